"""The table of methods.

In: a method's name. Out: its row, by which :mod:`cotree.solvers.select` finds what runs it. A new
method of a known family is one row of ``METHODS``.

Constrained problems are projected between steps. A one-step method goes on from the projected
state after every step. A multistep method remembers states before, which a projection leaves
inconsistent with the new one: it starts anew from a projected state at breakpoints, and every
hundred steps if the correction has become larger than the tolerance. SUNDIALS' integrators, where C
drives them, have the projection within each step. Whatever the method, every
value in the trajectory is projected.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.errors import SolveError, nearest

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True)
class Method:
    """One row of the table of methods.

    Attributes
    ----------
    name : str
        The user's name for it.
    family : str
        "cotree", "scipy", "sundials" or, of SUNDIALS' integrators that have vectors of their own
        for sensitivities, "correctors".
    implicit : bool
        Whether it uses a Jacobian.
    multistep : bool
        Whether a step builds on those before.
    """

    name: str
    family: str
    implicit: bool
    multistep: bool


_ROWS = (
    Method("dopri5", "cotree", False, False),
    Method("rkf45", "cotree", False, False),
    Method("dop853", "cotree", False, False),
    Method("rodas4", "cotree", True, False),
    Method("rodas5", "cotree", True, False),
    Method("RK45", "scipy", False, False),
    Method("DOP853", "scipy", False, False),
    Method("RK23", "scipy", False, False),
    Method("Radau", "scipy", True, False),
    Method("BDF", "scipy", True, True),
    Method("LSODA", "scipy", True, True),
    Method("cvode", "sundials", True, True),
    Method("ida", "sundials", True, True),
    Method("cvodes", "correctors", True, True),
    Method("cvodes-simultaneous", "correctors", True, True),
    Method("idas", "correctors", True, True),
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
