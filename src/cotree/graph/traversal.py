"""Walking from node to node along a set of edges: the one traversal that everything else uses."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection

    from cotree.graph.linear_graph import LinearGraph


@dataclass(frozen=True)
class TreeStep:
    """One step of a walk, from a node that is known to one that is not.

    Parameters
    ----------
    edge : str
        Name of the edge that is walked along.
    parent, child : str
        The node the step leaves and the node it reaches.
    sign : int
        +1 if the edge points from parent to child, -1 if it points back.
    """

    edge: str
    parent: str
    child: str
    sign: int


def walk_edges(graph: LinearGraph, names: Collection[str], start: str) -> tuple[TreeStep, ...]:
    """Walk depth first from `start` along the named edges, reaching each node once.

    Parameters
    ----------
    graph : LinearGraph
        The graph.
    names : collection of str
        Names of the edges that may be used.
    start : str
        The node to start from.

    Returns
    -------
    tuple of TreeStep
        Parents before children, siblings in edge order, a subtree without interruption. Costs O(n),
        and no recursion, so that long chains are no danger.
    """
    allowed = names if isinstance(names, (set, frozenset)) else set(names)
    leaving: defaultdict[str, list[TreeStep]] = defaultdict(list)
    # Backwards, so that the stack gives the edges back in their own order.
    for edge in reversed(graph.edges):
        if edge.name in allowed:
            leaving[edge.tail].append(TreeStep(edge.name, edge.tail, edge.head, 1))
            # A walk ignores the direction of edges, and notes it in the sign.
            leaving[edge.head].append(TreeStep(edge.name, edge.head, edge.tail, -1))
    steps: list[TreeStep] = []
    reached = {start}
    stack = list(leaving[start])
    while stack:
        step = stack.pop()
        # An edge of a circuit may lead to a node that was reached since the edge was put on the
        # stack.
        if step.child not in reached:
            reached.add(step.child)
            steps.append(step)
            stack.extend(leaving[step.child])
    return tuple(steps)
