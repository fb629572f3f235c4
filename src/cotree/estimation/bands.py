"""Confidence and prediction bands: propagation of parameter uncertainty to predictions.

The delta method computes the variance of a state or output y over time from exact sensitivities y'
and the covariance C of the estimates, var(y) = y' C y'^T. Alternatively, samples from the
distribution of the estimates account for the nonlinearity of the model.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.arguments import check_whole, doubles
from cotree.errors import ParameterError, brief, check_known
from cotree.estimation.conditions import Measured
from cotree.estimation.estimated import LOGARITHMS, Array
from cotree.estimation.problem import Problem
from cotree.report import frame

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.estimation.conditions import Condition
    from cotree.estimation.problem import Predictions
    from cotree.estimation.uncertainty import Uncertainty

# Default number of points in time.
_POINTS = 201


@dataclass(frozen=True, eq=False)
class Band:
    """A predicted quantity over time, with its confidence or prediction interval.

    Attributes
    ----------
    name, unit, condition : str
        Name and unit of the quantity, and name of the experiment.
    t : ndarray, shape (n,)
        Times, [s].
    value : ndarray, shape (n,)
        The quantity at the estimates.
    error : ndarray, shape (n,)
        Standard errors; infinite if the quantity depends on an undetermined direction.
    lower, upper : ndarray, shape (n,)
        Limits of the interval at each time.
    level : float
        Pointwise confidence level: it holds for each time separately, not for the whole curve.
    with_noise : bool
        Whether the band is for a new measurement (True) or for the true value.
    """

    name: str
    unit: str
    condition: str
    t: Array
    value: Array
    error: Array
    lower: Array
    upper: Array
    level: float
    with_noise: bool

    def __repr__(self) -> str:
        return f"<Band of {self.name} at {len(self.t)} times, {100 * self.level:g} %>"

    def to_dataframe(self) -> Any:
        """Return a pandas DataFrame with the columns t, value, error, lower and upper."""
        return frame({n: getattr(self, n) for n in ("t", "value", "error", "lower", "upper")})

    def plot(self, ax: Any = None) -> Any:
        """Plot the value and the interval over time."""
        from cotree.plot.fits import Course, draw_courses

        return draw_courses([Course(title_of(self.condition), self)], ax=ax)


def title_of(name: str) -> str:
    """Return the plot title of an experiment, which may only have a number."""
    return f"experiment {name}" if name.isdigit() else name


def find_condition(problem: Problem, given: int | str) -> int:
    """Return the index of a condition from its index or name."""
    names = [condition.name for condition in problem.conditions]
    if isinstance(given, str):
        check_known([given], names, "there is no experiment", error=ParameterError)
        return names.index(given)
    number = check_whole(given, "experiment")
    if number >= len(names):
        raise ParameterError(f"there are experiments 0 to {len(names) - 1}, but no {number}")
    return number


def read_times(t: Any, condition: Condition) -> Array:
    """Convert and check the times of predictions, [s], shape (n,)."""
    read = doubles(t)
    times = np.zeros(0) if read is None else np.atleast_1d(read)
    if times.ndim != 1 or not times.size or not np.all(np.isfinite(times)):
        raise ParameterError(f"the times are {brief(repr(t))}: give finite numbers")
    if times.min() < condition.t_start:
        raise ParameterError(
            f"the time {times.min():g} s is before the start of the run at {condition.t_start:g} s"
        )
    return times


def predicted_at(
    found: Uncertainty,
    condition: Condition,
    output: str,
    t: Array,
    noise: str | float,
    transformation: str,
) -> tuple[Problem, Predictions]:
    """Predict a quantity at times t; return a problem with these times, and the predictions."""
    problem, n = found.problem, len(t)
    quantities = [condition.quantity(output)] * n
    rows = Measured(
        np.zeros(n, dtype=np.intp), t, quantities, np.ones(n), [noise] * n, transformation
    )
    at = Problem(problem.estimated, [condition], rows, problem.settings)
    (there,) = at.predict([found.theta])
    if there.message:
        raise ParameterError(f"'{output}' cannot be predicted: {there.message}")
    return at, there


def like_measured(
    problem: Problem, number: int, output: str, noise: str | float | None
) -> tuple[str | float, str]:
    """Return the noise of a quantity, by default as measured before, and its transformation."""
    rows = [i for i, name in enumerate(problem.measured.observable) if name == output]
    here = [i for i in rows if problem.measured.condition[i] == number] or rows
    if not here:
        if noise is None:
            raise ParameterError(
                f"'{output}' was not measured, so its noise is unknown: give the standard "
                "deviation of its noise"
            )
        return noise, "lin"
    row, measured = here[0], problem.measured
    return measured.noise[row] if noise is None else noise, measured.transformation[row]


def band_of(
    found: Uncertainty,
    output: str,
    t: Any = None,
    *,
    condition: int | str = 0,
    level: float = 0.95,
    noise: bool | float | str = False,
    draws: int = 0,
    seed: int = 0,
) -> Band:
    """Predict a quantity with its uncertainty interval; see :meth:`FitResult.bands`."""
    problem = found.problem
    number = find_condition(problem, condition)
    run = problem.conditions[number]
    quantity = run.quantity(output)
    if t is None:
        times = problem.measured.t[problem.measured.condition == number]
        end = float(times.max()) if times.size else run.t_start + 1.0
        t = np.linspace(run.t_start, end, _POINTS)
    t = read_times(t, run)
    given = 1.0 if noise is False else None if noise is True else noise
    deviation, kind = like_measured(problem, number, quantity, given)
    at, there = predicted_at(found, run, output, t, deviation, kind)
    middle = at.likelihood.transformed(there.values)
    # Fisher rows are derivatives divided by sigma, so the product is the derivative itself.
    slopes = at.likelihood.fisher_rows(there)[: len(t)] * there.sigma[:, None]
    errors = found.error_along(slopes)
    # Maximum likelihood underestimates the noise, so it is corrected like the standard errors.
    factor = math.sqrt(found.spread) if noise is True and math.isfinite(found.freedom) else 1.0
    deviations = factor * there.sigma
    total = np.hypot(errors, deviations) if noise is not False else errors
    if draws:
        drawn = _draw(at, found, draws, seed, deviations if noise is not False else None)
        # Samples do not cover undetermined directions: quantities that depend on them become nan.
        drawn = np.where(np.isfinite(errors), drawn, [[np.nan]])
        tail = 0.5 * (1.0 - level)
        low, high = np.quantile(drawn, [tail, 1.0 - tail], axis=0)
        low, high = (
            np.where(np.isfinite(errors), *pair) for pair in ((low, -np.inf), (high, np.inf))
        )
    else:
        reach = found.quantile(level) * total
        low, high = middle - reach, middle + reach
    lower, upper, in_units = low, high, errors
    if kind != "lin":
        decade = LOGARITHMS[kind]
        in_units = errors * (np.abs(there.values) * decade)
        with np.errstate(over="ignore"):
            lower, upper = np.exp(low * decade), np.exp(high * decade)
    unit = run.model.kernels.layout.units.get(quantity, "")
    return Band(
        output, unit, run.name, t, there.values, in_units, lower, upper, level, noise is not False
    )


def _draw(at: Problem, found: Uncertainty, n: int, seed: int, deviations: Array | None) -> Array:
    """Predict a quantity for samples of the estimates in one call of the ensemble engine."""
    random = np.random.default_rng(check_whole(seed, "seed"))
    n = check_whole(n, "draws", 1)
    # Student's t variates are normal variates divided by sqrt(chi-squared / freedom).
    wide = np.ones((n, 1))
    if math.isfinite(found.freedom):
        wide = np.sqrt(found.freedom / random.chisquare(found.freedom, (n, 1)))
    drawn = wide * random.standard_normal((n, found.root.shape[1])) @ found.root.T
    thetas = found.theta + drawn
    thetas = np.clip(thetas, at.scaled.lower, at.scaled.upper)
    runs: Sequence[Predictions] = at.predict(thetas, slopes=False)
    is_run = np.array([not run.message for run in runs])
    if not is_run.any():
        raise ParameterError(f"the runs of all {n} draws failed: {runs[0].message}")
    drawn = np.array([at.likelihood.transformed(run.values) for run in runs])[is_run]
    if deviations is not None:
        drawn = drawn + deviations * wide[is_run] * random.standard_normal(drawn.shape)
    return np.asarray(drawn)
