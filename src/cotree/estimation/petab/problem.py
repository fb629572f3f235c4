"""PEtab problems, version 1: reading, compilation, likelihood, gradient and fit.

``read_petab`` returns a ``PetabProblem``, an estimation problem that keeps PEtab's names, scales
and tables.

A prior whose type begins with ``parameterScale`` is a density of the parameter on its scale; any
other prior is a density of its value. There is no Jacobian factor for a change of variables, and
densities are not truncated at the bounds. Starts out of bounds are drawn again.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from cotree.arguments import check_whole
from cotree.ensemble.batch import load_batch
from cotree.errors import ParameterError, SolveError
from cotree.estimation.estimated import Array, Estimated, Scaled
from cotree.estimation.multistart import Search, StartRecord, minimise_from_starts
from cotree.estimation.petab.sbml_model import mapped
from cotree.estimation.petab.tsv_tables import ParameterRow, PriorRow, Tables, read_tables
from cotree.estimation.problem import Problem
from cotree.estimation.result import FitResult
from cotree.scene.settings import STEPS_OF_FIT, Settings, SettingsDict
from cotree.solvers.engine import build_ahead

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from cotree.api import Scene
    from cotree.compiled import Model
    from cotree.estimation.conditions import Condition, Measured
    from cotree.estimation.problem import Predictions


_MOST_DRAWS = 1000

# Below this fraction of the Laplace scale, a parabola replaces the kink of the absolute value.
_CORNER = 1e-3

# Added to logarithms to make them positive; the logarithm of a double is never below -745.
_LEAST_LOG = 750.0


class Priors:
    """Objective priors of the estimated parameters; a parameter may have none."""

    def __init__(self, estimated: Sequence[Estimated], rows: Sequence[PriorRow | None]) -> None:
        self._n = len(estimated)
        self._terms = [
            (i, Prior(row, estimated[i])) for i, row in enumerate(rows) if row is not None
        ]

    def __bool__(self) -> bool:
        return bool(self._terms)

    def log_density(self, theta: Array) -> float:
        """Return the sum of the log densities of all priors."""
        return sum(prior.log_density(float(theta[i]))[0] for i, prior in self._terms)

    def gradient(self, theta: Array) -> Array:
        """Return the gradient of the log density on the parameters' scales, (n_estimated,)."""
        found = np.zeros(self._n)
        for i, prior in self._terms:
            found[i] = prior.log_density(float(theta[i]))[1]
        return found

    def rows(self, theta: Array) -> tuple[Array, Array]:
        """Return residuals that represent the priors in least-squares methods, and their Jacobian.

        Up to a constant, half their sum of squares is minus the log density; the transposed
        Jacobian times the residuals is its exact gradient. Uniform priors have no residuals.
        """
        rows = [(i, *row) for i, prior in self._terms for row in prior.squares(float(theta[i]))]
        slopes = np.zeros((len(rows), self._n))
        for at, (i, _, slope) in enumerate(rows):
            slopes[at, i] = slope
        return np.array([value for _, value, _ in rows]), slopes


class Prior:
    """The prior of one parameter."""

    def __init__(self, row: PriorRow, estimated: Estimated) -> None:
        self._kind, self._a, self._b = row.kind, row.first, row.second
        self._scaled = Scaled([estimated])
        self._is_on_scale = row.kind.startswith("parameterScale")
        self._is_log = row.kind.startswith("log")
        self._family = row.kind.removeprefix("parameterScale").removeprefix("log").lower()
        self._name, self._bounds = estimated.name, (self._scaled.lower[0], self._scaled.upper[0])

    def _deviation(self, theta: float) -> tuple[float, float]:
        """Return the argument of the prior density and its derivative with respect to ``theta``."""
        if self._is_on_scale:
            return theta, 1.0
        given = np.array([theta])
        x, slope = float(self._scaled.values(given)[0]), float(self._scaled.slopes(given)[0])
        if not self._is_log:
            return x, slope
        return (math.log(x), slope / x) if x > 0.0 else (math.nan, 0.0)

    def log_density(self, theta: float) -> tuple[float, float]:
        """Return the log density and its derivative with respect to ``theta``."""
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
        # The factor 1/x converts a density of the logarithm to a density of the value.
        factor = float(self._is_log)
        return value - factor * z, (slope / self._b - factor) * z_slope

    def squares(self, theta: float) -> list[tuple[float, float]]:
        """Return residuals for least squares and their derivatives; see :meth:`Priors.rows`."""
        if self._family == "uniform":
            return []
        z, along = self._deviation(theta)
        if math.isnan(z):
            return [(math.nan, 0.0)]
        r, r_slope = (z - self._a) / self._b, along / self._b
        if self._family == "normal":
            # The factor 1/x of a log-normal density only shifts the minimum of the square.
            return [(r + (self._b if self._is_log else 0.0), r_slope)]
        # This residual times its derivative is the derivative of the absolute value. A second
        # residual, with zero derivative, adds the rest of the value.
        weight = max(abs(r), _CORNER) ** -0.5
        rows = [(r * weight, r_slope * weight)]
        missing = 2.0 * abs(r) - (r * weight) ** 2
        if self._is_log:
            rows.append((1.0, along))
            missing += 2.0 * (_LEAST_LOG + z)
        return [*rows, (math.sqrt(missing), 0.0)]

    def sample(self, n: int, random: np.random.Generator) -> Array:
        """Draw starting values within the bounds on the parameter's scale, shape (n,)."""
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
    """Draw starting points on the parameters' scales, (n, n_estimated); uniform without a prior."""
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


def read_petab(
    path: str | Path, *, method: str = "auto", **settings: Unpack[SettingsDict]
) -> PetabProblem:
    """Read an estimation problem in PEtab format, version 1, and compile its model.

    The model is an SBML file, read as by :func:`cotree.read_sbml`. Conditions, preequilibrations,
    overrides of observables and noise, transformations, distributions and priors are supported;
    docs/petab.md lists unsupported features.

    Parameters
    ----------
    path : str or Path
        The YAML file of the problem, which lists the other files in its folder.
    method, **settings
        Method, tolerances, budgets and other settings of all runs, as in
        :meth:`cotree.Model.simulate`.

    Returns
    -------
    PetabProblem
        The problem.

    Raises
    ------
    SceneError
        If a file is missing, cannot be read, or contains an invalid row; the message begins with
        file and line.
    ModelError, FormulationError, BuildError
        If the equations of the model cannot be formed or compiled.
    Error
        If the extra ``petab`` is not installed.

    Examples
    --------
    >>> problem = cotree.read_petab("problem.yaml")  # doctest: +SKIP
    >>> problem.log_likelihood()  # doctest: +SKIP
    -138.22199
    """
    given: dict[str, Any] = {"max_steps": STEPS_OF_FIT, **settings}
    shared, tables = Settings(method=method, **given), read_tables(path)
    # Engines compile while the model is read; rodas5 is for stiff models and steady states.
    engines = ("dop853", "rodas5") if method == "auto" else (method,)
    build_ahead(*engines, then=[load_batch])
    return PetabProblem(tables, *mapped(tables), shared)


class PetabProblem(Problem):
    """An estimation problem in PEtab format.

    The methods take parameters as a mapping of unscaled values by name, or as an array of unscaled
    values in the order of ``names``; a missing parameter keeps its nominal value. Gradients are
    with respect to the estimated parameters on their scales. :attr:`objective` and the methods
    inherited from ``Problem`` take an array of all estimated parameters on their scales.

    Attributes
    ----------
    names : tuple of str
        The estimated parameters.
    nominal : dict of str to float
        Nominal values of the estimated parameters, if they have one.
    scene : cotree.Scene
        Scene of the model, with outputs for the measured quantities.
    model : cotree.Model
        The compiled model.
    priors : Priors
        Objective priors of the estimated parameters.
    """

    def __init__(
        self,
        tables: Tables,
        scene: Scene,
        conditions: Sequence[Condition],
        measured: Measured,
        settings: Settings,
    ) -> None:
        rows = tables.estimated
        super().__init__([_estimated(row) for row in rows], conditions, measured, settings)
        self._tables, self.scene = tables, scene
        self.nominal = {row.name: row.nominal for row in rows if row.nominal is not None}
        self.priors = Priors(self.estimated, [row.objective_prior for row in rows])

    def __repr__(self) -> str:
        return (
            f"<PetabProblem '{self._tables.file}': {len(self.estimated)} estimated parameters, "
            f"{len(self.conditions)} conditions, {len(self.measured)} measured values>"
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the estimated parameters."""
        return self.scaled.names

    @property
    def model(self) -> Model:
        """The compiled model."""
        return self.conditions[0].model

    def using(self, *, method: str | None = None, **settings: Unpack[SettingsDict]) -> PetabProblem:
        """Return the same problem with another integration method or other run settings.

        Parameters
        ----------
        method, **settings
            As in :func:`cotree.read_petab`; by default unchanged.
        """
        given: dict[str, Any] = {"method": method or self.settings.method, **settings}
        own = replace(self.settings, **given)
        return PetabProblem(self._tables, self.scene, self.conditions, self.measured, own)

    def theta(self, parameters: Any = None) -> Array:
        """Convert values of the estimated parameters to their scales, shape (n_estimated,).

        Parameters
        ----------
        parameters : mapping of str to float, or array_like of shape (n_estimated,), optional
            Unscaled values; by default nominal values.

        Raises
        ------
        ParameterError
            If a name is unknown, a value is missing, or a value has no logarithm.
        """
        if parameters is None or hasattr(parameters, "keys"):
            parameters = {**self.nominal, **dict(parameters or {})}
        return super().theta(parameters)

    def log_likelihood(self, parameters: Any = None) -> float:
        """Return the log-likelihood of all measured values, without priors.

        Parameters
        ----------
        parameters : mapping of str to float, or array_like of shape (n_estimated,), optional
            Unscaled values of estimated parameters; by default nominal values.

        Raises
        ------
        ParameterError
            If a name is unknown or a value is invalid.
        SolveError
            If a run fails; the message names the condition.
        """
        return self.likelihood.log_likelihood(self._found(parameters, slopes=False))

    def chi2(self, parameters: Any = None) -> float:
        """Return the sum of squared residuals, each divided by its noise.

        Parameters and errors are as in :meth:`log_likelihood`.
        """
        return self.likelihood.chi2(self._found(parameters, slopes=False))

    def gradient(self, parameters: Any = None) -> Array:
        """Return the gradient of the log-likelihood with respect to the scaled parameters.

        Parameters and errors are as in :meth:`log_likelihood`.

        Returns
        -------
        ndarray, shape (n_estimated,)
            Derivatives in the order of ``names``; for a parameter p on the scale ``log10``, with
            respect to log10(p).
        """
        return self.likelihood.gradient(self._found(parameters, slopes=True))

    def log_prior(self, parameters: Any = None) -> float:
        """Return the sum of the log densities of the objective priors.

        A prior on a parameter's scale is a density on that scale; any other prior is a density of
        the value. Densities are not truncated at the bounds. Parameters and errors are as in
        :meth:`log_likelihood`.
        """
        return self.priors.log_density(self.theta(parameters))

    def simulate(self, parameters: Any = None) -> Any:
        """Predict the measured values and return a PEtab simulation table.

        Parameters and errors are as in :meth:`log_likelihood`.

        Returns
        -------
        pandas.DataFrame
            The measurement table with a column ``simulation`` instead of ``measurement``.
        """
        import pandas

        values = self._found(parameters, slopes=False).values
        # Other PEtab tools also read tables with pandas, so cells become equal values. The Python
        # engine of pandas keeps all digits of numbers in every version.
        files = self._tables.measurement_files
        tables = [pandas.read_csv(file, sep="\t", engine="python") for file in files]
        # Rows that contain only separators are skipped.
        table = pandas.concat(tables, ignore_index=True).dropna(how="all").reset_index(drop=True)
        table["measurement"] = values
        return table.rename(columns={"measurement": "simulation"})

    def objective(self, theta: Any) -> tuple[float, Array]:
        """Return the objective of a fit and its gradient, for any optimiser.

        Parameters
        ----------
        theta : array_like, shape (n_estimated,)
            Parameters on their scales; :meth:`theta` returns the nominal ones.

        Returns
        -------
        value : float
            The negative log-likelihood minus the log densities of the objective priors; infinite if
            a run fails.
        gradient : ndarray, shape (n_estimated,)
            Its gradient.
        """
        value, gradient = super().objective(theta)
        return value - self.priors.log_density(theta), gradient - self.priors.gradient(theta)

    def starts(self, n: int, seed: int | None = None) -> Array:
        """Draw starting points of a fit from the initialization priors.

        Parameters
        ----------
        n : int
            Number of starts, at least one.
        seed : int, optional
            Equal seeds give equal starts.

        Returns
        -------
        ndarray, shape (n, n_estimated)
            Points on the parameters' scales, within the bounds; uniform if there is no prior.

        Raises
        ------
        ParameterError
            If ``n`` or the seed is invalid, or starts cannot be drawn.
        """
        n = check_whole(n, "n", 1)
        seed = None if seed is None else check_whole(seed, "seed")
        rows = [row.initialization_prior for row in self._tables.estimated]
        return sample_starts(self.estimated, rows, n, seed)

    def fit(
        self,
        starts: int = 20,
        seed: int | None = None,
        *,
        from_nominal: bool = True,
        search: Search | None = None,
        progress: bool = True,
    ) -> FitResult:
        """Maximise the likelihood times the objective priors, from several starts.

        Parameters
        ----------
        starts : int
            Number of starts, at least one.
        seed : int, optional
            Equal seeds draw equal starts; see :meth:`starts`.
        from_nominal : bool
            Whether the nominal values are the first start, if all parameters have one.
        search : Search, optional
            Optimiser, its tolerances and budgets. If many parameters end at their bounds, try
            ``Search(optimiser="dogbox", scale="bounds")``.
        progress : bool
            Whether a progress bar may be shown, on terminals only.

        Returns
        -------
        FitResult
            The starts, sorted by objective, which is the negative log-likelihood minus the log
            densities of the priors. Priors also affect the intervals and profiles of the result.

        Raises
        ------
        ParameterError
            If the number of starts or the seed is invalid, or starts cannot be drawn.
        """
        points = self.starts(check_whole(starts, "starts", 1), seed)
        if from_nominal and len(self.nominal) == len(self.names):
            points[0] = np.clip(self.theta(), self.scaled.lower, self.scaled.upper)
        more = self.priors.rows if self.priors else None
        records = minimise_from_starts(self, points, search, more_rows=more, progress=progress)
        found = tuple(self._with_priors(record) for record in records)
        return FitResult(self, found, search, more_rows=more)

    def _with_priors(self, record: StartRecord) -> StartRecord:
        """Replace squared prior residuals by log densities, which differ by a constant."""
        if not (self.priors and math.isfinite(record.objective)):
            return record
        rows, _ = self.priors.rows(record.theta)
        shift = -self.priors.log_density(record.theta) - 0.5 * float(np.sum(rows**2))
        return replace(record, objective=record.objective + shift)

    def _found(self, parameters: Any, *, slopes: bool) -> Predictions:
        [found] = self.predict(self.theta(parameters)[None, :], slopes=slopes)
        if found.message:
            raise SolveError(found.message)
        return found


def _estimated(row: ParameterRow) -> Estimated:
    # Starts must be within the bounds, but rounding may put nominal values slightly outside.
    start = None if row.nominal is None else min(max(row.nominal, row.lower), row.upper)
    return Estimated(row.name, row.lower, row.upper, row.scale, start)
