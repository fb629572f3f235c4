"""Real functions that follow the rules of IEEE 754 and C99's annex F, as compiled kernels do.

Python's own raise where there is no number: ``1/0``, ``exp(1000)``, ``log(-1)``. These give
infinities and nan, with C's signs, so that a value beyond what matters, such as the ``exp`` in
``1/(1 + exp(1000))``, does no harm with or without a compiler.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable


def divide(a: float, b: float) -> float:
    """Divide; a division by zero gives an infinity, or nan where the dividend is zero, too."""
    try:
        return a / b
    except ZeroDivisionError:
        if a == 0.0 or math.isnan(a):
            return math.nan
        # The sign of a zero counts, as in C: 1/-0.0 is minus infinity.
        return math.copysign(math.inf, a) * math.copysign(1.0, b)


def power(a: float, b: float) -> float:
    """Raise to a power; an infinite result has the sign of the base if the power is odd."""
    try:
        return math.pow(a, b)
    except OverflowError:
        # Overflow: the exponent tells whether the sign of the base survives.
        return math.copysign(math.inf, a) if _is_odd(b) else math.inf
    except ValueError:
        # Without a value are a negative base with a fractional exponent, and zero with a negative
        # exponent. The latter is a pole, whose sign is that of the zero for odd exponents.
        if a != 0.0:
            return math.nan
        return math.copysign(math.inf, a) if _is_odd(b) else math.inf


def logarithm(x: float) -> float:
    """Give the natural logarithm: minus infinity of zero, nan of what is negative."""
    try:
        return math.log(x)
    except ValueError:
        return -math.inf if x == 0.0 else math.nan


def floor(x: float) -> float:
    """Round down; zeros keep their sign, infinities and nan stay."""
    return float(math.floor(x)) if x and math.isfinite(x) else x


def total(function: Callable[[float], float]) -> Callable[[float], float]:
    """Let a function give nan outside its domain, and an infinity beyond the largest number.

    Of those that overflow, ``exp`` and ``cosh`` do so upwards, ``sinh`` towards both sides.
    """
    upwards = function in (math.exp, math.cosh)

    def value(x: float) -> float:
        try:
            return function(x)
        except OverflowError:
            return math.inf if upwards else math.copysign(math.inf, x)
        except ValueError:
            return math.nan

    return value


def _is_odd(x: float) -> bool:
    return math.isfinite(x) and abs(math.fmod(x, 2.0)) == 1.0
