"""Reasons why events end a run: sentences without a capital and a full stop."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from cotree.codegen.statuses import EVENT_STATUSES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.equations import EventRow
    from cotree.solvers.base import FloatArray

#: The sentences by the name of the status, or of what ends a run without a failure: ``t`` is the
#: time, ``detail`` a further time, a duration or a count.
VERDICTS = {
    "EVENTS_NOT_FINITE": "what event {event} looks at is not finite",
    "EVENTS_SET_NOT_FINITE": "what event {event} sets is not finite",
    "EVENTS_CONTRADICT": "what event {event} sets contradicts the constraints",
    "EVENTS_UNDERDETERMINED": (
        "event {event} sets fewer states than the constraints leave free, so the others follow by"
        " a choice that sensitivities do not know of: set as many as there are degrees of "
        "freedom, or use an impact"
    ),
    "EVENTS_REST_AT_ZERO": (
        "event {event} at t = {t:.10g} leaves no speed away from zero, and the motion goes on "
        "through it: let a mode hold what comes to rest, or stop there"
    ),
    "EVENTS_GRAZING": (
        "event {event} grazes at t = {t:.10g}: what it looks at only just touches zero, to within "
        "the tolerances, and nothing there has sensitivities; where it is never much larger than "
        "atol, give a smaller atol, else change a parameter, or compile without sensitivities"
    ),
    "EVENTS_ACCUMULATE": (
        "event {event} happens ever faster and accumulates at t = {detail:.10g}: let a mode hold "
        "what comes to rest, or stop there"
    ),
    "EVENTS_CHATTER": (
        "event {event} happened 100 times within {detail:.3g} s before t = {t:.10g}: let a mode "
        "hold what chatters"
    ),
    "EVENTS_CASCADE": (
        "events {event} make each other happen without end at t = {t:.10g}: let a mode hold what "
        "chatters"
    ),
    "EVENTS_SLIDING": (
        "{event} at t = {t:.10g}: from either side the motion is driven back to where this jumps,"
        " so it neither crosses nor leaves; write a law that does not jump there (tanh for sign),"
        " or let a mode of your own hold what sticks"
    ),
    "EVENTS_LEAVES_JUMP": (
        "{event} at t = {t:.10g}: what rested where this jumps leaves there, and which way, and "
        "when, depends on the side: begin aside of the jump, or let a mode of your own hold what "
        "sticks"
    ),
    "EVENTS_NOT_COMMUTING": (
        "{event} and others jump at once at t = {t:.10g}, and what follows depends on which comes"
        " first, so nothing has sensitivities there: change a parameter, or compile without "
        "sensitivities"
    ),
    "EVENTS_NO_MODES": (
        "at t = {t:.10g} the dry friction or rigid stops of {event} have no modes that agree with "
        "each other: whichever of them hold, a force passes its limit or a motion goes against it; "
        "look for friction that is less at rest than sliding, and for forces that follow friction"
    ),
    "EVENTS_INDETERMINATE": (
        "at t = {t:.10g} {event} would stick beside a gear that holds the same motion: what the "
        "gear loses depends on how they share the force, which nothing decides; let the gear be "
        "ideal, or put an elastic shaft between them"
    ),
    "EVENTS_NEGATIVE_GAP": (
        "{event} begins at t = {t:.10g} beyond its limit: let it begin within, or at the limit"
    ),
    "EVENTS_NO_IMPULSES": (
        "at t = {t:.10g} the impact at {event} has no impulses that agree with each other: "
        "whichever of them act, one pulls or a gap closes further"
    ),
    "EVENTS_COUPLED_IMPACTS": (
        "{event} at t = {t:.10g} happens together with another impact that changes its speed, and "
        "what follows depends on which comes first, so nothing has sensitivities there: change a "
        "parameter, or compile without sensitivities"
    ),
    "EVENTS_ENERGY_GAIN": (
        "the impact at {event} at t = {t:.10g} would leave more energy than there was, as Newton's "
        "law of impact may with friction: give a smaller restitution"
    ),
    "EVENTS_NOT_UNIQUE": (
        "at t = {t:.10g} the contact {event} may hold or let go: with friction as strong as this "
        "more than one motion agrees with the laws (Painleve's paradox), so that none is chosen"
    ),
    "EVENTS_LOSSY_IMPACT": (
        "at t = {t:.10g} an impact passes the gear with losses {event}, whose laws are those of "
        "steady forces: let the gear be ideal, or put an elastic shaft between it and the stop"
    ),
    "EVENTS_BELOW_TOLERANCE": (
        "{event} at t = {t:.10g}: impacts follow each other faster and faster, and have become "
        "too small for the tolerances; give a larger rest_speed, or smaller tolerances"
    ),
    "EVENTS_LOCKED_DIRECTION": (
        "{event} turns at t = {t:.10g} the way that it locks, which takes an impact: let it start "
        "at a relative speed of zero or more, and put an elastic shaft between it and a rigid stop"
    ),
    "spends": "the limit of {detail:g} events is reached",
    "stops": "event {event} ends the run",
    "EVENTS_FAILED": "the equations of the events cannot be evaluated at t = {t:.10g}",
}

#: Impacts that a message lists.
_MOST_RESTS = 3

#: Names by the results of C.
BY_STATUS = {row.number: row.name for row in EVENT_STATUSES}


#: Sentences that name edges.
_OF_EDGES = (
    *("EVENTS_NO_MODES", "EVENTS_LOCKED_DIRECTION", "EVENTS_NO_IMPULSES", "EVENTS_NEGATIVE_GAP"),
    *("EVENTS_ENERGY_GAIN", "EVENTS_NOT_UNIQUE", "EVENTS_INDETERMINATE", "EVENTS_LOSSY_IMPACT"),
)

#: What the names of events of friction and stops say of their edges.
_EDGE = re.compile(r" (stops|turns its load|rests|hits|hits upper|hits lower)$")


def blamed(name: str, event: str, fired: Sequence[str]) -> Sequence[str]:
    """List what a sentence names: events, or edges with dry friction.

    Parameters
    ----------
    name : str
        A name in :data:`VERDICTS`.
    event : str
        The event where it failed.
    fired : sequence of str
        Those that happened at that time.
    """
    are_many = (
        "EVENTS_CASCADE",
        "EVENTS_SLIDING",
        "EVENTS_NO_MODES",
        "EVENTS_NO_IMPULSES",
        "EVENTS_INDETERMINATE",
    )
    listed = fired if name in are_many else [event]
    if name not in _OF_EDGES:
        return listed
    # Names of edges may hold blanks; the words after them do not vary.
    return [_EDGE.sub("", row) for row in listed]


def rest_note(rows: Sequence[EventRow], records: FloatArray) -> str:
    """Describe which rigid stops an impact has brought to rest by their rule; empty where none.

    Parameters
    ----------
    rows : sequence of EventRow
        The events.
    records : ndarray, shape (n_records, n)
        What happened; see :attr:`cotree.solvers.base.Trajectory.events`.
    """
    listed = [
        f"'{_EDGE.sub('', rows[int(i)].name)}' at t = {t:.10g}"
        for t, i in records[:, :2].tolist()
        if rows[int(i)].is_rest
    ]
    if not listed:
        return ""
    more = len(listed) - _MOST_RESTS
    shown = ", ".join(listed[:_MOST_RESTS]) + (f" and {more} more" if more > 0 else "")
    return f"Impacts ended in rest, slower than rest_speed: {shown}."


def verdict(name: str, events: Sequence[str], t: float = 0.0, detail: float = 0.0) -> str:
    """Return the sentence that says why events end a run.

    Parameters
    ----------
    name : str
        A name in :data:`VERDICTS`.
    events : sequence of str
        Names of the events.
    t, detail : float
        See :data:`VERDICTS`, [s].
    """
    listed = ", ".join(f"'{event}'" for event in events)
    return VERDICTS[name].format(event=listed, t=t, detail=detail)
