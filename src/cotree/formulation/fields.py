"""Fields of edges as nodes: scalars, unit vectors, inertia tensors, rotations."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

from cotree.components import Component, Field, Shape
from cotree.dag import vector
from cotree.dag.rotation import about
from cotree.dag.traverse import symbols_in
from cotree.equations import Guard
from cotree.errors import ParameterError
from cotree.scene.expressions import Expression
from cotree.scene.inertias import ROUNDING

if TYPE_CHECKING:
    from cotree.dag.nodes import Dag, Node
    from cotree.dag.vector import Matrix, Vector
    from cotree.scene.description import Edge
    from cotree.scene.expressions import FieldValue

Resolver = Callable[[str], "Node"]

#: Fields that give a direction: their length does not matter.
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


@dataclass(frozen=True)
class Resolvers:
    """Functions from names to nodes: of parameters, of time too, of coordinates and inputs too."""

    constant: Resolver
    timed: Resolver
    signal: Resolver

    def of(self, row: Field) -> Resolver:
        """Choose by what a field may depend on."""
        if row.timed:
            return self.timed
        return self.constant if row.constant else self.signal


def bind_edge(
    edge: Edge, dag: Dag, resolvers: Resolvers, at_scene: Callable[[Node], float]
) -> tuple[BoundEdge, list[Guard]]:
    """Bind the fields of an edge to nodes, with the conditions on their values.

    Parameters
    ----------
    edge : Edge
        The edge.
    dag : Dag
        The arena.
    resolvers : Resolvers
        From names to nodes, by what a field may depend on.
    at_scene : callable
        Evaluates a node of parameters at the scene's values.

    Returns
    -------
    bound : BoundEdge
        The edge with nodes as fields; axes are unit vectors.
    guards : list of Guard
        What parameter values must satisfy.

    Raises
    ------
    ParameterError
        If an axis has no direction, or a constant has the wrong sign.
    """
    expressions: dict[str, Expression] = {}
    guards: list[Guard] = []
    scalars: dict[str, Node] = {}
    vectors: dict[str, Vector] = {}
    inertia = rotation = None
    for name, value in edge.fields.items():
        row = edge.component.field(name)
        assert row is not None  # the scene accepted only fields of its component
        resolve = resolvers.of(row)
        if row.shape is Shape.EXPRESSION:
            assert isinstance(value, Expression)
            expressions[name] = value
        elif isinstance(value, Expression):
            # A message about a value that is no number names the field that it comes from.
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
                if square.value is None:  # parameters may take the direction away
                    guards.append(Guard(square, f"the squared length of {where}", is_strict=True))
                vectors[name] = _unit(vectors[name], square, where)
    if "normal" in vectors:
        # A planar joint slides along two axes that follow its normal.
        vectors["normal_x"], vectors["normal_y"] = plane_axes(vectors["normal"])
    first, second = edge.nodes or ("ground", "ground")  # none where it sits on a joint
    bound = BoundEdge(
        edge.name, edge.component, first, second, scalars, vectors, inertia, rotation, expressions
    )
    return bound, [*guards, *_guards(edge, bound, at_scene)]


def lower_vector(value: FieldValue, dag: Dag, resolve: Resolver) -> Vector:
    """Turn three expressions into nodes.

    Parameters
    ----------
    value : sequence of three Expression
        The components.
    dag : Dag
        The arena.
    resolve : callable
        From names to nodes.
    """
    x, y, z = (item.lower(dag, resolve) for item in value)  # type: ignore[union-attr]
    return (x, y, z)


def _inertia(value: FieldValue, dag: Dag, resolve: Resolver) -> Matrix:
    rows: list[Vector] = []
    for i, row in enumerate(cast("Sequence[Any]", value)):
        if isinstance(row, Expression):  # three principal values
            entries = [dag.zero] * 3
            entries[i] = row.lower(dag, resolve)
            rows.append((entries[0], entries[1], entries[2]))
        else:
            rows.append(lower_vector(row, dag, resolve))
    return (rows[0], rows[1], rows[2])


def _unit(axis: Vector, square: Node, where: str) -> Vector:
    """Scale an axis of known squared length to unit length; numbers fold."""
    if square.is_zero:
        raise ParameterError(f"{where} has no direction: give a vector that is not zero")
    # A length of one but for rounding needs no division, and axes of numbers stay as given.
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
            # The diagonal has the sign of the field; its minors limit the other entries.
            entries = (bound.inertia[i][i] for i in range(3))
            found += [
                Guard(entry, f"entry {i + 1} of {what}", is_strict)
                for i, entry in enumerate(entries)
            ]
            minors += _minors(bound.inertia, what, at_scene)
    # Constants are checked now, parameters whenever ``prepare`` gets their values.
    for guard in found:
        if guard.value.value is not None:
            guard.check(guard.value.value)
    return [guard for guard in (*found, *minors) if guard.value.value is None]


def is_varying(node: Node) -> bool:
    """Whether a value depends on more than parameters, which is all that ``prepare`` knows."""
    return any(symbol.data[0] != "p" for symbol in symbols_in([node]))


def _minors(tensor: Matrix, what: str, at_scene: Callable[[Node], float]) -> list[Guard]:
    """Ask parameters to keep what a real body's inertia satisfies: no negative minor of two rows.

    A tensor that has one at the scene's values is that of no body. It is taken all the same, with a
    warning (:mod:`cotree.scene.inertias`), and no pivot relies on it (:func:`safe_pivots`).
    """
    # Thin rods, and entries of 1e-35 beside zeros, have minors of zero but for rounding: a share of
    # the tensor's own size on its diagonal leaves room for that.
    room = ROUNDING * (tensor[0][0] + tensor[1][1] + tensor[2][2])
    found = []
    for i, j in ((0, 1), (0, 2), (1, 2)):
        if not tensor[i][j].is_zero:
            minor = (tensor[i][i] + room) * (tensor[j][j] + room) - tensor[i][j] * tensor[i][j]
            found.append(Guard(minor, f"minor of rows {i + 1} and {j + 1} of {what}", False))
    # Guards that the scene itself violates would refuse it.
    return found if all(_is_met(guard, at_scene) for guard in found) else []


def _is_met(guard: Guard, at_scene: Callable[[Node], float]) -> bool:
    number = at_scene(guard.value)
    return number >= 0.0 or not math.isfinite(number)  # where it has no value the guard says so


def rotation_matrix(value: FieldValue, dag: Dag, resolve: Resolver) -> Matrix:
    """Form the axes of the turned frame from roll, pitch and yaw, or from three rows.

    Roll, pitch and yaw turn about the fixed x, y and z axis, in this order.

    Parameters
    ----------
    value : sequence of three Expression, or of three rows of them
        The angles, [rad], or the rows of the matrix.
    dag : Dag
        The arena.
    resolve : callable
        From names to nodes.

    Returns
    -------
    Matrix
        Its columns are the axes of the turned frame.
    """
    if isinstance(cast("Sequence[Any]", value)[0], Expression):
        angles = lower_vector(value, dag, resolve)
        matrix = vector.identity(dag)
        # Fixed axes: each later rotation multiplies from the left.
        for axis, angle in zip(vector.identity(dag), angles, strict=True):
            if not angle.is_zero:
                matrix = vector.matmul(about(axis, angle).matrix, matrix)
        return matrix
    rows = [lower_vector(row, dag, resolve) for row in cast("Sequence[Any]", value)]
    return (rows[0], rows[1], rows[2])


def plane_axes(normal: Vector) -> tuple[Vector, Vector]:
    """Give two unit axes that follow a unit normal right-handedly.

    They are the next coordinate axes where the normal is one. Otherwise the first is the
    projection on the plane of the coordinate axis that follows the normal's largest entry.
    """
    dag = normal[0].dag
    # An entry of parameters has no size here; any choice is valid where it is no pole.
    sizes = [abs(entry.value) if entry.value is not None else 0.5 for entry in normal]
    start = vector.identity(dag)[(sizes.index(max(sizes)) + 1) % 3]
    # Gram-Schmidt; the start is not the axis of the largest entry, so never parallel to the normal.
    along = vector.dot(normal, start)
    first = vector.sub(start, vector.scale(along, normal))
    if not along.is_zero:
        length = dag.function("sqrt", vector.dot(first, first))
        first = (first[0] / length, first[1] / length, first[2] / length)
    return first, vector.cross(normal, first)
