"""Constraints: chords whose across variable is held, by a through variable of unknown size."""

from __future__ import annotations

from cotree.components.component import Component, Field, Plane, Role, Shape

# An empty Plane sets no condition: a distance between points of a plane stays within it.
DISTANCE = Component(
    "distance",
    Role.CONSTRAINT,
    "a massless rod: holds the distance between two nodes",
    fields=(Field("length", "m", "the distance", required=True, timed=True, sign="positive"),),
    domains=("translation",),
    keeps_plane=Plane(),
)

SLOT = Component(
    "slot",
    Role.CONSTRAINT,
    "holds the second node on a line through the first",
    fields=(
        Field(
            "axis",
            "1",
            "direction of the line in the first node's axes; may depend on time",
            Shape.VECTOR,
            required=True,
            timed=True,
        ),
    ),
    domains=("translation",),
    keeps_plane=Plane(within=("axis",)),
)

# Nonholonomic: it holds a velocity and no position, since a blade reaches every place by turning.
KNIFE_EDGE = Component(
    "knife_edge",
    Role.CONSTRAINT,
    "holds the velocity of the second node, against the first, across a blade at zero",
    fields=(
        Field(
            "axis",
            "1",
            "direction across the blade, in the second node's axes",
            Shape.VECTOR,
            required=True,
        ),
    ),
    keeps_plane=Plane(within=("axis",)),
)

# One equation holds a position, the height of the disc's centre; two hold velocities, the slip
# along the plane.
ROLLING_DISC = Component(
    "rolling_disc",
    Role.CONSTRAINT,
    "a thin disc about the second node rolls without slip on a plane through the first",
    fields=(
        Field("normal", "1", "of the plane, in the first node's axes", Shape.VECTOR, required=True),
        Field("axis", "1", "of the disc, in the second node's axes", Shape.VECTOR, required=True),
        Field("radius", "m", "of the disc", required=True, sign="positive"),
    ),
    keeps_plane=Plane(along=("axis",), within=("normal",)),
)

ROLLING_ELLIPSOID = Component(
    "rolling_ellipsoid",
    Role.CONSTRAINT,
    "an ellipsoid about the second node rolls without slip on a plane through the first",
    fields=(
        Field("normal", "1", "of the plane, in the first node's axes", Shape.VECTOR, required=True),
        Field(
            "semiaxes",
            "m",
            "along the second node's axes, positive",
            Shape.VECTOR,
            required=True,
            sign="positive",
        ),
    ),
    keeps_plane=Plane(within=("normal",)),
)

# Gears and expressions couple coordinates themselves, so they have no edge in a graph and their
# domains are empty.
GEAR = Component(
    "gear",
    Role.CONSTRAINT,
    "couples two coordinates: coordinate1 = ratio * coordinate2 + phase",
    fields=(
        Field("coordinate1", "rad or m", "such as j1.theta", Shape.EXPRESSION, required=True),
        Field("coordinate2", "rad or m", "such as j2.theta", Shape.EXPRESSION, required=True),
        Field("ratio", "1, m or 1/m", "negative for wheels that mesh outside", required=True),
        Field("phase", "rad or m", "coordinate1 where coordinate2 is zero", default=0.0),
    ),
    domains=(),
    keeps_plane=Plane(),
)

CONSTRAINT = Component(
    "constraint",
    Role.CONSTRAINT,
    "holds an expression of coordinates, node positions, parameters and t at zero",
    fields=(Field("expression", "", "what stays zero", Shape.EXPRESSION, required=True),),
    domains=(),
    keeps_plane=Plane(),
)

COMPONENTS = (DISTANCE, SLOT, KNIFE_EDGE, ROLLING_DISC, ROLLING_ELLIPSOID, GEAR, CONSTRAINT)
