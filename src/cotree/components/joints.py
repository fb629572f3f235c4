"""Joints: one row each, by motion space. The reaction space is what remains of six directions."""

from __future__ import annotations

from typing import Any

from cotree.components.component import (
    Component,
    Field,
    Freedom,
    FreeRotation,
    Plane,
    Role,
    Shape,
    optional,
)
from cotree.components.law import Law
from cotree.components.spaces import body_space


def _along(coordinate: Any, rate: Any, stiffness: Any, free: Any, damping: Any, drive: Any) -> Any:
    """Add the efforts along a coordinate; positive ones drive the second node along it."""
    return -stiffness * (coordinate - free) - damping * rate + drive


# One law serves angles and lengths; only the names of its arguments differ.
_TURNING = ("theta", "theta_dot", "stiffness", "free_angle", "damping", "torque")
_SLIDING = ("s", "s_dot", "stiffness", "free_length", "damping", "force")


def _effort(name: str, unit: str, doc: str) -> Field:
    return optional(name, unit, doc, 0.0)


def _direction(name: str, doc: str) -> Field:
    return Field(name, "1", doc, Shape.VECTOR, required=True)


_AXIS = _direction("axis", "direction in the first node's axes")
_AXIS2 = _direction("axis2", "second direction, in the axes that the first turn has moved")
_NORMAL = _direction("normal", "normal of the plane, in the first node's axes")
_MOTION = Field("motion", "rad or m", "prescribes the coordinate as a function of time", timed=True)
_TURN_EFFORTS = (
    _effort("stiffness", "N m/rad", "of a torsional spring in the joint"),
    _effort("free_angle", "rad", "angle at which that spring is at rest"),
    _effort("damping", "N m s/rad", "of a torsional damper in the joint"),
    _effort("torque", "N m", "drives the second node about the axis"),
)
_ABOUT_AXIS = Plane(along=("axis",))

REVOLUTE = Component(
    "revolute",
    Role.JOINT,
    "rotation of the second node about an axis through both",
    fields=(_AXIS, *_TURN_EFFORTS, _MOTION),
    motion_space=(Freedom("theta", "rad", rotates=True, axis="axis"),),
    law=Law.taking(_TURNING, _along),
    keeps_plane=_ABOUT_AXIS,
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
        _MOTION,
    ),
    motion_space=(Freedom("s", "m", rotates=False, axis="axis"),),
    law=Law.taking(_SLIDING, _along),
    keeps_plane=Plane(within=("axis",)),
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

# The order of the freedoms matters: each axis is fixed in the frame that the earlier ones moved.
# Two turns about different axes leave every plane, so that no plane is declared.
UNIVERSAL = Component(
    "universal",
    Role.JOINT,
    "rotation about an axis of the first node, then about one that it has turned",
    fields=(_AXIS, _AXIS2),
    motion_space=(
        Freedom("theta1", "rad", rotates=True, axis="axis"),
        Freedom("theta2", "rad", rotates=True, axis="axis2"),
    ),
)

SPHERICAL = Component(
    "spherical",
    Role.JOINT,
    "every rotation of the second node about a point that both share",
    motion_space=(FreeRotation(),),
)

PLANAR = Component(
    "planar",
    Role.JOINT,
    "translation in a plane and rotation about its normal",
    fields=(_NORMAL,),
    motion_space=(
        Freedom("x", "m", rotates=False, axis="normal_x"),
        Freedom("y", "m", rotates=False, axis="normal_y"),
        Freedom("theta", "rad", rotates=True, axis="normal"),
    ),
    keeps_plane=Plane(along=("normal",)),
)

# A free joint between two bodies has an empty reaction space: it only chooses coordinates.
FREE = Component(
    "free",
    Role.JOINT,
    "every motion of the second node: no reaction",
    motion_space=body_space("", is_particle=False),
)

# A screw has one freedom: its translation follows from the angle by the pitch, so that its reaction
# is the wrench that does no work on both together.
SCREW = Component(
    "screw",
    Role.JOINT,
    "rotation about an axis with a translation along it in proportion",
    fields=(
        _AXIS,
        Field("pitch", "m/rad", "translation for each radian", required=True),
        *_TURN_EFFORTS,
        _MOTION,
    ),
    motion_space=(Freedom("theta", "rad", rotates=True, axis="axis", pitch="pitch"),),
    law=Law.taking(_TURNING, _along),
)

COMPONENTS = (REVOLUTE, PRISMATIC, CYLINDRICAL, UNIVERSAL, SPHERICAL, PLANAR, FREE, SCREW)
