"""Starting points of the optimiser, spread between the bounds of the parameters."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cotree.ensemble.sampling import unit_points

if TYPE_CHECKING:
    from cotree.estimation.estimated import Estimated
    from cotree.estimation.problem import Problem

Array = npt.NDArray[np.float64]

_LN10 = math.log(10.0)


def spread_starts(problem: Problem, n: int, seed: int = 0) -> Array:
    """Choose starting points: the initial guess first, then a Latin hypercube within the bounds.

    Parameters
    ----------
    problem : Problem
        The problem. Without a guess, a parameter starts in the middle of its bounds. If a bound is
        infinite, starts extend one decade beyond the guess on a logarithmic scale; on a linear
        scale they extend to zero and to twice the guess, or to -1 and 1 if the guess is zero.
    n : int
        Number of starting points.
    seed : int
        Seed of the Latin hypercube: equal seeds give equal starts.

    Returns
    -------
    ndarray, shape (n, n_estimated)
        On the scales of the estimated parameters.
    """
    ends = np.array([_ends(row) for row in problem.estimated]).T
    lower, upper = problem.scaled.lower, problem.scaled.upper
    # Infinite bounds are replaced by an interval around the guess.
    low = np.where(np.isfinite(lower), lower, np.minimum(ends[0], upper))
    high = np.where(np.isfinite(upper), upper, np.maximum(ends[1], lower))
    guess = np.array([np.nan if row.start is None else row.start for row in problem.estimated])
    first = problem.scaled.scaled(guess)
    first = np.where(np.isfinite(first), first, 0.5 * (low + high))
    if n < 2:
        return first[None, :]
    rest = low + unit_points("latin", n - 1, len(first), seed) * (high - low)
    return np.vstack([first, rest])


def _ends(row: Estimated) -> tuple[float, float]:
    """Return an interval around the guess of a parameter, on its scale."""
    if row.scale != "lin":
        decade = 1.0 if row.scale == "log10" else _LN10
        middle = math.log10(row.start) * decade if row.start else 0.0
        return middle - decade, middle + decade
    start = row.start or 0.0
    return start - (abs(start) or 1.0), start + (abs(start) or 1.0)
