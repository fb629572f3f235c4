"""Outputs: expressions of coordinates, inputs, parameters and across variables of nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.errors import ExpressionError, nearest

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.dag.nodes import Node
    from cotree.formulation.across import Motion
    from cotree.scene.expressions import Expression
    from cotree.sensitivity.across import MotionTangent

#: Across variables of a node by name: derivative order and component in ground axes.
NODE_VARIABLES = {
    **{"xyz"[i]: (0, i) for i in range(3)},
    **{"v" + "xyz"[i]: (1, i) for i in range(3)},
}


@dataclass(frozen=True)
class Outputs:
    """Output expressions over the first graph.

    Attributes
    ----------
    values : tuple of Node
        The outputs.
    across : mapping of str to Node
        The across variables of nodes that they use, by ``node.variable``.
    """

    values: tuple[Node, ...]
    across: Mapping[str, Node]


def form_outputs(motion: Motion, expressions: Mapping[str, Expression]) -> Outputs:
    """Form the outputs.

    Raises
    ------
    ExpressionError
        If an output uses a name that is unknown.
    """
    system = motion.system
    known: dict[str, Node] = {**system.parameters, **system.inputs, "t": system.time}
    for coordinate in system.coordinates:
        known[coordinate.name] = coordinate.position
        known[f"{coordinate.name}_dot"] = coordinate.speed
    across: dict[str, Node] = {}

    def resolve(name: str) -> Node:
        if name in known:
            return known[name]
        if name not in across:
            across[name] = _node_variable(motion, name, known)
        return across[name]

    with system.dag.labelled("outputs"):
        values = tuple(item.lower(system.dag, resolve) for item in expressions.values())
    return Outputs(values, across)


def _node_variable(motion: Motion, name: str, known: Mapping[str, Node]) -> Node:
    node, _, variable = name.partition(".")
    point = motion.clusters.points.get(node)
    if point is None or variable not in NODE_VARIABLES:
        if point is not None:
            raise ExpressionError(
                f"node '{node}' has no variable '{variable}'{nearest(variable, NODE_VARIABLES)}"
            )
        raise ExpressionError(f"uses the unknown name '{name}'{nearest(name, known)}")
    order, i = NODE_VARIABLES[variable]
    return (motion.position(point) if order == 0 else motion.velocity(point))[i]


def output_seed(moved: MotionTangent, outputs: Outputs) -> dict[Node, Node]:
    """Differentiate the across variables that outputs use, by the sensitivity graph."""
    seed = {}
    for name, value in outputs.across.items():
        node, _, variable = name.partition(".")
        order, i = NODE_VARIABLES[variable]
        point = moved.motion.clusters.points[node]
        seed[value] = (moved.position(point) if order == 0 else moved.velocity(point))[i]
    return seed
