"""Models of experiments: scenes extended by outputs for measured quantities.

Observables, noise and inputs of experiments may be expressions. For each experiment, a model is
compiled with outputs for these expressions and sensitivities to the estimated parameters.
Experiments whose inputs have the same expressions share one model.
"""

from __future__ import annotations

import keyword
import re
import warnings
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.api import Scene
from cotree.compiled import Model, compile_spec
from cotree.errors import ParameterError, brief, check_known, nearest
from cotree.estimation.conditions import Measured
from cotree.estimation.estimated import Array, Estimated
from cotree.estimation.experiment import Experiment, in_si
from cotree.naming import RESERVED
from cotree.scene.expressions import check_positive, parse
from cotree.scene.variants import expressions_among, new_names, with_inputs

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cotree.scene.description import SceneDescription
    from cotree.units import Unit


_LONGEST = 50  # maximum length of an output name derived from a column name


@dataclass
class Observed:
    """Observables, noise and inputs of an experiment, by names in its model."""

    experiment: Experiment
    name: str
    model: Model = field(init=False)  # set after compilation
    #: State or output measured by each column.
    outputs: dict[str, str] = field(default_factory=dict)
    #: Output for the standard deviation of each column, if it is an expression.
    noise: dict[str, str] = field(default_factory=dict)
    #: Estimated parameter for the standard deviation of each column.
    deviations: dict[str, str] = field(default_factory=dict)
    #: Inputs that are numbers, tables or functions, by name.
    inputs: dict[str, Any] = field(default_factory=dict)
    expressions: dict[str, str] = field(default_factory=dict)  # expressions of inputs, by name
    #: Parameters in expressions that the scene does not contain.
    new: set[str] = field(default_factory=set)


class ObservedScene:
    """Adds outputs for measured quantities to a scene and compiles it."""

    def __init__(self, model: Model | Scene) -> None:
        if not isinstance(model, (Model, Scene)):
            raise ParameterError(
                f"a fit needs a compiled model or a scene, not {brief(repr(model))}"
            )
        # A compiled model is compiled again with its tree and its options.
        self._given = model if isinstance(model, Model) else None
        self._model = self._given
        self.scene: SceneDescription = model.spec.scene if isinstance(model, Model) else model
        self._new: dict[str, str] = {}  # expressions of the added outputs, by name

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""
        if self._model is None:
            assert isinstance(self.scene, Scene)
            # Compilation without sensitivities is fast and cached.
            self._model = self.scene.compile()
        return tuple(self._model.states)

    def observe(self, experiment: Experiment, own_name: str, wanted: Sequence[str]) -> Observed:
        """Determine the state or output measured by each column of an experiment."""
        found = Observed(experiment, own_name)
        known = {*wanted, *experiment.parameters}
        table, given = experiment.table, experiment.inputs
        for name, column in table.columns.items():
            is_input = name in self.scene.inputs and name not in given
            if is_input and name not in (experiment.observables or ()) and column.values.size > 1:
                found.inputs[name] = column
        found.expressions = expressions_among(given)
        found.inputs |= {k: v for k, v in given.items() if k not in found.expressions}
        what = f"inputs of {experiment.where}: the scene has no input"
        check_known(given, self.scene.inputs, what, error=ParameterError)
        found.new |= set(new_names(self.scene, found.expressions, known))
        for measured, text in self._texts(found).items():
            where = f"column '{measured}' of {experiment.where}"
            found.outputs[measured] = self._output(measured, text, where, found, known)
        for measured in found.outputs:
            given_noise = experiment.noise_of(measured)
            if not isinstance(given_noise, str) or given_noise in table.columns:
                continue
            if given_noise in {*wanted} - {*self.scene.parameters} and "." not in given_noise:
                found.deviations[measured] = given_noise
            else:
                where = f"the noise of column '{measured}' of {experiment.where}"
                name = self._output(f"noise_of_{measured}", given_noise, where, found, known)
                found.noise[measured] = name
        return found

    def _texts(self, found: Observed) -> dict[str, str]:
        experiment = found.experiment
        if experiment.observables is not None:
            return experiment.observables
        table, known = experiment.table, {*self.states, *self.scene.outputs}
        names = [name for name in table.columns if name in known and name not in found.inputs]
        deviations = {str(experiment.noise_of(name)) for name in names}
        left = [n for n in table.columns if n not in {*names, *found.inputs, *deviations}]
        if not names:
            listed = ", ".join(f"'{brief(name)}'" for name in left[:8]) or "none but times"
            close = nearest(left[0] if left else "", known)
            raise ParameterError(
                f"{experiment.where}: no column is a state or an output of the model{close}; its "
                f'columns are {listed}: assign them by observables={{"column": "expression"}}'
            )
        if left:
            listed = ", ".join(f"'{brief(name)}'" for name in left[:8])
            close = nearest(left[0], known) if len(left) == 1 else ""
            warnings.warn(
                f"{experiment.where}: no state, output or input of the model is called {listed}, "
                f"which is ignored{close}; select the measured columns by observables",
                RuntimeWarning,
                stacklevel=6,
            )
        return {name: name for name in names}

    def _output(self, column: str, text: str, where: str, found: Observed, known: set[str]) -> str:
        """Return the state or output for an expression; add an output if there is none."""
        expression = parse(text, where)
        plain = expression.text.strip()
        if plain in self.scene.outputs:
            return plain
        # Without a compiled model, :meth:`compile` later replaces the output by the state.
        if self._model is not None and plain in self._model.states:
            return plain
        scene = self.scene
        names = {*scene.parameters, *scene.inputs, *scene.outputs, *scene.modes, *RESERVED}
        new = sorted(name for name in expression.names - names if "." not in name)
        what = f"{where} uses the unknown name"
        check_known(new, {*names, *known}, what, error=ParameterError)
        found.new.update(new)
        base = re.sub(r"[^A-Za-z0-9_]", "_", column)[:_LONGEST]
        base = base if base[:1].isalpha() and not keyword.iskeyword(base) else f"y_{base}"
        name, n = base, 1
        while self._new.get(name, plain) != plain or name in {*names, *known}:
            n += 1
            name = f"{base}_{n}"
        self._new[name] = plain
        return name

    def compile(
        self, rows: Sequence[Observed], wanted: Sequence[str], values: Mapping[str, float]
    ) -> None:
        """Compile models for all experiments; those with equal expressions share one."""
        alike: dict[Any, list[Observed]] = {}
        for row in rows:
            alike.setdefault(tuple(sorted(row.expressions.items())), []).append(row)
        for group in alike.values():
            model = self._compiled(group, wanted, values)
            for row in group:
                row.model = model
                # Columns that measure a state refer to the state instead of an equal output.
                for column, name in row.outputs.items():
                    text = self._new.get(name, name)
                    row.outputs[column] = text if text in model.states else name

    def _compiled(
        self, rows: Sequence[Observed], wanted: Sequence[str], values: Mapping[str, float]
    ) -> Model:
        new = set().union(*(row.new for row in rows))
        used = [name for row in rows for name in (*row.outputs.values(), *row.noise.values())]
        outputs = {name: self._new[name] for name in used if name in self._new}
        texts = rows[0].expressions
        names = [n for n in wanted if n in self.scene.parameters or "." in n or n in new]
        given = self._given
        is_plain = not (new or outputs or texts)
        if given is not None and is_plain and set(names) <= set(given.sensitivities):
            return given
        gains = [name for name in sorted(new) if name in set(new_names(self.scene, texts, new))]
        scene = self.scene.copied()
        if texts:
            scene = with_inputs(scene, texts, {name: values[name] for name in gains}, "input")
        for name in sorted(new - set(gains)):
            scene.parameter(name, values[name])
        for name, text in outputs.items():
            scene.output(name, text)
        with warnings.catch_warnings():
            # The fit warns about parameters without effect.
            warnings.filterwarnings("ignore", message="no state or output depends on")
            if given is None:
                assert isinstance(scene, Scene)
                return scene.compile(names)
            return compile_spec(given.spec.of(scene, names))


#: Prefix of the names of estimated standard deviations, such as ``noise[v]`` for column ``v``.
NOISE = "noise"

# Noise bounds over the data range: below the accuracy of runs, above residuals of poor starts.
_LEAST_NOISE, _MOST_NOISE = 1e-9, 1e4


def measured_rows(
    runs: Sequence[Observed],
    noise: str | None,
    estimate: Callable[..., str],
    found: dict[str, Estimated],
) -> Measured:
    """Return the measured values of all experiments; add noise parameters to ``found``."""
    rows: list[tuple[int, float, str, float, str | float, str]] = []
    for number, run in enumerate(runs):
        n_before, where = len(rows), run.experiment.where
        for column, output in run.outputs.items():
            transform = run.experiment.transform_of(column)
            table = run.experiment.table
            there, values, unit = _present(run, column, output, transform)
            if not there.size:
                continue
            given = run.experiment.noise_of(column)
            if given is None and noise == "given":
                raise ParameterError(
                    f"noise is 'given', but column '{column}' of {where} has none: give "
                    "Experiment(noise=...)"
                )
            deviations: list[str | float]
            if given is None or noise == "estimated":
                known = _unit(run.model, output)
                deviations = [_estimated_noise(found, column, values, transform, known)]
            elif column in run.deviations:
                deviations = [estimate(run.deviations[column], run.name, None)]
            elif column in run.noise:
                deviations = [run.noise[column]]
            else:
                # Offsets, as of degC, do not apply to deviations; those of logarithms have no unit.
                factor = 1.0 if unit is None or transform != "lin" else float(unit.factor)
                deviations = _given_noise(run, column, given, factor, there)
            deviations *= len(there) // len(deviations)
            rows += [
                (number, t, output, value, deviation, transform)
                for t, value, deviation in zip(
                    table.t[there].tolist(), values.tolist(), deviations, strict=True
                )
            ]
        if len(rows) == n_before:
            listed = ", ".join(f"'{column}'" for column in run.outputs)
            raise ParameterError(f"{where}: {listed} holds missing values only")
    condition, t, observable, value, sigma, transformation = zip(*rows, strict=True)
    return Measured(
        np.array(condition, dtype=np.intp), np.array(t), observable, np.array(value), sigma,
        transformation,
    )  # fmt: skip


def _present(
    run: Observed, name: str, output: str, transform: str
) -> tuple[npt.NDArray[np.intp], Array, Unit | None]:
    """Return the indices of rows with a value in a column, these values in SI, and its unit."""
    row = run.experiment
    table, column = row.table, row.table.columns[name]
    unit = table.unit(column, _unit(run.model, output), row.unit_of(name))
    there = np.flatnonzero(np.isfinite(column.values))
    values = in_si(column.values, unit)[there]
    if transform != "lin":
        for i in there[values <= 0.0].tolist():
            raise ParameterError(
                f"{row.where}, {table.rows[i]}, column '{name}': {column.values[i]:g} has no "
                "logarithm"
            )
    return there, values, unit


def _given_noise(
    run: Observed, name: str, given: float | str, factor: float, there: npt.NDArray[np.intp]
) -> list[str | float]:
    """Return the standard deviations of a column, or only one if all are equal."""
    row, table = run.experiment, run.experiment.table
    if not isinstance(given, str):
        return [check_positive(given * factor, f"the noise of column '{name}' of {row.where}")]
    column = table.columns[given]
    unit = table.unit(column, "", row.unit_of(given))
    # A column of standard deviations without a unit has the unit of the measured column.
    scale = factor if unit is None else float(unit.factor)
    return [
        check_positive(column.values[i] * scale, f"{row.where}, {table.rows[i]}, noise '{given}'")
        for i in there.tolist()
    ]


def _estimated_noise(
    found: dict[str, Estimated], column: str, values: Array, transform: str, unit: str
) -> str:
    """Return the name of a column's standard deviation, one estimate for all experiments."""
    name = f"{NOISE}[{column}]"
    if transform != "lin":
        values, unit = np.log(values), ""
    size = float(np.ptp(values)) or float(np.abs(values).max()) or 1.0
    lower, upper = _LEAST_NOISE * size, _MOST_NOISE * size
    if name in found:
        lower, upper = min(lower, found[name].lower), max(upper, found[name].upper)
    found[name] = Estimated(name, lower, upper, "log", None, unit)
    return name


def _unit(model: Model, name: str) -> str:
    """Return the unit of a state or output, or an empty string."""
    layout = model.kernels.layout
    return next((row.unit for row in (*layout.states, *layout.outputs) if row.name == name), "")
