"""Table of the integration methods."""

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
    #: "cotree", "scipy", "sundials", or "correctors" for the SUNDIALS integrators that keep
    #: sensitivities in separate vectors.
    family: str
    implicit: bool  # whether the method uses a Jacobian
    multistep: bool  # whether a step depends on several previous steps
    #: Method used if C cannot run this one, or suggested instead of SciPy methods and correctors.
    instead: str = ""
    #: Name of the C stepper in ``codegen.c_files.STEPPERS``; empty for SciPy methods.
    stepper: str = ""
    #: Whether algebraic unknowns are always integrated in C, not solved for at each evaluation.
    keeps_algebraic: bool = False
    #: SUNDIALS number of the corrector for sensitivities in separate vectors; zero without one.
    corrector: int = 0


_ROWS = (
    # RK45 is also the Dormand-Prince pair. SciPy lacks the Fehlberg pair of the paper's example.
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
    # IDA solves implicit equations in states and rates.
    Method("ida", "sundials", True, True, "BDF", "ida", keeps_algebraic=True),
    # Correctors of SUNDIALS: 1 is simultaneous, 2 is staggered.
    Method("cvodes", "correctors", True, True, "cvode", "cvodes", corrector=2),
    Method("cvodes-simultaneous", "correctors", True, True, "cvode", "cvodes", corrector=1),
    Method("idas", "correctors", True, True, "ida", "idas", keeps_algebraic=True, corrector=2),
)

METHODS: Mapping[str, Method] = {row.name: row for row in _ROWS}

#: Major and minor SUNDIALS version whose structures ``cotree_sundials.c`` copies.
SUNDIALS_VERSION = (7, 9)

#: SUNDIALS libraries with sensitivities; libraries without them define functions of equal names.
WITH_SENSITIVITIES: Mapping[str, str] = {"cvodes": "cvode", "idas": "ida"}

#: Names of the SUNDIALS libraries.
SUNDIALS = ("cvode", "ida", "cvodes", "idas")


def method_row(method: str) -> Method:
    """Return the table row of a method; raise SolveError with a suggestion if there is none."""
    if method not in METHODS:
        raise SolveError(f"There is no method '{method}'{nearest(method, [*METHODS, 'auto'])}")
    return METHODS[method]


def names_of(family: str, implicit: bool | None = None) -> str:
    """Join the names of all, explicit or implicit methods of a family by commas."""
    rows = [row for row in METHODS.values() if row.family == family]
    return ", ".join(row.name for row in rows if implicit in (None, row.implicit))
