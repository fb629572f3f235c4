"""Mass matrices bordered by constraints: by the matrix, or along the tree that it belongs to."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.linear.factors import factorise
from cotree.linear.tree import factorise_tree

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.linear.factors import RankedSolver
    from cotree.linear.tree import TreeLink


def factorise_bordered(
    dag: Dag,
    matrix: Sequence[Sequence[Node]],
    is_safe: Sequence[bool],
    sizes: Sequence[Sequence[Node]],
    links: Sequence[TreeLink],
) -> RankedSolver:
    """Factorise a bordered mass matrix, along its tree where ``links`` describe one.

    Parameters
    ----------
    dag : Dag
        The arena.
    matrix : sequence of rows of Node
        [M, -G^T; -G, 0], symmetric; along a tree the rows of M are not read.
    is_safe : sequence of bool
        Whether the pivot of each unknown is known to be nonzero.
    sizes : sequence of rows of Node
        For each multiplier, squares of what its row is made of, before anything cancels.
    links : sequence of TreeLink
        The tree; empty where the matrix is eliminated.
    """
    if not links:
        return factorise(dag, matrix, is_safe, sizes)
    n = len(matrix) - len(sizes)
    return factorise_tree(dag, links, [row[:n] for row in matrix[n:]], sizes, n)
