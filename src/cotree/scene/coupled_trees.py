"""Joint choice of branches in graphs that ideal couplings and amplifiers connect.

A tree with one port of each transformer is a common forest of its graph and of another in which
these ports are parallel. In graphs with ideal amplifiers the other is that of through variables.
Other conditions have no such graph: that both ports of a gyrator are branches or neither is, and
those of transformers beside amplifiers. They are left free at first; where the best choice violates
one of them, each of its options is tried.
"""

from __future__ import annotations

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
    from cotree.scene.networks import Port

# States that a storage loses as a branch: across storages have theirs as branches, through storages
# and springs as chords. This goes before all other preferences.
_EXCESS = {Kind.ACROSS_STORAGE: -1, Kind.THROUGH_STORAGE: 1, Kind.SPRING: 1}

# Weights are multiples of a quarter, and less than sixteen.
_UNIT, _MOST = 4, 64

# A hundred gyrators tied to each other take a few thousand choices; the search has no bound.
_MOST_TRIED = 20_000


@dataclass(frozen=True)
class _Couple:
    """An ideal coupling: its ports, and which of them may be branches."""

    ports: tuple[str, str]
    options: tuple[tuple[bool, bool], ...]

    @classmethod
    def of(cls, ports: Sequence[Port], edges: Collection[str]) -> _Couple:
        first, second = ports
        law = first.terminal.across
        # A gyrator gives its across variable by the other's through variable.
        is_gyrator = law is not None and any(a.startswith("through_") for a in law.arguments)
        options = ((True, True), (False, False)) if is_gyrator else ((True, False), (False, True))
        # What acts on a multibody system takes its motion as it is, and what is short-circuited
        # is no edge of a graph: neither is a branch.
        could = [port.name in edges for port in ports]
        return cls(
            (first.name, second.name),
            tuple(row for row in options if could[0] >= row[0] and could[1] >= row[1]),
        )

    @property
    def is_one_of_two(self) -> bool:
        """Whether it is a transformer either of whose ports may be the branch."""
        return len(self.options) == 2 and self.options[0][0] is not self.options[0][1]

    def is_kept(self, branches: Collection[str]) -> bool:
        """Say whether the choice of its ports as branches and chords is valid."""
        first, second = self.ports
        return (first in branches, second in branches) in self.options


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
    """

    graphs: Sequence[LinearGraph]
    ports: Mapping[str, Port]
    ends: Mapping[str, tuple[str, str]]
    costs: Mapping[str, int]
    couples: tuple[_Couple, ...]

    @classmethod
    def of(
        cls,
        graphs: Sequence[LinearGraph],
        ports: Mapping[str, Port],
        weights: Mapping[str, float],
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
        """
        # The graphs share names of nodes; a prefix keeps their nodes apart in the common forest.
        ends = {
            edge.name: (f"{graph.domain}|{edge.tail}", f"{graph.domain}|{edge.head}")
            for graph in graphs
            for edge in graph.edges
        }
        # So large that one storage with a state outweighs all other preferences together.
        excess = _MOST * (len(ends) + 1)
        costs = {
            name: excess * _EXCESS.get(ports[name].kind, 0) + round(_UNIT * weights[name])
            for name in ends
            if weights[name] != float("inf")
        }
        couples: dict[str, list[Port]] = {}
        for port in ports.values():
            if port.kind is Kind.COUPLED:
                couples.setdefault(port.edge.name, []).append(port)
        return cls(
            graphs, ports, ends, costs, tuple(_Couple.of(both, ends) for both in couples.values())
        )

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
        return {name for name in self.ends if self.ports[name].terminal.domain in domains}

    def _relaxed(self, fixed: Mapping[str, bool]) -> _Found | None:
        """Select branches with the ports of some couplings fixed; None where there are none.

        Transformers are kept as far as they can be, other couplings left free.
        """
        chosen = [name for name, is_branch in fixed.items() if is_branch]
        branches = [*self._of_kind(Kind.ACROSS_SOURCE), *chosen]
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
        kept = [name for name in branches if name in self._split]
        try:
            # Contracted edges are branches already: the inputs of amplifiers in the tree of across
            # variables, their outputs in that of through variables, given branches in both.
            across = Contracted(self.ends, [*self._inputs, *branches])
            through = Contracted(ends, [*self._of_kind(Kind.NORATOR), *kept])
        except TopologyError:
            return None
        known = {*fixed, *branches}
        costs = self._open(across, known, pairs)
        found = common_forest(across, through, costs)
        # A spanning tree of each graph has one branch less than nodes.
        n_nodes = sum(graph.n_nodes - 1 for graph in self.graphs)
        n_ports = sum(name in found for pair in pairs for name in pair)
        if len(found) + len(branches) + len(self._inputs) < n_nodes or n_ports < len(pairs):
            return None
        cost = sum(self.costs[name] for name in (*found, *chosen))
        return _Found(cost, fixed, frozenset({*found, *branches}))

    def _open(
        self, across: Contracted, known: Collection[str], pairs: Sequence[tuple[str, str]]
    ) -> dict[str, int]:
        """Give the costs of edges that may become branches; of each pair one port has to."""
        # A bonus larger than all costs together: one port of each pair is always chosen.
        must = 1 + sum(map(abs, self.costs.values()))
        costs = {name: self.costs[name] - must for pair in pairs for name in pair}
        rest = [name for name in self.costs if name not in known and name not in costs]
        # Ports displace only the heavier of a circuit: what is none of the lightest forest is
        # none of the best.
        alone = set(across.lightest((n for n in rest if n not in self._split), self.costs))
        return costs | {
            name: self.costs[name] for name in rest if name in self._split or name in alone
        }
