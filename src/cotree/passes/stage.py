"""Pass: stage. What depends on parameters only moves to ``prepare``.

Assumes that nothing is prepared yet. Guarantees that no kernel but ``prepare`` computes a value of
parameters only: each reads it as a prepared value. Pieces that steps hold stand behind these, and
are zero until someone holds them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from cotree.dag.multi_output import SEVERAL
from cotree.dag.symbols import PARAMETER, PIECE
from cotree.dag.traverse import dependent, reachable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.dag.nodes import Node
    from cotree.program import Program


def stage_parameters(program: Program) -> Program:
    """Move values of parameters only to ``prepare``."""
    # Over all kernels at once, so that a value that several of them read is prepared once.
    results = [node for kernel in program.kernels.values() for node in kernel.results]
    dag, n_pieces = program.dag, program.layout.n_pieces
    frontier = _frontier(results)
    pieces = [dag.symbol(PIECE, i) for i in range(n_pieces)]
    prepared = {node: i for i, node in enumerate([*frontier, *pieces])}
    kernels = {name: replace(kernel, prepared=prepared) for name, kernel in program.kernels.items()}
    kernels["prepare"] = replace(
        kernels["prepare"], results=(*frontier, *[dag.zero] * n_pieces), prepared={}
    )
    return replace(program, kernels=kernels)


def varying_values(order: Sequence[Node]) -> set[Node]:
    """Give what depends on more than parameters, among values in order of evaluation."""
    return dependent(order, [n for n in order if n.op == "symbol" and n.data[0] != PARAMETER])


def _frontier(results: list[Node]) -> list[Node]:
    """List the values of parameters only that values of other things, or results, read."""
    order = reachable(results)
    varying = varying_values(order)
    read = {arg for node in order if node in varying for arg in node.args}
    read.update(results)
    return [
        # Kernels read the results of a node with several, never the node itself.
        node
        for node in order
        if node in read and node not in varying and node.args and node.op not in SEVERAL
    ]
