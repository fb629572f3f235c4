"""Residuals, likelihood and Fisher information as functions of predictions.

With a measured value m, its prediction y and the transformation T, the residual is
r = (T(y) - T(m)) / sigma. A row with a normal distribution contributes
-(r^2 / 2 + log(sigma sqrt(2 pi)) + log(dm/dT)) to the log-likelihood; a row with a Laplace
distribution of scale sigma contributes -(abs(r) + log(2 sigma) + log(dm/dT)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cotree.estimation.estimated import LOGARITHMS, Array

if TYPE_CHECKING:
    from cotree.estimation.conditions import Measured


@dataclass(frozen=True, eq=False)
class Predictions:
    """Predictions of the measured rows at one point in parameter space."""

    values: Array  # observables before transformation
    slopes: Array  # derivatives of the observables with respect to the scaled estimated parameters
    sigma: Array  # standard deviations of the transformed values (scales of Laplace distributions)
    sigma_slopes: Array  # derivatives of ``sigma`` with respect to the scaled estimated parameters
    message: str = ""  # reason why a run failed (values are then nan), or empty


class Likelihood:
    """Likelihood of measured values as a function of predictions."""

    def __init__(self, measured: Measured) -> None:
        logs = np.array(measured.transformation, dtype=object)
        self.is_log = logs != "lin"
        # T(x) = log(x) / factor, so its derivative is 1 / (factor x).
        self._factor = np.array([LOGARITHMS[word] for word in logs])
        self.is_normal = np.array(measured.distribution, dtype=object) == "normal"
        self.value = np.asarray(measured.value, dtype=float)
        self._target = self.transformed(self.value)
        # negative logarithms of the constant factors in the densities
        log_slope = np.where(
            self.is_log, np.log(self._factor * np.abs(self.value) + ~self.is_log), 0
        )
        log_norm = np.where(self.is_normal, 0.5 * math.log(2.0 * math.pi), math.log(2.0))
        self._constant = float(np.sum(log_norm + log_slope))

    def transformed(self, values: Array) -> Array:
        """Transform one value per row; values without a logarithm become nan."""
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = np.log(np.where(self.is_log, values, 1.0)) / self._factor
        return np.where(self.is_log, logs, values)

    def residuals(self, found: Predictions) -> Array:
        """Return the residual r of each row, shape (n_rows,)."""
        return np.asarray((self.transformed(found.values) - self._target) / found.sigma)

    def residual_slopes(self, found: Predictions) -> Array:
        """Return the derivatives of the residuals, shape (n_rows, n_estimated)."""
        slopes = self._mean_slopes(found)
        return np.asarray(
            slopes - (self.residuals(found) / found.sigma)[:, None] * found.sigma_slopes
        )

    def chi2(self, found: Predictions) -> float:
        """Return the sum of the squared residuals."""
        return float(np.sum(self.residuals(found) ** 2))

    def log_likelihood(self, found: Predictions) -> float:
        """Return the log-likelihood; minus infinity if a prediction is not finite."""
        r = self.residuals(found)
        parts = np.where(self.is_normal, 0.5 * r**2, np.abs(r)) + np.log(found.sigma)
        total = -float(np.sum(parts)) - self._constant
        return total if math.isfinite(total) else -math.inf

    def gradient(self, found: Predictions) -> Array:
        """Return the log-likelihood's gradient; at kinks, the mean of one-sided derivatives."""
        r = self.residuals(found)
        weights = np.where(self.is_normal, r, np.sign(r))
        by_sigma = found.sigma_slopes / found.sigma[:, None]
        return np.asarray(-weights @ self.residual_slopes(found) - np.sum(by_sigma, axis=0))

    def fisher(self, found: Predictions) -> Array:
        """Return the expected Fisher information, shape (n_estimated, n_estimated)."""
        rows = self.fisher_rows(found)
        return np.asarray(rows.T @ rows)

    def fisher_rows(self, found: Predictions) -> Array:
        """Return J such that J^T J is the Fisher information, shape (2 n_rows, n_estimated).

        Rows of the measured values precede rows of their standard deviations. Singular values of J
        identify undetermined directions with twice as many digits as eigenvalues of J^T J.
        """
        # Fisher information on sigma: 2 / sigma^2 (normal) or 1 / sigma^2 (Laplace).
        share = np.where(self.is_normal, math.sqrt(2.0), 1.0)
        by_sigma = found.sigma_slopes * (share / found.sigma)[:, None]
        return np.vstack([self._mean_slopes(found), by_sigma])

    def _mean_slopes(self, found: Predictions) -> Array:
        """Return the derivatives of the transformed predictions, divided by sigma."""
        scale = np.where(self.is_log, self._factor * found.values, 1.0) * found.sigma
        return np.asarray(found.slopes / scale[:, None])
