"""Conversion of the columns of experiments into the measured rows of a problem."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cotree.errors import ParameterError
from cotree.estimation.conditions import Measured
from cotree.estimation.estimated import Estimated
from cotree.estimation.tables import in_si

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.compiled import Model
    from cotree.estimation.experiment import Experiment
    from cotree.estimation.observing import Observed
    from cotree.units import Unit

Array = npt.NDArray[np.float64]

#: Prefix of automatically named standard deviations: that of column ``v`` is ``noise[v]``.
NOISE = "noise"

# Bounds of estimated standard deviations, in multiples of the range of the data. The lower one is
# below the accuracy of the runs; the upper one accommodates starts far from the optimum.
_LEAST_NOISE, _MOST_NOISE = 1e-9, 1e4


@dataclass(frozen=True)
class _Part:
    """Measured values of one column of one experiment, with times and noise."""

    number: int
    t: Array
    output: str
    values: Array
    noise: list[str | float]
    transform: str


@dataclass(frozen=True)
class _Run:
    """An experiment with its name, the meaning of its columns, and its model."""

    experiment: Experiment
    name: str
    observed: Observed
    model: Model


class MeasuredRows:
    """Collects the measured values of all experiments.

    Parameters
    ----------
    noise : str or None
        ``given`` or ``estimated``, as of :func:`cotree.fit`.
    estimate : callable
        Returns the estimated parameter for a name in an experiment.
    found : dict of str to Estimated
        The estimated parameters; noise parameters are added to it.
    """

    def __init__(
        self, noise: str | None, estimate: Callable[..., str], found: dict[str, Estimated]
    ) -> None:
        self._noise, self._estimate, self._found = noise, estimate, found
        self._parts: list[_Part] = []

    def add(
        self, number: int, experiment: Experiment, name: str, observed: Observed, model: Model
    ) -> None:
        """Add the values of an experiment.

        Raises
        ------
        ParameterError, UnitError
            If all values are missing, units are incompatible, a value has no logarithm, or a
            standard deviation is not positive.
        """
        run = _Run(experiment, name, observed, model)
        parts = [self._part(number, run, column) for column in observed.outputs]
        present = [part for part in parts if part.values.size]
        if not present:
            listed = ", ".join(f"'{column}'" for column in observed.outputs)
            raise ParameterError(f"{experiment.where}: {listed} holds missing values only")
        self._parts += present

    def measured(self) -> Measured:
        """Return the rows of all experiments."""
        parts = self._parts
        return Measured(
            np.concatenate([np.full(len(part.t), part.number, dtype=np.intp) for part in parts]),
            np.concatenate([part.t for part in parts]),
            [part.output for part in parts for _ in part.t],
            np.concatenate([part.values for part in parts]),
            [value for part in parts for value in part.noise],
            [part.transform for part in parts for _ in part.t],
        )

    def _part(self, number: int, run: _Run, name: str) -> _Part:
        """Return the values of a column that are not missing."""
        row, output = run.experiment, run.observed.outputs[name]
        table, column = row.table, row.table.columns[name]
        known = _unit(run.model, output)
        unit = table.unit(column, known, row.unit_of(name))
        there = np.flatnonzero(np.isfinite(column.values))
        values, transform = in_si(column.values, unit)[there], row.transform_of(name)
        if transform != "lin":
            for i in there[values <= 0.0].tolist():
                raise ParameterError(
                    f"{row.where}, {table.rows[i]}, column '{name}': {column.values[i]:g} has no "
                    "logarithm"
                )
        noise: list[str | float] = []
        if there.size:
            given = row.noise_of(name)
            if given is None and self._noise == "given":
                raise ParameterError(
                    f"noise is 'given', but column '{name}' of {row.where} has none: give "
                    "Experiment(noise=...)"
                )
            if given is None or self._noise == "estimated":
                noise = [self._estimated_noise(name, values, transform, known)] * len(there)
            else:
                noise = self._given_noise(run, name, unit, there)
        return _Part(number, table.t[there], output, values, noise, transform)

    def _given_noise(
        self, run: _Run, name: str, unit: Unit | None, there: npt.NDArray[np.intp]
    ) -> list[str | float]:
        row, observed = run.experiment, run.observed
        # A standard deviation is a difference, so offsets of units do not apply; that of a
        # logarithm has no unit.
        is_plain = unit is None or row.transform_of(name) != "lin"
        factor = 1.0 if is_plain or unit is None else float(unit.factor)
        if name in observed.deviations:
            known = self._estimate(observed.deviations[name], run.name, None)
            return [known] * len(there)
        if name in observed.noise:
            return [observed.noise[name]] * len(there)
        if name not in observed.columns:
            given, where = row.noise_of(name), f"the noise of column '{name}' of {row.where}"
            return [_positive(float(given or 0.0) * factor, where)] * len(there)
        column = row.table.columns[observed.columns[name]]
        column_unit = row.table.unit(column, "", row.unit_of(column.name))
        # A column of standard deviations without a unit has the unit of the measured column.
        scale = factor if column_unit is None else float(column_unit.factor)
        rows, what = row.table.rows, f"column '{column.name}'"
        return [
            _positive(float(column.values[i]) * scale, f"{row.where}, {rows[i]}, {what}")
            for i in there.tolist()
        ]

    def _estimated_noise(self, column: str, values: Array, transform: str, unit: str) -> str:
        """Return the estimated standard deviation of a column, shared by all experiments."""
        name = f"{NOISE}[{column}]"
        if transform != "lin":
            values, unit = np.log(values), ""
        size = float(np.ptp(values)) or float(np.abs(values).max()) or 1.0
        lower, upper = _LEAST_NOISE * size, _MOST_NOISE * size
        if name in self._found:
            known = self._found[name]
            lower, upper = min(lower, known.lower), max(upper, known.upper)
        self._found[name] = Estimated(name, lower, upper, "log", None, unit)
        return name


def _unit(model: Model, name: str) -> str:
    """Return the unit of a state or output, or an empty string."""
    layout = model.layout
    return next((row.unit for row in (*layout.states, *layout.outputs) if row.name == name), "")


def _positive(value: float, where: str) -> float:
    if not (math.isfinite(value) and value > 0.0):
        raise ParameterError(f"{where}: a standard deviation of {value:g} is not positive")
    return value
