"""Template data of kernels and models: texts and numbers that templates arrange without logic."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.codegen.ir import (
    Affine,
    Argument,
    Array,
    Assign,
    LeaveUnless,
    Loop,
    call,
    element,
    named,
    whole,
)
from cotree.codegen.kernel_blocks import cut_into_blocks, n_bytes
from cotree.codegen.loops import roll
from cotree.codegen.node_statements import (
    SINES,
    Printed,
    is_written_out,
    name_starts,
    own_rows,
    print_nodes,
    starts_of_maps,
)
from cotree.codegen.printing import Body, Constants, constants, function_head, print_body
from cotree.codegen.render import Features
from cotree.codegen.targets import DOUBLE
from cotree.dag.multi_output import Function
from cotree.dag.nodes import ARGUMENT_OF, reachable
from cotree.naming import c_identifier, c_string
from cotree.program.kernels import KERNELS
from cotree.quiet import without_collection
from cotree.version import VERSION

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

    from cotree.codegen.ir import CExpression, Statement
    from cotree.codegen.maps import MapContext
    from cotree.codegen.targets import Target
    from cotree.dag.lookup import LinearTable, LookupData
    from cotree.dag.nodes import Node
    from cotree.program.layout import Layout
    from cotree.program.program import Kernel, Program


#: Kind of an event that changes the direction of friction on a plane in space.
_TURN = 6


@dataclass(frozen=True)
class KernelContext:
    """Template data of one kernel."""

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
class KernelFile:
    """Template data of a C file of kernels."""

    title: str
    prefix: str
    generator: str
    digest: str
    uses_solve: bool
    definite_sizes: list[int]  # sizes of symmetric systems solved by straight-line code
    tables: list[Constants]
    lookups: list[str]
    functions: list[str]
    kernels: list[KernelContext]

    @property
    def bodies(self) -> list[Body]:
        """Functions of the file."""
        return [kernel.body for kernel in self.kernels]

    @property
    def n_written(self) -> int:
        """Number of operations in the longest function, which determines the compiler flags."""
        return max((n for body in self.bodies for n in body.written), default=0)

    @property
    def n_written_in_all(self) -> int:
        """Number of operations in all functions together."""
        return sum(n for body in self.bodies for n in body.written)


def _written_table(
    table: LinearTable | LookupData, name: str, target: Target
) -> Iterator[Constants]:
    """Yield the arguments and the values of a table, each as a table of constants."""
    for axis, values in table.arrays.items():
        yield constants(target.scalar, f"{name}_{axis}", map(target.literal, values))


def name_tables(nodes: Iterable[Node]) -> dict[LinearTable | LookupData, str]:
    """Return a C name for each table in ``nodes``."""
    tables = dict.fromkeys(node.data for node in nodes if node.op in ("table", "lookup"))
    return {table: f"table{i}" for i, table in enumerate(tables)}


def file_fields(
    title: str,
    nodes: Sequence[Node],
    kernels: list[KernelContext],
    further: Sequence[str] = (),
    target: Target = DOUBLE,
) -> dict[str, Any]:
    """Return the fields of :class:`KernelFile`; the lines ``further`` also enter its digest."""
    lines = [line for kernel in kernels for line in (kernel.signature, *kernel.body.text)]
    solved = [node for node in nodes if node.op == "solve"]
    return {
        "title": title,
        "prefix": c_identifier(title),
        "generator": VERSION,
        "digest": hashlib.sha256("\n".join([*lines, *further]).encode()).hexdigest()[:16],
        "uses_solve": bool(solved),
        "definite_sizes": sorted({node.data.size for node in solved if is_written_out(node)}),
        "tables": [
            row
            for table, name in name_tables(nodes).items()
            for row in _written_table(table, name, target)
        ],
        "lookups": sorted({table.function for table in name_tables(nodes)}),
        "functions": sorted({node.data.name for node in nodes if isinstance(node.data, Function)}),
        "kernels": kernels,
    }


def kernel_context(
    prefix: str,
    kernel: Kernel,
    program: Program,
    names: Mapping[Any, str],
    called: Mapping[str, int],
    target: Target = DOUBLE,
) -> KernelContext:
    """Build the template data of a kernel; ``called`` has stack sizes of its callees, [byte]."""
    spec = kernel.spec
    guards = program.guards if spec.name == "prepare" else ()
    if spec.tail_of and kernel.results:
        # Call the other kernel: computing only its last results would save little.
        whole_kernel = program.kernels[spec.tail_of]
        printed = Printed([_tail(prefix, kernel, whole_kernel)], [], 1, uses_status=True)
        unused, operations = [], whole_kernel.operations.total
    else:
        roots = [*kernel.results, *(guard.value for guard in guards)]
        # The guards' nodes are missing in the order of the kernel, so it must be determined again.
        order = None if guards else [kernel.order]
        places, has_groups = starts_of_maps(kernel), not kernel.is_by_need
        printed = print_nodes(roots, kernel.prepared, names, order, places, has_groups=has_groups)
        unused, operations = _unused(kernel, roots), kernel.operations.total
    n_results = len(kernel.results)
    results, checks = printed.values[:n_results], printed.values[n_results:]
    statements = [*printed.statements, *_written(spec.result, results)]
    # Guards follow all results, as cut_into_blocks requires. Numbers start at one because zero
    # means success. Equal conditions are checked only once.
    checked: dict[tuple[CExpression, bool], int] = {}
    for i, (guard, value) in enumerate(zip(guards, checks, strict=True), 1):
        checked.setdefault((value, guard.is_strict), i)
    statements += [
        LeaveUnless(value, whole(i), is_strict) for (value, is_strict), i in checked.items()
    ]
    name, arguments = f"{prefix}_{spec.name}", _arguments(kernel)
    rolled = roll(statements, "z" if "v" in spec.arguments else "v")
    cut = cut_into_blocks(f"{name}_{{}}", rolled, arguments, (spec.result, *printed.filled))
    heads = [target.declared(argument) for argument in arguments]
    return KernelContext(
        signature=function_head("int", name, heads),
        prototype=function_head("COTREE_EXPORT int", name, heads),
        doc=spec.doc[0].upper() + spec.doc[1:],
        n_results=n_results,
        n_operations=operations,
        n_statements=printed.n_statements,
        unused=unused,
        body=print_body(cut, target),
        uses_status=printed.uses_status,
        n_stack=n_bytes(cut, called, len(arguments), target.size),
    )


def _written(array: str, results: Sequence[CExpression]) -> Iterator[Statement]:
    """Yield assignments of the results; results that a map writes itself are omitted."""
    for i, value in enumerate(results):
        place = element(array, i)
        if value != place:
            yield Assign((place,), value)


def _tail(prefix: str, kernel: Kernel, whole_kernel: Kernel) -> list[Statement]:
    """Return statements that call another kernel and copy its last results."""
    n, n_kept = len(whole_kernel.results), len(kernel.results)
    given = map(named, (*kernel.spec.arguments, "whole"))
    first, kept = element("whole", Affine(1, n - n_kept)), element(kernel.spec.result, Affine(1, 0))
    return [
        Array("whole", n),
        Assign((named("status"),), call(f"{prefix}_{whole_kernel.spec.name}", *given)),
        Loop(n_kept, (Assign((kept,), first),)),
    ]


def _arguments(kernel: Kernel) -> list[Argument]:
    read = [Argument(key, is_array=key != "t") for key in kernel.spec.arguments]
    return [*read, Argument(kernel.spec.result, is_constant=False)]


def _unused(kernel: Kernel, roots: Sequence[Node]) -> list[str]:
    """Return the arguments that no statement uses; templates cast them to void."""
    nodes = reachable(roots, stop=kernel.prepared)
    read = {ARGUMENT_OF[node.data[0]] for node in nodes if node.op == "symbol"}
    if any(node in kernel.prepared for node in nodes):
        read.add("k")
    unused = [key for key in kernel.spec.arguments if key not in read]
    return unused if kernel.results else [*unused, kernel.spec.result]


@dataclass(frozen=True)
class ModelContext(KernelFile):
    """Template data of one model."""

    target: Target
    layout: Layout
    guards: list[str]  # C literals of the guards' conditions
    n_prepared: int
    uses_vectors: bool
    packs_sines: bool
    maps: list[MapContext]
    constants: list[Constants]  # constant columns of maps, and column starts of results
    clears_columns: bool
    kernel_pointers: dict[str, str]
    enums: dict[str, list[str]]  # enumerators in the header, by kind of quantity

    @property
    def upper(self) -> str:
        """Prefix of macros."""
        return self.prefix.upper()

    def features(self) -> Features:
        """Return the parts of the runtime that the model needs with an explicit method."""
        layout = self.layout
        return Features(
            sensitivities=bool(layout.sensitivities),
            inputs=bool(layout.inputs),
            algebraic=layout.n_algebraic > 0,
            constraints=bool(layout.constraints),
            events=layout.has_events,
            modes=any(row.part > 1 for row in layout.events),
            discs=any(row.part == _TURN for row in layout.events),
            moving_breakpoints=False,
            implicit=False,
            helper=False,
            mending=False,
            sundials=False,
        )

    @property
    def bodies(self) -> list[Body]:
        """Functions of the file."""
        return [*super().bodies, *(row.body for row in self.maps)]


@without_collection()
def model_context(
    program: Program, target: Target = DOUBLE, names_of: Collection[str] = tuple(KERNELS)
) -> ModelContext:
    """Build the template data of a model, with the named kernels, for scalar numbers."""
    layout = program.layout
    prefix = c_identifier(layout.name)
    chosen = [kernel for name, kernel in program.kernels.items() if name in names_of]
    nodes = [node for kernel in chosen for node in kernel.order]
    nodes += reachable([guard.value for guard in program.guards])  # checked by ``prepare``
    tables = name_tables(nodes)
    maps = list(dict.fromkeys(node for node in nodes if node.op == "map"))
    # Applications of the same map share a function if their inputs are stored equally.
    applied = {own_rows(node): node for node in maps}
    functions_of = {rows: f"cotree_map{i}" for i, rows in enumerate(applied)}
    columns: dict[Node, Constants] = {}
    contexts: list[MapContext] = []
    if maps:
        from cotree.codegen.maps import constant_columns, map_context

        # Columns that are constant are stored in a table at file scope.
        columns = {
            node: table
            for i, node in enumerate(maps)
            if (table := constant_columns(node, f"cotree_columns{i}", target))
        }
        contexts = [map_context(applied[rows], name, target) for rows, name in functions_of.items()]
    present = [k for k in chosen if k.is_present]
    packs_sines = any(node.op == "sines" for node in nodes)
    names: dict[Any, str] = {**tables, **functions_of}
    names |= {node: table.name for node, table in columns.items()}
    # A kernel that copies the last results of another kernel contains no map.
    starts = name_starts(kernel for kernel in present if not kernel.spec.tail_of)
    names |= {places: table.name for places, table in starts.items()}
    if packs_sines:
        names[SINES] = "cotree_sines"
    # In registry order, callees precede their callers, so their stack sizes are known.
    kernels, called = [], {row.name: row.n_stack for row in contexts}
    for kernel in present:
        own = kernel_context(prefix, kernel, program, names, called, target)
        kernels.append(own)
        called[f"{prefix}_{kernel.spec.name}"] = own.n_stack
    return ModelContext(
        **file_fields(layout.name, nodes, kernels, target=target),
        target=target,
        layout=layout,
        guards=[f"{c_string(guard.demand)}," for guard in program.guards],
        n_prepared=program.n_prepared,
        uses_vectors=packs_sines or bool(maps),
        packs_sines=packs_sines,
        maps=contexts,
        constants=[*columns.values(), *starts.values()],
        # Other columns are cleared and filled in each call.
        clears_columns=any(node not in columns for node in maps),
        # The model structure has a pointer for each kernel in the registry; NULL if it is missing.
        kernel_pointers={
            k.spec.field: f"{prefix}_{k.spec.name}" if k in present else "NULL"
            for k in program.kernels.values()
        },
        enums=_enums(prefix.upper(), layout),
    )


def _enums(upper: str, layout: Layout) -> dict[str, list[str]]:
    """Return the enumerators of states, parameters, inputs, outputs and sensitivities."""
    rows = {
        "state": [row.name for row in layout.states],
        "parameter": [row.name for row in layout.parameters],
        "input": [row.name for row in layout.inputs],
        "output": [row.name for row in layout.outputs],
        "sensitivity": layout.sensitivities,
    }
    return {
        kind: _enumerators(f"{upper}_{kind.upper()}", names)
        for kind, names in rows.items()
        if names
    }


def _enumerators(prefix: str, names: Sequence[str]) -> list[str]:
    """Convert names to enumerators; equal ones are made unique by numbers."""
    found: dict[str, None] = {}
    for name in names:
        own = first = f"{prefix}_{re.sub('[^A-Za-z0-9_]', '_', name)}"
        n = 1
        while own in found:
            n += 1
            own = f"{first}_{n}"
        found[own] = None
    return list(found)
