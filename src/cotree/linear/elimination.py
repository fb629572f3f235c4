"""Gaussian elimination of a sparse matrix with entries of any type, and plans of it.

In: the nonzeros of a matrix, a choice of pivots, and the arithmetic of the entries. Out: its
factors. Entries are nodes whose values become code, or places in a plan of which only the pattern
is known. All sparse eliminations of this package use it; they differ in the choice of pivots and in
the use of symmetry. None depends on values, which are known at run time only.

The plan of a Jacobian J, whose algebraic unknowns come last, has the steps that factor
``shift M - J`` and solve with the factors, where M is one on the diagonal of the other unknowns and
zero elsewhere. The code that takes the steps checks their results. For banded factors it has the
bandwidths of a pattern that is compressed by columns, and the places of the unknowns.
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
    """The operations of elimination on entries."""

    def inverse(self, pivot: T) -> T:
        """Form the reciprocal of a pivot."""

    def scaled(self, entry: T, inverse: T) -> T:
        """Multiply an entry with the reciprocal of the pivot above it."""

    def less(self, entry: T | None, multiplier: T, other: T) -> T | None:
        """Subtract the product of a multiplier and the pivot row's entry; None stands for zero."""


@dataclass
class Remainder:
    """The remaining pattern between the elimination of two pivots."""

    #: Columns of the entries in each row, and rows of the entries in each column.
    rows: Mapping[int, Collection[int]]
    columns: Mapping[int, Collection[int]]
    #: Rows with an entry in the last pivot's column; columns with an entry in its row.
    below: Collection[int] = ()
    beside: Collection[int] = ()


#: Function that returns the next pivot, or None at the end of the elimination.
Choice = Callable[[Remainder], Place | None]


@dataclass(frozen=True)
class Factors(Generic[T]):
    """Factors of a matrix, pivot by pivot."""

    pivots: tuple[Place, ...]  # row and column of each pivot
    inverses: tuple[T, ...]  # reciprocals of the pivots
    #: For each pivot: the multipliers with which its row is subtracted from others, by row.
    lower: tuple[dict[int, T], ...]
    upper: tuple[dict[int, T], ...]  # remaining row of each pivot, by column


def eliminate(
    rows: dict[int, dict[int, T]],
    arithmetic: Arithmetic[T],
    choose: Choice,
    *,
    is_symmetric: bool = False,
) -> Factors[T]:
    """Eliminate unknowns until there is no further pivot; ``rows`` then contains the remainder.

    With ``is_symmetric`` all pivots are on the diagonal, and only one of each pair of symmetric
    entries is computed.
    """
    # A symmetric matrix is its own transpose.
    columns: dict[int, set[int]] = {} if is_symmetric else columns_of(rows)
    left = Remainder(rows, rows if is_symmetric else columns)
    pivots, inverses, lower, upper = [], [], [], []
    less = arithmetic.less
    # Right-looking elimination, so that counts are current when the next pivot is chosen.
    while (pivot := choose(left)) is not None:
        i, j = pivot
        row = rows.pop(i)
        inverse = arithmetic.inverse(row.pop(j))
        if not is_symmetric:
            for k in (j, *row):
                columns[k].discard(i)
        # Sorted, so that the generated code does not depend on the order of sets.
        below = sorted(row if is_symmetric else columns.pop(j))
        # Multiply by the reciprocal, so that each pivot needs one division.
        multipliers = {k: arithmetic.scaled(rows[k].pop(j), inverse) for k in below}
        for k, multiplier in multipliers.items():
            own = rows[k]
            for other, entry in row.items():
                # Entries across the diagonal are computed once.
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
        # Only the counts of the pivot's rows and columns have changed.
        left.below, left.beside = below, row
        pivots.append(pivot)
        inverses.append(inverse)
        lower.append(multipliers)
        upper.append(row)
    return Factors(tuple(pivots), tuple(inverses), tuple(lower), tuple(upper))


def columns_of(rows: Mapping[int, Collection[int]]) -> dict[int, set[int]]:
    """List the rows of each column's entries; each row has a column of its number."""
    columns: dict[int, set[int]] = {j: set() for j in rows}
    for i, row in rows.items():
        for j in row:
            columns[j].add(i)
    return columns


def _set_entry(
    row: dict[int, T], columns: Mapping[int, set[int]], i: int, j: int, entry: T | None
) -> None:
    """Set the entry in row i, column j, and update the pattern by columns, if there is one."""
    if entry is None:
        row.pop(j, None)
    else:
        row[j] = entry
    if columns:
        (columns[j].discard if entry is None else columns[j].add)(i)


class FewestCouplings:
    """Minimum degree: the allowed unknown of a symmetric matrix with the fewest couplings.

    Among unknowns with equally many couplings the last one is chosen, which is farthest out in the
    tree and causes the least fill-in.
    """

    def __init__(self, rows: Mapping[int, Collection[int]], allowed: Iterable[int]) -> None:
        self._left = set(allowed)
        # By degree, then by the negative number, so that the last comes first.
        self._waiting = [(len(rows[i]), -i) for i in self._left]
        heapify(self._waiting)

    def __call__(self, left: Remainder) -> Place | None:
        """Choose the next pivot."""
        for i in left.below:
            heappush(self._waiting, (len(left.rows[i]), -i))
        while self._waiting:
            count, negative = heappop(self._waiting)
            k = -negative
            # An unknown whose count has changed was pushed again. A pivot that cancels by rounding,
            # as that of a mass of 1e-17 of another, is no entry.
            if k in self._left and len(left.rows[k]) == count and k in left.rows[k]:
                self._left.remove(k)
                return k, k
        return None


class FewestUpdates:
    """The pivot whose elimination changes the fewest entries, up to ``most_updates`` in all.

    Pivots on the diagonal, and those that change no entry, are preferred. An equation without
    unknowns ends the elimination.
    """

    def __init__(self, most_updates: int) -> None:
        self._n_left = most_updates

    def __call__(self, left: Remainder) -> Place | None:
        """Choose the next pivot."""
        # Nothing is left, or a row has no entries: the matrix is singular for all values.
        if not left.rows or not all(left.rows.values()):
            return None
        best = min(
            # Pivots off the diagonal only if they cause no updates; then by number of updates, then
            # by order.
            (i != j and cost > 0, cost, i != j, i, j)
            for i, row in left.rows.items()
            for j in row
            for cost in [_n_updates(left, i, j)]
        )
        self._n_left -= best[1]
        return (best[-2], best[-1]) if self._n_left >= 0 else None


class FewestUpdatesOfMatched:
    """The pivot that changes the fewest entries, among one for each column.

    ``row_of`` has the row of each column's pivot; see :func:`match`.
    """

    def __init__(self, left: Remainder, row_of: Sequence[int]) -> None:
        self._row_of = row_of
        self._column_of = {row: j for j, row in enumerate(row_of)}
        self._left = set(range(len(row_of)))
        self._waiting = [(_n_updates(left, i, j), j) for j, i in enumerate(row_of)]
        heapify(self._waiting)

    def __call__(self, left: Remainder) -> Place | None:
        """Choose the next pivot."""
        # Costs of other columns have not changed; stale entries of the heap are skipped.
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
    """Match each column with a distinct row that has an entry in it, preferably on the diagonal.

    None if no such matching exists: the matrix is then singular for all values.
    """
    row_of = [j if j in rows else -1 for j, rows in enumerate(columns)]
    column_of = {row: j for j, row in enumerate(row_of) if row >= 0}
    # Augmenting paths of a bipartite matching, from columns without a row to free rows.
    for start in [j for j, row in enumerate(row_of) if row < 0]:
        # Breadth first, so that as few of the other unknowns as possible change their rows.
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


@dataclass(frozen=True)
class FactorStep:
    """One of the factors: ``(shift + -J - sum of products) * scale``, or its reciprocal."""

    value: int  # index of its value among the entries of J, or -1
    has_shift: bool  # whether the scalar ``shift`` is added to the matrix
    products: tuple[tuple[int, int], ...]  # pairs of factors whose products are subtracted
    pivot: int  # factor by which the value is multiplied, or -1
    is_pivot: bool  # whether the reciprocal is stored


@dataclass(frozen=True)
class Elimination:
    """Plan of the factorisation of a matrix, and of solutions with its factors."""

    factors: tuple[FactorStep, ...]  # factors, in the order of their computation
    #: Row and column of each pivot, in order.
    rows: tuple[int, ...]
    columns: tuple[int, ...]
    pivots: tuple[int, ...]  # index of each pivot's reciprocal among the factors
    #: For each pivot: earlier pivots that its row subtracts, as pairs of pivot and factor.
    lower: tuple[tuple[tuple[int, int], ...], ...]
    #: For each pivot: later pivots, as pairs, for backward substitution.
    upper: tuple[tuple[tuple[int, int], ...], ...]

    @property
    def n_operations(self) -> int:
        """Number of products of the factorisation and of one solution."""
        solving = sum(len(row) for row in (*self.lower, *self.upper))
        return sum(len(entry.products) + 1 for entry in self.factors) + solving


def plan_elimination(
    n: int, column_starts: Sequence[int], row_indices: Sequence[int], n_algebraic: int
) -> Elimination | None:
    """Plan the factors of ``shift M - J``; None if the matrix is structurally singular.

    The pattern of J is compressed by columns; the last ``n_algebraic`` unknowns are algebraic.
    """
    n_shifted = n - n_algebraic
    rows: dict[int, dict[int, _Sum]] = {i: {} for i in range(n)}
    for j in range(n):
        for at in range(column_starts[j], column_starts[j + 1]):
            rows[row_indices[at]][j] = _Sum(at)
    for i in range(n_shifted):
        # The shift adds diagonal entries that J may lack, except for algebraic unknowns.
        rows[i].setdefault(i, _Sum()).has_shift = True
    columns = columns_of(rows)
    # Algebraic unknowns may have no entry on the diagonal: a matching finds pivots for all.
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
    products: list[_Sum] = field(default_factory=list)  # pairs of entries, concatenated
    pivot: _Sum | None = None
    is_pivot: bool = False
    number: int = -1  # index among the factors, once their order is known


class _OfSums:
    """Symbolic elimination, which records products; no entry cancels."""

    def inverse(self, pivot: _Sum) -> _Sum:
        # The reciprocal replaces the pivot, since solutions multiply by it.
        pivot.is_pivot = True
        return pivot

    def scaled(self, entry: _Sum, inverse: _Sum) -> _Sum:
        entry.pivot = inverse
        return entry

    def less(self, entry: _Sum | None, multiplier: _Sum, other: _Sum) -> _Sum:
        if entry is None:
            # Fill-in: the entry has no value in J.
            entry = _Sum()
        entry.products += multiplier, other
        return entry


def _listed(plan: Factors[_Sum]) -> Elimination:
    """Assign numbers to the factors: pivot by pivot, each in the order of the other pivots."""
    rows, columns = [i for i, _ in plan.pivots], [j for _, j in plan.pivots]
    # From here on, rows and columns are numbered by the rank of their pivot.
    rank_of_row = {row: k for k, row in enumerate(rows)}
    rank_of_column = {column: k for k, column in enumerate(columns)}
    below = [sorted((rank_of_row[i], entry) for i, entry in own.items()) for own in plan.lower]
    beside = [sorted((rank_of_column[j], entry) for j, entry in own.items()) for own in plan.upper]
    factors: list[_Sum] = []
    for pivot, down, along in zip(plan.inverses, below, beside, strict=True):
        # Products of a factor are those of previous pivots.
        factors += [pivot, *(entry for _, entry in down), *(entry for _, entry in along)]
    for number, entry in enumerate(factors):
        entry.number = number
    lower: list[list[tuple[int, int]]] = [[] for _ in rows]
    for m, down in enumerate(below):
        for k, entry in down:
            # By rows, for forward substitution.
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
    # Pairs were stored concatenated.
    numbers = [factor.number for factor in own.products]
    products = tuple(zip(numbers[::2], numbers[1::2], strict=True))
    pivot = -1 if own.pivot is None else own.pivot.number
    return FactorStep(own.value, own.has_shift, products, pivot, own.is_pivot)


# Matrices up to this size are stored dense.
_SMALL = 40


def narrow_band(
    n: int, column_starts: Sequence[int], row_indices: Sequence[int]
) -> tuple[int, int, Any]:
    """Return the lower and upper bandwidths, and the order of unknowns that minimises them.

    The pattern is compressed by columns. Places are None if the matrix is small or not sparse.
    """
    if n > _SMALL:
        from scipy.sparse import csc_matrix
        from scipy.sparse.csgraph import reverse_cuthill_mckee

        starts, rows = np.array(column_starts), np.array(row_indices, dtype=np.int64)
        pattern = csc_matrix((np.ones(len(rows)), rows, starts), shape=(n, n)).tocsr()
        # The order lists unknowns by their new positions; its inverse is the new position of each.
        places = np.empty(n, dtype=np.intc)
        places[reverse_cuthill_mckee(pattern, symmetric_mode=False)] = np.arange(n)
        # Distance of each entry below the diagonal after reordering.
        below = places[rows] - np.repeat(places, np.diff(starts))
        lower, upper = int(max(below.max(initial=0), 0)), int(max((-below).max(initial=0), 0))
        # The number of diagonals of banded storage with row pivoting.
        if 2 * lower + upper + 1 < n:
            return lower, upper, places
    return n - 1, n - 1, None
