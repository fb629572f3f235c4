"""C text of maps: statements for one column, which vectors execute for several columns.

Statements whose values are zero in the same blocks of columns form a segment. C skips the segment
for these blocks. A value that crosses from one segment to another is stored in an array, and set to
zero if its segment is skipped. Long maps are divided into functions.

Skipping does not change results, since skipped sums contain only products with zero. Only the sign
of a zero could differ: adding zero to each result avoids this.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from heapq import heapify, heappop, heappush
from itertools import chain
from typing import TYPE_CHECKING

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
from cotree.codegen.kernel_blocks import (
    LONGEST_BLOCK,
    VECTOR,
    Blocks,
    Crossing,
    cut_into_blocks,
    n_bytes,
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
    """The statements of a map, grouped into segments."""

    parts: list[list[Statement]]  # statements of the map, in several parts if it is long
    #: For each block of columns: 1 for each guarded segment to execute, 0 for each one to skip.
    live: list[list[int]]
    n_crossing: int  # length of the array of crossing values


@dataclass
class _Segment:
    """Statements whose values are zero in the same blocks of columns: zero bits in ``blocks``."""

    blocks: int
    nodes: list[Node]


def cut_into_segments(
    linear: LinearMap, symbols: Callable[[str, int], CExpression], longest: int = LONGEST_BLOCK
) -> Segments:
    """Divide a map into segments, and these into parts of at most ``longest`` statements."""
    segments = _shorter(_segments(linear), longest)
    number = {node: i for i, segment in enumerate(segments) for node in segment.nodes}
    # Values that another segment reads need a variable, even if they are read once.
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
    groups = printed.parts[1:]  # without the leaves, which have no statements
    for i, (root, value) in enumerate(zip(linear.results, printed.values, strict=True)):
        if root in number:
            # Adding zero makes the sign of a zero result independent of the blocks.
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
    """Combine segments into parts, with guards around segments that some blocks skip."""
    crossing = Crossing(groups)
    blocks = range(-(-n_columns // BLOCK))
    everywhere = (1 << len(blocks)) - 1
    guarded: list[int] = []
    parts: list[list[Statement]] = []
    length = longest  # so that the first segment starts a part
    for number, segment in enumerate(segments):
        if length + len(segment.nodes) > longest:
            parts.append([])
            length = 0
        length += len(segment.nodes)
        rows = crossing.written(number)
        if segment.blocks == everywhere:
            parts[-1] += rows
            continue
        condition = call("LIVE", named("live"), whole(len(guarded)))
        guarded.append(segment.blocks)
        parts[-1].append(When(condition, tuple(rows), tuple(_vanishing(rows))))
    live = [[reach >> k & 1 for reach in guarded] for k in blocks]
    return parts, live, crossing.lengths[REAL]


def _vanishing(rows: Sequence[Statement]) -> list[Statement]:
    """Return statements that set the results and crossing values of a segment to zero."""
    places = [row.to[-1] for row in rows if isinstance(row, Assign)]
    left = [place for place in places if place.form.op == "element"]
    return [Assign((place,), zero()) for place in left]


def _segments(linear: LinearMap) -> list[_Segment]:
    """Group statements into segments whose values are zero in the same blocks."""
    readers: dict[Node, list[Node]] = {node: [] for node in linear.statements}
    waiting = {}
    for node in linear.statements:
        # A statement is ready when all its arguments are computed.
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
        # A segment begins with the first ready statement in the original order. For length, it then
        # takes all statements with the same blocks, including those that become ready meanwhile.
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
    """Return the blocks in which each value is computed: at least those in which it may be nonzero.

    If the sums that read a product are computed in the same blocks, the product is also computed
    there: compilers can then fuse both operations, and no more values cross between segments.
    """
    blocks: dict[Node, int] = {}
    roots = set(linear.results)
    # In reverse order, the blocks of all readers are known.
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
    """Sort values depth-first, so that few values are live at a time."""
    left = set(nodes)
    # Start from values that no statement of the segment reads.
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
    """Divide segments that have more than ``longest`` statements."""
    return [
        _Segment(segment.blocks, segment.nodes[at : at + longest])
        for segment in segments
        for at in range(0, len(segment.nodes), longest)
    ]


#: Minimum fraction of the work that skipping must save; otherwise the map is written with loops.
_SKIPPED = 0.15
#: Maximum number of operations in a block. With blocks of 500, a map of 2261 operations compiles
#: with a third of the instructions and runs a fifth faster in vectors of four (gcc 12).
_LONGEST_BLOCK = 500
#: Maximum number of operations in a block if two vectors are interleaved, which hides latency.
_LONGEST_IN_TURN = 80
_FEWEST_IN_TURN = 300  # minimum number of statements; if fewer, too many values cross blocks

#: Number of vectors in the transposition macro, for the widest vectors: one per lane and stage.
_TURNING = 8 * 4
#: Number of arguments and loop counters in the template of a map.
_MAP_ARGUMENTS = 24

#: Arguments of a function that contains statements of a map, by name.
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
    """Template data of one map."""

    name: str
    doc: str
    n_columns: int
    width: int  # length of a row of inputs
    n_shared: int
    n_sensitive: int
    reads_own: bool
    places: list[str]  # start of each row in storage, for each group of eight columns
    n_own: int  # number of rows that columns do not share
    n_results: int
    block: int
    body: Body
    n_crossing: int
    n_together: int  # number of vectors that are interleaved
    n_guards: int
    live: list[str]  # for each block of columns, flags of the guarded segments to execute
    n_stack: int  # upper bound of the stack size, [byte]


@dataclass(frozen=True)
class _Cut:
    """The statements of a map, divided into functions if there are many."""

    blocks: Blocks
    live: list[list[int]] = field(default_factory=list)
    n_crossing: int = 0
    n_together: int = 1


def map_context(node: Node, name: str, target: Target) -> MapContext:
    """Build the template data of an application of a map."""
    linear: LinearMap = node.data
    own = own_rows(node)
    n_blocks = -(-linear.n_columns // BLOCK)
    # Segments are worthwhile if enough statements are skipped in some blocks of columns.
    skips = linear.n_times < (1.0 - _SKIPPED) * n_blocks * len(linear.statements)
    cut = _in_segments(own, name) if skips else _in_blocks(own, name)
    n_guards = len(cut.live[0]) if cut.live else 0
    # Vectors wider than a block read two rows of flags: pad an odd number of rows.
    rows = [*cut.live, *([[0] * n_guards] * (len(cut.live) % 2))]
    blocks, n_results = cut.blocks, len(linear.results)
    bodies = [blocks.statements, *(function.body for function in blocks.functions)]
    # Include the template's arrays, and its vectors for transposing inputs and results.
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
    """Return a table of the inputs that columns do not share; None if one is not constant."""
    rows = own_rows(node)
    numbers = {i: value.value for i, value in rows.values(node).items()}
    if None in numbers.values():
        return None
    items = (target.literal(numbers.get(i) or 0.0) for i in range(rows.length))
    return constants(target.scalar, name, items)


def _is_waiting(linear: LinearMap) -> bool:
    """Return whether the time of a long map is limited by latency instead of throughput."""
    started, longest = bounds(linear.statements)
    return longest > started and len(linear.statements) > _FEWEST_IN_TURN


def _in_segments(own: OwnRows, name: str) -> _Cut:
    """Return the statements of a map with many zeros, in segments."""
    linear = own.linear
    longest, together = (_LONGEST_IN_TURN, 2) if _is_waiting(linear) else (_LONGEST_BLOCK, 1)
    cut = cut_into_segments(linear, _symbols(own), longest)
    if len(cut.parts) == 1:
        return _Cut(Blocks([], cut.parts[0]), cut.live, cut.n_crossing)
    given = {}
    if together > 1:
        # Each interleaved vector uses its own part of these arrays.
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
    """Return the statements of a map with few zeros; repeated ones become loops."""
    linear = own.linear
    order = by_need(linear.order)
    printed = print_nodes(linear.results, {}, {}, [order], has_groups=False, symbols=_symbols(own))
    statements = printed.statements + [
        Assign((element("result", i),), zero() if root.is_zero else value)
        for i, (root, value) in enumerate(zip(linear.results, printed.values, strict=True))
    ]
    # Blocks declare the array of crossing values, so it is not an argument.
    arguments = [row for key, row in _ARGUMENTS.items() if key != "w"]
    return _Cut(
        cut_into_blocks(f"{name}_{{}}", roll(statements), arguments, ("result",), _LONGEST_BLOCK)
    )


def _symbols(own: OwnRows) -> Callable[[str, int], CExpression]:
    """Return a function that forms the C expression of an input of a map."""

    def read(kind: str, i: int) -> CExpression:
        if kind != "column" or i < own.first:
            return symbol(kind, i)
        place = i - own.first
        row = whole(own.width * place) if own.is_whole else element("at", place)
        # All inputs have the same width, so that the same expressions are inlined.
        return replace(call("OWN", named("here"), row), width=symbol(kind, i).width)

    return read
