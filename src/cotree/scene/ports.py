"""Ports of scalar components: which nodes each edge in a scalar graph runs between."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.components import Kind, Role
from cotree.domains import DOMAINS
from cotree.errors import SceneError
from cotree.naming import check_name

if TYPE_CHECKING:
    from cotree.components import Component, Terminal


@dataclass(frozen=True)
class Ends:
    """Where a port's edge begins and ends; its across variable is the head's minus the tail's.

    Attributes
    ----------
    tail, head : str
        The nodes.
    """

    tail: str
    head: str


def check_ports(
    edge: str, component: Component, nodes: Sequence[object], fields: Mapping[str, Any]
) -> tuple[tuple[str, ...], tuple[Ends, ...], dict[str, Any]]:
    """Check the nodes of an edge.

    Parameters
    ----------
    edge : str
        Its name, for messages.
    component : Component
        What it is.
    nodes : sequence of str
        The nodes as listed.
    fields : mapping
        What else was said; a component with several ports takes their nodes from here.

    Returns
    -------
    nodes : tuple of str
        All nodes, in order.
    ports : tuple of Ends
        Of each port of a scalar component; empty for others.
    rest : dict
        The fields that remain.

    Raises
    ------
    SceneError
        If nodes are missing, too many, not names, or the same.
    """
    rest = dict(fields)
    if component.role is not Role.NETWORK:
        first, second = _pair(edge, nodes, f"edge '{edge}'")
        return (first, second), (), rest
    if component.terminals:
        return _by_terminal(edge, component, nodes, rest)
    if len(component.ports) == 1:
        pair = _pair(edge, nodes, f"edge '{edge}'")
        return pair, (_ends(component.ports[0], pair, f"edge '{edge}'"),), rest
    if nodes:
        if not _is_list(nodes) or len(nodes) != len(component.ports):
            names = ", ".join(port.port for port in component.ports)
            raise SceneError(
                f"edge '{edge}' of type '{component.name}' has the ports {names}: name the two "
                "nodes of each, or as nodes one of each, the other being the ground"
            )
        rest |= {
            port.port: _from_ground(port, node)
            for port, node in zip(component.ports, nodes, strict=True)
        }
    found: list[str] = []
    ports = []
    for port in component.ports:
        where = f"{port.port} of edge '{edge}'"
        pair = _pair(edge, rest.pop(port.port, ()), where)
        found += pair
        ports.append(_ends(port, pair, where))
    return tuple(dict.fromkeys(found)), tuple(ports), rest


def _by_terminal(
    edge: str, component: Component, nodes: Sequence[object], rest: dict[str, Any]
) -> tuple[tuple[str, ...], tuple[Ends, ...], dict[str, Any]]:
    """Give the nodes of a component such as a transistor, whose ports share them."""
    if not _is_list(nodes) or len(nodes) != len(component.terminals):
        wanted = ", ".join(component.terminals)
        raise SceneError(
            f"edge '{edge}' of type '{component.name}' needs {len(component.terminals)} nodes: "
            f"{wanted}"
        )
    by_name = {
        terminal: check_name("node", node)
        for terminal, node in zip(component.terminals, nodes, strict=True)
    }
    places = {**by_name, "ground": "ground"}
    ports = []
    for port in component.ports:
        # Names that a scene cannot give are of nodes within.
        head, tail = (places.get(name, f"{edge}.{name}") for name in port.between)
        if head == tail and port.kind not in (Kind.DISSIPATOR, Kind.THROUGH_SOURCE):
            first, second = port.between
            raise SceneError(
                f"{first} and {second} of edge '{edge}' are both node '{head}': name two"
            )
        ports.append(Ends(tail, head))
    if len(by_name) > 1 and len(set(by_name.values())) == 1:
        raise SceneError(f"edge '{edge}' has node '{ports[0].head}' only: name others")
    return tuple(dict.fromkeys(by_name.values())), tuple(ports), rest


def _from_ground(port: Terminal, node: object) -> tuple[object, object]:
    """Pair a node with the ground, in the order of the domain."""
    return (node, "ground") if DOMAINS[port.domain].head_first else ("ground", node)


def _ends(port: Terminal, pair: tuple[str, str], where: str) -> Ends:
    ends = Ends(pair[1], pair[0]) if DOMAINS[port.domain].head_first else Ends(*pair)
    if port.is_inertial and ends.tail != "ground":
        raise SceneError(
            f"{where} moves against '{ends.tail}', but inertia is against the ground: name "
            "'ground' first, then the node that it moves with"
        )
    return ends


def _pair(edge: str, nodes: object, what: str) -> tuple[str, str]:
    if not _is_list(nodes) or len(nodes) != 2:  # type: ignore[arg-type]
        raise SceneError(f"{what} needs two nodes, as a list of their names")
    first, second = (check_name("node", node) for node in nodes)  # type: ignore[attr-defined]
    if first == second:
        raise SceneError(f"{what} begins and ends at node '{first}': name two nodes")
    return first, second


def _is_list(value: object) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)
