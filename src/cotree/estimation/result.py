"""Results of a fit: estimates and their uncertainty."""

from __future__ import annotations

import json
import math
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from cotree.errors import ParameterError, nearest
from cotree.scene.given import check_names

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Sequence

    import numpy.typing as npt
    from matplotlib.figure import Figure

    from cotree.estimation.bands import Band
    from cotree.estimation.candidates import NextMeasurements
    from cotree.estimation.likelihood import Predictions
    from cotree.estimation.multistart import Search, StartRecord
    from cotree.estimation.problem import Problem
    from cotree.estimation.profiles import Profile
    from cotree.estimation.uncertainty import Uncertainty


class ShownFit:
    """Text, tables and plots of a :class:`~cotree.estimation.result.FitResult`."""

    @cached_property
    def units(self) -> dict[str, str]:
        """Units by name; an empty string if unknown."""
        return {
            row.name: row.unit or _unit(self._fit.problem, row.name)
            for row in self._fit.problem.estimated
        }

    @property
    def is_converged(self) -> bool:
        """Whether the best start met the tolerances of the optimiser."""
        return self._fit.starts[0].is_converged

    @property
    def optimality(self) -> float:
        """The optimality of the best start; see :class:`~cotree.estimation.multistart`."""
        return self._fit.starts[0].optimality

    def to_dict(self) -> dict[str, Any]:
        """Return everything as JSON-compatible values; numbers that are not finite are None."""
        from cotree.estimation.report import as_dict

        return as_dict(self._fit)

    def to_json(self, path: str | os.PathLike[str] | None = None) -> str:
        """Return the same as JSON text; if a path is given, also write it to that file."""
        from cotree.files import written_whole

        text = json.dumps(self.to_dict(), indent=2, allow_nan=False)
        if path is not None:
            with written_whole(path) as draft:
                draft.write_text(text + "\n", encoding="utf-8")
        return text

    def to_dataframe(self, level: float = 0.95) -> Any:
        """Return a pandas DataFrame with a row for each parameter."""
        from cotree.estimation.report import estimate_rows, frame

        return frame(estimate_rows(self._fit, level), "parameter")

    def starts_table(self) -> Any:
        """Return a pandas DataFrame with a row for each start, the best one first."""
        from cotree.estimation.report import frame, starts_rows

        return frame(starts_rows(self._fit), "rank")

    def plot(self) -> Figure:
        """Plot data and predictions with bands, residuals, and starts or correlations."""
        from cotree.estimation.pictures import overview

        return overview(self._fit)

    def plot_courses(self, *, noise: bool = False) -> Figure:
        """Plot measured and predicted values over time with bands, which may include noise."""
        from cotree.estimation.pictures import courses
        from cotree.plot.fits import draw_courses

        return draw_courses(courses(self._fit, noise=noise))

    def plot_residuals(self) -> Figure:
        """Plot residuals over time, measured against predicted values, and a probability plot."""
        from cotree.estimation.pictures import residuals
        from cotree.plot.fits import draw_residuals

        return draw_residuals(residuals(self._fit))

    def plot_waterfall(self) -> Figure:
        """Plot the objectives of all starts in ascending order."""
        from cotree.estimation.pictures import waterfall

        return waterfall(self._fit)

    def plot_profiles(self, names: Sequence[str] | None = None, *, level: float = 0.95) -> Figure:
        """Compute and plot profile likelihoods."""
        from cotree.estimation.pictures import profiles

        return profiles(self._fit, names, level)

    def plot_correlation(self) -> Figure:
        """Plot the correlation matrix of the estimates as a heat map."""
        from cotree.plot.fits import draw_correlation

        return draw_correlation(self._fit.names, self._fit.correlation)

    def __str__(self) -> str:
        """Return a summary as plain text."""
        from cotree.estimation.report import as_text

        return as_text(self._fit)

    def __repr__(self) -> str:
        """Return the estimates on one line."""
        found = ", ".join(f"{name} = {value:.6g}" for name, value in self._fit.parameters.items())
        return f"<FitResult: {found}>"

    def _repr_html_(self) -> str:
        from cotree.estimation.report import as_html

        return as_html(self._fit)

    @property
    def _fit(self) -> FitResult:
        return cast("FitResult", self)


def _unit(problem: Problem, name: str) -> str:
    """Find the unit of the model parameter or state to which an estimated parameter is tied."""
    for condition in problem.conditions:
        for target, value in (*condition.parameters.items(), *condition.initial.items()):
            if value == name:
                return condition.model.layout.units.get(target, "")
    return ""


if TYPE_CHECKING:
    Array = npt.NDArray[np.float64]


class FitResult(ShownFit):
    """Estimated parameters with their uncertainty.

    ``print(result)`` shows estimates with standard errors and intervals, and the findings: anything
    that limits the use of the estimates. Standard errors follow from the Fisher information, which
    is formed from exact sensitivities; profiles do not assume that the model is nearly linear.

    Parameters
    ----------
    problem : Problem
        What was fitted.
    starts : sequence of StartRecord
        The starts, sorted by objective.
    search : Search, optional
        Settings of the optimiser; standard errors depend on its loss.
    more_rows : callable, optional
        Returns residuals of priors and their Jacobian for ``theta``; see
        :func:`~cotree.estimation.multistart.minimise_from_starts`.

    Attributes
    ----------
    problem, starts, search, more_rows
        As given.
    """

    def __init__(
        self,
        problem: Problem,
        starts: Sequence[StartRecord],
        search: Search | None = None,
        *,
        more_rows: Callable[[Array], tuple[Array, Array]] | None = None,
    ) -> None:
        self.problem, self.starts = problem, tuple(starts)
        self.search, self.more_rows = search, more_rows

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the estimated parameters, in the order of arrays."""
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
        """Covariance and Fisher information, on the scales of the parameters."""
        from cotree.estimation.uncertainty import robust_factor, uncertainty_of

        factor = 1.0
        if self.search is not None and self.search.loss != "linear":
            factor = robust_factor(
                self.residuals, self.search.loss, self.search.f_scale, len(self.names)
            )
        return uncertainty_of(self.problem, self.theta, self.predictions, self._prior, factor)

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard errors by name, in units; infinite if a parameter is not determined."""
        slopes = self.problem.scaled.slopes(self.theta)
        # The derivative is zero for a value of zero on a logarithmic scale.
        errors = np.where(slopes > 0.0, slopes, 1.0) * self.uncertainty.errors
        return dict(zip(self.names, errors.tolist(), strict=True))

    def intervals(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Return confidence intervals by name, in units.

        They are formed on the scale of each parameter, so those of parameters on logarithmic scales
        are positive, and do not take the bounds into account.

        Parameters
        ----------
        level : float
            Confidence level of each interval on its own.
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

        The inverse square root of each is the relative standard error of a combination of
        parameters; for undetermined combinations the eigenvalue is zero up to rounding.
        """
        return np.asarray(np.linalg.eigvalsh(self._relative_fisher()))

    @property
    def eigenvectors(self) -> Array:
        """Eigenvectors for :attr:`eigenvalues`, in relative changes, in the columns."""
        return np.asarray(np.linalg.eigh(self._relative_fisher())[1])

    @property
    def residuals(self) -> Array:
        """Residuals of the measured values in standard deviations, computed minus measured."""
        return self.problem.likelihood.residuals(self.predictions)

    @property
    def chi2(self) -> float:
        """Sum of the squared residuals."""
        return self.problem.likelihood.chi2(self.predictions)

    @property
    def degrees_of_freedom(self) -> int:
        """Number of measured values less that of the parameter combinations they determine."""
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
        """Parameters at a bound, with "lower" or "upper"."""
        from cotree.estimation.findings import at_bounds

        sides = zip(self.names, at_bounds(self.problem, self.theta), strict=True)
        return {name: side for name, side in sides if side}

    @cached_property
    def undetermined(self) -> tuple[str, ...]:
        """Combinations of parameters that the data do not determine, a sentence for each group."""
        from cotree.estimation.findings import of_directions

        return of_directions(self.problem, self.theta, self.uncertainty, self._prior)

    @cached_property
    def findings(self) -> tuple[str, ...]:
        """Limits on the use of the estimates, a sentence each; empty if there are none."""
        from cotree.estimation.findings import of_agreement, of_bounds, of_optimiser, of_widths

        first = of_optimiser(self.starts)
        if not math.isfinite(self.starts[0].objective):
            return first
        return (
            *first,
            *of_bounds(self.problem, self.theta),
            *self.undetermined,
            *of_widths(self.problem, self.theta, self.uncertainty),
            *of_agreement(self.problem, self.predictions, self.degrees_of_freedom, self.search),
        )

    def profile(self, name: str, *, level: float = 0.95) -> Profile:
        """Compute the profile likelihood of a parameter and its likelihood-ratio interval.

        Parameters
        ----------
        name : str
            An estimated parameter.
        level : float
            Level of confidence.

        Raises
        ------
        ParameterError
            If the parameter is not estimated, or the loss is not a likelihood.
        """
        return self.profiles([name], level=level)[name]

    def profiles(
        self, names: Sequence[str] | None = None, *, level: float = 0.95
    ) -> dict[str, Profile]:
        """Compute profile likelihoods of some or all parameters, in one batch.

        Parameters
        ----------
        names : sequence of str, optional
            Estimated parameters; all where absent.
        level : float
            Level of confidence.
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
        found = profiles_of(
            self.problem,
            self.theta,
            objective,
            [self.names.index(name) for name in chosen],
            self.uncertainty,
            level=level,
            more_rows=self.more_rows,
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
            Whether to compute the prediction interval of a further measurement. True uses the noise
            of the measured values of this quantity; a number or a name gives its deviation.
        draws : int
            Number of samples from the distribution of the estimates, normal or Student's t. Zero
            selects the delta method, which linearises the model at the estimates.
        seed : int
            Seed of the samples.

        Raises
        ------
        ParameterError
            For an unknown name, or if the run fails.
        """
        from cotree.estimation.bands import band_of

        return band_of(
            self.problem, self.theta, self.uncertainty, output, t,
            condition=experiment, level=level, noise=noise, draws=draws, seed=seed,
        )  # fmt: skip

    def next_measurements(
        self, candidates: Any, n: int = 5, *, criterion: str = "D", repeat: bool = True
    ) -> NextMeasurements:
        """Choose the measurements that shrink the intervals most.

        Parameters
        ----------
        candidates : mapping, or sequence of Candidates
            Outputs, states or columns, mapped to times, to (times, noise), or to a mapping of the
            fields of :class:`~cotree.estimation.candidates.Candidates`, which can also change the
            experiment. The default noise is that of the measured values of the output.
        n : int
            Number of measurements to choose.
        criterion : str
            What to minimise: "D", the determinant of the covariance; "A", the sum of relative
            variances; "E", the largest variance of any direction; or the name of a parameter, for
            its variance.
        repeat : bool
            Whether a candidate may be measured more than once.

        Returns
        -------
        NextMeasurements
            Ordered by benefit, with the standard errors after each.

        Raises
        ------
        ParameterError
            For an unknown name or criterion, a missing noise, or too few candidates.
        """
        from cotree.estimation.candidates import choose

        return choose(
            self.problem, self.theta, self.uncertainty, candidates, n,
            criterion=criterion, repeat=repeat,
        )  # fmt: skip

    @cached_property
    def _prior(self) -> Array | None:
        """Jacobian of the residuals of priors at the estimates."""
        return None if self.more_rows is None else self.more_rows(self.theta)[1]

    def _relative_fisher(self) -> Array:
        sizes = np.abs(self.uncertainty.split.sizes)
        return np.asarray(np.outer(sizes, sizes) * self.fisher)
