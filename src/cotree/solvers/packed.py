"""Sensitivities that vanish at all times, left out of what a method in Python integrates.

In: what starts a method. Out: the same, of a problem some of whose sensitivities are zero. The
method sees the others alone; all else sees them all.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.solvers.evaluate import Evaluator

if TYPE_CHECKING:
    from cotree.solvers.problem import FloatArray, Problem
    from cotree.solvers.stepper import StartStepper, Stepper


def packed(start: StartStepper) -> StartStepper:
    """Have a method integrate only what does not vanish.

    Parameters
    ----------
    start : callable
        ``start(evaluator, t, z, t_end)`` returns a stepper that has not stepped yet.
    """

    def begin(evaluator: Evaluator, t: float, z: FloatArray, t_end: float) -> Stepper:
        if evaluator.problem.places is None:
            return start(evaluator, t, z, t_end)
        inner = _PackedEvaluator(evaluator)
        return _PackedStepper(start(inner, t, inner.pack(z), t_end), inner)

    return begin


class _PackedEvaluator(Evaluator):
    """The evaluator of what is integrated; the other one counts and guards."""

    def __init__(self, whole: Evaluator) -> None:
        self.problem: Problem = whole.problem
        self._whole, self._places = whole, whole.problem.integrated

    def pack(self, z: FloatArray) -> FloatArray:
        """Leave out what vanishes."""
        left: FloatArray = z[self._places]
        return left

    def unpack(self, w: FloatArray) -> FloatArray:
        """Put zeros in its places."""
        z = np.zeros(self.problem.size)
        z[self._places] = w
        return z

    def rhs(self, t: float, z: FloatArray) -> FloatArray:
        """Return a fresh array with the derivative."""
        return self.pack(self._whole.rhs(t, self.unpack(z)))

    def state_jacobian(self, t: float, z: FloatArray) -> FloatArray:
        """Return the Jacobian of the states."""
        return self._whole.state_jacobian(t, self.unpack(z))

    def dense_jacobian(self, t: float, z: FloatArray) -> FloatArray:
        """Return the Jacobian of what is integrated as a dense matrix."""
        whole = self._whole.dense_jacobian(t, self.unpack(z))
        return np.ascontiguousarray(whole[np.ix_(self._places, self._places)])

    def sized_jacobian(self, t: float, z: FloatArray) -> Any:
        """Return the same, in SciPy's CSC form where that is cheaper."""
        whole = self._whole.sized_jacobian(t, self.unpack(z))
        if isinstance(whole, np.ndarray):
            return np.ascontiguousarray(whole[np.ix_(self._places, self._places)])
        return whole[self._places][:, self._places]


class _PackedStepper:
    """A stepper whose values have zeros in the places of what vanishes."""

    def __init__(self, inner: Stepper, evaluator: _PackedEvaluator) -> None:
        self._inner, self._evaluator = inner, evaluator
        self.lands, self.has_memory = inner.lands, inner.has_memory
        self.t, self.z = inner.t, evaluator.unpack(inner.z)

    @property
    def nlu(self) -> int:
        """Return the number of factorisations so far."""
        return self._inner.nlu

    def step(self, t_bound: float) -> str:
        """Take one step, not past ``t_bound``."""
        reason = self._inner.step(t_bound)
        self.t, self.z = self._inner.t, self._evaluator.unpack(self._inner.z)
        return reason

    def interpolate(self, t: float) -> FloatArray:
        """Return the values at a time inside the last step."""
        return self._evaluator.unpack(self._inner.interpolate(t))

    def replace(self, z: FloatArray, dz: FloatArray) -> None:
        """Go on from other values."""
        self.z = z
        self._inner.replace(self._evaluator.pack(z), self._evaluator.pack(dz))
