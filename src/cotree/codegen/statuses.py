"""Endings of jobs in C: one table for C's headers and main programs, and for messages in Python."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True)
class Status:
    """One way to end.

    Attributes
    ----------
    name : str
        In C, after ``COTREE_``.
    number : int
        Its value there.
    sentence : str
        The event in words, without a capital and a full stop.
    meaning : str
        A remark that the header adds; may be empty.
    """

    name: str
    number: int
    sentence: str
    meaning: str = ""


#: Endings of integrators and jobs: ``cotree_status``.
STATUSES = (
    Status("OK", 0, "all is well"),
    Status("BAD_ARGUMENT", 1, "a size, time, tolerance or initial value is out of range"),
    Status(
        "TOO_MANY_STEPS",
        2,
        "too many steps are needed",
        "max_steps were tried in one call of integrate",
    ),
    Status(
        "STEP_TOO_SMALL",
        3,
        "the step size fell to rounding level",
        "the tolerances ask for steps below the resolution of t",
    ),
    Status("RATE_FAILED", 4, "the right-hand side fails", "however small the step"),
    Status("RATE_NOT_FINITE", 5, "the right-hand side is not finite", "however small the step"),
    Status(
        "RATE_STOPPED",
        6,
        "the right-hand side stopped the integration",
        "it returned a negative number",
    ),
    Status(
        "PROJECTION_FAILED",
        7,
        "the projection onto the constraints fails, or moves a step by many tolerances",
        "however small the step",
    ),
    Status("NO_MEMORY", 8, "SUNDIALS got no memory"),
    Status("NOT_FINITE", 9, "the solution is no longer finite"),
    Status("NOT_SOLVED", 10, "the algebraic unknowns cannot be solved for", "or what needs them"),
    Status("NOT_PROJECTED", 11, "the constraints cannot be met", "where a point is kept"),
    Status("CANNOT_START", 12, "it cannot start"),
    Status("TOO_TIGHT", 13, "the tolerances are too tight for double precision"),
    Status(
        "ERROR_TEST_FAILED",
        14,
        "the error test fails again and again, or the step size fell to its least",
    ),
    Status(
        "NOT_CONVERGED",
        15,
        "Newton's method fails again and again, or the step size fell to its least",
    ),
    Status("SENSITIVITIES_FAILED", 16, "the rates of sensitivities fail"),
    Status("FLAGGED", 17, "the integrator gives a flag of its own"),
)

#: Failures of events, in ``cotree_events_status``. Python says more of them, by their names, in
#: :mod:`cotree.solvers.event_messages`.
EVENT_STATUSES = (
    Status(
        "EVENTS_FAILED",
        20,
        "its equations cannot be evaluated",
        "a kernel or an algebraic equation",
    ),
    Status("EVENTS_NOT_FINITE", 21, "what it looks at is not finite"),
    Status("EVENTS_SET_NOT_FINITE", 22, "what it sets is not finite"),
    Status("EVENTS_CONTRADICT", 23, "what it sets contradicts the constraints"),
    Status("EVENTS_CHOOSE", 24, "what it sets leaves a choice, which has no sensitivities"),
    Status(
        "EVENTS_REST", 25, "it leaves no speed away from zero, and the motion goes on through it"
    ),
    Status("EVENTS_GRAZE", 26, "it only just touches zero, where nothing has sensitivities"),
    Status(
        "EVENTS_ACCUMULATE",
        27,
        "it happens ever faster, and accumulates",
        "at the time detail",
    ),
    Status(
        "EVENTS_CHATTER",
        28,
        "it happens too often: it chatters",
        "CROWD times within detail seconds",
    ),
    Status(
        "EVENTS_ENDLESS",
        29,
        "it and others make each other happen without end",
        "has_fired tells which",
    ),
    Status(
        "EVENTS_SLIDE",
        40,
        "what jumps is driven back to the jump from either side",
        "the same, of jumps inside expressions",
    ),
    Status("EVENTS_LEAVE", 41, "what rested at the jump leaves it, to either side"),
    Status("EVENTS_PART", 42, "jumps at once have no derivative, since either may come first"),
    Status(
        "EVENTS_MODES",
        43,
        "no modes of dry friction and rigid stops agree with each other",
        "has_fired tells whose",
    ),
    Status(
        "EVENTS_SHARED",
        51,
        "how friction that sticks shares forces is open, though losses depend on it",
        "has_fired tells whose",
    ),
    Status("EVENTS_BACKWARD", 44, "a one-way clutch turns the way that it locks"),
    Status("EVENTS_BEYOND", 45, "a rigid stop begins beyond its limit"),
    Status(
        "EVENTS_IMPACT",
        46,
        "no impulses of rigid stops agree with each other",
        "has_fired tells whose",
    ),
    Status(
        "EVENTS_TOGETHER",
        47,
        "gaps that close at once act on each other, so that either order has other sensitivities",
    ),
    Status("EVENTS_GAINS", 49, "the impact would leave more energy than there was"),
    Status("EVENTS_SEVERAL", 50, "a contact may hold or let go: friction allows both"),
    Status("EVENTS_LOSSY", 52, "an impact passes a gear with losses, which has no law of impact"),
    Status("EVENTS_FAINT", 48, "its impacts are too small for the tolerance"),
)

#: A sensitivity that does not exist behind a corner; ``turned`` of the job says which one.
TURNED = 60

#: Numbers and sentences by name.
NUMBERS: Mapping[str, int] = {row.name: row.number for row in STATUSES}
SENTENCES: Mapping[str, str] = {row.name: row.sentence for row in STATUSES}
