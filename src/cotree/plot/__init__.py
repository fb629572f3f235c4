"""Pictures: linear graphs with their tree in bold, results over time, files of both.

Every function makes a matplotlib `Figure`, which belongs to no window unless its caller says how it
is made (:mod:`cotree.plot.figures`); nothing is computed here but positions on paper.
"""

from __future__ import annotations

from cotree.plot.figures import check_picture, save_figure, svg_text
from cotree.plot.graph import draw_graph, draw_graphs
from cotree.plot.result import Curves, Name, choose_curves, draw_curves, plot_result

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
