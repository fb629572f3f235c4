"""The table of integration methods.

A new method of a known family is a row of ``METHODS``. Its name then appears in the documentation
of settings and in the help of commands.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.errors import SolveError, nearest

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True)
class Method:
    """A row of the table of methods."""

    name: str  # name of the method in settings
    #: "cotree", "scipy", "sundials" or, for the integrators of SUNDIALS with separate vectors of
    #: sensitivities, "correctors".
    family: str
    implicit: bool  # whether the method uses a Jacobian
    multistep: bool  # whether a step depends on several earlier ones
    #: Method used if C cannot run this one; for methods of SciPy and correctors, the method that
    #: the error suggests.
    instead: str = ""
    #: Stepper in C, a name in ``codegen.c_files.STEPPERS``; empty for SciPy.
    stepper: str = ""
    #: Whether C always integrates algebraic unknowns instead of solving for them at each
    #: evaluation.
    keeps_algebraic: bool = False
    #: Number of the corrector in SUNDIALS, for sensitivities in separate vectors.
    corrector: int = 0


_ROWS = (
    # SciPy's RK45 is the pair of Dormand and Prince, too. SciPy does not have the pair of Fehlberg,
    # which the paper uses for its example.
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
    # The equations for IDA contain the rates implicitly.
    Method("ida", "sundials", True, True, "BDF", "ida", keeps_algebraic=True),
    # Correctors of SUNDIALS: 1 is simultaneous, 2 is staggered.
    Method("cvodes", "correctors", True, True, "cvode", "cvodes", corrector=2),
    Method("cvodes-simultaneous", "correctors", True, True, "cvode", "cvodes", corrector=1),
    Method("idas", "correctors", True, True, "ida", "idas", keeps_algebraic=True, corrector=2),
)

METHODS: Mapping[str, Method] = {row.name: row for row in _ROWS}

#: Major and minor version of the structures in ``cotree_sundials.c``.
SUNDIALS_VERSION = (7, 9)

#: Libraries of SUNDIALS with sensitivities, and those without, whose functions have the same names.
WITH_SENSITIVITIES: Mapping[str, str] = {"cvodes": "cvode", "idas": "ida"}

#: Libraries of SUNDIALS by name.
SUNDIALS = ("cvode", "ida", "cvodes", "idas")


def method_row(method: str) -> Method:
    """Return the row of a method.

    Raises
    ------
    SolveError
        If no method has this name; the message suggests a similar one.
    """
    if method not in METHODS:
        raise SolveError(f"There is no method '{method}'{nearest(method, [*METHODS, 'auto'])}")
    return METHODS[method]


def names_of(family: str, implicit: bool | None = None) -> str:
    """List the names of a family of methods, or of its explicit or implicit ones, with commas."""
    rows = [row for row in METHODS.values() if row.family == family]
    return ", ".join(row.name for row in rows if implicit in (None, row.implicit))
