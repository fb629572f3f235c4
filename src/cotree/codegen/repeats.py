"""Detection of repeated statements: their forms and numbers in, pieces of them out.

A piece is a body of statements with its number of repetitions. Two kinds of loops are looked for:
even loops, in which every number grows by the same amount each time, and others, whose numbers
need tables. An even loop is preferred where it covers about as many statements.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator, Sequence

    import numpy.typing as npt

LONGEST_BODY = 150  # statements of a loop's body: a link's in space
FEWEST_LINES = 64  # that a loop replaces; below, statements are as short and read better
_FEWEST_EVEN = 24  # the same of one without tables
_FEWEST_TIMES = 8


@dataclass(frozen=True, slots=True)
class StatementRow:
    """A statement, split into its form and its numbers.

    Attributes
    ----------
    form : hashable or None
        Equal for statements that differ in their numbers only; None where it is never part of a
        loop.
    whole : tuple of int
        Its whole numbers, in order.
    real : tuple of float
        Its constants, in order.
    """

    form: Hashable
    whole: tuple[int, ...] = ()
    real: tuple[float, ...] = ()


def pieces(statements: Sequence[StatementRow]) -> Iterator[tuple[int, int, int]]:
    """Cut statements into pieces: start, length of the body, number of repetitions.

    Parameters
    ----------
    statements : sequence of StatementRow
        In order of evaluation.

    Yields
    ------
    tuple of int
        Pieces that follow one another; those that are no loops are repeated once.
    """
    n = len(statements)
    # From each place on: the statements of the longest loop whatever its numbers, and those of the
    # longest even loop.
    labels = _labels([row.form for row in statements])
    reach = _form_reach(labels)
    even, period_of = _even_reach(statements, labels)
    covered = np.cumsum([0, *_covered_by_even(even)])
    start = plain = 0
    while start < n:
        period, length = 0, int(reach[start])
        # A run may begin one line late, where it is then longer.
        is_longest = length > 0 and reach[start + 1] <= length
        # Tables are taken only where even loops would cover less than half of these statements.
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
    """Give each form a number; a statement without one is like no other."""
    numbers: dict[Hashable, int] = {}
    return np.array(
        [-1 - i if f is None else numbers.setdefault(f, len(numbers)) for i, f in enumerate(forms)],
        dtype=np.intp,
    )


def _form_reach(labels: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """Count the statements of the longest loop that begins at each place, whatever its numbers."""
    n = len(labels)
    reach = np.zeros(n + 1, dtype=np.intp)
    for period in range(1, min(LONGEST_BODY, n - 1) + 1):
        # So many statements agree with those one period later. The repetition that they agree with
        # counts, too.
        agreed = _run_lengths(labels[:-period] == labels[period:])
        part = reach[: n - period]
        np.maximum(part, _worth(agreed // period + 1, period, FEWEST_LINES), out=part)
    return reach


def _shortest_period(labels: npt.NDArray[np.intp], start: int, length: int) -> int:
    """Choose the shortest body that covers about as many statements."""
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
    """Count the statements of the longest even loop at each place, and of its body."""
    n = len(labels)
    best, period_of = np.zeros(n + 1, dtype=np.intp), np.zeros(n + 1, dtype=np.intp)
    whole = _padded([row.whole for row in statements])
    # Constants of an even loop must be equal: each is replaced by a number of its own, so that
    # whole numbers are compared.
    names: dict[float, int] = {}
    real = _padded([tuple(names.setdefault(r, len(names)) for r in row.real) for row in statements])
    for period in range(1, min(LONGEST_BODY, (n - 1) // 2) + 1):
        is_same = labels[:-period] == labels[period:]
        agreed = _run_lengths(is_same)
        hoped = _worth(agreed // period + 1, period, _FEWEST_EVEN)
        # Only runs that may beat what was found already are looked at further.
        rows = np.flatnonzero(hoped > best[: n - period])
        if not len(rows):
            continue
        # All places of the runs that are long enough.
        # Plus one at the start of a run and minus one behind it, summed up, mark the places within.
        ends = np.zeros(n + 1, dtype=np.intp)
        ends[rows] += 1
        np.subtract.at(ends, rows + agreed[rows], 1)
        rows = np.flatnonzero(np.cumsum(ends)[: n - 2 * period] > 0)
        rows = rows[is_same[rows] & is_same[rows + period]]
        a, b, c = rows, rows + period, rows + 2 * period
        # Whole numbers are in an even loop if their second differences over three repetitions
        # vanish.
        is_even = np.all(whole[b] - whole[a] == whole[c] - whole[b], axis=1)
        is_even &= np.all((real[a] == real[b]) & (real[b] == real[c]), axis=1)
        holds = np.zeros(n - 2 * period, dtype=np.bool_)
        holds[rows[is_even]] = True
        length = _run_lengths(holds)
        # A place that holds speaks for three repetitions, hence two more than periods in the run.
        found = _worth(np.where(length > 0, length // period + 2, 0), period, _FEWEST_EVEN)
        part = best[: n - 2 * period]
        is_better = found > part
        part[is_better] = found[is_better]
        period_of[: n - 2 * period][is_better] = period
    return best, period_of


def _covered_by_even(even: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """Mark the statements that even loops would take, from the first on."""
    marked = np.zeros(len(even) - 1, dtype=np.intp)
    start = 0
    begins = np.flatnonzero(even)
    while True:
        at = int(np.searchsorted(begins, start))
        if at == len(begins):
            return marked
        # A run may begin late, where it is then longer.
        start = int(begins[at])
        while even[start + 1] > even[start]:
            start += 1
        marked[start : start + even[start]] = 1
        start += int(even[start])


def _worth(times: npt.NDArray[np.intp], period: int, fewest: int) -> npt.NDArray[Any]:
    """Count the statements of a loop; none where it is not worth it."""
    is_worth = (times >= _FEWEST_TIMES) & (times * period >= fewest)
    return np.where(is_worth, times * period, 0)


def _run_lengths(holds: npt.NDArray[np.bool_]) -> npt.NDArray[np.intp]:
    """Count the consecutive places, from each one on, where something holds."""
    # From the next place where it does not hold, found backwards.
    places = np.arange(len(holds))
    breaks = np.where(holds, len(holds), places)
    nexts = np.minimum.accumulate(breaks[::-1])[::-1]
    return np.asarray(nexts - places, dtype=np.intp)


def _padded(rows: Sequence[tuple[int, ...]]) -> npt.NDArray[np.int64]:
    """Make a matrix of rows of any length, with zeros behind the shorter ones."""
    lengths = np.array([len(row) for row in rows], dtype=np.intp)
    width = int(lengths.max(initial=0))
    matrix = np.zeros((len(rows), width), dtype=np.int64)
    matrix[np.arange(width) < lengths[:, None]] = [number for row in rows for number in row]
    return matrix
