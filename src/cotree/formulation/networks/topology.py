"""f-circuits and f-cutsets of scalar graphs as sums of variables.

Circuits are differences of prefix sums, which begin at the nearest common ancestor. Cutsets are
suffix sums of the cutsets of outer branches, unless one of their chords ends at the node in
between. Common parts are computed once, and no term is added and later subtracted.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from cotree.formulation.networks.rules import Sum
from cotree.graph import tree_walk

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from cotree.formulation.networks.rules import Variable
    from cotree.graph import Tree


@dataclass(frozen=True)
class _Place:
    """A node of the tree, with the branch that leads to it."""

    depth: int
    parent: str
    branch: str
    sign: int


@dataclass(frozen=True)
class Topology:
    """A scalar graph with its tree."""

    domain: str  # physical domain of the graph, such as ``electrical``
    tree: Tree  # the graph's normal tree, or its tree of positions
    #: Quantities that circuits sum: along a single branch, and along several branches.
    across: str = "across"
    prefix: str = "path"

    @cached_property
    def _places(self) -> dict[str, _Place]:
        places = {self.tree.graph.reference: _Place(0, "", "", 1)}
        for step in tree_walk(self.tree):
            # The traversal runs outwards from the reference, so the parent's depth is known.
            depth = places[step.parent].depth + 1
            places[step.child] = _Place(depth, step.parent, step.edge, step.sign)
        return places

    @cached_property
    def branches(self) -> frozenset[str]:
        """Names of the tree's branches."""
        return frozenset(self.tree.branches)

    @cached_property
    def _tops(self) -> tuple[dict[str, str], dict[str, str]]:
        """First node of each node's heavy path, and next node outwards on this path."""
        # Heavy paths (D. D. Sleator and R. E. Tarjan, J. Comput. Syst. Sci. 26 (1983) 362): a path
        # outwards changes between heavy paths at most log2(n) times.
        sizes = dict.fromkeys(self._places, 1)
        following: dict[str, str] = {}
        for node, place in reversed(self._places.items()):  # children before parents
            parent = place.parent
            if parent:
                sizes[parent] += sizes[node]
                if parent not in following or sizes[following[parent]] <= sizes[node]:
                    following[parent] = node
        tops: dict[str, str] = {}
        for node, place in self._places.items():
            is_next = bool(place.parent) and following[place.parent] == node
            tops[node] = tops[place.parent] if is_next else node
        return tops, following

    def _ancestor(self, a: str, b: str) -> str:
        places, tops = self._places, self._tops[0]
        while tops[a] != tops[b]:
            # Leave the heavy path that begins farther from the reference.
            if places[tops[a]].depth < places[tops[b]].depth:
                a, b = b, a
            a = places[tops[a]].parent
        # On a common heavy path, the node nearer to the reference is the ancestor.
        return a if places[a].depth < places[b].depth else b

    def _toward(self, ancestor: str, node: str) -> str:
        """Return the first branch on the path from an ancestor to another node."""
        tops, following = self._tops
        # Move inwards until the ancestor's heavy path is reached; remember the last node.
        child = following[ancestor]
        while tops[node] != tops[ancestor]:
            child = tops[node]
            node = self._places[child].parent
        return self._places[child if node == ancestor else following[ancestor]].branch

    def circuit(self, chord: str, rate: str) -> Sum:
        """Return the sum of across variables, or of their rates, along a chord's f-circuit."""
        edge = self.tree.graph.edge(chord)
        ancestor = self._ancestor(edge.tail, edge.head)
        terms: list[tuple[int, Variable]] = []
        for sign, node in ((1, edge.head), (-1, edge.tail)):
            # Potential of the head minus potential of the tail, relative to their common ancestor.
            terms += [(sign * own, variable) for own, variable in self._along(ancestor, node, rate)]
        return Sum(tuple(terms))

    def potential(self, node: str, rate: str) -> Sum:
        """Return the sum of across variables, or of their rates, from the reference to a node."""
        return Sum(tuple(self._along(self.tree.graph.reference, node, rate)))

    def _along(self, ancestor: str, node: str, rate: str) -> list[tuple[int, Variable]]:
        """Return the terms from an ancestor to a node: none, one branch, or a prefix sum."""
        if node == ancestor:
            return []
        place = self._places[node]
        if place.parent == ancestor:
            return [(place.sign, (f"{self.across}{rate}", place.branch))]
        return [(1, (f"{self.prefix}{rate}", f"{self.domain}|{ancestor}|{node}"))]

    def path(self, ancestor: str, node: str, rate: str) -> Sum:
        """Return the prefix sum from an ancestor to a node: parent's sum plus a term ([1] eq. 2).

        ``rate`` is the suffix of the quantity: "", or "_rate" for the rate of the across variable.
        """
        place = self._places[node]
        # Each prefix is one variable, which all circuits through the same nodes share.
        before = self._along(ancestor, place.parent, rate)
        return Sum((*before, (place.sign, (f"{self.across}{rate}", place.branch))))

    @cached_property
    def _ends(self) -> dict[str, list[tuple[int, int]]]:
        """Chords that end at each node, by number, with +1 or -1 for the direction."""
        ends: defaultdict[str, list[tuple[int, int]]] = defaultdict(list)
        for number, chord in enumerate(self.tree.chords):
            edge = self.tree.graph.edge(chord)
            ends[edge.head].append((number, 1))
            ends[edge.tail].append((number, -1))
        return ends

    @cached_property
    def _cuts(self) -> tuple[dict[str, tuple[int, int, int]], set[str]]:
        """For each branch: count, sum of numbers and sum of directions of the chords in its cutset.

        Also return the branches with a chord in their cutset that the next inner branch does not
        share, because the circuit of this chord closes at the node between both branches.
        """
        # For each node: number of chord ends, sum of chord numbers, sum of directions. Suffix sums
        # turn them into totals over the part of the tree beyond each branch.
        totals = {node: (0, 0, 0) for node in self._places}
        open_branches: set[str] = set()

        def add(node: str, number: int, n: int, sign: int) -> None:
            count, numbers, signs = totals[node]
            totals[node] = count + n, numbers + n * number, signs + sign

        for number, chord in enumerate(self.tree.chords):
            edge = self.tree.graph.edge(chord)
            # If only one chord crosses a branch, these three totals identify it.
            add(edge.head, number, 1, 1)
            add(edge.tail, number, 1, -1)
            ancestor = self._ancestor(edge.tail, edge.head)
            add(ancestor, number, -2, 0)  # circuits that close here cross no inner branch
            open_branches |= {
                self._toward(ancestor, node) for node in (edge.tail, edge.head) if node != ancestor
            }
        found = {}
        for node, place in reversed(self._places.items()):
            if place.branch:
                own = totals[node]
                found[place.branch] = own
                parent = totals[place.parent]
                totals[place.parent] = parent[0] + own[0], parent[1] + own[1], parent[2] + own[2]
        return found, open_branches

    def _crossing(self, branch: str) -> list[tuple[int, int]]:
        """Return the chords that have exactly one end beyond a branch."""
        found, waiting = [], [branch]
        while waiting:
            name = waiting.pop()
            waiting += self._beyond[name]
            found += self._ends[self._outer[name]]
        return _once(found)

    @cached_property
    def _outer(self) -> dict[str, str]:
        return {place.branch: node for node, place in self._places.items() if place.branch}

    def crossing(self, branch: str) -> dict[str, int]:
        """Return the chords, with signs, that sum to a branch's through variable."""
        chords, sign = self.tree.chords, -self._sign(branch)
        return {chords[number]: sign * own for number, own in self._crossing(branch)}

    def along(self, chord: str) -> dict[str, int]:
        """Return the branches, with signs, that sum to a chord's across variable."""
        edge = self.tree.graph.edge(chord)
        ancestor = self._ancestor(edge.tail, edge.head)
        found = {}
        for sign, node in ((1, edge.head), (-1, edge.tail)):
            while node != ancestor:
                place = self._places[node]
                found[place.branch] = sign * place.sign
                node = place.parent
        return found

    @cached_property
    def _beyond(self) -> dict[str, list[str]]:
        """For each branch: the branches that follow next outwards."""
        following: defaultdict[str, list[str]] = defaultdict(list)
        for place in self._places.values():
            if place.branch:
                following[self._places[place.parent].branch].append(place.branch)
        return following

    def _sign(self, branch: str) -> int:
        return self._places[self._outer[branch]].sign

    def above(self, branches: Sequence[str]) -> list[tuple[int, int]]:
        """Return each branch's sign, and the index of the branch that leads to it, or -1."""
        numbers = {name: i for i, name in enumerate(branches)}
        found = []
        for name in branches:
            own = self._places[self._outer[name]]
            before = self._places[own.parent]
            while before.branch and before.branch not in numbers:
                before = self._places[before.parent]
            found.append((own.sign, numbers.get(before.branch, -1)))
        return found

    def parts(self, branches: Sequence[str]) -> dict[str, int]:
        """Divide the tree at branches; return each node's part: the index of a branch, or -1."""
        numbers = {name: i for i, name in enumerate(branches)}
        found: dict[str, int] = {}
        for node, place in self._places.items():  # parents before children
            found[node] = numbers.get(place.branch, found.get(place.parent, -1))
        return found

    def cutset(self, branch: str, rate: str) -> Sum:
        """Return a branch's through variable, or its rate, from the flow beyond the branch."""
        n, number, sign = self._cuts[0][branch]
        # If only one chord crosses the cut, no sum is needed.
        if n == 1:
            chord = self.tree.chords[number]
            # The branch supplies the flow that leaves through the chords: opposite signs.
            return Sum(((-self._sign(branch) * sign, (f"through{rate}", chord)),))
        return Sum(((-self._sign(branch), (f"flow{rate}", branch)),))

    def flow(self, branch: str, rate: str) -> Sum:
        """Return the sum of the through variables of chords that leave the part beyond a branch."""
        cuts, open_branches = self._cuts
        terms: list[tuple[int, Variable]] = []
        # Chords that end at the node itself come first, then the sums of the branches beyond it.
        own = list(self._ends[self._outer[branch]])
        for other in self._beyond[branch]:
            n, number, sign = cuts[other]
            # Use the sum of an outer branch only if all of its chords also cross this branch. A
            # chord whose circuit closes at this node would be added and then subtracted.
            if n > 1 and other not in open_branches:
                terms.append((1, (f"flow{rate}", other)))
            elif n == 1:
                own.append((number, sign))
            elif n > 1:
                own += self._crossing(other)
        terms += [(sign, (f"through{rate}", self.tree.chords[i])) for i, sign in _once(own)]
        return Sum(tuple(terms))


def _once(ends: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the chords that occur exactly once, in order."""
    found: dict[int, int] = {}
    for number, sign in ends:
        # A chord with both ends beyond the branch does not cross it: remove it.
        if found.pop(number, None) is None:
            found[number] = sign
    return sorted(found.items())
