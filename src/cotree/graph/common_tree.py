"""Two trees of one graph that share all edges but some that only one of them may have.

Networks with ideal amplifiers have circuits after one tree and cutsets after another: nullators are
branches of the first only, norators of the second only. What the trees share is a common base of
two graphic matroids, found by augmenting along shortest paths of exchanges (A. Schrijver,
Combinatorial Optimization, 2003, section 41.3).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from cotree.errors import TopologyError
from cotree.graph.tree import Parts, Tree

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from cotree.graph.linear_graph import LinearGraph

#: A cost and a number of edges: of paths of equal cost, the shortest must be taken.
_Length = tuple[int, int]


def select_common_trees(
    graph: LinearGraph,
    weights: Mapping[str, float],
    first: Collection[str],
    second: Collection[str],
) -> tuple[Tree, Tree]:
    """Select two spanning trees that share all but given edges.

    Parameters
    ----------
    graph : LinearGraph
        The graph.
    weights : mapping of str to float
        Weight of each other edge that may be in both. Edges that are left out, or whose weight is
        not finite, are in none.
    first, second : collection of str
        Edges that are in the first tree only, and in the second only.

    Returns
    -------
    tuple of Tree
        The trees. As many edges of the least weight as can be are shared, then of the next.

    Raises
    ------
    TopologyError
        If there are no such trees.
    """
    candidates = [
        name
        for name in graph.edge_names
        if name not in first and name not in second and math.isfinite(weights.get(name, math.inf))
    ]
    costs = _costs({name: weights[name] for name in candidates})
    sides = (_Side(graph, first), _Side(graph, second))
    shared: set[str] = set()
    while len(shared) < graph.n_nodes - 1 - len(first):
        path = _exchange(sides, candidates, costs, shared)
        if path is None:
            raise TopologyError(f"the {graph.domain} graph has no two trees that share their edges")
        shared ^= set(path)
    made = [
        Tree(graph, tuple(n for n in graph.edge_names if n in shared or n in own))
        for own in (first, second)
    ]
    return made[0], made[1]


def _costs(weights: Mapping[str, float]) -> dict[str, int]:
    """Turn weights into costs of which one of a rank outweighs all of the next."""
    ranks = {weight: i for i, weight in enumerate(sorted(set(weights.values())))}
    base = len(weights) + 1
    return {name: -(base ** (len(ranks) - ranks[weight])) for name, weight in weights.items()}


class _Side:
    """One of the two graphs: some edges contracted beforehand."""

    def __init__(self, graph: LinearGraph, contracted: Iterable[str]) -> None:
        parts = Parts(graph.nodes)
        for name in contracted:
            edge = graph.edge(name)
            if not parts.join(edge.tail, edge.head):
                raise TopologyError(f"edge '{name}' closes a circuit of ideal amplifiers")
        self._ends = {
            edge.name: (parts.top(edge.tail), parts.top(edge.head)) for edge in graph.edges
        }

    def circuits(
        self, forest: Collection[str], others: Iterable[str]
    ) -> dict[str, list[str] | None]:
        """Name the edges of a forest in the circuit of each other edge; None without one."""
        neighbours: dict[str, list[tuple[str, str]]] = {}
        for name in forest:
            a, b = self._ends[name]
            neighbours.setdefault(a, []).append((b, name))
            neighbours.setdefault(b, []).append((a, name))
        return {name: _route(neighbours, *self._ends[name]) for name in others}


def _route(
    neighbours: Mapping[str, list[tuple[str, str]]], start: str, end: str
) -> list[str] | None:
    came: dict[str, tuple[str, str]] = {start: ("", "")}
    waiting = [start]
    while waiting and end not in came:
        node = waiting.pop()
        for other, edge in neighbours.get(node, ()):
            if other not in came:
                came[other] = (node, edge)
                waiting.append(other)
    if end not in came:
        return None
    route = []
    while end != start:
        end, edge = came[end]
        route.append(edge)
    return route


def _exchange(
    sides: tuple[_Side, _Side],
    candidates: Collection[str],
    costs: Mapping[str, int],
    shared: Collection[str],
) -> list[str] | None:
    """Find the cheapest exchange that gives one more shared edge."""
    others = [name for name in candidates if name not in shared]
    first, second = (side.circuits(shared, others) for side in sides)
    # From what leaves to what the first graph then accepts, and on to what that makes leave the
    # second: an edge may take the place of any in its circuit, or of any at all without one.
    arcs: dict[str, list[str]] = {name: [] for name in candidates}
    for name in others:
        circuit = first[name]
        for leaving in shared if circuit is None else circuit:
            arcs[leaving].append(name)
        circuit = second[name]
        arcs[name] += shared if circuit is None else circuit
    length: dict[str, _Length] = {n: (costs[n], 0) for n in others if first[n] is None}
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
    ends = [name for name in others if second[name] is None and name in length]
    if not ends:
        return None
    path = [min(ends, key=lambda name: length[name])]
    while path[-1] in before:
        path.append(before[path[-1]])
    return path
