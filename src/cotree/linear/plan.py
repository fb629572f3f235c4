"""Plan of the elimination of a sparse matrix, from its pattern only.

In: the pattern of the Jacobian J, and the number of algebraic unknowns, which come last. Out: the
steps that factor ``shift M - J`` and solve with the factors, where M is one on the diagonal of the
other unknowns and zero elsewhere. Values are known at run time only, and the code that takes the
steps checks their results.

For banded factors: the bandwidths of a pattern that is compressed by columns, and the places of the
unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.linear.elimination import (
    Factors,
    FewestUpdatesOfMatched,
    Remainder,
    columns_of,
    eliminate,
    match,
)

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True)
class FactorStep:
    """One of the factors: ``(shift + -J - sum of products) * scale``, or its reciprocal."""

    value: int  # its index among the entries of J, or -1
    has_shift: bool  # whether ``shift`` is added
    products: tuple[tuple[int, int], ...]  # factors whose products are subtracted
    pivot: int  # the factor that it is multiplied with, or -1 for none
    is_pivot: bool  # whether its reciprocal is stored


@dataclass(frozen=True)
class Elimination:
    """Plan of the factorisation of a matrix, and of solutions with its factors."""

    factors: tuple[FactorStep, ...]  # in the order in which they are computed
    #: Row and column of each pivot, in order.
    rows: tuple[int, ...]
    columns: tuple[int, ...]
    pivots: tuple[int, ...]  # place of each pivot's reciprocal among the factors
    #: For each pivot, which earlier ones its row subtracts: number and factor.
    lower: tuple[tuple[tuple[int, int], ...], ...]
    #: The same of later ones, for substitution backwards.
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
    """An entry while it is eliminated: its place in J, and the products subtracted from it."""

    value: int = -1
    has_shift: bool = False
    products: list[_Sum] = field(default_factory=list)  # pairs, one factor after the other
    pivot: _Sum | None = None
    is_pivot: bool = False
    number: int = -1  # among the factors, once their order is known


class _OfSums:
    """Symbolic elimination: it records products, and no entry vanishes."""

    def inverse(self, pivot: _Sum) -> _Sum:
        # The reciprocal replaces the pivot, since solutions multiply by it.
        pivot.is_pivot = True
        return pivot

    def scaled(self, entry: _Sum, inverse: _Sum) -> _Sum:
        entry.pivot = inverse
        return entry

    def less(self, entry: _Sum | None, multiplier: _Sum, other: _Sum) -> _Sum:
        if entry is None:
            # Fill-in: no place in J.
            entry = _Sum()
        entry.products += multiplier, other
        return entry


def _listed(plan: Factors[_Sum]) -> Elimination:
    """Assign numbers to the factors: pivot by pivot, each in the order of the other pivots."""
    rows, columns = [i for i, _ in plan.pivots], [j for _, j in plan.pivots]
    # From here on rows and columns are numbered by the rank of their pivot.
    rank_of_row = {row: k for k, row in enumerate(rows)}
    rank_of_column = {column: k for k, column in enumerate(columns)}
    below = [sorted((rank_of_row[i], entry) for i, entry in own.items()) for own in plan.lower]
    beside = [sorted((rank_of_column[j], entry) for j, entry in own.items()) for own in plan.upper]
    factors: list[_Sum] = []
    for pivot, down, along in zip(plan.inverses, below, beside, strict=True):
        # Products of a factor are those of earlier pivots.
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
    # Pairs were stored one factor after the other.
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
