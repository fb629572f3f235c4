"""Expression strings: parsed by a small grammar, never evaluated as Python.

An expression may hold numbers, names, ``edge.coordinate``, ``edge.port.variable``, both also of
parts as ``leg1.knee.theta``, ``+ - * / **``, parentheses, the functions of :data:`FUNCTIONS`, and
``where(condition, value, otherwise)`` with comparisons joined by ``and``, ``or`` and ``not``. It is
checked when a scene is made and turned into nodes later.
"""

from __future__ import annotations

import ast
import math
import numbers
import re
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from cotree.dag.nodes import Dag
from cotree.errors import ExpressionError, ParameterError, brief
from cotree.scene.calls import bound, calls_table, has_table, known_tables, table_of
from cotree.scene.grammar import (
    COMPARISONS,
    check_tree,
    dotted,
    finite,
    names_in,
    shown,
)
from cotree.scene.words import read_tree

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.dag.nodes import Node

_LONGEST = 4000  # characters; keeps the parser's own recursion bounded
_WITH_UNIT = re.compile(r"\s*([-+]?\d[\d.eE+-]{0,30})\s*([A-Za-zµΩ°%][\w/^ ²³]{0,30})\s*\Z")

_BINARY: dict[type[ast.operator], Callable[[Node, Node], Node]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.Pow: lambda a, b: a**b,
}


@dataclass(frozen=True)
class Expression:
    """A checked expression.

    Attributes
    ----------
    text : str
        As the user wrote it.
    where : str
        What it belongs to, for messages: "stiffness of edge 'k'".
    tree : ast.expr
        The parsed text.
    names : frozenset of str
        The names in it: parameters, inputs, ``t``, and dotted ``edge.coordinate``.
    """

    text: str
    where: str = field(repr=False)
    tree: ast.expr = field(compare=False, repr=False)  # the text says the same
    names: frozenset[str] = field(repr=False)

    def __getstate__(self) -> dict[str, Any]:
        # A set has another order in each process, and equal scenes are to give equal bytes.
        return {**self.__dict__, "names": sorted(self.names)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, names=frozenset(state["names"]))

    @classmethod
    def of_tree(cls, tree: ast.expr, where: str = "") -> Expression:
        """Make the expression of a tree that needs no check."""
        return cls(ast.unparse(tree), where, tree, names_in(tree))

    @property
    def told(self) -> str | float:
        """Key that equal expressions share: a number if it was given as one, otherwise the text."""
        value = self.tree.value if isinstance(self.tree, ast.Constant) else None
        return value if isinstance(value, float) and repr(value) == self.text else self.text

    @property
    def number(self) -> float | None:
        """The value, where the expression is a plain number."""
        tree, sign = self.tree, 1.0
        if isinstance(tree, ast.UnaryOp) and isinstance(tree.op, ast.USub):
            tree, sign = tree.operand, -1.0
        return sign * float(tree.value) if isinstance(tree, ast.Constant) else None  # type: ignore[arg-type]

    @property
    def is_zero(self) -> bool:
        """Whether the value is zero whatever its names stand for, as that of ``0*L`` is."""
        if self.number is not None:
            return self.number == 0.0
        # Whether it is zero is remembered by the text, which does not tell the values of a table.
        return not ("(" in self.text and has_table(self.tree)) and _vanishes(self)

    def lower(self, dag: Dag, resolve: Callable[[str], Node]) -> Node:
        """Turn the expression into a node.

        Parameters
        ----------
        dag : Dag
            The arena to make it in.
        resolve : callable
            Gives the node of a name; raises ExpressionError for an unknown one.

        Raises
        ------
        ExpressionError
            If a name is unknown or a constant part is undefined (``1/0``, ``sqrt(-1)``).
        """
        try:
            return _lower(self.tree, dag, resolve)
        except (ArithmeticError, ValueError, TypeError) as error:
            if isinstance(error, ExpressionError):
                raise ExpressionError(f"{self.where}: {error}") from None
            raise ExpressionError(f"{self.where}: '{self.text}' has no value: {error}") from None


#: Value of a field: one expression, or a tuple of three, or three such rows.
FieldValue = Expression | tuple[Expression, ...] | tuple[tuple[Expression, ...], ...]


@lru_cache(maxsize=1024)
def _vanishes(expression: Expression) -> bool:
    """Tell whether an expression folds to zero for any values of its names."""
    dag, places = Dag(), {name: i for i, name in enumerate(sorted(expression.names))}
    try:
        return expression.lower(dag, lambda name: dag.symbol("p", places[name])).is_zero
    except ExpressionError:
        return False  # said where it is used


def parse(value: object, where: str) -> Expression:
    """Check a number or an expression string.

    Parameters
    ----------
    value : float, int or str
        What the user gave.
    where : str
        What it belongs to, for messages.

    Raises
    ------
    ExpressionError
        If it is neither, does not parse, or holds anything but the grammar above.
    """
    # Python's booleans are numbers; in a scene they are a mistake.
    if isinstance(value, bool) or not isinstance(value, (str, numbers.Real)):
        raise ExpressionError(
            f"{where} must be a number or an expression in quotes, not {type(value).__name__}"
        )
    if isinstance(value, str):
        return _parse_text(value, where)
    number = finite(value)
    if number is None:
        raise ExpressionError(f"{where} is {shown(value)}: give a finite number")
    return Expression(repr(number), where, ast.Constant(number), frozenset())


def _parse_text(text: str, where: str) -> Expression:
    if len(text) > _LONGEST:
        raise ExpressionError(f"{where} is longer than {_LONGEST} characters: split it")
    try:
        tables = known_tables()
        if tables and calls_table(text, tables):
            tree, names = _checked(bound(read_tree(text), tables))
        else:
            tree, names = _tree_of(text)
    except ExpressionError as error:
        hint = ""
        if with_unit := _WITH_UNIT.match(text):
            number, unit = with_unit.groups()
            hint = f': for a number with a unit write {{ value = {number}, unit = "{unit}" }}'
        raise ExpressionError(f"{where}: '{brief(text)}' {error}{hint}") from None
    return Expression(text, where, tree, names)


@lru_cache(maxsize=1024)
def _tree_of(text: str) -> tuple[ast.expr, frozenset[str]]:
    """Parse and check a text once: thousands of edges may have the same."""
    return _checked(read_tree(text))


def _checked(tree: ast.expr) -> tuple[ast.expr, frozenset[str]]:
    names: set[str] = set()
    check_tree(tree, names, 0)
    return tree, frozenset(names)


def check_number(value: object, what: str) -> float:
    """Accept a finite number.

    Raises
    ------
    ParameterError
        If it is not one.
    """
    if isinstance(value, bool) or not hasattr(type(value), "__float__"):
        raise ParameterError(f"{what} is {brief(value)!r}: give a number")
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        raise ParameterError(f"{what} is {brief(value)!r}: give a number") from None
    if not math.isfinite(number):
        raise ParameterError(f"{what} is {number}: give a finite number")
    return number


def _lower(tree: ast.expr, dag: Dag, resolve: Callable[[str], Node]) -> Node:
    """Turn a checked tree into a node."""
    match tree:
        case ast.Constant(value=value):
            return dag.constant(float(value))  # type: ignore[arg-type]
        case ast.Name(id="pi"):
            return dag.constant(math.pi)
        case ast.Name(id=name):
            return resolve(name)
        case ast.Attribute():
            return resolve(dotted(tree))
        case ast.BinOp(left=left, op=op, right=right):
            return _BINARY[type(op)](_lower(left, dag, resolve), _lower(right, dag, resolve))
        case ast.UnaryOp(op=op, operand=operand):
            inner = _lower(operand, dag, resolve)
            return -inner if isinstance(op, ast.USub) else inner
        case ast.Call(func=ast.Name(id="where"), args=[condition, accepted, refused]):
            branches = (_lower(accepted, dag, resolve), _lower(refused, dag, resolve))
            return _lower_condition(condition, dag, resolve, *branches)
        case ast.Call(func=called, args=args) if table := table_of(called):
            return table.node(dag, [_lower(arg, dag, resolve) for arg in args], resolve)
        case ast.Call(func=ast.Name(id=function), args=args):
            return _lower_call(dag, function, [_lower(arg, dag, resolve) for arg in args])
    raise AssertionError("the tree was checked when it was parsed")


def _lower_condition(
    tree: ast.expr, dag: Dag, resolve: Callable[[str], Node], accepted: Node, refused: Node
) -> Node:
    """Choose between two values by a checked condition."""
    match tree:
        case ast.Compare(left=left, ops=ops, comparators=others):
            sides = [_lower(side, dag, resolve) for side in (left, *others)]
            # A chain ``a < b < c`` holds where all of its parts do: the selections are nested from
            # the last.
            for a, op, b in reversed(list(zip(sides[:-1], ops, sides[1:], strict=True))):
                is_larger, has_equal = COMPARISONS[type(op)]
                excess = a - b if is_larger == has_equal else b - a
                # A selection accepts equality: where it is to be refused, the roles change.
                accepted = (
                    dag.select(excess, accepted, refused)
                    if has_equal
                    else dag.select(excess, refused, accepted)
                )
            return accepted
        case ast.BoolOp(op=op, values=parts):
            # ``and`` nests in the branch that is accepted, ``or`` in the one that is refused.
            for part in reversed(parts):
                if isinstance(op, ast.And):
                    accepted = _lower_condition(part, dag, resolve, accepted, refused)
                else:
                    refused = _lower_condition(part, dag, resolve, accepted, refused)
            return accepted if isinstance(op, ast.And) else refused
        case ast.UnaryOp(operand=part):
            return _lower_condition(part, dag, resolve, refused, accepted)
    raise AssertionError("the condition was checked when it was parsed")


def _lower_call(dag: Dag, function: str, args: list[Node]) -> Node:
    # A selection has the derivative of the branch taken, which is what sensitivities follow.
    if function == "max":
        return dag.select(args[0] - args[1], args[0], args[1])
    if function == "min":
        return dag.select(args[0] - args[1], args[1], args[0])
    if function == "mod":
        return args[0] - args[1] * dag.function("floor", args[0] / args[1])
    return dag.function(function, *args)
