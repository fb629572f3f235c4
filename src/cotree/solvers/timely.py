"""A check that the rounding of t does not decide a result.

In: a ``Problem`` and its ``Trajectory``. Out: the trajectory, marked as failed where rates depend
on time and t is too large to tell the times of a step apart. Where rates do not depend on t, its
rounding changes nothing.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import Error
from cotree.model.linear import solve_with
from cotree.solvers.evaluate import FAILED

if TYPE_CHECKING:
    import numpy.typing as npt

    from cotree.model.linear import Matrix
    from cotree.solvers.base import FloatArray, Trajectory
    from cotree.solvers.problem import Problem

# A spacing of t below this share of rtol times a step is not looked at any further.
_FINE = 0.1

# Roundings of successive steps are independent, so their sum grows with the square root of the
# number of steps, up to as many as this.
_REMEMBERED = 100

# So many points are looked at, and how far ahead and back, as a share of a step.
_POINTS, _REACH = 5, 1.0 / 16.0


def timely(problem: Problem, trajectory: Trajectory) -> Trajectory:
    """Fail a trajectory that the rounding of t decides."""
    n_steps = trajectory.statistics.n_steps
    if trajectory.status != 0 or not n_steps or not trajectory.t.size:
        return trajectory
    if is_fine(problem, n_steps):
        return trajectory
    step = abs(problem.settings.t_span[1] - problem.settings.t_span[0]) / n_steps
    places = np.unique(np.linspace(0, trajectory.t.size - 1, _POINTS).astype(int))
    # Of a value that passes zero no method has more digits than of what it swings between.
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
        f"{_spacing(t):.2g} s apart, and over steps of {step:.2g} s the rates' dependence on time "
        f"makes {shares[worst]:.2g} times the tolerance of that. Let the run begin nearer to "
        "t = 0, or loosen rtol."
    )
    return replace(trajectory, status=FAILED, message=reason)


def is_fine(problem: Problem, n_steps: int | npt.NDArray[np.int64]) -> Any:
    """Return whether times are so near to each other that their rounding decides nothing.

    Parameters
    ----------
    problem : Problem
        The problem.
    n_steps : int, or ndarray of int
        Steps of a run, or of several.
    """
    start, end = problem.settings.t_span
    # Steps are counted where there is any.
    steps = abs(end - start) / (n_steps + (n_steps == 0))
    return _spacing(max(abs(start), abs(end))) <= _FINE * problem.settings.rtol * steps


def _spacing(t: float) -> float:
    return math.ulp(t)


def _share(problem: Problem, t: float, z: FloatArray, step: float, allowed: FloatArray) -> float:
    """Return the change by half a spacing of t over a step, as a share of the tolerance.

    Of the changes ahead and back the smaller one is taken: a jump of the rates is at one side.
    """
    y = z[: problem.n_states]
    low, high = sorted(problem.settings.t_span)
    ahead = max(_REACH * step, _spacing(t))
    times = [at for at in (t - ahead, t + ahead) if low <= at <= high]
    try:
        here = _rates(problem, t, y)
        changes = [_over_step(problem, t, y, step, _rates(problem, at, y) - here) for at in times]
    except Error:
        return 0.0
    n = problem.n_states - problem.n_algebraic
    sizes = [float(np.sqrt(np.mean(np.square(c[:n] / allowed[:n])))) for c in changes]
    least = min((size for size in sizes if np.isfinite(size)), default=0.0)
    # The change over the distance `ahead`, scaled to the rounding error of t: half a spacing.
    return 0.5 * least * _spacing(t) / ahead


def _rates(problem: Problem, t: float, y: FloatArray) -> FloatArray:
    assert problem.state_rhs is not None  # it is a model's
    return np.array(problem.state_rhs(t, y), dtype=np.float64)


def _over_step(
    problem: Problem, t: float, y: FloatArray, step: float, change: FloatArray
) -> FloatArray:
    """Return the effect of a change of the rates on an implicit step, which damps stiff modes."""
    if not np.any(change):
        return change
    # (M / h - J) x = change is an implicit Euler step of length h under a disturbance of the rates;
    # M has zeros for algebraic unknowns. Without stiffness x is h times the change.
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
        # Without a matrix that can be solved with, nothing is damped.
        return step * change
