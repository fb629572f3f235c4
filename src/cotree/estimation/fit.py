"""``cotree.fit``: estimation of parameters by least squares from several starts."""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.arguments import check_choice, check_mapping, check_names, check_whole
from cotree.errors import ParameterError, SolveError, brief, check_known, nearest
from cotree.estimation.conditions import Condition
from cotree.estimation.estimated import Array, Estimated, estimated, read_ranges, spread_starts
from cotree.estimation.experiment import Experiment, in_si
from cotree.estimation.multistart import Search, minimise_from_starts
from cotree.estimation.observing import Observed, ObservedScene, measured_rows
from cotree.estimation.problem import Problem
from cotree.estimation.result import FitResult
from cotree.scene.expressions import check_number
from cotree.scene.settings import STEPS_OF_FIT, settings_from

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Unpack

    from cotree.api import Scene
    from cotree.compiled import Model
    from cotree.scene.settings import SettingsDict


def estimation_problem(
    model: Model | Scene,
    experiments: Experiment | Sequence[Experiment],
    parameters: Any,
    *,
    shared: Sequence[str] | None = None,
    per_experiment: Sequence[str] = (),
    noise: str | None = None,
    start: Mapping[str, float] | None = None,
    method: str | None = None,
    **settings: Unpack[SettingsDict],
) -> Problem:
    """Build the problem that :func:`cotree.fit` solves, for use with other optimisers and samplers.

    Parameters
    ----------
    model, experiments, parameters, shared, per_experiment, noise, start, method, **settings
        As in :func:`cotree.fit`.

    Returns
    -------
    Problem
        ``theta()`` returns the initial point. ``objective(theta)`` returns the negative
        log-likelihood and its exact gradient. ``residuals``, ``jacobian`` and ``bounds`` are also
        available. The array ``theta``, shape (n_estimated,), contains values, or logarithms for
        parameters on logarithmic scales. ``values(theta)`` returns values by name.

    Raises
    ------
    ModelError
        If a name is unknown, an argument is missing, or arguments contradict each other.

    Examples
    --------
    >>> import numpy as np, cotree
    >>> from scipy.optimize import minimize
    >>> scene = cotree.Scene("discharge")
    >>> scene.parameter("R", 2.0)
    >>> scene.edge("C", "capacitor", "a", "ground", capacitance=1.0, initial={"v": 4.0})
    >>> scene.edge("R", "resistor", "a", "ground", resistance="R")
    >>> t = np.linspace(0, 5, 11)
    >>> run = cotree.Experiment({"t": t, "C.v": 4 * np.exp(-t / 3)}, noise=0.1)
    >>> problem = cotree.estimation_problem(scene, run, {"R": (0.1, 100, "log")})
    >>> best = minimize(problem.objective, problem.theta(), jac=True, bounds=problem.bounds)
    >>> round(problem.values(best.x)["R"], 4)
    3.0
    """
    parts = _Assembly(model, experiments, parameters, shared, per_experiment, noise, start)
    return parts.problem(method=method, **settings)


_NOT_ESTIMATED = ", which is not estimated"


class _Assembly:
    """Assembly of an estimation problem from models, experiments and parameters."""

    def __init__(
        self,
        model: Model | Scene,
        experiments: Any,
        parameters: Any,
        shared: Sequence[str] | None,
        per_experiment: Sequence[str],
        noise: str | None,
        start: Mapping[str, float] | None,
    ) -> None:
        rows = _listed(experiments)
        self._ranges = read_ranges(parameters)
        self._apart = _apart(self._ranges, shared, per_experiment)
        self._begin = _starts(start, self._ranges)
        if noise is not None:
            check_choice(noise, "noise", ("given", "estimated"))
        self._noise = noise
        self._observer = ObservedScene(model)
        self._runs = [
            self._observer.observe(row, name, list(self._ranges))
            for row, name in zip(rows, _names(rows), strict=True)
        ]
        self._found: dict[str, Estimated] = {}
        self._equal: dict[Any, dict[str, Any]] = {}  # equal inputs become one object
        self._check_used()

    def problem(self, **given: Any) -> Problem:
        """Compile the models and build the problem; ``given`` contains run settings."""
        scene = self._observer.scene
        settings = settings_from(scene.defaults, {"max_steps": STEPS_OF_FIT, **given})
        new = set().union(*(run.new for run in self._runs))
        wanted = [n for n in self._ranges if n in scene.parameters or n in new]
        wanted += [n for n in self._ranges if "." in n and n not in wanted]
        # parameters and states of the model that are tied to estimated parameters
        tied = [
            name
            for run in self._runs
            for values in (run.experiment.parameters, run.experiment.initial)
            for name, value in values.items()
            if isinstance(value, str) and name not in wanted
        ]
        wanted += dict.fromkeys(tied)
        self._observer.compile(self._runs, wanted, {n: self._new_value(n) for n in new})
        conditions = [self._condition(run) for run in self._runs]
        measured = measured_rows(self._runs, self._noise, self._estimate, self._found)
        # Parameters are in the user's order, with noise parameters last.
        places = {name: i for i, name in enumerate(self._ranges)}
        found = sorted(
            self._found.values(),
            key=lambda row: places.get(
                row.name, places.get(row.name.partition("[")[0], len(places))
            ),
        )
        return Problem(found, conditions, measured, settings)

    def _check_used(self) -> None:
        """Raise an error for unused estimated parameters and unknown names in experiments."""
        scene, rows = self._observer.scene, [run.experiment for run in self._runs]
        used = set().union(*(run.new for run in self._runs))
        used |= {v for run in self._runs for v in run.deviations.values()}
        for row in rows:
            given = (*row.parameters.values(), *row.initial.values())
            texts = {value for value in given if isinstance(value, str)}
            check_known(
                sorted(texts), self._ranges, f"{row.where} names", _NOT_ESTIMATED, ParameterError
            )
            used |= texts
        for name in self._ranges:
            if name not in used and all(
                name in row.parameters or name in row.initial for row in rows
            ):
                raise ParameterError(
                    f"'{name}' is to be estimated, but every experiment gives its value: remove "
                    "one of the two"
                )
            if name in used or name in scene.parameters or "." in name:
                continue
            if name in scene.inputs:
                raise ParameterError(
                    f"'{name}' is an input: to estimate it, set it to an expression of a new "
                    f'parameter, inputs={{"{name}": "{name}_0"}}, and estimate that parameter'
                )
            raise ParameterError(
                f"'{brief(name)}' is to be estimated, but the scene '{scene.name}' has no such "
                f"parameter{nearest(name, scene.parameters)}"
            )

    def _nominal_value(self, name: str) -> float | None:
        """Return a parameter's value in the scene; None if it is derived or not in the scene."""
        row = self._observer.scene.parameters.get(name)
        return None if row is None or row.is_derived else row.number

    def _new_value(self, name: str) -> float:
        """Return a default value for a new parameter, which every run overrides."""
        for run in self._runs:
            value = run.experiment.parameters.get(name)
            if value is not None and not isinstance(value, str):
                return value
        return self._begin.get(name, 1.0)

    def _estimate(self, name: str, experiment: str, nominal: float | None, unit: str = "") -> str:
        """Return the name of the estimated parameter for an experiment; create it if new."""
        full = f"{name}[{experiment}]" if name in self._apart else name
        if full not in self._found:
            begin = self._begin.get(full, self._begin.get(name))
            self._found[full] = estimated(full, self._ranges[name], begin, nominal, unit)
        return full

    def _condition(self, run: Observed) -> Condition:
        row, model = run.experiment, run.model
        first = dict(zip(model.states, model.initial_state.tolist(), strict=True))
        units = {
            row.name: row.unit
            for row in (*model.kernels.layout.parameters, *model.kernels.layout.states)
        }
        parameters: dict[str, float | str] = {}
        initial: dict[str, float | str] = {}
        for name in self._ranges:
            if name in model.parameters and name not in row.parameters:
                nominal = None if name in run.new else self._nominal_value(name)
                parameters[name] = self._estimate(name, run.name, nominal, units[name])
            elif name in model.states and name not in row.initial:
                initial[name] = self._estimate(name, run.name, first[name], units[name])
        for target, given in ((parameters, row.parameters), (initial, row.initial)):
            for key, value in given.items():
                target[key] = value
                if isinstance(value, str):
                    nominal = first.get(key) if target is initial else None
                    nominal = self._nominal_value(key) if nominal is None else nominal
                    target[key] = self._estimate(value, run.name, nominal, units.get(key, ""))
        inputs = {key: self._input(row, key, value) for key, value in run.inputs.items()}
        if all(isinstance(value, (int, float)) for value in inputs.values()):
            # Experiments that share one mapping of inputs run in one block.
            inputs = self._equal.setdefault(tuple(sorted(inputs.items())), inputs)
        return Condition(run.name, model, parameters, initial, inputs, row.t_start, run.outputs)

    def _input(self, row: Experiment, name: str, value: Any) -> Any:
        """Return an input; convert a data column to a table without missing values."""
        column = row.table.columns.get(name)
        if column is None or value is not column:
            return value
        wanted = self._observer.scene.inputs[name].unit
        values = in_si(column.values, row.table.unit(column, wanted, row.unit_of(name)))
        present = np.isfinite(values)
        if present.sum() < 2:
            raise ParameterError(
                f"column '{name}' of {row.where} is an input, which needs at least two values"
            )
        return row.table.t[present], values[present]


def _listed(experiments: Any) -> list[Experiment]:
    """Return the experiments as a list; the argument may be a single experiment."""
    found = [experiments] if isinstance(experiments, Experiment) else experiments
    if isinstance(found, (str, bytes)) or not hasattr(found, "__iter__"):
        found = [found]
    rows = list(found)
    for row in rows:
        if not isinstance(row, Experiment):
            raise ParameterError(
                f"experiments holds {brief(repr(row))}: give cotree.Experiment(data, ...)"
            )
    if not rows:
        raise ParameterError("there are no experiments: give at least one")
    return rows


def _names(rows: Sequence[Experiment]) -> list[str]:
    """Return a unique name for each experiment: its own, or its number, counted from one."""
    given = [row.name for row in rows]
    return [
        name if name is not None and given.count(name) == 1 else str(i + 1)
        for i, name in enumerate(given)
    ]


def _apart(
    ranges: Mapping[str, Any], shared: Sequence[str] | None, per_experiment: Sequence[str]
) -> set[str]:
    """Return the parameters that are estimated separately for each experiment."""
    apart = check_names(per_experiment, "per_experiment")
    alike = None if shared is None else check_names(shared, "shared")
    check_known(apart, ranges, "per_experiment names", _NOT_ESTIMATED, ParameterError)
    check_known(alike or (), ranges, "shared names", _NOT_ESTIMATED, ParameterError)
    for name in alike or ():
        if name in apart:
            raise ParameterError(
                f"'{name}' is in shared and in per_experiment: remove it from one of them"
            )
    # If shared parameters are listed, all other parameters are separate.
    return set(apart) if alike is None else set(ranges) - set(alike)


def _starts(start: Any, ranges: Mapping[str, Any]) -> dict[str, float]:
    given = check_mapping(start, "start")
    names = (name.partition("[")[0] for name in given)
    check_known(names, ranges, "start names", _NOT_ESTIMATED, ParameterError)
    return {name: check_number(value, f"start of '{name}'") for name, value in given.items()}


def fit(
    model: Model | Scene,
    experiments: Experiment | Sequence[Experiment],
    parameters: Any,
    *,
    shared: Sequence[str] | None = None,
    per_experiment: Sequence[str] = (),
    noise: str | None = None,
    start: Mapping[str, float] | None = None,
    loss: str = "linear",
    f_scale: float = 1.0,
    starts: int = 20,
    seed: int = 0,
    method: str | None = None,
    optimiser: str = "trf",
    max_evaluations: int | None = None,
    progress: bool = True,
    **settings: Unpack[SettingsDict],
) -> FitResult:
    """Estimate parameters and initial values from measurements by maximum likelihood.

    ``scipy.optimize.least_squares`` minimises the residuals with their exact Jacobian. It searches
    from several starts concurrently, and the ensemble engine computes their runs together. The
    outcome of a start does not depend on the others.

    Parameters
    ----------
    model : Model or Scene
        The model. It is compiled again if it lacks sensitivities to estimated parameters or outputs
        for measured quantities.
    experiments : Experiment or sequence of Experiment
        The measurements.
    parameters : mapping of str to tuple, or sequence of str
        Parameters to estimate: parameters of the scene, initial values (by the names of states),
        new parameters in expressions of experiments, and names that experiments use as values. Each
        range is ``(lower, upper)`` or ``(lower, upper, scale)`` in SI units, with the scale
        ``"lin"``, ``"log"`` or ``"log10"``; None means no bound. The default range of a positive
        parameter extends from a hundredth to a hundred times its start, on a logarithmic scale.
    shared, per_experiment : sequence of str, optional
        Parameters with one estimate for all experiments, and parameters with a separate estimate
        for each experiment, called ``k[1]`` or ``k[name]``. By default all are shared. If
        ``shared`` is set, all other parameters are separate.
    noise : str, optional
        ``"given"`` requires that experiments specify their noise. ``"estimated"`` ignores the
        specified noise and estimates a standard deviation ``noise[column]`` for each column. By
        default only unspecified noise is estimated.
    start : mapping of str to float, optional
        The first start; by default the scene's values if they are within the bounds, else the
        middle of the bounds.
    loss : str
        ``"linear"``, or one of the robust losses ``"soft_l1"``, ``"huber"``, ``"cauchy"`` and
        ``"arctan"``, which reduce the influence of outliers and require a specified noise; see
        ``scipy.optimize.least_squares``.
    f_scale : float
        The residual, in standard deviations, beyond which a value counts as an outlier.
    starts : int
        Number of starts; all but the first are spread between the bounds.
    seed : int
        Seed of these starts; equal seeds give equal results.
    method : str, optional
        Integration method; see :meth:`cotree.Model.simulate`.
    optimiser : str
        ``"trf"``, ``"dogbox"``, or ``"lm"``, which does not support bounds.
    max_evaluations : int, optional
        Maximum number of evaluations per start; by default a hundred per parameter.
    progress : bool
        Whether to show a progress bar, after one second and on terminals only.
    **settings
        Tolerances, budgets and other settings of the runs; see :meth:`cotree.Model.simulate`. By
        default a run may take 100,000 steps.

    Returns
    -------
    FitResult
        Estimates with standard errors, intervals, findings, profiles and plots. After Ctrl-C it
        contains the best points found so far.

    Raises
    ------
    ModelError
        If a name is unknown, an argument is missing, or arguments contradict each other.
    SolveError
        If the runs of all starts fail.

    Examples
    --------
    >>> import numpy as np, cotree
    >>> scene = cotree.Scene("discharge")
    >>> scene.parameter("R", 2.0)
    >>> scene.edge("C", "capacitor", "a", "ground", capacitance=1.0, initial={"v": 4.0})
    >>> scene.edge("R", "resistor", "a", "ground", resistance="R")
    >>> t = np.linspace(0, 5, 11)
    >>> run = cotree.Experiment({"t": t, "C.v": 5 * np.exp(-t / 3)}, noise=0.1)
    >>> result = cotree.fit(scene, run, {"R": (0.1, 100, "log"), "C.v": (0, 10)})
    >>> {name: round(value, 4) for name, value in result.parameters.items()}
    {'R': 3.0, 'C.v': 5.0}
    """
    search = Search(optimiser, loss, f_scale, max_evaluations=max_evaluations)
    starts, seed = check_whole(starts, "starts", 1), check_whole(seed, "seed")
    parts = _Assembly(model, experiments, parameters, shared, per_experiment, noise, start)
    problem = parts.problem(method=method, **settings)
    _check_search(problem, search)
    return solve(problem, search, starts, seed, progress=progress)


def solve(
    problem: Problem, search: Search, n_starts: int, seed: int, *, progress: bool = True
) -> FitResult:
    """Minimise from several starts; raise an error if none succeeds."""
    points = sized(problem, spread_starts(problem.estimated, n_starts, seed))
    records = minimise_from_starts(problem, points, search, progress=progress)
    if not math.isfinite(records[0].objective):
        subject = f"all {n_starts} starts failed" if n_starts > 1 else "the only start failed"
        raise SolveError(f"{subject}: {records[0].message}")
    _check_determined(problem, records[0].theta)
    if any(row.message.startswith("interrupted") for row in records):
        warnings.warn(
            "the fit was interrupted: the result holds the best points found so far",
            RuntimeWarning,
            stacklevel=3,
        )
    return FitResult(problem, records, search)


def sized(problem: Problem, points: Array) -> Array:
    """Set noise parameters without a guess to the root mean square of the residuals."""
    noise = np.array([v if isinstance(v, str) else "" for v in problem.measured.noise])
    unset = [
        (j, noise == row.name)
        for j, row in enumerate(problem.estimated)
        if row.start is None and (noise == row.name).any()
    ]
    if not unset:
        return points
    points = points.copy()
    target = problem.likelihood.transformed(problem.likelihood.value)
    for point, found in zip(points, problem.predict(points), strict=True):
        difference = problem.likelihood.transformed(found.values) - target
        for j, rows in unset:
            size = float(np.sqrt(np.mean(difference[rows] ** 2)))
            if math.isfinite(size) and size > 0.0:
                values = problem.scaled.values(point)
                values[j] = size
                point[j] = problem.scaled.scaled(values)[j]
    return np.clip(points, problem.scaled.lower, problem.scaled.upper)


def _check_search(problem: Problem, search: Search) -> None:
    """Raise an error if the loss or the optimiser does not support the problem."""
    unknown = [name for name in problem.measured.noise if isinstance(name, str)]
    if search.loss != "linear" and unknown:
        raise ParameterError(
            f"loss='{search.loss}' needs known noise, but '{unknown[0]}' is estimated: give the "
            "standard deviation of every measured column"
        )
    if search.optimiser != "lm":
        return
    bounded = [
        row.name for row in problem.estimated if row.lower > -math.inf or row.upper < math.inf
    ]
    if bounded:
        raise ParameterError(
            f"optimiser='lm' does not support bounds, but '{bounded[0]}' has some: use 'trf', "
            "or give (None, None)"
        )
    if search.loss != "linear":
        raise ParameterError(f"optimiser='lm' does not support loss '{search.loss}': use 'trf'")
    # Each value with estimated noise adds a second row.
    if len(problem.measured) + len(unknown) < len(problem.estimated):
        raise ParameterError(
            "optimiser='lm' needs at least as many measured values as parameters, of which there "
            f"are {len(problem.estimated)}: use 'trf'"
        )


def _check_determined(problem: Problem, theta: Array) -> None:
    """Raise an error if no parameter influences any measured value."""
    (found,) = problem.predict([theta])
    if not np.any(found.slopes):
        names = ", ".join(f"'{name}'" for name in problem.scaled.names)
        raise ParameterError(
            f"no measured value depends on {names}: measure other quantities, or estimate "
            "other parameters"
        )
