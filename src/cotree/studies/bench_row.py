"""A method at a tolerance: one row of a bench."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.studies.accuracy import worse

if TYPE_CHECKING:
    from cotree.solvers.base import Statistics


@dataclass(frozen=True)
class BenchRow:
    """One method at one tolerance.

    Attributes
    ----------
    method : str
        The method.
    rtol, atol : float
        Its tolerances.
    seconds : float
        Median time of a run on the clock, states and sensitivities together, [s]; nan where the
        run failed.
    n_runs : int
        Number of runs that the median is taken of.
    error_states, error_sensitivities : float
        See :data:`cotree.studies.accuracy.ERROR`; nan where there is nothing to compare.
    statistics : Statistics or None
        Work done; None where the run could not start.
    status : int
        0 for success, else negative, as in a result.
    message : str
        The solver's report, or the reason why there is no run.
    """

    method: str
    rtol: float
    atol: float
    seconds: float
    n_runs: int
    error_states: float
    error_sensitivities: float
    statistics: Statistics | None
    status: int
    message: str

    @property
    def success(self) -> bool:
        """Tell whether the run reached its end."""
        return self.status == 0

    @property
    def error(self) -> float:
        """Give the larger of both errors."""
        return worse(self.error_states, self.error_sensitivities)
