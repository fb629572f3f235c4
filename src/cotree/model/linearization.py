"""Linear systems as users see them: matrices with names, eigenvalues, derivatives, exports."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.errors import Error, ParameterError, brief, nearest
from cotree.model.eigenvalues import eigenvalue_slopes, order_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.model.arrays import Array


@dataclass(frozen=True, eq=False)
class LinearSlopes:
    """Derivatives of the matrices of a linear system by one parameter.

    Attributes
    ----------
    A, B, C, D : ndarray
        Of the shapes of the matrices, in their units per unit of the parameter.
    """

    A: Array
    B: Array
    C: Array
    D: Array


@dataclass(frozen=True, eq=False, repr=False)
class Linearization:
    """A linear system about a motion: z' = A z + B u, y = C z + D u for small deviations.

    Attributes
    ----------
    A, B, C, D : ndarray
        Shapes (n, n), (n, n_inputs), (n_outputs, n) and (n_outputs, n_inputs) with n deviations;
        units follow from those of states, inputs and outputs.
    states, inputs, outputs : tuple of str
        Names along the axes. Of the full form: the states that have rates. Of the reduced one:
        those that are independent; rotations where a quaternion stands for them, ``EDGE.turn_x``
        to ``turn_z`` along the axes of the edge's first node and their rates, ``turn_x_dot``.
    basis : ndarray, shape (n_states, n)
        The deviations of all states that have rates for a unit of each z: the unit matrix in the
        full form.
    is_steady : bool
        Whether the motion through the point is steady: whatever the independent deviations depend
        on stays as it is, so that the reduced A is constant and its eigenvalues tell stability.
        About any other motion they do not: the system holds at this instant.
    slopes : mapping of str to LinearSlopes
        Derivatives of the matrices, by the name that was asked for.
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

    def __repr__(self) -> str:
        from cotree.model.display import linear_text

        return linear_text(self)

    def _repr_html_(self) -> str:
        """Show the matrices with the names of their rows and columns in a notebook."""
        from cotree.model.display import linear_html

        return linear_html(self)

    @property
    def eigenvalues(self) -> npt.NDArray[np.complex128]:
        """The eigenvalues of A, [1/s], shape (n,): the largest real part first.

        They tell stability as :attr:`is_steady` says.
        """
        found = np.linalg.eigvals(self.A).astype(complex)
        return found[order_of(found)]

    def sensitivity(self, name: str) -> LinearSlopes:
        """Return the derivatives of A, B, C and D by a parameter that was asked for.

        Raises
        ------
        ParameterError
            If it was not; :meth:`cotree.Model.linearize` takes ``sensitivities``.
        """
        if name not in self.slopes:
            raise ParameterError(
                f"derivatives by '{brief(name)}' were not asked for{nearest(name, self.slopes)}; "
                "name it in linearize(sensitivities=[...])"
            )
        return self.slopes[name]

    def eigenvalue_sensitivity(self, name: str) -> npt.NDArray[np.complex128]:
        """Return the derivatives of :attr:`eigenvalues` by a parameter, in the same order.

        Each is w A' v / (w v) with the left and the right eigenvector w and v.

        Returns
        -------
        ndarray of complex, shape (n,)

        Raises
        ------
        ParameterError
            If the derivatives by this parameter were not asked for.
        SingularSystemError
            If eigenvalues coincide: they have no derivative there.
        """
        return eigenvalue_slopes(self.A, self.sensitivity(name).A)

    def to_scipy(self) -> Any:
        """Return a ``scipy.signal.StateSpace``, which is continuous in time and has no names."""
        from scipy.signal import StateSpace

        return StateSpace(self.A, self.B, self.C, self.D)

    def to_control(self) -> Any:
        """Return a ``control.StateSpace`` with the names of states, inputs and outputs.

        That library keeps no dots in names: ``j.s`` is called ``j_s`` there.

        Raises
        ------
        Error
            If the package is not installed.
        """
        try:
            from control import StateSpace
        except ImportError as error:
            raise Error(
                "to_control() needs the package control: run `pip install control` (the extra "
                "cotree[control]), or use to_scipy()"
            ) from error
        names = {
            "states": _without_dots(self.states),
            "inputs": _without_dots(self.inputs),
            "outputs": _without_dots(self.outputs),
        }
        return StateSpace(self.A, self.B, self.C, self.D, **names, remove_useless_states=False)

    def summary(self) -> str:
        """Say in a sentence what it is about, and what its eigenvalues tell."""
        size = f"{len(self.states)} deviations, {len(self.inputs)} inputs"
        if not self.is_steady:
            return (
                f"{size}, about no steady motion in these coordinates: A holds at this instant, "
                "and unless it is the same along the whole motion its eigenvalues do not tell "
                "stability"
            )
        if len(self.states) == len(self.basis):
            return f"{size}, about a steady motion"
        return f"{size}, about a steady motion: the eigenvalues of A tell stability"


def _without_dots(names: Sequence[str]) -> list[str]:
    """Write names without dots, no two alike."""
    found: list[str] = []
    for name in names:
        plain = name.replace(".", "_")
        while plain in found:
            plain += "_"
        found.append(plain)
    return found
