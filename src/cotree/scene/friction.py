"""Modes and events of dry friction.

In: a scene with edges that stick and slide. Out: the same scene, in which each of them has a mode,
``EDGE.mode``, that tells which of its laws holds, and events where that may change: where its speed
passes through zero, where its force passes a limit, and where it engages or lets go. What the modes
become then is chosen in C, for all edges at once; see
``templates/runtime/events/cotree_friction.c``.
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

_MODE = Field("mode", "", "which of its laws holds", constant=False)
_SIDE = Field("side", "", "the sign of its load", constant=False)


def with_friction(scene: _Scene) -> _Scene:
    """Give every edge with dry friction its mode and events; a scene without any stays itself."""
    ports = {
        port.edge.name: port
        for port in scalar_ports(scene).values()
        if port.terminal.friction is not None
        and not port.terminal.friction.presser  # those of contacts: see stops
        and "mode" not in port.edge.fields
    }
    if not ports:
        return scene
    made = copy.copy(scene)
    made.edges, made.modes, made.events = dict(scene.edges), dict(scene.modes), {}
    for name, port in ports.items():
        made.edges[name] = _with_modes(port)
        mode = mode_name(name)
        made.modes[mode] = Mode(
            mode, parse(_at_start(port), f"mode of edge '{name}'"), is_jump=True
        )
        if port.terminal.friction.load is not None:  # type: ignore[union-attr]
            side = side_name(name)
            made.modes[side] = Mode(side, parse("1", f"side of edge '{name}'"), is_jump=True)
        for event in _events(port, mode):
            made.events[event.name] = event
    made.events.update(scene.events)
    return made


def mode_name(edge: str) -> str:
    """Name the mode of an edge with dry friction."""
    return f"{edge}.mode"


def side_name(edge: str) -> str:
    """Name the mode that tells the sign of the load of an edge."""
    return f"{edge}.side"


def _with_modes(port: Port) -> Edge:
    edge, added = port.edge, [(_MODE, mode_name(port.edge.name))]
    assert port.terminal.friction is not None
    if port.terminal.friction.load is not None:
        added.append((_SIDE, side_name(edge.name)))
    component = replace(
        edge.component, fields=(*edge.component.fields, *(field for field, _ in added))
    )
    fields = {
        field.name: parse(name, f"{field.name} of edge '{edge.name}'") for field, name in added
    }
    return replace(edge, component=component, fields={**edge.fields, **fields})


def _at_start(port: Port) -> str:
    """Give the mode by the speed at the start; what is at rest there is chosen by the engine."""
    speed = f"sign({port.name}.{DOMAINS[port.terminal.domain].across_symbol})"
    assert port.terminal.friction is not None
    if port.terminal.friction.grip is None:
        return speed
    return f"where({port.name}.grip > 0, {speed}, 2)"


def _events(port: Port, mode: str) -> list[Event]:
    friction, name = port.terminal.friction, port.name
    assert friction is not None
    row = DOMAINS[port.terminal.domain]
    speed, force = f"{name}.{row.across_symbol}", f"{name}.{row.through_symbol}"
    # Factors that leave of each value what its mode looks at, and zero in all other modes.
    direction, stuck = mode, f"(1 - {mode}**2)"
    if friction.grip is not None:
        direction, stuck = f"{mode}*(4 - {mode}**2)/3", f"{stuck}*(2 - {mode})/2"
    rows = [
        ("stops", f"{direction}*{speed}", -1, ModePart.SLIP),
        ("slips forwards", f"{stuck}*({name}.upper - {force})", -1, ModePart.FORWARD_LIMIT),
    ]
    if friction.lower is not None:
        text = f"{stuck}*({force} - {name}.lower)"
        rows.append(("slips backwards", text, -1, ModePart.BACKWARD_LIMIT))
    if friction.grip is not None:
        rows.append(("engages", f"{name}.grip", 0, ModePart.ENGAGED))
    if friction.load is not None:
        # While it sticks, no law of sliding takes part.
        text = f"{mode}**2*{side_name(port.edge.name)}*{name}.load"
        rows.append(("turns its load", text, -1, ModePart.LOAD))
    where = f"friction of edge '{port.edge.name}'"
    return [
        Event(
            f"{port.edge.name} {what}",
            parse(when, where),
            way,
            # The mode is chosen together with those of all other edges.
            {target: parse(target, where)},
            is_stop=False,
            restitution=None,
            part=part,
        )
        for what, when, way, part in rows
        for target in [side_name(port.edge.name) if part is ModePart.LOAD else mode]
    ]
