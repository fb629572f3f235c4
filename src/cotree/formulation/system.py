"""A scene bound to nodes: every symbol, coordinate and field as a value of one program.

In: a scene and the tree of its joints. Out: a :class:`System`, which the walks of
:mod:`cotree.formulation` and :mod:`cotree.sensitivity` read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

from cotree.components import Component, Freedom, Role
from cotree.dag import vector
from cotree.dag.several import Table, table
from cotree.equations import Guard
from cotree.errors import ExpressionError, ParameterError, nearest
from cotree.scene.expressions import Expression, parse

if TYPE_CHECKING:
    from cotree.dag.nodes import Dag, Node
    from cotree.dag.vector import Matrix, Vector
    from cotree.graph import Tree
    from cotree.scene.description import Edge, FieldValue, SceneDescription

Resolver = Callable[[str], "Node"]


@dataclass(frozen=True)
class Coordinate:
    """A generalized coordinate: one direction of a tree joint's motion space.

    Attributes
    ----------
    name : str
        ``edge.coordinate``.
    index : int
        Its place among the coordinates.
    edge : str
        The joint.
    freedom : Freedom
        The direction.
    position, speed, acceleration : Node
        Symbols of the coordinate, its rate and the rate of that.
    initial_position, initial_speed : Node
        Initial values, of parameters only.
    """

    name: str
    index: int
    edge: str
    freedom: Freedom
    position: Node
    speed: Node
    acceleration: Node
    initial_position: Node
    initial_speed: Node


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


@dataclass(frozen=True)
class System:
    """A scene bound to nodes.

    Attributes
    ----------
    dag : Dag
        The arena of all its values.
    time : Node
        The symbol of time.
    parameters, inputs : mapping of str to Node
        Symbols (or numbers, for parameters that are not tunable) by name.
    coordinates : tuple of Coordinate
        In the order of the scene's edges.
    edges : mapping of str to BoundEdge
        The bound edges.
    gravity : Vector
        Acceleration of free fall, in ground axes.
    tree : Tree
        The branches.
    guards : tuple of Guard
        What parameter values must satisfy.
    input_values : tuple of Node
        The scene's own value of every input, of time and parameters.
    """

    dag: Dag
    time: Node
    parameters: Mapping[str, Node]
    inputs: Mapping[str, Node]
    coordinates: tuple[Coordinate, ...]
    edges: Mapping[str, BoundEdge]
    gravity: Vector
    tree: Tree
    guards: tuple[Guard, ...]
    input_values: tuple[Node, ...]


def bind(scene: SceneDescription, tree: Tree, dag: Dag) -> System:
    """Bind a scene to nodes.

    Parameters
    ----------
    scene : SceneDescription
        The scene.
    tree : Tree
        The tree of its joints.
    dag : Dag
        The arena to make the nodes in.

    Raises
    ------
    ExpressionError
        If an expression uses a name that is unknown, or not allowed where it stands.
    ParameterError
        If an axis has no direction.
    """
    time = dag.symbol("t", 0)
    tunable = [name for name, parameter in scene.parameters.items() if parameter.tunable]
    parameters = {
        name: dag.symbol("p", tunable.index(name)) if row.tunable else dag.constant(row.value)
        for name, row in scene.parameters.items()
    }
    inputs = {name: dag.symbol("u", i) for i, name in enumerate(scene.inputs)}
    of_parameters = _resolver([parameters], "parameters")
    of_time = _resolver([parameters, {"t": time}], "parameters and t")
    with dag.labelled("initial values"):
        coordinates = _coordinates(scene, tree, dag, of_parameters)
    states = {c.name: c.position for c in coordinates}
    states |= {f"{c.name}_dot": c.speed for c in coordinates}
    of_everything = _resolver([parameters, {"t": time}, inputs, states], "")
    edges: dict[str, BoundEdge] = {}
    guards: list[Guard] = []
    for edge in scene.edges.values():
        with dag.labelled(f"parameters of {edge.name}"):
            edges[edge.name], own = _bind_edge(edge, dag, of_parameters, of_everything)
            guards += own
    return System(
        dag=dag,
        time=time,
        parameters=parameters,
        inputs=inputs,
        coordinates=coordinates,
        edges=edges,
        gravity=_lower_vector(scene.gravity, dag, of_parameters),
        tree=tree,
        guards=tuple(guards),
        input_values=tuple(
            table(dag, row.value, time)[0]
            if isinstance(row.value, Table)
            else row.value.lower(dag, of_time)
            for row in scene.inputs.values()
        ),
    )


def _resolver(known: Sequence[Mapping[str, Node]], allowed: str) -> Resolver:
    """Make the function that gives the node of a name; ``allowed`` says what may be used."""
    by_name = {name: node for mapping in known for name, node in mapping.items()}

    def resolve(name: str) -> Node:
        if name in by_name:
            return by_name[name]
        if allowed and (name == "t" or "." in name):
            raise ExpressionError(f"uses '{name}', but may depend on {allowed} only")
        raise ExpressionError(f"uses the unknown name '{name}'{nearest(name, by_name)}")

    return resolve


def _coordinates(
    scene: SceneDescription, tree: Tree, dag: Dag, resolve: Resolver
) -> tuple[Coordinate, ...]:
    branches = set(tree.branches)
    rows = [
        (edge, freedom)
        for edge in scene.edges.values()
        if edge.name in branches
        for freedom in edge.component.motion_space
    ]
    zero = parse(0.0, "initial value")
    return tuple(
        Coordinate(
            f"{edge.name}.{freedom.name}",
            i,
            edge.name,
            freedom,
            dag.symbol("x", i),
            dag.symbol("x", len(rows) + i),
            dag.symbol("w", i),
            edge.initial.get(freedom.name, zero).lower(dag, resolve),
            edge.initial.get(f"{freedom.name}_dot", zero).lower(dag, resolve),
        )
        for i, (edge, freedom) in enumerate(rows)
    )


def _bind_edge(
    edge: Edge, dag: Dag, constant: Resolver, signal: Resolver
) -> tuple[BoundEdge, list[Guard]]:
    """Bind the fields of an edge, and say what their values must satisfy."""
    guards: list[Guard] = []
    scalars: dict[str, Node] = {}
    vectors: dict[str, Vector] = {}
    inertia = None
    axes = {freedom.axis for freedom in edge.component.motion_space} | {"axis"}
    for name, value in edge.fields.items():
        row = edge.component.field(name)
        assert row is not None  # the scene accepted only fields of its component
        resolve = constant if row.constant else signal
        if isinstance(value, Expression):
            scalars[name] = value.lower(dag, resolve)
        elif name == "inertia":
            inertia = _inertia(value, dag, resolve)
        else:
            vectors[name] = _lower_vector(value, dag, resolve)
            if name in axes:
                where = f"{name} of edge '{edge.name}'"
                square = vector.dot(vectors[name], vectors[name])
                if square.value is None:  # parameters may take the direction away
                    guards.append(Guard(square, f"the squared length of {where}", is_strict=True))
                vectors[name] = _unit(vectors[name], square, where)
    bound = BoundEdge(edge.name, edge.component, *edge.nodes, scalars, vectors, inertia)
    return bound, [*guards, *_guards(edge, bound)]


def _lower_vector(value: FieldValue, dag: Dag, resolve: Resolver) -> Vector:
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
            rows.append(_lower_vector(row, dag, resolve))
    return (rows[0], rows[1], rows[2])


def _unit(axis: Vector, square: Node, where: str) -> Vector:
    """Scale an axis of known squared length to unit length; numbers fold."""
    if square.is_zero:
        raise ParameterError(f"{where} has no direction: give a vector that is not zero")
    if square.value is not None and math.isclose(square.value, 1.0, rel_tol=1e-15):
        return axis
    length = square.dag.function("sqrt", square)
    return (axis[0] / length, axis[1] / length, axis[2] / length)


def _guards(edge: Edge, bound: BoundEdge) -> list[Guard]:
    found = []
    for row in edge.component.fields:
        what, is_strict = f"{row.name} of edge '{edge.name}'", row.sign == "positive"
        if row.sign and row.name in bound.scalars:
            found.append(Guard(bound.scalars[row.name], what, is_strict))
        elif row.sign and row.name == "inertia" and bound.inertia is not None:
            found += _inertia_guards(bound.inertia, what, is_strict)
    for guard in found:
        if guard.value.value is not None:
            guard.check(guard.value.value)
    return [guard for guard in found if guard.value.value is None]


def _inertia_guards(tensor: Matrix, what: str, is_strict: bool) -> list[Guard]:
    """Ask for what a real body's inertia satisfies: its diagonal, and its minors of two rows."""
    found = [Guard(tensor[i][i], f"entry {i + 1} of {what}", is_strict) for i in range(3)]
    for i, j in ((0, 1), (0, 2), (1, 2)):
        if not tensor[i][j].is_zero:
            # A thin rod makes this zero; the factor leaves room for its rounding.
            minor = (1.0 + 1e-12) * (tensor[i][i] * tensor[j][j]) - tensor[i][j] * tensor[i][j]
            found.append(Guard(minor, f"minor of rows {i + 1} and {j + 1} of {what}", False))
    return found


def bodies(system: System) -> list[BoundEdge]:
    """List the edges that carry inertia."""
    return [edge for edge in system.edges.values() if edge.component.role is Role.BODY]
