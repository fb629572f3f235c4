"""Pictures: linear graphs with their tree in bold, results over time, files of both.

Every function makes a matplotlib `Figure`, which belongs to no window unless its caller says how it
is made (:mod:`cotree.plot.figures`); nothing is computed here but positions on paper.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from cotree.files import atomic_write, check_suffix
from cotree.plot.graph import draw_graph, draw_graphs
from cotree.plot.result import Curves, Name, choose_curves, draw_curves, plot_result

if TYPE_CHECKING:
    import os

    from matplotlib.figure import Figure

__all__ = [
    "Curves",
    "Name",
    "check_picture",
    "choose_curves",
    "draw_curves",
    "draw_graph",
    "draw_graphs",
    "plot_result",
    "save_figure",
    "svg_text",
]

_SUFFIXES = (".svg", ".png", ".pdf")


def save_figure(fig: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure to a file, .svg, .png or .pdf, completely or not at all.

    Raises SceneError for another suffix, or if the file cannot be written.
    """
    import matplotlib

    path = Path(path)
    format = check_picture(path).removeprefix(".")
    # Without dates and random identifiers, equal pictures are equal files.
    dates: dict[str, Any] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    with (
        atomic_write(path, "the picture") as draft,
        matplotlib.rc_context({"svg.hashsalt": "cotree"}),
    ):
        fig.savefig(draft, format=format, dpi=150, metadata=dates.get(format, {}))


def svg_text(fig: Figure) -> str:
    """Return a figure as the text of an SVG element, on its own light ground."""
    import io

    import matplotlib

    text = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "cotree"}):
        fig.savefig(text, format="svg", metadata={"Date": None})
    # A page requires only the element, without the document declaration.
    return text.getvalue().partition("<svg")[2].join(["<svg", ""])


def check_picture(path: Path) -> str:
    """Return the suffix of a picture's file."""
    return check_suffix(path, _SUFFIXES, "draw")
