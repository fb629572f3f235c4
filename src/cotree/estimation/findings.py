"""Findings about a fit: one sentence on each limitation of its estimates."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from cotree.estimation.estimated import LOGARITHMS
from cotree.estimation.uncertainty import in_words, neighbouring_points, split

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.estimation.estimated import Array
    from cotree.estimation.likelihood import Predictions
    from cotree.estimation.multistart import Search, StartRecord
    from cotree.estimation.problem import Problem
    from cotree.estimation.uncertainty import Uncertainty

# An estimate is at a bound if their distance, relative to the range or the value, is smaller.
_AT_BOUND = 1e-6

# Starts reached the same optimum if objectives differ by less. One standard error adds 0.5.
SAME_OPTIMUM = 0.005

# If a tail probability of chi-squared is below this, the model or the noise is wrong.
_IMPROBABLE = 1e-3

# An interval on a logarithmic scale is uninformative if the ratio of its limits is larger.
_WIDE = 1e3


def at_bounds(problem: Problem, theta: Array) -> dict[str, str]:
    """Return "lower" or "upper" for each parameter at a bound, by name."""
    found, scaled = {}, problem.scaled
    for name, x, low, high in zip(scaled.names, theta, scaled.lower, scaled.upper, strict=True):
        near = _AT_BOUND * (high - low if math.isfinite(high - low) else max(1.0, abs(x)))
        if x - low <= near or high - x <= near:
            found[name] = "lower" if x - low <= near else "upper"
    return found


def of_optimiser(starts: Sequence[StartRecord]) -> tuple[str, ...]:
    """Report lack of convergence, failed starts, and an optimum that only one start reached."""
    best, sentences = starts[0], []
    if not math.isfinite(best.objective):
        return (f"No start succeeded: {best.message}.",)
    if not best.is_converged:
        sentences.append(f"The optimiser did not converge: {best.message}.")
    n_same = sum(row.objective - best.objective <= SAME_OPTIMUM for row in starts)
    if len(starts) > 1 and n_same == 1:
        sentences.append(
            f"Only one of {len(starts)} starts reached the best objective, so there may be a "
            "better optimum: increase the number of starts."
        )
    failed = sum(not math.isfinite(row.objective) for row in starts)
    if failed:
        sentences.append(
            f"{failed} of {len(starts)} starts failed; starts_table() gives the reasons."
        )
    return tuple(sentences)


def of_bounds(problem: Problem, sides: Mapping[str, str]) -> tuple[str, ...]:
    """Report estimates at a bound."""
    sentences = []
    for row in problem.estimated:
        side = sides.get(row.name)
        if side == "lower" and row.name in problem.measured.noise:
            sentences.append(
                f"'{row.name}' is at its lower bound {row.lower:g}: the model reproduces the data "
                "almost exactly, so the noise cannot be estimated and the intervals are "
                "meaningless; specify the noise."
            )
        elif side:
            value = row.lower if side == "lower" else row.upper
            sentences.append(
                f"'{row.name}' is at its {side} bound {value:g}: its standard error ignores the "
                f"bound; profile('{row.name}') gives the interval that the data allow."
            )
    return tuple(sentences)


def of_directions(found: Uncertainty, more_rows: Array | None = None) -> tuple[str, ...]:
    """Report undetermined directions; ``more_rows`` of priors are assumed constant nearby."""
    if not found.split.open.shape[1]:
        return ()
    problem = found.problem
    points = neighbouring_points(problem, found.theta)
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


def of_widths(found: Uncertainty) -> tuple[str, ...]:
    """Report intervals that are too wide to be informative."""
    sentences, scaled = [], found.problem.scaled
    reach = found.quantile(0.95) * found.errors
    for i, row in enumerate(found.problem.estimated):
        if not math.isfinite(reach[i]):
            continue
        x = found.theta[i]
        if x - reach[i] < scaled.lower[i] and x + reach[i] > scaled.upper[i]:
            sentences.append(
                f"The data hardly determine '{row.name}': its 95 % interval is wider than its "
                f"bounds {row.lower:g} and {row.upper:g}."
            )
        elif row.scale != "lin":
            ratio = 2.0 * reach[i] * LOGARITHMS[row.scale]
            if ratio > math.log(_WIDE):
                sentences.append(
                    f"The data hardly determine '{row.name}': the ends of its 95 % interval differ "
                    f"by a factor of {math.exp(min(ratio, 700.0)):.1g}."
                )
    return tuple(sentences)


def of_agreement(
    problem: Problem, found: Predictions, freedom: int, search: Search | None = None
) -> tuple[str, ...]:
    """Report residuals that contradict the known noise; robust losses allow for outliers."""
    is_given = not any(isinstance(v, str) for v in problem.measured.noise)
    is_robust = search is not None and search.loss != "linear"
    if is_robust or not is_given or not problem.likelihood.is_normal.all() or freedom < 1:
        return ()
    from scipy import stats

    chi2 = problem.likelihood.chi2(found)
    statistic = f"chi-squared is {chi2:.4g} at {freedom} degrees of freedom"
    if stats.chi2.sf(chi2, freedom) < _IMPROBABLE:
        return (
            f"The residuals are larger than the given noise explains ({statistic}): the model does "
            "not fit the data, or the noise is underestimated, and the intervals are too narrow.",
        )
    if stats.chi2.cdf(chi2, freedom) < _IMPROBABLE:
        return (
            f"The residuals are smaller than the given noise explains ({statistic}): the noise is "
            "overestimated, and the intervals are too wide.",
        )
    return ()
