"""Repeated statements to loops.

Statements that follow one another and differ in their numbers only (the stages of a ladder, the
nonzeros of a Jacobian) become the body of a loop: places that grow by the same amount each time
are computed, others are read from a table. The order of evaluation stays. Temporaries that a loop
makes or reads live in an array; all others stay as they are.
"""

from __future__ import annotations

from collections import Counter
from itertools import takewhile
from typing import TYPE_CHECKING, Any

from cotree.codegen.expressions import Affine, CExpression, TableEntry, element, read_from
from cotree.codegen.repeats import FEWEST_LINES, StatementRow, pieces
from cotree.codegen.statements import (
    REAL,
    SCALAR,
    WHOLE,
    Array,
    Assign,
    Comment,
    ConstantTable,
    LeaveUnless,
    Loop,
    changed,
    kind_of,
)

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator, Mapping, Sequence

    from cotree.codegen.expressions import Number, Temporary
    from cotree.codegen.statements import Statement

#: A compiler takes little time for up to so many statements. Loops run a fifth slower than these,
#: unless they leave less than this share of them.
_SHORT, _MUCH_SHORTER = 8000, 0.25


def roll(statements: Sequence[Statement], array: str = "v") -> list[Statement]:
    """Turn repeated statements into loops.

    Parameters
    ----------
    statements : sequence of Statement
        In order of evaluation, with comments.
    array : str
        Name of the array of loops' temporaries.

    Returns
    -------
    list of Statement
        The same with loops; tables and the array of their temporaries come first. Statements that
        loops would not shorten much, and that are not too many, stay as they are.
    """
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
    # Loops pay in long functions, or where they leave less than a quarter of the lines.
    if len(statements) <= _SHORT and writer.n_lines > _MUCH_SHORTER * len(statements):
        return list(statements)
    return writer.written()


def _apart(statements: Sequence[Statement]) -> tuple[list[Statement], list[str]]:
    """Give the statements, and the comment before each."""
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
    """Separate the form of a statement from its numbers, if it may stand in a loop."""
    form: Hashable
    if isinstance(statement, Assign):
        declared = statement.declares
        is_temporary = declared is not None and kind_of(declared) == REAL
        # Results of a node with several are left alone, too: a loop that fills them is short, and
        # would move temporaries that long straight lines read into an array.
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
    # Whole numbers may grow from one repetition to the next, constants are the same or stand in a
    # table: they are kept apart.
    pairs = list(zip(numbers, slots, strict=True))
    whole, real = ([n for n, slot in pairs if (slot == "r") == is_real] for is_real in (0, 1))
    return StatementRow(form, tuple(whole), tuple(real))


def _kept_in_array(
    rows: Sequence[Statement], found: Sequence[tuple[int, int, int]], array: str
) -> dict[Temporary, CExpression]:
    """Give the temporaries that loops make or read a place, in the order of their numbers."""
    kept: set[Temporary] = set()
    for start, period, times in found:
        if times > 1:
            for row in rows[start : start + period * times]:
                kept.update(_temporaries(row))
    # In the order of numbers: temporaries that are evenly spaced mostly have places that are, too,
    # which a loop then computes instead of reading a table.
    return {key: element(array, place) for place, key in enumerate(sorted(kept))}


def _temporaries(row: Statement) -> Iterator[Temporary]:
    for expression in row.expressions:  # type: ignore[union-attr]
        for at, prefix in expression.form.temporaries:
            yield prefix, expression.numbers[at]


class _LoopWriter:
    """Writes statements and loops."""

    def __init__(self, kept: Mapping[Temporary, CExpression], array: str) -> None:
        self._statements: list[Statement] = []
        self._tables: list[Statement] = []
        self._kept = kept
        self._array = array
        self._names: Counter[str] = Counter()
        self.n_lines = 0

    def written(self) -> list[Statement]:
        """Give the array, the tables and the statements, in this order."""
        array = [Array(self._array, len(self._kept))] if self._kept else []
        return [*array, *self._tables, *self._statements]

    def plain(self, rows: Sequence[Statement], comments: Sequence[str]) -> None:
        """Write statements that stand alone."""
        for row, comment in zip(rows, comments, strict=True):
            if comment:
                self._statements.append(Comment(comment))
            self._statements.append(self._placed(row))
            self.n_lines += 1 + bool(comment)

    def loop(self, rows: Sequence[Statement], comments: Sequence[str], period: int) -> None:
        """Write a loop of statements that repeat after a period.

        Parameters
        ----------
        rows : sequence of Statement
            All of them, every repetition.
        comments : sequence of str
            The comment before each; empty where there is none.
        period : int
            Number of statements of the body.
        """
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
        """Merge statements that differ in their numbers only into one."""
        merged = []
        for alike in zip(*(row.expressions for row in rows), strict=True):  # type: ignore[union-attr]
            columns = zip(*(expression.numbers for expression in alike), strict=True)
            form = alike[0].form
            numbers = tuple(map(self._number, columns, form.slots))
            merged.append(CExpression(form, numbers, alike[0].width))
        return rows[0].of(merged)  # type: ignore[union-attr]

    def _number(self, column: Sequence[Number], slot: str) -> Number:
        """Write a number that may change each time."""
        first = column[0]
        if all(number == first for number in column):
            return first
        # Constants are never computed from each other: that would round.
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
    """Merge the comments of a repeated statement into one."""
    first, last = comments[0], comments[-1]
    if first == last or not first or not last:
        return first
    # The last one without the words that both begin with: "angle of link 1 to 9".
    words = last.split(" ")
    same = takewhile(lambda pair: pair[0] == pair[1], zip(first.split(" "), words, strict=False))
    return f"{first} to {' '.join(words[len(list(same)) :])}"
