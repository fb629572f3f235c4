"""The chosen tree has the least weight that networkx finds."""

from __future__ import annotations

import random

import networkx
import pytest

from cotree.graph import GraphEdge, LinearGraph, select_tree


@pytest.mark.parametrize("seed", range(20))
def test_weight_is_that_of_networkx(seed):
    rng = random.Random(seed)
    nodes = ("ground", *(f"n{i}" for i in range(1, 12)))
    pairs = [(nodes[rng.randrange(i)], nodes[i]) for i in range(1, len(nodes))]
    pairs += [tuple(rng.sample(nodes, 2)) for _ in range(15)]
    edges = tuple(GraphEdge(f"e{i}", a, b, "x") for i, (a, b) in enumerate(pairs))
    weights = {edge.name: float(rng.randrange(5)) for edge in edges}
    tree = select_tree(LinearGraph("test", nodes, edges), weights)
    other = networkx.MultiGraph()
    for edge in edges:
        other.add_edge(edge.tail, edge.head, weight=weights[edge.name])
    least = networkx.minimum_spanning_tree(other).size(weight="weight")
    assert sum(weights[name] for name in tree.branches) == least
    assert len(tree.branches) == len(nodes) - 1
