"""Across variables: prefix sums over the tree (paper, Eq. (2)).

Vectors of a cluster are resolved in the cluster's basis, vectors of a branch in the basis of its
parent. Gravity is subtracted from accelerations, so that weight needs no terminal equation. A
sensitivity graph evaluates the same functions with dual numbers, and reads values that do not
depend on its seed from the first graph.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

from cotree.dag import vector
from cotree.formulation.frames import Frames, Geometry, resolve_branch

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.dag.vector import Matrix, Vector
    from cotree.formulation.clusters import Branch, Clusters, Point
    from cotree.formulation.system import System


@dataclass(frozen=True)
class Circuits:
    """Sums of an across variable along paths of the tree; each sum is computed once."""

    motion: Motion
    #: Function that returns the across variable of a branch, in the basis of its parent.
    across: Callable[[Branch], Vector]
    #: In a sensitivity graph: circuits of the first graph, from which unchanged values are read.
    known: Circuits | None = None
    _sums: dict[tuple[int, int], Vector] = field(default_factory=dict)

    def between(self, ancestor: int, cluster: int) -> Vector:
        """Return the sum between two cluster origins, in the basis of the ancestor ([1] eq. 2)."""
        clusters, frames = self.motion.clusters, self.motion.frames
        if self.known is not None and frames.is_kept(cluster):
            return self.known.between(ancestor, cluster)
        total = vector.zeros(self.motion.system.dag)
        for branch in clusters.path(cluster, ancestor):
            # Paths from one ancestor share inner parts: each sum adds one term to a known sum.
            key = (ancestor, branch.child)
            if key not in self._sums:
                # The sum is in the ancestor's basis; each term is in its parent's basis.
                step = inwards(clusters, frames, self.across(branch), branch.parent, ancestor)
                self._sums[key] = vector.add(total, step)
            total = self._sums[key]
        return total


def inwards(clusters: Clusters, frames: Frames, a: Vector, cluster: int, ancestor: int) -> Vector:
    """Transform a vector from a cluster's basis to an ancestor's basis."""
    while cluster != ancestor:
        # Rotate branch by branch; a cluster may share the basis of its parent.
        a = frames.up(cluster, a)
        cluster = clusters.to(cluster).parent
    return a


def outwards(clusters: Clusters, frames: Frames, a: Vector, ancestor: int, cluster: int) -> Vector:
    """Transform a vector from an ancestor's basis to a cluster's basis."""
    for branch in clusters.path(cluster, ancestor):
        a = frames.down(branch.child, a)
    return a


@dataclass(frozen=True)
class Motion:
    """Positions and velocities of all clusters."""

    #: The clusters, and the axes in which vectors are resolved.
    system: System
    clusters: Clusters
    frames: Frames
    geometry: tuple[Geometry, ...]  # geometry of every moving branch, parents before children
    omega: tuple[Vector, ...]  # angular velocity of each cluster, [rad/s]
    first: Motion | None = None  # in a sensitivity graph: motion of the first graph

    def to(self, cluster: int) -> Geometry:
        """Return the branch that leads to a cluster."""
        # Branch i - 1 leads to cluster i; cluster 0 is the ground.
        return self.geometry[cluster - 1]

    @cached_property
    def positions(self) -> Circuits:
        """Sums of the branches' vectors between cluster origins."""
        known = None if self.first is None else self.first.positions
        return Circuits(self, lambda branch: self.to(branch.child).offset, known)

    @cached_property
    def velocities(self) -> Circuits:
        """Sums of the branches' velocities between cluster origins."""
        known = None if self.first is None else self.first.velocities
        return Circuits(self, self._branch_velocity, known)

    def _branch_velocity(self, branch: Branch) -> Vector:
        geometry = self.to(branch.child)
        # The offset rotates with the parent; the motion space adds the relative motion.
        result = vector.cross(self.omega[branch.parent], geometry.offset)
        for speed, shifting in zip(branch.speeds, geometry.shifting, strict=True):
            result = vector.add(result, vector.scale(self.frames.seen(speed.symbol), shifting))
        return result

    def arm(self, point: Point) -> Vector:
        """Return the vector from a cluster's origin to a point, in the cluster's basis."""
        return self.frames.resolved(point.cluster, point.local)

    def position(self, point: Point, ancestor: int = 0) -> Vector:
        """Return the vector from an ancestor's origin to a point, in the ancestor's basis."""
        arm = inwards(self.clusters, self.frames, self.arm(point), point.cluster, ancestor)
        return vector.add(self.positions.between(ancestor, point.cluster), arm)

    def velocity(self, point: Point, ancestor: int = 0) -> Vector:
        """Return a point's velocity relative to an ancestor's origin, in the ancestor's basis."""
        own = vector.cross(self.omega[point.cluster], self.arm(point))
        own = inwards(self.clusters, self.frames, own, point.cluster, ancestor)
        return vector.add(self.velocities.between(ancestor, point.cluster), own)


@dataclass(frozen=True)
class Accelerations:
    """Accelerations of all clusters, with gravity subtracted."""

    alpha: tuple[Vector, ...]  # angular acceleration of each cluster, [rad/s^2]
    #: ``[alpha]x + [omega]x[omega]x`` of each cluster. Its product with a vector fixed in the
    #: cluster is the acceleration of the vector's end relative to its start.
    matrix: tuple[Matrix, ...]
    origin: tuple[Vector, ...]  # acceleration of each cluster's origin, minus gravity
    #: Relative acceleration of the origins along each moving branch, in the parent's basis.
    across: tuple[Vector, ...]
    rates: tuple[Node, ...]  # accelerations: the derivatives of the speeds


def move(system: System, clusters: Clusters, frames: Frames, first: Motion | None = None) -> Motion:
    """Compute branch geometry and cluster spins ([1] eq. 2); ``first`` supplies constant values."""
    geometry = []
    # The ground is first and does not rotate. Branches come after the branches that carry them, so
    # each prefix sum adds one term (Eq. (2)).
    omega = [vector.zeros(system.dag)]
    for branch in clusters.branches:
        if first is not None and frames.is_kept(branch.child):
            geometry.append(first.to(branch.child))
            omega.append(first.omega[branch.child])
            continue
        with system.dag.labelled(f"f-circuits, geometry of {branch.edge}"):
            own = resolve_branch(system, frames, branch)
            geometry.append(own)
            # Angular velocities add up along the rotation tree.
            total = vector.add(omega[branch.turn_parent], relative_spin(frames, own))
            omega.append(frames.down(branch.child, total))
    return Motion(system, clusters, frames, tuple(geometry), tuple(omega), first)


def relative_spin(frames: Frames, geometry: Geometry) -> Vector:
    """Return the angular velocity of a branch's child relative to its parent."""
    return _moving(frames, geometry, geometry.turning)


def _moving(frames: Frames, geometry: Geometry, directions: Sequence[Vector]) -> Vector:
    zero = vector.zeros(geometry.branch.anchor[0].dag)
    speeds = [frames.seen(v.symbol) for v in geometry.branch.speeds]
    return weighted(zero, directions, speeds)


def weighted(zero: Vector, vectors: Sequence[Vector], factors: Sequence[Node]) -> Vector:
    """Return the weighted sum of vectors, or ``zero`` if there are no vectors."""
    total = zero
    for item, factor in zip(vectors, factors, strict=True):
        total = vector.add(total, vector.scale(factor, item))
    return total


def carrier_spin(motion: Motion, branch: Branch) -> Vector:
    """Return the angular velocity of a branch's carrier, in the basis of the branch's parent."""
    if branch.carrier != branch.child:
        return motion.omega[branch.carrier]
    # If the carrier is the child, its angular velocity is in the child's basis.
    return motion.frames.up(branch.child, motion.omega[branch.child])


def accelerate(
    motion: Motion, rates: Sequence[Node], first: Accelerations | None = None
) -> Accelerations:
    """Compute the cluster accelerations from the time derivatives of the speeds.

    In a sensitivity graph, ``first`` contains the accelerations of the first graph, and ``rates``
    are held constant because their derivatives are the unknowns.
    """
    system, frames = motion.system, motion.frames
    zero = vector.zeros(system.dag)
    alpha = [zero]
    matrix = [vector.angular_acceleration_matrix(zero, zero)]
    # Giving the ground the acceleration -g includes weight in inertial forces (d'Alembert).
    origin = [vector.neg(frames.resolved(0, system.gravity))]
    steps = []
    for geometry in motion.geometry:
        branch = geometry.branch
        parent, child = branch.parent, branch.child
        if first is not None and frames.is_kept(child):
            alpha.append(first.alpha[child])
            matrix.append(first.matrix[child])
            steps.append(first.across[child - 1])
            # If the parent's sum is unchanged too, so is this sum.
            if origin[parent] == first.origin[parent]:
                origin.append(first.origin[child])
                continue
        with system.dag.labelled(f"f-circuits, acceleration of {branch.edge}"):
            # Otherwise the sum changes, but its last term is that of the first graph.
            if len(steps) < child:
                own = [rates[v.index] for v in branch.speeds]
                spin = carrier_spin(motion, branch)
                turn = _turn(frames, geometry, own, spin)
                total = vector.add(alpha[branch.turn_parent], turn)
                alpha.append(frames.down(child, total))
                matrix.append(vector.angular_acceleration_matrix(motion.omega[child], alpha[-1]))
                steps.append(_shift(frames, geometry, own, spin, matrix))
            origin.append(frames.down(child, vector.add(origin[parent], steps[-1])))
    return Accelerations(tuple(alpha), tuple(matrix), tuple(origin), tuple(steps), tuple(rates))


def _turn(frames: Frames, geometry: Geometry, rates: Sequence[Node], spin: Vector) -> Vector:
    zero = vector.zeros(geometry.branch.anchor[0].dag)
    # Axes of the motion space are constant in the carrier: their rate in space is spin x e.
    gyroscopic = vector.cross(spin, relative_spin(frames, geometry))
    return vector.add(weighted(zero, geometry.turning, rates), gyroscopic)


def _shift(
    frames: Frames,
    geometry: Geometry,
    rates: Sequence[Node],
    spin: Vector,
    matrix: Sequence[Matrix],
) -> Vector:
    branch = geometry.branch
    zero = vector.zeros(branch.anchor[0].dag)
    # Tangential and centripetal acceleration of the part of the arm that is fixed in the parent.
    total = vector.times(matrix[branch.parent], geometry.from_parent)
    total = vector.add(total, weighted(zero, geometry.sliding, rates))
    # Coriolis term 2 omega x v of translations along axes that rotate with the carrier.
    coriolis = vector.cross(spin, _moving(frames, geometry, geometry.sliding))
    total = vector.add(total, vector.add(coriolis, coriolis))
    # A joint that points inwards slides along axes of its child, in which this part of the arm is
    # fixed. The child's matrix is in the child's basis.
    if not vector.is_zero(geometry.from_child):
        outer = frames.down(branch.child, geometry.from_child)
        carried = vector.times(matrix[branch.child], outer)
        total = vector.add(total, frames.up(branch.child, carried))
    return total


@dataclass(frozen=True)
class View:
    """Across variables of a graph; some views have no accelerations."""

    motion: Motion  # positions and velocities of the graph
    accelerations: Accelerations | None = None
    first: View | None = None  # in a sensitivity graph: variables of the first graph

    @property
    def across(self) -> Accelerations:
        """Accelerations of the clusters."""
        assert self.accelerations is not None  # absent in views of positions and velocities
        return self.accelerations

    @cached_property
    def _accelerations(self) -> Circuits:
        known = None if self.first is None else self.first._accelerations
        return Circuits(self.motion, lambda branch: self.across.across[branch.child - 1], known)

    @cached_property
    def _rates(self) -> dict[Node, Node]:
        speeds = self.motion.system.speeds
        # Accelerations are zero for the right-hand side, and symbols for balances and outputs.
        return {v.acceleration: rate for v, rate in zip(speeds, self.across.rates, strict=True)}

    def _inwards(self, a: Vector, cluster: int, ancestor: int) -> Vector:
        return inwards(self.motion.clusters, self.motion.frames, a, cluster, ancestor)

    def scalar(self, node: Node) -> Node:
        """Return a field, coordinate, speed or acceleration in this view."""
        if self.accelerations is not None:
            # Replace the symbol of an acceleration by its value in this view.
            node = self._rates.get(node, node)
        return self.motion.frames.seen(node)

    def fixed(self, cluster: int, local: Vector, ancestor: int) -> Vector:
        """Transform a vector in cluster axes, which may depend on time, to an ancestor's basis."""
        return self._inwards(self.motion.frames.resolved(cluster, local), cluster, ancestor)

    def position(self, point: Point, ancestor: int) -> Vector:
        """Return the vector from an ancestor's origin to a point."""
        return self.motion.position(point, ancestor)

    def velocity(self, point: Point, ancestor: int) -> Vector:
        """Return a point's velocity relative to an ancestor's origin."""
        return self.motion.velocity(point, ancestor)

    def acceleration(self, point: Point, ancestor: int) -> Vector:
        """Return a point's acceleration relative to an ancestor's origin."""
        # Gravity is added only at the ground's origin, so sums from an ancestor exclude it.
        own = vector.times(self.across.matrix[point.cluster], self.motion.arm(point))
        own = self._inwards(own, point.cluster, ancestor)
        return vector.add(self._accelerations.between(ancestor, point.cluster), own)

    def omega(self, cluster: int, ancestor: int) -> Vector:
        """Return a cluster's angular velocity relative to an ancestor."""
        return self._inwards(self.motion.omega[cluster], cluster, ancestor)

    def alpha(self, cluster: int, ancestor: int) -> Vector:
        """Return a cluster's angular acceleration relative to an ancestor."""
        return self._inwards(self.across.alpha[cluster], cluster, ancestor)

    def formula(self, node: Node, arguments: Mapping[Node, Node]) -> Node:
        """Substitute this view's values for the arguments of a formula."""
        return self.motion.frames.formula(node, arguments)

    def settled(self, a: Vector, ancestor: int, cluster: int) -> Vector:
        """Transform a vector from an ancestor's basis to a cluster's basis."""
        # A pull is computed once in the ancestor's basis, and then transformed for both clusters.
        return outwards(self.motion.clusters, self.motion.frames, a, ancestor, cluster)
