"""Sphinx builds the site from these settings: `make docs`."""

from __future__ import annotations

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
exclude_patterns = ["gallery"]
myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 4
nitpicky = False
autosummary_generate = True
autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
numpydoc_xref_param_type = False

# What scripts of the gallery warn of is a defect of the script.
warnings.filterwarnings("error", module="gallery")
sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "examples",
    "filename_pattern": r"/",
    "abort_on_example_error": True,
    "remove_config_comments": True,
    "download_all_examples": False,
    "show_memory": False,
    "min_reported_time": 5,
    "within_subsection_order": "ExampleTitleSortKey",
    "image_scrapers": ("gallery_support.scrape_figures",),
    "reset_modules": ("gallery_support.set_style",),
}

html_theme = "pydata_sphinx_theme"
html_title = "cotree"
html_show_sourcelink = False
html_theme_options = {
    "navigation_with_keys": False,
    "show_prev_next": True,
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
}


def _as_page_of_the_site(_app: object, page: str, source: list[str]) -> None:
    """Adapt what reads well in the repository, too: links that leave docs/, and lists of pages."""
    source[0] = source[0].replace("../benchmarks/README.md", "benchmarks.md")
    if page == "components/README":
        source[0] += "\n```{toctree}\n:hidden:\n:glob:\n\n*\n```\n"


def setup(app: Any) -> None:
    """Connect what this file defines with Sphinx."""
    app.connect("source-read", _as_page_of_the_site)
