"""Errors of runs against a reference on which two methods agree.

In: a model and times. Out: a ``Reference``, with the two methods that made it and how far they are
apart, which bounds the errors that it can resolve.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cotree.errors import Error, SolveError
from cotree.solvers.methods import METHODS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from cotree.results import Result

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

# Methods with their tolerances, best first: formulas of different families, of high order. Those of
# BDF lose digits to rounding in their many steps at tolerances as tight as the first one's. Events
# are taken by cvode and the last two alone.
_EXPLICIT_FIRST = (
    ("DOP853", 1e-13),
    ("Radau", 1e-12),
    ("LSODA", 1e-12),
    ("cvode", 1e-12),
    ("dop853", 1e-13),
    ("rodas5", 1e-12),
)
_IMPLICIT_FIRST = (
    ("Radau", 1e-12),
    ("cvode", 1e-12),
    ("BDF", 1e-12),
    ("LSODA", 1e-12),
    ("DOP853", 1e-13),
    ("rodas5", 1e-12),
    ("dop853", 1e-13),
)


@dataclass(frozen=True, eq=False)
class Solution:
    """States and sensitivities that one method gives, to compare.

    Attributes
    ----------
    method : str
        The method.
    rtol : float
        Its relative tolerance.
    y : ndarray, shape (n_states, n_t)
        States.
    s : ndarray, shape (n_states, n_parameters, n_t)
        Their sensitivities.
    """

    method: str
    rtol: float
    y: Array
    s: Array

    def distance(self, other: Solution | Result) -> tuple[float, float]:
        """Return the error of another solution, of its states and of its sensitivities.

        Returns
        -------
        states, sensitivities : float
            max |y - ref| / max(1, max |ref|) over points and states, and the same over points,
            states and parameters: max |ref| is that over the points, of each state and of each
            sensitivity on its own. nan where there are none.
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
        """Say in a line which methods agree, and to what."""
        sensitivities = (
            ""
            if math.isnan(self.agreement_sensitivities)
            else f", of sensitivities to {self.agreement_sensitivities:.1e}"
        )
        return (
            f"{self.solution} and {self.other} agree to {self.agreement_states:.1e}{sensitivities}"
        )


def worse(*errors: float) -> float:
    """Give the largest error, without those that are nan since there is nothing to compare."""
    return max((error for error in errors if not math.isnan(error)), default=math.nan)


def find_reference(run: Callable[[str, float], Result], is_stiff: bool) -> Reference:
    """Solve by different methods at tight tolerances until two agree.

    Parameters
    ----------
    run : callable
        ``run(method, rtol)`` gives a result at the points to compare.
    is_stiff : bool
        Whether to begin with implicit methods.

    Returns
    -------
    Reference
        The first two that agree to 1e-10, or else the two of all that agree best.

    Raises
    ------
    SolveError
        If no two agree to 1e-6.
    """
    solutions: list[Solution] = []
    pairs: list[Reference] = []
    notes: list[str] = []
    for method, rtol in _IMPLICIT_FIRST if is_stiff else _EXPLICIT_FIRST:
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
    """Tell whether a method that was chosen for a problem shows it to be stiff."""
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
