"""Two trees that share their edges, against all that there are."""

from __future__ import annotations

import itertools
import random

import pytest

from cotree.errors import TopologyError
from cotree.graph import GraphEdge, LinearGraph, named_tree, select_common_trees


def _graph(rng, n_nodes, n_edges):
    nodes = ("ground", *(f"n{i}" for i in range(1, n_nodes)))
    pairs = [rng.sample(nodes, 2) for _ in range(n_edges)]
    return LinearGraph(
        "electrical", nodes, tuple(GraphEdge(f"e{i}", a, b, "") for i, (a, b) in enumerate(pairs))
    )


def _is_tree(graph, names):
    try:
        named_tree(graph, names)
    except TopologyError:
        return False
    return True


def _ranked(names, weights):
    """Count how many edges of each weight there are, the least weight first."""
    return [-sum(weights[name] == weight for name in names) for weight in (0, 1, 2)]


@pytest.mark.parametrize("seed", range(60))
def test_the_best_of_all_pairs_of_trees(seed):
    rng = random.Random(seed)
    n_nodes = rng.randint(3, 6)
    graph = _graph(rng, n_nodes, rng.randint(n_nodes + 1, 10))
    names = list(graph.edge_names)
    rng.shuffle(names)
    k = rng.randint(1, 2)
    first, second, rest = names[:k], names[k : 2 * k], names[2 * k :]
    weights = {name: rng.randint(0, 2) for name in rest}
    possible = [
        shared
        for shared in itertools.combinations(rest, n_nodes - 1 - k)
        if _is_tree(graph, [*shared, *first]) and _is_tree(graph, [*shared, *second])
    ]
    if not possible:
        with pytest.raises(TopologyError):
            select_common_trees(graph, weights, first, second)
        return
    trees = select_common_trees(graph, weights, first, second)
    shared = set(trees[0].branches) & set(trees[1].branches)
    assert set(trees[0].branches) == shared | set(first)
    assert set(trees[1].branches) == shared | set(second)
    assert tuple(sorted(shared)) in {tuple(sorted(names)) for names in possible}
    assert _ranked(shared, weights) == min(_ranked(names, weights) for names in possible)


def test_edges_without_a_finite_weight_are_never_shared():
    edges = [("a", "ground", "A"), ("b", "ground", "A"), ("in", "A", "B"), ("out", "B", "ground")]
    graph = LinearGraph(
        "electrical", ("ground", "A", "B"), tuple(GraphEdge(n, t, h, "") for n, t, h in edges)
    )
    weights = {"a": float("inf"), "b": 3.0}
    trees = select_common_trees(graph, weights, ["in"], ["out"])
    assert [tree.branches for tree in trees] == [("b", "in"), ("b", "out")]
