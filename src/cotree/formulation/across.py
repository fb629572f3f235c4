"""Across variables of the first graph: prefix sums over the tree (paper, Eq. (2)).

Quantities of a cluster are vectors resolved in its basis; those of a branch, in the basis of its
parent. Accelerations contain minus gravity, so that weight needs no terminal equation of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from cotree.dag import vector
from cotree.formulation.circuits import Circuits, inwards
from cotree.formulation.frames import choose_frames, resolve_branch

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from cotree.dag.nodes import Node
    from cotree.dag.vector import Matrix, Vector
    from cotree.formulation.clusters import Branch, Clusters, Point
    from cotree.formulation.frames import Frames, Geometry
    from cotree.formulation.system import System


@dataclass(frozen=True)
class Motion:
    """Positions and velocities of the first graph.

    Attributes
    ----------
    system, clusters, frames : System, Clusters, Frames
        What moves, and the axes it is resolved in.
    geometry : tuple of Geometry
        Every moving branch, parents before children.
    omega : tuple of Vector
        Angular velocity of each cluster.
    """

    system: System
    clusters: Clusters
    frames: Frames
    geometry: tuple[Geometry, ...]
    omega: tuple[Vector, ...]

    def to(self, cluster: int) -> Geometry:
        """Give the branch that carries a cluster."""
        return self.geometry[cluster - 1]

    @cached_property
    def positions(self) -> Circuits:
        """Position circuits, from cluster origin to cluster origin."""
        return Circuits(self.clusters, self.frames, lambda branch: self.to(branch.child).offset)

    @cached_property
    def velocities(self) -> Circuits:
        """Velocity circuits, from cluster origin to cluster origin."""
        return Circuits(self.clusters, self.frames, self._branch_velocity)

    def _branch_velocity(self, branch: Branch) -> Vector:
        geometry = self.to(branch.child)
        result = vector.cross(self.omega[branch.parent], geometry.offset)
        for speed, shifting in zip(branch.speeds, geometry.shifting, strict=True):
            result = vector.add(result, vector.scale(speed.symbol, shifting))
        return result

    def arm(self, point: Point) -> Vector:
        """Give a point's position from its cluster's origin, in the cluster's basis."""
        return self.frames.resolved(point.cluster, point.local)

    def position(self, point: Point, ancestor: int = 0) -> Vector:
        """Form the vector from an ancestor's origin to a point, in the ancestor's basis."""
        arm = inwards(self.clusters, self.frames, self.arm(point), point.cluster, ancestor)
        zero = vector.zeros(self.system.dag)
        return vector.add(self.positions.between(ancestor, point.cluster, zero), arm)

    def velocity(self, point: Point, ancestor: int = 0) -> Vector:
        """Form a point's velocity less that of an ancestor's origin, in the ancestor's basis."""
        own = vector.cross(self.omega[point.cluster], self.arm(point))
        own = inwards(self.clusters, self.frames, own, point.cluster, ancestor)
        zero = vector.zeros(self.system.dag)
        return vector.add(self.velocities.between(ancestor, point.cluster, zero), own)


@dataclass(frozen=True)
class Accelerations:
    """Accelerations of the first graph, less gravity.

    Attributes
    ----------
    alpha : tuple of Vector
        Angular acceleration of each cluster.
    matrix : tuple of Matrix
        ``[alpha]x + [omega]x[omega]x`` of each cluster: times an arm, the acceleration across it.
    origin : tuple of Vector
        Acceleration of each cluster's origin, less gravity.
    across : tuple of Vector
        Of each moving branch, from the parent's origin to the child's, in the parent's basis.
    rates : tuple of Node
        The accelerations that they belong to.
    """

    alpha: tuple[Vector, ...]
    matrix: tuple[Matrix, ...]
    origin: tuple[Vector, ...]
    across: tuple[Vector, ...]
    rates: tuple[Node, ...]


def move(system: System, clusters: Clusters, own_axes: Collection[int]) -> Motion:
    """Form the geometry of the branches and the angular velocities of the clusters."""
    with system.dag.labelled("f-circuits, rotation"):
        frames = choose_frames(system, clusters, own_axes)
    geometry = []
    omega = [vector.zeros(system.dag)]
    for branch in clusters.branches[1:]:
        assert branch is not None
        with system.dag.labelled(f"f-circuits, geometry of {branch.edge}"):
            own = resolve_branch(system, frames, branch)
            geometry.append(own)
            total = vector.add(omega[branch.turn_parent], relative_spin(own))
            omega.append(frames.down(branch.child, total))
    return Motion(system, clusters, frames, tuple(geometry), tuple(omega))


def relative_spin(geometry: Geometry) -> Vector:
    """Form the angular velocity across a branch."""
    zero = vector.zeros(geometry.from_parent[0].dag)
    return weighted(zero, geometry.turning, [v.symbol for v in geometry.branch.speeds])


def weighted(zero: Vector, vectors: Sequence[Vector], factors: Sequence[Node]) -> Vector:
    """Sum vectors with factors."""
    total = zero
    for item, factor in zip(vectors, factors, strict=True):
        total = vector.add(total, vector.scale(factor, item))
    return total


def carrier_spin(motion: Motion, branch: Branch) -> Vector:
    """Give the angular velocity of a branch's carrier, in the basis of its parent."""
    if branch.carrier != branch.child:
        return motion.omega[branch.carrier]
    return motion.frames.up(branch.child, motion.omega[branch.child])


def accelerate(motion: Motion, rates: Sequence[Node]) -> Accelerations:
    """Form the accelerations of the clusters for given accelerations of the coordinates.

    Parameters
    ----------
    motion : Motion
        The first graph's positions and velocities.
    rates : sequence of Node
        Rates of the speeds, in their order.
    """
    system, frames = motion.system, motion.frames
    zero = vector.zeros(system.dag)
    alpha = [zero]
    matrix = [vector.angular_acceleration_matrix(alpha[0], alpha[0])]
    origin = [vector.neg(system.gravity)]
    steps = []
    for geometry in motion.geometry:
        branch = geometry.branch
        own = [rates[v.index] for v in branch.speeds]
        speeds = [v.symbol for v in branch.speeds]
        with system.dag.labelled(f"f-circuits, acceleration of {branch.edge}"):
            spin = carrier_spin(motion, branch)
            turn = vector.add(
                weighted(zero, geometry.turning, own), vector.cross(spin, relative_spin(geometry))
            )
            alpha.append(frames.down(branch.child, vector.add(alpha[branch.turn_parent], turn)))
            matrix.append(vector.angular_acceleration_matrix(motion.omega[branch.child], alpha[-1]))
            sliding = geometry.sliding
            across = vector.times(matrix[branch.parent], geometry.from_parent)
            across = vector.add(across, weighted(zero, sliding, own))
            coriolis = vector.cross(spin, weighted(zero, sliding, speeds))
            across = vector.add(across, vector.add(coriolis, coriolis))
            if not vector.is_zero(geometry.from_child):
                carried = vector.times(matrix[-1], frames.down(branch.child, geometry.from_child))
                across = vector.add(across, frames.up(branch.child, carried))
            steps.append(across)
            total = vector.add(origin[branch.parent], across)
            origin.append(frames.down(branch.child, total))
    return Accelerations(tuple(alpha), tuple(matrix), tuple(origin), tuple(steps), tuple(rates))
