"""Initial states: absolute coordinates from forward kinematics, and conditions on chords.

The initial states of bodies in the tree are across variables along the tree of joints, evaluated at
the initial coordinates of the joints. The consistent start must also satisfy the initial values of
coordinates that are not states.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.components import Freedom, Role
from cotree.dag import vector
from cotree.dag.evaluate import evaluate
from cotree.dag.vector import quaternion_of_nodes
from cotree.errors import SceneError
from cotree.formulation.across import View, move
from cotree.formulation.chords import chord_measure, node_angle
from cotree.formulation.clusters import lump
from cotree.formulation.constraints import along_speeds
from cotree.formulation.frames import choose_frames
from cotree.formulation.system import bind
from cotree.scene.expressions import Expression
from cotree.scene.graphs import Trees, joint_branches, motion_spaces

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.components import MotionStep
    from cotree.dag.nodes import Dag, Node
    from cotree.formulation.across import Motion
    from cotree.formulation.measures import Measure
    from cotree.formulation.system import System
    from cotree.scene.description import SceneDescription

#: Names of the initial values of a free rotation.
_TURN = ("rotation", "q0", "q1", "q2", "q3")


def body_starts(
    scene: SceneDescription, trees: Trees, spaces: Mapping[str, Sequence[MotionStep]], dag: Dag
) -> dict[str, dict[str, Node]]:
    """Return the initial states, by short names, of all bodies in the tree that joints reach."""
    # Bodies in the tree have absolute coordinates, whose initial values may be absent.
    placed = [name for name in trees.branches if scene.edges[name].component.role is Role.BODY]
    if not placed:
        return {}
    # In the tree of joints, a body that is still a branch is not reached by joints.
    reference = joint_branches(scene)
    placed = [name for name in placed if name not in reference.branches]
    if not placed:
        return {}
    # Run the formulation's traversals with initial values instead of coordinates.
    system = bind(scene, reference, dag, is_start=True)
    clusters = lump(system)
    motion = move(system, clusters, choose_frames(system, clusters, ()))
    values = {symbol: scene.parameters[name].number for name, symbol in system.tunable.items()}
    return {name: _start(motion, name, spaces[name], values) for name in placed}


def _start(
    motion: Motion, body: str, space: Sequence[MotionStep], values: Mapping[Node, float]
) -> dict[str, Node]:
    """Return the initial state of a body's node along the body's motion space."""
    frames = motion.frames
    point = motion.clusters.points[motion.system.edges[body].second]
    position, velocity = motion.position(point), motion.velocity(point)
    omega = motion.omega[point.cluster]
    found: dict[str, Node] = {}
    for step in space:
        (name, _), (rate, _) = step.coordinates[0], step.rates[0]
        if isinstance(step, Freedom):
            i = "xyz".index(step.axis)
            if step.rotates:
                found[name], found[rate] = node_angle(motion, point, step.axis), omega[i]
            else:
                found[name], found[rate] = position[i], velocity[i]
            continue
        axes = frames.rotations[point.cluster].matrix
        if point.turn is not None:
            axes = vector.matmul(axes, point.turn)
        # Numeric values determine the largest entry; the results remain functions of parameters.
        quaternion = quaternion_of_nodes(axes, lambda n: float(evaluate([n], values)[0]))
        found |= {name: node for (name, _), node in zip(step.coordinates, quaternion, strict=True)}
        # The speeds of a free rotation are in axes of the body's node.
        own = vector.transposed_times(axes, omega)
        found |= {name: node for (name, _), node in zip(step.rates, own, strict=True)}
    return found


@dataclass(frozen=True)
class StartValue:
    """Initial value of a coordinate or rate that is no state, with derivatives along the speeds."""

    name: str
    unit: str
    measure: Measure
    is_rate: bool
    given: Node
    gradient: tuple[Node, ...]


def start_conditions(scene: SceneDescription, motion: Motion, view: View) -> tuple[StartValue, ...]:
    """Return the scene's initial values for chords, which are joints and bodies."""
    system = motion.system
    given = [
        (edge, name, value)
        for edge in scene.edges.values()
        for name, value in edge.initial.items()
        if not _is_state(system, edge.name, name)
    ]
    if not given:
        return ()
    placing, spaces = joint_branches(scene).branches, motion_spaces(scene).of
    found = []
    for edge, name, value in given:
        if name in _TURN and edge.name in placing:
            continue  # the joints' initial values determine the positions of bodies
        # Chords have the same coordinates as branches.
        steps = spaces[edge.name]
        measure = chord_measure(motion, system.edges[edge.name], name, steps)
        if measure is None or name in _TURN or not isinstance(value, Expression):
            raise SceneError(
                f"initial {name} of edge '{edge.name}' cannot be used: the edge is a chord of "
                f"the tree ({system.trees.listed()}); give initial values of branches, or "
                "name a tree that contains it"
            )
        rates = {n: unit for step in steps for n, unit in step.rates}
        units = {n: unit for step in steps for n, unit in step.coordinates} | rates
        # Newton's method needs the derivatives of the measure with respect to the speeds.
        gradient = tuple(along_speeds(motion, measure.pull(view)))
        node = value.lower(system.dag, system.of_parameters)
        own = f"{edge.name}.{name}"
        found.append(StartValue(own, units[name], measure, name in rates, node, gradient))
    return tuple(found)


def given_names(scene: SceneDescription) -> tuple[str, ...]:
    """Return the states with an initial value in the scene, in the scene's order."""
    found: list[str] = []
    for edge in scene.edges.values():
        for name in edge.initial:
            own = [f"q{i}" for i in range(4)] if name == "rotation" else [name]
            found += [f"{edge.name}.{short}" for short in own]
    return tuple(found)


def _is_state(system: System, edge: str, name: str) -> bool:
    """Return whether an initial value belongs to a state, or to the four states of a rotation."""
    # The field of a rotation sets all four entries of the quaternion.
    state = "q0" if name == "rotation" else name
    return f"{edge}.{state}" in system.names
