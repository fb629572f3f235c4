"""Serve the gallery: one look for its pictures, and figures that pyplot does not know.

``Result.plot``, ``GraphReport.draw`` and ``BenchReport.plot`` return figures of their own where a
script does not import pyplot; the scraper of sphinx-gallery, made for pyplot, does not see those.
"""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst, matplotlib_scraper

STYLE = {
    "figure.figsize": (7.0, 3.8),
    "figure.constrained_layout.use": True,
    "figure.dpi": 110,
    "savefig.dpi": 110,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.alpha": 0.3,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
}

# Those of this script that are pictures already; kept, so that none is taken for another.
_seen: list[Figure] = []


def set_style(_settings: dict[str, Any], _script: str) -> None:
    """Reset the style of plots before each script."""
    _seen.clear()
    mpl.rcdefaults()
    plt.close("all")
    mpl.rcParams.update(STYLE)


def scrape_figures(
    block: Any, block_vars: dict[str, Any], settings: dict[str, Any], **options: Any
) -> str:
    """Save the figures of pyplot, then those that variables of the script hold."""
    _seen.extend(plt.figure(number) for number in plt.get_fignums())
    text: str = matplotlib_scraper(block, block_vars, settings, **options)
    paths = []
    for name, value in block_vars["example_globals"].items():
        if isinstance(value, Figure) and not name.startswith("_") and value not in _seen:
            _seen.append(value)
            path = str(next(block_vars["image_path_iterator"]))
            value.savefig(path, dpi=STYLE["savefig.dpi"])
            paths.append(path)
    return text + (figure_rst(paths, settings["src_dir"]) if paths else "")
