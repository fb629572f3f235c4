"""Repeated statements to loops.

Statements that follow one another and differ in their numbers only (the stages of a ladder, the
nonzeros of a Jacobian) become the body of a loop: places that grow by the same amount each time
are computed, others are read from a table. The order of evaluation stays. Temporaries that a loop
makes or reads live in an array; all others stay as they are.
"""

from __future__ import annotations

import re
import textwrap
from collections import Counter
from dataclasses import dataclass
from itertools import takewhile
from typing import TYPE_CHECKING

from cotree.codegen.repeats import FEWEST_LINES, Statement, may_repeat, pieces

if TYPE_CHECKING:
    from collections.abc import Sequence

#: Up to so many statements a compiler takes little time; what loops leave of them runs slower
#: by a fifth than they do, unless that is less than this share.
_SHORT, _MUCH_SHORTER = 8000, 0.25

_FLOAT = r"\d+\.\d*(?:e[+-]?\d+)?|\d+e[+-]?\d+"
_NUMBER = re.compile(rf"(?<![\w.])(?:({_FLOAT})|v(\d+)\b(?!\[)|(\d+))")
# Statements that may stand in a loop: temporaries, results, guards.
_STATEMENT = re.compile(
    r"const double v\d+ = |(?:[a-z]+|(?:shared|own)\d+)\[\d+\] = |if \(!\(.*\) return -\d+;$"
)
_MARK = re.compile("([\x00\x01\x02])")
_DEFINITION = re.compile(r"const double v(\d+) = ")


@dataclass(frozen=True)
class _Line:
    """A statement, split into its text without numbers and the numbers themselves."""

    text: str
    comment: str  # that stands before it
    form: str  # with a mark in the place of each number
    numbers: tuple[str, ...]

    @classmethod
    def of(cls, text: str, comment: str) -> _Line:
        if not _STATEMENT.match(text):
            return cls(text, comment, "", ())
        numbers: list[str] = []

        def marked(match: re.Match[str]) -> str:
            real, temporary, whole = match.groups()
            numbers.append(real or temporary or whole)
            return "\x00" if real else "\x02" if temporary else "\x01"

        return cls(text, comment, _NUMBER.sub(marked, text), tuple(numbers))

    @property
    def statement(self) -> Statement:
        """The statement in the form in which repeats are looked for."""
        marked = list(zip(_MARK.findall(self.form), self.numbers, strict=True))
        return Statement(
            self.form,
            tuple(int(number) for mark, number in marked if mark != "\x00"),
            tuple(number for mark, number in marked if mark == "\x00"),
        )


def roll(lines: Sequence[str], array: str = "v") -> list[str]:
    """Turn repeated statements into loops.

    Parameters
    ----------
    lines : sequence of str
        Statements in order of evaluation, one each, and comments.
    array : str
        Name of the array of loops' temporaries.

    Returns
    -------
    list of str
        The same with loops; tables and the array of their temporaries come first. Statements that
        loops would not shorten much, and that are not too many, stay as they are.
    """
    statements, comments = _apart(lines)
    if len(statements) < FEWEST_LINES:
        return list(lines)
    parsed = _parse(statements, comments)
    found = list(pieces([row.statement for row in parsed]))
    if not any(times > 1 for _, _, times in found):
        return list(lines)
    writer = _Writer(_kept_in_array(parsed, found), array)
    for start, period, times in found:
        rows = parsed[start : start + period * times]
        if times == 1:
            writer.plain(rows)
        else:
            writer.loop([rows[i::period] for i in range(period)])
    if len(lines) <= _SHORT and writer.n_lines > _MUCH_SHORTER * len(lines):
        return list(lines)
    return writer.written()


def _apart(lines: Sequence[str]) -> tuple[list[str], list[str]]:
    """Give the statements, and the comment before each."""
    statements: list[str] = []
    comments: list[str] = []
    comment = ""
    for line in lines:
        if line.startswith("/*"):
            comment = line
            continue
        statements.append(line)
        comments.append(comment)
        comment = ""
    return statements, comments


def _parse(statements: Sequence[str], comments: Sequence[str]) -> list[_Line]:
    """Tell forms from numbers, where statements repeat even when kinds of numbers are ignored."""
    repeats = may_repeat([_NUMBER.sub("", text) for text in statements])
    return [
        _Line.of(text, comment) if repeats[i] else _Line(text, comment, "", ())
        for i, (text, comment) in enumerate(zip(statements, comments, strict=True))
    ]


def _step(column: Sequence[str]) -> int | None:
    """Return the constant increment of a number; None where the increment changes."""
    if all(number == column[0] for number in column):
        return 0
    if not all(number.isdigit() for number in column):
        return None
    first, second, *rest = map(int, column)
    step = second - first
    is_even = all(number == first + step * (i + 2) for i, number in enumerate(rest))
    return step if is_even else None


def _kept_in_array(lines: Sequence[_Line], found: Sequence[tuple[int, int, int]]) -> dict[str, int]:
    """Give the temporaries that loops make or read a place, in the order of their numbers."""
    kept: set[int] = set()
    for start, period, times in found:
        if times > 1:
            for row in lines[start : start + period * times]:
                kept.update(_temporaries(row))
    return {str(number): place for place, number in enumerate(sorted(kept))}


def _temporaries(row: _Line) -> list[int]:
    return [
        int(n)
        for mark, n in zip(_MARK.findall(row.form), row.numbers, strict=True)
        if mark == "\x02"
    ]


class _Writer:
    """Writes statements and loops."""

    def __init__(self, kept: dict[str, int], array: str) -> None:
        self._lines: list[str] = []
        self._tables: list[str] = []
        self._kept = kept
        self._array = array
        self._names: Counter[str] = Counter()

    @property
    def n_lines(self) -> int:
        """Number of lines of statements."""
        return len(self._lines)

    def written(self) -> list[str]:
        """Give all lines: the array, the tables, the statements."""
        size = [f"double {self._array}[{len(self._kept)}];"] if self._kept else []
        return [*size, *self._tables, *self._lines]

    def plain(self, rows: Sequence[_Line]) -> None:
        """Write statements that stand alone."""

        def named(match: re.Match[str]) -> str:
            number = match.group(2)
            place = self._kept.get(number) if number else None
            return match.group() if place is None else f"{self._array}[{place}]"

        for row in rows:
            if row.comment:
                self._lines.append(row.comment)
            made = _DEFINITION.match(row.text)
            text = row.text
            if made and made.group(1) in self._kept:
                text = text.removeprefix("const double ")
            self._lines.append(_NUMBER.sub(named, text))

    def loop(self, body: Sequence[Sequence[_Line]]) -> None:
        """Write a loop; each row of the body is one statement, as it is each time."""
        self._lines.append(f"for (int i = 0; i < {len(body[0])}; ++i) {{")
        for rows in body:
            comment = _of_all([row.comment for row in rows])
            if comment:
                self._lines.append(f"    {comment}")
            text = rows[0].form.removeprefix("const double ")
            columns = iter(zip(*(row.numbers for row in rows), strict=True))
            parts = _MARK.split(text)
            for at, part in enumerate(parts):
                if part == "\x02":
                    places = [str(self._kept[number]) for number in next(columns)]
                    parts[at] = f"{self._array}[{self._place(places)}]"
                elif part in ("\x00", "\x01"):
                    place = self._place(next(columns))
                    is_in_brackets = parts[at - 1].endswith("[")
                    parts[at] = place if is_in_brackets or " " not in place else f"({place})"
            self._lines.append("    " + "".join(parts))
        self._lines.append("}")

    def _place(self, column: Sequence[str]) -> str:
        """Write a number that may change each time."""
        step = _step(column)
        if step is None:
            is_whole = all(number.isdigit() for number in column)
            return (
                self._table("int", "j", column) if is_whole else self._table("double", "c", column)
            )
        if step == 0:
            return column[0]
        first = int(column[0])
        scaled = "i" if step == 1 else f"{step} * i"
        if step < 0:
            return f"{first} - {'i' if step == -1 else f'{-step} * i'}"
        return f"{scaled} + {first}" if first else scaled

    def _table(self, kind: str, prefix: str, column: Sequence[str]) -> str:
        name = f"{prefix}_{self._names[prefix]}"
        self._names[prefix] += 1
        self._tables.append(f"static const {kind} {name}[{len(column)}] = {{")
        text = " ".join(f"{number}," for number in column)
        self._tables += textwrap.wrap(text, 92, initial_indent="    ", subsequent_indent="    ")
        self._tables.append("};")
        return f"{name}[i]"


def _of_all(comments: Sequence[str]) -> str:
    """Merge the comments of a repeated statement into one."""
    first, last = comments[0], comments[-1]
    if first == last or not first or not last:
        return first
    words = last.split(" ")
    same = takewhile(lambda pair: pair[0] == pair[1], zip(first.split(" "), words, strict=False))
    return f"{first.removesuffix(' */')} to {' '.join(words[len(list(same)) :])}"
