"""SciPy's methods: ``scipy.integrate.solve_ivp`` is called between breakpoints.

LSODA receives a first step. Its default is far too long if all rates are zero at the start and grow
soon after, as in a stiff circuit with a sine source, and it shortens a step only a few times.
"""

from __future__ import annotations

import contextlib
import threading
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import SolveError
from cotree.methods import METHODS
from cotree.model.linear import solve_with
from cotree.quiet import without_warnings
from cotree.solvers.budgets import Progress, Thinning, steps_spent
from cotree.solvers.guarded_calls import Evaluator, IntegrationStopError, augmented_tolerances
from cotree.solvers.native import ROUNDING_LEVEL, summary
from cotree.solvers.problem import RunProblem, beyond_scipy, check_problem, segments
from cotree.solvers.result import BUDGET_SPENT, FAILED, FloatArray, Statistics, Trajectory
from cotree.tolerances import LIMITS

if TYPE_CHECKING:
    from collections.abc import Callable


_SHARE = 0.01


def first_step(
    rates_at: Callable[[float, FloatArray], FloatArray],
    t: float,
    z: FloatArray,
    t_end: float,
    longest: float,
    tolerances: tuple[float, FloatArray],
) -> float:
    """Return a first step, [s], for order 1 (Hairer, Norsett, Wanner, ODEs I, 2nd ed., II.4)."""
    rtol, atol = tolerances
    weights = 1.0 / (atol + rtol * np.abs(z))
    rates = rates_at(t, z)
    # d0, d1 and h0 of the reference: norms of values and rates relative to the tolerances, and a
    # step that changes the values by one percent.
    size, slope = _norm(z * weights), _norm(rates * weights)
    # Shorter steps would be lost in the rounding of t.
    least = 4.0 * float(np.spacing(max(abs(t), abs(t_end))))
    trial = 1e-6 if min(size, slope) < 1e-5 else _SHARE * size / slope
    trial = min(max(trial, least), longest)
    direction = 1.0 if t_end > t else -1.0
    # The norm d2 of the second derivative follows from an explicit Euler step of h0.
    ahead = rates_at(t + direction * trial, z + direction * trial * rates)
    bend = _norm((ahead - rates) * weights) / trial
    steepest = max(slope, bend) if np.isfinite(bend) else slope
    if steepest <= 1e-15:
        return min(max(1e-6, 1e-3 * trial), longest)
    # h1 of the reference, for order 1: the error of a step is proportional to its square.
    return min(100.0 * trial, max(float(np.sqrt(_SHARE / steepest)), least), longest)


def _norm(scaled: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(scaled)))) if scaled.size else 0.0


_one_at_a_time = threading.RLock()

# If rates are nan, methods shorten a step. This number of such evaluations ends a run.
_MOST_IGNORED = 1000

# Maximum rounding error of the time of a stored step, relative to the time since the last one.
_FINE = 1e-2

#: Message if a method such as Radau damps a growing mode, which its error estimate cannot detect.
_DAMPED = "its steps damp a mode that grows faster than they can resolve: use 'rodas5'"


def solve_with_scipy(problem: RunProblem, method: str) -> Trajectory:
    """Integrate with "RK45", "DOP853", "RK23", "Radau", "BDF" or "LSODA"."""
    check_problem(problem)
    what = beyond_scipy(problem)
    if what:
        raise SolveError(
            f"The method '{method}' cannot take {what}: use '{METHODS[method].instead}', which "
            "runs in C."
        )
    from scipy.integrate import _ode

    # In older versions of SciPy, LSODA is Fortran code with global variables.
    is_global = method == "LSODA" and hasattr(_ode.lsoda, "active_global_handle")
    lock: Any = _one_at_a_time if is_global else contextlib.nullcontext()
    # Warnings of SciPy are suppressed, because this module reports values that are not finite.
    with lock, np.errstate(all="ignore"), without_warnings(module=r"scipy\."):
        return _Run(problem, method).trajectory()


class _Run:
    def __init__(self, problem: RunProblem, method: str) -> None:
        self.problem, self.method = problem, method
        self.evaluator = Evaluator(problem)
        self.progress = Progress(method, problem.settings.t_span)
        self.t, self.z = float(problem.settings.t_span[0]), np.array(problem.z0, dtype=np.float64)
        self.times: list[float] = []
        self.columns: list[FloatArray] = []
        self.thinning = Thinning()
        self.n_steps = self.nlu = 0
        self.stop: IntegrationStopError | None = None

    def trajectory(self) -> Trajectory:
        """Integrate from one breakpoint to the next, and return the stored points."""
        begin, problem = time.perf_counter(), self.problem
        if problem.settings.t_eval is None:
            self._store_step()
        with self.progress:
            for start, end in segments(problem):
                try:
                    self._integrate(start, end)
                except IntegrationStopError as stop:
                    self.stop = stop
                if self.stop is not None:
                    break
        # The last step may not be stored if the stride exceeds 1.
        is_cut = self.stop is not None or self.thinning.stride > 1
        if is_cut and self.times[-1:] != [self.t]:
            self._store(self.t, self.z)
        status, reason = (0, "") if self.stop is None else (self.stop.status, self.stop.reason)
        cause = self.evaluator.not_finite
        if reason and cause and cause not in reason:
            reason = f"{reason}; {cause}"
        counts = self.evaluator.nfev, self.evaluator.njev, self.nlu, self.n_steps
        statistics = Statistics(self.method, *counts, time.perf_counter() - begin)
        sentences = [*summary(problem, self.method, self.t, reason), self.thinning.note]
        return Trajectory(
            t=np.array(self.times),
            z=np.array(self.columns).reshape(len(self.columns), problem.size).T.copy(),
            status=status,
            message=" ".join(sentences).rstrip(),
            statistics=statistics,
        )

    def _integrate(self, start: float, end: float) -> None:
        import scipy.integrate

        if self.problem.reach is not None:
            self.problem.reach(start, self.z)
        self.evaluator.open_segment(start, end)
        limit = self.spent()
        # SciPy's choice of the first step does not end if rates are not finite.
        if limit is None and not np.isfinite(self.evaluator.rhs(start, self.z)).all():
            limit = IntegrationStopError(FAILED, "the integrator cannot start")
        if limit is not None:
            raise limit
        segment = _ScipySegment(self, start, end)
        wanted = self._wanted(start, end)
        # SciPy requires distinct ascending times. Without requested times, this class stores steps.
        way = self.problem.direction
        times, places = np.unique(way * (wanted - start), return_inverse=True)
        try:
            options = {"t_eval": way * times, "events": segment, **segment.options()}
            span, z = (0.0, end - start), self.z[self.problem.integrated]
            found = scipy.integrate.solve_ivp(segment.rates, span, z, self.method, **options)
        except (RuntimeError, ValueError) as error:
            # SuperLU and SciPy's checks raise these errors; functions of the user raise others.
            if not str(error).endswith(("exactly singular", "infs or NaNs")):
                raise
            reason = "the iteration matrix is singular or not finite"
            raise IntegrationStopError(FAILED, reason) from None
        self.nlu += int(found.nlu)
        for t, place in zip(wanted.tolist(), places.tolist(), strict=True):
            if place < len(found.t):
                self._store(t, segment.whole(found.y[:, place]))
        if self.stop is None and found.status == -1:
            is_short = "step size" in found.message and "less than" in found.message
            reason = ROUNDING_LEVEL if is_short else "the solver gave up on its step"
            self.stop = IntegrationStopError(FAILED, reason)

    def step_done(self, t: float, z: FloatArray, rounding: float) -> None:
        """Count a step; if all steps are stored and ``rounding`` is small, store its end."""
        self.n_steps += 1
        self.t, self.z = t, z
        self.evaluator.step_done()
        self.progress.reached(t)
        if self.problem.settings.t_eval is None and rounding <= _FINE * abs(t - self.times[-1]):
            self._store_step()

    def spent(self) -> IntegrationStopError | None:
        """Return an exception if the run has reached its limit of steps, else None."""
        limit = self.problem.settings.max_steps
        if limit is None or self.problem.steps_taken + self.n_steps < limit:
            return None
        return IntegrationStopError(BUDGET_SPENT, steps_spent(limit))

    def _wanted(self, start: float, end: float) -> FloatArray:
        """Return the requested times in (start, end], or in [start, end] at the start of a run."""
        if self.problem.settings.t_eval is None:
            return np.zeros(0)
        times, way = np.asarray(self.problem.settings.t_eval, dtype=float), self.problem.direction
        is_first = start == self.problem.settings.t_span[0]
        after = way * (times - start) >= 0.0 if is_first else way * (times - start) > 0.0
        return times[after & (way * (times - end) <= 0.0)]

    def _store(self, t: float, z: FloatArray) -> None:
        self.times.append(t)
        self.columns.append(z)

    def _store_step(self) -> None:
        """Store the last point; if the memory is full, first drop every second stored point."""
        if len(self.times) >= self.problem.most_rows:
            kept = self.thinning.thin()
            self.times, self.columns = self.times[kept], self.columns[kept]
        if range(1)[self.thinning.select(1)]:
            self._store(self.t, self.z)


class _ScipySegment:
    """Functions for ``solve_ivp`` between two breakpoints; the object is also an event function.

    The time s begins at zero in each segment, because the rounding of a large t would disturb each
    step. The vector w contains the entries of z that are not identically zero.
    """

    terminal = True

    def __init__(self, run: _Run, start: float, end: float) -> None:
        self._run, self._start, self._end = run, start, end
        self._last = 0.0
        self._n_short = self._n_ignored = 0
        self._matrix: Any = None
        self._w: FloatArray = np.zeros(0)  # w at the end of the previous step

    def __call__(self, s: float, w: FloatArray) -> float:
        """Record a step; return a value that changes its sign if the run must stop."""
        run = self._run
        if run.stop is not None:  # SciPy locates the zero of this function
            return self._last - s
        if s == 0.0:
            self._w = w.copy()
            return 1.0
        if not np.isfinite(w).all():
            run.stop = IntegrationStopError(FAILED, "the solution is no longer finite")
            return -1.0  # SciPy then ends at the previous step, which is the last valid one
        before, self._last = self._last, s
        is_end = s == self._end - self._start
        t, z = self._end if is_end else self._start + s, self.whole(w)
        # The absolute time is rounded, so the rates extrapolate the values to the rounded time.
        rounding = 0.0 if is_end else (t - self._start) - s
        if rounding and run.problem.settings.t_eval is None:
            z += rounding * self.whole(self.rates(s, w))
        if run.method == "Radau" and self._is_turned(before, w):
            run.stop = IntegrationStopError(FAILED, _DAMPED)
            return 0.0
        self._w = w.copy()
        run.step_done(t, z, abs(rounding))
        if is_end:
            return 1.0
        is_short = abs(s - before) <= LIMITS.stall_spacings * np.spacing(abs(s))
        self._n_short = self._n_short + 1 if is_short else 0
        if not is_short:
            run.evaluator.not_finite = ""
        # LSODA does not stop by itself if its steps reach the spacing of floating-point times.
        if self._n_short >= LIMITS.stall_steps:
            run.stop = IntegrationStopError(FAILED, ROUNDING_LEVEL)
            return 0.0
        run.stop = run.stop or run.spent()
        return 1.0 if run.stop is None else 0.0

    def _is_turned(self, before: float, w: FloatArray) -> bool:
        """Return whether a step damps a fast growing mode.

        Let r be the residual of the trapezoidal rule and x the solution of (I - h J / 2) x = r. For
        decaying modes, x has the sign of r. For a fast growing mode, it has the opposite sign and
        about the same size.
        """
        step = self._last - before
        # The residual is the step of the trapezoidal rule minus the actual step.
        rates = self.rates(before, self._w) + self.rates(self._last, w)
        left = 0.5 * step * rates - (w - self._w)
        rtol, atol = augmented_tolerances(self._run.problem)
        weights = 1.0 / (atol + rtol * np.maximum(np.abs(w), np.abs(self._w)))
        # Residuals below the tolerance have arbitrary signs.
        seen = np.abs(left * weights) > 1.0
        if not np.any(seen) or self._matrix is None:
            return False
        solved = _solve(self._matrix, 0.5 * step, left)
        one, other = (left * weights)[seen], (solved * weights)[seen]
        sizes = np.linalg.norm(one) * np.linalg.norm(other)
        return bool(np.vdot(one, other) < -LIMITS.opposed_cosine * sizes)

    def whole(self, w: FloatArray) -> FloatArray:
        """Return z as a new array, including the entries that are identically zero."""
        z = np.zeros(self._run.problem.size)
        z[self._run.problem.integrated] = w
        return z

    def rates(self, s: float, w: FloatArray) -> FloatArray:
        """Return the rates of the integrated entries; after a stop, nan, which ends the method."""
        run = self._run
        if run.stop is None:
            try:
                dz = run.evaluator.rhs(self._start + s, self.whole(w))
                found: FloatArray = dz[run.problem.integrated]
                return found
            except IntegrationStopError as stop:
                run.stop = stop
        self._n_ignored += 1
        if self._n_ignored > _MOST_IGNORED:
            raise run.stop
        return np.full(len(w), np.nan)

    def options(self) -> dict[str, Any]:
        run = self._run
        rtol, atol = augmented_tolerances(run.problem)
        longest = min(run.problem.max_step, abs(self._end - self._start))
        found: dict[str, Any] = {"rtol": rtol, "atol": atol, "max_step": longest}
        if METHODS[run.method].implicit:
            found["jac"] = self._jacobian
        # If all rates are zero, LSODA's default is a fraction of the span, with which it fails.
        if run.method == "LSODA":
            begin = 0.0, run.z[run.problem.integrated], self._end - self._start
            found["first_step"] = first_step(self.rates, *begin, longest, (rtol, atol))
        return found

    def _jacobian(self, s: float, w: FloatArray) -> Any:
        """Return the Jacobian, as a sparse matrix if that is cheaper and the method accepts it."""
        run, z = self._run, self.whole(w)
        evaluator, places = run.evaluator, run.problem.integrated
        if run.stop is not None and self._matrix is not None:
            return self._matrix
        try:
            is_dense = run.method == "LSODA"
            matrix = evaluator.augmented_jacobian(self._start + s, z, is_dense=is_dense)
        except IntegrationStopError as stop:
            run.stop = stop
            if self._matrix is None:
                raise
            return self._matrix
        if run.problem.places is not None:
            if isinstance(matrix, np.ndarray):
                matrix = np.ascontiguousarray(matrix[np.ix_(places, places)])
            else:
                matrix = matrix[places][:, places]
        self._matrix = matrix
        return matrix


def _solve(jacobian: Any, share: float, left: FloatArray) -> FloatArray:
    """Solve (I - share * J) x = left for x; return zeros if the matrix is singular."""
    from scipy.sparse import identity

    n = len(left)
    unit = np.eye(n) if isinstance(jacobian, np.ndarray) else identity(n, format="csc")
    try:
        return solve_with(unit - share * jacobian, left)
    except np.linalg.LinAlgError:
        return np.zeros_like(left)
