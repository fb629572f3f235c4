"""The loop over steps of SciPy's methods.

In: a ``Problem`` and a method's name. Out: a ``Trajectory``. The loop restarts at breakpoints,
collects outputs, holds a constrained motion to its constraints, watches budgets and progress, and
turns what goes wrong into a status and a sentence. Events, and sensitivities that jump where a
source has a corner, are left to the loop in C.

Every stored value of a constrained problem is projected. Methods without a memory also go on from
the projected value after each step. Those with one, whose history a projection puts at odds with
the present, start anew from it every ``_STEPS_UNHELD`` steps if it differs by more than the
tolerance. A step that makes it differ by many has failed.
"""

from __future__ import annotations

import contextlib
import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cotree.errors import SolveError
from cotree.quiet import without_warnings
from cotree.solvers.algebraic import solve_reduced
from cotree.solvers.base import Drift, Statistics, Trajectory
from cotree.solvers.budgets import Thinning, steps_spent
from cotree.solvers.corners import corner_times, segments
from cotree.solvers.evaluate import (
    BUDGET_SPENT,
    FAILED,
    Evaluator,
    IntegrationStopError,
    OffConstraintsError,
)
from cotree.solvers.messages import ROUNDING_LEVEL, told
from cotree.solvers.problem import check_problem
from cotree.solvers.progress import Progress
from cotree.solvers.scipy_ivp import Idle, ScipyStepper, alone
from cotree.solvers.singularity_crossing import LOOSENED, LOOSEST, Passage
from cotree.tolerances import LIMITS

if TYPE_CHECKING:
    from cotree.solvers.base import FloatArray
    from cotree.solvers.problem import Problem

    _Stepper = ScipyStepper | Idle

#: The end of a sentence on what SciPy's methods do not take.
IN_C = (
    "use 'dopri5', 'rodas5' or 'cvode', which run in C; where there is no compiler, "
    "`pip install ziglang` brings one"
)

# Steps of a few units in the last place get nowhere; LSODA takes them forever. A single
# one is normal before an output or a breakpoint.
_STALL_SPACINGS, _STALL_STEPS = LIMITS.stall_spacings, LIMITS.stall_steps

# A new start of a multistep method costs tens of short steps of low order. Looking this often, the
# four take 7 to 70 per cent more steps along a pendulum of index 1, with a twentieth or less of the
# error of a motion left to drift. Where every step is looked at, CVODE takes 36 times as many.
_STEPS_UNHELD = 100

# How much shorter steps become where something is not a number ahead, and the shortest that are
# tried, as a share of the span.
_RETREAT, _LEAST_REACH = 0.1, 1e-9


def solve_with_scipy(problem: Problem, method: str) -> Trajectory:
    """Integrate with one of SciPy's methods; algebraic unknowns are eliminated.

    Parameters
    ----------
    problem : Problem
        The problem.
    method : str
        "RK45", "DOP853", "RK23", "Radau", "BDF" or "LSODA".

    Returns
    -------
    Trajectory
        With status 0, or with the last good point as its last column.

    Raises
    ------
    SolveError
        If the problem cannot be accepted, or has what only methods in C take.
    """
    check_problem(problem)
    what = beyond_scipy(problem)
    if what:
        raise SolveError(f"The method '{method}' cannot take {what}: {IN_C}.")
    with alone(method):
        return solve_reduced(problem, lambda reduced: _drive(reduced, method))


def beyond_scipy(problem: Problem) -> str:
    """Name a feature that only methods in C take; empty if the problem has none."""
    if problem.events is not None:
        return f"events, such as '{problem.events.rows[0].name}'"
    if problem.n_sensitivities and problem.shifts.rows_at(corner_times(problem)[:-1])[0].any():
        return "sensitivities to parameters that move a corner of a source"
    return ""


def _drive(problem: Problem, method: str) -> Trajectory:
    begin = time.perf_counter()
    run = _Run(problem, method, Progress(method, problem.t_span))
    status, reason = 0, ""
    # What is not finite is watched and reported here; SciPy's own warnings say it once more.
    with np.errstate(all="ignore"), without_warnings(module=r"scipy\."):
        try:
            with run.progress:
                for segment in segments(problem):
                    run.integrate_segment(*segment)
        except IntegrationStopError as stop:
            status, reason = stop.status, stop.reason
            if status == FAILED and problem.singular is not None:
                run.passage.lost = problem.singular(run.t, run.z)
        # A step that was dropped may be the last one.
        if status != 0 or run.thinning.stride > 1:
            run.keep_last_point()
    evaluator = run.evaluator
    cause = evaluator.not_finite if reason else ""
    statistics = Statistics(
        method=method,
        nfev=evaluator.nfev,
        njev=evaluator.njev,
        nlu=run.nlu,
        n_steps=run.n_steps,
        seconds=time.perf_counter() - begin,
    )
    message = told(problem, method, run.t, reason, cause, run.passage.summary())
    # Completed points hold more values than are integrated.
    width = len(run.columns[0]) if run.columns else problem.size
    return Trajectory(
        t=np.array(run.times),
        z=np.array(run.columns).reshape(len(run.columns), width).T.copy(),
        status=status,
        message=f"{message} {run.thinning.note}".rstrip(),
        statistics=statistics,
        drift=run.drift(),
    )


class _Run:
    """The mutable state of one integration."""

    def __init__(self, problem: Problem, method: str, progress: Progress) -> None:
        self.problem = problem
        self._method = method
        self.progress = progress
        self.evaluator = Evaluator(problem)
        self.t = float(problem.t_span[0])
        self.z = np.array(problem.z0, dtype=np.float64)
        self.times: list[float] = []
        self.columns: list[FloatArray] = []
        self.residuals: list[FloatArray] = []
        self.thinning = Thinning()
        self.n_steps = 0
        self.nlu = 0
        self._wanted = [] if problem.t_eval is None else [float(t) for t in problem.t_eval]
        self._next = 0
        self._steps_unheld = 0
        self._moved = 0.0  # by how many tolerances the constraints would have moved the last step
        self.passage = Passage()
        self._reach = 0.0  # of the last step, or of those allowed since

    def integrate_segment(self, start: float, end: float) -> None:
        """Step from one breakpoint to the next."""
        evaluator = self.evaluator
        if self.problem.reach is not None:
            self.problem.reach(start, evaluator.complete(start, self.z))
        evaluator.open_segment(start, end)
        # A jump of an input may leave the motion of the segment before off the constraints.
        self.z = evaluator.project(start, self.z)
        evaluator.settle(start, self.z)
        self._keep_start()
        self._derivative(start, self.z, "it cannot start")
        self._steps_unheld, self._moved = 0, 0.0
        stepper = self._begin(start, self.z, end)
        nlu_before = self.nlu
        short_steps = 0
        crossing = end  # up to where the tolerance is loosened
        try:
            while self.problem.direction * (end - self.t) > 0:
                self._check_steps()
                before = self.t
                # Beyond the stretch of looser tolerance or shorter steps the run's own hold again.
                if evaluator.problem is not self.problem and self.t == crossing:
                    evaluator.problem = self.problem
                    stepper, nlu_before = self._begin(self.t, self.z, end), self.nlu
                limit = end if evaluator.problem is self.problem else crossing
                # Methods with a weak interpolant step onto outputs; the others interpolate.
                bound = self._bound(limit)
                reason = stepper.step(bound if stepper.lands else limit)
                self.nlu = nlu_before + stepper.nlu
                if not reason and not np.all(np.isfinite(stepper.z)):
                    reason = "the solution is no longer finite"
                try:
                    if reason:
                        raise IntegrationStopError(FAILED, reason)
                    self._accept(stepper)
                except IntegrationStopError as stop:
                    crossing = self._retreat(stepper, end, stop)
                    stepper = self._begin(self.t, self.z, crossing)
                    nlu_before = self.nlu
                    continue
                self._reach = abs(self.t - before)
                # Steppers count time from the start of their segment, hence that spacing.
                is_short = abs(self.t - before) <= _STALL_SPACINGS * np.spacing(abs(self.t - start))
                short_steps = short_steps + 1 if is_short else 0
                if not is_short:
                    evaluator.progressed()
                if short_steps >= _STALL_STEPS:
                    raise IntegrationStopError(FAILED, ROUNDING_LEVEL)
                if self._is_stuck(stepper, before, bound):
                    crossing = self._crossing(end)
                    stepper = self._begin(self.t, self.z, crossing)
                    nlu_before = self.nlu
        finally:
            self.nlu = nlu_before + stepper.nlu

    def _begin(self, t: float, z: FloatArray, t_end: float) -> _Stepper:
        """Start the method; without states there is nothing to start."""
        if not self.problem.size:
            return Idle(t, z)
        return ScipyStepper(self._method, self.evaluator, t, z, t_end)

    def _is_stuck(self, stepper: _Stepper, before: float, bound: float) -> bool:
        """Watch a step for a singular configuration; tell whether to cross it."""
        problem, passage = self.problem, self.passage
        # A step that ends on its bound was cut there and says nothing of the step size control.
        if problem.singular is None or self.t == bound:
            return False
        passage.watch(abs(self.t - before), stepper.has_memory)
        is_tight = self.evaluator.problem is problem and problem.rtol < LOOSEST
        return is_tight and passage.is_stuck and bool(problem.singular(self.t, self.z))

    def _crossing(self, end: float) -> float:
        """Loosen the tolerance, and say up to where."""
        problem, passage = self.problem, self.passage
        atol = np.asarray(problem.atol)
        assert problem.singular is not None  # or nobody would have looked
        passage.cross(self.t, problem.singular(self.t, self.z))
        # Never tighter than the run's own tolerance, and looser than LOOSEST only where that is.
        self.evaluator.problem = replace(
            problem,
            rtol=max(problem.rtol, min(problem.rtol * LOOSENED, LOOSEST)),
            atol=np.maximum(atol, np.minimum(atol * LOOSENED, LOOSEST)),
        )
        ahead = self.t + problem.direction * passage.longest
        return ahead if problem.direction * (end - ahead) > 0 else end

    def _retreat(self, stepper: _Stepper, end: float, stop: IntegrationStopError) -> float:
        """Shorten the steps after a failure, and say up to where."""
        # A share of the step that failed, or of the last reach if the stepper did not move.
        self._reach = _RETREAT * (abs(stepper.t - self.t) or self._reach)
        least = _LEAST_REACH * abs(self.problem.t_span[1] - self.problem.t_span[0])
        # Methods with a memory give up where a trial step is not finite; others shorten it.
        is_known = stop.status == FAILED and stepper.has_memory and self.evaluator.not_finite
        if not (is_known or isinstance(stop, OffConstraintsError)) or self._reach <= least:
            raise stop
        # The method begins anew anyway, so it may as well begin on the constraints.
        if stepper.has_memory:
            self.z, self._moved = self.evaluator.project(self.t, self.z), 0.0
        self.evaluator.problem = replace(self.evaluator.problem, max_step=self._reach)
        # Up to as far as the failed step would have gone.
        ahead = self.t + self.problem.direction * self._reach / _RETREAT
        return ahead if self.problem.direction * (end - ahead) > 0 else end

    def keep_last_point(self) -> None:
        """Append the last good point, unless it is there."""
        if self.times and self.times[-1] == self.t:
            return
        # A projection that fails may be the very reason; the point is then stored as it is.
        with contextlib.suppress(IntegrationStopError):
            self.z = self.evaluator.project(self.t, self.z)
        # One that cannot be completed is not stored.
        with contextlib.suppress(IntegrationStopError):
            self._keep(self.t, self.z)

    def drift(self) -> Drift | None:
        """Report on the constraints, if there are any."""
        names = self.problem.constraints
        if self.problem.residual is None:
            return None
        # The reshape keeps the axis of names where nothing was stored.
        residual = np.array(self.residuals).reshape(len(self.residuals), len(names)).T.copy()
        return Drift(names, residual, self.evaluator.correction)

    def _bound(self, end: float) -> float:
        if self._next >= len(self._wanted):
            return end
        wanted = self._wanted[self._next]
        return wanted if self.problem.direction * (end - wanted) > 0 else end

    def _accept(self, stepper: _Stepper) -> None:
        """Take a step, with the outputs in it."""
        self._steps_unheld += 1
        problem = self.problem
        self.evaluator.step_done()
        self.progress.reached(stepper.t)
        first = self._next
        wanted = self._wanted_until(stepper.t)
        points = [(t, stepper.z if t == stepper.t else stepper.interpolate(t)) for t in wanted]
        try:
            # All outputs of a step are found before one is stored, so that a step that fails here
            # can be taken back with them.
            if problem.project is not None:
                points = self._hold(stepper, points)
            columns = [(t, self.evaluator.complete(t, z)) for t, z in points]
        except IntegrationStopError:
            self._next = first
            raise
        self.n_steps += 1
        self.t, self.z = stepper.t, stepper.z
        for t, column in columns:
            if problem.t_eval is not None or self._has_place():
                self._store(t, column)

    def _wanted_until(self, t: float) -> list[float]:
        """Take the outputs up to a time from those still wanted; without t_eval, the step's end."""
        if self.problem.t_eval is None:
            # A breakpoint ends one segment and starts the next, but is stored once.
            return [t] if not self.times or self.times[-1] != t else []
        first = self._next
        while self._next < len(self._wanted):
            if self.problem.direction * (self._wanted[self._next] - t) > 0:
                break
            self._next += 1
        return self._wanted[first : self._next]

    def _hold(
        self, stepper: _Stepper, points: list[tuple[float, FloatArray]]
    ) -> list[tuple[float, FloatArray]]:
        """Project the points of a step, and its end where the method can go on from there."""
        z, evaluator, has_memory = stepper.z, self.evaluator, stepper.has_memory
        end, mean, largest = evaluator.hold(stepper.t, z, self._moved)
        held = [(t, end if t == stepper.t else evaluator.project(t, x)) for t, x in points]
        self._moved = mean if has_memory else 0.0
        if has_memory and self._steps_unheld < _STEPS_UNHELD:
            return held
        self._steps_unheld, self._moved = 0, 0.0
        # A new start of a multistep method has to be worth it; a one-step method loses nothing.
        if largest > 1.0 if has_memory else not np.array_equal(z, end):
            stepper.replace(end, self._derivative(stepper.t, end, "it cannot go on"))
            if has_memory:
                self.passage.restarted()
        return held

    def _derivative(self, t: float, z: FloatArray, otherwise: str) -> FloatArray:
        """Return the derivative where a method starts or goes on; stop where it is not finite."""
        dz = self.evaluator.rhs(t, z)
        # SciPy's first step would be nan, and its step loop would never end.
        if not np.all(np.isfinite(dz)):
            raise IntegrationStopError(FAILED, otherwise)
        return dz

    def _keep_start(self) -> None:
        """Store the very first point, if it is wanted."""
        if self.t == float(self.problem.t_span[0]) and not self.times:
            for t in self._wanted_until(self.t):
                self._keep(t, self.z)
                self.thinning.taken(1)

    def _keep(self, t: float, z: FloatArray) -> None:
        self._store(t, self.evaluator.complete(t, z))

    def _store(self, t: float, column: FloatArray) -> None:
        self.times.append(t)
        self.columns.append(column)
        if self.problem.residual is not None:
            self.residuals.append(self.evaluator.residual(t, column))

    def _has_place(self) -> bool:
        """Tell whether a step is to be stored; where there is no room, drop every second one."""
        if len(self.times) >= self.problem.most_rows:
            kept = self.thinning.thin()
            self.times, self.columns = self.times[kept], self.columns[kept]
            self.residuals = self.residuals[kept]
        return bool(range(1)[self.thinning.taken(1)])

    def _check_steps(self) -> None:
        limit = self.problem.max_steps
        if limit is not None and self.problem.steps_taken + self.n_steps >= limit:
            raise IntegrationStopError(BUDGET_SPENT, steps_spent(limit))
