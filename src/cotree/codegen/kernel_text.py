"""Kernels as typed, plain data for the templates: one by one, and what a file of them has."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.codegen.blocks import cut_into_blocks
from cotree.codegen.expressions import Affine, call, element, named, whole
from cotree.codegen.loops import roll
from cotree.codegen.node_statements import Printed, is_written_out, print_nodes
from cotree.codegen.printing import Body, Constants, constants, function_head, print_body
from cotree.codegen.result_offsets import starts_of_maps
from cotree.codegen.stack import n_bytes
from cotree.codegen.statements import Argument, Array, Assign, LeaveUnless, Loop
from cotree.codegen.targets import DOUBLE
from cotree.dag.multi_output import Function, Table
from cotree.dag.operations import OPERATIONS
from cotree.dag.symbols import ARGUMENT_OF
from cotree.dag.traverse import reachable
from cotree.naming import c_identifier
from cotree.version import VERSION

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from cotree.codegen.expressions import CExpression
    from cotree.codegen.statements import Statement
    from cotree.codegen.targets import Target
    from cotree.dag.lookup import LookupData
    from cotree.dag.nodes import Node
    from cotree.program import Kernel, Program


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
class KernelFile:
    """A C file of kernels."""

    title: str
    prefix: str
    generator: str
    digest: str
    uses_math: bool
    uses_solve: bool
    definite_sizes: list[int]  # of symmetric systems that are written out
    tables: list[Constants]
    lookups: list[str]
    functions: list[str]
    kernels: list[KernelContext]

    @property
    def bodies(self) -> list[Body]:
        """Its functions."""
        return [kernel.body for kernel in self.kernels]

    @property
    def n_written(self) -> int:
        """Number of operations of the longest function, for the choice of the compiler's flags."""
        return max((n for body in self.bodies for n in body.written), default=0)

    @property
    def n_written_in_all(self) -> int:
        """Number of operations of all functions together."""
        return sum(n for body in self.bodies for n in body.written)


def _written_table(table: Table | LookupData, name: str, target: Target) -> Iterator[Constants]:
    """Write the arguments and the values of a table."""
    for axis, values in table.arrays.items():
        yield constants(target.scalar, f"{name}_{axis}", map(target.literal, values))


def name_tables(nodes: Iterable[Node]) -> dict[Table | LookupData, str]:
    """Give each table among some values a name in C."""
    tables = dict.fromkeys(node.data for node in nodes if node.op in ("table", "lookup"))
    return {table: f"table{i}" for i, table in enumerate(tables)}


def file_fields(
    title: str,
    nodes: Sequence[Node],
    kernels: list[KernelContext],
    further: Sequence[str] = (),
    target: Target = DOUBLE,
) -> dict[str, Any]:
    """Gather the fields of :class:`KernelFile`.

    Parameters
    ----------
    title : str
        The model's name.
    nodes : sequence of Node
        All that the kernels compute.
    kernels : list of KernelContext
        The kernels.
    further : sequence of str
        Other lines of the file that its digest is to follow.
    target : Target
        The type of the numbers in tables.
    """
    lines = [line for kernel in kernels for line in (kernel.signature, *kernel.body.text)]
    solved = [node for node in nodes if node.op == "solve"]
    return {
        "title": title,
        "prefix": c_identifier(title),
        "generator": VERSION,
        "digest": hashlib.sha256("\n".join([*lines, *further]).encode()).hexdigest()[:16],
        "uses_math": bool(solved) or any(map(_is_call, nodes)),
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


def _is_call(node: Node) -> bool:
    """Tell whether C needs a function of its mathematics library for it."""
    return node.op == "sines" or (node.op in OPERATIONS and OPERATIONS[node.op].is_call)


def kernel_context(
    prefix: str,
    kernel: Kernel,
    program: Program,
    names: Mapping[Any, str],
    called: Mapping[str, int],
    target: Target = DOUBLE,
) -> KernelContext:
    """Gather what the templates need of one kernel.

    Parameters
    ----------
    prefix : str
        Prefix of the model's names.
    kernel : Kernel
        The kernel.
    program : Program
        That it is of.
    names : mapping
        As for :func:`cotree.codegen.node_statements.print_nodes`.
    called : mapping of str to int
        Bytes of the stack that functions take which it may call.
    target : Target
        The type of numbers that it computes with.
    """
    spec = kernel.spec
    guards = program.guards if spec.name == "prepare" else ()
    if spec.tail_of and kernel.results:
        # The whole kernel is called: to compute its tail alone would save next to nothing.
        whole_kernel = program.kernels[spec.tail_of]
        printed = Printed([_tail(prefix, kernel, whole_kernel)], [], 1, uses_status=True)
        unused, operations = [], whole_kernel.operations.total
    else:
        roots = [*kernel.results, *(guard.value for guard in guards)]
        # Values of guards are computed in the kernel, too, and are not in its order of values.
        order = None if guards else [kernel.order]
        places, has_groups = starts_of_maps(kernel), not kernel.is_by_need
        printed = print_nodes(roots, kernel.prepared, names, order, places, has_groups=has_groups)
        unused, operations = _unused(kernel, roots), kernel.operations.total
    n_results = len(kernel.results)
    results, checks = printed.values[:n_results], printed.values[n_results:]
    statements = [*printed.statements, *_written(spec.result, results)]
    # Guards come last, behind all results: cut_into_blocks relies on that. They are numbered from
    # one, since zero means success; a condition that was checked before is not checked again.
    checked: dict[tuple[CExpression, bool], int] = {}
    for i, (guard, value) in enumerate(zip(guards, checks, strict=True), 1):
        checked.setdefault((value, guard.is_strict), i)
    statements += [
        LeaveUnless(value, whole(i), is_strict) for (value, is_strict), i in checked.items()
    ]
    name, arguments = f"{prefix}_{spec.name}", _arguments(kernel)
    # An array of loops must not have the name of an argument.
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
    """Write the results that are not in their places already."""
    for i, value in enumerate(results):
        place = element(array, i)
        # A map may have written this result directly.
        if value != place:
            yield Assign((place,), value)


def _tail(prefix: str, kernel: Kernel, whole_kernel: Kernel) -> list[Statement]:
    """Call another kernel and keep its last results."""
    n, n_kept = len(whole_kernel.results), len(kernel.results)
    given = map(named, (*kernel.spec.arguments, "whole"))
    first, kept = element("whole", Affine(1, n - n_kept)), element(kernel.spec.result, Affine(1, 0))
    return [
        # All results are computed, and the last ones are copied.
        Array("whole", n),
        Assign((named("status"),), call(f"{prefix}_{whole_kernel.spec.name}", *given)),
        Loop(n_kept, (Assign((kept,), first),)),
    ]


def _arguments(kernel: Kernel) -> list[Argument]:
    """List a kernel's arguments, the result last."""
    # Time is the only argument that is no array.
    read = [Argument(key, is_array=key != "t") for key in kernel.spec.arguments]
    return [*read, Argument(kernel.spec.result, is_constant=False)]


def _unused(kernel: Kernel, roots: Sequence[Node]) -> list[str]:
    """List the arguments that no statement reads or writes."""
    # Compilers warn of arguments that nothing reads; templates cast these to void.
    nodes = reachable(roots, stop=kernel.prepared)
    read = {ARGUMENT_OF[node.data[0]] for node in nodes if node.op == "symbol"}
    if any(node in kernel.prepared for node in nodes):
        read.add("k")
    unused = [key for key in kernel.spec.arguments if key not in read]
    return unused if kernel.results else [*unused, kernel.spec.result]
