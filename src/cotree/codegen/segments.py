"""Maps of columns as segments, which C runs only where they do not vanish.

In: a map. Out: its statements, put into an order in which those that vanish in the same blocks of
columns stand together. A value that crosses from one segment to another stands in an array, and is
set to zero where its segment is skipped. Long maps are cut into functions.

Values are those of all statements: what is skipped is a sum of products with zeros. Only the sign
of a zero could differ, which a sum with zero takes away from each result.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from heapq import heapify, heappop, heappush
from typing import TYPE_CHECKING

from cotree.codegen.blocks import LONGEST_BLOCK
from cotree.codegen.printer_c import print_parts
from cotree.dag.linear_map import BLOCK

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.linear_map import LinearMap
    from cotree.dag.nodes import Node

_NAME = re.compile(r"\bv\d+\b")
_TEMPORARY = re.compile(r"const double (v\d+) = ")


@dataclass(frozen=True)
class Segments:
    """A map as segments.

    Attributes
    ----------
    parts : list of list of str
        C statements; more than one part where it is long.
    live : list of list of int
        For each block of columns, which of the guarded segments are run: one or zero.
    n_crossing : int
        Values that segments hand over at a time.
    """

    parts: list[list[str]]
    live: list[list[int]]
    n_crossing: int


@dataclass
class _Segment:
    """Statements that vanish in the same blocks."""

    blocks: int
    nodes: list[Node]


@dataclass(frozen=True)
class _Piece:
    """Lines of a segment, and the results that are among them."""

    blocks: int
    lines: list[str]
    results: list[int]

    @cached_property
    def makes(self) -> list[str]:
        """The temporaries that it declares."""
        return [found[1] for line in self.lines if (found := _TEMPORARY.match(line))]

    @cached_property
    def made(self) -> set[str]:
        """The same as a set."""
        return set(self.makes)

    @cached_property
    def read_here(self) -> set[str]:
        """The temporaries that it reads."""
        texts = (_TEMPORARY.sub("", line, count=1) for line in self.lines)
        return {name for text in texts for name in _NAME.findall(text)}

    @property
    def reads(self) -> set[str]:
        """Those that others declare."""
        return self.read_here - self.made


def cut_into_segments(linear: LinearMap, longest: int = LONGEST_BLOCK) -> Segments:
    """Cut a map into segments, and these into parts of so many statements at most."""
    segments = _shorter(_segments(linear), longest)
    pieces, values = _printed(linear, segments)
    writer = _Writer(pieces, linear.n_columns)
    parts: list[list[str]] = []
    length = longest
    for number, segment in enumerate(segments):
        if length + len(segment.nodes) > longest:
            parts.append([])
            length = 0
        parts[-1] += writer.written(number)
        length += len(segment.nodes)
    computed = {node for segment in segments for node in segment.nodes}
    parts[-1] += [
        f"result[{i}] = {'ZERO' if root.is_zero else value};"
        for i, (root, value) in enumerate(zip(linear.results, values, strict=True))
        if root not in computed
    ]
    return Segments(parts, writer.live, writer.n_crossing)


def _segments(linear: LinearMap) -> list[_Segment]:
    """Put statements in order: the next that may follow, with all that vanish as it does."""
    readers: dict[Node, list[Node]] = {node: [] for node in linear.statements}
    waiting = {}
    for node in linear.statements:
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


def _printed(linear: LinearMap, segments: Sequence[_Segment]) -> tuple[list[_Piece], list[str]]:
    """Print each segment, with those results whose values it gives; and what all results are."""
    number = {node: i for i, segment in enumerate(segments) for node in segment.nodes}
    crossing = {arg for node, i in number.items() for arg in node.args if number.get(arg, i) != i}
    printed = print_parts(linear.results, [segment.nodes for segment in segments], crossing)
    results: list[list[int]] = [[] for _ in segments]
    for i, root in enumerate(linear.results):
        if root in number:
            results[number[root]].append(i)
    pieces = []
    for segment, lines, own in zip(segments, printed.parts, results, strict=True):
        # A sum with zero: what is minus zero in some widths of vectors is skipped in others.
        rows = [*lines, *(f"result[{i}] = {printed.values[i]} + ZERO;" for i in own)]
        pieces.append(_Piece(segment.blocks, rows, own))
    return pieces, printed.values


class _Writer:
    """Writes segments, and keeps what crosses between them in an array."""

    def __init__(self, pieces: Sequence[_Piece], n_columns: int) -> None:
        self._pieces = pieces
        self._place: dict[str, str] = {}
        self.n_crossing = 0
        blocks = range(-(-n_columns // BLOCK))
        self._all = (1 << len(blocks)) - 1
        guarded = [piece.blocks for piece in pieces if piece.blocks != self._all]
        self.live = [[reach >> k & 1 for reach in guarded] for k in blocks]
        self._guards = iter(range(len(guarded)))
        self._allot_places()

    def _allot_places(self) -> None:
        """Give what crosses a place; one whose value is read no more serves again."""
        last = {name: i for i, piece in enumerate(self._pieces) for name in piece.reads}
        leaving: dict[int, list[int]] = {}
        free: list[int] = []
        for i, piece in enumerate(self._pieces):
            for name in piece.makes:
                if name not in last:
                    continue
                if not free:
                    free.append(self.n_crossing)
                    self.n_crossing += 1
                slot = heappop(free)
                self._place[name] = f"w[{slot}]"
                leaving.setdefault(last[name], []).append(slot)
            for slot in leaving.pop(i, ()):
                heappush(free, slot)

    def written(self, number: int) -> list[str]:
        """Write a segment."""
        piece = self._pieces[number]
        lines = [self._line(row, piece) for row in piece.lines]
        if piece.blocks == self._all:
            return lines
        kept = [self._place[name] for name in piece.makes if name in self._place]
        places = [*kept, *(f"result[{i}]" for i in piece.results)]
        guard = next(self._guards)
        lines = [f"if (LIVE(live, {guard})) {{", *(f"    {line}" for line in lines)]
        if places:
            lines += ["} else {", *(f"    {place} = ZERO;" for place in places)]
        return [*lines, "}"]

    def _line(self, line: str, piece: _Piece) -> str:
        made = _TEMPORARY.match(line)
        if made:
            name, value = made.group(1), self._placed(line[made.end() :], piece)
            place = self._place.get(name)
            if place is None:
                return f"const VECTOR {name} = {value}"
            if name not in piece.read_here:
                return f"{place} = {value}"
            return f"const VECTOR {name} = {place} = {value}"
        return self._placed(line, piece)

    def _placed(self, text: str, piece: _Piece) -> str:
        """Read what other segments made from its place."""
        return _NAME.sub(
            lambda found: found[0] if found[0] in piece.made else self._place[found[0]], text
        )
