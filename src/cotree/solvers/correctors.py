"""SUNDIALS' CVODES and IDAS: sensitivities as vectors of their own, driven from C.

In: a ``Problem`` with its native form. Out: a ``Trajectory``. CVODE and IDA take states and
sensitivities as one vector; here each parameter's has its own, so that the error test and the
iteration take the worst of them, not their mean. What solves the equations of a step is the C that
``cvode`` and ``ida`` have. Two correctors (W. F. Feehery, J. E. Tolsma and P. I. Barton, Applied
Numerical Mathematics 25, 1997, for the first; T. Maly and L. R. Petzold, ibid. 20, 1996, for the
second):

- staggered: the states are solved for and tested; then their sensitivities, which costs nothing
  where the states' step is refused;
- simultaneous: one iteration has all of them.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.errors import SolveError
from cotree.solvers.augmented import augmented_tolerances
from cotree.solvers.sundials_c import SundialsJob, load_sundials, solve_in_c
from cotree.solvers.sundials_library import library_path

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.model.newton import Newton
    from cotree.solvers.base import Trajectory
    from cotree.solvers.problem import FloatArray, Problem


@dataclass(frozen=True)
class Corrector:
    """A method's library, its corrector as SUNDIALS counts them, and the method without it."""

    library: str
    number: int
    without: str


#: By method.
CORRECTORS: Mapping[str, Corrector] = {
    "cvodes": Corrector("cvodes", 2, "cvode"),
    "cvodes-simultaneous": Corrector("cvodes", 1, "cvode"),
    "idas": Corrector("idas", 2, "ida"),
}


def solve_with_corrector(problem: Problem, method: str) -> Trajectory:
    """Integrate a checked problem with CVODES or IDAS.

    Parameters
    ----------
    problem : Problem
        It has passed ``check_problem``.
    method : str
        A name in ``CORRECTORS``.

    Raises
    ------
    SolveError
        If the library is not there, or the problem can only be taken by a method that the message
        names.
    """
    corrector = CORRECTORS[method]
    check_library(method)
    found = solve_in_c(problem, method, corrector.library, CorrectorJob)
    if not isinstance(found, str):
        return found
    raise SolveError(
        f"The method '{method}' cannot take this problem: {found}. "
        f"Use '{corrector.without}', which takes states and sensitivities as one vector."
    )


def check_library(method: str) -> None:
    """Refuse a method whose library cannot be used.

    Parameters
    ----------
    method : str
        A name in ``CORRECTORS``.

    Raises
    ------
    SolveError
        If there is no such library, or it is of another version; the message says what to do.
    """
    corrector = CORRECTORS[method]
    reason = library_path(corrector.library).why_not
    if not reason:
        loaded = load_sundials(corrector.library)
        reason = loaded if isinstance(loaded, str) else ""
    if reason:
        raise SolveError(
            f"The method '{method}' cannot be used: {reason}. Or use '{corrector.without}', which "
            "takes states and sensitivities as one vector."
        )


def is_available(method: str) -> bool:
    """Tell whether a method's library can be used; true of those that need none here."""
    if method not in CORRECTORS:
        return True
    try:
        check_library(method)
    except SolveError:
        return False
    return True


class CorrectorJob(SundialsJob):
    """A job of CVODES or IDAS; end it, whatever happens."""

    def _tolerances(self, problem: Problem) -> tuple[float, FloatArray]:
        # SUNDIALS itself leaves sensitivities out of the test, and the states' tolerances alone.
        return augmented_tolerances(dataclasses.replace(problem, error_test_sensitivities=True))

    def _make_aid(self, problem: Problem, newton: Newton | None) -> Any:
        aid = super()._make_aid(problem, newton)
        aid.corrector = CORRECTORS[self.name].number
        return aid
