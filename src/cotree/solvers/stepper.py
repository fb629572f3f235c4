"""A solver between two breakpoints, advanced one step at a time: the protocol, and one at rest."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from cotree.solvers.evaluate import Evaluator
    from cotree.solvers.problem import FloatArray


class Stepper(Protocol):
    """A solver between two breakpoints, advanced one step at a time.

    Attributes
    ----------
    t : float
        Time reached, [s].
    z : ndarray
        Values there; the array is never changed afterwards.
    lands : bool
        Whether steps end on outputs, because the method's interpolant is weaker than its steps.
    has_memory : bool
        Whether steps build on those before, so that ``replace`` costs a new start.
    nlu : int
        Factorisations so far.
    """

    t: float
    z: FloatArray
    lands: bool
    has_memory: bool

    @property
    def nlu(self) -> int:
        """Return the number of factorisations so far."""
        ...

    def step(self, t_bound: float) -> str:
        """Take one step, not past ``t_bound``; return a reason if that fails, else ""."""

    def interpolate(self, t: float) -> FloatArray:
        """Return the values at a time inside the last step."""

    def replace(self, z: FloatArray, dz: FloatArray) -> None:
        """Go on from other values at the time reached, where the derivative is ``dz``.

        The interpolant of the step before is lost.
        """


StartStepper = Callable[["Evaluator", float, "FloatArray", float], Stepper]


class Idle:
    """The stepper of a problem without states, which no solver accepts."""

    lands = True
    has_memory = False
    nlu = 0

    def __init__(self, evaluator: Evaluator, t: float, z: FloatArray, t_end: float) -> None:
        self.t = t
        self.z = z

    def step(self, t_bound: float) -> str:
        """Arrive."""
        self.t = t_bound
        return ""

    def interpolate(self, t: float) -> FloatArray:
        """Return what never changes."""
        return self.z

    def replace(self, z: FloatArray, dz: FloatArray) -> None:
        """Go on from other values."""
        self.z = z
