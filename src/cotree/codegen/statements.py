"""Statements as data: the small language between a program and its text.

In: what the printer of nodes, the roller of loops and the cutters of functions have to say. Out:
the same for :mod:`cotree.codegen.printing`, which alone knows how C spells it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Any, ClassVar, Self

from cotree.codegen.expressions import Affine, CExpression, TableEntry, Temporary, call, named

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

#: Types of values. A target says what they are in C: ``REAL`` is what its statements compute with,
#: which may hold several numbers at a time, ``SCALAR`` is one number.
REAL, SCALAR, WHOLE = "real", "scalar", "whole"

#: Temporaries that are whole numbers, by their prefix; all others are real.
_WHOLE_PREFIXES = frozenset({"rank", "accepted"})


class Simple:
    """A statement that is made of expressions, in the fields that ``parts`` names."""

    __slots__ = ()
    parts: ClassVar[tuple[str, ...]] = ("value",)

    @property
    def expressions(self) -> tuple[CExpression, ...]:
        """All expressions that it is made of, in the order of its text."""
        return tuple([getattr(self, part) for part in self.parts])

    def of(self, expressions: Sequence[CExpression]) -> Self:
        """Make the same statement of other expressions."""
        new: Any = dict(zip(self.parts, expressions, strict=True))
        return replace(self, **new)  # type: ignore[type-var]


@dataclass(frozen=True, slots=True)
class Assign(Simple):
    """``to`` becomes ``value``; a temporary, which comes first there, is declared by that."""

    to: tuple[CExpression, ...]
    value: CExpression

    @property
    def declares(self) -> Temporary | None:
        """The temporary that it declares, if any."""
        # A second place, if any, is an element of an array that keeps the same value.
        first = self.to[0]
        return (first.form.name, first.numbers[0]) if first.form.op == "temporary" else None

    @property
    def expressions(self) -> tuple[CExpression, ...]:
        """All expressions that it is made of, in the order of its text."""
        return (*self.to, self.value)

    def of(self, expressions: Sequence[CExpression]) -> Assign:
        """Make the same statement of other expressions."""
        return Assign(tuple(expressions[:-1]), expressions[-1])


@dataclass(frozen=True, slots=True)
class LeaveUnless(Simple):
    """Leave the function with minus ``number`` unless ``value`` is above zero, or at least zero."""

    parts = ("value", "number")
    value: CExpression
    number: CExpression
    is_strict: bool


@dataclass(frozen=True, slots=True)
class Report(Simple):
    """Set the function's status to ``code`` where ``condition`` holds."""

    parts = ("condition", "status")
    condition: CExpression
    code: str
    status: CExpression = named("status")  # noqa: RUF009


@dataclass(frozen=True, slots=True)
class Call(Simple):
    """Call a function; ``loop`` is a macro that does so for each of several vectors, if any."""

    value: CExpression
    loop: str = ""


@dataclass(frozen=True, slots=True)
class Array(Simple):
    """Declare an array, with values or without."""

    name: str
    length: int
    kind: str = REAL
    values: tuple[CExpression, ...] = ()
    is_constant: bool = False
    is_aligned: bool = False  # vectors are read from it

    @property
    def expressions(self) -> tuple[CExpression, ...]:
        """All expressions that it is made of, in the order of its text."""
        return (named(self.name), *self.values)

    def of(self, expressions: Sequence[CExpression]) -> Array:
        """Make the same statement of other expressions."""
        return replace(self, values=tuple(expressions[1:]))


@dataclass(frozen=True, slots=True)
class ConstantTable:
    """Declare a table of constants."""

    name: str
    kind: str
    values: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Comment:
    """Words about the statements that follow."""

    text: str


@dataclass(frozen=True, slots=True)
class Loop:
    """Run statements for ``i`` from 0 on."""

    times: int
    body: tuple[Statement, ...]


@dataclass(frozen=True, slots=True)
class When:
    """Run some statements where a condition holds, and others where it does not."""

    condition: CExpression
    body: tuple[Statement, ...]
    otherwise: tuple[Statement, ...]


Statement = Simple | ConstantTable | Comment | Loop | When


@dataclass(frozen=True, slots=True)
class Argument:
    """An argument of a function.

    Attributes
    ----------
    name : str
        Its name.
    kind : str
        ``REAL``, ``SCALAR``, ``WHOLE``, or a type of C.
    is_array : bool
        Whether it is an array.
    is_constant : bool
        Whether the function only reads it.
    is_restricted : bool
        Whether the array is the only way to what it holds.
    given : str
        The caller's expression, if it does not have the same name.
    """

    name: str
    kind: str = SCALAR
    is_array: bool = True
    is_constant: bool = True
    is_restricted: bool = True
    given: str = ""


@dataclass(frozen=True, slots=True)
class FunctionPart:
    """A function that is part of another: its arguments and statements."""

    name: str
    arguments: list[Argument]
    body: list[Statement]


def function_of(
    name: str, body: Sequence[Statement], arguments: Iterable[Argument]
) -> tuple[FunctionPart, CExpression]:
    """Make a function of statements, and its call.

    Parameters
    ----------
    name : str
        Its name, which the target completes.
    body : sequence of Statement
        Its statements.
    arguments : iterable of Argument
        The arguments to choose from; those that it uses are taken.
    """
    used = set().union(*map(uses, body))
    taken = [argument for argument in arguments if argument.name in used]
    given = [named(argument.given or argument.name) for argument in taken]
    return FunctionPart(name, taken, list(body)), call(name, *given, op="part")


def kind_of(key: Temporary) -> str:
    """Tell whether a temporary is a real or a whole number."""
    return WHOLE if key[0] in _WHOLE_PREFIXES else REAL


def simple(statements: Iterable[Statement]) -> Iterator[Simple]:
    """List the statements that are made of expressions, those inside of others included."""
    for row in statements:
        if isinstance(row, Simple):
            yield row
        elif isinstance(row, Loop):
            yield from simple(row.body)
        elif isinstance(row, When):
            # The condition is made of one expression, as a call is.
            yield from simple((Call(row.condition), *row.body, *row.otherwise))


def declared_by(statement: Statement) -> Temporary | None:
    """Tell which temporary a statement declares."""
    return statement.declares if isinstance(statement, Assign) else None


def uses(statement: Statement) -> set[str | Temporary]:
    """List all names and temporaries in a statement."""
    found: set[str | Temporary] = set()
    is_loop = isinstance(statement, Loop)
    for row in simple((statement,)):
        for expression in row.expressions:
            form, numbers = expression.form, expression.numbers
            found |= form.names
            found.update([(prefix, numbers[at]) for at, prefix in form.temporaries])
            # Only loops read tables of numbers.
            if is_loop:
                found.update(number.table for number in numbers if isinstance(number, TableEntry))
    return found


def changed(statement: Statement, change: Callable[[CExpression], CExpression]) -> Statement:
    """Make the same statement of other expressions, inside of loops and conditions, too."""
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
    """Count the operations that stand in statements: those of loops, and of indices, once."""
    found = 0
    for row in statements:
        for part in simple((row,)):
            found += sum([expression.form.n_operations for expression in part.expressions])
            if isinstance(part, LeaveUnless):
                found += 1 + part.is_strict
            if isinstance(row, Loop):
                numbers = chain.from_iterable(e.numbers for e in part.expressions)
                found += sum(n.n_operations for n in numbers if isinstance(n, Affine))
        found += isinstance(row, Loop)  # the comparison of i
    return found
