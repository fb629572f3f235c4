"""Pass: divide once. Divisions by one value become products with its reciprocal.

Assumes nothing. Guarantees the same values to rounding. A reciprocal is formed where a kernel
divides by the same value more than once, or by a value of parameters only, whose reciprocal
``prepare`` then forms once for all calls. Other divisions stay.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from cotree.passes.rewriting import for_each_kernel, rewrite
from cotree.passes.stage import varying_values

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.dag.nodes import Node
    from cotree.program import Kernel, Program


def share_reciprocals(program: Program) -> Program:
    """Replace repeated divisions by products with a reciprocal."""
    return for_each_kernel(program, with_reciprocals)


def with_reciprocals(kernel: Kernel) -> Kernel:
    """Replace the repeated divisions of one kernel."""
    order = kernel.order
    # Reciprocals themselves are left alone.
    divisions = [n for n in order if n.op == "div" and n.args[0] is not n.dag.one]
    if not divisions:
        return kernel
    varying = varying_values(order)
    times = Counter(node.args[1] for node in divisions)
    shared = {
        node
        for node in divisions
        if times[node.args[1]] > 1 or (node.args[1] not in varying and node in varying)
    }

    def form(node: Node, new: Mapping[Node, Node]) -> Node:
        above, below = (new.get(arg, arg) for arg in node.args)
        # Nodes are interned, so that this reciprocal is formed once for all divisions.
        return above * (1.0 / below)

    return rewrite(kernel, shared, form)
