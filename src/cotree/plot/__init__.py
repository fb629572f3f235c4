"""Figures of linear graphs, with their trees in bold, and of results; saving of figures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from cotree.files import atomic_write, check_suffix
from cotree.plot.graph import draw_graph, draw_graphs
from cotree.plot.result_figures import Curves, Name, choose_curves, draw_curves, plot_result

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
    """Write a figure to an SVG, PNG or PDF file, completely or not at all.

    Raises SceneError if the suffix is unknown or the file cannot be written.
    """
    import matplotlib

    path = Path(path)
    format = check_picture(path).removeprefix(".")
    # Omit dates and random identifiers, so that equal figures become equal files.
    dates: dict[str, Any] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    with (
        atomic_write(path, "the picture") as draft,
        matplotlib.rc_context({"svg.hashsalt": "cotree"}),
    ):
        fig.savefig(draft, format=format, dpi=150, metadata=dates.get(format, {}))


def svg_text(fig: Figure) -> str:
    """Return a figure as an SVG element on a light background."""
    import io

    import matplotlib

    text = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "cotree"}):
        fig.savefig(text, format="svg", metadata={"Date": None})
    # In an HTML page, the element must not follow an XML declaration.
    return text.getvalue().partition("<svg")[2].join(["<svg", ""])


def check_picture(path: Path) -> str:
    """Return the suffix of a picture file; raise SceneError if it is unknown."""
    return check_suffix(path, _SUFFIXES, "draw")
