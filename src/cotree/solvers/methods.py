"""The table of methods, and what they refuse.

In: a method's name. Out: its row, by which :mod:`cotree.solvers.select` finds what runs it, or the
sentence by which it refuses a problem. A new method of a known family is one row of ``METHODS``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.errors import SolveError, nearest
from cotree.solvers.problem import corner_times

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.solvers.problem import Problem


# Algebraic unknowns leave a dense Jacobian once eliminated: C takes none of more states than this.
_MOST_REDUCED = 2000


@dataclass(frozen=True)
class Method:
    """One row of the table of methods."""

    name: str  # the user's name for it
    #: "cotree", "scipy", "sundials" or, of SUNDIALS' integrators that have vectors of their own for
    #: sensitivities, "correctors".
    family: str
    implicit: bool  # whether it uses a Jacobian
    multistep: bool  # whether a step builds on those before
    #: The method that stands in where C cannot run this one; of correctors and SciPy's methods, for
    #: which none does, the method that the refusal names.
    instead: str = ""
    #: The unit of C that takes its steps, a name in ``codegen.integrators.STEPPERS``; empty for
    #: SciPy's.
    stepper: str = ""
    #: Whether C always integrates algebraic unknowns, and never solves for them at each evaluation.
    keeps_algebraic: bool = False
    #: The number that SUNDIALS gives to the corrector of sensitivities with vectors of their own.
    corrector: int = 0


_ROWS = (
    # SciPy's RK45 is the pair of Dormand and Prince, too; of Fehlberg's pair, with which the paper
    # integrates its example, SciPy has none.
    Method("dopri5", "cotree", False, False, "RK45", "dopri5"),
    Method("rkf45", "cotree", False, False, "RK45", "rkf45"),
    Method("dop853", "cotree", False, False, "DOP853", "dop853"),
    Method("rodas4", "cotree", True, False, "Radau", "rodas4", keeps_algebraic=True),
    Method("rodas5", "cotree", True, False, "Radau", "rodas5", keeps_algebraic=True),
    Method("RK45", "scipy", False, False, "dopri5"),
    Method("DOP853", "scipy", False, False, "dop853"),
    Method("RK23", "scipy", False, False, "dopri5"),
    Method("Radau", "scipy", True, False, "rodas5"),
    Method("BDF", "scipy", True, True, "cvode"),
    Method("LSODA", "scipy", True, True, "cvode"),
    Method("cvode", "sundials", True, True, "BDF", "cvode"),
    # IDA's equations need not be solved for the rates.
    Method("ida", "sundials", True, True, "BDF", "ida", keeps_algebraic=True),
    # SUNDIALS numbers its correctors: 1 is simultaneous, 2 is staggered.
    Method("cvodes", "correctors", True, True, "cvode", "cvodes", corrector=2),
    Method("cvodes-simultaneous", "correctors", True, True, "cvode", "cvodes", corrector=1),
    Method("idas", "correctors", True, True, "ida", "idas", keeps_algebraic=True, corrector=2),
)

METHODS: Mapping[str, Method] = {row.name: row for row in _ROWS}


def method_row(method: str) -> Method:
    """Return a method's row of the table.

    Raises
    ------
    SolveError
        If no method has this name; the message gives the nearest one.
    """
    if method not in METHODS:
        raise SolveError(f"There is no method '{method}'{nearest(method, [*METHODS, 'auto'])}")
    return METHODS[method]


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
