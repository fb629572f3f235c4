"""Positions and axes of rigid clusters over a run, from the f-circuits of the first graph.

In: the motion of the first graph and coordinates over time. Out: positions and axes of every
cluster. Branch after branch is evaluated with arrays, in proportion to the size of the scene.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cotree.dag.evaluate import evaluate

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.dag.vector import Matrix, Vector
    from cotree.formulation.across import Motion
    from cotree.formulation.clusters import Point
    from cotree.watch.shapes import Array


@dataclass(frozen=True, eq=False)
class Poses:
    """Origins and axes of the clusters over time; number 0 is the ground.

    Attributes
    ----------
    positions : ndarray, shape (n_clusters, n_times, 3)
        Of the origins, [m].
    axes : ndarray, shape (n_clusters, n_times, 3, 3)
        From each cluster's axes to the ground's.
    """

    positions: Array
    axes: Array

    def of(self, cluster: int, local: Array) -> Array:
        """Give the position of a point of a cluster over time, shape (n_times, 3)."""
        found: Array = self.positions[cluster] + self.axes[cluster] @ local
        return found


@dataclass(frozen=True, eq=False)
class Place:
    """A node: a point of its cluster, and its axes in the cluster's.

    Attributes
    ----------
    cluster : int
        The cluster.
    local : ndarray, shape (3,)
        Position in the cluster, [m].
    turn : ndarray, shape (3, 3)
        From the node's axes to the cluster's.
    """

    cluster: int
    local: Array
    turn: Array


class MotionValues:
    """Values of nodes of the first graph over a run.

    Parameters
    ----------
    motion : Motion
        Of the first graph.
    p : ndarray, shape (n_parameters,)
        Parameters.
    times : ndarray, shape (n_times,), [s]
        When.
    coordinates : ndarray, shape (n_coordinates, n_times)
        The coordinates then.
    """

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
        """Evaluate nodes of parameters only, shape (n_nodes,)."""
        return np.array(evaluate(nodes, self._fixed), dtype=float)

    def place(self, point: Point) -> Place:
        """Evaluate a node's place in its cluster."""
        turn = np.eye(3) if point.turn is None else self.matrix(point.turn)
        return Place(point.cluster, self.numbers(point.local), turn)

    def matrix(self, a: Matrix) -> Array:
        """Evaluate a matrix of parameters only."""
        return np.array([self.numbers(row) for row in a])

    def over_time(self, a: Vector) -> Array:
        """Evaluate a vector of parameters and time, shape (n_times, 3)."""
        values = evaluate(a, self._moving, "array")
        return np.stack([self._over_time(value) for value in values], axis=-1)

    def _over_time(self, value: float | Array) -> Array:
        # Values of parameters only are one number for all times.
        return np.broadcast_to(np.asarray(value, dtype=float), (self.n,))

    def poses(self) -> Poses:
        """Follow the branches from the ground outwards."""
        motion = self.motion
        nodes: list[Node] = []
        for geometry in motion.geometry:
            child = geometry.branch.child
            # All nodes are evaluated at once, so that values they share are computed once.
            nodes += geometry.offset
            for matrix in (motion.frames.rotations[child].matrix, motion.frames.steps[child]):
                nodes += [entry for row in matrix or () for entry in row]
        with np.errstate(all="ignore"):  # what is not finite is seen by whoever draws it
            values = evaluate(nodes, self._moving, "array")
        # Taken in the order in which they were listed above.
        rows = iter(values)

        def taken(k: int) -> Array:
            return np.stack([self._over_time(next(rows)) for _ in range(k)], axis=-1)

        still = np.broadcast_to(np.eye(3), (self.n, 3, 3))
        # Bases are the axes in which a cluster's vectors are resolved.
        origins, bases, axes = [np.zeros((self.n, 3))], [still], [still]
        for geometry in motion.geometry:
            branch = geometry.branch
            # Across variables add along the branches (f-circuits): position of the parent and the
            # offset.
            basis = bases[branch.parent]
            origins.append(origins[branch.parent] + (basis @ taken(3)[:, :, None])[:, :, 0])
            own = taken(9).reshape(self.n, 3, 3)
            if motion.frames.steps[branch.child] is not None:
                basis = basis @ taken(9).reshape(self.n, 3, 3)
            bases.append(basis)
            axes.append(basis @ own)
        return Poses(np.stack(origins), np.stack(axes))
