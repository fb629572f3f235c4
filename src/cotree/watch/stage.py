"""Preparation of a drawing: view directions, sizes, and poses of all clusters over time."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cotree.components import Role
from cotree.dag.evaluate import evaluate

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.dag.vector import Matrix, Vector
    from cotree.formulation.across import Motion
    from cotree.formulation.clusters import Point
    from cotree.formulation.fields import BoundEdge
    from cotree.formulation.first_graph import FirstGraph
    from cotree.watch.shapes import Array


#: Azimuth and elevation of the view of a spatial scene, [deg].
VIEW = (-55.0, 22.0)

_SHOWING = ("prismatic", "cylindrical", "screw", "rolling_disc", "rolling_ellipsoid")
# Width of bars relative to the mechanism and to their length, and minimum relative width.
_OF_SIZE, _OF_ARM, _LEAST = 0.021, 0.14, 0.002
# Arms to a centre of mass are thin if shorter than this fraction of the longest arm.
_SPUR = 0.75


@dataclass(frozen=True, eq=False)
class Stage:
    """Poses, directions and sizes for drawing."""

    poses: Poses  # poses of the clusters
    places: Mapping[str, Place]  # positions of the nodes in their clusters
    #: Vertical axis (upwards), and direction to the viewer.
    up: Array
    towards: Array
    is_flat: bool  # whether everything moves in a plane
    #: Size of the mechanism, and half the width of its bars, [m].
    size: float
    thickness: float
    body: tuple[int, ...]  # index of each cluster among those with nodes
    shown: frozenset[int]  # clusters that have a block or a disc for a joint or a constraint
    reach: Mapping[int, float]  # longest arm of each cluster that has arms, [m]
    spurs: frozenset[str]  # names of arms that only lead to a centre of mass


def set_stage(first: FirstGraph, values: MotionValues, view: tuple[float, float] | None) -> Stage:
    """Choose view directions and sizes; ``view`` is azimuth and elevation, [deg]."""
    system = first.system
    poses = values.poses()
    points = first.motion.clusters.points
    places = {name: values.place(point) for name, point in points.items()}
    is_flat = bool(system.plane) and view is None
    up = _up(values.numbers(system.gravity), system.plane)
    towards = _plane_side(system.plane, up) if is_flat else _direction(up, view or VIEW)
    arms = _arms(first, places)
    size = _size(poses, places)
    # Arms without length are rotations and are excluded from the median length.
    lengths = [length for length in arms.values() if length > 1e-9 * size]
    thickness = _OF_SIZE * size
    if lengths:
        thickness = max(min(thickness, _OF_ARM * float(np.median(lengths))), _LEAST * size)
    edges = system.edges
    # cluster of each edge's second node
    held = {edge.name: places[edge.second].cluster for edge in edges.values()}
    reach: dict[int, float] = {}
    for name, length in arms.items():
        if length > 1e-9 * size:
            reach[held[name]] = max(reach.get(held[name], 0.0), length)
    shown = sorted({place.cluster for place in places.values()} - {0})
    body = [0] * len(poses.positions)
    for i, cluster in enumerate(shown):
        body[cluster] = i
    return Stage(
        poses,
        places,
        up,
        towards,
        is_flat,
        size,
        thickness,
        tuple(body),
        frozenset(held[e.name] for e in edges.values() if _shows(e)),
        reach,
        _spurs(first, places, arms, reach),
    )


def _shows(edge: BoundEdge) -> bool:
    """Return whether the shape of an edge represents its second body."""
    if edge.component.role is Role.TOUCH:
        return bool({"size", "semiaxes"} & edge.vectors.keys()) or "radius" in edge.scalars
    return edge.component.name in _SHOWING


def _up(gravity: Array, plane: str) -> Array:
    """Return the coordinate axis opposite to gravity; without gravity, z, or y in an xy plane."""
    allowed = [i for i in range(3) if "xyz"[i] != plane]
    i = max(allowed, key=lambda i: abs(float(gravity[i])))
    if gravity[i] == 0.0:
        i = 1 if plane == "z" else 2
    return np.asarray(np.eye(3)[i] * (-1.0 if gravity[i] > 0.0 else 1.0))


def _plane_side(plane: str, up: Array) -> Array:
    """Return a plane's normal to the viewer that makes its other axis point to the right."""
    normal: Array = np.eye(3)["xyz".index(plane)]
    right = np.cross(up, normal)
    return normal if right.sum() > 0.0 else -normal


def _direction(up: Array, view: tuple[float, float]) -> Array:
    """Return the view direction from azimuth and elevation, [deg]; ``up`` points upwards."""
    azimuth, elevation = np.deg2rad(view)
    i = int(np.argmax(np.abs(up)))
    ahead, left = np.eye(3)[(i + 1) % 3], np.cross(up, np.eye(3)[(i + 1) % 3])
    level = np.cos(azimuth) * ahead + np.sin(azimuth) * left
    return np.asarray(np.cos(elevation) * level + np.sin(elevation) * up)


def _arms(first: FirstGraph, places: Mapping[str, Place]) -> dict[str, float]:
    """Return the lengths of arms within a cluster, [m], by name."""
    return {
        edge.name: float(np.linalg.norm(places[edge.second].local - places[edge.first].local))
        for edge in first.system.edges.values()
        if edge.component.role is Role.ARM
        and places[edge.first].cluster == places[edge.second].cluster
    }


def _size(poses: Poses, places: Mapping[str, Place]) -> float:
    """Return the largest extent of the nodes at any time, [m], or one if all nodes coincide."""
    paths = np.stack([poses.of(place.cluster, place.local) for place in places.values()])
    moving = np.array([place.cluster != 0 for place in places.values()])
    own = float(np.linalg.norm(np.ptp(paths, axis=0), axis=1).max())
    if moving.any():
        alone = float(np.linalg.norm(np.ptp(paths[moving], axis=0), axis=1).max())
        # The ground is ignored if the mechanism is far from it.
        own = alone if own > 8.0 * alone > 0.0 else own
    return own or 1.0


def _spurs(
    first: FirstGraph,
    places: Mapping[str, Place],
    arms: Mapping[str, float],
    reach: Mapping[int, float],
) -> frozenset[str]:
    """Return the names of short arms that lead only to a body's centre of mass."""
    edges = first.system.edges
    uses = Counter(
        name
        for edge in edges.values()
        if edge.component.role not in (Role.BODY, Role.FORCE, Role.TORQUE)
        for name in (edge.first, edge.second)
    )
    # Network edges may also act on nodes.
    uses.update(n for edge in first.scene.edges.values() for e in edge.ports for n in e.acts_on)
    return frozenset(
        name
        for name, length in arms.items()
        if uses[edges[name].second] == 1
        and length < _SPUR * reach.get(places[edges[name].second].cluster, 0.0)
    )


@dataclass(frozen=True, eq=False)
class Poses:
    """Origins and axes of the clusters over time; cluster 0 is the ground."""

    positions: Array  # positions of the origins, [m]
    axes: Array  # rotations from cluster axes to ground axes

    def of(self, cluster: int, local: Array) -> Array:
        """Return the position of a point of a cluster over time, shape (n_times, 3)."""
        return np.asarray(self.positions[cluster] + self.axes[cluster] @ local)


@dataclass(frozen=True, eq=False)
class Place:
    """Position and orientation of a node in its cluster."""

    cluster: int
    local: Array  # position in cluster axes, [m]
    turn: Array  # rotation from node axes to cluster axes


class MotionValues:
    """Values of nodes at ``times``, [s]; ``coordinates`` have shape (n_coordinates, n_times)."""

    def __init__(self, motion: Motion, p: Array, times: Array, coordinates: Array) -> None:
        system, dag = motion.system, motion.system.dag
        self.motion, self.n = motion, len(times)
        self._fixed: dict[Node, float | Array] = {
            dag.symbol("p", i): float(value) for i, value in enumerate(p)
        }
        self._moving: Mapping[Node, float | Array] = {
            **self._fixed,
            dag.symbol("t", 0): times,
            **{c.symbol: row for c, row in zip(system.coordinates, coordinates, strict=True)},
        }

    def numbers(self, nodes: Sequence[Node]) -> Array:
        """Evaluate nodes that depend only on parameters, shape (n_nodes,)."""
        return np.array(evaluate(nodes, self._fixed), dtype=float)

    def place(self, point: Point) -> Place:
        """Evaluate the position of a node in its cluster."""
        turn = np.eye(3) if point.turn is None else self.matrix(point.turn)
        return Place(point.cluster, self.numbers(point.local), turn)

    def matrix(self, a: Matrix) -> Array:
        """Evaluate a matrix that depends only on parameters."""
        return np.array([self.numbers(row) for row in a])

    def over_time(self, a: Vector) -> Array:
        """Evaluate a vector that depends on parameters and time, shape (n_times, 3)."""
        values = evaluate(a, self._moving, "array")
        return np.stack([self._over_time(value) for value in values], axis=-1)

    def _over_time(self, value: float | Array) -> Array:
        # A value that depends only on parameters is one number for all times.
        return np.broadcast_to(np.asarray(value, dtype=float), (self.n,))

    def poses(self) -> Poses:
        """Compute the poses of the clusters along the branches, from the ground outwards."""
        motion = self.motion
        nodes: list[Node] = []
        for geometry in motion.geometry:
            child = geometry.branch.child
            # Evaluate all nodes together, so that shared values are computed once.
            nodes += geometry.offset
            for matrix in (motion.frames.rotations[child].matrix, motion.frames.steps[child]):
                nodes += [entry for row in matrix or () for entry in row]
        with np.errstate(all="ignore"):  # values may be infinite or nan
            values = evaluate(nodes, self._moving, "array")
        # Values are in the order of `nodes`.
        rows = iter(values)

        def next_values(k: int) -> Array:
            return np.stack([self._over_time(next(rows)) for _ in range(k)], axis=-1)

        still = np.broadcast_to(np.eye(3), (self.n, 3, 3))
        # Vectors of a cluster are resolved in its basis.
        origins, bases, axes = [np.zeros((self.n, 3))], [still], [still]
        for geometry in motion.geometry:
            branch = geometry.branch
            # Across variables add up along branches (f-circuits): parent position plus offset.
            basis = bases[branch.parent]
            origins.append(origins[branch.parent] + (basis @ next_values(3)[:, :, None])[:, :, 0])
            own = next_values(9).reshape(self.n, 3, 3)
            if motion.frames.steps[branch.child] is not None:
                basis = basis @ next_values(9).reshape(self.n, 3, 3)
            bases.append(basis)
            axes.append(basis @ own)
        return Poses(np.stack(origins), np.stack(axes))
