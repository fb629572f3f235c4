"""Forests of two graphs at once, against all that there are."""

from __future__ import annotations

import itertools
import random

import pytest

from cotree.errors import TopologyError
from cotree.graph.common_forest import Contracted, common_forest


def _ends(rng, n_nodes, names):
    nodes = [f"n{i}" for i in range(n_nodes)]
    return {name: tuple(rng.sample(nodes, 2)) for name in names}


def _is_forest(ends, names):
    try:
        Contracted(ends, names)
    except TopologyError:
        return False
    return True


@pytest.mark.parametrize("seed", range(60))
def test_the_best_of_all_common_forests(seed):
    """With some edges contracted in each graph, as nullators and norators are."""
    rng = random.Random(seed)
    names = [f"e{i}" for i in range(rng.randint(5, 10))]
    first, second = (_ends(rng, rng.randint(3, 6), names) for _ in range(2))
    inputs, outputs, *rest = names
    costs = {name: rng.randint(-3, 3) for name in rest}
    possible = [
        shared
        for n in range(len(rest) + 1)
        for shared in itertools.combinations(rest, n)
        if _is_forest(first, [*shared, inputs]) and _is_forest(second, [*shared, outputs])
    ]
    found = common_forest(Contracted(first, [inputs]), Contracted(second, [outputs]), costs)
    assert tuple(name for name in rest if name in found) in set(possible)
    most = max(map(len, possible))
    assert len(found) == most
    least = min(sum(costs[n] for n in names) for names in possible if len(names) == most)
    assert sum(costs[name] for name in found) == least


@pytest.mark.parametrize("seed", range(60))
def test_the_best_of_all_trees_with_one_edge_of_each_pair(seed):
    rng = random.Random(seed)
    n_nodes = rng.randint(4, 7)
    names = [f"e{i}" for i in range(11)]
    ends = _ends(rng, n_nodes, names)
    pairs = [("e0", "e1"), ("e2", "e3"), ("e4", "e5")]
    apart = {name: (f"{name}+", f"{name}-") for name in names}
    apart |= {second: apart[first] for first, second in pairs}
    costs = {name: rng.randint(0, 3) for name in names}
    preferred = {
        name: cost - 100 * any(name in pair for pair in pairs) for name, cost in costs.items()
    }
    found = common_forest(Contracted(ends), Contracted(apart), preferred)
    possible = [
        names
        for names in itertools.combinations(costs, n_nodes - 1)
        if _is_forest(ends, names) and all((a in names) != (b in names) for a, b in pairs)
    ]
    is_one_of_each = all((a in found) != (b in found) for a, b in pairs)
    assert (is_one_of_each and len(found) == n_nodes - 1) == bool(possible)
    if possible:
        least = min(sum(costs[name] for name in names) for names in possible)
        assert sum(costs[name] for name in found) == least


def test_edges_of_equal_cost_are_taken_in_their_order():
    names = ["b", "c", "a", "d"]
    ends = dict.fromkeys(names, ("0", "1"))
    assert common_forest(Contracted(ends), Contracted(ends), dict.fromkeys(names, 1)) == {"b"}


def test_contracted_edges_in_a_circuit_are_refused():
    with pytest.raises(TopologyError, match="'b'"):
        Contracted({"a": ("0", "1"), "b": ("1", "0")}, ["a", "b"])
