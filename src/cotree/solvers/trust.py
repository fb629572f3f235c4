"""Warnings and failures for runs whose tolerances are too loose or corrections too large."""

from __future__ import annotations

import math
import sys
import warnings
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import Error
from cotree.methods import METHODS
from cotree.quiet import level_of_user
from cotree.solvers.result import FAILED
from cotree.tolerances import FARTHEST_CORRECTION, LOOSE_RTOL, loose_rtol

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import numpy.typing as npt

    from cotree.model.linear import Matrix
    from cotree.model.model import CompiledModel
    from cotree.solvers.problem import RunProblem
    from cotree.solvers.result import FloatArray, Trajectory


# Corrections are compared with rtol, but at least with this relative tolerance.
_CORRECTED_RTOL = 1e-3

# Relative tolerances for redundant constraints, onto which the projection is not unique. Above the
# first, the error of Bricard's mechanism is 10 to 300 tolerances. Above the second, or above the
# first with multistep methods, it is as large as the solution.
_ROUGH, _ROUGHEST = 1e-4, 1e-3

# The error test covers storage contents, but not the variables that they determine. The error of
# such a variable that causes a warning, in tolerances, and number of points examined.
_LEFT_FREE, _N_EXAMINED = 10.0, 50

# States below this multiple of the machine precision are rounding errors of a model at rest.
_ROUNDINGS = 16.0


def warn_of_tolerances(problem: RunProblem) -> None:
    """Warn if the relative tolerance is loose."""
    _warn(loose_rtol(problem.settings.rtol))


def warn_of_result(
    problem: RunProblem,
    trajectory: Trajectory,
    followers: Sequence[tuple[int, int]] = (),
    is_balanced: Callable[[], bool] = lambda: False,
) -> None:
    """Warn if the tolerances were too loose to control the states of a run.

    ``followers`` are pairs of indices: a storage content, and the variable that it determines.
    """
    if trajectory.status == 0:
        untested = _untested(problem, trajectory)
        if untested and not is_balanced():
            _warn(untested)
        if followers:
            _warn(_left_free(problem, trajectory, followers))


def is_balanced(model: CompiledModel, problem: RunProblem) -> bool:
    """Return whether the first rates are rounding errors of large terms, as in a robot at rest.

    Rounding errors change completely if parameters and inputs change in their tenth digit.
    """
    native, t, y = problem.native, problem.settings.t_span[0], problem.z0[: problem.n_states]
    assert native is not None  # the settings require a C compiler
    p, u = native.p, native.inputs
    with suppress(Error):
        rates = model.rhs(t, y, p, u)
        others = model.rhs(t, y, _other(p), _other(u))
        return bool(np.max(np.abs(others - rates), initial=0.0) > np.max(np.abs(rates), initial=0))
    return False


def _other(values: FloatArray) -> FloatArray:
    """Return numbers that differ in the tenth digit, each by a different relative change."""
    return values * (1.0 + 1e-10 * (1.0 + np.arange(len(values)) % 7))


def warn_of_redundancy(problem: RunProblem, trajectory: Trajectory, redundant: int) -> None:
    """Warn if constraints are redundant and the tolerance is loose."""
    if trajectory.status == 0 and redundant and problem.settings.rtol > _ROUGH:
        _warn(
            f"constraints are redundant, and errors of {trajectory.statistics.method} then exceed "
            f"the tolerance by far if rtol is above {_ROUGH:g}: give a tighter one"
        )


def check_constraint_drift(
    problem: RunProblem, trajectory: Trajectory, redundant: int
) -> Trajectory:
    """Mark a run as failed if it may have jumped to another branch of the constraints.

    This is possible if a projection changed the states by far more than the tolerance, or if the
    tolerance is too loose for ``redundant`` constraints.
    """
    drift = trajectory.drift
    if drift is None or trajectory.status != 0:
        return trajectory
    rtol, method = problem.settings.rtol, trajectory.statistics.method
    is_multistep = method in METHODS and METHODS[method].multistep
    tolerance = max(rtol, problem.settings.atol, _CORRECTED_RTOL)
    if drift.correction > FARTHEST_CORRECTION * tolerance:
        reason = (
            "the projection onto the constraints moved the states by up to "
            f"{drift.correction:.2g}, far more than the tolerance, so that the motion may have "
            f"continued along another branch: give an rtol of {0.1 * rtol:.1g} or less."
        )
    elif redundant and rtol > (loosest := _ROUGH if is_multistep else _ROUGHEST):
        reason = (
            "constraints are redundant, and at such a loose tolerance the projection may lead to "
            f"another motion: give an rtol of {loosest:g} or less."
        )
    else:
        return trajectory
    return replace(trajectory, status=FAILED, message=f"{trajectory.message} But {reason}")


def _left_free(
    problem: RunProblem, trajectory: Trajectory, followers: Sequence[tuple[int, int]]
) -> str:
    """Return a warning if the tolerance of a storage content is too loose for its variable."""
    if not followers or problem.jacobian is None:
        return ""
    totals, own = (list(places) for places in zip(*followers, strict=True))
    # Tolerances refer to the largest magnitude of a run: relative accuracy near zero is irrelevant.
    y, atol = trajectory.z[: problem.n_states], problem.state_atol
    asked = atol[own] + problem.settings.rtol * np.max(np.abs(y[own]), axis=1)
    worst, message = _LEFT_FREE, ""
    n = len(trajectory.t)
    for k in np.unique(np.linspace(0, n - 1, min(n, _N_EXAMINED)).astype(int)).tolist():
        t = float(trajectory.t[k])
        # The storage content appears in the variable's algebraic equation, so this derivative is
        # the content per unit of the variable, such as a capacitance.
        capacity = np.abs(problem.jacobian(t, y[:, k])[own, own])
        allowed = atol[totals] + problem.settings.rtol * np.abs(y[totals, k])
        left = allowed / np.maximum(capacity, np.finfo(np.float64).tiny)
        i = int(np.argmax(left / asked))
        if left[i] > worst * asked[i]:
            worst = float(left[i] / asked[i])
            message = (
                f"the tolerance of '{problem.names[totals[i]]}' allows errors of {left[i]:.1g} in "
                f"'{problem.names[own[i]]}' at t = {t:.6g}, on which it hardly depends there: "
                f"multiply rtol and atol by {1.0 / worst:.1g} if it matters"
            )
    return message


def _untested(problem: RunProblem, trajectory: Trajectory) -> str:
    """Return a warning if the absolute tolerance is large compared with all states."""
    n = problem.n_states - problem.n_algebraic
    y, atol = trajectory.z[:n], problem.settings.atol
    # The initial states are checked first, because they are often large enough.
    at_start = max(map(abs, problem.z0[:n].tolist()), default=0.0)
    if problem.sizes is None and _is_seen(at_start, atol):
        return ""
    if problem.sizes is not None:
        y = y / problem.sizes[:n, None]
    most, least = (f.reduce(y, axis=None, initial=0.0) for f in (np.maximum, np.minimum))
    largest = max(float(most), -float(least))
    # At rest, states are rounding errors, which tolerances need not control.
    if largest <= _ROUNDINGS * sys.float_info.epsilon or _is_seen(largest, atol):
        return ""
    return (
        f"no state was ever larger than {largest:.2g}, of which atol = {atol:.2g} tests little: "
        f"give an atol below {LOOSE_RTOL * largest:.1g}"
    )


def _is_seen(largest: float, atol: float) -> bool:
    """Return whether an absolute tolerance is small enough for states of the given magnitude."""
    return not largest < atol / LOOSE_RTOL  # the negation makes nan count as seen


def _warn(message: str) -> None:
    if message:
        warnings.warn(message, RuntimeWarning, stacklevel=level_of_user())


# The spacing of t has no effect if it is below this fraction of (rtol * step size).
_FINE = 0.1

# Number of steps whose rounding errors add up. The errors are independent, so their sum is
# proportional to the square root of this number.
_REMEMBERED = 100

# Number of points examined, and increment of finite differences as a fraction of a step.
_POINTS, _REACH = 5, 1.0 / 16.0


def check_time_resolution(problem: RunProblem, trajectory: Trajectory) -> Trajectory:
    """Mark a run as failed if errors due to the rounding of t exceed the tolerance."""
    n_steps = trajectory.statistics.n_steps
    is_empty = not n_steps or not trajectory.t.size
    if trajectory.status != 0 or is_empty or is_fine(problem, n_steps):
        return trajectory
    step = abs(problem.settings.t_span[1] - problem.settings.t_span[0]) / n_steps
    places = np.unique(np.linspace(0, trajectory.t.size - 1, _POINTS).astype(int))
    # Tolerances refer to the largest magnitudes, because values may pass through zero.
    largest = np.max(np.abs(trajectory.z[: problem.n_states]), axis=1)
    allowed = problem.state_atol + problem.settings.rtol * largest
    with np.errstate(all="ignore"):
        shares = [
            _share(problem, float(trajectory.t[j]), trajectory.z[:, j].copy(), step, allowed)
            for j in places
        ]
    shares = [math.sqrt(min(n_steps, _REMEMBERED)) * share for share in shares]
    worst = int(np.argmax(shares))
    if shares[worst] <= 1.0:
        return trajectory
    t = float(trajectory.t[places[worst]])
    reason = (
        f"{trajectory.statistics.method} cannot keep the tolerance: at t = {t:.10g} times are "
        f"{math.ulp(t):.2g} s apart, and over steps of {step:.2g} s this rounding changes the "
        f"solution by {shares[worst]:.2g} times the tolerance. Start the run nearer to "
        "t = 0, or loosen rtol."
    )
    return replace(trajectory, status=FAILED, message=reason)


def is_fine(problem: RunProblem, n_steps: int | npt.NDArray[np.int64]) -> Any:
    """Return whether the rounding of times has no effect, for one number of steps or an array."""
    start, end = problem.settings.t_span
    # Runs without steps count as runs with one step.
    steps = abs(end - start) / (n_steps + (n_steps == 0))
    return math.ulp(max(abs(start), abs(end))) <= _FINE * problem.settings.rtol * steps


def _share(problem: RunProblem, t: float, z: FloatArray, step: float, allowed: FloatArray) -> float:
    """Return the error of a step due to the rounding of t, as a fraction of the tolerance.

    The error is computed forwards and backwards in time, and the smaller value is returned, because
    a jump affects only one of them.
    """
    y = z[: problem.n_states]
    low, high = sorted(problem.settings.t_span)
    ahead = max(_REACH * step, math.ulp(t))
    times = [at for at in (t - ahead, t + ahead) if low <= at <= high]
    try:
        here = _rates(problem, t, y)
        changes = [_over_step(problem, t, y, step, _rates(problem, at, y) - here) for at in times]
    except Error:
        return 0.0
    n = problem.n_states - problem.n_algebraic
    sizes = [float(np.sqrt(np.mean(np.square(c[:n] / allowed[:n])))) for c in changes]
    least = min((size for size in sizes if np.isfinite(size)), default=0.0)
    # The change over the time `ahead` is scaled to the rounding error of t, half a spacing.
    return 0.5 * least * math.ulp(t) / ahead


def _rates(problem: RunProblem, t: float, y: FloatArray) -> FloatArray:
    assert problem.state_rhs is not None  # the problem has a model
    return np.array(problem.state_rhs(t, y), dtype=np.float64)


def _over_step(
    problem: RunProblem, t: float, y: FloatArray, step: float, change: FloatArray
) -> FloatArray:
    """Return the change of the states in an implicit step due to a change of the rates."""
    if not np.any(change):
        return change
    from cotree.model.linear import solve_with

    # (M / h - J) x = change is an implicit Euler step of length h with disturbed rates; M has zeros
    # for algebraic unknowns. Without stiffness, x is h times the change.
    shift = np.zeros(problem.n_states)
    shift[: problem.n_states - problem.n_algebraic] = 1.0 / step
    if problem.sparse_jacobian is not None:
        from scipy.sparse import diags

        matrix: Matrix = diags(shift) - problem.sparse_jacobian(t, y)
    else:
        assert problem.jacobian is not None
        matrix = np.diag(shift) - np.array(problem.jacobian(t, y))
    try:
        return solve_with(matrix, change)
    except np.linalg.LinAlgError:
        # This is the change without damping.
        return step * change
