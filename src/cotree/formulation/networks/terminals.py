"""The rules of all network variables: f-circuits, f-cutsets and terminal equations."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

from cotree.components import Kind, integral_of
from cotree.dag.continuity import kink_symbols
from cotree.dag.derivative import tangents
from cotree.dag.nodes import symbols_in
from cotree.domains import DOMAINS
from cotree.errors import FormulationError
from cotree.formulation.fields import guards_of, is_timed
from cotree.formulation.networks.rules import (
    FieldRule,
    Lawful,
    Sum,
    Unknown,
    across_residual,
    explicit_residual,
    friction_residual,
    higher_index,
    holding_laws,
    rate_of,
    spring_rate,
    spring_residual,
    spring_stretch,
    stop_residual,
    stored_rate,
    stored_residual,
    stored_value,
    through_residual,
)
from cotree.formulation.networks.stores import is_of_content
from cotree.formulation.networks.unilateral_forces import limit_law
from cotree.formulation.networks.variable_names import argument_of
from cotree.scene.networks import GIVES, Swap

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.components import Law
    from cotree.dag.nodes import Node
    from cotree.equations import Guard
    from cotree.formulation.networks.couplings import Coupling
    from cotree.formulation.networks.rules import Rule, Variable
    from cotree.formulation.networks.stores import Total
    from cotree.formulation.networks.topology import Topology
    from cotree.scene.networks import Port


@dataclass(frozen=True)
class Terminals:
    """Topology and terminal equations of all networks, which yield the rule of each variable."""

    ports: Mapping[str, Port]  # edges of all scalar graphs, by name
    #: By domain: graphs with the trees of across variables, of through variables and of positions.
    topologies: Mapping[str, Topology]
    cutsets: Mapping[str, Topology]
    positions: Mapping[str, Topology]
    states: Mapping[Variable, Node]  # symbols of the variables that are states
    fields: Mapping[tuple[str, str], Node]  # values of the components' fields, by edge and field
    measured: Mapping[Node, Variable]  # variables represented by symbols in fields
    time: Node  # symbol of time in the program
    couplings: Mapping[str, Coupling]  # motion of ports that act on a multibody system
    #: Totals of contents that are states, by the port that defines them.
    stores: Mapping[str, Total]
    contents: Mapping[str, Law]  # contents of storages, by port
    modes: frozenset[Node]  # symbols of the modes, which change only at events
    #: By controlling edge: controlled sources whose laws determine the controlling variables.
    swaps: Mapping[str, Swap]
    #: Multipliers of friction and stops on the mechanism, by port.
    multipliers: Mapping[str, Node]
    #: Fields of friction and stops that depend on forces or accelerations: algebraic unknowns.
    reacting: frozenset[tuple[str, str]]
    #: Conditions on parameters under which values whose rates are used do not jump.
    guards: dict[Node, Guard] = field(default_factory=dict)
    #: Values whose rates jump at unknown times (kinks), and the symbols that determine these times.
    kinks: dict[str, frozenset[Node]] = field(default_factory=dict)

    def is_branch(self, name: str) -> bool:
        """Return whether a port's edge is a branch of the tree of across variables."""
        return name not in self.couplings and name in self.topology(name).branches

    def topology(self, name: str) -> Topology:
        """Return the graph of a port's domain with the tree of across variables."""
        return self.topologies[self.ports[name].terminal.domain]

    def _cutset(self, name: str) -> Topology:
        return self.cutsets[self.ports[name].terminal.domain]

    def rule(self, variable: Variable) -> Rule:
        """Return the rule of a variable."""
        quantity, name = variable
        # The suffix _rate denotes the time derivative of a quantity.
        base, _, rate = quantity.partition("_")
        rate = f"_{rate}" if rate else ""
        if base == "residual":
            return self._residual(rate[1:], name)
        if base in ("path", "potential", "distance"):
            domain, ancestor, node = name.split("|")
            if base == "potential":
                return self.topologies[domain].potential(node, rate)
            graphs = self.positions if base == "distance" else self.topologies
            return graphs[domain].path(ancestor, node, rate)
        if base == "flow":
            return self._cutset(name).flow(name, rate)
        if base == "measure":
            return self._measure(name)
        if base == "limit":
            return self._lawful(self.ports[name], limit_law(self.ports[name], rate[1:]))
        if base in ("total", "content", "stored", "loss"):
            return self._content(base, name, rate)
        if base == "field":
            edge, _, field = name.partition("|")
            if (edge, field) in self.reacting and not rate:
                return Unknown(("residual_field", name))
            return self._field(name, bool(rate))
        if base == "given":
            return self._field(name, is_rate=False)
        if base == "multiplier":
            return FieldRule(self.multipliers[name])
        if base == "stretch":
            return self._stretch(variable)
        if base == "across":
            return self._across(name, rate)
        return self._through(name, rate)

    def _measure(self, name: str) -> Rule:
        edge, _, own = name.partition("|")
        ports = (port for port in self.ports.values() if port.edge.name == edge)
        port = next(ports)
        row = next(row for row in port.edge.component.measures if row.name == own)
        return Sum(tuple((sign, (kind, port.sibling(at))) for sign, kind, at in row.terms))

    def _stretch(self, variable: Variable) -> Rule:
        quantity, name = variable
        port = self.ports[name]
        if name in self.couplings and port.terminal.integral is None:
            motion = self.couplings[name]
            return FieldRule(motion.value if quantity == "stretch" else motion.rate)
        # The rate of a stretch is the law of its integral.
        if quantity != "stretch":
            integral = integral_of(port.terminal)
            assert integral is not None
            return self._lawful(port, integral.rate)
        if variable in self.states:
            return FieldRule(self.states[variable])
        if port.is_short:
            return Sum(())  # an edge from a node to itself has no circuit
        positions = self.positions[port.terminal.domain]
        if name not in positions.branches:
            # Positions are like across variables: f-circuits determine those of chords.
            return positions.circuit(name, "")
        if port.terminal.storage is None:
            return Unknown(("residual_stretch", name))
        return self._lawful(port, spring_stretch(port.terminal))

    def _content(self, base: str, name: str, rate: str) -> Rule:
        """Return the rule of a content, of a total of contents, or of a storage's loss."""
        port, store = self.ports[name], self.stores.get(name)
        if base == "content":
            # A total of one content is that content: read the state directly.
            base = "total" if store is not None and store.is_alone else "stored"
        if base == "total":
            assert store is not None
            return Sum(store.flows) if rate else FieldRule(self.states[base, name])
        if base == "stored":
            law = self.contents[name]
            return self._lawful(port, self._rate_of_law(port, law) if rate else law)
        terminal = port.terminal
        loss = terminal.through if port.kind is Kind.ACROSS_STORAGE else terminal.across
        assert loss is not None
        return self._lawful(port, loss)

    def _across(self, name: str, rate: str) -> Rule:
        port = self.ports[name]
        if name in self.couplings:
            motion = self.couplings[name]
            # The mechanism determines the variable, as for a chord parallel to the joint (Eq. (2)).
            return FieldRule(motion.acceleration if rate else motion.rate)
        if port.is_short:
            return Sum(())  # an edge from a node to itself has no circuit
        if self._is_swapped(name, "across"):
            return Unknown((f"residual_across{rate}", name))
        if not self.is_branch(name):
            # The f-circuit determines the across variable of a chord, its law the through variable.
            return self.topology(name).circuit(name, rate)
        if port.kind is Kind.ACROSS_STORAGE:
            if name in self.stores:
                return Unknown((f"residual_across{rate}", name))
            if rate:
                return self._lawful(port, stored_rate(port.terminal, True))
            return FieldRule(self.states["across", name])
        # Other edges of the cutset determine a spring or through storage that is a branch.
        if port.kind is Kind.SPRING and not rate:
            if port.terminal.storage is None:
                return Unknown(("residual_across", name))
            # Springs in a cutset depend on each other: the stretch of this one is not a state.
            law = spring_rate(port.terminal)
        elif port.kind is Kind.THROUGH_STORAGE and not rate:
            law = stored_value(port.terminal, False)
        elif port.terminal.across is not None and port.kind is not Kind.THROUGH_STORAGE:
            law = port.terminal.across
        elif rate:
            raise higher_index(port)
        else:
            return Unknown(("residual_across", name))
        return self._lawful(port, self._rate_of_law(port, law) if rate else law)

    def _through(self, name: str, rate: str) -> Rule:
        port = self.ports[name]
        if name not in self.couplings and name in self._cutset(name).branches:
            # The f-cutset determines the through variable of a branch (Eq. (1)).
            return self._cutset(name).cutset(name, rate)
        if self._is_swapped(name, "through"):
            return Unknown((f"residual_through{rate}", name))
        if name in self.multipliers and not rate:
            return self._lawful(port, holding_laws(port.terminal)[0])
        if port.kind is Kind.THROUGH_STORAGE:
            if name in self.stores:
                return Unknown((f"residual_through{rate}", name))
            if rate:
                return self._lawful(port, stored_rate(port.terminal, False))
            return FieldRule(self.states["through", name])
        if port.kind is Kind.ACROSS_STORAGE and not rate:
            # Other storages of the loop determine an across storage that is a chord.
            law = stored_value(port.terminal, True)
        elif port.terminal.through is not None and port.kind is not Kind.ACROSS_STORAGE:
            law = port.terminal.through
        elif rate:
            raise higher_index(port)
        else:
            return Unknown(("residual_through", name))
        return self._lawful(port, self._rate_of_law(port, law) if rate else law)

    def _is_swapped(self, name: str, quantity: str) -> bool:
        return name in self.swaps and self.swaps[name].quantity == quantity

    def _controlling(self, swap: Swap, rate: str) -> Rule:
        """Return the equation of a controlling variable: variable of the source minus its law."""
        port, gives = swap.source, GIVES[swap.source.kind]
        law = getattr(port.terminal, gives)
        law = self._rate_of_law(port, law) if rate else law
        return self._lawful(port, explicit_residual(f"{gives}{rate}", law))

    def torn(self, variable: Variable) -> Unknown | None:
        """Return a variable's rule as an unknown with an equation; None for sums and fields."""
        quantity, name = variable
        base = quantity.partition("_")[0]
        may_be = base in ("across", "through") or quantity == "stretch"
        if not may_be or isinstance(self.rule(variable), (Sum, FieldRule)):
            return None
        return Unknown((f"residual_{quantity}", name))

    def _residual(self, quantity: str, name: str) -> Rule:
        if quantity == "field":
            return Sum(((1, ("field", name)), (-1, ("given", name))))
        port = self.ports[name]
        terminal = port.terminal
        is_storage = port.kind in (Kind.ACROSS_STORAGE, Kind.THROUGH_STORAGE)
        base, _, rate = quantity.partition("_")
        if self._is_swapped(name, base):
            return self._controlling(self.swaps[name], f"_{rate}" if rate else "")
        if name in self.stores and quantity in ("across", "through"):
            # Residual: the sum of the contents by their laws, minus the total, which is a state. It
            # is zero for the correct voltages or currents.
            parts = ((sign, ("stored", part)) for sign, part in self.stores[name].parts)
            return Sum((*parts, (-1, ("total", name))))
        if name in self.stores and quantity in ("across_rate", "through_rate"):
            return self._lawful(port, stored_residual(terminal, quantity == "across_rate"))
        if quantity == "stretch":
            return self._lawful(port, across_residual(terminal))
        if port.kind is Kind.FRICTION:
            return self._lawful(port, friction_residual(terminal))
        if port.kind is Kind.STOP:
            return self._lawful(port, stop_residual(terminal))
        if quantity == "across" and port.kind is Kind.SPRING:
            return self._lawful(port, spring_residual(terminal))
        if quantity == "across" and not is_storage:
            return self._lawful(port, across_residual(terminal))
        if quantity == "through" and not is_storage:
            return self._lawful(port, through_residual(terminal))
        if (quantity.removesuffix("_rate"), name) in self.states:
            return self._lawful(port, stored_residual(terminal, quantity == "across_rate"))
        rule = self.rule((quantity, name))
        assert isinstance(rule, Lawful)
        return self._lawful(port, explicit_residual(quantity, rule.law))

    def _lawful(self, port: Port, law: Law) -> Lawful:
        graph = self.topologies.get(port.terminal.domain)
        reference = graph.tree.graph.reference if graph else ""
        known = self.fields, reference
        return Lawful(law, tuple((arg, argument_of(port, arg, *known)) for arg in law.arguments))

    def _field(self, name: str, is_rate: bool) -> FieldRule:
        edge, _, field = name.partition("|")
        node = self.time if field == "t" else self.fields[edge, field]
        variables = dict(self.measured)
        if is_rate:
            node, rates = self._rate_of_field(edge, field, node)
            variables |= rates
        symbols = [symbol for symbol in symbols_in([node]) if symbol in variables]
        return FieldRule(node, tuple((symbol, variables[symbol]) for symbol in symbols))

    @cached_property
    def _changing(self) -> dict[Node, Variable]:
        """Variables of all changing symbols in fields, including network states."""
        return {symbol: variable for variable, symbol in self.states.items()} | {**self.measured}

    def _rate_of_field(
        self, edge: str, field: str, node: Node
    ) -> tuple[Node, dict[Node, Variable]]:
        """Return a field's time derivative, and the variables of new symbols in this derivative."""
        one = self.time.dag.one
        moving: dict[Node, Node] = {self.time: one}
        rates: dict[Node, Variable] = {}
        is_known = True
        for symbol in symbols_in([node]):
            if symbol in self._changing:
                quantity, name = self._changing[symbol]
                # Chain rule: the rate of a variable is a further variable, with its own symbol.
                moving[symbol] = self.time.dag.symbol("network_rate", symbol.index)
                rates[moving[symbol]] = (f"{quantity}_rate", name)
            elif symbol in self.modes and is_of_content(self.ports.values(), edge, field):
                continue  # contents of storages are continuous when modes change
            elif symbol.data[0] not in ("p", "t"):
                is_known = False
        what = f"{field} of edge '{edge}'"
        if not is_known:
            reason = "depends on an input or on multibody states"
            raise FormulationError(f"{what} {self._refused(edge, reason)}")
        self._require_continuity(edge, what, node)
        return tangents([node], moving)[0], rates

    def _refused(self, edge: str, reason: str) -> str:
        port = next(port for port in self.ports.values() if port.edge.name == edge)
        return (
            f"{reason}, but its rate of change is needed, since storages are connected to it: "
            "give an expression of t, parameters and states of networks that does not jump, or "
            f"add {DOMAINS[port.terminal.domain].remedy} between them"
        )

    def _require_continuity(self, edge: str, what: str, node: Node) -> None:
        """Raise an error if a value jumps; if the jump depends on parameters only, add a guard."""
        changing, breach = [self.time, *self._changing], self._refused(edge, "jumps")
        for guard in guards_of(node, changing, self.time, what, breach):
            self.guards[guard.value] = guard
        looked_at = kink_symbols(node, changing)
        if looked_at and not is_timed(node, self.time):
            self.kinks[what] = looked_at

    def _rate_of_law(self, port: Port, law: Law) -> Law:
        """Return a law's time derivative; raise an error if a waveform in the law jumps."""
        known = {
            name: self.time if name == "t" else self.fields.get((port.edge.name, name))
            for name in law.arguments
        }
        if port.kind in (Kind.ACROSS_SOURCE, Kind.THROUGH_SOURCE) and None not in known.values():
            value = law.value(self.time.dag, {name: v for name, v in known.items() if v})
            if value not in known.values():  # fields are checked separately
                what = f"{port.edge.component.name} '{port.edge.name}'"
                self._require_continuity(port.edge.name, what, value)
        return rate_of(law)
