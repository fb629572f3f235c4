"""Rows for methods of least squares, whose sum of squares is twice the negative log-likelihood.

Rows of measured values with given normal noise are their residuals. What is not a sum of squares,
logarithms of estimated deviations and absolute values of Laplace's distribution, is written so that
three things hold at every point: half of the sum of squares is the objective up to a constant, the
Jacobian times the rows is its exact gradient, and the Jacobian squared is near its second
derivative. A last row, with a Jacobian of zero, makes up for the value. The usual rows
sqrt(2 log(sigma) + constant) have the first two only: Gauss-Newton steps along a deviation are then
about twice too long, and converge slowly.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from cotree.estimation.likelihood import Predictions
    from cotree.estimation.problem import Problem

Array = npt.NDArray[np.float64]

# Deviations may shrink by this exponent from where a start begins: 2e-9 of it. A larger one would
# leave fewer digits to the objective.
_SHRINKS = 20.0

# Residuals of Laplace's distribution below this one count by their squares, which have a slope of
# zero between the slopes of both sides.
_CORNER = 1e-3


class SquareRows:
    """Rows and their Jacobian at the predictions of one start.

    Parameters
    ----------
    problem : Problem
        What is estimated, and what was measured.
    """

    def __init__(self, problem: Problem) -> None:
        self._likelihood = problem.likelihood
        self._is_normal = problem.likelihood.is_normal
        self._with_noise = np.array([isinstance(v, str) for v in problem.measured.noise])
        self._is_plain = bool(self._is_normal.all()) and not self._with_noise.any()
        self._first: Array | None = None

    def at(self, found: Predictions) -> tuple[Array, Array]:
        """Give rows, shape (n,), and their derivatives, shape (n, n_estimated).

        The constant of deviations is set by the first predictions that are asked for.
        """
        r = self._likelihood.residuals(found)
        slopes = self._likelihood.residual_slopes(found)
        if self._is_plain:
            return r, slopes
        # Squares of these are r^2 of normal and |r| of Laplace's distributions.
        weights = np.where(self._is_normal, 1.0, np.maximum(np.abs(r), _CORNER) ** -0.5)
        rows, missing = r * weights, np.where(self._is_normal, 0.0, 2.0 * np.abs(r))
        missing = missing - np.where(self._is_normal, 0.0, rows**2)
        own, normal = self._with_noise, self._is_normal[self._with_noise]
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = np.log(found.sigma)
        if self._first is None:
            self._first = logs
        # Along log(sigma) the rows above have the curvature r^2, and the objective 2 r^2, whose
        # mean is 2; of Laplace's distribution they have nearly all of it.
        weight = np.where(normal, np.maximum(1.0, np.abs(r[own])), 0.5)
        by_sigma = found.sigma_slopes[own] / found.sigma[own, None]
        rest = np.sum(missing) + np.sum(
            2.0 * (logs - self._first + _SHRINKS)[own] - weight**-2.0 + 4.0
        )
        with np.errstate(invalid="ignore"):
            # A deviation that shrinks beyond all bounds has no rows: the step is taken back.
            last = np.sqrt(rest)
        return (
            np.concatenate([rows, 1.0 / weight, [last]]),
            np.vstack(
                [slopes * weights[:, None], weight[:, None] * by_sigma, np.zeros(slopes.shape[1])]
            ),
        )
