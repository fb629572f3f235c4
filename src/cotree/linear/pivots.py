"""Choices of pivots: the order in which elimination takes the unknowns, for little fill-in.

None looks at values, which are known at run time only.
"""

from __future__ import annotations

from heapq import heapify, heappop, heappush
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from cotree.linear.elimination import Place, Remainder


class FewestCouplings:
    """Of a symmetric matrix: at each step the unknown with the fewest couplings (minimum degree).

    Ties go to the last, which lies farthest out in the tree and fills in least.

    Parameters
    ----------
    rows : mapping of int to collection of int
        The columns of each row's entries.
    allowed : iterable of int
        The unknowns whose pivots are safe.
    """

    def __init__(self, rows: Mapping[int, Collection[int]], allowed: Iterable[int]) -> None:
        self._left = set(allowed)
        # By degree, and by the negative number among equals, which takes the last first.
        self._waiting = [(len(rows[i]), -i) for i in self._left]
        heapify(self._waiting)

    def __call__(self, left: Remainder) -> Place | None:
        """Choose the next pivot."""
        for i in left.below:
            heappush(self._waiting, (len(left.rows[i]), -i))
        while self._left:
            count, negative = heappop(self._waiting)
            k = -negative
            # One whose count has changed since stands there again.
            if k in self._left and len(left.rows[k]) == count:
                self._left.remove(k)
                return k, k
        return None


class FewestUpdates:
    """At each step the pivot whose elimination changes the fewest entries, wherever it lies.

    That is on the diagonal, or where an equation has one unknown left, or an unknown one equation;
    elsewhere only where there is no other choice. An equation without unknowns ends it.

    Parameters
    ----------
    most_updates : int
        How many entries may be changed in all.
    """

    def __init__(self, most_updates: int) -> None:
        self._n_left = most_updates

    def __call__(self, left: Remainder) -> Place | None:
        """Choose the next pivot."""
        # Nothing is left, or a row without entries: singular whatever the values are.
        if not left.rows or not all(left.rows.values()):
            return None
        best = min(
            # Off the diagonal only for free, else by the number of updates; then the diagonal, then
            # order.
            (i != j and cost > 0, cost, i != j, i, j)
            for i, row in left.rows.items()
            for j in row
            for cost in [_n_updates(left, i, j)]
        )
        self._n_left -= best[1]
        return (best[-2], best[-1]) if self._n_left >= 0 else None


class FewestUpdatesOfMatched:
    """At each step the pivot that changes the fewest entries, of one for each column.

    Parameters
    ----------
    rows, columns : mapping of int to collection of int
        The pattern.
    row_of : sequence of int
        The row of each column's pivot, no two of them the same; see :func:`match`.
    """

    def __init__(self, left: Remainder, row_of: Sequence[int]) -> None:
        self._row_of = row_of
        self._column_of = {row: j for j, row in enumerate(row_of)}
        self._left = set(range(len(row_of)))
        self._waiting = [(_n_updates(left, i, j), j) for j, i in enumerate(row_of)]
        heapify(self._waiting)

    def __call__(self, left: Remainder) -> Place | None:
        """Choose the next pivot."""
        # Costs of the others have not changed; stale entries of the heap are skipped below.
        for j in {self._column_of[i] for i in left.below}.union(left.beside):
            heappush(self._waiting, (_n_updates(left, self._row_of[j], j), j))
        while self._left:
            cost, j = heappop(self._waiting)
            if j in self._left and _n_updates(left, self._row_of[j], j) == cost:
                self._left.remove(j)
                return self._row_of[j], j
        return None


def _n_updates(left: Remainder, i: int, j: int) -> int:
    """Count the entries that a pivot changes (H. M. Markowitz, Management Sci. 3 (1957) 255)."""
    return (len(left.rows[i]) - 1) * (len(left.columns[j]) - 1)


def match(columns: Sequence[Collection[int]]) -> list[int] | None:
    """Match each column with a distinct row that has an entry in it, its own where it can.

    None where there is no such matching: the matrix is then singular whatever its values.
    """
    row_of = [j if j in rows else -1 for j, rows in enumerate(columns)]
    column_of = {row: j for j, row in enumerate(row_of) if row >= 0}
    # Augmenting paths of a bipartite matching: a column without a row takes one from another, which
    # takes the next, until a free row is found.
    for start in [j for j, row in enumerate(row_of) if row < 0]:
        # Breadth first, so that as few of the others as possible leave their own rows.
        came_from: dict[int, int] = {}
        queue, free = [start], -1
        for j in queue:
            for row in sorted(columns[j]):
                if row in came_from:
                    continue
                came_from[row] = j
                if row not in column_of:
                    free = row
                    break
                queue.append(column_of[row])
            if free >= 0:
                break
        if free < 0:
            return None
        row = free
        while True:
            # Shift the rows back along the path.
            j = came_from[row]
            row_of[j], row = row, row_of[j]
            column_of[row_of[j]] = j
            if j == start:
                break
    return row_of
