"""Sampled inputs: Python functions that are called with the states at fixed intervals."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cotree.errors import ParameterError
from cotree.scene.expressions import check_number
from cotree.scene.settings import MOST_STEPS
from cotree.tolerances import SAME

if TYPE_CHECKING:
    from cotree.model.model import CompiledModel
    from cotree.model.signals import ReplacedInputs, Sampled
    from cotree.solvers.result import FloatArray

    Inputs = Callable[[float], FloatArray | None]


class MeasuredValues(Mapping[str, float]):
    """Mapping from names to the states and outputs that a sampled function receives."""

    def __init__(self, y: FloatArray, model: CompiledModel, outputs: Callable[[], FloatArray]):
        self._y, self._model, self._outputs = y, model, outputs

    def __getitem__(self, name: str) -> float:
        """Return the value of a state or an output."""
        if name in self._model.states:
            return float(self._y[self._model.states.index(name)])
        if name in self._model.outputs:
            return float(self._outputs()[self._model.outputs.index(name)])
        raise ParameterError(
            f"a sampled input reads '{name}', which is not a state or an output: known are "
            f"{', '.join(self)}"
        )

    def __iter__(self) -> Iterator[str]:
        return iter((*self._model.states, *self._model.outputs))

    def __len__(self) -> int:
        return len(self._model.states) + len(self._model.outputs)


class InputSamples:
    """The samples of one input in a run; each is computed once, so that repeated steps agree.

    ``held``, shape (1,), contains the current sample, which C reads.
    """

    def __init__(
        self, sampled: Sampled, name: str, span: tuple[float, float], before: float
    ) -> None:
        start, end = span
        if end < start:
            raise ParameterError(f"input '{name}' is sampled: such runs go forwards only")
        count = (end - start) / sampled.period
        if count > MOST_STEPS:
            raise ParameterError(
                f"input '{name}' is sampled {count:.3g} times in the span: its period is too short "
                "for this run; check its unit"
            )
        self._sampled, self._name, self._before = sampled, name, before
        self.times = [start + k * sampled.period for k in range(math.floor(count) + 1)]
        self.held = np.array([before])
        self._values: list[float] = []

    def __call__(self, t: float) -> float:
        """Return the last sample before time t."""
        place = max(bisect_left(self.times, t) - 1, 0)
        return self._values[min(place, len(self._values) - 1)] if self._values else self._before

    def reach(self, t: float, measured: MeasuredValues) -> None:
        """Take the sample that is due at time t, if any, and update ``held``."""
        rounding = SAME * abs(t)
        if len(self._values) < len(self.times) and self.times[len(self._values)] <= t + rounding:
            value = self._sampled.at(self.times[len(self._values)], measured)
            self._values.append(check_number(value, f"a sample of input '{self._name}'"))
        place = min(bisect_right(self.times, t + rounding), len(self._values)) - 1
        self.held[0] = self._values[place]


def reaching(
    model: CompiledModel, p: FloatArray, samples: Sequence[InputSamples], u: Inputs
) -> Callable[[float, FloatArray], None]:
    """Return a function of time and states that takes the samples due at this time."""
    n = len(model.states)

    def reach(t: float, z: FloatArray) -> None:
        y = np.array(z[:n])
        measured = MeasuredValues(y, model, lambda: model.output_values(t, y, p, u(t)))
        for item in samples:
            item.reach(t, measured)

    return reach


def with_samples(
    model: CompiledModel, p: FloatArray, signals: ReplacedInputs, span: tuple[float, float]
) -> tuple[ReplacedInputs, list[InputSamples]]:
    """Replace sampled inputs by constants that change at the sample times."""
    before, samples = model.input_values(span[0], p), {}
    for place, row in signals.sampled.items():
        name = model.inputs[place]
        if row.reads_states and model.sensitivities:
            raise ParameterError(
                f"input '{name}' is sampled from states by a function of Python, whose derivatives "
                "are unknown: give an expression, or compile without sensitivities"
            )
        samples[place] = InputSamples(row, name, span, float(before[place]))
    times = [t for item in samples.values() for t in item.times]
    # A table with one point is a constant, here the last sample.
    held = {place: (np.zeros(1), item.held) for place, item in samples.items()}
    return replace(
        signals,
        by_position={**signals.by_position, **samples},
        breakpoints=(*signals.breakpoints, *times),
        tables={**signals.tables, **held},
    ), list(samples.values())
