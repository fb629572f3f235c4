"""Evaluation of nodes in Python for floats, complex numbers or arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from cotree.dag.multi_output import SEVERAL
from cotree.dag.nodes import PIECE, reachable
from cotree.dag.operations import OPERATIONS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Node

Numbers = Literal["real", "complex_", "array"]


def evaluate(
    roots: Sequence[Node],
    values: Mapping[Node, Any],
    numbers: Numbers = "real",
    order: Sequence[Node] | None = None,
) -> list[Any]:
    """Return the values of the roots; ``values`` has the values of symbols and other known nodes.

    ``numbers`` is 'real', or 'complex_' for complex steps, in which real parts select branches.
    ``order`` is the result of :func:`~cotree.dag.nodes.reachable`, if known. Raise KeyError if a
    symbol has no value, and ArithmeticError or ValueError if an operation on complex numbers is
    undefined; operations on floats return infinities and nan, as in C.
    """
    # A local table is faster than an attribute of each row: kernels have thousands of nodes.
    functions = {name: getattr(row, numbers) for name, row in OPERATIONS.items()}
    known: dict[Node, Any] = {}
    # Nodes with known values are not expanded, so their arguments need no values.
    for node in reachable(roots, stop=values) if order is None else order:
        op = node.op
        # Any node may be in ``values``, not only symbols.
        if node in values:
            known[node] = values[node]
        elif op == "constant":
            known[node] = node.value
        elif op == "symbol":
            if node.data[0] != PIECE:
                raise KeyError(node.data)
            known[node] = 0.0  # zero means that the branch is not frozen
        elif op == "result":
            known[node] = known[node.args[0]][node.data]
        elif op in SEVERAL:
            known[node] = SEVERAL[op].evaluate(node.data, [known[arg] for arg in node.args])
        else:
            known[node] = functions[op](*[known[arg] for arg in node.args])
    return [known[root] for root in roots]
