"""Sums along paths and beyond branches, written out, are the f-circuit and f-cutset matrices."""

from __future__ import annotations

import random
from collections import Counter

import pytest

from cotree.formulation.networks.topology import Topology
from cotree.graph import LinearGraph, Tree
from cotree.graph.linear_graph import GraphEdge
from cotree.graph.tree import f_circuit, f_cutset


def drawn(seed: int) -> Tree:
    """A tree of some nodes, long or bushy, and chords anywhere."""
    rng = random.Random(seed)
    nodes = ["ground", *(f"n{i}" for i in range(1, rng.randint(2, 16)))]
    edges, reach = [], rng.randint(1, 6)
    for i in range(1, len(nodes)):
        ends = [nodes[rng.randrange(max(0, i - reach), i)], nodes[i]]
        rng.shuffle(ends)
        edges.append(GraphEdge(f"b{i}", *ends, "x"))
    edges += [GraphEdge(f"c{k}", *rng.sample(nodes, 2), "x") for k in range(rng.randint(0, 14))]
    rng.shuffle(edges)
    graph = LinearGraph("electrical", tuple(nodes), tuple(edges))
    return Tree(graph, tuple(edge.name for edge in edges if edge.name[0] == "b"))


def expanded(topology: Topology, sum_of, sign: int = 1) -> Counter:
    """Write a sum out in branches or chords."""
    found: Counter = Counter()
    for own, (quantity, name) in sum_of.terms:
        if quantity == "flow":
            found.update(expanded(topology, topology.flow(name, ""), sign * own))
        elif quantity == "path":
            _, ancestor, node = name.split("|")
            found.update(expanded(topology, topology.path(ancestor, node, ""), sign * own))
        else:
            found[name] += sign * own
    return found


@pytest.mark.parametrize("seed", range(60))
def test_sums_are_the_rows_of_the_matrices(seed):
    tree = drawn(seed)
    topology = Topology("electrical", tree)
    for matrix, row_of in (
        (f_cutset(tree), topology.cutset),
        (f_circuit(tree), topology.circuit),
    ):
        for name in matrix.rows:
            # Each row says that its own edge and the others add up to nothing.
            wanted = {other: -sign for sign, other in matrix.terms(name) if other != name}
            found = {k: v for k, v in expanded(topology, row_of(name, "")).items() if v}
            assert found == wanted
