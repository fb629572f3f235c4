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
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import numpy.typing as npt

_LONGEST_BODY = 24  # statements of a loop's body
_FEWEST_TIMES = 8
_FEWEST_LINES = 64  # below, statements are as short and read better

_FLOAT = r"\d+\.\d*(?:e[+-]?\d+)?|\d+e[+-]?\d+"
_NUMBER = re.compile(rf"(?<![\w.])(?:({_FLOAT})|v(\d+)\b(?!\[)|(\d+))")
# What may stand in a loop: temporaries, results, guards.
_STATEMENT = re.compile(r"const double v\d+ = |[a-z]+\[\d+\] = |if \(!\(.*\) return -\d+;$")
_DEFINITION = re.compile(r"const double v(\d+) = ")


@dataclass(frozen=True)
class _Line:
    """A statement: what it is but for its numbers, and these."""

    text: str
    form: str  # with a mark in the place of each number
    numbers: tuple[str, ...]

    @classmethod
    def of(cls, text: str) -> _Line:
        if not _STATEMENT.match(text):
            return cls(text, "", ())
        numbers: list[str] = []

        def marked(match: re.Match[str]) -> str:
            real, temporary, whole = match.groups()
            numbers.append(real or temporary or whole)
            return "\x00" if real else "v\x02" if temporary else "\x01"

        return cls(text, _NUMBER.sub(marked, text), tuple(numbers))


def roll(lines: Sequence[str]) -> list[str]:
    """Turn repeated statements into loops.

    Parameters
    ----------
    lines : sequence of str
        Statements in order of evaluation, one each.

    Returns
    -------
    list of str
        The same with loops; tables and the array of their temporaries come first.
    """
    if len(lines) < _FEWEST_LINES:
        return list(lines)
    parsed = _parse(lines)
    pieces = list(_pieces(parsed))
    if not any(times > 1 for _, _, times in pieces):
        return list(lines)
    kept = _kept_in_array(parsed, pieces)
    writer = _Writer(kept)
    for start, period, times in pieces:
        rows = parsed[start : start + period * times]
        if times == 1:
            writer.lines += [writer.plain(row) for row in rows]
        else:
            writer.loop([rows[i::period] for i in range(period)])
    size = [f"double v[{max(kept) + 1}];"] if kept else []
    return [*size, *writer.tables, *writer.lines]


def _parse(lines: Sequence[str]) -> list[_Line]:
    """Tell forms from numbers, where statements repeat even when kinds of numbers are ignored."""
    covered = _cover([_NUMBER.sub("", text) for text in lines])
    n = len(lines)
    reach = covered.max(axis=0)
    begins = np.flatnonzero(reach)
    changes = np.zeros(n + 1, dtype=np.intp)
    changes[begins] += 1
    np.subtract.at(changes, begins + reach[begins], 1)
    repeats = np.cumsum(changes) > 0
    return [_Line.of(text) if repeats[i] else _Line(text, "", ()) for i, text in enumerate(lines)]


def _cover(forms: Sequence[str]) -> npt.NDArray[np.intp]:
    """Count the statements of the loop with each length of body (rows) that begins at each place.

    Those that are empty are like no other.
    """
    n = len(forms)
    numbers: dict[str, int] = {}
    labels = np.array(
        [numbers.setdefault(form, len(numbers)) if form else -1 - i for i, form in enumerate(forms)]
    )
    covered = np.zeros((_LONGEST_BODY + 1, n + 1), dtype=np.intp)
    for period in range(1, min(_LONGEST_BODY, n - 1) + 1):
        agreed = _run_lengths(labels[:-period] == labels[period:])
        times = agreed // period + 1
        is_worth = (times >= _FEWEST_TIMES) & (times * period >= _FEWEST_LINES)
        covered[period, : n - period] = np.where(is_worth, times * period, 0)
    return covered


def _pieces(lines: Sequence[_Line]) -> Iterator[tuple[int, int, int]]:
    """Cut the statements into pieces: start, length of the body, how often it is repeated."""
    n = len(lines)
    covered = _cover([row.form for row in lines])
    reach = covered.max(axis=0)
    start = plain = 0
    while start < n:
        # A run may begin one line late, where it is then longer.
        if reach[start] == 0 or reach[start + 1] > reach[start]:
            start += 1
            continue
        if start > plain:
            yield plain, start - plain, 1
        period = _best_period(lines, start, covered[:, start])
        times = int(covered[period, start]) // period
        yield start, period, times
        start = plain = start + period * times
    if start > plain:
        yield plain, start - plain, 1


def _best_period(lines: Sequence[_Line], start: int, covered: npt.NDArray[np.intp]) -> int:
    """Choose the shortest body whose places grow evenly, among those that cover about as much."""
    most = int(covered.max())
    periods = [p for p in range(1, len(covered)) if covered[p] > 0 and covered[p] + p > most]
    for period in periods:
        rows = lines[start : start + int(covered[period])]
        if all(
            _step(column) is not None
            for i in range(period)
            for column in zip(*(row.numbers for row in rows[i::period]), strict=True)
        ):
            return period
    return int(covered.argmax())


def _step(column: Sequence[str]) -> int | None:
    """Give what a number grows by each time; None where that changes."""
    if all(number == column[0] for number in column):
        return 0
    if not all(number.isdigit() for number in column):
        return None
    first, second, *rest = map(int, column)
    step = second - first
    is_even = all(number == first + step * (i + 2) for i, number in enumerate(rest))
    return step if is_even else None


def _run_lengths(holds: npt.NDArray[np.bool_]) -> npt.NDArray[np.intp]:
    """Count, from each place on, how long something holds."""
    n = len(holds)
    breaks = np.flatnonzero(~holds)
    nexts = np.append(breaks, n)[np.searchsorted(breaks, np.arange(n))]
    return np.asarray(nexts - np.arange(n), dtype=np.intp)


def _kept_in_array(lines: Sequence[_Line], pieces: Sequence[tuple[int, int, int]]) -> set[int]:
    """List the temporaries that loops make or read."""
    found: set[int] = set()
    for start, period, times in pieces:
        if times > 1:
            for row in lines[start : start + period * times]:
                found.update(_temporaries(row))
    return found


def _temporaries(row: _Line) -> list[int]:
    marks = [mark for mark in row.form if mark in "\x00\x01\x02"]
    pairs = zip(marks, row.numbers, strict=True)
    return [int(number) for mark, number in pairs if mark == "\x02"]


class _Writer:
    """Writes statements and loops."""

    def __init__(self, kept: set[int]) -> None:
        self.lines: list[str] = []
        self.tables: list[str] = []
        self._kept = kept
        self._names: Counter[str] = Counter()

    def plain(self, row: _Line) -> str:
        """Write a statement that stands alone."""

        def named(match: re.Match[str]) -> str:
            number = match.group(2)
            return f"v[{number}]" if number and int(number) in self._kept else match.group()

        made = _DEFINITION.match(row.text)
        text = row.text
        if made and int(made.group(1)) in self._kept:
            text = text.removeprefix("const double ")
        return text if row.text.startswith("/*") else _NUMBER.sub(named, text)

    def loop(self, body: Sequence[Sequence[_Line]]) -> None:
        """Write a loop; each row of the body is one statement, as it is each time."""
        self.lines.append(f"for (int i = 0; i < {len(body[0])}; ++i) {{")
        for rows in body:
            text = rows[0].form.removeprefix("const double ")
            places = [
                self._place(column) for column in zip(*(r.numbers for r in rows), strict=True)
            ]
            parts = re.split("([\x00\x01\x02])", text)
            given = iter(places)
            for at, part in enumerate(parts):
                if part == "\x02":
                    parts[at] = f"[{next(given)}]"
                elif part in ("\x00", "\x01"):
                    parts[at] = next(given)
            self.lines.append("    " + "".join(parts))
        self.lines.append("}")

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
        self.tables.append(f"static const {kind} {name}[{len(column)}] = {{")
        text = " ".join(f"{number}," for number in column)
        self.tables += textwrap.wrap(text, 92, initial_indent="    ", subsequent_indent="    ")
        self.tables.append("};")
        return f"{name}[i]"
