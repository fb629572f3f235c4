"""Identities of linear graphs on random connected multigraphs, and the paper's Fig. 1 exactly."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cotree.graph import (
    GraphEdge,
    LinearGraph,
    Tree,
    f_circuit,
    f_cutset,
    incidence,
    named_tree,
    select_tree,
    tree_walk,
)


@st.composite
def trees(draw: st.DrawFn) -> Tree:
    """Draw a connected multigraph with a random tree: parallel edges, any orientation and order."""
    n = draw(st.integers(1, 9))
    pairs = [(draw(st.integers(0, i - 1)), i) for i in range(1, n)]
    if n > 1:
        ends = st.tuples(st.integers(0, n - 1), st.integers(0, n - 1))
        pairs += draw(st.lists(ends.filter(lambda pair: pair[0] != pair[1]), max_size=12))
    pairs = draw(st.permutations(pairs))
    edges = tuple(
        GraphEdge(f"e{j}", f"n{pair[flip]}", f"n{pair[1 - flip]}", "x")
        for j, pair in enumerate(pairs)
        for flip in [draw(st.integers(0, 1))]
    )
    graph = LinearGraph("test", tuple(f"n{i}" for i in range(n)), edges, "n0")
    return select_tree(graph, {edge.name: draw(st.floats(0, 1)) for edge in edges})


def random_values(seed: int, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    # Three components a variable, small integers: every sum below is exact in floating point.
    values = np.random.default_rng(seed).integers(-99, 100, size=(len(names), 3)).astype(float)
    return dict(zip(names, values, strict=True))


seeds = st.integers(0, 2**32 - 1)


@given(trees())
def test_f_cutsets_and_f_circuits_are_orthogonal_with_identities(tree: Tree):
    cutset, circuit = f_cutset(tree), f_circuit(tree)
    assert cutset.columns == circuit.columns == tree.graph.edge_names
    assert not (cutset.matrix @ circuit.matrix.T).any()
    branches = [tree.graph.edge_names.index(name) for name in cutset.rows]
    chords = [tree.graph.edge_names.index(name) for name in circuit.rows]
    np.testing.assert_array_equal(cutset.matrix[:, branches], np.eye(len(branches)))
    np.testing.assert_array_equal(circuit.matrix[:, chords], np.eye(len(chords)))


@given(trees())
def test_f_cutset_is_the_reduced_incidence_solved_for_the_branches(tree: Tree):
    graph = tree.graph
    reduced = np.delete(incidence(graph).matrix, graph.nodes.index(graph.reference), axis=0)
    branches = [graph.edge_names.index(name) for name in tree.branches]
    expected = np.linalg.solve(reduced[:, branches].astype(float), reduced.astype(float))
    # The reduced incidence of a tree is unimodular with an inverse of -1, 0, 1: rounding only.
    np.testing.assert_allclose(f_cutset(tree).matrix, expected, rtol=0, atol=1e-12)


@given(trees(), seeds)
def test_tellegen(tree: Tree, seed: int):
    graph = tree.graph
    potential = random_values(seed, graph.nodes)
    across = np.array([potential[e.head] - potential[e.tail] for e in graph.edges]).reshape(-1, 3)
    chords = random_values(seed + 1, tree.chords)
    cutset = f_cutset(tree)
    branches = {
        row: -sum((s * chords[n] for s, n in cutset.terms(row) if n != row), np.zeros(3))
        for row in cutset.rows
    }
    through = np.array([(chords | branches)[e.name] for e in graph.edges]).reshape(-1, 3)
    assert not (incidence(graph).matrix @ through).any()
    assert not (f_circuit(tree).matrix @ across).any()
    # Sums of integers below 2**53 are exact, so nothing is left to rounding.
    assert np.sum(across * through) == 0.0


@given(trees())
def test_walk_reaches_parents_before_children(tree: Tree):
    reached = {tree.graph.reference}
    for step in tree_walk(tree):
        edge = tree.graph.edge(step.edge)
        ends = (edge.tail, edge.head) if step.sign > 0 else (edge.head, edge.tail)
        assert (step.parent, step.child) == ends
        assert step.parent in reached
        assert step.child not in reached
        reached.add(step.child)
    assert reached == set(tree.graph.nodes)


@pytest.fixture
def spring_mass_damper() -> Tree:
    edges = tuple(GraphEdge(name, "ground", "A", "x") for name in ("m", "k", "c", "F", "s"))
    return named_tree(LinearGraph("translation", ("ground", "A"), edges), ["m"])


def test_figure_1_has_one_f_cutset(spring_mass_damper: Tree):
    cutset = f_cutset(spring_mass_damper)
    assert (cutset.rows, cutset.columns) == (("m",), ("m", "k", "c", "F", "s"))
    assert cutset.matrix.tolist() == [[1, 1, 1, 1, 1]]


def test_figure_1_has_four_f_circuits(spring_mass_damper: Tree):
    circuit = f_circuit(spring_mass_damper)
    assert circuit.rows == ("k", "c", "F", "s")
    assert [circuit.terms(row) for row in circuit.rows] == [
        ((-1, "m"), (1, row)) for row in circuit.rows
    ]
    assert circuit.summary().splitlines()[:2] == ["    m  k  c  F  s", "k  -1  1  0  0  0"]


def test_incidence_is_plus_one_at_the_tail(spring_mass_damper: Tree):
    matrix = incidence(spring_mass_damper.graph)
    assert matrix.rows == ("ground", "A")
    assert matrix.matrix.tolist() == [[1] * 5, [-1] * 5]


def test_matrices_are_read_only(spring_mass_damper: Tree):
    with pytest.raises(ValueError, match="read-only"):
        f_cutset(spring_mass_damper).matrix[0, 0] = 2


def test_long_chain_needs_neither_recursion_nor_quadratic_time():
    n = 10_000
    nodes = ("ground", *(f"n{i}" for i in range(n)))
    edges = tuple(GraphEdge(f"e{i}", nodes[i], nodes[i + 1], "x") for i in range(n))
    chord = GraphEdge("c", "ground", nodes[-1], "x")
    graph = LinearGraph("test", nodes, (*edges, chord))
    begin = time.perf_counter()
    tree = named_tree(graph, [edge.name for edge in edges])
    assert select_tree(graph, dict.fromkeys(graph.edge_names, 1.0)).chords == ("c",)
    assert len(f_circuit(tree).terms("c")) == n + 1
    # Takes about 0.2 s; 10,000 nodes in quadratic time would take a minute.
    assert time.perf_counter() - begin < 10
