"""Rigid bodies and the arms fixed in them."""

from __future__ import annotations

from cotree.components.component import Component, Field, Plane, Role, Shape

# The inertia edge runs from the ground to the centre of mass, where Newton's and Euler's equations
# separate into translation and rotation.
RIGID_BODY = Component(
    "rigid_body",
    Role.BODY,
    "inertia of a body whose centre of mass is the second node; the first node is ground",
    fields=(
        Field("mass", "kg", "mass", required=True, sign="nonnegative"),
        Field(
            "inertia",
            "kg m^2",
            "about the centre of mass, in the second node's axes; not modelled where absent",
            Shape.INERTIA,
            sign="nonnegative",
        ),
    ),
    keeps_plane=Plane(),
)

_ROTATION = Field(
    "rotation",
    "rad",
    "of the second node: roll, pitch and yaw about the first node's axes, or a matrix",
    Shape.ROTATION,
)

# The empty motion space of an arm adds no coordinate; an edge in the plane needs the vector there.
ARM = Component(
    "arm",
    Role.ARM,
    "a vector fixed in a body, from the first node to the second",
    fields=(
        Field("vector", "m", "in the first node's axes", Shape.VECTOR, required=True),
        _ROTATION,
    ),
    keeps_plane=Plane(within=("vector",)),
)

WELD = Component(
    "weld",
    Role.ARM,
    "holds the second node to the first",
    fields=(_ROTATION,),
    keeps_plane=Plane(),
)

COMPONENTS = (RIGID_BODY, ARM, WELD)
