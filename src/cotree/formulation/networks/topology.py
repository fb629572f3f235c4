"""f-circuits and f-cutsets of the scalar graphs as sums of variables.

Paths are prefix sums from the nearest common ancestor, cutsets are suffix sums of those beyond
wherever none of their chords ends, so that what two equations share is formed once and nothing
is added only to be taken away again.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from cotree.formulation.networks.rules import Sum
from cotree.graph import tree_walk

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.formulation.networks.rules import Variable
    from cotree.graph import Tree


@dataclass(frozen=True)
class _Place:
    """A node of the tree: what leads to it."""

    depth: int
    parent: str
    branch: str
    sign: int


@dataclass(frozen=True)
class Topology:
    """One scalar graph with its tree.

    Attributes
    ----------
    domain : str
        The graph's domain.
    tree : Tree
        Its normal tree.
    """

    domain: str
    tree: Tree

    @cached_property
    def _places(self) -> dict[str, _Place]:
        places = {self.tree.graph.reference: _Place(0, "", "", 1)}
        for step in tree_walk(self.tree):
            depth = places[step.parent].depth + 1
            places[step.child] = _Place(depth, step.parent, step.edge, step.sign)
        return places

    @cached_property
    def branches(self) -> frozenset[str]:
        """The branches of the tree."""
        return frozenset(self.tree.branches)

    def _ancestor(self, a: str, b: str) -> str:
        """Find the nearest node that leads to both."""
        places = self._places
        while a != b:
            if places[a].depth < places[b].depth:
                b = places[b].parent
            else:
                a = places[a].parent
        return a

    def circuit(self, chord: str, rate: str) -> Sum:
        """Sum the across variables along the f-circuit of a chord; or their rates."""
        edge = self.tree.graph.edge(chord)
        ancestor = self._ancestor(edge.tail, edge.head)
        terms: list[tuple[int, Variable]] = []
        for sign, node in ((1, edge.head), (-1, edge.tail)):
            terms += [(sign * own, variable) for own, variable in self._along(ancestor, node, rate)]
        return Sum(tuple(terms))

    def potential(self, node: str, rate: str) -> Sum:
        """Sum the across variables from the reference to a node; or their rates."""
        return Sum(tuple(self._along(self.tree.graph.reference, node, rate)))

    def _along(self, ancestor: str, node: str, rate: str) -> list[tuple[int, Variable]]:
        """Name the sum from an ancestor to a node: nothing, one branch, or a prefix sum."""
        if node == ancestor:
            return []
        place = self._places[node]
        if place.parent == ancestor:
            return [(place.sign, (f"across{rate}", place.branch))]
        return [(1, (f"path{rate}", f"{self.domain}|{ancestor}|{node}"))]

    def path(self, ancestor: str, node: str, rate: str) -> Sum:
        """Form the prefix sum of a node from that of its parent."""
        place = self._places[node]
        before = self._along(ancestor, place.parent, rate)
        return Sum((*before, (place.sign, (f"across{rate}", place.branch))))

    @cached_property
    def _crossing(self) -> dict[str, dict[str, int]]:
        """List the chords in the f-cutset of each branch, with their direction outwards."""
        found: dict[str, dict[str, int]] = {name: {} for name in self.tree.branches}
        for chord in self.tree.chords:
            edge = self.tree.graph.edge(chord)
            ancestor = self._ancestor(edge.tail, edge.head)
            for sign, node in ((1, edge.head), (-1, edge.tail)):
                while node != ancestor:
                    place = self._places[node]
                    found[place.branch][chord] = sign
                    node = place.parent
        return found

    @cached_property
    def _beyond(self) -> dict[str, list[str]]:
        """List the branches that follow each branch outwards."""
        following: defaultdict[str, list[str]] = defaultdict(list)
        for place in self._places.values():
            if place.branch:
                following[self._places[place.parent].branch].append(place.branch)
        return following

    @cached_property
    def _signs(self) -> dict[str, int]:
        return {place.branch: place.sign for place in self._places.values()}

    def above(self, branches: Sequence[str]) -> list[tuple[int, int]]:
        """Give the sign of each of some branches, and which of them leads to it; -1 for none."""
        numbers = {name: i for i, name in enumerate(branches)}
        parents = {place.branch: self._places[place.parent] for place in self._places.values()
                   if place.branch}  # fmt: skip
        found = []
        for name in branches:
            before = parents[name]
            while before.branch and before.branch not in numbers:
                before = parents[before.branch]
            found.append((self._signs[name], numbers.get(before.branch, -1)))
        return found

    def parts(self, branches: Sequence[str]) -> dict[str, int]:
        """Cut the tree at some branches; give each node the number of that which leads to it.

        Nodes that none leads to have the number -1.
        """
        numbers = {name: i for i, name in enumerate(branches)}
        found: dict[str, int] = {}
        for node, place in self._places.items():  # each after its parent
            found[node] = numbers.get(place.branch, found.get(place.parent, -1))
        return found

    def cutset(self, branch: str, rate: str) -> Sum:
        """Give a branch's through variable from what flows out beyond it; or its rate."""
        own = self._crossing[branch]
        if len(own) == 1:
            ((chord, sign),) = own.items()
            return Sum(((-self._signs[branch] * sign, (f"through{rate}", chord)),))
        return Sum(((-self._signs[branch], (f"flow{rate}", branch)),))

    def flow(self, branch: str, rate: str) -> Sum:
        """Sum what the chords beyond a branch take from there."""
        rest = dict(self._crossing[branch])
        terms: list[tuple[int, Variable]] = []
        for other in self._beyond[branch]:
            shared = self._crossing[other]
            if len(shared) > 1 and shared.keys() <= rest.keys():
                terms.append((1, (f"flow{rate}", other)))
                for chord in shared:
                    del rest[chord]
        terms += [(sign, (f"through{rate}", chord)) for chord, sign in rest.items()]
        return Sum(tuple(terms))
