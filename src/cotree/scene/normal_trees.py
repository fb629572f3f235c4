"""Normal trees of the scalar graphs of a scene.

If the tree must contain exactly one port of each transformer, it is a common forest of its graph
and of a second graph in which the two ports are parallel edges. In graphs with ideal amplifiers,
the second graph is that of the through variables. If a controlled source determines its controlling
variable, the controlling edge is a branch in the tree of across variables and the source is a
branch in the tree of through variables, like the input and output of an amplifier. A second graph
cannot express two conditions: that both ports of a gyrator are branches or both are chords, and the
condition for transformers in graphs with amplifiers. The search ignores them at first; if the best
choice violates one of them, it branches on the options of this coupling.

The normal tree contains across sources first, then across storages, dissipators and through
storages, but never through sources. The states are then the across variables of storages in the
tree and the through variables of storages in the cotree (H. E. Koenig, Y. Tokad, H. K. Kesavan,
Analysis of Discrete Physical Systems, 1967). One port of a transformer is a branch and the other
port is a chord; the ports of a gyrator are either both branches or both chords. In a graph with
ideal amplifiers, f-circuits use a tree that contains the inputs, and f-cutsets use a tree that
contains the outputs; all other edges are in both trees or in neither, except controlled sources
that determine their controlling variable (:mod:`cotree.scene.networks`).

A network of sources, positive resistances, storages, transformers and gyrators with a unique
solution has such a tree. Its determinant is a sum of squares, one for each choice of the branches
that are not ports, and a square is zero unless ports complete these branches to a tree (compare A.
Recski, Matroid Theory and its Applications, 1989).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property
from heapq import heappop, heappush
from itertools import count
from typing import TYPE_CHECKING

from cotree.components import Kind, content_of
from cotree.domains import DOMAINS
from cotree.errors import TopologyError, listed
from cotree.graph import GraphEdge, LinearGraph, Tree, select_tree
from cotree.graph.common_forest import Contracted, common_forest
from cotree.graph.linear_graph import walk_edges
from cotree.graph.tree import Parts, path_between
from cotree.scene.networks import GIVES, Port, Swap, swaps_of

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence


#: Change of the number of states if the edge becomes a branch: across storages have states as
#: branches, through storages and springs as chords. The number of states takes priority over all
#: other preferences.
EXCESS = {Kind.ACROSS_STORAGE: -1, Kind.THROUGH_STORAGE: 1, Kind.SPRING: 1}

# Weights are multiples of a quarter and are less than sixteen.
_UNIT, _MOST = 4, 64

# Maximum number of trial choices; a hundred coupled gyrators require a few thousand.
_MOST_TRIED = 20_000


@dataclass(frozen=True)
class _Couple:
    """An ideal coupling. Each of its options states which of its ports and swaps are branches."""

    ports: tuple[str, ...]
    options: tuple[tuple[bool, ...], ...]

    @classmethod
    def of(cls, ports: Sequence[Port], edges: Collection[str], swaps: Sequence[Swap]) -> _Couple:
        first, second = ports
        law = first.terminal.across
        # The across variable of a gyrator's port depends on the through variable of the other port.
        is_gyrator = law is not None and any(a.startswith("through_") for a in law.arguments)
        options: tuple[tuple[bool, ...], ...]
        options = ((True, True), (False, False)) if is_gyrator else ((True, False), (False, True))
        own = [swap.name for swap in swaps if swap.source in ports]
        if own:
            none = (False, False)
            options = (
                *((*row, *none) for row in options),
                (*none, True, False),
                (*none, False, True),
            )
        # Ports on a multibody system have a prescribed motion; short-circuited ports have no edge.
        could = [port.name in edges for port in ports]
        return cls(
            (first.name, second.name, *own),
            tuple(row for row in options if could[0] >= row[0] and could[1] >= row[1]),
        )

    @property
    def is_one_of_two(self) -> bool:
        """Whether the coupling is a transformer, either port of which may be the branch."""
        return self.options == ((True, False), (False, True))

    def is_kept(self, branches: Collection[str]) -> bool:
        """Return whether the given branches satisfy the coupling's condition."""
        return tuple(name in branches for name in self.ports) in self.options


@dataclass(frozen=True)
class _Choice:
    cost: int
    fixed: Mapping[str, bool]
    branches: frozenset[str]


@dataclass(frozen=True)
class CoupledTrees:
    """Graphs whose branches must be chosen together."""

    graphs: Sequence[LinearGraph]
    ports: Mapping[str, Port]  # ports by edge name
    ends: Mapping[str, tuple[str, str]]  # the two nodes of each edge, prefixed by the domain
    costs: Mapping[str, int]  # cost of each edge that may be a branch
    couples: tuple[_Couple, ...]  # ideal couplings of the graphs
    #: Controlled sources that may determine their controlling variable.
    swaps: Mapping[str, Swap]

    @classmethod
    def of(
        cls,
        graphs: Sequence[LinearGraph],
        ports: Mapping[str, Port],
        weights: Mapping[str, float],
        swaps: Sequence[Swap] = (),
    ) -> CoupledTrees:
        """Collect edges of graphs whose trees are chosen together; ``weights`` are preferences."""
        # Graphs share node names, so a prefix distinguishes the nodes in the common forest.
        ends = {edge.name: _ends(ports[edge.name]) for graph in graphs for edge in graph.edges}
        # Costs in descending order: loss of a state, swaps, sum of all other preferences.
        swapped = _MOST * (len(ends) + 1)
        excess = swapped * (len(swaps) + 1)
        costs = {
            name: excess * EXCESS.get(ports[name].kind, 0) + round(_UNIT * weights[name])
            for name in ends
            if weights[name] != float("inf")
        }
        costs |= {swap.name: swapped + excess * EXCESS.get(swap.control.kind, 0) for swap in swaps}
        couples: dict[str, list[Port]] = {}
        for port in ports.values():
            if port.kind is Kind.COUPLED:
                couples.setdefault(port.edge.name, []).append(port)
        pairs = tuple(_Couple.of(both, ends, swaps) for both in couples.values())
        return cls(graphs, ports, ends, costs, pairs, {swap.name: swap for swap in swaps})

    def select(self) -> frozenset[str]:
        """Select the branches that leave the fewest storages without a state."""
        # Couplings that have only one option are decided in advance.
        given = {
            name: row
            for couple in self.couples
            if len(couple.options) == 1
            for name, row in zip(couple.ports, couple.options[0], strict=True)
        }
        best = self._relaxed(given) if all(couple.options for couple in self.couples) else None
        if best is None and self._inputs:
            amplifiers = dict.fromkeys(self.ports[name].edge.name for name in self._inputs)
            raise TopologyError(
                f"the ideal amplifiers {listed(amplifiers)} leave their outputs undetermined, or "
                "contradict a source: each needs feedback from its output to its input through "
                "resistances or storages"
            )
        order = count()
        # Entries are cost, number of violated couplings, a counter that orders equal entries, and
        # the choice. Choices are examined by ascending cost. Ignoring couplings can only lower the
        # cost, so the first choice that satisfies all of them is optimal.
        waiting: list[tuple[int, int, int, _Choice]] = []
        made = [best] if best is not None else []
        while made or waiting:
            for found in made:
                heappush(waiting, (found.cost, len(self._broken(found)), next(order), found))
            *_, best = heappop(waiting)
            broken = self._broken(best)
            if not broken:
                return best.branches
            made = self._either_way(best, broken)
            if next(order) > _MOST_TRIED:
                names = dict.fromkeys(self.ports[couple.ports[0]].edge.name for couple in broken)
                raise TopologyError(
                    f"the branches of {listed(names)} take too long to choose: too many "
                    "gyrators are connected to each other; put a resistance or a storage "
                    "between them"
                )
        names = dict.fromkeys(self.ports[couple.ports[0]].edge.name for couple in self.couples)
        raise TopologyError(
            f"the ports of {listed(names)} cannot be one branch and one chord: sources or "
            "other couplings contradict their variables, or leave them undetermined; add a "
            "resistance or a storage"
        )

    def _broken(self, found: _Choice) -> list[_Couple]:
        """Return the couplings whose conditions a choice violates."""
        return [couple for couple in self.couples if not couple.is_kept(found.branches)]

    def _either_way(self, best: _Choice, broken: Sequence[_Couple]) -> list[_Choice]:
        """Return the best choices for each option of one of the violated couplings."""
        made: list[list[_Choice]] = []
        for couple in broken:
            tried = [
                self._relaxed({**best.fixed, **dict(zip(couple.ports, row, strict=True))})
                for row in couple.options
            ]
            made.append([found for found in tried if found is not None])
            if len(made[-1]) < 2:  # at most one choice remains, so there is nothing to compare
                return made[-1]
        # Branching on the coupling with the most expensive options restricts the search most.
        return max(made, key=lambda pair: sorted(found.cost for found in pair))

    @cached_property
    def _inputs(self) -> list[str]:
        return self._of_kind(Kind.NULLATOR)

    def _of_kind(self, kind: Kind) -> list[str]:
        return [name for name in self.ends if self.ports[name].kind is kind]

    @cached_property
    def _split(self) -> set[str]:
        domains = {self.ports[name].terminal.domain for name in self._inputs}
        domains |= {swap.source.terminal.domain for swap in self.swaps.values()}
        return {name for name in self.ends if self.ports[name].terminal.domain in domains}

    @cached_property
    def _sources(self) -> dict[str, list[str]]:
        """Edges of which one must be chosen, by across source: the source or one of its swaps."""
        found: dict[str, list[str]] = {}
        for name, swap in self.swaps.items():
            for port in (swap.source, swap.control):
                if port.kind is Kind.ACROSS_SOURCE:
                    found.setdefault(port.name, [port.name]).append(name)
        return found

    def _relaxed(self, fixed: Mapping[str, bool]) -> _Choice | None:
        """Select branches with ``fixed`` choices for some couplings; return None if impossible.

        Conditions of all other transformers are satisfied if possible; those of gyrators are
        ignored.
        """
        chosen = [name for name, is_branch in fixed.items() if is_branch]
        given = [n for n in self._of_kind(Kind.ACROSS_SOURCE) if n not in self._sources]
        branches = [*given, *chosen]
        pairs = [
            couple.ports
            for couple in self.couples
            if couple.is_one_of_two
            and couple.ports[0] not in fixed
            and self._split.isdisjoint(couple.ports)
        ]
        # Edges are independent unless at most one of them may be a branch.
        ends = {
            n: pair if n in self._split else (f"{n}+", f"{n}-") for n, pair in self.ends.items()
        }
        ends |= {second: ends[first] for first, second in pairs}
        swaps = self.swaps.items()
        kept = [name for name in branches if self._is_split(name)]
        try:
            # Contracted edges are branches: inputs of amplifiers in the tree of across variables,
            # outputs in the tree of through variables, prescribed branches in both.
            across = Contracted(
                {**self.ends} | {name: _ends(swap.control) for name, swap in swaps},
                [*self._inputs, *branches],
            )
            through = Contracted(
                ends | {name: _ends(swap.source) for name, swap in swaps},
                [*self._of_kind(Kind.NORATOR), *kept],
            )
        except TopologyError:
            return None
        known = {*fixed, *branches}
        must = [*pairs, *self._sources.values()]
        costs = self._open(across, known, must)
        found = common_forest(across, through, costs)
        # The spanning tree of each graph has one branch less than the graph has nodes.
        n_nodes = sum(graph.n_nodes - 1 for graph in self.graphs)
        if len(found) + len(branches) + len(self._inputs) < n_nodes:
            return None
        if any(found.isdisjoint(names) for names in must):
            return None
        cost = sum(self.costs[name] for name in (*found, *chosen))
        return _Choice(cost, fixed, frozenset({*found, *branches}))

    def _open(
        self, across: Contracted, known: Collection[str], must: Sequence[Collection[str]]
    ) -> dict[str, int]:
        """Return the costs of possible branches; one of each set in ``must`` is always chosen."""
        # The bonus exceeds the sum of all costs, so one edge of each set is always chosen.
        bonus = 1 + sum(map(abs, self.costs.values()))
        # A swap may involve two across sources: the controlling one and the controlled one.
        counts = Counter(name for names in must for name in names)
        costs = {name: self.costs[name] - bonus * n for name, n in counts.items()}
        rest = [name for name in self.costs if name not in known and name not in costs]
        # A chosen port replaces the heaviest edge of its circuit: only the lightest forest matters.
        alone = set(across.lightest((n for n in rest if not self._is_split(n)), self.costs))
        return costs | {
            name: self.costs[name] for name in rest if self._is_split(name) or name in alone
        }

    def _is_split(self, name: str) -> bool:
        return name in self._split or name in self.swaps


def _ends(port: Port) -> tuple[str, str]:
    """Return the nodes of a port, with names that differ between graphs."""
    return f"{port.terminal.domain}|{port.tail}", f"{port.terminal.domain}|{port.head}"


#: Weight of edges that are never branches.
_NEVER = float("inf")

#: Maximum preference within a kind; preferences between kinds or for initial values are larger.
_AMONG_LIKE = 0.2


@dataclass(frozen=True)
class NormalTree:
    """The trees for f-circuits and f-cutsets, which are equal without amplifiers or swaps."""

    #: Tree of across variables, and tree of through variables.
    across: Tree
    through: Tree
    #: Controlled sources whose laws determine their controlling variables.
    swaps: tuple[Swap, ...] = ()

    @property
    def is_split(self) -> bool:
        """Whether the two trees differ."""
        return self.across is not self.through


def normal_trees(
    graphs: Mapping[str, LinearGraph], ports: Mapping[str, Port]
) -> dict[str, NormalTree]:
    """Choose the normal tree of each scalar graph."""
    weights = {name: _weight(port) for name, port in ports.items()}
    for port in ports.values():
        _check_short(port)
    try:
        for graph in graphs.values():
            # With ideal amplifiers, one tree contains the inputs and the other tree the outputs.
            for kind in (Kind.NULLATOR, Kind.NORATOR):
                _check_across_sources(graph, ports, kind)
                _check_reached(graph, ports, weights, kind)
        trees = _trees(graphs, ports, weights)
    except TopologyError:
        # If no other tree exists, a controlled source may determine its controlling variable.
        swapped = _swapped(graphs, ports, weights)
        if swapped is None:
            raise
        return swapped
    # Swaps are also tried if they may give an additional storage a state.
    if _are_tied(trees, ports):
        swapped = _swapped(graphs, ports, weights)
        if swapped is not None and _n_displaced(swapped, ports) < _n_displaced(trees, ports):
            return swapped
    return trees


def _swapped(
    graphs: Mapping[str, LinearGraph], ports: Mapping[str, Port], weights: Mapping[str, float]
) -> dict[str, NormalTree] | None:
    """Choose the trees with swaps of controlled sources; return None if there are no swaps."""
    swaps = swaps_of(ports)
    try:
        return _trees(graphs, ports, weights, swaps) if swaps else None
    except TopologyError:
        return None


def _n_displaced(trees: Mapping[str, NormalTree], ports: Mapping[str, Port]) -> int:
    """Count the storages without a state."""
    return sum(len(_displaced(tree, ports)) for tree in trees.values())


def _displaced(tree: NormalTree, ports: Mapping[str, Port]) -> list[str]:
    """Return the storages that have no state because of their position in the tree."""
    branches = set(tree.across.branches)
    return [
        name
        for name in tree.across.graph.edge_names
        if (port := ports.get(name)) is not None
        if port.kind in EXCESS and (name in branches) is (EXCESS[port.kind] > 0)
    ]


def _are_tied(trees: Mapping[str, NormalTree], ports: Mapping[str, Port]) -> bool:
    """Return whether the circuit or cutset of a storage without a state contains a source."""
    # Without such a source, no swap can add a state, because all other exchanges have been tried.
    for tree in trees.values():
        for name in _displaced(tree, ports):
            if ports[name].kind is Kind.ACROSS_STORAGE:
                graph, branches = tree.across.graph, set(tree.across.branches)
                around = path_between(graph, branches, ports[name].tail, ports[name].head)
            else:
                around = _cutset(tree.through, name)
            if any(ports[n].kind in GIVES or ports[n].kind is Kind.COUPLED for n in around):
                return True
    return False


def _cutset(tree: Tree, branch: str) -> list[str]:
    parts = Parts(tree.graph.nodes)
    for name in tree.branches:
        if name != branch:
            parts.join(tree.graph.edge(name).tail, tree.graph.edge(name).head)
    edges = (tree.graph.edge(name) for name in tree.chords)
    return [edge.name for edge in edges if parts.top(edge.tail) != parts.top(edge.head)]


def _trees(
    graphs: Mapping[str, LinearGraph],
    ports: Mapping[str, Port],
    weights: Mapping[str, float],
    swaps: Sequence[Swap] = (),
) -> dict[str, NormalTree]:
    # Graphs that are connected by couplings are chosen together, all others separately.
    tied = {p.terminal.domain for p in ports.values() if p.kind in (Kind.COUPLED, Kind.NULLATOR)}
    tied |= {swap.source.terminal.domain for swap in swaps}
    trees = {}
    for domain, graph in graphs.items():
        if domain not in tied:
            own = {name: weights[name] for name in graph.edge_names}
            if not any(ports[name].terminal.storage for name in own):
                own = _nearest_first(graph, own)
            tree = select_tree(graph, own)
            trees[domain] = NormalTree(tree, tree)
    coupled = [graph for domain, graph in graphs.items() if domain in tied]
    if coupled:
        found = CoupledTrees.of(coupled, ports, weights, swaps).select()
        for graph in coupled:
            trees[graph.domain] = _trees_of(graph, ports, found, swaps)
    return trees


def _nearest_first(graph: LinearGraph, weights: Mapping[str, float]) -> dict[str, float]:
    """Adjust weights so that edges near the reference precede others of the same kind.

    The tree is then shallow, and f-circuits and f-cutsets contain few nonlinear unknowns.
    """
    import networkx

    allowed = [edge for edge in graph.edges if weights[edge.name] != _NEVER]
    drawn = networkx.Graph([(edge.tail, edge.head) for edge in allowed])
    drawn.add_node(graph.reference)
    steps = networkx.single_source_shortest_path_length(drawn, graph.reference)
    found = dict(weights)
    for edge in allowed:
        near = min(steps.get(node, graph.n_nodes) for node in (edge.tail, edge.head))
        # The term is bounded, so nearness decides only between edges of the same kind.
        found[edge.name] += _AMONG_LIKE * near / (near + 1.0)
    return found


def _trees_of(
    graph: LinearGraph, ports: Mapping[str, Port], shared: Collection[str], swaps: Sequence[Swap]
) -> NormalTree:
    own = [s for s in swaps if s.name in shared and s.source.terminal.domain == graph.domain]

    def tree(graph: LinearGraph, kind: Kind, swapped: Collection[str]) -> Tree:
        both = {name for name in graph.edge_names if name in shared or name in swapped}
        both |= {name for name in graph.edge_names if name in ports and ports[name].kind is kind}
        return Tree(graph, tuple(name for name in graph.edge_names if name in both))

    # The tree of through variables has no open edges, because their through variable is zero.
    beside = tuple(
        GraphEdge(s.control.name, s.control.tail, s.control.head, "open")
        for s in own
        if s.control.name not in ports
    )
    with_open = replace(graph, edges=(*graph.edges, *beside)) if beside else graph
    across = tree(with_open, Kind.NULLATOR, {s.control.name for s in own})
    is_split = bool(own) or any(ports[n].kind is Kind.NULLATOR for n in graph.edge_names)
    through = tree(graph, Kind.NORATOR, {s.source.name for s in own})
    return NormalTree(across, through if is_split else across, tuple(own))


def _weight(port: Port) -> float:
    """Return the weight of a port by its kind; storages with an initial value are preferred."""
    if port.is_coupling:
        return _NEVER
    if port.kind.may_hold or port.kind in (Kind.THROUGH_SOURCE, Kind.NULLATOR, Kind.NORATOR):
        return _NEVER
    # Kinds are numbered by their preference as branches; across sources are the lightest. Ports of
    # gyrators weigh as much as dissipators, so that an invalid choice is detected at once.
    own = float((Kind.DISSIPATOR if port.kind is Kind.COUPLED else port.kind).value)
    row, initial = DOMAINS[port.terminal.domain], port.initial
    content = content_of(port.terminal)
    is_given = content is not None and content[0] in initial
    # Variables with an initial value should be states: across of a branch, through of a chord.
    if port.kind is Kind.ACROSS_STORAGE and (is_given or row.across_symbol in initial):
        return own - 0.25  # preferred as a branch
    if port.kind is Kind.THROUGH_STORAGE and (is_given or row.through_symbol in initial):
        return own + 0.25  # preferred as a chord
    if port.kind is Kind.SPRING:
        law = port.terminal.through
        if law is None or "across" in law.arguments:
            return _NEVER
        # If a nonlinear spring is a branch, its elongation is an unknown of an equation.
        is_linear = port.terminal.storage is not None
        return own + 0.25 * (row.stretch in initial) + 0.5 * (not is_linear)
    # Voltages of junctions are better unknowns of nonlinear equations than their currents.
    is_implicit = port.kind is Kind.DISSIPATOR and port.terminal.across is None
    return own - (0.25 if is_implicit else 0.0)


def _check_short(port: Port) -> None:
    """Raise if an edge from a node to itself is undetermined; all other such edges are chords."""
    if not port.is_short or port.kind not in (Kind.ACROSS_SOURCE, Kind.NULLATOR, Kind.NORATOR):
        return
    row = DOMAINS[port.terminal.domain]
    if port.kind is Kind.ACROSS_SOURCE:
        why = f"a {row.across[0]} given there contradicts that or leaves the {row.through}"
    elif port.kind is Kind.NULLATOR:
        why = "an ideal amplifier requires just that, which leaves its output"
    else:
        why = f"an ideal amplifier with its output at its own input leaves its {row.through}"
    raise TopologyError(
        f"'{port.name}' begins and ends at node '{port.head}': between a node and itself the "
        f"{row.across[0]} is zero, and {why} undetermined; remove it or name another node"
    )


def _check_across_sources(graph: LinearGraph, ports: Mapping[str, Port], kind: Kind) -> None:
    """Raise if across sources form a loop with each other or with ports of ideal amplifiers."""
    # If an edge cannot join two parts of the graph, its ends are connected: it closes a loop.
    parts, sources = Parts(graph.nodes), set[str]()
    for edge in graph.edges:
        if ports[edge.name].kind not in (Kind.ACROSS_SOURCE, kind):
            continue
        if not parts.join(edge.tail, edge.head):
            loop = [*path_between(graph, sources, edge.tail, edge.head), edge.name]
            row = DOMAINS[graph.domain]
            raise TopologyError(
                f"{listed(loop)} form a loop of {row.across[0]} sources in the {graph.domain} "
                f"graph: their {row.across[0]}s contradict each other or leave the {row.through} "
                "undetermined; put a resistance into the loop or take one out"
            )
        sources.add(edge.name)


def _check_reached(
    graph: LinearGraph, ports: Mapping[str, Port], weights: Mapping[str, float], kind: Kind
) -> None:
    """Raise if no edge, or no possible branch, connects a node to the ground."""
    everything = _reached(graph, graph.edge_names)
    if floating := [node for node in graph.nodes if node not in everything]:
        raise TopologyError(
            f"the {graph.domain} part with the node {listed(floating)} floats: connect one of "
            f"its nodes to 'ground', the reference of its {DOMAINS[graph.domain].across[0]}"
        )
    # Edges of infinite weight are never branches, so no tree reaches these nodes.
    allowed = [n for n in graph.edge_names if weights[n] != _NEVER or ports[n].kind is kind]
    reached = _reached(graph, allowed)
    if cut := [node for node in graph.nodes if node not in reached]:
        own = set(cut)
        edges = [e.name for e in graph.edges if (e.tail in own) != (e.head in own)]
        row = DOMAINS[graph.domain]
        one, alone = len(edges) == 1, len(cut) == 1
        raise TopologyError(
            f"only {'edge' if one else 'edges'} {listed(edges)} {'reaches' if one else 'reach'} "
            f"the {'node' if alone else 'nodes'} {listed(cut)} of the {graph.domain} graph: "
            f"{'its' if one else 'their'} {row.through}{'' if one else 's'} "
            f"{'is' if one else 'are'} given, so that the {row.across[0]} there is undetermined; "
            f"add {row.remedy} there"
        )


def _reached(graph: LinearGraph, names: Collection[str]) -> set[str]:
    steps = walk_edges(graph, names, graph.reference)
    return {graph.reference, *(step.child for step in steps)}
