"""Figures that pyplot knows, so that ``plt.show()`` shows them.

A figure is made by pyplot where someone may ask pyplot for it: where the program has imported it,
in a notebook, and at an interactive prompt. Other programs get a figure that belongs to nothing: it
needs no window system, is not kept in memory, and is saved all the same.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

if TYPE_CHECKING:
    from collections.abc import Callable


class ShownFigure(Figure):
    """A figure that a notebook shows once, although it is the value of a cell, too."""

    def _ipython_display_(self) -> None:
        """Take it from pyplot, which would show all of its figures again when the cell ends."""
        pyplot = sys.modules.get("matplotlib.pyplot")
        number = getattr(self, "number", None)
        if pyplot is not None and number is not None and pyplot.fignum_exists(number):
            backend = pyplot.get_backend().lower()
            if "ipympl" in backend and pyplot.isinteractive():
                return  # it was shown as it was made
            if "inline" in backend:
                pyplot.close(self)
        # The notebook goes on as with any other figure, and shows it as a picture.
        raise NotImplementedError


def figure_for_people(width: float, height: float) -> Figure:
    """Make a figure of a size, [in], that pyplot knows where it may be asked for it."""
    layout = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.08)
    make: Callable[..., Figure] = ShownFigure
    if "matplotlib.pyplot" in sys.modules or _is_interactive():
        import matplotlib.pyplot as plt

        make = plt.figure
        return make(figsize=(width, height), layout=layout, FigureClass=ShownFigure)
    return make(figsize=(width, height), layout=layout)


def _is_interactive() -> bool:
    """Return whether a person types the statements, in a notebook or at a prompt."""
    shell = sys.modules.get("IPython")
    return hasattr(sys, "ps1") or (shell is not None and shell.get_ipython() is not None)
