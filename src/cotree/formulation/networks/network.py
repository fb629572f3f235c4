"""The scalar networks of a scene, solved: from components to rates of their states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.components import Kind
from cotree.domains import DOMAINS
from cotree.equations import Guard, State
from cotree.errors import ParameterError
from cotree.formulation.networks.plan import make_plan
from cotree.formulation.networks.solved import solve_plan
from cotree.formulation.networks.terminals import Terminals
from cotree.formulation.networks.topology import Topology
from cotree.scene.networks import normal_trees, scalar_graphs, scalar_ports

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.formulation.fields import Resolver
    from cotree.formulation.networks.rules import Variable
    from cotree.formulation.networks.solved import Solved
    from cotree.graph import LinearGraph, Tree
    from cotree.scene.description import SceneDescription
    from cotree.scene.networks import Port


@dataclass(frozen=True)
class Surroundings:
    """What the networks see of the rest of the model.

    Attributes
    ----------
    dag : Dag
        The arena.
    time : Node
        The symbol of time.
    n_states : int
        How many states come before theirs.
    of_parameters : callable
        Gives the node of a parameter's name.
    of_everything : callable
        Gives the node of any other name that a field may use.
    """

    dag: Dag
    time: Node
    n_states: int
    of_parameters: Resolver
    of_everything: Resolver


@dataclass(frozen=True)
class Network:
    """The scalar networks of a scene.

    Attributes
    ----------
    ports : mapping of str to Port
        The edges of all scalar graphs.
    graphs, trees : mapping of str to LinearGraph and Tree
        The graphs and their normal trees, by domain.
    states : tuple of State
        States of storages and springs, then algebraic unknowns.
    solved : Solved
        Every variable that states and outputs need.
    rates : tuple of Variable
        The variables that the states' rates are; residuals for algebraic unknowns.
    guards : tuple of Guard
        What parameter values must satisfy.
    observed : mapping of str to Variable
        What outputs and other fields name.
    """

    ports: Mapping[str, Port]
    graphs: Mapping[str, LinearGraph]
    trees: Mapping[str, Tree]
    states: tuple[State, ...]
    solved: Solved
    rates: tuple[Variable, ...]
    guards: tuple[Guard, ...]
    observed: Mapping[str, Variable]

    @property
    def n_differential(self) -> int:
        """Number of states that have a rate."""
        return sum(not state.is_algebraic for state in self.states)

    @property
    def rate_values(self) -> tuple[Node, ...]:
        """Rates of the states, then residuals of the algebraic unknowns."""
        return tuple(self.solved.values[variable] for variable in self.rates)


def draw_networks(
    scene: SceneDescription,
) -> tuple[dict[str, Port], dict[str, LinearGraph], dict[str, Tree]]:
    """List the ports of a scene, draw its scalar graphs and choose their normal trees."""
    ports = scalar_ports(scene)
    graphs = scalar_graphs(ports)
    return ports, graphs, normal_trees(graphs, ports)


def form_network(
    scene: SceneDescription, around: Surroundings, wanted: Sequence[str]
) -> tuple[Network, dict[str, Node]]:
    """Form the equations of the scalar networks of a scene.

    Parameters
    ----------
    scene : SceneDescription
        The scene.
    around : Surroundings
        What the networks see of the rest.
    wanted : sequence of str
        Names that outputs and other fields use: those of the networks are formed.

    Returns
    -------
    network : Network
        The networks.
    observed : dict of str to Node
        What the wanted names stand for, those that are of the networks.

    Raises
    ------
    TopologyError
        If a graph has no normal tree.
    ParameterError, ExpressionError
        If a field or an initial value is wrong.
    """
    ports, graphs, trees = draw_networks(scene)
    topologies = {domain: Topology(domain, tree) for domain, tree in trees.items()}
    names = _Names(ports, topologies)
    holders = [port for port in ports.values() if _has_state(port, topologies)]
    symbols = {
        port.name: around.dag.symbol("x", around.n_states + i) for i, port in enumerate(holders)
    }
    fields, measured, guards = _bind_fields(ports, symbols, names, around)
    terminals = Terminals(ports, topologies, symbols, fields, measured, around.time)
    rates = tuple(_rate(port) for port in holders)
    observed = {name: found for name in wanted if (found := names.variable(name)) is not None}
    plan = make_plan(terminals, [*rates, *observed.values()])
    first = around.n_states + len(holders)
    solved = solve_plan(
        terminals,
        plan,
        lambda i: around.dag.symbol("x", first + i),
        lambda block: all(_is_passive(ports, v) for v in (*block.unknowns, *block.inner)),
    )
    states = [_state(port, symbols[port.name], around, _initial(port, around)) for port in holders]
    _refuse_initials(ports, symbols)
    for (quantity, name), symbol in solved.algebraic.items():
        states.append(_algebraic(ports[name], quantity, symbol, around))
    network = Network(
        ports,
        graphs,
        trees,
        tuple(states),
        solved,
        (*rates, *solved.residuals),
        tuple(guards),
        observed,
    )
    return network, {name: solved.values[variable] for name, variable in observed.items()}


@dataclass(frozen=True)
class _Names:
    """What names of nodes and edges stand for."""

    ports: Mapping[str, Port]
    topologies: Mapping[str, Topology]

    def variable(self, name: str) -> Variable | None:
        """Find the variable of ``edge.symbol``, ``edge.port.symbol`` or ``node.symbol``."""
        first, _, symbol = name.rpartition(".")
        port = self.ports.get(first)
        if port is not None:
            row = DOMAINS[port.terminal.domain]
            if symbol == row.across_symbol:
                return "across", first
            if symbol == row.through_symbol:
                return "through", first
            if symbol and symbol == row.stretch and port.kind is Kind.SPRING:
                return "stretch", first
            return None
        for domain, topology in self.topologies.items():
            graph = topology.tree.graph
            if symbol == DOMAINS[domain].across_symbol and first in graph.nodes:
                return "potential", f"{domain}|{graph.reference}|{first}"
        return None


def _has_state(port: Port, topologies: Mapping[str, Topology]) -> bool:
    """Say whether a storage or spring has a state of its own."""
    is_branch = port.name in topologies[port.terminal.domain].branches
    return (
        (port.kind is Kind.ACROSS_STORAGE and is_branch)
        or (port.kind is Kind.THROUGH_STORAGE and not is_branch)
        or port.kind is Kind.SPRING
    )


def _rate(port: Port) -> Variable:
    if port.kind is Kind.ACROSS_STORAGE:
        return "across_rate", port.name
    if port.kind is Kind.THROUGH_STORAGE:
        return "through_rate", port.name
    return "across", port.name


def _short(port: Port) -> tuple[str, str]:
    """Give symbol and unit of a port's state."""
    row = DOMAINS[port.terminal.domain]
    if port.kind is Kind.ACROSS_STORAGE:
        return row.across_symbol, row.across_unit
    if port.kind is Kind.THROUGH_STORAGE:
        return row.through_symbol, row.through_unit
    return row.stretch, row.stretch_unit


def _initial(port: Port, around: Surroundings) -> Node:
    value = port.edge.initial.get(_short(port)[0])
    if value is None:
        return around.dag.zero
    return value.lower(around.dag, around.of_parameters)  # type: ignore[union-attr]


def _state(port: Port, symbol: Node, around: Surroundings, initial: Node) -> State:
    short, unit = _short(port)
    return State(f"{port.name}.{short}", unit, symbol, initial, is_given=short in port.edge.initial)


def _algebraic(port: Port, quantity: str, symbol: Node, around: Surroundings) -> State:
    """Make the entry of an unknown that stays; its initial value is a guess."""
    row = DOMAINS[port.terminal.domain]
    is_across = quantity == "across"
    short = row.across_symbol if is_across else row.through_symbol
    unit = row.across_unit if is_across else row.through_unit
    value = port.edge.initial.get(short)
    guess = (
        around.dag.zero if value is None else value.lower(around.dag, around.of_parameters)  # type: ignore[union-attr]
    )
    return State(f"{port.name}.{short}", unit, symbol, guess, is_given=False, is_algebraic=True)


def _refuse_initials(ports: Mapping[str, Port], states: Mapping[str, Node]) -> None:
    """Refuse initial values of storages whose state is that of others."""
    for port in ports.values():
        is_storage = port.kind in (Kind.ACROSS_STORAGE, Kind.THROUGH_STORAGE)
        if is_storage and port.name not in states and port.edge.initial:
            raise ParameterError(
                f"edge '{port.name}' has no state of its own, because others like it are tied to "
                "it without a resistance: its initial value follows from theirs; leave it out"
            )


def _is_passive(ports: Mapping[str, Port], variable: Variable) -> bool:
    port = ports.get(variable[1])
    # Pivots of ideal couplings may vanish at some ratios.
    return port is None or (port.terminal.is_passive and port.kind is not Kind.COUPLED)


def _bind_fields(
    ports: Mapping[str, Port],
    symbols: Mapping[str, Node],
    names: _Names,
    around: Surroundings,
) -> tuple[dict[tuple[str, str], Node], dict[Node, Variable], list[Guard]]:
    """Turn the fields of all components into nodes."""
    fields: dict[tuple[str, str], Node] = {}
    measured: dict[Node, Variable] = {}
    guards: dict[tuple[Node, str], Guard] = {}
    of_states = {f"{name}.{_short(ports[name])[0]}": symbol for name, symbol in symbols.items()}

    def resolve(name: str) -> Node:
        if name in of_states:
            return of_states[name]
        variable = names.variable(name)
        if variable is None:
            return around.of_everything(name)
        symbol = around.dag.symbol("network", len(measured))
        known = next((s for s, v in measured.items() if v == variable), None)
        if known is None:
            measured[symbol] = variable
        return known or symbol

    for edge in {port.edge.name: port.edge for port in ports.values()}.values():
        for field, value in edge.fields.items():
            row = edge.component.field(field)
            assert row is not None  # the scene accepted only fields of its component
            resolver = around.of_parameters if row.constant else resolve
            node = value.lower(around.dag, resolver)  # type: ignore[union-attr]
            fields[edge.name, field] = node
            if row.sign and _is_constant(node):
                guard = Guard(node, f"{field} of edge '{edge.name}'", row.sign == "positive")
                if node.value is None:
                    # Where several edges share a value, the first is named.
                    guards.setdefault((node, row.sign), guard)
                else:
                    guard.check(node.value)
    return fields, measured, list(guards.values())


def _is_constant(node: Node) -> bool:
    from cotree.dag.traverse import symbols_in

    return all(symbol.data[0] == "p" for symbol in symbols_in([node]))
