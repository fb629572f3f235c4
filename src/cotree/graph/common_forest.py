"""Largest edge sets of minimum cost that form a forest in each of two graphs.

Such a set belongs to both trees of a network with ideal amplifiers. In a network with ideal
transformers, at most one of the two ports may be a branch: the ports are parallel edges of the
second graph. The sets are common independent sets of two matroids, found by augmentation along
shortest exchange paths (A. Schrijver, Combinatorial Optimization, 2003, section 41.3).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.errors import TopologyError
from cotree.graph.tree import Parts

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

#: Cost and number of edges of a path; of paths of equal cost, the shortest must be used.
_Length = tuple[int, int]


class Contracted:
    """A graph after contraction of the edges ``branches``, which must not contain a circuit."""

    def __init__(self, ends: Mapping[str, tuple[str, str]], branches: Iterable[str] = ()) -> None:
        parts = Parts(node for pair in ends.values() for node in pair)
        for name in branches:
            if not parts.join(*ends[name]):
                raise TopologyError(
                    f"edge '{name}' closes a circuit of edges that must be branches"
                )
        # Contraction merges the ends of a branch: one node represents each connected part.
        self.ends = {name: (parts.top(a), parts.top(b)) for name, (a, b) in ends.items()}

    def lightest(self, names: Iterable[str], costs: Mapping[str, int]) -> list[str]:
        """Return a forest of minimum cost among ``names``; first edges are preferred if equal."""
        parts = self._parts()
        cheapest = sorted(names, key=costs.__getitem__)
        # Kruskal's algorithm; the stable sort prefers the first of equal edges.
        return [name for name in cheapest if parts.join(*self.ends[name])]

    def extended(self, forest: Iterable[str]) -> Parts:
        """Return the connected parts of the graph of a forest."""
        parts = self._parts()
        for name in forest:
            parts.join(*self.ends[name])
        return parts

    def _parts(self) -> Parts:
        return Parts(node for pair in self.ends.values() for node in pair)

    def circuits(
        self, forest: Sequence[str], others: Iterable[str]
    ) -> dict[str, Sequence[str] | None]:
        """Return the forest path between the ends of each other edge, or None without a path."""
        neighbours: dict[str, list[tuple[str, str]]] = {}
        for name in forest:
            a, b = self.ends[name]
            neighbours.setdefault(a, []).append((b, name))
            neighbours.setdefault(b, []).append((a, name))
        # Depths are counted from the root of each tree of the forest.
        places: dict[str, tuple[int, str, str]] = {}  # depth, parent and edge to the parent
        for root in neighbours:
            if root not in places:
                places[root] = (0, root, "")
                waiting = [root]
                while waiting:
                    node = waiting.pop()
                    for other, name in neighbours[node]:
                        if other not in places:
                            places[other] = (places[node][0] + 1, node, name)
                            waiting.append(other)
        parts = self.extended(forest)
        found: dict[str, Sequence[str] | None] = {}
        for name in others:
            a, b = self.ends[name]
            # An edge between two trees closes no circuit.
            found[name] = None if parts.top(a) != parts.top(b) else _between(places, a, b)
        return found


def _between(places: Mapping[str, tuple[int, str, str]], a: str, b: str) -> list[str]:
    # Move up from the deeper node until both paths meet.
    route = []
    while a != b:
        if places[a][0] < places[b][0]:
            a, b = b, a
        _, above, name = places[a]
        route.append(name)
        a = above
    return route


def common_forest(first: Contracted, second: Contracted, costs: Mapping[str, int]) -> set[str]:
    """Return a largest edge set that is a forest in both graphs, at minimum total cost.

    Only edges in ``costs`` may be selected. Among sets of equal cost, the first edges are
    preferred.

    >>> first = Contracted({"a": ("0", "1"), "b": ("0", "1"), "c": ("1", "2"), "d": ("1", "2")})
    >>> second = Contracted({"a": ("0", "1"), "b": ("2", "3"), "c": ("0", "1"), "d": ("4", "5")})
    >>> sorted(common_forest(first, second, {"a": 0, "b": 3, "c": 0, "d": 1}))
    ['a', 'd']
    """
    cheapest = sorted(costs, key=costs.__getitem__)
    shared: set[str] = set()
    while True:
        path = _exchange(first, second, costs, shared)
        if path is None:
            return shared
        # The path alternates between added and removed edges and adds one more than it removes.
        shared ^= set(path)
        # An edge that can be added in both graphs, and costs no more than this path, is the next
        # shortest path: add it without a search.
        least = sum(costs[name] if name in shared else -costs[name] for name in path)
        grown = first.extended(shared), second.extended(shared)
        for name in cheapest:
            if costs[name] > least:
                break
            ends = first.ends[name], second.ends[name]
            if name not in shared and all(
                parts.top(a) != parts.top(b) for parts, (a, b) in zip(grown, ends, strict=True)
            ):
                shared.add(name)
                for parts, pair in zip(grown, ends, strict=True):
                    parts.join(*pair)


def _exchange(
    first: Contracted, second: Contracted, costs: Mapping[str, int], shared: set[str]
) -> list[str] | None:
    forest = [name for name in costs if name in shared]
    others = [name for name in costs if name not in shared]
    enters, leaves = first.circuits(forest, others), second.circuits(forest, others)
    # For each removed edge, arcs lead to the edges that the first graph can then accept; from each
    # added edge, arcs lead to those that the second graph must then remove. Edges that one graph
    # accepts anyway begin or end a path. Paths through such edges are no cheaper than their part
    # before or after it, since an exchange that adds no edge cannot lower the cost.
    arcs: dict[str, list[str]] = {name: [] for name in costs}
    for name in others:
        for leaving in enters[name] or ():
            arcs[leaving].append(name)
        arcs[name] += leaves[name] or ()
    # Bellman-Ford algorithm, since removed edges have negative costs. It terminates because a set
    # of minimum cost for its size has no cycle of negative cost.
    length: dict[str, _Length] = {n: (costs[n], 0) for n in others if enters[n] is None}
    before: dict[str, str] = {}
    waiting = list(length)
    while waiting:
        changed: dict[str, None] = {}
        for name in waiting:
            cost, steps = length[name]
            for other in arcs[name]:
                step = -costs[other] if other in shared else costs[other]
                found = (cost + step, steps + 1)
                if other not in length or found < length[other]:
                    length[other], before[other] = found, name
                    changed[other] = None
        waiting = list(changed)
    ends = [name for name in others if leaves[name] is None and name in length]
    if not ends:
        return None
    path = [min(ends, key=lambda name: length[name])]
    while path[-1] in before:
        path.append(before[path[-1]])
    return path
