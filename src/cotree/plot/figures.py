"""Figures that pyplot manages, so that ``plt.show()`` shows them, and figures to files.

A figure is made by pyplot if the program has imported pyplot, in a notebook, and at an interactive
prompt. In other programs it is a figure of its own, which needs no window system, is not kept in
memory, and can be saved.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure

from cotree.files import atomic_write, check_suffix
from cotree.plot.result import new_figure

if TYPE_CHECKING:
    import os


class ShownFigure(Figure):
    """A figure that a notebook shows once, even if it is the value of a cell."""

    def _ipython_display_(self) -> None:
        """Remove the figure from pyplot, which would show it again at the end of the cell."""
        pyplot = sys.modules.get("matplotlib.pyplot")
        number = getattr(self, "number", None)
        if pyplot is not None and number is not None and pyplot.fignum_exists(number):
            backend = pyplot.get_backend().lower()
            if "ipympl" in backend and pyplot.isinteractive():
                return  # it is shown already
            if "inline" in backend:
                pyplot.close(self)
        # The notebook then shows it as a picture, like any other figure.
        raise NotImplementedError


def figure_for_people(width: float, height: float) -> Figure:
    """Make a figure of a size, [in], by pyplot if the user may call ``plt.show()``."""
    if "matplotlib.pyplot" in sys.modules or _is_interactive():
        import matplotlib.pyplot as plt

        return new_figure(width, height, partial(plt.figure, FigureClass=ShownFigure))
    return new_figure(width, height, ShownFigure)


def _is_interactive() -> bool:
    """Return whether Python runs in a notebook or at a prompt."""
    shell = sys.modules.get("IPython")
    return hasattr(sys, "ps1") or (shell is not None and shell.get_ipython() is not None)


_SUFFIXES = (".svg", ".png", ".pdf")


def save_figure(fig: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure to a file, .svg, .png or .pdf, completely or not at all.

    Raises SceneError for another suffix, or if the file cannot be written.
    """
    import matplotlib

    path = Path(path)
    format = check_picture(path).removeprefix(".")
    # Neither date nor random identifiers, so that the same picture is the same file.
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
    # A page takes the element, without the declaration of a document.
    return text.getvalue().partition("<svg")[2].join(["<svg", ""])


def check_picture(path: Path) -> str:
    """Return the suffix of a picture's file."""
    return check_suffix(path, _SUFFIXES, "draw")
