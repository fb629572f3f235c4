"""The pattern of an ensemble: data that all members share, with a template of their C jobs.

SIMD lanes run several members in one vector. Their code is compiled for the first ensemble that
uses it. If members cannot use lanes, a sentence states the reason.
"""

from __future__ import annotations

import threading
import weakref
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.build import BuildOptions, LoadedLibrary, find_toolchain
from cotree.build.compile import cpu_features
from cotree.codegen.lanes import (
    Lanes,
    lanes_context,
    lanes_declarations,
    lanes_of,
    lanes_refusal,
    render_lanes,
)
from cotree.dag.nodes import INPUT, PARAMETER, TIME, symbols_in
from cotree.errors import Error, SolveError
from cotree.methods import Method, method_row
from cotree.model.kernels import Newton, load_kernels
from cotree.model.signals import ReplacedInputs, read_signals
from cotree.model.start import is_slope
from cotree.sharing import forming
from cotree.solvers.job import Job
from cotree.solvers.native import (
    band_refusal,
    can_extend,
    check_available,
    engine_of,
    factors_of,
)
from cotree.solvers.prepare import prepared
from cotree.solvers.problem import RunProblem, check_values, refusal, tested, turn_tolerances
from cotree.solvers.select import choose_method

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.ensemble.plan import Plan
    from cotree.model.model import CompiledModel
    from cotree.model.start_in_c import StartInC
    from cotree.solvers.engine import Engine
    from cotree.solvers.result import FloatArray


@dataclass(frozen=True, eq=False)
class Pattern:
    """The data that all members of an ensemble share."""

    plan: Plan  # the plan, with the method already chosen
    row: Method
    engine: Engine
    problem: RunProblem  # problem with the plan's own values for the columns that members set
    newton: Newton | None  # sparse factorisation for implicit methods in C
    job: Job  # template for the jobs of members
    signals: ReplacedInputs  # inputs that replace those of the scene
    starts: StartInC | None  # C function for initial states of members
    #: Whether each member is prepared in Python, because C cannot find its initial state or its
    #: time events depend on its values.
    is_searched: bool
    is_timed: bool  # whether rates depend on time, so that rounding errors of time may matter
    is_watched: bool  # whether members found to be stiff are repeated with another method

    def job_of(self, problem: RunProblem) -> Job:
        """Create the job of a member, which can be restarted for other members."""
        is_extended = bool(self.job.job.is_extended)
        return Job(self.engine, self.row, problem, self.newton, is_extended=is_extended)


@dataclass(frozen=True)
class NotBatchable:
    """A plan whose members must run one by one, with the method chosen and the reason."""

    plan: Plan
    why: str


def find_pattern(plan: Plan) -> Pattern | NotBatchable:
    """Return the pattern of a plan, or the reason why its members run one by one."""
    try:
        problem = problem_of(plan, plan.settings.parameters, plan.settings.initial)
        is_auto = plan.settings.method == "auto"
        method = choose_method(problem)[0] if is_auto else plan.settings.method
        row = method_row(method)
        plan = replace(plan, settings=replace(plan.settings, method=method))
        is_watched = (is_auto or plan.is_chosen) and row.family == "cotree" and not row.implicit
        found = _pattern(plan, row, problem, is_watched=is_watched)
    except Error as error:
        # The common values may be invalid although the values of the members are valid.
        found = str(error)
    return NotBatchable(plan, found) if isinstance(found, str) else found


def problem_of(plan: Plan, parameters: Any, initial: Mapping[str, float]) -> RunProblem:
    """Return the problem of one run for the given parameters and initial values."""
    problem = prepared(plan.model, plan.settings).run(parameters, initial)
    check_values(problem)
    return problem


def _pattern(plan: Plan, row: Method, problem: RunProblem, *, is_watched: bool) -> Pattern | str:
    """Return the pattern of a plan whose method is chosen, or the reason why there is none."""
    if not row.stepper:
        return f"'{row.name}' runs in Python"
    if problem.reach is not None:
        return "an input is sampled by a function of Python"
    check_available(row.name)
    why = refusal(row.name, problem)
    if why:
        return why
    engine = engine_of(row.stepper, problem)
    if isinstance(engine, str):
        return engine
    newton = factors_of(row, problem)
    if isinstance(newton, str):
        return newton
    job = Job(engine, row, problem, newton, is_extended=can_extend(row, problem))
    why = band_refusal(job, problem)
    if why:
        return why
    read = symbols_in(plan.model.program.kernels["rhs"].results)
    starts = prepared(plan.model, plan.settings).model.start_in_c
    return Pattern(
        plan,
        row,
        engine,
        problem,
        newton,
        job,
        read_signals(plan.settings.inputs, plan.model.inputs),
        starts=starts,
        is_searched=starts is None or starts.is_sparse or _is_searched(plan, problem),
        is_timed=any(node.data[0] in (TIME, INPUT) for node in read),
        is_watched=is_watched,
    )


def _is_searched(plan: Plan, problem: RunProblem) -> bool:
    names = (*plan.columns, *plan.settings.initial)
    # Tolerances of storage contents depend on the initial state, which Python then computes.
    is_own = plan.model.begins_at_rest or plan.model.layout.followers or any(map(is_slope, names))
    # In C, an exception in a Python function would end all members.
    return bool(is_own or problem.functions or _moving(plan) & set(plan.columns))


def _moving(plan: Plan) -> set[str]:
    """Return the names of parameters on which time events or the longest step depend."""
    program = plan.model.program
    events = [event for own in program.time_events.values() for event in own]
    nodes = [node for event in events for node in (event.first, event.period) if node is not None]
    nodes += [limit for own in program.longest_steps.values() for limit in own]
    read = {node.data for node in symbols_in(nodes)}
    return {name for i, name in enumerate(plan.model.parameters) if (PARAMETER, i) in read}


@dataclass(frozen=True, eq=False)
class Own:
    """Values that differ between members, as arrays."""

    p: FloatArray  # parameter values, shape (n_members, n_parameters)
    states: npt.NDArray[np.intc]  # indices of states with given initial values, shape (n_set,)
    values: FloatArray  # initial values of these states, shape (n_members, n_set)
    is_refused: npt.NDArray[np.bool_]  # members whose values are not finite


def own_values(pattern: Pattern, rows: FloatArray) -> Own:
    """Return the parameters and initial values of the members with the given rows."""
    plan, model = pattern.plan, pattern.plan.model
    shared = model.parameter_array(plan.settings.parameters)
    p = np.empty((len(rows), len(shared)))
    p[:] = shared
    initial = {
        name: np.full(len(rows), float(value))
        for name, value in plan.settings.initial.items()
        if not is_slope(name)
    }
    columns, places = [], []
    for j, name in enumerate(plan.columns):
        if name in model.states:
            initial[name] = rows[:, j]
        elif not is_slope(name):  # initial slopes are processed when Python prepares a member
            columns.append(j)
            places.append(model.parameters.index(name))
    p[:, places] = rows[:, columns]
    return Own(
        p,
        np.array([model.states.index(name) for name in initial], dtype=np.intc),
        np.array(list(initial.values())).reshape(len(initial), len(rows)).T.copy(),
        np.logical_not(np.isfinite(rows).all(axis=1)),
    )


def tolerances(pattern: Pattern, p: FloatArray) -> tuple[FloatArray | None, FloatArray | None]:
    """Return absolute tolerances of values and quaternions by member; None if they are common.

    Tolerances of sensitivities depend on the magnitudes of parameters, see
    :class:`cotree.solvers.problem.Tolerances`.
    """
    problem, model, settings = pattern.problem, pattern.plan.model, pattern.plan.settings
    names = model.sensitivities[: problem.n_sensitivities]
    moved = [
        j
        for j, name in enumerate(names)
        if name in pattern.plan.columns and name in model.parameters and name not in settings.scales
    ]
    if not moved:
        return None, None
    scales = np.tile(np.asarray(problem.scales), (len(p), 1))
    for j in moved:
        size = np.abs(p[:, model.parameters.index(names[j])])
        scales[:, j] = np.where(size == 0.0, 1.0, size)
    own = replace(problem, scales=scales)
    _, atols = tested(pattern.row, own, is_extended=bool(pattern.job.job.is_extended))
    # If sensitivities are not in the error test, their scales have no effect.
    return (atols if atols.ndim > 1 else None), turn_tolerances(own)


# Loaded SIMD lanes by model, then by properties of the code. One thread loads at a time.
_loaded: weakref.WeakKeyDictionary[CompiledModel, dict[tuple[Any, ...], LoadedLanes | str]] = (
    weakref.WeakKeyDictionary()
)
_building = threading.Lock()

#: Permitted numbers of members per vector; 1 disables vectors.
WIDTHS = (1, 2, 4, 8, 16)


@dataclass(frozen=True, eq=False)
class LoadedLanes:
    """Compiled SIMD lanes of a model."""

    n_lanes: int  # number of members integrated by one call
    n_bytes: int  # memory needed per worker, [byte]
    work: int  # address of the C function that integrates members
    library: LoadedLibrary  # reference that keeps the loaded code in memory


def find_lanes(pattern: Pattern) -> LoadedLanes | str:
    """Return the SIMD lanes of a pattern, built if necessary, or the reason why there are none.

    The choice depends only on the plan and the processor, not on the members of a block.
    """
    why = refusal_of(pattern)
    if why:
        return why
    key = _key(pattern)
    with _building:
        loaded = _loaded.setdefault(pattern.plan.model, {})
        if key not in loaded:
            loaded[key] = _load(pattern, *key)
        return loaded[key]


def refusal_of(pattern: Pattern) -> str:
    """Return the reason why members cannot run in SIMD lanes, or an empty string.

    The reason has no capital and no full stop. Compilers are only tested when lanes are built.
    """
    plan, problem = pattern.plan, pattern.problem
    if plan.lanes is not None and plan.lanes not in WIDTHS:
        raise SolveError(
            f"lanes is {plan.lanes}; give one of {', '.join(map(str, WIDTHS))}, or None"
        )
    if plan.lanes == 1:
        return "one lane is requested"
    found = _loaded.get(plan.model, {}).get(_key(pattern))
    if found is not None:
        return found if isinstance(found, str) else ""
    why = lanes_refusal(
        plan.model.program, pattern.row.name, has_sensitivities=problem.n_sensitivities > 0
    )
    if why:
        return why
    if pattern.signals.by_position:
        return "the run replaces inputs of the scene"
    if problem.settings.t_eval is None or not len(problem.settings.t_eval):
        return "no output times are given"
    if len(problem.breakpoints):
        return "rates have kinks or jumps at known times"
    if pattern.is_searched:
        return "members are prepared in Python: their starts or time events differ"
    return ""


def _key(pattern: Pattern) -> tuple[str, Lanes, bool]:
    """Return the properties of a pattern that determine the code of its lanes."""
    lanes = lanes_of(cpu_features().split(), pattern.plan.lanes, pattern.problem.size)
    return pattern.row.name, lanes, pattern.problem.n_sensitivities > 0


def _load(
    pattern: Pattern, method: str, lanes: Lanes, has_sensitivities: bool
) -> LoadedLanes | str:
    """Build and load SIMD lanes, or return the reason why that failed."""
    if find_toolchain() is None:
        return "no compiler is found"
    # Rendering may add nodes to the model's graph, which only one thread may do at a time.
    with forming:
        program = pattern.plan.model.program
        model = lanes_context(program, method, lanes, has_sensitivities=has_sensitivities)
        files = render_lanes(model, method)
    # At this optimisation level the compiler shares computations between kernels and steps.
    written = model.n_written, model.n_written_in_all
    options = BuildOptions("-O3")
    library = load_kernels(files, lanes_declarations(model), *written, options)
    if library is None:
        return "the compiler does not support vectors"
    found = getattr(library.lib, f"{model.prefix}_lanes")()
    work = int(library.ffi.cast("uintptr_t", found.work))
    return LoadedLanes(int(found.n_lanes), int(found.n_bytes), work, library)
