"""The one loop over steps that all methods share.

In: a checked ``Problem`` and a function that starts a stepper. Out: a ``Trajectory``. The loop
restarts at breakpoints, collects outputs, watches budgets and progress, and turns what goes wrong
into a status and a sentence.
"""

from __future__ import annotations

import itertools
import time
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

import numpy as np

from cotree.solvers.augmented import RTOL_FLOOR, augmented_tolerances
from cotree.solvers.base import Statistics, Trajectory
from cotree.solvers.evaluate import BUDGET_SPENT, FAILED, Evaluator, IntegrationStopError

if TYPE_CHECKING:
    from cotree.solvers.problem import FloatArray, Problem

# Steps of a few units in the last place get nowhere. SciPy's own methods stop there, LSODA and
# SUNDIALS go on forever. A single short step is normal before an output or a breakpoint.
_STALL_SPACINGS = 16
_STALL_STEPS = 5


class Stepper(Protocol):
    """A solver between two breakpoints, advanced one step at a time.

    Attributes
    ----------
    t : float
        Time reached, [s].
    z : ndarray
        Values there; the array is never changed afterwards.
    lands : bool
        Whether steps end on outputs, because the method's interpolant is weaker than its steps.
    nlu : int
        Factorisations so far.
    """

    t: float
    z: FloatArray
    lands: bool

    @property
    def nlu(self) -> int:
        """Return the number of factorisations so far."""
        ...

    def step(self, t_bound: float) -> str:
        """Take one step, not past ``t_bound``; return a reason if that fails, else ""."""

    def interpolate(self, t: float) -> FloatArray:
        """Return the values at a time inside the last step."""


StartStepper = Callable[[Evaluator, float, "FloatArray", float], Stepper]


def drive(problem: Problem, method: str, start: StartStepper) -> Trajectory:
    """Integrate with one method.

    Parameters
    ----------
    problem : Problem
        It has passed ``check_problem``.
    method : str
        Name for statistics and messages.
    start : callable
        ``start(evaluator, t, z, t_end)`` returns a stepper that has not stepped yet.

    Returns
    -------
    Trajectory
        With status 0, or with the last good point as its last column.
    """
    begin = time.perf_counter()
    run = _Run(problem, start if problem.size else _Idle)
    status, reason = 0, ""
    # What is not finite is watched and reported here; SciPy's own warnings say it once more.
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.filterwarnings("ignore", module=r"scipy\.")
        try:
            for segment in _segments(problem):
                run.integrate_segment(*segment)
        except IntegrationStopError as stop:
            status, reason = stop.status, stop.reason
            run.keep_last_point()
    evaluator = run.evaluator
    statistics = Statistics(
        method=method,
        nfev=evaluator.nfev,
        njev=evaluator.njev,
        nlu=run.nlu,
        n_steps=run.n_steps,
        seconds=time.perf_counter() - begin,
    )
    return Trajectory(
        t=np.array(run.times),
        z=np.array(run.columns).reshape(len(run.columns), problem.size).T.copy(),
        status=status,
        message=_message(problem, method, run, reason),
        statistics=statistics,
    )


class _Idle:
    """The stepper of a problem without states, which no solver accepts."""

    lands = True
    nlu = 0

    def __init__(self, evaluator: Evaluator, t: float, z: FloatArray, t_end: float) -> None:
        self.t = t
        self.z = z

    def step(self, t_bound: float) -> str:
        self.t = t_bound
        return ""

    def interpolate(self, t: float) -> FloatArray:
        return self.z


class _Run:
    """The moving parts of one integration."""

    def __init__(self, problem: Problem, start: StartStepper) -> None:
        self.problem = problem
        self.evaluator = Evaluator(problem)
        self.t = float(problem.t_span[0])
        self.z = np.array(problem.z0, dtype=np.float64)
        self.times: list[float] = []
        self.columns: list[FloatArray] = []
        self.n_steps = 0
        self.nlu = 0
        self._start = start
        self._wanted = [] if problem.t_eval is None else [float(t) for t in problem.t_eval]
        self._next = 0
        if problem.t_eval is None or (self._wanted and self._wanted[0] == self.t):
            self._keep(self.t, self.z)
            self._next = 1

    def integrate_segment(self, start: float, end: float) -> None:
        """Step from one breakpoint to the next."""
        evaluator = self.evaluator
        evaluator.open_segment(start, end)
        # SciPy's first step would be nan, and its step loop would never end.
        if not np.all(np.isfinite(evaluator.rhs(start, self.z))):
            raise IntegrationStopError(FAILED, "it cannot start")
        stepper = self._start(evaluator, start, self.z, end)
        nlu_before = self.nlu
        short_steps = 0
        try:
            while self.problem.direction * (end - self.t) > 0:
                self._check_steps()
                before = self.t
                reason = stepper.step(self._bound(end) if stepper.lands else end)
                self.nlu = nlu_before + stepper.nlu
                if reason:
                    raise IntegrationStopError(FAILED, reason)
                if not np.all(np.isfinite(stepper.z)):
                    raise IntegrationStopError(FAILED, "the solution is no longer finite")
                self._accept(stepper)
                is_short = abs(self.t - before) <= _STALL_SPACINGS * np.spacing(abs(self.t))
                short_steps = short_steps + 1 if is_short else 0
                if not is_short:
                    evaluator.progressed()
                if short_steps >= _STALL_STEPS:
                    raise IntegrationStopError(FAILED, "the step size fell to rounding level")
        finally:
            self.nlu = nlu_before + stepper.nlu

    def keep_last_point(self) -> None:
        """Append the last good point, unless it is there."""
        if not self.times or self.times[-1] != self.t:
            self._keep(self.t, self.z)

    def _bound(self, end: float) -> float:
        if self._next >= len(self._wanted):
            return end
        wanted = self._wanted[self._next]
        return wanted if self.problem.direction * (end - wanted) > 0 else end

    def _accept(self, stepper: Stepper) -> None:
        self.n_steps += 1
        self.evaluator.step_done()
        self.t, self.z = stepper.t, stepper.z
        if self.problem.t_eval is None:
            self._keep(self.t, self.z)
            return
        while self._next < len(self._wanted):
            wanted = self._wanted[self._next]
            if self.problem.direction * (wanted - self.t) > 0:
                return
            self._keep(wanted, self.z if wanted == self.t else stepper.interpolate(wanted))
            self._next += 1

    def _keep(self, t: float, z: FloatArray) -> None:
        self.times.append(t)
        self.columns.append(z)

    def _check_steps(self) -> None:
        limit = self.problem.max_steps
        if limit is not None and self.n_steps >= limit:
            raise IntegrationStopError(BUDGET_SPENT, f"the limit of {limit} steps is reached")


def _segments(problem: Problem) -> list[tuple[float, float]]:
    """Cut the span at the breakpoints inside it."""
    start, end = (float(t) for t in problem.t_span)
    low, high = min(start, end), max(start, end)
    inside = sorted({float(b) for b in problem.breakpoints if low < b < high})
    if problem.direction < 0:
        inside.reverse()
    corners = [start, *inside, end]
    return list(itertools.pairwise(corners))


def _message(problem: Problem, method: str, run: _Run, reason: str) -> str:
    sentences = []
    if reason:
        cause = run.evaluator.not_finite
        why = f"{reason}; {cause}" if cause and cause not in reason else reason
        end = problem.t_span[1]
        sentences.append(f"{method} stopped at t = {run.t:.10g} of {end:.10g}: {why}.")
    else:
        sentences.append(f"{method} reached t = {run.t:.10g}.")
    rtol, _ = augmented_tolerances(problem)
    if rtol > problem.rtol:
        sentences.append(
            f"rtol = {problem.rtol:.3g} is below what double precision can test; "
            f"{RTOL_FLOOR:.3g} was used."
        )
    return " ".join(sentences)
