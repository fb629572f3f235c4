"""What a component type declares: its role in the graph, its fields, its motion space, its law."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cotree.components.law import Law


class Role(Enum):
    """What an edge is to the formulation."""

    BODY = "body"  # inertia: through variables from accelerations
    ARM = "arm"  # an empty motion space: a fixed across variable
    JOINT = "joint"  # a motion space and a reaction space
    LINE = "line"  # a force along an axis or along the line of its nodes
    FORCE = "force"  # a given force vector
    TORQUE = "torque"  # a given torque vector


class Shape(Enum):
    """Shape of a field's value."""

    SCALAR = "scalar"
    VECTOR = "vector"  # three components
    INERTIA = "inertia"  # a scalar, three principal values, or a symmetric 3 by 3 tensor


@dataclass(frozen=True)
class Field:
    """A field of a component.

    Attributes
    ----------
    name, unit, doc : str
        Name in scenes, SI unit, meaning.
    shape : Shape
        Scalar, vector or inertia.
    default : float or None
        Value where the scene gives none; None leaves the field out.
    required : bool
        Whether a scene must give it.
    constant : bool
        Whether it may depend on parameters only. Otherwise time, inputs and coordinates are
        allowed too.
    sign : {'', 'nonnegative', 'positive'}
        What its value must be.
    """

    name: str
    unit: str
    doc: str
    shape: Shape = Shape.SCALAR
    default: float | None = None
    required: bool = False
    constant: bool = True
    sign: str = ""


@dataclass(frozen=True)
class Freedom:
    """One direction of a joint's motion space, with its coordinate.

    Attributes
    ----------
    name : str
        Name of the coordinate; its rate is called ``<name>_dot``.
    unit : str
        Unit of the coordinate.
    rotates : bool
        True for a rotation about the axis, false for a translation along it.
    axis : str
        The field that holds the axis. It is fixed in the frame that the freedoms before it in the
        motion space have moved, which is parallel to the first node's where they are zero.
    """

    name: str
    unit: str
    rotates: bool
    axis: str


@dataclass(frozen=True)
class Component:
    """A component type.

    Attributes
    ----------
    name : str
        The ``type`` in scenes.
    role : Role
        What its edge is to the formulation.
    doc : str
        One line on what it models.
    fields : tuple of Field
        What a scene may say of it.
    domains : tuple of str
        The graphs that it has an edge in.
    motion_space : tuple of Freedom
        Of a joint; empty otherwise.
    law : Law or None
        Of a force element, or of what acts along a joint's coordinate.
    """

    name: str
    role: Role
    doc: str
    fields: tuple[Field, ...] = ()
    domains: tuple[str, ...] = ("translation", "rotation")
    motion_space: tuple[Freedom, ...] = ()
    law: Law | None = None

    @property
    def tree_weight(self) -> float | None:
        """What the edge adds to the equations as a branch; None where it cannot be one."""
        if self.role is Role.ARM:
            return 0.0
        if self.role is Role.JOINT:
            return float(len(self.motion_space))
        if self.role is Role.BODY:
            return 6.0
        return None

    def field(self, name: str) -> Field | None:
        """Give the field called ``name``, if there is one."""
        return next((field for field in self.fields if field.name == name), None)
