"""Linear equations of a block, factorised once for any number of right-hand sides."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.dag.multi_output import SolveShape, solve
from cotree.linear.factors import factorise_definite
from cotree.tolerances import TINY

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.linear.factors import LinearSolver


@dataclass(frozen=True)
class _AtRunTime:
    """Equations whose pivots are chosen at run time, with scaled rows and columns."""

    dag: Dag
    matrix: tuple[tuple[Node, ...], ...]
    row_scales: tuple[Node, ...]
    column_scales: tuple[Node, ...]
    n_determined: int

    def solve(self, rhs: Sequence[Node]) -> list[Node]:
        """Solve for one right-hand side.

        One of zeros is solved too: that the solution is zero is to be checked with the rank.
        """
        n = len(rhs)
        scaled = [value * scale for value, scale in zip(rhs, self.row_scales, strict=True)]
        found = solve(
            self.dag, self.matrix, scaled, self.dag.zero, SolveShape(n, self.n_determined)
        )
        return [value * s for value, s in zip(found, self.column_scales, strict=False)]


def _at_run_time(dag: Dag, matrix: Sequence[Sequence[Node]], n_determined: int) -> _AtRunTime:
    """Divide rows, then columns, by the sums of their sizes, which makes pivots comparable."""
    n = range(len(matrix))
    # Units differ from row to row (volts, amperes, newtons): without scales the largest pivot would
    # be a matter of units, and so would the decision on the rank.
    rows = tuple(1.0 / _size(dag, row) for row in matrix)
    scaled = [[matrix[i][j] * rows[i] for j in n] for i in n]
    columns = tuple(1.0 / _size(dag, [scaled[i][j] for i in n]) for j in n)
    return _AtRunTime(
        dag,
        tuple(tuple(scaled[i][j] * columns[j] for j in n) for i in n),
        rows,
        columns,
        n_determined,
    )


def _size(dag: Dag, entries: Sequence[Node]) -> Node:
    # A row of zeros is divided by it, so that the rank shows it.
    total = dag.constant(TINY)
    for entry in entries:
        total = total + dag.function("abs", entry)
    return total


def factorise_block(
    dag: Dag, matrix: Sequence[Mapping[int, Node]], is_safe: bool, n_determined: int
) -> LinearSolver:
    """Factorise the equations of a block.

    Parameters
    ----------
    dag : Dag
        The arena.
    matrix : sequence of mapping of int to Node
        The rows; absent entries are zero.
    is_safe : bool
        Whether it is positive definite for every state, if it is symmetric.
    n_determined : int
        Number of leading unknowns that must have one solution.
    """
    # Symmetric and positive definite: any order of pivots is stable.
    if is_safe and _is_symmetric(matrix):
        return factorise_definite(dag, matrix)
    n = range(len(matrix))
    return _at_run_time(dag, [[row.get(j, dag.zero) for j in n] for row in matrix], n_determined)


def _is_symmetric(matrix: Sequence[Mapping[int, Node]]) -> bool:
    """Whether entries across the diagonal are the same nodes.

    Where branches and chords are torn together they are each other's negatives.
    """
    return all(
        matrix[j].get(i) is entry for i, row in enumerate(matrix) for j, entry in row.items()
    )
