"""Errors of runs against a reference on which two methods agree.

In: a model and times. Out: a ``Reference``, with the two methods that made it and how far they are
apart, which bounds the errors that it can resolve.
"""

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

#: What an error is, for tables and pictures.
ERROR = "largest |y - ref| / max(1, max |ref|)"
#: The same relative to the own size of each quantity, however small.
OWN_ERROR = "largest |y - ref| / max |ref|"

# A quantity whose two references differ by more than this share of it has no digits to judge by.
_TOLD = 1e-2

# Where the ends of two methods agree to this, no further method is asked: it is a tenth of the
# tightest error that a method is recommended for.
_ENOUGH = 1e-10
# Beyond this nothing can be said of any method.
_TOO_FAR = 1e-6

# Methods, best first: formulas of different families, of high order. Events, constraints and
# algebraic unknowns are taken by cvode, dop853 and rodas5 alone.
_EXPLICIT_FIRST = ("DOP853", "Radau", "LSODA", "cvode", "dop853", "rodas5")
_IMPLICIT_FIRST = ("Radau", "cvode", "BDF", "LSODA", "DOP853", "rodas5", "dop853")

# Relative tolerances of explicit methods, and of the others, which lose digits to rounding in their
# many steps at one as tight as that.
_TIGHTEST, _TIGHT = 1e-13, 1e-12


@dataclass(frozen=True, eq=False)
class Solution:
    """States and sensitivities that one method gives, to compare."""

    method: str
    rtol: float  # its relative tolerance
    y: Array  # states
    s: Array  # their sensitivities

    def distance(self, other: Solution | Result) -> tuple[float, float]:
        """Return the error of another solution, of its states and of its sensitivities.

        They are max |y - ref| / max(1, max |ref|) over points and states, and the same over points,
        states and parameters: max |ref| is that over the points, of each state and of each
        sensitivity on its own. nan if there are none.
        """
        return _error(other.y, self.y), _error(other.s, self.s)

    def __str__(self) -> str:
        """Name the method with its tolerance."""
        return f"{self.method} at rtol {self.rtol:.0e}"


@dataclass(frozen=True, eq=False)
class Reference:
    """A solution on which two different methods agree.

    Attributes
    ----------
    solution : Solution
        The solution that errors are taken against.
    other : Solution
        The solution that confirms it.
    agreement_states, agreement_sensitivities : float
        The error of one against the other. Smaller errors cannot be told apart from it.
    """

    solution: Solution
    other: Solution
    agreement_states: float
    agreement_sensitivities: float

    @property
    def agreement(self) -> float:
        """Return the larger of the two agreements."""
        return worse(self.agreement_states, self.agreement_sensitivities)

    @property
    def own_agreement(self) -> float:
        """Return the agreement relative to the own sizes of quantities."""
        return worse(*self.own_distance(self.other))

    def own_distance(self, other: Solution | Result) -> tuple[float, float]:
        """Return the error of a solution relative to the own size of each quantity.

        Returns
        -------
        states, sensitivities : float
            max |y - ref| / max |ref| over points and states, and the same of sensitivities. What
            both references are too far apart to tell is left out; nan where nothing is left.
        """
        return (
            _own_error(other.y, self.solution.y, self.other.y),
            _own_error(other.s, self.solution.s, self.other.s),
        )

    def summary(self) -> str:
        """Describe in a line which methods agree, and to what."""
        sensitivities = (
            ""
            if math.isnan(self.agreement_sensitivities)
            else f", of sensitivities to {self.agreement_sensitivities:.1e}"
        )
        return (
            f"{self.solution} and {self.other} agree to {self.agreement_states:.1e}{sensitivities}"
        )


def worse(*errors: float) -> float:
    """Return the largest error, without those that are nan since there is nothing to compare."""
    return max((error for error in errors if not math.isnan(error)), default=math.nan)


def find_reference(run: Callable[[str, float], Result], is_stiff: bool) -> Reference:
    """Solve by different methods at tight tolerances until two agree to 1e-10, or best of all.

    ``run(method, rtol)`` returns a result at the points to compare; ``is_stiff`` begins with
    implicit methods.
    """
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
        # A part of a trajectory has not all the points to compare.
        if not result.success:
            notes.append(f"{method}: {result.message}")
            continue
        found = Solution(method, rtol, result.y, result.s)
        # Any two methods may be the first to agree, so each new solution meets all earlier ones.
        pairs += _pairs(solutions, found)
        solutions.append(found)
        best = min(pairs, key=lambda pair: pair.agreement, default=None)
        # Further methods would only cost time.
        if best is not None and best.agreement <= _ENOUGH:
            return best
    best = min(pairs, key=lambda pair: pair.agreement, default=None)
    if best is None or not best.agreement <= _TOO_FAR:
        said = [pair.summary() for pair in pairs] + notes
        raise SolveError(
            f"no two methods agree to {_TOO_FAR:.0e}, so errors cannot be measured "
            f"({'; '.join(said)}): give a shorter end time, as a chaotic motion needs, or a longer "
            "time limit"
        )
    return best


def _pairs(earlier: list[Solution], found: Solution) -> Iterator[Reference]:
    """Pair each earlier solution, whose method ranks higher, with a new one."""
    for solution in earlier:
        # The earlier solution is the reference, whose size errors are divided by.
        pair = Reference(solution, found, *solution.distance(found))
        if math.isfinite(pair.agreement):
            yield pair


def starts_implicit(method: str) -> bool:
    """Return whether a method that was chosen for a problem shows it to be stiff."""
    return method in METHODS and METHODS[method].implicit


def _own_error(found: Array, reference: Array, other: Array) -> float:
    """Return the largest difference, relative to the own size of each quantity that is known."""
    if reference.size == 0:
        return math.nan
    size = np.max(np.abs(reference), axis=-1)
    is_told = (size > 0.0) & (np.max(np.abs(other - reference), axis=-1) <= _TOLD * size)
    if not np.any(is_told):
        return math.nan
    largest = float(np.max(np.max(np.abs(found - reference), axis=-1)[is_told] / size[is_told]))
    return largest if math.isfinite(largest) else math.inf


def _error(found: Array, reference: Array) -> float:
    """Return the largest difference, scaled row by row; points lie along the last axis."""
    if reference.size == 0:
        return math.nan
    # Where a quantity never reaches one, its own unit is the scale.
    scale = np.maximum(1.0, np.max(np.abs(reference), axis=-1, keepdims=True))
    largest = float(np.max(np.abs(found - reference) / scale))
    # A value that is not finite is as wrong as can be; nan says that there is nothing to compare.
    return largest if math.isfinite(largest) else math.inf


# Times that differ by less are called equal: compilers and the layout of memory decide on as much.
_LEAST_GAIN = 0.1
# Least times whose ratio is beyond two differ, however noisy a few runs of one of them were.
_MOST = 1.0


@dataclass(eq=False)
class BenchRow:
    """One method at one tolerance.

    Attributes
    ----------
    method : str
        The method.
    rtol, atol : float
        Its tolerances.
    times : list of float
        Times of runs on the clock, states and sensitivities together, [s]; empty where the run
        failed, and where another method stood in.
    first : float
        How long the first run took, [s].
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
        """Median of the times, [s], which passes over runs that the machine has delayed, or nan."""
        return statistics.median(self.times) if self.times else math.nan

    @property
    def least(self) -> float:
        """The shortest of the times, [s], or nan."""
        return min(self.times, default=math.nan)

    @property
    def noise(self) -> float:
        """How far the lower quartile of the times lies above the least, as a share of that."""
        # What disturbs a run only makes it longer: quick ones say how well the least is known.
        times, n = sorted(self.times), len(self.times)
        return times[max(1, n // 4) if n > 1 else 0] / times[0] - 1.0 if times else math.nan

    @property
    def n_runs(self) -> int:
        """Number of runs that the median is taken of."""
        return len(self.times)

    @property
    def success(self) -> bool:
        """Return whether the run reached its end."""
        return self.status == 0

    @property
    def error(self) -> float:
        """Return the larger of both errors."""
        return worse(self.error_states, self.error_sensitivities)

    @property
    def own_error(self) -> float:
        """Return the larger of both errors that are relative to own sizes."""
        return worse(self.own_error_states, self.own_error_sensitivities)

    @property
    def stand_in(self) -> str:
        """Return the method that computed the row in place of the one that it names, or nothing."""
        ran = self.method if self.statistics is None else self.statistics.method
        return "" if ran == self.method else ran

    @property
    def note(self) -> str:
        """Describe why there are no numbers, or who stood in; nothing where the row is complete."""
        if not self.success:
            return self.message
        return f"{self.stand_in} stood in: not timed" if self.stand_in else ""

    @property
    def spread(self) -> float:
        """Return how far the median lies above the least time, as a share of that."""
        return self.seconds / self.least - 1.0


def fastest(rows: Iterable[BenchRow]) -> tuple[BenchRow, ...]:
    """Return the fastest row, with those that are within its noise, one of each method.

    Least times that differ by less than a tenth, or by less than the noise of either, are equal.
    Rows stay in their order, whatever the noise.
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
