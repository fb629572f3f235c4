"""Table of the scalar operations: arguments, evaluation and C text of each.

Python's functions raise an error for ``1/0``, ``exp(1000)`` and ``log(-1)``. The functions in this
module return infinities and nan as in C, including signs. A harmless overflow, as in ``1/(1 +
exp(1000))``, is then no error.

Sums, differences, products, quotients and negations are operators in C; all other operations are
function calls. Partial derivatives are expressions of nodes and are in
:mod:`cotree.dag.derivative`.
"""

from __future__ import annotations

import cmath
import math
import operator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable


def divide(a: float, b: float) -> float:
    """Return a / b as in C: infinity if only b is zero, nan if both are zero."""
    try:
        return a / b
    except ZeroDivisionError:
        if a == 0.0 or math.isnan(a):
            return math.nan
        # As in C, the sign of zero matters: 1/-0.0 is minus infinity.
        return math.copysign(math.inf, a) * math.copysign(1.0, b)


def power(a: float, b: float) -> float:
    """Return a**b; an infinite result has the sign of the base if the exponent is odd."""
    try:
        return math.pow(a, b)
    except OverflowError:
        # An odd exponent keeps the sign of the base.
        return math.copysign(math.inf, a) if _is_odd(b) else math.inf
    except ValueError:
        # A negative base with a fractional exponent is undefined. Zero with a negative exponent is
        # a pole; for odd exponents, the result has the sign of the zero.
        if a != 0.0:
            return math.nan
        return math.copysign(math.inf, a) if _is_odd(b) else math.inf


def logarithm(x: float) -> float:
    """Return the natural logarithm: minus infinity at zero, nan for negative arguments."""
    try:
        return math.log(x)
    except ValueError:
        return -math.inf if x == 0.0 else math.nan


def floor(x: float) -> float:
    """Round down as in C: zeros, infinities and nan are unchanged."""
    return float(math.floor(x)) if x and math.isfinite(x) else x


def total(function: Callable[[float], float]) -> Callable[[float], float]:
    """Wrap a function such that it returns nan outside its domain, and infinity if it overflows.

    ``exp`` and ``cosh`` overflow to plus infinity, ``sinh`` to either infinity.
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


Scalar = Any  # float, complex, or a numpy array of either


@dataclass(frozen=True)
class Operation:
    """A scalar operation."""

    name: str  # name of the operation in graphs
    arity: int  # number of arguments of the operation
    #: Evaluation for floats, complex numbers and numpy arrays. For floats, the results are those of
    #: C, including infinities and nan, and no errors are raised.
    real: Callable[..., Scalar]
    complex_: Callable[..., Scalar]
    array: Callable[..., Scalar]
    c: str  # C expression, with ``{0}``, ``{1}``, ... for the arguments
    is_call: bool = True  # true for a C library function, false for an operator


def _sign(x: float) -> float:
    return float((x > 0.0) - (x < 0.0))


# For complex steps only: real parts select branches, imaginary parts are infinitesimal.
def _complex_atan2(y: complex, x: complex) -> complex:
    y0, x0 = complex(y).real, complex(x).real
    # The two directions differ infinitesimally, so the arctangent is on its principal branch.
    return math.atan2(y0, x0) + cmath.atan((x0 * y - y0 * x) / (x0 * x + y0 * y))


def _complex_erf(x: complex) -> complex:
    """Return erf of a complex number to first order in the imaginary part, for complex steps."""
    x0 = complex(x).real
    slope = 2.0 / math.sqrt(math.pi) * math.exp(-x0 * x0)
    return complex(math.erf(x0), slope * complex(x).imag)


def _array_erf(x: Scalar) -> Scalar:
    each = np.vectorize(_complex_erf if np.iscomplexobj(x) else math.erf)
    return each(x)


def _select(condition: float, accepted: float, refused: float) -> float:
    # As in C, a comparison with nan is false: the refused value is returned.
    return accepted if condition >= 0.0 else refused


def _complex_select(condition: complex, accepted: complex, refused: complex) -> complex:
    return accepted if complex(condition).real >= 0.0 else refused


def _array_select(condition: Scalar, accepted: Scalar, refused: Scalar) -> Scalar:
    return np.where(np.real(condition) >= 0.0, accepted, refused)


def _array_sign(x: Scalar) -> Scalar:
    """Return the sign; as in C, and unlike NumPy, the sign of nan is zero."""
    return np.subtract(np.real(x) > 0.0, np.real(x) < 0.0, dtype=float)


def _arithmetic(name: str, arity: int, function: Callable[..., Scalar], c: str) -> Operation:
    return Operation(name, arity, function, function, function, c, is_call=False)


def _function(name: str, real: Callable[[float], float] | None = None) -> Operation:
    array = getattr(np, {"asin": "arcsin", "acos": "arccos", "atan": "arctan"}.get(name, name))
    real = real or total(getattr(math, name))
    return Operation(name, 1, real, getattr(cmath, name), array, f"{name}({{0}})")


_ROWS = (
    _arithmetic("add", 2, operator.add, "{0} + {1}"),
    _arithmetic("sub", 2, operator.sub, "{0} - {1}"),
    _arithmetic("mul", 2, operator.mul, "{0} * {1}"),
    # Of Python's arithmetic operators, only division can raise an error for floats.
    Operation("div", 2, divide, operator.truediv, operator.truediv, "{0} / {1}", is_call=False),
    _arithmetic("neg", 1, operator.neg, "-{0}"),
    *(_function(name) for name in ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan")),
    *(_function(name) for name in ("sinh", "cosh", "tanh", "exp")),
    _function("log", logarithm),
    Operation("erf", 1, math.erf, _complex_erf, _array_erf, "erf({0})"),
    Operation("abs", 1, abs, lambda x: x if complex(x).real >= 0.0 else -x, np.abs, "fabs({0})"),
    Operation(
        "sign",
        1,
        _sign,
        lambda x: _sign(complex(x).real),
        _array_sign,
        # The same comparisons as in Python, so that the sign of nan is zero in C too.
        "(double)(({0} > 0.0) - ({0} < 0.0))",
    ),
    Operation("floor", 1, floor, lambda x: math.floor(complex(x).real), np.floor, "floor({0})"),
    Operation("atan2", 2, math.atan2, _complex_atan2, np.arctan2, "atan2({0}, {1})"),
    Operation("pow", 2, power, operator.pow, np.power, "pow({0}, {1})"),
    Operation("select", 3, _select, _complex_select, _array_select, "({0} >= 0.0 ? {1} : {2})"),
)

OPERATIONS: dict[str, Operation] = {row.name: row for row in _ROWS}


def folded(name: str, *values: float) -> float:
    """Evaluate an operation on constants; raise ValueError or OverflowError if it is not finite."""
    found: float = OPERATIONS[name].real(*values)
    if not math.isfinite(found):
        text = f"{name}({', '.join(f'{value:.10g}' for value in values)}) is {found}"
        if math.isnan(found):
            raise ValueError(f"math domain error: {text}")
        raise OverflowError(f"math range error: {text}")
    return found
