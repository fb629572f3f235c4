"""Endings of jobs in C: one table for C's headers and main programs, and for messages in Python."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True)
class Status:
    """One way to end."""

    name: str  # in C, after ``COTREE_``
    number: int  # its value there
    sentence: str  # the event in words, without a capital and a full stop
    meaning: str = ""  # a remark that the header adds; may be empty


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
#: :mod:`cotree.solvers.messages`.
EVENT_STATUSES = (
    Status(
        "EVENTS_FAILED",
        20,
        "its equations cannot be evaluated",
        "a kernel or an algebraic equation",
    ),
    Status("EVENTS_NOT_FINITE", 21, "its event function is not finite"),
    Status("EVENTS_SET_NOT_FINITE", 22, "its new values are not finite"),
    Status("EVENTS_CONTRADICT", 23, "its new values contradict the constraints"),
    Status(
        "EVENTS_UNDERDETERMINED",
        24,
        "its new values leave states undetermined, which have no sensitivities",
    ),
    Status(
        "EVENTS_REST_AT_ZERO",
        25,
        "it leaves no speed away from zero, and the motion goes on through it",
    ),
    Status("EVENTS_GRAZING", 26, "it only just touches zero, where nothing has sensitivities"),
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
        "COTREE_EVENT_CROWD times in detail seconds",
    ),
    Status(
        "EVENTS_CASCADE",
        29,
        "it and others trigger each other without end",
        "has_fired: the events",
    ),
    Status(
        "EVENTS_SLIDING",
        40,
        "the motion is driven to a jump from both sides, and slides along it",
        "CASCADE with jumps only",
    ),
    Status("EVENTS_LEAVES_JUMP", 41, "a value that rested at a jump leaves it to either side"),
    Status(
        "EVENTS_NOT_COMMUTING",
        42,
        "simultaneous jumps do not commute, so that no sensitivities exist",
    ),
    Status(
        "EVENTS_NO_MODES",
        43,
        "no modes of dry friction and rigid stops are consistent",
        "has_fired: their events",
    ),
    Status(
        "EVENTS_INDETERMINATE",
        51,
        "the forces of sticking friction are indeterminate, and losses depend on them",
        "has_fired: their events",
    ),
    Status("EVENTS_LOCKED_DIRECTION", 44, "a one-way clutch turns in its locked direction"),
    Status("EVENTS_NEGATIVE_GAP", 45, "a rigid stop begins beyond its limit"),
    Status(
        "EVENTS_NO_IMPULSES",
        46,
        "no impulses of rigid stops are consistent",
        "has_fired: their events",
    ),
    Status(
        "EVENTS_COUPLED_IMPACTS",
        47,
        "gaps that close simultaneously interact, so that sensitivities depend on their order",
    ),
    Status("EVENTS_ENERGY_GAIN", 49, "the impact would gain energy"),
    Status("EVENTS_NOT_UNIQUE", 50, "friction allows a contact both to stay closed and to open"),
    Status(
        "EVENTS_LOSSY_IMPACT", 52, "an impact passes a gear with losses, which has no law of impact"
    ),
    Status(
        "EVENTS_LEAVES_ROOT",
        53,
        "a value rests at zero, and a root with an infinite slope drives it away",
    ),
    Status("EVENTS_BELOW_TOLERANCE", 48, "its impacts are too small for the tolerance"),
)

#: A sensitivity that does not exist behind a corner; ``turned`` of the job says which one.
TURNED = 60

#: Numbers and sentences by name.
NUMBERS: Mapping[str, int] = {row.name: row.number for row in STATUSES}
SENTENCES: Mapping[str, str] = {row.name: row.sentence for row in STATUSES}
