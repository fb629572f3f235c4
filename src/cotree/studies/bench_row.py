"""A method at a tolerance: one row of a bench, and which rows are fastest as far as times tell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.studies.accuracy import worse

if TYPE_CHECKING:
    from collections.abc import Iterable

    from cotree.solvers.base import Statistics

# Times that differ by less are called equal: compilers and the layout of memory decide on as much.
_LEAST_GAIN = 0.1
# Least times whose ratio is beyond two differ, however noisy a few runs of one of them were.
_MOST = 1.0


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
        run failed, and where another method stood in.
    least : float
        The shortest of these times, [s].
    noise : float
        How far the lower quartile of the times lies above the least, as a share of that.
    n_runs : int
        Number of runs that the median is taken of.
    error_states, error_sensitivities : float
        See :data:`cotree.studies.accuracy.ERROR`; nan where there is nothing to compare.
    own_error_states, own_error_sensitivities : float
        See :data:`cotree.studies.accuracy.OWN_ERROR`.
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
    least: float
    noise: float
    n_runs: int
    error_states: float
    error_sensitivities: float
    own_error_states: float
    own_error_sensitivities: float
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

    @property
    def own_error(self) -> float:
        """Give the larger of both errors that are relative to own sizes."""
        return worse(self.own_error_states, self.own_error_sensitivities)

    @property
    def stand_in(self) -> str:
        """Give the method that computed the row in place of the one that it names, or nothing."""
        ran = self.method if self.statistics is None else self.statistics.method
        return "" if ran == self.method else ran

    @property
    def note(self) -> str:
        """Say why there are no numbers, or who stood in; nothing where the row is complete."""
        if not self.success:
            return self.message
        return f"{self.stand_in} stood in: not timed" if self.stand_in else ""

    @property
    def spread(self) -> float:
        """Give how far the median lies above the least time, as a share of that."""
        return self.seconds / self.least - 1.0


def fastest(rows: Iterable[BenchRow]) -> tuple[BenchRow, ...]:
    """Give the fastest row, with those that are within its noise, one of each method.

    Parameters
    ----------
    rows : iterable of BenchRow
        Rows with times.

    Returns
    -------
    tuple of BenchRow
        More than one where the least times of methods differ by less than a tenth, or by less than
        the noise of either. They stand in the order of the rows, whatever the noise.
    """
    best_of: dict[str, BenchRow] = {}
    for row in rows:
        held = best_of.get(row.method)
        if held is None or row.least < held.least:
            best_of[row.method] = row
    # What disturbs a run makes it longer, never shorter: least times tell most of the methods.
    best = min(best_of.values(), key=lambda row: row.least, default=None)
    if best is None:
        return ()
    return tuple(
        row
        for row in best_of.values()
        if row.least <= best.least * (1.0 + min(_MOST, max(_LEAST_GAIN, best.noise, row.noise)))
    )
