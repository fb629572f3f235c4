"""Force elements: chords whose through variable follows from across variables and fields.

Through variables act on the second node; the first gets the reaction.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from cotree.components.component import Component, Field, Plane, Role, Shape, optional, value
from cotree.components.law import Law


def _three(name: str, unit: str, doc: str) -> Field:
    return Field(name, unit, doc, Shape.VECTOR, constant=False)


AXIS = Field(
    "axis", "1", "acts along it, fixed in the first node's axes; else along the line", Shape.VECTOR
)


# Forces on the second node: tension pulls it towards the first, hence the minus signs.
def _spring(length: Any, rate: Any, stiffness: Any, free_length: Any, damping: Any) -> Any:
    return -stiffness * (length - free_length) - damping * rate


def _damper(rate: Any, damping: Any) -> Any:
    return -damping * rate


# Without an axis the force acts along the line of the nodes, which keeps every plane.
SPRING = Component(
    "spring",
    Role.LINE,
    "linear spring, with a damper beside it where damping is given",
    fields=(
        AXIS,
        value("stiffness", "N/m", "force per length", ""),
        optional("free_length", "m", "length at rest", 0.0),
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
    "given force on the second node",
    fields=(replace(_three("force", "N", "components in the first node's axes"), required=True),),
    domains=("translation",),
    keeps_plane=Plane(within=("force",)),
)

TORQUE = Component(
    "torque",
    Role.TORQUE,
    "given torque on the second node",
    fields=(
        replace(_three("torque", "N m", "components in the first node's axes"), required=True),
    ),
    domains=("rotation",),
    keeps_plane=Plane(along=("torque",)),
)

# The law is an expression of the scene, so that the type has none of its own.
LINE_FORCE = Component(
    "line_force",
    Role.LAW,
    "force along the line of its nodes, or an axis, by an expression of length and rate",
    fields=(
        AXIS,
        Field(
            "force",
            "N",
            "on the second node: an expression of length, rate, t, inputs and coordinates",
            Shape.EXPRESSION,
            required=True,
        ),
    ),
    domains=("translation",),
    keeps_plane=Plane(within=("axis",)),
)


# A bushing has a law for each of its six directions, which the formulation forms; hence it has no
# scalar law of its own.
BUSHING = Component(
    "bushing",
    Role.BUSHING,
    "springs and dampers along and about the three axes of the first node",
    fields=(
        _three("stiffness", "N/m", "along each axis"),
        _three("damping", "N s/m", "along each axis"),
        _three("rotation_stiffness", "N m/rad", "about each axis"),
        _three("rotation_damping", "N m s/rad", "about each axis"),
    ),
)

COMPONENTS = (SPRING, DAMPER, FORCE, TORQUE, LINE_FORCE, BUSHING)
