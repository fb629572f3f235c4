"""Fields of edges as nodes: scalars, unit vectors, inertia tensors, rotations."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

from cotree.components import Component, Field, MotionStep, Shape
from cotree.components.component import Role
from cotree.components.mechanical import VELOCITY_SOURCES
from cotree.dag import vector
from cotree.dag.derivative import tangents
from cotree.dag.nodes import MEASURED, PARAMETER, TIME, Dag, Node, kinds_in, symbols_in
from cotree.dag.vector import Matrix, Vector, about, quaternion_of_angles, quaternion_of_matrix
from cotree.equations import Guard
from cotree.errors import ExpressionError, FormulationError, ParameterError, SceneError, nearest
from cotree.naming import owner_among
from cotree.scene.checks import ROUNDING
from cotree.scene.expressions import Expression, FieldValue

if TYPE_CHECKING:
    from cotree.scene.description import Edge, SceneDescription


Resolver = Callable[[str], "Node"]

#: Fields that are directions: their length has no effect.
UNIT_VECTORS = frozenset({"axis", "axis2", "normal"})


@dataclass(frozen=True)
class BoundEdge:
    """An edge whose fields are nodes; vectors and tensors are tuples of nodes."""

    name: str
    component: Component
    first: str
    second: str
    scalars: Mapping[str, Node]
    vectors: Mapping[str, Vector]
    inertia: Matrix | None
    rotation: Matrix | None
    expressions: Mapping[str, Expression]


def bind_edge(
    edge: Edge, dag: Dag, names_of: Callable[[Field], Resolver], at_scene: Callable[[Node], float]
) -> tuple[BoundEdge, list[Guard]]:
    """Bind the fields of an edge to nodes and normalise its axes; also return guards.

    ``names_of`` returns the nodes of the names that a field may use; ``at_scene`` evaluates nodes
    of parameters. Raise ParameterError if an axis has no direction or a constant has a wrong sign.
    """
    expressions: dict[str, Expression] = {}
    guards: list[Guard] = []
    scalars: dict[str, Node] = {}
    vectors: dict[str, Vector] = {}
    inertia = rotation = None
    for name, value in edge.fields.items():
        row = edge.component.field(name)
        assert row is not None  # the scene has checked that the component has this field
        resolve = names_of(row)
        if row.shape is Shape.EXPRESSION:
            assert isinstance(value, Expression)
            expressions[name] = value
        elif isinstance(value, Expression):
            # Set the origin, so that messages about undefined values name the field.
            scalars[name] = value.lower(dag, resolve)
            dag.note_origin(scalars[name], f"{name} of edge '{edge.name}'")
        elif row.shape is Shape.INERTIA:
            inertia = _inertia(value, dag, resolve)
        elif row.shape is Shape.ROTATION:
            rotation = rotation_matrix(value, dag, resolve)
        else:
            vectors[name] = lower_vector(value, dag, resolve)
            if name in UNIT_VECTORS and not row.timed:
                where = f"{name} of edge '{edge.name}'"
                square = vector.dot(vectors[name], vectors[name])
                if square.value is None:  # the length may be zero for some parameter values
                    guards.append(Guard(square, f"the squared length of {where}", is_strict=True))
                vectors[name] = _unit(vectors[name], square, where)
    if "normal" in vectors:
        # A planar joint slides along two axes, which are computed from its normal.
        vectors["normal_x"], vectors["normal_y"] = plane_axes(vectors["normal"])
    first, second = edge.nodes or ("ground", "ground")  # an edge without nodes acts on a joint
    bound = BoundEdge(
        edge.name, edge.component, first, second, scalars, vectors, inertia, rotation, expressions
    )
    return bound, [*guards, *_guards(edge, bound, at_scene)]


def lower_vector(value: FieldValue, dag: Dag, resolve: Resolver) -> Vector:
    """Return the nodes of a triple of expressions."""
    x, y, z = (item.lower(dag, resolve) for item in value)  # type: ignore[union-attr]
    return (x, y, z)


def _inertia(value: FieldValue, dag: Dag, resolve: Resolver) -> Matrix:
    rows: list[Vector] = []
    for i, row in enumerate(cast("Sequence[Any]", value)):
        if isinstance(row, Expression):  # a list of three principal moments
            entries = [dag.zero] * 3
            entries[i] = row.lower(dag, resolve)
            rows.append((entries[0], entries[1], entries[2]))
        else:
            rows.append(lower_vector(row, dag, resolve))
    return (rows[0], rows[1], rows[2])


def _unit(axis: Vector, square: Node, where: str) -> Vector:
    """Scale an axis with this squared length to unit length; numeric axes are folded."""
    if square.is_zero:
        raise ParameterError(f"{where} has no direction: give a vector that is not zero")
    # An axis of length one up to rounding is not divided, so that numeric axes are unchanged.
    if square.value is not None and math.isclose(square.value, 1.0, rel_tol=1e-15):
        return axis
    length = square.dag.function("sqrt", square)
    return (axis[0] / length, axis[1] / length, axis[2] / length)


def _guards(edge: Edge, bound: BoundEdge, at_scene: Callable[[Node], float]) -> list[Guard]:
    found = []
    minors: list[Guard] = []
    for row in edge.component.fields:
        what, is_strict = f"{row.name} of edge '{edge.name}'", row.sign == "positive"
        if row.sign and row.name in bound.scalars and not is_varying(bound.scalars[row.name]):
            found.append(Guard(bound.scalars[row.name], what, is_strict))
        elif row.sign and row.name in bound.vectors:
            found += [
                Guard(entry, f"entry {i + 1} of {what}", is_strict)
                for i, entry in enumerate(bound.vectors[row.name])
                if not is_varying(entry)
            ]
        elif row.sign and row.name == "inertia" and bound.inertia is not None:
            # Diagonal entries must have the required sign; the minors bound all other entries.
            entries = (bound.inertia[i][i] for i in range(3))
            found += [
                Guard(entry, f"entry {i + 1} of {what}", is_strict)
                for i, entry in enumerate(entries)
            ]
            minors += _minors(bound.inertia, what, at_scene)
    # Check constants now, and parameters whenever ``prepare`` receives their values.
    for guard in found:
        if guard.value.value is not None:
            guard.check(guard.value.value)
    return [guard for guard in (*found, *minors) if guard.value.value is None]


def is_varying(node: Node) -> bool:
    """Return whether a value depends on more than parameters."""
    return any(symbol.data[0] != "p" for symbol in symbols_in([node]))


def _minors(tensor: Matrix, what: str, at_scene: Callable[[Node], float]) -> list[Guard]:
    """Return guards on the minors of an inertia tensor, which no real body has negative."""
    # Minors of thin rods, and of tensors with entries of 1e-35, are zero up to rounding. A small
    # fraction of the trace, added to the diagonal, is the tolerance.
    room = ROUNDING * (tensor[0][0] + tensor[1][1] + tensor[2][2])
    found = []
    for i, j in ((0, 1), (0, 2), (1, 2)):
        if not tensor[i][j].is_zero:
            minor = (tensor[i][i] + room) * (tensor[j][j] + room) - tensor[i][j] * tensor[i][j]
            found.append(Guard(minor, f"minor of rows {i + 1} and {j + 1} of {what}", False))
    # If the scene's values violate a guard, none is returned: they would reject the scene.
    return found if all(_is_met(guard, at_scene) for guard in found) else []


def _is_met(guard: Guard, at_scene: Callable[[Node], float]) -> bool:
    number = at_scene(guard.value)
    return number >= 0.0 or not math.isfinite(number)  # the guard itself reports nan


def rotation_matrix(value: FieldValue, dag: Dag, resolve: Resolver) -> Matrix:
    """Return rotated axes (columns) from rows, or from roll, pitch, yaw [rad] about fixed axes."""
    if isinstance(cast("Sequence[Any]", value)[0], Expression):
        angles = lower_vector(value, dag, resolve)
        matrix = vector.identity(dag)
        # Rotations about fixed axes multiply from the left.
        for axis, angle in zip(vector.identity(dag), angles, strict=True):
            if not angle.is_zero:
                matrix = vector.matmul(about(axis, angle).matrix, matrix)
        return matrix
    rows = [lower_vector(row, dag, resolve) for row in cast("Sequence[Any]", value)]
    return (rows[0], rows[1], rows[2])


def plane_axes(normal: Vector) -> tuple[Vector, Vector]:
    """Return two unit axes that form a right-handed system with a unit normal.

    If the normal is a coordinate axis, the results are the other two. Otherwise, the first one is
    the projection on the plane of the coordinate axis that follows the normal's largest entry.
    """
    dag = normal[0].dag
    # The size of a symbolic entry is unknown; any choice is valid if it is not singular.
    sizes = [abs(entry.value) if entry.value is not None else 0.5 for entry in normal]
    axes, follows = vector.identity(dag), sizes.index(max(sizes)) + 1
    start = axes[follows % 3]
    # Gram-Schmidt; the axis after a known largest entry is never parallel to the normal.
    along = vector.dot(normal, start)
    if along.value is None:
        # Parameters may turn the normal to within 26 degrees of this axis: use the next one there.
        share = 0.5 + 0.5 * dag.function("sign", along * along - 0.81)
        turn = vector.sub(axes[(follows + 1) % 3], start)
        start = vector.add(start, vector.scale(share, turn))
        along = vector.dot(normal, start)
    first = vector.sub(start, vector.scale(along, normal))
    if not along.is_zero:
        length = dag.function("sqrt", vector.dot(first, first))
        first = (first[0] / length, first[1] / length, first[2] / length)
    return first, vector.cross(normal, first)


def resolver_of(
    known: Sequence[Mapping[str, Node]],
    allowed: str = "",
    refused: Mapping[str, str] | None = None,
    advice: str = "",
) -> Resolver:
    """Return a function from names to nodes; later mappings in ``known`` take precedence.

    Error messages contain ``allowed``, which describes the allowed names, and ``advice``. Names in
    ``refused`` exist but are not allowed here; ``refused`` maps each to its advice.
    """
    others = refused or {}
    by_name = {name: node for mapping in known for name, node in mapping.items()}

    def resolve(name: str) -> Node:
        if name in by_name:
            return by_name[name]
        # A name that is not allowed here needs another message than a misspelt name.
        if allowed and (name == "t" or "." in name or name in others):
            own = others.get(name, advice)
            message = f"uses '{name}', but may depend on {allowed} only{own and ': '}{own}"
            raise ExpressionError(message)
        # T usually means a temperature or a torque, rarely time.
        hint = nearest(name, by_name.keys() - {"t"} if name == "T" else by_name)
        raise ExpressionError(f"uses the unknown name '{name}'{hint}")

    return resolve


class FieldNames:
    """The names that fields may use: parameters, inputs, states, outputs and across variables.

    Across variables are computed after the first fields are bound. Until :meth:`gathered` is
    called, each across variable in a field is a symbol. ``others`` are the nodes and edges of the
    scalar networks.
    """

    def __init__(
        self, scene: SceneDescription, dag: Dag, known: Mapping[str, Node], others: Collection[str]
    ) -> None:
        self._scene, self._dag, self._known = scene, dag, known
        self._of_known = resolver_of([known])
        self._places = {*scene.nodes, *scene.edges, *others}
        self._pending: list[str] = []
        self._measured: dict[str, Node] = {}
        self._is_gathered = False

    def node(self, name: str, resolve: Resolver | None = None) -> Node:
        """Return the node of a name; ``resolve`` returns the nodes of names inside an output."""
        # In expressions, a parameter takes precedence over an output of the same name.
        if name in self._scene.outputs and name not in self._scene.parameters:
            return self._output(name, resolve or self.node)
        # Names of states also contain dots, but their symbols are already known.
        is_across = bool(owner_among(name, self._places))
        if not is_across or name in self._known:
            return self._of_known(name)
        if name not in self._measured:
            assert not self._is_gathered  # a symbol created now would never be replaced
            self._measured[name] = self._dag.symbol(MEASURED, len(self._measured))
        return self._measured[name]

    def _output(self, name: str, resolve: Resolver) -> Node:
        if name in self._pending:
            raise ExpressionError(f"uses output '{name}', which depends on itself")
        # An output may use other outputs; an output that is pending here depends on itself.
        self._pending.append(name)
        found = self._scene.outputs[name].lower(self._dag, resolve)
        self._pending.remove(name)
        return found

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the across variables that fields use so far, in order of first use."""
        return tuple(self._measured)

    def gathered(self) -> dict[str, Node]:
        """Return the symbols of all across variables by name, and accept no further ones."""
        self._is_gathered = True
        return dict(self._measured)


def initial_values(
    edge: Edge, space: Sequence[MotionStep], dag: Dag, resolve: Resolver, start: Mapping[str, Node]
) -> dict[str, Node]:
    """Bind the initial values of a branch by short names of its coordinates and rates.

    ``start`` contains default values that the scene may replace; all other values are zero. Raise
    SceneError if the scene has an initial value for a coordinate that the branch does not have.
    """
    values = {name: dag.zero for kind in space for name, _ in (*kind.coordinates, *kind.rates)}
    # The identity rotation is the quaternion (1, 0, 0, 0).
    if "q0" in values:
        values["q0"] = dag.one
    # Initial values of the scene are set below and take precedence.
    values |= start
    for name, given in edge.initial.items():
        if name == "rotation" and "q0" in values:
            turned = _quaternion(given, dag, resolve)
            values |= {f"q{i}": node for i, node in enumerate(turned)}
        elif name not in values:
            raise SceneError(
                f"edge '{edge.name}' moves along {', '.join(values) or 'nothing'} in this "
                f"scene, so it has no initial '{name}'{nearest(name, values)}"
            )
        else:
            # The scene has checked that all initial values except rotations are single expressions.
            assert isinstance(given, Expression)
            values[name] = given.lower(dag, resolve)
    return values


def _quaternion(given: object, dag: Dag, resolve: Resolver) -> tuple[Node, ...]:
    """Convert roll, pitch and yaw angles, or a matrix of numbers, to a quaternion."""
    assert isinstance(given, tuple)
    if isinstance(given[0], Expression):
        return quaternion_of_angles(lower_vector(given, dag, resolve))
    quaternion = quaternion_of_matrix([[entry.number for entry in row] for row in given])
    assert quaternion is not None  # the scene has checked the rotation
    return tuple(dag.constant(entry) for entry in quaternion)


def guards_of(
    value: Node, moving: Sequence[Node], time: Node, what: str, breach: str
) -> Iterator[Guard]:
    """Raise an error if a value jumps when ``moving`` symbols change; yield parameter guards.

    ``what`` and ``breach`` are the subject and the predicate of the error message.
    """
    from cotree.dag.continuity import margins, may_jump

    if not is_timed(value, time):
        if may_jump(value, moving, time):
            raise FormulationError(f"{what} {breach}")
        return
    # A negative margin means a jump; constant margins are checked now.
    for margin in margins(time.dag, value, time):
        if margin.value is None:
            yield Guard(margin, what, False, breach)
        elif not margin.value >= 0.0:
            raise FormulationError(f"{what} {breach}")


def is_timed(value: Node, time: Node) -> bool:
    """Return whether only parameters and time determine at which points a value jumps."""
    from cotree.dag.continuity import have_time_events

    of_time = kinds_in([value]) <= {PARAMETER, TIME}
    return of_time and have_time_events(time.dag, value, [time])


_BREACH = (
    "jumps, or its rate does, which would require an impulse: give an expression of t whose "
    "value and rate are continuous, such as max(0, t)**2 instead of max(0, t)"
)


def motion_guards(edge: BoundEdge, time: Node) -> Iterator[Guard]:
    """Yield guards against jumps of prescribed motions and constraints, and of their rates."""
    if edge.component.role not in (Role.JOINT, Role.CONSTRAINT):
        return
    for name, value in edge.scalars.items():
        if edge.component.role is Role.JOINT and name != "motion":
            continue
        (rate,) = tangents([value], {time: time.dag.one})
        # A jump of the position or the speed would require an impulse.
        for node in (value,) if edge.component.name in VELOCITY_SOURCES else (value, rate):
            yield from guards_of(node, [time], time, f"{name} of edge '{edge.name}'", _BREACH)
