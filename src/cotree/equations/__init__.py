"""The narrow waist: governing and sensitivity equations, as nodes, with no graph and no C."""

from __future__ import annotations

from cotree.equations.equations import (
    ConstraintSet,
    CornerRow,
    Derivative,
    DerivedParameter,
    Equations,
    EventRow,
    Guard,
    HeldUnknown,
    PositionRow,
    Quantity,
    RedundantRow,
    State,
    spread,
    substituted,
)

__all__ = [
    "ConstraintSet",
    "CornerRow",
    "Derivative",
    "DerivedParameter",
    "Equations",
    "EventRow",
    "Guard",
    "HeldUnknown",
    "PositionRow",
    "Quantity",
    "RedundantRow",
    "State",
    "spread",
    "substituted",
]
