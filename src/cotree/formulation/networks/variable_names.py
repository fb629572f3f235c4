"""Names of network variables in scenes, such as ``C1.v``, ``M.shaft.tau``, ``n3.v``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from cotree.components import content_of, integral_of
from cotree.domains import DOMAINS

if TYPE_CHECKING:
    from collections.abc import Container, Mapping

    from cotree.formulation.networks.rules import Variable
    from cotree.formulation.networks.stores import Total
    from cotree.formulation.networks.topology import Topology
    from cotree.scene.networks import Port


@dataclass(frozen=True)
class Names:
    """Finds the variables of nodes and edges by name."""

    ports: Mapping[str, Port]
    topologies: Mapping[str, Topology]
    stores: Mapping[str, Total]

    @cached_property
    def _of_ports(self) -> dict[str, Variable]:
        """Variables of all ports by name, with and without the name of the port."""
        found: dict[str, Variable] = {}
        for port in self.ports.values():
            for quantity, symbol in _symbols(port).items():
                found[f"{port.name}.{symbol}"] = (quantity, port.name)
                # Also add the name without the port if it is unambiguous.
                found[state_name(port, symbol)] = (quantity, port.name)
            # A total of several contents has a name of its own, besides those of the contents.
            store = self.stores.get(port.name)
            if store is not None and not store.is_alone:
                found[state_name(port, store.symbol[0])] = ("total", port.name)
            for row in port.edge.component.measures:
                found[f"{port.edge.name}.{row.name}"] = ("measure", f"{port.edge.name}|{row.name}")
        return found

    def of_edge(self, edge: str) -> list[str]:
        """Return the names of an edge's variables without the edge's name."""
        start = f"{edge}."
        return [name.removeprefix(start) for name in self._of_ports if name.startswith(start)]

    def variable(self, name: str) -> Variable | None:
        """Return the variable ``edge.symbol``, ``edge.port.symbol`` or ``node.symbol``, or None."""
        if name in self._of_ports:
            return self._of_ports[name]
        # Names of ports contain a dot: the symbol comes after the last dot.
        first, _, symbol = name.rpartition(".")
        # A node may belong to several domains; the symbol identifies the domain.
        for domain, topology in self.topologies.items():
            graph = topology.tree.graph
            if symbol == DOMAINS[domain].across_symbol and first in graph.nodes:
                return "potential", f"{domain}|{graph.reference}|{first}"
        return None


def _symbols(port: Port) -> dict[str, str]:
    row = DOMAINS[port.terminal.domain]
    found = {"across": row.across_symbol, "through": row.through_symbol}
    integral = integral_of(port.terminal)
    if integral is not None:
        found["stretch"] = integral.name
    if content := content_of(port.terminal):
        found["content"] = content[0]
    if (friction := port.terminal.friction) is not None:
        # Force limits on both sides, whether friction is engaged, and the load.
        rows = ("upper", "lower", "grip", "load")
        found |= {f"limit_{n}": n for n in rows if getattr(friction, n) is not None}
    if (stop := port.terminal.stop) is not None:
        rows = ("upper_gap", "lower_gap", "rebound", "excess")
        found |= {f"limit_{n}": n for n in rows if getattr(stop, n) is not None}
    return found


def state_name(port: Port, symbol: str) -> str:
    """Return a port's variable name; without the port if no other is in the same domain."""
    own = port.edge.component.ports
    domains = [terminal.domain for terminal in own]
    # A port that measures a controlling variable is not among the ports of the component.
    is_alone = domains.count(port.terminal.domain) == 1 and port.terminal in own
    return f"{port.edge.name if is_alone else port.name}.{symbol}"


def argument_of(
    port: Port, name: str, fields: Container[tuple[str, str]], reference: str
) -> Variable:
    """Return the variable of a port's law argument; ``fields``, (edge, field), take precedence.

    Node potentials are relative to the node ``reference``.
    """
    first, underscore, rest = name.partition("_")
    is_field = (port.edge.name, name) in fields
    if first in ("across", "through") and rest != "rate" and not is_field:
        quantity = f"{first}_rate" if rest.startswith("rate_") else first
        return quantity, port.sibling(rest.removeprefix("rate_")) if underscore else port.name
    if name in ("across_rate", "through_rate", "stretch", "stretch_rate"):
        return name, port.name
    if first == "stretch" and underscore and not is_field:
        return "stretch", port.sibling(rest)
    if first == "potential" and not is_field:
        node = port.ends.head if rest.startswith("head") else port.ends.tail
        quantity = "potential_rate" if rest.endswith("_rate") else "potential"
        return quantity, f"{port.terminal.domain}|{reference}|{node}"
    if name == "multiplier" and not is_field:
        return name, port.name
    if name.endswith("_rate") and not is_field:
        return "field_rate", f"{port.edge.name}|{name.removesuffix('_rate')}"
    return "field", f"{port.edge.name}|{name}"
