"""Design variables, scaled to the interval from zero to one between their bounds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import ParameterError, brief
from cotree.scene.expressions import check_number
from cotree.scene.given import check_whole

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.model.arrays import Array


@dataclass(frozen=True)
class Scale:
    """The scale of one design variable.

    Attributes
    ----------
    name : str
        A parameter, or a state, whose name denotes its initial value.
    low, high : float
        Bounds; infinite if there is none.
    is_log : bool
        Whether the scale is logarithmic.
    start : float
        Initial guess.
    """

    name: str
    low: float
    high: float
    is_log: bool
    start: float

    @property
    def _span(self) -> tuple[float, float]:
        """Origin and unit of the scale, in terms of the logarithm for a logarithmic scale."""
        low, high, start = (self._plain(x) for x in (self.low, self.high, self.start))
        if math.isfinite(low) and math.isfinite(high):
            return low, high - low
        return start, abs(start) or 1.0

    def _plain(self, value: float) -> float:
        if not self.is_log:
            return value
        return math.log(value) if 0.0 < value < math.inf else math.copysign(math.inf, value - 1.0)

    def scaled(self, value: float) -> float:
        """Convert a value to its scaled coordinate."""
        origin, unit = self._span
        return (self._plain(value) - origin) / unit

    def value(self, v: float) -> float:
        """Convert a scaled coordinate to a value, clipped to the bounds."""
        origin, unit = self._span
        plain = origin + unit * v
        found = math.exp(min(plain, 700.0)) if self.is_log else plain
        return min(max(found, self.low), self.high)

    def slope(self, value: float) -> float:
        """Return the derivative of the value with respect to its scaled coordinate."""
        return self._span[1] * (value if self.is_log else 1.0)


def read_scales(
    over: Mapping[str, Any], known: Mapping[str, float], guess: Mapping[str, float]
) -> list[Scale]:
    """Read bounds, scales and starts.

    Parameters
    ----------
    over : mapping of str to (lower, upper) or (lower, upper, "log")
        Bounds by name.
    known : mapping of str to float
        The scene's values, which are the default guesses.
    guess : mapping of str to float
        Initial guesses that override them.

    Raises
    ------
    ParameterError
        If bounds are invalid, or a guess violates them.
    """
    if not isinstance(over, dict) or not over:
        raise ParameterError(
            'over must map names to bounds, as in over={"L": (0.5, 2), "k": (1, 1e3, "log")}'
        )
    for name in guess:
        if name not in over:
            raise ParameterError(f"guess names '{brief(name)}', which is not in over")
    return [_read(name, bounds, known, guess) for name, bounds in over.items()]


def _read(name: str, bounds: Any, known: Mapping[str, float], guess: Mapping[str, float]) -> Scale:
    what = f"over of '{brief(name)}'"
    if not isinstance(bounds, (tuple, list)) or len(bounds) not in (2, 3):
        raise ParameterError(
            f'{what} is {brief(repr(bounds))}: give (lower, upper) or (lower, upper, "log")'
        )
    kind = bounds[2] if len(bounds) == 3 else "linear"
    if kind not in ("linear", "log"):
        raise ParameterError(f"{what} has the scale {brief(repr(kind))}: give 'linear' or 'log'")
    low, high = (_bound(value, what) for value in bounds[:2])
    if not low < high:
        raise ParameterError(
            f"{what} goes from {low:g} to {high:g}: the lower bound must be below the upper one"
        )
    is_log = kind == "log"
    if is_log and low <= 0.0:
        raise ParameterError(
            f"{what} is logarithmic, but its lower bound is {low:g}: give a positive lower bound"
        )
    if name in guess:
        start = check_number(guess[name], f"the guess of '{name}'")
        if not low <= start <= high:
            raise ParameterError(
                f"the guess of '{name}' is {start:g}, outside its bounds {low:g} to {high:g}"
            )
    else:
        start = known.get(name, math.nan)
        if not low <= start <= high:  # also where it is nan: there is no nominal value
            start = _middle(low, high, is_log=is_log)
    return Scale(name, low, high, is_log, start)


def _bound(value: Any, what: str) -> float:
    if isinstance(value, (int, float)) and not isinstance(value, bool) and math.isinf(value):
        return float(value)
    return check_number(value, what)


def _middle(low: float, high: float, *, is_log: bool) -> float:
    if not math.isfinite(low) or not math.isfinite(high):
        return low if math.isfinite(low) else high if math.isfinite(high) else 0.0
    return math.sqrt(low * high) if is_log else 0.5 * (low + high)


def drawn_starts(scales: Sequence[Scale], starts: int, seed: int | None) -> list[Array]:
    """Return the starting points in scaled coordinates: the guess first, then random ones.

    Raises
    ------
    ParameterError
        If random starts are requested and a variable is unbounded.
    """
    first = np.array([scale.scaled(scale.start) for scale in scales])
    starts = check_whole(starts, "starts", 1)
    seed = None if seed is None else check_whole(seed, "seed")
    if starts == 1:
        return [first]
    for scale in scales:
        if not (math.isfinite(scale.low) and math.isfinite(scale.high)):
            raise ParameterError(
                f"starts are drawn between bounds, and '{scale.name}' has none: give both"
            )
    from scipy.stats import qmc

    # Even a few points of a Latin hypercube cover the range of every variable.
    rows = qmc.LatinHypercube(len(scales), seed=seed).random(starts - 1)
    return [first, *rows]
