"""Scalar graphs of a scene and their normal trees.

The normal tree takes across sources first, then across storages, dissipators and through
storages, never through sources, so that states are across variables of its storages and through
variables of the cotree's (H. E. Koenig, Y. Tokad, H. K. Kesavan, Analysis of Discrete Physical
Systems, 1967). Of the two ports of a transformer one is a branch and the other a chord; of a
gyrator both are one or the other. Circuits of a graph with ideal amplifiers follow a tree with
their inputs, cutsets one with their outputs; all else is in both or in none.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

from cotree.components import Kind, Role
from cotree.domains import DOMAINS
from cotree.errors import TopologyError
from cotree.graph import GraphEdge, LinearGraph, Tree, select_common_trees, select_tree
from cotree.graph.checks import listed

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from cotree.components import Terminal
    from cotree.scene.description import Edge, FieldValue, SceneDescription
    from cotree.scene.ports import Ends

#: Weights of ports that an ideal coupling makes branches or chords.
_ALWAYS, _NEVER = -1.0, float("inf")

# Couplings up to which all choices of their branches are tried.
_FEW = 8


@dataclass(frozen=True)
class NormalTree:
    """The tree that circuits follow and that which cutsets do; one but for ideal amplifiers.

    Attributes
    ----------
    across, through : Tree
        Of across and of through variables.
    """

    across: Tree
    through: Tree

    @property
    def is_split(self) -> bool:
        """Whether they differ."""
        return self.across is not self.through


@dataclass(frozen=True)
class Port:
    """An edge of a scalar graph: one port of a component.

    Attributes
    ----------
    name : str
        Name of the edge in the graph: the component's, with that of the port where it has several.
    edge : Edge
        The component in the scene.
    terminal : Terminal
        Its terminal equation.
    ends : Ends
        Its nodes, or what it acts on in a multibody system.
    """

    name: str
    edge: Edge
    terminal: Terminal
    ends: Ends

    @property
    def tail(self) -> str:
        """The node where it begins."""
        return self.ends.tail

    @property
    def head(self) -> str:
        """The node where it ends, whose across variable is the greater."""
        return self.ends.head

    @property
    def is_coupling(self) -> bool:
        """Whether it acts on a multibody system in place of a scalar graph."""
        return bool(self.ends.acts_on)

    @property
    def kind(self) -> Kind:
        """Its place in the normal tree."""
        return self.terminal.kind

    @property
    def initial(self) -> dict[str, FieldValue]:
        """What the scene says of its start: ``name``, or ``port.name`` of several ports."""
        given = self.edge.initial
        own = f"{self.terminal.port}."
        named = {key.removeprefix(own): v for key, v in given.items() if key.startswith(own)}
        return {key: v for key, v in given.items() if "." not in key} | named

    def sibling(self, port: str) -> str:
        """Name another port of the same component, by its own name or its number."""
        if port.isdecimal():
            port = self.edge.component.ports[int(port)].port
        return port_name(self.edge, port)


def port_name(edge: Edge, port: str) -> str:
    """Name the edge of a component's port."""
    return f"{edge.name}.{port}" if port else edge.name


def scalar_ports(scene: SceneDescription) -> dict[str, Port]:
    """List the edges of all scalar graphs by name."""
    found = {}
    for edge in scene.edges.values():
        if edge.component.role is Role.NETWORK:
            for terminal, ends in zip(edge.component.ports, edge.ports, strict=True):
                name = port_name(edge, terminal.port)
                found[name] = Port(name, edge, terminal, ends)
    return found


def scalar_graphs(ports: Mapping[str, Port]) -> dict[str, LinearGraph]:
    """Draw the scalar graphs that have edges."""
    graphs = {}
    for domain, row in DOMAINS.items():
        own = [p for p in ports.values() if p.terminal.domain == domain and not p.is_coupling]
        if row.is_scalar and own:
            nodes = dict.fromkeys(["ground", *(n for p in own for n in (p.tail, p.head))])
            edges = (
                GraphEdge(p.name, p.tail, p.head, p.edge.component.name)
                for p in own
                if p.tail != p.head  # the short-circuited junction of a transistor
            )
            graphs[domain] = LinearGraph(domain, tuple(nodes), tuple(edges))
    return graphs


def normal_trees(
    graphs: Mapping[str, LinearGraph], ports: Mapping[str, Port]
) -> dict[str, NormalTree]:
    """Choose the normal tree of each scalar graph.

    Raises
    ------
    TopologyError
        If a part floats, across sources form a loop, only through sources reach a part, or ideal
        transformers or amplifiers leave no choice of branches.
    """
    weights = {name: _weight(port) for name, port in ports.items()}
    for graph in graphs.values():
        for kind in (Kind.NULLATOR, Kind.NORATOR):
            _check_across_sources(graph, ports, kind)
            _check_reached(graph, ports, weights, kind)
    choices = _choices(ports)
    best = None
    few = len(choices) <= _FEW
    for choice in _combinations(choices) if few else [_one_by_one(graphs, ports, weights, choices)]:
        total, trees = _chosen(graphs, ports, weights | choice, choice)
        if trees is not None and (best is None or total < best[0]):
            best = (total, trees)
    if best is None:
        coupled = dict.fromkeys(p.edge.name for p in ports.values() if p.kind is Kind.COUPLED)
        raise TopologyError(
            f"the ports of {listed(coupled)} cannot be one branch and one chord: they are tied to "
            "sources or to each other so that their variables contradict or are undetermined; add "
            "a resistance or a storage"
        )
    return best[1]


def _weight(port: Port) -> float:
    """Order the kinds; among its like, a storage with an initial value keeps its state."""
    if port.is_coupling:
        return _NEVER
    is_linear_spring = port.kind is Kind.SPRING and port.terminal.storage is not None
    if port.kind in (Kind.THROUGH_SOURCE, Kind.NULLATOR, Kind.NORATOR):
        return _NEVER
    if port.kind is Kind.SPRING and not is_linear_spring:
        return _NEVER
    own = float(port.kind.value)
    row, initial = DOMAINS[port.terminal.domain], port.initial
    if port.kind is Kind.ACROSS_STORAGE and row.across_symbol in initial:
        return own - 0.25  # a branch
    if port.kind is Kind.THROUGH_STORAGE and row.through_symbol in initial:
        return own + 0.25  # a chord
    if port.kind is Kind.SPRING and row.stretch in initial:
        return own + 0.25
    # Unknowns of nonlinear equations are better the junctions' own voltages.
    is_implicit = port.kind is Kind.DISSIPATOR and port.terminal.across is None
    return own - (0.25 if is_implicit else 0.0)


def _choices(ports: Mapping[str, Port]) -> list[list[dict[str, float]]]:
    """List, for each ideal coupling, which of its ports may be branches and which chords."""
    couples: dict[str, list[Port]] = {}
    for port in ports.values():
        if port.kind is Kind.COUPLED:
            couples.setdefault(port.edge.name, []).append(port)
    found = []
    for first, second in couples.values():
        law = first.terminal.across
        is_gyrator = law is not None and any(a.startswith("through_") for a in law.arguments)
        pairs = (
            ((_ALWAYS, _ALWAYS), (_NEVER, _NEVER))
            if is_gyrator
            else ((_ALWAYS, _NEVER), (_NEVER, _ALWAYS))
        )
        coupled = {p.name for p in (first, second) if p.is_coupling}
        options = [{first.name: a, second.name: b} for a, b in pairs]
        # What acts on a multibody system takes its motion as it is: a chord.
        found.append([row for row in options if all(row[name] == _NEVER for name in coupled)])
    return found


def _combinations(choices: Sequence[Sequence[dict[str, float]]]) -> Iterator[dict[str, float]]:
    """List all combinations of a few couplings."""
    for chosen in product(*choices):
        yield {name: weight for row in chosen for name, weight in row.items()}


def _one_by_one(
    graphs: Mapping[str, LinearGraph],
    ports: Mapping[str, Port],
    weights: Mapping[str, float],
    choices: Sequence[Sequence[dict[str, float]]],
) -> dict[str, float]:
    """Choose for one coupling after another what weighs least, those after it left open."""
    chosen: dict[str, float] = {}
    for row in choices:
        tried = []
        for option in row:
            total, trees = _chosen(graphs, ports, {**weights, **chosen, **option}, chosen | option)
            tried.append((trees is None, total, option))
        chosen |= min(tried, key=lambda item: item[:2])[2]
    return chosen


def _chosen(
    graphs: Mapping[str, LinearGraph],
    ports: Mapping[str, Port],
    weights: Mapping[str, float],
    choice: Mapping[str, float],
) -> tuple[tuple[int, float], dict[str, NormalTree] | None]:
    """Select trees, and rate them; None where the choice cannot be had.

    The best leave the fewest storages without a state of their own; then by weight.
    """
    trees, total = {}, 0.0
    nothing = (0, 0.0), None
    for domain, graph in graphs.items():
        try:
            trees[domain] = _select(
                graph, ports, {name: weights[name] for name in graph.edge_names}
            )
        except TopologyError:
            if not choice:
                raise
            return nothing
        own = float(Kind.COUPLED.value)
        chosen = [n for n in trees[domain].across.branches if weights[n] != _NEVER]
        total += sum(own if name in choice else weights[name] for name in chosen)
    # What must be a branch: one left out lies in a loop of its like, which contradicts itself.
    given = float(Kind.ACROSS_SOURCE.value)
    wanted = {name for name in weights if weights[name] in (_ALWAYS, given)}
    branches = {name for tree in trees.values() for name in tree.across.branches}
    if not wanted <= branches:
        return nothing
    excess = {True: Kind.THROUGH_STORAGE, False: Kind.ACROSS_STORAGE}
    n_excess = sum(port.kind is excess[name in branches] for name, port in ports.items())
    return (n_excess, total), trees


def _select(
    graph: LinearGraph, ports: Mapping[str, Port], weights: Mapping[str, float]
) -> NormalTree:
    """Select the normal tree of a graph."""
    kinds = {name: ports[name].kind for name in graph.edge_names}
    inputs = [name for name, kind in kinds.items() if kind is Kind.NULLATOR]
    outputs = [name for name, kind in kinds.items() if kind is Kind.NORATOR]
    if not inputs:
        tree = select_tree(graph, weights)
        return NormalTree(tree, tree)
    try:
        made = NormalTree(*select_common_trees(graph, weights, inputs, outputs))
    except TopologyError:
        made = None
    sources = {name for name, kind in kinds.items() if kind is Kind.ACROSS_SOURCE}
    if made is None or not sources <= set(made.across.branches):
        amplifiers = dict.fromkeys(ports[name].edge.name for name in inputs)
        raise TopologyError(
            f"the ideal amplifiers {listed(amplifiers)} leave their outputs undetermined, or "
            "contradict a source: each needs feedback from its output to its input through "
            "resistances or storages"
        )
    return made


def _check_across_sources(graph: LinearGraph, ports: Mapping[str, Port], kind: Kind) -> None:
    """Refuse loops of across sources, and of what an ideal amplifier has of this kind."""
    above: dict[str, str] = {node: node for node in graph.nodes}
    through: dict[str, list[tuple[str, str]]] = {node: [] for node in graph.nodes}

    def top(node: str) -> str:
        while above[node] != node:
            node = above[node]
        return node

    for edge in graph.edges:
        if ports[edge.name].kind not in (Kind.ACROSS_SOURCE, kind):
            continue
        a, b = top(edge.tail), top(edge.head)
        if a == b:
            loop = [*_route(through, edge.tail, edge.head), edge.name]
            what = DOMAINS[graph.domain].across[0]
            raise TopologyError(
                f"{listed(loop)} form a loop of {what} sources in the {graph.domain} graph: their "
                f"{what}s contradict each other or leave the {DOMAINS[graph.domain].through} "
                "undetermined; put a resistance into the loop or take one out"
            )
        above[b] = a
        through[edge.tail].append((edge.head, edge.name))
        through[edge.head].append((edge.tail, edge.name))


def _route(neighbours: Mapping[str, Sequence[tuple[str, str]]], start: str, end: str) -> list[str]:
    """Name the edges from a node to another."""
    came: dict[str, tuple[str, str]] = {start: ("", "")}
    waiting = [start]
    while end not in came:
        node = waiting.pop()
        for other, edge in neighbours[node]:
            if other not in came:
                came[other] = (node, edge)
                waiting.append(other)
    found = []
    while end != start:
        end, edge = came[end]
        found.append(edge)
    return found[::-1]


def _check_reached(
    graph: LinearGraph, ports: Mapping[str, Port], weights: Mapping[str, float], kind: Kind
) -> None:
    """Refuse parts that nothing connects to the ground, or only through sources and springs."""
    everything = _reached(graph, graph.edge_names)
    if floating := [node for node in graph.nodes if node not in everything]:
        raise TopologyError(
            f"the {graph.domain} part with the node {listed(floating)} floats: connect one of its "
            f"nodes to 'ground', where its {DOMAINS[graph.domain].across[0]} is measured from"
        )
    allowed = [n for n in graph.edge_names if weights[n] != _NEVER or ports[n].kind is kind]
    reached = _reached(graph, allowed)
    if cut := [node for node in graph.nodes if node not in reached]:
        own = set(cut)
        edges = [e.name for e in graph.edges if (e.tail in own) != (e.head in own)]
        row = DOMAINS[graph.domain]
        raise TopologyError(
            f"only {listed(edges)} reach the node {listed(cut)} of the {graph.domain} graph: "
            f"their {row.through}s are given, so that its {row.across[0]} is undetermined; add "
            f"{row.remedy} there"
        )


def _reached(graph: LinearGraph, names: Iterable[str]) -> set[str]:
    neighbours: dict[str, list[str]] = {node: [] for node in graph.nodes}
    for name in names:
        edge = graph.edge(name)
        neighbours[edge.tail].append(edge.head)
        neighbours[edge.head].append(edge.tail)
    reached, waiting = {graph.reference}, [graph.reference]
    while waiting:
        for node in neighbours[waiting.pop()]:
            if node not in reached:
                reached.add(node)
                waiting.append(node)
    return reached
