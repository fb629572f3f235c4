"""An animated drawing: solids on tracks, struts between them, and their poses over time.

In planar scenes, bars are plates, struts are behind all plates, and bodies that share a joint are
in different layers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cotree.components import Role
from cotree.watch import shapes
from cotree.watch.shapes import BODIES, GROUND, JOINT, Array, Color, Mesh, axes_along

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from cotree.formulation.fields import BoundEdge
    from cotree.formulation.first_graph import FirstGraph
    from cotree.watch.frame_times import Moments
    from cotree.watch.stage import MotionValues, Place, Poses, Stage


#: Length of travel, in mechanism sizes, beyond which the camera follows the mechanism.
FAR = 15.0


def _spread(n: int) -> Array:
    """Return ``n`` directions spread evenly over the sphere, on a golden-angle spiral."""
    # Slices of equal height have equal areas on a sphere (Archimedes).
    z = (2.0 * np.arange(n) + 1.0) / n - 1.0
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(n)
    r = np.sqrt(1.0 - z**2)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z])


# For this number, a bounding box has an error of about a hundredth of the shape's size.
_DIRECTIONS = _spread(200)


@dataclass(frozen=True, eq=False)
class Solid:
    """A shape that moves with a track, the motion of one cluster."""

    name: str  # name of the edge or node
    track: int  # index of the cluster with which the shape moves
    mesh: Mesh  # shape, in the track's axes
    color: Color  # colour of the shape


@dataclass(frozen=True, eq=False)
class Strut:
    """A shape between two points; its mesh, from z = 0 to z = 1, is stretched to their distance."""

    name: str
    tracks: tuple[int, int]  # indices of the clusters with which the strut's ends move
    ends: tuple[Array, Array]  # end points, in the axes of these clusters
    side: Array  # direction in the first track's axes, close to the mesh's y direction
    mesh: Mesh
    color: Color


@dataclass(frozen=True, eq=False)
class Label:
    """A label at a point of a track."""

    text: str
    track: int
    local: Array


@dataclass(frozen=True, eq=False)
class Drawing:
    """The shapes and labels of an animation, and their motion."""

    #: Name of the scene, and a note on the run; untrusted.
    title: str
    note: str
    frames: Moments  # times and events of the frames
    poses: Poses  # poses of the tracks (clusters) in each frame
    #: Shapes, struts and labels to draw.
    solids: tuple[Solid, ...]
    struts: tuple[Strut, ...]
    labels: tuple[Label, ...]
    up: Array  # axis that points up in the picture
    towards: Array  # direction to the viewer: the normal of a plane, or the user's choice
    is_flat: bool  # whether everything moves in a plane
    thickness: float  # thickness of bars, [m]

    def floor(self) -> Array:
        """Return the lines of a fixed grid, (n_lines, 2, 3), or dashes along a camera's path."""
        axes = axes_along(self.up, self.towards if self.is_flat else None)
        low, high = self.bounds(axes)
        # ``own`` is the largest extent at any time, ``path`` the path of the centre.
        own, path = float((high - low).max()), 0.5 * (low + high) @ axes.T
        low, high = low.min(axis=0), high.max(axis=0)
        is_far = float((high - low).max()) > FAR * own
        if own <= 0.0 or (self.is_flat and not is_far):
            return np.zeros((0, 2, 3))
        if is_far and not self.is_flat:
            return _dashes(path, 0.4 * own)
        # Two horizontal directions of the grid, and its normal.
        one, two, still = (0, 2, 1) if self.is_flat else (0, 1, 2)
        size = max(float(high[one] - low[one]), float(high[two] - low[two]), 0.5 * own)
        step = _round_up(max(0.5 * own, size / 300.0) if is_far else size / 9.0)
        lines = []
        for fixed, free in ((one, two), (two, one)):
            # Lines are at multiples of the step, wherever the motion starts.
            middle = {k: round(0.5 * (low[k] + high[k]) / step) * step for k in (fixed, free)}
            extent = {k: high[k] - low[k] if is_far else size for k in (fixed, free)}
            n = {k: int(np.ceil(0.6 * extent[k] / step)) + (2 if is_far else 0) for k in extent}
            for i in range(-n[fixed], n[fixed] + 1):
                ends = np.empty((2, 3))
                ends[:, fixed] = middle[fixed] + i * step
                ends[:, free] = middle[free] + np.array([-n[free], n[free]]) * step
                ends[:, still] = low[still] - (own if is_far else 0.0)
                lines.append(ends @ axes.T)
        return np.array(lines)

    def bounds(self, axes: Array) -> tuple[Array, Array]:
        """Return the bounding box of each frame along ``axes``, two arrays (n_frames, 3), [m]."""
        n = len(self.frames.times)
        low, high = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
        corners: dict[int, list[Array]] = {}
        for solid in self.solids:
            corners.setdefault(solid.track, []).append(_outermost(solid.mesh.points))
        for strut in self.struts:
            for track, end in zip(strut.tracks, strut.ends, strict=True):
                # The ends of a strut bound it.
                corners.setdefault(track, []).append(end[None])
        for track, parts in corners.items():
            points = np.concatenate(parts)
            turned = axes.T @ self.poses.axes[track]
            # Multiply rotation and view for all frames of a track before applying them to points.
            placed = turned @ points.T + (self.poses.positions[track] @ axes)[:, :, None]
            low, high = np.minimum(low, placed.min(axis=2)), np.maximum(high, placed.max(axis=2))
        return low, high


def _dashes(path: Array, length: float) -> Array:
    """Return at most 300 dashes of about the same length along a path, shape (n_lines, 2, 3)."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    # Dashes and gaps have the same length.
    n = int(min(300.0, 0.5 * way[-1] / length))
    at = np.linspace(0.0, way[-1], 2 * n)
    points = np.stack([np.interp(at, way, column) for column in path.T], axis=1)
    return points.reshape(n, 2, 3)


def _round_up(x: float) -> float:
    """Round up to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(x))
    return float(next(m for m in (1.0, 2.0, 5.0, 10.0) if m * power >= x) * power)


def _outermost(points: Array) -> Array:
    """Return the outermost points in many directions, which determine bounding boxes."""
    if len(points) <= len(_DIRECTIONS):
        return points
    return np.asarray(points[np.unique(np.argmax(points @ _DIRECTIONS.T, axis=0))])


def layers_of(edges: Iterable[BoundEdge], places: Mapping[str, Place], n: int) -> list[int]:
    """Assign layers to n clusters, different for clusters that share a joint or constraint."""
    neighbours: list[set[int]] = [set() for _ in range(n)]
    for edge in edges:
        if edge.component.role in (Role.JOINT, Role.CONSTRAINT):
            a, b = (places[name].cluster for name in (edge.first, edge.second))
            neighbours[max(a, b)].add(min(a, b))
    layers = [0] * n
    # Greedy colouring; the ground has no layer.
    for cluster in range(1, n):
        taken = {layers[other] for other in neighbours[cluster] if other}
        layers[cluster] = next(i for i in range(n) if i not in taken)
    return layers


class DrawingBuilder:
    """Builder of a drawing, to which edges add their shapes in cluster axes."""

    def __init__(
        self,
        first: FirstGraph,
        values: MotionValues,
        stage: Stage,
        with_visuals: frozenset[int] = frozenset(),
    ) -> None:
        self.first, self.values, self.stage = first, values, stage
        self.poses, self.places = stage.poses, stage.places
        self.w = stage.thickness
        self.solids: list[Solid] = []
        self.struts: list[Strut] = []
        self.labels: list[Label] = []
        self.layer = layers_of(first.system.edges.values(), self.places, len(self.poses.positions))
        # Layers are slightly thicker than a plate, so that plates do not touch.
        self.pitch = 1.1 * self.w if stage.is_flat else 0.0
        self.with_visuals = with_visuals
        self._grounded: set[tuple[float, ...]] = set()
        self._between: dict[tuple[str, str], list[tuple[str, Mesh, Color]]] = {}

    def drawing(self, title: str, note: str, frames: Moments) -> Drawing:
        """Return the drawing, with a title above it and a note below."""
        # Add struts last, so that all struts between two nodes are known and placed side by side.
        stage = self.stage
        for (first, second), own in self._between.items():
            self._add_struts(first, second, own)
        if not self.solids and not self.struts:  # without other shapes, points become balls
            for name, place in self.places.items():
                self.solid(name, place.cluster, shapes.sphere(self.w).placed(place.local))
        return Drawing(
            title,
            note,
            frames,
            self.poses,
            tuple(self.solids),
            tuple(self.struts),
            tuple(self.labels),
            stage.up,
            stage.towards,
            stage.is_flat,
            self.w,
        )

    def color(self, cluster: int) -> Color:
        """Return the colour of a body."""
        return GROUND if cluster == 0 else BODIES[self.stage.body[cluster] % len(BODIES)]

    def raised(self, cluster: int) -> Array:
        """Return the offset of a body's plates towards the viewer, in its axes."""
        return self.layer[cluster] * self.pitch * self.towards(cluster)

    def towards(self, cluster: int) -> Array:
        """Return the direction to the viewer in a body's axes; it is constant in a plane."""
        return np.asarray(self.poses.axes[cluster][0].T @ self.stage.towards)

    def axis(self, edge: BoundEdge, name: str, end: str) -> Array:
        """Return an axis of an edge, (3,), in the axes of a node's cluster."""
        return np.asarray(self.places[end].turn @ self.values.numbers(edge.vectors[name]))

    def gap(self, first: str, second: str) -> Array:
        """Return the vector between two nodes over time, in ground axes, shape (n_times, 3)."""
        one, two = (self.places[name] for name in (first, second))
        return self.poses.of(two.cluster, two.local) - self.poses.of(one.cluster, one.local)

    def reach(self, edge: BoundEdge) -> Array:
        """Return the vector between an edge's nodes over time, in the axes of the first node."""
        one = self.places[edge.first]
        axes = self.poses.axes[one.cluster] @ one.turn
        return np.asarray(np.einsum("tji,tj->ti", axes, self.gap(edge.first, edge.second)))

    def solid(
        self, name: str, cluster: int, mesh: Mesh, color: Color | None = None, label: bool = False
    ) -> None:
        """Add a shape that moves with a body; its default colour is that of the body."""
        self.solids.append(Solid(name, cluster, mesh, color or self.color(cluster)))
        if label:
            self.label(name, cluster, mesh.points.mean(axis=0))

    def label(self, name: str, cluster: int, local: Array) -> None:
        """Label a point in the axes of a body, [m]."""
        self.labels.append(Label(name, cluster, local))

    def upright(self) -> Array:
        """Return ground axes with z up and y towards the viewer."""
        return shapes.axes_along(self.stage.up, self.stage.towards)

    def is_hidden(self, edge: BoundEdge) -> bool:
        """Return whether both bodies of a joint have visuals."""
        return {self.places[n].cluster for n in (edge.first, edge.second)} <= self.with_visuals

    def pin(self, edge: BoundEdge, end: str, axis: Array, radius: float, length: float) -> None:
        """Draw a cylinder through a node about ``axis``, in cluster axes."""
        place = self.places[end]
        at = place.local
        if self.stage.is_flat:  # the pin extends through all layers
            height = 0.5 * max(self.layer) * self.pitch
            at, length = at + height * self.towards(place.cluster), 2.0 * height + 1.3 * self.w
        mesh = shapes.cylinder(radius, length).placed(at, shapes.axes_along(axis))
        self.solid(edge.name, place.cluster, mesh, JOINT)

    def mark(self, edge: BoundEdge) -> None:
        """Label a joint; draw a ground symbol if it connects a body to the ground."""
        one, two = self.places[edge.first], self.places[edge.second]
        self.label(edge.name, one.cluster, one.local)
        for place in (one, two):
            if place.cluster == 0:
                self.ground_symbol(edge.name, place)

    def ground_symbol(self, name: str, place: Place) -> None:
        """Draw a ground symbol at a point, unless it already has one."""
        if not self.stage.is_flat and np.linalg.norm(place.local) > self.w:
            place = self.places["ground"]  # at the ground node, which bars connect to the point
        if (at := tuple(place.local)) in self._grounded:
            return
        self._grounded.add(at)
        w, size = self.w, 3.6 * self.w
        axes = self.upright()
        if self.stage.is_flat:
            triangle = np.array([[0.0, 0.0], [-0.62 * size, -size], [0.62 * size, -size]])
            legs = shapes.extruded(triangle, 0.5 * w)
            base = shapes.box(2.0 * size, 0.6 * w, 0.22 * size)
            behind = 1.2 * self.pitch * self.stage.towards
        else:
            legs = shapes.turned([(0.0, -size), (0.6 * size, -size), (0.2 * size, 0.0), (0.0, 0.0)])
            base = shapes.cylinder(0.8 * size, 0.2 * size)
            behind = np.zeros(3)
        base = base.placed(np.array([0.0, 0.0, -1.1 * size]))
        foot = shapes.joined([legs, base]).placed(place.local - behind, axes)
        self.solid(name, 0, foot, GROUND)

    def length(self, first: str, second: str) -> float:
        """Return the mean distance of two nodes."""
        return float(np.linalg.norm(self.gap(first, second), axis=1).mean())

    def strut(self, name: str, first: str, second: str, mesh: Mesh, color: Color) -> None:
        """Add a strut between two nodes; the length of its mesh along z is one."""
        one, two = self.places[first], self.places[second]
        # Struts within one body or between coincident points are not drawn.
        if one.cluster != two.cluster and self.length(first, second) > 1e-9 * self.stage.size:
            self._between.setdefault((first, second), []).append((name, mesh, color))

    def _add_struts(self, first: str, second: str, own: list[tuple[str, Mesh, Color]]) -> None:
        """Add all struts between two nodes, with ground symbols or walls at their ends."""
        one, two = self.places[first], self.places[second]
        stage, axes = self.stage, self.poses.axes
        gaps = self.gap(first, second)
        # A strut may shrink to a point, so take its direction at the greatest length.
        gap = gaps[int(np.argmax(np.linalg.norm(gaps, axis=1)))]
        towards = stage.towards if stage.is_flat else shapes.axes_along(gap, stage.up)[:, 0]
        along = shapes.axes_along(gap, towards)
        apart, behind = 2.9 * self.w * along[:, 0], np.zeros(3)
        if stage.is_flat:  # struts are drawn behind the bars
            behind = 1.6 * self.pitch * stage.towards
        for i, (name, mesh, color) in enumerate(own):
            shift = (i - 0.5 * (len(own) - 1)) * apart - behind
            # In cluster axes, the shift at the first time applies to all times.
            ends = [p.local + axes[p.cluster, 0].T @ shift for p in (one, two)]
            side = axes[one.cluster, 0].T @ towards
            tracks = (one.cluster, two.cluster)
            self.struts.append(Strut(name, tracks, (ends[0], ends[1]), side, mesh, color))
            self.label(name, one.cluster, ends[0])
        # The wall is wide enough for all struts side by side.
        width = (2.9 * len(own) + 0.6) * self.w
        # A strut ends at a ground symbol if its direction changes, otherwise at a wall.
        is_turning = np.linalg.norm(np.cross(gaps, gap), axis=1).max() > 0.1 * float(gap @ gap)
        for place in (one, two):
            if place.cluster == 0 and is_turning:
                self.ground_symbol(own[0][0], place)
            elif place.cluster == 0 or len(own) > 1:
                wall = shapes.box(width, width if place.cluster == 0 else self.w, 0.5 * self.w)
                at = place.local - axes[place.cluster, 0].T @ behind
                turn = axes[place.cluster, 0].T @ along
                self.solid(own[0][0], place.cluster, wall.placed(at, turn))
