"""Assembly of an estimation problem from a model, experiments and parameter ranges."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.errors import ParameterError, brief, nearest
from cotree.estimation.columns import Accuracy
from cotree.estimation.conditions import Condition
from cotree.estimation.experiment import Experiment
from cotree.estimation.measured_rows import MeasuredRows
from cotree.estimation.observing import Observer, signal
from cotree.estimation.problem import Problem
from cotree.estimation.ranges import estimated, read_ranges
from cotree.estimation.tables import in_si
from cotree.scene.expressions import check_number
from cotree.scene.given import check_mapping, check_names

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.api import Scene
    from cotree.compiled import Model
    from cotree.estimation.estimated import Estimated

Array = npt.NDArray[np.float64]


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
    rtol: float = 1e-8,
    atol: float = 1e-10,
) -> Problem:
    """Set up the problem that :func:`cotree.fit` solves, for other optimisers and samplers.

    Parameters
    ----------
    model, experiments, parameters, shared, per_experiment, noise, start, method, rtol, atol
        As of :func:`cotree.fit`.

    Returns
    -------
    Problem
        ``objective(theta)`` gives the negative log-likelihood and its exact gradient, ``theta()``
        the initial point. It also has ``residuals``, ``jacobian`` and ``bounds``. ``theta``, shape
        (n_estimated,), holds values, or logarithms for parameters on logarithmic scales;
        ``values(theta)`` returns values by name.

    Raises
    ------
    ModelError
        If a name is unknown, something is missing, or arguments contradict each other.

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
    return _Assembly(model, experiments, parameters, shared, per_experiment, noise, start).problem(
        Accuracy(_default(model, method), rtol, atol)
    )


class _Assembly:
    """Assembles a problem step by step."""

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
        self._experiments = _listed(experiments)
        self._names = _names(self._experiments)
        self._ranges = read_ranges(parameters)
        self._apart = _apart(self._ranges, shared, per_experiment)
        self._begin = _starts(start, self._ranges)
        if noise not in (None, "given", "estimated"):
            raise ParameterError(f"noise is {brief(repr(noise))}: give 'given' or 'estimated'")
        self._noise = noise
        self._observer = Observer(model)
        wanted = list(self._ranges)
        self._observed = [self._observer.observe(row, wanted) for row in self._experiments]
        self._check_used()

    def problem(self, accuracy: Accuracy) -> Problem:
        """Compile the models and assemble the problem."""
        self._begin_of: dict[str, float | None] = {n: self._nominal_value(n) for n in self._ranges}
        new = set().union(*(row.new for row in self._observed))
        values = {n: self._new_value(n) for n in new}
        wanted = [n for n in self._ranges if n in self._observer.scene.parameters or n in new]
        wanted += [n for n in self._ranges if "." in n and n not in wanted]
        wanted += self._aliased(wanted)
        self._models = self._observer.compile(self._observed, wanted, values)
        self._found: dict[str, Estimated] = {}
        conditions = [self._condition(i) for i in range(len(self._experiments))]
        rows = MeasuredRows(self._noise, self._estimate, self._found)
        for i, row in enumerate(self._experiments):
            rows.add(i, row, self._names[i], self._observed[i], self._models[i])
        measured = rows.measured()
        # In the order in which the user gave them, with noise parameters last.
        places = {name: i for i, name in enumerate(self._ranges)}
        found = sorted(
            self._found.values(),
            key=lambda row: places.get(
                row.name, places.get(row.name.partition("[")[0], len(places))
            ),
        )
        return Problem(found, conditions, measured, accuracy)

    def _aliased(self, wanted: Sequence[str]) -> list[str]:
        """List parameters and states that experiments tie to estimated parameters."""
        given = [v for e in self._experiments for v in (*e.parameters.items(), *e.initial.items())]
        found = dict.fromkeys(k for k, v in given if isinstance(v, str) and k not in wanted)
        return list(found)

    def _check_used(self) -> None:
        """Refuse estimated parameters that nothing uses, and unknown names in experiments."""
        scene = self._observer.scene
        used = set().union(*(row.new for row in self._observed))
        used |= {v for row in self._observed for v in row.deviations.values()}
        for row in self._experiments:
            given = (*row.parameters.values(), *row.initial.values())
            texts = {value for value in given if isinstance(value, str)}
            for text in sorted(texts - self._ranges.keys()):
                raise ParameterError(
                    f"{row.where} names '{brief(text)}', which is not estimated"
                    f"{nearest(text, self._ranges)}"
                )
            used |= texts
        for name in self._ranges:
            if name not in used and all(
                name in row.parameters or name in row.initial for row in self._experiments
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
        """Return the scene's value of a parameter, or None if it is derived or not in the scene."""
        row = self._observer.scene.parameters.get(name)
        if row is not None:
            return None if row.is_derived else row.number
        return None

    def _new_value(self, name: str) -> float:
        """Return a default for a new parameter; every run overrides it."""
        for row in self._experiments:
            value = row.parameters.get(name)
            if value is not None and not isinstance(value, str):
                return value
        return self._begin.get(name, 1.0)

    def _estimate(self, name: str, experiment: str, nominal: float | None, unit: str = "") -> str:
        """Return the name of the estimated parameter for an experiment; create it if it is new."""
        full = f"{name}[{experiment}]" if name in self._apart else name
        if full not in self._found:
            begin = self._begin.get(full, self._begin.get(name))
            self._found[full] = estimated(full, self._ranges[name], begin, nominal, unit)
        return full

    def _condition(self, number: int) -> Condition:
        """Make the condition of an experiment."""
        row, name = self._experiments[number], self._names[number]
        model, observed = self._models[number], self._observed[number]
        first = dict(zip(model.states, model.initial_state.tolist(), strict=True))
        units = {row.name: row.unit for row in (*model.layout.parameters, *model.layout.states)}
        parameters: dict[str, float | str] = {}
        initial: dict[str, float | str] = {}
        for wanted in self._ranges:
            if wanted in model.parameters and wanted not in row.parameters:
                nominal = None if wanted in observed.new else self._nominal_value(wanted)
                parameters[wanted] = self._estimate(wanted, name, nominal, units[wanted])
            elif wanted in model.states and wanted not in row.initial:
                initial[wanted] = self._estimate(wanted, name, first[wanted], units[wanted])
        for target, given, nominal_values in (
            (parameters, row.parameters, {}),
            (initial, row.initial, first),
        ):
            for key, value in given.items():
                nominal = nominal_values.get(key, self._nominal_value(key))
                target[key] = value
                if isinstance(value, str):
                    target[key] = self._estimate(value, name, nominal, units.get(key, ""))
        inputs = {key: self._input(row, key, value) for key, value in observed.inputs.items()}
        return Condition(
            name, model, parameters, initial, self._shared(inputs), row.t_start, observed.outputs
        )

    def _input(self, row: Experiment, name: str, value: Any) -> Any:
        column = row.table.columns.get(name)
        if column is None or value is not column:
            return value
        wanted = self._observer.scene.inputs[name].unit
        unit = row.table.unit(column, wanted, row.unit_of(name))
        return signal(name, row.where, row.table.t, in_si(column.values, unit))

    def _shared(self, inputs: dict[str, Any]) -> dict[str, Any]:
        """Return the same mapping for equal inputs, so that the experiments run in one block."""
        if not all(isinstance(value, (int, float)) for value in inputs.values()):
            return inputs
        kept: dict[Any, dict[str, Any]] = self.__dict__.setdefault("_kept", {})
        return kept.setdefault(tuple(sorted(inputs.items())), inputs)


def _default(model: Any, method: str | None) -> str:
    """Return the integration method, by default that of the scene."""
    if method is not None:
        return method
    defaults = model._recipe.defaults if hasattr(model, "_recipe") else None
    found = getattr(defaults or getattr(model, "defaults", None), "method", None)
    return found or "auto"


def _listed(experiments: Any) -> list[Experiment]:
    """Accept a single experiment or a sequence."""
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
    """Name experiments: by their own name if it is unique, else by their number from one."""
    given = [row.name for row in rows]
    return [
        name if name is not None and given.count(name) == 1 else str(i + 1)
        for i, name in enumerate(given)
    ]


def _apart(
    ranges: Mapping[str, Any], shared: Sequence[str] | None, per_experiment: Sequence[str]
) -> set[str]:
    """Find the parameters that are estimated separately for each experiment."""
    apart = check_names(per_experiment, "per_experiment")
    alike = None if shared is None else check_names(shared, "shared")
    for word, names in (("per_experiment", apart), ("shared", alike or ())):
        for name in names:
            if name not in ranges:
                raise ParameterError(
                    f"{word} names '{brief(name)}', which is not estimated{nearest(name, ranges)}"
                )
    for name in alike or ():
        if name in apart:
            raise ParameterError(
                f"'{name}' is in shared and in per_experiment: remove it from one of them"
            )
    # If the user lists the shared parameters, all others are separate.
    return set(apart) if alike is None else set(ranges) - set(alike)


def _starts(start: Any, ranges: Mapping[str, Any]) -> dict[str, float]:
    """Read the initial guesses."""
    found = {}
    for name, value in check_mapping(start, "start").items():
        if name.partition("[")[0] not in ranges:
            raise ParameterError(
                f"start names '{brief(name)}', which is not estimated{nearest(name, ranges)}"
            )
        found[name] = check_number(value, f"start of '{name}'")
    return found
