"""Drawings of linear graphs as in the paper ([1] Fig. 1 and 4): tree bold, ground hatched.

The layout of nodes and edges is deterministic. Its unit of length is about two thirds of the usual
distance between neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import numpy.typing as npt

from cotree.graph.linear_graph import walk_edges

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from cotree.graph import GraphEdge, LinearGraph, Tree

Array = npt.NDArray[np.float64]

# Distance between parallel edges, clearance between edges and nodes, margin of the picture.
_FAN, _CLEARANCE, _MARGIN = 0.36, 0.22, 0.45
# Width of a letter in edge names; candidate positions of a name along its edge, the best first.
_LETTER, _LABEL_PLACES = 0.068, (0.46, 0.4, 0.52, 0.34, 0.28, 0.58)
# Number of nodes in a row of a long chain.
_LINE = 7
# If no gap between edges at the reference exceeds this, the picture is compressed to a half plane.
_OPEN = np.radians(150)


@dataclass(frozen=True)
class Curve:
    """An edge on paper: a cubic Bezier curve from its tail to its head, points of shape (4, 2)."""

    edge: GraphEdge
    points: Array

    def at(self, s: float) -> Array:
        """Return the point at `s` from 0 (tail) to 1 (head)."""
        # Bernstein polynomials of degree three.
        weights = np.array([(1 - s) ** 3, 3 * s * (1 - s) ** 2, 3 * s**2 * (1 - s), s**3])
        return np.asarray(weights @ self.points)


@dataclass(frozen=True)
class GraphDrawing:
    """The layout of a graph: nodes, edge curves, positions of edge names, picture corners."""

    graph: LinearGraph
    position_of: dict[str, Array]
    curves: tuple[Curve, ...]
    labels: tuple[Array, ...]
    low: Array
    high: Array

    @property
    def size(self) -> Array:
        """Width and height of the picture."""
        return self.high - self.low


def lay_out(graph: LinearGraph) -> GraphDrawing:
    """Compute the positions of a graph's nodes, edges and names."""
    position_of = _positions(graph)
    curves = tuple(_curves(graph, position_of))
    points = [*position_of.values(), *(c.at(s) for c in curves for s in np.linspace(0, 1, 9))]
    low, high = np.min(points, axis=0) - _MARGIN, np.max(points, axis=0) + _MARGIN
    return GraphDrawing(graph, position_of, curves, _labels(curves, position_of), low, high)


def of_one_height(drawings: Sequence[GraphDrawing]) -> list[GraphDrawing]:
    """Extend all drawings to the same lower and upper limits, which aligns their titles."""
    low, high = min(d.low[1] for d in drawings), max(d.high[1] for d in drawings)
    return [
        replace(d, low=np.array([d.low[0], low]), high=np.array([d.high[0], high]))
        for d in drawings
    ]


def _positions(graph: LinearGraph) -> dict[str, Array]:
    if graph.n_nodes <= 2:
        others = [node for node in graph.nodes if node != graph.reference]
        return {graph.reference: np.zeros(2)} | {node: np.array([0.0, 2.2]) for node in others}
    import networkx

    walk = walk_edges(graph, graph.edge_names, graph.reference)
    order = [graph.reference, *(step.child for step in walk)]
    # For the layout, unconnected components are joined to the reference.
    floating = [node for node in graph.nodes if node not in order]
    order += floating
    index_of = {node: i for i, node in enumerate(order)}
    simple = networkx.Graph((index_of[edge.tail], index_of[edge.head]) for edge in graph.edges)
    simple.add_edges_from((0, index_of[node]) for node in floating)
    pairs = sorted(tuple(sorted(pair)) for pair in simple.edges)
    if pairs == [(i, i + 1) for i in range(len(order) - 1)]:
        points = _serpentine(len(order))
    else:
        angles = np.linspace(0, 2 * np.pi, len(order), endpoint=False)
        # Start on a circle, in the order of a traversal from the reference.
        start = dict(enumerate(np.column_stack([np.cos(angles), np.sin(angles)])))
        placed = networkx.kamada_kawai_layout(simple, pos=start)
        # The reference becomes the origin, about which the picture is rotated.
        points = np.array([placed[i] - placed[0] for i in range(len(order))])
        lengths = [np.linalg.norm(points[i] - points[j]) for i, j in pairs]
        points = _reference_below(points / np.median(lengths) * 1.5, pairs)
    return dict(zip(order, points, strict=True))


def _serpentine(n: int) -> Array:
    """Return positions of `n` nodes of a chain in a serpentine from the top left corner."""
    # Reverse every second row, so that neighbours in the chain are adjacent.
    row, column = np.divmod(np.arange(n), _LINE)
    column = np.where(row % 2 == 0, column, _LINE - 1 - column)
    return np.column_stack([1.3 * column, -1.1 * row]).astype(float)


def _reference_below(points: Array, pairs: Iterable[tuple[int, ...]]) -> Array:
    """Rotate the picture about node 0, the reference, so that the other nodes are above it.

    If nodes surround the reference, their directions are first compressed into a half plane, from
    the gap that stretches the fewest edges.
    """
    x, y = points[1:].T
    angles = np.arctan2(y, x)
    order = np.argsort(angles, kind="stable")
    gaps = np.mod(np.roll(angles[order], -1) - angles[order], 2 * np.pi)
    inner = [(i - 1, j - 1) for i, j in pairs if i > 0]

    def behind(gap: int) -> Array:
        """Return the node angles measured from the end of the gap."""
        turned = np.mod(angles - angles[order[(gap + 1) % len(order)]], 2 * np.pi)
        # Rounding may change the angle zero to a full turn.
        return np.where(turned > 2 * np.pi - 1e-9, 0.0, turned)

    def cost(gap: int) -> tuple[int, float]:
        turned = behind(gap)
        # An edge is stretched if its ends are more than half a turn apart.
        crossing = sum(abs(turned[i] - turned[j]) > np.pi for i, j in inner)
        return (crossing, -round(float(gaps[gap]), 6))

    gap = min(range(len(gaps)), key=cost) if gaps.max() < _OPEN else int(gaps.argmax())
    turned, spread = behind(gap), max(2 * np.pi - gaps[gap], 1e-9)
    # Compress angles to the half plane above the reference; enlarge radii to preserve arc lengths.
    shrink = min(1.0, np.pi / spread)
    # Place nodes clockwise from the left, where the traversal usually starts.
    side = 1.0 if turned[0] <= spread / 2 else -1.0
    directions = np.pi / 2 + side * shrink * (spread / 2 - turned)
    radii = np.hypot(x, y) / shrink
    fan = np.column_stack([radii * np.cos(directions), radii * np.sin(directions)])
    return np.vstack([np.zeros(2), fan])


def _curves(graph: LinearGraph, position_of: Mapping[str, Array]) -> Iterator[Curve]:
    """Draw parallel edges as a fan, and bend edges around nodes that are not their ends."""
    parallel: dict[frozenset[str], list[GraphEdge]] = {}
    for edge in graph.edges:
        # Parallel edges join the same two nodes in either direction.
        parallel.setdefault(frozenset((edge.tail, edge.head)), []).append(edge)
    for edges in parallel.values():
        ends = (edges[0].tail, edges[0].head)
        others = np.array([p for node, p in position_of.items() if node not in ends])
        fans = [
            [
                _curve(edge, ends, position_of, shift + _FAN * ((len(edges) - 1) / 2 - k))
                for k, edge in enumerate(edges)
            ]
            for shift in (0.0, 0.3, -0.3, 0.6, -0.6, 0.9, -0.9)
        ]
        # Take the first fan with sufficient clearance, or else the fan with the largest clearance.
        yield from max(fans, key=lambda fan: min(_CLEARANCE, _clearance(fan, others)))


def _curve(
    edge: GraphEdge, ends: tuple[str, str], position_of: Mapping[str, Array], bulge: float
) -> Curve:
    """Return an edge as an arc whose middle is `bulge` to the left of the line between `ends`."""
    first, last = position_of[ends[0]], position_of[ends[1]]
    along = last - first
    normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    # At its middle, a cubic curve has 3/4 of the offset of its inner control points.
    inner = 4 / 3 * bulge * normal
    points = np.array([first, first + 0.2 * along + inner, last - 0.2 * along + inner, last])
    # The arc begins at the first of the two nodes, the curve at the tail of the edge.
    return Curve(edge, points if edge.tail == ends[0] else points[::-1])


def _clearance(fan: Sequence[Curve], others: Array) -> float:
    if not len(others):
        return float("inf")
    samples = np.array([curve.at(s) for curve in fan for s in np.linspace(0.05, 0.95, 19)])
    distances = np.linalg.norm(samples[:, None, :] - others[None, :, :], axis=2)
    return float(distances.min())


def _labels(curves: Sequence[Curve], position_of: Mapping[str, Array]) -> tuple[Array, ...]:
    """Return a position on its edge for each name, away from previous names, edges and nodes."""
    samples = np.array([[curve.at(s) for s in np.linspace(0.06, 0.94, 41)] for curve in curves])
    nodes = np.array(list(position_of.values()))
    places: list[Array] = []
    halves: list[Array] = []
    for i, curve in enumerate(curves):
        half = np.array([_LETTER * len(curve.edge.name) / 2 + 0.04, 0.09])
        foreign = np.vstack([*samples[:i], *samples[i + 1 :], nodes])
        taken, widths = np.reshape(places, (-1, 2)), np.reshape(halves, (-1, 2)) + half
        candidates = [curve.at(s) for s in _LABEL_PLACES]
        # Overlap with another name is worse than overlap with any number of lines.
        costs = [
            1000 * _count_within(taken - place, widths) + _count_within(foreign - place, half)
            for place in candidates
        ]
        places.append(candidates[int(np.argmin(costs))])
        halves.append(half)
    return tuple(places)


def _count_within(offsets: Array, half: Array) -> int:
    return int(np.all(np.abs(offsets) < half, axis=1).sum())


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
            away = freest(directions, 4)
            _draw_ground(ax, position, away)
            place = position + (0.42 if away[0] == 0 else 0.5) * away
        else:
            away = freest(directions, 16)
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


def freest(directions: Sequence[Array], n: int) -> Array:
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
