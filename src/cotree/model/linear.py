"""Linear systems: inverted where they are small, factorised as sparse ones, or of any rank.

In: the derivatives of equations, full or in SciPy's compressed form. Out: what solves for a step of
Newton's method, the scale that rounding gives to each unknown, and the unknowns that a singular
matrix leaves free; of gradients with redundant rows, least steps and independent columns.
"""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cotree.tolerances import LIMITS, RANK, TINY

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from cotree.model.arrays import Array


#: A full matrix, or one of SciPy's compressed ones.
Matrix = Any

#: Rounding of the equations moves unknowns by this share of their scale.
ROUNDING = 4 * float(np.finfo(np.float64).eps)

#: Steps below this share of an unknown that no longer halve can only be rounding, since Newton's
#: method squares its errors; or, where unknowns are zero but for rounding, this share of scales.
SMALL = LIMITS.small_correction
_STALLED = 1e4 * float(np.finfo(np.float64).eps)

#: Residuals below this share of their terms are what these leave of each other.
_MET = 1e-3

#: Up to so many rows, and from this share of nonzeros on, full matrices cost less.
_FEW, _SHARE = 60, 0.1

#: Random signs that tell how much rounding of each equation moves the unknowns of a large system.
_PROBES = 16

#: Rounds of inverse iteration, and how far above rounding a singular value is that they find large.
_ROUNDS, _CLEARLY = 4, 1e3

#: Rounding of singular values, in units in the last place of the largest; more in larger matrices.
_WEAK = 10

#: Entries below this share of the largest are not involved in a singular direction.
_INVOLVED = 0.1


def is_sparse(n: int, n_nonzeros: int) -> bool:
    """Whether a matrix with so many rows and nonzeros is better factorised as a sparse one."""
    return n > _FEW and n_nonzeros < _SHARE * n * n


class Linear(NamedTuple):
    """The equations of a point, made linear; a tuple, since one is made at each Newton step."""

    #: ``solve(b)`` solves with the derivatives by the unknowns, for one or several columns.
    solve: Callable[[Array], Array]
    #: Of each unknown: its own size and what it would change by if each term of the equations
    #: changed by its own size. Rounding moves it by this times that of a number.
    scale: Array
    #: Of the terms of each equation; infinite where a step alone tells that it has converged.
    sizes: Array | float = math.inf

    def measured(self, step: Array) -> tuple[Array, float]:
        """Return the sizes that a step is divided by, and its largest entry then, at most 1."""
        size: Array = np.maximum(self.scale, TINY)
        length = longest(step / size)
        if length <= 1.0:
            return size, length
        size = np.maximum(size, np.abs(step))
        return size, longest(step / size)

    def is_stalled(self, z: Array, step: Array) -> bool:
        """Whether a step that does not become shorter may be taken for rounding."""
        floor = np.maximum(SMALL * np.abs(z), _STALLED * self.scale)
        return bool(np.all(np.abs(step) <= floor))

    def is_met(self, g: Array) -> bool:
        """Whether residuals are what is left of larger terms.

        Where the matrix is nearly singular scales are so large that any step looks short.
        """
        return bool((np.abs(g) <= _MET * self.sizes + TINY).all())


def longest(step: Array) -> float:
    """Return the size of the largest entry; nan where an entry is nan.

    ``numpy.max`` gives the same, but its call takes longer.
    """
    return float(np.maximum.reduce(np.abs(step), initial=0.0))


def linearise(slope: Matrix, y: Array) -> Linear:
    """Factorise the last columns of the Jacobian at y, which holds fixed values, then unknowns.

    Raises LinAlgError if the matrix is singular or not finite.
    """
    n = slope.shape[0]
    # The sum of the absolute terms of each equation, of which rounding is a share.
    sizes: Array = abs(slope).dot(np.abs(y))
    # A sum is infinite or nan where one of its terms is, a product with zero, too.
    if not math.isfinite(np.add.reduce(sizes)):
        raise np.linalg.LinAlgError("not finite")
    if isinstance(slope, np.ndarray):
        # Full systems are small, and the inverse also bounds what rounding of each equation does.
        inverse = _inverse(slope[:, -n:])
        return Linear(inverse.dot, np.abs(y[-n:]) + np.abs(inverse).dot(sizes), sizes)
    solve = _factorised(slope[:, -n:])
    # The inverse is full. Sums with random signs come within a small factor of those of sizes.
    found = np.abs(solve(_signs(n) * sizes[:, None])).max(axis=1)
    if not math.isfinite(np.add.reduce(found)):
        raise np.linalg.LinAlgError("singular")
    return Linear(solve, np.abs(y[-n:]) + found, sizes)


def solve_entries(rows: Any, columns: Any, values: Array, b: Array) -> Array:
    """Solve a square system whose matrix is the sum of entries at ``rows`` and ``columns``.

    Raises LinAlgError if the matrix is singular or not finite.
    """
    from scipy.sparse import coo_matrix

    matrix = coo_matrix((values, (rows, columns)), shape=(len(b), len(b)))
    if not is_sparse(len(b), len(values)):
        return solve_with(matrix.toarray(), b)
    if not np.all(np.isfinite(values)):
        raise np.linalg.LinAlgError("not finite")
    return solve_with(matrix, b)


def solve_with(matrix: Matrix, b: Array) -> Array:
    """Solve with a square matrix, full or sparse."""
    if isinstance(matrix, np.ndarray):
        return np.asarray(np.linalg.solve(matrix, b), dtype=np.float64)
    return _factorised(matrix)(b)


def _inverse(matrix: Array) -> Array:
    solver, unit = _solver(len(matrix))
    _, _, inverse, status = solver(matrix, unit)
    if status != 0 or (
        not math.isfinite(np.vdot(inverse, inverse)) and not np.all(np.isfinite(inverse))
    ):
        raise np.linalg.LinAlgError("singular")
    return inverse


@functools.cache
def _solver(n: int) -> tuple[Callable[..., tuple[Array, Array, Array, int]], Array]:
    """Return LAPACK's solver, called four times faster than through NumPy, and a unit matrix."""
    from scipy.linalg.lapack import dgesv

    return dgesv, np.eye(n, order="F")


@functools.lru_cache(maxsize=8)
def _signs(n: int) -> Array:
    """Return random signs, the same at every call, shape (n, number of probes)."""
    return np.random.default_rng(0).choice([-1.0, 1.0], (n, _PROBES))


def _factorised(matrix: Matrix) -> Callable[..., Array]:
    """Factorise a sparse matrix; return its solver, which takes ``"T"`` for the transpose."""
    from scipy.sparse import diags
    from scipy.sparse.linalg import splu

    # Pivots are the largest of their columns: of rows in other units they would be the worst.
    size = abs(matrix.tocsr()).max(axis=1).toarray().ravel()
    scale = 1.0 / np.where(size > 0.0, size, 1.0)
    try:
        factors = splu((diags(scale) @ matrix).tocsc())
    except RuntimeError:
        raise np.linalg.LinAlgError("singular") from None

    def solve(b: Array, way: str = "N") -> Array:
        # D A is factorised, D being the scale of rows: A^-1 = (D A)^-1 D and A^-T = D (D A)^-T.
        if way == "T":
            return np.asarray((factors.solve(b, way).T * scale).T)
        return np.asarray(factors.solve((b.T * scale).T))

    return solve


def least_step(rows: Array, target: Array, whole: Array) -> Array:
    """Solve rows @ step = target by the least step, in the sense of least squares.

    ``rows``, (n_rows, n), are columns of a gradient, some of them redundant, and ``whole``,
    (n_rows, n_all), all of it: what is rounding beside that moves nothing, even if nothing else is
    free.
    """
    if not rows.size:
        return np.zeros((rows.shape[1], *target.shape[1:]))
    left, sizes, right = np.linalg.svd(rows, full_matrices=False)
    # A gradient of which no column is left out has the singular values that were just found.
    largest = sizes[0] if rows.shape == whole.shape else np.linalg.norm(whole, 2)
    kept = sizes > RANK * max(largest, sizes[0])
    along = (left[:, kept].T @ target).T / sizes[kept]
    # The pseudo-inverse without singular values that are nothing but rounding.
    return np.asarray(right[kept].T @ along.T, dtype=np.float64)


def independent_columns(rows: Array) -> list[int]:
    """List the free columns, chosen so that the others follow from them best."""
    if not rows.size:
        return list(range(rows.shape[1]))
    from scipy.linalg import qr

    # Pivoting takes those columns first that are best solved for; the rest may be chosen.
    triangle, order = qr(rows, mode="r", pivoting=True)
    diagonal = np.abs(np.diag(triangle))
    rank = int(np.count_nonzero(diagonal > RANK * diagonal[0]))
    return sorted(order[rank:].tolist())


def singular_direction(slopes: Iterable[Matrix]) -> tuple[int, ...]:
    """Return the unknowns that square matrices leave undetermined; none as soon as one is regular.

    Rows and columns are scaled first, so the answer is free of units.
    """
    involved: tuple[int, ...] = ()
    for slope in slopes:
        if not isinstance(slope, np.ndarray):
            if _is_clearly_regular(slope):
                return ()
            slope = slope.toarray()
        involved = _weak_unknowns(slope)
        if not involved:
            break
    return involved


def _is_clearly_regular(slope: Matrix) -> bool:
    """Whether no singular value of a sparse matrix, scaled, is anywhere near rounding."""
    matrix = slope.tocoo(copy=True)
    if not np.all(np.isfinite(matrix.data)):
        return False
    for _ in range(3):
        # Each round brings the largest entry of every row, then of every column, to one.
        for place in (matrix.row, matrix.col):
            size = np.zeros(len(slope.indptr) - 1)
            np.maximum.at(size, place, np.abs(matrix.data))
            matrix.data /= np.where(size > 0.0, size, 1.0)[place]
    try:
        solve = _factorised(matrix)
    except np.linalg.LinAlgError:
        return False
    # The largest singular value is at most the root of the largest sums of a column and of a row.
    largest = math.sqrt(abs(matrix).sum(axis=0).max() * abs(matrix).sum(axis=1).max())
    x = np.random.default_rng(0).standard_normal(matrix.shape[0])
    growth = math.inf
    for _ in range(_ROUNDS):
        # Inverse iteration with A A^T: x grows by the inverse square of the least singular value.
        x = solve(solve(x / np.linalg.norm(x)), "T")
        growth = float(np.linalg.norm(x))
        if not math.isfinite(growth):
            return False
    return bool(growth**-0.5 > _CLEARLY * _rounding(len(x)) * largest)


def _rounding(n: int) -> float:
    """Return the rounding of singular values of a matrix of n rows, as a share of the largest."""
    return max(_WEAK, n) * float(np.finfo(float).eps)


def _weak_unknowns(slope: Array) -> tuple[int, ...]:
    if not np.all(np.isfinite(slope)):
        return ()
    matrix = slope.copy()
    for _ in range(3):
        for axis in (1, 0):
            size = np.max(np.abs(matrix), axis=axis, keepdims=True)
            matrix /= np.where(size > 0.0, size, 1.0)
    _, values, directions = np.linalg.svd(matrix)
    weak = directions[values <= _rounding(len(matrix)) * max(float(values[0]), 1e-300)]
    return tuple(
        int(i) for i in np.flatnonzero(np.max(np.abs(weak), axis=0, initial=0.0) > _INVOLVED)
    )
