"""Conversion of statements to C text for a target; no other module writes statements as C."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from itertools import chain
from string import Formatter
from typing import TYPE_CHECKING

from cotree.codegen.ir import (
    SCALAR,
    Affine,
    Array,
    Assign,
    Call,
    Comment,
    ConstantTable,
    LeaveUnless,
    Loop,
    SetStatus,
    Simple,
    TableEntry,
    When,
    kind_of,
    n_operations,
)
from cotree.codegen.targets import DOUBLE
from cotree.naming import c_comment

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator

    from cotree.codegen.ir import CExpression, Form, Number, Statement
    from cotree.codegen.kernel_blocks import Blocks
    from cotree.codegen.targets import Target

_WIDTH, _INDENT = 98, "    "
#: Lowest precedence at which an expression needs no parentheses after a sign.
_TIGHTEST = 4

#: Text of expressions without arguments; %s represents the number.
_LEAVES = {
    "number": "%s{suffix}",
    "whole": "%s",
    "element": "{name}[%s]",
    "temporary": "{name}%s",
    "name": "{name}",
    "zero": "{zero}",
}


@dataclass(frozen=True)
class BlockText:
    """Head and statements of a function that was split off another one, as text."""

    signature: str
    lines: list[str]


@dataclass(frozen=True)
class Body:
    """The statements of a function as text."""

    lines: list[str]  # lines of the function itself
    blocks: list[BlockText]  # functions split off this one, in calling order
    #: Number of operations in each of these blocks, then in the function; loops count once.
    written: list[int]

    @property
    def text(self) -> list[str]:
        """All lines of the function and of the blocks."""
        return [*chain.from_iterable((b.signature, *b.lines) for b in self.blocks), *self.lines]


@dataclass(frozen=True)
class Constants:
    """A table of constants as text, from :func:`constants`."""

    type: str
    name: str
    length: int
    lines: list[str]


def constants(kind: str, name: str, items: Iterable[str]) -> Constants:
    """Return a table in which every entry is written, including zeros.

    If an entry has no initialiser, gcc 12 reads a vector that begins there as zeros, even if later
    entries are nonzero.
    """
    items = [*items]
    return Constants(kind, name, len(items), wrapped(items))


def int_table(name: str, numbers: Iterable[int]) -> Constants:
    """Return a table of integers; if empty, it contains a zero, since C has no empty arrays."""
    return constants("int", name, list(map(str, numbers)) or ["0"])


def print_lines(statements: Iterable[Statement], target: Target = DOUBLE) -> list[str]:
    """Return the lines of statements."""
    return list(_Printer(target).lines(statements))


def print_expression(expression: CExpression, target: Target = DOUBLE) -> str:
    """Return the text of an expression."""
    return _Printer(target).expression(expression)


def print_body(cut: Blocks, target: Target = DOUBLE) -> Body:
    """Return the text of a function, and of the blocks into which it is divided."""
    printer, blocks = _Printer(target), []
    for function in cut.functions:
        heads = [target.declared(argument) for argument in function.arguments] or ["void"]
        head = function_head(target.function, target.name.format(function.name), heads)
        blocks.append(BlockText(head, list(printer.lines(function.body))))
    # The function itself comes last; see Body.written.
    counted = [*(function.body for function in cut.functions), cut.statements]
    lines = list(printer.lines(cut.statements))
    return Body(lines, blocks, [*map(n_operations, counted)])


class _Printer:
    """Writer of statements for one target; the text of each form is cached."""

    def __init__(self, target: Target) -> None:
        self._target = target
        self._formats: dict[Form, str] = {}
        self._is_in_loop = False
        # Programs contain doubles, which may exceed the range of the target's type.
        self._is_narrow = target.most_decades < DOUBLE.most_decades

    def lines(self, statements: Iterable[Statement]) -> Iterator[str]:
        """Yield the lines of statements."""
        for statement in statements:
            if isinstance(statement, Simple):
                yield self._simple(statement)
            elif isinstance(statement, Comment):
                yield f"/* {c_comment(statement.text)} */"
            else:
                yield from self._compound(statement)

    def expression(self, expression: CExpression) -> str:
        """Return the text of an expression."""
        text, numbers = self._format(expression.form), expression.numbers
        if self._is_narrow:
            numbers = self._fitted(expression)
        # Outside loops all numbers are plain, so faster formatting suffices.
        if self._is_in_loop:
            return text % tuple(map(_number, numbers, expression.form.slots))
        return text % numbers

    def _fitted(self, expression: CExpression) -> tuple[Number, ...]:
        """Return an expression's numbers in the target type; raise CodegenError if out of range."""
        return tuple(
            self._target.fitted(number) if slot == "r" and isinstance(number, float) else number
            for number, slot in zip(expression.numbers, expression.form.slots, strict=True)
        )

    def _assign(self, row: Assign) -> str:
        to = " = ".join([self.expression(place) for place in row.to])
        declared = row.declares
        head = f"const {self._target.type_of(kind_of(declared))} " if declared else ""
        return f"{head}{to} = {self.expression(row.value)};"

    def _simple(self, row: Simple) -> str:
        """Return the text of a statement on one line."""
        if isinstance(row, Assign):
            return self._assign(row)
        if isinstance(row, LeaveUnless):
            comparison = ">" if row.is_strict else ">="
            value, number = map(self.expression, row.expressions)
            # "!" makes nan leave the function too
            return f"if (!({value} {comparison} 0.0{self._target.suffix})) return -{number};"
        if isinstance(row, SetStatus):
            return (
                f"if ({self.expression(row.condition)}) {self.expression(row.status)} = {row.code};"
            )
        if isinstance(row, Call):
            return f"{row.loop}{self.expression(row.value)};"
        assert isinstance(row, Array)
        head = f"{self._target.type_of(row.kind)} {row.name}[{row.length}]"
        if row.is_aligned:
            head = f"{self._target.aligned}{head}"
        # Arrays without values are filled later, so they cannot be const.
        if not row.values:
            return f"{head};"
        constant = "const " if row.is_constant else ""
        return f"{constant}{head} = {{{', '.join(map(self.expression, row.values))}}};"

    def _compound(self, row: ConstantTable | Loop | When) -> Iterator[str]:
        if isinstance(row, ConstantTable):
            kind = self._target.type_of_entry(row.kind)
            yield f"static const {kind} {row.name}[{len(row.values)}] = {{"
            spelt = self._target.literal if row.kind == SCALAR else str
            text = " ".join([f"{spelt(value)}," for value in row.values])
            yield from textwrap.wrap(text, 92, initial_indent=_INDENT, subsequent_indent=_INDENT)
            yield "};"
        elif isinstance(row, Loop):
            yield f"for (int i = 0; i < {row.times}; ++i) {{"
            self._is_in_loop = True
            yield from self._indented(row.body)
            # Loops are not nested.
            self._is_in_loop = False
            yield "}"
        else:
            yield f"if ({self.expression(row.condition)}) {{"
            yield from self._indented(row.body)
            if row.otherwise:
                yield "} else {"
                yield from self._indented(row.otherwise)
            yield "}"

    def _indented(self, rows: Iterable[Statement]) -> Iterator[str]:
        return (f"{_INDENT}{line}" for line in self.lines(rows))

    def _format(self, form: Form) -> str:
        """Return the format string of a form, with a placeholder for each number."""
        text = self._formats.get(form)
        if text is None:
            text = self._formats[form] = self._spelt(form)
        return text

    def _spelt(self, form: Form) -> str:
        op, name = form.op, form.name
        if op == "tolerance":
            return self._target.number.format(self._target.share(name))
        if op in _LEAVES:
            target = self._target
            text = _LEAVES[op].format(name=name, suffix=target.suffix, zero=target.zero)
            return target.number.format(text) if op == "number" else text
        if self._target.fused and op in ("add", "sub"):
            left, right = form.args
            if left.op == "mul":
                a, b = map(self._format, left.args)
                return f"{self._target.fused}({a}, {b}, {self._signed(op, right)})"
            if right.op == "mul":
                # Keep the order of the numbers in the form: those of c precede those of a and b.
                a, b = self._signed(op, right.args[0]), self._format(right.args[1])
                return f"{self._target.fused_onto}({self._format(left)}, {a}, {b})"
        args = [self._format(arg) for arg in form.args]
        if op in ("call", "part"):
            own = self._target.name.format(name) if op == "part" else name
            return f"{own}({', '.join(args)})"
        parts, given = [], iter(zip(args, form.args, form.needs, strict=True))
        for text, place, _, _ in Formatter().parse(self._target.spelling(op)):
            parts.append(text)
            if place is not None:
                spelt, arg, needed = next(given)
                parts.append(spelt if arg.level >= needed else f"({spelt})")
        return "".join(parts)

    def _signed(self, op: str, form: Form) -> str:
        """Return a term of a sum or difference with its sign."""
        text = self._format(form)
        if op == "add":
            return text
        return f"-{text}" if form.level >= _TIGHTEST else f"-({text})"


def _number(number: Number, slot: str) -> str:
    """Return the text of a number in a loop; a sum outside brackets gets parentheses."""
    if isinstance(number, TableEntry):
        return f"{number.table}[i]"
    if not isinstance(number, Affine):
        return str(number)
    # Indices and counts are nonnegative, so a decreasing one begins with its first value.
    step, first = number.step, number.first
    if step < 0:
        text = f"{first} - {'i' if step == -1 else f'{-step} * i'}"
    else:
        text = "i" if step == 1 else f"{step} * i"
        text = f"{text} + {first}" if first else text
    return f"({text})" if slot == "w" and " " in text else text


def function_head(result: str, name: str, arguments: Collection[str]) -> str:
    """Return a function head, with line breaks only between arguments."""
    lines = [f"{result} {name}("]
    indent = " " * len(lines[0])
    for i, argument in enumerate(arguments):
        separator = ")" if i == len(arguments) - 1 else ","
        if len(lines[-1]) + len(argument) > _WIDTH and not lines[-1].endswith("("):
            lines[-1] = lines[-1].rstrip()
            lines.append(indent)
        lines[-1] += f"{argument}{separator} "
    return "\n".join(lines).rstrip()


def wrapped(items: Iterable[str]) -> list[str]:
    """Return lines of readable length, filled with items that each end with a comma."""
    text = " ".join(f"{item}," for item in items)
    return textwrap.wrap(text, 96, break_long_words=False, break_on_hyphens=False)
