"""Methods in C, which take steps without Python between them."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cotree.codegen.statuses import NUMBERS
from cotree.errors import SolveError
from cotree.methods import METHODS, Method
from cotree.records import changed, filled
from cotree.solvers.budgets import Progress, steps_spent, time_spent
from cotree.solvers.engine import check_installed, load_engine
from cotree.solvers.evaluate import BUDGET_SPENT, FAILED
from cotree.solvers.job import Job, job_kind
from cotree.solvers.messages import (
    event_message,
    fold_at,
    rest_note,
    singular_positions,
    stiffness_note,
    summary,
)
from cotree.solvers.problem import beyond_scipy, refusal
from cotree.solvers.result import Drift, FloatArray, Statistics, Trajectory

if TYPE_CHECKING:
    from cotree.model.kernels import Newton
    from cotree.solvers.engine import Engine
    from cotree.solvers.problem import Problem
    from cotree.solvers.stiffness import MethodSwitch


# Failures that are caused by the equations, and not by an event or the tolerances.
_UNSOLVED = {
    NUMBERS[name] for name in ("STEP_TOO_SMALL", "RATE_FAILED", "RATE_NOT_FINITE", "NOT_SOLVED")
}


class Ended(NamedTuple):
    """The outcome of a job that ended or pauses: status, reason of a failure, time in C, [s]."""

    status: int
    reason: str
    seconds: float
    is_waiting: bool = False


def with_compile_time(trajectory: Trajectory, seconds: float) -> Trajectory:
    """Return a trajectory with the time to compile or to find the C of the method, [s]."""
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
    """Return the stored values of a job, with the last good point if it failed.

    ``note`` ends the message; ``compile_seconds`` is the time that the C of the method took.
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
    if problem.singular is not None:
        sentences[1:1] = singular_positions(problem, job, has_failed=ended.status == FAILED)
    records = job.event_records
    rested = rest_note(problem.events.rows, records) if problem.events is not None else ""
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
        "events": records,
        "is_unsolved": ended.status != 0 and int(c.status) in _UNSOLVED,
    }
    return filled(Trajectory, values)


def _drift(job: Job, problem: Problem, t: FloatArray, z: FloatArray) -> Drift | None:
    """Measure the drift of constraints and algebraic equations at the stored points."""
    n, cut = problem.n_states, problem.n_states - problem.n_algebraic
    if problem.held is None and cut == n:
        return None
    # C does not store residuals.
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


# Results of cotree_job_run.
_MORE, _FAILED, _STOPPED, _STIFF = 1, 2, 3, 4

# Time that C runs before it returns to Python, [s], and the first number of steps: small, since
# steps of a large model may take milliseconds each.
_GLANCE, _FIRST_STEPS = 0.1, 100


def check_available(method: str) -> None:
    """Raise SolveError if the library of a SUNDIALS method is missing or of a wrong version."""
    row = METHODS[method]
    if row.family == "sundials":
        check_installed(method)
    if row.family != "correctors":
        return
    engine = load_engine(row.stepper)
    if isinstance(engine, str):
        raise SolveError(
            f"The method '{method}' cannot be used: {engine}. Or use '{row.instead}', which "
            "takes states and sensitivities as one vector."
        )


def is_available(method: str) -> bool:
    """Return whether a method's library can be used; true for methods that need none."""
    try:
        check_available(method)
    except SolveError:
        return False
    return True


def can_extend(row: Method, problem: Problem) -> bool:
    """Return whether algebraic unknowns are integrated instead of solved for at each evaluation."""
    native = problem.native
    return (
        native is not None
        and native.model.can_extend
        and not (native.replaced or native.functions)  # whose rates are not known
        # Explicit methods would solve for the unknowns in each stage.
        and not row.implicit
        and problem.held is None
        and problem.events is None
    )


@dataclass(eq=False)
class Attempt:
    """An integration in C that has begun."""

    problem: Problem
    row: Method  # the method
    job: Job  # the job, which may have taken some steps
    is_extended: bool  # whether it integrates algebraic unknowns, too
    compiling: float  # seconds that the C of the method took
    ended: Ended | None = None  # the outcome of the steps so far; None before any

    def take_steps(self, n: int) -> None:
        """Take the first steps; :attr:`Job.z` is then their end."""
        self.ended = run_job(self.job, self.problem, self.row.name, until=n)
        self.job.sync_state()

    def abandon(self) -> None:
        """End the job, and leave it to other runs."""
        self.job.end()
        self._release()

    def finish(self, successor: MethodSwitch | None = None) -> Trajectory:
        """Integrate to the end; ``successor`` may take over if the problem is stiff."""
        job, problem, method = self.job, self.problem, self.row.name
        ended = _run(job, problem, method, successor, self.ended)
        if (
            isinstance(ended, Ended)
            and ended.status == FAILED
            and self.is_extended
            and not fold_at(problem, float(job.job.t), job.z)
        ):
            # Solving for the unknowns at each evaluation may succeed if their integration fails.
            # At a fold it would continue with another solution.
            problem = changed(problem, steps_taken=problem.steps_taken + int(job.job.n_steps))
            idle = _idle(self.row, problem, is_extended=False)
            job = self.job = idle or Job(job.engine, self.row, problem)
            ended = _run(job, problem, method, successor, Ended(0, "", ended.seconds, True))
        # The trajectory of the successor is complete, including its message.
        if isinstance(ended, Trajectory):
            return with_compile_time(ended, ended.statistics.compile_seconds + self.compiling)
        note = successor.note if successor is not None else stiffness_note(job.job)
        trajectory = trajectory_of(job, problem, method, ended, note, self.compiling)
        self._release()
        return trajectory

    def _release(self) -> None:
        if self.problem.shared is not None:
            self.problem.shared.release(self.job)


def begin_in_c(problem: Problem, method: str) -> Attempt | str:
    """Begin to integrate a checked problem in C, or return the reason why C cannot."""
    why = refusal(method, problem)
    if why:
        return why
    row = METHODS[method]
    is_extended = can_extend(row, problem)
    idle = _idle(row, problem, is_extended=is_extended)
    if idle is not None:
        return Attempt(problem, row, idle, is_extended, 0.0)
    before = time.perf_counter()
    engine = engine_of(row.stepper, problem)
    if isinstance(engine, str):
        return engine
    newton = factors_of(row, problem)
    if isinstance(newton, str):
        return newton
    compiling = time.perf_counter() - before
    job = Job(engine, row, problem, newton, is_extended=is_extended)
    why = band_refusal(job, problem)
    return why or Attempt(problem, row, job, is_extended, compiling)


def engine_of(stepper: str, problem: Problem) -> Engine | str:
    """Build and load the engine of a stepper for a problem that is not refused, or return why not.

    The engine contains the search for events only if the model has any.
    """
    assert problem.native is not None
    return load_engine(stepper, has_events=problem.native.model.layout.has_events)


def factors_of(row: Method, problem: Problem) -> Newton | str | None:
    """Build the factorisation for an own implicit method, or return why that fails.

    None for other methods.
    """
    if row.family != "cotree" or not row.implicit:
        return None
    assert problem.native is not None  # it was not refused
    return problem.native.model.newton() or "no compiler can build what it needs of the model"


def band_refusal(job: Job, problem: Problem) -> str:
    """Return a reason to prefer SciPy's sparse factorisation, or an empty text."""
    is_refused = problem.is_sparse and job.is_wide and not beyond_scipy(problem)
    return "the Jacobian's band is wide" if is_refused else ""


def _idle(row: Method, problem: Problem, *, is_extended: bool) -> Job | None:
    """Restart an idle job of an earlier run; None if there is none."""
    if problem.shared is None:
        return None
    job = problem.shared.acquire(job_kind(row, problem, is_extended=is_extended))
    if job is not None:
        job.begin(problem)
    return job


def _run(
    job: Job, problem: Problem, method: str, successor: MethodSwitch | None, ended: Ended | None
) -> Ended | Trajectory:
    """Advance a job to its end, or switch to its successor; free the stepper's memory."""
    try:
        if successor is not None:
            job.pause_if_stiff(successor.first_step)
        if ended is None or ended.is_waiting:
            ended = run_job(job, problem, method, 0.0 if ended is None else ended.seconds)
        while successor is not None and ended.is_waiting:
            first = trajectory_of(job, problem, method, ended)
            trajectory = successor.take_over(problem, first, job)
            if trajectory is not None:
                return trajectory
            # The next test, which computes eigenvalues, follows after as many steps as so far.
            job.pause_if_stiff(2 * int(job.job.n_steps))
            ended = run_job(job, problem, method, ended.seconds)
        return ended
    finally:
        job.end()


def run_job(
    job: Job, problem: Problem, method: str, spent: float = 0.0, *, until: int | None = None
) -> Ended:
    """Advance a job to its end, or for ``until`` steps.

    The time already ``spent``, [s], counts against the time limit.
    """
    with Progress(method, problem.settings.t_span) as progress:
        begin = time.perf_counter() - spent
        status, reason, is_waiting = _advance(job, problem, begin, progress, until)
        if status == BUDGET_SPENT:
            job.sync_state()
        return Ended(status, reason, time.perf_counter() - begin, is_waiting)


def _advance(
    job: Job, problem: Problem, begin: float, progress: Progress, until: int | None
) -> tuple[int, str, bool]:
    """Return the status, the reason of a failure, and whether the job pauses."""
    settings, others = problem.settings, problem.steps_taken
    limit, time_limit = settings.max_steps, settings.time_limit
    assert problem.native is not None  # or there were no job
    steps = 1 if problem.native.functions else _FIRST_STEPS  # Python's functions may take long
    while True:
        before, taken = time.perf_counter(), job.job.n_steps
        allowed = steps if limit is None else min(steps, limit - others - taken)
        if until is not None:
            if taken >= until:
                return 0, "", True
            allowed = min(allowed, until - taken)
        result = job.run(allowed)
        now = time.perf_counter()
        if result == _FAILED:
            return FAILED, job.reason(problem), False
        if result == _STIFF:
            return 0, "", True
        if result == _STOPPED:
            assert problem.events is not None  # one of which it was
            return 0, event_message("stops", [problem.events.rows[job.job.event].name]), False
        if result != _MORE:
            return 0, "", False
        progress.reached(float(job.job.t))
        has_records = problem.events is not None
        if has_records and 0 < job.job.most_events <= job.job.n_records:
            return BUDGET_SPENT, event_message("spends", [], detail=job.job.most_events), False
        # Checked after events, which end a run in any case.
        if limit is not None and others + job.job.n_steps >= limit:
            return BUDGET_SPENT, steps_spent(limit), False
        if time_limit is not None and now - begin > time_limit:
            return BUDGET_SPENT, time_spent(time_limit), False
        # Steps for a tenth of a second: Ctrl-C and the time limit then take effect soon, and calls
        # of C cost little.
        rest = _GLANCE if time_limit is None else time_limit - (now - begin)
        rate = (job.job.n_steps - taken) / max(now - before, 1e-9)
        steps = int(min(max(1.0, rate * min(_GLANCE, rest)), 10.0 * steps))
