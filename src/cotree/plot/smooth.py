"""Repetition of runs at more times, for smooth curves."""

from __future__ import annotations

from dataclasses import replace
from numbers import Number
from typing import TYPE_CHECKING

import numpy as np

from cotree.errors import Error
from cotree.model.signals import read_signals
from cotree.quiet import without_warnings
from cotree.solvers.simulate import simulate

if TYPE_CHECKING:
    from cotree.model.model import CompiledModel
    from cotree.scene.settings import Settings
    from cotree.solvers.result import FloatArray, RunRecord

# Least number of points of a smooth curve, number of parts of each interval between points, and
# largest number of steps of a repeated run.
_SMOOTH, _PARTS, _MOST_STEPS = 400, 4, 4000

# Distances of points from a jump, as fractions of the span, less than a tenth of a pixel. The
# located time has an error, so the nearer point may be on the wrong side.
_ASIDE = np.array([[1e-5], [1e-4]])

# Maximum difference of a repeated run, relative to the range of a state; about a line width.
_LINE_WIDTH = 2e-3


def at_more_times(record: RunRecord, model: CompiledModel, settings: Settings) -> RunRecord:
    """Return a repetition of a run at more times, or the same record if that is impossible.

    Runs that failed, have many points or steps, or have Python inputs are not repeated.
    """
    t = record.t
    is_short = 2 <= len(t) < _SMOOTH and record.statistics.n_steps <= _MOST_STEPS
    is_known = all(map(_is_known, settings.inputs.values()))
    if record.status != 0 or not (is_short and is_known):
        return record
    jumps = _jumps(record, model, settings)
    wanted = _times(t, jumps)
    try:
        with without_warnings():
            found = simulate(model, replace(settings, t_eval=wanted, throw=False))
    except Error:
        return record
    return found if _agrees(record, found, jumps) else record


def _is_known(value: object) -> bool:
    """Return whether an input is a number, an expression or a table, not a function."""
    parts = value if isinstance(value, (tuple, list)) else [value]
    return not any(map(callable, parts)) and isinstance(
        value, (str, Number, tuple, list, np.ndarray)
    )


def _jumps(record: RunRecord, model: CompiledModel, settings: Settings) -> FloatArray:
    span = (float(record.t[0]), float(record.t[-1]))
    signals = read_signals(settings.inputs, model.inputs)
    p = model.arguments_of(record.parameter_values)
    restarts = model.restart_times(p, span, settings.inputs, signals.breakpoints).times
    return np.concatenate([restarts, *(e.t for e in record.events.values())])


def _times(t: FloatArray, jumps: FloatArray) -> FloatArray:
    """Return times that divide each interval evenly, and times on both sides of each jump."""
    shares = np.arange(1, _PARTS) / _PARTS
    inside = (t[:-1, None] + shares * np.diff(t)[:, None]).ravel()
    # At late times, a fixed distance would be smaller than the rounding error.
    aside = np.maximum(_ASIDE * abs(t[-1] - t[0]), 8 * np.spacing(np.abs(jumps)))
    sides = np.concatenate([(jumps - aside).ravel(), (jumps + aside).ravel()])
    even = np.linspace(t[0], t[-1], _SMOOTH)
    times = np.concatenate([t, inside, even, sides])
    low, high = min(t[0], t[-1]), max(t[0], t[-1])
    found = np.unique(times[(times >= low) & (times <= high)])
    return found if t[-1] >= t[0] else found[::-1]


def _agrees(record: RunRecord, found: RunRecord, jumps: FloatArray) -> bool:
    """Return whether a repeated run passes through the points of the run within a line width."""
    if found.status != 0:
        return False
    # At a jump, the run may contain the value before it or after it.
    is_smooth = ~np.isin(record.t, jumps)
    here = np.flatnonzero(np.isin(found.t, record.t[is_smooth]))
    y = record.y[:, is_smooth]
    if len(here) != y.shape[1]:
        return False
    size = np.ptp(record.y, axis=1, keepdims=True)
    # A constant state has the range zero, so its magnitude is the lower bound.
    size = np.maximum(size, 1e-6 * np.max(np.abs(record.y), axis=1, keepdims=True, initial=0.0))
    return bool(np.all(np.abs(found.y[:, here] - y) <= _LINE_WIDTH * size + 1e-300))
