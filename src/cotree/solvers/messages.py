"""Messages on the outcome of an integration."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cotree.codegen.statuses import EVENT_FAILURES, NUMBERS, SENTENCES, TURNED
from cotree.errors import Error, listed
from cotree.model.kernels import SINGULAR
from cotree.solvers.guarded_calls import Evaluator, IntegrationStopError
from cotree.solvers.job import Rescue
from cotree.solvers.native import ROUNDING_LEVEL
from cotree.solvers.problem import describe_entry, turning
from cotree.solvers.result import BUDGET_SPENT

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from cotree.equations import EventRow
    from cotree.solvers.job import Job
    from cotree.solvers.problem import RunProblem
    from cotree.solvers.result import FloatArray, Trajectory


# Messages by the number of a status.
_SENTENCES = dict(enumerate(SENTENCES.values()))

# Undefined rates explain a failure if they occur soon after it: within this fraction of the elapsed
# time or, at the start, within the square of this fraction of the span.
_SOON = 1e-3


def failure(job: Job, problem: RunProblem) -> str:
    """Return the reason why a job failed."""
    c, status = job.job, int(job.job.status)
    if status in EVENT_FAILURES:
        return _event_reason(job, problem, EVENT_FAILURES[status])
    if status == TURNED:
        return turning(problem, float(c.t), int(c.turned))
    reasons = []
    if c.flag:
        known = status != NUMBERS["FLAGGED"]
        reasons = [f"SUNDIALS reports: {_SENTENCES[status] if known else f'flag {c.flag}'}"]
    elif status != NUMBERS["RATE_NOT_FINITE"] or c.entry < 0:
        reasons = [_SENTENCES.get(status, f"the integrator gives status {status}")]
    if c.kernel_status == SINGULAR and not problem.n_algebraic:
        reasons.append("a linear system of the model is singular within the next step")
    if c.row >= 0:
        of, by = describe_entry(problem, c.row), describe_entry(problem, c.column)
        reasons.append(f"the Jacobian entry of {of} and {by} is not finite within the next step")
    if c.entry >= 0:
        name = describe_entry(problem, int(job.places[c.entry]))
        reasons.append(f"the derivative of {name} is not finite within the next step")
    elif c.row < 0 and status in (NUMBERS["RATE_FAILED"], NUMBERS["RATE_NOT_FINITE"]):
        reasons += _fault_of_jacobian(job, problem)
    reason = "; ".join(reasons)
    # Steps become short if the rates are undefined beyond a point.
    why = undefined_ahead(problem, float(c.t), job.z)
    return f"{reason}: {why}" if why else reason


def _fault_of_jacobian(job: Job, problem: RunProblem) -> list[str]:
    """Return a message on a Jacobian entry that is not finite at the last point, if any."""
    if not job.has_newton or problem.n_algebraic:
        return []
    try:
        Evaluator(problem).state_jacobian(float(job.job.t), job.z)
    except (IntegrationStopError, Error) as error:
        return [str(error)]
    return []


def _event_reason(job: Job, problem: RunProblem, name: str) -> str:
    c = job.job
    # Kinks of laws are located like events but have no names.
    rows = problem.events.event_rows if problem.events is not None else ()
    fired = [row.name for i, row in enumerate(rows) if c.has_fired[i]]
    event = rows[c.event].name if c.event < len(rows) else "kink of a law"
    names = ", ".join(f"'{own}'" for own in subjects(name, event, fired))
    t, detail = float(c.event_time), float(c.event_detail)
    message = EVENT_MESSAGES[name].format(event=names, t=t, detail=detail)
    if name == "EVENTS_CONTRADICT" and c.event_detail >= 0.0:
        return f"{message}, '{problem.constraints[int(c.event_detail)]}' first of all"
    return f"{message} ({job.rescue.reason})" if job.rescue.reason else message


def notes_of(job: Job, problem: RunProblem, z: FloatArray, *, has_failed: bool) -> list[str]:
    """Return messages on impacts that ended at rest and, after a failure, on contacts that jam."""
    if problem.events is None:
        return []
    rested, jammed = rest_note(problem.events.event_rows, job.event_records), ""
    if has_failed and z.shape[1]:
        end = replace(problem.events, t=float(job.job.t))
        jammed = end.jammed(np.ascontiguousarray(z[:, -1]))
    return [row for row in (jammed, rested) if row]


def undefined_ahead(problem: RunProblem, t: float, z: FloatArray) -> str:
    """Return the reason why rates are undefined just after the last point, or an empty string.

    The rates are evaluated along the tangent of the motion from the last valid point (t, z).
    """
    if problem.undefined is None or problem.state_rhs is None:
        return ""
    start, end = problem.settings.t_span
    y = np.array(z[: problem.n_states])
    why = _undefined(problem, t, y)
    if why:
        return why
    rates = np.array(problem.state_rhs(t, y))
    # Algebraic unknowns are held constant, because their entries are residuals, not rates.
    rates[problem.n_states - problem.n_algebraic :] = 0.0
    reach = min(abs(end - t), _SOON * max(abs(t - start), _SOON * abs(end - start)))
    # The distance grows from a few ulps of t by factors of four, to find the nearest cause.
    step = 4.0 * float(np.spacing(max(abs(t), float(np.finfo(np.float64).tiny))))
    while step <= reach and not why:
        ahead = math.copysign(step, end - start)
        why = _undefined(problem, t + ahead, y + ahead * rates)
        step *= 4.0
    return why


def _undefined(problem: RunProblem, t: float, y: FloatArray) -> str:
    """Return why rates or algebraic unknowns are undefined at a point, or an empty string."""
    assert problem.undefined is not None  # checked by the caller
    why = problem.undefined(t, y)
    if why or not problem.n_algebraic:
        return why
    rescue = Rescue(problem)
    return "" if rescue.find_unknowns(t, y) else rescue.reason


def singular_positions(problem: RunProblem, job: Job, *, has_failed: bool) -> list[str]:
    """Return messages on the singular positions that a job crossed or at which it failed."""
    assert problem.singular is not None  # the problem has constraints
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


#: Messages by status name; ``t`` is the time, and ``detail`` a second time, a duration or a count.
EVENT_MESSAGES = {
    "EVENTS_NOT_FINITE": "the function of event {event} is not finite",
    "EVENTS_SET_NOT_FINITE": "a new value of event {event} is not finite",
    "EVENTS_CONTRADICT": "the new values of event {event} contradict the constraints",
    "EVENTS_UNDERDETERMINED": (
        "event {event} sets fewer states than the constraints leave free, and the choice of the "
        "others has no sensitivities: set as many as there are degrees of freedom, or use an impact"
    ),
    "EVENTS_REST_AT_ZERO": (
        "event {event} at t = {t:.10g} leaves no speed away from zero, and the motion continues "
        "through it: hold the resting motion by a mode, or make the event terminal"
    ),
    "EVENTS_GRAZING": (
        "event {event} grazes at t = {t:.10g}: its function only touches zero, to within the "
        "tolerances, where no sensitivities exist; if it is never much larger than atol, give a "
        "smaller atol, else change a parameter, or compile without sensitivities"
    ),
    "EVENTS_ACCUMULATE": (
        "event {event} occurs ever faster and accumulates at t = {detail:.10g}: hold the resting "
        "motion by a mode, or make the event terminal"
    ),
    "EVENTS_CHATTER": (
        "event {event} occurred 100 times within {detail:.3g} s before t = {t:.10g}: if its "
        "function is never much larger than atol, give a smaller atol, else hold the chattering "
        "motion by a mode"
    ),
    "EVENTS_CASCADE": (
        "events {event} trigger each other without end at t = {t:.10g}: hold the chattering motion "
        "by a mode"
    ),
    "EVENTS_SLIDING": (
        "{event} at t = {t:.10g}: from either side the motion is driven back to the jump, so it "
        "neither crosses nor leaves; write a law that does not jump there (tanh for sign), or hold "
        "the sticking motion by a mode"
    ),
    "EVENTS_LEAVES_JUMP": (
        "{event} at t = {t:.10g}: a value that rested at the jump leaves it, in a direction and at "
        "a time that depend on the side: start away from the jump, or hold the sticking motion by "
        "a mode"
    ),
    "EVENTS_NOT_COMMUTING": (
        "{event} and others jump simultaneously at t = {t:.10g}, and the motion depends on their "
        "order, so that no sensitivities exist there: change a parameter, or compile without "
        "sensitivities"
    ),
    "EVENTS_NO_MODES": (
        "at t = {t:.10g} the dry friction or rigid stops of {event} have no consistent modes: with "
        "each choice a force exceeds its limit or a motion opposes its mode; check for friction "
        "that is less at rest than sliding, and for forces that depend on friction"
    ),
    "EVENTS_INDETERMINATE": (
        "at t = {t:.10g} {event} would stick while a gear holds the same motion: the losses of the "
        "gear depend on their shares of the force, which are indeterminate; make the gear ideal, "
        "or put an elastic shaft between them"
    ),
    "EVENTS_NEGATIVE_GAP": (
        "{event} starts at t = {t:.10g} beyond its limit: start within the limit, or at it"
    ),
    "EVENTS_NO_IMPULSES": (
        "at t = {t:.10g} the impact at {event} has no consistent impulses: with each choice one is "
        "tensile or a gap closes further"
    ),
    "EVENTS_COUPLED_IMPACTS": (
        "{event} at t = {t:.10g} coincides with another impact that changes its speed, and the "
        "motion depends on their order, so that no sensitivities exist there: change a parameter, "
        "or compile without sensitivities"
    ),
    "EVENTS_ENERGY_GAIN": (
        "the impact at {event} at t = {t:.10g} would gain energy, as Newton's law of impact may "
        "with friction: give a smaller restitution"
    ),
    "EVENTS_NOT_UNIQUE": (
        "at t = {t:.10g} the contact {event} may stay closed or open: with such strong friction "
        "several motions satisfy the laws (Painleve's paradox): reduce the friction"
    ),
    "EVENTS_LOSSY_IMPACT": (
        "at t = {t:.10g} an impact passes the gear with losses {event}, whose laws hold for steady "
        "forces: make the gear ideal, or put an elastic shaft between it and the stop"
    ),
    "EVENTS_LEAVES_ROOT": (
        "at t = {t:.10g} the argument of a root rests at zero, and the root, whose slope is "
        "infinite there, drives it away: when it leaves is not unique; start away from zero, or "
        "write a law with a finite slope there"
    ),
    "EVENTS_BELOW_TOLERANCE": (
        "{event} at t = {t:.10g}: impacts occur ever faster, and have become too small for the "
        "tolerances; give a larger rest_speed, or smaller tolerances"
    ),
    "EVENTS_LOCKED_DIRECTION": (
        "{event} turns at t = {t:.10g} in its locked direction, which needs an impact: start at a "
        "relative speed of zero or more, and put an elastic shaft between it and a rigid stop"
    ),
    "EVENTS_FAILED": "the equations of the events cannot be evaluated at t = {t:.10g}",
}

#: Maximum number of impacts that a message lists.
_MOST_RESTS = 3

#: Statuses whose messages name edges instead of events.
_OF_EDGES = (
    *("EVENTS_NO_MODES", "EVENTS_LOCKED_DIRECTION", "EVENTS_NO_IMPULSES", "EVENTS_NEGATIVE_GAP"),
    *("EVENTS_ENERGY_GAIN", "EVENTS_NOT_UNIQUE", "EVENTS_INDETERMINATE", "EVENTS_LOSSY_IMPACT"),
)

#: Statuses whose messages name all events that fired.
_OF_MANY = (
    *("EVENTS_CASCADE", "EVENTS_SLIDING", "EVENTS_NO_MODES"),
    *("EVENTS_NO_IMPULSES", "EVENTS_INDETERMINATE"),
)

#: Suffixes that follow the edge name in the names of friction and stop events.
_EDGE = re.compile(r" (stops|turns its load|rests|hits|hits upper|hits lower)$")


def subjects(name: str, event: str, fired: Sequence[str]) -> Sequence[str]:
    """Return the names of events or edges for a message of :data:`EVENT_MESSAGES`."""
    listed = fired if name in _OF_MANY else [event]
    if name not in _OF_EDGES:
        return listed
    return [_EDGE.sub("", row) for row in listed]


def rest_note(rows: Sequence[EventRow], records: FloatArray) -> str:
    """Return a message on impacts after which a rigid stop is at rest, or an empty string."""
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


# Fractions of the run time at which the early part ends and the late part begins.
_EARLY, _LATE = 0.1, 0.9

# Minimum factor from the early to the late part that counts as growth. In ten times the time, a
# uniform motion covers ten times the distance, and an accelerated motion a hundred times.
_LEAST = 1e3

# Minimum exponent of time for unbounded growth. Counts and angles grow more slowly; an exponential
# that has grown a thousandfold grows like the power 7.7 at its end.
_LEAST_POWER = 7.0

# Messages on failures that rounding errors of forces may also cause.
_ROUNDED = "STEP_TOO_SMALL PROJECTION_FAILED NOT_PROJECTED ERROR_TEST_FAILED NOT_CONVERGED"
_OF_ROUNDING = tuple(SENTENCES[name] for name in _ROUNDED.split())

# A slope counts as infinite if it exceeds its value shortly before by more than this factor.
_STEEPER = 100.0

# An equation hardly determines an unknown if its derivative with respect to the unknown is below
# this fraction of the largest derivative in the equation.
_HARDLY = 1e-8

# Maximum number of unknowns for a determinant, and maximum number of names in a message.
_MOST_UNKNOWNS, _MOST_NAMED = 50, 4

# Distances of test points from a fold, relative to an unknown. The folds of large gains are narrow
# and need the small distances.
_BESIDE_FOLD = (-1e-3, -1e-5, 1e-5, 1e-3)


def with_growth(problem: RunProblem, trajectory: Trajectory) -> Trajectory:
    """Add the cause of an early stop to a run's message, if the end of the run reveals one."""
    for cause in (growth, fold, undetermined, infinite_slope):
        if sentence := cause(problem, trajectory):
            return replace(trajectory, message=f"{trajectory.message} {sentence}")
    return trajectory


def is_of_rounding(trajectory: Trajectory) -> bool:
    """Return whether rounding errors of forces may have caused an early stop."""
    message = trajectory.message
    return trajectory.status == BUDGET_SPENT or any(text in message for text in _OF_ROUNDING)


def fold(problem: RunProblem, trajectory: Trajectory) -> str:
    """Return a message on a fold of the algebraic equations at the end of a run, if any."""
    if not trajectory.t.size:
        return ""
    is_known = SENTENCES["FOLD"] in trajectory.message
    return fold_at(problem, float(trajectory.t[-1]), trajectory.z[:, -1], is_known=is_known)


def fold_at(problem: RunProblem, t: float, z: FloatArray, *, is_known: bool = False) -> str:
    """Return a message on a fold of the algebraic equations at a point, or an empty string."""
    m, n = problem.n_algebraic, problem.n_states
    if not (is_known or _is_near_fold(problem, t, z[:n])):
        return ""
    unknowns = listed(f"'{name}'" for name in list(problem.names[n - m : n])[:_MOST_NAMED])
    return (
        f"The algebraic equations have a fold at t = {t:.6g}: two of their solutions for "
        f"{unknowns} meet and end there. Switch a mode there by events, or add a storage, such as "
        "a small capacitor, to the loop."
    )


def _is_near_fold(problem: RunProblem, t: float, y: FloatArray) -> bool:
    """Return whether two solutions of the algebraic equations meet and end near a point.

    The determinant of the derivatives with respect to the unknowns changes its sign at a fold.
    """
    m, n = problem.n_algebraic, problem.n_states
    if not 0 < m <= _MOST_UNKNOWNS or problem.jacobian is None:
        return False
    signs: set[float] = set()
    floor = problem.state_atol / problem.settings.rtol
    # Several distances are tested, because a kink may be near the last point.
    for i in range(n - m, n):
        for aside in _BESIDE_FOLD:
            there = y.copy()
            there[i] += aside * max(abs(y[i]), float(floor[i]))
            slopes = np.asarray(problem.jacobian(t, there))[n - m :, n - m :]
            if not np.all(np.isfinite(slopes)):
                return False
            signs.add(float(np.linalg.slogdet(slopes)[0]))
    return len(signs) > 1


def undetermined(problem: RunProblem, trajectory: Trajectory) -> str:
    """Return a message on algebraic unknowns that their equations hardly determine, if any."""
    m, n = problem.n_algebraic, problem.n_states
    is_sought = m > 0 and "algebraic equations cannot be solved" in trajectory.message
    if not (is_sought and trajectory.t.size) or problem.jacobian is None:
        return ""
    t, y = float(trajectory.t[-1]), trajectory.z[:n, -1].copy()
    rows = np.abs(np.asarray(problem.jacobian(t, y)))[n - m :]
    with np.errstate(all="ignore"):
        shares = np.max(rows[:, n - m :] / np.max(rows, axis=1, keepdims=True), axis=0)
    names = [
        name
        for name, share in zip(problem.names[n - m : n], shares, strict=True)
        if share < _HARDLY
    ]
    if not names:
        return ""
    return (
        f"The algebraic equations hardly depend on {_quoted(names[:_MOST_NAMED])} at t = {t:.6g}: "
        f"its slope is {float(np.min(shares)):.2g} of the largest one, as where semiconductors "
        "block the current of an inductor. Put a large resistor, such as 1e7 ohm, or a small "
        "capacitor in parallel."
    )


def infinite_slope(problem: RunProblem, trajectory: Trajectory) -> str:
    """Return a message on a rate with an infinite slope where steps became too short, if any.

    Sensitivities grow there like a root of time, which steps resolve only to about sqrt(eps).
    """
    n, start = problem.n_states, float(problem.settings.t_span[0])
    is_sought = problem.n_sensitivities and ROUNDING_LEVEL in trajectory.message
    if not (is_sought and trajectory.t.size) or problem.jacobian is None:
        return ""
    t, z = float(trajectory.t[-1]), trajectory.z[:, -1].copy()
    back = _SOON * (t - start)
    rates = np.asarray((problem.state_rhs or problem.rhs)(t, z))[:n].copy()
    rates[n - problem.n_algebraic :] = 0.0
    with np.errstate(all="ignore"):
        here = np.abs(np.array(problem.jacobian(t, z[:n])))
        before = np.abs(np.array(problem.jacobian(t - back, z[:n] - back * rates)))
        # The negation makes slopes that are not finite count as steep.
        is_steep = ~(here <= _STEEPER * (before + 1.0 / max(abs(back), 1e-300) * _SOON))
    if not is_steep.any():
        return ""
    row, column = (int(place[0]) for place in np.nonzero(is_steep))
    return (
        f"The equation of '{problem.names[row]}' has an infinite slope in "
        f"'{problem.names[column]}' at t = {t:.6g}, as a root has at zero: sensitivities change "
        "there faster than steps resolve at this rtol. Loosen rtol to 1e-7, write a law with a "
        "finite slope there, or compile without sensitivities."
    )


def growth(problem: RunProblem, trajectory: Trajectory) -> str:
    """Return a message on the state that has grown most, or an empty string if none grew much.

    A state counts if it exceeds a thousand times its range in the first tenth of the run, has its
    maximum in the last tenth, and grows there at least like the seventh power of time.
    """
    n, start = problem.n_states, float(problem.settings.t_span[0])
    if not trajectory.t.size or not n:
        return ""
    # Requested times may not include the start.
    t = np.abs(np.concatenate([[start], trajectory.t]) - start)
    y = np.abs(np.column_stack([problem.z0[:n], trajectory.z[:n]]))
    early, late = t <= _EARLY * t[-1], t >= _LATE * t[-1]
    with np.errstate(all="ignore"):
        floor = problem.state_atol / problem.settings.rtol
        # Algebraic unknowns are not considered, because their initial values may be guesses.
        ranges = np.maximum(np.max(y[:, early], axis=1), floor)
        ranges[n - problem.n_algebraic :] = np.inf
        last, most = np.max(y[:, late], axis=1), np.max(y, axis=1)
        # Exponent of time with which each state grows at the end or, if larger, in the last tenth:
        # an oscillating state may be momentarily constant at the end.
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
    # The last time at which the state was within its early range.
    since = start + problem.direction * float(t[np.flatnonzero(y[worst] <= ranges[worst])[-1]])
    name = f"'{problem.names[worst]}'" if problem.names else f"State {worst}"
    return (
        f"{name} grows without bound: since t = {since:.4g} it has left the range of its beginning "
        f"and reached {last[worst]:.3g}, {factors[worst]:.2g} times as much; check the signs in "
        "its equation."
    )
