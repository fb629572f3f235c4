"""Simulation of a compiled model with given settings."""

from __future__ import annotations

import time
import warnings
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import SolveError
from cotree.model.arrays import derived_values
from cotree.quiet import level_of_user
from cotree.records import filled
from cotree.solvers.engine import sweep
from cotree.solvers.prepare import Preparation, prepared
from cotree.solvers.problem import RunProblem, check_values
from cotree.solvers.result import EventTimes, FloatArray, RunRecord, Trajectory, deferred
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

    from cotree.model.bound import BoundModel
    from cotree.model.model import CompiledModel
    from cotree.scene.settings import Settings


_SWEPT = ("output_values", "output_sensitivities", "input_values")

# Outputs of trajectories above this size, [byte], are evaluated at once, others on first use.
_MOST_COPIED = 2**18


def observed(
    preparation: Preparation, problem: RunProblem, trajectory: Trajectory, left_out: Sequence[int]
) -> dict[str, Any]:
    """Return the outputs, inputs and events of a record; see :func:`deferred`.

    The sensitivities of outputs in ``left_out`` are set to nan, because they are not unique.
    """
    model, t, z = preparation.model, trajectory.t, trajectory.z
    native = problem.native
    assert native is not None  # the settings require a C compiler
    later: dict[str, Callable[[], Mapping[str, Any]]] = {
        "parameter_values": lambda: {"parameter_values": _parameter_values(model, native.p)},
        "events": lambda: {"events": _event_times(model, trajectory.events)},
    }

    def swept() -> dict[str, FloatArray]:
        values = sweep(native, t, z)
        values[1][left_out] = np.nan
        return dict(zip(_SWEPT, values, strict=True))

    # Python functions may have an internal state, so they are called now, in the order of the runs.
    if preparation.asks_python or z.nbytes > _MOST_COPIED:
        return {**swept(), **deferred(**later)}
    t, z = t.copy(), z.copy()
    return deferred(**later, **dict.fromkeys(_SWEPT, swept))


def _parameter_values(model: CompiledModel, p: FloatArray) -> dict[str, float]:
    named = dict(zip(model.parameters, p.tolist(), strict=True))
    return named | derived_values(model.layout.derived, p)


def _event_times(model: CompiledModel, records: FloatArray) -> dict[str, EventTimes]:
    n, m, found = len(model.states), len(model.sensitivities), {}
    for i, row in enumerate(model.layout.events):
        own = records[records[:, 1] == i]
        # The shape is explicit, because empty arrays may lack these columns.
        parts = own[:, 2:].reshape(len(own), m + 2 * n)
        slopes, before, after = np.split(parts, [m, m + n], axis=1)
        found[row.name] = EventTimes(own[:, 0].copy(), before.T, after.T, slopes.T)
    return found


def simulate(model: CompiledModel, settings: Settings) -> RunRecord:
    """Simulate a model; with ``throw``, raise SolveError if the integration fails."""
    return filled(
        RunRecord, run_values(prepared(model, settings), settings.parameters, settings.initial)
    )


def run_values(
    preparation: Preparation, parameters: Any, initial: Mapping[str, float]
) -> dict[str, Any]:
    """Simulate a model with prepared settings, and return the fields of a ``RunRecord`` by name."""
    begin = time.perf_counter()
    model, settings = preparation.model, preparation.settings
    problem = preparation.run(parameters, initial)
    check_values(problem)
    warn_of_tolerances(problem)
    # A complete run also fails if the rounding of t or the drift of the constraints is too large.
    trajectory = check_time_resolution(problem, integrate(problem, settings.method))
    # The rank of the constraints may change along a motion, so a few points are examined.
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
        # z is ordered by parameter and state; s has the axes state, parameter, time.
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


def redundancy(model: CompiledModel, constraints: BoundModel | None, trajectory: Trajectory) -> int:
    """Return the largest number of redundant constraints at a few points of a trajectory."""
    n = len(trajectory.t)
    if constraints is None or not model.layout.constraint_edges or n == 0:
        return 0
    places = sorted({0, n // 3, 2 * n // 3, n - 1})
    return max(constraints.redundant(trajectory.t[j], trajectory.z[:, j]) for j in places)


def _left_out(model: CompiledModel) -> list[int]:
    """Return the outputs without unique sensitivities if constraints are redundant, and warn."""
    # Multipliers of redundant constraints have minimum norm; this choice has no derivatives.
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
