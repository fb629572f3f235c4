"""Estimated parameters: their bounds, and the scale on which an optimiser sees them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cotree.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = npt.NDArray[np.float64]

#: Scales: "lin" is the value itself, the others are its natural and its decimal logarithm.
SCALES = ("lin", "log", "log10")

_LN10 = math.log(10.0)


@dataclass(frozen=True)
class Estimated:
    """An estimated parameter.

    Attributes
    ----------
    name : str
        Its name.
    lower, upper : float
        Bounds of its value, in its unit; infinite if there is none.
    scale : str
        One of ``SCALES``: an optimiser sees the value, or its logarithm.
    start : float or None
        Initial guess, within the bounds; None leaves the choice to the estimation.
    unit : str
        Unit of the value.
    """

    name: str
    lower: float = -math.inf
    upper: float = math.inf
    scale: str = "lin"
    start: float | None = None
    unit: str = ""

    def __post_init__(self) -> None:
        what = f"estimated parameter '{self.name}'"
        if self.scale not in SCALES:
            raise ParameterError(
                f"the scale of {what} is '{self.scale}': give {', '.join(map(repr, SCALES))}"
            )
        # Written so that nan is refused as well.
        if not self.lower < self.upper:
            raise ParameterError(
                f"{what} has the bounds {self.lower:g} and {self.upper:g}: the lower one must be "
                "below the upper one"
            )
        if self.scale != "lin" and not self.lower >= 0.0:
            raise ParameterError(
                f"{what} has the lower bound {self.lower:g}: on a logarithmic scale bounds must "
                "not be negative"
            )
        if self.start is not None and not self.lower <= self.start <= self.upper:
            raise ParameterError(
                f"{what} starts at {self.start:g}, outside its bounds {self.lower:g} and "
                f"{self.upper:g}"
            )


class Scaled:
    """Conversion between the values of estimated parameters and the optimiser's variables.

    Parameters
    ----------
    estimated : sequence of Estimated
        The parameters.

    Attributes
    ----------
    names : tuple of str
        Their names.
    lower, upper : ndarray, shape (n,)
        Bounds on their scales.
    """

    def __init__(self, estimated: Sequence[Estimated]) -> None:
        self.names = tuple(row.name for row in estimated)
        self._factors = np.array([{"log10": _LN10}.get(row.scale, 1.0) for row in estimated])
        self._is_log = np.array([row.scale != "lin" for row in estimated], dtype=bool)
        self.lower = self.scaled(np.array([row.lower for row in estimated], dtype=float))
        self.upper = self.scaled(np.array([row.upper for row in estimated], dtype=float))

    def values(self, theta: Array) -> Array:
        """Convert the optimiser's variables to values, shape (..., n) each."""
        return np.where(
            self._is_log, np.exp(np.where(self._is_log, theta * self._factors, 0)), theta
        )

    def scaled(self, values: Array) -> Array:
        """Convert values to the optimiser's variables, shape (..., n) each.

        A value of zero on a logarithmic scale becomes minus infinity.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(
                self._is_log, np.log(np.where(self._is_log, values, 1.0)) / self._factors, values
            )

    def slopes(self, theta: Array) -> Array:
        """Return the derivatives of the values by the optimiser's variables, shape (..., n)."""
        return np.where(self._is_log, self.values(theta) * self._factors, 1.0)
