"""Findings about a fit: one sentence for everything that limits the use of its estimates."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from cotree.estimation.determined import in_words, points_beside, split

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from cotree.estimation.likelihood import Predictions
    from cotree.estimation.multistart import Search
    from cotree.estimation.problem import Problem
    from cotree.estimation.result import StartRecord
    from cotree.estimation.uncertainty import Uncertainty

    Array = npt.NDArray[np.float64]

# Estimates nearer to a bound than this, in shares of the width or of their value, lie on it:
# optimisers that keep to bounds stay a little inside.
_AT_BOUND = 1e-6

# Objectives of starts that differ by less are of one optimum: a hundredth of what a parameter's
# standard error is worth.
SAME_OPTIMUM = 0.005

# A chi-squared that is less probable than this, above or below, says that the model or the noise
# is wrong.
_IMPROBABLE = 1e-3

# Intervals on logarithmic scales whose ends differ by more than this factor tell little.
_WIDE = 1e3


def at_bounds(problem: Problem, theta: Array) -> tuple[str, ...]:
    """Say for each parameter whether it is at its "lower" or "upper" bound; else an empty text."""
    lower, upper = problem.scaled.lower, problem.scaled.upper
    found = []
    for x, low, high in zip(theta, lower, upper, strict=True):
        width = high - low if math.isfinite(high - low) else max(1.0, abs(x))
        if x - low <= _AT_BOUND * width:
            found.append("lower")
        else:
            found.append("upper" if high - x <= _AT_BOUND * width else "")
    return tuple(found)


def of_optimiser(starts: Sequence[StartRecord]) -> tuple[str, ...]:
    """Say whether the optimiser converged, and how many starts led to the best optimum."""
    best, said = starts[0], []
    if not math.isfinite(best.objective):
        return (f"No start succeeded: {best.message}.",)
    if not best.is_converged:
        said.append(f"The optimiser did not converge: {best.message}.")
    n_same = sum(row.objective - best.objective <= SAME_OPTIMUM for row in starts)
    if len(starts) > 1 and n_same == 1:
        said.append(
            f"Only one of {len(starts)} starts reached the best objective, so there may be a "
            "better one: increase the number of starts."
        )
    failed = sum(not math.isfinite(row.objective) for row in starts)
    if failed:
        said.append(f"{failed} of {len(starts)} starts failed; starts_table() gives the reasons.")
    return tuple(said)


def of_bounds(problem: Problem, theta: Array) -> tuple[str, ...]:
    """Say which estimates are at a bound."""
    said = []
    noise = {name for name in problem.measured.noise if isinstance(name, str)}
    for row, side in zip(problem.estimated, at_bounds(problem, theta), strict=True):
        if side == "lower" and row.name in noise:
            said.append(
                f"'{row.name}' is at its lower bound {row.lower:g}: the model reproduces the data "
                "almost exactly, so that their noise cannot be estimated and intervals mean "
                "nothing; give the noise."
            )
        elif side:
            value = row.lower if side == "lower" else row.upper
            said.append(
                f"'{row.name}' is at its {side} bound {value:g}: its standard error ignores the "
                f"bound; profile('{row.name}') gives the interval that the data allow."
            )
    return tuple(said)


def of_directions(
    problem: Problem,
    theta: Array,
    found: Uncertainty,
    more_rows: Array | None = None,
) -> tuple[str, ...]:
    """Name the directions that the data do not determine.

    Rows of information of priors are taken to be the same beside the estimates.
    """
    if not found.split.open.shape[1]:
        return ()
    points = points_beside(problem, theta)
    beside = []
    for point, there in zip(points, problem.predict(points), strict=True):
        if there.message:
            continue
        rows = problem.likelihood.fisher_rows(there)
        if more_rows is not None:
            rows = np.vstack([rows, more_rows])
        if np.all(np.isfinite(rows)):
            beside.append(split(problem, point, there, rows))
    return in_words(problem.scaled.names, found.split, beside)


def of_widths(problem: Problem, theta: Array, found: Uncertainty) -> tuple[str, ...]:
    """Say which intervals are too wide to tell anything."""
    said = []
    reach = found.quantile(0.95) * found.errors
    for i, row in enumerate(problem.estimated):
        if not math.isfinite(reach[i]):
            continue
        low, high = problem.scaled.lower[i], problem.scaled.upper[i]
        if theta[i] - reach[i] < low and theta[i] + reach[i] > high:
            said.append(
                f"The data hardly determine '{row.name}': its 95 % interval is wider than its "
                f"bounds {row.lower:g} and {row.upper:g}."
            )
        elif row.scale != "lin":
            ratio = 2.0 * reach[i] * (math.log(10.0) if row.scale == "log10" else 1.0)
            if ratio > math.log(_WIDE):
                said.append(
                    f"The data hardly determine '{row.name}': the ends of its 95 % interval differ "
                    f"by a factor of {math.exp(min(ratio, 700.0)):.1g}."
                )
    return tuple(said)


def of_agreement(
    problem: Problem, found: Predictions, freedom: int, search: Search | None = None
) -> tuple[str, ...]:
    """Say whether residuals are as large as the noise says, where it is given.

    Other losses are chosen for outliers, whose residuals are large, and standard errors allow for
    them.
    """
    is_given = not any(isinstance(v, str) for v in problem.measured.noise)
    is_robust = search is not None and search.loss != "linear"
    if is_robust or not is_given or not problem.likelihood.is_normal.all() or freedom < 1:
        return ()
    from scipy import stats

    chi2 = problem.likelihood.chi2(found)
    told = f"chi-squared is {chi2:.4g} at {freedom} degrees of freedom"
    if stats.chi2.sf(chi2, freedom) < _IMPROBABLE:
        return (
            f"The residuals are larger than the given noise explains ({told}): the model does not "
            "fit the data, or the noise is underestimated, and the intervals are too narrow.",
        )
    if stats.chi2.cdf(chi2, freedom) < _IMPROBABLE:
        return (
            f"The residuals are smaller than the given noise explains ({told}): the noise is "
            "overestimated, and the intervals are too wide.",
        )
    return ()
