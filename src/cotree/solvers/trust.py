"""What a run is warned of: tolerances that test little, and corrections beyond them.

In: a ``Problem``, and later its ``Trajectory``. Out: warnings, to the caller of a model's
``simulate``.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from cotree.solvers.methods import METHODS
from cotree.tolerances import LOOSE_RTOL, loose_rtol

if TYPE_CHECKING:
    from cotree.solvers.base import Drift, Trajectory
    from cotree.solvers.problem import Problem

# Corrections beyond this many times the tolerance are none of integration.
_LARGEST_CORRECTION = 1e5

# Nor are those beyond this, unless the tolerance is as loose.
_LARGE_CORRECTION = 1e-2

# Methods with a memory see redundant constraints off which they predict: Bricard's mechanism goes
# another way at 1e-3, and is off by a thousand tolerances at 1e-5.
_ROUGH = 1e-6

# From these functions up to the caller of ``Model.simulate``.
_CALLER = 5


def warn_of_tolerances(problem: Problem) -> None:
    """Warn where the relative tolerance is loose."""
    _warn(loose_rtol(problem.rtol))


def warn_of_result(problem: Problem, trajectory: Trajectory) -> None:
    """Warn where the absolute tolerance tested nothing, or constraints moved the states far."""
    if trajectory.status == 0:
        _warn(_untested(problem, trajectory))
    if trajectory.drift is not None:
        _warn(_corrected(problem, trajectory.drift))


def warn_of_redundancy(problem: Problem, trajectory: Trajectory, redundant: int) -> None:
    """Warn where constraints are redundant and a method with a memory follows them roughly."""
    method = trajectory.statistics.method
    is_rough = problem.rtol > _ROUGH and METHODS[method].multistep
    if trajectory.status == 0 and redundant and is_rough:
        _warn(
            f"constraints are redundant, which {method} follows with errors of many tolerances "
            f"where rtol is above {_ROUGH:g}: give a tighter one, or take dopri5 or dop853"
        )


def _untested(problem: Problem, trajectory: Trajectory) -> str:
    """Compare the absolute tolerance with what the states ever were."""
    n = problem.n_states - problem.n_algebraic
    largest = float(np.max(np.abs(trajectory.z[:n]), initial=0.0))
    atol = float(np.min(problem.atol))
    # What is at rest leaves rounding, of which no tolerance asks anything.
    if not np.finfo(np.float64).eps < largest < atol / LOOSE_RTOL:
        return ""
    return (
        f"no state was ever larger than {largest:.2g}, of which atol = {atol:.2g} tests little: "
        f"give an atol below {LOOSE_RTOL * largest:.1g}"
    )


def _corrected(problem: Problem, drift: Drift) -> str:
    """Compare what projection did to the states with the tolerance."""
    tolerance = max(problem.rtol, float(np.min(problem.atol)), 1e-12)
    allowed = min(_LARGEST_CORRECTION * tolerance, max(_LARGE_CORRECTION, 10.0 * tolerance))
    if drift.correction <= allowed:
        return ""
    return (
        f"projection onto the constraints moved the states by up to {drift.correction:.2g}, "
        "far more than the tolerance: near a singular configuration the motion may have gone "
        "on along another branch; compare with another tolerance or method"
    )


def _warn(message: str) -> None:
    if message:
        warnings.warn(message, RuntimeWarning, stacklevel=_CALLER)
