"""Quantities of models by name: what equations, programs and results share, without nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Quantity:
    """A named parameter, input or output, with its unit and meaning."""

    name: str
    unit: str = ""
    doc: str = ""


@dataclass(frozen=True)
class RedundantRow:
    """An initial value of a variable that follows from states."""

    name: str  # of the variable
    states: tuple[str, ...]  # the states from which the variable follows
    is_position: bool = False  # whether it is a position, which follows along an f-circuit


@dataclass(frozen=True)
class PositionRow:
    """A position that is not a state: the sum of those along its f-circuit."""

    #: Of the position.
    name: str
    unit: str
    terms: tuple[tuple[int, int], ...]  # signs, and the states by their numbers

    def sum_of(self, values: Any) -> Any:
        """Sum an array of states, or of their sensitivities, along its last axis."""
        return sum(sign * values[..., i] for sign, i in self.terms)
