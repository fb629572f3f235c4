"""Expressions of scenes as syntax trees, built node by node with a limit on size and depth.

A part that becomes too long for one expression is cut off: it becomes a separate quantity of the
scene, and the rest contains its name.
"""

from __future__ import annotations

import ast
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.errors import ExpressionError
from cotree.scene.grammar import number_tree

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

#: Nodes and levels of a tree above which a part is cut off. The text of a scene's expression has
#: at most 4000 characters and 100 levels; a node takes a name of up to 60 letters.
_LARGEST, _HIGHEST = 50, 30

_OPERATORS: dict[str, type[ast.operator]] = {
    "+": ast.Add,
    "-": ast.Sub,
    "*": ast.Mult,
    "/": ast.Div,
    "**": ast.Pow,
}


@dataclass(frozen=True)
class Term:
    """A partly built expression.

    Attributes
    ----------
    tree : ast.expr
        The expression.
    size, height : int
        Its numbers of nodes and levels.
    """

    tree: ast.expr
    size: int = 1
    height: int = 1

    @property
    def text(self) -> str:
        """The expression in the syntax of scenes."""
        return ast.unparse(self.tree)


def number(value: float) -> Term:
    """Make a number.

    Raises
    ------
    ExpressionError
        If it is not finite.
    """
    if not math.isfinite(value):
        raise ExpressionError(f"contains {value}, which is not finite")
    # Integers are written without a decimal point.
    is_whole = value == int(value) and abs(value) < 1e15
    return Term(number_tree(int(value) if is_whole else value))


def name(identifier: str) -> Term:
    """Make a name, which may contain a dot."""
    edge, _, variable = identifier.partition(".")
    tree: ast.expr = ast.Name(edge)
    return Term(ast.Attribute(tree, variable) if variable else tree)


@dataclass
class TermMaker:
    """Combines terms, and cuts off parts that have become too large.

    Attributes
    ----------
    cut : callable
        Declares a quantity: takes an expression and the beginning of a name, and returns the name.
    """

    cut: Callable[[str, str], str]

    def _made(self, tree: ast.expr, *parts: Term) -> Term:
        size, height = 1 + sum(p.size for p in parts), 1 + max(p.height for p in parts)
        made = Term(tree, size, height)
        return name(self.cut(made.text, "part")) if size > _LARGEST or height > _HIGHEST else made

    def operate(self, left: Term, symbol: str, right: Term) -> Term:
        """Join two terms by an operator."""
        return self._made(ast.BinOp(left.tree, _OPERATORS[symbol](), right.tree), left, right)

    def negated(self, term: Term) -> Term:
        """Change the sign of a term."""
        return self._made(ast.UnaryOp(ast.USub(), term.tree), term)

    def call(self, function: str, *terms: Term) -> Term:
        """Call a function of scenes."""
        return self._made(ast.Call(ast.Name(function), [t.tree for t in terms], []), *terms)

    def balanced(self, join: Callable[[Term, Term], Term], terms: Sequence[Term]) -> Term:
        """Join many terms in a tree whose height is the logarithm of their number."""
        # A sum of a thousand terms that is nested to the left would be a thousand levels deep.
        if len(terms) == 1:
            return terms[0]
        half = (len(terms) + 1) // 2
        return join(self.balanced(join, terms[:half]), self.balanced(join, terms[half:]))

    def where(self, condition: Term, accepted: Term, refused: Term) -> Term:
        """Choose between two terms."""
        parts = (condition, accepted, refused)
        return self._made(ast.Call(ast.Name("where"), [p.tree for p in parts], []), *parts)


def compare(left: Term, operator: type[ast.cmpop], right: Term) -> Term:
    """Compare two terms, to a condition."""
    tree = ast.Compare(left.tree, [operator()], [right.tree])
    return Term(tree, left.size + right.size + 1, max(left.height, right.height) + 1)


def combine(operator: type[ast.boolop], conditions: Sequence[Term]) -> Term:
    """Join conditions by ``and`` or ``or``."""
    if len(conditions) == 1:
        return conditions[0]
    tree = ast.BoolOp(operator(), [c.tree for c in conditions])
    return Term(tree, sum(c.size for c in conditions), 1 + max(c.height for c in conditions))


def contrary(condition: Term) -> Term:
    """Negate a condition."""
    return Term(ast.UnaryOp(ast.Not(), condition.tree), condition.size + 1, condition.height + 1)
