"""PEtab's formulas, version 1, as expressions of scenes: rewritten as trees, never evaluated.

PEtab writes ``a^b``, ``ln(x)``, ``log10(x)``, ``piecewise(value, condition, ..., otherwise)`` and
``&&`` where scenes write ``a**b``, ``log(x)``, ``log(x)/log(10)``, ``where(condition, value,
otherwise)`` and ``and``. The result is checked against the grammar of scenes.
"""

from __future__ import annotations

import ast
import re
from typing import TYPE_CHECKING

from cotree.dag.nodes import Dag
from cotree.errors import ExpressionError, brief
from cotree.scene.expressions import parse
from cotree.scene.words import read_tree

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.dag.nodes import Node

_LONGEST = 4000  # characters, the limit of expressions in scenes

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)|(?P<name>[A-Za-z_][A-Za-z0-9_]*)"
    r"|(?P<sign>&&|\|\||[<>=!]=|\*\*|[-+*/^()<>,!]))"
)

# PEtab's functions in terms of those of scenes; ``{0}`` is the argument.
_AS = {
    "ln": "log({0})",
    "log10": "log({0})/2.302585092994046",
    "log2": "log({0})/0.6931471805599453",
    "sec": "1/cos({0})",
    "csc": "1/sin({0})",
    "cot": "1/tan({0})",
    "sech": "1/cosh({0})",
    "csch": "1/sinh({0})",
    "coth": "1/tanh({0})",
    "arcsin": "asin({0})",
    "arccos": "acos({0})",
    "arctan": "atan({0})",
    "arcsec": "acos(1/{0})",
    "arccsc": "asin(1/{0})",
    "arccot": "atan(1/{0})",
    "arcsinh": "log({0} + sqrt({0}**2 + 1))",
    "arccosh": "log({0} + sqrt({0}**2 - 1))",
    "arctanh": "log((1 + {0})/(1 - {0}))/2",
}
_SAME = ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "sqrt", "abs", "sign", "min", "max")

_TIME = "time"


class Formula:
    """A formula that is parsed once and can be written with different meanings of its names.

    Parameters
    ----------
    text : str
        The formula in PEtab's syntax.

    Attributes
    ----------
    names : tuple of str
        The names in it except ``time``, in order.

    Raises
    ------
    ExpressionError
        If the text is not a formula.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        try:
            self._tree = read_tree(_python_text(text))
        except ExpressionError as error:
            raise ExpressionError(f"'{brief(text)}' {error}") from None
        functions = {id(node.func) for node in ast.walk(self._tree) if isinstance(node, ast.Call)}
        found = [
            node.id
            for node in ast.walk(self._tree)
            if isinstance(node, ast.Name) and id(node) not in functions
        ]
        self.names = tuple(name for name in dict.fromkeys(found) if name != _TIME)

    def expression(self, meaning: Callable[[str], str]) -> str:
        """Write the formula as an expression of a scene.

        Parameters
        ----------
        meaning : callable
            Returns the expression that a name stands for.

        Raises
        ------
        ExpressionError
            If scenes have no equivalent of a function in it.
        """
        tree: ast.expr = _Rewriting(meaning).visit(_copied(self._tree))
        return ast.unparse(ast.fix_missing_locations(tree))


def number_of(expression: str, where: str) -> float | None:
    """Return the value of an expression without names, else None.

    Raises
    ------
    ExpressionError
        If it is not an expression, or has no value.
    """
    checked = parse(expression, where)
    if checked.names:
        return None
    return checked.lower(Dag(), _unknown).value


def _unknown(name: str) -> Node:
    raise AssertionError(f"'{name}' in an expression without names")


def _copied(tree: ast.expr) -> ast.expr:
    # Rewriting changes trees in place; writing and parsing the text is the simplest copy.
    return read_tree(ast.unparse(tree))


def _python_text(text: str) -> str:
    """Translate PEtab's operators to Python's."""
    if len(text) > _LONGEST:
        raise ExpressionError(f"is longer than {_LONGEST} characters")
    place, found = 0, []
    joined: list[set[str]] = [set()]
    text = text.strip()
    while place < len(text):
        match = _TOKEN.match(text, place)
        if match is None:
            raise ExpressionError(
                f"contains '{text[place:].strip()[:1]}', which PEtab does not allow"
            )
        place, token = match.end(), match[0].strip()
        if token == "(":
            joined.append(set())
        elif token == ")" and len(joined) > 1:
            joined.pop()
        elif token == ",":
            joined[-1].clear()
        elif token in ("&&", "||"):
            # They have equal precedence in PEtab, but not in Python.
            joined[-1].add(token)
            if len(joined[-1]) > 1:
                raise ExpressionError("mixes && and || in one condition: add parentheses")
        found.append(_SPELT.get(token, token))
    return " ".join(found)


_SPELT = {"^": "**", "&&": "and", "||": "or", "!": "not", "true": "1", "false": "0"}


class _Rewriting(ast.NodeTransformer):
    """Rewrites functions, comparisons and names."""

    def __init__(self, meaning: Callable[[str], str]) -> None:
        self._meaning = meaning

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return read_tree("t" if node.id == _TIME else self._meaning(node.id))

    def visit_Call(self, node: ast.Call) -> ast.expr:
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        args: list[ast.expr] = [self.visit(arg) for arg in node.args]
        if name == "piecewise" and len(args) % 2 == 1 and len(args) > 1:
            result = args[-1]
            for value, condition in reversed(list(zip(args[:-1:2], args[1::2], strict=True))):
                result = _call("where", condition, value, result)
            return result
        if name in _AS and len(args) == 1:
            return read_tree(_AS[name].format(f"({ast.unparse(args[0])})"))
        if name == "log" and len(args) == 2:
            return ast.BinOp(_call("log", args[0]), ast.Div(), _call("log", args[1]))
        if name == "pow" and len(args) == 2:
            return ast.BinOp(args[0], ast.Pow(), args[1])
        if name in (*_SAME, "log"):
            return _call(name, *args)
        raise ExpressionError(
            f"'{brief(ast.unparse(node))}' is not a function of PEtab, or has the wrong number of "
            "arguments"
        )

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        sides = [self.visit(side) for side in (node.left, *node.comparators)]
        parts: list[ast.expr] = []
        for a, op, b in zip(sides[:-1], node.ops, sides[1:], strict=True):
            if isinstance(op, (ast.Eq, ast.NotEq)):
                # Expressions of scenes have no equality; a <= b and a >= b is equivalent.
                both = ast.BoolOp(
                    ast.And(), [_compared(a, ast.LtE(), b), _compared(a, ast.GtE(), b)]
                )
                is_equal = isinstance(op, ast.Eq)
                parts.append(both if is_equal else ast.UnaryOp(ast.Not(), both))
            else:
                parts.append(_compared(a, op, b))
        return parts[0] if len(parts) == 1 else ast.BoolOp(ast.And(), parts)


def _call(name: str, *args: ast.expr) -> ast.Call:
    return ast.Call(ast.Name(name), list(args), [])


def _compared(a: ast.expr, op: ast.cmpop, b: ast.expr) -> ast.Compare:
    return ast.Compare(a, [op], [b])
