"""Measures of contact: a blade and a rolling disc, whose rates are held (nonholonomic)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.dag import vector
from cotree.formulation.endpoints import Carried, Ends, Pull, pull_in_place

if TYPE_CHECKING:
    from cotree.dag.nodes import Node
    from cotree.formulation.views import View


def _against_first(ends: Ends, view: View) -> tuple[Any, Any]:
    """Give angular velocity and acceleration of the first node's cluster."""
    cluster = ends.first.cluster
    return view.omega(cluster, ends.ancestor), view.alpha(cluster, ends.ancestor)


@dataclass(frozen=True)
class Slip:
    """Velocity of the second node, as the first sees it, along an axis that the second carries."""

    ends: Ends
    axis: Carried

    def value(self, view: View) -> Any:
        """Give nothing: there is no such coordinate."""
        return None

    def _velocity(self, view: View) -> Any:
        omega, _ = _against_first(self.ends, view)
        # The rate in space of r less the part by which the first body's turn carries it.
        return vector.sub(self.ends.closing(view), vector.cross(omega, self.ends.reach(view)))

    def rate(self, view: View) -> Any:
        """Give e.(r' - omega x r)."""
        return vector.dot(self.axis.value(view), self._velocity(view))

    def acceleration(self, view: View) -> Any:
        """Give the time derivative of that rate."""
        omega, alpha = _against_first(self.ends, view)
        carried = vector.add(
            vector.cross(alpha, self.ends.reach(view)),
            vector.cross(omega, self.ends.closing(view)),
        )
        # Product rule of e.(r' - omega x r), with omega' = alpha; a term for e' follows.
        own = vector.sub(self.ends.opening(view), carried)
        return vector.dot(self.axis.value(view), own) + vector.dot(
            self.axis.rate(view), self._velocity(view)
        )

    def pull(self, view: View) -> Pull:
        """Act with a force across the blade."""
        return pull_in_place(view, self.ends, self.axis)


@dataclass(frozen=True)
class Rolling:
    """Velocity of a disc's point of contact along a direction of the plane that it rolls on.

    Attributes
    ----------
    ends : Ends
        A node of the plane, and the disc's centre.
    normal : Carried
        Of the plane, carried by the first node.
    axle : Carried
        Axis of the disc, carried by the second.
    direction : Carried
        Along which the velocity is taken, carried by the first.
    radius : Node
        Of the disc.
    has_value : bool
        Whether the direction is the normal: the height of the contact is then a value.
    """

    ends: Ends
    normal: Carried
    axle: Carried
    direction: Carried
    radius: Node
    has_value: bool

    def _down(self, view: View) -> tuple[Any, Any, Any]:
        """Give the part of the normal within the disc, its length, and its direction."""
        n, d = self.normal.value(view), self.axle.value(view)
        # The contact lies on the rim, furthest down: opposite to the normal's projection on the
        # disc. Where the disc lies flat the projection vanishes, and no point is lowest.
        part = vector.sub(n, vector.scale(vector.dot(n, d), d))
        return part, *vector.polar(part)

    def _contact(self, view: View) -> Any:
        """Give the vector from the centre to the contact."""
        return vector.scale(-view.scalar(self.radius), self._down(view)[2])

    def _contact_rate(self, view: View) -> Any:
        _, length, up = self._down(view)
        n, d = self.normal.value(view), self.axle.value(view)
        n_rate, d_rate = self.normal.rate(view), self.axle.rate(view)
        # Rate of n - (n.d) d, by the product rule.
        along = vector.dot(n_rate, d) + vector.dot(n, d_rate)
        turned = vector.add(vector.scale(along, d), vector.scale(vector.dot(n, d), d_rate))
        part_rate = vector.sub(n_rate, turned)
        # The rate of a unit vector p / |p| is the part of p' across it, over |p|.
        across = vector.sub(part_rate, vector.scale(vector.dot(up, part_rate), up))
        return vector.scale(-(view.scalar(self.radius) / length), across)

    def value(self, view: View) -> Any:
        """Give the height of the contact, for the normal."""
        if not self.has_value:
            return None
        # The rim reaches down by r |p|, since n.up is |p|, the sine of the angle between normal and
        # axle.
        height = vector.dot(self.normal.value(view), self.ends.reach(view))
        return height - view.scalar(self.radius) * self._down(view)[1]

    def _velocity(self, view: View) -> Any:
        """Give the velocity of the disc's material at the contact, as the plane sees it."""
        contact = self._contact(view)
        omega, _ = _against_first(self.ends, view)
        spin = view.omega(self.ends.second.cluster, self.ends.ancestor)
        # The material point of the disc at the contact; pure rolling means that it stands still.
        own = vector.add(self.ends.closing(view), vector.cross(spin, contact))
        carried = vector.cross(omega, vector.add(self.ends.reach(view), contact))
        return vector.sub(own, carried)

    def rate(self, view: View) -> Any:
        """Give the velocity along the direction."""
        return vector.dot(self.direction.value(view), self._velocity(view))

    def acceleration(self, view: View) -> Any:
        """Give the time derivative of that velocity; the contact itself moves over the disc."""
        contact, contact_rate = self._contact(view), self._contact_rate(view)
        omega, alpha = _against_first(self.ends, view)
        cluster = self.ends.second.cluster
        spin = view.omega(cluster, self.ends.ancestor)
        turn = view.alpha(cluster, self.ends.ancestor)
        own = vector.add(self.ends.opening(view), vector.cross(turn, contact))
        own = vector.add(own, vector.cross(spin, contact_rate))
        # Product rule of omega x (r + contact), where the contact moves along rim and plane.
        place = vector.add(self.ends.reach(view), contact)
        moving = vector.add(self.ends.closing(view), contact_rate)
        carried = vector.add(vector.cross(alpha, place), vector.cross(omega, moving))
        return vector.dot(self.direction.value(view), vector.sub(own, carried)) + vector.dot(
            self.direction.rate(view), self._velocity(view)
        )

    def pull(self, view: View) -> Pull:
        """Act with a force at the contact."""
        return pull_in_place(view, self.ends, self.direction, beyond=self._contact(view))
