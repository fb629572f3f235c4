"""Factors of matrices of nodes, for any number of right-hand sides.

In: the nonzeros of a matrix. Out: its factors, which solve by substitution. Symmetric matrices are
factorised as L D L^T. Rows without a pivot that is certainly nonzero form a dense core, whose
pivots are chosen at run time. The pivots of unsymmetric matrices are chosen by sparsity, without
regard to values; at run time a bound of the cancellation errors is computed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from cotree.dag.multi_output import RANK_TOLERANCE, SolveShape, solve
from cotree.linear.elimination import FewestCouplings, FewestUpdates, eliminate

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.linear.elimination import Factors

#: Squared gradients of constraints below this fraction of their terms are scaled as if they had
#: this size: rounding errors, about 1e-31, are then below the rank tolerance.
_SMALLEST_SHARE = 1e-17


#: Limit of the ratio of a multiplier to the one that its residual would require if nothing else
#: balanced it. Multipliers of rows that cannot be satisfied exceed it. Rounding errors of residuals
#: are amplified as much.
_BEYOND = 1e4
#: Factor on it where a residual exceeds rounding, so that the multiplier passes its limit long
#: before the row counts as one that motions change; and the largest rounding, [m/s^2], [rad/s^2].
_FURTHER, _ROUNDING = 1e6, 1e-10


class LinearSolver(Protocol):
    """Factorised equations."""

    def solve(self, rhs: Sequence[Node]) -> list[Node]:
        """Solve for one right-hand side."""


class RankedSolver(LinearSolver, Protocol):
    """Factorised equations, of which some may be redundant."""

    def solve(self, rhs: Sequence[Node], tolerance: float = RANK_TOLERANCE) -> list[Node]:
        """Solve for one right-hand side.

        Pivots chosen at run time that are below ``tolerance`` times their entries count as zero.
        """


@dataclass(frozen=True)
class Core:
    """Equations whose pivots are chosen at run time."""

    places: tuple[int, ...]  # indices of the unknowns
    matrix: tuple[tuple[Node, ...], ...]  # symmetric matrix of the equations
    #: Scales of the diagonal. Entries divided by the roots of the scales are close to 1 if nothing
    #: cancels, so that the rank does not depend on units.
    sizes: tuple[Node, ...]
    n_determined: int  # number of unknowns, the first ones, that must be unique

    def solve(self, right: Sequence[Node], tolerance: float) -> dict[int, Node]:
        """Solve for the core unknowns; empty if their right-hand side is zero."""
        rest = [right[i] for i in self.places]
        if all(value.is_zero for value in rest):
            return {}
        dag, shape = rest[0].dag, SolveShape(len(rest), self.n_determined, tolerance)
        # Scaled to a unit diagonal, so that entries are compared with one.
        found = solve(dag, self.matrix, rest, dag.one, shape, self.sizes)
        return dict(zip(self.places, found, strict=False))  # the last entry of found is the rank


@dataclass(frozen=True)
class SparseFactors:
    """A factorised matrix."""

    dag: Dag  # arena that holds the nodes
    factors: Factors[Node]  # factors, pivot by pivot
    is_symmetric: bool  # whether the row multipliers of a pivot equal those of its column
    core: Core | None = None  # the remaining system without safe pivots

    def solve(self, rhs: Sequence[Node], tolerance: float = RANK_TOLERANCE) -> list[Node]:
        """Solve for one right-hand side; see :class:`RankedSolver`."""
        own, right = self.factors, list(rhs)
        found = [self.dag.zero] * len(right)
        # The substitution in unsymmetric factors belongs to the caller's section.
        with self.dag.labelled("substitution" if self.is_symmetric else self.dag.section):
            # Forwards with L, the core in between, then backwards.
            for (i, _), below in zip(own.pivots, own.lower, strict=True):
                for k, multiplier in below.items():
                    right[k] = right[k] - multiplier * right[i]
            for i, value in self.core.solve(right, tolerance).items() if self.core else ():
                found[i] = value
            rows = own.lower if self.is_symmetric else own.upper
            for (i, j), inverse, row in reversed(
                list(zip(own.pivots, own.inverses, rows, strict=True))
            ):
                # Multipliers of symmetric matrices are already divided by the pivot.
                value = right[i] * inverse if self.is_symmetric else right[i]
                for k, entry in row.items():
                    value = value - entry * found[k]
                found[j] = value if self.is_symmetric else value * inverse
        return found


class _OfNodes:
    """Arithmetic of nodes; nodes that are identically zero are dropped."""

    def inverse(self, pivot: Node) -> Node:
        return 1.0 / pivot

    def scaled(self, entry: Node, inverse: Node) -> Node:
        return entry * inverse

    def less(self, entry: Node | None, multiplier: Node, other: Node) -> Node | None:
        product = multiplier * other
        left = -product if entry is None else entry - product
        # An entry that cancels identically is removed from the pattern, and causes no fill-in.
        return None if left.is_zero else left


def factorise(
    dag: Dag,
    matrix: Sequence[Sequence[Node]],
    is_safe: Sequence[bool],
    sizes: Sequence[Sequence[Node]] = (),
) -> SparseFactors:
    """Factorise a symmetric matrix. Pivots that are not safe may be zero at run time.

    The last unknowns are multipliers, which may be redundant. ``sizes`` contains for each of them
    the squares of the terms of its row before cancellation.
    """
    rows = _nonzeros([dict(enumerate(row)) for row in matrix])
    with dag.labelled("elimination"):
        # Only pivots that cannot be zero are eliminated; the remaining rows form the core.
        choose = FewestCouplings(rows, [i for i in rows if is_safe[i]])
        factors = eliminate(rows, _OfNodes(), choose, is_symmetric=True)
        core = _core(dag, matrix, rows, sizes) if rows else None
    return SparseFactors(dag, factors, True, core)


@dataclass(frozen=True)
class HeldFactors:
    """A factorised matrix, bordered by multipliers that are eliminated last."""

    dag: Dag  # arena that holds the nodes
    inner: RankedSolver  # factors of the matrix without its border
    border: tuple[tuple[Node, ...], ...]  # rows of the multipliers, in terms of the other unknowns
    responses: tuple[tuple[Node, ...], ...]  # solution for each column as right-hand side
    cores: tuple[Core, ...]  # remaining equations of the multipliers, in groups that are coupled

    def solve(self, rhs: Sequence[Node], tolerance: float = RANK_TOLERANCE) -> list[Node]:
        """Solve for one right-hand side; see :class:`RankedSolver`."""
        n = len(rhs) - len(self.border)
        found = self.inner.solve(rhs[:n], tolerance)
        held = [self.dag.zero] * len(self.border)
        with self.dag.labelled("substitution"):
            rest = [
                value - _product(row, found)
                for value, row in zip(rhs[n:], self.border, strict=True)
            ]
            for core in self.cores:
                for i, multiplier in core.solve(rest, tolerance).items():
                    held[i] = multiplier
                    found = [
                        value - response * multiplier
                        for value, response in zip(found, self.responses[i], strict=True)
                    ]
                # A row that no multiplier can satisfy has a multiplier beyond all limits.
                own = [held[i] for i in core.places]
                for i, row, size in zip(core.places, core.matrix, core.sizes, strict=True):
                    left = rest[i] - _product(row, own)
                    square = left * left
                    factor = _BEYOND * (1.0 + _FURTHER * (square / (square + _ROUNDING**2)))
                    held[i] = held[i] - factor * left / size
        return [*found, *held]


def hold(
    dag: Dag,
    inner: RankedSolver,
    rows: Sequence[Sequence[Node]],
    columns: Sequence[Sequence[Node]],
    n: int,
    sizes: Sequence[Node],
) -> HeldFactors:
    """Border a factorised matrix of ``n`` unknowns with rows, which may be redundant, and columns.

    The multipliers of redundant rows are those of least norm; the multiplier of a row that depends
    on no unknown is zero. ``sizes`` contains the diagonal entry of each row without cancellation.
    """
    border = tuple(tuple(row[:n]) for row in rows)
    pairs = zip(columns, border, strict=True)
    is_symmetric = all(tuple(column) == row[: len(column)] for column, row in pairs)
    responses = []
    for column in columns:
        rest = [dag.zero] * (n - len(column))
        responses.append(tuple(inner.solve([*column, *rest])))
    with dag.labelled("elimination"):
        core = [[dag.zero for _ in rows] for _ in rows]
        for i, row in enumerate(rows):
            for j, response in enumerate(responses[: i + 1] if is_symmetric else responses):
                core[i][j] = row[n + j] - _product(border[i], response)
                if is_symmetric:
                    core[j][i] = core[i][j]
        diagonal = [
            # Without the second term, a row that no motion changes would consist of rounding errors
            # only.
            dag.function("abs", core[i][i]) + size
            for i, size in enumerate(sizes)
        ]
    cores = [
        # Multipliers may be indeterminate, so that no unknown must be unique.
        Core(
            tuple(group),
            tuple(tuple(core[i][j] for j in group) for i in group),
            tuple(diagonal[i] for i in group),
            0,
        )
        for group in _coupled(core)
    ]
    return HeldFactors(dag, inner, border, tuple(responses), tuple(cores))


def _coupled(matrix: Sequence[Sequence[Node]]) -> list[list[int]]:
    """Group the rows that are coupled by entries."""
    groups: list[set[int]] = []
    for i, row in enumerate(matrix):
        own = {i, *(j for j, entry in enumerate(row) if not entry.is_zero)}
        apart = [group for group in groups if group.isdisjoint(own)]
        own = own.union(*(group for group in groups if not group.isdisjoint(own)))
        groups = [*apart, own]
    return [sorted(group) for group in sorted(groups, key=min)]


def _product(a: Sequence[Node], b: Sequence[Node]) -> Node:
    total = b[0].dag.zero
    for x, y in zip(a, b, strict=True):
        if not x.is_zero:
            total = total + x * y
    return total


def factorise_definite(dag: Dag, matrix: Sequence[Mapping[int, Node]]) -> SparseFactors:
    """Factorise a symmetric, positive definite matrix of which only the nonzeros are given."""
    rows = _nonzeros(matrix)
    with dag.labelled("elimination"):
        factors = eliminate(rows, _OfNodes(), FewestCouplings(rows, rows), is_symmetric=True)
    return SparseFactors(dag, factors, True)


def _nonzeros(matrix: Sequence[Mapping[int, Node]]) -> dict[int, dict[int, Node]]:
    return {i: {j: e for j, e in row.items() if not e.is_zero} for i, row in enumerate(matrix)}


def _core(
    dag: Dag,
    matrix: Sequence[Sequence[Node]],
    rows: Mapping[int, Mapping[int, Node]],
    natural: Sequence[Sequence[Node]],
) -> Core:
    """Scale the remainder of an elimination by rows and columns.

    Rows and columns are divided by the square roots of the diagonal entries before elimination. For
    multipliers these entries are zero, and their values after elimination, which are minus sums of
    squares, are used; squares of the couplings to the rest of the core are added.
    """
    core, n = sorted(rows), len(matrix) - len(natural)
    fresh = [i for i in core if matrix[i][i].is_zero]
    squares = {i: 1.0 / matrix[i][i] for i in core if i not in fresh}
    sizes = {i: matrix[i][i] for i in core}
    for i in fresh:
        sizes[i] = dag.function("abs", rows[i].get(i, dag.zero))
        for j, entry in rows[i].items():
            if j != i and matrix[j][i] is not dag.zero:
                # Couplings to unknowns of the core that are not eliminated, divided by their
                # diagonal entries.
                sizes[i] = sizes[i] + entry * entry * squares.get(j, dag.one)
        if i >= n:
            parts = [
                # G_j^2 / M_jj: what the diagonal of G M^-1 G^T would be if M were diagonal.
                size / matrix[j][j]
                for j, size in enumerate(natural[i - n])
                if not size.is_zero and not matrix[j][j].is_zero
            ]
            sizes[i] = kept_size(sizes[i], parts)
    return Core(
        tuple(core),
        tuple(tuple(rows[i].get(j, dag.zero) for j in core) for i in core),
        tuple(dag.one if size.is_zero else size for size in sizes.values()),
        # Accelerations in the core come before the multipliers, and must be unique.
        sum(i < n for i in core),
    )


def kept_size(size: Node, parts: Sequence[Node]) -> Node:
    """Return a positive size of a multiplier's equation whose diagonal cancels.

    The sum is zero where the gradient of a constraint vanishes, and a rounding error where
    constraints are redundant. Adding a small fraction of the sum without cancellation ensures that
    the scaled row is small in these cases.
    """
    return size + _SMALLEST_SHARE * sum(parts, size.dag.zero)


def factorise_unsymmetric(
    dag: Dag, matrix: Sequence[Mapping[int, Node]], most_updates: int
) -> tuple[SparseFactors, Node] | None:
    """Factorise a matrix; each pivot is the one whose elimination changes the fewest entries.

    Also returns the doubt in the factors at run time: the sum of ``|terms of a pivot| / |pivot|``
    over all pivots that are sums. None if the matrix is singular for all values, or if more than
    ``most_updates`` entries would be changed.
    """
    rows = _nonzeros(matrix)
    # The remaining rows have no pivot, or none that is cheap enough.
    factors = eliminate(rows, _OfNodes(), FewestUpdates(most_updates))
    if rows:
        return None
    return SparseFactors(dag, factors, False), _doubt(dag, matrix, factors)


def _doubt(dag: Dag, matrix: Sequence[Mapping[int, Node]], factors: Factors[Node]) -> Node:
    """Compare each pivot with the magnitude of the terms of its sum."""
    doubt = dag.zero
    for n, ((i, j), inverse) in enumerate(zip(factors.pivots, factors.inverses, strict=True)):
        parts = [
            # The pivot is the entry less these products; a size far above the pivot is
            # cancellation.
            lower[i] * upper[j]
            for lower, upper in zip(factors.lower[:n], factors.upper[:n], strict=True)
            if i in lower and j in upper
        ]
        # A pivot that is an entry of the matrix cannot be affected by cancellation.
        if not parts:
            continue
        size = dag.function("abs", matrix[i].get(j, dag.zero))
        for part in parts:
            size = size + dag.function("abs", part)
        doubt = doubt + size * dag.function("abs", inverse)
    return doubt
