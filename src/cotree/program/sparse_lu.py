"""The elimination of a sparse matrix, planned from its pattern alone.

In: the pattern of the Jacobian J, and the number of algebraic unknowns, which come last. Out: the
steps that factor ``shift M - J`` and solve with the factors, where M is one on the diagonal of the
other unknowns and zero elsewhere. Values are known at run time only: the code that takes the steps
checks their results.
"""

from __future__ import annotations

from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True)
class Entry:
    """One of the factors: ``(shift + -J - sum of products) * scale``, or its reciprocal.

    Attributes
    ----------
    value : int
        Its place among the entries of J, or -1 where there is none.
    has_shift : bool
        Whether ``shift`` is added.
    products : tuple of (int, int)
        Factors whose products are subtracted.
    pivot : int
        The factor that it is multiplied with, or -1 for none.
    is_pivot : bool
        Whether its reciprocal is kept.
    """

    value: int
    has_shift: bool
    products: tuple[tuple[int, int], ...]
    pivot: int
    is_pivot: bool


@dataclass(frozen=True)
class Elimination:
    """Plan of the factorisation of a matrix, and of solutions with its factors.

    Attributes
    ----------
    factors : tuple of Entry
        In the order in which they are computed.
    rows, columns : tuple of int
        Row and column of each pivot, in order.
    pivots : tuple of int
        Place of each pivot's reciprocal among the factors.
    lower : tuple of tuples of (int, int)
        For each pivot, which earlier ones its row subtracts: number and factor.
    upper : tuple of tuples of (int, int)
        The same of later ones, for substitution backwards.
    """

    factors: tuple[Entry, ...]
    rows: tuple[int, ...]
    columns: tuple[int, ...]
    pivots: tuple[int, ...]
    lower: tuple[tuple[tuple[int, int], ...], ...]
    upper: tuple[tuple[tuple[int, int], ...], ...]

    @property
    def n_operations(self) -> int:
        """Number of products of the factorisation and of one solution."""
        solving = sum(len(row) for row in (*self.lower, *self.upper))
        return sum(len(entry.products) + 1 for entry in self.factors) + solving


def plan_elimination(
    n: int, column_starts: Sequence[int], row_indices: Sequence[int], n_algebraic: int
) -> Elimination | None:
    """Plan the factors of ``shift M - J``.

    Parameters
    ----------
    n : int
        Number of unknowns.
    column_starts, row_indices : sequence of int
        The pattern of J, compressed by columns.
    n_algebraic : int
        How many of the unknowns are algebraic.

    Returns
    -------
    Elimination or None
        None where the pattern alone makes the matrix singular.
    """
    place = {
        (row_indices[i], j): i
        for j in range(n)
        for i in range(column_starts[j], column_starts[j + 1])
    }
    shifted = range(n - n_algebraic)
    columns: list[set[int]] = [set() for _ in range(n)]
    for i, j in [*place, *((k, k) for k in shifted)]:
        columns[j].add(i)
    row_of = _match(columns)
    if row_of is None:
        return None
    order = _least_degree(columns, row_of)
    return _plan(order, row_of, columns, place, n - n_algebraic)


def _match(columns: list[set[int]]) -> list[int] | None:
    """Match each column with a distinct row that has an entry in it, its own where it can."""
    row_of = [j if j in rows else -1 for j, rows in enumerate(columns)]
    column_of = {row: j for j, row in enumerate(row_of) if row >= 0}
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
            j = came_from[row]
            row_of[j], row = row, row_of[j]
            column_of[row_of[j]] = j
            if j == start:
                break
    return row_of


def _least_degree(columns: list[set[int]], row_of: list[int]) -> list[int]:
    """Order the pivots, each given by its column, for little fill-in (Markowitz)."""
    n = len(columns)
    column_of = {row: j for j, row in enumerate(row_of)}
    # Rows by the columns that own them: pivots are then on the diagonal.
    below = [{column_of[i] for i in rows} - {j} for j, rows in enumerate(columns)]
    right: list[set[int]] = [set() for _ in range(n)]
    for j, rows in enumerate(below):
        for i in rows:
            right[i].add(j)
    heap = [(len(below[k]) * len(right[k]), k) for k in range(n)]
    heapify(heap)
    order, is_done = [], [False] * n
    while heap:
        cost, k = heappop(heap)
        if is_done[k] or cost != len(below[k]) * len(right[k]):
            continue
        is_done[k] = True
        order.append(k)
        for i in below[k]:
            right[i].discard(k)
            right[i] |= right[k] - {i}
        for j in right[k]:
            below[j].discard(k)
            below[j] |= below[k] - {j}
        for i in below[k] | right[k]:
            heappush(heap, (len(below[i]) * len(right[i]), i))
    return order


def _plan(
    order: list[int],
    row_of: list[int],
    columns: list[set[int]],
    place: dict[tuple[int, int], int],
    n_shifted: int,
) -> Elimination:
    """List the factors, each computed in one step from earlier ones (Crout)."""
    n = len(order)
    rank = {column: k for k, column in enumerate(order)}
    rows, cols = [row_of[j] for j in order], list(order)
    rank_of_row = {row: k for k, row in enumerate(rows)}
    left: list[list[int]] = [[] for _ in range(n)]  # of each pivot's row, before the diagonal
    above: list[list[int]] = [[] for _ in range(n)]  # of each pivot's column
    down: list[set[int]] = [set() for _ in range(n)]
    along: list[set[int]] = [set() for _ in range(n)]
    for j, of_column in enumerate(columns):
        for row in of_column:
            i, k = rank_of_row[row], rank[j]
            if i > k:
                down[k].add(i)
            elif i < k:
                along[i].add(k)
    for k in range(n):
        for i in down[k]:
            down_too = {j for j in along[k] if j < i}
            for j in down_too:
                down[j].add(i)
            along[i] |= {j for j in along[k] if j > i}
            left[i].append(k)
        for j in along[k]:
            above[j].append(k)
    number: dict[tuple[int, int], int] = {}
    factors: list[Entry] = []

    def add(i: int, j: int, pivot: int) -> None:
        shared = [m for m in left[i] if m < min(i, j) and (m, j) in number]
        products = tuple((number[i, m], number[m, j]) for m in shared)
        row, column = rows[i], cols[j]
        number[i, j] = len(factors)
        has_shift = row == column and row < n_shifted
        factors.append(Entry(place.get((row, column), -1), has_shift, products, pivot, i == j))

    for k in range(n):
        add(k, k, -1)
        for i in sorted(down[k]):
            add(i, k, number[k, k])
        for j in sorted(along[k]):
            add(k, j, -1)
    return Elimination(
        tuple(factors),
        tuple(rows),
        tuple(cols),
        tuple(number[k, k] for k in range(n)),
        tuple(tuple((m, number[k, m]) for m in sorted(left[k])) for k in range(n)),
        tuple(tuple((j, number[k, j]) for j in sorted(along[k])) for k in range(n)),
    )
