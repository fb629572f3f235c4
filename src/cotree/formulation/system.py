"""A scene whose symbols, coordinates and fields are expression nodes of one program."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING

from cotree.components import FreeRotation, Role
from cotree.dag.evaluate import evaluate
from cotree.dag.multi_output import table
from cotree.dag.nodes import INPUT, PARAMETER, STATE, TIME, UNKNOWN
from cotree.equations import State
from cotree.formulation.fields import (
    FieldNames,
    Resolver,
    bind_edge,
    initial_values,
    lower_vector,
    motion_guards,
    resolver_of,
)
from cotree.scene.expressions import Expression
from cotree.scene.graphs import Trees, motion_spaces
from cotree.scene.parameters import parameter_nodes, parameter_values

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from cotree.components import Field, MotionStep
    from cotree.dag.nodes import Dag, Node
    from cotree.dag.vector import Vector
    from cotree.equations import Guard
    from cotree.formulation.fields import BoundEdge
    from cotree.scene.description import SceneDescription
    from cotree.scene.parameters import Parameter


# Advice in error messages if a prescribed motion depends on states or inputs.
_DRIVEN = (
    "the equations contain its time derivatives; write an expression of t, or a torque or force "
    "that follows the value, such as torque = 'c*(w - hinge.theta_dot)' of a joint"
)


@dataclass(frozen=True)
class Coordinate:
    """A generalised coordinate of a branch."""

    #: Name of the coordinate, ``edge.coordinate``, and its unit.
    name: str
    unit: str
    symbol: Node  # symbol of the coordinate in the program
    initial: Node  # initial value as a function of parameters


@dataclass(frozen=True)
class Speed:
    """A generalised speed along one direction of a branch's motion space."""

    #: Name of the speed, usually ``edge.coordinate_dot``, and its unit.
    name: str
    unit: str
    index: int  # index among the speeds
    edge: str  # name of the branch
    #: Coordinate whose rate is the speed; None for angular velocities.
    coordinate: Coordinate | None
    #: Symbols of the speed and of its rate in the program.
    symbol: Node
    acceleration: Node
    initial: Node  # initial value as a function of parameters


@dataclass(frozen=True)
class Step:
    """One step of a branch's motion space, with its coordinates and speeds."""

    edge: str
    kind: MotionStep
    coordinates: tuple[Coordinate, ...]
    speeds: tuple[Speed, ...]


@dataclass(frozen=True)
class System:
    """A scene whose symbols and fields are nodes of one program."""

    dag: Dag  # arena of all nodes
    time: Node  # symbol of time in the program
    #: Symbols of the parameters that a run may change, by name: arguments of the program.
    tunable: Mapping[str, Node]
    #: Nodes of all parameters, and symbols of the inputs, by name. Parameters that are not tunable
    #: are numbers; derived parameters are expressions of other parameters.
    parameters: Mapping[str, Node]
    inputs: Mapping[str, Node]
    #: Quantities that change only at events. They are states without a rate and follow the speeds.
    modes: tuple[State, ...]
    #: Motion space of each branch that has one, in the order of the scene's edges. If an edge is a
    #: branch of only one tree, these are its translations only or its rotations only.
    steps: Mapping[str, tuple[Step, ...]]
    plane: str  # normal of the plane of motion: ``x``, ``y`` or ``z``; empty for spatial motion
    edges: Mapping[str, BoundEdge]  # bound edges by name
    gravity: Vector  # gravitational acceleration in the ground frame, [m/s^2]
    trees: Trees  # spanning trees of the translation graph and of the rotation graph
    guards: tuple[Guard, ...]  # conditions that parameter values must satisfy
    at_scene: Callable[[Node], float]  # evaluates a node with the scene's parameter values
    input_values: tuple[Node, ...]  # the scene's inputs as functions of time and parameters
    of_parameters: Resolver  # function from a parameter's name to its node
    signals: FieldNames  # function from any name that a field may use to its node

    @cached_property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """All coordinates."""
        return tuple(c for steps in self.steps.values() for step in steps for c in step.coordinates)

    @cached_property
    def speeds(self) -> tuple[Speed, ...]:
        """All speeds; their rates are the unknown accelerations."""
        return tuple(v for steps in self.steps.values() for step in steps for v in step.speeds)

    @cached_property
    def names(self) -> dict[str, Node]:
        """Symbols of coordinates, speeds and modes by name."""
        coordinates = {row.name: row.symbol for row in self.coordinates}
        speeds = {row.name: row.symbol for row in self.speeds}
        return coordinates | speeds | {row.name: row.symbol for row in self.modes}

    @property
    def bodies(self) -> list[BoundEdge]:
        """The edges that carry inertia."""
        return [edge for edge in self.edges.values() if edge.component.role is Role.BODY]


def bind(
    scene: SceneDescription,
    trees: Trees,
    dag: Dag,
    starts: Mapping[str, Mapping[str, Node]] | None = None,
    is_start: bool = False,
    names: Collection[str] = (),
) -> System:
    """Bind a scene to nodes of an arena.

    ``starts`` contains default initial values of branches; ``names`` contains the nodes and edges
    of the scalar networks. With ``is_start``, initial values replace coordinates and speeds. Raise
    ExpressionError if a name is unknown or not allowed, ParameterError if an axis has no direction.
    """
    time = dag.symbol(TIME, 0)
    tunable, parameters = _parameters(scene, dag)
    values = parameter_values(scene.parameters)
    at_scene = partial(_at, {symbol: values[name] for name, symbol in tunable.items()})
    inputs = {name: dag.symbol(INPUT, i) for i, name in enumerate(scene.inputs)}
    # Three scopes of names: parameters only; parameters and time; all variables.
    of_modes = dict.fromkeys(
        scene.modes, "let an output depend on modes, and use the output in the field"
    )
    of_parameters = resolver_of([parameters], "parameters", of_modes)
    of_time = resolver_of([parameters, {"t": time}], "parameters and t", of_modes)
    spaces = motion_spaces(scene)
    with dag.labelled("initial values"):
        steps = _steps(scene, trees, spaces.of, dag, of_parameters, starts or {})
    if is_start:
        steps = {name: tuple(_at_start(step) for step in own) for name, own in steps.items()}
    kept = [step for own in steps.values() for step in own]
    # State vector: all coordinates, then all speeds, then modes.
    states = {c.name: c.symbol for step in kept for c in step.coordinates}
    states |= {v.name: v.symbol for step in kept for v in step.speeds}
    # Modes are numbered after coordinates and speeds, but before the states of the networks.
    modes = _modes(scene, dag, len(states), of_parameters)
    states |= {mode.name: mode.symbol for mode in modes}
    everything = {**parameters, "t": time, **inputs, **states}
    signals = FieldNames(scene, dag, everything, names)
    held = resolver_of(
        [parameters, {"t": time}],
        "parameters and t",
        of_modes | dict.fromkeys((*scene.inputs, *scene.outputs), _DRIVEN),
        _DRIVEN,
    )

    def names_of(row: Field) -> Resolver:
        if row.timed:
            return held
        return of_parameters if row.constant else signals.node

    edges: dict[str, BoundEdge] = {}
    guards: list[Guard] = []
    for edge in scene.edges.values():
        with dag.labelled(f"parameters of {edge.name}"):
            edges[edge.name], own = bind_edge(edge, dag, names_of, at_scene)
            # The equations contain two derivatives of a prescribed motion, which must not jump.
            guards += [*own, *motion_guards(edges[edge.name], time)]
    return System(
        dag=dag,
        time=time,
        tunable=tunable,
        parameters=parameters,
        inputs=inputs,
        modes=modes,
        steps=steps,
        plane=spaces.plane,
        edges=edges,
        gravity=lower_vector(scene.gravity, dag, of_parameters),
        trees=trees,
        guards=tuple(guards),
        at_scene=at_scene,
        input_values=tuple(
            # An input from a table is piecewise linear in time; all other inputs are expressions.
            row.value.lower(dag, of_time)
            if isinstance(row.value, Expression)
            else table(dag, row.value, time)[0]
            for row in scene.inputs.values()
        ),
        of_parameters=of_parameters,
        signals=signals,
    )


def _parameters(scene: SceneDescription, dag: Dag) -> tuple[dict[str, Node], dict[str, Node]]:
    names = [name for name, row in scene.parameters.items() if row.is_argument]
    tunable = {name: dag.symbol(PARAMETER, i) for i, name in enumerate(names)}

    def number(row: Parameter) -> Node:
        # Parameters that are not tunable are numbers and are folded into expressions.
        return tunable[row.name] if row.is_argument else dag.constant(row.number)

    return tunable, parameter_nodes(scene.parameters, dag, number)


def _at_start(step: Step) -> Step:
    coordinates = tuple(replace(c, symbol=c.initial) for c in step.coordinates)
    # A freedom has one coordinate; speeds of a free rotation have no coordinate.
    own = coordinates[0]
    return replace(
        step,
        coordinates=coordinates,
        speeds=tuple(
            replace(v, symbol=v.initial, coordinate=v.coordinate and own) for v in step.speeds
        ),
    )


def _modes(
    scene: SceneDescription, dag: Dag, n_before: int, resolve: Resolver
) -> tuple[State, ...]:
    """Create a state with a symbol for every mode, numbered after coordinates and speeds."""
    return tuple(
        State(
            mode.name,
            "",
            dag.symbol(STATE, n_before + i),
            # The mode of a jump follows from the initial states; see ``first_graph.started``.
            dag.zero if mode.is_jump else mode.initial.lower(dag, resolve),
        )
        for i, mode in enumerate(scene.modes.values())
    )


def _at(values: Mapping[Node, float], node: Node) -> float:
    return float(evaluate([node], values)[0])


def _steps(
    scene: SceneDescription,
    trees: Trees,
    spaces: Mapping[str, tuple[MotionStep, ...]],
    dag: Dag,
    resolve: Resolver,
    starts: Mapping[str, Mapping[str, Node]],
) -> dict[str, tuple[Step, ...]]:
    """Create the numbered coordinates and speeds of all branches, with their initial values."""
    # If the trees differ, an edge has coordinates only in the trees in which it is a branch.
    kept = {
        name: [kind for kind in spaces[name] if trees.is_branch(name, kind.rotates)]
        for name in scene.edges
    }
    moving = [edge for edge in scene.edges.values() if kept[edge.name]]
    n_coordinates = sum(len(kind.coordinates) for kinds in kept.values() for kind in kinds)
    found: dict[str, tuple[Step, ...]] = {}
    i = j = 0
    for edge in moving:
        start = starts.get(edge.name, {})
        # Use the whole motion space, so that initial values of the chord's part are accepted, too.
        initial = initial_values(edge, spaces[edge.name], dag, resolve, start)
        own = []
        for kind in kept[edge.name]:
            coordinates = []
            for name, unit in kind.coordinates:
                symbol = dag.symbol(STATE, i)
                coordinates.append(Coordinate(f"{edge.name}.{name}", unit, symbol, initial[name]))
                i += 1
            speeds = []
            for name, unit in kind.rates:
                of = None if isinstance(kind, FreeRotation) else coordinates[0]
                # i counts coordinates and j counts speeds; the counts differ after free rotations.
                symbol = dag.symbol(STATE, n_coordinates + j)
                full, w = f"{edge.name}.{name}", dag.symbol(UNKNOWN, j)
                speeds.append(Speed(full, unit, j, edge.name, of, symbol, w, initial[name]))
                j += 1
            own.append(Step(edge.name, kind, tuple(coordinates), tuple(speeds)))
        found[edge.name] = tuple(own)
    return found
