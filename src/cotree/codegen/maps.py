"""Maps of many columns to C: the statements of one column, which a vector holds several of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.codegen.loops import roll
from cotree.codegen.printer_c import padded, print_nodes
from cotree.program.machine import by_need

if TYPE_CHECKING:
    from cotree.dag.linear_map import LinearMap
    from cotree.dag.nodes import Node


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
    n_written: int
    lines: list[str]


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
    printed = print_nodes(linear.results, {}, {}, by_need(linear.order), has_groups=False)
    lines = printed.lines + [
        f"result[{i}] = {'ZERO' if root.is_zero else value};"
        for i, (root, value) in enumerate(zip(linear.results, printed.values, strict=True))
    ]
    return MapContext(
        name=name,
        doc=f"{linear.n_columns} columns, {linear.counts.total()} operations each",
        n_columns=linear.n_columns,
        n_shared=linear.n_shared,
        n_sensitive=n,
        n_own=linear.n_inputs - n,
        n_results=len(linear.results),
        width=padded(linear.n_columns),
        n_written=linear.counts.total(),
        lines=[line.replace("double v", "VECTOR v", 1) for line in roll(lines)],
    )
