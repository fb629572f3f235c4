"""Typed, plain data for the templates. A template arranges text and decides nothing else."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.codegen.blocks import cut_into_blocks
from cotree.codegen.expressions import Affine, call, element, named, whole
from cotree.codegen.loops import roll
from cotree.codegen.maps import ConstantColumns, MapContext, constant_columns, map_context
from cotree.codegen.own_rows import own_rows
from cotree.codegen.places import StartsContext, name_starts, starts_of_maps
from cotree.codegen.printer_c import SINES, Printed, is_written_out, print_nodes
from cotree.codegen.printing import (
    DOUBLE,
    Body,
    Counted,
    function_head,
    literal,
    print_body,
    wrapped,
)
from cotree.codegen.stack import n_bytes
from cotree.codegen.statements import (
    Argument,
    Array,
    Assign,
    Guard,
    Loop,
)
from cotree.dag.operations import OPERATIONS
from cotree.dag.several import Function, Table, sizes_of
from cotree.dag.symbols import ARGUMENT_OF
from cotree.dag.traverse import reachable
from cotree.naming import c_comment, c_identifier, c_string
from cotree.version import VERSION

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from cotree.codegen.expressions import Expression
    from cotree.codegen.statements import Statement
    from cotree.dag.nodes import Node
    from cotree.equations import Quantity
    from cotree.program import Kernel, Layout, Program


@dataclass(frozen=True)
class QuantityContext:
    """A row of a table of names."""

    name: str
    unit: str
    doc: str
    name_literal: str
    unit_literal: str


@dataclass(frozen=True)
class TableContext:
    """A piecewise linear function."""

    name: str
    length: int
    x: list[str]
    y: list[str]


@dataclass(frozen=True)
class KernelContext:
    """One kernel."""

    signature: str
    prototype: str
    doc: str
    n_results: int
    n_operations: int
    n_statements: int
    unused: list[str]
    body: Body
    uses_status: bool
    n_stack: int


@dataclass(frozen=True)
class EventContext:
    """One event."""

    name_literal: str
    direction: int
    is_stop: bool
    is_jump: bool
    is_count: bool
    n_kept: int
    n_targets: int
    targets: list[str]


@dataclass(frozen=True)
class HybridContext:
    """Data of a model that its events need; not written for a model without events."""

    events: list[EventContext]
    n_jumps: int
    n_coordinates: int
    n_speeds: int
    n_values: int
    n_rows: int
    value_rows: list[str]
    n_quaternions: int
    quaternions: list[str]


@dataclass(frozen=True)
class ModelContext(Counted):
    """One model."""

    title: str
    name_literal: str
    prefix: str
    upper: str
    guard: str
    generator: str
    digest: str
    uses_math: bool
    uses_solve: bool
    scales_solve: bool
    definite_sizes: list[int]  # of symmetric systems that are written out
    tables: list[TableContext]
    functions: list[str]
    uses_vectors: bool
    packs_sines: bool
    maps: list[MapContext]
    constant_columns: list[ConstantColumns]
    clears_columns: bool
    starts: list[StartsContext]
    kernels: list[KernelContext]
    kernel_pointers: list[str]
    states: list[QuantityContext]
    parameters: list[QuantityContext]
    inputs: list[QuantityContext]
    outputs: list[QuantityContext]
    sensitivities: list[str]
    sensitivity_literals: list[str]
    guard_literals: list[str]
    parameter_values: list[str]
    column_starts: list[str]
    row_indices: list[str]
    sensitivity_starts: list[str]
    sensitivity_rows: list[str]
    n_prepared: int
    n_guards: int
    n_nonzeros: int
    n_reached: int
    n_constraints: int
    n_algebraic: int
    hybrid: HybridContext

    @property
    def bodies(self) -> list[Body]:
        """The functions."""
        return [*(row.body for row in self.kernels), *(row.body for row in self.maps)]


def model_context(program: Program) -> ModelContext:
    """Gather what the templates of a model need.

    Parameters
    ----------
    program : Program
        After its passes.
    """
    layout = program.layout
    prefix = c_identifier(layout.name)
    nodes = [node for kernel in program.kernels.values() for node in kernel.order]
    nodes += reachable([guard.value for guard in program.guards])  # prepare checks them
    tables = name_tables(node.data for node in nodes if node.op == "table")
    functions = sorted({node.data.name for node in nodes if isinstance(node.data, Function)})
    maps = list(dict.fromkeys(node for node in nodes if node.op == "map"))
    applied = {own_rows(node): node for node in maps}
    functions_of = {rows: f"cotree_map{i}" for i, rows in enumerate(applied)}
    columns = {
        node: table
        for i, node in enumerate(maps)
        if (table := constant_columns(node, f"cotree_columns{i}"))
    }
    present = [k for k in program.kernels.values() if k.is_present]
    packs_sines = any(node.op == "sines" for node in nodes)
    names: dict[Any, str] = {**tables, **functions_of}
    names |= {node: table.name for node, table in columns.items()}
    starts = name_starts(kernel for kernel in present if not kernel.spec.tail_of)
    names |= {places: table.name for places, table in starts.items()}
    if packs_sines:
        names[SINES] = "cotree_sines"
    contexts = [map_context(applied[rows], name) for rows, name in functions_of.items()]
    kernels, called = [], {row.name: row.n_stack for row in contexts}
    for kernel in present:
        own = kernel_context(prefix, kernel, program, names, called)
        kernels.append(own)
        called[f"{prefix}_{kernel.spec.name}"] = own.n_stack  # others may call it
    lines = "\n".join(line for kernel in kernels for line in (kernel.signature, *kernel.body.text))
    return ModelContext(
        title=layout.name,
        name_literal=c_string(layout.name),
        prefix=prefix,
        upper=prefix.upper(),
        guard=f"COTREE_MODEL_{prefix.upper()}_H",
        generator=VERSION,
        digest=hashlib.sha256(lines.encode()).hexdigest()[:16],
        uses_math=any(node.op == "solve" or is_call(node) for node in nodes),
        uses_solve=any(node.op == "solve" for node in nodes),
        scales_solve=any(node.op == "solve" and sizes_of(node) for node in nodes),
        definite_sizes=sorted({node.data.size for node in nodes if is_written_out(node)}),
        tables=[table_context(table, name) for table, name in tables.items()],
        functions=functions,
        uses_vectors=packs_sines or bool(maps),
        packs_sines=packs_sines,
        maps=contexts,
        constant_columns=list(columns.values()),
        clears_columns=any(node not in columns for node in maps),
        starts=list(starts.values()),
        kernels=kernels,
        kernel_pointers=[
            f"{prefix}_{k.spec.name}" if k in present else "NULL" for k in program.kernels.values()
        ],
        states=[_quantity(row) for row in layout.states],
        parameters=[_quantity(row) for row in layout.parameters],
        inputs=[_quantity(row) for row in layout.inputs],
        outputs=[_quantity(row) for row in layout.outputs],
        sensitivities=list(layout.sensitivities),
        sensitivity_literals=wrapped(map(c_string, layout.sensitivities)),
        guard_literals=[f"{c_string(guard.what + guard.source)}," for guard in program.guards],
        parameter_values=wrapped(map(literal, layout.parameter_values)),
        column_starts=wrapped(map(str, layout.column_starts)),
        row_indices=wrapped(map(str, layout.row_indices)),
        sensitivity_starts=wrapped(map(str, layout.sensitivity_starts)),
        sensitivity_rows=wrapped(map(str, layout.sensitivity_rows)),
        n_reached=len(layout.sensitivity_rows),
        n_prepared=program.n_prepared,
        n_guards=len(program.guards),
        n_nonzeros=len(layout.row_indices),
        n_constraints=len(layout.constraints),
        n_algebraic=layout.n_algebraic,
        hybrid=_hybrid_context(layout),
    )


def _hybrid_context(layout: Layout) -> HybridContext:
    events = [
        EventContext(
            c_string(row.name),
            row.direction,
            row.is_stop,
            row.is_jump,
            row.is_count,
            len(row.kept),
            len(row.targets),
            wrapped(map(str, row.targets)),
        )
        for row in layout.events
    ]
    return HybridContext(
        events,
        sum(event.n_targets for event in events),
        layout.n_coordinates,
        layout.n_speeds,
        len(layout.value_rows),
        len(layout.constraint_edges),
        wrapped(map(str, layout.value_rows)),
        len(layout.quaternions),
        wrapped(map(str, layout.quaternions)),
    )


def is_call(node: Node) -> bool:
    """Whether C needs a function of its mathematics library for it."""
    return node.op == "sines" or (node.op in OPERATIONS and OPERATIONS[node.op].is_call)


def table_context(table: Table, name: str) -> TableContext:
    """Write a table's values."""
    return TableContext(
        name, len(table.x), wrapped(map(literal, table.x)), wrapped(map(literal, table.y))
    )


def name_tables(tables: Iterable[Table]) -> dict[Table, str]:
    """Give each table a name in C."""
    return {table: f"table{i}" for i, table in enumerate(dict.fromkeys(tables))}


def _quantity(row: Quantity) -> QuantityContext:
    return QuantityContext(
        row.name, c_comment(row.unit), c_comment(row.doc), c_string(row.name), c_string(row.unit)
    )


def kernel_context(
    prefix: str,
    kernel: Kernel,
    program: Program,
    names: Mapping[Any, str],
    called: Mapping[str, int],
) -> KernelContext:
    """Gather what the templates need of one kernel; functions it may call take some stack each."""
    spec = kernel.spec
    guards = program.guards if spec.name == "prepare" else ()
    if spec.tail_of and kernel.results:
        whole_kernel = program.kernels[spec.tail_of]
        printed = Printed([_tail(prefix, kernel, whole_kernel)], [], 1, uses_status=True)
        unused, operations = [], whole_kernel.operations.total
    else:
        roots = [*kernel.results, *(guard.value for guard in guards)]
        order = None if guards else kernel.order
        places, has_groups = starts_of_maps(kernel), not kernel.is_by_need
        printed = print_nodes(roots, kernel.prepared, names, order, places, has_groups=has_groups)
        unused, operations = _unused(kernel, roots), kernel.operations.total
    n_results = len(kernel.results)
    results, checks = printed.values[:n_results], printed.values[n_results:]
    statements = [*printed.statements, *_written(spec.result, results)]
    statements += [
        Guard(value, whole(i), guard.is_strict)
        for i, (guard, value) in enumerate(zip(guards, checks, strict=True), 1)
    ]
    name, arguments = f"{prefix}_{spec.name}", _arguments(kernel)
    rolled = roll(statements, "z" if "v" in spec.arguments else "v")
    cut = cut_into_blocks(f"{name}_{{}}", rolled, arguments, (spec.result, *printed.filled))
    heads = [DOUBLE.declared(argument) for argument in arguments]
    return KernelContext(
        signature=function_head("int", name, heads),
        prototype=function_head("COTREE_EXPORT int", name, heads),
        doc=spec.doc[0].upper() + spec.doc[1:],
        n_results=n_results,
        n_operations=operations,
        n_statements=printed.n_statements,
        unused=unused,
        body=print_body(cut),
        uses_status=printed.uses_status,
        n_stack=n_bytes(cut, called),
    )


def _written(array: str, results: Sequence[Expression]) -> Iterator[Statement]:
    """Write the results that are not in their places already."""
    for i, value in enumerate(results):
        place = element(array, i)
        if value != place:
            yield Assign((place,), value)


def _tail(prefix: str, kernel: Kernel, whole_kernel: Kernel) -> list[Statement]:
    """Call another kernel and keep its last results."""
    n, n_kept = len(whole_kernel.results), len(kernel.results)
    given = map(named, (*kernel.spec.arguments, "whole"))
    first, kept = element("whole", Affine(1, n - n_kept)), element(kernel.spec.result, Affine(1, 0))
    return [
        Array("whole", n),
        Assign((named("status"),), call(f"{prefix}_{whole_kernel.spec.name}", *given)),
        Loop(n_kept, (Assign((kept,), first),)),
    ]


def _arguments(kernel: Kernel) -> list[Argument]:
    """List a kernel's arguments, the result last."""
    read = [Argument(key, is_array=key != "t") for key in kernel.spec.arguments]
    return [*read, Argument(kernel.spec.result, is_constant=False)]


def _unused(kernel: Kernel, roots: Sequence[Node]) -> list[str]:
    """List the arguments that no statement reads or writes."""
    nodes = reachable(roots, stop=kernel.prepared)
    read = {ARGUMENT_OF[node.data[0]] for node in nodes if node.op == "symbol"}
    if any(node in kernel.prepared for node in nodes):
        read.add("k")
    unused = [key for key in kernel.spec.arguments if key not in read]
    return unused if kernel.results else [*unused, kernel.spec.result]
