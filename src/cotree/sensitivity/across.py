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
from cotree.dag.rotation import quaternion_turn
from cotree.formulation.across import carrier_spin, relative_spin, weighted
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
    sliding: tuple[Vector, ...]
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
        speeds = [v.symbol for v in branch.speeds]
        result = vector.add(result, weighted(self.zero, own.shifting, speeds))
        d_speeds = [self.seed.of(v) for v in speeds]
        return vector.add(result, weighted(self.zero, first.shifting, d_speeds))

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
    across: tuple[Vector | None, ...]


def move_tangent(motion: Motion, seed: Seed) -> MotionTangent:
    """Form positions and velocities of a sensitivity graph."""
    phi: list[Vector | None] = [None] * len(motion.omega)
    omega: list[Vector | None] = [None] * len(motion.omega)
    geometry: list[GeometryTangent | None] = [None] * len(motion.geometry)
    for first in motion.geometry:
        branch = first.branch
        reached = (phi[branch.parent], phi[branch.turn_parent])
        if reached == (None, None) and not _is_seeded(branch, seed):
            continue
        with motion.system.dag.labelled(f"f-circuits, derivative of {branch.edge}"):
            own = _branch_tangent(motion, seed, first, reached, omega[branch.turn_parent])
            geometry[branch.child - 1] = own
            phi[branch.child] = motion.frames.down(branch.child, own.phi)
            omega[branch.child] = motion.frames.down(branch.child, own.omega)
    return MotionTangent(motion, seed, tuple(phi), tuple(omega), tuple(geometry))


def _is_seeded(branch: Branch, seed: Seed) -> bool:
    """Whether anything of the branch itself depends on the seed."""
    symbols = [c.symbol for c in branch.coordinates] + [v.symbol for v in branch.speeds]
    if any(not seed.of(node).is_zero for node in (*symbols, *branch.slides)):
        return True
    fields = (branch.anchor, *branch.axes, *(branch.mount or ()))
    return not all(vector.is_zero(seed.vector(local)) for local in fields)


def _branch_tangent(
    motion: Motion,
    seed: Seed,
    first: Geometry,
    parents: tuple[Vector | None, Vector | None],
    omega_parent: Vector | None,
) -> GeometryTangent:
    """Differentiate a branch: its motion space, its offset, and what it adds to phi and omega.

    ``parents`` are phi of the parent and of the turn parent.
    """
    branch, frames = first.branch, motion.frames
    zero = vector.zeros(motion.system.dag)
    phi, omega = parents[1] or zero, omega_parent or zero
    # A turn about the axis leaves the axis itself alone: the parent's axes serve both carriers,
    # but not for a free rotation, whose axes are constant in the second node's.
    phi_child = vector.add(phi, _turn(motion, seed, first))
    is_childs = branch.quaternion is not None and branch.carrier == branch.child
    phi_axes = phi_child if is_childs else phi
    d_axes = [frames.resolved(branch.turn_parent, seed.vector(axis)) for axis in branch.axes]
    d_slides = [seed.of(length) for length in branch.slides]
    anchor = frames.resolved(branch.parent, seed.vector(branch.anchor))
    from_parent = vector.add(vector.cross(parents[0] or zero, first.from_parent), anchor)
    from_child, slide = zero, zero
    for axis, d_axis, length, d_length in zip(
        first.axes, d_axes, branch.slides, d_slides, strict=True
    ):
        d_reach = length * seed.of(branch.position) + d_length * branch.position
        slide = vector.add(slide, vector.scale(d_reach, axis))
        slide = vector.add(slide, vector.scale(length * branch.position, d_axis))
    if branch.sign > 0:
        from_parent = vector.add(from_parent, slide)
    else:
        from_child = vector.sub(vector.cross(phi, first.from_child), slide)
    turning, shifting, sliding = [], [], []
    for i, length in enumerate(branch.slides):
        d_own = vector.add(vector.cross(phi_axes, first.axes[i]), d_axes[i])
        d_along = vector.signed(branch.sign, d_own)
        along = vector.signed(branch.sign, first.axes[i])
        turning.append(d_along if branch.turns else zero)
        sliding.append(vector.add(vector.scale(length, d_along), vector.scale(d_slides[i], along)))
        moved = vector.cross(turning[-1], first.from_child)
        moved = vector.add(moved, vector.cross(first.turning[i], from_child))
        shifting.append(vector.add(moved, sliding[-1]))
    speeds = [v.symbol for v in branch.speeds]
    d_spin = vector.add(
        weighted(zero, turning, speeds),
        weighted(zero, first.turning, [seed.of(v) for v in speeds]),
    )
    return GeometryTangent(
        from_parent,
        from_child,
        tuple(turning),
        tuple(shifting),
        tuple(sliding),
        phi_child,
        vector.add(omega, d_spin),
    )


def _turn(motion: Motion, seed: Seed, first: Geometry) -> Vector:
    """Form what a branch itself adds to phi, in the basis of its parent."""
    branch, frames = first.branch, motion.frames
    zero = vector.zeros(motion.system.dag)
    if not branch.turns:
        return zero
    if branch.quaternion is None:
        d_axis = frames.resolved(branch.turn_parent, seed.vector(branch.axes[0]))
        own = vector.scale(seed.of(branch.position), first.turning[0])
        return vector.add(own, _tilt(first, d_axis))
    d = [seed.of(entry) for entry in branch.quaternion]
    own = zero
    if any(not entry.is_zero for entry in d):
        own = quaternion_turn(branch.quaternion, d, is_own=branch.sign < 0)
        own = vector.signed(branch.sign, own)
    if branch.mount is not None:
        own = vector.add(vector.times(branch.mount, own), _mounting(branch.mount, seed))
    return frames.resolved(branch.turn_parent, own)


def _mounting(mount: Matrix, seed: Seed) -> Vector:
    """Form the rotation vector of a change of constant axes: [phi]x = dT T^T."""
    spin = vector.matmul(seed.matrix(mount), vector.transpose(mount))
    return (spin[2][1], spin[0][2], spin[1][0])


def _tilt(first: Geometry, d_axis: Vector) -> Vector:
    """Form what a change of the axis itself adds to phi.

    From the derivative of the rotation vector theta e by its left Jacobian:
    sin(theta) e_p + (1 - cos(theta)) e x e_p.
    """
    if vector.is_zero(d_axis):
        return d_axis
    position = first.branch.position
    angle = position if first.branch.sign > 0 else -position
    sine, cosine = (position.dag.function(name, angle) for name in ("sin", "cos"))
    across = vector.cross(first.axes[0], d_axis)
    return vector.add(vector.scale(sine, d_axis), vector.scale(1.0 - cosine, across))


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
    steps: list[Vector | None] = [None] * len(motion.geometry)
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
            own_rates = [rates[v.index] for v in branch.speeds]
            d_alpha = _turn_tangent(moved, geometry, own, own_rates, alpha[branch.turn_parent])
            alpha[child] = motion.frames.down(child, d_alpha)
            matrix[child] = vector.angular_acceleration_tangent(
                motion.omega[child], moved.omega_of(child), alpha[child] or moved.zero
            )
            d_across = _shift_tangent(moved, first, geometry, own, own_rates, matrix)
            steps[child - 1] = d_across
            total = vector.add(origin[parent] or moved.zero, d_across)
            origin[child] = motion.frames.down(child, total)
    return AccelerationTangent(tuple(alpha), tuple(matrix), tuple(origin), tuple(steps))


def _carrier_tangent(moved: MotionTangent, branch: Branch) -> Vector:
    """Differentiate the angular velocity of a branch's carrier."""
    if branch.carrier != branch.child:
        return moved.omega_of(branch.carrier)
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
    speeds = [v.symbol for v in branch.speeds]
    d_speeds = [moved.seed.of(v) for v in speeds]
    zero = moved.zero
    d_relative = vector.add(
        weighted(zero, own.turning, speeds), weighted(zero, geometry.turning, d_speeds)
    )
    total = vector.add(alpha_parent or zero, weighted(zero, own.turning, rates))
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
    sliding, d_sliding = geometry.sliding, own.sliding
    total = vector.add(total, weighted(moved.zero, d_sliding, rates))
    speeds = [v.symbol for v in branch.speeds]
    slip = weighted(moved.zero, sliding, speeds)
    d_slip = vector.add(
        weighted(moved.zero, d_sliding, speeds),
        weighted(moved.zero, sliding, [moved.seed.of(v) for v in speeds]),
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
