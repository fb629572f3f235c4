"""From nodes to SymPy: how equations leave the program for people.

In: nodes and the SymPy expression of each symbol. Out: SymPy expressions, shared where the nodes
are. Nothing is simplified beyond what SymPy does as it builds an expression.
"""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any

from cotree.dag.traverse import reachable

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cotree.dag.nodes import Node

_LARGEST_DENOMINATOR = 10**6
_LARGEST_NUMERATOR = 10**15  # beyond it a double's own digits say nothing to a reader

#: SymPy's names, where they differ from ours.
_SYMPY_NAMES = {"abs": "Abs"}


def to_sympy(nodes: Sequence[Node], symbols: Mapping[Node, Any]) -> list[Any]:
    """Turn nodes into SymPy expressions.

    Parameters
    ----------
    nodes : sequence of Node
        The values wanted.
    symbols : mapping of Node to sympy.Expr
        The expression of each symbol; other nodes may be replaced, too.

    Returns
    -------
    list of sympy.Expr
        One for each node. A node with several results becomes the application of an undefined
        function: ``table_1(t)``, ``solve_1_x_1(...)``, ``name_1(...)``.

    Raises
    ------
    KeyError
        If a symbol has nothing to stand for it.
    """
    known: dict[Node, Any] = {}
    numbers: dict[Any, int] = {}
    for node in reachable(nodes, stop=symbols):
        if node in symbols:
            known[node] = symbols[node]
        elif node.value is not None:
            known[node] = rational(node.value)
        elif node.op == "symbol":
            raise KeyError(f"no SymPy symbol is given for {node!r}")
        elif node.op == "result":
            known[node] = _result(node, [known[arg] for arg in _arguments(node)], numbers)
        # A node with several results has no expression; each of its results does.
        elif node.op not in _SEVERAL:
            known[node] = _apply(node.op, [known[arg] for arg in node.args])
    return [known[node] for node in nodes]


def rational(value: float) -> Any:
    """Give the simplest rational number that reads back as the same double, or the double.

    Parameters
    ----------
    value : float
        A finite number.

    Examples
    --------
    >>> rational(1.0 / 12.0), rational(9.81)
    (1/12, 981/100)
    """
    import sympy

    # People write 1/12, not 0.08333333333333333; only a fraction that is the same double is taken.
    fraction = Fraction(value).limit_denominator(_LARGEST_DENOMINATOR)
    if float(fraction) == value and abs(fraction.numerator) <= _LARGEST_NUMERATOR:
        return sympy.Rational(fraction.numerator, fraction.denominator)
    return sympy.Float(value)


#: Operations that are written with signs, of numbers or expressions.
ARITHMETIC: dict[str, Callable[..., Any]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "neg": lambda a: -a,
    "pow": lambda a, b: a**b,
}


def _apply(op: str, args: list[Any]) -> Any:
    """Apply one operation of :data:`cotree.dag.operations.OPERATIONS`."""
    import sympy

    if op in ARITHMETIC:
        return ARITHMETIC[op](*args)
    if op == "select":
        # The second branch must be unconditional, or SymPy returns nan outside the first.
        condition, accepted, refused = args
        return sympy.Piecewise((accepted, condition >= 0), (refused, True))
    return getattr(sympy, _SYMPY_NAMES.get(op, op))(*args)


def _solve_name(node: Node, position: int) -> str:
    size = node.data.size
    if position < size:
        return f"x_{position + 1}"
    return "rank" if position == size else "is_determined"


def _table_name(_: Node, position: int) -> str:
    return "slope" if position else ""


def _lookup_name(node: Node, position: int) -> str:
    return str(node.data.results[position])


def _call_name(_: Node, position: int) -> str:
    return str(position + 1)


#: Names of the results of nodes that have several.
_SEVERAL: dict[str, Callable[[Node, int], str]] = {
    "solve": _solve_name,
    "table": _table_name,
    "lookup": _lookup_name,
    "call": _call_name,
}


def _arguments(node: Node) -> tuple[Node, ...]:
    """List what a result depends on; how a system decides its rank says nothing to a reader."""
    source = node.args[0]
    if source.op != "solve":
        return source.args
    size = source.data.size
    # Coefficients and right-hand side.
    return source.args[: size * (size + 1)]


def _result(node: Node, args: list[Any], numbers: dict[Any, int]) -> Any:
    """Apply an undefined function for one result of a node that has several."""
    import sympy

    source = node.args[0]
    # Systems are told apart by their arguments, tables and functions by what they are.
    key = (source.op, source if source.op == "solve" else source.data)
    if key not in numbers:
        # Each kind is numbered from one, in order of evaluation.
        numbers[key] = 1 + sum(op == source.op for op, _ in numbers)
    own = source.data.name if source.op == "call" else f"{source.op}_{numbers[key]}"
    suffix = _SEVERAL[source.op](source, node.data)
    return sympy.Function(f"{own}_{suffix}" if suffix else own, real=True)(*args)
