"""Maps of columns as segments, which C runs only where they do not vanish.

In: a map. Out: its statements, put into an order in which those that vanish in the same blocks of
columns stand together. A value that crosses from one segment to another stands in an array, and is
set to zero where its segment is skipped. Long maps are cut into functions.

Values are those of all statements: what is skipped is a sum of products with zeros. Only the sign
of a zero could differ, which a sum with zero takes away from each result.
"""

from __future__ import annotations

from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from typing import TYPE_CHECKING

from cotree.codegen.blocks import LONGEST_BLOCK
from cotree.codegen.crossing import Crossing
from cotree.codegen.expressions import apply, call, element, named, whole, zero
from cotree.codegen.node_statements import print_nodes
from cotree.codegen.statements import REAL, Assign, When
from cotree.dag.linear_map import BLOCK

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cotree.codegen.expressions import CExpression
    from cotree.codegen.statements import Statement
    from cotree.dag.linear_map import LinearMap
    from cotree.dag.nodes import Node


@dataclass(frozen=True)
class Segments:
    """A map as segments.

    Attributes
    ----------
    parts : list of list of Statement
        Its statements; more than one part where it is long.
    live : list of list of int
        For each block of columns, which of the guarded segments are run: one or zero.
    n_crossing : int
        Values that segments hand over at a time.
    """

    parts: list[list[Statement]]
    live: list[list[int]]
    n_crossing: int


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
    """Cut a map into segments, and these into parts of so many statements at most.

    Parameters
    ----------
    linear : LinearMap
        The map.
    symbols : callable
        The expression of an input, from its kind and its position.
    longest : int
        Statements of a part at most.
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
