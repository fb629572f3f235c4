"""The pattern of an ensemble, which its members share: for C, a job that never runs.

In: a ``Plan``. Out: a ``Pattern``, or the reason why members have to run one by one. From it and
the rows of a block follow parameters, initial values and tolerances of members.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.dag.nodes import INPUT, PARAMETER, TIME, symbols_in
from cotree.errors import Error
from cotree.methods import Method, method_row
from cotree.model.signals import ReplacedInputs, read_signals
from cotree.model.start import is_slope
from cotree.solvers.augmented import tested
from cotree.solvers.engine import Engine, load_engine
from cotree.solvers.job import Job
from cotree.solvers.native import band_refusal, can_extend, check_available, factors_of
from cotree.solvers.prepare import prepared
from cotree.solvers.problem import Problem, check_values, turn_tolerances
from cotree.solvers.refusals import refusal
from cotree.solvers.select import choose_method

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.ensemble.plan import Plan
    from cotree.model.kernels import Newton
    from cotree.model.start_in_c import StartInC
    from cotree.solvers.result import FloatArray


@dataclass(frozen=True, eq=False)
class Pattern:
    """The parts of a run that members share."""

    plan: Plan  # with a method by its name
    row: Method
    engine: Engine
    problem: Problem  # of a run with the values that no member sets
    newton: Newton | None  # the factors of the model, for own implicit methods
    job: Job  # a job that has not begun
    signals: ReplacedInputs  # inputs in place of the scene's
    starts: StartInC | None  # what finds the starts of members in C
    #: Whether each member is prepared in Python: C cannot find its start, or it has corners of its
    #: own.
    is_searched: bool
    is_timed: bool  # whether rates depend on time, so that its rounding may decide a run
    is_watched: bool  # whether members that an explicit method finds stiff are run with another one

    def job_of(self, problem: Problem) -> Job:
        """Make the job of a member, which may begin again for others."""
        is_extended = bool(self.job.job.is_extended)
        return Job(self.engine, self.row, problem, self.newton, is_extended=is_extended)


@dataclass(frozen=True)
class NotBatchable:
    """A plan whose members run one by one, with a method by its name, and the reason."""

    plan: Plan
    why: str


def find_pattern(plan: Plan) -> Pattern | NotBatchable:
    """Find what members share."""
    try:
        problem = problem_of(plan, plan.settings.parameters, plan.settings.initial)
        is_auto = plan.settings.method == "auto"
        method = choose_method(problem)[0] if is_auto else plan.settings.method
        row = method_row(method)
        plan = replace(plan, settings=replace(plan.settings, method=method))
        is_watched = (is_auto or plan.is_chosen) and row.family == "cotree" and not row.implicit
        found = _pattern(plan, row, problem, is_watched=is_watched)
    except Error as error:
        # The values that no member sets may be refused where those of members are not.
        found = str(error)
    return NotBatchable(plan, found) if isinstance(found, str) else found


def problem_of(plan: Plan, parameters: Any, initial: Mapping[str, float]) -> Problem:
    """Return the problem of one run, with the sensitivities that the plan has."""
    problem = prepared(plan.model, plan.settings).run(parameters, initial).problem
    check_values(problem)
    return problem


def _pattern(plan: Plan, row: Method, problem: Problem, *, is_watched: bool) -> Pattern | str:
    """Find the pattern of a plan whose method has a name."""
    if not row.stepper:
        return f"'{row.name}' runs in Python"
    if problem.reach is not None:
        return "an input is sampled by a function of Python"
    check_available(row.name)
    why, engine = refusal(row.name, problem), load_engine(row.stepper)
    if why or isinstance(engine, str):
        return why or str(engine)
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


def _is_searched(plan: Plan, problem: Problem) -> bool:
    """Return whether each member is prepared in Python."""
    # Tolerances of contents follow from the start.
    if plan.model.begins_at_rest or plan.model.layout.followers:
        return True
    if any(is_slope(name) for name in (*plan.columns, *plan.settings.initial)):
        return True
    assert problem.native is not None  # C takes it
    if problem.native.functions:  # of which one exception ends all that is asked after it
        return True
    return bool(_moving(plan) & set(plan.columns))


def _moving(plan: Plan) -> set[str]:
    """Name the parameters that corners and the longest step depend on."""
    program = plan.model.program
    stops = [stop for own in program.stops.values() for stop in own]
    nodes = [node for stop in stops for node in (stop.first, stop.period) if node is not None]
    nodes += [limit for own in program.longest_steps.values() for limit in own]
    read = {node.data for node in symbols_in(nodes)}
    return {name for i, name in enumerate(plan.model.parameters) if (PARAMETER, i) in read}


@dataclass(frozen=True, eq=False)
class Own:
    """Values that members have of their own."""

    p: FloatArray  # parameters, shape (n_members, n_parameters)
    states: npt.NDArray[np.intc]  # states whose initial values are set, shape (n_set,)
    values: FloatArray  # these values, shape (n_members, n_set)
    is_refused: npt.NDArray[np.bool_]  # members with values that are not finite, shape (n_members,)


def own_values(pattern: Pattern, rows: FloatArray) -> Own:
    """Return what members set."""
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
        elif not is_slope(name):  # whose starts are made in Python
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
    """Return the absolute tolerances of members, of values and of turns, if they differ.

    Those of sensitivities are divided by the sizes of the parameters; see
    :class:`cotree.solvers.augmented.Tolerances`.
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
    # Where sensitivities are not tested, their sizes change nothing.
    return (atols if atols.ndim > 1 else None), turn_tolerances(own)
