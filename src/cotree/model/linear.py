"""Linear systems of Newton steps: dense inverses, sparse factorisations and least squares."""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cotree.tolerances import LIMITS, RANK, TINY

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from cotree.model.arrays import Array


#: A dense matrix or a compressed SciPy matrix.
Matrix = Any

#: Relative change of an unknown that counts as a rounding error.
ROUNDING = 4 * float(np.finfo(np.float64).eps)

#: Newton's method converges quadratically: a step that no longer halves is a rounding error if it
#: is below the first fraction of its unknown. For an unknown that is zero up to rounding, the limit
#: is the second fraction times :attr:`Linear.scale`.
SMALL = LIMITS.small_correction
_STALLED = 1e4 * float(np.finfo(np.float64).eps)

#: Residuals below this fraction of the summed magnitudes of their terms are cancellation errors.
_MET = 1e-3

#: Dense factorisation is faster up to this number of rows, or above this fraction of nonzeros.
_FEW, _SHARE = 60, 0.1

#: Number of random sign vectors that estimate the rounding errors of large systems.
_PROBES = 16

#: Number of inverse iterations, and minimum ratio of a nonzero singular value to its error.
_ROUNDS, _CLEARLY = 4, 1e3

#: Minimum rounding error of singular values, in machine precisions times the largest one.
_WEAK = 10

#: Unknowns are involved in a unit null vector if their component exceeds this value.
_INVOLVED = 0.1


def is_sparse(n: int, n_nonzeros: int) -> bool:
    """Return whether sparse factorisation is faster than dense, for an n-by-n matrix."""
    return n > _FEW and n_nonzeros < _SHARE * n * n


class Linear(NamedTuple):
    """The linear equations of one Newton step; a tuple, because it is created quickly."""

    #: ``solve(b)`` solves with the Jacobian of the unknowns; b may be a matrix.
    solve: Callable[[Array], Array]
    #: Scale of each unknown: its magnitude plus its change if each term of the equations changes by
    #: 100 %. Its rounding error is about this scale times the machine precision.
    scale: Array
    #: Summed magnitudes of each equation's terms; infinite if only the steps decide on convergence.
    sizes: Array | float = math.inf

    def measured(self, step: Array) -> tuple[Array, float]:
        """Return a scale for each entry of a step, and the largest scaled entry, at most 1."""
        size: Array = np.maximum(self.scale, TINY)
        length = longest(step / size)
        if length <= 1.0:
            return size, length
        size = np.maximum(size, np.abs(step))
        return size, longest(step / size)

    def is_stalled(self, z: Array, step: Array) -> bool:
        """Return whether a step that no longer shrinks is a rounding error."""
        floor = np.maximum(SMALL * np.abs(z), _STALLED * self.scale)
        return bool(np.all(np.abs(step) <= floor))

    def is_met(self, g: Array) -> bool:
        """Return whether residuals are cancellation errors of larger terms.

        A short step does not prove convergence: if the matrix is nearly singular, the scales are
        large.
        """
        return bool((np.abs(g) <= _MET * self.sizes + TINY).all())


def longest(step: Array) -> float:
    """Return the largest magnitude in a step, or nan; faster than ``numpy.max``."""
    return float(np.maximum.reduce(np.abs(step), initial=0.0))


def linearise(slope: Matrix, y: Array) -> Linear:
    """Factorise the last columns of the Jacobian at y; raise LinAlgError if they are singular."""
    n = slope.shape[0]
    # The rounding error of an equation is proportional to the summed magnitudes of its terms.
    sizes: Array = abs(slope).dot(np.abs(y))
    # Products with nan or infinity are never finite, even with zero.
    if not math.isfinite(np.add.reduce(sizes)):
        raise np.linalg.LinAlgError("not finite")
    if isinstance(slope, np.ndarray):
        # Dense systems are small, and the inverse also bounds the effect of rounding errors.
        inverse = _inverse(slope[:, -n:])
        return Linear(inverse.dot, np.abs(y[-n:]) + np.abs(inverse).dot(sizes), sizes)
    solve = _factorised(slope[:, -n:])
    # The inverse would be dense; solutions for random signs estimate its absolute row sums.
    found = np.abs(solve(_signs(n) * sizes[:, None])).max(axis=1)
    if not math.isfinite(np.add.reduce(found)):
        raise np.linalg.LinAlgError("singular")
    return Linear(solve, np.abs(y[-n:]) + found, sizes)


def solve_entries(rows: Any, columns: Any, values: Array, b: Array) -> Array:
    """Solve a system whose entries are sums of ``values``; raise LinAlgError if it is singular."""
    from scipy.sparse import coo_matrix

    matrix = coo_matrix((values, (rows, columns)), shape=(len(b), len(b)))
    if not is_sparse(len(b), len(values)):
        return solve_with(matrix.toarray(), b)
    if not np.all(np.isfinite(values)):
        raise np.linalg.LinAlgError("not finite")
    return solve_with(matrix, b)


def solve_with(matrix: Matrix, b: Array) -> Array:
    """Solve a linear system with a full or sparse square matrix."""
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
    """Return LAPACK's solver, four times faster than NumPy's, and an n-by-n unit matrix."""
    from scipy.linalg.lapack import dgesv

    return dgesv, np.eye(n, order="F")


@functools.lru_cache(maxsize=8)
def _signs(n: int) -> Array:
    """Return random signs, shape (n, number of probes); every call returns the same signs."""
    return np.random.default_rng(0).choice([-1.0, 1.0], (n, _PROBES))


def _factorised(matrix: Matrix) -> Callable[..., Array]:
    """Factorise a sparse matrix; return its solver, for which ``"T"`` selects the transpose."""
    from scipy.sparse import diags
    from scipy.sparse.linalg import splu

    # Rows are scaled, because they may have different units and pivots are chosen within columns.
    size = abs(matrix.tocsr()).max(axis=1).toarray().ravel()
    scale = 1.0 / np.where(size > 0.0, size, 1.0)
    try:
        factors = splu((diags(scale) @ matrix).tocsc())
    except RuntimeError:
        raise np.linalg.LinAlgError("singular") from None

    def solve(b: Array, way: str = "N") -> Array:
        # The factors are those of D A with row scales D: A^-1 = (D A)^-1 D, A^-T = D (D A)^-T.
        if way == "T":
            return np.asarray((factors.solve(b, way).T * scale).T)
        return np.asarray(factors.solve((b.T * scale).T))

    return solve


def least_step(rows: Array, target: Array, whole: Array) -> Array:
    """Solve rows @ x = target with minimum norm; rounding errors of ``whole`` count as zero."""
    if not rows.size:
        return np.zeros((rows.shape[1], *target.shape[1:]))
    left, sizes, right = np.linalg.svd(rows, full_matrices=False)
    # If ``rows`` has all columns, ``whole`` has the same largest singular value.
    largest = sizes[0] if rows.shape == whole.shape else np.linalg.norm(whole, 2)
    kept = sizes > RANK * max(largest, sizes[0])
    along = (left[:, kept].T @ target).T / sizes[kept]
    return np.asarray(right[kept].T @ along.T, dtype=np.float64)


def independent_columns(rows: Array) -> list[int]:
    """Return the columns to choose as independent, such that the others are well conditioned."""
    if not rows.size:
        return list(range(rows.shape[1]))
    from scipy.linalg import qr

    # Pivoting takes the best conditioned columns first: these are dependent, the last independent.
    triangle, order = qr(rows, mode="r", pivoting=True)
    diagonal = np.abs(np.diag(triangle))
    rank = int(np.count_nonzero(diagonal > RANK * diagonal[0]))
    return sorted(order[rank:].tolist())


def singular_direction(slopes: Iterable[Matrix]) -> tuple[int, ...]:
    """Return the unknowns that every matrix, with scaled rows and columns, leaves undetermined."""
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
    """Return whether all singular values of the scaled matrix far exceed rounding errors."""
    matrix = slope.tocoo(copy=True)
    if not np.all(np.isfinite(matrix.data)):
        return False
    for _ in range(3):
        # Scale the largest entry of every row, then of every column, to one.
        for place in (matrix.row, matrix.col):
            size = np.zeros(len(slope.indptr) - 1)
            np.maximum.at(size, place, np.abs(matrix.data))
            matrix.data /= np.where(size > 0.0, size, 1.0)[place]
    try:
        solve = _factorised(matrix)
    except np.linalg.LinAlgError:
        return False
    # sqrt(largest row sum times largest column sum) bounds the largest singular value.
    largest = math.sqrt(abs(matrix).sum(axis=0).max() * abs(matrix).sum(axis=1).max())
    x = np.random.default_rng(0).standard_normal(matrix.shape[0])
    growth = math.inf
    for _ in range(_ROUNDS):
        # Inverse iteration with A A^T: the growth of x is 1 / (least singular value)^2.
        x = solve(solve(x / np.linalg.norm(x)), "T")
        growth = float(np.linalg.norm(x))
        if not math.isfinite(growth):
            return False
    return bool(growth**-0.5 > _CLEARLY * _rounding(len(x)) * largest)


def _rounding(n: int) -> float:
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
