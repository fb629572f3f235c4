"""Results of a fit: estimates with their uncertainty."""

from __future__ import annotations

import json
import math
import textwrap
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.arguments import check_names
from cotree.errors import ParameterError, nearest
from cotree.estimation.bands import Band, title_of
from cotree.report import Report, Reported, Table, counted, frame, json_values, matrix

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from cotree.estimation.candidates import NextMeasurements
    from cotree.estimation.estimated import Array
    from cotree.estimation.multistart import MoreRows, Search, StartRecord
    from cotree.estimation.problem import Predictions, Problem
    from cotree.estimation.profiles import Profile
    from cotree.estimation.uncertainty import Uncertainty
    from cotree.plot.fits import Course, ResidualSeries


# Width of text, smallest correlation that is listed, and largest number of listed correlations.
_WIDTH, _CORRELATED, _MOST_CORRELATED = 96, 0.5, 8

# Attributes with arrays that are written to JSON.
_ARRAYS = ("theta", "covariance", "correlation", "fisher", "eigenvalues")

_HEAD = ("parameter", "estimate", "std. error", "relative", "lower", "upper", "unit", "")


class FitResult(Reported):
    """Estimated parameters with their uncertainty.

    ``print(result)`` shows estimates with standard errors and intervals, and findings on the
    limitations of the estimates. Standard errors follow from the Fisher information, which is
    formed from exact sensitivities. Profiles do not assume that the model is nearly linear.

    Parameters
    ----------
    problem : Problem
        The problem that was solved.
    starts : sequence of StartRecord
        The starts, sorted by objective.
    search : Search, optional
        Settings of the optimiser; standard errors depend on its loss.
    more_rows : callable, optional
        Returns the residuals of priors and their Jacobian at ``theta``; see
        :func:`~cotree.estimation.multistart.minimise_from_starts`.

    Attributes
    ----------
    problem, starts, search, more_rows
        The arguments.
    """

    def __init__(
        self,
        problem: Problem,
        starts: Sequence[StartRecord],
        search: Search | None = None,
        *,
        more_rows: MoreRows | None = None,
    ) -> None:
        self.problem, self.starts = problem, tuple(starts)
        self.search, self.more_rows = search, more_rows

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the estimated parameters, in the order of array entries."""
        return self.problem.scaled.names

    @property
    def theta(self) -> Array:
        """Estimates on their scales, shape (n_estimated,)."""
        return self.starts[0].theta

    @property
    def parameters(self) -> dict[str, float]:
        """Estimates by name, in their units."""
        values = self.problem.scaled.values(self.theta)
        return dict(zip(self.names, values.tolist(), strict=True))

    @cached_property
    def predictions(self) -> Predictions:
        """Predictions at the estimates.

        Raises
        ------
        ParameterError
            If no start succeeded.
        """
        if not math.isfinite(self.starts[0].objective):
            raise ParameterError(f"no start of the fit succeeded: {self.starts[0].message}")
        (found,) = self.problem.predict([self.theta])
        if found.message:
            raise ParameterError(f"the run at the estimates failed: {found.message}")
        return found

    @cached_property
    def uncertainty(self) -> Uncertainty:
        """Covariance and Fisher information on the scales of the parameters."""
        from cotree.estimation.uncertainty import robust_factor, uncertainty_of

        factor = 1.0
        if self.search is not None and self.search.loss != "linear":
            factor = robust_factor(
                self.residuals, self.search.loss, self.search.f_scale, len(self.names)
            )
        return uncertainty_of(self.problem, self.theta, self.predictions, self._prior, factor)

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard errors by name, in the parameters' units; infinite if undetermined."""
        slopes = self.problem.scaled.slopes(self.theta)
        # On a logarithmic scale the derivative vanishes for a value of zero.
        errors = np.where(slopes > 0.0, slopes, 1.0) * self.uncertainty.errors
        return dict(zip(self.names, errors.tolist(), strict=True))

    def intervals(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Return confidence intervals by name, in the parameters' units.

        They are computed on the scale of each parameter, so that they are positive for logarithmic
        scales. Bounds are not taken into account.

        Parameters
        ----------
        level : float
            Confidence level of each interval separately.
        """
        reach = self.uncertainty.quantile(level) * self.uncertainty.errors
        with np.errstate(over="ignore"):
            low, high = (self.problem.scaled.values(self.theta + s * reach) for s in (-1.0, 1.0))
        return dict(zip(self.names, zip(low.tolist(), high.tolist(), strict=True), strict=True))

    @property
    def covariance(self) -> Array:
        """Covariance of the estimates on their scales, shape (n_estimated, n_estimated)."""
        return self.uncertainty.covariance

    @property
    def correlation(self) -> Array:
        """Correlation of the estimates, (n_estimated, n_estimated); nan if undetermined."""
        return self.uncertainty.correlation

    @property
    def fisher(self) -> Array:
        """Fisher information on the scales of the parameters, shape (n_estimated, n_estimated)."""
        return self.uncertainty.fisher

    @property
    def eigenvalues(self) -> Array:
        """Eigenvalues of the Fisher information for relative changes, ascending, (n_estimated,).

        The inverse square root of each eigenvalue is the relative standard error of a parameter
        combination. For undetermined combinations the eigenvalue is zero up to rounding.
        """
        return np.asarray(np.linalg.eigvalsh(self._relative_fisher()))

    @property
    def eigenvectors(self) -> Array:
        """Eigenvectors for :attr:`eigenvalues` as columns, in relative changes."""
        return np.asarray(np.linalg.eigh(self._relative_fisher())[1])

    @property
    def residuals(self) -> Array:
        """Residuals (computed minus measured values) in standard deviations, shape (n_rows,)."""
        return self.problem.likelihood.residuals(self.predictions)

    @property
    def chi2(self) -> float:
        """Chi-squared: sum of the squared residuals."""
        return self.problem.likelihood.chi2(self.predictions)

    @property
    def degrees_of_freedom(self) -> int:
        """Number of measured values minus number of parameter combinations that they determine."""
        n_open = int(self.uncertainty.split.open.shape[1])
        return len(self.problem.measured) - len(self.names) + n_open

    @property
    def reduced_chi2(self) -> float:
        """Chi-squared divided by its degrees of freedom; nan if there are none."""
        freedom = self.degrees_of_freedom
        return self.chi2 / freedom if freedom > 0 else math.nan

    @property
    def log_likelihood(self) -> float:
        """Logarithm of the likelihood at the estimates."""
        return self.problem.likelihood.log_likelihood(self.predictions)

    @property
    def aic(self) -> float:
        """Akaike information criterion."""
        return 2.0 * (len(self.names) - self.log_likelihood)

    @property
    def bic(self) -> float:
        """Bayesian information criterion."""
        return len(self.names) * math.log(len(self.problem.measured)) - 2.0 * self.log_likelihood

    @cached_property
    def at_bounds(self) -> dict[str, str]:
        """Parameters at a bound, each with "lower" or "upper"."""
        from cotree.estimation.uncertainty import at_bounds

        return at_bounds(self.problem, self.theta)

    @cached_property
    def undetermined(self) -> tuple[str, ...]:
        """Sentences on the parameter combinations that the data do not determine."""
        from cotree.estimation.uncertainty import of_directions

        return of_directions(self.uncertainty, self._prior)

    @cached_property
    def findings(self) -> tuple[str, ...]:
        """Limitations of the estimates, one sentence each; empty if there are none."""
        from cotree.estimation.uncertainty import of_agreement, of_bounds, of_optimiser, of_widths

        first = of_optimiser(self.starts)
        if not math.isfinite(self.starts[0].objective):
            return first
        return (
            *first,
            *of_bounds(self.problem, self.at_bounds),
            *self.undetermined,
            *of_widths(self.uncertainty),
            *of_agreement(self.problem, self.predictions, self.degrees_of_freedom, self.search),
        )

    def profile(self, name: str, *, level: float = 0.95) -> Profile:
        """Return the profile likelihood of a parameter and its likelihood-ratio interval.

        Parameters
        ----------
        name : str
            An estimated parameter.
        level : float
            Confidence level.

        Raises
        ------
        ParameterError
            If the parameter is not estimated, or the loss is not a likelihood.
        """
        return self.profiles([name], level=level)[name]

    def profiles(
        self, names: Sequence[str] | None = None, *, level: float = 0.95
    ) -> dict[str, Profile]:
        """Return the profile likelihoods of several parameters, computed in one batch.

        Parameters
        ----------
        names : sequence of str, optional
            Estimated parameters; by default all.
        level : float
            Confidence level.
        """
        from cotree.estimation.profiles import profiles_of

        if self.search is not None and self.search.loss != "linear":
            raise ParameterError(
                f"the loss '{self.search.loss}' is not a likelihood, so it has no profiles: fit "
                "with loss='linear'"
            )
        chosen = self.names if names is None else check_names(names, "names")
        for name in chosen:
            if name not in self.names:
                raise ParameterError(f"'{name}' is not estimated{nearest(name, self.names)}")
        objective = -self.log_likelihood
        if self.more_rows is not None:
            objective += 0.5 * float(np.sum(self.more_rows(self.theta)[0] ** 2))
        places = [self.names.index(name) for name in chosen]
        found = profiles_of(
            self.uncertainty, objective, places, level=level, more_rows=self.more_rows
        )
        return {row.name: row for row in found}

    def bands(
        self,
        output: str,
        t: Any = None,
        *,
        experiment: int | str = 0,
        level: float = 0.95,
        noise: bool | float | str = False,
        draws: int = 0,
        seed: int = 0,
    ) -> Band:
        """Predict any state or output with its confidence or prediction interval.

        Parameters
        ----------
        output : str
            A state or output of the model, measured or not, or a column of the data.
        t : array_like, optional
            Times, [s]; by default from the start to the last measured value.
        experiment : int or str
            The experiment, by its number or name.
        level : float
            Pointwise confidence level.
        noise : bool, float or str
            Whether to include the noise of a new measurement, which yields a prediction interval.
            True selects the noise of previous measurements of this quantity; a number or a name is
            its standard deviation.
        draws : int
            Number of samples from the distribution of the estimates, normal or Student's t. Zero
            selects the delta method, which linearises the model at the estimates.
        seed : int
            Seed of the samples.

        Raises
        ------
        ParameterError
            If a name is unknown, or the run fails.
        """
        from cotree.estimation.bands import band_of

        return band_of(
            self.uncertainty, output, t,
            condition=experiment, level=level, noise=noise, draws=draws, seed=seed,
        )  # fmt: skip

    def next_measurements(
        self, candidates: Any, n: int = 5, *, criterion: str = "D", repeat: bool = True
    ) -> NextMeasurements:
        """Choose the further measurements that reduce the intervals most.

        Parameters
        ----------
        candidates : mapping, or sequence of Candidates
            Outputs, states or columns, mapped to times, to (times, noise), or to a mapping of the
            fields of :class:`~cotree.estimation.candidates.Candidates`, which can also change the
            experiment. By default, the noise is taken from previous measurements of the output.
        n : int
            Number of measurements to choose.
        criterion : str
            The quantity to minimise: "D", the determinant of the covariance; "A", the sum of
            relative variances; "E", the largest variance along any direction; or the name of a
            parameter, for its variance.
        repeat : bool
            Whether a candidate may be measured more than once.

        Returns
        -------
        NextMeasurements
            Ordered by benefit, with the standard errors after each.

        Raises
        ------
        ParameterError
            If a name or the criterion is unknown, the noise is missing, or there are too few
            candidates.
        """
        from cotree.estimation.candidates import choose

        return choose(
            self.uncertainty, candidates, n,
            criterion=criterion, repeat=repeat,
        )  # fmt: skip

    @cached_property
    def _prior(self) -> Array | None:
        """The Jacobian of the prior residuals at the estimates."""
        return None if self.more_rows is None else self.more_rows(self.theta)[1]

    def _relative_fisher(self) -> Array:
        sizes = np.abs(self.uncertainty.split.sizes)
        return np.asarray(np.outer(sizes, sizes) * self.fisher)

    @cached_property
    def units(self) -> dict[str, str]:
        """Units of the parameters by name; empty strings if unknown."""
        return {
            row.name: row.unit or _unit(self.problem, row.name) for row in self.problem.estimated
        }

    @property
    def is_converged(self) -> bool:
        """Whether the best start met the tolerances of the optimiser."""
        return self.starts[0].is_converged

    @property
    def optimality(self) -> float:
        """Optimality of the best start; see :class:`~cotree.estimation.multistart.StartRecord`."""
        return self.starts[0].optimality

    def to_dict(self) -> dict[str, Any]:
        """Return all results as JSON-compatible values; numbers that are not finite become None."""
        found: dict[str, Any] = json_values(
            {
                "parameters": self._estimates(),
                "agreement": self._agreement(),
                "names": list(self.names),
                "scales": [row.scale for row in self.problem.estimated],
                **{name: getattr(self, name) for name in _ARRAYS},
                "starts": self._starts(),
                "findings": list(self.findings),
            }
        )
        return found

    def to_json(self, path: str | os.PathLike[str] | None = None) -> str:
        """Return ``to_dict()`` as JSON text; also write it to ``path`` unless that is None."""
        from cotree.files import atomic_write

        text = json.dumps(self.to_dict(), indent=2, allow_nan=False)
        if path is not None:
            with atomic_write(path) as draft:
                draft.write_text(text + "\n", encoding="utf-8")
        return text

    def to_dataframe(self, level: float = 0.95) -> Any:
        """Return a pandas DataFrame with one row per parameter."""
        return frame(self._estimates(level), "parameter")

    def starts_table(self) -> Any:
        """Return a pandas DataFrame with one row per start, the best one first."""
        return frame(self._starts(), "rank")

    def plot(self) -> Figure:
        """Plot data and predictions with bands, residuals, and either starts or correlations."""
        return overview(self)

    def plot_courses(self, *, noise: bool = False) -> Figure:
        """Plot measured and predicted values over time with uncertainty bands.

        If ``noise`` is true, the bands include the measurement noise.
        """
        from cotree.plot.fits import draw_courses

        return draw_courses(courses(self, noise=noise))

    def plot_residuals(self) -> Figure:
        """Plot residuals over time, measured over predicted values, and a probability plot."""
        from cotree.plot.fits import draw_residuals

        return draw_residuals(residuals(self))

    def plot_waterfall(self) -> Figure:
        """Plot the objectives of all starts in ascending order."""
        from cotree.plot.fits import draw_waterfall

        return draw_waterfall(self.starts)

    def plot_profiles(self, names: Sequence[str] | None = None, *, level: float = 0.95) -> Figure:
        """Compute and plot profile likelihoods."""
        from cotree.plot.fits import draw_profiles

        curves = list(self.profiles(names, level=level).values())
        return draw_profiles(curves, self.standard_errors)

    def plot_correlation(self) -> Figure:
        """Plot the correlation matrix of the estimates as a heat map."""
        from cotree.plot.fits import draw_correlation

        return draw_correlation(self.names, self.correlation)

    def report(self) -> Report:
        """Return a report with goodness of fit, estimates, correlations and findings."""
        sizes = {
            "parameter": len(self.problem.estimated),
            "value": len(self.problem.measured),
            "experiment": len(self.problem.conditions),
        }
        parameters, values, experiments = (counted(n, noun) for noun, n in sizes.items())
        agreement = [
            (name, "" if isinstance(value, float) and math.isnan(value) else value)
            for name, value in self._agreement().items()
            if name not in ("values", "conditions", "estimated")
        ]
        estimates = [
            (
                row["parameter"],
                f"{row['estimate']:.6g}",
                _shown(row["error"], "{:.3g}"),
                f"{100 * row['relative']:.2g} %" if math.isfinite(row["relative"]) else "",
                _shown(row["lower"]),
                _shown(row["upper"]),
                *(row["unit"], row["remark"]),
            )
            for row in self._estimates()
        ]
        return Report(
            f"Fit of {parameters} to {values} of {experiments}",
            Table(("", ""), agreement, align="lr"),
            Table(_HEAD, estimates, align="lrrrrrll"),
            _wrapped(self._how()),
            _wrapped(f"Correlations: {', '.join(pairs)}") if (pairs := self._correlated()) else "",
            matrix("Correlation", self.names, self.names, np.round(self.correlation, 3)),
            *(_wrapped(f"! {sentence}", "  ") for sentence in self.findings),
        )

    def __repr__(self) -> str:
        """Return the estimates on one line."""
        found = ", ".join(f"{name} = {value:.6g}" for name, value in self.parameters.items())
        return f"<FitResult: {found}>"

    def _estimates(self, level: float = 0.95) -> list[dict[str, Any]]:
        """Return one row per parameter: estimate, error, interval, bounds and remark."""
        errors, intervals = self.standard_errors, self.intervals(level)
        is_open = self.uncertainty.split.is_open
        rows = []
        for i, row in enumerate(self.problem.estimated):
            value, error = self.parameters[row.name], errors[row.name]
            side = self.at_bounds.get(row.name, "")
            remark = f"at its {side} bound" if side else ""
            rows.append(
                {
                    "parameter": row.name,
                    "estimate": value,
                    "error": error,
                    "relative": abs(error / value) if value else math.inf,
                    "lower": intervals[row.name][0],
                    "upper": intervals[row.name][1],
                    "unit": self.units[row.name],
                    "scale": row.scale,
                    "bounds": (row.lower, row.upper),
                    "remark": "not determined" if is_open[i] else remark,
                }
            )
        return rows

    def _agreement(self) -> dict[str, Any]:
        return {
            "values": len(self.problem.measured),
            "conditions": len(self.problem.conditions),
            "estimated": len(self.problem.estimated),
            "degrees of freedom": self.degrees_of_freedom,
            "chi2": self.chi2,
            "reduced chi2": self.reduced_chi2,
            "log-likelihood": self.log_likelihood,
            "AIC": self.aic,
            "BIC": self.bic,
            "starts": len(self.starts),
            "converged": sum(row.is_converged for row in self.starts),
            "evaluations": sum(row.n_evaluations for row in self.starts),
        }

    def _starts(self) -> list[dict[str, Any]]:
        """Return one row per start, the best one first.

        The distance from the best end point is the Mahalanobis distance in standard errors, without
        undetermined directions.
        """
        best, rows = self.starts[0], []
        values = self.problem.scaled.values
        for rank, start in enumerate(self.starts):
            apart = start.theta - best.theta
            distance = math.sqrt(max(float(apart @ self.fisher @ apart), 0.0))
            rows.append(
                {
                    "rank": rank,
                    "objective": start.objective,
                    "above": start.objective - best.objective if rank else 0.0,
                    "distance": distance,
                    "evaluations": start.n_evaluations,
                    "converged": start.is_converged,
                    "message": start.message,
                    **dict(zip(self.names, values(start.theta).tolist(), strict=True)),
                }
            )
        return rows

    def _how(self) -> str:
        freedom = self.uncertainty.freedom
        law = (
            "normal quantiles, because the noise is given"
            if math.isinf(freedom)
            else f"Student's t with {freedom:g} degrees of freedom, because the noise is estimated"
        )
        logs = any(row.scale != "lin" for row in self.problem.estimated)
        on_scale = "; those of logarithmic parameters are formed on that scale" if logs else ""
        return f"The 95 % intervals use {law}{on_scale}."

    def _correlated(self) -> list[str]:
        found = [
            (abs(c), f"{self.names[i]} with {self.names[j]} {c:+.2f}")
            for i in range(len(self.names))
            for j in range(i)
            if math.isfinite(c := float(self.correlation[i, j])) and abs(c) >= _CORRELATED
        ]
        return [text for _, text in sorted(found, reverse=True)[:_MOST_CORRELATED]]


def _unit(problem: Problem, name: str) -> str:
    """Return the unit of an estimated parameter, from the parameter or state tied to it."""
    for condition in problem.conditions:
        for target, value in (*condition.parameters.items(), *condition.initial.items()):
            if value == name:
                return condition.model.kernels.layout.units.get(target, "")
    return ""


def _shown(number: float, form: str = "{:.6g}") -> str:
    return "" if math.isnan(number) else form.format(number)


def _wrapped(sentence: str, later: str = "") -> str:
    return textwrap.fill(sentence, _WIDTH, subsequent_indent=later)


# Largest numbers of readable time plots in an overview and in a separate figure.
_MOST_IN_OVERVIEW, _MOST = 6, 24


def courses(result: FitResult, *, noise: bool = False, most: int = _MOST) -> list[Course]:
    """Return measured and computed values over time with bands, for at most ``most`` plots."""
    from cotree.plot.fits import Course

    measured, found = result.problem.measured, result.predictions
    parts = []
    for condition, name, rows in _measured_parts(result)[:most]:
        t = measured.t[rows]
        run = result.problem.conditions[condition]
        end = max(t.max(), run.t_start)
        times = np.unique(np.concatenate([np.linspace(run.t_start, end, 301), t]))
        band = result.bands(run.column(name), times, experiment=condition, noise=noise)
        is_plain = not result.problem.likelihood.is_log[rows].any()
        values = np.asarray(measured.value, dtype=float)[rows]
        sigma = found.sigma[rows] if is_plain else None
        parts.append(Course(title_of(run.name), band, t, values, sigma))
    return parts


def residuals(result: FitResult) -> list[ResidualSeries]:
    """Return the residuals of each quantity in each experiment."""
    from cotree.plot.fits import ResidualSeries

    likelihood, values = result.problem.likelihood, result.residuals
    computed = likelihood.transformed(result.predictions.values)
    target = likelihood.transformed(likelihood.value)
    has_several = len(result.problem.conditions) > 1
    return [
        ResidualSeries(
            f"{run.column(name)} · {title_of(run.name)}" if has_several else run.column(name),
            result.problem.measured.t[rows],
            values[rows],
            target[rows],
            computed[rows],
        )
        for condition, name, rows in _measured_parts(result)
        for run in [result.problem.conditions[condition]]
    ]


def overview(result: FitResult) -> Figure:
    """Plot time courses, residuals, and either starts or correlations."""
    from cotree.plot.fits import draw_overview

    shown = courses(result, most=_MOST_IN_OVERVIEW)
    return draw_overview(shown, residuals(result), result.starts, result.names, result.correlation)


def _measured_parts(result: FitResult) -> list[tuple[int, str, np.ndarray]]:
    """Return condition, name and row indices of each measured quantity in each experiment."""
    measured = result.problem.measured
    parts: dict[tuple[int, str], list[int]] = {}
    for i, name in enumerate(measured.observable):
        parts.setdefault((int(measured.condition[i]), name), []).append(i)
    return [(c, name, np.array(rows)) for (c, name), rows in parts.items()]
