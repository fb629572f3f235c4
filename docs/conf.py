"""Sphinx builds the site from these settings: `make docs`."""

from __future__ import annotations

import inspect
import sys
import warnings
from pathlib import Path
from typing import Any

import cotree

sys.path.insert(0, str(Path(__file__).parent))  # gallery_support

project = "cotree"
author = "the cotree developers"
copyright = "the cotree developers, BSD-3-Clause"
release = version = cotree.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.viewcode",
    "numpydoc",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "sphinx-mathjax-offline",
]
templates_path = ["_templates"]
exclude_patterns = ["gallery", "_templates", "readme_picture.py", "sg_execution_times.rst"]
myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
nitpicky = False
smartquotes = False  # two dashes begin an option
autosummary_generate = True
autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
numpydoc_xref_param_type = False

# A script of the gallery that makes cotree warn, or NumPy, has a defect.
warnings.filterwarnings("error", category=RuntimeWarning)
sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "examples",
    "filename_pattern": r"/",
    "abort_on_example_error": True,
    "remove_config_comments": True,
    "download_all_examples": False,
    "show_memory": False,
    "thumbnail_size": (560, 392),
    "write_computation_times": False,
    "min_reported_time": 5,
    "subsection_order": [
        f"gallery/{field}"
        for field in (
            "mechanisms",
            "robots",
            "control",
            "circuits",
            "fluids_and_heat",
            "electrochemistry",
            "events",
            "sensitivities_and_design",
            "looking_inside",
            "embedded_c",
        )
    ],
    "within_subsection_order": "ExampleTitleSortKey",
    "image_scrapers": ("gallery_support.scrape_figures",),
    "reset_modules": ("gallery_support.set_style",),
}

html_theme = "pydata_sphinx_theme"
html_title = "cotree"
html_show_sourcelink = False
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_sidebars: dict[str, list[str]] = {"index": []}
html_theme_options = {
    "navigation_with_keys": False,
    "header_links_before_dropdown": 7,
    "show_prev_next": True,
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
}


# Members of the compiled model that serve the solvers, not users.
_FOR_SOLVERS = {
    "begins_at_rest",
    "bound",
    "bound_jacobian",
    "check_parameters",
    "check_start",
    "corners",
    "initial_values",
    "jacobian_colouring",
    "junctions",
    "layout",
    "longest_step",
    "native",
    "why_undefined",
    "headline",
    "mechanics",
}


def _is_left_out(
    _app: object, _what: str, name: str, _item: object, skip: bool, _o: object
) -> bool:
    return skip or name in _FOR_SOLVERS


# Classes that users make themselves, so that how they are made is shown.
_MADE_BY_USERS = {"cotree.Scene"}


def _without_making(_app: object, what: str, name: str, *_rest: object) -> tuple[str, str] | None:
    """Leave out how objects are made that cotree makes."""
    return ("", "") if what == "class" and name not in _MADE_BY_USERS else None


def _with_inherited_attributes(
    _app: object, what: str, name: str, item: Any, _options: object, lines: list[str]
) -> None:
    """List the attributes that a result has from the class below it, too."""
    if what == "class" and name == "cotree.Result":
        inherited = (inspect.getdoc(item.__mro__[1]) or "").splitlines()
        start = inherited.index("Attributes") + 2
        at = lines.index("Attributes") + 2
        lines[at:at] = inherited[start:]


def _with_bars(
    _app: object, _what: str, _name: str, _item: object, _options: object, lines: list[str]
) -> None:
    """Keep the bars of |x| in docstrings, which reStructuredText takes for substitutions."""
    lines[:] = [line if "``|" in line else line.replace("|", r"\|") for line in lines]


def _as_page_of_the_site(_app: object, page: str, source: list[str]) -> None:
    """Adapt what reads well in the repository, too: links that leave docs/, and lists of pages."""
    source[0] = source[0].replace("../benchmarks/README.md", "benchmarks.md")
    if page == "components/README":
        source[0] += "\n```{toctree}\n:hidden:\n:glob:\n\n*\n```\n"
    if page == "command_line":
        source[0] += _commands()


def _commands() -> str:
    """Describe every command as the program itself does."""
    from click import Context

    from cotree.cli.app import app

    text = ""
    with Context(app, info_name="cotree") as program:
        for name in app.list_commands(program):
            command = app.get_command(program, name)
            about = command.get_help(Context(command, program, name))
            text += f"\n## `cotree {name}`\n\n```text\n{about}\n```\n"
    return text


def setup(app: Any) -> None:
    """Connect what this file defines with Sphinx."""
    app.connect("autodoc-process-docstring", _with_inherited_attributes, priority=400)
    app.connect("autodoc-process-docstring", _with_bars)
    app.connect("autodoc-process-signature", _without_making)
    app.connect("autodoc-skip-member", _is_left_out)
    app.connect("source-read", _as_page_of_the_site)
