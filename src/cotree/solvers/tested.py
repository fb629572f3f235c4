"""Unknowns of a problem that C integrates, and the tolerances of the error test there.

In: a row of the table of methods, and a ``Problem``. Out: places in z, and absolute tolerances.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.solvers.augmented import Tolerances

if TYPE_CHECKING:
    import numpy.typing as npt

    from cotree.solvers.base import FloatArray
    from cotree.solvers.methods import Method
    from cotree.solvers.problem import Problem


def tested(
    row: Method, problem: Problem, *, is_extended: bool
) -> tuple[npt.NDArray[np.intp], FloatArray]:
    """Return the places in z of what C integrates, and their absolute tolerances.

    Parameters
    ----------
    row : Method
        The method.
    problem : Problem
        The problem.
    is_extended : bool
        Whether algebraic unknowns are integrated, too, by an explicit method.

    Returns
    -------
    places : ndarray of int, shape (n,)
    atols : ndarray, shape (..., n)
        See :class:`Tolerances`.
    """
    is_left = is_integrated(row, problem, is_extended=is_extended)
    known = as_tested(row, problem)
    return problem.integrated[is_left], Tolerances(known, is_left).of(known)


def is_integrated(row: Method, problem: Problem, *, is_extended: bool) -> npt.NDArray[np.bool_]:
    """Return which of the entries that do not vanish C integrates."""
    places = problem.integrated
    cut = problem.n_states - (0 if row.keeps_algebraic else problem.n_algebraic)
    # Sensitivities of algebraic unknowns are solved for even where these are integrated.
    lead = problem.n_states if is_extended else cut
    # Those of states that are integrated: of the states themselves up to `lead`, of their
    # sensitivities up to `cut` in each block.
    found: npt.NDArray[np.bool_] = places % problem.n_states < np.where(
        places < problem.n_states, lead, cut
    )
    return found


def as_tested(row: Method, problem: Problem) -> Problem:
    """Return the problem with the sensitivities in the error test where the method leaves them out.

    SUNDIALS leaves sensitivities out of the test itself, at the states' own tolerances.
    """
    return problem.with_settings(error_test_sensitivities=True) if row.corrector else problem
