"""Evaluation of nodes in Python: on floats, complex numbers or arrays."""

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
    """Evaluate nodes.

    Parameters
    ----------
    roots : sequence of Node
        The nodes to evaluate.
    values : mapping of Node to number
        The symbols' values; other nodes may be given too, and are then not computed.
    numbers : {'real', 'complex_', 'array'}
        Kind of the values; 'complex_' follows the real part at every branch, for the complex step.
    order : sequence of Node, optional
        :func:`~cotree.dag.nodes.reachable` of the roots, where it is known already.

    Returns
    -------
    list
        The values of the roots.

    Raises
    ------
    KeyError
        If a symbol has no value.
    ArithmeticError, ValueError
        If an operation on complex numbers is undefined at these values. Those on floats give
        infinities and nan, as C does.
    """
    # Looked up once, since kernels have thousands of nodes.
    functions = {name: getattr(row, numbers) for name, row in OPERATIONS.items()}
    known: dict[Node, Any] = {}
    # Nothing that a given value depends on is computed.
    for node in reachable(roots, stop=values) if order is None else order:
        op = node.op
        # A given value may be any node, so it is looked up before the operation is evaluated.
        if node in values:
            known[node] = values[node]
        elif op == "constant":
            known[node] = node.value
        elif op == "symbol":
            if node.data[0] != PIECE:
                raise KeyError(node.data)
            known[node] = 0.0  # the flags of frozen branches are zero: no branch is frozen
        elif op == "result":
            known[node] = known[node.args[0]][node.data]
        elif op in SEVERAL:
            known[node] = SEVERAL[op].evaluate(node.data, [known[arg] for arg in node.args])
        else:
            known[node] = functions[op](*[known[arg] for arg in node.args])
    return [known[root] for root in roots]
