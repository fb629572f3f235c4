"""Maps of many columns to C: the statements of one column, which a vector holds several of.

Statements that vanish in the same blocks of columns form segments, which C runs only where they
do not vanish. A value that crosses from one segment to another stands in an array, and is set to
zero where its segment is skipped. Long maps are cut into functions.

Values are those of all statements: what is skipped is a sum of products with zeros. Only the sign
of a zero could differ, which a sum with zero takes away from each result.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from heapq import heapify, heappop, heappush
from itertools import chain
from typing import TYPE_CHECKING

from cotree.codegen.blocks import LONGEST_BLOCK, VECTOR, Blocks, Crossing, cut_into_blocks, n_bytes
from cotree.codegen.ir import (
    REAL,
    Argument,
    Array,
    Assign,
    Call,
    When,
    apply,
    call,
    element,
    function_of,
    named,
    uses,
    whole,
    zero,
)
from cotree.codegen.loops import roll
from cotree.codegen.node_statements import OwnRows, own_rows, print_nodes, symbol
from cotree.codegen.printing import Body, Constants, constants, print_body, wrapped
from cotree.dag.multi_output import BLOCK, LinearMap
from cotree.program.counts import bounds, by_need

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cotree.codegen.ir import CExpression, Statement
    from cotree.codegen.targets import Target
    from cotree.dag.nodes import Node


@dataclass(frozen=True)
class Segments:
    """A map as segments."""

    parts: list[list[Statement]]  # its statements; more than one part where it is long
    #: For each block of columns, which of the guarded segments are run: one or zero.
    live: list[list[int]]
    n_crossing: int  # values that segments hand over at a time


@dataclass
class _Segment:
    """Statements that vanish in the same blocks."""

    blocks: int
    nodes: list[Node]


def cut_into_segments(
    linear: LinearMap,
    symbols: Callable[[str, int], CExpression],
    longest: int = LONGEST_BLOCK,
) -> Segments:
    """Cut a map into segments, and these into parts of at most ``longest`` statements.

    ``symbols`` returns the expression of an input, from its kind and its position.
    """
    segments = _shorter(_segments(linear), longest)
    number = {node: i for i, segment in enumerate(segments) for node in segment.nodes}
    # A value that another segment reads gets a statement, even if it is read once: expressions do
    # not reach across segments.
    crossing = {arg for node, i in number.items() for arg in node.args if number.get(arg, i) != i}
    leaves = [node for node in linear.order if not node.args]
    printed = print_nodes(
        linear.results,
        {},
        {},
        [leaves, *(segment.nodes for segment in segments)],
        kept=crossing,
        has_groups=False,
        symbols=symbols,
    )
    groups = printed.parts[1:]  # leaves take no statement
    for i, (root, value) in enumerate(zip(linear.results, printed.values, strict=True)):
        if root in number:
            # A sum with zero: what is minus zero in some widths of vectors is skipped in others.
            total = Assign((element("result", i),), apply("add", value, zero()))
            groups[number[root]].append(total)
    parts, live, n_crossing = _joined(segments, groups, linear.n_columns, longest)
    parts[-1] += [
        Assign((element("result", i),), zero() if root.is_zero else value)
        for i, (root, value) in enumerate(zip(linear.results, printed.values, strict=True))
        if root not in number
    ]
    return Segments(parts, live, n_crossing)


def _joined(
    segments: Sequence[_Segment], groups: Sequence[list[Statement]], n_columns: int, longest: int
) -> tuple[list[list[Statement]], list[list[int]], int]:
    """Join segments to parts, each with a guard if it is not always run."""
    crossing = Crossing(groups)
    blocks = range(-(-n_columns // BLOCK))
    everywhere = (1 << len(blocks)) - 1
    guarded: list[int] = []
    parts: list[list[Statement]] = []
    length = longest  # so that the first segment begins a part
    for number, segment in enumerate(segments):
        if length + len(segment.nodes) > longest:
            parts.append([])
            length = 0
        length += len(segment.nodes)
        rows = crossing.written(number)
        # A segment that is run in all blocks needs no guard.
        if segment.blocks == everywhere:
            parts[-1] += rows
            continue
        condition = call("LIVE", named("live"), whole(len(guarded)))
        guarded.append(segment.blocks)
        parts[-1].append(When(condition, tuple(rows), tuple(_vanishing(rows))))
    live = [[reach >> k & 1 for reach in guarded] for k in blocks]
    return parts, live, crossing.lengths[REAL]


def _vanishing(rows: Sequence[Statement]) -> list[Statement]:
    """Set to zero what a segment leaves behind: places of what crosses, then results."""
    places = [row.to[-1] for row in rows if isinstance(row, Assign)]
    left = [place for place in places if place.form.op == "element"]
    return [Assign((place,), zero()) for place in left]


def _segments(linear: LinearMap) -> list[_Segment]:
    """Order statements into segments: the next that is ready, with all that vanish alike."""
    readers: dict[Node, list[Node]] = {node: [] for node in linear.statements}
    waiting = {}
    for node in linear.statements:
        # Topological order by counting: a statement is ready when none of its arguments is awaited.
        awaited = {arg for arg in node.args if arg in readers}
        waiting[node] = len(awaited)
        for arg in awaited:
            readers[arg].append(node)
    blocks = _where_computed(linear, readers)
    ready: dict[int, list[tuple[int, Node]]] = {}
    for node in blocks:
        if not waiting[node]:
            ready.setdefault(blocks[node], []).append((node.index, node))
    for heap in ready.values():
        heapify(heap)
    found = []
    while ready:
        # The class whose next statement came first originally is taken, with all of it that is
        # ready or gets ready meanwhile: segments are then few and long.
        chosen = min(ready, key=lambda key: ready[key][0][0])
        heap, nodes = ready[chosen], []
        while heap:
            nodes.append(heappop(heap)[1])
            for reader in readers[nodes[-1]]:
                waiting[reader] -= 1
                if not waiting[reader]:
                    own = ready.setdefault(blocks[reader], [])
                    heappush(own, (reader.index, reader))
        del ready[chosen]
        found.append(_Segment(chosen, _depth_first(nodes)))
    return found


def _where_computed(linear: LinearMap, readers: Mapping[Node, Sequence[Node]]) -> dict[Node, int]:
    """Choose the blocks in which each value is computed: at least those where it may not vanish.

    A product goes with the sums that read it, where these are of the same blocks: one value crosses
    to them either way, and compilers turn both into one operation.
    """
    blocks: dict[Node, int] = {}
    roots = set(linear.results)
    # Backwards, so that the readers of each value have their blocks already.
    for node in reversed(linear.statements):
        around = {blocks[reader] for reader in readers[node]}
        moves = (
            node.op in ("mul", "neg")
            and node not in roots
            and len(around) == 1
            and all(reader.op in ("add", "sub") for reader in readers[node])
        )
        blocks[node] = around.pop() if moves else linear.blocks(node)
    return {node: blocks[node] for node in linear.statements}


def _depth_first(nodes: Sequence[Node]) -> list[Node]:
    """Compute each value where it is first needed: few are then waiting at a time."""
    left = set(nodes)
    # Values that no other of the segment reads are its ends, from which arguments are followed.
    read = {arg for node in nodes for arg in node.args}
    found: list[Node] = []
    stack = [node for node in reversed(nodes) if node not in read]
    while stack:
        node = stack[-1]
        waiting = [arg for arg in node.args if arg in left and arg is not node]
        if node not in left:
            stack.pop()
        elif waiting:
            stack += reversed(waiting)
        else:
            left.remove(node)
            found.append(stack.pop())
    return found


def _shorter(segments: Sequence[_Segment], longest: int) -> list[_Segment]:
    """Cut what is longer than a function is to be."""
    return [
        _Segment(segment.blocks, segment.nodes[at : at + longest])
        for segment in segments
        for at in range(0, len(segment.nodes), longest)
    ]


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
    """Gather what the templates need of an application of a map."""
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
    """Return whether the longest path of one vector takes longer than starting all operations."""
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
    """Return the places of the inputs of a map: sensitivities in columns, others in rows."""

    def read(kind: str, i: int) -> CExpression:
        if kind != "column" or i < own.first:
            return symbol(kind, i)
        place = i - own.first
        row = whole(own.width * place) if own.is_whole else element("at", place)
        # As long as other inputs, so that the same expressions are written out.
        return replace(call("OWN", named("here"), row), width=symbol(kind, i).width)

    return read
