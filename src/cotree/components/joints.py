"""Joints: one row each, by motion space. The reaction space is what remains of six directions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cotree.components.component import Component, Field, Freedom, Role, Shape
from cotree.components.law import Law

if TYPE_CHECKING:
    Symbol = Any


def _revolute(
    theta: Symbol,
    theta_dot: Symbol,
    stiffness: Symbol,
    free_angle: Symbol,
    damping: Symbol,
    torque: Symbol,
) -> Symbol:
    return -stiffness * (theta - free_angle) - damping * theta_dot + torque


def _prismatic(
    s: Symbol,
    s_dot: Symbol,
    stiffness: Symbol,
    free_length: Symbol,
    damping: Symbol,
    force: Symbol,
) -> Symbol:
    return -stiffness * (s - free_length) - damping * s_dot + force


def _effort(name: str, unit: str, doc: str) -> Field:
    return Field(name, unit, doc, default=0.0, constant=False)


_AXIS = Field("axis", "1", "direction in the first node's axes", Shape.VECTOR, required=True)

REVOLUTE = Component(
    "revolute",
    Role.JOINT,
    "rotation of the second node about an axis through both",
    fields=(
        _AXIS,
        _effort("stiffness", "N m/rad", "of a torsional spring in the joint"),
        _effort("free_angle", "rad", "angle at which that spring is at rest"),
        _effort("damping", "N m s/rad", "of a torsional damper in the joint"),
        _effort("torque", "N m", "drives the second node about the axis"),
    ),
    motion_space=(Freedom("theta", "rad", rotates=True, axis="axis"),),
    law=Law(_revolute),
)

PRISMATIC = Component(
    "prismatic",
    Role.JOINT,
    "translation of the second node along an axis through the first",
    fields=(
        _AXIS,
        _effort("stiffness", "N/m", "of a spring in the joint"),
        _effort("free_length", "m", "coordinate at which that spring is at rest"),
        _effort("damping", "N s/m", "of a damper in the joint"),
        _effort("force", "N", "drives the second node along the axis"),
    ),
    motion_space=(Freedom("s", "m", rotates=False, axis="axis"),),
    law=Law(_prismatic),
)

CYLINDRICAL = Component(
    "cylindrical",
    Role.JOINT,
    "translation along an axis and rotation about it",
    fields=(_AXIS,),
    motion_space=(
        Freedom("s", "m", rotates=False, axis="axis"),
        Freedom("theta", "rad", rotates=True, axis="axis"),
    ),
)

COMPONENTS = (REVOLUTE, PRISMATIC, CYLINDRICAL)
