"""The two nodes of a chord: vectors between them, axes they carry, and forces on them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

from cotree.dag import vector
from cotree.dag.derivative import tangents

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.dag.nodes import Node
    from cotree.dag.vector import Vector
    from cotree.formulation.across import Motion, View
    from cotree.formulation.clusters import Clusters, Point
    from cotree.formulation.fields import BoundEdge


@dataclass(frozen=True)
class Pull:
    """Wrenches on clusters and efforts along speeds, for a unit of a through variable."""

    #: On clusters, at their origins and in their bases; the ground is left out.
    wrenches: tuple[tuple[int, Any, Any], ...] = ()
    efforts: Mapping[int, Any] = field(default_factory=dict)  # along speeds, by their index

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
        """Add another pull."""
        efforts = dict(self.efforts)
        # Wrenches are listed, since they are summed on their clusters later; efforts of one speed
        # are added.
        for index, effort in other.efforts.items():
            efforts[index] = efforts[index] + effort if index in efforts else effort
        return Pull((*self.wrenches, *other.wrenches), efforts)


@dataclass(frozen=True)
class Ends:
    """The nodes of a chord, and their nearest common ancestor."""

    first: Point
    second: Point
    ancestor: int

    @classmethod
    def of(cls, clusters: Clusters, first: Point, second: Point) -> Ends:
        """Pair two nodes with their common ancestor."""
        # The ancestor moves both nodes equally: terms within it cancel and are not formed.
        return cls(first, second, clusters.common_ancestor(first.cluster, second.cluster))

    def _between(self, see: Any) -> Any:
        return vector.sub(see(self.second, self.ancestor), see(self.first, self.ancestor))

    def reach(self, view: View) -> Any:
        """Return the vector from the first node to the second."""
        return self._between(view.position)

    def closing(self, view: View) -> Any:
        """Return the rate in space of the vector from the first node to the second."""
        return self._between(view.velocity)

    def opening(self, view: View) -> Any:
        """Return the second derivative in space of the vector from the first node to the second."""
        return self._between(view.acceleration)

    def arm(self, view: View, end: int) -> Any:
        """Return a node's position from its cluster's origin, in the ancestor's basis."""
        point = (self.first, self.second)[end]
        return view.fixed(point.cluster, point.local, self.ancestor)

    def spin(self, view: View) -> Any:
        """Return the relative angular velocity."""
        a, b = self.first.cluster, self.second.cluster
        return vector.sub(view.omega(b, self.ancestor), view.omega(a, self.ancestor))

    def turn(self, view: View) -> Any:
        """Return the rate in space of the relative angular velocity."""
        a, b = self.first.cluster, self.second.cluster
        return vector.sub(view.alpha(b, self.ancestor), view.alpha(a, self.ancestor))


class Seen(Protocol):
    """A vector as seen in a view."""

    def value(self, view: View) -> Any:
        """Return the vector."""
        ...


@dataclass(frozen=True)
class Carried:
    """A vector given in a node's axes, which may depend on time, with its rates in space."""

    point: Point
    local: Vector
    ancestor: int
    time: Node

    @cached_property
    def _locals(self) -> tuple[Vector, Vector, Vector]:
        """Return the vector and its explicit rates, in the cluster's axes."""
        # Axes and vectors of constraints may be functions of time.
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
        """Return the rate of the vector."""
        omega = view.omega(self.point.cluster, self.ancestor)
        # Transport theorem: the rate in space is omega x e plus the explicit rate in the node's
        # axes.
        carried = vector.cross(omega, self.value(view))
        return vector.add(carried, self._explicit(view, 1))

    def acceleration(self, view: View) -> Any:
        """Return the second derivative of the vector."""
        omega = view.omega(self.point.cluster, self.ancestor)
        alpha = view.alpha(self.point.cluster, self.ancestor)
        inner = vector.cross(omega, self.value(view))
        explicit = self._explicit(view, 1)
        total = vector.add(vector.cross(alpha, self.value(view)), vector.cross(omega, inner))
        # Coriolis term of a vector that changes in a rotating frame: 2 omega x explicit rate.
        relative = vector.cross(omega, explicit)
        total = vector.add(total, vector.add(relative, relative))
        return vector.add(total, self._explicit(view, 2))


def pair_pull(
    view: View, ends: Ends, force: Any, torque: Any, arms: tuple[Any, Any] | None = None
) -> Pull:
    """Apply a force and a torque to the second node, and their opposites to the first.

    Both are in the basis of the nodes' common ancestor. ``arms`` leads from the origins of the
    nodes' clusters to the points of action, by default the nodes.
    """
    found = []
    arms = arms or (ends.arm(view, 0), ends.arm(view, 1))
    for point, arm, sign in ((ends.second, arms[1], 1), (ends.first, arms[0], -1)):
        # Loads on the ground have no effect.
        if point.cluster == 0:
            continue
        # Moment about the origin of the cluster, where its wrenches are summed.
        whole = torque if force is None else vector.cross(arm, force)
        if force is not None and torque is not None:
            whole = vector.add(whole, torque)
        # A zero of the same kind: nodes in the first graph, dual numbers in the others.
        pushed = vector.sub(whole, whole) if force is None else force
        found.append(
            (
                point.cluster,
                view.settled(vector.signed(sign, pushed), ends.ancestor, point.cluster),
                view.settled(vector.signed(sign, whole), ends.ancestor, point.cluster),
            )
        )
    return Pull(tuple(found))


def pull_in_place(view: View, ends: Ends, axis: Seen, beyond: Any | None = None) -> Pull:
    """Apply a force along ``axis`` to the second node, and its opposite to the first's body.

    Both act at the same point; ``beyond`` leads there from the second node.
    """
    # The point is the second node, relative to the origins of both clusters.
    arms = vector.add(ends.arm(view, 0), ends.reach(view)), ends.arm(view, 1)
    if beyond is not None:
        arms = vector.add(arms[0], beyond), vector.add(arms[1], beyond)
    return pair_pull(view, ends, axis.value(view), None, arms)


def chord_ends(motion: Motion, edge: BoundEdge) -> Ends:
    """Find the nodes of an edge."""
    points = motion.clusters.points
    return Ends.of(motion.clusters, points[edge.first], points[edge.second])


def carried_by(motion: Motion, ends: Ends, end: int, local: Vector) -> Carried:
    """Attach a vector, resolved in its axes, to a node."""
    point = (ends.first, ends.second)[end]
    return Carried(point, local, ends.ancestor, motion.system.time)
