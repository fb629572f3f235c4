"""An electrical network at rest: the scene whose solution is the operating point of another.

Nothing changes with time there. A capacity is replaced by the current through it at a constant
voltage: zero, or the static current of a junction. Inductances become short circuits.
"""

from __future__ import annotations

import copy
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

from cotree.components import Component, Kind, Law, Role, integral_of
from cotree.components.junctions import symbol
from cotree.errors import SceneError
from cotree.scene.expressions import parse
from cotree.scene.simulation import Simulation

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.components import Terminal
    from cotree.scene.description import Edge, SceneDescription
    from cotree.scene.expressions import Expression, FieldValue

_DOMAIN = "electrical"


def standing_scene(
    scene: SceneDescription, wanted: Sequence[str], jumps: Mapping[str, Expression]
) -> SceneDescription:
    """Make the scene of an operating point.

    Parameters
    ----------
    scene : SceneDescription
        An electrical network, which stays as it is.
    wanted : sequence of str
        Variables that the outputs ``wanted_0``, ``wanted_1``, ... are to give.
    jumps : mapping of str to Expression
        The values of those that are modes of jumps.

    Raises
    ------
    SceneError
        If it is more than an electrical network.
    """
    # A shallow copy: what differs at rest is replaced, the rest is shared with the scene.
    standing = copy.copy(scene)
    standing.edges = {name: _standing(edge) for name, edge in scene.edges.items()}
    standing.events, standing.defaults = {}, Simulation()
    for number, (node, voltage) in enumerate(scene.defaults.held):
        if node not in scene.nodes:
            raise SceneError(f"held of the simulation names '{node}', which is no node")
        # The method of a scene checks the statement and makes the edge; its name is changed
        # afterwards.
        source, own = "voltage_source", standing.edges
        standing.edges = {}
        standing.edge(f"held_{number}", source, node, "ground", voltage=voltage.text)
        own[f"held {number}"] = replace(  # a name that no edge of a scene can have
            standing.edges[f"held_{number}"], name=f"held {number}"
        )
        standing.edges = own
    standing.outputs = {
        f"wanted_{i}": jumps.get(name) or parse(name, f"variable '{name}' at the operating point")
        for i, name in enumerate(wanted)
    }
    return standing


def _standing(edge: Edge) -> Edge:
    component = edge.component
    is_electrical = component.role is Role.NETWORK and all(
        port.domain == _DOMAIN and integral_of(port) is None for port in component.ports
    )
    if not is_electrical:
        raise SceneError(
            f"edge '{edge.name}' of type '{component.name}' is no part of an electrical network, "
            "or stores what has no rest: start from initial values, not from an operating point"
        )
    # Two ends at one node make a port that no circuit equation determines; see below.
    short = frozenset(i for i, ends in enumerate(edge.ports) if ends.tail == ends.head)
    return replace(edge, component=_at_rest(component, short), initial=_guesses(edge))


def _guesses(edge: Edge) -> dict[str, FieldValue]:
    """Keep initial values of junctions only, where they are guesses."""
    is_storage = any(_is_storage(port) for port in edge.component.ports)
    return {} if is_storage else dict(edge.initial)


@lru_cache(maxsize=1024)
def _at_rest(component: Component, short: frozenset[int]) -> Component:
    """Put a component at rest, of which some ports, by number, have both ends at one node."""
    if not any(_is_storage(port) for port in component.ports):
        return component
    ports = (_terminal_at_rest(port, i in short) for i, port in enumerate(component.ports))
    # Demands are on inductances and couplings, which are of no effect at rest.
    return replace(component, ports=tuple(ports), demands=())


def _is_storage(port: Terminal) -> bool:
    return port.storage is not None or port.content is not None


def _terminal_at_rest(terminal: Terminal, is_short: bool) -> Terminal:
    terminal = replace(terminal, content=None)
    # The current is constant, so that no voltage is induced: a source of no voltage.
    if terminal.kind is Kind.THROUGH_STORAGE:
        none = Law(lambda: 0)
        if is_short:  # nothing decides what circulates; the least resistance would end it
            return replace(
                terminal, kind=Kind.THROUGH_SOURCE, storage=None, through=none, across=None
            )
        return replace(terminal, kind=Kind.ACROSS_SOURCE, storage=None, through=None, across=none)
    if terminal.kind is not Kind.ACROSS_STORAGE:
        return terminal
    # The voltage is constant: what remains is the static current, with the rates of all voltages
    # zero.
    static = None if terminal.through is None else terminal.through.expression
    if static is not None:
        rates = {item: 0 for item in static.free_symbols if item.name.startswith("across_rate_")}
        static = static.subs(rates)
    # A current that does not depend on the port's own voltage is given; one that does is a
    # dissipator's.
    if static is None or symbol("across") not in static.free_symbols:
        law = Law(lambda: 0) if static is None else Law.of(static)
        return replace(terminal, kind=Kind.THROUGH_SOURCE, storage=None, through=law)
    return replace(terminal, kind=Kind.DISSIPATOR, storage=None, through=Law.of(static))
