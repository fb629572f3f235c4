"""An estimation problem: conditions, measured values and estimated parameters.

In: conditions, measured rows and estimated parameters. Out: predictions, and from them residuals,
log-likelihood, gradient and Fisher information, as functions of the estimated parameters on their
scales. Runs at several points in parameter space go through the ensemble engine in one call.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import ParameterError
from cotree.estimation.conditions import check_condition, check_measured
from cotree.estimation.estimated import Array, Scaled
from cotree.estimation.groups import Group
from cotree.estimation.likelihood import Likelihood, Predictions
from cotree.model.arrays import as_array
from cotree.scene.settings import STEPS_OF_FIT, Settings

if TYPE_CHECKING:
    from collections.abc import Hashable, Sequence

    from cotree.estimation.conditions import Condition, Measured
    from cotree.estimation.estimated import Estimated


class Problem:
    """Measured values and the simulations that predict them.

    Parameters
    ----------
    estimated : sequence of Estimated
        The estimated parameters, in the order of ``theta``.
    conditions : sequence of Condition
        The runs.
    measured : Measured
        The measured values.
    settings : Settings, optional
        Method, tolerances and budgets of the runs.

    Attributes
    ----------
    estimated, conditions, measured, settings
        As given.
    scaled : Scaled
        The estimated parameters on their scales.
    likelihood : Likelihood
        Likelihood as a function of predictions.

    Raises
    ------
    ParameterError
        If a name is unknown, or a row is invalid.
    """

    def __init__(
        self,
        estimated: Sequence[Estimated],
        conditions: Sequence[Condition],
        measured: Measured,
        settings: Settings | None = None,
    ) -> None:
        self.estimated, self.conditions = tuple(estimated), tuple(conditions)
        self.measured, self.settings = measured, settings or Settings(max_steps=STEPS_OF_FIT)
        self.scaled = Scaled(self.estimated)
        if len(set(self.scaled.names)) < len(self.scaled.names):
            raise ParameterError(
                f"two estimated parameters have the same name: {self.scaled.names}"
            )
        if not len(measured):
            raise ParameterError("there are no measured values: give at least one")
        for condition in self.conditions:
            for link in condition.chain:
                check_condition(link, self.scaled.names)
        check_measured(measured, self.conditions, self.scaled.names)
        self.likelihood = Likelihood(measured)
        self._last: tuple[bytes, Predictions] | None = None
        self._groups = self._grouped()

    def predict(self, thetas: Any, *, slopes: bool = True) -> list[Predictions]:
        """Predict the measured values at several points in parameter space in one call.

        Parameters
        ----------
        thetas : array_like, shape (n_thetas, n_estimated)
            Points on the scales of the parameters. Results do not depend on the other points.
        slopes : bool
            Whether to compute derivatives. Without them runs are faster, and the values differ
            within the tolerances.

        Returns
        -------
        list of Predictions
            One for each point; if a run fails, values are nan and there is a message.
        """
        n_rows, n_est = len(self.measured), len(self.estimated)
        thetas = np.asarray(thetas, dtype=float)
        if thetas.ndim != 2 or thetas.shape[1] != n_est:
            raise ParameterError(
                f"thetas must be an array of shape (n_thetas, {n_est}), not of shape {thetas.shape}"
            )
        n = len(thetas)
        values, factors = self.scaled.values(thetas), self.scaled.slopes(thetas)
        width = n_est if slopes else 0
        observed, sigma = np.empty((2, n, n_rows))
        observed_slopes, sigma_slopes = np.empty((2, n, n_rows, width))
        messages = [""] * n
        for group in self._groups:
            *computed, failed = group.run(values, slopes=slopes)
            for whole, part in zip(
                (observed, observed_slopes, sigma, sigma_slopes), computed, strict=True
            ):
                whole[:, group.rows] = part
            messages = [a or b for a, b in zip(messages, failed, strict=True)]
        if slopes:
            observed_slopes *= factors[:, None, :]
            sigma_slopes *= factors[:, None, :]
        return [
            Predictions(observed[i], observed_slopes[i], sigma[i], sigma_slopes[i], messages[i])
            for i in range(n)
        ]

    def theta(self, parameters: Any = None) -> Array:
        """Convert values of the estimated parameters to their scales, shape (n_estimated,).

        Parameters
        ----------
        parameters : mapping of str to float, or array_like of shape (n_estimated,), optional
            Values, not on their scales. Missing ones are the initial guesses, or the middle of
            finite bounds if there is no guess.

        Raises
        ------
        ParameterError
            If a name is unknown, a value is missing, or one has no logarithm.
        """
        names = self.scaled.names
        middle = self.scaled.values(0.5 * (self.scaled.lower + self.scaled.upper))
        given = {
            row.name: float(value) if row.start is None and np.isfinite(value) else row.start
            for row, value in zip(self.estimated, middle, strict=True)
        }
        if parameters is not None and not hasattr(parameters, "keys"):
            array = as_array(parameters, (len(names),), "the estimated parameters")
            parameters = dict(zip(names, array.tolist(), strict=True))
        for name, value in dict(parameters or {}).items():
            if name not in given:
                raise ParameterError(f"'{name}' is not estimated: {', '.join(names)} are")
            given[name] = value
        missing = [name for name, value in given.items() if value is None]
        if missing:
            raise ParameterError(f"'{missing[0]}' has no initial guess: give a value")
        theta = self.scaled.scaled(np.array(list(given.values()), dtype=float))
        for name, value in zip(names, theta, strict=True):
            if not np.isfinite(value):
                raise ParameterError(f"'{name}' is {given[name]}, which has no finite logarithm")
        return theta

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Bounds of the estimated parameters on their scales, as SciPy's ``minimize`` takes them.

        They are infinite if there is no bound.
        """
        return list(zip(self.scaled.lower.tolist(), self.scaled.upper.tolist(), strict=True))

    def values(self, theta: Any) -> dict[str, float]:
        """Return the estimated parameters by name, in their units.

        Parameters
        ----------
        theta : array_like, shape (n_estimated,)
            Their values on their scales.
        """
        given = as_array(theta, (len(self.estimated),), "theta")
        return dict(zip(self.scaled.names, self.scaled.values(given).tolist(), strict=True))

    def objective(self, theta: Any) -> tuple[float, Array]:
        """Return the negative log-likelihood and its gradient, for any optimiser.

        Parameters
        ----------
        theta : array_like, shape (n_estimated,)
            Values of the estimated parameters on their scales.

        Returns
        -------
        float, ndarray of shape (n_estimated,)
            Infinite, and nan, where a run fails.
        """
        found = self.predicted(theta)
        return -self.likelihood.log_likelihood(found), -self.likelihood.gradient(found)

    def residuals(self, theta: Any) -> Array:
        """Return the normalised residuals, shape (n_rows,); nan if a run fails.

        Parameters
        ----------
        theta : array_like, shape (n_estimated,)
            Values of the estimated parameters on their scales.
        """
        return self.likelihood.residuals(self.predicted(theta))

    def jacobian(self, theta: Any) -> Array:
        """Return the exact Jacobian of the residuals, shape (n_rows, n_estimated).

        Parameters
        ----------
        theta : array_like, shape (n_estimated,)
            Values of the estimated parameters on their scales.
        """
        return self.likelihood.residual_slopes(self.predicted(theta))

    def predicted(self, theta: Any) -> Predictions:
        """Return predictions with derivatives at one point; the latest are cached.

        Parameters
        ----------
        theta : array_like, shape (n_estimated,)
            Values of the estimated parameters on their scales.
        """
        point = np.array(as_array(theta, (len(self.estimated),), "theta"), dtype=float)
        # Optimisers request values and derivatives at the same point in separate calls.
        key = point.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = key, self.predict([point])[0]
        return self._last[1]

    def _grouped(self) -> list[Group]:
        """Group conditions that can run in one block; those without measurements are not run."""
        found: dict[Hashable, list[int]] = {}
        for number, condition in enumerate(self.conditions):
            times = self.measured.t[self.measured.condition == number]
            if not times.size:
                continue
            key = (
                id(condition.model),
                # Tables cannot be hashed, so inputs are compared by identity of their mapping.
                id(condition.inputs) if condition.inputs else 0,
                condition.t_start,
                float(times.max()),
                tuple(frozenset(link.initial) for link in condition.chain),
            )
            found.setdefault(key, []).append(number)
        names = self.scaled.names
        return [
            Group(
                [self.conditions[i] for i in numbers], numbers, self.measured, names, self.settings
            )
            for numbers in found.values()
        ]
