"""Parameters that follow from others: no arguments of the program, but nodes of those."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

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
