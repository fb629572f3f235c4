"""Joint choice of branches in graphs that ideal couplings and amplifiers connect.

A tree with one port of each transformer is a common forest of its graph and of another in which
these ports are parallel. In graphs with ideal amplifiers the other is that of through variables.
A controlled source may determine what controls it; then the controlling edge is a branch of the
tree of across variables and the source one of the other, as input and output of an amplifier.
Other conditions have no such graph: that both ports of a gyrator are branches or neither is, and
those of transformers beside amplifiers. They are left free at first; where the best choice violates
one of them, each of its options is tried.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from heapq import heappop, heappush
from itertools import count
from typing import TYPE_CHECKING

from cotree.components import Kind
from cotree.errors import TopologyError, listed
from cotree.graph import Contracted, common_forest

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from cotree.graph import LinearGraph
    from cotree.scene.controls import Swap
    from cotree.scene.networks import Port

#: States that a storage loses as a branch: across storages have theirs as branches, through
#: storages and springs as chords. This goes before all other preferences.
EXCESS = {Kind.ACROSS_STORAGE: -1, Kind.THROUGH_STORAGE: 1, Kind.SPRING: 1}

# Weights are multiples of a quarter, and less than sixteen.
_UNIT, _MOST = 4, 64

# A hundred gyrators tied to each other take a few thousand choices; the search has no bound.
_MOST_TRIED = 20_000


@dataclass(frozen=True)
class _Couple:
    """An ideal coupling: its ports, and which of them may be branches.

    Two swaps of its ports follow these where each port may be a branch of one tree only.
    """

    ports: tuple[str, ...]
    options: tuple[tuple[bool, ...], ...]

    @classmethod
    def of(cls, ports: Sequence[Port], edges: Collection[str], swaps: Sequence[Swap]) -> _Couple:
        first, second = ports
        law = first.terminal.across
        # A gyrator gives its across variable by the other's through variable.
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
        # What acts on a multibody system takes its motion as it is, and what is short-circuited
        # is no edge of a graph: neither is a branch.
        could = [port.name in edges for port in ports]
        return cls(
            (first.name, second.name, *own),
            tuple(row for row in options if could[0] >= row[0] and could[1] >= row[1]),
        )

    @property
    def is_one_of_two(self) -> bool:
        """Whether it is a transformer either of whose ports may be the branch."""
        return self.options == ((True, False), (False, True))

    def is_kept(self, branches: Collection[str]) -> bool:
        """Say whether the choice of its ports as branches and chords is valid."""
        return tuple(name in branches for name in self.ports) in self.options


@dataclass(frozen=True)
class _Found:
    """The best branches with some couplings left free."""

    cost: int
    fixed: Mapping[str, bool]
    branches: frozenset[str]


@dataclass(frozen=True)
class CoupledTrees:
    """The choice of branches of several graphs together.

    Attributes
    ----------
    graphs : sequence of LinearGraph
        The graphs.
    ports : mapping of str to Port
        Their edges.
    ends : mapping of str to (str, str)
        The nodes of each edge, of all graphs apart.
    costs : mapping of str to int
        Of each edge that may be a branch.
    couples : tuple of _Couple
        The ideal couplings.
    swaps : mapping of str to Swap
        The controlled sources that may determine what controls them.
    """

    graphs: Sequence[LinearGraph]
    ports: Mapping[str, Port]
    ends: Mapping[str, tuple[str, str]]
    costs: Mapping[str, int]
    couples: tuple[_Couple, ...]
    swaps: Mapping[str, Swap]

    @classmethod
    def of(
        cls,
        graphs: Sequence[LinearGraph],
        ports: Mapping[str, Port],
        weights: Mapping[str, float],
        swaps: Sequence[Swap] = (),
    ) -> CoupledTrees:
        """Gather the edges of graphs whose trees must be chosen together.

        Parameters
        ----------
        graphs : sequence of LinearGraph
            The graphs.
        ports : mapping of str to Port
            Their edges.
        weights : mapping of str to float
            How late each edge becomes a branch; infinite for edges that never do.
        swaps : sequence of Swap
            The controlled sources that may determine what controls them.
        """
        # The graphs share names of nodes; a prefix keeps their nodes apart in the common forest.
        ends = {edge.name: _ends(ports[edge.name]) for graph in graphs for edge in graph.edges}
        # So large that a swap outweighs all other preferences together, and one storage with a
        # state all swaps.
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
        """Select the branches: first the fewest storages without a state of their own.

        Raises
        ------
        TopologyError
            If there is no such choice.
        """
        # Couplings with one option leave nothing to choose.
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
        # The least cost first: what keeps all couplings then is the best.
        order = count()
        # Entries are the cost, the number of violated couplings, a number that orders equals, and
        # the choice. Leaving couplings free only lowers the cost, hence the first valid choice is
        # the best.
        waiting: list[tuple[int, int, int, _Found]] = []
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
                    f"the branches of {listed(names)} take too long to choose: more gyrators are "
                    "tied to each other than can be tried; put a resistance or a storage between"
                )
        names = dict.fromkeys(self.ports[couple.ports[0]].edge.name for couple in self.couples)
        raise TopologyError(
            f"the ports of {listed(names)} cannot be one branch and one chord: they are tied to "
            "sources or to each other so that their variables contradict or are undetermined; add "
            "a resistance or a storage"
        )

    def _broken(self, found: _Found) -> list[_Couple]:
        """List the couplings whose conditions are violated."""
        return [couple for couple in self.couples if not couple.is_kept(found.branches)]

    def _either_way(self, best: _Found, broken: Sequence[_Couple]) -> list[_Found]:
        """Try the options of one of the couplings that are not kept."""
        made: list[list[_Found]] = []
        for couple in broken:
            tried = [
                self._relaxed({**best.fixed, **dict(zip(couple.ports, row, strict=True))})
                for row in couple.options
            ]
            made.append([found for found in tried if found is not None])
            if len(made[-1]) < 2:  # no choice, or none at all
                return made[-1]
        # What costs most either way tells the most of where the best is.
        return max(made, key=lambda pair: sorted(found.cost for found in pair))

    @cached_property
    def _inputs(self) -> list[str]:
        return self._of_kind(Kind.NULLATOR)

    def _of_kind(self, kind: Kind) -> list[str]:
        return [name for name in self.ends if self.ports[name].kind is kind]

    @cached_property
    def _split(self) -> set[str]:
        """The edges of graphs that have two trees."""
        domains = {self.ports[name].terminal.domain for name in self._inputs}
        domains |= {swap.source.terminal.domain for swap in self.swaps.values()}
        return {name for name in self.ends if self.ports[name].terminal.domain in domains}

    @cached_property
    def _sources(self) -> dict[str, list[str]]:
        """The sources of across that swaps are of: what puts each into every tree it must be in."""
        found: dict[str, list[str]] = {}
        for name, swap in self.swaps.items():
            for port in (swap.source, swap.control):
                if port.kind is Kind.ACROSS_SOURCE:
                    found.setdefault(port.name, [port.name]).append(name)
        return found

    def _relaxed(self, fixed: Mapping[str, bool]) -> _Found | None:
        """Select branches with the ports of some couplings fixed; None where there are none.

        Transformers are kept as far as they can be, other couplings left free.
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
        # Each edge apart but for what may not be branches together.
        ends = {
            n: pair if n in self._split else (f"{n}+", f"{n}-") for n, pair in self.ends.items()
        }
        ends |= {second: ends[first] for first, second in pairs}
        swaps = self.swaps.items()
        kept = [name for name in branches if self._is_split(name)]
        try:
            # Contracted edges are branches already: the inputs of amplifiers in the tree of across
            # variables, their outputs in that of through variables, given branches in both.
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
        # A spanning tree of each graph has one branch less than nodes.
        n_nodes = sum(graph.n_nodes - 1 for graph in self.graphs)
        if len(found) + len(branches) + len(self._inputs) < n_nodes:
            return None
        if any(found.isdisjoint(names) for names in must):
            return None
        cost = sum(self.costs[name] for name in (*found, *chosen))
        return _Found(cost, fixed, frozenset({*found, *branches}))

    def _open(
        self, across: Contracted, known: Collection[str], must: Sequence[Collection[str]]
    ) -> dict[str, int]:
        """Give the costs of edges that may become branches; of each set in ``must`` one has to."""
        # A bonus larger than all costs together: one of each set is always chosen.
        bonus = 1 + sum(map(abs, self.costs.values()))
        # A swap may stand for two sources of across: that which controls, and that which is
        # controlled.
        counts = Counter(name for names in must for name in names)
        costs = {name: self.costs[name] - bonus * n for name, n in counts.items()}
        rest = [name for name in self.costs if name not in known and name not in costs]
        # Ports displace only the heavier of a circuit: what is none of the lightest forest is
        # none of the best.
        alone = set(across.lightest((n for n in rest if not self._is_split(n)), self.costs))
        return costs | {
            name: self.costs[name] for name in rest if self._is_split(name) or name in alone
        }

    def _is_split(self, name: str) -> bool:
        return name in self._split or name in self.swaps


def _ends(port: Port) -> tuple[str, str]:
    """Name the nodes of a port, of all graphs apart."""
    return f"{port.terminal.domain}|{port.tail}", f"{port.terminal.domain}|{port.head}"
