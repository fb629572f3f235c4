"""Incidence, f-cutset and f-circuit matrices, built from the walk over the tree.

In: a `LinearGraph` or a `Tree`. Out: integer matrices with their rows and columns named, columns in
edge order. The signs are such that `incidence @ through = 0`, `cutset @ through = 0` ([1] eq. 1),
`circuit @ across = 0` ([1] eq. 2) and `cutset @ circuit.T = 0`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cotree.graph.tree import tree_walk
from cotree.report import Table

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cotree.graph.linear_graph import LinearGraph
    from cotree.graph.tree import Tree


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
        """List sign and column of the nonzero entries of a row."""
        entries = self.matrix[self.rows.index(row)]
        return tuple((int(entries[j]), self.columns[j]) for j in np.flatnonzero(entries))

    def summary(self) -> str:
        """Describe the matrix with the names of its rows and columns."""
        rows = [(name, *row) for name, row in zip(self.rows, self.matrix.tolist(), strict=True)]
        return Table(("", *self.columns), rows).text()


def incidence(graph: LinearGraph) -> TopologyMatrix:
    """Form the incidence matrix, (n_nodes, n_edges): +1 at the tail of an edge, -1 at its head."""
    matrix = np.zeros((graph.n_nodes, graph.n_edges), dtype=np.int64)
    row_of = {node: i for i, node in enumerate(graph.nodes)}
    for j, edge in enumerate(graph.edges):
        # Through variables flow from tail to head, so that a row sums the flows out of its node.
        matrix[row_of[edge.tail], j] = 1
        matrix[row_of[edge.head], j] = -1
    return TopologyMatrix(matrix, graph.nodes, graph.edge_names)


def f_cutset(tree: Tree) -> TopologyMatrix:
    """Form the f-cutset matrix, (n_branches, n_edges), of [1] eq. 1.

    One row per branch, with +1 for the branch and for each edge that crosses the cut in its
    direction, -1 for those that cross against it. The columns of the branches are the identity.
    """
    matrix, column_of = _with_identity(tree, tree.branches)
    row_of = {name: i for i, name in enumerate(tree.branches)}
    # The chord's f-circuit contains a branch exactly if the branch's f-cutset contains the chord,
    # with the opposite sign.
    for chord, branch, sign in _circuit_terms(tree):
        matrix[row_of[branch], column_of[chord]] = -sign
    return TopologyMatrix(matrix, tree.branches, tree.graph.edge_names)


def f_circuit(tree: Tree) -> TopologyMatrix:
    """Form the f-circuit matrix, (n_chords, n_edges), of [1] eq. 2.

    One row per chord, with +1 for the chord and for each branch that the circuit follows in its
    direction, -1 for those against it. The columns of the chords are the identity.
    """
    # Each chord closes exactly one f-circuit, so that its own column has a single entry.
    matrix, column_of = _with_identity(tree, tree.chords)
    row_of = {name: i for i, name in enumerate(tree.chords)}
    for chord, branch, sign in _circuit_terms(tree):
        matrix[row_of[chord], column_of[branch]] = sign
    return TopologyMatrix(matrix, tree.chords, tree.graph.edge_names)


def _with_identity(
    tree: Tree, rows: tuple[str, ...]
) -> tuple[npt.NDArray[np.int64], dict[str, int]]:
    """Return a matrix with an identity in the columns of `rows`, and the map to columns."""
    # Columns are in edge order, so that cutset and circuit matrices share them.
    column_of = {name: j for j, name in enumerate(tree.graph.edge_names)}
    matrix = np.zeros((len(rows), len(column_of)), dtype=np.int64)
    for i, name in enumerate(rows):
        matrix[i, column_of[name]] = 1
    return matrix, column_of


def _circuit_terms(tree: Tree) -> Iterator[tuple[str, str, int]]:
    """Yield chord, branch and sign for every branch of every f-circuit.

    A circuit follows its chord from tail to head and returns to the tail through the tree. Only the
    steps below the point at which the two paths meet are visited, so the cost is the number of
    terms.
    """
    step_to = {step.child: step for step in tree_walk(tree)}
    depth = {tree.graph.reference: 0}
    for step in step_to.values():
        # The walk lists parents before children, so that the depth of the parent is known.
        depth[step.child] = depth[step.parent] + 1
    for chord in tree.chords:
        edge = tree.graph.edge(chord)
        # Up from the head is against the path from the reference, hence the minus sign.
        tail, head = edge.tail, edge.head
        while tail != head:
            # The deeper end cannot be on the path of the other: move it.
            if depth[head] >= depth[tail]:
                step = step_to[head]
                head = step.parent
                yield chord, step.edge, -step.sign
            else:
                step = step_to[tail]
                tail = step.parent
                yield chord, step.edge, step.sign
