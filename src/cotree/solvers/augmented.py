"""Jacobian and tolerances of the augmented vector [y, s_1, ..., s_np].

The Jacobian of z has the state Jacobian J in each diagonal block, and d(J s_p + f_p)/dy below the
first. Those blocks are second derivatives, which no kernel computes; ``n_states`` differences of
the right-hand side are accurate enough for an iteration. Without them Newton's method needs one
iteration more, since its error is nilpotent: SciPy's BDF and Radau, which allow 4 and 6 iterations,
then take up to a hundred times as many steps on Robertson's problem, and sensitivities outside the
error test have large errors (IDA, 20 %).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy.typing as npt

    from cotree.methods import Method
    from cotree.solvers.problem import Problem
    from cotree.solvers.result import FloatArray


#: Augmented systems longer than this are factored block by block, not as one dense matrix.
DENSE_LIMIT = 100

#: SciPy's limit; below it the error test measures rounding only.
RTOL_FLOOR = 100 * float(np.finfo(np.float64).eps)

#: Absolute tolerance of sensitivities outside the error test. Infinite weights would turn norms of
#: LSODA and SUNDIALS into 0 * inf; the square of this number is finite.
UNTESTED = 1e100

_ROOT_EPS = float(np.sqrt(np.finfo(np.float64).eps))


def diagonal_blocks(matrix: FloatArray, n_states: int) -> FloatArray:
    """Return a writeable view, (m, n_states, n_states), of a matrix's diagonal blocks."""
    m = matrix.shape[0] // n_states
    # The repeated index selects equal rows and columns of blocks.
    blocks: FloatArray = np.einsum("iaib->iab", matrix.reshape(m, n_states, m, n_states))
    return blocks


def assemble_dense(first: FloatArray, n_states: int) -> FloatArray:
    """Return the dense Jacobian of z from its first columns.

    ``first``, (size, n_states), holds the derivatives of z' by the states: J, then d(J s_p +
    f_p)/dy of each parameter. J stands again in the other diagonal blocks.
    """
    size = first.shape[0]
    matrix = np.zeros((size, size))
    diagonal_blocks(matrix, n_states)[...] = first[:n_states]
    matrix[:, :n_states] = first
    return matrix


def assemble_sparse(first: FloatArray, n_states: int) -> Any:
    """Return the same matrix as ``assemble_dense`` in SciPy's CSC form."""
    from scipy.sparse import csc_matrix

    size = first.shape[0]
    jacobian = first[:n_states]
    n_blocks = size // n_states - 1
    # CSC form: n_states full columns, then columns that contain a column of J in their own block.
    block_rows = np.arange(n_states, size).reshape(n_blocks, 1, n_states)
    rows = np.broadcast_to(block_rows, (n_blocks, n_states, n_states))
    data = np.broadcast_to(jacobian.T, (n_blocks, n_states, n_states))
    lengths = np.repeat([size, n_states], [n_states, size - n_states])
    return csc_matrix(
        (
            np.concatenate([first.T.ravel(), data.ravel()]),
            np.concatenate([np.tile(np.arange(size), n_states), rows.ravel()]),
            np.concatenate([[0], np.cumsum(lengths)]),
        ),
        shape=(size, size),
    )


def difference_columns(
    problem: Problem, rhs: Callable[[FloatArray], FloatArray], z: FloatArray
) -> FloatArray:
    """Return the derivatives of z' by the states, (size, n_states), as forward differences."""
    rtol, atol = augmented_tolerances(problem)
    middle = rhs(z)
    columns = np.empty((problem.size, problem.n_states))
    for j in range(problem.n_states):
        # As in SUNDIALS: with an increment of the size of the corrections, the rounding error of
        # the Jacobian is smaller than theirs.
        y = abs(z[j])
        shifted = z.copy()
        shifted[j] += max(_ROOT_EPS * y, rtol * y + atol[j])
        # The rounded increment.
        columns[:, j] = (rhs(shifted) - middle) / (shifted[j] - z[j])
    return columns


def augmented_tolerances(problem: Problem) -> tuple[float, FloatArray]:
    """Return the relative tolerance and the absolute ones of all that is integrated.

    The first is at least ``RTOL_FLOOR``; the others have shape (..., len(problem.integrated)), see
    :class:`Tolerances`.
    """
    tolerances = Tolerances(problem)
    return tolerances.rtol_of(problem), tolerances.of(problem)


class Tolerances:
    """Absolute tolerances of entries of z, for problems that differ only in values of parameters.

    Absolute tolerances of sensitivities are those of the states divided by the sizes of the
    parameters, as in CVODES (Hindmarsh et al. 2005): the rounding error of a sensitivity of 1e7 V/F
    to a capacitance of 1e-12 F exceeds the tolerance of a voltage.

    Solvers cannot exclude entries from the error test, so untested sensitivities have an absolute
    tolerance that no error reaches. Solvers average squares over all entries, so the states'
    tolerances are divided by the square root of the ratio of both numbers: states are then tested
    as without sensitivities. LSODA uses the maximum and becomes stricter by that factor.

    Sizes of states and of parameters may have a row for each of several problems. ``is_left``
    selects entries; by default all that are integrated.
    """

    def __init__(self, problem: Problem, is_left: npt.NDArray[np.bool_] | None = None) -> None:
        places = problem.integrated if is_left is None else problem.integrated[is_left]
        self._atol = problem.settings.atol
        # Block 0 of z contains the states, block k their sensitivities to parameter k - 1.
        self._block, self._state = np.divmod(places, max(1, problem.n_states))
        self._is_tested = problem.settings.error_test_sensitivities
        self._share = 1.0 if self._is_tested else _share(problem)

    def rtol_of(self, problem: Problem) -> float:
        """Return the relative tolerance of one of the problems, at least ``RTOL_FLOOR``."""
        return max(problem.settings.rtol / self._share, RTOL_FLOOR)

    def of(self, problem: Problem) -> FloatArray:
        """Return the tolerances of one of the problems, a fresh array of shape (..., n_entries)."""
        scales = problem.scales
        atol: Any = self._atol
        if problem.sizes is not None:
            atol = (atol * problem.sizes)[..., self._state]
        if not self._is_tested:
            return np.where(self._block > 0, UNTESTED, atol / self._share)
        if scales is None:
            scales = np.ones(problem.n_sensitivities)
        # The divisor of states is one.
        divisors = np.empty((*scales.shape[:-1], 1 + scales.shape[-1]))
        divisors[..., 0], divisors[..., 1:] = 1.0, scales
        found: FloatArray = atol / divisors.take(self._block, axis=-1)
        return np.minimum(found, UNTESTED, out=found)


def tested_rtol(problem: Problem) -> float:
    """Return the relative tolerance of the error test, at least ``RTOL_FLOOR``."""
    share = 1.0 if problem.settings.error_test_sensitivities else _share(problem)
    return max(problem.settings.rtol / share, RTOL_FLOOR)


def _share(problem: Problem) -> float:
    """Return the square root of the number of entries divided by that of states."""
    return float(np.sqrt(max(1, len(problem.integrated)) / max(1, problem.n_states)))


def tested(
    row: Method, problem: Problem, *, is_extended: bool
) -> tuple[npt.NDArray[np.intp], FloatArray]:
    """Return the places in z of integrated entries, (n,), and their tolerances, (..., n).

    ``is_extended``: an explicit method integrates the algebraic unknowns, too.
    """
    is_left = is_integrated(row, problem, is_extended=is_extended)
    known = as_tested(row, problem)
    return problem.integrated[is_left], Tolerances(known, is_left).of(known)


def is_integrated(row: Method, problem: Problem, *, is_extended: bool) -> npt.NDArray[np.bool_]:
    """Return which of the entries that do not vanish are integrated in C."""
    places = problem.integrated
    cut = problem.n_states - (0 if row.keeps_algebraic else problem.n_algebraic)
    # Sensitivities of algebraic unknowns are always solved for.
    lead = problem.n_states if is_extended else cut
    # States up to `lead`, and sensitivities up to `cut` in each block.
    found: npt.NDArray[np.bool_] = places % problem.n_states < np.where(
        places < problem.n_states, lead, cut
    )
    return found


def as_tested(row: Method, problem: Problem) -> Problem:
    """Return the problem with sensitivities in the error test if SUNDIALS excludes them itself."""
    return problem.with_settings(error_test_sensitivities=True) if row.corrector else problem
