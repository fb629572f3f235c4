"""Ports of scalar components: the end nodes of their edges in scalar graphs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from cotree.arguments import is_list
from cotree.components import Role
from cotree.components.ports import HEAT, loss_of, with_heat
from cotree.domains import DOMAINS
from cotree.errors import SceneError
from cotree.naming import check_path

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.components import Component, Terminal

#: Keys that connect a port to a multibody system.
_PLACES = frozenset({"joint", "line"})

#: Domains whose ports may act on a multibody system.
_MECHANICAL = ("translational", "rotational")


def acts_on_multibody(port: Terminal) -> bool:
    """Return whether a port may act on a joint or along a line instead of between two nodes."""
    return port.domain in _MECHANICAL


@dataclass(frozen=True)
class PortEnds:
    """End nodes of a port's edge; its across variable is the head's minus the tail's."""

    #: Nodes of the port; empty if it acts on a multibody system.
    tail: str
    head: str
    #: A joint's coordinate, or the two nodes that define the line of action; otherwise empty.
    acts_on: tuple[str, ...] = ()


def check_ports(
    edge: str, component: Component, nodes: Sequence[object], fields: Mapping[str, Any]
) -> tuple[tuple[str, ...], tuple[PortEnds, ...], dict[str, Any]]:
    """Return all nodes of an edge in order, the ends of each scalar port, and all other fields.

    Raise SceneError if the number of nodes is wrong, or if nodes are equal that must differ.
    """
    rest = dict(fields)
    if component.role is not Role.NETWORK:
        _refuse_joint(edge, component, rest)
        if component.field("joint") is not None:
            _refuse_nodes(edge, nodes)
            return (), (), rest
        first, second = _pair(edge, nodes, f"edge '{edge}'")
        return (first, second), (), rest
    # ``check_heat`` has appended the thermal port; the value of its field is the node.
    if component.ports[-1].port == HEAT:
        sink = _heat_nodes(edge, rest.pop(HEAT))
        own = replace(component, ports=component.ports[:-1])
        found, ports, rest = check_ports(edge, own, nodes, rest)
        ports = (*ports, _ends(component.ports[-1], sink, edge))
        return tuple(dict.fromkeys((*found, *sink))), ports, rest
    if component.geometry is not None:
        pair = _pair(edge, nodes, f"edge '{edge}'")
        return (), tuple(PortEnds("", "", pair) for _ in component.ports), rest
    if component.terminals:
        return _by_terminal(edge, component, nodes, rest)
    if len(component.ports) == 1:
        (port,) = component.ports
        if acts_on_multibody(port) and rest.keys() & _PLACES:
            _refuse_nodes(edge, nodes)
            return (), (_multibody(edge, rest),), rest
        if acts_on_multibody(port) and not nodes:
            raise SceneError(f"edge '{edge}' needs two nodes, or joint = \"...\" to act on a joint")
        pair = _pair(edge, nodes, f"edge '{edge}'", may_be_one=True)
        return pair, (_ends(port, pair, f"edge '{edge}'"),), rest
    _refuse_places(edge, component, nodes, rest)
    # This short form lists one node per port; the other node of each port is the ground.
    if nodes:
        if not is_list(nodes) or len(nodes) != len(component.ports):
            names = ", ".join(port.port for port in component.ports)
            raise SceneError(
                f"edge '{edge}' of type '{component.name}' has the ports {names}: name the "
                "two nodes of each port, or as nodes one of each if the other is the ground"
            )
        for port, node in zip(component.ports, nodes, strict=True):
            head_first = DOMAINS[port.domain].head_first
            rest[port.port] = (node, "ground") if head_first else ("ground", node)
    listed: list[str] = []
    placed = []
    for port in component.ports:
        where = f"{port.port} of edge '{edge}'"
        # A mechanical port without nodes acts on the multibody system.
        has_nodes = port.port in rest or not rest.keys() & _PLACES
        if acts_on_multibody(port) and not has_nodes:
            placed.append(_multibody(edge, rest))
            continue
        if acts_on_multibody(port) and port.port not in rest and any(e.acts_on for e in placed):
            raise SceneError(
                f"{where} needs two nodes of its own, since its other port acts on the "
                "multibody system; to couple two joints use a gear"
            )
        pair = _pair(edge, rest.pop(port.port, ()), where, may_be_one=True)
        listed += pair
        placed.append(_ends(port, pair, where))
    # A node of several ports is listed once.
    return tuple(dict.fromkeys(listed)), tuple(placed), rest


def check_heat(edge: str, component: Component, fields: Mapping[str, Any]) -> Component:
    """Return the component, with a thermal port if a field names the node for its heat."""
    if (
        HEAT not in fields
        or component.field(HEAT) is not None
        or component.role is not Role.NETWORK
    ):
        return component
    if loss_of(component) is None:
        raise SceneError(
            f"edge '{edge}' of type '{component.name}' dissipates no heat: only dissipators "
            f"and machines with a loss take '{HEAT}'"
        )
    return with_heat(component)


def _heat_nodes(edge: str, value: object) -> tuple[str, str]:
    """Return the nodes between which heat is added: two stated ones, or one and the ground."""
    pair = (value, "ground") if isinstance(value, str) else value
    return _pair(edge, pair, f"{HEAT} of edge '{edge}'")


def _refuse_joint(edge: str, component: Component, rest: Mapping[str, Any]) -> None:
    """Raise if a two-node component names a joint, and suggest types that act on joints."""
    if "joint" in rest and component.field("joint") is None:
        from cotree.components.mechanical import ON_JOINTS

        others = " or ".join(ON_JOINTS.get(component.name, ()))
        cure = f"use a {others} instead" if others else "remove the joint"
        raise SceneError(
            f"edge '{edge}' of type '{component.name}' connects two nodes and cannot act on a "
            f"joint: {cure}"
        )


def _refuse_places(
    edge: str, component: Component, nodes: Sequence[object], rest: Mapping[str, Any]
) -> None:
    """Raise if a port that acts on a joint or along a line also has nodes."""
    mechanical = [port.port for port in component.ports if acts_on_multibody(port)]
    if not rest.keys() & _PLACES or not mechanical:
        return
    if nodes or all(port in rest for port in mechanical):
        place = min(rest.keys() & _PLACES)
        others = [port.port for port in component.ports if port.port not in mechanical]
        named = " and ".join(f'{port} = ["...", "ground"]' for port in others)
        raise SceneError(
            f"edge '{edge}' has nodes for its port {mechanical[-1]}, but also acts on the "
            f"multibody system by {place}: remove {place}"
            + (f", or give {named} instead of the nodes" if named else "")
        )


def _refuse_nodes(edge: str, nodes: Sequence[object]) -> None:
    """Raise if a component that acts on a joint or along a line also lists nodes."""
    if nodes:
        raise SceneError(
            f"edge '{edge}' has nodes of the one-dimensional graph, but also acts on the "
            "multibody system by joint or line: remove one of them"
        )


def _multibody(edge: str, rest: dict[str, Any]) -> PortEnds:
    """Return the joint on which a port acts, or the two nodes that define its line of action."""
    if "joint" in rest:
        # The last word of the name may be a coordinate; this is decided when the joints are known.
        return PortEnds("", "", (check_path("joint", str(rest.pop("joint"))),))
    return PortEnds("", "", _pair(edge, rest.pop("line"), f"line of edge '{edge}'"))


def _by_terminal(
    edge: str, component: Component, nodes: Sequence[object], rest: dict[str, Any]
) -> tuple[tuple[str, ...], tuple[PortEnds, ...], dict[str, Any]]:
    """Return the nodes of a component such as a transistor, whose ports share nodes."""
    if not is_list(nodes) or len(nodes) != len(component.terminals):
        wanted = ", ".join(component.terminals)
        raise SceneError(
            f"edge '{edge}' of type '{component.name}' needs {len(component.terminals)} nodes: "
            f"{wanted}{_counted(nodes)}"
        )
    by_name = {
        terminal: check_path("node", node)
        for terminal, node in zip(component.terminals, nodes, strict=True)
    }
    places = {**by_name, "ground": "ground"}
    ports = []
    for port in component.ports:
        # Inner nodes have names that a scene cannot state.
        head, tail = (places.get(name, f"{edge}.{name}") for name in port.between)
        if head == tail and "ground" in port.between:  # only for species and amplifier outputs
            first, second = port.between
            raise SceneError(
                f"{first} and {second} of edge '{edge}' are both node '{head}': name two"
            )
        ports.append(PortEnds(tail, head))
    return tuple(dict.fromkeys(by_name.values())), tuple(ports), rest


def _ends(port: Terminal, pair: tuple[str, str], where: str) -> PortEnds:
    # Across is head minus tail: second minus first node, or plus minus minus node.
    ends = PortEnds(pair[1], pair[0]) if DOMAINS[port.domain].head_first else PortEnds(*pair)
    if port.is_absolute and ends.tail != "ground":
        raise SceneError(f"{where} {DOMAINS[port.domain].absolute.format(tail=ends.tail)}")
    return ends


def _counted(nodes: object) -> str:
    return f"; there {'is' if len(nodes) == 1 else 'are'} {len(nodes)}" if is_list(nodes) else ""


def _pair(edge: str, nodes: object, what: str, may_be_one: bool = False) -> tuple[str, str]:
    """Return two checked nodes, which may be equal only if ``may_be_one``."""
    if not is_list(nodes) or len(nodes) != 2:
        raise SceneError(f"{what} needs two nodes, as a list of their names{_counted(nodes)}")
    first, second = (check_path("node", node) for node in nodes)
    if first == second and not may_be_one:
        raise SceneError(f"{what} begins and ends at node '{first}': name two nodes")
    return first, second
