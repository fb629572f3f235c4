"""Expressions and statements as data: the intermediate language between a program and C text.

An expression consists of a form and numbers. The numbers are constants, indices and the numbers of
temporaries; the form is the tree of operations, arrays and names without these numbers. Equal forms
reveal loops: the statements differ only in their numbers. Properties of a form (names, operations,
text) are computed only once. Only :mod:`cotree.codegen.printing` writes C.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain
from string import Formatter
from typing import TYPE_CHECKING, Any, ClassVar, Self

from cotree.dag.operations import OPERATIONS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence


#: A temporary variable: prefix and number.
Temporary = tuple[str, Any]

#: Highest precedence: that of names, calls and array elements.
_ATOM = 9
#: Precedence of each operation, and the lowest precedence at which an argument needs no
#: parentheses. It is higher for right operands, to preserve the order of evaluation.
_BINDING: dict[str, tuple[int, tuple[int, ...]]] = {
    "add": (1, (1, 2)),
    "sub": (1, (1, 2)),
    "mul": (2, (2, 3)),
    "div": (2, (2, 3)),
    "neg": (3, (4,)),
    "sign": (_ATOM, (_ATOM, _ATOM)),
    "select": (_ATOM, (3, 3, 3)),
    "real": (3, (_ATOM,)),
    "not": (3, (_ATOM,)),
    "fails": (0, (1,)),
}
#: Type of each number in a leaf: real (r), whole (w), index (i), number of a temporary (t).
_SLOTS = {
    **{"number": "r", "whole": "w", "element": "i", "temporary": "t"},
    **{"name": "", "zero": "", "tolerance": ""},
}
#: Numbers of operations other than one: a sign consists of comparisons, the other entries are free.
_COUNTS = {"sign": 3, "real": 0, "not": 0, "fails": 0} | dict.fromkeys(_SLOTS, 0)


def fields_of(spelling: str) -> list[int]:
    """Return the argument numbers in a format string, in the order in which they occur."""
    return [int(name) for _, name, _, _ in Formatter().parse(spelling) if name is not None]


#: Operations whose text repeats or reorders the arguments.
_ARRANGED = {
    name: fields
    for name, row in OPERATIONS.items()
    if (fields := fields_of(row.c)) != [*range(row.arity)]
}
_WIDTHS = {name: len(row.c.format(*[""] * row.arity)) for name, row in OPERATIONS.items()}


@dataclass(frozen=True, slots=True, eq=False)
class Form:
    """The structure of an expression, without its numbers."""

    #: An operation, ``number``, ``whole``, ``zero``, ``tolerance``, ``name``, ``element`` (of an
    #: array), ``temporary``, ``call`` (of a function) or ``part`` (a call of a split-off part).
    op: str
    name: str  # name of the array or function, prefix of the temporary, or value of the tolerance
    args: tuple[Form, ...]  # arguments of the operation or function
    level: int  # precedence of the form
    #: Type of each number: ``r`` constant, ``w`` whole, ``i`` index, ``t`` number of a temporary.
    slots: str
    n_operations: int  # number of operations
    width: int  # number of characters in C, without those of the numbers
    names: frozenset[str]  # all names in the form, except temporaries
    #: Index among the numbers, and prefix, of each temporary.
    temporaries: tuple[tuple[int, str], ...]
    _hash: int

    # Compare by value: after a form is dropped from the cache, an equal one may be built.
    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        return isinstance(other, Form) and (
            self._hash == other._hash
            and self.op == other.op
            and self.name == other.name
            and self.args == other.args
        )

    @property
    def needs(self) -> tuple[int, ...]:
        """Minimum precedence of each argument that needs no parentheses."""
        return _BINDING[self.op][1] if self.op in _BINDING else (0,) * len(self.args)


@lru_cache(maxsize=1 << 14)
def _form(op: str, name: str, args: tuple[Form, ...] = ()) -> Form:
    level, needs = _BINDING.get(op, (_ATOM, (0,) * len(args)))
    slots = _SLOTS.get(op) if op in _SLOTS else "".join(arg.slots for arg in args)
    width = sum(arg.width + 2 * (arg.level < need) for arg, need in zip(args, needs, strict=True))
    if op in ("call", "part"):
        width += len(name) + 2 * max(1, len(args))
    else:
        width += _WIDTHS.get(op, len(name) + 2 * (op == "element"))
    names = frozenset(chain.from_iterable(arg.names for arg in args))
    temporaries: list[tuple[int, str]] = [(0, name)] if op == "temporary" else []
    # The numbers of the arguments follow each other in argument order.
    start = 0
    for arg in args:
        temporaries += [(start + place, prefix) for place, prefix in arg.temporaries]
        start += len(arg.slots)
    return Form(
        op=op,
        name=name,
        args=args,
        level=level,
        slots=slots or "",
        n_operations=_COUNTS.get(op, 1) + sum(arg.n_operations for arg in args),
        width=width,
        names=names | {name} if name and op not in ("temporary", "tolerance") else names,
        temporaries=tuple(temporaries),
        _hash=hash((op, name, args)),
    )


@dataclass(frozen=True, slots=True)
class Affine:
    """A number that changes by a constant step in a loop over i: ``step * i + first``."""

    step: int
    first: int

    @property
    def n_operations(self) -> int:
        """Number of integer operations."""
        return (abs(self.step) != 1) + (self.step < 0 or self.first != 0)


@dataclass(frozen=True, slots=True)
class TableEntry:
    """A number in a loop that is read from a table, one entry per iteration."""

    table: str


Number = int | float | Affine | TableEntry


@dataclass(frozen=True, slots=True)
class CExpression:
    """An expression with its form, its numbers, and the length of its C text."""

    form: Form
    numbers: tuple[Number, ...]
    width: int


_ZERO = CExpression(_form("zero", ""), (), 4)


def number(value: float) -> CExpression:
    """Build a constant; the sign of a negative constant is an operation."""
    # Precedence then adds parentheses where needed: -(-2.0) instead of --2.0.
    value = float(value)
    if value < 0.0:
        return apply("neg", number(-value))
    return CExpression(_form("number", ""), (value,), len(repr(value)))


def tolerance(value: float) -> CExpression:
    """Build a tolerance, given for doubles and scaled to the precision of the target's type."""
    form = _form("tolerance", repr(float(value)))
    return CExpression(form, (), form.width)


def whole(value: Number) -> CExpression:
    """Build a nonnegative whole number."""
    return CExpression(_form("whole", ""), (value,), len(str(value)))


def zero() -> CExpression:
    """Return the zero of type ``REAL``."""
    return _ZERO


def named(text: str) -> CExpression:
    """Build the name of an argument, an array or a constant."""
    return CExpression(_form("name", text), (), len(text))


def element(array: str, index: Number) -> CExpression:
    """Build an element of an array."""
    form = _form("element", array)
    return CExpression(form, (index,), form.width + len(str(index)))


def temporary(prefix: str, value: int) -> CExpression:
    """Build a temporary."""
    return CExpression(_form("temporary", prefix), (value,), len(prefix) + len(str(value)))


def apply(op: str, *args: CExpression) -> CExpression:
    """Build an operation of :data:`cotree.dag.operations.OPERATIONS`, or one that only C has.

    Operations that only C has are the conversion ``real``, ``not``, and ``fails``, a test for
    nonzero.
    """
    if op in _ARRANGED:
        # Arguments are listed in the order of the text; some occur repeatedly.
        args = tuple(args[i] for i in _ARRANGED[op])
    return _joined(_form(op, "", tuple([arg.form for arg in args])), args)


def call(function: str, *args: CExpression, op: str = "call") -> CExpression:
    """Build a function call; ``op`` is ``part`` if the callee was split off from the caller."""
    return _joined(_form(op, function, tuple([arg.form for arg in args])), args)


def _joined(form: Form, args: Sequence[CExpression]) -> CExpression:
    numbers: tuple[Number, ...] = ()
    width = form.width
    for arg in args:
        numbers += arg.numbers
        # The number of characters of the form is already included.
        width += arg.width - arg.form.width
    return CExpression(form, numbers, width)


def read_from(expression: CExpression, places: Mapping[Temporary, CExpression]) -> CExpression:
    """Replace each temporary that is stored in an array by the array element."""
    form, numbers = expression.form, expression.numbers
    if not form.temporaries:
        return expression
    found = [
        (at, places[key])
        for at, prefix in form.temporaries
        if (key := (prefix, numbers[at])) in places
    ]
    if not found:
        return expression
    moved = list(numbers)
    for at, place in found:
        (moved[at],) = place.numbers
    new = _replaced(form, tuple([(at, place.form) for at, place in found]))
    return CExpression(new, tuple(moved), expression.width)


@lru_cache(maxsize=1 << 14)
def _replaced(form: Form, found: tuple[tuple[int, Form], ...]) -> Form:
    """Replace temporaries in a form by other forms, each of which contains one number."""
    if form.op == "temporary":
        return found[0][1]
    args: list[Form] = []
    start = 0
    for arg in form.args:
        end = start + len(arg.slots)
        own = tuple([(at - start, new) for at, new in found if start <= at < end])
        args.append(_replaced(arg, own) if own else arg)
        start = end
    return _form(form.op, form.name, tuple(args))


#: Types of values: ``REAL`` may be a vector of numbers; ``SCALAR`` is a single number.
REAL, SCALAR, WHOLE = "real", "scalar", "whole"

#: Prefixes of temporary variables that are integers; all others are real.
_WHOLE_PREFIXES = frozenset({"rank", "accepted"})


class Simple:
    """A statement that contains no other statements; ``parts`` names its expressions."""

    __slots__ = ()
    parts: ClassVar[tuple[str, ...]] = ("value",)

    @property
    def expressions(self) -> tuple[CExpression, ...]:
        """Expressions in the order in which they appear in the text."""
        return tuple([getattr(self, part) for part in self.parts])

    def of(self, expressions: Sequence[CExpression]) -> Self:
        """Return the statement with other expressions."""
        new: Any = dict(zip(self.parts, expressions, strict=True))
        return replace(self, **new)  # type: ignore[type-var]


@dataclass(frozen=True, slots=True)
class Assign(Simple):
    """Assignment of ``value`` to all of ``to``; a temporary comes first, and is declared here."""

    to: tuple[CExpression, ...]
    value: CExpression

    @property
    def declares(self) -> Temporary | None:
        """The temporary that the statement declares, if any."""
        # The second target is the array element in which the same value is stored.
        first = self.to[0]
        return (first.form.name, first.numbers[0]) if first.form.op == "temporary" else None

    @property
    def expressions(self) -> tuple[CExpression, ...]:
        """Expressions in the order of the text."""
        return (*self.to, self.value)

    def of(self, expressions: Sequence[CExpression]) -> Assign:
        """Return the statement with other expressions."""
        return Assign(tuple(expressions[:-1]), expressions[-1])


@dataclass(frozen=True, slots=True)
class LeaveUnless(Simple):
    """A return of -``number`` unless ``value > 0``, or ``value >= 0`` if not strict."""

    parts = ("value", "number")
    value: CExpression
    number: CExpression
    is_strict: bool


@dataclass(frozen=True, slots=True)
class SetStatus(Simple):
    """Assignment of ``code`` to the function's status if ``condition`` holds."""

    parts = ("condition", "status")
    condition: CExpression
    code: str
    status: CExpression = named("status")  # noqa: RUF009


@dataclass(frozen=True, slots=True)
class Call(Simple):
    """Function call; ``loop`` is empty, or a macro that repeats the call for several vectors."""

    value: CExpression
    loop: str = ""


@dataclass(frozen=True, slots=True)
class Array(Simple):
    """Declaration of an array, optionally with values."""

    name: str
    length: int
    kind: str = REAL
    values: tuple[CExpression, ...] = ()
    is_constant: bool = False
    is_aligned: bool = False  # whether it is loaded into vectors

    @property
    def expressions(self) -> tuple[CExpression, ...]:
        """Expressions in the order of the text."""
        return (named(self.name), *self.values)

    def of(self, expressions: Sequence[CExpression]) -> Array:
        """Return the statement with other expressions."""
        return replace(self, values=tuple(expressions[1:]))


@dataclass(frozen=True, slots=True)
class ConstantTable:
    """Declaration of a table of constants."""

    name: str
    kind: str
    values: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Comment:
    """A comment on the statements that follow."""

    text: str


@dataclass(frozen=True, slots=True)
class Loop:
    """Loop that executes statements for ``i`` from 0 to ``times - 1``."""

    times: int
    body: tuple[Statement, ...]


@dataclass(frozen=True, slots=True)
class When:
    """Execution of ``body`` if a condition holds, else of ``otherwise``."""

    condition: CExpression
    body: tuple[Statement, ...]
    otherwise: tuple[Statement, ...]


Statement = Simple | ConstantTable | Comment | Loop | When


@dataclass(frozen=True, slots=True)
class Argument:
    """An argument of a function."""

    name: str
    kind: str = SCALAR  # ``REAL``, ``SCALAR``, ``WHOLE``, or a C type
    is_array: bool = True  # whether the argument is an array
    is_constant: bool = True  # whether the function only reads the argument
    is_restricted: bool = True  # whether the pointer is declared ``restrict``
    given: str = ""  # the caller's expression, if it differs from the argument's name


@dataclass(frozen=True, slots=True)
class FunctionPart:
    """The arguments and statements of a function that was split off another one."""

    name: str
    arguments: list[Argument]
    body: list[Statement]


def function_of(
    name: str, body: Sequence[Statement], arguments: Iterable[Argument]
) -> tuple[FunctionPart, CExpression]:
    """Build a function of statements with the arguments that they use, and its call."""
    used = set().union(*map(uses, body))
    taken = [argument for argument in arguments if argument.name in used]
    given = [named(argument.given or argument.name) for argument in taken]
    return FunctionPart(name, taken, list(body)), call(name, *given, op="part")


def kind_of(key: Temporary) -> str:
    """Return the type of a temporary, ``REAL`` or ``WHOLE``."""
    return WHOLE if key[0] in _WHOLE_PREFIXES else REAL


def simple(statements: Iterable[Statement]) -> Iterator[Simple]:
    """Yield all statements, also those in loops and conditions, that contain no others."""
    for row in statements:
        if isinstance(row, Simple):
            yield row
        elif isinstance(row, Loop):
            yield from simple(row.body)
        elif isinstance(row, When):
            # The condition is yielded as a call statement.
            yield from simple((Call(row.condition), *row.body, *row.otherwise))


def declared_by(statement: Statement) -> Temporary | None:
    """Return the temporary that a statement declares, if any."""
    return statement.declares if isinstance(statement, Assign) else None


def uses(statement: Statement) -> set[str | Temporary]:
    """Return all names and temporaries that a statement contains."""
    found: set[str | Temporary] = set()
    is_loop = isinstance(statement, Loop)
    for row in simple((statement,)):
        for expression in row.expressions:
            form, numbers = expression.form, expression.numbers
            found |= form.names
            found.update([(prefix, numbers[at]) for at, prefix in form.temporaries])
            if is_loop:
                found.update(number.table for number in numbers if isinstance(number, TableEntry))
    return found


def changed(statement: Statement, change: Callable[[CExpression], CExpression]) -> Statement:
    """Return a statement with all expressions changed, also those of inner statements."""
    if isinstance(statement, Simple):
        return statement.of([change(expression) for expression in statement.expressions])
    if isinstance(statement, Loop):
        return Loop(statement.times, tuple(changed(row, change) for row in statement.body))
    if isinstance(statement, When):
        inner = (statement.body, statement.otherwise)
        body, otherwise = (tuple(changed(row, change) for row in rows) for rows in inner)
        return When(change(statement.condition), body, otherwise)
    return statement


def n_operations(statements: Iterable[Statement]) -> int:
    """Return the number of operations in the text; those in a loop count once."""
    found = 0
    for row in statements:
        for part in simple((row,)):
            found += sum([expression.form.n_operations for expression in part.expressions])
            if isinstance(part, LeaveUnless):
                found += 1 + part.is_strict
            if isinstance(row, Loop):
                numbers = chain.from_iterable(e.numbers for e in part.expressions)
                found += sum(n.n_operations for n in numbers if isinstance(n, Affine))
        found += isinstance(row, Loop)  # comparison of the loop index
    return found
