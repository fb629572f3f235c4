"""The C sources of an FMU: model, further kernels, tables, an integrator, the interface."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.codegen.context import (
    KernelFile,
    file_fields,
    kernel_context,
    model_context,
    name_tables,
)
from cotree.codegen.integrators import INTEGRATORS, method_files, stepper_files
from cotree.codegen.model_files import render_model
from cotree.codegen.newton import newton_context, render_newton
from cotree.codegen.printing import Constants, constants, int_table
from cotree.codegen.render import render
from cotree.codegen.runtime import source_texts, with_runtime
from cotree.codegen.start_tables import StartTables, start_tables
from cotree.codegen.targets import DOUBLE
from cotree.naming import c_identifier, c_string
from cotree.solvers.budgets import MOST_EVENTS, MOST_STEPS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from cotree.export.fmu.kernels import FmuKernels, Partials
    from cotree.program import Program


@dataclass(frozen=True)
class PatternContext:
    """A matrix of derivatives."""

    name: str
    n_rows: int
    n_columns: int
    n_nonzeros: int


@dataclass(frozen=True)
class TablesContext(KernelFile):
    """Data of the template of a model's tables."""

    token_literal: str
    integrator: str
    has_sensitivities: bool
    is_exchangeable: bool
    is_implicit: bool
    is_strict: bool
    is_extended: bool
    n_inputs: int
    n_signals: int
    is_found: bool
    is_at_rest: bool
    has_states: bool
    has_sizes: bool
    rtol: str
    atol: str
    span: str
    most_steps: int
    most_events: int
    n_stops: int
    has_stops: bool
    n_limits: int
    start_tables: StartTables
    patterns: list[PatternContext]
    arrays: list[Constants]


@dataclass(frozen=True)
class Facts:
    """Properties of a model besides its program.

    Attributes
    ----------
    token : str
        What description and library prove with that they belong together.
    integrator : str
        Of Co-Simulation; empty without it.
    is_exchangeable : bool
        Whether there is Model Exchange.
    has_sensitivities : bool
        Whether sensitivities are integrated and are variables.
    is_strict : bool
        Whether constraints are dependent.
    outside : tuple of int
        Inputs that are set from outside.
    input_values : tuple of float
        Their values until then.
    start : tuple of float
        States at the start.
    is_found, is_at_rest : bool
        Whether states that are not given begin as in ``start``; whether all do.
    sizes : tuple of float
        Factors of absolute tolerances; empty where they are one.
    rtol, atol, t_end : float
        Defaults.
    """

    token: str
    integrator: str
    is_exchangeable: bool
    has_sensitivities: bool
    is_strict: bool
    outside: tuple[int, ...]
    input_values: tuple[float, ...]
    start: tuple[float, ...]
    is_found: bool
    is_at_rest: bool
    sizes: tuple[float, ...]
    rtol: float
    atol: float
    t_end: float


def source_files(
    program: Program, kernels: FmuKernels, facts: Facts, version: int
) -> Mapping[str, str]:
    """Write all sources.

    Parameters
    ----------
    program : Program
        After its passes.
    kernels : FmuKernels
        Its further kernels.
    facts : Facts
        What the tables hold besides.
    version : int
        2 or 3.

    Returns
    -------
    mapping of str to str
        Text by file name.
    """
    # Without Co-Simulation no integrator is called, but the job is compiled all the same.
    integrator = facts.integrator
    method = integrator or "dopri5"
    files = {
        **render_model(model_context(program)),
        **method_files(method),
        **stepper_files(method),
    }
    if integrator and INTEGRATORS[integrator].is_implicit:
        files |= render_newton(newton_context(program))
    files |= source_texts(f"cotree_fmi{version}.h")
    tables = _tables_context(program, kernels, facts)
    files["fmu_tables.c"] = render("fmi/fmu_tables.c.jinja", model=tables)
    return with_runtime(files)


def _tables_context(program: Program, kernels: FmuKernels, facts: Facts) -> TablesContext:
    layout, prefix = program.layout, c_identifier(program.layout.name)
    present = kernels.present
    nodes = [node for kernel in present for node in kernel.order]
    names = name_tables(nodes)
    contexts = [kernel_context(prefix, kernel, program, names, {}) for kernel in present]
    is_implicit = bool(facts.integrator) and INTEGRATORS[facts.integrator].is_implicit
    arrays = list(_arrays(program, kernels, facts))
    further = [line for array in arrays for line in (array.name, *array.lines)]
    signals = [i for i in range(len(layout.inputs)) if i not in facts.outside]
    return TablesContext(
        **file_fields(layout.name, nodes, contexts, [*further, facts.token]),
        token_literal=c_string(facts.token),
        integrator=facts.integrator,
        has_sensitivities=facts.has_sensitivities,
        is_exchangeable=facts.is_exchangeable,
        is_implicit=is_implicit,
        is_strict=facts.is_strict,
        is_extended=not is_implicit
        and program.can_extend
        and not layout.events
        and not layout.inputs,
        n_inputs=len(facts.outside),
        n_signals=len(signals),
        is_found=facts.is_found,
        is_at_rest=facts.is_at_rest,
        has_states=bool(layout.states),
        has_sizes=bool(facts.sizes),
        rtol=DOUBLE.literal(facts.rtol),
        atol=DOUBLE.literal(facts.atol),
        span=DOUBLE.literal(facts.t_end),
        most_steps=MOST_STEPS,
        most_events=MOST_EVENTS,
        n_stops=len(kernels.starts),
        has_stops=kernels.stops is not None,
        n_limits=kernels.n_limits,
        start_tables=start_tables(layout),
        patterns=[
            PatternContext(own.name, own.n_rows, own.n_columns, len(own.rows))
            for own in (kernels.partials, kernels.initial, kernels.constraints)
        ],
        arrays=arrays,
    )


def _arrays(program: Program, kernels: FmuKernels, facts: Facts) -> Iterable[Constants]:
    layout = program.layout
    signals = [i for i in range(len(layout.inputs)) if i not in facts.outside]
    yield from _ints("inputs", facts.outside)
    yield from _doubles("values", facts.input_values)
    yield from _ints("signals", signals)
    yield from _doubles("start", facts.start)
    yield from _doubles("sizes", facts.sizes)
    yield from _ints("stop_starts", [int(starts) for starts in kernels.starts])
    for own in (kernels.partials, kernels.initial, kernels.constraints):
        yield from _pattern(own)


def _pattern(own: Partials) -> Iterable[Constants]:
    yield from _ints(f"{own.name}_starts", own.starts)
    yield from _ints(f"{own.name}_rows", own.rows)


def _ints(name: str, values: Sequence[int]) -> Iterable[Constants]:
    if values:
        yield int_table(name, values)


def _doubles(name: str, values: Sequence[float]) -> Iterable[Constants]:
    if values:
        numbers = [v if math.isfinite(v) else 0.0 for v in values]
        yield constants("double", name, map(DOUBLE.literal, numbers))
