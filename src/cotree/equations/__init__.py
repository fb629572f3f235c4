"""The narrow waist: governing and sensitivity equations, as nodes, with no graph and no C."""

from __future__ import annotations

from cotree.equations.corner import CornerRow
from cotree.equations.derivative import Derivative, spread, substituted
from cotree.equations.derived import DerivedParameter, PositionRow, RedundantRow
from cotree.equations.equations import (
    ConstraintSet,
    Equations,
    EventRow,
    Guard,
    Quantity,
    State,
)

__all__ = [
    "ConstraintSet",
    "CornerRow",
    "Derivative",
    "DerivedParameter",
    "Equations",
    "EventRow",
    "Guard",
    "PositionRow",
    "Quantity",
    "RedundantRow",
    "State",
    "spread",
    "substituted",
]
