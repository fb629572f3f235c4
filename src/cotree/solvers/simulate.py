"""From a compiled model and a run's settings to a result."""

from __future__ import annotations

import time
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import SolveError
from cotree.quiet import level_of_user
from cotree.solvers.growth import with_growth
from cotree.solvers.prepare import prepared
from cotree.solvers.problem import check_values
from cotree.solvers.result import EventTimes, RunRecord
from cotree.solvers.select import run as integrate
from cotree.solvers.sweep import sweep
from cotree.solvers.timely import timely
from cotree.solvers.trust import (
    held,
    is_balanced,
    warn_of_redundancy,
    warn_of_result,
    warn_of_tolerances,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.model.model import CompiledModel
    from cotree.solvers.base import FloatArray, Occurrence, Trajectory
    from cotree.solvers.prepare import Preparation
    from cotree.solvers.project import Projection
    from cotree.solvers.settings import Settings


def simulate(
    model: CompiledModel,
    settings: Settings,
    units: Mapping[str, str],
) -> RunRecord:
    """Integrate a model.

    Parameters
    ----------
    model : CompiledModel
        The model.
    settings : Settings
        Settings of the run.
    units : mapping of str to str
        Unit of each state, output and input.

    Raises
    ------
    ModelError
        If a parameter, initial value or input is not accepted.
    SolveError
        If the method is unknown or cannot take what it is given, or, with ``throw``, if the
        integration fails.
    """
    values = run_values(prepared(model, settings), settings.parameters, settings.initial)
    return RunRecord(**{**values, "units": units})


def run_values(
    preparation: Preparation, parameters: Any, initial: Mapping[str, float]
) -> dict[str, Any]:
    """Integrate a model once more with settings that were prepared.

    Parameters
    ----------
    preparation : Preparation
        Of the model and the settings.
    parameters : mapping of str to float, array_like of shape (n_parameters,), or None
        Values in place of the scene's.
    initial : mapping of str to float
        Initial values of states in place of the scene's.

    Returns
    -------
    dict of str to object
        The values of a ``RunRecord``, by field.

    Raises
    ------
    ModelError, SolveError
        As :func:`simulate`.
    """
    begin = time.perf_counter()
    model, settings = preparation.model, preparation.settings
    problem, p, u, values, start, projection = preparation.run(parameters, initial)
    check_values(problem)
    warn_of_tolerances(problem)
    # A run may still be refused: by the rounding of t, then by its constraints.
    trajectory = timely(problem, integrate(problem, settings.method))
    # Redundancy may come and go along a motion, so a few points are looked at, not the start alone.
    redundant = redundancy(model, projection, trajectory)
    trajectory = with_growth(problem, held(problem, trajectory, redundant))
    if trajectory.status != 0:
        if settings.throw:
            raise SolveError(trajectory.message)
        warnings.warn(trajectory.message, RuntimeWarning, stacklevel=level_of_user())
    t = problem.t_span[0]
    warn_of_result(
        problem,
        trajectory,
        model.layout.followers,
        lambda: is_balanced(model, t, start.y, p, u(t)),
    )
    n, m = len(model.states), len(model.sensitivities)
    warn_of_redundancy(problem, trajectory, redundant)
    native = None if problem.native is None else problem.native.model
    outputs, output_s, inputs = sweep(model, p, u, trajectory.t, trajectory.z, native)
    if redundant and model.sensitivities:
        _leave_out(model, output_s)
    return {
        "t": trajectory.t,
        "y": trajectory.z[:n],
        # z goes parameter by parameter, s by state, parameter and time.
        "s": trajectory.z[n:].reshape(m, n, len(trajectory.t)).transpose(1, 0, 2),
        "states": model.states,
        "outputs": model.outputs,
        "output_values": outputs,
        "output_sensitivities": output_s,
        "inputs": model.inputs,
        "input_values": inputs,
        "parameters_of_sensitivity": model.sensitivities,
        "units": preparation.units.copy(),
        "status": trajectory.status,
        "message": trajectory.message,
        "statistics": trajectory.statistics,
        "times": _times_of(trajectory, time.perf_counter() - begin),
        "drift": trajectory.drift,
        "redundant": redundant,
        "events": _event_times(model, trajectory.events),
        "parameter_values": values,
    }


def _event_times(model: CompiledModel, happened: Sequence[Occurrence]) -> dict[str, EventTimes]:
    """Group the occurrences by event."""
    n, m, found = len(model.states), len(model.sensitivities), {}
    for i, row in enumerate(model.layout.events):
        # Shapes are given, since an event that never happened has no row to infer them from.
        own = [item for item in happened if item.event == i]
        found[row.name] = EventTimes(
            np.array([item.t for item in own]),
            np.array([item.before[:n] for item in own]).reshape(len(own), n).T,
            np.array([item.after[:n] for item in own]).reshape(len(own), n).T,
            np.array([item.time_sensitivity for item in own]).reshape(len(own), m).T,
        )
    return found


def _times_of(trajectory: Trajectory, seconds: float) -> dict[str, float]:
    """Separate the time to compile a method from the time to integrate."""
    compiling = trajectory.statistics.compile_seconds
    return {"compile": compiling, "integrate": seconds - compiling}


def redundancy(model: CompiledModel, projection: Projection | None, trajectory: Trajectory) -> int:
    """Return the largest number of redundant constraints at a few points of the trajectory."""
    n = len(trajectory.t)
    if projection is None or not model.layout.constraint_edges or n == 0:
        return 0
    places = sorted({0, n // 3, 2 * n // 3, n - 1})
    return max(projection.redundant(trajectory.t[j], trajectory.z[:, j]) for j in places)


def _leave_out(model: CompiledModel, sensitivities: FloatArray) -> None:
    """Set sensitivities of reactions to nan: with redundant constraints they are not unique."""
    # Of multipliers that share a load the least are taken, and that choice is not differentiated.
    taken = [i for i, uses in enumerate(model.layout.uses_multipliers) if uses]
    if not taken:
        return
    sensitivities[taken] = np.nan
    names = ", ".join(f"'{model.outputs[i]}'" for i in taken[:6])
    warnings.warn(
        f"constraints are redundant, so reactions are not unique: of those that share a load the "
        f"least are given, and the sensitivities of {names} are left out (nan)",
        RuntimeWarning,
        stacklevel=level_of_user(),
    )
