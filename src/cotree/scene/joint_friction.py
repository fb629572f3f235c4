"""Dampers and friction on joints with several motions.

On a spherical joint, a law f(w) acts with the torque f(|w|) w/|w|. The magnitude of the torque of
dry friction is limited while the joint sticks (a ball of torques). On a cylindrical joint, dry
friction at a radius limits force and torque together.
"""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

from cotree.components import Kind
from cotree.components.law import Law, argument, sqrt
from cotree.components.terminal import Friction, Touch
from cotree.errors import SceneError
from cotree.scene.networks import scalar_ports

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.components.terminal import Terminal
    from cotree.scene.description import SceneDescription
    from cotree.scene.networks import Port

    _Scene = TypeVar("_Scene", bound=SceneDescription)

#: Added in quadrature to an angular speed, [rad/s]: the slope of a root at zero is infinite.
_SLOWEST = 1e-8

_NAMES = ("turn1", "turn2", "turn3")

#: Ports of friction at the surface of a rod in a sleeve, by domain.
_AT_SURFACE = {"along": "translational", "around": "rotational"}

_SURFACE = "translational"  # domain of an edge with such friction


def with_joint_friction(scene: _Scene) -> _Scene:
    """Replace a damper or friction on several motions of a joint by a port for each motion."""
    made = scene
    for port in scalar_ports(scene).values():
        turns = _ports_on_joint(scene, port)
        if not turns:
            continue
        if made is scene:
            made = copy.copy(scene)
            made.edges = dict(scene.edges)
        edge = port.edge
        component = replace(edge.component, ports=turns)
        made.edges[edge.name] = replace(
            edge, component=component, ports=(edge.ports[0],) * len(turns)
        )
    return made


def _ports_on_joint(scene: SceneDescription, port: Port) -> tuple[Terminal, ...]:
    """Return the ports that replace a port, or an empty tuple."""
    edge, terminal, acts_on = port.edge, port.terminal, port.ends.acts_on
    joint = scene.edges.get(acts_on[0]) if len(acts_on) == 1 else None
    kind = joint.component.name if joint is not None else ""
    if terminal.touch is not None:
        return ()
    if port.kind is Kind.FRICTION and "radius" in edge.fields and terminal.domain == _SURFACE:
        if kind != "cylindrical":
            raise SceneError(
                f"radius of edge '{edge.name}' needs a cylindrical joint: remove it, or name the "
                'joint as joint = "..."'
            )
        _check(port, "v", "")
        return _frictions(terminal, _AT_SURFACE)
    if kind != "spherical" or terminal.domain != "rotational" or len(edge.ports) > 1:
        return ()
    if port.kind is Kind.DISSIPATOR:
        return _turns(terminal)
    if port.kind is not Kind.FRICTION:
        return ()
    _check(port, "w", ", or the rates w1, w2 and w3 of the joint")
    return _frictions(terminal, dict.fromkeys(_NAMES, terminal.domain))


def _check(port: Port, speed: str, others: str) -> None:
    """Raise SceneError for laws that depend on a direction of slip."""
    edge, friction, joint = port.edge, port.terminal.friction, port.ends.acts_on[0]
    assert friction is not None
    whose = f"edge '{edge.name}' acts on all motions of the joint '{joint}'"
    if friction.lower is None:
        raise SceneError(f"{whose}, which have no backward direction: use a revolute joint")
    if "backward" in edge.fields:
        raise SceneError(f"{whose}, which have no backward direction: remove backward")
    own = f"{edge.name}.{speed}"
    fields = edge.law_fields
    used = [name for name, field in fields.items() if own in getattr(field, "names", ())]
    if used:
        raise SceneError(
            f"{whose}, and its {used[0]} depends on the speed '{own}', but the slip has several "
            f"components: use stribeck_speed{others}"
        )


def _turns(terminal: Terminal) -> tuple[Terminal, ...]:
    assert terminal.through is not None
    squares = sum(argument(f"across_{other}") ** 2 for other in _NAMES)
    factor = terminal.through.over("across").where(across=sqrt(squares + _SLOWEST**2))
    return tuple(
        replace(
            terminal,
            port=name,
            through=factor * argument(f"across_{name}"),
            is_passive=False,
            touch=Touch(0, f"spin{i + 1}"),
        )
        for i, name in enumerate(_NAMES)
    )


def _frictions(terminal: Terminal, domains: Mapping[str, str]) -> tuple[Terminal, ...]:
    law = terminal.friction
    assert law is not None
    names = tuple(domains)
    # The scene adds fields with the components of the slip direction. The speed along it is smooth
    # through rest.
    levers: dict[str, Any] = {n: argument("radius") if n == "around" else 1 for n in names}
    speed: Any = sum(argument(f"across_{n}") * levers[n] * argument(f"way_{n}") for n in names)
    force: Law = law.forward.where(across=speed)
    return tuple(
        replace(
            terminal,
            domain=domain,
            port=name,
            is_passive=False,
            friction=Friction(
                force * levers[name] * argument(f"way_{name}"),
                # In an impact elsewhere, the direction is that in which sliding began.
                force * levers[name] * argument(f"direction_{name}"),
                law.upper,
                None,
                law.grip,
                suffix=f"_{name}",
                leader="" if i == 0 else names[0],
                followers=names[1:] if i == 0 else (),
            ),
            touch=Touch(0, f"spin{i + 1}") if name in _NAMES else None,
        )
        for i, (name, domain) in enumerate(domains.items())
    )
