"""The tree of a linear graph, and its topology matrices.

Edges in the tree are branches, all others are chords ([1] section 1.1). The signs are such that
`incidence @ through = 0`, `cutset @ through = 0` ([1] eq. 1), `circuit @ across = 0` ([1] eq. 2)
and `cutset @ circuit.T = 0`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cotree.errors import TopologyError, listed
from cotree.graph.linear_graph import LinearGraph, TreeStep, check_spanned, walk_edges
from cotree.report import Table

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping


@dataclass(frozen=True)
class Tree:
    """A spanning tree of a graph; `select_tree` and `named_tree` create and check it.

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
        """Names of the chords, the edges of the cotree, in edge order."""
        # Includes edges that can never be branches, such as springs and loads.
        return tuple(name for name in self.graph.edge_names if name not in self._branch_set)

    def is_branch(self, name: str) -> bool:
        """Return whether an edge is in the tree.

        Raises
        ------
        TopologyError
            If the graph has no such edge.
        """
        # ``edge`` raises the error for an unknown name.
        return self.graph.edge(name).name in self._branch_set

    def summary(self) -> str:
        """Return a description of the tree in one line.

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
    """Return the spanning tree of minimum weight; edges without a finite weight are chords.

    Among equal weights, the first edge in edge order is selected.
    """
    for name in weights:
        graph.edge(name)
    # Candidates are in edge order; the stable sort keeps this order among equal weights.
    candidates = [name for name in graph.edge_names if math.isfinite(weights.get(name, math.inf))]
    check_spanned(
        graph,
        candidates,
        "edges that may be branches",
        f"connect {{them}} to '{graph.reference}' by such an edge (in mechanics a joint, an arm "
        "or a body)",
    )
    # Kruskal's algorithm.
    parts = Parts(graph.nodes)
    chosen = {
        name
        for name in sorted(candidates, key=lambda name: weights[name])
        if parts.join(graph.edge(name).tail, graph.edge(name).head)
    }
    return _tree_of(graph, chosen)


def named_tree(graph: LinearGraph, names: Iterable[str]) -> Tree:
    """Return the tree of the named edges; raise TopologyError unless they form a spanning tree."""
    parts = Parts(graph.nodes)
    branches: set[str] = set()
    for name in names:
        edge = graph.edge(name)
        if name in branches:
            raise TopologyError(
                f"the tree of the {graph.domain} graph names edge '{name}' twice; name it once"
            )
        # Check edge by edge, so that the message can name the circuit.
        if not parts.join(edge.tail, edge.head):
            # The new edge closes a circuit with the path between its ends.
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
    """Return the steps from the root outwards: parents before children, siblings in edge order."""
    return walk_edges(tree.graph, tree.branches, tree.graph.reference)


class Parts:
    """The connected parts of a growing forest."""

    def __init__(self, nodes: Iterable[str]) -> None:
        self._above = {node: node for node in nodes}

    def join(self, a: str, b: str) -> bool:
        """Join the parts of two nodes; return False if both are already in one part."""
        top, other = self.top(a), self.top(b)
        self._above[other] = top
        return top != other

    def top(self, node: str) -> str:
        """Return the node that represents the connected part of ``node``."""
        above = self._above
        while above[node] != node:
            above[node] = node = above[above[node]]  # halves the path for the next search
        return node


def _tree_of(graph: LinearGraph, branches: set[str]) -> Tree:
    return Tree(graph, tuple(name for name in graph.edge_names if name in branches))


def path_between(graph: LinearGraph, names: set[str], start: str, end: str) -> list[str]:
    """Return the edges of a forest on the path from one node to another."""
    # One step leads to each node, so the path is traced backwards from its end.
    step_to = {step.child: step for step in walk_edges(graph, names, start)}
    path: list[str] = []
    node = end
    while node != start:
        path.append(step_to[node].edge)
        node = step_to[node].parent
    return path[::-1]


@dataclass(frozen=True, eq=False)
class TopologyMatrix:
    """A matrix of -1, 0 and +1 with named rows and columns.

    Parameters
    ----------
    matrix : ndarray of int64, shape (n_rows, n_columns)
        The entries, read-only.
    rows : tuple of str
        Name of each row: a node, a branch or a chord.
    columns : tuple of str
        Name of each column: an edge.
    """

    matrix: npt.NDArray[np.int64]
    rows: tuple[str, ...]
    columns: tuple[str, ...]

    def __post_init__(self) -> None:
        self.matrix.setflags(write=False)

    def terms(self, row: str) -> tuple[tuple[int, str], ...]:
        """Return the sign and the column of each nonzero entry in a row."""
        entries = self.matrix[self.rows.index(row)]
        return tuple((int(entries[j]), self.columns[j]) for j in np.flatnonzero(entries))

    def summary(self) -> str:
        """Return the matrix as text, with the names of its rows and columns."""
        rows = [(name, *row) for name, row in zip(self.rows, self.matrix.tolist(), strict=True)]
        return Table(("", *self.columns), rows).text()


def incidence(graph: LinearGraph) -> TopologyMatrix:
    """Return the incidence matrix, (n_nodes, n_edges): +1 at an edge's tail, -1 at its head."""
    matrix = np.zeros((graph.n_nodes, graph.n_edges), dtype=np.int64)
    row_of = {node: i for i, node in enumerate(graph.nodes)}
    for j, edge in enumerate(graph.edges):
        # The through variable flows from tail to head: it leaves the tail and enters the head.
        matrix[row_of[edge.tail], j] = 1
        matrix[row_of[edge.head], j] = -1
    return TopologyMatrix(matrix, graph.nodes, graph.edge_names)


def f_cutset(tree: Tree) -> TopologyMatrix:
    """Return the f-cutset matrix of [1] eq. 1, (n_branches, n_edges), an identity in the branches.

    It is +1 for edges that cross the cut in the branch's direction, -1 in the opposite direction.
    """
    matrix, column_of = _with_identity(tree, tree.branches)
    row_of = {name: i for i, name in enumerate(tree.branches)}
    # Signs are opposite to those of the f-circuits, because cutset @ circuit.T = 0.
    for chord, branch, sign in _circuit_terms(tree):
        matrix[row_of[branch], column_of[chord]] = -sign
    return TopologyMatrix(matrix, tree.branches, tree.graph.edge_names)


def f_circuit(tree: Tree) -> TopologyMatrix:
    """Return the f-circuit matrix, [1] eq. 2, (n_chords, n_edges); chord columns form an identity.

    It is +1 for branches that the circuit follows in their direction, -1 in the opposite one.
    """
    # The column of a chord has a single entry, since a chord closes only its own f-circuit.
    matrix, column_of = _with_identity(tree, tree.chords)
    row_of = {name: i for i, name in enumerate(tree.chords)}
    for chord, branch, sign in _circuit_terms(tree):
        matrix[row_of[chord], column_of[branch]] = sign
    return TopologyMatrix(matrix, tree.chords, tree.graph.edge_names)


def _with_identity(
    tree: Tree, rows: tuple[str, ...]
) -> tuple[npt.NDArray[np.int64], dict[str, int]]:
    """Return a matrix with an identity in the columns ``rows``, and the index of each column."""
    # Columns are in edge order for both cutset and circuit matrices.
    column_of = {name: j for j, name in enumerate(tree.graph.edge_names)}
    matrix = np.zeros((len(rows), len(column_of)), dtype=np.int64)
    for i, name in enumerate(rows):
        matrix[i, column_of[name]] = 1
    return matrix, column_of


def _circuit_terms(tree: Tree) -> Iterator[tuple[str, str, int]]:
    """Return chord, branch and sign for every branch in every f-circuit.

    A circuit follows its chord from tail to head, and returns to the tail through the tree.
    """
    step_to = {step.child: step for step in tree_walk(tree)}
    depth = {tree.graph.reference: 0}
    for step in step_to.values():
        # The walk lists parents before children, so the parent's depth is known.
        depth[step.child] = depth[step.parent] + 1
    for chord in tree.chords:
        edge = tree.graph.edge(chord)
        # The path returns from the chord's head to its tail: steps on the head side count negative.
        tail, head = edge.tail, edge.head
        while tail != head:
            # Move the deeper end towards the root until both ends meet.
            if depth[head] >= depth[tail]:
                step = step_to[head]
                head = step.parent
                yield chord, step.edge, -step.sign
            else:
                step = step_to[tail]
                tail = step.parent
                yield chord, step.edge, step.sign
