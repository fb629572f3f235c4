"""Dampers and friction on spherical joints: a law f(w) acts with the torque f(|w|) w/|w|.

The magnitude of the torque of dry friction is limited while the joint sticks (a ball of torques).
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
    from cotree.components.terminal import Terminal
    from cotree.scene.description import SceneDescription
    from cotree.scene.networks import Port

    _Scene = TypeVar("_Scene", bound=SceneDescription)

#: Added in quadrature to an angular speed, [rad/s]: the slope of a root at zero is infinite.
_SLOWEST = 1e-8

_NAMES = ("turn1", "turn2", "turn3")


def with_ball_joints(scene: _Scene) -> _Scene:
    """Replace each port of a damper or of friction on a spherical joint by three ports."""
    made = scene
    for port in scalar_ports(scene).values():
        joint = scene.edges.get(port.ends.acts_on[0]) if len(port.ends.acts_on) == 1 else None
        if joint is None or joint.component.name != "spherical":
            continue
        edge, terminal = port.edge, port.terminal
        if terminal.domain != "rotational" or len(edge.ports) > 1:
            continue
        if port.kind is Kind.DISSIPATOR:
            turns = _turns(terminal)
        elif port.kind is Kind.FRICTION:
            _check(port)
            turns = _frictions(terminal)
        else:
            continue
        if made is scene:
            made = copy.copy(scene)
            made.edges = dict(scene.edges)
        component = replace(edge.component, ports=turns)
        ports = (edge.ports[0],) * len(_NAMES)
        made.edges[edge.name] = replace(edge, component=component, ports=ports)
    return made


def _check(port: Port) -> None:
    """Raise SceneError for laws that depend on a direction of turning."""
    edge, friction = port.edge, port.terminal.friction
    assert friction is not None
    whose = f"edge '{edge.name}' acts on the spherical joint '{port.ends.acts_on[0]}'"
    if friction.lower is None:
        raise SceneError(f"{whose}, which has no backward direction: use a revolute joint")
    if "backward" in edge.fields:
        raise SceneError(f"{whose}, which has no backward direction: remove backward")
    own = f"{edge.name}.w"
    fields = edge.law_fields
    used = [name for name, field in fields.items() if own in getattr(field, "names", ())]
    if used:
        raise SceneError(
            f"{whose}, and its {used[0]} depends on the speed '{own}', but the slip of a spherical "
            "joint has three components: use stribeck_speed, or the rates w1, w2 and w3 of the "
            "joint"
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


def _frictions(terminal: Terminal) -> tuple[Terminal, ...]:
    law = terminal.friction
    assert law is not None
    # The scene adds fields with the components of the slip direction. The speed along it is smooth
    # through rest.
    speed: Any = sum(argument(f"across_{name}") * argument(f"way_{name}") for name in _NAMES)
    torque: Law = law.forward.where(across=speed)
    return tuple(
        replace(
            terminal,
            port=name,
            is_passive=False,
            friction=Friction(
                torque * argument(f"way_{name}"),
                # In an impact elsewhere, the direction is that in which sliding began.
                torque * argument(f"direction_{name}"),
                law.upper,
                None,
                law.grip,
                suffix=f"_{name}",
                leader="" if i == 0 else _NAMES[0],
                followers=_NAMES[1:] if i == 0 else (),
            ),
            touch=Touch(0, f"spin{i + 1}"),
        )
        for i, name in enumerate(_NAMES)
    )
