"""Measures: scalar across variables with their rates, and the dual through variables.

The pull of a measure consists of the forces and torques on clusters and coordinates per unit of the
dual through variable; the power of the pull is the rate of the measure. A constraint keeps a
measure at zero; its multiplier acts along the pull. Laws of chord joints, couplings, prescribed
motions and outputs also use measures.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

from cotree.dag import vector
from cotree.dag.derivative import tangents
from cotree.dag.dual import function

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.dag.vector import Vector
    from cotree.formulation.across import Motion, View
    from cotree.formulation.clusters import Clusters, Point
    from cotree.formulation.fields import BoundEdge
    from cotree.formulation.system import Speed


@dataclass(frozen=True)
class Pull:
    """Wrenches on clusters, and efforts along speeds, per unit of a through variable."""

    #: Wrenches on clusters except the ground, at the clusters' origins and in their bases.
    wrenches: tuple[tuple[int, Any, Any], ...] = ()
    efforts: Mapping[int, Any] = field(default_factory=dict)  # effort by index of its speed

    @property
    def entries(self) -> list[Any]:
        """All components of the wrenches, then all efforts."""
        of_wrenches = (entry for _, *parts in self.wrenches for part in parts for entry in part)
        return [*of_wrenches, *self.efforts.values()]

    def scaled(self, factor: Any) -> Pull:
        """Return the pull multiplied by a factor."""
        return Pull(
            tuple(
                (cluster, vector.scale(factor, force), vector.scale(factor, torque))
                for cluster, force, torque in self.wrenches
            ),
            {index: factor * effort for index, effort in self.efforts.items()},
        )

    def plus(self, other: Pull) -> Pull:
        """Return the sum of this pull and another one."""
        efforts = dict(self.efforts)
        # Wrenches are only listed and summed later; efforts along the same speed are added here.
        for index, effort in other.efforts.items():
            efforts[index] = efforts[index] + effort if index in efforts else effort
        return Pull((*self.wrenches, *other.wrenches), efforts)


@dataclass(frozen=True)
class Ends:
    """The two nodes of a chord, and their nearest common ancestor."""

    first: Point
    second: Point
    ancestor: int

    @classmethod
    def of(cls, clusters: Clusters, first: Point, second: Point) -> Ends:
        """Return two nodes with their nearest common ancestor."""
        # The ancestor moves both nodes equally, so its motion cancels.
        return cls(first, second, clusters.common_ancestor(first.cluster, second.cluster))

    def _between(self, see: Any) -> Any:
        return vector.sub(see(self.second, self.ancestor), see(self.first, self.ancestor))

    def reach(self, view: View) -> Any:
        """Return the vector from the first node to the second."""
        return self._between(view.position)

    def closing(self, view: View) -> Any:
        """Return the time derivative of the vector between the nodes, in inertial axes."""
        return self._between(view.velocity)

    def opening(self, view: View) -> Any:
        """Return the second time derivative of the vector between the nodes, in inertial axes."""
        return self._between(view.acceleration)

    def arm(self, view: View, end: int) -> Any:
        """Return the vector from a cluster's origin to its node, in the ancestor's basis."""
        point = (self.first, self.second)[end]
        return view.fixed(point.cluster, point.local, self.ancestor)

    def spin(self, view: View) -> Any:
        """Return the angular velocity of the second node relative to the first."""
        a, b = self.first.cluster, self.second.cluster
        return vector.sub(view.omega(b, self.ancestor), view.omega(a, self.ancestor))

    def turn(self, view: View) -> Any:
        """Return the time derivative of the relative angular velocity, in inertial axes."""
        a, b = self.first.cluster, self.second.cluster
        return vector.sub(view.alpha(b, self.ancestor), view.alpha(a, self.ancestor))


class Facing(Protocol):
    """A direction that may depend on time."""

    def value(self, view: View) -> Any:
        """Return the vector."""

    def rate(self, view: View) -> Any:
        """Return the time derivative of the vector."""


@dataclass(frozen=True)
class Carried:
    """A vector in node axes that may depend on time, with derivatives in inertial axes."""

    point: Point
    local: Vector
    ancestor: int
    time: Node

    @cached_property
    def _locals(self) -> tuple[Vector, Vector, Vector]:
        """The vector and its two explicit time derivatives, in cluster axes."""
        # Axes and vectors of constraints may depend on time explicitly.
        seed = {self.time: self.time.dag.one}
        own = self.point.resolved(self.local)
        first = tangents(own, seed)
        second = tangents(first, seed)
        return own, (first[0], first[1], first[2]), (second[0], second[1], second[2])

    def _explicit(self, view: View, order: int) -> Any:
        return view.fixed(self.point.cluster, self._locals[order], self.ancestor)

    def value(self, view: View) -> Any:
        """Return the vector."""
        return self._explicit(view, 0)

    def rate(self, view: View) -> Any:
        """Return the time derivative of the vector."""
        omega = view.omega(self.point.cluster, self.ancestor)
        # Transport theorem: the rate in space is omega x e plus the explicit rate in node axes.
        carried = vector.cross(omega, self.value(view))
        return vector.add(carried, self._explicit(view, 1))

    def acceleration(self, view: View) -> Any:
        """Return the second time derivative of the vector."""
        omega = view.omega(self.point.cluster, self.ancestor)
        alpha = view.alpha(self.point.cluster, self.ancestor)
        inner = vector.cross(omega, self.value(view))
        explicit = self._explicit(view, 1)
        total = vector.add(vector.cross(alpha, self.value(view)), vector.cross(omega, inner))
        # Coriolis term 2 omega x (explicit rate) of a vector that changes in a rotating frame.
        relative = vector.cross(omega, explicit)
        total = vector.add(total, vector.add(relative, relative))
        return vector.add(total, self._explicit(view, 2))


def pair_pull(
    view: View, ends: Ends, force: Any, torque: Any, arms: tuple[Any, Any] | None = None
) -> Pull:
    """Return a force and a torque on the second node, and their opposites on the first node.

    Force and torque are in the basis of the nodes' common ancestor. ``arms`` are the vectors from
    the clusters' origins to the points of action, which by default are the nodes.
    """
    found = []
    arms = arms or (ends.arm(view, 0), ends.arm(view, 1))
    for point, arm, sign in ((ends.second, arms[1], 1), (ends.first, arms[0], -1)):
        # Loads on the ground have no effect.
        if point.cluster == 0:
            continue
        # Wrenches of a cluster are summed at its origin: use the moment about the origin.
        whole = torque if force is None else vector.cross(arm, force)
        if force is not None and torque is not None:
            whole = vector.add(whole, torque)
        # Difference of equal terms: a zero that is a dual number in sensitivity graphs.
        pushed = vector.sub(whole, whole) if force is None else force
        found.append(
            (
                point.cluster,
                view.settled(vector.signed(sign, pushed), ends.ancestor, point.cluster),
                view.settled(vector.signed(sign, whole), ends.ancestor, point.cluster),
            )
        )
    return Pull(tuple(found))


def pull_in_place(view: View, ends: Ends, axis: Facing, beyond: Any | None = None) -> Pull:
    """Return a force along ``axis`` and its reaction, both at ``beyond`` from the second node."""
    # Both arms lead to the second node, one from the origin of each cluster.
    arms = vector.add(ends.arm(view, 0), ends.reach(view)), ends.arm(view, 1)
    if beyond is not None:
        arms = vector.add(arms[0], beyond), vector.add(arms[1], beyond)
    return pair_pull(view, ends, axis.value(view), None, arms)


def chord_ends(motion: Motion, edge: BoundEdge) -> Ends:
    """Return the nodes of an edge."""
    points = motion.clusters.points
    return Ends.of(motion.clusters, points[edge.first], points[edge.second])


def carried_by(motion: Motion, ends: Ends, end: int, local: Vector) -> Carried:
    """Return a vector that is fixed in a node, from its components in node axes."""
    point = (ends.first, ends.second)[end]
    return Carried(point, local, ends.ancestor, motion.system.time)


class Measure(Protocol):
    """A scalar across variable; nonholonomic measures have a rate but no value."""

    def value(self, view: View) -> Any:
        """Return the value, or None for a nonholonomic measure."""

    def rate(self, view: View) -> Any:
        """Return the time derivative of the value."""

    def acceleration(self, view: View) -> Any:
        """Return the time derivative of the rate."""

    def pull(self, view: View) -> Pull:
        """Return the wrenches and efforts per unit of the dual through variable."""


@dataclass(frozen=True)
class CoordinateMeasure:
    """The coordinate of a tree joint, as a measure."""

    speed: Speed

    def value(self, view: View) -> Any:
        """Return the coordinate."""
        # Angular velocities of a free rotation are speeds without coordinates.
        return None if self.speed.coordinate is None else view.scalar(self.speed.coordinate.symbol)

    def rate(self, view: View) -> Any:
        """Return the speed."""
        return view.scalar(self.speed.symbol)

    def acceleration(self, view: View) -> Any:
        """Return the acceleration."""
        return view.scalar(self.speed.acceleration)

    def pull(self, view: View) -> Pull:
        """Return a unit effort along the coordinate."""
        # The power of a unit effort is the speed, which is the rate of the measure.
        return Pull(efforts={self.speed.index: view.scalar(self.speed.symbol.dag.one)})


@dataclass(frozen=True)
class Coincidence:
    """A component of the vector between two nodes that a constraint keeps at one point.

    Since the vector and its rates are zero, ``direction`` may be any axis of the ancestor's basis.
    """

    ends: Ends
    direction: Vector

    def _along(self, view: View) -> Vector:
        return view.motion.frames.constant(self.ends.ancestor, self.direction)

    def value(self, view: View) -> Any:
        """Return the component of the vector along ``direction``."""
        return vector.dot(self._along(view), self.ends.reach(view))

    def rate(self, view: View) -> Any:
        """Return the component of the relative velocity along ``direction``."""
        return vector.dot(self._along(view), self.ends.closing(view))

    def acceleration(self, view: View) -> Any:
        """Return the component of the relative acceleration along ``direction``."""
        return vector.dot(self._along(view), self.ends.opening(view))

    def pull(self, view: View) -> Pull:
        """Return a unit force along the direction, and its reaction."""
        # If the constraint is satisfied, the nodes coincide, and opposite forces have no moment.
        return pair_pull(view, self.ends, self._along(view), None)


@dataclass(frozen=True)
class AxisLength:
    """Component of the vector between two nodes along an axis that is fixed in a node."""

    ends: Ends
    axis: Carried

    def value(self, view: View) -> Any:
        """Return e.r, with the axis e and the vector r between the nodes."""
        return vector.dot(self.axis.value(view), self.ends.reach(view))

    def rate(self, view: View) -> Any:
        """Return e.r' + e'.r, the rate of e.r."""
        return vector.dot(self.axis.value(view), self.ends.closing(view)) + vector.dot(
            self.axis.rate(view), self.ends.reach(view)
        )

    def acceleration(self, view: View) -> Any:
        """Return e.r'' + 2 e'.r' + e''.r, the second derivative of e.r."""
        reach, closing, opening = (
            form(view) for form in (self.ends.reach, self.ends.closing, self.ends.opening)
        )
        crossed = vector.dot(self.axis.rate(view), closing)
        return (
            vector.dot(self.axis.value(view), opening)
            + (crossed + crossed)
            + vector.dot(self.axis.acceleration(view), reach)
        )

    def pull(self, view: View) -> Pull:
        """Return a force along the axis on the second node, and its reaction at the same point."""
        # e'.r is the power of the reaction's moment: the axis rotates with its node, and the
        # reaction acts on the first body at the position of the second node.
        return pull_in_place(view, self.ends, self.axis)


@dataclass(frozen=True)
class Distance:
    """The distance between two nodes."""

    ends: Ends

    def _polar(self, view: View) -> Any:
        return vector.polar(self.ends.reach(view))

    def value(self, view: View) -> Any:
        """Return |r|, the length of the vector r between the nodes."""
        return self._polar(view)[0]

    def rate(self, view: View) -> Any:
        """Return e.r', the rate of |r|, with the direction e of r."""
        return vector.dot(self._polar(view)[1], self.ends.closing(view))

    def acceleration(self, view: View) -> Any:
        """Return e.r'' + (r'.r' - (e.r')^2) / |r|, the rate of e.r'."""
        length, direction = self._polar(view)
        closing, rate = self.ends.closing(view), self.rate(view)
        # Centripetal: squared velocity across the line over length; singular if nodes coincide.
        across = (vector.dot(closing, closing) - rate * rate) / length
        return vector.dot(direction, self.ends.opening(view)) + across

    def pull(self, view: View) -> Pull:
        """Return opposite forces that push the nodes apart."""
        # Both nodes are on the line of the forces, which therefore have no moment.
        return pair_pull(view, self.ends, self._polar(view)[1], None)


@dataclass(frozen=True)
class Cosine:
    """The scalar product of two directions, one fixed in each node."""

    ends: Ends
    a: Carried
    b: Carried

    def value(self, view: View) -> Any:
        """Return a.b, the scalar product of both directions."""
        return vector.dot(self.a.value(view), self.b.value(view))

    def _moment(self, view: View) -> Any:
        # a' = omega_a x a and b' = omega_b x b lead to (a.b)' = (b x a).(omega_b - omega_a).
        return vector.cross(self.b.value(view), self.a.value(view))

    def rate(self, view: View) -> Any:
        """Return (b x a).spin, the rate of a.b, with the relative angular velocity."""
        return vector.dot(self._moment(view), self.ends.spin(view))

    def acceleration(self, view: View) -> Any:
        """Return (b x a).alpha + (b x a)'.spin, with the relative angular acceleration alpha."""
        moving = vector.add(
            vector.cross(self.b.rate(view), self.a.value(view)),
            vector.cross(self.b.value(view), self.a.rate(view)),
        )
        # b x a changes because both bodies rotate, hence the second term.
        return vector.dot(self._moment(view), self.ends.turn(view)) + vector.dot(
            moving, self.ends.spin(view)
        )

    def pull(self, view: View) -> Pull:
        """Return the torque b x a, and its reaction."""
        return pair_pull(view, self.ends, None, self._moment(view))


@dataclass(frozen=True)
class Spin:
    """Relative angular velocity about an axis that is fixed in a node."""

    ends: Ends
    axis: Carried

    def value(self, view: View) -> Any:
        """Return None, since a rotation about a moving axis has no coordinate."""
        return None

    def rate(self, view: View) -> Any:
        """Return the relative angular velocity about the axis."""
        return vector.dot(self.axis.value(view), self.ends.spin(view))

    def acceleration(self, view: View) -> Any:
        """Return the time derivative of the rate."""
        return vector.dot(self.axis.value(view), self.ends.turn(view)) + vector.dot(
            self.axis.rate(view), self.ends.spin(view)
        )

    def pull(self, view: View) -> Pull:
        """Return a torque about the axis, and its reaction."""
        return pair_pull(view, self.ends, None, self.axis.value(view))


@dataclass(frozen=True)
class Angle(Spin):
    """Angle of the second node relative to the first, about a unit axis fixed in both nodes."""

    #: Directions perpendicular to the axis, one fixed in each node; they coincide at angle zero.
    reference: Carried
    mark: Carried
    #: Sum of the angles if all rotations are about one axis; else None: angle between -pi and pi.
    sum: Node | None = None

    def value(self, view: View) -> Any:
        """Return the angle."""
        if self.sum is not None:
            return view.scalar(self.sum)
        reference, mark = self.reference.value(view), self.mark.value(view)
        # Both directions are perpendicular to the axis, so sine and cosine determine the angle.
        sine = vector.dot(self.axis.value(view), vector.cross(reference, mark))
        return function("atan2", sine, vector.dot(reference, mark))


@dataclass(frozen=True)
class Composite:
    """A function of other measures, time and parameters."""

    parts: Sequence[Measure]  # measures on which the function depends
    expression: Node  # function of the symbols ``("measure", i)``
    time: Node  # symbol of time in the function

    @cached_property
    def _symbols(self) -> tuple[tuple[Node, ...], ...]:
        """Symbols of the measures, of their rates and of their accelerations."""
        kinds = ("measure", "measure rate", "measure acceleration")
        n, dag = len(self.parts), self.time.dag
        return tuple(tuple(dag.symbol(kind, i) for i in range(n)) for kind in kinds)

    @cached_property
    def _rate(self) -> Node:
        values, rates, _ = self._symbols
        seed = dict(zip(values, rates, strict=True)) | {self.time: self.time.dag.one}
        return tangents([self.expression], seed)[0]

    @cached_property
    def _acceleration(self) -> Node:
        values, rates, second = self._symbols
        seed = dict(zip(values, rates, strict=True)) | {self.time: self.time.dag.one}
        # A rate depends on values, rates and time: differentiate with respect to all of them.
        return tangents([self._rate], seed | dict(zip(rates, second, strict=True)))[0]

    def _arguments(self, view: View, order: int) -> dict[Node, Any]:
        forms = ("value", "rate", "acceleration")[: order + 1]
        return {
            symbol: getattr(part, form)(view)
            # Values and rates need no symbols of accelerations, so lengths may differ.
            for form, symbols in zip(forms, self._symbols, strict=False)
            for part, symbol in zip(self.parts, symbols, strict=True)
        }

    def value(self, view: View) -> Any:
        """Return the function of the measures' values."""
        return view.formula(self.expression, self._arguments(view, 0))

    def rate(self, view: View) -> Any:
        """Return the time derivative of the function."""
        return view.formula(self._rate, self._arguments(view, 1))

    def acceleration(self, view: View) -> Any:
        """Return the second time derivative of the function."""
        return view.formula(self._acceleration, self._arguments(view, 2))

    def pull(self, view: View) -> Pull:
        """Return the sum of the measures' pulls, each times its partial derivative."""
        total = Pull()
        # The explicit dependence on time has no power through the pull.
        values = self._symbols[0]
        for part, symbol in zip(self.parts, values, strict=True):
            partial = tangents([self.expression], {symbol: symbol.dag.one})[0]
            if not partial.is_zero:
                factor = view.formula(partial, self._arguments(view, 0))
                total = total.plus(part.pull(view).scaled(factor))
        return total
