"""Time counted from where a method in Python begins.

In: what starts a method. Out: the same, of a method whose own time begins at zero. Late in a run
the rounding of t would add up over its steps, and be longer than its first ones; an autonomous
motion does not depend on t at all.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from cotree.solvers.evaluate import Evaluator

# A rounding of t below this share of the relative tolerance of a step is not felt.
_FINE = 1e-2

if TYPE_CHECKING:
    from cotree.solvers.problem import FloatArray, Problem
    from cotree.solvers.stepper import StartStepper, Stepper


def counted_from_start(start: StartStepper) -> StartStepper:
    """Have a method count time from where it begins.

    Parameters
    ----------
    start : callable
        ``start(evaluator, t, z, t_end)`` returns a stepper that has not stepped yet.
    """

    def begin(evaluator: Evaluator, t: float, z: FloatArray, t_end: float) -> Stepper:
        if t == 0.0:
            return start(evaluator, t, z, t_end)
        inner = start(_LaterEvaluator(evaluator, t), 0.0, z, t_end - t)
        return _LaterStepper(inner, t, _FINE * evaluator.problem.rtol)

    return begin


class _LaterEvaluator(Evaluator):
    """The evaluator as a method that counts from zero sees it; the other one counts and guards."""

    def __init__(self, whole: Evaluator, origin: float) -> None:
        self.problem: Problem = whole.problem
        self._whole, self._origin = whole, origin

    def rhs(self, t: float, z: FloatArray) -> FloatArray:
        """Return a fresh array with the derivative."""
        return self._whole.rhs(self._origin + t, z)

    def state_jacobian(self, t: float, z: FloatArray) -> FloatArray:
        """Return the Jacobian of the states."""
        return self._whole.state_jacobian(self._origin + t, z)

    def sparse_jacobian(self, t: float, z: FloatArray) -> Any:
        """Return the same in SciPy's CSC form."""
        return self._whole.sparse_jacobian(self._origin + t, z)

    def dense_jacobian(self, t: float, z: FloatArray) -> FloatArray:
        """Return the Jacobian of what is integrated as a dense matrix."""
        return self._whole.dense_jacobian(self._origin + t, z)

    def sized_jacobian(self, t: float, z: FloatArray) -> Any:
        """Return the same, in SciPy's CSC form where that is cheaper."""
        return self._whole.sized_jacobian(self._origin + t, z)


class _LaterStepper:
    """A stepper whose times are those of the problem, rounded towards where it began.

    Where that rounding is felt, its values are those at the rounded time.
    """

    def __init__(self, inner: Stepper, origin: float, fine: float) -> None:
        self._inner, self._origin, self._fine = inner, origin, fine
        self._before = inner.t
        self.lands, self.has_memory = inner.lands, inner.has_memory
        self.t, self.z = origin, inner.z

    @property
    def nlu(self) -> int:
        """Return the number of factorisations so far."""
        return self._inner.nlu

    def step(self, t_bound: float) -> str:
        """Take one step, not past ``t_bound``."""
        inner, bound = self._inner, t_bound - self._origin
        before = inner.t
        reason = inner.step(bound)
        if reason:
            return reason
        self._before = before
        self.t, self.z = t_bound, inner.z
        if inner.t != bound:
            self._round(t_bound)
        return reason

    def interpolate(self, t: float) -> FloatArray:
        """Return the values at a time inside the last step."""
        low, high = sorted((self._before, self._inner.t))
        return self._inner.interpolate(min(max(t - self._origin, low), high))

    def replace(self, z: FloatArray, dz: FloatArray) -> None:
        """Go on from other values."""
        self.z = z
        if self._is_felt():
            self._inner.t = self.t - self._origin
        self._inner.replace(z, dz)

    def _round(self, t_bound: float) -> None:
        """Find the time of a step that ends before its bound."""
        inner, origin = self._inner, self._origin
        self.t = origin + inner.t
        is_ahead = abs(self.t - origin) > abs(inner.t) or (self.t - t_bound) * inner.t >= 0.0
        if is_ahead:
            self.t = math.nextafter(self.t, origin)
        if self._is_felt():
            self.z = self.interpolate(self.t)

    def _is_felt(self) -> bool:
        """Tell whether a time differs from its rounding by more than a step notices."""
        inner = self._inner
        return abs(self.t - self._origin - inner.t) > self._fine * abs(inner.t - self._before)
