"""The walk over the tree of a linear graph, from its reference outwards."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.graph.traversal import TreeStep, walk_edges

if TYPE_CHECKING:
    from cotree.graph.tree import Tree


def tree_walk(tree: Tree) -> tuple[TreeStep, ...]:
    """Walk the tree from the reference node outwards.

    Parameters
    ----------
    tree : Tree
        The tree.

    Returns
    -------
    tuple of TreeStep
        One step a branch: parents before children, siblings in edge order.
    """
    return walk_edges(tree.graph, tree.branches, tree.graph.reference)
