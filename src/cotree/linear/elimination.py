"""Gaussian elimination of a sparse matrix, whatever its entries are.

In: the nonzeros of a matrix, a choice of pivots, and the arithmetic of the entries. Out: its
factors. Entries are nodes where values become code, or places in a plan where only the pattern is
known. The sparse eliminations of this package are this one; they differ in what they choose as
pivots, and in whether symmetry halves the work.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

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
        """Subtract a product from an entry.

        Parameters
        ----------
        entry : T or None
            Of the remainder; None stands for zero, as in the result.
        multiplier, other : T
            The factor of the pivot's row, and that row's entry in the same column.
        """


@dataclass
class Remainder:
    """The pattern that is left between two pivots.

    Attributes
    ----------
    rows, columns : mapping of int to collection of int
        The columns of each row's entries, and the rows of each column's.
    below, beside : collection of int
        The rows and the columns that the last pivot was coupled with.
    """

    rows: Mapping[int, Collection[int]]
    columns: Mapping[int, Collection[int]]
    below: Collection[int] = ()
    beside: Collection[int] = ()


#: Chooses the next pivot; None where elimination ends. See :mod:`cotree.linear.pivots`.
Choice = Callable[[Remainder], Place | None]


@dataclass(frozen=True)
class Factors(Generic[T]):
    """Factors of a matrix, pivot by pivot.

    Attributes
    ----------
    pivots : tuple of (int, int)
        Row and column of each.
    inverses : tuple of T
        Their reciprocals: every right-hand side multiplies by them.
    lower : tuple of dict of int to T
        For each pivot, the multipliers with which its row is subtracted from others, by row.
    upper : tuple of dict of int to T
        The rest of each pivot's row when it is taken, by column.
    """

    pivots: tuple[Place, ...]
    inverses: tuple[T, ...]
    lower: tuple[dict[int, T], ...]
    upper: tuple[dict[int, T], ...]


def eliminate(
    rows: dict[int, dict[int, T]],
    arithmetic: Arithmetic[T],
    choose: Choice,
    *,
    is_symmetric: bool = False,
) -> Factors[T]:
    """Eliminate unknowns as long as there is a choice of a pivot.

    Parameters
    ----------
    rows : dict of int to dict of int to T
        The nonzeros by row and column. What remains is left there.
    arithmetic : Arithmetic
        That of the entries.
    choose : Choice
        Of the pivots.
    is_symmetric : bool
        Whether entries across the diagonal are the same, and all pivots lie on it: one half of them
        is then computed.
    """
    # A symmetric matrix is its own transpose.
    columns: dict[int, set[int]] = {} if is_symmetric else columns_of(rows)
    left = Remainder(rows, rows if is_symmetric else columns)
    pivots, inverses, lower, upper = [], [], [], []
    less = arithmetic.less
    # Right-looking elimination: each pivot updates all that remains, so that counts are current
    # when the next is chosen.
    while (pivot := choose(left)) is not None:
        i, j = pivot
        row = rows.pop(i)
        inverse = arithmetic.inverse(row.pop(j))
        if not is_symmetric:
            for k in (j, *row):
                columns[k].discard(i)
        # Sorted, so that the code that is generated does not depend on the order of sets.
        below = sorted(row if is_symmetric else columns.pop(j))
        # By the reciprocal, so that each pivot costs one division.
        multipliers = {k: arithmetic.scaled(rows[k].pop(j), inverse) for k in below}
        for k, multiplier in multipliers.items():
            own = rows[k]
            for other, entry in row.items():
                # The entry across the diagonal is computed once and put in both places.
                if is_symmetric and other > k:
                    continue
                before = own.get(other)
                updated = less(before, multiplier, entry)
                # The same object: an unchanged node, or a sum that was extended in place.
                if updated is before:
                    continue
                _put(own, columns, k, other, updated)
                if is_symmetric and other != k:
                    _put(rows[other], columns, other, k, updated)
        # Only rows and columns that the pivot touched have other counts now.
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


def _put(
    row: dict[int, T], columns: Mapping[int, set[int]], i: int, j: int, entry: T | None
) -> None:
    """Put an entry into row i, column j, and keep track of the pattern by columns, if any."""
    if entry is None:
        row.pop(j, None)
    else:
        row[j] = entry
    if columns:
        (columns[j].discard if entry is None else columns[j].add)(i)
