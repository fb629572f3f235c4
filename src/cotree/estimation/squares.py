"""The negative log-likelihood as a least-squares problem, 1/2 F^T F with the Jacobian J of F.

For a given normal noise, F consists of the residuals. The other terms, logarithms of estimated
standard deviations and absolute values for Laplace distributions, are not squares. They are
rewritten such that at every point 1/2 F^T F is the objective up to a constant, J^T F is its exact
gradient, and J^T J approximates its Hessian. To this end a last row, whose row of J is zero,
corrects the value. The usual rows sqrt(2 log(sigma) + constant) have only the first two properties:
Gauss-Newton steps in a standard deviation are then about twice too long and converge slowly.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from cotree.estimation.likelihood import Predictions
    from cotree.estimation.problem import Problem

Array = npt.NDArray[np.float64]

# A standard deviation may shrink by a factor exp(-20) = 2e-9 from its initial value. A larger
# exponent would cost digits of the objective.
_SHRINKS = 20.0

# Below this, residuals of a Laplace distribution count quadratically: it smooths the kink at zero.
_CORNER = 1e-3


class SquareRows:
    """Computes F and J from the predictions of one start.

    Parameters
    ----------
    problem : Problem
        The estimation problem.
    """

    def __init__(self, problem: Problem) -> None:
        self._likelihood = problem.likelihood
        self._is_normal = problem.likelihood.is_normal
        self._with_noise = np.array([isinstance(v, str) for v in problem.measured.noise])
        self._is_plain = bool(self._is_normal.all()) and not self._with_noise.any()
        self._first: Array | None = None

    def at(self, found: Predictions) -> tuple[Array, Array]:
        """Return F, shape (n,), and J, shape (n, n_estimated).

        The first call fixes the additive constant of the terms of standard deviations.
        """
        r = self._likelihood.residuals(found)
        slopes = self._likelihood.residual_slopes(found)
        if self._is_plain:
            return r, slopes
        # The squares of these rows are r^2 for normal and |r| for Laplace distributions.
        weights = np.where(self._is_normal, 1.0, np.maximum(np.abs(r), _CORNER) ** -0.5)
        rows, missing = r * weights, np.where(self._is_normal, 0.0, 2.0 * np.abs(r))
        missing = missing - np.where(self._is_normal, 0.0, rows**2)
        noisy, normal = self._with_noise, self._is_normal[self._with_noise]
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = np.log(found.sigma)
        if self._first is None:
            self._first = logs
        # With respect to log(sigma), J^T J of the rows above contributes r^2, but the Hessian of
        # the objective is 2 r^2, with expectation 2. For Laplace distributions little is missing.
        weight = np.where(normal, np.maximum(1.0, np.abs(r[noisy])), 0.5)
        by_sigma = found.sigma_slopes[noisy] / found.sigma[noisy, None]
        rest = np.sum(missing) + np.sum(
            2.0 * (logs - self._first + _SHRINKS)[noisy] - weight**-2.0 + 4.0
        )
        with np.errstate(invalid="ignore"):
            # If a standard deviation shrinks too far, this is nan, and the step is rejected.
            last = np.sqrt(rest)
        return (
            np.concatenate([rows, 1.0 / weight, [last]]),
            np.vstack(
                [slopes * weights[:, None], weight[:, None] * by_sigma, np.zeros(slopes.shape[1])]
            ),
        )
