"""Named quantities of models, shared by equations, programs and results."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Quantity:
    """A named parameter, input or output, with unit and description."""

    name: str
    unit: str = ""
    doc: str = ""


@dataclass(frozen=True)
class RedundantRow:
    """A prescribed initial value of a variable that the states determine."""

    name: str  # name of the variable
    states: tuple[str, ...]  # states that determine the variable
    is_position: bool = False  # whether it is a position, which an f-circuit determines


@dataclass(frozen=True)
class PositionRow:
    """A position that is not a state but the sum of the states along its f-circuit."""

    #: Name and unit of the position variable.
    name: str
    unit: str
    terms: tuple[tuple[int, int], ...]  # sign and index of each state in the sum

    def sum_of(self, values: Any) -> Any:
        """Compute the position, or its sensitivity; states are the last axis of ``values``."""
        return sum(sign * values[..., i] for sign, i in self.terms)
