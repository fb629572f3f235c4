"""Multibody components; forces act on the second node, and their reactions on the first."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from cotree.components.component import (
    Component,
    Field,
    Freedom,
    FreeRotation,
    MotionStep,
    Plane,
    Role,
    Shape,
    optional,
    value,
)
from cotree.components.law import Law

#: For each normal, the two axes in the plane, in cyclic order after the normal.
PLANE_AXES = {"z": ("x", "y"), "x": ("y", "z"), "y": ("z", "x")}


def body_space(plane: str, is_particle: bool, line: str = "") -> tuple[MotionStep, ...]:
    """Return the motion space of a free body, with translations before the rotation.

    ``plane`` is the normal of the plane of motion; ``line`` is the direction of motion, or "".
    """
    # The order of the states is that of these translations and rotations.
    if line:
        return (Freedom(line, "m", rotates=False, axis=line),)
    if plane:
        # In every plane, the coordinates are called x and y; their axes depend on the normal.
        sliding = tuple(
            Freedom(name, "m", rotates=False, axis=axis)
            for name, axis in zip("xy", PLANE_AXES[plane], strict=True)
        )
        return sliding if is_particle else (*sliding, Freedom("theta", "rad", True, plane))
    sliding = tuple(Freedom(name, "m", False, name, rate=f"v{name}") for name in "xyz")
    return sliding if is_particle else (*sliding, FreeRotation())


# The inertia edge ends at the centre of mass, which decouples translation and rotation.
RIGID_BODY = Component(
    "rigid_body",
    Role.BODY,
    "inertia of a body whose centre of mass is the second node; the first node is ground",
    fields=(
        Field("mass", "kg", "mass of the body", required=True, sign="nonnegative"),
        Field(
            "inertia",
            "kg m^2",
            "inertia about the centre of mass, in the second node's axes; a particle if omitted",
            Shape.INERTIA,
            sign="nonnegative",
        ),
    ),
    keeps_plane=Plane(),
)

_ROTATION = Field(
    "rotation",
    "rad",
    "orientation of the second node: roll, pitch and yaw about the first node's axes, or a matrix",
    Shape.ROTATION,
)

# An arm has no coordinate. It keeps its nodes in a plane only if its vector is in the plane.
ARM = Component(
    "arm",
    Role.ARM,
    "constant vector in a body, from the first node to the second",
    fields=(
        Field(
            "vector",
            "m",
            "vector to the second node, in the first node's axes",
            Shape.VECTOR,
            required=True,
        ),
        _ROTATION,
    ),
    keeps_plane=Plane(within=("vector",)),
)

WELD = Component(
    "weld", Role.ARM, "rigid connection of two nodes", fields=(_ROTATION,), keeps_plane=Plane()
)


def _along(coordinate: Any, rate: Any, stiffness: Any, free: Any, damping: Any, drive: Any) -> Any:
    """Return the total effort along a coordinate; positive efforts increase the coordinate."""
    return -stiffness * (coordinate - free) - damping * rate + drive


# Argument names of the law, for an angle and for a length.
_TURNING = ("theta", "theta_dot", "stiffness", "free_angle", "damping", "torque")
_SLIDING = ("s", "s_dot", "stiffness", "free_length", "damping", "force")


def _effort(name: str, unit: str, doc: str) -> Field:
    return optional(name, unit, doc, 0.0)


def _direction(name: str, doc: str) -> Field:
    return Field(name, "1", doc, Shape.VECTOR, required=True)


_AXIS = _direction("axis", "direction of the axis, in the first node's frame")
_AXIS2 = _direction(
    "axis2", "direction of the second axis, in the frame that the first rotation has turned"
)
_NORMAL = _direction("normal", "normal of the plane, in the first node's frame")
_MOTION = Field("motion", "rad or m", "prescribed coordinate as a function of time", timed=True)
_TURN_EFFORTS = (
    _effort("stiffness", "N m/rad", "stiffness of a torsional spring in the joint"),
    _effort("free_angle", "rad", "angle at which the spring is unloaded"),
    _effort("damping", "N m s/rad", "coefficient of a torsional damper in the joint"),
    _effort("torque", "N m", "torque on the second node about the axis"),
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
        _effort("stiffness", "N/m", "stiffness of a spring in the joint"),
        _effort("free_length", "m", "coordinate at which the spring is unloaded"),
        _effort("damping", "N s/m", "coefficient of a damper in the joint"),
        _effort("force", "N", "force on the second node along the axis"),
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

# Each axis is fixed in the frame that results from previous freedoms. Two rotations keep no plane.
UNIVERSAL = Component(
    "universal",
    Role.JOINT,
    "rotation about an axis of the first node, then about a second axis that turns with it",
    fields=(_AXIS, _AXIS2),
    motion_space=(
        Freedom("theta1", "rad", rotates=True, axis="axis"),
        Freedom("theta2", "rad", rotates=True, axis="axis2"),
    ),
)

SPHERICAL = Component(
    "spherical",
    Role.JOINT,
    "any rotation of the second node about a common point",
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

# A free joint has an empty reaction space: it only defines coordinates.
FREE = Component(
    "free",
    Role.JOINT,
    "any motion of the second node, without reactions",
    motion_space=body_space("", is_particle=False),
)

# A screw has one freedom: the pitch couples translation and rotation. Reactions do no work.
SCREW = Component(
    "screw",
    Role.JOINT,
    "rotation about an axis with a proportional translation along it",
    fields=(
        _AXIS,
        Field("pitch", "m/rad", "translation per radian", required=True),
        *_TURN_EFFORTS,
        _MOTION,
    ),
    motion_space=(Freedom("theta", "rad", rotates=True, axis="axis", pitch="pitch"),),
    law=Law.taking(_TURNING, _along),
)


# The empty Plane sets no condition, because a distance constraint keeps every plane.
DISTANCE = Component(
    "distance",
    Role.CONSTRAINT,
    "massless rod: constant distance between two nodes",
    fields=(
        Field(
            "length", "m", "distance between the nodes", required=True, timed=True, sign="positive"
        ),
    ),
    domains=("translation",),
    keeps_plane=Plane(),
)

SLOT = Component(
    "slot",
    Role.CONSTRAINT,
    "second node on a line through the first",
    fields=(
        Field(
            "axis",
            "1",
            "direction of the line, in the first node's frame; may depend on time",
            Shape.VECTOR,
            required=True,
            timed=True,
        ),
    ),
    domains=("translation",),
    keeps_plane=Plane(within=("axis",)),
)

# Nonholonomic: velocity is restricted but position is not, since the blade can turn.
KNIFE_EDGE = Component(
    "knife_edge",
    Role.CONSTRAINT,
    "knife edge: zero velocity of the second node across a blade, relative to the first",
    fields=(_direction("axis", "direction across the blade, in the second node's frame"),),
    keeps_plane=Plane(within=("axis",)),
)

# One equation for the height of the disc's centre, two for the slip in the plane.
ROLLING_DISC = Component(
    "rolling_disc",
    Role.CONSTRAINT,
    "thin disc at the second node that rolls without slip on a plane through the first",
    fields=(
        _NORMAL,
        _direction("axis", "axis of the disc, in the second node's frame"),
        Field("radius", "m", "radius of the disc", required=True, sign="positive"),
    ),
    keeps_plane=Plane(along=("axis",), within=("normal",)),
)

ROLLING_ELLIPSOID = Component(
    "rolling_ellipsoid",
    Role.CONSTRAINT,
    "ellipsoid at the second node that rolls without slip on a plane through the first",
    fields=(
        _NORMAL,
        Field(
            "semiaxes",
            "m",
            "semi-axes along the axes of the second node",
            Shape.VECTOR,
            required=True,
            sign="positive",
        ),
    ),
    keeps_plane=Plane(within=("normal",)),
)


def _coordinate(name: str, doc: str) -> Field:
    return Field(name, "rad or m", doc, Shape.EXPRESSION, required=True)


# Gears and expressions couple coordinates directly: they have no edges and no domains.
GEAR = Component(
    "gear",
    Role.CONSTRAINT,
    "linear relation of two coordinates: coordinate1 = ratio * coordinate2 + phase",
    fields=(
        _coordinate("coordinate1", "driven coordinate, such as j1.theta"),
        _coordinate("coordinate2", "other coordinate, such as j2.theta"),
        Field(
            "ratio",
            "1, m or 1/m",
            "ratio of the coordinates; negative for external gears",
            required=True,
        ),
        Field("phase", "rad or m", "value of coordinate1 if coordinate2 is zero", default=0.0),
    ),
    domains=(),
    keeps_plane=Plane(),
)

CONSTRAINT = Component(
    "constraint",
    Role.CONSTRAINT,
    "expression of coordinates, node positions, parameters and t that stays zero",
    fields=(
        Field("expression", "", "expression that stays zero", Shape.EXPRESSION, required=True),
    ),
    domains=(),
    keeps_plane=Plane(),
)


def _three(name: str, unit: str, doc: str) -> Field:
    return Field(name, unit, doc, Shape.VECTOR, constant=False)


AXIS = Field(
    "axis",
    "1",
    "direction of the force, in the first node's frame; by default the line of the nodes",
    Shape.VECTOR,
)


# The force acts on the second node and is negative for tension.
def _spring(length: Any, rate: Any, stiffness: Any, free_length: Any, damping: Any) -> Any:
    return -stiffness * (length - free_length) - damping * rate


def _damper(rate: Any, damping: Any) -> Any:
    return -damping * rate


# Without an axis, the force acts along the line between the nodes, which keeps every plane.
SPRING = Component(
    "spring",
    Role.LINE,
    "linear spring, with a parallel damper if damping is given",
    fields=(
        AXIS,
        value("stiffness", "N/m", "force per elongation", ""),
        optional("free_length", "m", "length at which the force is zero", 0.0),
        optional("damping", "N s/m", "force per rate of length", 0.0),
    ),
    domains=("translation",),
    law=Law(_spring),
    keeps_plane=Plane(within=("axis",)),
)

DAMPER = Component(
    "damper",
    Role.LINE,
    "linear damper",
    fields=(AXIS, value("damping", "N s/m", "force per rate of length", "")),
    domains=("translation",),
    law=Law(_damper),
    keeps_plane=Plane(within=("axis",)),
)

FORCE = Component(
    "force",
    Role.FORCE,
    "prescribed force on the second node",
    fields=(replace(_three("force", "N", "components in the first node's frame"), required=True),),
    domains=("translation",),
    keeps_plane=Plane(within=("force",)),
)

TORQUE = Component(
    "torque",
    Role.TORQUE,
    "prescribed torque on the second node",
    fields=(
        replace(_three("torque", "N m", "components in the first node's frame"), required=True),
    ),
    domains=("rotation",),
    keeps_plane=Plane(along=("torque",)),
)

# The type has no law, because each edge states its own expression.
LINE_FORCE = Component(
    "line_force",
    Role.LAW,
    "force along the line of its nodes or an axis, a function of length and rate",
    fields=(
        AXIS,
        Field(
            "force",
            "N",
            "force on the second node, an expression of length, rate, t, inputs and coordinates",
            Shape.EXPRESSION,
            required=True,
        ),
    ),
    domains=("translation",),
    keeps_plane=Plane(within=("axis",)),
)


# A bushing has no scalar law; the formulation forms laws for its six directions.
BUSHING = Component(
    "bushing",
    Role.BUSHING,
    "springs and dampers along and about the three axes of the first node",
    fields=(
        _three("stiffness", "N/m", "stiffness along each axis"),
        _three("damping", "N s/m", "damping along each axis"),
        _three("rotation_stiffness", "N m/rad", "torsional stiffness about each axis"),
        _three("rotation_damping", "N m s/rad", "torsional damping about each axis"),
    ),
)

COMPONENTS = (
    *(RIGID_BODY, ARM, WELD),
    *(REVOLUTE, PRISMATIC, CYLINDRICAL, UNIVERSAL, SPHERICAL, PLANAR, FREE, SCREW),
    *(DISTANCE, SLOT, KNIFE_EDGE, ROLLING_DISC, ROLLING_ELLIPSOID, GEAR, CONSTRAINT),
    *(SPRING, DAMPER, FORCE, TORQUE, LINE_FORCE, BUSHING),
)
