"""Conversion of repeated statements to loops.

Consecutive statements that differ only in their numbers (the stages of a ladder, the nonzeros of a
Jacobian) become a loop. Indices with a constant step are computed, all others are read from a
table. The order of evaluation is unchanged. Temporaries in loops become array elements.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import takewhile
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.codegen.ir import (
    REAL,
    SCALAR,
    WHOLE,
    Affine,
    Array,
    Assign,
    CExpression,
    Comment,
    ConstantTable,
    LeaveUnless,
    Loop,
    TableEntry,
    changed,
    element,
    kind_of,
    read_from,
)

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator, Mapping, Sequence

    import numpy.typing as npt

    from cotree.codegen.ir import Number, Statement, Temporary


LONGEST_BODY = 150  # maximum number of statements in a loop body; suffices for a spatial link
FEWEST_LINES = 64  # minimum number of statements that a loop replaces
_FEWEST_EVEN = 24  # the same minimum for loops without tables
_FEWEST_TIMES = 8


@dataclass(frozen=True, slots=True)
class StatementRow:
    """A statement, split into its form and its numbers."""

    #: Equal for statements that differ only in numbers; None keeps a statement outside loops.
    form: Hashable
    whole: tuple[int, ...] = ()  # whole numbers of the statement, in order
    real: tuple[float, ...] = ()  # constants of the statement, in order


def pieces(statements: Sequence[StatementRow]) -> Iterator[tuple[int, int, int]]:
    """Divide statements into loops; yield start, length of the body and number of iterations.

    In even loops, all numbers have constant steps; other loops need tables. Even loops are
    preferred if they cover about as many statements. Statements outside loops form pieces with one
    iteration.
    """
    n = len(statements)
    # For each start: length of the longest loop, and of the longest even loop.
    labels = _labels([row.form for row in statements])
    reach = _form_reach(labels)
    even, period_of = _even_reach(statements, labels)
    covered = np.cumsum([0, *_covered_by_even(even)])
    start = plain = 0
    while start < n:
        period, length = 0, int(reach[start])
        # Skip this loop if a loop that starts one statement later is longer.
        is_longest = length > 0 and reach[start + 1] <= length
        # Use tables only if even loops cover less than half of the loop's statements.
        if is_longest and 2 * (covered[start + length] - covered[start]) < length:
            period = _shortest_period(labels, start, length)
            length -= length % period
        elif even[start] > 0 and even[start + 1] <= even[start]:
            period, length = int(period_of[start]), int(even[start])
        if not period:
            start += 1
            continue
        if start > plain:
            yield plain, start - plain, 1
        yield start, period, length // period
        start = plain = start + length
    if start > plain:
        yield plain, start - plain, 1


def _labels(forms: Sequence[Hashable]) -> npt.NDArray[np.intp]:
    """Return the number of each statement's form; statements without a form get unique numbers."""
    numbers: dict[Hashable, int] = {}
    return np.array(
        [-1 - i if f is None else numbers.setdefault(f, len(numbers)) for i, f in enumerate(forms)],
        dtype=np.intp,
    )


def _form_reach(labels: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """Return the length of the longest loop from each start if numbers may differ arbitrarily."""
    n = len(labels)
    reach = np.zeros(n + 1, dtype=np.intp)
    for period in range(1, min(LONGEST_BODY, n - 1) + 1):
        # Number of consecutive statements that equal the statement one period later.
        agreed = _run_lengths(labels[:-period] == labels[period:])
        part = reach[: n - period]
        np.maximum(part, _worth(agreed // period + 1, period, FEWEST_LINES), out=part)
    return reach


def _shortest_period(labels: npt.NDArray[np.intp], start: int, length: int) -> int:
    """Return the shortest loop body that covers about the same statements."""
    part = labels[start : start + length]
    for period in range(1, LONGEST_BODY + 1):
        differing = np.flatnonzero(part[:-period] != part[period:])
        agreed = int(differing[0]) if len(differing) else len(part) - period
        times = agreed // period + 1
        if times >= _FEWEST_TIMES and times * period + period > length:
            return period
    raise AssertionError("a loop was found that is none")


def _even_reach(
    statements: Sequence[StatementRow], labels: npt.NDArray[np.intp]
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """For each start, return the length of the longest even loop, and of its body."""
    n = len(labels)
    best, period_of = np.zeros(n + 1, dtype=np.intp), np.zeros(n + 1, dtype=np.intp)
    whole = _padded([row.whole for row in statements])
    # Even loops have the same constants in all iterations; constants are numbered for comparison.
    names: dict[float, int] = {}
    real = _padded([tuple(names.setdefault(r, len(names)) for r in row.real) for row in statements])
    for period in range(1, min(LONGEST_BODY, (n - 1) // 2) + 1):
        is_same = labels[:-period] == labels[period:]
        agreed = _run_lengths(is_same)
        hoped = _worth(agreed // period + 1, period, _FEWEST_EVEN)
        # Examine only starts whose loop may become longer than the best one so far.
        rows = np.flatnonzero(hoped > best[: n - period])
        if not len(rows):
            continue
        # Count the loops that contain each statement: +1 at starts, -1 after ends.
        ends = np.zeros(n + 1, dtype=np.intp)
        ends[rows] += 1
        np.subtract.at(ends, rows + agreed[rows], 1)
        rows = np.flatnonzero(np.cumsum(ends)[: n - 2 * period] > 0)
        rows = rows[is_same[rows] & is_same[rows + period]]
        a, b, c = rows, rows + period, rows + 2 * period
        # In even loops, whole numbers have zero second differences over three iterations.
        is_even = np.all(whole[b] - whole[a] == whole[c] - whole[b], axis=1)
        is_even &= np.all((real[a] == real[b]) & (real[b] == real[c]), axis=1)
        holds = np.zeros(n - 2 * period, dtype=np.bool_)
        holds[rows[is_even]] = True
        length = _run_lengths(holds)
        # A match compares three iterations: n matches in a row mean n + 2 iterations.
        found = _worth(np.where(length > 0, length // period + 2, 0), period, _FEWEST_EVEN)
        part = best[: n - 2 * period]
        is_better = found > part
        part[is_better] = found[is_better]
        period_of[: n - 2 * period][is_better] = period
    return best, period_of


def _covered_by_even(even: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """Mark the statements that even loops cover if loops are chosen from front to back."""
    marked = np.zeros(len(even) - 1, dtype=np.intp)
    start = 0
    begins = np.flatnonzero(even)
    while True:
        at = int(np.searchsorted(begins, start))
        if at == len(begins):
            return marked
        # Prefer a longer loop that starts later.
        start = int(begins[at])
        while even[start + 1] > even[start]:
            start += 1
        marked[start : start + even[start]] = 1
        start += int(even[start])


def _worth(times: npt.NDArray[np.intp], period: int, fewest: int) -> npt.NDArray[Any]:
    """Return the number of statements that a loop covers, or zero if it is not worthwhile."""
    is_worth = (times >= _FEWEST_TIMES) & (times * period >= fewest)
    return np.where(is_worth, times * period, 0)


def _run_lengths(holds: npt.NDArray[np.bool_]) -> npt.NDArray[np.intp]:
    """Return the number of consecutive true values that begin at each position."""
    # The next false value has the minimum index of all later ones, accumulated backwards.
    places = np.arange(len(holds))
    breaks = np.where(holds, len(holds), places)
    nexts = np.minimum.accumulate(breaks[::-1])[::-1]
    return np.asarray(nexts - places, dtype=np.intp)


def _padded(rows: Sequence[tuple[int, ...]]) -> npt.NDArray[np.int64]:
    lengths = np.array([len(row) for row in rows], dtype=np.intp)
    width = int(lengths.max(initial=0))
    matrix = np.zeros((len(rows), width), dtype=np.int64)
    matrix[np.arange(width) < lengths[:, None]] = [number for row in rows for number in row]
    return matrix


#: Number of statements up to which compilation is fast. Shorter text becomes loops, which run a
#: fifth slower, only if they reduce the number of lines to this fraction.
_SHORT, _MUCH_SHORTER = 8000, 0.25


def roll(statements: Sequence[Statement], array: str = "v") -> list[Statement]:
    """Convert repeated statements to loops if that shortens the text; tables come first."""
    rows, comments = _apart(statements)
    if len(rows) < FEWEST_LINES:
        return list(statements)
    found = list(pieces([_row(row) for row in rows]))
    if not any(times > 1 for _, _, times in found):
        return list(statements)
    writer = _LoopWriter(_kept_in_array(rows, found, array), array)
    for start, period, times in found:
        end = start + period * times
        if times == 1:
            writer.plain(rows[start:end], comments[start:end])
        else:
            writer.loop(rows[start:end], comments[start:end], period)
    if len(statements) <= _SHORT and writer.n_lines > _MUCH_SHORTER * len(statements):
        return list(statements)
    return writer.written()


def _apart(statements: Sequence[Statement]) -> tuple[list[Statement], list[str]]:
    """Return the statements without comments, and the comment before each statement."""
    rows: list[Statement] = []
    comments: list[str] = []
    comment = ""
    for row in statements:
        if isinstance(row, Comment):
            comment = row.text
            continue
        rows.append(row)
        comments.append(comment)
        comment = ""
    return rows, comments


def _row(statement: Statement) -> StatementRow:
    """Split a statement into its form and its numbers."""
    form: Hashable
    if isinstance(statement, Assign):
        declared = statement.declares
        is_temporary = declared is not None and kind_of(declared) == REAL
        # Arrays of nodes with several results stay outside: their short loops would need a table.
        array = statement.to[0].form.name
        is_place = declared is None and not (array[0] == "v" and array[1:].isdigit())
        if len(statement.to) > 1 or not (is_temporary or is_place):
            return StatementRow(None)
        form = (statement.to[0].form, statement.value.form)
    elif isinstance(statement, LeaveUnless):
        form = (statement.is_strict, statement.value.form)
    else:
        return StatementRow(None)
    slots = "".join([expression.form.slots for expression in statement.expressions])
    numbers: tuple[Any, ...] = ()
    for expression in statement.expressions:
        numbers += expression.numbers
    if "r" not in slots:
        return StatementRow(form, numbers)
    # In loops, whole numbers may have a step; constants must be equal or in a table.
    pairs = list(zip(numbers, slots, strict=True))
    whole, real = ([n for n, slot in pairs if (slot == "r") == is_real] for is_real in (0, 1))
    return StatementRow(form, tuple(whole), tuple(real))


def _kept_in_array(
    rows: Sequence[Statement], found: Sequence[tuple[int, int, int]], array: str
) -> dict[Temporary, CExpression]:
    """Return array elements for the temporaries that loops compute or read."""
    kept: set[Temporary] = set()
    for start, period, times in found:
        if times > 1:
            for row in rows[start : start + period * times]:
                kept.update(_temporaries(row))
    # Sorted, evenly spaced temporaries usually have evenly spaced indices.
    return {key: element(array, place) for place, key in enumerate(sorted(kept))}


def _temporaries(row: Statement) -> Iterator[Temporary]:
    for expression in row.expressions:  # type: ignore[union-attr]
        for at, prefix in expression.form.temporaries:
            yield prefix, expression.numbers[at]


class _LoopWriter:
    """Writer of statements and loops, with their tables and the array of temporaries."""

    def __init__(self, kept: Mapping[Temporary, CExpression], array: str) -> None:
        self._statements: list[Statement] = []
        self._tables: list[Statement] = []
        self._kept = kept
        self._array = array
        self._names: Counter[str] = Counter()
        self.n_lines = 0

    def written(self) -> list[Statement]:
        """Return the array, the tables and the statements, in this order."""
        array = [Array(self._array, len(self._kept))] if self._kept else []
        return [*array, *self._tables, *self._statements]

    def plain(self, rows: Sequence[Statement], comments: Sequence[str]) -> None:
        """Append statements outside loops."""
        for row, comment in zip(rows, comments, strict=True):
            if comment:
                self._statements.append(Comment(comment))
            self._statements.append(self._placed(row))
            self.n_lines += 1 + bool(comment)

    def loop(self, rows: Sequence[Statement], comments: Sequence[str], period: int) -> None:
        """Append a loop of statements that repeat after a period, with their comments."""
        body: list[Statement] = []
        for i in range(period):
            comment = _of_all(comments[i::period])
            if comment:
                body.append(Comment(comment))
            body.append(self._merged([self._placed(row) for row in rows[i::period]]))
        self._statements.append(Loop(len(rows) // period, tuple(body)))
        self.n_lines += len(body) + 2

    def _placed(self, row: Statement) -> Statement:
        return changed(row, lambda expression: read_from(expression, self._kept))

    def _merged(self, rows: Sequence[Statement]) -> Statement:
        """Merge statements that differ only in their numbers into one statement of a loop body."""
        merged = []
        for alike in zip(*(row.expressions for row in rows), strict=True):  # type: ignore[union-attr]
            columns = zip(*(expression.numbers for expression in alike), strict=True)
            form = alike[0].form
            numbers = tuple(map(self._number, columns, form.slots))
            merged.append(CExpression(form, numbers, alike[0].width))
        return rows[0].of(merged)  # type: ignore[union-attr]

    def _number(self, column: Sequence[Number], slot: str) -> Number:
        """Return a number in a loop body from its value in each iteration."""
        first = column[0]
        if all(number == first for number in column):
            return first
        # Not for constants: start plus multiples of a step would round.
        if slot != "r":
            step = column[1] - first  # type: ignore[operator]
            if all(number == first + step * i for i, number in enumerate(column)):  # type: ignore[operator]
                return Affine(step, first)  # type: ignore[arg-type]
            return self._table(WHOLE, "j", column)
        return self._table(SCALAR, "c", column)

    def _table(self, kind: str, prefix: str, column: Sequence[Number]) -> TableEntry:
        name = f"{prefix}_{self._names[prefix]}"
        self._names[prefix] += 1
        self._tables.append(ConstantTable(name, kind, tuple(column)))  # type: ignore[arg-type]
        return TableEntry(name)


def _of_all(comments: Sequence[str]) -> str:
    first, last = comments[0], comments[-1]
    if first == last or not first or not last:
        return first
    # Omit the common first words of the second name: "angle of link 1 to 9".
    words = last.split(" ")
    same = takewhile(lambda pair: pair[0] == pair[1], zip(first.split(" "), words, strict=False))
    return f"{first} to {' '.join(words[len(list(same)) :])}"
