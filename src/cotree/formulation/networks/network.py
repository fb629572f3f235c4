"""The solved scalar networks of a scene: from components to the rates of their states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.components import Kind
from cotree.dag.nodes import STATE, UNKNOWN, Node, symbols_in
from cotree.equations import Guard, PositionRow, State
from cotree.formulation.fields import is_varying
from cotree.formulation.networks.solve_plan import Solved, make_plan, solve_plan
from cotree.formulation.networks.states import (
    Redundant,
    algebraic_state,
    held_variables,
    position_trees,
    redundant_values,
    state_of,
    summed_positions,
)
from cotree.formulation.networks.stores import contents_of, find_stores
from cotree.formulation.networks.terminals import Terminals
from cotree.formulation.networks.topology import Topology
from cotree.formulation.networks.unilateral_forces import (
    Holding,
    check_friction,
    holding_of,
    holding_ports,
    reacting_fields,
    used_by_friction,
)
from cotree.formulation.networks.variable_names import Names
from cotree.scene.networks import Port, scalar_graphs, scalar_ports
from cotree.scene.normal_trees import NormalTree, normal_trees

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cotree.formulation.networks.couplings import Coupling
    from cotree.formulation.networks.rules import Variable
    from cotree.formulation.system import System
    from cotree.graph import LinearGraph
    from cotree.scene.description import SceneDescription


@dataclass(frozen=True)
class Network:
    """The scalar networks of a scene and their solution."""

    ports: Mapping[str, Port]  # ports with an edge in a scalar graph
    #: The graphs and their normal trees, by domain.
    graphs: Mapping[str, LinearGraph]
    trees: Mapping[str, NormalTree]
    states: tuple[State, ...]  # states of storages and springs, then algebraic unknowns
    solved: Solved  # values of all variables that states and outputs require
    #: Variables that are the rates of states or the residuals of algebraic unknowns.
    rates: tuple[Variable, ...]
    guards: tuple[Guard, ...]  # conditions that parameter values must satisfy
    observed: Mapping[str, Variable]  # variables used by outputs and other fields, by name
    positions: tuple[PositionRow, ...]  # positions that are sums of states
    redundant: tuple[Redundant, ...]  # initial values of variables that are not states
    #: Values whose rates jump at unknown times, with the symbols on which these times depend.
    kinks: Mapping[str, frozenset[Node]]
    #: Symbols of the mechanism that occur only in fields of friction and dampers on it. They may be
    #: reactions, since such a field is determined together with the accelerations.
    of_friction: frozenset[Node]
    names: Names  # names of network variables in the scene
    holding: tuple[Holding, ...]  # friction and stops on the mechanism whose forces are multipliers

    @property
    def watched(self) -> tuple[Variable, ...]:
        """Variables that are required besides the rates of the states."""
        return (*self.observed.values(), *(row.variable for row in self.redundant))

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
) -> tuple[dict[str, Port], dict[str, LinearGraph], dict[str, NormalTree]]:
    """Return the ports of a scene, its scalar graphs and their normal trees."""
    ports = scalar_ports(scene)
    graphs = scalar_graphs(ports)
    return ports, graphs, normal_trees(graphs, ports)


def form_network(
    scene: SceneDescription,
    system: System,
    couplings: Mapping[str, Coupling],
    wanted: Sequence[str],
    *,
    is_motion: Callable[[str], bool],
    has_multipliers: bool,
) -> tuple[Network, dict[str, Node]]:
    """Form the equations of a scene's scalar networks, and the nodes of the ``wanted`` names.

    The states of ``system`` precede the states of the networks. ``is_motion`` returns whether a
    name denotes a position or velocity of the mechanism. With ``has_multipliers``, the forces of
    friction and stops on the mechanism are multipliers, and their fields that depend on forces or
    accelerations are algebraic unknowns; otherwise the forces are algebraic unknowns.

    Raise TopologyError if a graph has no normal tree, FormulationError if no inertia determines
    whether dry friction sticks, ParameterError or ExpressionError for invalid fields.
    """
    ports, graphs, trees = draw_networks(scene)
    topologies = {domain: Topology(domain, tree.across) for domain, tree in trees.items()}
    # With ideal amplifiers, f-circuits and f-cutsets have different trees.
    cutsets = {
        domain: Topology(domain, tree.through) if tree.is_split else topologies[domain]
        for domain, tree in trees.items()
    }
    check_friction(ports, topologies)
    contents = contents_of(ports, lambda port, name: _is_constant(scene, port, name))
    stores = find_stores(ports, topologies, cutsets, contents)
    names = Names(ports, topologies, stores)
    used = {*wanted, *_used_by_fields(ports)}
    positions = position_trees(graphs, ports, topologies, used)
    held = held_variables(ports, topologies, positions, stores, used)
    dag = system.dag
    # State vector: coordinates, speeds and modes of the mechanism, network states, unknowns.
    n_before = len(system.coordinates) + len(system.speeds) + len(system.modes)
    symbols = {item.variable: dag.symbol(STATE, n_before + i) for i, item in enumerate(held)}
    fields, measured, guards, active = _bind_fields(ports, symbols, names, system)
    moving = {system.signals.node(name) for name in system.signals.measured if is_motion(name)}
    held_ports = holding_ports(ports) if has_multipliers else []
    # Numbered downwards, because other multipliers are numbered upwards, after the accelerations.
    multipliers = {name: dag.symbol(UNKNOWN, -1 - i) for i, name in enumerate(held_ports)}
    reacting = reacting_fields(ports, held_ports, fields, measured, moving.__contains__)
    swaps = {swap.control.name: swap for tree in trees.values() for swap in tree.swaps}
    # Add the open edges that measure controlling variables; the scene has no such edges.
    all_ports = ports | {name: swap.control for name, swap in swaps.items()}
    terminals = Terminals(
        all_ports,
        topologies,
        cutsets,
        positions,
        symbols,
        fields,
        measured,
        system.time,
        couplings,
        stores,
        contents,
        frozenset(mode.symbol for mode in system.modes if mode.symbol.op == "symbol"),
        swaps,
        multipliers,
        reacting,
    )
    # Only required variables: rates of states, names in use, and redundant initial values.
    rates = tuple(item.rate for item in held)
    observed = {name: found for name in wanted if (found := names.variable(name)) is not None}
    at = dag, system.of_parameters
    redundant = redundant_values(ports, held, *at)
    roots = [*rates, *observed.values(), *(row.variable for row in redundant)]
    # If a sum of contents is a state, the variable that it determines is always an unknown.
    roots += [store.unknown for store in stores.values()]
    plan = make_plan(terminals, roots)
    # Algebraic unknowns are numbered after all states that have a rate.
    first = n_before + len(held)
    solved = solve_plan(
        terminals,
        plan,
        lambda i: dag.symbol(STATE, first + i),
        lambda block: all(
            v[1] not in active and _is_passive(all_ports, trees, v)
            for v in (*block.unknowns, *block.inner)
        ),
        is_static=first == 0,
    )
    states = [state_of(item, symbols[item.variable], *at) for item in held]
    for (quantity, name), symbol in solved.algebraic.items():
        if quantity == "field":
            states.append(_field_state(all_ports, name, symbol))
        else:
            states.append(algebraic_state(all_ports[name], quantity, symbol, *at))
    own = (*(item.variable for item in held), *solved.algebraic)
    places = {variable: n_before + i for i, variable in enumerate(own)}
    network = Network(
        ports,
        graphs,
        trees,
        tuple(states),
        solved,
        (*rates, *solved.residuals),
        (*guards, *terminals.guards.values()),
        observed,
        summed_positions(ports, topologies, positions, used, places),
        # The initial value of an algebraic unknown is a guess for the start, not a condition.
        tuple(row for row in redundant if row.variable not in solved.algebraic),
        terminals.kinks,
        used_by_friction(ports, fields),
        names,
        tuple(holding_of(ports[name], symbol, fields) for name, symbol in multipliers.items()),
    )
    return network, {name: solved.values[variable] for name, variable in observed.items()}


def _field_state(ports: Mapping[str, Port], name: str, symbol: Node) -> State:
    edge, _, field = name.partition("|")
    row = next(p.edge.component.field(field) for p in ports.values() if p.edge.name == edge)
    unit = row.unit if row else ""
    zero = symbol.dag.zero
    return State(f"{edge}.{field}", unit, symbol, zero, is_given=False, is_algebraic=True)


def _is_constant(scene: SceneDescription, port: Port, name: str) -> bool:
    field = port.edge.fields.get(name)  # time and potentials are not fields
    return field is not None and all(
        n in scene.parameters or n == "pi"
        for n in field.names  # type: ignore[union-attr]
    )


def _used_by_fields(ports: Mapping[str, Port]) -> set[str]:
    values = (value for port in ports.values() for value in port.edge.law_fields.values())
    return {name for value in values for name in value.names}  # type: ignore[union-attr]


def _is_passive(
    ports: Mapping[str, Port], trees: Mapping[str, NormalTree], variable: Variable
) -> bool:
    port = ports.get(variable[1])
    if port is None:
        return True
    # Pivots of ideal couplings may vanish for some ratios.
    is_own = port.terminal.is_passive and port.kind is not Kind.COUPLED
    tree = trees.get(port.terminal.domain)
    return is_own and not (tree is not None and tree.is_split)


def _bind_fields(
    ports: Mapping[str, Port], symbols: Mapping[Variable, Node], names: Names, system: System
) -> tuple[dict[tuple[str, str], Node], dict[Node, Variable], list[Guard], set[str]]:
    """Return the nodes of all components' fields, and the edges that may supply power."""
    fields: dict[tuple[str, str], Node] = {}
    symbol_of: dict[Variable, Node] = {}
    guards: dict[tuple[Node, bool, str], Guard] = {}
    active: set[str] = set()

    def resolve(name: str) -> Node:
        variable = names.variable(name)
        if variable is None:
            # An output may contain variables of the networks.
            return system.signals.node(name, resolve)
        if variable in symbols:
            return symbols[variable]
        if variable not in symbol_of:
            # A symbol represents the variable until its value is known.
            symbol_of[variable] = system.dag.symbol("network", len(symbol_of))
        return symbol_of[variable]

    def ask(guard: Guard) -> None:
        if guard.value.value is None:
            # If several edges share a value, only the first edge is named.
            guards.setdefault((guard.value, guard.is_strict, guard.breach), guard)
        else:
            guard.check(guard.value.value)

    for edge in {port.edge.name: port.edge for port in ports.values()}.values():
        for field, value in edge.law_fields.items():
            row = edge.component.field(field)
            assert row is not None  # the scene has checked that the component has this field
            # Constant fields may be needed by ``prepare``, which knows only parameters.
            resolver = system.of_parameters if row.constant else resolve
            node = value.lower(system.dag, resolver)  # type: ignore[union-attr]
            fields[edge.name, field] = node
            system.dag.note_origin(node, f"{field} of edge '{edge.name}'")
            # A source whose value depends on another variable is a controlled source.
            if not row.sign and not set(symbol_of.values()).isdisjoint(symbols_in([node])):
                active.add(edge.name)
            if row.sign and not is_varying(node):
                what = f"{field} of edge '{edge.name}'"
                at_scene = system.at_scene(node) if row.sign == "nonzero" else 1.0
                if not at_scene > 0.0:
                    active.add(edge.name)
                    breach = "be negative, as in the scene" if at_scene else "not be zero"
                    ask(Guard(-node, what, True, f"must {breach}"))
                else:
                    ask(Guard(node, what, row.sign != "nonnegative"))
        for demand in edge.component.demands:
            arguments = {name: fields[edge.name, name] for name in demand.law.arguments}
            node = demand.law.value(system.dag, arguments)
            # Values that change during a run cannot be checked before the run.
            if not is_varying(node):
                ask(Guard(node, f"edge '{edge.name}'", True, demand.breach))
    # Network variables in fields are symbols, which are arguments of the field.
    measured = {symbol: variable for variable, symbol in symbol_of.items()}
    return fields, measured, list(guards.values()), active
