"""The linear graph of one domain: named nodes and directed edges ([1] section 1.1, Fig. 1)."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from cotree.errors import TopologyError, check_known, listed, nearest
from cotree.report import Table

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable


@dataclass(frozen=True)
class GraphEdge:
    """A directed edge; its across variable is the potential of ``head`` minus that of ``tail``."""

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
        Names of the nodes, including the reference.
    edges : tuple of GraphEdge
        The edges; all matrices keep their order.
    reference : str
        The node relative to which node potentials are measured.

    Raises
    ------
    TopologyError
        If a name occurs twice, the reference is not a node, an edge has an unknown node, or both
        ends of an edge are the same node.

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
        # Names must be unique within a domain: they become rows and columns of its matrices.
        _check_unique("edge", (edge.name for edge in self.edges), self.domain)
        known = frozenset(self.nodes)
        # Node potentials are relative to the reference, at which walks start.
        if self.reference not in known:
            raise TopologyError(
                f"the {self.domain} graph has no node '{self.reference}' to be its reference; "
                "connect an edge to it"
            )
        for edge in self.edges:
            what = f"edge '{edge.name}' ends at unknown node"
            check_known((edge.tail, edge.head), known, what, error=TopologyError)
            # A self-loop would be a circuit of one edge, whose across variable is always zero.
            if edge.tail == edge.head:
                raise TopologyError(
                    f"edge '{edge.name}' connects node '{edge.tail}' to itself; give it two nodes"
                )

    @cached_property
    def _edge_by_name(self) -> dict[str, GraphEdge]:
        return {edge.name: edge for edge in self.edges}

    @property
    def n_nodes(self) -> int:
        """Number of nodes, including the reference."""
        return len(self.nodes)

    @property
    def n_edges(self) -> int:
        """Number of edges."""
        return len(self.edges)

    @cached_property
    def edge_names(self) -> tuple[str, ...]:
        """Names of the edges, in their order."""
        # The dictionary has the order of the edges.
        return tuple(self._edge_by_name)

    def edge(self, name: str) -> GraphEdge:
        """Return the edge named ``name``.

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
        """Return a description of the graph, one line per edge."""
        head = (
            f"{self.domain} graph: {self.n_nodes} nodes, {self.n_edges} edges, "
            f"reference {self.reference}"
        )
        rows = [(edge.name, f"{edge.tail} -> {edge.head}", edge.kind) for edge in self.edges]
        return Table((), rows, head).text() or head


def _check_unique(noun: str, names: Iterable[str], domain: str) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise TopologyError(
                f"{noun} '{name}' occurs twice in the {domain} graph; rename one of them"
            )
        seen.add(name)


@dataclass(frozen=True)
class TreeStep:
    """A step of a walk from parent to child; ``sign`` is -1 if the edge points to the parent."""

    edge: str
    parent: str
    child: str
    sign: int


def walk_edges(graph: LinearGraph, names: Collection[str], start: str) -> tuple[TreeStep, ...]:
    """Return the steps of a depth-first walk along the named edges, parents before children.

    Each node is reached once, in O(n). Without recursion, long chains do not exceed Python's limit.
    """
    allowed = names if isinstance(names, (set, frozenset)) else set(names)
    leaving: defaultdict[str, list[TreeStep]] = defaultdict(list)
    # The stack reverses the order, so edges are pushed in reverse.
    for edge in reversed(graph.edges):
        if edge.name in allowed:
            leaving[edge.tail].append(TreeStep(edge.name, edge.tail, edge.head, 1))
            # The walk follows edges in both directions; the sign is -1 against the edge.
            leaving[edge.head].append(TreeStep(edge.name, edge.head, edge.tail, -1))
    steps: list[TreeStep] = []
    reached = {start}
    stack = list(leaving[start])
    while stack:
        step = stack.pop()
        # In a circuit, the node may have been reached along another edge.
        if step.child not in reached:
            reached.add(step.child)
            steps.append(step)
            stack.extend(leaving[step.child])
    return tuple(steps)


def check_spanned(graph: LinearGraph, names: Collection[str], what: str, remedy: str) -> None:
    """Raise TopologyError if the named edges do not connect all nodes.

    ``{them}`` in ``remedy`` is replaced by the unconnected nodes.
    """
    steps = walk_edges(graph, names, graph.reference)
    # Each step reaches one new node; the reference is where the walk starts.
    if len(steps) + 1 < graph.n_nodes:
        reached = {graph.reference, *(step.child for step in steps)}
        floating = [node for node in graph.nodes if node not in reached]
        raise TopologyError(_floating_message(graph, floating, what, remedy))


def _floating_message(graph: LinearGraph, floating: list[str], what: str, remedy: str) -> str:
    inside = set(floating)
    # List all edges at these nodes, including those that cannot be branches.
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
