"""Factors of matrices whose entries are nodes, for any number of right-hand sides.

Symmetric matrices are factorised as L D L^T. Rows whose pivots may be zero form a dense core, whose
pivots are chosen at run time. Pivots of unsymmetric matrices are chosen for sparsity; the code
measures the cancellation in them at run time.
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

#: Smallest ratio of a squared constraint gradient to the sum of its squared terms. Scales of rows
#: use at least this ratio, so that rounding errors (about 1e-31) stay below the rank tolerance.
_SMALLEST_SHARE = 1e-17

#: Factor of residuals that are added to multipliers: it makes the multiplier of a row that cannot
#: be satisfied exceed all limits, but also amplifies rounding errors of residuals.
_BEYOND = 1e4


class LinearSolver(Protocol):
    """Factorised equations that can be solved for any right-hand side."""

    def solve(self, rhs: Sequence[Node]) -> list[Node]:
        """Solve for one right-hand side."""


class RankedSolver(LinearSolver, Protocol):
    """Factorised equations, some of which may be redundant."""

    def solve(self, rhs: Sequence[Node], tolerance: float = RANK_TOLERANCE) -> list[Node]:
        """Solve for one right-hand side.

        Pivots chosen at run time count as zero below ``tolerance`` times the scale of their row.
        """


@dataclass(frozen=True)
class Core:
    """Equations whose pivots are chosen at run time."""

    places: tuple[int, ...]  # indices of the unknowns
    matrix: tuple[tuple[Node, ...], ...]  # symmetric matrix of the equations
    #: Scales of the diagonal. Entries are divided by the roots of their scales: without
    #: cancellation, the diagonal is then close to 1, so that the rank does not depend on units.
    sizes: tuple[Node, ...]
    n_determined: int  # number of leading unknowns that must be unique

    def solve(self, right: Sequence[Node], tolerance: float) -> dict[int, Node]:
        """Return the unknowns of the core by index; empty if their right-hand side is zero."""
        rest = [right[i] for i in self.places]
        if all(value.is_zero for value in rest):
            return {}
        dag, shape = rest[0].dag, SolveShape(len(rest), self.n_determined, tolerance)
        # The scaled diagonal is about 1, so pivots are compared with one.
        found = solve(dag, self.matrix, rest, dag.one, shape, self.sizes)
        return dict(zip(self.places, found, strict=False))  # without rank and acceptance


@dataclass(frozen=True)
class SparseFactors:
    """A factorised matrix."""

    dag: Dag  # arena of the nodes
    factors: Factors[Node]  # factors, pivot by pivot
    is_symmetric: bool  # whether the multipliers of a pivot's row and column are equal
    core: Core | None = None  # remaining equations, whose pivots may be zero

    def solve(self, rhs: Sequence[Node], tolerance: float = RANK_TOLERANCE) -> list[Node]:
        """Solve for one right-hand side; see :class:`RankedSolver`."""
        own, right = self.factors, list(rhs)
        found = [self.dag.zero] * len(right)
        # Nodes of unsymmetric factors keep the label that the caller has set.
        with self.dag.labelled("substitution" if self.is_symmetric else self.dag.section):
            # Forward substitution with L, then the core, then backward substitution.
            for (i, _), below in zip(own.pivots, own.lower, strict=True):
                for k, multiplier in below.items():
                    right[k] = right[k] - multiplier * right[i]
            for i, value in self.core.solve(right, tolerance).items() if self.core else ():
                found[i] = value
            rows = own.lower if self.is_symmetric else own.upper
            for (i, j), inverse, row in reversed(
                list(zip(own.pivots, own.inverses, rows, strict=True))
            ):
                # The multipliers of symmetric matrices are already divided by the pivot.
                value = right[i] * inverse if self.is_symmetric else right[i]
                for k, entry in row.items():
                    value = value - entry * found[k]
                found[j] = value if self.is_symmetric else value * inverse
        return found


class _OfNodes:
    def inverse(self, pivot: Node) -> Node:
        return 1.0 / pivot

    def scaled(self, entry: Node, inverse: Node) -> Node:
        return entry * inverse

    def less(self, entry: Node | None, multiplier: Node, other: Node) -> Node | None:
        product = multiplier * other
        left = -product if entry is None else entry - product
        # An entry that is structurally zero is removed, and so causes no fill-in.
        return None if left.is_zero else left


def factorise(
    dag: Dag,
    matrix: Sequence[Sequence[Node]],
    is_safe: Sequence[bool],
    sizes: Sequence[Sequence[Node]] = (),
) -> SparseFactors:
    """Factorise a symmetric matrix; pivots that are not safe may be zero at run time.

    The last unknowns are multipliers, which may be redundant. ``sizes`` contains the squared terms
    of their rows, without cancellation.
    """
    rows = _nonzeros([dict(enumerate(row)) for row in matrix])
    with dag.labelled("elimination"):
        # Eliminate only safe pivots; the remaining rows form the core.
        choose = FewestCouplings(rows, [i for i in rows if is_safe[i]])
        factors = eliminate(rows, _OfNodes(), choose, is_symmetric=True)
        core = _core(dag, matrix, rows, sizes) if rows else None
    return SparseFactors(dag, factors, True, core)


@dataclass(frozen=True)
class HeldFactors:
    """A factorised matrix, bordered by rows and columns of multipliers, eliminated last."""

    dag: Dag  # arena of the nodes
    inner: RankedSolver  # factors of the matrix without border
    border: tuple[tuple[Node, ...], ...]  # coefficients of the inner unknowns in the border rows
    responses: tuple[tuple[Node, ...], ...]  # solution with each border column as right-hand side
    cores: tuple[Core, ...]  # remaining equations of the multipliers, in coupled groups

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
                # If no multiplier can satisfy a row, make its multiplier exceed all limits.
                own = [held[i] for i in core.places]
                for i, row, size in zip(core.places, core.matrix, core.sizes, strict=True):
                    held[i] = held[i] - _BEYOND * (rest[i] - _product(row, own)) / size
        return [*found, *held]


def hold(
    dag: Dag,
    inner: RankedSolver,
    rows: Sequence[Sequence[Node]],
    columns: Sequence[Sequence[Node]],
    n: int,
    sizes: Sequence[Node],
) -> HeldFactors:
    """Add a border of rows and columns, which may be redundant, to a factorised matrix.

    Multipliers of redundant rows have minimum norm; multipliers of rows without unknowns are zero.
    ``sizes`` contains each row's diagonal entry without cancellation.
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
            # Without the added sum, a row that no motion affects would be pure rounding.
            dag.function("abs", core[i][i]) + size
            for i, size in enumerate(sizes)
        ]
    cores = [
        # Multipliers may be indeterminate, so their uniqueness is not required.
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
    """Return groups of rows that nonzero entries couple."""
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
    """Factorise a symmetric, positive definite matrix from its nonzeros."""
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
    """Return the remaining equations of an elimination, scaled by the roots of diagonal entries.

    Diagonal entries of multipliers are zero. Their scales are minus the entries after elimination,
    which are sums of squares, plus squared couplings to the rest of the core.
    """
    core, n = sorted(rows), len(matrix) - len(natural)
    fresh = [i for i in core if matrix[i][i].is_zero]
    squares = {i: 1.0 / matrix[i][i] for i in core if i not in fresh}
    sizes = {i: matrix[i][i] for i in core}
    for i in fresh:
        sizes[i] = dag.function("abs", rows[i].get(i, dag.zero))
        for j, entry in rows[i].items():
            if j != i and matrix[j][i] is not dag.zero:
                # Squared couplings to core unknowns, over the diagonal entries of these unknowns.
                sizes[i] = sizes[i] + entry * entry * squares.get(j, dag.one)
        if i >= n:
            parts = [
                # Diagonal of G M^-1 G^T if M were diagonal: the sum of G_j^2 / M_jj.
                size / matrix[j][j]
                for j, size in enumerate(natural[i - n])
                if not size.is_zero and not matrix[j][j].is_zero
            ]
            sizes[i] = kept_size(sizes[i], parts)
    return Core(
        tuple(core),
        tuple(tuple(rows[i].get(j, dag.zero) for j in core) for i in core),
        tuple(dag.one if size.is_zero else size for size in sizes.values()),
        # The accelerations in the core precede the multipliers and must be unique.
        sum(i < n for i in core),
    )


def kept_size(size: Node, parts: Sequence[Node]) -> Node:
    """Return a diagonal entry plus a small fraction of its sum without cancellation.

    The entry is zero if the gradient of a constraint vanishes, and a rounding error if constraints
    are redundant. Divided by the result, such a row is small.
    """
    return size + _SMALLEST_SHARE * sum(parts, size.dag.zero)


def factorise_unsymmetric(
    dag: Dag, matrix: Sequence[Mapping[int, Node]], most_updates: int
) -> tuple[SparseFactors, Node] | None:
    """Factorise with pivots that change the fewest entries, and form a measure of cancellation.

    The measure is the sum of ``|terms of a pivot| / |pivot|`` over all pivots that are sums. Return
    None if the matrix is structurally singular or more than ``most_updates`` entries would change.
    """
    rows = _nonzeros(matrix)
    # Rows remain if they have no pivot, or if all of their pivots would change too many entries.
    factors = eliminate(rows, _OfNodes(), FewestUpdates(most_updates))
    if rows:
        return None
    return SparseFactors(dag, factors, False), _doubt(dag, matrix, factors)


def _doubt(dag: Dag, matrix: Sequence[Mapping[int, Node]], factors: Factors[Node]) -> Node:
    doubt = dag.zero
    for n, ((i, j), inverse) in enumerate(zip(factors.pivots, factors.inverses, strict=True)):
        parts = [
            # The pivot is an entry minus these products, and small if they cancel.
            lower[i] * upper[j]
            for lower, upper in zip(factors.lower[:n], factors.upper[:n], strict=True)
            if i in lower and j in upper
        ]
        # A pivot without products is a matrix entry, which cannot cancel.
        if not parts:
            continue
        size = dag.function("abs", matrix[i].get(j, dag.zero))
        for part in parts:
            size = size + dag.function("abs", part)
        doubt = doubt + size * dag.function("abs", inverse)
    return doubt
