"""Priors of a PEtab problem, version 1: densities for the objective, and samples for starts.

A prior whose type begins with ``parameterScale`` is a density of the parameter on its scale; any
other prior is a density of its value. Densities are evaluated as stated, without the factor of a
change of variables, and are not truncated at the bounds. Starts out of bounds are drawn again.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from cotree.errors import ParameterError
from cotree.estimation.estimated import Array, Scaled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.estimation.estimated import Estimated
    from cotree.estimation.petab.tables import PriorRow

_MOST_DRAWS = 1000

# Below this deviation, in multiples of its scale, the Laplace distribution's absolute value is
# replaced by a square, whose slope passes through zero continuously.
_CORNER = 1e-3

# Added to logarithms to make them positive: the logarithm of a double is never below -745.
_LEAST_LOG = 750.0


class Priors:
    """Objective priors of the estimated parameters, some of which have none."""

    def __init__(self, estimated: Sequence[Estimated], rows: Sequence[PriorRow | None]) -> None:
        self._n = len(estimated)
        self._terms = [
            (i, Prior(row, estimated[i])) for i, row in enumerate(rows) if row is not None
        ]

    def __bool__(self) -> bool:
        return bool(self._terms)

    def log_density(self, theta: Array) -> float:
        """Compute the sum of the logarithms of all densities."""
        return sum(prior.log_density(float(theta[i]))[0] for i, prior in self._terms)

    def gradient(self, theta: Array) -> Array:
        """Compute its derivatives with respect to the scaled parameters, shape (n_estimated,)."""
        found = np.zeros(self._n)
        for i, prior in self._terms:
            found[i] = prior.log_density(float(theta[i]))[1]
        return found

    def rows(self, theta: Array) -> tuple[Array, Array]:
        """Return residuals for least-squares methods, with their Jacobian.

        Half of their sum of squares is minus the sum of the logarithms up to a constant, and the
        transposed Jacobian times the residuals is its exact gradient. Uniform priors have none.
        """
        rows = [(i, *row) for i, prior in self._terms for row in prior.squares(float(theta[i]))]
        slopes = np.zeros((len(rows), self._n))
        for at, (i, _, slope) in enumerate(rows):
            slopes[at, i] = slope
        return np.array([value for _, value, _ in rows]), slopes


class Prior:
    """A prior of one parameter."""

    def __init__(self, row: PriorRow, estimated: Estimated) -> None:
        self._kind, self._a, self._b = row.kind, row.first, row.second
        self._scaled = Scaled([estimated])
        self._is_on_scale = row.kind.startswith("parameterScale")
        self._is_log = row.kind.startswith("log")
        self._family = row.kind.removeprefix("parameterScale").removeprefix("log").lower()
        self._name, self._bounds = estimated.name, (self._scaled.lower[0], self._scaled.upper[0])

    def _deviation(self, theta: float) -> tuple[float, float]:
        """Return the argument of the density and its derivative with respect to ``theta``."""
        if self._is_on_scale:
            return theta, 1.0
        given = np.array([theta])
        x, slope = float(self._scaled.values(given)[0]), float(self._scaled.slopes(given)[0])
        if not self._is_log:
            return x, slope
        return (math.log(x), slope / x) if x > 0.0 else (math.nan, 0.0)

    def log_density(self, theta: float) -> tuple[float, float]:
        """Compute the logarithm of the density and its derivative with respect to ``theta``."""
        z, z_slope = self._deviation(theta)
        if math.isnan(z):
            return -math.inf, 0.0
        if self._family == "uniform":
            is_inside = self._a <= z <= self._b
            return (-math.log(self._b - self._a) if is_inside else -math.inf), 0.0
        r = (z - self._a) / self._b
        if self._family == "normal":
            value, slope = -0.5 * r * r - math.log(self._b * math.sqrt(2.0 * math.pi)), -r
        else:
            value, slope = -abs(r) - math.log(2.0 * self._b), -math.copysign(bool(r), r)
        # A density of the logarithm becomes one of the value by the factor 1/x.
        factor = float(self._is_log)
        return value - factor * z, (slope / self._b - factor) * z_slope

    def squares(self, theta: float) -> list[tuple[float, float]]:
        """Compute residuals for least-squares methods and their slopes; see :meth:`Priors.rows`."""
        if self._family == "uniform":
            return []
        z, along = self._deviation(theta)
        if math.isnan(z):
            return [(math.nan, 0.0)]
        r, r_slope = (z - self._a) / self._b, along / self._b
        if self._family == "normal":
            # The factor 1/x of a log-normal density only shifts the square.
            return [(r + (self._b if self._is_log else 0.0), r_slope)]
        # This residual times its slope is the slope of the absolute value; a residual with zero
        # slope supplies the rest of the value.
        weight = max(abs(r), _CORNER) ** -0.5
        rows = [(r * weight, r_slope * weight)]
        missing = 2.0 * abs(r) - (r * weight) ** 2
        if self._is_log:
            rows.append((1.0, along))
            missing += 2.0 * (_LEAST_LOG + z)
        return [*rows, (math.sqrt(missing), 0.0)]

    def sample(self, n: int, random: np.random.Generator) -> Array:
        """Draw starts on the parameter's scale, within its bounds, shape (n,)."""
        low, high = self._bounds
        found: Array = np.empty(0)
        for _ in range(_MOST_DRAWS):
            drawn = self._drawn(n, random)
            found = np.concatenate([found, drawn[(drawn >= low) & (drawn <= high)]])
            if len(found) >= n:
                return found[:n]
        raise ParameterError(
            f"the initializationPrior of '{self._name}' has almost no probability within its bounds"
        )

    def _drawn(self, n: int, random: np.random.Generator) -> Array:
        values: Array = getattr(random, self._family)(self._a, self._b, n)
        if self._is_on_scale:
            return values
        if self._is_log:
            values = np.exp(values)
        with np.errstate(invalid="ignore"):
            return self._scaled.scaled(values[:, None])[:, 0]


def sample_starts(
    estimated: Sequence[Estimated], rows: Sequence[PriorRow | None], n: int, seed: int | None
) -> Array:
    """Draw starts on the scales, shape (n, n_estimated); uniform without a prior."""
    random, scaled = np.random.default_rng(seed), Scaled(estimated)
    found = np.empty((n, len(rows)))
    for i, (parameter, row) in enumerate(zip(estimated, rows, strict=True)):
        if row is not None:
            found[:, i] = Prior(row, parameter).sample(n, random)
            continue
        low, high = scaled.lower[i], scaled.upper[i]
        if not (np.isfinite(low) and np.isfinite(high)):
            raise ParameterError(
                f"starts of '{parameter.name}' cannot be drawn between {parameter.lower:g} and "
                f"{parameter.upper:g} on scale {parameter.scale}: give it an initializationPrior"
            )
        found[:, i] = random.uniform(low, high, n)
    return found
