"""Drawings of linear graphs as in the paper ([1] Fig. 1 and 4): tree bold, ground hatched."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

import numpy as np

from cotree.plot.layout import Array, Curve, GraphDrawing, lay_out, of_one_height

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from cotree.graph import LinearGraph, Tree

_INCHES = 1.35
# Radius of a node, size of a thin edge's arrow head, distance of a node's name, in layout units.
_DOT = 0.055
_HEAD_LENGTH, _HEAD_WIDTH = 0.15, 0.1
_LABEL_DISTANCE = 0.2


def draw_graph(graph: LinearGraph, tree: Tree | None, ax: Axes | None = None) -> Figure:
    """Draw a linear graph: nodes as dots, branches as bold and chords as thin arrows."""
    drawing = lay_out(graph)
    if ax is None:
        figure = _new_figure([drawing])
        ax = figure.subplots()
    _draw(drawing, tree, ax)
    return cast("Figure", ax.figure)


def draw_graphs(
    graphs_with_trees: Iterable[tuple[LinearGraph, Tree | None]],
    make: Callable[[float, float], Figure] | None = None,
    parts: Sequence[str] = (),
) -> Figure:
    """Draw several graphs side by side, each under the name of its domain.

    Edges of each of the ``parts`` have a background of one colour.
    """
    pairs = list(graphs_with_trees)
    drawings = of_one_height([lay_out(graph) for graph, _ in pairs])
    figure = _new_figure(drawings, make)
    # Widths of panels are proportional to widths of graphs, so that all graphs have one scale.
    axes = figure.subplots(
        1, len(drawings), squeeze=False, width_ratios=[drawing.size[0] for drawing in drawings]
    )
    for drawing, (_, tree), ax in zip(drawings, pairs, axes[0], strict=True):
        _draw(drawing, tree, ax)
        _draw_parts(drawing, parts, ax)
    return figure


def _new_figure(
    drawings: Sequence[GraphDrawing], make: Callable[[float, float], Figure] | None = None
) -> Figure:
    from matplotlib.figure import Figure

    width = sum(drawing.size[0] for drawing in drawings) * _INCHES
    height = max(drawing.size[1] for drawing in drawings) * _INCHES
    size = (max(width, 2.6), height + 0.8)
    return make(*size) if make else Figure(figsize=size, layout="constrained")


def _draw(drawing: GraphDrawing, tree: Tree | None, ax: Axes) -> None:
    from matplotlib.patches import Circle

    graph = drawing.graph
    # An equal aspect preserves the angles and lengths of the layout.
    ax.set_aspect("equal")
    ax.set_axis_off()
    ax.set_xlim(drawing.low[0], drawing.high[0])
    ax.set_ylim(drawing.low[1], drawing.high[1])
    ax.set_title(graph.domain, fontsize=11)
    for curve, label in zip(drawing.curves, drawing.labels, strict=True):
        _draw_edge(ax, curve, label, bold=tree is not None and tree.is_branch(curve.edge.name))
    for node, position in drawing.position_of.items():
        directions = [
            # Edges may be curved, so use their directions near the node.
            (curve.at(0.15) if curve.edge.tail == node else curve.at(0.85)) - position
            for curve in drawing.curves
            if node in (curve.edge.tail, curve.edge.head)
        ]
        if node == graph.reference:
            # A ground symbol points down, up, left or right.
            away = _freest(directions, 4)
            _draw_ground(ax, position, away)
            place = position + (0.42 if away[0] == 0 else 0.5) * away
        else:
            away = _freest(directions, 16)
            place = position + _LABEL_DISTANCE * away
        ax.add_patch(Circle(tuple(position), _DOT, fc="black", ec="white", lw=0.8, zorder=4))
        _write(ax, place, node, fontsize=11, zorder=5)
    if tree is not None:
        _draw_key(ax)


def _draw_parts(drawing: GraphDrawing, parts: Sequence[str], ax: Axes) -> None:
    """Draw broad pale strokes under each part's edges, whose names begin with the part's name."""
    for number, part in enumerate(parts):
        for curve in drawing.curves:
            if curve.edge.name.startswith(f"{part}."):
                _draw_curve(ax, curve, lw=22, ec=f"C{number % 10}", alpha=0.15, zorder=0)


def _draw_curve(ax: Axes, curve: Curve, **style: Any) -> None:
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    codes = [Outline.MOVETO, Outline.CURVE4, Outline.CURVE4, Outline.CURVE4]
    ax.add_patch(PathPatch(Outline(curve.points, codes), fill=False, **style))


def _freest(directions: Sequence[Array], n: int) -> Array:
    """Return the direction, out of `n`, that is farthest from all edges; the first is down."""
    angles = -np.pi / 2 + 2 * np.pi / n * np.arange(n)
    # Rounding makes equivalent directions equal, so that the first one is chosen.
    candidates = np.round(np.column_stack([np.cos(angles), np.sin(angles)]), 12)
    if not directions:
        return np.asarray(candidates[0])
    units = np.array([direction / np.linalg.norm(direction) for direction in directions])
    # The largest cosine is that of the nearest edge; the freest direction minimises it.
    closest = np.max(candidates @ units.T, axis=1)
    return np.asarray(candidates[np.argmin(np.round(closest, 9))])


def _draw_edge(ax: Axes, curve: Curve, label: Array, *, bold: bool) -> None:
    from matplotlib.patches import Polygon

    width, color = (3.0, "black") if bold else (1.1, "0.25")
    _draw_curve(ax, curve, lw=width, ec=color, zorder=1)
    along = curve.at(0.78) - curve.at(0.70)
    along /= np.linalg.norm(along)
    normal = np.array([-along[1], along[0]])
    size = 1.3 if bold else 1.0
    # The name is at the middle of the edge, so the arrow is farther along.
    tip = curve.at(0.74) + _HEAD_LENGTH / 2 * size * along
    half = _HEAD_WIDTH / 2 * size * normal
    back = tip - _HEAD_LENGTH * size * along
    ax.add_patch(
        Polygon([tip, back + half, back - half], closed=True, fc=color, ec="none", zorder=2)
    )
    box = {"boxstyle": "round,pad=0.12", "fc": "white", "ec": "none"}
    style = {"fontstyle": "italic", "fontweight": "bold" if bold else "normal"}
    _write(ax, label, curve.edge.name, fontsize=10, zorder=3, bbox=box, **style)


def _write(ax: Axes, place: Array, text: str, **style: Any) -> None:
    ax.text(place[0], place[1], text, ha="center", va="center", parse_math=False, **style)


def _draw_ground(ax: Axes, position: Array, away: Array) -> None:
    side = np.array([-away[1], away[0]])
    ground = position + 0.14 * away
    strokes = [(position, ground), (ground - 0.24 * side, ground + 0.24 * side)]
    for shift in np.linspace(-0.2, 0.24, 6):
        begin = ground + shift * side
        strokes.append((begin, begin + 0.1 * away - 0.08 * side))
    for begin, end in strokes:
        ax.plot([begin[0], end[0]], [begin[1], end[1]], color="black", lw=1.1, zorder=1)


def _draw_key(ax: Axes) -> None:
    from matplotlib.lines import Line2D

    branch = Line2D([], [], color="black", lw=3.0, label="branch")
    chord = Line2D([], [], color="0.25", lw=1.1, label="chord")
    below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.02), "ncols": 2}
    ax.legend(handles=[branch, chord], frameon=False, fontsize=9, **below)
