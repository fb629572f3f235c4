"""The outcome of one start of the optimiser."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class StartRecord:
    """The outcome of one start of the optimiser.

    Attributes
    ----------
    began, theta : ndarray, shape (n_estimated,)
        First and best values of the estimated parameters on their scales.
    objective : float
        The objective at the best point; infinite if no run succeeded.
    n_evaluations : int
        Number of evaluations of the predictions.
    is_converged : bool
        Whether the optimiser met its tolerances.
    message : str
        Reason for termination.
    optimality : float
        The largest entry of the gradient where the optimiser ended, each times the distance to the
        bound that it points to; nan if it was interrupted.
    """

    began: Array
    theta: Array
    objective: float
    n_evaluations: int
    is_converged: bool
    message: str
    optimality: float = math.nan
