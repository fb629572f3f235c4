"""The narrow waist: governing and sensitivity equations, as nodes, with no graph and no C."""

from __future__ import annotations

from cotree.equations.equations import (
    ConstraintSet,
    Derivative,
    Equations,
    EventRow,
    Guard,
    Quantity,
    RedundantRow,
    State,
    spread,
)

__all__ = [
    "ConstraintSet",
    "Derivative",
    "Equations",
    "EventRow",
    "Guard",
    "Quantity",
    "RedundantRow",
    "State",
    "spread",
]
