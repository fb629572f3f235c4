"""Quantities derived from a run besides its states: outputs, inputs, events, parameters.

In: a run and its trajectory. Out: entries of a ``RunRecord``. They are made when they are first
asked for, since most callers of a small run read few of them, and making all of them takes as long
as integrating. Nothing that happens to the arrays of the result meanwhile changes them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.model.arrays import derived_values
from cotree.records import deferred
from cotree.solvers.result import EventTimes
from cotree.solvers.sweep import sweep

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cotree.model.model import CompiledModel
    from cotree.solvers.base import FloatArray, Trajectory
    from cotree.solvers.prepare import Preparation, Run

_SWEPT = ("output_values", "output_sensitivities", "input_values")

# A trajectory of more bytes is not copied for later: what is made of it is made at once.
_MOST_COPIED = 2**18


def observed(
    preparation: Preparation, run: Run, trajectory: Trajectory, left_out: Sequence[int]
) -> dict[str, Any]:
    """Return entries of a record; see :func:`cotree.records.deferred`.

    Parameters
    ----------
    preparation, run : Preparation and Run
        What the trajectory was integrated with.
    trajectory : Trajectory
        The trajectory.
    left_out : sequence of int
        Outputs whose sensitivities are not unique, and therefore nan.

    Raises
    ------
    SingularSystemError
        If an output is not determined somewhere; where outputs are made later, then.
    """
    model, t, z = preparation.model, trajectory.t, trajectory.z
    assert run.problem.native is not None  # runs of models in Python are refused
    native = run.problem.native.model
    later: dict[str, Callable[[], Mapping[str, Any]]] = {
        "parameter_values": lambda: {"parameter_values": _parameter_values(model, run.p)},
        "events": lambda: {"events": _event_times(model, trajectory.events)},
    }

    def swept() -> dict[str, FloatArray]:
        values = sweep(model, run.p, run.u, t, z, native)
        values[1][left_out] = np.nan
        return dict(zip(_SWEPT, values, strict=True))

    # Functions of Python may remember their calls: they are asked in the order of the run.
    if preparation.asks_python or z.nbytes > _MOST_COPIED:
        return {**swept(), **deferred(**later)}
    t, z = t.copy(), z.copy()
    return deferred(**later, **dict.fromkeys(_SWEPT, swept))


def _parameter_values(model: CompiledModel, p: FloatArray) -> dict[str, float]:
    """Return the tunable parameters, and those that follow from them, by name."""
    named = dict(zip(model.parameters, p.tolist(), strict=True))
    return named | derived_values(model.layout.derived, p)


def _event_times(model: CompiledModel, happened: FloatArray) -> dict[str, EventTimes]:
    """Group the events that happened by their names."""
    n, m, found = len(model.states), len(model.sensitivities), {}
    for i, row in enumerate(model.layout.events):
        own = happened[happened[:, 1] == i]
        # Shapes are given, since methods without events give no columns for them.
        parts = own[:, 2:].reshape(len(own), m + 2 * n)
        slopes, before, after = np.split(parts, [m, m + n], axis=1)
        found[row.name] = EventTimes(own[:, 0].copy(), before.T, after.T, slopes.T)
    return found
