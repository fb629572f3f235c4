"""Corners of expressions: points where a part of them jumps but the whole is continuous."""

from __future__ import annotations

import ast
import copy
from typing import TYPE_CHECKING, Any

from cotree.dag.nodes import Dag
from cotree.dag.traverse import reachable, substitute
from cotree.scene.expressions import Expression
from cotree.scene.grammar import names_in, number_tree

if TYPE_CHECKING:
    from cotree.dag.nodes import Node


def jumps_in(tree: ast.expr) -> list[ast.expr]:
    """List the signs and the comparisons of two values in a tree."""
    return [
        node
        for node in ast.walk(tree)
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name)
            and node.func.id == "sign"
        )
        or (isinstance(node, ast.Compare) and len(node.ops) == 1)
    ]


def has_only_corner(whole: ast.expr, part: ast.expr) -> bool:
    """Tell whether an expression is evidently continuous wherever a part of it jumps.

    The part jumps where its argument is zero. There the values on both sides are subtracted: the
    argument is replaced by zero, or one of its terms by the others. A difference that folds to zero
    is a proof; anything else counts as a jump.
    """
    dag = Dag()
    # In one arena equal values are one node: the difference of both sides folds where they agree.
    symbols = {name: dag.symbol("x", i) for i, name in enumerate(sorted(names_in(whole)))}

    def lowered(tree: ast.expr) -> Node:
        return Expression.of_tree(tree).lower(dag, symbols.__getitem__)

    sides: list[ast.expr]
    if isinstance(part, ast.Compare):
        looked_at: ast.expr = ast.BinOp(part.left, ast.Sub(), part.comparators[0])
        # Comparing equal numbers folds to the value on either side: >= holds, > does not.
        same = ast.Constant(0.5)
        sides = [ast.Compare(same, [op], [same]) for op in (ast.GtE(), ast.Gt())]
    else:
        assert isinstance(part, ast.Call)
        looked_at = part.args[0]
        # A sign jumps from -1 to 1; its value 0 in between is met at the event only.
        sides = [number_tree(1.0), number_tree(-1.0)]
    try:
        above, below = (lowered(_Replaced(part, side).visit(whole)) for side in sides)
        difference = above - below
        for solution in _solutions(lowered(looked_at)):
            if substitute([difference], solution)[0].is_zero:
                return True
    except (ArithmeticError, ValueError):  # it has no value somewhere: nothing is proved
        return False
    return False


def _solutions(value: Node) -> list[dict[Node, Node]]:
    """List ways to say in a substitution that a value is zero."""
    dag = value.dag
    found = [{value: dag.zero}]
    if value.op in ("add", "sub"):
        a, b = value.args
        for one, other in ((a, b), (b, a)):
            # One term may be replaced by the other where it does not occur in it.
            if one.value is None and one not in reachable([other]):
                found.append({value: dag.zero, one: -other if value.op == "add" else other})
    return found


class _Replaced(ast.NodeTransformer):
    """Copies a tree with one part replaced; the part is told by identity, not by its text."""

    def __init__(self, part: ast.expr, by: ast.expr) -> None:
        self._part, self._by = part, by

    def visit(self, node: ast.AST) -> Any:
        """Give the replacement for the part, and a copy of any other node."""
        return self._by if node is self._part else super().visit(copy.copy(node))

    def generic_visit(self, node: ast.AST) -> ast.AST:
        """Copy the lists of a node before what is in them changes."""
        for name, value in ast.iter_fields(node):
            if isinstance(value, list):
                setattr(node, name, list(value))
        return super().generic_visit(node)
