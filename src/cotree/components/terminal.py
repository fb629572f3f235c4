"""Terminal equations of scalar components.

A terminal equation relates the across and through variables of an edge of an electrical, hydraulic,
thermal or one-dimensional mechanical graph.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from cotree.components.law import Law
from cotree.domains import DOMAINS


class Kind(Enum):
    """Kind of an edge, in the order in which edges become branches of the normal tree.

    A nullator makes both of its variables zero, a norator neither. f-circuits use the nullator as a
    branch and the norator as a chord, f-cutsets vice versa.
    """

    ACROSS_SOURCE = 0  # a given across variable; always a branch
    ACROSS_STORAGE = 1  # capacitors, tanks, masses: through = capacity * rate of across
    COUPLED = 2  # a port of a transformer or gyrator
    DISSIPATOR = 3  # resistors: algebraic relation of through and across
    THROUGH_STORAGE = 4  # inductors: across = inertance * rate of through
    SPRING = 5  # through by the integral of across; a branch only among springs
    THROUGH_SOURCE = 6  # a given through variable; always a chord
    NULLATOR = 7
    NORATOR = 8
    FRICTION = 9  # dry friction: through sticks, or follows a law of sliding; always a chord
    STOP = 10  # a rigid stop: through keeps it closed, or is zero; always a chord

    @property
    def may_hold(self) -> bool:
        """Return whether a mode may keep the edge's across variable zero."""
        return self in (Kind.FRICTION, Kind.STOP)


@dataclass(frozen=True)
class Integral:
    """A quantity of a port that its terminal equation, its fields or outputs may use: a state."""

    #: The state is called ``edge.name``.
    name: str
    unit: str
    rate: Law  # the law of its rate


@dataclass(frozen=True)
class PortMeasure:
    """A sum of variables of a component's ports that outputs and fields may name."""

    #: It is called ``edge.name``.
    name: str
    unit: str
    terms: tuple[tuple[int, str, str], ...]  # signs, ``across`` or ``through``, and ports


@dataclass(frozen=True)
class Touch:
    """The direction of a port of a contact, at one of the points that may touch."""

    spot: int  # the point, from 0 on
    #: ``gap``; ``slip1`` or ``slip2``: one of two perpendicular directions of slip; ``part1`` to
    #: ``part3``: the part of an axis that is tangential to a ball.
    quantity: str


@dataclass(frozen=True)
class Friction:
    """Laws of an edge that sticks, slides forwards, slides backwards, or is disengaged.

    While it sticks, the rate of across is zero, and through takes the value that keeps it so, as
    long as that stays between two limits. All laws take the arguments of those of a
    :class:`Terminal`.
    """

    #: The through variable while across is positive, and while it is negative.
    forward: Law
    backward: Law
    #: The limits of through while it sticks, beyond which it begins to slide forwards and
    #: backwards; None if it never slides in that direction.
    upper: Law
    lower: Law | None
    #: Positive while it is engaged; through is zero otherwise. None if it is always engaged.
    grip: Law | None = None
    #: The value whose sign is the argument ``side`` of the laws of sliding, which are continuous at
    #: its zero.
    load: Law | None = None
    #: The port of the same component whose rigid stop presses it together: it is disengaged while
    #: that is open, and takes part in its impacts. Empty if there is none.
    presser: str = ""
    suffix: str = ""  # the suffix of its modes among the fields
    #: Of the second direction of a friction disc: the port of the first one, which has the mode of
    #: both. The force along each is within a disc together with that along the other.
    leader: str = ""
    #: Of the first direction of a friction disc: the port of the second one.
    follower: str = ""

    @property
    def is_disc(self) -> bool:
        """Return whether its force is within a disc, with that along a second direction."""
        return bool(self.leader or self.follower)

    @property
    def mode(self) -> str:
        """The field of its mode."""
        return f"mode_{self.leader}" if self.leader else f"mode{self.suffix}"


@dataclass(frozen=True)
class Stop:
    """Laws of a rigid stop: an edge whose stretch never exceeds a limit.

    Within its limits through is zero. At a limit it keeps the rate of across zero, as long as it
    does not pull. The laws take the arguments of those of a :class:`Terminal`.
    """

    #: The gap to each limit; None if there is none on that side.
    upper_gap: Law | None
    lower_gap: Law | None
    rebound: Law  # the change of across in an impact
    excess: Law  # the rebound speed in excess of the rest threshold
    suffix: str = ""  # the suffix of its modes among the fields


@dataclass(frozen=True)
class Terminal:
    """The terminal equation of one port.

    Laws are functions of ``across`` and ``through`` of the port itself, ``across_<port>`` and
    ``through_<port>`` of the component's other ports (by name, or by number from 0 on),
    ``potential_head`` and ``potential_tail`` of its nodes, ``stretch`` for its integral, ``t``, and
    the fields of the component.
    Through variables flow from the head to the tail inside the element, so that across times
    through is the power that it takes up.
    """

    domain: str  # the graph of the port's edge
    kind: Kind  # its kind in the normal tree
    port: str = ""  # its name; empty if the component has one port only
    #: The across variable, explicitly; for storages of through, the term besides ``inertance *
    #: rate``.
    across: Law | None = None
    #: The through variable, explicitly; for storages of across, the term besides ``capacity *
    #: rate``.
    through: Law | None = None
    #: Capacity or inertance of a storage; of a spring whose law is linear in ``stretch``, the
    #: increase of through for a unit of stretch.
    storage: Law | None = None
    #: Of a storage by content: the content as a function of the variable that is the state of its
    #: kind, of its siblings' and of fields: charge of voltage, flux linkage of current, volume of
    #: pressure. Its rate plus ``through`` or ``across`` is the other variable; there is no
    #: ``storage`` then.
    content: Law | None = None
    #: Whether linear equations of it are symmetric and positive definite.
    is_passive: bool = True
    #: Of a component whose ports share nodes: the terminals at head and tail. ``ground`` is one;
    #: other names are those of nodes within the component.
    between: tuple[str, str] = ("", "")
    #: The quantity ``stretch``; the integral of across if the domain has a name for it.
    integral: Integral | None = None
    #: Whether its tail must be the ground, to which motion and concentrations refer.
    is_absolute: bool = False
    #: Of dry friction: its laws. The field ``mode``, which :mod:`cotree.scene.unilateral` adds,
    #: selects one.
    friction: Friction | None = None
    #: Of a rigid stop: its laws. The field ``mode``, which :mod:`cotree.scene.unilateral` adds, is
    #: zero if it is open.
    stop: Stop | None = None
    touch: Touch | None = None  # of a contact of two bodies: the direction along which it acts


_ACROSS = Law.field("across")


def integral_of(terminal: Terminal) -> Integral | None:
    """Return the quantity ``stretch`` of a terminal equation; None if it has no name."""
    row = DOMAINS[terminal.domain]
    if terminal.touch is not None and terminal.touch.quantity != "gap":
        return None  # slip distances are not functions of positions
    # A component's own integral (a state of charge) takes precedence over that of the domain.
    if terminal.integral is not None or not row.stretch:
        return terminal.integral
    return Integral(row.stretch, row.stretch_unit, _ACROSS)


def content_of(terminal: Terminal) -> tuple[str, str] | None:
    """Return symbol and unit of the content of a storage by content; None for all others."""
    if terminal.content is None:
        return None
    row = DOMAINS[terminal.domain]
    return row.content if terminal.kind is Kind.ACROSS_STORAGE else row.impulse
