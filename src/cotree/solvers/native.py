"""Runs of C methods, which take steps without returning to Python."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.codegen.statuses import NUMBERS, SENTENCES
from cotree.errors import SolveError
from cotree.methods import METHODS, Method
from cotree.records import changed, filled
from cotree.solvers.budgets import Progress, events_spent, steps_spent, time_spent
from cotree.solvers.engine import load_engine
from cotree.solvers.job import Job, job_kind
from cotree.solvers.problem import RTOL_FLOOR, beyond_scipy, refusal, tested_rtol
from cotree.solvers.result import BUDGET_SPENT, FAILED, Drift, FloatArray, Statistics, Trajectory
from cotree.tolerances import LIMITS

if TYPE_CHECKING:
    from cotree.model.kernels import Newton
    from cotree.solvers.engine import Engine
    from cotree.solvers.problem import RunProblem
    from cotree.solvers.select import MethodSwitch


# Statuses of failures that are due to the equations, not to events or tolerances.
_UNSOLVED = {
    NUMBERS[name] for name in ("STEP_TOO_SMALL", "RATE_FAILED", "RATE_NOT_FINITE", "NOT_SOLVED")
}


#: Message if a method stops because its steps no longer change t.
ROUNDING_LEVEL = SENTENCES["STEP_TOO_SMALL"]

# The rounding of times may limit steps if their spacing exceeds this fraction of the span.
_FINE = 1e-12


def summary(problem: RunProblem, method: str, t: float, reason: str) -> list[str]:
    """Return messages on the end time, the reason for an early stop, and a raised tolerance."""
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
    """Return a message if an explicit method detected stiffness, or an empty string."""
    if not (job.is_stiff and job.n_stiff_steps > LIMITS.most_stiff_steps):
        return ""
    return (
        f"The problem is stiff from t = {float(job.stiff_since):.6g} on: about "
        f"{int(job.n_stiff_steps)} steps were as short as stability requires, and a method for "
        "stiff problems such as rodas5 may take far fewer."
    )


def _rounding_of_time(problem: RunProblem, t: float) -> str:
    """Return a message if the rounding of a large t limits the step size, or an empty string."""
    spacing, (start, end) = float(np.spacing(abs(t))), problem.settings.t_span
    if spacing <= _FINE * abs(end - start):
        return ""
    return (
        f"Near t = {t:.17g} times are {spacing:.2g} s apart, too far for the steps that are "
        "needed: start the run nearer to t = 0."
    )


def with_compile_time(trajectory: Trajectory, seconds: float) -> Trajectory:
    """Add the time that the compilation of the method's C code took, [s], to a trajectory."""
    statistics = changed(trajectory.statistics, compile_seconds=seconds)
    return changed(trajectory, statistics=statistics)


def _drift(job: Job, problem: RunProblem, t: FloatArray, z: FloatArray) -> Drift | None:
    n, cut = problem.n_states, problem.n_states - problem.n_algebraic
    if problem.held is None and cut == n:
        return None
    # Residuals are evaluated in Python, because C does not store them.
    columns = []
    for j, at in enumerate(t.tolist()):
        point = np.ascontiguousarray(z[:, j])
        left = [] if problem.held is None else [problem.held.constraint_residuals(at, point)]
        if cut < n:
            assert problem.state_rhs is not None  # problems in C have rates
            left.append(np.array(problem.state_rhs(at, point[:n])[cut:]))
        columns.append(np.concatenate(left))
    names = (*problem.constraints, *problem.names[cut:])
    residual = np.array(columns).reshape(len(t), len(names)).T.copy()
    return Drift(names, residual, float(job.job.correction))


# Return codes of ``cotree_job_run``.
_MORE, _FAILED, _STOPPED, _STIFF = 1, 2, 3, 4

# Maximum time of one C call, [s], and number of steps in the first call: few, because a step of a
# large model may take milliseconds.
_GLANCE, _FIRST_STEPS = 0.1, 100


def check_available(method: str) -> None:
    """Raise SolveError if the library of a SUNDIALS method is missing or has a wrong version."""
    row = METHODS[method]
    if row.family == "sundials":
        from cotree.solvers.sundials import check_installed

        check_installed(method)
    if row.family != "correctors":
        return
    # Corrector methods run only models without events; see ``refusal``.
    engine = load_engine(row.stepper, has_events=False)
    if isinstance(engine, str):
        raise SolveError(
            f"The method '{method}' cannot be used: {engine}. Or use '{row.instead}', which "
            "takes states and sensitivities as one vector."
        )


def is_available(method: str) -> bool:
    """Return whether the library that a method needs is installed and has the right version."""
    try:
        check_available(method)
    except SolveError:
        return False
    return True


def can_extend(row: Method, problem: RunProblem) -> bool:
    """Return whether a method can integrate algebraic unknowns instead of solving for them."""
    return (
        problem.native is not None
        and problem.native.model.can_extend
        and not (problem.replaced or problem.functions)  # the rates of these inputs are unknown
        # Only explicit methods gain: they would solve for the unknowns in each stage.
        and not row.implicit
        and problem.held is None
        and problem.events is None
    )


@dataclass(eq=False)
class Attempt:
    """An integration in C that has begun and can be advanced, finished or abandoned."""

    problem: RunProblem
    row: Method  # integration method
    job: Job  # C job of the run, which may have taken some steps
    is_extended: bool  # whether the job integrates algebraic unknowns
    compiling: float  # time that the compilation of the method's C code took, [s]
    status: int = 0  # see :attr:`Trajectory.status`
    reason: str = ""  # reason of a failure or an early stop
    seconds: float = 0.0  # time in C, [s]
    is_waiting: bool = True  # whether the job can take further steps

    def take_steps(self, n: int) -> None:
        """Take the first n steps; :attr:`Job.z` is then the point reached."""
        self._advance(until=n)
        self.job.sync_state()

    def abandon(self) -> None:
        """End the job, and release it for other runs."""
        self.job.end()
        self._release()

    def finish(self, successor: MethodSwitch | None = None) -> Trajectory:
        """Integrate to the end; if the problem becomes stiff, ``successor`` may continue."""
        other = self._run(successor)
        if self.status == FAILED and self.is_extended and not self._is_at_fold():
            # If the integration of algebraic unknowns fails, a method that solves for them at each
            # evaluation may succeed. At a fold, however, it would continue with another solution.
            taken = self.problem.steps_taken + int(self.job.job.n_steps)
            self.problem = problem = changed(self.problem, steps_taken=taken)
            idle = _idle(self.row, problem, is_extended=False)
            self.job = idle or Job(self.job.engine, self.row, problem)
            self.status, self.reason, self.is_waiting = 0, "", True
            other = self._run(successor)
        # The trajectory of the successor contains the whole run and its message.
        if other is not None:
            return with_compile_time(other, other.statistics.compile_seconds + self.compiling)
        note = successor.note if successor is not None else stiffness_note(self.job.job)
        trajectory = self._trajectory(note, self.compiling)
        self._release()
        return trajectory

    def _run(self, successor: MethodSwitch | None) -> Trajectory | None:
        """Advance the job to its end; return the trajectory of a successor if it took over."""
        job = self.job
        try:
            if successor is not None:
                job.pause_if_stiff(successor.first_step)
            if self.is_waiting:
                self._advance()
            while successor is not None and self.is_waiting:
                trajectory = successor.take_over(self.problem, self._trajectory(), job)
                if trajectory is not None:
                    return trajectory
                # Eigenvalues take time, so the next test follows after twice as many steps.
                job.pause_if_stiff(2 * int(job.job.n_steps))
                self._advance()
            return None
        finally:
            job.end()

    def _trajectory(self, note: str = "", compile_seconds: float = 0.0) -> Trajectory:
        """Return the stored points; if the job stopped early, also the last valid point."""
        job, problem, method, c = self.job, self.problem, self.row.name, self.job.job
        t, z = job.rows.stored(job.z, is_cut=self.status != 0 or bool(self.reason))
        work = {
            "method": method,
            "nfev": c.n_evaluations,
            "njev": c.n_jacobians,
            "nlu": c.n_factorisations,
            "n_steps": c.n_steps,
            "seconds": self.seconds,
            "compile_seconds": compile_seconds,
            "began_with": "",
        }
        sentences = summary(problem, method, c.t, self.reason)
        if problem.singular is not None or problem.events is not None:
            from cotree.solvers.messages import notes_of, singular_positions

            if problem.singular is not None:
                sentences[1:1] = singular_positions(problem, job, has_failed=self.status == FAILED)
            sentences += notes_of(job, problem, z, has_failed=self.status != 0)
        sentences += [row for row in (job.rows.thinning.note, note) if row]
        values = {
            "t": t,
            "z": z,
            "status": self.status,
            "message": " ".join(sentences),
            "statistics": filled(Statistics, work),
            "drift": _drift(job, problem, t, z),
            "events": job.event_records,
            "is_unsolved": self.status != 0 and int(c.status) in _UNSOLVED,
        }
        return filled(Trajectory, values)

    def _is_at_fold(self) -> bool:
        from cotree.solvers.messages import fold_at

        is_known = int(self.job.job.status) == NUMBERS["FOLD"]
        return is_known or bool(fold_at(self.problem, float(self.job.job.t), self.job.z))

    def _release(self) -> None:
        if self.problem.shared is not None:
            self.problem.shared.release(self.job)

    def _advance(self, until: int | None = None) -> None:
        """Advance the job to its end, or until ``until`` steps have been taken."""
        with Progress(self.row.name, self.problem.settings.t_span) as progress:
            begin = time.perf_counter() - self.seconds
            self.status, self.reason, self.is_waiting = self._steps(begin, progress, until)
            if self.status == BUDGET_SPENT:
                self.job.sync_state()
            self.seconds = time.perf_counter() - begin

    def _steps(self, begin: float, progress: Progress, until: int | None) -> tuple[int, str, bool]:
        """Take steps; return the status, the reason of a failure, and whether the job pauses."""
        job, problem = self.job, self.problem
        settings, others = problem.settings, problem.steps_taken
        limit, time_limit = settings.max_steps, settings.time_limit
        begin -= problem.seconds_taken
        # Steps that call Python functions may be slow, so the first call takes a single step.
        steps = 1 if problem.functions else _FIRST_STEPS
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
                from cotree.solvers.messages import failure

                return FAILED, failure(job, problem), False
            if result == _STIFF:
                return 0, "", True
            if result == _STOPPED:
                assert problem.events is not None  # only terminal events stop a job
                name = problem.events.event_rows[job.job.event].name
                return 0, f"event '{name}' ends the run", False
            if result != _MORE:
                return 0, "", False
            progress.reached(float(job.job.t))
            has_records = problem.events is not None
            if has_records and 0 < job.job.most_events <= job.job.n_records:
                return BUDGET_SPENT, events_spent(job.job.most_events), False
            # The limit of steps is checked last, because a terminal event ends the run in any case.
            if limit is not None and others + job.job.n_steps >= limit:
                return BUDGET_SPENT, steps_spent(limit), False
            if time_limit is not None and now - begin > time_limit:
                return BUDGET_SPENT, time_spent(time_limit), False
            # The next call should take about a tenth of a second: Ctrl-C and the time limit then
            # take effect quickly, and the overhead of calls is small.
            rest = _GLANCE if time_limit is None else time_limit - (now - begin)
            rate = (job.job.n_steps - taken) / max(now - before, 1e-9)
            steps = int(min(max(1.0, rate * min(_GLANCE, rest)), 10.0 * steps))


def begin_in_c(problem: RunProblem, method: str) -> Attempt | str:
    """Begin the integration of a checked problem in C, or return the reason why C cannot."""
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


def engine_of(stepper: str, problem: RunProblem) -> Engine | str:
    """Build and load the engine of a stepper for a problem, or return the reason why that fails."""
    assert problem.native is not None
    return load_engine(stepper, has_events=problem.native.model.layout.has_events)


def factors_of(row: Method, problem: RunProblem) -> Newton | str | None:
    """Return the ``cotree_newton`` of an implicit method, or the reason why it cannot be built."""
    if row.family != "cotree" or not row.implicit:
        return None
    assert problem.native is not None  # other problems have been rejected before
    return problem.native.model.code.newton() or "no compiler can build what it needs of the model"


def band_refusal(job: Job, problem: RunProblem) -> str:
    """Return a reason to prefer SciPy's sparse factorisation, or an empty string."""
    is_refused = problem.is_sparse and job.is_wide and not beyond_scipy(problem)
    return "the Jacobian's band is wide" if is_refused else ""


def _idle(row: Method, problem: RunProblem, *, is_extended: bool) -> Job | None:
    """Take an idle job of an earlier run, and begin this run in it; None if no job is idle."""
    if problem.shared is None:
        return None
    job = problem.shared.acquire(job_kind(row, problem, is_extended=is_extended))
    if job is not None:
        job.begin(problem)
    return job
