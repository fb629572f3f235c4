"""Choice of a method for a problem, and integration with it."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cotree.errors import SingularSystemError, SolveError
from cotree.methods import METHODS, method_row
from cotree.records import changed
from cotree.solvers.engine import has_sundials
from cotree.solvers.native import begin_in_c, check_available, engine_of, with_compile_time
from cotree.solvers.problem import RTOL_FLOOR, beyond_scipy, check_problem, refusal, restart_times
from cotree.solvers.result import FAILED

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree.methods import Method
    from cotree.solvers.job import Job
    from cotree.solvers.native import Attempt
    from cotree.solvers.problem import RunProblem
    from cotree.solvers.result import FloatArray, Trajectory

# A problem counts as stiff if the span exceeds this number of time constants. DOP853, with 12
# evaluations per step, is stable up to about |lambda| h = 6. It then needs 4000 evaluations, as
# many as an implicit method at usual tolerances.
_STIFF_TIME_CONSTANTS = 2000.0

# An explicit method is used if the fastest decay is at most this multiple of the fastest growth,
# because steps that resolve the growth are then nearly as short as stability requires.
_MILD = 10.0

# The C method for problems without states.
_STATIC = "dop853"

_PROBE_STEPS = 20
_PROBE_RTOL = 1e-3


def integrate(problem: RunProblem, method: str = "auto") -> Trajectory:
    """Integrate a problem with a method of ``METHODS``, or with "auto".

    A failed integration returns a status other than 0. Raises SolveError if the method is unknown
    or not installed, or the problem cannot be accepted.
    """
    check_problem(problem)
    return run(problem, method)


def run(problem: RunProblem, method: str) -> Trajectory:
    """Integrate a checked problem; see :func:`integrate`."""
    if method != "auto":
        return _solve(problem, method)
    before = time.perf_counter()
    # The choice of a method takes steps with this engine; its compilation is timed separately.
    if not refusal("dop853", problem):
        engine_of("dop853", problem)
    compiling = time.perf_counter() - before
    method, reason, begun = _choose(problem)
    trajectory = _with_ida(problem, _solve_watched(problem, method, begun))
    trajectory = with_compile_time(trajectory, trajectory.statistics.compile_seconds + compiling)
    return changed(trajectory, message=f"{trajectory.message} {reason}")


def _with_ida(problem: RunProblem, first: Trajectory) -> Trajectory:
    """Repeat the run with "ida" if another method could not solve for algebraic unknowns.

    "ida" solves for states and unknowns together; other methods solve for unknowns at given states.
    """
    own = METHODS[first.statistics.method]
    if not (first.is_unsolved and problem.n_algebraic and own.family == "cotree"):
        return first
    from cotree.solvers.messages import fold

    if fold(problem, first):  # no method can pass a fold
        return first
    limit, taken = problem.settings.time_limit, problem.steps_taken + first.statistics.n_steps
    limit = None if limit is None else limit - first.statistics.seconds
    is_spent = problem.settings.max_steps is not None and taken >= problem.settings.max_steps
    if is_spent or (limit is not None and limit <= 0) or not has_sundials():
        return first
    # Sampled inputs permit only a single integration.
    if refusal("ida", problem) or problem.reach is not None:
        return first
    second = _solve(changed(problem.with_settings(time_limit=limit), steps_taken=taken), "ida")
    if second.status != 0:
        return changed(first, message=f"{first.message} Nor did ida: {second.message}")
    from cotree.solvers.stiffness import summed

    return changed(
        second,
        message=f"{second.message} ida restarted the run, since {first.message.rstrip('.')}.",
        statistics=summed(first.statistics, second.statistics),
    )


@dataclass
class MethodSwitch:
    """The switch of one run to a method for stiff problems."""

    #: Function ``solve(problem, method)`` that integrates with a named method.
    solve: Callable[[RunProblem, str], Trajectory]
    #: First step that is tested for stiffness; the choice of the method examined earlier steps.
    first_step: int = 0
    note: str = ""  # remark on the outcome; empty if no switch was attempted
    _has_failed: bool = False

    def take_over(self, problem: RunProblem, first: Trajectory, job: Job) -> Trajectory | None:
        """Continue a stiff problem from the last point of a job to the end of the span.

        ``first`` contains the points stored so far. Return the whole trajectory, or None if the job
        must continue.
        """
        from cotree.solvers import stiffness

        c, method = job.job, first.statistics.method
        # The job may continue from this point, so the new run gets a copy.
        t, z, since = float(c.t), job.z.copy(), float(c.stiff_since)
        if self._has_failed or not stiffness.is_confirmed(
            problem, t, z, float(c.last_step), method
        ):
            return None
        self.note = stiffness.obstacle(problem, t, z, method)
        if self.note:
            return None
        rest = stiffness.rest(problem, first, t, z)
        if rest is None:
            return None
        other = stiffness.stiff_method(problem)
        second = self.solve(rest, other)
        became = f"from t = {since:.6g} on its steps were as short as stability requires"
        # A further attempt would fail at the same point.
        if second.status == FAILED:
            self._has_failed = True
            self.note = f"{method} continued, although {became}: {second.message}"
            return None
        note = f"{other} took over from {method} at t = {t:.10g}: stiff, {became}."
        return stiffness.joined(problem, first, changed(second, message=f"{second.message} {note}"))


def _solve_watched(problem: RunProblem, method: str, begun: Attempt | None) -> Trajectory:
    """Integrate, and switch to a method for stiff problems if the problem becomes stiff."""
    row = method_row(method)
    # Only the explicit C steppers detect stiffness.
    if row.family != "cotree" or row.implicit:
        return _solve(problem, method)
    successor = MethodSwitch(_solve, probe_steps(problem.settings.rtol))
    return _solve(problem, method, successor, begun)


def _solve(
    problem: RunProblem,
    method: str,
    successor: MethodSwitch | None = None,
    begun: Attempt | None = None,
) -> Trajectory:
    """Integrate a checked problem with a named method or its substitute."""
    row = method_row(method)
    if problem.n_states == problem.n_algebraic and row.family != "cotree":
        # If all states are algebraic unknowns, every C method only solves for them at output times.
        attempt = begun or begin_in_c(problem, _STATIC)
        if not isinstance(attempt, str):
            return attempt.finish()
    if not row.stepper:
        from cotree.solvers.scipy_ivp import solve_with_scipy

        return solve_with_scipy(problem, method)
    if row.family != "cotree":
        check_available(method)
    attempt = begun or begin_in_c(problem, method)
    if isinstance(attempt, str):
        return _run_substitute(problem, row, attempt)
    return attempt.finish(successor)


def _run_substitute(problem: RunProblem, row: Method, why: str) -> Trajectory:
    """Integrate with the substitute of a method that C cannot run; the message gives the reason."""
    what, other, method = beyond_scipy(problem), row.instead, row.name
    if row.family == "correctors":
        raise SolveError(
            f"The method '{method}' cannot take this problem: {why}. "
            f"Use '{other}', which takes states and sensitivities as one vector."
        )
    # The stages of Rosenbrock methods violate dependent constraints; other C methods do not.
    if what and problem.native is not None and other == "Radau":
        other = "cvode" if has_sundials() else "dopri5"
    elif what:
        raise SolveError(
            f"The method '{method}' cannot run: {why}. Its substitute '{other}' does not "
            f"support {what}: use 'dop853' or 'rodas5', which run in C."
        )
    trajectory = _solve(problem, other)
    message = f"{trajectory.message} {other} was used instead of {method}: {why}."
    return changed(trajectory, message=message)


def choose_method(problem: RunProblem) -> tuple[str, str]:
    """Return a method and the reason for it, based on the fastest decay early in the run.

    Strongly damped modes with time constants far below the span force explicit methods to take
    steps that are shorter than accuracy requires. Modes that oscillate faster than they decay are
    ignored, because every method needs short steps for them. If stiffness appears later, "dop853"
    detects it; see :mod:`cotree.solvers.stiffness`.

    Methods for stiff problems may damp a growing mode whose amplitude is below the tolerance; their
    error estimates cannot detect this. If such a mode exists at the start, the result is an
    explicit method if possible; otherwise the reason mentions the mode.
    """
    check_problem(problem)
    method, reason, begun = _choose(problem)
    if begun is not None:
        begun.abandon()
    return method, reason


def _choose(problem: RunProblem) -> tuple[str, str, Attempt | None]:
    """Return a method, the reason for it, and the integration if it has begun."""
    if problem.n_states == problem.n_algebraic:
        method = "DOP853" if refusal(_STATIC, problem) else _STATIC
        return method, "There are no states to integrate.", None
    explicit = "DOP853" if refusal("dop853", problem) else "dop853"
    probe = Probe(problem, explicit)
    method, reason = _chosen(problem, explicit, _rates(problem, probe))
    if probe.begun is not None and method != explicit:
        probe.begun.abandon()
        probe.begun = None
    return method, reason, probe.begun


def _chosen(problem: RunProblem, explicit: str, rates: Rates) -> tuple[str, str]:
    """Return an explicit method or a method for stiff problems, and the reason for the choice."""
    span = abs(problem.settings.t_span[1] - problem.settings.t_span[0])
    # The span, measured in time constants of the fastest damped mode.
    count = span * rates.decay
    most = "at most " if rates.is_bound else ""
    length = f"the span is {most}{float(f'{count:.2g}'):.6g} times the shortest decay"
    if count <= _STIFF_TIME_CONSTANTS:
        reason = f"not stiff, {length}" if count >= 1.0 else "not stiff, nothing decays fast"
        return explicit, f"{explicit} was chosen: {reason}."
    from cotree.solvers.stiffness import stiff_method

    method = stiff_method(problem)
    growth = rates.growth
    # An implicit method may be used if a mode that grows from the tolerance stays below one during
    # the whole span.
    smallest = min(problem.settings.rtol, problem.settings.atol)
    if span * growth <= -math.log(max(smallest, float(np.finfo(np.float64).eps))):
        return method, f"{method} was chosen: stiff, {length}{_saving(problem, method)}."
    grows = f"at the start a mode grows e-fold every {1.0 / growth:.3g} s"
    if explicit == "dop853" and rates.first_decay <= _MILD * growth:
        return explicit, (
            f"{explicit} was chosen to begin with: stiff, {length}, but {grows}, which {method} "
            "would damp while it is below the tolerance."
        )
    return method, (
        f"{method} was chosen: stiff, {length}. But {grows}: what is below the tolerance there "
        "may decide the result, so compare with that of a tighter one."
    )


def _saving(problem: RunProblem, method: str) -> str:
    """Return a remark that rodas5 would take longer if cvode was chosen for this reason."""
    from cotree.solvers.stiffness import cost_of_rodas5

    cost = cost_of_rodas5(problem) if method == "cvode" else 0.0
    return f", and rodas5 would take about {cost:.2g} times as long" if cost > 1.0 else ""


class Rates(NamedTuple):
    """Rates of the modes on which the choice of a method depends, [1/s].

    ``decay`` is the fastest decay at the start and after a few steps or, if ``is_bound``, an upper
    bound. The other rates hold at the start, and are zero without stiffness.
    """

    decay: float
    first_decay: float = 0.0
    growth: float = 0.0
    is_bound: bool = False


def _rates(problem: RunProblem, probe: Probe) -> Rates:
    """Return the rates of the modes, cached for runs with equal parameters and starts."""
    native, shared = problem.native, problem.shared
    if native is None or shared is None:
        return probe.rates()
    return shared.finding(probe.rates, native.p, problem.z0)


class Probe:
    """Mode rates at the start and a few steps later; ``begun`` if the run itself took the steps."""

    def __init__(self, problem: RunProblem, explicit: str) -> None:
        self._problem, self._explicit = problem, explicit
        self.begun: Attempt | None = None

    def rates(self) -> Rates:
        """Compute the rates of the modes."""
        problem, explicit = self._problem, self._explicit
        # With algebraic unknowns or sampled inputs, the trial steps are not steps of the run.
        if explicit != "dop853" or problem.reach is not None or problem.n_algebraic:
            return self._by_eigenvalues(_loose_steps(problem, explicit))
        start, first = (float(problem.settings.t_span[0]), problem.z0), None
        bound = bound_of_decay(problem, *start)
        if not self._is_mild(bound):
            from cotree.solvers.stiffness import fastest_decay

            first = fastest_decay(problem, [start])
            if not self._is_mild(first):  # no trial step is needed
                return self._by_eigenvalues([start], first)
        later = self._begin()
        bound = max([bound, *(bound_of_decay(problem, *point) for point in later)])
        if self._is_mild(bound):
            return Rates(bound, is_bound=True)
        return self._by_eigenvalues([start, *later], first)

    def _is_mild(self, decay: float) -> bool:
        """Return whether an explicit method may be used for modes with the given decay rate."""
        start, end = self._problem.settings.t_span
        return abs(end - start) * decay <= _STIFF_TIME_CONSTANTS

    def _by_eigenvalues(
        self, points: Sequence[tuple[float, FloatArray]], first: float | None = None
    ) -> Rates:
        """Compute the rates at the given points; ``first`` is the decay at the first, if known."""
        from cotree.solvers.stiffness import fastest_decay, fastest_growth

        problem = self._problem
        if first is None:
            first = fastest_decay(problem, points[:1])
        decay = max(first, fastest_decay(problem, points[1:]))
        if self._is_mild(decay):
            return Rates(decay)
        return Rates(decay, first, fastest_growth(problem, *points[0]))

    def _begin(self) -> list[tuple[float, FloatArray]]:
        attempt = begin_in_c(self._problem, self._explicit)
        if isinstance(attempt, str):  # there is no compiler for the method's engine
            return []
        self.begun = attempt
        attempt.take_steps(probe_steps(self._problem.settings.rtol))
        return [(float(attempt.job.job.t), attempt.job.z.copy())]


def bound_of_decay(problem: RunProblem, t: float, z: FloatArray) -> float:
    """Return an upper bound of the decay rates of modes at a point, [1/s]; infinite if unknown.

    The bound is the Frobenius norm of the Jacobian, which no magnitude of an eigenvalue exceeds.
    """
    # Eliminating unknowns is expensive, and the Jacobian is large near dependent constraints.
    if problem.n_algebraic or problem.singular is not None or problem.jacobian is None:
        return math.inf
    y = z[: problem.n_states]
    try:
        if problem.sparse_jacobian is not None:
            entries = problem.sparse_jacobian(t, y).data
        else:
            entries = np.asarray(problem.jacobian(t, y)).ravel()
    except (SingularSystemError, SolveError):
        return math.inf
    with np.errstate(over="ignore"):
        square = float(entries.dot(entries))
    return math.sqrt(square) if math.isfinite(square) else math.inf


def probe_steps(rtol: float) -> int:
    """Return the number of "dop853" steps in the time of a few steps at a loose tolerance."""
    # Step sizes of a method of order 8 are proportional to the eighth root of the tolerance.
    share = max(1.0, _PROBE_RTOL / max(rtol, RTOL_FLOOR))
    return math.ceil(_PROBE_STEPS * math.pow(share, 0.125))


def _loose_steps(problem: RunProblem, method: str) -> list[tuple[float, FloatArray]]:
    """Return the start, and the end point of a few steps at a loose tolerance."""
    span = problem.settings.t_span
    if problem.reach is not None:
        # The steps end at the first breakpoint, because only the run itself may take samples.
        start, end = restart_times(problem)[:2].tolist()
        span = start, end
    rtol = max(problem.settings.rtol, _PROBE_RTOL)
    probe = problem.with_settings(t_eval=None, rtol=rtol, max_steps=_PROBE_STEPS, t_span=span)
    trajectory = _solve(probe, method)
    if not trajectory.t.size:
        return []
    return [(float(trajectory.t[i]), trajectory.z[:, i].copy()) for i in (0, -1)]
