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

    ACROSS_SOURCE = 0  # prescribes an across variable; always a branch
    ACROSS_STORAGE = 1  # capacitors, tanks, masses: through = capacity * rate of across
    COUPLED = 2  # coupled: a port of a transformer or gyrator
    DISSIPATOR = 3  # resistors: algebraic relation of through and across
    THROUGH_STORAGE = 4  # inductors: across = inertance * rate of through
    SPRING = 5  # through depends on the integral of across; a branch only among springs
    THROUGH_SOURCE = 6  # prescribes a through variable; always a chord
    NULLATOR = 7
    NORATOR = 8
    FRICTION = 9  # dry friction: sticks, or slides by a law; always a chord
    STOP = 10  # a rigid stop: through keeps it closed, or is zero if open; always a chord

    @property
    def may_hold(self) -> bool:
        """Return whether a mode may keep the edge's across variable zero."""
        return self in (Kind.FRICTION, Kind.STOP)


@dataclass(frozen=True)
class Integral:
    """A quantity of a port that its terminal equation, its fields or outputs may use: a state."""

    #: The name of the state is ``edge.name``.
    name: str
    unit: str
    rate: Law  # law of the state's rate


@dataclass(frozen=True)
class PortMeasure:
    """A sum of variables of a component's ports that outputs and fields may name."""

    #: The name of the variable is ``edge.name``.
    name: str
    unit: str
    terms: tuple[tuple[int, str, str], ...]  # sign, ``across`` or ``through``, and port


@dataclass(frozen=True)
class Touch:
    """The direction of a port of a contact, at one of the points that may touch."""

    spot: int  # index of the contact point, from 0 on
    #: Measure of the port: ``gap``; ``slip1`` or ``slip2``, one of two perpendicular directions of
    #: slip; ``part1`` to ``part3``, a component of an axis tangential to a ball; ``spin1`` to
    #: ``spin3``, an axis of the first node of a spherical joint.
    quantity: str


@dataclass(frozen=True)
class Friction:
    """Laws of an edge that sticks, slides forwards, slides backwards, or is disengaged.

    While it sticks, the rate of across is zero, and through takes the value that keeps it so, as
    long as that stays between two limits. All laws take the arguments of those of a
    :class:`Terminal`.
    """

    #: Law of the through variable while across is positive, and while it is negative.
    forward: Law
    backward: Law
    #: The limits of through while friction sticks; beyond them it starts to slide forwards or
    #: backwards. None if it never slides in that direction.
    upper: Law
    lower: Law | None
    #: Positive while friction is engaged; otherwise through is zero. None if friction is always
    #: engaged.
    grip: Law | None = None
    #: Value whose sign is the argument ``side`` of the sliding laws, which are continuous at its
    #: zero.
    load: Law | None = None
    #: Port of the same component whose rigid stop provides the normal force. Friction is
    #: disengaged while the stop is open, and takes part in its impacts. Empty if there is none.
    presser: str = ""
    suffix: str = ""  # suffix of its modes among the fields
    #: For the second direction of friction on a plane: the port of the first direction, which has
    #: the mode of both. The magnitude of the two forces together is limited.
    leader: str = ""
    #: For the first direction of friction on a plane: the port of the second one.
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

    #: The gap at each limit; None if that limit is absent.
    upper_gap: Law | None
    lower_gap: Law | None
    rebound: Law  # change of across in an impact
    excess: Law  # rebound speed minus the rest threshold
    suffix: str = ""  # suffix of its modes among the fields


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

    domain: str  # domain of the graph that contains the port's edge
    kind: Kind  # kind of the port in the normal tree
    port: str = ""  # name of the port; empty if the component has only one port
    #: Explicit law of the across variable; for through storages, the term in addition to
    #: ``inertance * rate``.
    across: Law | None = None
    #: Explicit law of the through variable; for across storages, the term in addition to
    #: ``capacity * rate``.
    through: Law | None = None
    #: Capacity or inertance of a storage; for a spring whose law is linear in ``stretch``, its
    #: stiffness.
    storage: Law | None = None
    #: For a storage given by its content: the content as a function of the variable that is the
    #: state of its kind, of those of its siblings and of fields. Examples are charge of voltage,
    #: flux linkage of current, volume of pressure. The rate of the content plus ``through`` or
    #: ``across`` is the other variable; ``storage`` is then None.
    content: Law | None = None
    #: Whether the linear equations of the terminal are symmetric and positive definite.
    is_passive: bool = True
    #: If ports of the component share nodes: the terminals at head and tail. ``ground`` is the
    #: reference; other names are nodes inside the component.
    between: tuple[str, str] = ("", "")
    #: State ``stretch``: by default the integral of across, if the domain has a name for it.
    integral: Integral | None = None
    #: Whether the tail must be the ground, the reference of motion and concentrations.
    is_absolute: bool = False
    #: Laws of dry friction. The field ``mode``, which :mod:`cotree.scene.unilateral` adds,
    #: selects one.
    friction: Friction | None = None
    #: Laws of a rigid stop. The field ``mode``, which :mod:`cotree.scene.unilateral` adds, is
    #: zero if the stop is open.
    stop: Stop | None = None
    touch: Touch | None = None  # for a contact of two bodies: the direction in which the port acts


_ACROSS = Law.field("across")


def integral_of(terminal: Terminal) -> Integral | None:
    """Return the quantity ``stretch`` of a terminal equation; None if it has no name."""
    row = DOMAINS[terminal.domain]
    if terminal.touch is not None and terminal.touch.quantity != "gap":
        return None  # slip distances are not determined by positions
    # An integral of the component itself, such as a state of charge, takes precedence over that of
    # the domain.
    if terminal.integral is not None or not row.stretch:
        return terminal.integral
    return Integral(row.stretch, row.stretch_unit, _ACROSS)


def content_of(terminal: Terminal) -> tuple[str, str] | None:
    """Return symbol and unit of the content of a storage by content; None for all others."""
    if terminal.content is None:
        return None
    row = DOMAINS[terminal.domain]
    return row.content if terminal.kind is Kind.ACROSS_STORAGE else row.impulse
