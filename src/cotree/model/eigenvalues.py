"""Derivatives of the eigenvalues of a matrix.

In: a matrix and its derivative. Out: w A' v / (w v) for each eigenvalue, with its left eigenvector
w and its right eigenvector v; see J. R. Magnus, On differentiating eigenvalues and eigenvectors,
Econometric Theory 1 (1985). Multiple eigenvalues have no such derivative and are refused.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cotree.errors import SingularSystemError

if TYPE_CHECKING:
    from cotree.model.arrays import Array

#: Rounding splits a defective double eigenvalue by the square root of the machine precision. Closer
#: eigenvalues count as equal, as do those whose left and right eigenvectors are that orthogonal.
_SPLIT = float(np.finfo(np.float64).eps) ** 0.5


def order_of(values: npt.NDArray[np.complex128]) -> npt.NDArray[np.intp]:
    """Order eigenvalues by descending real part, then by descending imaginary part."""
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
    # The cosines of the angles between left and right eigenvectors, which have unit length.
    cosines = np.einsum("ij,ij->j", left.conj(), right)
    weak = np.abs(cosines) <= _SPLIT
    far = np.abs(values[:, None] - values)
    np.fill_diagonal(far, np.inf)
    near = far.min(axis=1) <= _SPLIT * max(float(np.abs(values).max()), 1e-300)
    if np.any(weak | near):
        found = values[np.flatnonzero(weak | near)[0]]
        shown = f"{found.real:.6g}" if found.imag == 0.0 else f"{found:.6g}"
        raise SingularSystemError(
            f"the eigenvalue {shown} is a multiple eigenvalue, which is not differentiable: change "
            "a parameter slightly, or remove states on which nothing depends, by reduced=True or "
            "fewer joints"
        )
    slopes = np.einsum("ij,ik,kj->j", left.conj(), slope, right) / cosines
    return np.asarray(slopes[order_of(values)], dtype=complex)
