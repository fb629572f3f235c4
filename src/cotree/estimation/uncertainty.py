"""Uncertainty of estimates: covariance, standard errors, intervals and correlations.

In: rows of information, whose squares are the Fisher information, at the estimates. The covariance
is the inverse of that information (Cramer and Rao), by singular values of rows that are scaled to
the estimates. Parameters that take part in a direction that is not determined have infinite errors,
others have theirs.

Where standard deviations of the noise are estimated with the other parameters, maximum likelihood
takes them too small by the degrees of freedom that these use up: variances of the parameters are
multiplied by n/(n - p), with n values of unknown noise and p parameters that act on values, and
quantiles are those of Student's t with n - p degrees of freedom, as in linear regression, where
both are exact. Where the noise is given, quantiles are normal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cotree.errors import ParameterError
from cotree.estimation.determined import split
from cotree.scene.expressions import check_number

if TYPE_CHECKING:
    from cotree.estimation.determined import Split
    from cotree.estimation.likelihood import Predictions
    from cotree.estimation.problem import Problem

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """The uncertainty of estimates; parameters are on their scales.

    Attributes
    ----------
    fisher : ndarray, shape (n, n)
        Fisher information, that of priors added.
    covariance, correlation : ndarray, shape (n, n)
        Infinite variances, and nan, where something is not determined.
    errors : ndarray, shape (n,)
        Standard errors.
    root : ndarray, shape (n, n_determined)
        Its square is the covariance along what is determined.
    freedom : float
        Degrees of freedom of Student's t; infinite where the noise is given.
    spread : float
        By which variances are multiplied, for noise that is estimated and for other losses.
    split : Split
        Directions that are not determined.
    """

    fisher: Array
    covariance: Array
    correlation: Array
    errors: Array
    root: Array
    freedom: float
    spread: float
    split: Split

    def quantile(self, level: float) -> float:
        """Give the number of standard errors on either side of an interval."""
        from scipy import stats

        inside = 0.5 * (1.0 + check_level(level))
        law = stats.norm if math.isinf(self.freedom) else stats.t(self.freedom)
        return float(law.ppf(inside))

    def rise(self, level: float) -> float:
        """Give the rise of twice the objective at the ends of a profile's interval.

        With given noise that is the quantile of chi-squared with one degree of freedom. Where n
        values tell their noise, n log(1 + t^2 / freedom) with Student's quantile t, by which
        profiles of linear models have the same intervals as linear regression.
        """
        squared = self.quantile(level) ** 2
        if math.isinf(self.freedom):
            return squared
        return self.freedom * self.spread * math.log1p(squared / self.freedom)

    def error_along(self, slopes: Array) -> Array:
        """Give standard errors of quantities by their derivatives, shape (n_quantities, n).

        Infinite where a quantity changes along a direction that is not determined.
        """
        errors = np.linalg.norm(slopes @ self.root, axis=1)
        if not self.split.open.size:
            return np.asarray(errors)
        scaled = slopes * self.split.sizes
        length = np.linalg.norm(scaled, axis=1)
        # Sensitivities have some five digits.
        is_open = np.linalg.norm(scaled @ self.split.open, axis=1) > 1e-4 * length
        return np.where(is_open, np.inf, errors)


def check_level(level: float) -> float:
    """Accept a level of confidence between 0 and 1."""
    found = check_number(level, "level")
    if not 0.0 < found < 1.0:
        raise ParameterError(f"level is {found:g}: give a level of confidence between 0 and 1")
    return found


def uncertainty_of(
    problem: Problem,
    theta: Array,
    found: Predictions,
    more_rows: Array | None = None,
    factor: float = 1.0,
) -> Uncertainty:
    """Find the uncertainty of estimates.

    Parameters
    ----------
    problem : Problem
        What was estimated.
    theta : ndarray, shape (n,)
        Estimates on their scales.
    found : Predictions
        What was computed there.
    more_rows : ndarray, shape (n_more, n), optional
        Rows of information from elsewhere: of priors.
    factor : float
        By which variances are multiplied, for losses that are not linear.
    """
    rows = problem.likelihood.fisher_rows(found)
    if more_rows is not None:
        rows = np.vstack([rows, more_rows])
    own = split(problem, theta, found, rows)
    freedom, spread = _freedom(problem, found)
    spread *= factor
    root = _root(rows, own) * math.sqrt(spread)
    covariance = root @ root.T
    is_open = own.is_open
    errors = np.where(is_open, np.inf, np.sqrt(np.diag(covariance)))
    covariance[is_open, :] = covariance[:, is_open] = np.nan
    covariance[is_open, is_open] = np.inf
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = covariance / np.outer(errors, errors)
    np.fill_diagonal(correlation, np.where(is_open, np.nan, 1.0))
    fisher = rows.T @ rows
    return Uncertainty(fisher, covariance, correlation, errors, root, freedom, spread, own)


def _root(rows: Array, own: Split) -> Array:
    """Give a square root of the inverse information, along what is determined."""
    n = rows.shape[1]
    basis = np.linalg.qr(np.hstack([own.open, np.eye(n)]))[0][:, own.open.shape[1] :]
    scaled = rows * own.sizes @ basis
    norms = np.linalg.norm(scaled, axis=0)
    norms = np.where(norms > 0.0, norms, 1.0)
    _, s, vh = np.linalg.svd(scaled / norms, full_matrices=False)
    return np.asarray(own.sizes[:, None] * (basis @ ((vh.T / norms[:, None]) / s)))


def _freedom(problem: Problem, found: Predictions) -> tuple[float, float]:
    """Give degrees of freedom and the factor of variances, by which noise is estimated."""
    acts_on_noise = np.any(found.sigma_slopes != 0.0, axis=0)
    acts_on_values = np.any(found.slopes != 0.0, axis=0)
    if not acts_on_noise.any():
        return math.inf, 1.0
    n = int(np.sum(np.any(found.sigma_slopes != 0.0, axis=1)))
    freedom = n - int(np.sum(acts_on_values))
    if freedom < 1:
        # As many parameters as values leave nothing to tell the noise from.
        return 1.0, float(n)
    return float(freedom), n / freedom


def robust_factor(residuals: Array, loss: str, f_scale: float, n_estimated: int) -> float:
    """Give the factor of variances under a loss that lets outliers count less (Huber 1981).

    It is the mean square of the slopes of the loss over the square of their mean slope.
    """
    z = (residuals / f_scale) ** 2
    size = np.sqrt(np.maximum(z, 1e-300))
    weight, slope = {
        "linear": (np.ones_like(z), np.ones_like(z)),
        "soft_l1": ((1 + z) ** -0.5, (1 + z) ** -1.5),
        "huber": (np.minimum(1.0, 1.0 / size), np.where(z <= 1.0, 1.0, 0.0)),
        "cauchy": (1 / (1 + z), (1 - z) / (1 + z) ** 2),
        "arctan": (1 / (1 + z**2), (1 - 3 * z**2) / (1 + z**2) ** 2),
    }[loss]
    n = len(z)
    squares = float(np.sum((weight * residuals) ** 2)) / max(n - n_estimated, 1)
    return squares / float(np.mean(slope)) ** 2
