"""Maps of many columns to C: the statements of one column, which a vector holds several of."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING

from cotree.codegen.blocks import Block, cut_into_blocks
from cotree.codegen.c_statements import NAME, count_written
from cotree.codegen.heads import function_head, wrapped
from cotree.codegen.loops import roll
from cotree.codegen.own_rows import OwnRows, own_rows
from cotree.codegen.printer_c import literal, print_nodes
from cotree.codegen.segments import cut_into_segments
from cotree.codegen.stack import n_bytes
from cotree.dag.linear_map import BLOCK
from cotree.program.machine import bounds, by_need

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

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

_COLUMN = re.compile(r"\bcolumn\[(\d+)\]")
_OWN = re.compile(r"\bown\[((?:[^\[\]]|\[[^\[\]]*\])*)\]")  # with a place from a table, too
_HEAD = "TARGET COTREE_APART static void"
#: What statements name, as a function gets it.
_ARGUMENTS = {
    "shared": "const double *COTREE_RESTRICT shared",
    "column": "const VECTOR *COTREE_RESTRICT column",
    "here": "const double *here",
    "at": "const PLACE *at",
    "live": "const unsigned char *live",
    "w": "VECTOR *COTREE_RESTRICT w",
    "result": "VECTOR *COTREE_RESTRICT result",
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
    functions: list[Block]  # none where it is not cut
    lines: list[str]
    n_crossing: int
    n_together: int  # vectors
    n_guards: int
    live: list[str]  # for each block of columns, which guarded segments are run

    @property
    def n_stack(self) -> int:
        """Bytes of the stack that it takes at most."""
        n = self.n_together * (self.n_sensitive + self.n_results + self.n_crossing)
        return n_bytes([f"VECTOR column[{n}];", *self.lines], self.functions, {})

    @cached_property
    def written(self) -> list[int]:
        """Number of operations in each of its functions."""
        return [count_written(rows) for rows in (self.lines, *(b.lines for b in self.functions))]


@dataclass(frozen=True)
class ConstantColumns:
    """Table of the values that the columns of a map do not share, all known beforehand."""

    name: str
    length: int
    lines: list[str]


@dataclass(frozen=True)
class _Text:
    """The statements of a map, in functions where they are long."""

    functions: list[Block]
    lines: list[str]
    live: list[list[int]]
    n_crossing: int
    n_together: int = 1

    @property
    def written(self) -> list[list[str]]:
        """The lines of each function."""
        return [self.lines, *(function.lines for function in self.functions)]


def map_context(node: Node, name: str) -> MapContext:
    """Gather what the templates need of one map.

    Parameters
    ----------
    node : Node
        Where it is applied.
    name : str
        Its name in C.
    """
    linear: LinearMap = node.data
    own = own_rows(node)
    n_blocks = -(-linear.n_columns // BLOCK)
    skips = linear.n_times < (1.0 - _SKIPPED) * n_blocks * len(linear.statements)
    text = _in_segments(own, name) if skips else _in_blocks(own, name)
    n_guards = len(text.live[0]) if text.live else 0
    # Vectors wider than a block read two rows.
    rows = [*text.live, *([[0] * n_guards] * (len(text.live) % 2))]
    return MapContext(
        name=name,
        doc=f"{linear.n_columns} columns, {linear.counts.total()} operations",
        n_columns=linear.n_columns,
        width=own.width,
        n_shared=linear.n_shared,
        n_sensitive=own.first,
        reads_own=any("OWN(" in line for rows in text.written for line in rows),
        places=[] if own.is_whole else wrapped(map(str, chain.from_iterable(own.places))),
        n_own=own.n_rows,
        n_results=len(linear.results),
        block=BLOCK,
        functions=text.functions,
        lines=text.lines,
        n_crossing=text.n_crossing,
        n_together=text.n_together,
        n_guards=n_guards,
        live=["".join(f"{bit}, " for bit in row).strip() for row in rows],
    )


def constant_columns(node: Node, name: str) -> ConstantColumns | None:
    """Write the values that columns do not share as a table; None where one must be computed."""
    rows = own_rows(node)
    values = rows.values(node)
    if any(value.value is None for value in values.values()):
        return None
    items = [f"[{i}] = {literal(value.value or 0.0)}" for i, value in sorted(values.items())]
    return ConstantColumns(name, rows.length, wrapped(items or ["0.0"]))


def _is_waiting(linear: LinearMap) -> bool:
    """Tell whether the longest path of one vector takes longer than starting all operations."""
    started, longest = bounds(linear.statements)
    return longest > started and len(linear.statements) > _FEWEST_IN_TURN


def _in_segments(own: OwnRows, name: str) -> _Text:
    """Write statements with many zeros as segments, each run only where it is not all zero."""
    linear = own.linear
    longest, together = (_LONGEST_IN_TURN, 2) if _is_waiting(linear) else (_LONGEST_BLOCK, 1)
    cut = cut_into_segments(linear, longest)
    parts = [_read_own(own, _tell_apart(part, own.first)) for part in cut.parts]
    if len(parts) == 1:
        return _Text([], parts[0], cut.live, cut.n_crossing)
    given = {}
    if together > 1:
        n_results = len(linear.results)
        sizes = {"column": own.first, "w": cut.n_crossing, "result": n_results}
        given = {key: f"OF({key}, {size})" for key, size in sizes.items()} | {
            "here": "HERE(turn)",
            "at": "AT(turn)",
            "live": "LIVE_OF(turn)",
        }
    pairs = [_function(f"{name}_{i}", part, given) for i, part in enumerate(parts, 1)]
    functions, calls = [function for function, _ in pairs], [call for _, call in pairs]
    return _Text(functions, calls, cut.live, cut.n_crossing, together)


def _in_blocks(own: OwnRows, name: str) -> _Text:
    """Write statements that are run for all columns, repeated ones as loops."""
    linear = own.linear
    printed = print_nodes(linear.results, {}, {}, by_need(linear.order), has_groups=False)
    lines = printed.lines + [
        f"result[{i}] = {'ZERO' if root.is_zero else value};"
        for i, (root, value) in enumerate(zip(linear.results, printed.values, strict=True))
    ]
    rolled = roll(_tell_apart(lines, own.first))
    lines = [line.replace("double v", "VECTOR v", 1) for line in rolled]
    cut = cut_into_blocks(
        f"NAMED({name}_{{}})",
        _read_own(own, lines),
        {key: head for key, head in _ARGUMENTS.items() if key != "w"},  # blocks have their own
        ("result",),
        _LONGEST_BLOCK,
        _HEAD,
    )
    return _Text(cut.functions, cut.lines, [], 0)


def _tell_apart(lines: Sequence[str], n_sensitive: int) -> list[str]:
    """Rename inputs that are neither shared nor sensitivities, so that no loop reads both."""

    def named(found: re.Match[str]) -> str:
        i = int(found[1])
        return found[0] if i < n_sensitive else f"own[{i - n_sensitive}]"

    return [_COLUMN.sub(named, line) for line in lines]


def _read_own(own: OwnRows, lines: Sequence[str]) -> list[str]:
    """Replace such inputs by reads from their rows."""

    def read(found: re.Match[str]) -> str:
        place = found[1]
        if not own.is_whole:
            return f"OWN(here, at[{place}])"
        whole = own.width * int(place) if place.isdigit() else f"{own.width} * ({place})"
        return f"OWN(here, {whole})"

    return [_OWN.sub(read, line) for line in lines]


def _function(name: str, lines: Sequence[str], given: Mapping[str, str]) -> tuple[Block, str]:
    """Write a function that runs some statements, and its call: one for each vector, if given."""
    names = {found for line in lines for found in NAME.findall(line)}
    used = [key for key in _ARGUMENTS if key in names]
    signature = function_head(_HEAD, f"NAMED({name})", [_ARGUMENTS[key] for key in used])
    call = f"NAMED({name})({', '.join(given.get(key, key) for key in used)});"
    return Block(signature, list(lines)), f"IN_TURN {call}" if given else call
