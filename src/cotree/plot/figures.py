"""Figures that pyplot manages, so that ``plt.show()`` displays them.

In notebooks, at prompts and in programs that import pyplot, pyplot makes the figures. Other figures
need no window system and do not remain in memory.
"""

from __future__ import annotations

import sys
from functools import partial

from matplotlib.figure import Figure

from cotree.plot.result_figures import new_figure


class ShownFigure(Figure):
    """A figure that a notebook displays only once, even if it is the value of a cell."""

    def _ipython_display_(self) -> None:
        """Remove the figure from pyplot, which would display it again at the end of the cell."""
        pyplot = sys.modules.get("matplotlib.pyplot")
        number = getattr(self, "number", None)
        if pyplot is not None and number is not None and pyplot.fignum_exists(number):
            backend = pyplot.get_backend().lower()
            if "ipympl" in backend and pyplot.isinteractive():
                return  # the figure has already been displayed
            if "inline" in backend:
                pyplot.close(self)
        # This exception makes the notebook display the figure as a picture.
        raise NotImplementedError


def figure_for_people(width: float, height: float) -> Figure:
    """Make a figure of the given size, [in], managed by pyplot if ``plt.show()`` may follow."""
    if "matplotlib.pyplot" in sys.modules or _is_interactive():
        import matplotlib.pyplot as plt

        return new_figure(width, height, partial(plt.figure, FigureClass=ShownFigure))
    return new_figure(width, height, ShownFigure)


def _is_interactive() -> bool:
    """Return whether Python runs in a notebook or at a prompt."""
    shell = sys.modules.get("IPython")
    return hasattr(sys, "ps1") or (shell is not None and shell.get_ipython() is not None)
