from __future__ import annotations

import math

import pytest

from cotree.errors import TopologyError
from cotree.graph import GraphEdge, LinearGraph, named_tree, select_tree

NAMES = ("m5", "m6", "j1", "r3", "h2", "r4", "k")


@pytest.fixture
def pendulum() -> LinearGraph:
    ends = ("ground A", "ground C", "ground A", "A D", "D B", "B C", "ground A")
    edges = tuple(
        GraphEdge(name, *pair.split(), "x") for name, pair in zip(NAMES, ends, strict=True)
    )
    return LinearGraph("translation", ("ground", "A", "D", "B", "C"), edges)


def test_lightest_tree_is_selected(pendulum: LinearGraph):
    weights = {"m5": 6.0, "m6": 6.0, "j1": 1.0, "r3": 0.0, "h2": 1.0, "r4": 0.0}
    tree = select_tree(pendulum, weights)
    assert tree.branches == ("j1", "r3", "h2", "r4")
    assert tree.chords == ("m5", "m6", "k")
    assert tree.is_branch("h2")
    assert not tree.is_branch("k")


def test_ties_are_broken_by_edge_order_not_by_the_mapping(pendulum: LinearGraph):
    expected = ("m5", "m6", "r3", "h2")
    assert select_tree(pendulum, dict.fromkeys(NAMES, 1.0)).branches == expected
    assert select_tree(pendulum, dict.fromkeys(reversed(NAMES), 1.0)).branches == expected


def test_edges_without_finite_weight_stay_chords(pendulum: LinearGraph):
    weights = dict.fromkeys(NAMES, 1.0) | {"m5": math.inf, "m6": math.nan}
    assert select_tree(pendulum, weights).branches == ("j1", "r3", "h2", "r4")


def test_nodes_out_of_reach_are_named_with_their_edges(pendulum: LinearGraph):
    with pytest.raises(TopologyError) as caught:
        select_tree(pendulum, {"j1": 1.0, "r3": 0.0, "r4": 0.0})
    assert str(caught.value) == (
        "nodes 'B', 'C' of the translation graph are floating: edges m6, h2, r4 touch them, but no "
        "path of edges that may be branches leads there from 'ground'; connect one of them to "
        "'ground' by such an edge (in mechanics a joint, an arm or a body)"
    )


def test_weight_of_an_unknown_edge_is_refused(pendulum: LinearGraph):
    with pytest.raises(TopologyError, match="no edge 'j2'"):
        select_tree(pendulum, dict.fromkeys(NAMES, 1.0) | {"j2": 1.0})


def test_named_tree_is_put_in_edge_order(pendulum: LinearGraph):
    tree = named_tree(pendulum, ["r4", "r3", "m6", "m5"])
    assert tree.branches == ("m5", "m6", "r3", "r4")
    assert tree.summary() == "translation tree: branches m5, m6, r3, r4; chords j1, h2, k"


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["j1", "r33", "h2", "r4"], "no edge 'r33'; did you mean 'r3'"),
        (["j1", "j1", "h2", "r4"], "names edge 'j1' twice"),
        (["j1", "k", "r3", "h2"], "contains a circuit of the edges j1, k; remove one"),
        (["m6", "r4", "h2", "r3", "j1"], "circuit of the edges m6, r4, h2, r3, j1; remove one"),
        (
            ["j1", "r3", "r4"],
            r"'B', 'C' .* floating: edges m6, h2, r4 touch them, but no path of the tree's edges",
        ),
        ([], "'A', 'D', 'B', 'C' .* floating"),
    ],
)
def test_named_edges_that_are_no_tree(pendulum: LinearGraph, names: list[str], message: str):
    with pytest.raises(TopologyError, match=message):
        named_tree(pendulum, names)


def test_single_node_has_an_empty_tree():
    tree = select_tree(LinearGraph("rotation", ("ground",), ()), {})
    assert tree.branches == tree.chords == ()
    assert tree.summary() == "rotation tree: branches none; chords none"
