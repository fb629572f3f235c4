"""The tree of a linear graph: chosen by weight, or named by the user.

In: a `LinearGraph` with weights or names. Out: a `Tree`. Its edges are branches, the others chords
([1] section 1.1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from cotree.errors import TopologyError, listed
from cotree.graph.linear_graph import TreeStep, check_spanned, walk_edges

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from cotree.graph.linear_graph import LinearGraph


@dataclass(frozen=True)
class Tree:
    """A spanning tree of a graph, created and checked by `select_tree` and `named_tree`.

    Parameters
    ----------
    graph : LinearGraph
        The graph.
    branches : tuple of str
        Names of the tree's edges, in edge order.
    """

    graph: LinearGraph
    branches: tuple[str, ...]

    @cached_property
    def _branch_set(self) -> frozenset[str]:
        return frozenset(self.branches)

    @cached_property
    def chords(self) -> tuple[str, ...]:
        """Names of the edges of the cotree, in edge order."""
        # Edges that could never be branches are chords, too, such as springs and loads.
        return tuple(name for name in self.graph.edge_names if name not in self._branch_set)

    def is_branch(self, name: str) -> bool:
        """Return whether the named edge is in the tree.

        Raises
        ------
        TopologyError
            If the graph has no such edge.
        """
        # The graph raises for unknown names.
        return self.graph.edge(name).name in self._branch_set

    def summary(self) -> str:
        """Describe the tree in one line.

        Examples
        --------
        >>> from cotree.graph import GraphEdge, LinearGraph, named_tree
        >>> edges = (GraphEdge("m", "ground", "A", "body"), GraphEdge("k", "ground", "A", "spring"))
        >>> named_tree(LinearGraph("translation", ("ground", "A"), edges), ["m"]).summary()
        'translation tree: branches m; chords k'
        """
        branches = ", ".join(self.branches) or "none"
        chords = ", ".join(self.chords) or "none"
        return f"{self.graph.domain} tree: branches {branches}; chords {chords}"


def select_tree(graph: LinearGraph, weights: Mapping[str, float]) -> Tree:
    """Select the spanning tree of minimum weight, the first in edge order among equals.

    Edges without a finite weight never become branches. Raises TopologyError if a weight is given
    for an unknown edge, or the edges that may be branches do not reach every node.
    """
    for name in weights:
        graph.edge(name)
    # In edge order, which the stable sort below keeps among equal weights.
    candidates = [name for name in graph.edge_names if math.isfinite(weights.get(name, math.inf))]
    check_spanned(
        graph,
        candidates,
        "edges that may be branches",
        f"connect {{them}} to '{graph.reference}' by one (in mechanics a joint, an arm or a body)",
    )
    # Kruskal's algorithm: the lightest edge that connects two parts, first in edge order among
    # equals.
    parts = Parts(graph.nodes)
    chosen = {
        name
        for name in sorted(candidates, key=lambda name: weights[name])
        if parts.join(graph.edge(name).tail, graph.edge(name).head)
    }
    return _tree_of(graph, chosen)


def named_tree(graph: LinearGraph, names: Iterable[str]) -> Tree:
    """Make the tree of the named edges, in any order.

    Raises TopologyError if a name is unknown or occurs twice, the edges contain a circuit, or they
    do not reach every node.
    """
    parts = Parts(graph.nodes)
    branches: set[str] = set()
    for name in names:
        edge = graph.edge(name)
        if name in branches:
            raise TopologyError(
                f"the tree of the {graph.domain} graph names edge '{name}' twice; name it once"
            )
        # Checked edge by edge, so that the message can name the circuit.
        if not parts.join(edge.tail, edge.head):
            # The edges named so far already connect the two nodes; the path between them closes the
            # circuit.
            circuit = [*path_between(graph, branches, edge.tail, edge.head), name]
            raise TopologyError(
                f"the tree of the {graph.domain} graph contains a circuit of the edges "
                f"{listed(circuit)}; remove one of them"
            )
        branches.add(name)
    check_spanned(
        graph, branches, "the tree's edges", "add an edge to the tree that reaches {them}"
    )
    return _tree_of(graph, branches)


def tree_walk(tree: Tree) -> tuple[TreeStep, ...]:
    """Walk the tree outwards: parents before children, siblings in edge order."""
    return walk_edges(tree.graph, tree.branches, tree.graph.reference)


class Parts:
    """The connected parts of a growing forest."""

    def __init__(self, nodes: Iterable[str]) -> None:
        self._above = {node: node for node in nodes}

    def join(self, a: str, b: str) -> bool:
        """Join the parts of two nodes; return False if they are in one part already."""
        top, other = self.top(a), self.top(b)
        # If both are in one part, this changes nothing.
        self._above[other] = top
        return top != other

    def top(self, node: str) -> str:
        """Return the node that represents the part of a node."""
        above = self._above
        while above[node] != node:
            above[node] = node = above[above[node]]  # halves the path for the next search
        return node


def _tree_of(graph: LinearGraph, branches: set[str]) -> Tree:
    return Tree(graph, tuple(name for name in graph.edge_names if name in branches))


def path_between(graph: LinearGraph, names: set[str], start: str, end: str) -> list[str]:
    """Return the edges from a node to another along a forest that connects them."""
    # From the end back to the start, since each node has one step that leads to it.
    step_to = {step.child: step for step in walk_edges(graph, names, start)}
    path: list[str] = []
    node = end
    while node != start:
        path.append(step_to[node].edge)
        node = step_to[node].parent
    return path[::-1]
