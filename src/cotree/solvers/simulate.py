"""From a compiled model and a run's settings to a result."""

from __future__ import annotations

import time
import warnings
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from cotree.errors import SolveError
from cotree.quiet import level_of_user
from cotree.records import filled
from cotree.solvers.evaluate import BUDGET_SPENT
from cotree.solvers.growth import with_growth
from cotree.solvers.observed import observed
from cotree.solvers.prepare import prepared
from cotree.solvers.problem import check_values
from cotree.solvers.result import RunRecord
from cotree.solvers.select import run as integrate
from cotree.solvers.timely import timely
from cotree.solvers.trust import (
    held,
    is_balanced,
    warn_of_redundancy,
    warn_of_result,
    warn_of_tolerances,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.model.model import CompiledModel
    from cotree.scene.settings import Settings
    from cotree.solvers.base import Trajectory
    from cotree.solvers.held_constraints import HeldConstraints
    from cotree.solvers.prepare import Preparation


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
        The values of a ``RunRecord``, by field; outputs, inputs, events and values of parameters
        are made when they are first asked for.
    """
    begin = time.perf_counter()
    model, settings = preparation.model, preparation.settings
    run = preparation.run(parameters, initial)
    problem = run.problem
    check_values(problem)
    warn_of_tolerances(problem)
    # A run may still be refused: by the rounding of t, then by its constraints.
    trajectory = timely(problem, integrate(problem, settings.method))
    # Redundancy may come and go along a motion, so a few points are looked at, not the start alone.
    redundant = redundancy(model, run.held, trajectory)
    trajectory = with_growth(problem, held(problem, trajectory, redundant))
    if trajectory.status == BUDGET_SPENT and (cause := model.slow_causes):
        trajectory = replace(trajectory, message=f"{trajectory.message} {cause}")
    if trajectory.status != 0:
        if settings.throw:
            raise SolveError(trajectory.message)
        warnings.warn(trajectory.message, RuntimeWarning, stacklevel=level_of_user())
    t = problem.settings.t_span[0]
    warn_of_result(
        problem,
        trajectory,
        model.layout.followers,
        lambda: is_balanced(model, t, run.start.y, run.p, run.u(t)),
    )
    warn_of_redundancy(problem, trajectory, redundant)
    left_out = _left_out(model) if redundant and model.sensitivities else []
    n, m = len(model.states), len(model.sensitivities)
    return {
        "t": trajectory.t,
        "y": trajectory.z[:n],
        # z goes parameter by parameter, s by state, parameter and time.
        "s": trajectory.z[n:].reshape(m, n, len(trajectory.t)).transpose(1, 0, 2),
        "states": model.states,
        "positions": model.layout.positions,
        "outputs": model.outputs,
        "inputs": model.inputs,
        "parameters_of_sensitivity": model.sensitivities,
        "units": preparation.units.copy(),
        "status": trajectory.status,
        "message": f"{trajectory.message} {run.start.told}".rstrip(),
        "statistics": trajectory.statistics,
        "times": _times_of(trajectory, time.perf_counter() - begin),
        "drift": trajectory.drift,
        "redundant": redundant,
        **observed(preparation, run, trajectory, left_out),
    }


def _times_of(trajectory: Trajectory, seconds: float) -> dict[str, float]:
    """Separate the time to compile a method from the time to integrate."""
    compiling = trajectory.statistics.compile_seconds
    return {"compile": compiling, "integrate": seconds - compiling}


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
    # Of multipliers that share a load the least are taken, and that choice is not differentiated.
    found = [i for i, uses in enumerate(model.layout.uses_multipliers) if uses]
    if found:
        names = ", ".join(f"'{model.outputs[i]}'" for i in found[:6])
        warnings.warn(
            "constraints are redundant, so reactions are not unique: of those that share a load "
            f"the least are given, and the sensitivities of {names} are left out (nan)",
            RuntimeWarning,
            stacklevel=level_of_user(),
        )
    return found
