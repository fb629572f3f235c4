"""Rules about the graph: nodes that one edge alone touches, and edges with both ends at one."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

from cotree.components import Role
from cotree.lint.findings import Finding
from cotree.lint.names import used_names
from cotree.lint.similar import look_alike

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cotree.scene.description import Edge, SceneDescription

# Names that other tools have for the ground.
_GROUNDS = frozenset({"gnd", "0", "gnd!", "earth", "ground"})


def findings(scene: SceneDescription) -> Iterator[Finding]:
    """Find dangling nodes and shorted edges."""
    yield from dangling_nodes(scene)
    for node in scene.nodes:
        if node != "ground" and node.lower() in _GROUNDS:
            told = f"node '{node}' is a node like any other: is 'ground' meant?"
            yield Finding("similar-names", "node", node, told)
    for edge in scene.edges.values():
        if _is_shorted(edge):
            told = f"both ends of edge '{edge.name}' are at node '{edge.nodes[0]}': it does nothing"
            yield Finding("shorted", "edge", edge.name, told)


def dangling_nodes(scene: SceneDescription, is_refused: bool = False) -> Iterator[Finding]:
    """Find nodes that one edge alone touches and no expression looks at.

    Bodies may fly on their own, and terminals may be open, unless the scene is refused.
    """
    touching: dict[str, list[Edge]] = defaultdict(list)
    for edge in scene.edges.values():
        acts = {node for ends in edge.ports for node in ends.acts_on}
        for node in {*edge.nodes, *acts}:
            touching[node].append(edge)
    observed = {owner for name in used_names(scene) for owner in _owners(name)}
    # Outer scenes connect ports.
    observed |= set(scene.ports)
    observed |= {node for node, _ in scene.defaults.held}
    if scene.origin is not None:
        observed |= {visual.node for visual in scene.origin.visuals}
    for node in scene.nodes:
        edges = touching[node]
        if node == "ground" or len(edges) != 1 or node in observed:
            continue
        edge = edges[0]
        close = look_alike(node, set(scene.nodes))
        if scene.origin is not None and edge.component.role is not Role.NETWORK:
            continue  # robots have frames at the ends of arms and joints
        is_end = edge.component.role is Role.BODY  # bodies may fly on their own
        if is_end and edge.initial:
            continue  # as one does that is given a start
        # Sensing terminals and open ends of a component with several nodes are usual.
        is_open = edge.component.role is Role.NETWORK and len(edge.ports) > 1
        if not close and not is_refused and (is_end or is_open):
            continue
        hint = f"; did you mean '{close}'?" if close else ": connect it, or look at it in an output"
        if close and len(touching[close]) == 1:  # either may be the slip
            other = touching[close][0].name
            hint = f", and '{close}' by edge '{other}' only: did you mean one node?"
        told = f"node '{node}' is touched by edge '{edge.name}' only{hint}"
        yield Finding("dangling-node", "node", node, told)


def _owners(name: str) -> Iterator[str]:
    """List what a name may be a variable of."""
    while name := name.rpartition(".")[0]:
        yield name


def _is_shorted(edge: Edge) -> bool:
    if edge.component.role is not Role.NETWORK:
        return len(edge.nodes) == 2 and edge.nodes[0] == edge.nodes[1]
    # Transistors as diodes have one port shorted of several.
    return bool(edge.ports) and all(e.tail and e.tail == e.head for e in edge.ports)
