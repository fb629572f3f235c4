"""The C sources of an FMU: model, further kernels, tables, an integrator, the interface.

Further kernels are derivatives with respect to all arguments, and times of kinks. The derivatives
are formed node by node from the results of the program, whichever sensitivities were compiled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cotree.codegen.c_files import INTEGRATORS, method_files, render_model, stepper_files
from cotree.codegen.context import (
    KernelFile,
    file_fields,
    kernel_context,
    model_context,
    name_tables,
)
from cotree.codegen.newton import newton_context, render_newton
from cotree.codegen.printing import Constants, constants, int_table
from cotree.codegen.render import project_files, render, source_texts
from cotree.codegen.start_tables import StartTables, start_tables
from cotree.codegen.targets import DOUBLE
from cotree.dag.derivative import tangents_along
from cotree.dag.nodes import INPUT, PARAMETER, STATE, TIME, substitute
from cotree.naming import c_identifier
from cotree.program.kernels import KernelSpec
from cotree.program.program import Kernel
from cotree.scene.settings import MOST_EVENTS, MOST_STEPS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.program.program import Program

_STATE = ("t", "x", "u", "p", "k")
_PARAMETER = ("p", "k")


@dataclass(frozen=True)
class Partials:
    """A kernel that writes the nonzeros of a matrix of derivatives."""

    name: str
    #: Numbers of rows and columns of the matrix.
    n_rows: int
    n_columns: int
    #: Sparsity pattern in compressed columns.
    starts: tuple[int, ...]
    rows: tuple[int, ...]
    kernel: Kernel

    def columns_of(self) -> list[set[int]]:
        """List the columns with an entry in each row."""
        found: list[set[int]] = [set() for _ in range(self.n_rows)]
        for j in range(self.n_columns):
            for i in self.rows[self.starts[j] : self.starts[j + 1]]:
                found[i].add(j)
        return found


@dataclass(frozen=True)
class FmuKernels:
    """The kernels of an FMU in addition to those of the program."""

    #: Derivatives of rates and residuals, outputs, event indicators and signals with respect to
    #: states, importer inputs, parameters and time.
    partials: Partials
    initial: Partials  # derivatives of the initial states with respect to parameters
    #: Derivatives of the constraints, then of the conditions at the start.
    constraints: Partials
    #: Upper bounds of the step size; then the first time and the period of each series of time
    #: events, with their derivatives along each sensitivity. None if there are neither.
    time_events: Kernel | None
    starts: tuple[bool, ...]  # whether no time event of each series precedes the first time
    n_limits: int  # number of upper bounds of the step size

    @property
    def present(self) -> list[Kernel]:
        """The kernels that have results."""
        rows = [self.partials.kernel, self.initial.kernel, self.constraints.kernel]
        found = [kernel for kernel in rows if kernel.results]
        return [*found, self.time_events] if self.time_events is not None else found


def form_kernels(program: Program, outside: Sequence[int]) -> FmuKernels:
    """Form the further kernels; inputs that are not ``outside`` are functions of time."""
    dag, layout, kernels = program.dag, program.layout, program.kernels
    own = kernels["inputs"].results
    signals = {dag.symbol(INPUT, i): own[i] for i in range(len(own)) if i not in outside}
    parameters = [dag.symbol(PARAMETER, i) for i in range(len(layout.parameters))]
    columns = [
        *(dag.symbol(STATE, i) for i in range(len(layout.states))),
        *(dag.symbol(INPUT, i) for i in outside),
        *parameters,
        dag.symbol(TIME, 0),
    ]
    rows = [
        *(node for name in ("rhs", "outputs", "events") for node in kernels[name].results),
        *signals.values(),
    ]
    held = [*kernels["constraints"].results]
    held += kernels["start"].results[: len(layout.start_rows)]
    starts, time_events, n_limits = _time_events(program, outside)
    return FmuKernels(
        _partials(program, "partials", _STATE, substitute(rows, signals), columns),
        _partials(program, "initial_partials", _PARAMETER, kernels["initial"].results, parameters),
        _partials(program, "constraint_partials", _STATE, substitute(held, signals), columns),
        time_events,
        starts,
        n_limits,
    )


def _partials(
    program: Program,
    name: str,
    arguments: tuple[str, ...],
    rows: Sequence[Node],
    columns: Sequence[Node],
) -> Partials:
    one = program.dag.one
    found = tangents_along(rows, [{column: one} for column in columns])
    starts, indices, values = [0], [], []
    for j in range(len(columns)):
        for i, row in enumerate(found):
            if j in row:
                indices.append(i)
                values.append(row[j])
        starts.append(len(indices))
    spec = KernelSpec(name, arguments, "values", f"derivatives, the nonzeros of {name} by columns")
    prepared = program.kernels["rhs"].prepared if "x" in arguments else {}
    kernel = Kernel(spec, tuple(values), prepared)
    return Partials(name, len(rows), len(columns), tuple(starts), tuple(indices), kernel)


def _time_events(
    program: Program, outside: Sequence[int]
) -> tuple[tuple[bool, ...], Kernel | None, int]:
    """Return the time events and longest steps of all functions of time."""
    dag = program.dag
    replaced = {program.layout.inputs[i].name for i in outside}
    events = [
        event for name, own in program.time_events.items() if name not in replaced for event in own
    ]
    limits = [
        limit
        for name, own in program.longest_steps.items()
        if name not in replaced
        for limit in own
    ]
    if not events and not limits:
        return (), None, 0
    values = [*limits]
    for event in events:
        values += [event.first, event.period if event.period is not None else dag.zero]
        values += [d for pair in event.along for d in pair]
    spec = KernelSpec(
        "time_events",
        _PARAMETER,
        "values",
        "upper bounds of steps; first times, periods and their derivatives of all time events",
    )
    return tuple(event.starts for event in events), Kernel(spec, tuple(values), {}), len(limits)


@dataclass(frozen=True)
class TablesContext(KernelFile):
    """Data of the template of a model's tables; flags and fields are those of ``fmu_tables``."""

    facts: FmuFacts
    further: FmuKernels
    is_implicit: bool
    flags: list[str]
    fields: list[str]
    most_steps: int
    most_events: int
    start_tables: StartTables
    patterns: dict[str, Partials]
    arrays: list[Constants]


@dataclass(frozen=True)
class FmuFacts:
    """Properties of an FMU that are not part of the program."""

    token: str  # instantiation token (FMI 2: GUID), which ties the library to the description
    integrator: str  # method of Co-Simulation; empty if the FMU has only Model Exchange
    is_exchangeable: bool  # whether the FMU offers Model Exchange
    has_sensitivities: bool  # whether sensitivities are integrated and offered as variables
    is_strict: bool  # whether the model has dependent (redundant) constraints
    outside: tuple[int, ...]  # inputs that the importer sets
    input_values: tuple[float, ...]  # values of these inputs until they are set
    start: tuple[float, ...]  # values of the states at the start
    #: Whether states without a prescribed value start as in ``start``; whether all states do.
    is_found: bool
    is_at_rest: bool
    sizes: tuple[float, ...]  # factors of the absolute tolerances; empty if all are one
    #: Default tolerances and end time.
    rtol: float
    atol: float
    t_end: float


def source_files(
    program: Program, kernels: FmuKernels, facts: FmuFacts, version: int
) -> Mapping[str, str]:
    """Return all sources as text by file name, for version 2 or 3."""
    integrator, is_implicit = facts.integrator, _is_implicit(facts)
    if not (is_implicit or program.layout.n_algebraic):
        unused = replace(program.kernels["jacobian"], results=())
        program = replace(program, kernels={**program.kernels, "jacobian": unused})
    model = model_context(program)
    tables = _tables_context(program, kernels, facts)
    layout = program.layout
    has_modes = any(row.is_jump or layout.n_algebraic for row in layout.events)
    features = replace(
        model.features(),
        sensitivities=facts.has_sensitivities,
        moving_breakpoints=facts.has_sensitivities and bool(kernels.starts),
        implicit=is_implicit,
        # Conditions of algebraic unknowns alone do not count as conditions of the start.
        start=tables.start_tables.has_assembly or has_modes,
        breakpoints=kernels.time_events is not None,
        exchange=facts.is_exchangeable,
        steps=bool(integrator),
    )
    files = dict(render_model(model, features))
    if integrator:
        files |= {**method_files(integrator), **stepper_files(integrator)}
    if is_implicit:
        files |= render_newton(newton_context(program), features)
    files["fmu_tables.c"] = render("fmi/fmu_tables.c.jinja", model=tables)
    files |= source_texts(f"cotree_fmi{version}.h", features=features)
    return project_files(files, DOUBLE, features)


def _is_implicit(facts: FmuFacts) -> bool:
    return bool(facts.integrator) and INTEGRATORS[facts.integrator].is_implicit


def _tables_context(program: Program, kernels: FmuKernels, facts: FmuFacts) -> TablesContext:
    layout, prefix = program.layout, c_identifier(program.layout.name)
    present = kernels.present
    nodes = [node for kernel in present for node in kernel.order]
    names = name_tables(nodes)
    contexts = [kernel_context(prefix, kernel, program, names, {}) for kernel in present]
    is_implicit, own_tables = _is_implicit(facts), start_tables(layout)
    own = list(_arrays(program, kernels, facts))
    patterns = {"partials": kernels.partials, "initial": kernels.initial}
    patterns |= {"constraints": kernels.constraints} if kernels.constraints.n_rows else {}
    arrays = [*own, *(row for pattern in patterns.values() for row in _pattern(pattern))]
    further = [line for array in arrays for line in (array.name, *array.lines)]
    flags = {
        "has_sensitivities": facts.has_sensitivities,
        "is_exchangeable": facts.is_exchangeable,
        "is_implicit": is_implicit,
        "is_strict": facts.is_strict,
        "is_extended": not is_implicit
        and program.traits.can_extend(program.layout)
        and not layout.events
        and not layout.inputs,
        "is_found": facts.is_found,
        "is_at_rest": facts.is_at_rest,
    }
    return TablesContext(
        **file_fields(layout.name, nodes, contexts, [*further, facts.token]),
        facts=facts,
        further=kernels,
        is_implicit=is_implicit,
        flags=[name for name, holds in flags.items() if holds],
        fields=[array.name for array in own],
        most_steps=MOST_STEPS,
        most_events=MOST_EVENTS,
        # The redundant conditions do not hold at an operating point.
        start_tables=replace(own_tables, redundant=()) if facts.is_at_rest else own_tables,
        patterns=patterns,
        arrays=arrays,
    )


def _arrays(program: Program, kernels: FmuKernels, facts: FmuFacts) -> Iterable[Constants]:
    signals = [i for i in range(len(program.layout.inputs)) if i not in facts.outside]
    yield from _ints("inputs", facts.outside)
    yield from _doubles("values", facts.input_values)
    yield from _ints("signals", signals)
    yield from _doubles("start", facts.start)
    yield from _doubles("sizes", facts.sizes)
    yield from _ints("time_event_starts", [int(starts) for starts in kernels.starts])


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
