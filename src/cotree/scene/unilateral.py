"""Modes and events of dry friction and of rigid stops.

In: a scene with edges that stick and slide. Out: the same scene, in which each of them has a mode,
``EDGE.mode``, that tells which of its laws holds, and events where that may change: where its speed
passes through zero, where its force passes a limit, and where it engages or lets go. What the modes
become then is chosen in C, for all edges at once; see
``templates/runtime/events/cotree_friction.c``.

In: a scene with rigid stops. Out: the same scene, in which each of them has a mode, ``EDGE.mode``,
that tells which limit holds it; the impulse of its last impact, ``EDGE.impulse``; and events: where
a gap closes, where an impact ends in rest, and where the force of a limit would pull. What the
modes become then is chosen in C, for all edges at once, together with those of dry friction; see
``templates/runtime/events/cotree_stops.c``.
"""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

from cotree.components import Kind
from cotree.components.component import Field
from cotree.domains import DOMAINS
from cotree.scene.events import Event, Mode, ModePart
from cotree.scene.expressions import parse
from cotree.scene.networks import Port, scalar_ports

if TYPE_CHECKING:
    from cotree.components.terminal import Friction, Stop
    from cotree.scene.description import Edge, SceneDescription


if TYPE_CHECKING:
    _Scene = TypeVar("_Scene", bound=SceneDescription)

_MODE = Field("mode", "", "which of its laws holds", constant=False)
_SIDE = Field("side", "", "the sign of its load", constant=False)


def with_friction(scene: _Scene) -> _Scene:
    """Add mode and events to every edge with dry friction; a scene without any stays itself."""
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
    """Return the mode by the speed at the start; what is at rest there is chosen by the engine."""
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


def with_stops(scene: _Scene) -> _Scene:
    """Add modes and events to rigid stops and to the friction that these press."""
    ports = [port for port in scalar_ports(scene).values() if _is_due(port)]
    if not ports:
        return scene
    made = copy.copy(scene)
    made.edges, made.modes, made.events = dict(scene.edges), dict(scene.modes), {}
    for port in ports:
        edge, name = port.edge.name, _holder(port)
        made.edges[edge] = _with_stop_modes(made.edges[edge], port)
        for what, doc, start in _modes(port):
            mode = f"{name}.{what}"
            made.modes[mode] = Mode(mode, parse(start, f"{doc} of edge '{edge}'"))
        for event in _stop_events(port):
            made.events[event.name] = event
    made.events.update(scene.events)
    return made


def _laws(port: Port) -> Stop | Friction | None:
    friction = port.terminal.friction
    return friction if friction is not None and friction.presser else port.terminal.stop


def _is_due(port: Port) -> bool:
    laws = _laws(port)
    return laws is not None and f"mode{laws.suffix}" not in port.edge.fields


def _holder(port: Port, of: str = "") -> str:
    """Name a port that holds, or another one of its edge: by the edge where it is the only one."""
    ports = port.edge.component.ports
    is_alone = sum(terminal.kind.may_hold for terminal in ports) == 1
    return port.edge.name if is_alone else port.sibling(of or port.terminal.port)


def _modes(port: Port) -> tuple[tuple[str, str, str], ...]:
    """List modes: name, meaning, and value at the start."""
    # Within an impact, an impulse is what that changes the speed by.
    if port.kind is Kind.STOP:
        return ("mode", "which of its laws holds", "0"), ("impulse", "of the last impact", "0")
    # Friction without a force is disengaged; its impulse is zero between evaluations.
    return ("mode", "which of its laws holds", "2"), ("impulse", "asked for in an impact", "0")


def _with_stop_modes(edge: Edge, port: Port) -> Edge:
    laws = _laws(port)
    assert laws is not None
    rows = [(f"{what}{laws.suffix}", doc, what) for what, doc, _ in _modes(port)]
    added = tuple(Field(name, "", doc, constant=False) for name, doc, _ in rows)
    component = replace(edge.component, fields=(*edge.component.fields, *added))
    fields = {
        name: parse(f"{_holder(port)}.{what}", f"{doc} of edge '{edge.name}'")
        for name, doc, what in rows
    }
    return replace(edge, component=component, fields={**edge.fields, **fields})


#: Name, condition, role, and what it sets.
_Row = tuple[str, str, ModePart, "dict[str, str]"]


def _stop_events(port: Port) -> list[Event]:
    rows = _stop_rows(port) if port.kind is Kind.STOP else _pressed_rows(port)
    where = f"{port.edge.component.name} '{port.edge.name}'"
    return [
        Event(
            f"{_holder(port)} {what}",
            parse(when, where),
            -1,
            # Modes are chosen together with those of all other edges.
            {target: parse(text, where) for target, text in values.items()},
            is_stop=False,
            restitution=None,
            part=part,
        )
        for what, when, part, values in rows
    ]


def _stop_rows(port: Port) -> list[_Row]:
    stop, name, holder = port.terminal.stop, port.name, _holder(port)
    assert stop is not None
    row = DOMAINS[port.terminal.domain]
    mode, force = f"{holder}.mode", f"{name}.{row.through_symbol}"
    # Factors that leave of each value what its mode looks at, and exact zeros in all other modes.
    free = f"(1 - {mode}**2)*(4 - {mode}**2)/4"
    struck = f"{mode}**2*({mode}**2 - 1)/12"
    sided = stop.upper_gap is not None and stop.lower_gap is not None
    own = {mode: mode}
    rebound = own | {f"{holder}.impulse": f"{name}.rebound"}
    rows: list[_Row] = []
    if stop.upper_gap is not None:
        text = f"{free}*{name}.upper_gap"
        rows.append((f"hits{' upper' if sided else ''}", text, ModePart.UPPER_GAP, rebound))
    if stop.lower_gap is not None:
        text = f"{free}*{name}.lower_gap"
        rows.append((f"hits{' lower' if sided else ''}", text, ModePart.LOWER_GAP, rebound))
    at_rest = own | {f"{holder}.impulse": f"-{name}.{row.across_symbol}"}
    rows.append(("rests", f"{struck}*{name}.excess", ModePart.REBOUND, at_rest))
    # One and two times the side of the limit, in contact and in an impact, give the side.
    rows.append(("lifts", f"{mode}*(7 - {mode}**2)/6*{force}", ModePart.FORCE, own))
    return rows


def _pressed_rows(port: Port) -> list[_Row]:
    """Return the events of friction that a stop presses together."""
    friction, name, holder = port.terminal.friction, port.name, _holder(port)
    assert friction is not None
    row = DOMAINS[port.terminal.domain]
    mode, presser = f"{holder}.mode", f"{_holder(port, friction.presser)}.mode"
    speed, force = f"{name}.{row.across_symbol}", f"{name}.{row.through_symbol}"
    direction = f"{mode}*(4 - {mode}**2)*(9 - {mode}**2)/24"
    stuck = f"(1 - {mode}**2)*(2 - {mode})*(3 - {mode})/6"
    struck = f"{mode}*({mode}**2 - 1)*({mode} - 2)/24"
    # The second target tells which stop presses.
    own = {mode: mode, presser: presser}
    sticks = own | {f"{holder}.impulse": f"-{speed}"}
    return [
        ("stops", f"{direction}*{speed}", ModePart.SLIP, sticks),
        (
            "slips forwards",
            f"({stuck} + {struck})*({name}.upper - {force})",
            ModePart.FORWARD_LIMIT,
            own,
        ),
        (
            "slips backwards",
            f"({stuck} + {struck})*({force} - {name}.lower)",
            ModePart.BACKWARD_LIMIT,
            own,
        ),
    ]
