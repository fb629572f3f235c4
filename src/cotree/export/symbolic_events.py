"""Events for people: the expressions they watch and their effects, as SymPy and as plain text."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.export.to_sympy import to_sympy

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from cotree.dag.nodes import Node
    from cotree.equations import Equations

_WAYS = {-1: "falls through", 0: "passes", 1: "rises through"}


@dataclass(frozen=True)
class SymbolicEvent:
    """An event, which happens where an expression passes through zero.

    Attributes
    ----------
    when : sympy.Expr
        The expression.
    direction : int
        -1 for downwards, 1 for upwards, 0 for both.
    set : mapping of str to sympy.Expr
        New values of states and modes by name, as expressions in the values before.
    restitution : sympy.Expr or None
        Of an impact.
    is_stop : bool
        Whether a run ends there.
    is_chosen : bool
        Whether the modes of dry friction and rigid stops are chosen there, all together, in place
        of what it sets.
    """

    when: Any
    direction: int
    set: Mapping[str, Any]
    restitution: Any
    is_stop: bool
    is_chosen: bool = False

    def line(self, name: str, spell: Callable[[Any], str], symbols: Mapping[Any, Any]) -> str:
        """Write the event as plain text.

        Parameters
        ----------
        name : str
            Name of the event.
        spell : callable
            Writes an expression.
        symbols : mapping of str to sympy.Symbol
            By name of a state.
        """
        # Expressions see the values before the event, so that the order of these does not matter.
        actions = [f"{symbols[state]} := {spell(value)}" for state, value in self.set.items()]
        if self.is_chosen:
            why = "is chosen with the modes of all friction and stops"
            actions = [f"{symbols[state]} {why}" for state in self.set]
        if self.restitution is not None:
            actions.append(f"an impact with restitution {spell(self.restitution)}")
        if self.is_stop:
            actions.append("the run ends")
        then = ", ".join(actions) or "it is noted"
        return f"{name}: where {spell(self.when)} {_WAYS[self.direction]} 0, {then}"


def symbolic_events(
    equations: Equations, known: Mapping[Node, Any], states: tuple[str, ...]
) -> dict[str, SymbolicEvent]:
    """Turn the events of equations into SymPy, by name.

    Parameters
    ----------
    equations : Equations
        The equations, whose output values end with the expressions of the events.
    known : mapping of Node to sympy.Symbol
        Spelling of the symbols.
    states : tuple of str
        Names of the states.
    """
    # Places of expressions count from the outputs, which come first.
    first = len(equations.outputs)
    values = dict(enumerate(to_sympy(equations.output_values[first:], known), start=first))
    found = {}
    # An impact sets speeds, too, but by its restitution and not by expressions.
    for row in equations.events:
        kept = zip(row.kept, row.new_values, strict=True)
        new = {states[target]: values[place] for target, place in kept}
        restitution = None if row.restitution is None else values[row.restitution]
        found[row.name] = SymbolicEvent(
            values[row.watched],
            row.direction,
            new,
            restitution,
            row.is_stop,
            row.part > 0,
        )
    return found
