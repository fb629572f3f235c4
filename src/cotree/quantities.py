"""Quantities of models by name, without nodes; shared by equations, programs and results."""

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
    """An initial value of a variable that follows from states."""

    name: str  # name of the variable
    states: tuple[str, ...]  # states that determine the variable
    is_position: bool = False  # whether it is a position, which an f-circuit determines


@dataclass(frozen=True)
class PositionRow:
    """A position that is not a state: the sum of the states along its f-circuit."""

    #: Name and unit of the position variable.
    name: str
    unit: str
    terms: tuple[tuple[int, int], ...]  # signs and indices of the states that are added

    def sum_of(self, values: Any) -> Any:
        """Sum an array of states, or of their sensitivities, along its last axis."""
        return sum(sign * values[..., i] for sign, i in self.terms)
