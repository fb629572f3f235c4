"""Simulation of a compiled model with the settings of a run."""

from __future__ import annotations

import time
import warnings
from dataclasses import replace
from numbers import Number
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import Error, SolveError
from cotree.model.arrays import derived_values
from cotree.model.signals import read_signals
from cotree.quiet import level_of_user, without_warnings
from cotree.records import deferred, filled
from cotree.solvers.engine import sweep
from cotree.solvers.prepare import Preparation, prepared
from cotree.solvers.problem import HeldConstraints, Problem, check_values
from cotree.solvers.result import EventTimes, FloatArray, RunRecord, Trajectory
from cotree.solvers.select import run as integrate
from cotree.solvers.trust import (
    check_constraint_drift,
    check_time_resolution,
    is_balanced,
    warn_of_redundancy,
    warn_of_result,
    warn_of_tolerances,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cotree.model.model import CompiledModel
    from cotree.scene.settings import Settings


_SWEPT = ("output_values", "output_sensitivities", "input_values")

# Trajectories with more bytes than this are evaluated at once, others on first use.
_MOST_COPIED = 2**18


def observed(
    preparation: Preparation, problem: Problem, trajectory: Trajectory, left_out: Sequence[int]
) -> dict[str, Any]:
    """Return the outputs, inputs and events of a record; see :func:`cotree.records.deferred`.

    ``left_out`` are outputs whose sensitivities are not unique, and therefore nan.
    SingularSystemError is raised, at first use, if an output is not determined somewhere.
    """
    model, t, z = preparation.model, trajectory.t, trajectory.z
    native, u = problem.native, problem.u
    assert native is not None  # the settings require a C compiler
    later: dict[str, Callable[[], Mapping[str, Any]]] = {
        "parameter_values": lambda: {"parameter_values": _parameter_values(model, native.p)},
        "events": lambda: {"events": _event_times(model, trajectory.events)},
    }

    def swept() -> dict[str, FloatArray]:
        values = sweep(model, native, u, t, z)
        values[1][left_out] = np.nan
        return dict(zip(_SWEPT, values, strict=True))

    # Python functions may have an internal state, so they are called in the order of the run.
    if preparation.asks_python or z.nbytes > _MOST_COPIED:
        return {**swept(), **deferred(**later)}
    t, z = t.copy(), z.copy()
    return deferred(**later, **dict.fromkeys(_SWEPT, swept))


def _parameter_values(model: CompiledModel, p: FloatArray) -> dict[str, float]:
    """Return the tunable parameters, and those that follow from them, by name."""
    named = dict(zip(model.parameters, p.tolist(), strict=True))
    return named | derived_values(model.layout.derived, p)


def _event_times(model: CompiledModel, records: FloatArray) -> dict[str, EventTimes]:
    """Group the records of events by name."""
    n, m, found = len(model.states), len(model.sensitivities), {}
    for i, row in enumerate(model.layout.events):
        own = records[records[:, 1] == i]
        # The shape is explicit, since arrays of methods without events have no columns for them.
        parts = own[:, 2:].reshape(len(own), m + 2 * n)
        slopes, before, after = np.split(parts, [m, m + n], axis=1)
        found[row.name] = EventTimes(own[:, 0].copy(), before.T, after.T, slopes.T)
    return found


def simulate(model: CompiledModel, settings: Settings) -> RunRecord:
    """Integrate a model.

    Raises
    ------
    ModelError
        If a parameter, initial value or input is not accepted.
    SolveError
        If the method is unknown or cannot take what it is given, or, with ``throw``, if the
        integration fails.
    """
    return filled(
        RunRecord, run_values(prepared(model, settings), settings.parameters, settings.initial)
    )


def run_values(
    preparation: Preparation, parameters: Any, initial: Mapping[str, float]
) -> dict[str, Any]:
    """Integrate a model with prepared settings; return the values of a ``RunRecord`` by field.

    Outputs, inputs, events and values of parameters are made on first use.
    """
    begin = time.perf_counter()
    model, settings = preparation.model, preparation.settings
    problem = preparation.run(parameters, initial)
    check_values(problem)
    warn_of_tolerances(problem)
    # A run may still fail because of the rounding of t or drift of the constraints.
    trajectory = check_time_resolution(problem, integrate(problem, settings.method))
    # The rank of constraints may change along a motion, so a few points are examined.
    redundant = redundancy(model, problem.held, trajectory)
    if trajectory.drift is not None:
        trajectory = check_constraint_drift(problem, trajectory, redundant)
    if trajectory.status != 0:
        from cotree.solvers.messages import is_of_rounding, with_growth

        trajectory = with_growth(problem, trajectory)
        if model.slow_causes and is_of_rounding(trajectory):
            trajectory = replace(trajectory, message=f"{trajectory.message} {model.slow_causes}")
        if settings.throw:
            raise SolveError(trajectory.message)
        warnings.warn(trajectory.message, RuntimeWarning, stacklevel=level_of_user())
    warn_of_result(problem, trajectory, model.layout.followers, lambda: is_balanced(model, problem))
    if redundant:
        warn_of_redundancy(problem, trajectory, redundant)
    left_out = _left_out(model) if redundant and model.sensitivities else []
    n, m = len(model.states), len(model.sensitivities)
    compiling = trajectory.statistics.compile_seconds
    return {
        "t": trajectory.t,
        "y": trajectory.z[:n],
        # z is ordered by parameter; s has the axes state, parameter and time.
        "s": trajectory.z[n:].reshape(m, n, len(trajectory.t)).transpose(1, 0, 2),
        "states": model.states,
        "positions": model.layout.positions,
        "outputs": model.outputs,
        "inputs": model.inputs,
        "parameters_of_sensitivity": model.sensitivities,
        "units": preparation.units.copy(),
        "status": trajectory.status,
        "message": f"{trajectory.message} {problem.note}".rstrip(),
        "statistics": trajectory.statistics,
        "times": {"compile": compiling, "integrate": time.perf_counter() - begin - compiling},
        "drift": trajectory.drift,
        "redundant": redundant,
        **observed(preparation, problem, trajectory, left_out),
    }


def redundancy(
    model: CompiledModel, constraints: HeldConstraints | None, trajectory: Trajectory
) -> int:
    """Return the largest number of redundant constraints at a few points of the trajectory."""
    n = len(trajectory.t)
    if constraints is None or not model.layout.constraint_edges or n == 0:
        return 0
    places = sorted({0, n // 3, 2 * n // 3, n - 1})
    return max(constraints.redundant(trajectory.t[j], trajectory.z[:, j]) for j in places)


def _left_out(model: CompiledModel) -> list[int]:
    """List the outputs whose sensitivities are not unique with redundant constraints, and warn."""
    # Multipliers of minimum norm are chosen, and this choice is not differentiated.
    found = [i for i, uses in enumerate(model.layout.uses_multipliers) if uses]
    if found:
        names = ", ".join(f"'{model.outputs[i]}'" for i in found[:6])
        warnings.warn(
            "constraints are redundant, so reactions are not unique: the least reactions are "
            f"returned, and the sensitivities of {names} are left out (nan)",
            RuntimeWarning,
            stacklevel=level_of_user(),
        )
    return found


# Minimum number of points of a smooth curve, divisions of each interval between points, and maximum
# number of steps of a run that is repeated for it.
_SMOOTH, _PARTS, _MOST_STEPS = 400, 4, 4000

# Distances of points next to a jump, as fractions of the span, less than a tenth of a pixel. An
# event is located to a tolerance, so the nearer point may be on the other side.
_ASIDE = np.array([[1e-5], [1e-4]])

# Maximum difference of a repeated run, as a fraction of a state's range: the width of a line.
_LINE_WIDTH = 2e-3


def at_more_times(record: RunRecord, model: CompiledModel, settings: Settings) -> RunRecord:
    """Repeat a run of few points at more times, or return the record itself if that cannot be done.

    Runs that failed, have many points, took many steps, or have functions of Python as inputs are
    not repeated.
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
    """Return whether an input is the same at each run: a number, an expression or a table."""
    parts = value if isinstance(value, (tuple, list)) else [value]
    return not any(map(callable, parts)) and isinstance(
        value, (str, Number, tuple, list, np.ndarray)
    )


def _jumps(record: RunRecord, model: CompiledModel, settings: Settings) -> FloatArray:
    """Return the times within a run at which a value may jump, unsorted."""
    span = (float(record.t[0]), float(record.t[-1]))
    signals = read_signals(settings.inputs, model.inputs)
    p = model.arguments_of(record.parameter_values)
    corners = model.restart_times(p, span, settings.inputs, signals.breakpoints).times
    return np.concatenate([corners, *(e.t for e in record.events.values())])


def _times(t: FloatArray, jumps: FloatArray) -> FloatArray:
    """Divide each interval evenly, and add both sides of jumps."""
    shares = np.arange(1, _PARTS) / _PARTS
    inside = (t[:-1, None] + shares * np.diff(t)[:, None]).ravel()
    # At late times a fixed distance would be below the rounding error.
    aside = np.maximum(_ASIDE * abs(t[-1] - t[0]), 8 * np.spacing(np.abs(jumps)))
    sides = np.concatenate([(jumps - aside).ravel(), (jumps + aside).ravel()])
    even = np.linspace(t[0], t[-1], _SMOOTH)
    times = np.concatenate([t, inside, even, sides])
    low, high = min(t[0], t[-1]), max(t[0], t[-1])
    found = np.unique(times[(times >= low) & (times <= high)])
    return found if t[-1] >= t[0] else found[::-1]


def _agrees(record: RunRecord, found: RunRecord, jumps: FloatArray) -> bool:
    """Return whether a repetition passes through the points of the run, to the width of a line."""
    if found.status != 0:
        return False
    # At a jump, the value on either side may be stored.
    is_smooth = ~np.isin(record.t, jumps)
    here = np.flatnonzero(np.isin(found.t, record.t[is_smooth]))
    y = record.y[:, is_smooth]
    if len(here) != y.shape[1]:
        return False
    size = np.ptp(record.y, axis=1, keepdims=True)
    # A constant state has no range.
    size = np.maximum(size, 1e-6 * np.max(np.abs(record.y), axis=1, keepdims=True, initial=0.0))
    return bool(np.all(np.abs(found.y[:, here] - y) <= _LINE_WIDTH * size + 1e-300))
