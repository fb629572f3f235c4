"""Conversion of SymPy expressions, such as component laws, to nodes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache, reduce
from operator import add
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cotree.dag.nodes import Dag, Node

#: Function that forms the node of an expression from the nodes of its symbols.
_Maker = Callable[["Dag", Mapping[str, "Node"]], "Node"]
_Chooser = Callable[["Dag", Mapping[str, "Node"], "Node", "Node"], "Node"]

_FUNCTIONS = {
    **{name: name for name in ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh")},
    **{"tanh": "tanh", "exp": "exp", "log": "log", "Abs": "abs", "sign": "sign", "atan2": "atan2"},
    **{"floor": "floor", "erf": "erf"},
}


def from_sympy(expression: Any, dag: Dag, arguments: Mapping[str, Node]) -> Node:
    """Return a SymPy expression, a law or its derivative, as a node.

    ``arguments`` maps its symbols to nodes. Raise ValueError if the expression contains another
    symbol, or a function without a corresponding operation.
    """
    return _maker(expression)(dag, arguments)


@lru_cache(maxsize=4096)
def _maker(expression: Any) -> _Maker:
    """Return a function that forms the node of an expression; edges with equal laws share it."""
    if expression.is_Symbol:
        return _symbol(expression.name)
    if expression.is_number:
        value = float(expression)
        return lambda dag, arguments: dag.constant(value)
    name = type(expression).__name__
    if name == "Piecewise":
        return _piecewise(expression)
    parts = [_maker(arg) for arg in expression.args]
    if expression.is_Add:
        return lambda dag, arguments: reduce(add, [part(dag, arguments) for part in parts])
    if expression.is_Mul:
        # SymPy stores a/b as a*b**-1. Restore the division: it rounds once, the product twice.
        inverted = [factor.is_Pow and factor.exp == -1 for factor in expression.args]
        return lambda dag, arguments: _product(
            dag, inverted, [part(dag, arguments) for part in parts]
        )
    if expression.is_Pow:
        base, exponent = parts
        return lambda dag, arguments: base(dag, arguments) ** exponent(dag, arguments)
    if name == "Heaviside":  # SymPy writes derivatives of Max and Min with Heaviside
        return lambda dag, arguments: dag.select(parts[0](dag, arguments), dag.one, dag.zero)
    if name == "ceiling":
        return lambda dag, arguments: -dag.function("floor", -parts[0](dag, arguments))
    if name == "Mod":
        return lambda dag, arguments: _remainder(*[part(dag, arguments) for part in parts])
    if name in ("Max", "Min"):
        return lambda dag, arguments: _extreme(name, [part(dag, arguments) for part in parts], dag)
    if name not in _FUNCTIONS:
        raise ValueError(f"the law uses the function '{name}', which is not supported")
    function = _FUNCTIONS[name]
    return lambda dag, arguments: dag.function(function, *[part(dag, arguments) for part in parts])


def _symbol(name: str) -> _Maker:
    def make(dag: Dag, arguments: Mapping[str, Node]) -> Node:
        if name not in arguments:
            raise ValueError(f"the law uses '{name}', which is not one of its arguments")
        return arguments[name]

    return make


def _product(dag: Dag, inverted: list[bool], args: list[Node]) -> Node:
    """Return a product; factors with negative integer powers become divisors."""
    above, below = dag.one, dag.one
    for is_inverted, arg in zip(inverted, args, strict=True):
        if is_inverted:
            # x**-1 was formed as 1/x: divide by x. A folded constant is no division node.
            below = below * arg.args[1] if arg.op == "div" else below / arg
        else:
            above = above * arg
    return above / below


def _remainder(a: Node, b: Node) -> Node:
    # In SymPy and Python, the remainder has the sign of b; in C, fmod has the sign of a.
    return a - b * a.dag.function("floor", a / b)


def _extreme(name: str, args: list[Node], dag: Dag) -> Node:
    best = args[0]
    for arg in args[1:]:
        difference = arg - best if name == "Max" else best - arg
        best = dag.select(difference, arg, best)
    return best


def _piecewise(expression: Any) -> _Maker:
    """Convert a piecewise expression to nested selections; its conditions must be comparisons."""
    import sympy

    pairs = list(expression.args)
    value, condition = pairs[-1]
    if condition is not sympy.true:
        raise ValueError(
            "the law has a Piecewise without a default branch: end it with (value, True)"
        )
    # The first true condition applies, so selections are nested from the last branch backwards.
    last = _maker(value)
    branches = [(_maker(value), _chooser(condition)) for value, condition in reversed(pairs[:-1])]

    def make(dag: Dag, arguments: Mapping[str, Node]) -> Node:
        result = last(dag, arguments)
        for value, choose in branches:
            result = choose(dag, arguments, value(dag, arguments), result)
        return result

    return make


def _chooser(condition: Any) -> _Chooser:
    """Return a function that selects between two nodes by a comparison or logical expression."""
    import sympy

    if isinstance(condition, (sympy.Or, sympy.And)):
        return _joined([_chooser(part) for part in condition.args], isinstance(condition, sympy.Or))
    if isinstance(condition, sympy.Not):
        inner = _chooser(condition.args[0])
        return lambda dag, arguments, accepted, refused: inner(dag, arguments, refused, accepted)
    if not isinstance(condition, (sympy.Ge, sympy.Gt, sympy.Le, sympy.Lt)):
        raise ValueError("the law has a condition that is not a comparison by <, <=, > or >=")
    # A selection tests for >= 0, so a >= b becomes a - b >= 0.
    excess = _maker(condition.gts - condition.lts)
    if isinstance(condition, (sympy.Gt, sympy.Lt)):  # strict comparison: false at equality
        return lambda dag, arguments, accepted, refused: dag.select(
            -excess(dag, arguments), refused, accepted
        )
    return lambda dag, arguments, accepted, refused: dag.select(
        excess(dag, arguments), accepted, refused
    )


def _joined(parts: list[_Chooser], is_any: bool) -> _Chooser:
    # Selections are nested: the second condition of "or" is in the false branch of the first one,
    # the second condition of "and" in the true branch.
    def choose(dag: Dag, arguments: Mapping[str, Node], accepted: Node, refused: Node) -> Node:
        for part in reversed(parts):
            if is_any:
                refused = part(dag, arguments, accepted, refused)
            else:
                accepted = part(dag, arguments, accepted, refused)
        return refused if is_any else accepted

    return choose
