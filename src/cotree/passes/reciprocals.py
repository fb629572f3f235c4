"""Pass: divide once. Divisions by one value become products with its reciprocal.

Assumes nothing. Guarantees the same values to rounding. A reciprocal is formed where a kernel
divides by the same value more than once, or by a value of parameters only, whose reciprocal
``prepare`` then forms once for all calls. Other divisions stay.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

from cotree.passes.stage import varying_values

if TYPE_CHECKING:
    from cotree.dag.nodes import Node
    from cotree.program import Kernel, Program


def share_reciprocals(program: Program) -> Program:
    """Replace repeated divisions by products with a reciprocal."""
    kernels = {name: _rewrite(kernel) for name, kernel in program.kernels.items()}
    return replace(program, kernels=kernels)


def _rewrite(kernel: Kernel) -> Kernel:
    order = kernel.order
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
    new: dict[Node, Node] = {}
    for node in order:
        is_shared = node in shared
        if not is_shared and new.keys().isdisjoint(node.args):
            continue
        args = tuple([new.get(arg, arg) for arg in node.args])
        with node.dag.labelled(node.section):
            new[node] = args[0] * (1.0 / args[1]) if is_shared else node.dag.rebuild(node, args)
    results = tuple(new.get(node, node) for node in kernel.results)
    return replace(kernel, results=results)
