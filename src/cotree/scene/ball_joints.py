"""Dampers and friction on spherical joints: a law f(w) acts with the torque f(|w|) w/|w|."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

from cotree.components import Kind
from cotree.components.law import argument, sqrt
from cotree.components.terminal import Touch
from cotree.scene.networks import scalar_ports

if TYPE_CHECKING:
    from cotree.components.terminal import Terminal
    from cotree.scene.description import SceneDescription

    _Scene = TypeVar("_Scene", bound=SceneDescription)

#: Added in quadrature to an angular speed, [rad/s]: the slope of a root at zero is infinite.
_SLOWEST = 1e-8

_NAMES = ("turn1", "turn2", "turn3")


def with_ball_joints(scene: _Scene) -> _Scene:
    """Replace each port of a damper on a spherical joint by three ports, one per axis."""
    made = scene
    for port in scalar_ports(scene).values():
        joint = scene.edges.get(port.ends.acts_on[0]) if len(port.ends.acts_on) == 1 else None
        if joint is None or joint.component.name != "spherical":
            continue
        edge, is_damper = port.edge, port.kind is Kind.DISSIPATOR
        if not is_damper or port.terminal.domain != "rotational" or len(edge.ports) > 1:
            continue
        if made is scene:
            made = copy.copy(scene)
            made.edges = dict(scene.edges)
        component = replace(edge.component, ports=_turns(port.terminal))
        ports = (edge.ports[0],) * len(_NAMES)
        made.edges[edge.name] = replace(edge, component=component, ports=ports)
    return made


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
