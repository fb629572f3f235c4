"""Maps of many columns to C: the statements of one column, which a vector holds several of."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import chain
from typing import TYPE_CHECKING

from cotree.codegen.blocks import Blocks, cut_into_blocks
from cotree.codegen.column_storage import OwnRows, own_rows
from cotree.codegen.expressions import call, element, named, whole, zero
from cotree.codegen.loops import roll
from cotree.codegen.node_statements import print_nodes, symbol
from cotree.codegen.printing import Body, Constants, constants, print_body, wrapped
from cotree.codegen.segments import cut_into_segments
from cotree.codegen.stack import VECTOR, n_bytes
from cotree.codegen.statements import (
    REAL,
    Argument,
    Array,
    Assign,
    Call,
    function_of,
    uses,
)
from cotree.dag.linear_map import BLOCK
from cotree.program.cost_model import bounds, by_need

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.codegen.expressions import CExpression
    from cotree.codegen.targets import Target
    from cotree.dag.linear_map import LinearMap
    from cotree.dag.nodes import Node

#: Segments leave out at least this share of the work, or loops are looked for in place of them.
_SKIPPED = 0.15
#: Operations of a block of statements at most. Measured with gcc 12 on a map of 2261: 500 compile
#: with a third of the instructions, and four numbers at a time run a fifth faster.
_LONGEST_BLOCK = 500
#: The same of segments that wait for each other: two vectors then go through each block in turn,
#: and one is worked at while the other waits.
_LONGEST_IN_TURN = 80
_FEWEST_IN_TURN = 300  # statements; of fewer, what crosses between blocks is too much

#: Vectors of the macro that turns rows into columns, of the widest: one for each lane and stage.
_TURNING = 8 * 4
#: Arguments of a map and names that it counts by, as its template has them.
_MAP_ARGUMENTS = 24

#: The names in statements, as arguments of a function.
_ARGUMENTS = {
    argument.name: argument
    for argument in (
        Argument("shared"),
        Argument("column", REAL),
        Argument("here", is_restricted=False),
        Argument("at", "PLACE", is_restricted=False),
        Argument("live", "unsigned char", is_restricted=False),
        Argument("w", REAL, is_constant=False),
        Argument("result", REAL, is_constant=False),
    )
}


@dataclass(frozen=True)
class MapContext:
    """One map."""

    name: str
    doc: str
    n_columns: int
    width: int  # of a row
    n_shared: int
    n_sensitive: int
    reads_own: bool
    places: list[str]  # of what columns do not share, for each eight columns
    n_own: int  # rows of these
    n_results: int
    block: int
    body: Body
    n_crossing: int
    n_together: int  # vectors
    n_guards: int
    live: list[str]  # for each block of columns, which guarded segments are run
    n_stack: int  # bytes that it takes at most


@dataclass(frozen=True)
class _Cut:
    """The statements of a map, in functions where they are long."""

    blocks: Blocks
    live: list[list[int]] = field(default_factory=list)
    n_crossing: int = 0
    n_together: int = 1


def map_context(node: Node, name: str, target: Target) -> MapContext:
    """Gather what the templates need of one map.

    Parameters
    ----------
    node : Node
        An application of the map.
    name : str
        Its name in C.
    target : Target
        The type of its numbers, one at a time.
    """
    linear: LinearMap = node.data
    own = own_rows(node)
    n_blocks = -(-linear.n_columns // BLOCK)
    # Segments pay where many statements are skipped in some blocks of columns.
    skips = linear.n_times < (1.0 - _SKIPPED) * n_blocks * len(linear.statements)
    cut = _in_segments(own, name) if skips else _in_blocks(own, name)
    n_guards = len(cut.live[0]) if cut.live else 0
    # Vectors wider than a block read two rows, so zeros follow the last of an odd number.
    rows = [*cut.live, *([[0] * n_guards] * (len(cut.live) % 2))]
    blocks, n_results = cut.blocks, len(linear.results)
    bodies = [blocks.statements, *(function.body for function in blocks.functions)]
    # The arrays that the template declares besides, and vectors that turn rows into columns: those
    # of the inputs, if there are any, and those of the results.
    n_turning = _TURNING * ((own.first > 0) + 1)
    n_vectors = cut.n_together * (own.first + n_results + cut.n_crossing) + n_turning
    vectors = Array("column", n_vectors, is_aligned=True)
    return MapContext(
        name=name,
        doc=f"{linear.n_columns} columns, {linear.counts.total()} operations",
        n_columns=linear.n_columns,
        width=own.width,
        n_shared=linear.n_shared,
        n_sensitive=own.first,
        reads_own=any("here" in uses(row) for body in bodies for row in body),
        places=[] if own.is_whole else wrapped(map(str, chain.from_iterable(own.places))),
        n_own=own.n_rows,
        n_results=n_results,
        block=BLOCK,
        body=print_body(blocks, target.lanes),
        n_crossing=cut.n_crossing,
        n_together=cut.n_together,
        n_guards=n_guards,
        live=["".join(f"{bit}, " for bit in row).strip() for row in rows],
        n_stack=n_bytes(
            replace(blocks, statements=[vectors, *blocks.statements]), {}, _MAP_ARGUMENTS, VECTOR
        ),
    )


def constant_columns(node: Node, name: str, target: Target) -> Constants | None:
    """Write the values that columns do not share as a table; None where one must be computed."""
    rows = own_rows(node)
    numbers = {i: value.value for i, value in rows.values(node).items()}
    if None in numbers.values():
        return None
    items = (target.literal(numbers.get(i) or 0.0) for i in range(rows.length))
    return constants(target.scalar, name, items)


def _is_waiting(linear: LinearMap) -> bool:
    """Tell whether the longest path of one vector takes longer than starting all operations."""
    started, longest = bounds(linear.statements)
    return longest > started and len(linear.statements) > _FEWEST_IN_TURN


def _in_segments(own: OwnRows, name: str) -> _Cut:
    """Write statements with many zeros as segments, each run only where it is not all zero."""
    linear = own.linear
    longest, together = (_LONGEST_IN_TURN, 2) if _is_waiting(linear) else (_LONGEST_BLOCK, 1)
    # If one vector waits for its own values, two go through each part in turn, and parts are short.
    cut = cut_into_segments(linear, _symbols(own), longest)
    if len(cut.parts) == 1:
        return _Cut(Blocks([], cut.parts[0]), cut.live, cut.n_crossing)
    given = {}
    if together > 1:
        # Each of the vectors that are taken in turn has its own share of these arrays.
        sizes = {"column": own.first, "w": cut.n_crossing, "result": len(linear.results)}
        given = {key: f"OF({key}, {size})" for key, size in sizes.items()} | {
            "here": "HERE(turn)",
            "at": "AT(turn)",
            "live": "LIVE_OF(turn)",
        }
    arguments = [replace(row, given=given.get(key, "")) for key, row in _ARGUMENTS.items()]
    pairs = [function_of(f"{name}_{i}", part, arguments) for i, part in enumerate(cut.parts, 1)]
    functions = [function for function, _ in pairs]
    calls = [Call(called, "IN_TURN " if given else "") for _, called in pairs]
    return _Cut(Blocks(functions, [*calls]), cut.live, cut.n_crossing, together)


def _in_blocks(own: OwnRows, name: str) -> _Cut:
    """Write statements that are run for all columns, repeated ones as loops."""
    linear = own.linear
    # All columns run the same statements, so their order follows the longest path alone.
    order = by_need(linear.order)
    printed = print_nodes(linear.results, {}, {}, [order], has_groups=False, symbols=_symbols(own))
    statements = printed.statements + [
        Assign((element("result", i),), zero() if root.is_zero else value)
        for i, (root, value) in enumerate(zip(linear.results, printed.values, strict=True))
    ]
    # Blocks have an array of their own for what crosses.
    arguments = [row for key, row in _ARGUMENTS.items() if key != "w"]
    return _Cut(
        cut_into_blocks(f"{name}_{{}}", roll(statements), arguments, ("result",), _LONGEST_BLOCK)
    )


def _symbols(own: OwnRows) -> Callable[[str, int], CExpression]:
    """Give the places of the inputs of a map: sensitivities in columns, others in rows."""

    def read(kind: str, i: int) -> CExpression:
        if kind != "column" or i < own.first:
            return symbol(kind, i)
        place = i - own.first
        row = whole(own.width * place) if own.is_whole else element("at", place)
        # As long as other inputs, so that the same expressions are written out.
        return replace(call("OWN", named("here"), row), width=symbol(kind, i).width)

    return read
