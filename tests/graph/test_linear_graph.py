from __future__ import annotations

import pytest

from cotree.errors import TopologyError
from cotree.graph import GraphEdge, LinearGraph
from cotree.graph.linear_graph import check_spanned


def graph_of(nodes: str, *edges: str) -> LinearGraph:
    """Build a graph from a string of nodes and strings 'name tail head'."""
    return LinearGraph(
        "translation", tuple(nodes.split()), tuple(GraphEdge(*e.split(), "x") for e in edges)
    )


def check_connected(graph: LinearGraph) -> None:
    """Check that all edges together join every node to the reference."""
    check_spanned(graph, graph.edge_names, "edges", f"connect {{them}} to '{graph.reference}'")


def test_edge_is_found_by_name_and_counted():
    graph = graph_of("ground A", "m ground A", "k A ground")
    assert graph.edge("k") == GraphEdge("k", "A", "ground", "x")
    assert (graph.n_nodes, graph.n_edges, graph.edge_names) == (2, 2, ("m", "k"))


def test_unknown_edge_names_the_nearest():
    with pytest.raises(TopologyError, match="no edge 'spring'; did you mean 'spring1'"):
        graph_of("ground A", "spring1 ground A").edge("spring")


def test_summary_has_a_line_an_edge():
    lines = graph_of("ground A", "m ground A", "k A ground").summary().splitlines()
    assert lines == [
        "translation graph: 2 nodes, 2 edges, reference ground",
        "  m  ground -> A  x",
        "  k  A -> ground  x",
    ]


@pytest.mark.parametrize(
    ("nodes", "edges", "message"),
    [
        ("ground A A", ["m ground A"], "node 'A' occurs twice"),
        ("ground A", ["m ground A", "m A ground"], "edge 'm' occurs twice"),
        ("A B", ["m A B"], "no node 'ground'"),
        ("ground Alpha", ["m ground Alfa"], "edge 'm' ends at unknown node 'Alfa'; did you mean"),
        ("ground A", ["m A A"], "edge 'm' connects node 'A' to itself"),
    ],
)
def test_wrong_graph_is_refused(nodes: str, edges: list[str], message: str):
    with pytest.raises(TopologyError, match=message):
        graph_of(nodes, *edges)


def test_floating_nodes_are_named_with_their_edges():
    graph = graph_of("ground A B C D", "m ground A", "h2 D B", "r4 B C")
    with pytest.raises(TopologyError) as caught:
        check_connected(graph)
    assert str(caught.value) == (
        "nodes 'B', 'C', 'D' of the translation graph are floating: edges h2, r4 touch them, but "
        "no path of edges leads there from 'ground'; connect one of them to 'ground'"
    )


def test_floating_node_without_edges():
    with pytest.raises(TopologyError, match=r"node 'B' .* is floating: no edge touches it"):
        check_connected(graph_of("ground A B", "m ground A"))


def test_many_floating_nodes_are_cut_short():
    graph = graph_of("ground " + " ".join(f"n{i}" for i in range(20)))
    with pytest.raises(TopologyError, match=r"'n7' and 12 more"):
        check_connected(graph)


def test_connected_graph_passes():
    check_connected(graph_of("ground A B", "m ground A", "k B A"))
