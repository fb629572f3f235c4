"""Scalar graphs of a scene: an edge for each port of its components."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.components import Kind, Role
from cotree.domains import DOMAINS
from cotree.graph import GraphEdge, LinearGraph

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.components import Terminal
    from cotree.scene.description import Edge, SceneDescription
    from cotree.scene.expressions import FieldValue
    from cotree.scene.ports import PortEnds


@dataclass(frozen=True)
class Port:
    """An edge of a scalar graph: one port of a component.

    Attributes
    ----------
    name : str
        Name of the edge in the graph: the component's, with that of the port where it has several.
    edge : Edge
        The component in the scene.
    terminal : Terminal
        Its terminal equation.
    ends : PortEnds
        Its nodes, or what it acts on in a multibody system.
    """

    name: str
    edge: Edge
    terminal: Terminal
    ends: PortEnds

    @property
    def tail(self) -> str:
        """The node where it begins."""
        return self.ends.tail

    @property
    def head(self) -> str:
        """The node where it ends, whose across variable is the greater."""
        return self.ends.head

    @property
    def is_coupling(self) -> bool:
        """Whether it acts on a multibody system in place of a scalar graph."""
        return bool(self.ends.acts_on)

    @property
    def is_short(self) -> bool:
        """Whether its ends are one node: its across variable is zero, and no cutset contains it."""
        return not self.is_coupling and self.tail == self.head

    @property
    def kind(self) -> Kind:
        """Its place in the normal tree."""
        return self.terminal.kind

    @property
    def initial(self) -> dict[str, FieldValue]:
        """Its initial values in the scene: ``name``, or ``port.name`` with several ports."""
        given = self.edge.initial
        # With several ports a table of a port has been flattened to port.name.
        own = f"{self.terminal.port}."
        named = {key.removeprefix(own): v for key, v in given.items() if key.startswith(own)}
        return {key: v for key, v in given.items() if "." not in key} | named

    def sibling(self, port: str) -> str:
        """Name another port of the same component, by its own name or its number."""
        # Ports of reactions are numbered: one law serves every reaction of the same orders.
        if port.isdecimal():
            port = self.edge.component.ports[int(port)].port
        return port_name(self.edge, port)


def port_name(edge: Edge, port: str) -> str:
    """Name the edge of a component's port."""
    return f"{edge.name}.{port}" if port else edge.name


def scalar_ports(scene: SceneDescription) -> dict[str, Port]:
    """List the edges of all scalar graphs by name."""
    found = {}
    for edge in scene.edges.values():
        if edge.component.role is Role.NETWORK:
            # Ports and ends stand in the same order, in which ``check_ports`` made them.
            for terminal, ends in zip(edge.component.ports, edge.ports, strict=True):
                name = port_name(edge, terminal.port)
                found[name] = Port(name, edge, terminal, ends)
    return found


def scalar_graphs(ports: Mapping[str, Port]) -> dict[str, LinearGraph]:
    """Form the scalar graphs that have edges."""
    graphs = {}
    for domain, row in DOMAINS.items():
        own = [p for p in ports.values() if p.terminal.domain == domain and not p.is_coupling]
        # A port that acts on a multibody system has no edge in a scalar graph.
        if row.is_scalar and own:
            # The reference comes first; a dict keeps the order of the scene and drops duplicates.
            nodes = dict.fromkeys(["ground", *(n for p in own for n in (p.tail, p.head))])
            edges = (
                GraphEdge(p.name, p.tail, p.head, p.edge.component.name)
                for p in own
                if not p.is_short
            )
            graphs[domain] = LinearGraph(domain, tuple(nodes), tuple(edges))
    return graphs
