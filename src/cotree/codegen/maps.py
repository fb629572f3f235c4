"""Maps of many columns to C: the statements of one column, which a vector holds several of."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.codegen.blocks import Block
from cotree.codegen.c_statements import NAME, count_written
from cotree.codegen.heads import function_head
from cotree.codegen.loops import roll
from cotree.codegen.printer_c import padded, print_nodes
from cotree.codegen.segments import Segments, cut_into_segments
from cotree.dag.linear_map import BLOCK
from cotree.program.machine import by_need

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.dag.linear_map import LinearMap
    from cotree.dag.nodes import Node

#: Segments leave out at least this share of the work, or loops are looked for in place of them.
_SKIPPED = 0.15

_COLUMN = re.compile(r"\bcolumn\[(\d+)\]")
#: What statements name, as a function gets it.
_ARGUMENTS = {
    "shared": "const double *COTREE_RESTRICT shared",
    "column": "const VECTOR *COTREE_RESTRICT column",
    "OWN": "const double *here",
    "LIVE": "const unsigned char *live",
    "w": "VECTOR *COTREE_RESTRICT w",
    "result": "VECTOR *COTREE_RESTRICT result",
}


@dataclass(frozen=True)
class MapContext:
    """One map."""

    name: str
    doc: str
    n_columns: int
    n_shared: int
    n_sensitive: int
    n_own: int
    n_results: int
    block: int
    n_written: int
    functions: list[Block]  # none where it is not cut
    lines: list[str]
    n_crossing: int
    n_guards: int
    live: list[str]  # for each block of columns, which guarded segments are run


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
    n, width, cut = linear.n_sensitive(node.args), padded(linear.n_columns), _written(linear)
    n_guards = len(cut.live[0]) if cut.live else 0

    def input_read(found: re.Match[str]) -> str:
        i = int(found[1])
        return found[0] if i < n else f"OWN({width * (i - n)})"

    parts = [[_COLUMN.sub(input_read, line) for line in part] for part in cut.parts]
    lines, functions = parts[0], []
    if len(parts) > 1:
        pairs = [_function(f"{name}_{i}", part) for i, part in enumerate(parts, 1)]
        functions, lines = [function for function, _ in pairs], [call for _, call in pairs]
    # Vectors wider than a block read two rows.
    rows = [*cut.live, *([[0] * n_guards] * (len(cut.live) % 2))]
    return MapContext(
        name=name,
        doc=f"{linear.n_columns} columns, {linear.counts.total()} operations",
        n_columns=linear.n_columns,
        n_shared=linear.n_shared,
        n_sensitive=n,
        n_own=linear.n_inputs - n,
        n_results=len(linear.results),
        block=BLOCK,
        n_written=max(count_written(part) for part in parts),
        functions=functions,
        lines=lines,
        n_crossing=cut.n_crossing,
        n_guards=n_guards,
        live=["".join(f"{bit}, " for bit in row).strip() for row in rows],
    )


def _written(linear: LinearMap) -> Segments:
    """Write the statements, as segments where much vanishes."""
    n_blocks = -(-linear.n_columns // BLOCK)
    if linear.n_times < (1.0 - _SKIPPED) * n_blocks * len(linear.statements):
        return cut_into_segments(linear)
    printed = print_nodes(linear.results, {}, {}, by_need(linear.order), has_groups=False)
    lines = printed.lines + [
        f"result[{i}] = {'ZERO' if root.is_zero else value};"
        for i, (root, value) in enumerate(zip(linear.results, printed.values, strict=True))
    ]
    return Segments([[line.replace("double v", "VECTOR v", 1) for line in roll(lines)]], [], 0)


def _function(name: str, lines: Sequence[str]) -> tuple[Block, str]:
    """Write a function that runs some statements, and its call."""
    names = {found for line in lines for found in NAME.findall(line)}
    used = [key for key in _ARGUMENTS if key in names]
    heads = [_ARGUMENTS[key] for key in used]
    signature = function_head("TARGET COTREE_APART static void", f"NAMED({name})", heads)
    passed = ", ".join(re.split(r"\W", head)[-1] for head in heads)
    return Block(signature, list(lines)), f"NAMED({name})({passed});"
