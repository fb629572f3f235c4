"""PEtab problems, version 1: read and compile them, compute likelihoods and gradients, and fit.

In: the YAML file of a problem. Out: a ``PetabProblem``, an estimation problem that keeps the names,
scales and tables of PEtab.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.arguments import check_whole
from cotree.ensemble.batch import load_batch
from cotree.errors import SolveError
from cotree.estimation.estimated import Estimated
from cotree.estimation.multistart import Search, StartRecord, minimise_from_starts
from cotree.estimation.petab.model import mapped
from cotree.estimation.petab.priors import Priors, sample_starts
from cotree.estimation.petab.tables import Tables, read_tables
from cotree.estimation.problem import Problem
from cotree.estimation.result import FitResult
from cotree.scene.settings import STEPS_OF_FIT, Settings
from cotree.solvers.engine import build_ahead

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path
    from typing import Unpack

    from cotree.api import Scene
    from cotree.compiled import Model
    from cotree.estimation.conditions import Condition, Measured
    from cotree.estimation.estimated import Array
    from cotree.estimation.likelihood import Predictions
    from cotree.estimation.petab.tables import ParameterRow
    from cotree.scene.settings import SettingsDict


def read_petab(
    path: str | Path, *, method: str = "auto", **settings: Unpack[SettingsDict]
) -> PetabProblem:
    """Read an estimation problem in PEtab's format, version 1, and compile its model.

    The model is an SBML file, as :func:`cotree.read_sbml` reads it. Conditions, preequilibrations,
    overrides of observables and noise, transformations, distributions and priors are read;
    docs/petab.md says what is not.

    Parameters
    ----------
    path : str or Path
        The YAML file of the problem; it names the other files, which are in its folder.
    method, **settings
        Method, tolerances, budgets and others of all runs, as of :meth:`cotree.Model.simulate`.

    Returns
    -------
    PetabProblem
        The problem.

    Raises
    ------
    SceneError
        If a file is missing, cannot be read, or a row is invalid; the message begins with file
        and line.
    ModelError, FormulationError, BuildError
        If the model cannot be formed or compiled.
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
    # The compiler builds the engines while Python reads and forms the model; most models are
    # stiff, and runs to a steady state are done by rodas5.
    engines = ("dop853", "rodas5") if method == "auto" else (method,)
    build_ahead(*engines, then=[load_batch])
    return PetabProblem(tables, *mapped(tables), shared)


class PetabProblem(Problem):
    """An estimation problem of PEtab.

    The methods take parameters as a mapping of unscaled values by name, or as an array of unscaled
    values in the order of ``names``; a parameter that is missing keeps its nominal value. Gradients
    are with respect to the estimated parameters on their scales. :attr:`objective` and the methods
    inherited from ``Problem`` take an array of all estimated parameters on their scales.

    Attributes
    ----------
    names : tuple of str
        The estimated parameters.
    nominal : dict of str to float
        Nominal values of the estimated parameters that have one.
    scene : cotree.Scene
        The model with the outputs that were measured.
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
        """The estimated parameters."""
        return self.scaled.names

    @property
    def model(self) -> Model:
        """The compiled model."""
        return self.conditions[0].model

    def using(self, *, method: str | None = None, **settings: Unpack[SettingsDict]) -> PetabProblem:
        """Return the same problem with another integration method or other tolerances.

        Parameters
        ----------
        method, **settings
            As of :func:`cotree.read_petab`; by default those of this problem.
        """
        given: dict[str, Any] = {"method": method or self.settings.method, **settings}
        own = replace(self.settings, **given)
        return PetabProblem(self._tables, self.scene, self.conditions, self.measured, own)

    def theta(self, parameters: Any = None) -> Array:
        """Convert values of the estimated parameters to their scales, shape (n_estimated,).

        Parameters
        ----------
        parameters : mapping of str to float, or array_like of shape (n_estimated,), optional
            Values, not on their scales; missing ones are nominal.

        Raises
        ------
        ParameterError
            If a name is unknown, a value is missing, or one has no logarithm.
        """
        if parameters is None or hasattr(parameters, "keys"):
            parameters = {**self.nominal, **dict(parameters or {})}
        return super().theta(parameters)

    def log_likelihood(self, parameters: Any = None) -> float:
        """Compute the logarithm of the likelihood of all measured values, without priors.

        Parameters
        ----------
        parameters : mapping of str to float, or array_like of shape (n_estimated,), optional
            Values of estimated parameters, not on their scales; missing ones are nominal.

        Raises
        ------
        ParameterError
            If a name or value is not accepted.
        SolveError
            If a run fails; the message names the condition.
        """
        return self.likelihood.log_likelihood(self._found(parameters, slopes=False))

    def chi2(self, parameters: Any = None) -> float:
        """Compute the sum of the squared residuals, each divided by its noise.

        Parameters and errors are those of :meth:`log_likelihood`.
        """
        return self.likelihood.chi2(self._found(parameters, slopes=False))

    def gradient(self, parameters: Any = None) -> Array:
        """Compute the derivatives of the log-likelihood by the parameters on their scales.

        Parameters and errors are those of :meth:`log_likelihood`.

        Returns
        -------
        ndarray, shape (n_estimated,)
            In the order of ``names``: by log10 of a parameter whose scale is log10.
        """
        return self.likelihood.gradient(self._found(parameters, slopes=True))

    def log_prior(self, parameters: Any = None) -> float:
        """Compute the sum of the logarithms of the objective priors' densities.

        Priors on the parameter's scale are densities on that scale, all others are densities of its
        value; they are not truncated at bounds. Parameters and errors are those of
        :meth:`log_likelihood`.
        """
        return self.priors.log_density(self.theta(parameters))

    def simulate(self, parameters: Any = None) -> Any:
        """Compute predictions of the measured values, as a PEtab simulation table.

        Parameters and errors are those of :meth:`log_likelihood`.

        Returns
        -------
        pandas.DataFrame
            The measurement table with a column ``simulation`` instead of ``measurement``.
        """
        import pandas

        values = self._found(parameters, slopes=False).values
        # Read with pandas as other tools for PEtab do, so that the cells are equal; this engine
        # keeps all digits of numbers in every version.
        files = self._tables.measurement_files
        tables = [pandas.read_csv(file, sep="\t", engine="python") for file in files]
        # Rows that contain only separators are skipped.
        table = pandas.concat(tables, ignore_index=True).dropna(how="all").reset_index(drop=True)
        table["measurement"] = values
        return table.rename(columns={"measurement": "simulation"})

    def objective(self, theta: Any) -> tuple[float, Array]:
        """Compute the objective of a fit and its gradient, for any optimiser.

        Parameters
        ----------
        theta : array_like, shape (n_estimated,)
            Values on their scales; :meth:`theta` returns the nominal ones.

        Returns
        -------
        value : float
            The negative log-likelihood less the logarithms of the objective priors; infinite if a
            run fails.
        gradient : ndarray, shape (n_estimated,)
            Its gradient.
        """
        value, gradient = super().objective(theta)
        return value - self.priors.log_density(theta), gradient - self.priors.gradient(theta)

    def starts(self, n: int, seed: int | None = None) -> Array:
        """Draw starts of a fit from the initialization priors.

        Parameters
        ----------
        n : int
            Number of starts, at least one.
        seed : int, optional
            Equal seeds give equal starts.

        Returns
        -------
        ndarray, shape (n, n_estimated)
            On their scales, within the bounds; uniform if there is no prior.

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
            Optimiser, tolerances and budgets. Where many parameters end at their bounds, try
            ``Search(optimiser="dogbox", scale="bounds")``.
        progress : bool
            Whether a progress bar may be shown, on terminals only.

        Returns
        -------
        FitResult
            The starts, sorted by objective: the negative log-likelihood less the logarithms of the
            priors, which also enter the intervals and profiles of the result.

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
        """Replace the squares of the priors by their logarithms, which differ by a constant."""
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
    # Rounding may put nominal values slightly out of bounds; starts must be within them.
    start = None if row.nominal is None else min(max(row.nominal, row.lower), row.upper)
    return Estimated(row.name, row.lower, row.upper, row.scale, start)
