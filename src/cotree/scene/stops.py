"""Modes and events of rigid stops.

In: a scene with rigid stops. Out: the same scene, in which each of them has a mode, ``EDGE.mode``,
that tells which limit holds it; the impulse of its last impact, ``EDGE.impulse``; and events: where
a gap closes, where an impact ends in rest, and where the force of a limit would pull. What the
modes become then is chosen in C, for all edges at once, together with those of dry friction; see
``templates/c/run/stops.c.jinja``.
"""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import TYPE_CHECKING

from cotree.components.component import Field
from cotree.domains import DOMAINS
from cotree.scene.events import Event, Mode, ModePart
from cotree.scene.expressions import parse
from cotree.scene.networks import scalar_ports

if TYPE_CHECKING:
    from typing import TypeVar

    from cotree.scene.description import Edge, SceneDescription
    from cotree.scene.networks import Port

    _Scene = TypeVar("_Scene", bound=SceneDescription)

_ADDED = (
    Field("mode", "", "which limit holds it", constant=False),
    # Within an impact it is what the speed is to change by.
    Field("impulse", "", "of the last impact", constant=False),
)


def with_stops(scene: _Scene) -> _Scene:
    """Give every rigid stop its modes and events; a scene without any stays itself."""
    ports = [
        port
        for port in scalar_ports(scene).values()
        if port.terminal.stop is not None and "mode" not in port.edge.fields
    ]
    if not ports:
        return scene
    made = copy.copy(scene)
    made.edges, made.modes, made.events = dict(scene.edges), dict(scene.modes), {}
    for port in ports:
        made.edges[port.edge.name] = _with_modes(port)
        for field in _ADDED:
            name = f"{port.edge.name}.{field.name}"
            made.modes[name] = Mode(name, parse("0", f"{field.name} of edge '{port.edge.name}'"))
        for event in _events(port):
            made.events[event.name] = event
    made.events.update(scene.events)
    return made


def _with_modes(port: Port) -> Edge:
    edge = port.edge
    component = replace(edge.component, fields=(*edge.component.fields, *_ADDED))
    fields = {
        row.name: parse(f"{edge.name}.{row.name}", f"{row.name} of edge '{edge.name}'")
        for row in _ADDED
    }
    return replace(edge, component=component, fields={**edge.fields, **fields})


def _events(port: Port) -> list[Event]:
    stop, name, edge = port.terminal.stop, port.name, port.edge.name
    assert stop is not None
    row = DOMAINS[port.terminal.domain]
    mode, force = f"{edge}.mode", f"{name}.{row.through_symbol}"
    # Factors that leave of each value what its mode looks at, and exact zeros in all other modes.
    free = f"(1 - {mode}**2)*(4 - {mode}**2)/4"
    struck = f"{mode}**2*({mode}**2 - 1)/12"
    sided = stop.upper_gap is not None and stop.lower_gap is not None
    rebound = {f"{edge}.impulse": f"{name}.rebound"}
    rows = []
    if stop.upper_gap is not None:
        text = f"{free}*{name}.upper_gap"
        rows.append((f"hits{' upper' if sided else ''}", text, ModePart.UPPER_GAP, rebound))
    if stop.lower_gap is not None:
        text = f"{free}*{name}.lower_gap"
        rows.append((f"hits{' lower' if sided else ''}", text, ModePart.LOWER_GAP, rebound))
    at_rest = {f"{edge}.impulse": f"-{name}.{row.across_symbol}"}
    rows.append(("rests", f"{struck}*{name}.excess", ModePart.RESTS, at_rest))
    # One and two times the side of the limit, in contact and in an impact, give the side.
    rows.append(("lifts", f"{mode}*(7 - {mode}**2)/6*{force}", ModePart.LIFTS, {}))
    where = f"rigid stop '{edge}'"
    return [
        Event(
            f"{edge} {what}",
            parse(when, where),
            -1,
            # The mode is chosen together with those of all other edges.
            {target: parse(text, where) for target, text in ({mode: mode} | values).items()},
            is_stop=False,
            restitution=None,
            part=part,
        )
        for what, when, part, values in rows
    ]
