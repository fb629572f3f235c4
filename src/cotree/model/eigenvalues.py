"""Derivatives of the eigenvalues of a matrix.

In: a matrix and its derivative. Out: w A' v / (w v) of each eigenvalue, with its left eigenvector w
and its right one v; see J. R. Magnus, On differentiating eigenvalues and eigenvectors, Econometric
Theory 1 (1985). Where eigenvalues coincide there is no such derivative, and it is refused.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cotree.errors import SingularSystemError

if TYPE_CHECKING:
    from cotree.model.arrays import Array

#: A double eigenvalue that is not simple splits by the root of rounding: closer ones are taken for
#: one, as are those whose eigenvectors are orthogonal to this share.
_SPLIT = float(np.finfo(np.float64).eps) ** 0.5


def order_of(values: npt.NDArray[np.complex128]) -> npt.NDArray[np.intp]:
    """Order eigenvalues: the largest real part first, of conjugate ones the upper first."""
    return np.lexsort((-values.imag, -values.real))


def eigenvalue_slopes(matrix: Array, slope: Array) -> npt.NDArray[np.complex128]:
    """Differentiate the eigenvalues of a matrix, in the order of :func:`order_of`.

    Parameters
    ----------
    matrix, slope : ndarray, shape (n, n)
        The matrix and its derivative.

    Raises
    ------
    SingularSystemError
        If eigenvalues coincide.
    """
    from scipy.linalg import eig

    if not matrix.size:
        return np.zeros(0, dtype=complex)
    values, left, right = eig(matrix, left=True, right=True)
    own = np.einsum("ij,ij->j", left.conj(), right)
    # Vectors have the length one, so this is the cosine of the angle between them.
    weak = np.abs(own) <= _SPLIT
    far = np.abs(values[:, None] - values)
    np.fill_diagonal(far, np.inf)
    near = far.min(axis=1) <= _SPLIT * max(float(np.abs(values).max()), 1e-300)
    if np.any(weak | near):
        found = values[np.flatnonzero(weak | near)[0]]
        shown = f"{found.real:.6g}" if found.imag == 0.0 else f"{found:.6g}"
        raise SingularSystemError(
            f"the eigenvalue {shown} is a multiple one, and such eigenvalues have no derivative by "
            "a single parameter: change a parameter a little, or leave out by reduced=True and "
            "fewer joints what nothing depends on"
        )
    slopes = np.einsum("ij,ik,kj->j", left.conj(), slope, right) / own
    return np.asarray(slopes[order_of(values)], dtype=complex)
