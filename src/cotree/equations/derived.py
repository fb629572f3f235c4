"""Parameters and variables of networks that follow from others, and are no arguments."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from cotree.dag.symbols import PARAMETER
from cotree.dag.traverse import symbols_in
from cotree.errors import listed

if TYPE_CHECKING:
    from cotree.dag.nodes import Node


@dataclass(frozen=True)
class DerivedParameter:
    """A parameter that follows from others.

    Attributes
    ----------
    name, unit, doc : str
        As of other parameters.
    text : str
        The expression that gives it, as the scene has it.
    node : Node
        Its value, of the symbols of parameters.
    arguments : tuple of str
        Names of all parameters that are arguments, in the order of their symbols.
    """

    name: str
    unit: str
    doc: str
    text: str
    node: Node = field(repr=False)
    arguments: tuple[str, ...] = field(repr=False)

    @property
    def sources(self) -> tuple[str, ...]:
        """The parameters that it follows from and a run may change."""
        symbols = symbols_in([self.node])
        places = sorted(symbol.data[1] for symbol in symbols if symbol.data[0] == PARAMETER)
        return tuple(self.arguments[place] for place in places)

    @property
    def told(self) -> str:
        """Say that it cannot be chosen, and what it is made of."""
        shown = listed(f"'{source}'" for source in self.sources)
        tail = f"; it follows from {shown}" if shown else ""
        return f"parameter '{self.name}' is derived, {self.name} = {self.text}{tail}"


@dataclass(frozen=True)
class RedundantRow:
    """An initial value of a variable that is not a state but follows from states.

    Attributes
    ----------
    name : str
        Of the variable.
    states : tuple of str
        The states that the variable follows from.
    is_position : bool
        Whether it is a position, which follows along an f-circuit.
    """

    name: str
    states: tuple[str, ...]
    is_position: bool = False


@dataclass(frozen=True)
class PositionRow:
    """A position that is no state: the sum of those along its f-circuit.

    Attributes
    ----------
    name, unit : str
        Of the position.
    terms : tuple of (int, int)
        Signs, and the states by their numbers.
    """

    name: str
    unit: str
    terms: tuple[tuple[int, int], ...]

    def sum_of(self, values: Any) -> Any:
        """Sum an array of states, or of their sensitivities, along its last axis."""
        return sum(sign * values[..., i] for sign, i in self.terms)
