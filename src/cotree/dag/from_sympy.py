"""From SymPy to nodes: component laws enter here."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.dag.nodes import Dag, Node

_FUNCTIONS = {
    **{name: name for name in ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh")},
    **{"tanh": "tanh", "exp": "exp", "log": "log", "Abs": "abs", "sign": "sign", "atan2": "atan2"},
    "floor": "floor",
}


def from_sympy(expression: Any, dag: Dag, arguments: Mapping[str, Node]) -> Node:
    """Turn a SymPy expression into a node.

    Parameters
    ----------
    expression : sympy.Expr
        A law, or a derivative of one.
    dag : Dag
        The arena to make it in.
    arguments : mapping of str to Node
        The node of each symbol, by name.

    Raises
    ------
    ValueError
        If the expression holds a function that the program has no operation for, or a symbol
        without a node.
    """
    if expression.is_Symbol:
        if expression.name not in arguments:
            raise ValueError(f"the law uses '{expression.name}', which is not one of its arguments")
        return arguments[expression.name]
    if expression.is_number:
        return dag.constant(float(expression))
    name = type(expression).__name__
    if name == "Piecewise":
        return _piecewise(expression, dag, arguments)
    args = [from_sympy(arg, dag, arguments) for arg in expression.args]
    if expression.is_Add:
        return _sum(args)
    if expression.is_Mul:
        return _product(expression, args, dag)
    if expression.is_Pow:
        return args[0] ** args[1]
    if name == "Heaviside":  # the derivative of Max and Min
        return dag.select(args[0], dag.one, dag.zero)
    if name in ("Max", "Min"):
        return _extreme(name, args, dag)
    if name not in _FUNCTIONS:
        raise ValueError(f"the law uses the function '{name}', which cotree has no operation for")
    return dag.function(_FUNCTIONS[name], *args)


def _sum(args: list[Node]) -> Node:
    total = args[0]
    for arg in args[1:]:
        total = total + arg
    return total


def _product(expression: Any, args: list[Node], dag: Dag) -> Node:
    """Multiply, dividing by what has a negative integer power instead of inverting it."""
    above, below = dag.one, dag.one
    for factor, arg in zip(expression.args, args, strict=True):
        if factor.is_Pow and factor.exp == -1:
            below = below * arg.args[1] if arg.op == "div" else below / arg
        else:
            above = above * arg
    return above / below


def _extreme(name: str, args: list[Node], dag: Dag) -> Node:
    best = args[0]
    for arg in args[1:]:
        difference = arg - best if name == "Max" else best - arg
        best = dag.select(difference, arg, best)
    return best


def _piecewise(expression: Any, dag: Dag, arguments: Mapping[str, Node]) -> Node:
    """Turn branches on comparisons into selections, last branch first."""
    import sympy

    pairs = list(expression.args)
    value, condition = pairs[-1]
    if condition is not sympy.true:
        raise ValueError("the last branch of a Piecewise must hold everywhere else")
    result = from_sympy(value, dag, arguments)
    for value, condition in reversed(pairs[:-1]):
        branch = from_sympy(value, dag, arguments)
        result = _choice(condition, branch, result, dag, arguments)
    return result


def _choice(
    condition: Any, accepted: Node, refused: Node, dag: Dag, arguments: Mapping[str, Node]
) -> Node:
    """Select by a comparison, or by several that SymPy has joined."""
    import sympy

    if isinstance(condition, sympy.Or):
        for part in reversed(condition.args):
            refused = _choice(part, accepted, refused, dag, arguments)
        return refused
    if isinstance(condition, sympy.And):
        for part in reversed(condition.args):
            accepted = _choice(part, accepted, refused, dag, arguments)
        return accepted
    if isinstance(condition, sympy.Not):
        return _choice(condition.args[0], refused, accepted, dag, arguments)
    if not isinstance(condition, (sympy.Ge, sympy.Gt, sympy.Le, sympy.Lt)):
        raise ValueError("a Piecewise may only branch on <, <=, > or >=")
    difference = from_sympy(condition.gts - condition.lts, dag, arguments)
    if isinstance(condition, (sympy.Gt, sympy.Lt)):  # strict: refuse equality
        return dag.select(-difference, refused, accepted)
    return dag.select(difference, accepted, refused)
