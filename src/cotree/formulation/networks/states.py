"""States of the networks: states of storages, integrals such as stretches, algebraic unknowns."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

from cotree.components import Kind, content_of, integral_of
from cotree.domains import DOMAINS
from cotree.equations import PositionRow, State
from cotree.errors import ParameterError
from cotree.formulation.networks.topology import Topology
from cotree.formulation.networks.variable_names import state_name
from cotree.graph import select_tree

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from collections.abc import Set as AbstractSet

    from cotree.components import Terminal
    from cotree.dag.nodes import Dag, Node
    from cotree.formulation.fields import Resolver
    from cotree.formulation.networks.rules import Variable
    from cotree.formulation.networks.stores import Total
    from cotree.graph import LinearGraph
    from cotree.scene.networks import Port


@dataclass(frozen=True)
class Held:
    """A port variable that is a state."""

    port: Port
    quantity: str  # ``across``, ``through``, ``stretch`` or ``total`` (of contents)
    #: Name of the variable without the name of the port, and unit of the variable.
    short: str
    unit: str

    @property
    def name(self) -> str:
        """Name of the state."""
        return state_name(self.port, self.short)

    @property
    def variable(self) -> Variable:
        """The variable that is the state."""
        return self.quantity, self.port.name

    @property
    def rate(self) -> Variable:
        """The variable that is the rate of the state."""
        return f"{self.quantity}_rate", self.port.name


class _Use(IntEnum):
    """Reasons to choose an edge as a branch of the tree of positions, most important first."""

    BALANCE = 0  # a balance of springs determines its stretch
    GIVEN = 1  # has an initial value
    LAW = 2  # the terminal equation depends on the variable
    NAMED = 3  # used in a field, an output or an event
    NONE = 4


def position_trees(
    graphs: Mapping[str, LinearGraph],
    ports: Mapping[str, Port],
    topologies: Mapping[str, Topology],
    used: AbstractSet[str],
) -> dict[str, Topology]:
    """Choose the trees of positions; branches whose position is needed are states.

    In order of preference, branches are springs whose stretch a balance of springs determines,
    edges with an initial value, edges whose laws depend on their position, and edges in ``used``;
    equal edges are in the scene's order. Positions of chords follow from f-circuits ([1] eq. 2).
    """
    found = {}
    for domain, graph in graphs.items():
        if DOMAINS[domain].stretch:
            branches = topologies[domain].branches
            uses = {name: _use(ports[name], branches, used) for name in graph.edge_names}
            tree = select_tree(graph, uses)
            found[domain] = Topology(domain, tree, "stretch", "distance")
    return found


def _use(port: Port, branches: AbstractSet[str], used: AbstractSet[str]) -> _Use:
    if port.kind is Kind.SPRING and port.name in branches:
        return _Use.BALANCE
    item = _held(port, "stretch")
    if item.short in port.initial:
        return _Use.GIVEN
    if _uses_stretch(port):
        return _Use.LAW
    # A name may contain the port or not.
    return _Use.NAMED if {item.name, f"{port.name}.{item.short}"} & used else _Use.NONE


def held_variables(
    ports: Mapping[str, Port],
    topologies: Mapping[str, Topology],
    positions: Mapping[str, Topology],
    stores: Mapping[str, Total],
    used: AbstractSet[str],
) -> list[Held]:
    """Return the states of the networks; integrals are states if they are used or initialised."""
    found = []
    for port in ports.values():
        if port.is_coupling:
            # The multibody system determines the motion of the port; only the integral is a state.
            if port.terminal.integral is not None:
                found.append(_held(port, "stretch"))
            continue
        is_branch = port.name in topologies[port.terminal.domain].branches
        _check_content(port, stores.get(port.name))
        # In a normal tree, across storages are branches and through storages are chords. Other
        # storages depend on the states of these.
        if port.name in stores:
            found.append(Held(port, "total", *stores[port.name].symbol))
        elif port.kind is Kind.ACROSS_STORAGE and is_branch:
            found.append(_held(port, "across"))
        elif port.kind is Kind.THROUGH_STORAGE and not is_branch:
            found.append(_held(port, "through"))
        # A position is a state if its edge is a branch; an integral of the component always is.
        is_held = port.terminal.integral is not None or (
            port.terminal.domain in positions
            and port.name in positions[port.terminal.domain].branches
        )
        if is_held and _use(port, topologies[port.terminal.domain].branches, used) in _HELD:
            found.append(_held(port, "stretch"))
    return found


#: Reasons for which the position of a branch is a state.
_HELD = (_Use.GIVEN, _Use.LAW, _Use.NAMED)


def summed_positions(
    ports: Mapping[str, Port],
    topologies: Mapping[str, Topology],
    positions: Mapping[str, Topology],
    used: AbstractSet[str],
    places: Mapping[Variable, int],
) -> tuple[PositionRow, ...]:
    """Return the positions that are sums of states and that fields or outputs use."""
    rows = []
    for domain, topology in positions.items():
        for name in topology.tree.chords:
            if _use(ports[name], topologies[domain].branches, used) not in _HELD:
                continue
            along = topology.along(name).items()
            # A stretch that a balance of springs determines is no state: omit sums that contain it.
            if all(("stretch", branch) in places for branch, _ in along):
                item = _held(ports[name], "stretch")
                terms = tuple((sign, places["stretch", branch]) for branch, sign in along)
                rows.append(PositionRow(item.name, item.unit, terms))
    return tuple(rows)


def _check_content(port: Port, store: Total | None) -> None:
    """Raise an error if a content has an initial value but depends on other contents."""
    content = content_of(port.terminal)
    # The content of a single storage is a state, which has this initial value itself.
    if content is None or content[0] not in port.initial or (store and store.is_alone):
        return
    row, is_across = DOMAINS[port.terminal.domain], port.kind is Kind.ACROSS_STORAGE
    symbol = row.across_symbol if is_across else row.through_symbol
    raise ParameterError(
        f"'{state_name(port, content[0])}' cannot have an initial value of its own, since "
        f"'{port.name}' is connected to other storages or to sources: give initial values of "
        f"'{symbol}' instead"
    )


def _held(port: Port, quantity: str) -> Held:
    row = DOMAINS[port.terminal.domain]
    if quantity == "stretch":
        integral = integral_of(port.terminal)
        assert integral is not None
        return Held(port, quantity, integral.name, integral.unit)
    if quantity == "across":
        return Held(port, quantity, row.across_symbol, row.across_unit)
    return Held(port, quantity, row.through_symbol, row.through_unit)


def _uses_stretch(port: Port) -> bool:
    if _names(port.terminal, "stretch"):
        return True
    siblings = port.edge.component.ports
    return any(_names(other, f"stretch_{port.terminal.port}") for other in siblings)


def _names(terminal: Terminal, argument: str) -> bool:
    laws = [terminal.across, terminal.through, terminal.storage, terminal.content]
    if terminal.stop is not None:
        laws += [terminal.stop.upper_gap, terminal.stop.lower_gap]
    return any(argument in law.arguments for law in laws if law is not None)


def state_of(item: Held, symbol: Node, dag: Dag, of_parameters: Resolver) -> State:
    """Return the entry of a state; raise an error if two initial values follow from each other."""
    initial = _initial(item, dag, of_parameters)
    is_given = item.short in item.port.initial
    # States other than totals have a single name.
    if item.quantity != "total":
        return State(item.name, item.unit, symbol, initial, is_given=is_given)
    quantity = "across" if item.port.kind is Kind.ACROSS_STORAGE else "through"
    follows = _held(item.port, quantity)
    # A charge and its voltage determine each other, so only one of them may have an initial value.
    if is_given and follows.short in item.port.initial:
        raise ParameterError(
            f"edge '{item.port.edge.name}' gives initial values of both '{item.name}' and "
            f"'{follows.name}', which follow from each other: remove one"
        )
    return State(item.name, item.unit, symbol, initial, is_given=is_given, follower=follows.name)


def algebraic_state(
    port: Port, quantity: str, symbol: Node, dag: Dag, of_parameters: Resolver
) -> State:
    """Return the entry of a port's algebraic unknown; its initial value is only a guess."""
    # A rate has no name and unit in scenes, so the name and unit of the variable are used.
    item = _held(port, quantity.removesuffix("_rate"))
    guess = _initial(item, dag, of_parameters)
    return State(item.name, item.unit, symbol, guess, is_given=False, is_algebraic=True)


def _initial(item: Held, dag: Dag, of_parameters: Resolver) -> Node:
    value = item.port.initial.get(item.short)
    return dag.zero if value is None else value.lower(dag, of_parameters)  # type: ignore[union-attr]


@dataclass(frozen=True)
class Redundant:
    """An initial value of a variable that follows from states and sources."""

    name: str  # name of the variable
    variable: Variable
    given: Node  # initial value as a function of parameters


def redundant_values(
    ports: Mapping[str, Port], held: Iterable[Held], dag: Dag, of_parameters: Resolver
) -> list[Redundant]:
    """Return the initial values, except guesses, of variables that follow from the states."""
    # States have their initial values directly; all other initial values must agree with them.
    known = {item.variable for item in held}
    return [
        Redundant(item.name, item.variable, _initial(item, dag, of_parameters))
        for port in ports.values()
        for item in _given(port)
        if item.variable not in known and not _may_be_guess(item)
    ]


def _given(port: Port) -> list[Held]:
    quantities = ["across", "through"]
    if integral_of(port.terminal) is not None:
        quantities.append("stretch")
    items = (_held(port, quantity) for quantity in quantities)
    return [item for item in items if item.short in port.initial]


#: Kinds of variables that follow from states and sources. Other variables may be unknowns of
#: nonlinear equations, for which initial values are guesses.
_FOLLOWING = {
    Kind.ACROSS_SOURCE: ("across",),
    Kind.ACROSS_STORAGE: ("across", "through"),
    Kind.THROUGH_STORAGE: ("across", "through"),
    Kind.SPRING: ("across", "through"),
    Kind.THROUGH_SOURCE: ("through",),
}


def _may_be_guess(item: Held) -> bool:
    kind = item.port.kind
    if item.quantity == "stretch":
        return False  # an f-circuit or the mechanism determines the variable
    # In a cutset of springs, the stretch of a nonlinear spring is an unknown of an equation.
    is_bent = kind is Kind.SPRING and item.port.terminal.storage is None
    return is_bent or item.quantity not in _FOLLOWING.get(kind, ())
