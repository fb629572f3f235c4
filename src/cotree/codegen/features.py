"""Parts of the runtime that a model uses: the macros ``COTREE_HAS_...`` of ``cotree_real.h``."""

from __future__ import annotations

from dataclasses import dataclass, fields


@dataclass(frozen=True)
class Features:
    """The parts of the runtime that are compiled; all of them unless said otherwise.

    Attributes
    ----------
    sensitivities : bool
        Whether states have sensitivities.
    inputs : bool
        Whether there are inputs.
    algebraic : bool
        Whether some states satisfy algebraic equations.
    constraints : bool
        Whether states are projected on constraints.
    events : bool
        Whether there are events, or kinks of rates whose times depend on states.
    moving_corners : bool
        Whether there are kinks of rates whose times depend on parameters of sensitivity.
    implicit : bool
        Whether a method takes a Jacobian.
    helper : bool
        Whether another program finds states where iterations fail.
    """

    sensitivities: bool = True
    inputs: bool = True
    algebraic: bool = True
    constraints: bool = True
    events: bool = True
    moving_corners: bool = True
    implicit: bool = True
    helper: bool = True

    def macros(self) -> dict[str, bool]:
        """Return the value of each macro by name."""
        return {
            f"COTREE_HAS_{row.name.upper()}": bool(getattr(self, row.name)) for row in fields(self)
        }


#: What Python's engine is compiled with.
ALL = Features()
