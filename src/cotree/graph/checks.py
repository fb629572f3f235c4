"""Checks that every node of a graph can be reached from its reference."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.errors import TopologyError, listed
from cotree.graph.traversal import walk_edges

if TYPE_CHECKING:
    from collections.abc import Collection

    from cotree.graph.linear_graph import LinearGraph


def check_spanned(graph: LinearGraph, names: Collection[str], what: str, remedy: str) -> None:
    """Check that the named edges alone join every node to the reference.

    Parameters
    ----------
    graph : LinearGraph
        The graph.
    names : collection of str
        Names of the edges that count.
    what : str
        What these edges are called, for the message.
    remedy : str
        What to do about it, for the message; `{them}` in it stands for the nodes.

    Raises
    ------
    TopologyError
        If a node is not reached.
    """
    steps = walk_edges(graph, names, graph.reference)
    # Each step reaches one more node; the reference is reached by none.
    if len(steps) + 1 < graph.n_nodes:
        reached = {graph.reference, *(step.child for step in steps)}
        floating = [node for node in graph.nodes if node not in reached]
        raise TopologyError(_floating_message(graph, floating, what, remedy))


def _floating_message(graph: LinearGraph, floating: list[str], what: str, remedy: str) -> str:
    inside = set(floating)
    # Edges of any kind: the message also names those that cannot be branches.
    touching = [edge.name for edge in graph.edges if edge.tail in inside or edge.head in inside]
    subject, verb, them = (
        ("node", "is", "it") if len(floating) == 1 else ("nodes", "are", "one of them")
    )
    here = "it" if len(floating) == 1 else "them"
    if not touching:
        attached = f"no edge touches {here}"
    elif len(touching) == 1:
        attached = f"edge {touching[0]} touches {here}"
    else:
        attached = f"edges {listed(touching)} touch {here}"
    quoted = listed(f"'{node}'" for node in floating)
    return (
        f"{subject} {quoted} of the {graph.domain} graph "
        f"{verb} floating: {attached}{', but' if touching else ';'} no path of {what} leads there "
        f"from '{graph.reference}'; {remedy.format(them=them)}"
    )
