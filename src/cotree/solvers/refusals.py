"""Refusals of problems by methods, before anything is built."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.methods import METHODS
from cotree.solvers.problem import corner_times

if TYPE_CHECKING:
    from cotree.solvers.problem import Problem


# Algebraic unknowns leave a dense Jacobian once eliminated: C takes none of more states than this.
_MOST_REDUCED = 2000


def refusal(method: str, problem: Problem) -> str:
    """Describe, before anything is built, why C cannot solve a checked problem; else empty."""
    row = METHODS[method]
    if problem.native is None:
        return problem.not_native
    if row.family == "correctors" and problem.events is not None:
        return "there are events"
    # Own methods take problems without any rate; SUNDIALS needs one to integrate.
    if row.family == "cotree":
        return _dependent(problem) if row.implicit else ""
    if problem.n_states == problem.n_algebraic:
        return "there are no states"
    # Methods that solve for the unknowns at each evaluation iterate with the reduced Jacobian.
    is_reduced = problem.n_algebraic > 0 and not row.keeps_algebraic
    if is_reduced and problem.n_states > _MOST_REDUCED:
        return f"more than {_MOST_REDUCED} states have algebraic unknowns beside them"
    return ""


def beyond_scipy(problem: Problem) -> str:
    """Name what of a problem SciPy's methods do not take, as a phrase; empty if they take it."""
    if problem.events is not None:
        return f"events, such as '{problem.events.rows[0].name}'"
    if problem.n_algebraic:
        unknowns = problem.names[problem.n_states - problem.n_algebraic :]
        return "algebraic unknowns" + (f", such as '{unknowns[0]}'" if unknowns else "")
    if problem.held is not None:
        return f"constraints, such as '{problem.constraints[0]}'"
    if problem.has_corners:
        return "laws with corners, which have to be located"
    if not problem.n_states:
        return "a problem without states"
    if problem.n_sensitivities and problem.shifts.rows_at(corner_times(problem)[:-1])[0].any():
        return "sensitivities to parameters that move a corner of a source"
    return ""


def _dependent(problem: Problem) -> str:
    """Describe which constraints depend on each other at the start; empty if none do.

    Stages of Rosenbrock methods are off the constraints, which then contradict each other.
    """
    edges = (
        () if problem.singular is None else problem.singular(problem.settings.t_span[0], problem.z0)
    )
    names = ", ".join(f"'{edge}'" for edge in edges)
    return f"constraints of {names} are dependent at the start" if edges else ""
