"""What the members of an ensemble share, as C takes it: a job that never runs.

In: a ``Plan``. Out: a ``Pattern``, or the reason why members have to run one by one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cotree.dag.symbols import INPUT, PARAMETER, TIME
from cotree.dag.traverse import symbols_in
from cotree.ensemble.results import n_sensitivities
from cotree.model.signals import read_signals
from cotree.scene.expressions import check_number
from cotree.solvers.engine import load_engine
from cotree.solvers.job import Job
from cotree.solvers.jumps import ModelEvents
from cotree.solvers.methods import method_row, refusal
from cotree.solvers.native import check_available
from cotree.solvers.prepare import given_scales, max_step_of, n_observed, places_of, scales_of
from cotree.solvers.problem import Native, Problem, check_problem
from cotree.solvers.settings import check_settings, read_bound, read_span, read_times, read_whole

if TYPE_CHECKING:
    from cotree.ensemble.plan import Plan
    from cotree.model.signals import ReplacedInputs
    from cotree.solvers.engine import Engine
    from cotree.solvers.methods import Method


@dataclass(frozen=True, eq=False)
class Pattern:
    """What members share.

    Attributes
    ----------
    plan : Plan
        The plan.
    row : Method
        Its method.
    engine : Engine
        The engine of the method.
    problem : Problem
        That of a run with the values that no member sets; the start is of no meaning.
    job : Job
        Its job.
    signals : ReplacedInputs
        Inputs in place of the scene's.
    is_timed : bool
        Whether rates depend on time, so that its rounding may decide a run.
    is_extended : bool
        Whether algebraic unknowns are integrated, too, by an explicit method.
    """

    plan: Plan
    row: Method
    engine: Engine
    problem: Problem
    job: Job
    signals: ReplacedInputs
    is_timed: bool
    is_extended: bool = False


def find_pattern(plan: Plan) -> Pattern | str:
    """Find what members share.

    Returns
    -------
    Pattern or str
        A reason is a sentence without a capital and an end.

    Raises
    ------
    Error
        If the settings are refused, or the values that no member sets.
    """
    check_settings(plan.settings)
    row, signals = (
        method_row(plan.settings.method),
        read_signals(plan.settings.inputs, plan.model.inputs),
    )
    if not row.stepper:
        return f"'{row.name}' runs in Python"
    why = _unfit(plan, signals)
    if why:
        return why
    check_available(row.name)
    problem = _problem(plan, signals)
    check_problem(problem)
    why = refusal(row.name, problem)
    if why:
        return why
    engine = load_engine(row.stepper)
    if isinstance(engine, str):
        return engine
    newton = None
    if row.family == "cotree" and row.implicit:
        assert problem.native is not None  # it was not refused
        newton = problem.native.model.newton()
        if newton is None:
            return "no compiler can build what it needs of the model"
    read = symbols_in(plan.model._program.kernels["rhs"].results)
    is_timed = any(node.data[0] in (TIME, INPUT) for node in read)
    return Pattern(plan, row, engine, problem, Job(engine, row, problem, newton), signals, is_timed)


def _unfit(plan: Plan, signals: ReplacedInputs) -> str:
    """Say why members cannot run side by side in C; empty where they can."""
    model, layout = plan.model, plan.model.layout
    if model.backend != "C":
        return "the model is evaluated in Python"
    if signals.by_position.keys() - signals.tables.keys() or signals.sampled:
        return "an input is a function of Python"
    if layout.constraints or layout.start_rows or layout.n_algebraic or layout.redundant:
        return "the start of each member is searched for"
    if layout.followers or model.begins_at_rest or any(row.is_jump for row in layout.events):
        return "the start of each member is searched for"
    program = model._program
    stops = [stop for own in program.stops.values() for stop in own]
    nodes = [node for stop in stops for node in (stop.first, stop.period) if node is not None]
    nodes += [limit for own in program.longest_steps.values() for limit in own]
    read = {node.data for node in symbols_in(nodes)}
    set_ones = {(PARAMETER, i) for i, name in enumerate(model.parameters) if name in plan.columns}
    if read & set_ones:
        return "members differ in where sources have corners"
    return ""


def _problem(plan: Plan, signals: ReplacedInputs) -> Problem:
    """Give the problem of a run with the values that no member sets."""
    model, settings, m = plan.model, plan.settings, n_sensitivities(plan)
    p = model.parameter_array(settings.parameters)
    values = dict(zip(model.parameters, p.tolist(), strict=True))
    t_span, n = read_span(settings.t_span), len(model.states)
    corners = model.corners(p, t_span, settings.inputs, signals.breakpoints)
    native = model.native(p)
    assert native is not None
    return Problem(
        rhs=lambda t, z: z,
        jacobian=None,
        n_states=n,
        n_sensitivities=m,
        z0=np.zeros(n * (1 + m)),
        t_span=t_span,
        t_eval=read_times(settings.t_eval),
        rtol=check_number(settings.rtol, "rtol"),
        atol=check_number(settings.atol, "atol"),
        error_test_sensitivities=settings.error_test_sensitivities,
        scales=scales_of(model, values, given_scales(model, settings.scales))[:m],
        breakpoints=tuple(corner.t for corner in corners),
        scale=max(*map(abs, t_span), *(corner.scale for corner in corners)),
        shifts={corner.t: corner for corner in corners if any(corner.slopes + corner.spreads)},
        names=model.states,
        parameters=model.sensitivities[:m],
        max_step=max_step_of(model, p, settings),
        max_steps=read_whole(settings.max_steps, "max_steps"),
        max_events=read_whole(settings.max_events, "max_events"),
        time_limit=read_bound(settings.time_limit, "time_limit"),
        native=Native(native, len(model.inputs), signals.tables, {}),
        events=ModelEvents(model, p, lambda t: None) if model.layout.events else None,
        places=places_of(model) if m else None,
        n_observed=n_observed(model),
    )
