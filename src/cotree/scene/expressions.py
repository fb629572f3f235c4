"""Expressions as text: parsed according to a small grammar, never evaluated as Python.

An expression may contain numbers, names, ``edge.coordinate`` and ``edge.port.variable`` (with the
prefix of a part, as in ``leg1.knee.theta``), ``+ - * / **``, parentheses, the functions in
:data:`FUNCTIONS`, and ``where(condition, value, otherwise)``, whose comparisons may be joined by
``and``, ``or`` and ``not``. Python keywords such as ``in`` may be names before a dot: a letter is
appended to them while Python parses the text. A context of parsing contains the tables that
expressions may call; each parsed call stores its table.
"""

from __future__ import annotations

import ast
import keyword
import math
import numbers
import re
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import lru_cache, wraps
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, cast

from cotree.errors import ExpressionError, ParameterError, brief, nearest
from cotree.quiet import parsing, without_warnings

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from cotree.dag.nodes import Dag, Node

_WORDS = re.compile(rf"(?<!\w)({'|'.join(keyword.kwlist)})(?=\.[A-Za-z_])")
_MARK = "_ö"


def read_tree(text: str) -> ast.expr:
    """Parse a text; the resulting tree has not yet been checked against the grammar."""
    marked = _WORDS.sub(rf"\1{_MARK}", text.strip())
    try:
        # Python's parser would interpret leading spaces as indentation.
        with parsing, without_warnings(category=SyntaxWarning):  # such text is rejected later
            tree = ast.parse(marked, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ExpressionError("is not an expression") from None
    for node in ast.walk(tree):
        match node:
            case ast.Name():
                node.id = node.id.removesuffix(_MARK)
            case ast.Attribute():
                node.attr = node.attr.removesuffix(_MARK)
            case ast.Call(func=ast.Name(id="min" | "max") as extreme, args=args):
                while len(args) > 2:  # combines two arguments at a time
                    args[:2] = [ast.Call(extreme, args[:2], [])]
    return tree


_Method = TypeVar("_Method", bound="Callable[..., Any]")


class Callee(Protocol):
    """A function that expressions may call in addition to those of the grammar."""

    @property
    def n_arguments(self) -> int:
        """Number of arguments."""
        ...

    @property
    def names(self) -> frozenset[str]:
        """Parameters on which the values of the function depend."""
        ...

    def node(self, dag: Dag, args: list[Node], resolve: Callable[[str], Node]) -> Node:
        """Return the node of the function's value."""
        ...


_KNOWN: ContextVar[Mapping[str, Callee]] = ContextVar("known tables")
_NONE: Mapping[str, Callee] = {}


def known_tables() -> Mapping[str, Callee]:
    """Return the tables that expressions may currently call."""
    return _KNOWN.get(_NONE)


@contextmanager
def table_scope(tables: Mapping[str, Callee]) -> Iterator[None]:
    """Allow expressions that are parsed in a ``with`` block to call only the given tables."""
    token = _KNOWN.set(tables)
    try:
        yield
    finally:
        _KNOWN.reset(token)


def may_call_tables(method: _Method) -> _Method:
    """Allow expressions that a method parses to call the scene's tables."""

    @wraps(method)
    def in_scope(self: Any, *args: Any, **more: Any) -> Any:
        with table_scope(self.tables):
            return method(self, *args, **more)

    return cast("_Method", in_scope)


def bound(tree: ast.expr, tables: Mapping[str, Callee]) -> ast.expr:
    """Bind the table calls in a newly parsed tree to the given tables."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and (table := tables.get(ast.unparse(node.func))):
            node.func = name_of(ast.unparse(node.func), table)
    return tree


def name_of(name: str, table: Callee) -> ast.Name:
    """Return the tree of a function name with which an expression calls a table."""
    made = ast.Name(name)
    made.table = table  # type: ignore[attr-defined]
    return made


def table_of(called: ast.expr) -> Callee | None:
    """Return the table that a tree calls, or None for a function of the grammar."""
    return getattr(called, "table", None)


_DEEPEST = 100  # maximum nesting depth of an expression

#: Functions by name, with their numbers of arguments.
FUNCTIONS: dict[str, int] = {
    **dict.fromkeys(("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh"), 1),
    **dict.fromkeys(("exp", "log", "sqrt", "abs", "sign", "floor", "erf"), 1),
    **dict.fromkeys(("atan2", "min", "max", "mod"), 2),
}

#: Name of the conditional function ``where(condition, then, else)``.
WHERE = "where"

#: For each comparison: whether the left side must be larger, and whether equality is accepted.
COMPARISONS: dict[type[ast.cmpop], tuple[bool, bool]] = {
    ast.Lt: (False, False),
    ast.LtE: (False, True),
    ast.Gt: (True, False),
    ast.GtE: (True, True),
}

#: Binary operators that expressions may contain.
OPERATORS = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow)


def shown(value: object) -> str:
    """Return a value as text for a message, shortened if necessary."""
    try:
        return brief(repr(value))
    except ValueError:  # Python refuses to print integers of thousands of digits
        return "an integer of thousands of digits"


def finite(value: object) -> float | None:
    """Return a value as a finite float, or None if that is impossible."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return None
    try:
        number = float(value)
    except (TypeError, OverflowError):  # raised for durations of NumPy, which count as integers
        return None
    return number if math.isfinite(number) else None


def check_tree(tree: ast.expr, names: set[str], depth: int) -> None:
    """Check a tree against the grammar and collect its names; raise if anything else occurs."""
    if depth > _DEEPEST:
        raise ExpressionError(f"is nested deeper than {_DEEPEST} levels: split it")
    # Only these types of nodes are accepted. None of them is evaluated as Python.
    match tree:
        case ast.Constant(value=value):
            if finite(value) is None:
                raise ExpressionError(f"holds {shown(value)}, which is not a finite number")
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
                f"calls where with {len(args)} arguments: it takes a condition and two values"
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
                "calls where without a condition: compare two values by < <= > >=, joined by "
                "and, or, not"
            )


def names_in(tree: ast.expr) -> frozenset[str]:
    """Return the names in a checked tree: parameters, inputs, ``t`` and dotted names."""
    found: set[str] = set()
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Attribute):
            found.add(dotted(node))
        elif isinstance(node, ast.Name):
            found.add(node.id)
        elif isinstance(node, ast.Call):
            # The function's name is not a name of the scene; values of a table may contain names.
            waiting += node.args
            if table := table_of(node.func):
                found |= table.names
        else:
            waiting += ast.iter_child_nodes(node)
    return frozenset(found)


def number_tree(value: float) -> ast.expr:
    """Return the tree of a number; the grammar has no negative constants."""
    return ast.Constant(value) if value >= 0.0 else ast.UnaryOp(ast.USub(), ast.Constant(-value))


def name_tree(name: str) -> ast.expr:
    """Return the tree of a name, which may contain dots."""
    first, *rest = name.split(".")
    tree: ast.expr = ast.Name(first)
    for step in rest:
        tree = ast.Attribute(tree, step)
    return tree


def dotted(tree: ast.expr) -> str:
    """Return the dotted name that a chain of attributes represents, otherwise ""."""
    steps: list[str] = []
    while isinstance(tree, ast.Attribute):
        steps.append(tree.attr)
        tree = tree.value
    return ".".join([tree.id, *reversed(steps)]) if isinstance(tree, ast.Name) and steps else ""


def map_tree(tree: ast.expr, change: Callable[[ast.expr], ast.expr | None]) -> ast.expr:
    """Copy a tree; ``change`` returns the replacement of a subtree, or None to keep it."""
    if (found := change(tree)) is not None:
        return found
    match tree:
        case ast.BinOp():
            return ast.BinOp(map_tree(tree.left, change), tree.op, map_tree(tree.right, change))
        case ast.UnaryOp():
            return ast.UnaryOp(tree.op, map_tree(tree.operand, change))
        case ast.BoolOp():
            return ast.BoolOp(tree.op, [map_tree(part, change) for part in tree.values])
        case ast.Compare():
            sides = [map_tree(part, change) for part in (tree.left, *tree.comparators)]
            return ast.Compare(sides[0], tree.ops, sides[1:])
        case ast.Call():
            args = [map_tree(part, change) for part in tree.args]
            return ast.Call(tree.func, args, tree.keywords)
    return tree


def map_names(tree: ast.expr, new: Callable[[str], str | ast.expr]) -> ast.expr:
    """Copy a tree, and replace names by names or trees, also in the tables that it calls."""

    def named(name: str) -> ast.expr:
        found = new(name)
        return name_tree(found) if isinstance(found, str) else found

    def change(part: ast.expr) -> ast.expr | None:
        if isinstance(part, ast.Name):
            return named(part.id)
        if isinstance(part, ast.Attribute):
            return named(dotted(part))
        if not isinstance(part, ast.Call):
            return None
        own = part.func.id if isinstance(part.func, ast.Name) else dotted(part.func)
        if own in FUNCTIONS or own == WHERE or (name := str(new(own))) == own:
            return None
        table = known_tables().get(name)
        args = [map_tree(arg, change) for arg in part.args]
        return ast.Call(name_of(name, table) if table else name_tree(name), args, [])

    return map_tree(tree, change)


#: Cached parser: equal texts share one tree, which must not be changed.
shared_tree = lru_cache(maxsize=1024)(read_tree)


def fill(form: str, *trees: ast.expr) -> ast.expr:
    """Substitute trees for a, b and c in an expression or condition."""
    return map_names(shared_tree(form), dict(zip("abc", trees, strict=False)).__getitem__)


_LONGEST = 4000  # maximum number of characters, which limits the recursion of the parser
_UNIT = r"(?![eE]\d)([A-Za-zµΩ°%][\w/^ ²³]{0,30})"  # 1e999 is a number without a unit
_WITH_UNIT = re.compile(rf"\s*([-+]?\d[\d.eE+-]{{0,30}})\s*{_UNIT}\s*\Z")

_BINARY: dict[type[ast.operator], Callable[[Node, Node], Node]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.Pow: lambda a, b: a**b,
}


@dataclass(frozen=True)
class Expression:
    """A checked expression."""

    text: str  # the expression as the user wrote it
    where: str = field(repr=False)  # its owner in messages: "stiffness of edge 'k'"
    #: Syntax tree of the text.
    tree: ast.expr = field(compare=False, repr=False)  # determined by the text
    #: All names that occur: parameters, inputs, ``t``, and dotted ``edge.coordinate``.
    names: frozenset[str] = field(repr=False)

    def __getstate__(self) -> dict[str, Any]:
        # The order of sets differs between processes, but equal scenes must yield equal bytes.
        return {**self.__dict__, "names": sorted(self.names)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, names=frozenset(state["names"]))

    @classmethod
    def of_tree(cls, tree: ast.expr, where: str = "") -> Expression:
        """Return an expression for a syntax tree, without checking it."""
        return cls(ast.unparse(tree), where, tree, names_in(tree))

    def map_names(self, new: Callable[[str], str | ast.expr], where: str = "") -> Expression:
        """Return the expression with its names replaced; see :func:`map_names`."""
        where = where or self.where
        if not self.names:
            return Expression(self.text, where, self.tree, self.names)
        return Expression.of_tree(map_names(self.tree, new), where)

    @property
    def canonical(self) -> str | float:
        """Key that equal expressions share: a number if given as a number, otherwise the text."""
        value = self.tree.value if isinstance(self.tree, ast.Constant) else None
        return value if isinstance(value, float) and repr(value) == self.text else self.text

    @property
    def number(self) -> float | None:
        """The value if the expression is a plain number, else None."""
        tree, sign = self.tree, 1.0
        if isinstance(tree, ast.UnaryOp) and isinstance(tree.op, ast.USub):
            tree, sign = tree.operand, -1.0
        return sign * float(tree.value) if isinstance(tree, ast.Constant) else None  # type: ignore[arg-type]

    @property
    def is_zero(self) -> bool:
        """Whether the value is zero for all values of its names, as in ``0*L``."""
        if self.number is not None:
            return self.number == 0.0
        # The cache key is the text, which does not determine the values of a table.
        if "(" in self.text and any(hasattr(node, "table") for node in ast.walk(self.tree)):
            return False
        return _vanishes(self)

    def lower(self, dag: Dag, resolve: Callable[[str], Node]) -> Node:
        """Return the expression as a node; raise ExpressionError for constants such as ``1/0``."""
        try:
            return _lower(self.tree, dag, resolve)
        except (ArithmeticError, ValueError, TypeError) as error:
            if isinstance(error, ExpressionError):
                raise ExpressionError(f"{self.where}: {error}") from None
            raise ExpressionError(f"{self.where}: '{self.text}' has no value: {error}") from None


#: Value of a field: an expression, three expressions, or three rows of three.
FieldValue = Expression | tuple[Expression, ...] | tuple[tuple[Expression, ...], ...]


def entries(value: FieldValue | None) -> Iterator[Expression]:
    """Yield the expressions in a field's value."""
    if isinstance(value, Expression):
        yield value
    else:
        for item in value or ():
            yield from entries(item)


@lru_cache(maxsize=1024)
def _vanishes(expression: Expression) -> bool:
    """Return whether an expression folds to zero for all values of its names."""
    from cotree.dag.nodes import Dag

    dag, places = Dag(), {name: i for i, name in enumerate(sorted(expression.names))}
    try:
        return expression.lower(dag, lambda name: dag.symbol("p", places[name])).is_zero
    except ExpressionError:
        return False  # the error is raised later, where the expression is used


def parse(value: object, where: str) -> Expression:
    """Parse a number or an expression; ``where`` describes its owner in error messages."""
    # Booleans are numbers in Python, but errors in a scene.
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
        if "(" in text and any(name in text for name in tables):
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
    """Parse and check a text, cached because thousands of edges may have the same text."""
    return _checked(read_tree(text))


def _checked(tree: ast.expr) -> tuple[ast.expr, frozenset[str]]:
    names: set[str] = set()
    check_tree(tree, names, 0)
    return tree, frozenset(names)


def check_number(value: object, what: str) -> float:
    """Return a value as a finite number; raise if that is impossible."""
    # Complex numbers in NumPy also have a __float__ method.
    is_number = hasattr(type(value), "__float__") and not isinstance(value, bool)
    if not is_number or getattr(value, "ndim", False) or getattr(value, "imag", False):
        raise ParameterError(f"{what} is {brief(value)!r}: give a number")
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        raise ParameterError(f"{what} is {brief(value)!r}: give a number") from None
    if not math.isfinite(number):
        raise ParameterError(f"{what} is {number}: give a finite number")
    return number


def check_positive(value: object, what: str) -> float:
    """Return a value as a positive finite number; raise if that is impossible."""
    number = check_number(value, what)
    if not number > 0.0:
        raise ParameterError(f"{what} is {number:g}: give a positive number")
    return number


def _lower(tree: ast.expr, dag: Dag, resolve: Callable[[str], Node]) -> Node:
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
    match tree:
        case ast.Compare(left=left, ops=ops, comparators=others):
            sides = [_lower(side, dag, resolve) for side in (left, *others)]
            # A chain ``a < b < c`` becomes nested selections, from the last one outwards.
            for a, op, b in reversed(list(zip(sides[:-1], ops, sides[1:], strict=True))):
                is_larger, has_equal = COMPARISONS[type(op)]
                excess = a - b if is_larger == has_equal else b - a
                # A selection accepts equality; otherwise its two values are exchanged.
                pair = (accepted, refused) if has_equal else (refused, accepted)
                accepted = dag.select(excess, *pair)
            return accepted
        case ast.BoolOp(op=op, values=parts):
            # ``and`` nests selections in the first value, ``or`` in the second one.
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
    # A selection has the derivative of the selected value.
    if function == "max":
        return dag.select(args[0] - args[1], args[0], args[1])
    if function == "min":
        return dag.select(args[0] - args[1], args[1], args[0])
    if function == "mod":
        return args[0] - args[1] * dag.function("floor", args[0] / args[1])
    return dag.function(function, *args)
