"""Terminal equations, which relate the across and through variables of scalar components."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import partial

from cotree.components.law import Law, argument
from cotree.domains import DOMAINS


class Kind(Enum):
    """Kind of an edge; the normal tree prefers edges with lower values as branches.

    A nullator makes both of its variables zero; a norator restricts none. f-circuits use the
    nullator as a branch and the norator as a chord, and f-cutsets vice versa.
    """

    ACROSS_SOURCE = 0  # prescribes an across variable; always a branch
    ACROSS_STORAGE = 1  # capacitors, tanks, masses: through = capacity * rate of across
    COUPLED = 2  # a port of a transformer or gyrator
    DISSIPATOR = 3  # resistors: an algebraic relation of through and across
    THROUGH_STORAGE = 4  # inductors: across = inertance * rate of through
    SPRING = 5  # through depends on the integral of across; a branch only among springs
    THROUGH_SOURCE = 6  # prescribes a through variable; always a chord
    NULLATOR = 7
    NORATOR = 8
    FRICTION = 9  # dry friction, which sticks or slides; always a chord
    STOP = 10  # rigid stop, whose through variable is zero while it is open; always a chord

    @property
    def may_hold(self) -> bool:
        """Return whether a mode of the edge may keep its across variable zero."""
        return self in (Kind.FRICTION, Kind.STOP)


@dataclass(frozen=True)
class Integral:
    """A state that integrates a port's variable; equations, fields and outputs may use it."""

    #: In a scene, the state is called ``edge.name``.
    name: str
    unit: str
    rate: Law  # law of the state's rate


@dataclass(frozen=True)
class PortMeasure:
    """A named sum of port variables of a component, for use in outputs and fields."""

    #: In a scene, the variable is called ``edge.name``.
    name: str
    unit: str
    terms: tuple[tuple[int, str, str], ...]  # sign, then ``across`` or ``through``, then port


@dataclass(frozen=True)
class Touch:
    """Contact point and direction to which a port of a contact belongs."""

    spot: int  # index of the contact point, counted from 0
    #: What the port measures: ``gap``; ``slip1`` or ``slip2``, the slip along one of two
    #: perpendicular directions; ``part1`` to ``part3``, the slip on a ball along the tangential
    #: part of a coordinate axis; ``spin1`` to ``spin3``, the rotation about an axis of the first
    #: node of a spherical joint.
    quantity: str


@dataclass(frozen=True)
class Friction:
    """Laws of an edge that sticks, slides forwards, slides backwards, or is disengaged.

    While the edge sticks, its through variable keeps the rate of across zero and stays between two
    limits. Laws have the same arguments as those of a :class:`Terminal`.
    """

    #: Laws of the through variable for positive and for negative across.
    forward: Law
    backward: Law
    #: Limits of through while the edge sticks. Above the upper limit, it starts to slide forwards;
    #: below the lower limit, backwards. None if it never slides in that direction.
    upper: Law
    lower: Law | None
    #: Law that is positive while friction is engaged; else through is zero. None if always engaged.
    grip: Law | None = None
    #: Law whose sign is the argument ``side`` of the sliding laws, which are continuous at zero.
    load: Law | None = None
    #: Port of the same component whose rigid stop provides the normal force; empty without one.
    #: Friction is disengaged while the stop is open, and also acts in impacts at the stop.
    presser: str = ""
    suffix: str = ""  # suffix of the names of its mode fields
    #: For further friction directions: the port of the first direction. All have one mode, and the
    #: magnitude of the resultant force is limited.
    leader: str = ""
    #: For the first friction direction: the ports of the others, one on a plane, two in a ball.
    followers: tuple[str, ...] = ()

    @property
    def is_disc(self) -> bool:
        """Return whether the limit applies to the resultant of the forces in all directions."""
        return bool(self.leader or self.followers)

    @property
    def is_struck(self) -> bool:
        """Return whether an impulse may change the slip."""
        return bool(self.presser) or self.is_disc

    @property
    def mode(self) -> str:
        """Name of the field with the mode."""
        return f"mode_{self.leader}" if self.leader else f"mode{self.suffix}"


@dataclass(frozen=True)
class Stop:
    """Laws of a rigid stop: an edge whose stretch never exceeds a limit.

    Between the limits, through is zero. At a limit, through keeps the rate of across zero as long
    as the stop need not pull. Laws have the same arguments as those of a :class:`Terminal`.
    """

    #: Laws of the gap at each limit; None if the limit is absent.
    upper_gap: Law | None
    lower_gap: Law | None
    rebound: Law  # change of across in an impact
    excess: Law  # rebound speed minus the speed below which the stop stays closed
    suffix: str = ""  # suffix of the names of its mode fields


@dataclass(frozen=True)
class Terminal:
    """The terminal equation of one port.

    Laws are functions of ``across`` and ``through`` of the port itself, ``across_<port>`` and
    ``through_<port>`` of the component's other ports (by name, or by number counted from 0),
    ``potential_head`` and ``potential_tail`` of its nodes, ``stretch`` for its integral, ``t``, and
    the fields of the component.
    Through variables flow from the head to the tail inside the element, so that across times
    through is the power that it takes up.
    """

    domain: str  # domain of the graph that contains the port's edge
    kind: Kind  # kind of the port in the normal tree
    port: str = ""  # name of the port; empty if the component has only one port
    #: Explicit law of across; for a through storage, the term added to ``inertance * rate``.
    across: Law | None = None
    #: Explicit law of through; for an across storage, the term added to ``capacity * rate``.
    through: Law | None = None
    #: Capacity or inertance of a storage; stiffness of a spring that is linear in ``stretch``.
    storage: Law | None = None
    #: For a storage given by its content (charge as a function of voltage, flux linkage of current,
    #: volume of pressure): the content as a function of the port's state variable, of those of
    #: sibling ports, and of fields. The other variable is the rate of the content plus the law
    #: ``through`` or ``across``. ``storage`` is then None.
    content: Law | None = None
    #: Whether the linear equations of the component are symmetric and positive definite.
    is_passive: bool = True
    #: Terminals or inner nodes at head and tail if ports share nodes; ``ground`` is the reference.
    between: tuple[str, str] = ("", "")
    #: The state called ``stretch``; by default the integral of across, if its domain names this.
    integral: Integral | None = None
    #: Whether the tail must be the ground, which is the reference of motion and concentrations.
    is_absolute: bool = False
    #: Laws of dry friction; the field ``mode`` of :mod:`cotree.hybrid.unilateral` selects one.
    friction: Friction | None = None
    #: Laws of a rigid stop; the field ``mode`` of :mod:`cotree.hybrid.unilateral` is 0 if open.
    stop: Stop | None = None
    touch: Touch | None = None  # for a contact of two bodies: the direction in which the port acts


#: Terminal equation of a port of a component whose equations are not symmetric and definite.
active_port = partial(Terminal, is_passive=False)

_ACROSS = argument("across")


def integral_of(terminal: Terminal) -> Integral | None:
    """Return the state ``stretch`` of a port; None if its domain has no name for this integral."""
    row = DOMAINS[terminal.domain]
    if terminal.touch is not None and terminal.touch.quantity != "gap":
        return None  # slip distances do not follow from positions
    # An integral of the component, such as a state of charge, replaces that of the domain.
    if terminal.integral is not None or not row.stretch:
        return terminal.integral
    return Integral(row.stretch, row.stretch_unit, _ACROSS)


def content_of(terminal: Terminal) -> tuple[str, str] | None:
    """Return symbol and unit of a storage's content; None if no content defines the storage."""
    if terminal.content is None:
        return None
    row = DOMAINS[terminal.domain]
    return row.content if terminal.kind is Kind.ACROSS_STORAGE else row.impulse
