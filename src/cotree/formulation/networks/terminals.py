"""The rule of every variable of the networks: circuits, cutsets and terminal equations by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.components import Kind
from cotree.dag.derivative import tangents
from cotree.dag.traverse import reachable, symbols_in
from cotree.errors import FormulationError
from cotree.formulation.networks.derived import (
    across_residual,
    explicit_residual,
    rate_of,
    stored_rate,
    stored_residual,
    stored_value,
    through_residual,
)
from cotree.formulation.networks.rules import Field, Lawful, Sum, Unknown

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.components import Law
    from cotree.dag.nodes import Node
    from cotree.formulation.networks.rules import Rule, Variable
    from cotree.formulation.networks.topology import Topology
    from cotree.scene.networks import Port


@dataclass(frozen=True)
class Terminals:
    """Gives the rule of a variable.

    Attributes
    ----------
    ports : mapping of str to Port
        The edges of all scalar graphs.
    topologies : mapping of str to Topology
        The graphs with their trees, by domain.
    states : mapping of str to Node
        Symbols of the states of storages and springs, by port.
    fields : mapping of (edge, field) to Node
        Fields of the components.
    measured : mapping of Node to Variable
        What symbols in fields stand for.
    time : Node
        The symbol of time.
    """

    ports: Mapping[str, Port]
    topologies: Mapping[str, Topology]
    states: Mapping[str, Node]
    fields: Mapping[tuple[str, str], Node]
    measured: Mapping[Node, Variable]
    time: Node

    def is_branch(self, name: str) -> bool:
        """Say whether a port's edge is in its tree."""
        return name in self._topology(name).branches

    def _topology(self, name: str) -> Topology:
        return self.topologies[self.ports[name].terminal.domain]

    def above(self, branches: Sequence[str]) -> list[tuple[int, int]]:
        """Give the sign of branches of one tree, and which of them leads to each."""
        return self._topology(branches[0]).above(branches)

    def rule(self, variable: Variable) -> Rule:
        """Give the rule of a variable."""
        quantity, name = variable
        base, _, rate = quantity.partition("_")
        rate = f"_{rate}" if rate else ""
        if base == "residual":
            return self._residual(rate[1:], name)
        if base in ("path", "potential"):
            domain, ancestor, node = name.split("|")
            if base == "potential":
                return self.topologies[domain].potential(node)
            return self.topologies[domain].path(ancestor, node, rate)
        if base == "flow":
            return self._topology(name).flow(name, rate)
        if base == "field":
            return self._field(name, bool(rate))
        if base == "stretch":
            return Field(self.states[name])
        if base == "across":
            return self._across(name, rate)
        return self._through(name, rate)

    def _across(self, name: str, rate: str) -> Rule:
        port = self.ports[name]
        if not self.is_branch(name):
            return self._topology(name).circuit(name, rate)
        if port.kind is Kind.ACROSS_STORAGE:
            if rate:
                return self._lawful(port, stored_rate(port.terminal, True))
            return Field(self.states[name])
        if port.kind is Kind.THROUGH_STORAGE and not rate:
            # In a cutset of its like: its state is theirs.
            law = stored_value(port.terminal, False)
        elif port.terminal.across is not None and port.kind is not Kind.THROUGH_STORAGE:
            law = port.terminal.across
        elif rate:
            raise _higher_index(port)
        else:
            return Unknown(("residual_across", name))
        return self._lawful(port, rate_of(law) if rate else law)

    def _through(self, name: str, rate: str) -> Rule:
        port = self.ports[name]
        if self.is_branch(name):
            return self._topology(name).cutset(name, rate)
        if port.kind is Kind.THROUGH_STORAGE:
            if rate:
                return self._lawful(port, stored_rate(port.terminal, False))
            return Field(self.states[name])
        if port.kind is Kind.ACROSS_STORAGE and not rate:
            # In a loop of its like: its state is theirs.
            law = stored_value(port.terminal, True)
        elif port.terminal.through is not None and port.kind is not Kind.ACROSS_STORAGE:
            law = port.terminal.through
        elif rate:
            raise _higher_index(port)
        else:
            return Unknown(("residual_through", name))
        return self._lawful(port, rate_of(law) if rate else law)

    def torn(self, variable: Variable) -> Unknown | None:
        """Make an unknown of a variable that has an equation of its own; None for sums."""
        quantity, name = variable
        base = quantity.partition("_")[0]
        if base not in ("across", "through") or isinstance(self.rule(variable), (Sum, Field)):
            return None
        return Unknown((f"residual_{quantity}", name))

    def _residual(self, quantity: str, name: str) -> Rule:
        port = self.ports[name]
        terminal = port.terminal
        is_storage = port.kind in (Kind.ACROSS_STORAGE, Kind.THROUGH_STORAGE)
        if quantity == "across" and not is_storage:
            return self._lawful(port, across_residual(terminal))
        if quantity == "through" and not is_storage:
            return self._lawful(port, through_residual(terminal))
        if name in self.states:
            return self._lawful(port, stored_residual(terminal, quantity == "across_rate"))
        rule = self.rule((quantity, name))
        assert isinstance(rule, Lawful)
        return self._lawful(port, explicit_residual(quantity, rule.law))

    def _lawful(self, port: Port, law: Law) -> Lawful:
        return Lawful(law, tuple((arg, self._argument(port, arg)) for arg in law.arguments))

    def _argument(self, port: Port, name: str) -> Variable:
        """Name the variable that an argument of a law stands for."""
        first, _, rest = name.partition("_")
        if first in ("across", "through") and rest != "rate" and not self._is_field(port, name):
            is_rate = rest.startswith("rate_")
            sibling = rest.removeprefix("rate_")
            quantity = f"{first}_rate" if is_rate else first
            return quantity, port.sibling(sibling) if sibling else port.name
        if name in ("across_rate", "through_rate", "stretch"):
            return name, port.name
        if name == "stretch_rate":
            return "across", port.name
        if name.endswith("_rate") and not self._is_field(port, name):
            return "field_rate", f"{port.edge.name}|{name.removesuffix('_rate')}"
        return "field", f"{port.edge.name}|{name}"

    def _is_field(self, port: Port, name: str) -> bool:
        return (port.edge.name, name) in self.fields

    def _field(self, name: str, is_rate: bool) -> Field:
        edge, _, field = name.partition("|")
        node = self.time if field == "t" else self.fields[edge, field]
        if is_rate:
            node = self._rate_of_field(edge, field, node)
        symbols = [symbol for symbol in symbols_in([node]) if symbol in self.measured]
        return Field(node, tuple((symbol, self.measured[symbol]) for symbol in symbols))

    def _rate_of_field(self, edge: str, field: str, node: Node) -> Node:
        """Differentiate a field by time.

        Raises
        ------
        FormulationError
            If it depends on more than time and parameters, or jumps.
        """
        kinds = {symbol.data[0] for symbol in symbols_in([node])}
        jumps = any(item.op in ("select", "sign") for item in reachable([node]))
        if not kinds <= {"p", "t"} or jumps:
            reason = "jumps" if jumps else "depends on an input or on states"
            raise FormulationError(
                f"{field} of edge '{edge}' {reason}, but a storage is tied to it without a "
                "resistance between, so that its rate of change is needed: give a smooth "
                "expression of t and parameters, or put a resistance in series (a storage of "
                "through: in parallel)"
            )
        return tangents([node], {self.time: self.time.dag.one})[0]


def _higher_index(port: Port) -> FormulationError:
    return FormulationError(
        f"the equations of '{port.name}' have a higher index than can be solved: a storage is tied "
        "to its nonlinear law so that the law's rate of change would be needed; put a resistance "
        "between them"
    )
