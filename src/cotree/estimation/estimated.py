"""Estimated parameters: bounds, scales and starting points."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from cotree.arguments import check_choice
from cotree.ensemble.sampling import unit_points
from cotree.errors import ParameterError, brief
from cotree.scene.expressions import check_number

Array = npt.NDArray[np.float64]

#: Scales of estimated parameters: linear, natural logarithm and decimal logarithm.
SCALES = ("lin", "log", "log10")

#: d(ln p)/d(theta) of a parameter p with the logarithm theta on each scale; 1 if linear.
LOGARITHMS = {"lin": 1.0, "log": 1.0, "log10": math.log(10.0)}


@dataclass(frozen=True)
class Estimated:
    """An estimated parameter: bounds, scale and initial guess.

    Attributes
    ----------
    name : str
        Name of the parameter.
    lower, upper : float
        Bounds of its value, in its unit; infinite if there are none.
    scale : str
        One of ``SCALES``: the optimiser's variable is the value or its logarithm.
    start : float or None
        Initial guess within the bounds; None selects one automatically.
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
        what = f"'{self.name}'"
        check_choice(self.scale, f"the scale of {what}", SCALES)
        # negated, so that nan is also rejected
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
    """Conversion of parameter values to the optimiser's variables and their bounds, and back."""

    def __init__(self, estimated: Sequence[Estimated]) -> None:
        self.names = tuple(row.name for row in estimated)
        self._factors = np.array([LOGARITHMS[row.scale] for row in estimated])
        self._is_log = np.array([row.scale != "lin" for row in estimated], dtype=bool)
        self.lower = self.scaled(np.array([row.lower for row in estimated], dtype=float))
        self.upper = self.scaled(np.array([row.upper for row in estimated], dtype=float))

    def values(self, theta: Array) -> Array:
        """Convert the optimiser's variables to values; both have shape (..., n)."""
        return np.where(
            self._is_log, np.exp(np.where(self._is_log, theta * self._factors, 0)), theta
        )

    def scaled(self, values: Array) -> Array:
        """Convert values, (..., n), to the optimiser's variables; log scales map 0 to -inf."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(
                self._is_log, np.log(np.where(self._is_log, values, 1.0)) / self._factors, values
            )

    def slopes(self, theta: Array) -> Array:
        """Return the derivatives of values with respect to the optimiser's variables, (..., n)."""
        return np.where(self._is_log, self.values(theta) * self._factors, 1.0)


# Factor between the initial guess of a positive parameter and each of its default bounds.
_SPAN = 100.0


def read_ranges(parameters: Any) -> dict[str, Any]:
    """Return the ranges of estimated parameters by name, for :func:`estimated`."""
    if isinstance(parameters, str):
        parameters = [parameters]
    if not isinstance(parameters, (Mapping, Sequence)):
        raise ParameterError(
            'give what is estimated as parameters={"k": (10, 100, "log"), ...}, with bounds of each'
        )
    found: dict[str, Any] = {}
    for item in parameters:
        name = item.name if isinstance(item, Estimated) else item
        if not isinstance(name, str) or not name:
            raise ParameterError(f"parameters holds {brief(repr(item))}: give names of parameters")
        if name in found:
            raise ParameterError(f"'{name}' is given twice: name it once")
        found[name] = parameters[item] if isinstance(parameters, Mapping) else item
        if found[name] is name:  # the name is an element of a list, which contains no ranges
            found[name] = None
    if not found:
        raise ParameterError("nothing is estimated: name at least one parameter")
    return found


def estimated(
    name: str, given: Any, start: float | None, nominal: float | None, unit: str = ""
) -> Estimated:
    """Return an estimated parameter from its name and range.

    A range is ``(lower, upper)`` or ``(lower, upper, scale)``, in which None means no bound. The
    range None extends from a hundredth to a hundred times the initial guess on a logarithmic scale.
    ``start`` is the user's guess; by default it is the model's value ``nominal`` if that is within
    the bounds.
    """
    what = f"'{brief(name)}'"
    if isinstance(given, Estimated):
        start = given.start if start is None else start
        given = (given.lower, given.upper, given.scale)
    begin = nominal if start is None else start
    if given is None:
        if begin is None or not begin > 0.0:
            reason = "has no initial guess" if begin is None else f"starts at {begin:g}"
            raise ParameterError(
                f'{what} {reason}, so it has no default bounds: give "{name}": (lower, upper)'
            )
        return Estimated(name, begin / _SPAN, begin * _SPAN, "log", begin, unit)
    if isinstance(given, str) or not isinstance(given, Sequence) or len(given) not in (2, 3):
        raise ParameterError(
            f"{what} has the range {brief(repr(given))}: give (lower, upper) or "
            f"(lower, upper, scale), with the scale {' or '.join(map(repr, SCALES))}"
        )
    ends = (-math.inf, math.inf) if tuple(given[2:]) in ((), ("lin",)) else (0.0, math.inf)
    lower, upper = (
        end if value is None else _bound(value, what)
        for value, end in zip(given[:2], ends, strict=True)
    )
    scale = str(given[2]) if len(given) == 3 else "lin"
    if start is None:
        # The scene's value is only a default and is ignored if it violates the bounds.
        inside = (
            nominal is not None and lower <= nominal <= upper and (scale == "lin" or nominal > 0.0)
        )
        begin = nominal if inside else None
    elif scale != "lin" and not start > 0.0:
        raise ParameterError(f"{what} starts at {start:g}, which has no logarithm")
    return Estimated(name, lower, upper, scale, begin, unit)


def _bound(value: Any, what: str) -> float:
    """Return a bound as a float, which may be infinite, or raise an error."""
    if isinstance(value, float) and math.isinf(value):
        return value
    return check_number(value, f"a bound of {what}")


def spread_starts(rows: Sequence[Estimated], n: int, seed: int | None = 0) -> Array:
    """Return starting points: the initial guess, then a Latin hypercube within the bounds.

    Points are on the parameters' scales, shape (n, n_estimated). A parameter without a guess starts
    in the middle of its bounds. An infinite bound is replaced: on a logarithmic scale by one decade
    from the guess; on a linear scale by zero or twice the guess, or by -1 or 1 if the guess is
    zero.
    """
    scaled = Scaled(rows)
    ends = np.array([_ends(row) for row in rows]).T
    low = np.where(np.isfinite(scaled.lower), scaled.lower, np.minimum(ends[0], scaled.upper))
    high = np.where(np.isfinite(scaled.upper), scaled.upper, np.maximum(ends[1], scaled.lower))
    first = scaled.scaled(np.array([math.nan if r.start is None else r.start for r in rows]))
    first = np.where(np.isfinite(first), first, 0.5 * (low + high))
    if n < 2:
        return first[None, :]
    rest = low + unit_points("latin", n - 1, len(first), seed) * (high - low)
    return np.vstack([first, rest])


def _ends(row: Estimated) -> tuple[float, float]:
    """Return the interval, on the parameter's scale, that replaces infinite bounds."""
    if row.scale != "lin":
        decade = math.log(10.0) / LOGARITHMS[row.scale]
        middle = math.log10(row.start) * decade if row.start else 0.0
        return middle - decade, middle + decade
    start = row.start or 0.0
    return start - (abs(start) or 1.0), start + (abs(start) or 1.0)
