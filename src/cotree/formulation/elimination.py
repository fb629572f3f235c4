"""Elimination of linear unknowns: sparse L D L^T with safe pivots, a dense core for the rest.

In: a symmetric matrix of nodes and which of its pivots are safe. Out: a factorisation that solves
for any number of right-hand sides by substitution.
"""

from __future__ import annotations

from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from typing import TYPE_CHECKING, Protocol

from cotree.dag.several import RANK_TOLERANCE, SolveShape, solve
from cotree.formulation.articulated import SMALLEST_SHARE, factorise_tree

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.equations import Equations, Link


@dataclass(frozen=True)
class Factors:
    """A factorised matrix.

    Attributes
    ----------
    order : tuple of int
        The safe unknowns, in the order of their elimination.
    columns : tuple of dict of int to Node
        For each of them, its multipliers in the rows that remain.
    inverses : tuple of Node
        The reciprocals of their pivots: every right-hand side multiplies by them.
    core : tuple of int
        The unknowns left to a solution at run time.
    core_sizes : tuple of Node
        Their diagonal entries: before elimination, but of those that begin at zero (multipliers)
        after it. Divided by the roots of these, entries near 1 have lost nothing to cancellation,
        which makes the rank decision free of units.
    core_matrix : tuple of rows of Node
        Their Schur complement.
    n_determined : int
        How many unknowns of the core, which come first, must have one solution only.
    """

    dag: Dag
    order: tuple[int, ...]
    columns: tuple[dict[int, Node], ...]
    inverses: tuple[Node, ...]
    core: tuple[int, ...]
    core_sizes: tuple[Node, ...]
    core_matrix: tuple[tuple[Node, ...], ...]
    n_determined: int

    def solve(self, rhs: Sequence[Node], tolerance: float = RANK_TOLERANCE) -> list[Node]:
        """Solve for one right-hand side; see :func:`substitute_back`."""
        return substitute_back(self, rhs, tolerance)


def factorise(
    dag: Dag,
    matrix: Sequence[Sequence[Node]],
    is_safe: Sequence[bool],
    sizes: Sequence[Sequence[Node]] = (),
) -> Factors:
    """Eliminate the safe unknowns, at each step the one with the fewest couplings.

    Parameters
    ----------
    dag : Dag
        The arena.
    matrix : sequence of rows of Node
        Symmetric.
    is_safe : sequence of bool
        Whether the pivot of each unknown is known to be nonzero.
    sizes : sequence of rows of Node
        For each of the last unknowns, which are multipliers and may be redundant: squares of what
        its row is made of, before anything cancels.
    """
    n = len(matrix)
    rows = {i: {j: matrix[i][j] for j in range(n) if not matrix[i][j].is_zero} for i in range(n)}
    order, columns, inverses = _eliminated(dag, rows, {i for i in range(n) if is_safe[i]})
    core = tuple(sorted(rows))
    with dag.labelled("elimination"):
        core_sizes = _core_sizes(dag, matrix, rows, sizes)
    return Factors(
        dag,
        order,
        columns,
        inverses,
        core,
        core_sizes,
        tuple(tuple(rows[i].get(j, dag.zero) for j in core) for i in core),
        sum(i < n - len(sizes) for i in core),
    )


def factorise_definite(dag: Dag, matrix: Sequence[Mapping[int, Node]]) -> Factors:
    """Factorise a symmetric, positive definite matrix of which only the nonzeros are given."""
    rows = {i: dict(row) for i, row in enumerate(matrix)}
    order, columns, inverses = _eliminated(dag, rows, set(rows))
    return Factors(dag, order, columns, inverses, (), (), (), 0)


def _eliminated(
    dag: Dag, rows: dict[int, dict[int, Node]], left: set[int]
) -> tuple[tuple[int, ...], tuple[dict[int, Node], ...], tuple[Node, ...]]:
    """Eliminate the unknowns of ``left``; give their order, multipliers and inverse pivots.

    What remains of the others is left in ``rows``.
    """
    order, columns, inverses = [], [], []
    # Ties go to the last, which lies farthest out in the tree and fills in least. Entries whose
    # count has changed since are passed over.
    waiting = [(len(rows[i]), -i) for i in left]
    heapify(waiting)
    while left:
        count, negative = heappop(waiting)
        k = -negative
        if k not in left or len(rows[k]) != count:
            continue
        left.remove(k)
        pivot_row = rows.pop(k)
        pivot = pivot_row.pop(k)
        with dag.labelled("elimination"):
            inverse = 1.0 / pivot
            multipliers = {i: entry * inverse for i, entry in sorted(pivot_row.items())}
            for i, multiplier in multipliers.items():
                del rows[i][k]
                for j, entry in pivot_row.items():
                    if j > i:
                        continue
                    updated = rows[i].get(j, dag.zero) - multiplier * entry
                    rows[i][j] = rows[j][i] = updated
        for i in multipliers:
            heappush(waiting, (len(rows[i]), -i))
        order.append(k)
        columns.append(multipliers)
        inverses.append(inverse)
    return tuple(order), tuple(columns), tuple(inverses)


def _core_sizes(
    dag: Dag,
    matrix: Sequence[Sequence[Node]],
    rows: dict[int, dict[int, Node]],
    natural: Sequence[Sequence[Node]],
) -> tuple[Node, ...]:
    """Give what makes the core's diagonal one where it can be, from both sides.

    Multipliers begin with a zero there: elimination has left minus a sum of squares, to which what
    couples them to the rest of the core is added. The sum may vanish where a constraint loses its
    gradient, or be what rounding leaves of it where constraints are redundant: a share of what it
    would be if nothing cancelled keeps such a row small.
    """
    core = sorted(rows)
    fresh = [i for i in core if matrix[i][i].is_zero]
    squares = {i: 1.0 / matrix[i][i] for i in core if i not in fresh}
    sizes = {}
    for i in fresh:
        sizes[i] = dag.function("abs", rows[i].get(i, dag.zero))
        for j, entry in rows[i].items():
            if j != i and matrix[j][i] is not dag.zero:
                sizes[i] = sizes[i] + entry * entry * squares.get(j, dag.one)
    n = len(matrix) - len(natural)
    for i in fresh:
        if i >= n:
            for j, size in enumerate(natural[i - n]):
                if not size.is_zero and not matrix[j][j].is_zero:
                    sizes[i] = sizes[i] + SMALLEST_SHARE * (size / matrix[j][j])
    found = [sizes.get(i, matrix[i][i]) for i in core]
    return tuple(dag.one if size.is_zero else size for size in found)


class Solver(Protocol):
    """A factorised matrix, whichever way."""

    def solve(self, rhs: Sequence[Node], tolerance: float = RANK_TOLERANCE) -> list[Node]:
        """Solve for one right-hand side; see :func:`substitute_back`."""
        ...


def eliminate(
    dag: Dag,
    matrix: Sequence[Sequence[Node]],
    is_safe: Sequence[bool],
    sizes: Sequence[Sequence[Node]],
    links: Sequence[Link],
) -> Solver:
    """Factorise a bordered mass matrix, along its tree where ``links`` describe one."""
    if not links:
        return factorise(dag, matrix, is_safe, sizes)
    n = len(matrix) - len(sizes)
    return factorise_tree(dag, links, [row[:n] for row in matrix[n:]], sizes, n)


def solve_unknowns(equations: Equations) -> tuple[Solver, dict[Node, Node]]:
    """Factorise the matrix of some equations, and solve them for their unknowns."""
    factors = eliminate(
        equations.dag,
        equations.matrix,
        equations.is_safe,
        equations.constraints.sizes,
        equations.links,
    )
    unknowns = factors.solve(equations.forcing)
    return factors, dict(zip(equations.unknowns, unknowns, strict=True))


def substitute_back(
    factors: Factors, rhs: Sequence[Node], tolerance: float = RANK_TOLERANCE
) -> list[Node]:
    """Solve for one right-hand side.

    Parameters
    ----------
    factors : Factors
        From :func:`factorise`.
    rhs : sequence of Node
        Right-hand side.
    tolerance : float
        Pivots of the core below this share of its entries are zero.

    Returns
    -------
    list of Node
        The unknowns.
    """
    dag = factors.dag
    right = list(rhs)
    unknowns = [dag.zero] * len(right)
    with dag.labelled("substitution"):
        for k, column in zip(factors.order, factors.columns, strict=True):
            for i, multiplier in column.items():
                right[i] = right[i] - multiplier * right[k]
        if factors.core and any(not right[i].is_zero for i in factors.core):
            rest = [right[i] for i in factors.core]
            shape = SolveShape(len(rest), factors.n_determined, tolerance)
            solution = solve(dag, factors.core_matrix, rest, dag.one, shape, factors.core_sizes)
            for i, value in zip(factors.core, solution, strict=False):
                unknowns[i] = value
        for k, column, inverse in zip(
            reversed(factors.order),
            reversed(factors.columns),
            reversed(factors.inverses),
            strict=True,
        ):
            value = right[k] * inverse
            for i, multiplier in column.items():
                value = value - multiplier * unknowns[i]
            unknowns[k] = value
    return unknowns
