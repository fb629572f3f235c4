"""Contact measures of a blade, of a rolling disc, and of bodies that may touch."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from math import hypot, sqrt
from typing import TYPE_CHECKING, Any, Protocol

from cotree.dag import vector
from cotree.dag.dual import function
from cotree.formulation.across import View, weighted
from cotree.formulation.fields import BoundEdge, plane_axes
from cotree.formulation.measures import (
    AxisLength,
    Carried,
    Composite,
    Ends,
    Pull,
    carried_by,
    chord_ends,
    pull_in_place,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.components.terminal import Touch
    from cotree.dag.nodes import Dag, Node
    from cotree.dag.vector import Vector
    from cotree.formulation.across import Motion
    from cotree.formulation.measures import Facing


def _against_first(ends: Ends, view: View) -> tuple[Any, Any]:
    cluster = ends.first.cluster
    return view.omega(cluster, ends.ancestor), view.alpha(cluster, ends.ancestor)


@dataclass(frozen=True)
class Slip:
    """Velocity of the second node relative to the first body, along an axis of the second node."""

    ends: Ends
    axis: Carried

    def value(self, view: View) -> Any:
        """Return None, since a slip has no coordinate."""
        return None

    def _velocity(self, view: View) -> Any:
        omega, _ = _against_first(self.ends, view)
        # Rate of r in space, minus the part due to the rotation of the first body.
        return vector.sub(self.ends.closing(view), vector.cross(omega, self.ends.reach(view)))

    def rate(self, view: View) -> Any:
        """Return e.(r' - omega x r) for the axis e and the vector r between the nodes."""
        return vector.dot(self.axis.value(view), self._velocity(view))

    def acceleration(self, view: View) -> Any:
        """Return the time derivative of the rate."""
        omega, alpha = _against_first(self.ends, view)
        carried = vector.add(
            vector.cross(alpha, self.ends.reach(view)), vector.cross(omega, self.ends.closing(view))
        )
        # Product rule for e.(r' - omega x r), with omega' = alpha; the term for e' is added below.
        own = vector.sub(self.ends.opening(view), carried)
        return vector.dot(self.axis.value(view), own) + vector.dot(
            self.axis.rate(view), self._velocity(view)
        )

    def pull(self, view: View) -> Pull:
        """Return a unit force along the axis, and its reaction."""
        return pull_in_place(view, self.ends, self.axis)


@dataclass(frozen=True)
class Nearest:
    """The point of a box, disc or cylinder that is nearest to a ball's centre."""

    axes: Sequence[Carried]
    #: Coordinates along the axes from the point to the second node, as functions of those from the
    #: ball's centre.
    coordinates: Sequence[Composite]

    def _opposite(self, vectors: list[Any], factors: list[Any]) -> Any:
        zero = vector.zeros(self.coordinates[0].time.dag)
        return vector.neg(weighted(zero, vectors, factors))

    def depth(self, view: View, facing: Facing) -> Any:
        """Return the depth of the point below the second node, along the normal."""
        return -vector.dot(facing.value(view), self.place(view, facing))

    def place(self, view: View, facing: Facing) -> Any:
        """Return the vector from the second node to the point."""
        axes = [axis.value(view) for axis in self.axes]
        return self._opposite(axes, [part.value(view) for part in self.coordinates])

    def place_rate(self, view: View, facing: Facing) -> Any:
        """Return the time derivative of ``place``; the point moves over the body."""
        axes = [form(view) for axis in self.axes for form in (axis.rate, axis.value)]
        parts = [form(view) for part in self.coordinates for form in (part.value, part.rate)]
        return self._opposite(axes, parts)


@dataclass(frozen=True)
class Centres:
    """The direction from a ball's centre to the other ball's, or to the nearest point of a body."""

    ends: Ends
    edge: str  # for messages
    surface: Surface

    def _polar(self, view: View) -> Any:
        origin = f"distance of the centres of edge '{self.edge}', which must lie apart"
        reach = self.ends.reach(view)
        if isinstance(self.surface, Nearest):
            reach = vector.add(reach, self.surface.place(view, self))
        return vector.polar(reach, origin)

    def value(self, view: View) -> Any:
        """Return the unit vector."""
        return self._polar(view)[1]

    def rate(self, view: View) -> Any:
        """Return the part of the rate perpendicular to the direction, divided by the distance."""
        length, along = self._polar(view)
        closing = self.ends.closing(view)
        if isinstance(self.surface, Nearest):
            closing = vector.add(closing, self.surface.place_rate(view, self))
        across = vector.sub(closing, vector.scale(vector.dot(along, closing), along))
        return vector.scale(1.0 / length, across)


@dataclass(frozen=True)
class Tangent:
    """The part of an axis, constant in the ancestor, that is perpendicular to the normal."""

    facing: Facing
    axis: Vector

    def value(self, view: View) -> Any:
        """Return e - (n.e) n, the tangential part of the axis e, with the normal n."""
        n = self.facing.value(view)
        return vector.sub(self.axis, vector.scale(vector.dot(n, self.axis), n))

    def rate(self, view: View) -> Any:
        """Return the time derivative for a constant axis."""
        n, n_rate = self.facing.value(view), self.facing.rate(view)
        turned = vector.add(
            vector.scale(vector.dot(n_rate, self.axis), n),
            vector.scale(vector.dot(n, self.axis), n_rate),
        )
        return vector.neg(turned)


@dataclass(frozen=True)
class Across:
    """The direction perpendicular to the normal and to an axis of the ancestor."""

    facing: Facing
    axis: Vector

    def value(self, view: View) -> Any:
        """Return n x e, which is perpendicular to the normal n and the axis e."""
        return vector.cross(self.facing.value(view), self.axis)

    def rate(self, view: View) -> Any:
        """Return the time derivative, n' x e."""
        return vector.cross(self.facing.rate(view), self.axis)


@dataclass(frozen=True)
class Tilted:
    """An axis of the ancestor after the shortest rotation from ``up`` to the normal.

    Axis and ``up`` are perpendicular unit vectors. No such rotation exists if the normal is -up.
    """

    facing: Facing
    axis: Vector
    up: Vector

    def _parts(self, view: View) -> tuple[Any, Any, Any]:
        """Return (n.e)/(1 + n.up), 1 + n.up, and n + up for the normal n and the axis e."""
        n = self.facing.value(view)
        between = vector.add(n, self.up)
        # For unit vectors this is 1 + n.up, without the rounding error of a sum near zero.
        height = 0.5 * vector.dot(between, between)
        return vector.dot(n, self.axis) / height, height, between

    def value(self, view: View) -> Any:
        """Return the rotated axis, e - (n.e)/(1 + n.up) (n + up)."""
        share, _, between = self._parts(view)
        return vector.sub(self.axis, vector.scale(share, between))

    def rate(self, view: View) -> Any:
        """Return the time derivative for constant axis and ``up``."""
        share, height, between = self._parts(view)
        n_rate = self.facing.rate(view)
        change = (vector.dot(n_rate, self.axis) - share * vector.dot(n_rate, self.up)) / height
        return vector.neg(vector.add(vector.scale(change, between), vector.scale(share, n_rate)))


def _skew() -> tuple[tuple[float, float, float], ...]:
    """Return perpendicular unit vectors, right-handed; the last one is ``up``.

    Its components are irrational: no scene that is written in numbers has the opposite normal.
    """
    x, y, z = sqrt(2 / 12), sqrt(3 / 12), sqrt(7 / 12)
    level = hypot(x, y)
    return (y / level, -x / level, 0.0), (z * x / level, z * y / level, -level), (x, y, z)


class Surface(Protocol):
    """The shape of the second body, and its lowest point."""

    def depth(self, view: View, facing: Facing) -> Any:
        """Return the depth of the lowest point below the second node."""

    def place(self, view: View, facing: Facing) -> Any:
        """Return the vector from the second node to the lowest point."""

    def place_rate(self, view: View, facing: Facing) -> Any:
        """Return the time derivative of ``place``; the lowest point moves over the body."""


@dataclass(frozen=True)
class Ball:
    """A sphere about the second node, or a point if the radius is zero."""

    radius: Node

    def depth(self, view: View, facing: Facing) -> Any:
        """Return the radius."""
        return view.scalar(self.radius)

    def place(self, view: View, facing: Facing) -> Any:
        """Return the lowest point relative to the centre, -r n, with radius r and normal n."""
        return vector.scale(-view.scalar(self.radius), facing.value(view))

    def place_rate(self, view: View, facing: Facing) -> Any:
        """Return the time derivative of ``place``, -r n'."""
        return vector.scale(-view.scalar(self.radius), facing.rate(view))


@dataclass(frozen=True)
class Rim:
    """A circle about the second node, perpendicular to an axle fixed in the node."""

    axle: Carried
    radius: Node
    edge: str

    def _down(self, view: View, facing: Facing) -> tuple[Any, Any, Any]:
        """Return the normal's component in the plane of the disc, its length, and its direction."""
        n, d = facing.value(view), self.axle.value(view)
        # The contact is the lowest point of the rim, opposite to the projection of the normal on
        # the disc. If the disc lies flat, the projection vanishes, and there is no lowest point.
        part = vector.sub(n, vector.scale(vector.dot(n, d), d))
        origin = (
            f"tilt of edge '{self.edge}', whose axis must not be parallel to the normal; tilt "
            "it, or use a box, an ellipsoid, or contacts at three points of the rim"
        )
        return part, *vector.polar(part, origin)

    def depth(self, view: View, facing: Facing) -> Any:
        """Return the radius times the sine of the angle between normal and axle."""
        return view.scalar(self.radius) * self._down(view, facing)[1]

    def place(self, view: View, facing: Facing) -> Any:
        """Return the vector from the centre to the contact point."""
        return vector.scale(-view.scalar(self.radius), self._down(view, facing)[2])

    def place_rate(self, view: View, facing: Facing) -> Any:
        """Return the time derivative of ``place``."""
        _, length, up = self._down(view, facing)
        n, d = facing.value(view), self.axle.value(view)
        n_rate, d_rate = facing.rate(view), self.axle.rate(view)
        # Time derivative of n - (n.d) d, by the product rule.
        along = vector.dot(n_rate, d) + vector.dot(n, d_rate)
        turned = vector.add(vector.scale(along, d), vector.scale(vector.dot(n, d), d_rate))
        part_rate = vector.sub(n_rate, turned)
        # The rate of a unit vector p / |p| is the part of p' perpendicular to it, divided by |p|.
        across = vector.sub(part_rate, vector.scale(vector.dot(up, part_rate), up))
        return vector.scale(-(view.scalar(self.radius) / length), across)


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid about the second node, with axes fixed in the node."""

    axes: tuple[Carried, Carried, Carried]
    semiaxes: Vector

    def _squares(self, view: View) -> list[Any]:
        return [(seen := view.scalar(a)) * seen for a in self.semiaxes]

    def _entries(self, view: View, facing: Facing) -> tuple[list[Any], Any]:
        """Return the components m of the normal along the axes, and the depth sqrt(sum a^2 m^2)."""
        n = facing.value(view)
        entries = [vector.dot(n, axis.value(view)) for axis in self.axes]
        total = sum(
            (s * m * m for s, m in zip(self._squares(view), entries, strict=True)),
            start=view.scalar(self.semiaxes[0].dag.zero),
        )
        return entries, function("sqrt", total)

    def depth(self, view: View, facing: Facing) -> Any:
        """Return the distance of the tangential plane from the centre."""
        return self._entries(view, facing)[1]

    def place(self, view: View, facing: Facing) -> Any:
        """Return the lowest point, -sum a^2 m e/depth, with semi-axes a, axes e, and m = n.e."""
        entries, depth = self._entries(view, facing)
        parts = [
            vector.scale(-(s * m / depth), axis.value(view))
            for s, m, axis in zip(self._squares(view), entries, self.axes, strict=True)
        ]
        return vector.add(vector.add(parts[0], parts[1]), parts[2])

    def place_rate(self, view: View, facing: Facing) -> Any:
        """Return the time derivative of ``place``, by the product rule."""
        n, n_rate = facing.value(view), facing.rate(view)
        entries, depth = self._entries(view, facing)
        squares = self._squares(view)
        rates = [
            vector.dot(n_rate, axis.value(view)) + vector.dot(n, axis.rate(view))
            for axis in self.axes
        ]
        changes = [s * m * r for s, m, r in zip(squares, entries, rates, strict=True)]
        depth_rate = (changes[0] + changes[1] + changes[2]) / depth
        total = vector.zeros(self.semiaxes[0].dag)
        for s, m, r, axis in zip(squares, entries, rates, self.axes, strict=True):
            share = s * m / depth
            along = s * r / depth - share * depth_rate / depth
            total = vector.sub(total, vector.scale(along, axis.value(view)))
            total = vector.sub(total, vector.scale(share, axis.rate(view)))
        return total


@dataclass(frozen=True)
class Touching:
    """Velocity of the second body at its contact with the first body, along a direction."""

    ends: Ends  # node on the plane or centre of the ball, and node of the second body
    facing: Facing  # normal direction of the contact
    surface: Surface  # shape of the second body
    direction: Facing  # direction in which the velocity is measured
    #: Height of the first body's surface above its node, for the gap; None if not along the normal.
    rise: Node | None

    def value(self, view: View) -> Any:
        """Return the gap, or None for directions other than the normal."""
        if self.rise is None:
            return None
        height = vector.dot(self.facing.value(view), self.ends.reach(view))
        return height - self.surface.depth(view, self.facing) - view.scalar(self.rise)

    def _velocity(self, view: View) -> Any:
        """Return the velocity of the second body's material point relative to the first body."""
        contact = self.surface.place(view, self.facing)
        omega, _ = _against_first(self.ends, view)
        spin = view.omega(self.ends.second.cluster, self.ends.ancestor)
        # velocity of the material point at the contact, which is zero in pure rolling
        own = vector.add(self.ends.closing(view), vector.cross(spin, contact))
        carried = vector.cross(omega, vector.add(self.ends.reach(view), contact))
        return vector.sub(own, carried)

    def rate(self, view: View) -> Any:
        """Return the velocity along the direction."""
        return vector.dot(self.direction.value(view), self._velocity(view))

    def acceleration(self, view: View) -> Any:
        """Return the time derivative of the velocity; the contact point moves over both bodies."""
        contact = self.surface.place(view, self.facing)
        contact_rate = self.surface.place_rate(view, self.facing)
        omega, alpha = _against_first(self.ends, view)
        cluster = self.ends.second.cluster
        spin = view.omega(cluster, self.ends.ancestor)
        turn = view.alpha(cluster, self.ends.ancestor)
        own = vector.add(self.ends.opening(view), vector.cross(turn, contact))
        own = vector.add(own, vector.cross(spin, contact_rate))
        # Product rule for omega x (r + contact); the contact point moves over both surfaces.
        place = vector.add(self.ends.reach(view), contact)
        moving = vector.add(self.ends.closing(view), contact_rate)
        carried = vector.add(vector.cross(alpha, place), vector.cross(omega, moving))
        return vector.dot(self.direction.value(view), vector.sub(own, carried)) + vector.dot(
            self.direction.rate(view), self._velocity(view)
        )

    def pull(self, view: View) -> Pull:
        """Return a unit force at the contact point, and its reaction."""
        beyond = self.surface.place(view, self.facing)
        return pull_in_place(view, self.ends, self.direction, beyond=beyond)


def surface_of(motion: Motion, edge: BoundEdge, ends: Ends) -> Surface:
    """Return the shape of the second body."""
    if "ball" in edge.scalars and edge.vectors.keys() & {"size", "axis"}:
        return _nearest(motion, edge, ends)
    if "semiaxes" in edge.vectors:
        x, y, z = (carried_by(motion, ends, 1, e) for e in vector.identity(motion.system.dag))
        return Ellipsoid((x, y, z), edge.vectors["semiaxes"])
    radius = edge.scalars.get("radius", motion.system.dag.zero)
    if "axis" in edge.vectors:
        return Rim(carried_by(motion, ends, 1, edge.vectors["axis"]), radius, edge.name)
    return Ball(radius)


def _axes(motion: Motion, edge: BoundEdge, ends: Ends) -> list[AxisLength]:
    """Return the coordinates of a box, disc or cylinder along its axes; z is the axis of a disc."""
    if "size" in edge.vectors:
        axes = vector.identity(motion.system.dag)
    else:
        axis = edge.vectors["axis"]
        axes = (*plane_axes(axis), axis)
    return [AxisLength(ends, carried_by(motion, ends, 1, e)) for e in axes]


def _nearest(motion: Motion, edge: BoundEdge, ends: Ends) -> Nearest:
    """Return the nearest point of a box, disc or cylinder.

    Modes of the edge select its regions (faces, edges and corners), within which the point is a
    smooth function of the position.
    """
    dag, parts = motion.system.dag, _axes(motion, edge, ends)
    at = [dag.symbol("measure", i) for i in range(3)]

    def clipped(x: Node, length: Node, name: str) -> Node:
        if length.is_zero:
            return dag.zero
        beyond = edge.scalars[f"beyond_{name}"]
        return (1.0 - beyond) * x + 0.5 * beyond * length * dag.function("sign", x)

    if "size" in edge.vectors:
        own = [clipped(*row) for row in zip(at, edge.vectors["size"], "xyz", strict=True)]
    else:
        beyond = edge.scalars["beyond_rim"]
        # The term 1 - beyond keeps the root positive on the axis.
        out = dag.function("sqrt", at[0] * at[0] + at[1] * at[1] + (1.0 - beyond))
        share = 1.0 - beyond + beyond * edge.scalars["radius"] / out
        length = edge.scalars.get("length", dag.zero)
        own = [share * at[0], share * at[1], clipped(at[2], length, "end")]
    own_parts = [Composite(parts, node, motion.system.time) for node in own]
    return Nearest([part.axis for part in parts], own_parts)


def beyond(motion: Motion, edge: BoundEdge, name: str) -> Node | None:
    """Return how far a ball's centre is beyond a face or rim, or None for other names, [m^2].

    The value is the square of a coordinate, or of the distance from an axis, minus the square of
    half the size, or of the radius.
    """
    if f"beyond_{name}" not in edge.scalars:
        return None
    view, axes = View(motion), _axes(motion, edge, chord_ends(motion, edge))
    x, y, z = (measure.value(view) for measure in axes)
    square, half = x * x + y * y, edge.scalars.get("radius", motion.system.dag.zero)
    if name == "end":
        square, half = z * z, 0.5 * edge.scalars["length"]
    elif name != "rim":
        i = "xyz".index(name)
        square, half = (x, y, z)[i] * (x, y, z)[i], 0.5 * edge.vectors["size"][i]
    excess: Node = square - half * half
    return excess


def touching(motion: Motion, edge: BoundEdge, touch: Touch) -> Touching:
    """Return the measure of the gap or of a slip at one point of a contact."""
    ends = _ends_at(chord_ends(motion, edge), edge, touch.spot)
    dag = motion.system.dag
    surface = surface_of(motion, edge, ends)
    facing: Facing = Centres(ends, edge.name, surface)
    rise = edge.scalars.get("ball", dag.zero)
    if "normal" in edge.vectors:
        facing = carried_by(motion, ends, 0, edge.vectors["normal"])
    if touch.quantity == "gap":
        return Touching(ends, facing, surface, facing, rise)
    direction = _direction(motion, edge, ends, facing, touch.quantity)
    return Touching(ends, facing, surface, direction, None)


def _direction(
    motion: Motion, edge: BoundEdge, ends: Ends, facing: Facing, quantity: str
) -> Facing:
    """Return a slip direction: a tangent, or the tangential part of an axis of a ball.

    Both tangents and the normal are right-handed. In a planar system the first tangent is normal x
    e, with the axis e perpendicular to the plane of motion, and the second one is -e.
    """
    dag, plane, index = motion.system.dag, motion.system.plane, int(quantity[-1]) - 1
    axes = vector.identity(dag)
    if "normal" in edge.vectors:
        normal = edge.vectors["normal"]
        along = plane_axes(normal)
        if plane:
            first = vector.cross(normal, axes["xyz".index(plane)])
            along = first, vector.cross(normal, first)
        return carried_by(motion, ends, 0, along[index])
    if quantity.startswith("part"):
        # The tangential parts of the three axes always span the tangential plane.
        return Tangent(facing, axes[index])
    if plane:
        return Across(facing, axes["xyz".index(plane)])
    first, second, up = (_constants(dag, row) for row in _skew())
    return Tilted(facing, (first, second)[index], up)


def _constants(dag: Dag, row: tuple[float, float, float]) -> Vector:
    x, y, z = map(dag.constant, row)
    return x, y, z


def _ends_at(ends: Ends, edge: BoundEdge, spot: int) -> Ends:
    offset = _offset(edge, spot)
    if offset is None:
        return ends
    point = ends.second
    local = vector.add(point.local, point.resolved(offset))
    return replace(ends, second=replace(point, local=local))


def _offset(edge: BoundEdge, spot: int) -> Vector | None:
    """Return the position of a contact point in node axes, or None if it is the node itself."""
    if "ball" in edge.scalars:
        return None
    if "size" in edge.vectors:
        size = edge.vectors["size"]
        corner = list(vector.zeros(size[0].dag))
        sides = [i for i in range(3) if not size[i].is_zero]
        # An edge of zero length has two corners at one point, so the number of points is constant.
        signs = list(product((-1, 1), repeat=len(sides)))
        for i, sign in zip(sides, signs[spot % len(signs)], strict=True):
            corner[i] = 0.5 * sign * size[i]
        return (corner[0], corner[1], corner[2])
    if "length" in edge.scalars:
        return vector.scale((spot - 0.5) * edge.scalars["length"], edge.vectors["axis"])
    return None
