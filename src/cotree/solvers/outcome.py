"""The outcome of a job in C as a ``Trajectory``.

In: a job that ended or waits, and its problem. Out: the values that it has kept, with what it did.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cotree.codegen.statuses import NUMBERS
from cotree.records import changed, filled
from cotree.solvers.base import Drift, Statistics, Trajectory
from cotree.solvers.evaluate import FAILED
from cotree.solvers.event_messages import rest_note
from cotree.solvers.messages import singular_positions, summary

if TYPE_CHECKING:
    from cotree.solvers.base import FloatArray
    from cotree.solvers.job import Job
    from cotree.solvers.problem import Problem

# Endings for which the equations are to blame, and not an event or the tolerances.
_UNSOLVED = {
    NUMBERS[name] for name in ("STEP_TOO_SMALL", "RATE_FAILED", "RATE_NOT_FINITE", "NOT_SOLVED")
}


class Ended(NamedTuple):
    """The outcome of a job that ended or waits: status, reason of a failure, time in C, [s]."""

    status: int
    reason: str
    seconds: float
    is_waiting: bool = False


def compiled_in(trajectory: Trajectory, seconds: float) -> Trajectory:
    """Record how long it took to compile or to find the C of the method."""
    statistics = changed(trajectory.statistics, compile_seconds=seconds)
    return changed(trajectory, statistics=statistics)


def trajectory_of(
    job: Job,
    problem: Problem,
    method: str,
    ended: Ended,
    note: str = "",
    compile_seconds: float = 0.0,
) -> Trajectory:
    """Return the values that a job has kept, with the last good point of a failed job.

    Parameters
    ----------
    job : Job
        It has ended, or waits.
    problem : Problem
        Its problem.
    method : str
        Its method, for the message.
    ended : Ended
        Its outcome.
    note : str
        What the message ends with.
    compile_seconds : float
        Time that the C of the method took, [s].
    """
    c = job.job
    t, z = job.rows.stored(job.z, is_cut=ended.status != 0 or bool(ended.reason))
    work = {
        "method": method,
        "nfev": c.n_evaluations,
        "njev": c.n_jacobians,
        "nlu": c.n_factorisations,
        "n_steps": c.n_steps,
        "seconds": ended.seconds,
        "compile_seconds": compile_seconds,
        "began_with": "",
    }
    sentences = summary(problem, method, c.t, ended.reason)
    sentences[1:1] = singular_positions(problem, job, has_failed=ended.status == FAILED)
    happened = job.happened
    rested = rest_note(problem.events.rows, happened) if problem.events is not None else ""
    jammed = ""
    if ended.status != 0 and problem.events is not None and z.shape[1]:
        jammed = problem.events.jammed(float(c.t), np.ascontiguousarray(z[:, -1]))
    sentences += [row for row in (jammed, rested, job.rows.thinning.note, note) if row]
    values = {
        "t": t,
        "z": z,
        "status": ended.status,
        "message": " ".join(sentences),
        "statistics": filled(Statistics, work),
        "drift": _drift(job, problem, t, z),
        "events": happened,
        "is_unsolved": ended.status != 0 and int(c.status) in _UNSOLVED,
    }
    return filled(Trajectory, values)


def _drift(job: Job, problem: Problem, t: FloatArray, z: FloatArray) -> Drift | None:
    """Measure how well constraints and algebraic equations are met at the stored points."""
    n, cut = problem.n_states, problem.n_states - problem.n_algebraic
    if problem.held is None and cut == n:
        return None
    # C keeps no residuals of the points that it stores, so they are evaluated here.
    columns = []
    for j, at in enumerate(t.tolist()):
        point = np.ascontiguousarray(z[:, j])
        left = [] if problem.held is None else [problem.held.residual(at, point)]
        if cut < n:
            assert problem.state_rhs is not None  # a native problem is a model's
            left.append(np.array(problem.state_rhs(at, point[:n])[cut:]))
        columns.append(np.concatenate(left))
    names = (*problem.constraints, *problem.names[cut:])
    residual = np.array(columns).reshape(len(t), len(names)).T.copy()
    return Drift(names, residual, float(job.job.correction))
