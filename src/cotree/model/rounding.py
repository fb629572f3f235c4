"""Test whether a residual is due to rounding alone, where laws lose digits inside.

In: equations, a point, and the Newton step from there. A difference of squares of two volts leaves
1e-18 A of a conductance without a voltage, which neither the slopes nor the sizes of terms tell of.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from collections.abc import Callable

Array = npt.NDArray[np.float64]

#: Rounding of the equations moves unknowns by this share of their scale.
ROUNDING = 4 * float(np.finfo(np.float64).eps)

_NEIGHBOURS, _DISTANCES = 8, 5


class Differentiable(Protocol):
    """Equations with their derivatives."""

    @property
    def value(self) -> Callable[[Array], Array]:
        """Return the function whose values are to vanish."""
        ...

    def square(self, z: Array) -> Array:
        """Give the derivatives by the unknowns."""
        ...


def is_rounding(equation: Differentiable, z: Array, g: Array, step: Array) -> bool:
    """Say whether a residual is nothing but rounding.

    In that case, the values at neighbouring points deviate from the tangent by similar amounts
    whether the points are near or four times as far away. The deviation of a curve would be 16
    times, that of a kink 4 times as large.

    Parameters
    ----------
    equation : Differentiable
        The equations.
    z, g, step : ndarray, shape (n,)
        A point, the residuals there, and the Newton step.
    """
    slope, reach = equation.square(z).copy(), np.maximum(np.abs(step), ROUNDING * np.abs(z))
    aside = reach * np.random.default_rng(0).uniform(-1.0, 1.0, (_NEIGHBOURS, len(z)))
    away = np.array(
        [
            np.max([np.abs(equation.value(z + a) - g - slope @ a) for a in 4.0**k * aside], axis=0)
            for k in range(_DISTANCES)
        ]
    )
    is_flat = (away[1:] <= 2.0 * away[:-1]) & (np.abs(g) <= 2.0 * away[:-1])
    return bool(np.all(is_flat.any(axis=0) | (g == 0.0)))
