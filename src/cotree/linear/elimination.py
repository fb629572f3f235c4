"""Gaussian elimination of sparse matrices with entries of any type, and elimination plans.

Entries are nodes, whose values become code, or placeholders if only the pattern is known. Pivots do
not depend on values, since these are known only at run time. A plan is for ``shift M - J``: J is a
Jacobian, M a unit matrix with zeros for algebraic unknowns. The generated code checks its results.
"""

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
        """Return ``entry - multiplier * other``; ``other`` is in the pivot row, None is zero."""


@dataclass
class Remainder:
    """Pattern of the matrix that remains after the elimination of a pivot."""

    #: Columns of the entries in each row; rows of the entries in each column.
    rows: Mapping[int, Collection[int]]
    columns: Mapping[int, Collection[int]]
    #: Rows with an entry in the column of the last pivot; columns with an entry in its row.
    below: Collection[int] = ()
    beside: Collection[int] = ()


#: Function that returns the next pivot, or None to end the elimination.
Choice = Callable[[Remainder], Place | None]


@dataclass(frozen=True)
class Factors(Generic[T]):
    """Factors of a matrix, pivot by pivot."""

    pivots: tuple[Place, ...]  # row and column of each pivot
    inverses: tuple[T, ...]  # reciprocals of the pivots
    #: By row: the multipliers with which each pivot's row is subtracted from other rows.
    lower: tuple[dict[int, T], ...]
    upper: tuple[dict[int, T], ...]  # by column: entries in each pivot's row, without the pivot


def eliminate(
    rows: dict[int, dict[int, T]],
    arithmetic: Arithmetic[T],
    choose: Choice,
    *,
    is_symmetric: bool = False,
) -> Factors[T]:
    """Eliminate unknowns, with diagonal pivots if symmetric; ``rows`` keeps the remaining rows."""
    # The columns of a symmetric matrix are its rows.
    columns: dict[int, set[int]] = {} if is_symmetric else columns_of(rows)
    left = Remainder(rows, rows if is_symmetric else columns)
    pivots, inverses, lower, upper = [], [], [], []
    less = arithmetic.less
    # Right-looking elimination keeps all counts up to date for the choice of the next pivot.
    while (pivot := choose(left)) is not None:
        i, j = pivot
        row = rows.pop(i)
        inverse = arithmetic.inverse(row.pop(j))
        if not is_symmetric:
            for k in (j, *row):
                columns[k].discard(i)
        # Sorting makes the generated code independent of the order of sets.
        below = sorted(row if is_symmetric else columns.pop(j))
        # The reciprocal replaces divisions by products, so each pivot takes one division.
        multipliers = {k: arithmetic.scaled(rows[k].pop(j), inverse) for k in below}
        for k, multiplier in multipliers.items():
            own = rows[k]
            for other, entry in row.items():
                # Compute symmetric entries once.
                if is_symmetric and other > k:
                    continue
                before = own.get(other)
                updated = less(before, multiplier, entry)
                # Identical object: the node is unchanged, or the sum was extended in place.
                if updated is before:
                    continue
                _set_entry(own, columns, k, other, updated)
                if is_symmetric and other != k:
                    _set_entry(rows[other], columns, other, k, updated)
        # Only rows and columns that cross the pivot's row or column have new counts.
        left.below, left.beside = below, row
        pivots.append(pivot)
        inverses.append(inverse)
        lower.append(multipliers)
        upper.append(row)
    return Factors(tuple(pivots), tuple(inverses), tuple(lower), tuple(upper))


def columns_of(rows: Mapping[int, Collection[int]]) -> dict[int, set[int]]:
    """Return for each column the rows of its entries; columns are numbered like the rows."""
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
    """Minimum-degree pivots of a symmetric matrix; of equal degrees, the last unknown is first."""

    def __init__(self, rows: Mapping[int, Collection[int]], allowed: Iterable[int]) -> None:
        self._left = set(allowed)
        # Sorted by degree, then by negative index: of equal degrees, the last unknown comes first.
        self._waiting = [(len(rows[i]), -i) for i in self._left]
        heapify(self._waiting)

    def __call__(self, left: Remainder) -> Place | None:
        """Return the next pivot."""
        for i in left.below:
            heappush(self._waiting, (len(left.rows[i]), -i))
        while self._waiting:
            count, negative = heappop(self._waiting)
            k = -negative
            # Entries with an outdated degree are skipped: the unknown was pushed again. A pivot
            # that vanishes by rounding, such as a mass 1e-17 times another one, is no entry.
            if k in self._left and len(left.rows[k]) == count and k in left.rows[k]:
                self._left.remove(k)
                return k, k
        return None


class FewestUpdates:
    """Pivots that change the fewest entries, until the total would exceed ``most_updates``."""

    def __init__(self, most_updates: int) -> None:
        self._n_left = most_updates

    def __call__(self, left: Remainder) -> Place | None:
        """Return the next pivot."""
        # Stop if all rows are eliminated, or an empty row makes the matrix singular.
        if not left.rows or not all(left.rows.values()):
            return None
        best = min(
            # Off-diagonal pivots must cause no updates; at equal cost, diagonal ones come first.
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
        # The costs of all other columns are unchanged; outdated entries of the heap are skipped.
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
    """Assign a different row to each column, if possible the diagonal one; None if singular."""
    row_of = [j if j in rows else -1 for j, rows in enumerate(columns)]
    column_of = {row: j for j, row in enumerate(row_of) if row >= 0}
    # Augmenting paths of a bipartite matching lead from a column without a row to a free row.
    for start in [j for j, row in enumerate(row_of) if row < 0]:
        # The shortest path, found breadth first, reassigns the fewest columns.
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
            # Shift the assignments along the path, back to its start.
            j = came_from[row]
            row_of[j], row = row, row_of[j]
            column_of[row_of[j]] = j
            if j == start:
                break
    return row_of


@dataclass(frozen=True)
class FactorStep:
    """Recipe of a factor: ``(shift + -J - sum of products) * scale``, or the reciprocal of this."""

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
    #: For each pivot: the earlier pivots subtracted from its row, as pairs (pivot, factor).
    lower: tuple[tuple[tuple[int, int], ...], ...]
    #: For each pivot: the later pivots in backward substitution, as pairs (pivot, factor).
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
        # The shift adds diagonal entries, even if J has none, except for algebraic unknowns.
        rows[i].setdefault(i, _Sum()).has_shift = True
    columns = columns_of(rows)
    # Algebraic unknowns may lack a diagonal entry: a matching finds pivots for all unknowns.
    row_of = match([columns[j] for j in range(n)])
    if row_of is None:
        return None
    choose = FewestUpdatesOfMatched(Remainder(rows, columns), row_of)
    return _listed(eliminate(rows, _OfSums(), choose))


@dataclass(eq=False, slots=True)
class _Sum:
    """An entry during elimination: its index in J, and the products subtracted from it."""

    value: int = -1
    has_shift: bool = False
    products: list[_Sum] = field(default_factory=list)  # the factors of each product in turn
    pivot: _Sum | None = None
    is_pivot: bool = False
    number: int = -1  # index among the factors, assigned when the order is known


class _OfSums:
    """Arithmetic that records products instead of computing values; entries never cancel."""

    def inverse(self, pivot: _Sum) -> _Sum:
        # The reciprocal is stored instead of the pivot, because solutions are multiplied by it.
        pivot.is_pivot = True
        return pivot

    def scaled(self, entry: _Sum, inverse: _Sum) -> _Sum:
        entry.pivot = inverse
        return entry

    def less(self, entry: _Sum | None, multiplier: _Sum, other: _Sum) -> _Sum:
        if entry is None:
            # Fill-in: J has no entry here.
            entry = _Sum()
        entry.products += multiplier, other
        return entry


def _listed(plan: Factors[_Sum]) -> Elimination:
    """Return the plan with factors numbered pivot by pivot."""
    rows, columns = [i for i, _ in plan.pivots], [j for _, j in plan.pivots]
    # Rows and columns are now numbered in the order of their pivots.
    rank_of_row = {row: k for k, row in enumerate(rows)}
    rank_of_column = {column: k for k, column in enumerate(columns)}
    below = [sorted((rank_of_row[i], entry) for i, entry in own.items()) for own in plan.lower]
    beside = [sorted((rank_of_column[j], entry) for j, entry in own.items()) for own in plan.upper]
    factors: list[_Sum] = []
    for pivot, down, along in zip(plan.inverses, below, beside, strict=True):
        # The products of a factor consist of factors of earlier pivots.
        factors += [pivot, *(entry for _, entry in down), *(entry for _, entry in along)]
    for number, entry in enumerate(factors):
        entry.number = number
    lower: list[list[tuple[int, int]]] = [[] for _ in rows]
    for m, down in enumerate(below):
        for k, entry in down:
            # Forward substitution reads the multipliers row by row.
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
    # The two factors of a product are consecutive in the list.
    numbers = [factor.number for factor in own.products]
    products = tuple(zip(numbers[::2], numbers[1::2], strict=True))
    pivot = -1 if own.pivot is None else own.pivot.number
    return FactorStep(own.value, own.has_shift, products, pivot, own.is_pivot)


# Largest number of unknowns for which the matrix is stored as a dense one.
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
        # reverse_cuthill_mckee lists the unknowns in their new order; the inverse is needed.
        places = np.empty(n, dtype=np.intc)
        places[reverse_cuthill_mckee(pattern, symmetric_mode=False)] = np.arange(n)
        # Distance of each entry from the diagonal after reordering, positive below it.
        below = places[rows] - np.repeat(places, np.diff(starts))
        lower, upper = int(max(below.max(initial=0), 0)), int(max((-below).max(initial=0), 0))
        # Number of diagonals in banded storage, including those that row pivoting fills.
        if 2 * lower + upper + 1 < n:
            return lower, upper, places
    return n - 1, n - 1, None
