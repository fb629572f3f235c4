"""Sentences in which an integration reports its outcome.

In: a ``Problem`` and its ``Trajectory``. Out: the trajectory, whose message names the state. No run
is stopped by what is said here: budgets and values that are not finite end it.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.codegen.statuses import SENTENCES
from cotree.errors import listed
from cotree.solvers.augmented import RTOL_FLOOR, tested_rtol
from cotree.solvers.callbacks import Rescue
from cotree.tolerances import LIMITS

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from cotree.equations import EventRow
    from cotree.solvers.job import Job
    from cotree.solvers.problem import Problem
    from cotree.solvers.result import FloatArray, Trajectory


#: Reason given where a method stops because its steps no longer change t.
ROUNDING_LEVEL = SENTENCES["STEP_TOO_SMALL"]

# Where the spacing of floating-point times exceeds this share of the span, it may be too coarse.
_FINE = 1e-12

# Rates without a value made the steps short if they lie ahead within this share of the elapsed
# time; at the start, within the square of this share of the span.
_SOON = 1e-3


def summary(problem: Problem, method: str, t: float, reason: str) -> list[str]:
    """Describe in sentences where a method arrived, or why it stopped, and with which tolerance.

    Parameters
    ----------
    problem : Problem
        The problem.
    method : str
        The method that ran.
    t : float
        The last time that it reached, [s].
    reason : str
        The reason why it stopped early, without a capital and a full stop; or empty.
    """
    sentences = [f"{method} reached t = {t:.10g}."]
    if reason:
        end = problem.settings.t_span[1]
        sentences = [f"{method} stopped at t = {t:.10g} of {end:.10g}: {reason}."]
    if reason == ROUNDING_LEVEL:
        sentences.append(_rounding_of_time(problem, t))
    rtol = tested_rtol(problem)
    if rtol > problem.settings.rtol:
        sentences.append(
            f"rtol = {problem.settings.rtol:.3g} is below what double precision can test; "
            f"{RTOL_FLOOR:.3g} was used."
        )
    return [sentence for sentence in sentences if sentence]


def stiffness_note(job: Any) -> str:
    """Describe what an explicit method found out about stiffness; empty where that is nothing."""
    if not (job.is_stiff and job.n_stiff_steps > LIMITS.most_stiff_steps):
        return ""
    return (
        f"The problem is stiff from t = {float(job.stiff_since):.6g} on: about "
        f"{int(job.n_stiff_steps)} steps were as short as stability asks, and a method for "
        "stiff problems such as rodas5 may take far fewer."
    )


def undefined_ahead(problem: Problem, t: float, z: FloatArray) -> str:
    """Describe why rates have no value just beyond the point where a method stopped; else empty.

    C reports that the rates fail, but not why: they are evaluated here along the tangent of the
    motion from (t, z), the last good point.
    """
    if problem.undefined is None or problem.state_rhs is None:
        return ""
    start, end = problem.settings.t_span
    y = np.array(z[: problem.n_states])
    why = _undefined(problem, t, y)
    if why:
        return why
    rates = np.array(problem.state_rhs(t, y))
    # Entries of algebraic unknowns are residuals, not rates: the unknowns stay where they are.
    rates[problem.n_states - problem.n_algebraic :] = 0.0
    reach = min(abs(end - t), _SOON * max(abs(t - start), _SOON * abs(end - start)))
    # Distances grow fourfold from a few units in the last place, so the nearest fault is found.
    step = 4.0 * float(np.spacing(max(abs(t), float(np.finfo(np.float64).tiny))))
    while step <= reach and not why:
        ahead = math.copysign(step, end - start)
        why = _undefined(problem, t + ahead, y + ahead * rates)
        step *= 4.0
    return why


def _undefined(problem: Problem, t: float, y: FloatArray) -> str:
    """Describe why rates, or the algebraic unknowns in them, have no value at a point."""
    assert problem.undefined is not None  # or nobody would have asked
    why = problem.undefined(t, y)
    if why or not problem.n_algebraic:
        return why
    rescue = Rescue(problem)
    return "" if rescue.find_unknowns(t, y) else rescue.complaint


def _rounding_of_time(problem: Problem, t: float) -> str:
    """Report that rounding of a large t, not the motion, made steps short; empty otherwise."""
    spacing, (start, end) = float(np.spacing(abs(t))), problem.settings.t_span
    if spacing <= _FINE * abs(end - start):
        return ""
    return (
        f"Near t = {t:.17g} times are {spacing:.2g} s apart, too far for the steps that are "
        "needed: let the run begin nearer to t = 0."
    )


def singular_positions(problem: Problem, job: Job, *, has_failed: bool) -> list[str]:
    """Return sentences on the singular positions that a job crossed, or at which it failed."""
    if problem.singular is None:
        return []
    sentences = []
    lost = problem.singular(float(job.job.t), job.z) if has_failed else ()
    if lost:
        sentences.append(
            f"There the constraints of {_quoted(lost)} nearly lose rank, which enlarges rounding, "
            "most of all in sensitivities: loosen rtol."
        )
    crossings = job.crossings
    if crossings:
        places = ", ".join(f"{t:.6g}" for t, _ in crossings[:4])
        more = ", ..." if len(crossings) > 4 else ""
        names = dict.fromkeys(name for t, y in crossings for name in problem.singular(t, y))
        sentences.append(
            f"Singular configurations were crossed with a looser tolerance after t = {places}"
            f"{more}: there the constraints of {_quoted(names)} lose rank."
        )
    return sentences


def _quoted(names: Iterable[str]) -> str:
    return listed(f"'{name}'" for name in names)


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
        "when, depends on the side: start away from the jump, or let a mode of your own hold what "
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
    "EVENTS_LEAVES_ROOT": (
        "at t = {t:.10g} the argument of a root rests at zero, and the root, whose slope is "
        "infinite there, drives it away: when it leaves is not unique; start away from zero, or "
        "write a law with a finite slope there"
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

#: Sentences that name edges.
_OF_EDGES = (
    *("EVENTS_NO_MODES", "EVENTS_LOCKED_DIRECTION", "EVENTS_NO_IMPULSES", "EVENTS_NEGATIVE_GAP"),
    *("EVENTS_ENERGY_GAIN", "EVENTS_NOT_UNIQUE", "EVENTS_INDETERMINATE", "EVENTS_LOSSY_IMPACT"),
)

#: What the names of events of friction and stops say of their edges.
_EDGE = re.compile(r" (stops|turns its load|rests|hits|hits upper|hits lower)$")


def blamed(name: str, event: str, fired: Sequence[str]) -> Sequence[str]:
    """List what a sentence of :data:`VERDICTS` names: events, or edges with dry friction."""
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
    """Name the rigid stops that an impact has brought to rest by their rule; empty if none.

    ``records`` are those of :attr:`cotree.solvers.result.Trajectory.events`.
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
    """Return the sentence of :data:`VERDICTS` that says why events end a run."""
    listed = ", ".join(f"'{event}'" for event in events)
    return VERDICTS[name].format(event=listed, t=t, detail=detail)


# The share of the elapsed time that counts as the beginning, and the one that counts as the end.
_EARLY, _LATE = 0.1, 0.9

# Growth by less than this has other reasons: in ten times the time a steady motion covers ten times
# the way, and an accelerated one a hundred times.
_LEAST = 1e3

# Nor does what grows more slowly than this power of time, as counts and angles do: an exponential
# that has grown a thousandfold grows as the power of 7.7 at its end.
_LEAST_POWER = 7.0

# Unknowns whose determinant is formed, and those that a message names; how far aside it is formed.
_MOST_UNKNOWNS, _MOST_NAMED, _ASIDE = 50, 4, 1e-3


def with_growth(problem: Problem, trajectory: Trajectory) -> Trajectory:
    """Add to the message of a run that stopped early which state grows, or that a fold ended it."""
    if trajectory.status == 0:
        return trajectory
    said = growth(problem, trajectory) or fold(problem, trajectory)
    if not said:
        return trajectory
    return replace(trajectory, message=f"{trajectory.message} {said}")


def fold(problem: Problem, trajectory: Trajectory) -> str:
    """Report a fold of the algebraic equations where a run ended early, as a sentence, or empty.

    Two solutions meet at a fold, and none goes on: the determinant of the derivatives by the
    unknowns has different signs on either side of it.
    """
    m, n = problem.n_algebraic, problem.n_states
    if not (0 < m <= _MOST_UNKNOWNS and trajectory.t.size) or problem.jacobian is None:
        return ""
    t, y = float(trajectory.t[-1]), trajectory.z[:n, -1].copy()
    signs = set()
    # A kink may be near rather than at the last point.
    for i in range(n - m, n):
        for aside in (-_ASIDE, _ASIDE):
            there = y.copy()
            there[i] += aside * max(abs(y[i]), float(problem.state_atol[i]))
            slopes = np.asarray(problem.jacobian(t, there))[n - m :, n - m :]
            if not np.all(np.isfinite(slopes)):
                return ""
            signs.add(float(np.linalg.slogdet(slopes)[0]))
    if len(signs) < 2:
        return ""
    unknowns = listed(f"'{name}'" for name in list(problem.names[n - m : n])[:_MOST_NAMED])
    return (
        f"The algebraic equations have a fold at t = {t:.6g}: two of their solutions for "
        f"{unknowns} meet there, and none goes on. Let a mode switch there by events, or put a "
        "storage, such as a small capacitor, into the loop."
    )


def growth(problem: Problem, trajectory: Trajectory) -> str:
    """Name the state that has grown most, as a sentence; empty where none has grown much.

    A state has grown if it has left the range of the first tenth of the run a thousandfold, is as
    large as ever in the last one, and grows there faster than any power of time below the seventh.
    The range is at least the size below which the absolute tolerance decides.
    """
    n, start = problem.n_states, float(problem.settings.t_span[0])
    if not trajectory.t.size or not n:
        return ""
    # The start may not be among the times that were asked for.
    t = np.abs(np.concatenate([[start], trajectory.t]) - start)
    y = np.abs(np.column_stack([problem.z0[:n], trajectory.z[:n]]))
    early, late = t <= _EARLY * t[-1], t >= _LATE * t[-1]
    with np.errstate(all="ignore"):
        floor = problem.state_atol / problem.settings.rtol
        # The unknowns that the run began with may have been guesses.
        ranges = np.maximum(np.max(y[:, early], axis=1), floor)
        ranges[n - problem.n_algebraic :] = np.inf
        last, most = np.max(y[:, late], axis=1), np.max(y, axis=1)
        # The power of time by which each grows at the end, and has grown since the last time before
        # the last tenth: what swings may be at rest at the end.
        rate = (problem.state_rhs or problem.rhs)(float(trajectory.t[-1]), trajectory.z[:, -1])[:n]
        power = problem.direction * t[-1] * np.asarray(rate) / trajectory.z[:n, -1]
        before = np.flatnonzero(~late)
        if before.size and t[before[-1]] > 0.0:
            size = np.maximum(np.max(y[:, before], axis=1), floor)
            power = np.fmax(power, np.log(last / size) / np.log(t[-1] / t[before[-1]]))
        is_growing = (last >= most) & (power >= _LEAST_POWER)
        factors = np.where(is_growing, last / ranges, 0.0)
    worst = int(np.argmax(factors))
    if not factors[worst] >= _LEAST:
        return ""
    since = start + _left(problem.direction, t, y[worst], ranges[worst])
    name = f"'{problem.names[worst]}'" if problem.names else f"State {worst}"
    return (
        f"{name} grows without bound: since t = {since:.4g} it has left the range of its beginning "
        f"and reached {last[worst]:.3g}, {factors[worst]:.2g} times as much; look at the signs of "
        "what feeds it."
    )


def _left(direction: float, t: FloatArray, y: FloatArray, largest: float) -> float:
    """Return the time, from the start on, at which a value last was within its first range."""
    return direction * float(t[np.flatnonzero(y <= largest)[-1]])
