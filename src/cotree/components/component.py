"""Component types: declarations of their role in the graph, fields, motion space and law."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cotree.components.law import Law
    from cotree.components.terminal import PortMeasure, Terminal


class Role(Enum):
    """Role of an edge in the formulation."""

    BODY = "body"  # inertia: forces as functions of accelerations
    ARM = "arm"  # arm: no motion space, a constant transformation between two frames
    JOINT = "joint"  # a motion space and a reaction space
    LINE = "line"  # a force along an axis or along the line between two nodes
    FORCE = "force"  # a given force vector
    TORQUE = "torque"  # a given torque vector
    BUSHING = "bushing"  # forces and torques along and about three axes
    LAW = "law"  # a force by a user-defined law
    CONSTRAINT = "constraint"  # a kinematic constraint between two nodes
    TOUCH = "touch"  # contact between the shapes of two bodies; its laws are in a scalar graph
    NETWORK = "network"  # ports in scalar graphs, each with a terminal equation


class Acts(Enum):
    """Direction along which a user-defined law acts."""

    LINE = "line"  # along the line between the nodes, or an axis fixed in the first
    VELOCITY = "velocity"  # along the velocity of the second node relative to the first


class Shape(Enum):
    """Shape of a field's value."""

    SCALAR = "scalar"
    VECTOR = "vector"  # three components
    EXPRESSION = "expression"  # an expression of across variables, kept as text
    NAMES = "names"  # names of nodes, which may repeat
    NUMBERS = "numbers"  # a list of numbers
    ROTATION = "rotation"  # roll, pitch and yaw about fixed axes, or a matrix of three rows
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
    timed : bool
        Whether it may depend on parameters and time.
    sign : {'', 'nonnegative', 'positive', 'nonzero'}
        Sign that its value must have; empty where it may have any. One that is not zero keeps the
        sign that it has at the scene's values of parameters.
    """

    name: str
    unit: str
    doc: str
    shape: Shape = Shape.SCALAR
    default: float | None = None
    required: bool = False
    constant: bool = True
    sign: str = ""
    timed: bool = False


@dataclass(frozen=True)
class Freedom:
    """One direction of a joint's motion space, with its coordinate."""

    name: str  # name of the coordinate
    unit: str  # unit of the coordinate
    rotates: bool  # true for a rotation about the axis, false for a translation along it
    #: Field of the axis, or ``x``, ``y``, ``z``. The axis is fixed in the frame that results from
    #: the preceding freedoms of the motion space. At zero coordinates this frame is parallel to
    #: that of the first node.
    axis: str
    rate: str = ""  # name of the rate of the coordinate; ``<name>_dot`` if empty
    #: For a screw: name of the field with the translation along the axis per radian.
    pitch: str = ""

    @property
    def coordinates(self) -> tuple[tuple[str, str], ...]:
        """Name and unit of the coordinate."""
        return ((self.name, self.unit),)

    @property
    def rates(self) -> tuple[tuple[str, str], ...]:
        """Name and unit of its rate."""
        return ((self.rate or f"{self.name}_dot", f"{self.unit}/s"),)


@dataclass(frozen=True)
class FreeRotation:
    """Every rotation: a quaternion, with the angular velocity in the second node's axes."""

    # Three angles have singular attitudes; a quaternion has none. Its scalar part comes first.
    coordinates: tuple[tuple[str, str], ...] = (("q0", ""), ("q1", ""), ("q2", ""), ("q3", ""))
    rates: tuple[tuple[str, str], ...] = (("w1", "rad/s"), ("w2", "rad/s"), ("w3", "rad/s"))
    rotates: bool = True


#: One step of a motion space: its directions follow one another from the first node outwards.
MotionStep = Freedom | FreeRotation


@dataclass(frozen=True)
class Plane:
    """Fields that must be along a plane's normal, or within it, for an edge to keep the plane."""

    along: tuple[str, ...] = ()
    within: tuple[str, ...] = ()


@dataclass(frozen=True)
class Demand:
    """Condition on several fields of a component together, if parameters decide it."""

    law: Law  # function of the fields, whose value must be positive
    breach: str  # predicate of the error message, which follows the name of the edge


@dataclass(frozen=True)
class Component:
    """A component type.

    Attributes
    ----------
    name : str
        The ``type`` in scenes.
    role : Role
        Role of its edge in the formulation.
    doc : str
        One line on what it models.
    fields : tuple of Field
        The fields that a scene may give.
    domains : tuple of str
        The graphs that it has an edge in.
    motion_space : tuple of MotionStep
        Of a joint; empty otherwise.
    law : Law or None
        Of a force element, or of the through variable along a joint's coordinate.
    keeps_plane : Plane or None
        Conditions under which the edge keeps its nodes within a plane; None if it never does.
    acts : Acts
        Direction along which a user's law acts.
    ports : tuple of Terminal
        The terminal equations of a scalar component, one for each edge that it has in the graphs.
    loss : Law or None
        Of a scalar component: the power that it turns into heat, [W].
    terminals : tuple of str
        Of a scalar component whose ports share nodes: names of its nodes, in order.
    optional_terminals : tuple of str
        Names of further nodes that a scene may list after these; ``adapt`` takes them.
    adapt : callable or None
        Where ports depend on the scene: takes the edge's name, its nodes as listed and its fields
        as given; returns the component adapted to them, the nodes, and the fields that remain.
    measures : tuple of PortMeasure
        Of a scalar component: sums of variables of its ports, under names of its own.
    demands : tuple of Demand
        Conditions on its fields together.
    geometry : Component or None
        Of a contact: the part of it that belongs to the multibody system, with the fields that say
        what shapes may touch.
    """

    name: str
    role: Role
    doc: str
    fields: tuple[Field, ...] = ()
    domains: tuple[str, ...] = ("translation", "rotation")
    motion_space: tuple[MotionStep, ...] = ()
    law: Law | None = None
    keeps_plane: Plane | None = None
    acts: Acts = Acts.LINE
    ports: tuple[Terminal, ...] = ()
    terminals: tuple[str, ...] = ()
    optional_terminals: tuple[str, ...] = ()
    loss: Law | None = None
    adapt: Adapt | None = None
    measures: tuple[PortMeasure, ...] = ()
    demands: tuple[Demand, ...] = ()
    geometry: Component | None = None

    @property
    def n_freedoms(self) -> int:
        """Dimension of the motion space."""
        # Rates are counted, not coordinates: a quaternion has four coordinates but three freedoms.
        return sum(len(step.rates) for step in self.motion_space)

    @property
    def tree_weight(self) -> float | None:
        """Weight of the edge as a branch of the tree; None if it cannot be a branch."""
        # A tree of minimum weight then has the fewest coordinates: a branch adds as many as its
        # motion space has dimensions; a free body has the six absolute coordinates.
        if self.role is Role.ARM:
            return 0.0
        if self.role is Role.JOINT:
            return float(self.n_freedoms)
        if self.role is Role.BODY:
            return 6.0
        return None

    def field(self, name: str) -> Field | None:
        """Return the field called ``name``, if it exists."""
        return next((field for field in self.fields if field.name == name), None)


#: Nodes and fields of an edge as stated in a scene, and the result of :attr:`Component.adapt`.
Nodes = Sequence[object]
Given = Mapping[str, Any]
Adapted = tuple[Component, Nodes, Given]
Adapt = Callable[[str, Nodes, Given], Adapted]


def value(name: str, unit: str, doc: str, sign: str = "positive") -> Field:
    """Declare a required field of a law, which may depend on any variable.

    ``sign`` is '', 'nonnegative', 'positive' or 'nonzero', if the field is constant.
    """
    return Field(name, unit, doc, required=True, constant=False, sign=sign)


def optional(name: str, unit: str, doc: str, default: float | None, sign: str = "") -> Field:
    """Declare an optional field of a law; a default of None leaves its term out.

    ``sign`` is '', 'nonnegative' or 'positive', if the field is constant.
    """
    return Field(name, unit, doc, default=default, constant=False, sign=sign)
