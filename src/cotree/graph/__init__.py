"""Linear graphs: nodes, directed edges, trees, topology matrices, and walks along trees."""

from __future__ import annotations

from cotree.graph.linear_graph import GraphEdge, LinearGraph, TreeStep
from cotree.graph.tree import (
    TopologyMatrix,
    Tree,
    f_circuit,
    f_cutset,
    incidence,
    named_tree,
    select_tree,
    tree_walk,
)

__all__ = [
    "GraphEdge",
    "LinearGraph",
    "TopologyMatrix",
    "Tree",
    "TreeStep",
    "f_circuit",
    "f_cutset",
    "incidence",
    "named_tree",
    "select_tree",
    "tree_walk",
]
