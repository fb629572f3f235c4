"""From a compiled model and a run's settings to a result."""

from __future__ import annotations

import math
import time
import warnings
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import ParameterError, SolveError, nearest
from cotree.model.arrays import derived_values
from cotree.model.consistent import consistent_start
from cotree.model.contents import content_sizes
from cotree.model.moment import Moment
from cotree.model.signals import ReplacedInputs, read_signals
from cotree.model.start import find_start
from cotree.quiet import level_of_user
from cotree.scene.expressions import check_number
from cotree.solvers.augmented import DENSE_LIMIT
from cotree.solvers.growth import with_growth
from cotree.solvers.jumps import ModelEvents
from cotree.solvers.problem import Native, Problem
from cotree.solvers.project import Projection
from cotree.solvers.result import EventTimes, RunRecord
from cotree.solvers.sampling import Samples, reaching
from cotree.solvers.select import integrate
from cotree.solvers.settings import (
    check_settings,
    read_bound,
    read_span,
    read_times,
    read_whole,
)
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
    from collections.abc import Callable, Mapping, Sequence

    import numpy.typing as npt
    from scipy.sparse import csc_matrix

    from cotree.model.model import CompiledModel
    from cotree.solvers.base import FloatArray, Occurrence, Trajectory
    from cotree.solvers.settings import Settings


# Share of a Jacobian's entries beyond which sparse matrices cost more than dense ones.
_LARGEST_SHARE = 0.1


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
    begin = time.perf_counter()
    check_settings(settings)
    p = model.parameter_array(settings.parameters)
    values = dict(zip(model.parameters, p.tolist(), strict=True))
    values |= derived_values(model.layout.derived, p)
    signals = read_signals(settings.inputs, model.inputs)
    _check_replaced(model, settings.inputs)
    t_span = read_span(settings.t_span)
    signals, samples = _with_samples(model, p, signals, t_span)
    u = _input_function(model, p, signals)
    # Norms of quaternions are among the constraints: a free body is projected, too.
    is_held = settings.project and bool(model.layout.constraints)
    projection = Projection(model, p, u) if is_held else None
    jacobian = model.bound_jacobian(p)
    corners = model.corners(p, t_span, settings.inputs, signals.breakpoints)
    at = Moment(model, t_span[0], p, u(t_span[0]))
    start = find_start(at, settings.initial)
    reach = reaching(model, p, samples, u) if samples else None
    if reach is not None:
        # The first samples see a start at the scene's own inputs; then the start is theirs.
        reach(t_span[0], start.z)
        at = Moment(model, t_span[0], p, u(t_span[0]))
        start = find_start(at, settings.initial)
    z0, sizes = start.z, content_sizes(at, start.y)
    events = ModelEvents(model, p, u) if model.layout.events else None
    if events is not None:
        events.check_start(t_span[0], z0)
    problem = Problem(
        # Governing and sensitivity equations together, as Eqs. (8) and (9) of the paper are solved.
        rhs=_rates(model, p, u, "augmented_rhs" if model.sensitivities else "rhs"),
        jacobian=lambda t, y: jacobian(t, y, u(t)),
        n_states=len(model.states),
        n_sensitivities=len(model.sensitivities),
        z0=z0,
        t_span=t_span,
        t_eval=read_times(settings.t_eval),
        rtol=check_number(settings.rtol, "rtol"),
        atol=check_number(settings.atol, "atol"),
        sizes=sizes,
        error_test_sensitivities=settings.error_test_sensitivities,
        scales=_scales(model, values, settings.scales),
        breakpoints=tuple(corner.t for corner in corners),
        scale=max(*map(abs, t_span), *(corner.scale for corner in corners)),
        # Sensitivities are continuous at corners that no parameter moves.
        shifts={corner.t: corner for corner in corners if any(corner.slopes + corner.spreads)},
        names=model.states,
        parameters=model.sensitivities,
        max_step=_max_step(model, p, settings),
        max_steps=read_whole(settings.max_steps, "max_steps"),
        max_events=read_whole(settings.max_events, "max_events"),
        time_limit=read_bound(settings.time_limit, "time_limit"),
        project=projection,
        residual=projection.residual if projection else None,
        constraints=projection.names if projection else (),
        settle=_settle(model, p) if is_held else None,
        singular=projection.singular if projection and projection.has_rows else None,
        n_algebraic=model.layout.n_algebraic,
        state_rhs=_rates(model, p, u, "rhs"),
        undefined=lambda t, y: model.why_undefined(t, y, p, u(t)),
        sparse_jacobian=_sparse_jacobian(model, p, u),
        **_native(model, p, signals),
        events=events,
        places=_places(model),
        n_observed=_n_observed(model),
        reach=reach,
    )
    warn_of_tolerances(problem)
    # A run may still be refused: by the rounding of t, then by its constraints.
    trajectory = timely(problem, integrate(problem, settings.method))
    # Redundancy may come and go along a motion, so a few points are looked at, not the start alone.
    redundant = _redundant(model, projection, trajectory)
    trajectory = with_growth(problem, held(problem, trajectory, redundant))
    if trajectory.status != 0:
        if settings.throw:
            raise SolveError(trajectory.message)
        warnings.warn(trajectory.message, RuntimeWarning, stacklevel=level_of_user())
    warn_of_result(
        problem,
        trajectory,
        model.layout.followers,
        lambda: is_balanced(model, t_span[0], start.y, p, u(t_span[0])),
    )
    n, m = len(model.states), len(model.sensitivities)
    y = trajectory.z[:n]
    # z goes parameter by parameter, s by state, parameter and time.
    s = trajectory.z[n:].reshape(m, n, len(trajectory.t)).transpose(1, 0, 2)
    warn_of_redundancy(problem, trajectory, redundant)
    outputs, output_s, inputs = sweep(model, p, u, trajectory.t, trajectory.z)
    if redundant and model.sensitivities:
        _leave_out(model, output_s)
    return RunRecord(
        t=trajectory.t,
        y=y,
        s=s,
        states=model.states,
        outputs=model.outputs,
        output_values=outputs,
        output_sensitivities=output_s,
        inputs=model.inputs,
        input_values=inputs,
        parameters_of_sensitivity=model.sensitivities,
        units=units,
        status=trajectory.status,
        message=trajectory.message,
        statistics=trajectory.statistics,
        times=_times_of(trajectory, time.perf_counter() - begin),
        drift=trajectory.drift,
        redundant=redundant,
        events=_event_times(model, trajectory.events),
        parameter_values=values,
    )


def _places(model: CompiledModel) -> npt.NDArray[np.intp] | None:
    """Return positions of states and nonvanishing sensitivities; None where none vanishes."""
    n, m = len(model.states), len(model.sensitivities)
    places = np.array(model.layout.sensitivity_places, dtype=np.intp)
    # The layout counts places among the sensitivities, which stand behind the n states in z.
    return None if len(places) == n * m else np.concatenate([np.arange(n), n + places])


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


def _n_observed(model: CompiledModel) -> int:
    """Count what is evaluated at each stored point besides states and sensitivities."""
    n_outputs = len(model.outputs) * (1 + len(model.sensitivities))
    return n_outputs + len(model.inputs) + len(model.constraints) + model.layout.n_algebraic


def _scales(
    model: CompiledModel, values: Mapping[str, float], given: Mapping[str, float]
) -> FloatArray:
    """Return the sizes of sensitivity parameters: their values, or 1 for zeros and for states."""
    found = [abs(values.get(name, 1.0)) or 1.0 for name in model.sensitivities]
    for name, value in given.items():
        if name not in model.sensitivities:
            raise ParameterError(
                f"scales names '{name}', to which no sensitivity was asked for"
                f"{nearest(name, model.sensitivities)}"
            )
        size = check_number(value, f"the scale of '{name}'")
        if size <= 0.0:
            raise ParameterError(f"the scale of '{name}' is {size}: it must be positive")
        found[model.sensitivities.index(name)] = size
    return np.array(found)


def _max_step(model: CompiledModel, p: FloatArray, settings: Settings) -> float:
    """Return the longest step: the one that is asked for, or the one that the model needs."""
    if settings.max_step is None:
        return model.longest_step(p, settings.inputs)
    if settings.max_step == math.inf:
        return math.inf
    return check_number(settings.max_step, "max_step")


def _check_replaced(model: CompiledModel, inputs: Mapping[str, Any]) -> None:
    """Refuse to replace an input where sensitivities depend on the input's own."""
    for name in inputs:
        if model.sensitivities and name in model.layout.event_inputs:
            raise ParameterError(
                f"input '{name}' decides when an event happens, or what it sets, and the "
                "sensitivities there need its own rate: to replace it, compile "
                "scene.with_inputs(...), or without sensitivities"
            )
    for name, wanted in zip(model.inputs, model.layout.input_sensitivities, strict=True):
        if name in inputs and wanted:
            raise ParameterError(
                f"input '{name}' depends on '{wanted[0]}' in the scene, and the sensitivity to it "
                f"is compiled in: to replace the input, compile scene.with_inputs(...), or without "
                "that sensitivity"
            )


def _with_samples(
    model: CompiledModel, p: FloatArray, signals: ReplacedInputs, span: tuple[float, float]
) -> tuple[ReplacedInputs, list[Samples]]:
    """Let sampled functions be constants that change at their times.

    Raises
    ------
    ParameterError
        If sensitivities would have to know the derivative of a function.
    """
    if not signals.sampled:
        return signals, []
    before, samples = model.input_values(span[0], p), {}
    for place, row in signals.sampled.items():
        name = model.inputs[place]
        if row.reads_states and model.sensitivities:
            raise ParameterError(
                f"input '{name}' is sampled from states by a function of Python, whose derivatives "
                "nobody knows: give an expression, or compile without sensitivities"
            )
        samples[place] = Samples(row, name, span, float(before[place]))
    times = [t for item in samples.values() for t in item.times]
    # A table of one point is constant; its value is that of the last sample.
    held = {place: (np.zeros(1), item.held) for place, item in samples.items()}
    return replace(
        signals,
        by_position={**signals.by_position, **samples},
        breakpoints=(*signals.breakpoints, *times),
        tables={**signals.tables, **held},
    ), list(samples.values())


def _input_function(
    model: CompiledModel, p: FloatArray, signals: ReplacedInputs
) -> Callable[[float], FloatArray | None]:
    """Give u as a function of time; None leaves it to the model."""
    nothing = np.zeros(0)
    if not model.inputs:
        return lambda t: nothing
    if not signals.by_position:
        return lambda t: None
    own = model.bound("inputs", p)
    # The inputs of the scene are a buffer of the kernel, which the replaced ones must not change.
    return lambda t: signals.apply(t, own(t, nothing, nothing, nothing).copy())


def _rates(
    model: CompiledModel, p: FloatArray, u: Callable[[float], FloatArray | None], kernel: str
) -> Callable[[float, FloatArray], FloatArray]:
    """Give the rates of the states, and of sensitivities where z has them, as one function."""
    call, n = model.bound(kernel, p), len(model.states)
    return lambda t, z: call(t, z[:n], z[n:], u(t))


def _settle(
    model: CompiledModel, p: FloatArray
) -> Callable[[float, FloatArray, Sequence[int]], FloatArray]:
    """Return the function that moves states set by an event onto the constraints."""
    # Only states are wanted: C goes on from them with the sensitivities.
    none = np.zeros((len(model.states), len(model.sensitivities)))
    return lambda t, y, kept: (
        consistent_start(Moment(model, t, p), y, none, kept, is_initial=False, is_probe=True).y
    )


def _sparse_jacobian(
    model: CompiledModel, p: FloatArray, u: Callable[[float], FloatArray | None]
) -> Callable[[float, FloatArray], csc_matrix] | None:
    """Give the Jacobian as a sparse matrix, where it is large and has few entries."""
    n = len(model.states)
    # The Jacobian of what is left once algebraic unknowns are eliminated is dense.
    if model.layout.n_algebraic or n <= DENSE_LIMIT:
        return None
    # Dense factorisations are faster than sparse ones of matrices that fill in.
    if len(model.layout.row_indices) > _LARGEST_SHARE * n * n:
        return None
    return lambda t, y: model.jacobian_sparse(t, y, p, u(t))


def _native(model: CompiledModel, p: FloatArray, signals: ReplacedInputs) -> dict[str, Any]:
    """Return the native form of the problem, or the reason why C cannot take it."""
    native = model.native(p)
    if native is None:
        return {"not_native": "the model is evaluated in Python"}
    # Tables are evaluated in C; only functions of Python have to be asked at each evaluation.
    others = {i: f for i, f in signals.by_position.items() if i not in signals.tables}
    return {"native": Native(native, len(model.inputs), signals.tables, others)}


def _redundant(model: CompiledModel, projection: Projection | None, trajectory: Trajectory) -> int:
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
