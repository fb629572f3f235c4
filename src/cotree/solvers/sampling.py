"""Inputs that a function of Python gives now and then, held between: a digital controller.

In: the functions, their periods, and a run. Out: the times at which they are called, the values
that C reads between them, and the inputs at any time that was reached. Integration stops at the
times, so that no method steps over a change.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from cotree.dag.switching_times import SAME
from cotree.errors import ParameterError
from cotree.scene.expressions import check_number
from cotree.scene.settings import MOST_STEPS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from cotree.model.model import CompiledModel
    from cotree.model.signals import Sampled
    from cotree.solvers.base import FloatArray


class Measured(Mapping[str, float]):
    """States and outputs by name, as a sampled function gets them."""

    def __init__(self, y: FloatArray, model: CompiledModel, outputs: Callable[[], FloatArray]):
        self._y, self._model, self._outputs = y, model, outputs

    def __getitem__(self, name: str) -> float:
        """Return a state or an output."""
        if name in self._model.states:
            return float(self._y[self._model.states.index(name)])
        if name in self._model.outputs:
            return float(self._outputs()[self._model.outputs.index(name)])
        raise ParameterError(
            f"a sampled input asks for '{name}', which is no state and no output: known are "
            f"{', '.join(self)}"
        )

    def __iter__(self) -> Iterator[str]:
        return iter((*self._model.states, *self._model.outputs))

    def __len__(self) -> int:
        return len(self._model.states) + len(self._model.outputs)


class Samples:
    """The samples of one input during a run; it is mutable and belongs to the run.

    Each is taken once, and remembered: a method that goes over the same time again, or takes over
    from another one, gets the same value.

    Parameters
    ----------
    sampled : Sampled
        The function and its period.
    name : str
        The input, for messages.
    span : (float, float)
        Start and end of the run, [s].
    before : float
        Its value until the first sample is taken.

    Attributes
    ----------
    times : list of float
        The times of the samples within the span.
    held : ndarray, shape (1,)
        The value that C reads.
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
        """Return the value that acts up to a time; at that of a sample it is the one before."""
        place = max(bisect_left(self.times, t) - 1, 0)
        return self._values[min(place, len(self._values) - 1)] if self._values else self._before

    def reach(self, t: float, measured: Measured) -> None:
        """Take the sample that is due, and hold what acts from a time on."""
        rounding = SAME * abs(t)
        if len(self._values) < len(self.times) and self.times[len(self._values)] <= t + rounding:
            value = self._sampled.at(self.times[len(self._values)], measured)
            self._values.append(check_number(value, f"a sample of input '{self._name}'"))
        place = min(bisect_right(self.times, t + rounding), len(self._values)) - 1
        self.held[0] = self._values[place]


def reaching(
    model: CompiledModel,
    p: FloatArray,
    samples: Sequence[Samples],
    u: Callable[[float], FloatArray | None],
) -> Callable[[float, FloatArray], None]:
    """Return the function that takes the samples due at a time, from the states that are there."""
    n = len(model.states)

    def reach(t: float, z: FloatArray) -> None:
        y = np.array(z[:n])
        # Measured before any of the inputs changes.
        measured = Measured(y, model, lambda: model.output_values(t, y, p, u(t)))
        for item in samples:
            item.reach(t, measured)

    return reach
