"""Linear graphs: nodes, directed edges, trees, and the matrices and walks that follow from them.

Pure topology. What the edges mean is known to the rooms above.
"""

from __future__ import annotations

from cotree.graph.checks import check_connected
from cotree.graph.common_forest import Contracted, common_forest
from cotree.graph.linear_graph import GraphEdge, LinearGraph
from cotree.graph.matrices import TopologyMatrix, f_circuit, f_cutset, incidence
from cotree.graph.traversal import Step
from cotree.graph.tree import Tree, named_tree, select_tree
from cotree.graph.walks import prefix_sums, suffix_sums, tree_walk

__all__ = [
    "Contracted",
    "GraphEdge",
    "LinearGraph",
    "Step",
    "TopologyMatrix",
    "Tree",
    "check_connected",
    "common_forest",
    "f_circuit",
    "f_cutset",
    "incidence",
    "named_tree",
    "prefix_sums",
    "select_tree",
    "suffix_sums",
    "tree_walk",
]
