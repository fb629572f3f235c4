"""Component types: each declares a role in the graph, fields, a motion space and a law."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cotree.components.law import Law
    from cotree.components.terminal import PortMeasure, Terminal


class Role(Enum):
    """Role of an edge when equations are formulated."""

    BODY = "body"  # inertia, whose forces depend on accelerations
    ARM = "arm"  # constant transformation between two frames, without a motion space
    JOINT = "joint"  # has a motion space and a reaction space
    LINE = "line"  # a force along an axis or along the line between two nodes
    FORCE = "force"  # a given force vector
    TORQUE = "torque"  # a given torque vector
    BUSHING = "bushing"  # forces and torques along and about three axes
    LAW = "law"  # a force with a user-defined law
    CONSTRAINT = "constraint"  # a kinematic constraint between two nodes
    TOUCH = "touch"  # contact between the shapes of two bodies, whose laws are in a scalar graph
    NETWORK = "network"  # component with ports in scalar graphs, each with a terminal equation


class Acts(Enum):
    """Direction along which a user-defined law acts."""

    LINE = "line"  # along the line between the nodes, or along an axis fixed in the first node
    VELOCITY = "velocity"  # along the velocity of the second node relative to the first


class Shape(Enum):
    """Shape that the value of a field must have."""

    SCALAR = "scalar"
    VECTOR = "vector"  # three components
    EXPRESSION = "expression"  # an expression of across variables, kept as text
    NAMES = "names"  # a list of node names, which may repeat
    NUMBERS = "numbers"  # a list of numbers
    ROTATION = "rotation"  # roll, pitch and yaw about fixed axes, or a matrix of three rows
    INERTIA = "inertia"  # a scalar, three principal values, or a symmetric 3 by 3 tensor


@dataclass(frozen=True)
class Field:
    """A field of a component.

    Attributes
    ----------
    name, unit, doc : str
        Its name in scenes, its SI unit and its meaning.
    shape : Shape
        Shape of its value.
    default : float or None
        Value if the scene omits the field; None if the field then has no value.
    required : bool
        Whether a scene must set the field.
    constant : bool
        Whether its value may depend on parameters only; otherwise, it may also depend on time,
        inputs and coordinates.
    timed : bool
        Whether its value may depend on time in addition to parameters.
    sign : {'', 'nonnegative', 'positive', 'nonzero'}
        Sign that its value must have, or an empty string if any is allowed. A 'nonzero' value keeps
        the sign that it has for the parameter values of the scene.
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
    #: Name of the field with the axis, or ``x``, ``y``, ``z``. The axis is fixed in the frame that
    #: results from the preceding freedoms of the motion space. If all coordinates are zero, this
    #: frame is parallel to that of the first node.
    axis: str
    rate: str = ""  # name of the rate of the coordinate; ``<name>_dot`` if empty
    #: For a screw, the name of the field with its pitch: the translation along the axis per radian.
    pitch: str = ""

    @property
    def coordinates(self) -> tuple[tuple[str, str], ...]:
        """Name and unit of the coordinate."""
        return ((self.name, self.unit),)

    @property
    def rates(self) -> tuple[tuple[str, str], ...]:
        """Name and unit of the coordinate's rate."""
        return ((self.rate or f"{self.name}_dot", f"{self.unit}/s"),)


@dataclass(frozen=True)
class FreeRotation:
    """Unrestricted rotation: a quaternion, and the angular velocity in the second node's axes."""

    # Unlike three angles, a quaternion has no singular orientations. Its scalar part comes first.
    coordinates: tuple[tuple[str, str], ...] = (("q0", ""), ("q1", ""), ("q2", ""), ("q3", ""))
    rates: tuple[tuple[str, str], ...] = (("w1", "rad/s"), ("w2", "rad/s"), ("w3", "rad/s"))
    rotates: bool = True


#: One step of a motion space; steps lead from the first node to the second.
MotionStep = Freedom | FreeRotation


@dataclass(frozen=True)
class Plane:
    """Fields that must be normal or parallel to a plane if an edge is to keep its nodes in it."""

    along: tuple[str, ...] = ()
    within: tuple[str, ...] = ()


@dataclass(frozen=True)
class Demand:
    """A condition on several fields, checked at the current parameter values."""

    law: Law  # function of the fields; its value must be positive
    breach: str  # predicate of the error message; the edge's name is the subject


@dataclass(frozen=True)
class Component:
    """A component type.

    Attributes
    ----------
    name : str
        The ``type`` in scenes.
    role : Role
        Role of its edge when equations are formulated.
    doc : str
        One line that describes what it models.
    fields : tuple of Field
        The fields that a scene may set.
    domains : tuple of str
        The graphs in which it has an edge.
    motion_space : tuple of MotionStep
        Motion space of a joint; empty for all other components.
    law : Law or None
        Law of a force element, or of the effort along a joint's coordinate.
    keeps_plane : Plane or None
        Conditions under which the edge keeps its nodes in a plane; None if it never does.
    acts : Acts
        Direction along which a user-defined law acts.
    ports : tuple of Terminal
        Terminal equations of a scalar component, one for each of its edges in the graphs.
    loss : Law or None
        Power that a scalar component turns into heat, [W].
    terminals : tuple of str
        Node names of a scalar component whose ports share nodes, in order.
    optional_terminals : tuple of str
        Names of further nodes that a scene may list after these; ``adapt`` connects them.
    adapt : callable or None
        Function for components whose ports depend on the scene. It takes the edge's name, its nodes
        and its fields as given, and returns the adapted component, the nodes and the remaining
        fields.
    measures : tuple of PortMeasure
        Named sums of port variables of a scalar component.
    demands : tuple of Demand
        Conditions that involve several of its fields.
    geometry : Component or None
        For a contact, its part in the multibody system, whose fields define the shapes that may
        touch.
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
        # Count rates, because a quaternion has four coordinates but only three rates.
        return sum(len(step.rates) for step in self.motion_space)

    @property
    def tree_weight(self) -> float | None:
        """Weight of the edge as a branch of the tree; None if it cannot be a branch."""
        # The weight is the number of coordinates: dimensions of the motion space, six for a body.
        weights = {Role.ARM: 0.0, Role.JOINT: float(self.n_freedoms), Role.BODY: 6.0}
        return weights.get(self.role)

    def field(self, name: str) -> Field | None:
        """Return the field called ``name``, or None if there is none."""
        return next((field for field in self.fields if field.name == name), None)


#: Nodes and fields of an edge as stated in a scene, and the result of :attr:`Component.adapt`.
Nodes = Sequence[object]
Given = Mapping[str, Any]
Adapted = tuple[Component, Nodes, Given]
Adapt = Callable[[str, Nodes, Given], Adapted]


def value(name: str, unit: str, doc: str, sign: str = "positive") -> Field:
    """Declare a required field of a law, whose value may depend on any variable."""
    return Field(name, unit, doc, required=True, constant=False, sign=sign)


def optional(name: str, unit: str, doc: str, default: float | None, sign: str = "") -> Field:
    """Declare an optional field of a law; if its default is None, its term is left out."""
    return Field(name, unit, doc, default=default, constant=False, sign=sign)
