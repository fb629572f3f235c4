"""is a unit matrix with zeros for algebraic unknowns. The generated code checks its results."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from heapq import heapify, heappop, heappush
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

T = TypeVar("T")

#: Row and column of a pivot.
Place = tuple[int, int]


class Arithmetic(Protocol[T]):
    """Arithmetic operations on the entries of a matrix under elimination."""

    def inverse(self, pivot: T) -> T:
        """Return the reciprocal of a pivot."""

    def scaled(self, entry: T, inverse: T) -> T:
        """Return the product of an entry and the reciprocal of the pivot in its column."""

    def less(self, entry: T | None, multiplier: T, other: T) -> T | None:
        """Return ``entry - multiplier * other``, with an entry of the pivot row; None is zero."""


@dataclass
class Remainder:
    """The pattern that remains between the eliminations of two pivots."""

    #: Columns of the entries in each row; rows of the entries in each column.
    rows: Mapping[int, Collection[int]]
    columns: Mapping[int, Collection[int]]
    #: Rows with an entry in the last pivot's column; columns with an entry in its row.
    below: Collection[int] = ()
    beside: Collection[int] = ()


#: Returns the next pivot, or None to end the elimination.
Choice = Callable[[Remainder], Place | None]


@dataclass(frozen=True)
class Factors(Generic[T]):
    """Factors of a matrix, pivot by pivot."""

    pivots: tuple[Place, ...]  # row and column of each pivot
    inverses: tuple[T, ...]  # reciprocals of the pivots
    #: Multipliers that subtract each pivot's row from other rows, by row.
    lower: tuple[dict[int, T], ...]
    upper: tuple[dict[int, T], ...]  # remaining row of each pivot, by column


def eliminate(
    rows: dict[int, dict[int, T]],
    arithmetic: Arithmetic[T],
    choose: Choice,
    *,
    is_symmetric: bool = False,
) -> Factors[T]:
    """Eliminate unknowns, with diagonal pivots if symmetric; ``rows`` keeps the remainder."""
    # A symmetric matrix equals its transpose.
    columns: dict[int, set[int]] = {} if is_symmetric else columns_of(rows)
    left = Remainder(rows, rows if is_symmetric else columns)
    pivots, inverses, lower, upper = [], [], [], []
    less = arithmetic.less
    # Right-looking elimination: all counts are up to date when the next pivot is chosen.
    while (pivot := choose(left)) is not None:
        i, j = pivot
        row = rows.pop(i)
        inverse = arithmetic.inverse(row.pop(j))
        if not is_symmetric:
            for k in (j, *row):
                columns[k].discard(i)
        # Sorted, so that the generated code does not depend on the order of sets.
        below = sorted(row if is_symmetric else columns.pop(j))
        # Multiplication by the reciprocal needs only one division per pivot.
        multipliers = {k: arithmetic.scaled(rows[k].pop(j), inverse) for k in below}
        for k, multiplier in multipliers.items():
            own = rows[k]
            for other, entry in row.items():
                # symmetric entries are computed once
                if is_symmetric and other > k:
                    continue
                before = own.get(other)
                updated = less(before, multiplier, entry)
                # The same object: the node is unchanged, or the sum was extended in place.
                if updated is before:
                    continue
                _set_entry(own, columns, k, other, updated)
                if is_symmetric and other != k:
                    _set_entry(rows[other], columns, other, k, updated)
        # Counts have changed only in the pivot's rows and columns.
        left.below, left.beside = below, row
        pivots.append(pivot)
        inverses.append(inverse)
        lower.append(multipliers)
        upper.append(row)
    return Factors(tuple(pivots), tuple(inverses), tuple(lower), tuple(upper))


def columns_of(rows: Mapping[int, Collection[int]]) -> dict[int, set[int]]:
    """Return the rows of each column's entries; columns have the same numbers as rows."""
    columns: dict[int, set[int]] = {j: set() for j in rows}
    for i, row in rows.items():
        for j in row:
            columns[j].add(i)
    return columns


def _set_entry(
    row: dict[int, T], columns: Mapping[int, set[int]], i: int, j: int, entry: T | None
) -> None:
    if entry is None:
        row.pop(j, None)
    else:
        row[j] = entry
    if columns:
        (columns[j].discard if entry is None else columns[j].add)(i)


class FewestCouplings:
    """Minimum-degree pivots of a symmetric matrix; among equals, the outermost one in the tree."""

    def __init__(self, rows: Mapping[int, Collection[int]], allowed: Iterable[int]) -> None:
        self._left = set(allowed)
        # Sorted by degree, then by negative number, so that the last unknown comes first.
        self._waiting = [(len(rows[i]), -i) for i in self._left]
        heapify(self._waiting)

    def __call__(self, left: Remainder) -> Place | None:
        """Return the next pivot."""
        for i in left.below:
            heappush(self._waiting, (len(left.rows[i]), -i))
        while self._waiting:
            count, negative = heappop(self._waiting)
            k = -negative
            # An unknown whose degree has changed was pushed again. A pivot that vanishes by
            # rounding, such as a mass 1e-17 times another, is not an entry.
            if k in self._left and len(left.rows[k]) == count and k in left.rows[k]:
                self._left.remove(k)
                return k, k
        return None


class FewestUpdates:
    """Pivots whose elimination changes the fewest entries, up to ``most_updates`` in total."""

    def __init__(self, most_updates: int) -> None:
        self._n_left = most_updates

    def __call__(self, left: Remainder) -> Place | None:
        """Return the next pivot."""
        # Everything is eliminated, or a row is empty and the matrix is structurally singular.
        if not left.rows or not all(left.rows.values()):
            return None
        best = min(
            # Off-diagonal pivots only without updates; then by number of updates and position.
            (i != j and cost > 0, cost, i != j, i, j)
            for i, row in left.rows.items()
            for j in row
            for cost in [_n_updates(left, i, j)]
        )
        self._n_left -= best[1]
        return (best[-2], best[-1]) if self._n_left >= 0 else None


class FewestUpdatesOfMatched:
    """Pivots that change the fewest entries, in the rows that :func:`match` assigns to columns."""

    def __init__(self, left: Remainder, row_of: Sequence[int]) -> None:
        self._row_of = row_of
        self._column_of = {row: j for j, row in enumerate(row_of)}
        self._left = set(range(len(row_of)))
        self._waiting = [(_n_updates(left, i, j), j) for j, i in enumerate(row_of)]
        heapify(self._waiting)

    def __call__(self, left: Remainder) -> Place | None:
        """Return the next pivot."""
        # The costs of other columns have not changed; outdated entries of the heap are skipped.
        for j in {self._column_of[i] for i in left.below}.union(left.beside):
            heappush(self._waiting, (_n_updates(left, self._row_of[j], j), j))
        while self._left:
            cost, j = heappop(self._waiting)
            if j in self._left and _n_updates(left, self._row_of[j], j) == cost:
                self._left.remove(j)
                return self._row_of[j], j
        return None


def _n_updates(left: Remainder, i: int, j: int) -> int:
    """Return the number of updates by a pivot (H. M. Markowitz, Management Sci. 3 (1957) 255)."""
    return (len(left.rows[i]) - 1) * (len(left.columns[j]) - 1)


def match(columns: Sequence[Collection[int]]) -> list[int] | None:
    """Assign a different row to each column, preferably the diagonal one; None if singular."""
    row_of = [j if j in rows else -1 for j, rows in enumerate(columns)]
    column_of = {row: j for j, row in enumerate(row_of) if row >= 0}
    # Find augmenting paths of a bipartite matching, from columns without a row to free rows.
    for start in [j for j, row in enumerate(row_of) if row < 0]:
        # Breadth-first search reassigns the fewest columns.
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
            # Move the rows along the path back to the start.
            j = came_from[row]
            row_of[j], row = row, row_of[j]
            column_of[row_of[j]] = j
            if j == start:
                break
    return row_of


@dataclass(frozen=True)
class FactorStep:
    """A factor: ``(shift + -J - sum of products) * scale``, or the reciprocal of this value."""

    value: int  # index among the entries of J, or -1
    has_shift: bool  # whether the scalar ``shift`` is added to the matrix
    products: tuple[tuple[int, int], ...]  # pairs of factors whose products are subtracted
    pivot: int  # index of the factor that multiplies the value, or -1
    is_pivot: bool  # whether the reciprocal is stored


@dataclass(frozen=True)
class Elimination:
    """Plan for factorising ``shift M - J`` and for solving with the factors."""

    factors: tuple[FactorStep, ...]  # factors in the order of their computation
    #: Row and column of each pivot.
    rows: tuple[int, ...]
    columns: tuple[int, ...]
    pivots: tuple[int, ...]  # index of each pivot's reciprocal among the factors
    #: Earlier pivots that are subtracted from each pivot's row, as pairs (pivot, factor).
    lower: tuple[tuple[tuple[int, int], ...], ...]
    #: Later pivots in the backward substitution of each pivot, as pairs (pivot, factor).
    upper: tuple[tuple[tuple[int, int], ...], ...]

    @property
    def n_operations(self) -> int:
        """Number of products in the factorisation and in one solution."""
        solving = sum(len(row) for row in (*self.lower, *self.upper))
        return sum(len(entry.products) + 1 for entry in self.factors) + solving


def plan_elimination(
    n: int, column_starts: Sequence[int], row_indices: Sequence[int], n_algebraic: int
) -> Elimination | None:
    """Plan the factors of ``shift M - J``; return None if the matrix is structurally singular.

    The pattern of J is in CSC form; the last ``n_algebraic`` unknowns are algebraic.
    """
    n_shifted = n - n_algebraic
    rows: dict[int, dict[int, _Sum]] = {i: {} for i in range(n)}
    for j in range(n):
        for at in range(column_starts[j], column_starts[j + 1]):
            rows[row_indices[at]][j] = _Sum(at)
    for i in range(n_shifted):
        # The shift adds diagonal entries that J may not have, except for algebraic unknowns.
        rows[i].setdefault(i, _Sum()).has_shift = True
    columns = columns_of(rows)
    # Algebraic unknowns may have no diagonal entry: a matching finds pivots for all unknowns.
    row_of = match([columns[j] for j in range(n)])
    if row_of is None:
        return None
    choose = FewestUpdatesOfMatched(Remainder(rows, columns), row_of)
    return _listed(eliminate(rows, _OfSums(), choose))


@dataclass(eq=False, slots=True)
class _Sum:
    """An entry during elimination: its index in J, and the products that are subtracted from it."""

    value: int = -1
    has_shift: bool = False
    products: list[_Sum] = field(default_factory=list)  # pairs of entries, in one list
    pivot: _Sum | None = None
    is_pivot: bool = False
    number: int = -1  # index among the factors, assigned when their order is known


class _OfSums:
    """Symbolic elimination that records products; entries never cancel."""

    def inverse(self, pivot: _Sum) -> _Sum:
        # The reciprocal replaces the pivot, since solutions are multiplied by it.
        pivot.is_pivot = True
        return pivot

    def scaled(self, entry: _Sum, inverse: _Sum) -> _Sum:
        entry.pivot = inverse
        return entry

    def less(self, entry: _Sum | None, multiplier: _Sum, other: _Sum) -> _Sum:
        if entry is None:
            # Fill-in: the new entry has no value in J.
            entry = _Sum()
        entry.products += multiplier, other
        return entry


def _listed(plan: Factors[_Sum]) -> Elimination:
    """Return the plan with factors numbered pivot by pivot."""
    rows, columns = [i for i, _ in plan.pivots], [j for _, j in plan.pivots]
    # From here on, rows and columns are numbered by the position of their pivot.
    rank_of_row = {row: k for k, row in enumerate(rows)}
    rank_of_column = {column: k for k, column in enumerate(columns)}
    below = [sorted((rank_of_row[i], entry) for i, entry in own.items()) for own in plan.lower]
    beside = [sorted((rank_of_column[j], entry) for j, entry in own.items()) for own in plan.upper]
    factors: list[_Sum] = []
    for pivot, down, along in zip(plan.inverses, below, beside, strict=True):
        # The products of a factor belong to earlier pivots.
        factors += [pivot, *(entry for _, entry in down), *(entry for _, entry in along)]
    for number, entry in enumerate(factors):
        entry.number = number
    lower: list[list[tuple[int, int]]] = [[] for _ in rows]
    for m, down in enumerate(below):
        for k, entry in down:
            # Stored by rows for forward substitution.
            lower[k].append((m, entry.number))
    return Elimination(
        tuple(map(_entry, factors)),
        tuple(rows),
        tuple(columns),
        tuple(pivot.number for pivot in plan.inverses),
        tuple(map(tuple, lower)),
        tuple(tuple((k, entry.number) for k, entry in along) for along in beside),
    )


def _entry(own: _Sum) -> FactorStep:
    # The factors of each pair are stored one after the other.
    numbers = [factor.number for factor in own.products]
    products = tuple(zip(numbers[::2], numbers[1::2], strict=True))
    pivot = -1 if own.pivot is None else own.pivot.number
    return FactorStep(own.value, own.has_shift, products, pivot, own.is_pivot)


# Largest matrix that is stored as a dense one.
_SMALL = 40


def narrow_band(
    n: int, column_starts: Sequence[int], row_indices: Sequence[int]
) -> tuple[int, int, Any]:
    """Return the lower and upper bandwidths, and an order of the unknowns that reduces them.

    The pattern is in CSC form. The order is None if the matrix is small or not sparse.
    """
    if n > _SMALL:
        from scipy.sparse import csc_matrix
        from scipy.sparse.csgraph import reverse_cuthill_mckee

        starts, rows = np.array(column_starts), np.array(row_indices, dtype=np.int64)
        pattern = csc_matrix((np.ones(len(rows)), rows, starts), shape=(n, n)).tocsr()
        # The order lists unknowns by new position; its inverse is the new position of each unknown.
        places = np.empty(n, dtype=np.intc)
        places[reverse_cuthill_mckee(pattern, symmetric_mode=False)] = np.arange(n)
        # Distance of each entry from the diagonal after reordering, positive below it.
        below = places[rows] - np.repeat(places, np.diff(starts))
        lower, upper = int(max(below.max(initial=0), 0)), int(max((-below).max(initial=0), 0))
        # number of diagonals in banded storage with row pivoting
        if 2 * lower + upper + 1 < n:
            return lower, upper, places
    return n - 1, n - 1, None
