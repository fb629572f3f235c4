"""Linear systems for users: named matrices, eigenvalues, their derivatives, and export.

The derivative of an eigenvalue is w A' v / (w v) with the left eigenvector w and the right
eigenvector v; see J. R. Magnus, On differentiating eigenvalues and eigenvectors, Econometric Theory
1 (1985). It does not exist for multiple eigenvalues.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.errors import ParameterError, SingularSystemError, brief, nearest, optional_package
from cotree.report import Facts, Report, Reported, matrix, names

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.model.arrays import Array


#: Eigenvalues within this relative distance count as equal: rounding splits a defective double
#: eigenvalue by the square root of the machine precision. An eigenvalue also counts as multiple if
#: the cosine between its left and right eigenvectors is below this value.
_SPLIT = float(np.finfo(np.float64).eps) ** 0.5


def order_of(values: npt.NDArray[np.complex128]) -> npt.NDArray[np.intp]:
    """Return the indices that sort eigenvalues by descending real, then imaginary part."""
    return np.lexsort((-values.imag, -values.real))


def eigenvalue_slopes(matrix: Array, slope: Array) -> npt.NDArray[np.complex128]:
    """Return the derivatives of a matrix's eigenvalues, in the order of :func:`order_of`."""
    from scipy.linalg import eig

    if not matrix.size:
        return np.zeros(0, dtype=complex)
    values, left, right = eig(matrix, left=True, right=True)
    # Cosines between left and right eigenvectors of unit length.
    cosines = np.einsum("ij,ij->j", left.conj(), right)
    weak = np.abs(cosines) <= _SPLIT
    far = np.abs(values[:, None] - values)
    np.fill_diagonal(far, np.inf)
    near = far.min(axis=1) <= _SPLIT * max(float(np.abs(values).max()), 1e-300)
    if np.any(weak | near):
        found = values[np.flatnonzero(weak | near)[0]]
        shown = f"{found.real:.6g}" if found.imag == 0.0 else f"{found:.6g}"
        raise SingularSystemError(
            f"the eigenvalue {shown} is a multiple eigenvalue, which is not differentiable: "
            "change a parameter slightly, or remove states on which nothing depends, by "
            "reduced=True or fewer joints"
        )
    slopes = np.einsum("ij,ik,kj->j", left.conj(), slope, right) / cosines
    return np.asarray(slopes[order_of(values)], dtype=complex)


@dataclass(frozen=True, eq=False)
class LinearSlopes:
    """Derivatives of a linear system's matrices with respect to one parameter.

    Attributes
    ----------
    A, B, C, D : ndarray
        Derivatives of the matrices, in the shapes of the matrices.
    """

    A: Array
    B: Array
    C: Array
    D: Array


@dataclass(frozen=True, eq=False, repr=False)
class Linearization(Reported):
    """A linear system about a motion: z' = A z + B u, y = C z + D u for small deviations.

    Attributes
    ----------
    A, B, C, D : ndarray
        Shapes (n, n), (n, n_inputs), (n_outputs, n) and (n_outputs, n_inputs) with n deviations.
        Their units follow from the units of states, inputs and outputs.
    states, inputs, outputs : tuple of str
        Names along the axes. In the full form, ``states`` are the differential states except modes;
        in the reduced form, they are the independent ones. The reduced form replaces quaternions by
        small rotations ``EDGE.turn_x`` to ``EDGE.turn_z`` about the axes of the edge's first node,
        with rates ``EDGE.turn_x_dot`` to ``EDGE.turn_z_dot``.
    basis : ndarray, shape (n_states, n)
        Deviations of all differential states per unit of each z. In the full form, the columns are
        unit vectors. Rows of modes are zero, because small deviations do not change modes.
    is_steady : bool
        Whether the motion is steady, so that the linear system is constant and the eigenvalues of
        the reduced A determine stability. About any other motion, the linear system is valid only
        at this instant, and its eigenvalues do not determine stability.
    slopes : mapping of str to LinearSlopes
        Derivatives of the matrices with respect to each requested name.
    modes : mapping of str to float
        Modes at the point, which are constant in the linear system. If dry friction sticks, the
        relative acceleration is zero for all deviations.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    basis: Array
    is_steady: bool
    slopes: Mapping[str, LinearSlopes] = field(default_factory=dict)
    modes: Mapping[str, float] = field(default_factory=dict)

    def report(self) -> Report:
        """Return a report with names, eigenvalues and, in notebooks, the matrices."""
        z, u, y = self.states, self.inputs, self.outputs
        rates = [f"{name}′" for name in z]
        return Report(
            f"Linearization of {len(z)} states",
            Facts(
                [
                    ("about", self.summary().partition("about ")[2]),
                    ("modes", self.in_modes),
                    ("z", names(z)),
                    ("u", names(u)),
                    ("y", names(y)),
                    ("eigenvalues of A", _listed(self.eigenvalues)),
                ]
            ),
            matrix("A", rates, z, self.A),
            matrix("B", rates, u, self.B),
            matrix("C", y, z, self.C),
            matrix("D", y, u, self.D),
        )

    @property
    def eigenvalues(self) -> npt.NDArray[np.complex128]:
        """The eigenvalues of A, [1/s], shape (n,), by descending real part.

        They determine stability only if :attr:`is_steady` is true.
        """
        found = np.linalg.eigvals(self.A).astype(complex)
        return found[order_of(found)]

    def sensitivity(self, name: str) -> LinearSlopes:
        """Return the derivatives of A, B, C and D with respect to a requested parameter.

        Raises
        ------
        ParameterError
            If the parameter is not in ``sensitivities`` of :meth:`cotree.Model.linearize`.
        """
        if name not in self.slopes:
            raise ParameterError(
                f"derivatives with respect to '{brief(name)}' were not "
                f"requested{nearest(name, self.slopes)}; add it to linearize(sensitivities=[...])"
            )
        return self.slopes[name]

    def eigenvalue_sensitivity(self, name: str) -> npt.NDArray[np.complex128]:
        """Return the derivatives of :attr:`eigenvalues` with respect to a parameter, in order.

        Each one is w A' v / (w v) with the left eigenvector w and the right eigenvector v.

        Returns
        -------
        ndarray of complex, shape (n,)

        Raises
        ------
        ParameterError
            If the parameter is not in ``sensitivities`` of :meth:`cotree.Model.linearize`.
        SingularSystemError
            If eigenvalues coincide, because multiple eigenvalues are not differentiable.
        """
        return eigenvalue_slopes(self.A, self.sensitivity(name).A)

    def to_scipy(self) -> Any:
        """Return a continuous-time ``scipy.signal.StateSpace``, which has no names."""
        from scipy.signal import StateSpace

        return StateSpace(self.A, self.B, self.C, self.D)

    def to_control(self) -> Any:
        """Return a ``control.StateSpace`` with the names of states, inputs and outputs.

        The package ``control`` does not allow dots in names, so ``j.s`` becomes ``j_s``.

        Raises
        ------
        Error
            If the package is not installed.
        """
        control = optional_package("control", "to_control(), unlike to_scipy(), needs", "control")
        given = {
            name: _without_dots(getattr(self, name)) for name in ("states", "inputs", "outputs")
        }
        matrices = self.A, self.B, self.C, self.D
        return control.StateSpace(*matrices, **given, remove_useless_states=False)

    @property
    def in_modes(self) -> str:
        """The modes at the point as text."""
        return ", ".join(f"{name} = {value:g}" for name, value in self.modes.items())

    def summary(self) -> str:
        """Describe the system and the meaning of its eigenvalues in a sentence."""
        size = f"{len(self.states)} deviations, {len(self.inputs)} inputs"
        if self.modes:
            size += f", in the modes {self.in_modes}"
        if not self.is_steady:
            return (
                f"{size}, about a motion that is not steady in these coordinates: A is valid at "
                "this instant, and its eigenvalues determine stability only if A is constant "
                "along the motion"
            )
        if len(self.states) == len(self.basis) - len(self.modes):
            return f"{size}, about a steady motion"
        return f"{size}, about a steady motion: the eigenvalues of A determine stability"


def _listed(values: npt.NDArray[np.complex128], most: int = 12) -> str:
    """Return eigenvalues as text, with one entry per conjugate pair."""
    parts = [
        f"{x.real:.4g}" if x.imag == 0.0 else f"{x.real:.4g} ± {x.imag:.4g}i"
        for x in values
        if x.imag >= 0.0
    ]
    hidden = len(parts) - most
    return ", ".join(parts[:most]) + (f" and {hidden} more" if hidden > 0 else "") or "none"


def _without_dots(names: Sequence[str]) -> list[str]:
    """Replace dots in names by underscores, and keep the names unique."""
    found: list[str] = []
    for name in names:
        plain = name.replace(".", "_")
        while plain in found:
            plain += "_"
        found.append(plain)
    return found
