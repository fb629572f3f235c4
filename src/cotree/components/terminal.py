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

    A nullator says that both of its variables are zero, a norator says nothing of either. Circuits
    are drawn with the nullator as a branch and the norator as a chord, cutsets the other way.
    """

    ACROSS_SOURCE = 0  # an across variable that is given; always a branch
    ACROSS_STORAGE = 1  # capacitors, tanks, masses: through = capacity * rate of across
    COUPLED = 2  # a port of a transformer or gyrator
    DISSIPATOR = 3  # resistors: through and across at the same instant
    THROUGH_STORAGE = 4  # inductors: across = inertance * rate of through
    SPRING = 5  # through by the integral of across; a branch only among its like
    THROUGH_SOURCE = 6  # a through variable that is given; always a chord
    NULLATOR = 7
    NORATOR = 8
    FRICTION = 9  # dry friction: a through variable that holds, or slides by a law; always a chord
    STOP = 10  # a rigid stop: a through variable that holds, or is zero; always a chord

    @property
    def may_hold(self) -> bool:
        """Whether modes decide if the edge holds its across variable."""
        return self in (Kind.FRICTION, Kind.STOP)


@dataclass(frozen=True)
class Integral:
    """A quantity of a port that its terminal equation, its fields or outputs may use: a state."""

    #: The state is called ``edge.name``.
    name: str
    unit: str
    rate: Law  # the law of its rate, whose integral over time it is


@dataclass(frozen=True)
class PortMeasure:
    """A sum of variables of a component's ports that outputs and fields may name."""

    #: It is called ``edge.name``.
    name: str
    unit: str
    terms: tuple[tuple[int, str, str], ...]  # signs, ``across`` or ``through``, and ports


@dataclass(frozen=True)
class Touch:
    """The direction that a port of a contact acts along, at one of the places that may touch."""

    spot: int  # the place, from 0 on
    quantity: str  # ``gap``; or ``slip1``, ``slip2``, ...: a direction in which it slides
    is_planar: bool = False  # whether its laws hold where everything moves in one plane


@dataclass(frozen=True)
class Friction:
    """Laws of an edge that sticks, slides forwards, slides backwards, or is disengaged.

    While it sticks, the rate of across is zero, and through is whatever keeps it so, as long as it
    stays between two limits. All laws take the arguments of those of a :class:`Terminal`.
    """

    #: The through variable while across is positive, and while it is negative.
    forward: Law
    backward: Law
    #: The limits of through while it sticks, beyond which it begins to slide forwards and
    #: backwards; None where it never slides to that side.
    upper: Law
    lower: Law | None
    #: Positive while it is engaged; through is zero otherwise. None where it always is.
    grip: Law | None = None
    #: What the laws of sliding change their form with: the argument ``side`` is its sign. They meet
    #: where it is zero.
    load: Law | None = None
    #: The port of the same component whose rigid stop presses it together: it is disengaged while
    #: that is free, and takes part in its impacts. Empty where there is none.
    presser: str = ""
    suffix: str = ""  # what the names of its modes among the fields end with


@dataclass(frozen=True)
class Stop:
    """Laws of a rigid stop: an edge whose stretch never passes a limit.

    Within its limits through is zero. At a limit it is whatever keeps the rate of across at zero,
    as long as it does not pull away from there. The laws take the arguments of those of a
    :class:`Terminal`.
    """

    #: What is left of stretch to each limit; None where there is none on that side.
    upper_gap: Law | None
    lower_gap: Law | None
    rebound: Law  # what an impact changes across by
    excess: Law  # the speed that an impact leaves, less that below which it leaves none
    suffix: str = ""  # what the names of its modes among the fields end with


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

    domain: str  # the graph that the port has its edge in
    kind: Kind  # its place in the normal tree
    port: str = ""  # its name; empty where the component has one port only
    #: The across variable, explicitly; for storages of through, what is added to ``inertance *
    #: rate``.
    across: Law | None = None
    #: The through variable, explicitly; for storages of across, what is added to ``capacity *
    #: rate``.
    through: Law | None = None
    #: Capacity or inertance of a storage; of a spring whose law is linear in ``stretch``, the
    #: increase of through for a unit of stretch.
    storage: Law | None = None
    #: Of a storage by content: what it holds as a function of the variable that a storage of its
    #: kind has as a state, of its siblings' and of fields: charge of voltage, flux linkage of
    #: current, volume of pressure. Its rate, with what ``through`` or ``across`` adds, is the other
    #: variable; there is no ``storage`` then.
    content: Law | None = None
    #: Whether linear equations made of it are symmetric and positive definite.
    is_passive: bool = True
    #: Of a component whose ports share nodes: the terminals at head and tail. ``ground`` is one; a
    #: name that is not that of a terminal stands for a node within the component.
    between: tuple[str, str] = ("", "")
    #: The quantity ``stretch``; the integral of across, where the domain has a name for it.
    integral: Integral | None = None
    #: Whether its tail must be the ground, where motion and concentrations are measured from.
    is_absolute: bool = False
    #: Of dry friction: its laws. Which of them holds is the field ``mode``, which
    #: :mod:`cotree.scene.unilateral` adds.
    friction: Friction | None = None
    #: Of a rigid stop: its laws. Whether it holds is the field ``mode``, which
    #: :mod:`cotree.scene.unilateral` adds.
    stop: Stop | None = None
    touch: Touch | None = None  # of a contact of two bodies: what it acts along


_ACROSS = Law.field("across")


def integral_of(terminal: Terminal) -> Integral | None:
    """Return the quantity ``stretch`` of a terminal equation; None where it has no name."""
    row = DOMAINS[terminal.domain]
    if terminal.touch is not None and terminal.touch.quantity != "gap":
        return None  # how far bodies have slid is no function of where they are
    # A component's own integral (a state of charge) goes before that of the domain.
    if terminal.integral is not None or not row.stretch:
        return terminal.integral
    return Integral(row.stretch, row.stretch_unit, _ACROSS)


def content_of(terminal: Terminal) -> tuple[str, str] | None:
    """Return symbol and unit of the content of a storage by content; None for all others."""
    if terminal.content is None:
        return None
    row = DOMAINS[terminal.domain]
    return row.content if terminal.kind is Kind.ACROSS_STORAGE else row.impulse
