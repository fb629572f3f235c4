"""The outcome of every solver."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def _no_events() -> FloatArray:
    return np.zeros((0, 2))


@dataclass(frozen=True)
class Statistics:
    """Work done by one integration.

    Attributes
    ----------
    method : str
        Name of the method that ran, never "auto".
    nfev, njev : int
        Calls of the right-hand side, those for differences included, and state Jacobians.
    nlu : int
        Factorisations, 0 where the solver does not report them.
    n_steps : int
        Accepted steps.
    seconds : float
        Wall-clock time, [s].
    compile_seconds : float
        Wall-clock time that the C of the method itself took before, once on a machine, [s].
    began_with : str
        The method that ran before it, up to where the problem became stiff; or empty. The other
        numbers count both.
    """

    method: str
    nfev: int
    njev: int
    nlu: int
    n_steps: int
    seconds: float
    compile_seconds: float = 0.0
    began_with: str = ""


@dataclass(frozen=True, eq=False)
class Drift:
    """A measure of how well a constrained motion satisfies its constraints.

    Attributes
    ----------
    names : tuple of str
        Constraints, their rates, and norms of quaternions less one.
    residual : ndarray, shape (n_rows, n_t)
        Their residuals at the stored points, in their own units. A point that could not be
        projected, the last one of a failed integration, has its residuals as they are.
    correction : float
        The largest change that a projection made to a state, divided by that state or by 1 where
        it is less. A step's own error is part of it, so it grows with the tolerances.
    """

    names: tuple[str, ...]
    residual: FloatArray
    correction: float

    @property
    def worst(self) -> float:
        """Return the largest residual of all rows and points."""
        return float(np.max(np.abs(self.residual), initial=0.0))


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The outcome of an integration, complete or not."""

    #: Times, [s]. After a failure the last one is that of the last good point, whether it was asked
    #: for or not.
    t: FloatArray
    z: FloatArray  # states and sensitivities at these times
    status: int  # 0 for success, -1 for a failed integration, -2 for a spent budget
    message: str  # one or two sentences
    statistics: Statistics  # work done
    #: Residuals of the constraints along the run; None where there are no constraints.
    drift: Drift | None = None
    #: The events that happened, in order, a row each: time, [s], number of the event, derivatives
    #: of the time by the parameters, states before, and states after.
    events: FloatArray = field(default_factory=_no_events)
    #: Whether it failed because equations could not be solved, however short the step.
    is_unsolved: bool = False
