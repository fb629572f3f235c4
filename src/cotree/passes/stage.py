"""Pass: stage. What depends on parameters only moves to ``prepare``.

Assumes that ``prepare`` is empty. Guarantees that no kernel but ``prepare`` computes a value of
parameters only: each reads it as a prepared value.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from cotree.dag.traverse import dependent, substitute

if TYPE_CHECKING:
    from cotree.dag.nodes import Node
    from cotree.program import Kernel, Program


def stage_parameters(program: Program) -> Program:
    """Move values of parameters only to ``prepare``."""
    staged: dict[Node, Node] = {}
    for kernel in program.kernels.values():
        for node in _frontier(kernel):
            if node not in staged:
                staged[node] = program.dag.symbol("k", len(staged))
    kernels = {
        name: replace(kernel, results=tuple(substitute(kernel.results, staged)))
        for name, kernel in program.kernels.items()
    }
    kernels["prepare"] = replace(kernels["prepare"], results=tuple(staged))
    return replace(program, kernels=kernels)


def _frontier(kernel: Kernel) -> list[Node]:
    """List the values of parameters only that values of other things, or results, read."""
    order = kernel.order
    varying = dependent(
        order, [node for node in order if node.op == "symbol" and node.data[0] != "p"]
    )
    read = {arg for node in order if node in varying for arg in node.args}
    read.update(kernel.results)
    return [node for node in order if node in read and node not in varying and node.args]
