"""Maps of many columns to C: the statements of one column, which a vector holds several of."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from cotree.codegen.blocks import Block, cut_into_blocks
from cotree.codegen.c_statements import count_written
from cotree.codegen.loops import roll
from cotree.codegen.printer_c import padded, print_nodes
from cotree.codegen.stack import n_bytes

if TYPE_CHECKING:
    from cotree.dag.linear_map import LinearMap
    from cotree.dag.nodes import Node

#: Operations of a block of statements at most. Measured with gcc 12 on a map of 2261: 500 compile
#: with a third of the instructions, and four numbers at a time run a fifth faster.
_LONGEST_BLOCK = 500

#: What statements of a map read and write: of all columns, and of those in a vector.
_ARGUMENTS = {
    "shared": "const double *COTREE_RESTRICT shared",
    "column": "const VECTOR *COTREE_RESTRICT column",
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
    width: int
    lines: list[str]
    blocks: list[Block]  # none where it is not cut

    @property
    def n_stack(self) -> int:
        """Bytes of the stack that it takes at most."""
        n = self.n_sensitive + self.n_own + self.n_results
        return n_bytes([f"VECTOR column[{n}];", *self.lines], self.blocks, {})

    @cached_property
    def written(self) -> list[int]:
        """How many operations stand in each of its functions."""
        return [count_written(rows) for rows in (self.lines, *(b.lines for b in self.blocks))]


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
    n = linear.n_sensitive(node.args)
    printed = print_nodes(linear.results, {}, {}, linear.order)
    lines = printed.lines + [
        f"result[{i}] = {'ZERO' if root.is_zero else value};"
        for i, (root, value) in enumerate(zip(linear.results, printed.values, strict=True))
    ]
    lines = [line.replace("double v", "VECTOR v", 1) for line in roll(lines)]
    cut = cut_into_blocks(
        f"NAMED({name}_{{}})",
        lines,
        _ARGUMENTS,
        ("result",),
        _LONGEST_BLOCK,
        "TARGET COTREE_APART static void",
    )
    return MapContext(
        name=name,
        doc=f"{linear.n_columns} columns, {linear.counts.total()} operations each",
        n_columns=linear.n_columns,
        n_shared=linear.n_shared,
        n_sensitive=n,
        n_own=linear.n_inputs - n,
        n_results=len(linear.results),
        width=padded(linear.n_columns),
        lines=cut.lines,
        blocks=cut.functions,
    )
