"""Corners of expressions: points where a part of them jumps but the whole is continuous."""

from __future__ import annotations

import ast
import copy
from typing import TYPE_CHECKING, Any

from cotree.dag.continuity import meets
from cotree.dag.nodes import Dag
from cotree.dag.symbols import PARAMETER, STATE
from cotree.scene.expressions import Expression
from cotree.scene.grammar import COMPARISONS, names_in, number_tree

if TYPE_CHECKING:
    from collections.abc import Container

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


def boundary_of(part: ast.expr) -> tuple[ast.expr, bool]:
    """Return what is zero where a sign or a comparison jumps, and whether it holds above zero."""
    if isinstance(part, ast.Compare):
        is_larger, _ = COMPARISONS[type(part.ops[0])]
        return ast.BinOp(part.left, ast.Sub(), part.comparators[0]), is_larger
    assert isinstance(part, ast.Call)
    return part.args[0], True


def has_only_corner(whole: ast.expr, part: ast.expr, parameters: Container[str]) -> bool:
    """Return whether an expression is continuous wherever a part of it jumps.

    The part jumps where its argument is zero. There both values of the whole are compared, for all
    values of the parameters; see :func:`cotree.dag.continuity.meets`.
    """
    dag = Dag()
    # In one arena equal values are one node: the difference of both sides folds where they agree.
    symbols = {
        name: dag.symbol(PARAMETER if name in parameters else STATE, i)
        for i, name in enumerate(sorted(names_in(whole)))
    }

    def lowered(tree: ast.expr) -> Node:
        return Expression.of_tree(tree).lower(dag, symbols.__getitem__)

    looked_at, is_larger = boundary_of(part)
    if isinstance(part, ast.Compare):
        # Comparing equal numbers folds to the value on either side: >= holds, > does not.
        same = ast.Constant(0.5)
        kinds = (ast.GtE(), ast.Gt()) if is_larger else (ast.Gt(), ast.GtE())
        sides: list[ast.expr] = [ast.Compare(same, [op], [same]) for op in kinds]
    else:
        # A sign jumps from -1 to 1; its value 0 in between is met at the event only.
        sides = [number_tree(1.0), number_tree(-1.0)]
    try:
        above, below = (lowered(_Replaced(part, side).visit(whole)) for side in sides)
        return meets(above, below, lowered(looked_at))
    except (ArithmeticError, ValueError):  # it has no value somewhere: nothing is proved
        return False


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
