"""Refusals of problems by methods, before anything is built."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.methods import METHODS
from cotree.solvers.problem import corner_times

if TYPE_CHECKING:
    from cotree.solvers.problem import Problem


# Largest number of states with algebraic unknowns, whose elimination fills the Jacobian.
_MOST_REDUCED = 2000


def refusal(method: str, problem: Problem) -> str:
    """Return why a method in C cannot solve a checked problem; empty if it can."""
    row = METHODS[method]
    if problem.native is None:
        return problem.not_native
    if row.family == "correctors" and problem.events is not None:
        return "there are events"
    # SUNDIALS needs at least one rate.
    if row.family == "cotree":
        return _dependent(problem) if row.implicit else ""
    if problem.n_states == problem.n_algebraic:
        return "there are no states"
    is_reduced = problem.n_algebraic > 0 and not row.keeps_algebraic
    if is_reduced and problem.n_states > _MOST_REDUCED:
        return f"there are algebraic unknowns and more than {_MOST_REDUCED} states"
    return ""


def beyond_scipy(problem: Problem) -> str:
    """Return the part of a problem that SciPy's methods do not support; empty if there is none."""
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
    """Return a message on constraints that are dependent at the start; empty if none are.

    Stages of Rosenbrock methods violate these, which then contradict each other.
    """
    edges = (
        () if problem.singular is None else problem.singular(problem.settings.t_span[0], problem.z0)
    )
    names = ", ".join(f"'{edge}'" for edge in edges)
    return f"constraints of {names} are dependent at the start" if edges else ""
