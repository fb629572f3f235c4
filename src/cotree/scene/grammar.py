"""The grammar of expressions: its functions and operators, and the check of parsed trees."""

from __future__ import annotations

import ast
import math
import numbers

from cotree.errors import ExpressionError, brief, nearest
from cotree.scene.calls import known_tables, table_of

_DEEPEST = 100  # nesting levels

#: Functions by name, with their number of arguments.
FUNCTIONS: dict[str, int] = {
    **dict.fromkeys(("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh"), 1),
    **dict.fromkeys(("exp", "log", "sqrt", "abs", "sign", "floor", "erf"), 1),
    **dict.fromkeys(("atan2", "min", "max", "mod"), 2),
}

#: The conditional: what it gives where its first argument holds, and elsewhere.
WHERE = "where"

#: Comparisons: whether the left side is to be the larger, and whether equality will do.
COMPARISONS: dict[type[ast.cmpop], tuple[bool, bool]] = {
    ast.Lt: (False, False),
    ast.LtE: (False, True),
    ast.Gt: (True, False),
    ast.GtE: (True, True),
}

#: Operators of two values.
OPERATORS = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow)


def shown(value: object) -> str:
    """Show a value in a message, shortened."""
    try:
        return brief(repr(value))
    except ValueError:  # Python itself refuses to write integers of thousands of digits
        return "an integer of thousands of digits"


def finite(value: object) -> float | None:
    """Give a finite float, or None."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def check_tree(tree: ast.expr, names: set[str], depth: int) -> None:
    """Accept the grammar and collect its names; everything else is refused."""
    if depth > _DEEPEST:
        raise ExpressionError(f"is nested deeper than {_DEEPEST} levels: split it")
    # Only the shapes listed here pass: whatever else Python's grammar has is refused, not
    # evaluated.
    match tree:
        case ast.Constant(value=value):
            if finite(value) is None:
                raise ExpressionError(f"holds {shown(value)}, which is no finite number")
        case ast.Name(id=name):
            names.add(name)
        case ast.Attribute() if name := dotted(tree):
            names.add(name)
        case ast.BinOp(left=left, op=op, right=right):
            if not isinstance(op, OPERATORS):
                raise ExpressionError("holds an operator that is not one of + - * / **")
            check_tree(left, names, depth + 1)
            check_tree(right, names, depth + 1)
        case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=operand):
            check_tree(operand, names, depth + 1)
        case ast.Call(func=ast.Name(id="where"), args=[condition, held, other], keywords=[]):
            _check_condition(condition, names, depth + 1)
            check_tree(held, names, depth + 1)
            check_tree(other, names, depth + 1)
        case ast.Call(func=ast.Name(id="where"), args=args, keywords=[]):
            raise ExpressionError(
                f"gives where {len(args)} arguments: it takes a condition and two values"
            )
        case ast.Call(func=ast.Name(id=function) as called, args=args, keywords=[]):
            table = table_of(called)
            if function not in FUNCTIONS and table is None:
                hint = nearest(function, [*FUNCTIONS, WHERE, *known_tables()])
                raise ExpressionError(f"calls '{function}', which is not a known function{hint}")
            wanted = FUNCTIONS[function] if table is None else table.n_arguments
            if len(args) != wanted:
                more = "" if table is None else f": the table takes {wanted}"
                raise ExpressionError(f"gives {function} {len(args)} arguments{more}")
            if table is not None:
                names |= table.names
            for arg in args:
                check_tree(arg, names, depth + 1)
        case _:
            raise ExpressionError(
                "holds something other than numbers, names, + - * / ** and functions"
            )


def _check_condition(tree: ast.expr, names: set[str], depth: int) -> None:
    """Accept comparisons joined by ``and``, ``or`` and ``not``, and collect their names."""
    if depth > _DEEPEST:
        raise ExpressionError(f"is nested deeper than {_DEEPEST} levels: split it")
    match tree:
        case ast.Compare(left=left, ops=ops, comparators=others):
            if any(type(op) not in COMPARISONS for op in ops):
                raise ExpressionError("compares by something other than < <= > >=")
            for side in (left, *others):
                check_tree(side, names, depth + 1)
        case ast.BoolOp(values=parts):
            for part in parts:
                _check_condition(part, names, depth + 1)
        case ast.UnaryOp(op=ast.Not(), operand=part):
            _check_condition(part, names, depth + 1)
        case _:
            raise ExpressionError(
                "gives where a condition that is none: compare two values by < <= > >=, joined by "
                "and, or, not"
            )


def names_in(tree: ast.expr) -> frozenset[str]:
    """List the names in a checked tree: parameters, inputs, ``t`` and dotted ones."""
    found: set[str] = set()
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Attribute):
            found.add(dotted(node))
        elif isinstance(node, ast.Name):
            found.add(node.id)
        elif isinstance(node, ast.Call):
            # The name of the function is no name of the scene; values of a table may have some.
            waiting += node.args
            if table := table_of(node.func):
                found |= table.names
        else:
            waiting += ast.iter_child_nodes(node)
    return frozenset(found)


def number_tree(value: float) -> ast.expr:
    """Make the tree of a number; the grammar has no negative constants."""
    return ast.Constant(value) if value >= 0.0 else ast.UnaryOp(ast.USub(), ast.Constant(-value))


def dotted(tree: ast.expr) -> str:
    """Give the name that a chain of attributes is, as ``edge.variable``; else nothing."""
    steps: list[str] = []
    while isinstance(tree, ast.Attribute):
        steps.append(tree.attr)
        tree = tree.value
    return ".".join([tree.id, *reversed(steps)]) if isinstance(tree, ast.Name) and steps else ""
