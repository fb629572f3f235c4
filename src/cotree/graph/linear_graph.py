"""The linear graph of one domain: named nodes and directed, named edges between them.

In: names. Out: a `LinearGraph`, checked on construction. [1] section 1.1, Fig. 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from cotree.errors import TopologyError, nearest

if TYPE_CHECKING:
    from collections.abc import Iterable


@dataclass(frozen=True)
class GraphEdge:
    """A directed edge. Its across variable is the one of `head` minus the one of `tail`.

    Parameters
    ----------
    name : str
        Name of the edge, unique in its graph.
    tail, head : str
        Names of the nodes where the edge begins and ends.
    kind : str
        What the edge stands for; carried along, not looked at.
    """

    name: str
    tail: str
    head: str
    kind: str


@dataclass(frozen=True)
class LinearGraph:
    """Nodes and directed edges of one domain; parallel edges are allowed.

    Parameters
    ----------
    domain : str
        Name of the domain.
    nodes : tuple of str
        Names of the nodes, the reference among them.
    edges : tuple of GraphEdge
        The edges, whose order all matrices keep.
    reference : str
        The node that across variables of nodes are measured from.

    Raises
    ------
    TopologyError
        If a name occurs twice, the reference is not a node, or an edge has an unknown node or joins
        a node to itself.

    Examples
    --------
    >>> edges = (GraphEdge("m", "ground", "A", "body"), GraphEdge("k", "ground", "A", "spring"))
    >>> print(LinearGraph("translation", ("ground", "A"), edges).summary())
    translation graph: 2 nodes, 2 edges, reference ground
      m  ground -> A  body
      k  ground -> A  spring
    """

    domain: str
    nodes: tuple[str, ...]
    edges: tuple[GraphEdge, ...]
    reference: str = "ground"

    def __post_init__(self) -> None:
        _check_unique("node", self.nodes, self.domain)
        # Two domains may use one name; within a graph it names a row or a column of the matrices.
        _check_unique("edge", (edge.name for edge in self.edges), self.domain)
        known = set(self.nodes)
        # Across variables of nodes are differences to the reference, and walks begin there.
        if self.reference not in known:
            raise TopologyError(
                f"the {self.domain} graph has no node '{self.reference}' to be its reference; "
                "connect an edge to it"
            )
        for edge in self.edges:
            for node in (edge.tail, edge.head):
                if node not in known:
                    raise TopologyError(
                        f"edge '{edge.name}' ends at unknown node '{node}'{nearest(node, known)}"
                    )
            # Such an edge is a circuit of its own: never a branch, and its across variable is zero.
            if edge.tail == edge.head:
                raise TopologyError(
                    f"edge '{edge.name}' joins node '{edge.tail}' to itself; give it two nodes"
                )

    @cached_property
    def _edge_by_name(self) -> dict[str, GraphEdge]:
        return {edge.name: edge for edge in self.edges}

    @property
    def n_nodes(self) -> int:
        """Number of nodes, the reference included."""
        return len(self.nodes)

    @property
    def n_edges(self) -> int:
        """Number of edges."""
        return len(self.edges)

    @cached_property
    def edge_names(self) -> tuple[str, ...]:
        """Names of the edges, in their order."""
        # Dictionaries keep the order of insertion, which is that of the edges.
        return tuple(self._edge_by_name)

    def edge(self, name: str) -> GraphEdge:
        """Look an edge up by its name.

        Raises
        ------
        TopologyError
            If no edge has this name.
        """
        try:
            return self._edge_by_name[name]
        except KeyError:
            raise TopologyError(
                f"the {self.domain} graph has no edge '{name}'{nearest(name, self._edge_by_name)}"
            ) from None

    def summary(self) -> str:
        """Describe the graph, one line an edge."""
        head = (
            f"{self.domain} graph: {self.n_nodes} nodes, {self.n_edges} edges, "
            f"reference {self.reference}"
        )
        names, ends = _widths(self.edges)
        lines = (
            f"  {edge.name:<{names}}  {f'{edge.tail} -> {edge.head}':<{ends}}  {edge.kind}"
            for edge in self.edges
        )
        return "\n".join([head, *lines])


def _check_unique(noun: str, names: Iterable[str], domain: str) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise TopologyError(
                f"{noun} '{name}' occurs twice in the {domain} graph; rename one of them"
            )
        seen.add(name)


def _widths(edges: tuple[GraphEdge, ...]) -> tuple[int, int]:
    """Widths of the columns of names and of `tail -> head`."""
    names = max((len(edge.name) for edge in edges), default=0)
    ends = max((len(f"{edge.tail} -> {edge.head}") for edge in edges), default=0)
    return names, ends
