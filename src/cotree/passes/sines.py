"""Pass: sines together. Sines and cosines of several angles become one node, which C vectorises.

Assumes nothing. Guarantees the same values to a rounding of the last place. Taken together are
angles that depend on no sine themselves; those of parameters only stay, since ``prepare`` has them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from cotree.dag.multi_output import sines
from cotree.dag.traverse import dependent
from cotree.passes.stage import varying_values

if TYPE_CHECKING:
    from cotree.dag.nodes import Node
    from cotree.program import Kernel, Program

#: Fewer angles than these cost less one by one.
_FEWEST = 3


def pack_sines(program: Program) -> Program:
    """Take the sines and cosines of each kernel together."""
    kernels = {name: _rewrite(kernel) for name, kernel in program.kernels.items()}
    return replace(program, kernels=kernels)


def _rewrite(kernel: Kernel) -> Kernel:
    order = kernel.order
    found = [node for node in order if node.op in ("sin", "cos")]
    varying = varying_values(order)
    late = dependent(order, found) - set(found)
    angles = list(
        dict.fromkeys(n.args[0] for n in found if n.args[0] in varying and n.args[0] not in late)
    )
    if len(angles) < _FEWEST:
        return kernel
    dag = angles[0].dag
    with dag.labelled("sines and cosines"):
        packed = sines(dag, angles)
    place = {angle: i for i, angle in enumerate(angles)}
    new: dict[Node, Node] = {}
    for node in found:
        if node.args[0] in place:
            first = place[node.args[0]]
            new[node] = packed[first if node.op == "sin" else len(angles) + first]
    for node in order:
        if node in new or new.keys().isdisjoint(node.args):
            continue
        with dag.labelled(node.section):
            new[node] = dag.rebuild(node, tuple([new.get(arg, arg) for arg in node.args]))
    return replace(kernel, results=tuple(new.get(node, node) for node in kernel.results))
