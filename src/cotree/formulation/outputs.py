"""Outputs: expressions of coordinates, inputs, parameters and whatever can be observed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.dag.dual import tangent_of
from cotree.errors import ExpressionError
from cotree.naming import split_name
from cotree.scene.events import event_expressions

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.dag.nodes import Node
    from cotree.formulation.across import Motion
    from cotree.formulation.observed import Observer
    from cotree.scene.description import SceneDescription


@dataclass(frozen=True)
class Outputs:
    """Output expressions over the first graph.

    Attributes
    ----------
    values : tuple of Node
        The outputs, in terms of states and unknowns; then the expressions of the events, in the
        order of :func:`cotree.scene.events.event_expressions`.
    across : mapping of str to Node
        Positions and velocities of nodes that they use, by ``node.variable``.
    networks : mapping of str to Node
        Variables of scalar networks that they use, by name.
    jumps : mapping of str to Node
        Initial values of the modes that stand for jumps inside expressions, by name.
    """

    values: tuple[Node, ...]
    across: Mapping[str, Node]
    networks: Mapping[str, Node]
    jumps: Mapping[str, Node]


def form_outputs(observer: Observer, scene: SceneDescription) -> Outputs:
    """Form the outputs of a scene, and the expressions of its events.

    Raises
    ------
    ExpressionError
        If an output uses a name that is unknown.
    """
    motion = observer.motion
    system = motion.system
    known: dict[str, Node] = {**system.parameters, **system.inputs, "t": system.time}
    known |= system.names
    across: dict[str, Node] = {}

    known |= observer.networks
    formed: dict[str, Node] = {}
    pending: list[str] = []

    def of_output(name: str) -> Node:
        if name in pending:
            raise ExpressionError(f"uses output '{name}', which is made of itself")
        if name not in formed:
            pending.append(name)
            formed[name] = scene.outputs[name].lower(system.dag, resolve)
            pending.remove(name)
        return formed[name]

    def resolve(name: str) -> Node:
        if name not in known and name in scene.outputs:
            return of_output(name)
        if name not in known:
            # Formed once and only for names that occur: reactions and energies are expensive.
            known[name] = observer.value(name)
            # Positions and velocities have tangents from the motion of a sensitivity graph;
            # differentiating their long expressions would form all of it again.
            if _place(name) is not None and split_name(name)[0] in motion.clusters.points:
                across[name] = known[name]
        return known[name]

    with system.dag.labelled("outputs"):
        values = [of_output(name) for name in scene.outputs]
        values += [
            item.lower(system.dag, resolve) for item in event_expressions(scene.events.values())
        ]
        jumps = {
            mode.name: mode.initial.lower(system.dag, resolve)
            for mode in scene.modes.values()
            if mode.is_jump
        }
    return Outputs(tuple(values), across, observer.networks, jumps)


def _place(name: str) -> tuple[int, int] | None:
    """Give derivative order and component of a node's position or velocity."""
    variable = split_name(name)[1]
    if len(variable) == 1 and variable in "xyz":
        return 0, "xyz".index(variable)
    if len(variable) == 2 and variable[0] == "v" and variable[1] in "xyz":
        return 1, "xyz".index(variable[1])
    return None


def output_tangents(motion: Motion, outputs: Outputs) -> dict[Node, Node]:
    """Differentiate the across variables that outputs use, by a sensitivity graph's motion."""
    seed = {}
    for name, value in outputs.across.items():
        place = _place(name)
        assert place is not None  # only such are kept
        point = motion.clusters.points[split_name(name)[0]]
        order, i = place
        see = motion.velocity if order else motion.position
        seed[value] = tangent_of(see(point))[i]
    return seed
