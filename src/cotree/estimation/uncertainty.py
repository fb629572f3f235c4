"""Uncertainty of estimates: covariance, standard errors, intervals and correlations.

In: a matrix J at the estimates with the Fisher information J^T J. The covariance is the inverse of
the information (the Cramer-Rao bound), from a singular value decomposition of J in relative units.
Parameters that are involved in an undetermined direction have infinite standard errors; the others
are not affected.

If standard deviations of the noise are estimated along with the parameters, maximum likelihood
underestimates them. Variances are therefore multiplied by n/(n - p), with n values of unknown noise
and p parameters that influence predictions, and quantiles are those of Student's t with n - p
degrees of freedom. Both are exact for linear regression. If the noise is given, quantiles are
normal.
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
    """The uncertainty of estimates, with parameters on their scales.

    Attributes
    ----------
    fisher : ndarray, shape (n, n)
        Fisher information, including that of priors.
    covariance, correlation : ndarray, shape (n, n)
        Undetermined parameters have infinite variances, and nan elsewhere.
    errors : ndarray, shape (n,)
        Standard errors.
    root : ndarray, shape (n, n_determined)
        R such that R R^T is the covariance in the determined subspace.
    freedom : float
        Degrees of freedom of Student's t; infinite if the noise is given.
    spread : float
        Correction factor of variances, for estimated noise and for robust losses.
    split : Split
        Determined and undetermined directions.
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
        """Return half the width of a confidence interval in standard errors."""
        from scipy import stats

        inside = 0.5 * (1.0 + check_level(level))
        law = stats.norm if math.isinf(self.freedom) else stats.t(self.freedom)
        return float(law.ppf(inside))

    def rise(self, level: float) -> float:
        """Return the rise of twice the objective at the ends of a profile-likelihood interval.

        For a given noise this is the quantile of chi-squared with one degree of freedom. If the
        noise is estimated from n values, it is n log(1 + t^2 / freedom) with the quantile t of
        Student's t, which reproduces the intervals of linear regression for linear models.
        """
        squared = self.quantile(level) ** 2
        if math.isinf(self.freedom):
            return squared
        return self.freedom * self.spread * math.log1p(squared / self.freedom)

    def error_along(self, slopes: Array) -> Array:
        """Return standard errors of quantities from their derivatives, shape (n_quantities, n).

        They are infinite for quantities that change along an undetermined direction.
        """
        errors = np.linalg.norm(slopes @ self.root, axis=1)
        if not self.split.open.size:
            return np.asarray(errors)
        scaled = slopes * self.split.sizes
        length = np.linalg.norm(scaled, axis=1)
        # Sensitivities have about five correct digits, so smaller components count as zero.
        is_open = np.linalg.norm(scaled @ self.split.open, axis=1) > 1e-4 * length
        return np.where(is_open, np.inf, errors)


def check_level(level: float) -> float:
    """Check that a confidence level is between 0 and 1."""
    found = check_number(level, "level")
    if not 0.0 < found < 1.0:
        raise ParameterError(f"level is {found:g}: give a confidence level between 0 and 1")
    return found


def uncertainty_of(
    problem: Problem,
    theta: Array,
    found: Predictions,
    more_rows: Array | None = None,
    factor: float = 1.0,
) -> Uncertainty:
    """Compute the uncertainty of estimates.

    Parameters
    ----------
    problem : Problem
        What was estimated.
    theta : ndarray, shape (n,)
        Estimates on their scales.
    found : Predictions
        Predictions there.
    more_rows : ndarray, shape (n_more, n), optional
        Further rows of J, from priors.
    factor : float
        Correction factor of variances for robust losses.
    """
    rows = problem.likelihood.fisher_rows(found)
    if more_rows is not None:
        rows = np.vstack([rows, more_rows])
    parts = split(problem, theta, found, rows)
    freedom, spread = _freedom(problem, found)
    spread *= factor
    root = _root(rows, parts) * math.sqrt(spread)
    covariance = root @ root.T
    is_open = parts.is_open
    errors = np.where(is_open, np.inf, np.sqrt(np.diag(covariance)))
    covariance[is_open, :] = covariance[:, is_open] = np.nan
    covariance[is_open, is_open] = np.inf
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = covariance / np.outer(errors, errors)
    np.fill_diagonal(correlation, np.where(is_open, np.nan, 1.0))
    fisher = rows.T @ rows
    return Uncertainty(fisher, covariance, correlation, errors, root, freedom, spread, parts)


def _root(rows: Array, parts: Split) -> Array:
    """Return a square root of the inverse information in the determined subspace."""
    n = rows.shape[1]
    basis = np.linalg.qr(np.hstack([parts.open, np.eye(n)]))[0][:, parts.open.shape[1] :]
    scaled = rows * parts.sizes @ basis
    norms = np.linalg.norm(scaled, axis=0)
    norms = np.where(norms > 0.0, norms, 1.0)
    _, s, vh = np.linalg.svd(scaled / norms, full_matrices=False)
    return np.asarray(parts.sizes[:, None] * (basis @ ((vh.T / norms[:, None]) / s)))


def _freedom(problem: Problem, found: Predictions) -> tuple[float, float]:
    """Return degrees of freedom and the correction factor of variances for estimated noise."""
    acts_on_noise = np.any(found.sigma_slopes != 0.0, axis=0)
    acts_on_values = np.any(found.slopes != 0.0, axis=0)
    if not acts_on_noise.any():
        return math.inf, 1.0
    n = int(np.sum(np.any(found.sigma_slopes != 0.0, axis=1)))
    freedom = n - int(np.sum(acts_on_values))
    if freedom < 1:
        # No degrees of freedom are left from which the noise could be estimated.
        return 1.0, float(n)
    return float(freedom), n / freedom


def robust_factor(residuals: Array, loss: str, f_scale: float, n_estimated: int) -> float:
    """Return the factor of the asymptotic variance of an M-estimator (Huber 1981).

    It is the mean square of the influence function over the square of its mean derivative.
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
