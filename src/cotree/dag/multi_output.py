"""Nodes with several results: ``solve``, ``table``, ``lookup``, ``call``, ``map``, ``sines``.

A ``map`` applies the same statements to many columns, because sensitivities to different parameters
require the same operations on different inputs. C processes several columns at a time. The
arguments of the node are the values that all columns share, then the values of each column; its
results are sorted by column. A value is not computed in columns in which all of its inputs are
zero.

Each operation has a row in :data:`SEVERAL` with its evaluation; its derivatives are in
:mod:`cotree.dag.derivative`, its statements in :mod:`cotree.codegen.node_statements`. A ``result``
node reads one of the results.
"""

from __future__ import annotations

import bisect
import contextlib
import math
from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.dag.nodes import (
    COLUMN,
    PACKED_SENSITIVITY,
    SENSITIVITY,
    SHARED,
    Dag,
    Node,
    dependent,
    reachable,
    substitute,
    supports_of,
)
from cotree.dag.operations import OPERATIONS

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterable, Sequence

    from cotree.dag.lookup import LinearTable


#: Operations in maps; divisions by shared values are converted to products.
_LINEAR = frozenset({"add", "sub", "mul", "neg"})
#: Operations that are finite for all finite arguments, apart from overflow.
_FINITE = _LINEAR | {"abs", "sign", "floor", "sin", "cos", "atan", "tanh", "select"}
#: Number of columns that C processes together; values that are zero in all of them are skipped.
BLOCK = 4


@dataclass(frozen=True, eq=False)
class LinearMap:
    """Linear operations that are applied to each column of a matrix."""

    results: tuple[Node, ...]  # functions of the symbols ``(SHARED, i)`` and ``(COLUMN, i)``
    #: Number of values that all columns share, and number of values in each column.
    n_shared: int
    n_inputs: int
    #: Bit mask of the inputs that may be nonzero in each column, the first in the lowest bit.
    given: tuple[int, ...]

    @property
    def n_columns(self) -> int:
        """Number of columns."""
        return len(self.given)

    @cached_property
    def order(self) -> list[Node]:
        """All nodes of the statements for one column, in evaluation order."""
        return reachable(self.results)

    @cached_property
    def supports(self) -> dict[Node, int]:
        """Bit mask of the columns in which each node may be nonzero; zero for shared values."""
        own = {
            node: sum(1 << j for j, given in enumerate(self.given) if given >> node.data[1] & 1)
            for node in self.order
            if node.op == "symbol" and node.data[0] == COLUMN
        }
        # A node may be nonzero in the columns in which an argument may be nonzero.
        return supports_of(self.order, own)

    @cached_property
    def counts(self) -> Counter[str]:
        """Number of operations of each kind, summed over the columns that may be nonzero."""
        counts: Counter[str] = Counter()
        for node in self.statements:
            counts[node.op] += self.supports[node].bit_count()
        return counts

    @cached_property
    def statements(self) -> list[Node]:
        """The nodes that are computed for each column."""
        return [node for node in self.order if node.args]

    def blocks(self, node: Node) -> int:
        """Return the bit mask of the blocks of columns in which a node may be nonzero."""
        support, all_of_one = self.supports[node], (1 << BLOCK) - 1
        places = range(0, self.n_columns, BLOCK)
        return sum(1 << k for k, at in enumerate(places) if support >> at & all_of_one)

    @cached_property
    def n_times(self) -> int:
        """Number of executions of statements, summed over all blocks of columns."""
        return sum(self.blocks(node).bit_count() for node in self.statements)

    @property
    def n_results(self) -> int:
        """Total number of results of all columns."""
        return len(self.results) * self.n_columns

    def columns(self, args: Sequence[Any]) -> list[Sequence[Any]]:
        """Return the inputs of each column, extracted from the arguments of a ``map`` node."""
        n, first = self.n_inputs, self.n_shared
        return [args[first + n * j : first + n * (j + 1)] for j in range(self.n_columns)]

    @cached_property
    def inputs(self) -> list[Node]:
        """Symbols in the results: shared values, then values of a column."""
        dag = self.results[0].dag
        shared = [dag.symbol(SHARED, i) for i in range(self.n_shared)]
        return shared + [dag.symbol(COLUMN, i) for i in range(self.n_inputs)]

    def given_to(self, args: Sequence[Any]) -> list[list[Any]]:
        """Return the values of :attr:`inputs` for each column, from the arguments of the node."""
        return [[*args[: self.n_shared], *column] for column in self.columns(args)]

    def n_sensitive(self, args: Sequence[Node]) -> int:
        """Return the number of leading column inputs that are entries of ``s`` in all columns."""
        columns, n = self.columns(args), 0
        # C reads such inputs directly from the kernel argument ``s`` and copies the other inputs.
        while n < self.n_inputs and _sensitivity(columns[0][n]) == n:
            n += 1
        places = range(self.n_columns * n)
        given = (_sensitivity(value) for column in columns for value in column[:n])
        return n if all(a == b for a, b in zip(places, given, strict=True)) else 0

    def evaluate(self, values: Sequence[Any]) -> list[Any]:
        """Apply the map to numbers or arrays."""
        found: list[Any] = []
        for given in self.given_to(values):
            known: dict[Node, Any] = dict(zip(self.inputs, given, strict=True))
            for node in self.order:
                if node.op == "constant":
                    known[node] = node.value
                elif node.args:
                    known[node] = OPERATIONS[node.op].array(*(known[arg] for arg in node.args))
            found += [known[root] for root in self.results]
        return found


def _sensitivity(node: Node) -> int:
    """Return the index of a sensitivity in the kernel argument ``s``, or -1 for other nodes."""
    is_given = node.op == "symbol" and node.data[0] in (SENSITIVITY, PACKED_SENSITIVITY)
    return node.data[1] if is_given else -1


def form_map(
    dag: Dag, results: Sequence[Node], inputs: Sequence[Node], columns: Sequence[Sequence[Node]]
) -> tuple[LinearMap, tuple[Node, ...]] | None:
    """Return a map of results that are linear and homogeneous in ``inputs``, and its shared values.

    The zeros of ``columns``, to which the map will be applied, are exploited. Return None if the
    results contain an operation that cannot be converted to sums and products, such as a linear
    system whose matrix varies, or a selection of defined values: ``where(x > 0, sqrt(x), 0)``.
    """
    given = tuple(
        sum(1 << i for i, value in enumerate(column) if not value.is_zero) for column in columns
    )
    # Replace inputs that are zero in all columns, so that fewer statements remain.
    idle = {
        node: dag.zero for i, node in enumerate(inputs) if not any(bits >> i & 1 for bits in given)
    }
    products = _as_products(dag, substitute(results, idle), inputs)
    if products is None:
        return None
    results = products
    order = reachable(results)
    among = dependent(order, inputs)
    # Nodes that differ between columns; all other nodes are shared.
    varying = among - set(inputs)
    if not all(_is_linear(node, among) for node in varying):
        return None
    # A result that depends on no input is a constant, not a homogeneous linear function.
    if any(root not in varying and root not in inputs and not root.is_zero for root in results):
        return None
    own = {node: dag.symbol(COLUMN, i) for i, node in enumerate(inputs)}
    shared = {
        arg: None
        for node in order
        if node in varying
        for arg in node.args
        # Constants remain in the statements; other shared values become arguments of the map.
        if arg not in varying and arg not in own and arg.op != "constant"
    }
    own |= {node: dag.symbol(SHARED, i) for i, node in enumerate(shared)}
    body = tuple(substitute(results, own))
    return LinearMap(body, len(shared), len(inputs), given), tuple(shared)


def _is_linear(node: Node, varying: Container[Node]) -> bool:
    """Return whether an operation is linear and homogeneous in its varying arguments."""
    # A product is linear if one factor varies, a sum if all terms vary.
    times = sum(arg in varying for arg in node.args)
    return node.op in _LINEAR and (times == 1 if node.op == "mul" else times == len(node.args))


def _as_products(dag: Dag, results: Sequence[Node], inputs: Sequence[Node]) -> list[Node] | None:
    """Convert divisions by shared values and selections with shared conditions to products.

    Solutions of linear systems with shared matrices become sums of solutions for unit vectors.
    Return None if a selection may exclude an infinite or nan value, since 0 * inf would be nan.
    """
    varying = set(inputs)
    unsafe: set[Node] = set()
    made: dict[Node, Node] = {}
    inverses: dict[Node, list[tuple[Node, ...]]] = {}
    for node in reachable(results):
        if node.args and (node.op not in _FINITE or any(arg in unsafe for arg in node.args)):
            unsafe.add(node)
        if not any(arg in varying for arg in node.args):
            continue
        varying.add(node)
        args = [made.get(arg, arg) for arg in node.args]
        if node.op == "div" and node.args[1] not in varying:
            # The reciprocal is computed once for all columns.
            made[node] = args[0] * (1.0 / args[1])
        elif node.op == "select" and node.args[0] not in varying:
            if any(arg in unsafe for arg in node.args[1:]):
                return None
            # Rewrite the selection as a sum with the weights 1 and 0.
            share = dag.select(args[0], dag.one, dag.zero)
            made[node] = share * args[1] + (1.0 - share) * args[2]
        elif node.op == "result" and _has_shared_matrix(node.args[0], varying):
            (system,) = node.args
            if system not in inverses:
                inverses[system] = _for_unit_vectors(system)
            n = system.data.size
            # x = A^-1 b; the columns of A^-1 are shared by all columns of the map.
            rhs = [made.get(arg, arg) for arg in system.args[n * n : n * n + n]]
            columns = [solution[node.data] for solution in inverses[system]]
            # Results after the unknowns, such as the rank, do not depend on the right-hand side.
            made[node] = columns[0] if node.data >= n else _product(dag, columns, rhs)
        else:
            made[node] = dag.rebuild(node, tuple(args))
    return [made.get(root, root) for root in results]


def _has_shared_matrix(node: Node, varying: Container[Node]) -> bool:
    """Return whether a node is a linear system in which only the right-hand side varies."""
    if node.op != "solve":
        return False
    n = node.data.size
    return not any(arg in varying for arg in (*node.args[: n * n], *node.args[n * n + n :]))


def _for_unit_vectors(system: Node) -> list[tuple[Node, ...]]:
    """Solve a linear system with each unit vector as right-hand side."""
    dag, n = system.dag, system.data.size
    found = []
    for j in range(n):
        unit = [dag.one if i == j else dag.zero for i in range(n)]
        given = (*system.args[: n * n], *unit, *system.args[n * n + n :])
        found.append(dag.several("solve", given, system.data, n + 2))
    return found


def _product(dag: Dag, row: Sequence[Node], column: Sequence[Node]) -> Node:
    return sum((a * b for a, b in zip(row, column, strict=True)), dag.zero)


def apply_map(
    dag: Dag, linear: LinearMap, shared: Sequence[Node], columns: Sequence[Sequence[Node]]
) -> list[tuple[Node, ...]]:
    """Apply a map, and return the results of each column."""
    args = [*shared, *(value for column in columns for value in column)]
    flat = dag.several("map", args, linear, linear.n_results)
    n = len(linear.results)
    return [flat[n * j : n * (j + 1)] for j in range(linear.n_columns)]


#: Pivots count as zero below this fraction of the largest entry or of the reference.
RANK_TOLERANCE = 1e-13

#: A matrix certainly has full rank if its extreme singular values have a larger ratio.
_REGULAR = 1e-6

#: An unknown is unique if its entries in the basis of the null space are below this.
NULL_TOLERANCE = 1e-9


@dataclass(frozen=True)
class SolveShape:
    """Size of a linear system, and the requirements that its solution must meet."""

    size: int  # number of unknowns
    n_determined: int  # number of leading unknowns that must be unique
    #: Fraction of the largest entry below which a pivot counts as zero.
    tolerance: float = RANK_TOLERANCE


@dataclass(frozen=True)
class Function:
    """An external function of several arguments and results, called by generated code."""

    name: str  # name of ``int name(const double *arguments, double *results)`` in C
    n_results: int  # number of results of the function
    #: The same function in Python; arguments and results are sequences of floats.
    evaluate: Callable[[Sequence[Any]], Sequence[Any]] = field(compare=False)
    #: Function that returns the Jacobian as n_results rows of n_arguments entries.
    partials: Function | None = None


def solve_pivoted(
    matrix: Any, rhs: Any, reference: float = 0.0, shape: SolveShape | None = None
) -> tuple[Any, int, bool]:
    """Solve a dense linear system, real or complex, by Gaussian elimination with complete pivoting.

    If pivots are below the tolerance times the largest entry, the solution has minimum norm. Rows
    without a pivot are ignored, which is correct for consistent systems. ``reference`` is the
    magnitude of the terms whose sums are the entries, before cancellation. Return the solution, the
    number of accepted pivots, and whether the leading unknowns are unique.
    """
    a = np.array(matrix)
    b = np.array(rhs, dtype=np.result_type(a, rhs))
    n = len(b)
    columns = list(range(n))
    # Compare real parts only, so that complex steps select the same pivots.
    shape = shape or SolveShape(n, n)
    smallest = shape.tolerance * np.max(np.abs(a.real), initial=reference)
    rank = 0
    for k in range(n):
        # Complete pivoting determines the rank most reliably.
        place = int(np.argmax(np.abs(a[k:, k:].real)))
        row, column = k + place // (n - k), k + place % (n - k)
        # negated so that nan ends the elimination
        if not abs(a[row, column].real) > smallest:
            break
        a[[k, row]], b[[k, row]] = a[[row, k]], b[[row, k]]
        a[:, [k, column]] = a[:, [column, k]]
        columns[k], columns[column] = columns[column], columns[k]
        factors = a[k + 1 :, k] / a[k, k]
        a[k + 1 :, k:] -= np.outer(factors, a[k, k:])
        b[k + 1 :] -= factors * b[k]
        rank += 1
    # If the system is consistent, rows after the last pivot are rounding errors: ignore them.
    upper = np.triu(a[:rank, :rank])
    solution = np.zeros(n, dtype=b.dtype)
    solution[columns[:rank]] = np.linalg.solve(upper, b[:rank]) if rank else b[:0]
    if rank == n:
        return solution, rank, True
    # Basis of the null space for the minimum-norm solution: each free unknown is one in turn, and
    # the unknowns with pivots follow from U x = -A_free.
    free = np.zeros((n, n - rank), dtype=a.dtype)
    free[columns[:rank]] = -np.linalg.solve(upper, a[:rank, rank:]) if rank else a[:0, rank:]
    free[columns[rank:]] = np.eye(n - rank)
    basis, _ = np.linalg.qr(free.real)
    # A leading unknown is unique if its entries in the null space are zero.
    leading = basis[: shape.n_determined]
    is_determined = bool(np.all(np.abs(leading) <= NULL_TOLERANCE))
    # A solution orthogonal to the null space has minimum norm.
    return solution - basis @ (basis.T @ solution), rank, is_determined


def _evaluate_solve(data: SolveShape, values: Sequence[Any]) -> Sequence[Any]:
    n = data.size
    matrix = np.array(values[: n * n]).reshape(n, n)
    reference = complex(values[-1]).real
    rhs = np.array(values[n * n : n * n + n])
    sizes = np.real(np.array(values[n * n + n : -1]))
    # A size is zero if, for example, no motion violates a constraint: such a row is scaled by zero.
    scales = np.where(sizes == 0.0, 0.0, 1.0 / np.sqrt(np.where(sizes == 0.0, 1.0, sizes)))
    scales = scales if sizes.size else np.ones(n)
    # With S = diag(scales), solve S A S y = S b; x = S y. If A is singular, y has minimum norm.
    scaled = scales[:, None] * matrix * scales
    solution, rank, is_determined = solve_pivoted(scaled, scales * rhs, reference, data)
    return [*(scales * solution).tolist(), float(rank), float(is_determined)]


def _solve_regular(data: SolveShape, points: Any, found: Any) -> Any:
    """Solve all regular systems at once; return the indices of the other finite systems."""
    n = data.size
    matrices, rhs = points[:, : n * n].reshape(-1, n, n), points[:, n * n : n * n + n]
    is_finite = np.isfinite(points).all(axis=1)
    is_regular = is_finite & (points.shape[1] == n * n + n + 1)
    sizes = np.linalg.svd(matrices[is_regular], compute_uv=False)
    largest = np.maximum(sizes[:, 0], points[is_regular, -1].real)
    is_regular[is_regular] = sizes[:, -1] > _REGULAR * largest
    found[is_regular, :n] = np.linalg.solve(matrices[is_regular], rhs[is_regular, :, None])[..., 0]
    found[is_regular, n:] = n, 1.0
    return np.flatnonzero(is_finite & ~is_regular)


def _evaluate_table(table: LinearTable, values: Sequence[Any]) -> Sequence[Any]:
    x = values[0]
    place = complex(x).real
    if place <= table.x[0]:
        return [table.y[0], 0.0]
    if place >= table.x[-1]:
        return [table.y[-1], 0.0]
    # As in C, nan selects the first interval; the result is nan.
    k = 0 if math.isnan(place) else bisect.bisect_right(table.x, place) - 1
    slope = (table.y[k + 1] - table.y[k]) / (table.x[k + 1] - table.x[k])
    return [table.y[k] + slope * (x - table.x[k]), slope]


def _evaluate_sines(_: int, angles: Sequence[Any]) -> Sequence[Any]:
    if all(isinstance(angle, float) for angle in angles):
        return [*map(OPERATIONS["sin"].real, angles), *map(OPERATIONS["cos"].real, angles)]
    return [*map(np.sin, angles), *map(np.cos, angles)]


def solve(
    dag: Dag,
    matrix: Sequence[Sequence[Node]],
    rhs: Sequence[Node],
    reference: Node | None = None,
    shape: SolveShape | None = None,
    sizes: Sequence[Node] = (),
) -> tuple[Node, ...]:
    """Form the solution of a small dense linear system, its rank, and 1 if it is accepted, else 0.

    ``reference`` is the magnitude of the terms in the entries before cancellation; it scales the
    tolerance of the rank. ``shape`` has the number of leading unknowns that must be unique, by
    default all; others may be redundant. If ``sizes`` has a scale for each diagonal entry, rows and
    columns are divided by the square roots of these scales before pivoting.
    """
    n = len(rhs)
    # This layout is assumed by sizes_of, is_symmetric, the derivatives and the C statements.
    args = [*(entry for row in matrix for entry in row), *rhs, *sizes, reference or dag.zero]
    shape = shape or SolveShape(n, n)
    return dag.several("solve", args, shape, n + 2)


def sizes_of(node: Node) -> tuple[Node, ...]:
    """Return the scales of the diagonal entries of a linear system, if any."""
    n = node.data.size
    return node.args[n * n + n : -1]


def is_symmetric(node: Node) -> bool:
    """Return whether the matrix of a linear system is structurally symmetric."""
    n = node.data.size
    return all(node.args[i * n + j] is node.args[j * n + i] for i in range(n) for j in range(i))


def table(dag: Dag, data: LinearTable, x: Node) -> tuple[Node, Node]:
    """Form the value and the slope of a table at ``x``."""
    if x.value is not None:
        value, slope = map(dag.constant, _evaluate_table(data, [x.value]))
    else:
        value, slope = dag.several("table", [x], data, 2)
    return value, slope


def call(dag: Dag, function: Function, args: Sequence[Node]) -> tuple[Node, ...]:
    """Form a call of an external function, and return its results."""
    return dag.several("call", args, function, function.n_results)


def sines(dag: Dag, angles: Sequence[Node]) -> tuple[Node, ...]:
    """Form the sines, then the cosines, of several angles."""
    return dag.several("sines", angles, len(angles), 2 * len(angles))


def results(node: Node, n_results: int) -> tuple[Node, ...]:
    """Return the first ``n_results`` results of a node with several results."""
    return node.dag.several(node.op, node.args, node.data, n_results)


@dataclass(frozen=True)
class Several:
    """An operation with several results."""

    #: Function from (data, argument values) to result values.
    evaluate: Callable[[Any, Sequence[Any]], Sequence[Any]]
    n_results: Callable[[Any], int]  # number of results, a function of data


def _pointwise(
    function: Callable[[Any, Sequence[Any]], Sequence[Any]],
    n_results: Callable[[Any], int],
    together: Callable[[Any, Any, Any], Iterable[int]] | None = None,
) -> Several:
    """Extend a function of numbers to arrays of n points; undefined results are nan.

    ``together`` solves several points at once and returns the indices of the remaining points.
    """

    def evaluate(data: Any, values: Sequence[Any]) -> Sequence[Any]:
        if not any(np.ndim(value) for value in values):
            return function(data, values)
        points = np.array(np.broadcast_arrays(*values)).T
        found = np.full((len(points), n_results(data)), math.nan, np.result_type(points, float))
        for i in together(data, points, found) if together else range(len(points)):
            with contextlib.suppress(ArithmeticError, ValueError):
                found[i] = function(data, points[i].tolist())
        return list(found.T)

    return Several(evaluate, n_results)


SEVERAL: dict[str, Several] = {
    "solve": _pointwise(_evaluate_solve, lambda shape: int(shape.size) + 2, _solve_regular),
    "table": _pointwise(_evaluate_table, lambda _: 2),
    "lookup": Several(lambda data, values: data.evaluate(values), lambda d: len(d.results)),
    "call": _pointwise(lambda f, values: f.evaluate(values), lambda f: int(f.n_results)),
    "sines": Several(_evaluate_sines, lambda n: 2 * int(n)),
    "map": Several(LinearMap.evaluate, lambda linear: int(linear.n_results)),
}
