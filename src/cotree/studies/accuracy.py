"""Errors of runs relative to a reference solution on which two methods agree."""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cotree.errors import Error, SolveError
from cotree.methods import METHODS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from cotree.results import Result
    from cotree.solvers.result import Statistics


Array = npt.NDArray[np.float64]

#: Definition of errors, printed with tables and plots.
ERROR = "largest |y - ref| / max(1, max |ref|)"
#: Definition of errors relative to the magnitude of each quantity.
OWN_ERROR = "largest |y - ref| / max |ref|"

# A relative error is measurable if the reference solutions agree within this fraction.
_MEASURABLE = 1e-2

# If two methods agree within this tolerance, no further method is run.
_ENOUGH = 1e-10
# Largest permitted difference between the two solutions of a reference.
_TOO_FAR = 1e-6

# High-order methods of different families for the reference, in order of preference. Only cvode,
# dop853 and rodas5 support events, constraints and algebraic unknowns.
_EXPLICIT_FIRST = ("DOP853", "Radau", "LSODA", "cvode", "dop853", "rodas5")
_IMPLICIT_FIRST = ("Radau", "cvode", "BDF", "LSODA", "DOP853", "rodas5", "dop853")

# Relative tolerances of explicit methods, and of all others, which rounding errors limit.
_TIGHTEST, _TIGHT = 1e-13, 1e-12


@dataclass(frozen=True, eq=False)
class Solution:
    """States and sensitivities computed by one method."""

    method: str
    rtol: float  # relative tolerance of the run
    y: Array  # states at the points in time
    s: Array  # sensitivities of the states

    def distance(self, other: Solution | Result) -> tuple[float, float]:
        """Return the errors of the states and of the sensitivities of another solution.

        An error is the maximum of |y - ref| / max(1, max |ref|) over all times and all states or
        sensitivities, with the maximum of |ref| over time; nan if there are none.
        """
        return _error(other.y, self.y), _error(other.s, self.s)

    def __str__(self) -> str:
        """Return a text with the method and its tolerance."""
        return f"{self.method} at rtol {self.rtol:.0e}"


@dataclass(frozen=True, eq=False)
class Reference:
    """A solution on which two different methods agree.

    Attributes
    ----------
    solution : Solution
        The solution with which runs are compared.
    other : Solution
        The solution that confirms it.
    agreement_states, agreement_sensitivities : float
        Differences between both solutions; smaller errors cannot be measured.
    """

    solution: Solution
    other: Solution
    agreement_states: float
    agreement_sensitivities: float

    @property
    def agreement(self) -> float:
        """The larger of the differences in states and in sensitivities."""
        return worse(self.agreement_states, self.agreement_sensitivities)

    @property
    def own_agreement(self) -> float:
        """Largest difference relative to the magnitude of each quantity."""
        return worse(*self.own_distance(self.other))

    def own_distance(self, other: Solution | Result) -> tuple[float, float]:
        """Return the errors of a solution relative to the magnitude of each quantity.

        Returns
        -------
        states, sensitivities : float
            Maximum of |y - ref| / max |ref| over times and states, and likewise for sensitivities.
            Quantities on which the two reference solutions disagree are omitted; nan if none
            remain.
        """
        return (
            _own_error(other.y, self.solution.y, self.other.y),
            _own_error(other.s, self.solution.s, self.other.s),
        )

    def summary(self) -> str:
        """Return a summary of both methods' results and their agreement."""
        sensitivities = (
            ""
            if math.isnan(self.agreement_sensitivities)
            else f", of sensitivities to {self.agreement_sensitivities:.1e}"
        )
        return (
            f"{self.solution} and {self.other} agree to {self.agreement_states:.1e}{sensitivities}"
        )


def worse(*errors: float) -> float:
    """Return the largest of the errors that are not nan; nan if all are."""
    return max((error for error in errors if not math.isnan(error)), default=math.nan)


def find_reference(run: Callable[[str, float], Result], is_stiff: bool) -> Reference:
    """Run methods at tight tolerances until two agree to 1e-10; otherwise return the best pair."""
    solutions: list[Solution] = []
    pairs: list[Reference] = []
    notes: list[str] = []
    for method in _IMPLICIT_FIRST if is_stiff else _EXPLICIT_FIRST:
        rtol = _TIGHTEST if method.lower() == "dop853" else _TIGHT
        try:
            result = run(method, rtol)
        except Error as error:
            notes.append(f"{method}: {error}")
            continue
        if not result.success:
            notes.append(f"{method}: {result.message}")
            continue
        found = Solution(method, rtol, result.y, result.s)
        # Each new solution is compared with all earlier ones.
        pairs += _pairs(solutions, found)
        solutions.append(found)
        best = min(pairs, key=lambda pair: pair.agreement, default=None)
        if best is not None and best.agreement <= _ENOUGH:
            return best
    best = min(pairs, key=lambda pair: pair.agreement, default=None)
    if best is None or not best.agreement <= _TOO_FAR:
        texts = [pair.summary() for pair in pairs] + notes
        raise SolveError(
            f"no two methods agree to {_TOO_FAR:.0e}, so errors cannot be measured "
            f"({'; '.join(texts)}): give a shorter end time, as chaotic motions need, or a longer "
            "time limit"
        )
    return best


def _pairs(earlier: list[Solution], found: Solution) -> Iterator[Reference]:
    """Pair ``found`` with each earlier solution, which is the reference of the pair."""
    for solution in earlier:
        # Errors are relative to the earlier solution.
        pair = Reference(solution, found, *solution.distance(found))
        if math.isfinite(pair.agreement):
            yield pair


def starts_implicit(method: str) -> bool:
    """Return whether the method chosen for a problem is implicit."""
    return method in METHODS and METHODS[method].implicit


def _own_error(found: Array, reference: Array, other: Array) -> float:
    """Return the largest difference relative to the magnitude of each measurable quantity."""
    if reference.size == 0:
        return math.nan
    size = np.max(np.abs(reference), axis=-1)
    is_measurable = (size > 0.0) & (
        np.max(np.abs(other - reference), axis=-1) <= _MEASURABLE * size
    )
    if not np.any(is_measurable):
        return math.nan
    largest = float(
        np.max(np.max(np.abs(found - reference), axis=-1)[is_measurable] / size[is_measurable])
    )
    return largest if math.isfinite(largest) else math.inf


def _error(found: Array, reference: Array) -> float:
    """Return the largest scaled difference; the last axis is time."""
    if reference.size == 0:
        return math.nan
    # The difference is absolute for quantities below one.
    scale = np.maximum(1.0, np.max(np.abs(reference), axis=-1, keepdims=True))
    largest = float(np.max(np.abs(found - reference) / scale))
    # If a value is not finite, the error is infinite.
    return largest if math.isfinite(largest) else math.inf


# Relative differences of run times below this are due to compilers and memory layout.
_LEAST_GAIN = 0.1
# Run times whose relative difference is larger are different, whatever the noise.
_MOST = 1.0


@dataclass(eq=False)
class BenchRow:
    """Bench results of one method at one tolerance.

    Attributes
    ----------
    method : str
        The method.
    rtol, atol : float
        Its tolerances.
    times : list of float
        Elapsed times of runs, [s]; empty if the first run failed or another method was used.
    first : float
        Elapsed time of the first run, [s].
    error_states, error_sensitivities : float
        Errors as defined by :data:`cotree.studies.accuracy.ERROR`; nan if there are none.
    own_error_states, own_error_sensitivities : float
        Errors as defined by :data:`cotree.studies.accuracy.OWN_ERROR`.
    statistics : Statistics or None
        Numbers of steps and evaluations; None if the run could not start.
    status : int
        0 for success, else negative, as in results of runs.
    message : str
        Message of the solver, or the reason why there was no run.
    """

    method: str
    rtol: float
    atol: float
    times: list[float] = field(default_factory=list)
    first: float = math.nan
    error_states: float = math.nan
    error_sensitivities: float = math.nan
    own_error_states: float = math.nan
    own_error_sensitivities: float = math.nan
    statistics: Statistics | None = None
    status: int = -1
    message: str = ""

    @property
    def seconds(self) -> float:
        """Median of the elapsed times, [s]; nan if there are none."""
        return statistics.median(self.times) if self.times else math.nan

    @property
    def least(self) -> float:
        """Minimum of the elapsed times, [s]; nan if there are none."""
        return min(self.times, default=math.nan)

    @property
    def noise(self) -> float:
        """Lower quartile of the elapsed times divided by their minimum, minus one."""
        # Disturbances only lengthen runs, so the shortest runs show the accuracy of the minimum.
        times, n = sorted(self.times), len(self.times)
        return times[max(1, n // 4) if n > 1 else 0] / times[0] - 1.0 if times else math.nan

    @property
    def n_runs(self) -> int:
        """Number of runs from which the median is computed."""
        return len(self.times)

    @property
    def success(self) -> bool:
        """Whether the run reached its end."""
        return self.status == 0

    @property
    def error(self) -> float:
        """The larger of the errors of states and of sensitivities."""
        return worse(self.error_states, self.error_sensitivities)

    @property
    def own_error(self) -> float:
        """The larger of both errors relative to the magnitude of each quantity."""
        return worse(self.own_error_states, self.own_error_sensitivities)

    @property
    def substitute(self) -> str:
        """Method that replaced this row's method, or an empty string."""
        ran = self.method if self.statistics is None else self.statistics.method
        return "" if ran == self.method else ran

    @property
    def note(self) -> str:
        """Reason why the row has no errors or times; empty if it is complete."""
        if not self.success:
            return self.message
        return f"replaced by {self.substitute}: not timed" if self.substitute else ""

    @property
    def spread(self) -> float:
        """Median of the elapsed times divided by their minimum, minus one."""
        return self.seconds / self.least - 1.0


def fastest(rows: Iterable[BenchRow]) -> tuple[BenchRow, ...]:
    """Return the fastest rows, one per method; times equal within a tenth or the noise are ties."""
    best_of: dict[str, BenchRow] = {}
    for row in rows:
        held = best_of.get(row.method)
        if held is None or row.least < held.least:
            best_of[row.method] = row
    # Disturbances only lengthen runs, so minimum times are compared.
    best = min(best_of.values(), key=lambda row: row.least, default=None)
    if best is None:
        return ()
    return tuple(
        row
        for row in best_of.values()
        if row.least <= best.least * (1.0 + min(_MOST, max(_LEAST_GAIN, best.noise, row.noise)))
    )
