"""Modes and events for dry friction and rigid stops.

The mode ``EDGE.mode`` of dry friction selects one of its laws. Its events are zeros of the slip
rate, limits of the friction force, and engagement. The mode of a stop is the limit at which it is
closed; ``EDGE.impulse`` is the impulse of its last impact. Its events are closing gaps, impacts
that end in rest, and tensile forces. C code selects the modes of all edges together: see
``cotree_modes.c`` and ``cotree_impacts.c`` in ``templates/runtime/hybrid``.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

from cotree.components import Kind
from cotree.components.component import Field
from cotree.components.contact import with_discs
from cotree.domains import DOMAINS
from cotree.scene.events import Event, Mode, ModePart
from cotree.scene.expressions import Expression, parse
from cotree.scene.graphs import motion_spaces
from cotree.scene.networks import Port, scalar_ports

if TYPE_CHECKING:
    from cotree.components.terminal import Friction, Stop, Terminal
    from cotree.scene.description import SceneDescription
    from cotree.scene.edge import Edge

    _Scene = TypeVar("_Scene", bound=SceneDescription)

#: Row of a mode: field, description, name and initial value.
_ModeRow = tuple[str, str, str, str]
#: Row of an event: name, condition, direction, role, and new values by target.
_EventRow = tuple[str, str, int, ModePart, Mapping[str, str]]


def with_friction(scene: _Scene) -> _Scene:
    """Add a mode and events to each edge with dry friction; return other scenes unchanged."""
    ports = [
        port
        for port in scalar_ports(scene).values()
        if port.terminal.friction is not None
        and not port.terminal.friction.presser  # ``with_stops`` adds the friction of contacts
        and port.terminal.friction.mode not in port.edge.fields
    ]
    return _with(scene, ports, _friction_modes, _friction_rows, "friction of edge", is_jump=True)


def with_stops(scene: _Scene) -> _Scene:
    """Add modes and events to rigid stops, and to the friction at their contacts."""
    scene = _with_discs(scene)
    ports = [
        port
        for port in scalar_ports(scene).values()
        if (laws := _laws(port)) is not None and f"mode{laws.suffix}" not in port.edge.fields
    ]
    return _with(scene, ports, _stop_modes, _stop_rows, "rigid contact of edge", is_jump=False)


def _with_discs(scene: _Scene) -> _Scene:
    """Extend friction at rigid contacts in spatial scenes to two slip directions."""
    frictional = [
        edge
        for edge in scene.edges.values()
        if any(terminal.friction and terminal.friction.presser for terminal in edge.component.ports)
    ]
    if not frictional or motion_spaces(scene.mechanics).plane:
        return scene
    made = copy.copy(scene)
    made.edges = dict(scene.edges)
    for edge in frictional:
        component = with_discs(edge.component)
        # All points of a contact act between the same pair of nodes.
        ports = (edge.ports[0],) * len(component.ports)
        made.edges[edge.name] = replace(edge, component=component, ports=ports)
    return made


def _with(
    scene: _Scene,
    ports: Sequence[Port],
    modes_of: Callable[[Port], list[_ModeRow]],
    rows_of: Callable[[Port], list[_EventRow]],
    what: str,
    *,
    is_jump: bool,
) -> _Scene:
    """Add the modes and events of the given ports, before the events of the scene."""
    if not ports:
        return scene
    made = copy.copy(scene)
    made.edges, made.modes, made.events = dict(scene.edges), dict(scene.modes), {}
    for port in ports:
        edge, where = made.edges[port.edge.name], f"{what} '{port.edge.name}'"
        modes = modes_of(port)
        ways = _ways(port)
        docs = {field: doc for field, doc, _, _ in modes} | dict.fromkeys(ways, _WAY)
        added = tuple(Field(field, "", doc, constant=False) for field, doc in docs.items())
        component = replace(edge.component, fields=(*edge.component.fields, *added))
        fields = {field: parse(mode, where) for field, _, mode, _ in modes}
        fields |= {field: parse(text, where) for field, text in ways.items()}
        made.edges[edge.name] = replace(edge, component=component, fields={**edge.fields, **fields})
        for _, _, mode, start in modes:
            made.modes[mode] = Mode(mode, parse(start, where), is_jump=is_jump)
        for name, when, way, part, values in rows_of(port):
            # The new value of a mode is the mode itself, because C code selects the modes.
            new = {target: parse(text, where) for target, text in values.items()}
            made.events[name] = Event(name, parse(when, where), way, new, part=part)
    made.events.update(scene.events)
    return made


def _friction_modes(port: Port) -> list[_ModeRow]:
    friction, edge = port.terminal.friction, port.edge.name
    assert friction is not None
    if friction.is_disc:
        return _disc_modes(port)
    # The initial mode is the direction of the slip rate. At rest, the engine selects the mode.
    start = f"sign({port.name}.{DOMAINS[port.terminal.domain].across_symbol})"
    if friction.grip is not None:
        start = f"where({port.name}.grip > 0, {start}, 2)"
    rows = [("mode", "which of its laws holds", f"{edge}.mode", start)]
    if friction.load is not None:
        rows.append(("side", "the sign of its load", f"{edge}.side", "1"))
    return rows


def _friction_rows(port: Port) -> list[_EventRow]:
    friction, name, edge = port.terminal.friction, port.name, port.edge.name
    assert friction is not None
    if friction.is_disc:
        rows = _disc_rows(port) if friction.followers else []
        return [(f"{edge} {what}", when, -1, part, own) for what, when, part, own in rows]
    row = DOMAINS[port.terminal.domain]
    speed, force = f"{name}.{row.across_symbol}", f"{name}.{row.through_symbol}"
    mode, side = f"{edge}.mode", f"{edge}.side"
    # These factors are nonzero in one mode and zero in all others.
    direction, stuck = mode, f"(1 - {mode}**2)"
    if friction.grip is not None:
        direction, stuck = f"{mode}*(4 - {mode}**2)/3", f"{stuck}*(2 - {mode})/2"
    own = {mode: mode}
    upper = f"{stuck}*({name}.upper - {force})"
    found: list[_EventRow] = [
        (f"{edge} stops", f"{direction}*{speed}", -1, ModePart.SLIP, own),
        (f"{edge} slips forwards", upper, -1, ModePart.FORWARD_LIMIT, own),
    ]
    if friction.lower is not None:
        text = f"{stuck}*({force} - {name}.lower)"
        found.append((f"{edge} slips backwards", text, -1, ModePart.BACKWARD_LIMIT, own))
    if friction.grip is not None:
        found.append((f"{edge} engages", f"{name}.grip", 0, ModePart.ENGAGED, own))
    if friction.load is not None:
        # In mode 0 (sticking) the load has no effect.
        text = f"{mode}**2*{side}*{name}.load"
        found.append((f"{edge} turns its load", text, -1, ModePart.LOAD, {side: side}))
    return found


def _laws(port: Port) -> Stop | Friction | None:
    friction = port.terminal.friction
    return friction if friction is not None and friction.presser else port.terminal.stop


def _holder(port: Port, of: str = "") -> str:
    """Return the first part of a port's mode names: its edge, or the port if several may hold."""
    ports = port.edge.component.ports
    is_alone = sum(terminal.kind.may_hold for terminal in ports) == 1
    return port.edge.name if is_alone else port.sibling(of or port.terminal.port)


def _stop_modes(port: Port) -> list[_ModeRow]:
    laws, holder = _laws(port), _holder(port)
    assert laws is not None
    if port.terminal.friction is not None and port.terminal.friction.is_disc:
        return _disc_modes(port)
    # At the start, stops are open, and friction is disengaged, because it has no normal force.
    is_stop = port.kind is Kind.STOP
    start = "0" if is_stop else "2"
    doc = "of the last impact" if is_stop else "asked for in an impact"
    return [
        (f"mode{laws.suffix}", "which of its laws holds", f"{holder}.mode", start),
        (f"impulse{laws.suffix}", doc, f"{holder}.impulse", "0"),
    ]


def _stop_rows(port: Port) -> list[_EventRow]:
    friction = port.terminal.friction
    if friction is not None and friction.is_disc:
        rows = _disc_rows(port) if friction.followers else []
    else:
        rows = _limit_rows(port) if port.kind is Kind.STOP else _pressed_rows(port)
    return [(f"{_holder(port)} {what}", when, -1, part, own) for what, when, part, own in rows]


#: Row of an event at a limit: name, condition, role and targets.
_Row = tuple[str, str, ModePart, "dict[str, str]"]


def _limit_rows(port: Port) -> list[_Row]:
    stop, name, holder = port.terminal.stop, port.name, _holder(port)
    assert stop is not None
    row = DOMAINS[port.terminal.domain]
    mode, force = f"{holder}.mode", f"{name}.{row.through_symbol}"
    # Each factor is one in one kind of mode, and exactly zero in all other modes.
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
    # While a stop is closed, the mode is the side of the limit; in an impact, it is twice the side.
    rows.append(("lifts", f"{mode}*(7 - {mode}**2)/6*{force}", ModePart.FORCE, own))
    return rows


def _pressed_rows(port: Port) -> list[_Row]:
    """Return the events of friction whose normal force is the contact force of a stop."""
    friction, name, holder = port.terminal.friction, port.name, _holder(port)
    assert friction is not None
    row = DOMAINS[port.terminal.domain]
    mode, presser = f"{holder}.mode", f"{_holder(port, friction.presser)}.mode"
    speed, force = f"{name}.{row.across_symbol}", f"{name}.{row.through_symbol}"
    direction = f"{mode}*(4 - {mode}**2)*(9 - {mode}**2)/24"
    stuck = f"(1 - {mode}**2)*(2 - {mode})*(3 - {mode})/6"
    struck = f"{mode}*({mode}**2 - 1)*({mode} - 2)/24"
    # The second target identifies the stop that provides the normal force.
    own = {mode: mode, presser: presser}
    sticks = own | {f"{holder}.impulse": f"-{speed}"}
    upper = f"({stuck} + {struck})*({name}.upper - {force})"
    lower = f"({stuck} + {struck})*({force} - {name}.lower)"
    return [
        ("stops", f"{direction}*{speed}", ModePart.SLIP, sticks),
        ("slips forwards", upper, ModePart.FORWARD_LIMIT, own),
        ("slips backwards", lower, ModePart.BACKWARD_LIMIT, own),
    ]


#: Square of the tangent of the largest angle between slip and sliding direction.
_WIDEST = 3

#: Slip rate at which the sliding direction is updated first before slip ends, [m/s, rad/s].
_SLOW = "1e-4"

#: Slip rates at its second update, at a contact and in a joint. The slip at a contact is a sum of
#: speeds, with their rounding errors.
_SLOWER_AT_CONTACT, _SLOWER_IN_JOINT = "1e-5", "1e-6"

#: Ratio of the speed below which the sliding direction does not follow the slip, to the slip rate
#: at its next update. Where slip begins, a smaller speed makes the equations stiff. Where it ends,
#: a larger one changes the time at which it ends.
_SLOWEST = "1e-3"

#: Its square is added under square roots, because their slope at zero is infinite.
_TINY = "1e-30"

_WAY = "component of the direction of the slip"
_DIRECTION = "component of the direction of sliding, when it was last set"
_NEXT = "slip rate at the next update of the direction of sliding"


@dataclass(frozen=True)
class _Disc:
    """Friction whose force is limited by a disc on a plane, or by a ball in a ball joint."""

    owner: str  # prefix of the names of its mode and events
    holders: tuple[str, ...]  # first parts of the mode names, by slip direction
    slip: tuple[str, ...]
    force: tuple[str, ...]

    @classmethod
    def of(cls, port: Port) -> _Disc:
        """Return the expressions for a disc, given the port of its first slip direction."""
        friction, edge = port.terminal.friction, port.edge
        assert friction is not None
        slip, force = [], []
        for terminal in edge.component.ports:
            if terminal.port not in (port.terminal.port, *friction.followers):
                continue
            row, name = DOMAINS[terminal.domain], port.sibling(terminal.port)
            is_turn = _turns_in_sleeve(edge, terminal)
            slip.append(f"{name}.{row.across_symbol}{f'*{_radius(edge)}' if is_turn else ''}")
            force.append(f"{name}.{row.through_symbol}{f'/{_radius(edge)}' if is_turn else ''}")
        return cls(
            _holder(port) if friction.presser else edge.name,
            (_holder(port), *(_holder(port, name) for name in friction.followers)),
            tuple(slip),
            tuple(force),
        )

    @property
    def directions(self) -> tuple[str, ...]:
        """Return the modes that store the sliding direction at its last update."""
        return tuple(f"{holder}.direction" for holder in self.holders)

    @property
    def slow(self) -> str:
        """Return the mode with the slip rate at the next update of the sliding direction."""
        return f"{self.owner}.slow"

    @property
    def slowest(self) -> str:
        """Return the speed below which the sliding direction does not follow the slip."""
        return f"({_SLOWEST}*{self.slow})"

    @property
    def along(self) -> str:
        """Return the slip rate along the sliding direction."""
        return _sum(f"{v}*{d}" for v, d in zip(self.slip, self.directions, strict=True))

    @property
    def across(self) -> tuple[str, ...]:
        """Return the components of the slip perpendicular to the sliding direction."""
        if len(self.slip) == 2:
            (v1, v2), (d1, d2) = self.slip, self.directions
            return (f"({v2}*{d1} - {v1}*{d2})",)
        along, pairs = self.along, zip(self.slip, self.directions, strict=True)
        return tuple(f"({v} - {along}*{d})" for v, d in pairs)


def _turns_in_sleeve(edge: Edge, terminal: Terminal) -> bool:
    """Return whether the slip of a port is a rotation, whose speed counts at a radius."""
    return terminal.domain == "rotational" and edge.component.ports[0].domain == "translational"


def _radius(edge: Edge) -> str:
    """Return the radius at which a rod rubs in its sleeve."""
    radius = edge.fields["radius"]
    assert isinstance(radius, Expression)
    return f"({ast.unparse(radius.tree)})"


def _sum(terms: Iterable[str]) -> str:
    return f"({' + '.join(terms)})"


def _length(parts: Iterable[str]) -> str:
    return f"sqrt({' + '.join(f'({part})**2' for part in parts)} + {_TINY}**2)"


def _disc_modes(port: Port) -> list[_ModeRow]:
    friction, holder = port.terminal.friction, _holder(port)
    assert friction is not None
    way = "0" if friction.leader else "1"
    rows = [
        (f"impulse{friction.suffix}", "asked for in an impact", f"{holder}.impulse", "0"),
        (f"direction{friction.suffix}", _DIRECTION, f"{holder}.direction", way),
    ]
    if friction.leader:
        return rows  # the mode belongs to the first slip direction
    # At the start, friction at a contact is disengaged, because it has no normal force.
    start = "2" if friction.presser else "0"
    disc = _Disc.of(port)
    return [
        (friction.mode, "which of its laws holds", f"{disc.owner}.mode", start),
        (f"slow{friction.suffix}", _NEXT, disc.slow, _SLOW),
        *rows,
    ]


def _ways(port: Port) -> dict[str, str]:
    """Return the fields with the direction of the slip, rotated from the stored direction.

    The tangent of the angle does not change if slip reverses, so that the law is smooth at rest.
    """
    friction = port.terminal.friction
    if friction is not None and friction.leader and _turns_in_sleeve(port.edge, port.terminal):
        # The impulse state is minus the slip, which is a speed at the surface.
        return {f"impulse{friction.suffix}": f"{_holder(port)}.impulse/{_radius(port.edge)}"}
    if friction is None or not friction.followers:
        return {}
    disc = _Disc.of(port)
    share = f"{disc.along}/({disc.along}**2 + {disc.slowest}**2)"
    tangents = [f"({part}*{share})" for part in disc.across]
    length = f"sqrt(1 + {' + '.join(f'{tangent}**2' for tangent in tangents)})"
    if len(tangents) == 1:
        (d1, d2), (tangent,) = disc.directions, tangents
        turned = [f"({d1} - {tangent}*{d2})", f"({d2} + {tangent}*{d1})"]
    else:
        turned = [f"({d} + {t})" for d, t in zip(disc.directions, tangents, strict=True)]
    names = (friction.suffix, *(f"_{name}" for name in friction.followers))
    return {f"way{name}": f"{way}/{length}" for name, way in zip(names, turned, strict=True)}


def _disc_rows(port: Port) -> list[_Row]:
    friction = port.terminal.friction
    assert friction is not None
    disc = _Disc.of(port)
    mode, along = f"{disc.owner}.mode", disc.along
    slides = f"{mode}*(4 - {mode}**2)*(9 - {mode}**2)/24"
    is_sliding = f"{mode}**2*(4 - {mode}**2)*(9 - {mode}**2)/24"
    stuck = f"(1 - {mode}**2)*(2 - {mode})*(3 - {mode})/6"
    struck = f"{mode}*({mode}**2 - 1)*({mode} - 2)/24"
    force, speed = _length(disc.force), _length(disc.slip)
    limit = f"{port.name}.upper"
    # Direction of slip or, while friction sticks, of the force, in which sliding would begin.
    directions = {
        d: f"{is_sliding}*{v}/{speed} + {stuck}*{f}/{force}"
        for d, v, f in zip(disc.directions, disc.slip, disc.force, strict=True)
    }
    changes = [
        {f"{holder}.impulse": f"-{v}"} for holder, v in zip(disc.holders, disc.slip, strict=True)
    ]
    across = " + ".join(f"{part}**2" for part in disc.across)
    turned = f"({_WIDEST}*{along}**2 - ({across}) + {disc.slowest}**2)"
    turns = f"{slides}*{turned}/({along}**2 + {across} + {disc.slowest}**2)"
    slower = _SLOWER_AT_CONTACT if friction.presser else _SLOWER_IN_JOINT
    own, pressed = {mode: mode}, []
    if friction.presser:
        # The second target identifies the stop that provides the normal force.
        presser = f"{_holder(port, friction.presser)}.mode"
        own[presser] = presser
        # This factor is one during an impact of the stop (mode 2 or -2), otherwise zero.
        hit = f"{presser}**2*({presser}**2 - 1)/12"
        parts = ModePart.FIRST_IMPULSE, ModePart.SECOND_IMPULSE
        pressed = [
            (f"has an impulse along slide{i}", f"{hit}*{f}", part, own)
            for i, (f, part) in enumerate(zip(disc.force, parts, strict=True), start=1)
        ]
    # The last target of each of three events is one component of the slip. In a joint, which has no
    # stop, the second target of ``turns`` is one, too.
    turn = own | directions
    if not friction.presser:
        turn = own | changes[0] | directions | {k: v for c in changes[2:] for k, v in c.items()}
    rows: list[_Row] = [
        ("stops", f"{slides}*{along}", ModePart.SLIP, own | changes[0]),
        (
            "slips",
            f"{stuck}*({limit} - {force}) + {struck}*{limit}",
            ModePart.FORWARD_LIMIT,
            own | {disc.slow: _SLOW} | directions | changes[1],
        ),
        ("turns", turns, ModePart.TURN, turn),
        # These events update the sliding direction before slip ends; later it hardly changes.
        (
            "slows",
            f"{slides}*({speed} - {disc.slow})",
            ModePart.NONE,
            directions | {disc.slow: slower},
        ),
        *pressed,
    ]
    if friction.grip is not None:
        rows.append(("engages", f"{port.name}.grip", ModePart.ENGAGED, own))
    return rows
