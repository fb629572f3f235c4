"""Elimination of unsymmetric linear equations with pivots chosen before any value is known.

In: the nonzeros of a matrix of nodes. Out: its factors, for any number of right-hand sides, and a
doubt, which tells at run time what elimination may have lost to cancellation. Equations that can be
solved one after another are: an unknown that stands alone in its equation is a pivot that changes
nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Dag, Node


@dataclass(frozen=True)
class StaticFactors:
    """A factorised matrix.

    Attributes
    ----------
    pivots : tuple of (int, int)
        Equation and unknown of each, in order.
    inverses : tuple of Node
        Their reciprocals.
    multipliers : tuple of mapping of int to Node
        For each pivot, what its equation is subtracted from the others with.
    rows : tuple of mapping of int to Node
        The rest of each pivot's equation when it is taken, by unknown.
    doubt : Node
        Sum of ``|what a pivot is the sum of| / |pivot|``, of pivots that are sums.
    """

    dag: Dag
    pivots: tuple[tuple[int, int], ...]
    inverses: tuple[Node, ...]
    multipliers: tuple[Mapping[int, Node], ...]
    rows: tuple[Mapping[int, Node], ...]
    doubt: Node

    def solve(self, rhs: Sequence[Node]) -> list[Node]:
        """Solve for one right-hand side."""
        right, found = list(rhs), [self.dag.zero] * len(rhs)
        for (i, _), column in zip(self.pivots, self.multipliers, strict=True):
            for k, multiplier in column.items():
                right[k] = right[k] - multiplier * right[i]
        for (i, j), inverse, row in zip(
            reversed(self.pivots), reversed(self.inverses), reversed(self.rows), strict=True
        ):
            value = right[i]
            for k, entry in row.items():
                value = value - entry * found[k]
            found[j] = value * inverse
        return found


def factorise_static(
    dag: Dag, matrix: Sequence[Mapping[int, Node]], most_updates: int
) -> StaticFactors | None:
    """Factorise a matrix; at each step the pivot whose elimination changes the fewest entries.

    Pivots lie on the diagonal, or where an equation has one unknown left, or an unknown one
    equation; elsewhere only where there is no other choice.

    Parameters
    ----------
    dag : Dag
        The arena.
    matrix : sequence of mapping of int to Node
        The rows; absent entries are zero.
    most_updates : int
        How many entries may be changed in all.

    Returns
    -------
    StaticFactors or None
        None where it is singular whatever the values, or where that takes more.
    """
    rows = {i: {j: e for j, e in row.items() if not e.is_zero} for i, row in enumerate(matrix)}
    columns: dict[int, set[int]] = {j: set() for j in rows}
    for i, row in rows.items():
        for j in row:
            columns[j].add(i)
    parts: dict[tuple[int, int], list[Node]] = {}
    pivots, inverses, multipliers, rests = [], [], [], []
    doubt = dag.zero
    while rows:
        pivot = _choose(rows, columns)
        if pivot is None:
            return None
        i, j = pivot
        row = rows.pop(i)
        entry = row.pop(j)
        for k in (j, *row):
            columns[k].discard(i)
        below = sorted(columns.pop(j))
        most_updates -= len(below) * len(row)
        if most_updates < 0:
            return None
        inverse = 1.0 / entry
        if pivot in parts:
            sizes = dag.zero
            for part in parts[pivot]:
                sizes = sizes + dag.function("abs", part)
            doubt = doubt + sizes * dag.function("abs", inverse)
        factors = {k: rows[k].pop(j) * inverse for k in below}
        for k, factor in factors.items():
            for other, value in row.items():
                _subtract(rows[k], columns, parts, (k, other), factor * value)
        pivots.append(pivot)
        inverses.append(inverse)
        multipliers.append(factors)
        rests.append(row)
    return StaticFactors(
        dag, tuple(pivots), tuple(inverses), tuple(multipliers), tuple(rests), doubt
    )


def _subtract(
    row: dict[int, Node],
    columns: Mapping[int, set[int]],
    parts: dict[tuple[int, int], list[Node]],
    place: tuple[int, int],
    value: Node,
) -> None:
    """Subtract a value from an entry, and remember what the entry is the sum of."""
    i, j = place
    before = row.get(j)
    if before is not None:
        parts.setdefault(place, [before])
    parts.setdefault(place, []).append(value)
    after = -value if before is None else before - value
    if after.is_zero:
        row.pop(j, None)
        columns[j].discard(i)
    else:
        row[j] = after
        columns[j].add(i)


def _choose(
    rows: Mapping[int, Mapping[int, Node]], columns: Mapping[int, set[int]]
) -> tuple[int, int] | None:
    """Choose the next pivot; None where an equation has no unknown left."""
    best: tuple[int, ...] | None = None
    for i, row in rows.items():
        if not row:
            return None
        for j in row:
            cost = (len(row) - 1) * (len(columns[j]) - 1)
            is_apart = i != j and cost > 0
            rank = (int(is_apart), cost, int(i != j), i, j)
            if best is None or rank < best:
                best = rank
    return None if best is None else (best[-2], best[-1])
