"""Nodes with several results: ``solve``, ``table``, ``lookup``, ``call``, ``map``, ``sines``.

Each has a row in :data:`SEVERAL` with its evaluation; its derivatives stand in
:mod:`cotree.dag.derivative`, its statements in :mod:`cotree.codegen.node_statements`. The results
are read with ``result`` nodes.
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.dag.linear_map import LinearMap
from cotree.dag.operations import OPERATIONS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree.dag.nodes import Dag, Node

#: Pivots below this fraction of the largest entry, or of the reference given with the matrix, count
#: as zero: a few hundred roundings.
RANK_TOLERANCE = 1e-13

#: Entries of the null space below this are zero: an unknown that it leaves alone is determined.
NULL_TOLERANCE = 1e-9


@dataclass(frozen=True)
class SolveShape:
    """A linear system: its size, and the requirements on its solution.

    Attributes
    ----------
    size : int
        Number of unknowns.
    n_determined : int
        Number of leading unknowns that must have a unique solution.
    tolerance : float
        Share of the largest entry below which a pivot counts as zero.
    """

    size: int
    n_determined: int
    tolerance: float = RANK_TOLERANCE


@dataclass(frozen=True)
class Table:
    """A piecewise linear function, held constant outside its range.

    Attributes
    ----------
    x : tuple of float
        Ascending arguments, at least two.
    y : tuple of float
        Values at ``x``.
    """

    x: tuple[float, ...]
    y: tuple[float, ...]

    function = "cotree_table"

    @property
    def arrays(self) -> dict[str, tuple[float, ...]]:
        """Numbers that C reads, by a name for each row."""
        return {"x": self.x, "y": self.y}


@dataclass(frozen=True)
class Function:
    """An external function of several arguments and results, called by the generated code.

    Attributes
    ----------
    name : str
        C name: ``int name(const double *arguments, double *results)``.
    n_results : int
        How many results it has.
    evaluate : callable
        The same function in Python: sequence of floats to sequence of floats.
    partials : Function or None
        Gives the partial derivatives, row by row (n_results rows of n_arguments).
    """

    name: str
    n_results: int
    evaluate: Callable[[Sequence[Any]], Sequence[Any]] = field(compare=False)
    partials: Function | None = None


def solve_pivoted(
    matrix: Any, rhs: Any, reference: float = 0.0, shape: SolveShape | None = None
) -> tuple[Any, int, bool]:
    """Solve a dense linear system by Gaussian elimination with complete pivoting.

    Where pivots fall below the tolerance times the largest entry, the solution of least norm
    is taken; a row without a pivot is left out, which is right where the system is consistent.

    Parameters
    ----------
    matrix : array_like, shape (n, n)
        The coefficients, real or complex.
    rhs : array_like, shape (n,)
        The right-hand side.
    reference : float
        Size of the terms of the entries, where these may be the remainder of a cancellation.
    shape : SolveShape, optional
        Requirements on the solution; where absent, all unknowns must be unique.

    Returns
    -------
    solution : ndarray, shape (n,)
        The unknowns.
    rank : int
        Number of pivots accepted.
    is_determined : bool
        Whether the leading unknowns have a unique solution.
    """
    a = np.array(matrix)
    b = np.array(rhs, dtype=np.result_type(a, rhs))
    n = len(b)
    columns = list(range(n))
    # Sizes are judged by real parts alone, so that a complex step takes the same pivots.
    shape = shape or SolveShape(n, n)
    smallest = shape.tolerance * np.max(np.abs(a.real), initial=reference)
    rank = 0
    for k in range(n):
        # Complete pivoting: the order of the pivots decides the rank most reliably.
        place = int(np.argmax(np.abs(a[k:, k:].real)))
        row, column = k + place // (n - k), k + place % (n - k)
        # Written so that nan ends the elimination.
        if not abs(a[row, column].real) > smallest:
            break
        a[[k, row]], b[[k, row]] = a[[row, k]], b[[row, k]]
        a[:, [k, column]] = a[:, [column, k]]
        columns[k], columns[column] = columns[column], columns[k]
        factors = a[k + 1 :, k] / a[k, k]
        a[k + 1 :, k:] -= np.outer(factors, a[k, k:])
        b[k + 1 :] -= factors * b[k]
        rank += 1
    # Rows behind the last pivot are rounding, if the system is consistent, and are left out.
    upper = np.triu(a[:rank, :rank])
    solution = np.zeros(n, dtype=b.dtype)
    solution[columns[:rank]] = np.linalg.solve(upper, b[:rank]) if rank else b[:0]
    if rank == n:
        return solution, rank, True
    # The null space, by which the solution of least norm is found.
    free = np.zeros((n, n - rank), dtype=a.dtype)
    # Each free unknown is one in turn, and those with pivots follow from U x = -A_free.
    free[columns[:rank]] = -np.linalg.solve(upper, a[:rank, rank:]) if rank else a[:0, rank:]
    free[columns[rank:]] = np.eye(n - rank)
    basis, _ = np.linalg.qr(free.real)
    # A leading unknown is unique if no vector of the null space moves it.
    leading = basis[: shape.n_determined]
    is_determined = bool(np.all(np.abs(leading) <= NULL_TOLERANCE))
    # Without its part in the null space a solution has the least norm.
    return solution - basis @ (basis.T @ solution), rank, is_determined


def _evaluate_solve(data: SolveShape, values: Sequence[Any]) -> Sequence[Any]:
    n = data.size
    matrix = np.array(values[: n * n]).reshape(n, n)
    reference = complex(values[-1]).real
    rhs = np.array(values[n * n : n * n + n])
    sizes = np.real(np.array(values[n * n + n : -1]))
    # A row of zeros, as of a constraint that nothing moves in one position, stays a row of zeros.
    scales = np.where(sizes == 0.0, 0.0, 1.0 / np.sqrt(np.where(sizes == 0.0, 1.0, sizes)))
    scales = scales if sizes.size else np.ones(n)
    # With S = diag(scales) the system S A S y = S b is solved, and x = S y. Symmetry is kept, and
    # the norm that is least in a singular system is that of y.
    scaled = scales[:, None] * matrix * scales
    solution, rank, is_determined = solve_pivoted(scaled, scales * rhs, reference, data)
    return [*(scales * solution).tolist(), float(rank), float(is_determined)]


def _evaluate_table(table: Table, values: Sequence[Any]) -> Sequence[Any]:
    x = values[0]
    # An array of arguments is looked up one by one.
    if np.ndim(x):
        rows: list[Any] = np.array([_evaluate_table(table, [float(at)]) for at in x]).T.tolist()
        return rows
    place = complex(x).real
    if place <= table.x[0]:
        return [table.y[0], 0.0]
    if place >= table.x[-1]:
        return [table.y[-1], 0.0]
    # Like C, of nan take the first piece, which then gives nan.
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
    """Form the solution of a small dense linear system, and its rank.

    Parameters
    ----------
    dag : Dag
        The arena.
    matrix : sequence of rows of Node
        Coefficients, n by n.
    rhs : sequence of Node
        Right-hand side.
    reference : Node, optional
        Size of what the entries were made from, for the rank decision.
    shape : SolveShape, optional
        Number of leading unknowns that must be unique, or the solution is refused; the others
        may be redundant. All of them, where absent.
    sizes : sequence of Node
        What the diagonal of each row is compared with, if rows and columns are to be divided by
        the roots of these before anything is decided by the size of an entry.

    Returns
    -------
    tuple of Node
        The n unknowns, then the rank found at run time, and one where the solution is accepted.
    """
    n = len(rhs)
    # This layout is what sizes_of, is_symmetric, the derivatives and the statements in C rely on.
    args = [*(entry for row in matrix for entry in row), *rhs, *sizes, reference or dag.zero]
    shape = shape or SolveShape(n, n)
    return dag.several("solve", args, shape, n + 2)


def sizes_of(node: Node) -> tuple[Node, ...]:
    """Return the sizes that the diagonal of a linear system is compared with, if any."""
    n = node.data.size
    return node.args[n * n + n : -1]


def is_symmetric(node: Node) -> bool:
    """Tell whether the matrix of a linear system is symmetric whatever its values are."""
    n = node.data.size
    return all(node.args[i * n + j] is node.args[j * n + i] for i in range(n) for j in range(i))


def table(dag: Dag, data: Table, x: Node) -> tuple[Node, Node]:
    """Form the value and the slope of a table at ``x``.

    Parameters
    ----------
    dag : Dag
        The arena.
    data : Table
        Points and interpolation.
    x : Node
        Where to look it up.
    """
    if x.value is not None:
        value, slope = map(dag.constant, _evaluate_table(data, [x.value]))
    else:
        value, slope = dag.several("table", [x], data, 2)
    return value, slope


def call(dag: Dag, function: Function, args: Sequence[Node]) -> tuple[Node, ...]:
    """Form the results of an external function.

    Parameters
    ----------
    dag : Dag
        The arena.
    function : Function
        The function.
    args : sequence of Node
        Its arguments.
    """
    return dag.several("call", args, function, function.n_results)


def sines(dag: Dag, angles: Sequence[Node]) -> tuple[Node, ...]:
    """Form the sines, then the cosines, of several angles."""
    return dag.several("sines", angles, len(angles), 2 * len(angles))


def results(node: Node, n_results: int) -> tuple[Node, ...]:
    """Read the first ``n_results`` results of a node that has several."""
    return node.dag.several(node.op, node.args, node.data, n_results)


@dataclass(frozen=True)
class Several:
    """An operation with several results.

    Attributes
    ----------
    evaluate : callable
        (data, argument values) to result values.
    n_results : callable
        data to number of results.
    """

    evaluate: Callable[[Any, Sequence[Any]], Sequence[Any]]
    n_results: Callable[[Any], int]


SEVERAL: dict[str, Several] = {
    "solve": Several(_evaluate_solve, lambda shape: int(shape.size) + 2),
    "table": Several(_evaluate_table, lambda _: 2),
    "lookup": Several(lambda data, values: data.evaluate(values), lambda d: len(d.results)),
    "call": Several(lambda function, values: function.evaluate(values), lambda f: int(f.n_results)),
    "sines": Several(_evaluate_sines, lambda n: 2 * int(n)),
    "map": Several(LinearMap.evaluate, lambda linear: int(linear.n_results)),
}
