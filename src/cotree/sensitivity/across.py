"""Across variables of a sensitivity graph: the same prefix sums, of differentiated variables.

Every vector here is the derivative of a vector of the first graph as an arrow in space, resolved
in the same basis. The rotational across variable is the parametric rotation vector phi, with
dR/dp = [phi]x R, so that a vector fixed in a cluster changes by phi x vector. Accelerations of the
coordinates are held fixed: their derivatives are the unknowns of the sensitivity equations.

A sensitivity graph visits only the clusters that its seed reaches; None stands for the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from cotree.dag import vector
from cotree.formulation.across import carrier_spin, relative_spin, sliding_directions, weighted
from cotree.formulation.circuits import Circuits, inwards

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.dag.nodes import Node
    from cotree.dag.vector import Matrix, Vector
    from cotree.formulation.across import Accelerations, Motion
    from cotree.formulation.clusters import Branch, Point
    from cotree.formulation.frames import Geometry
    from cotree.sensitivity.seed import Seed


@dataclass(frozen=True)
class GeometryTangent:
    """Derivative of a moving branch, in the basis of its parent; see ``Geometry``."""

    from_parent: Vector
    from_child: Vector
    turning: tuple[Vector, ...]
    shifting: tuple[Vector, ...]
    phi: Vector
    omega: Vector

    @property
    def offset(self) -> Vector:
        """Derivative of the vector from the parent's origin to the child's."""
        return vector.add(self.from_parent, self.from_child)


@dataclass(frozen=True)
class MotionTangent:
    """Positions and velocities of a sensitivity graph.

    Attributes
    ----------
    motion : Motion
        The first graph.
    seed : Seed
        What it is differentiated by.
    phi, omega : tuple of Vector or None
        Parametric rotation vector and derivative of the angular velocity of each cluster; None
        where the seed does not reach.
    geometry : tuple of GeometryTangent or None
        Of each moving branch.
    """

    motion: Motion
    seed: Seed
    phi: tuple[Vector | None, ...]
    omega: tuple[Vector | None, ...]
    geometry: tuple[GeometryTangent | None, ...]

    @cached_property
    def zero(self) -> Vector:
        """The zero vector."""
        return vector.zeros(self.motion.system.dag)

    def phi_of(self, cluster: int) -> Vector:
        """Give the parametric rotation vector of a cluster."""
        return self.phi[cluster] or self.zero

    def omega_of(self, cluster: int) -> Vector:
        """Give the derivative of a cluster's angular velocity."""
        return self.omega[cluster] or self.zero

    @cached_property
    def positions(self) -> Circuits:
        """Circuits of position derivatives."""
        return Circuits(self.motion.clusters, self.motion.frames, self._branch_position)

    @cached_property
    def velocities(self) -> Circuits:
        """Circuits of velocity derivatives."""
        return Circuits(self.motion.clusters, self.motion.frames, self._branch_velocity)

    def _branch_position(self, branch: Branch) -> Vector:
        own = self.geometry[branch.child - 1]
        return self.zero if own is None else own.offset

    def _branch_velocity(self, branch: Branch) -> Vector:
        own, first = self.geometry[branch.child - 1], self.motion.to(branch.child)
        result = vector.cross(self.omega_of(branch.parent), first.offset)
        if own is None:
            return result
        result = vector.add(result, vector.cross(self.motion.omega[branch.parent], own.offset))
        speeds = [c.speed for c in branch.coordinates]
        result = vector.add(result, weighted(own.shifting, speeds))
        return vector.add(result, weighted(first.shifting, [self.seed.of(v) for v in speeds]))

    def arm(self, point: Point) -> Vector:
        """Differentiate a point's position from its cluster's origin."""
        return self.carried(point.cluster, point.local)

    def carried(self, cluster: int, local: Vector) -> Vector:
        """Differentiate a vector field fixed in a cluster, in the cluster's basis."""
        frames = self.motion.frames
        d_local = self.seed.vector(local)
        turned = self.zero
        if self.phi[cluster] is not None:
            turned = vector.cross(self.phi_of(cluster), frames.resolved(cluster, local))
        if vector.is_zero(d_local):
            return turned
        return vector.add(turned, frames.resolved(cluster, d_local))

    def position(self, point: Point, ancestor: int = 0) -> Vector:
        """Differentiate the vector from an ancestor's origin to a point."""
        motion = self.motion
        arm = inwards(motion.clusters, motion.frames, self.arm(point), point.cluster, ancestor)
        return vector.add(self.positions.between(ancestor, point.cluster, self.zero), arm)

    def velocity(self, point: Point, ancestor: int = 0) -> Vector:
        """Differentiate a point's velocity less that of an ancestor's origin."""
        motion, cluster = self.motion, point.cluster
        own = vector.add(
            vector.cross(self.omega_of(cluster), motion.arm(point)),
            vector.cross(motion.omega[cluster], self.arm(point)),
        )
        own = inwards(motion.clusters, motion.frames, own, cluster, ancestor)
        return vector.add(self.velocities.between(ancestor, cluster, self.zero), own)


@dataclass(frozen=True)
class AccelerationTangent:
    """Derivatives of the accelerations of the clusters; None where the seed does not reach."""

    alpha: tuple[Vector | None, ...]
    matrix: tuple[Matrix | None, ...]
    origin: tuple[Vector | None, ...]


def move_tangent(motion: Motion, seed: Seed) -> MotionTangent:
    """Form positions and velocities of a sensitivity graph."""
    phi: list[Vector | None] = [None] * len(motion.omega)
    omega: list[Vector | None] = [None] * len(motion.omega)
    geometry: list[GeometryTangent | None] = [None] * len(motion.geometry)
    for first in motion.geometry:
        branch = first.branch
        if phi[branch.parent] is None and not _is_seeded(branch, seed):
            continue
        with motion.system.dag.labelled(f"f-circuits, derivative of {branch.edge}"):
            own = _branch_tangent(motion, seed, first, phi[branch.parent], omega[branch.parent])
            geometry[branch.child - 1] = own
            phi[branch.child] = motion.frames.down(branch.child, own.phi)
            omega[branch.child] = motion.frames.down(branch.child, own.omega)
    return MotionTangent(motion, seed, tuple(phi), tuple(omega), tuple(geometry))


def _is_seeded(branch: Branch, seed: Seed) -> bool:
    """Whether anything of the branch itself depends on the seed."""
    symbols = [s for c in branch.coordinates for s in (c.position, c.speed)]
    if any(not seed.of(symbol).is_zero for symbol in symbols):
        return True
    return not all(vector.is_zero(seed.vector(local)) for local in (branch.anchor, *branch.axes))


def _branch_tangent(
    motion: Motion,
    seed: Seed,
    first: Geometry,
    phi_parent: Vector | None,
    omega_parent: Vector | None,
) -> GeometryTangent:
    """Differentiate a branch: its motion space, its offset, and what it adds to phi and omega."""
    branch, frames = first.branch, motion.frames
    zero = vector.zeros(motion.system.dag)
    phi, omega = phi_parent or zero, omega_parent or zero
    # A turn about the axis leaves the axis itself alone: the parent's axes serve both carriers.
    d_axes = [frames.resolved(branch.parent, seed.vector(axis)) for axis in branch.axes]
    positions = [c.position for c in branch.coordinates]
    d_positions = [seed.of(position) for position in positions]
    d_own = [
        vector.add(vector.cross(phi, axis), d_axis)
        for axis, d_axis in zip(first.axes, d_axes, strict=True)
    ]
    phi_child = phi
    turning = []
    for i, coordinate in enumerate(branch.coordinates):
        rotates = coordinate.freedom.rotates
        turning.append(vector.signed(branch.sign, d_own[i]) if rotates else zero)
        if rotates:
            phi_child = vector.add(phi_child, vector.scale(d_positions[i], first.turning[i]))
            phi_child = vector.add(phi_child, _tilt(first, i, d_axes[i]))
    phi_carrier = phi if branch.sign > 0 else phi_child
    slide = _slide_tangent(first, positions, d_positions, d_axes, zero)
    anchor = frames.resolved(branch.parent, seed.vector(branch.anchor))
    from_parent = vector.add(vector.cross(phi, first.from_parent), anchor)
    from_child = zero
    if branch.sign > 0:
        from_parent = vector.add(from_parent, slide)
    else:
        from_child = vector.sub(vector.cross(phi_carrier, first.from_child), slide)
    shifting = []
    for i, coordinate in enumerate(branch.coordinates):
        if coordinate.freedom.rotates:
            moved = vector.cross(turning[i], first.from_child)
            moved = vector.add(moved, vector.cross(first.turning[i], from_child))
        else:
            d_axis = vector.add(vector.cross(phi_carrier, first.axes[i]), d_axes[i])
            moved = vector.signed(branch.sign, d_axis)
        shifting.append(moved)
    speeds = [c.speed for c in branch.coordinates]
    d_spin = vector.add(
        weighted(turning, speeds), weighted(first.turning, [seed.of(v) for v in speeds])
    )
    return GeometryTangent(
        from_parent,
        from_child,
        tuple(turning),
        tuple(shifting),
        phi_child,
        vector.add(omega, d_spin),
    )


def _tilt(first: Geometry, i: int, d_axis: Vector) -> Vector:
    """Form what a change of the axis itself adds to phi.

    From the derivative of the rotation vector theta e by its left Jacobian:
    sin(theta) e_p + (1 - cos(theta)) e x e_p.
    """
    if vector.is_zero(d_axis):
        return d_axis
    position = first.branch.coordinates[i].position
    angle = position if first.branch.sign > 0 else -position
    sine, cosine = (position.dag.function(name, angle) for name in ("sin", "cos"))
    across = vector.cross(first.axes[i], d_axis)
    return vector.add(vector.scale(sine, d_axis), vector.scale(1.0 - cosine, across))


def _slide_tangent(
    first: Geometry,
    positions: Sequence[Node],
    d_positions: Sequence[Node],
    d_axes: Sequence[Vector],
    zero: Vector,
) -> Vector:
    """Differentiate the translation along the branch's axes, as its carrier sees it."""
    total = zero
    for i, coordinate in enumerate(first.branch.coordinates):
        if not coordinate.freedom.rotates:
            total = vector.add(total, vector.scale(d_positions[i], first.axes[i]))
            total = vector.add(total, vector.scale(positions[i], d_axes[i]))
    return total


def accelerate_tangent(
    moved: MotionTangent, first: Accelerations, rates: Sequence[Node]
) -> AccelerationTangent:
    """Form the accelerations of a sensitivity graph, those of the coordinates held fixed.

    Parameters
    ----------
    moved : MotionTangent
        Its positions and velocities.
    first : Accelerations
        Accelerations of the first graph.
    rates : sequence of Node
        Accelerations of the coordinates, in their order.
    """
    motion, seed = moved.motion, moved.seed
    system = motion.system
    n = len(motion.omega)
    alpha: list[Vector | None] = [None] * n
    matrix: list[Matrix | None] = [None] * n
    origin: list[Vector | None] = [None] * n
    gravity = seed.vector(system.gravity)
    if not vector.is_zero(gravity):
        origin[0] = vector.neg(gravity)
    for geometry in motion.geometry:
        branch, own = geometry.branch, moved.geometry[geometry.branch.child - 1]
        parent, child = branch.parent, branch.child
        if own is None:
            if origin[parent] is not None:
                origin[child] = motion.frames.down(child, origin[parent] or moved.zero)
            continue
        with system.dag.labelled(f"f-circuits, derivative of {branch.edge}"):
            own_rates = [rates[c.index] for c in branch.coordinates]
            d_alpha = _turn_tangent(moved, geometry, own, own_rates, alpha[parent])
            alpha[child] = motion.frames.down(child, d_alpha)
            matrix[child] = vector.angular_acceleration_tangent(
                motion.omega[child], moved.omega_of(child), alpha[child] or moved.zero
            )
            d_across = _shift_tangent(moved, first, geometry, own, own_rates, matrix)
            total = vector.add(origin[parent] or moved.zero, d_across)
            origin[child] = motion.frames.down(child, total)
    return AccelerationTangent(tuple(alpha), tuple(matrix), tuple(origin))


def _carrier_tangent(moved: MotionTangent, branch: Branch) -> Vector:
    """Differentiate the angular velocity of a branch's carrier."""
    if branch.sign > 0:
        return moved.omega_of(branch.parent)
    return moved.motion.frames.up(branch.child, moved.omega_of(branch.child))


def _turn_tangent(
    moved: MotionTangent,
    geometry: Geometry,
    own: GeometryTangent,
    rates: Sequence[Node],
    alpha_parent: Vector | None,
) -> Vector:
    """Differentiate the angular acceleration of a branch's child."""
    motion, branch = moved.motion, geometry.branch
    speeds = [c.speed for c in branch.coordinates]
    d_speeds = [moved.seed.of(v) for v in speeds]
    d_relative = vector.add(weighted(own.turning, speeds), weighted(geometry.turning, d_speeds))
    total = vector.add(alpha_parent or moved.zero, weighted(own.turning, rates))
    total = vector.add(
        total, vector.cross(_carrier_tangent(moved, branch), relative_spin(geometry))
    )
    return vector.add(total, vector.cross(carrier_spin(motion, branch), d_relative))


def _shift_tangent(
    moved: MotionTangent,
    first: Accelerations,
    geometry: Geometry,
    own: GeometryTangent,
    rates: Sequence[Node],
    d_matrix: Sequence[Matrix | None],
) -> Vector:
    """Differentiate the acceleration of a branch's child origin against its parent's."""
    motion, branch, frames = moved.motion, geometry.branch, moved.motion.frames
    parent, child = branch.parent, branch.child
    total = vector.times(first.matrix[parent], own.from_parent)
    d_parent = d_matrix[parent]
    if d_parent is not None:
        total = vector.add(total, vector.times(d_parent, geometry.from_parent))
    sliding = sliding_directions(geometry)
    d_sliding = tuple(
        moved.zero if coordinate.freedom.rotates else shifting
        for coordinate, shifting in zip(branch.coordinates, own.shifting, strict=True)
    )
    total = vector.add(total, weighted(d_sliding, rates))
    speeds = [c.speed for c in branch.coordinates]
    slip = weighted(sliding, speeds)
    d_slip = vector.add(
        weighted(d_sliding, speeds), weighted(sliding, [moved.seed.of(v) for v in speeds])
    )
    coriolis = vector.add(
        vector.cross(_carrier_tangent(moved, branch), slip),
        vector.cross(carrier_spin(motion, branch), d_slip),
    )
    total = vector.add(total, vector.add(coriolis, coriolis))
    if not vector.is_zero(geometry.from_child):
        d_child = d_matrix[child]
        assert d_child is not None  # formed just before, since the branch is reached
        carried = vector.add(
            vector.times(d_child, frames.down(child, geometry.from_child)),
            vector.times(first.matrix[child], frames.down(child, own.from_child)),
        )
        total = vector.add(total, frames.up(child, carried))
    return total
