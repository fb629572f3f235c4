"""Initial values of coordinates and speeds as nodes of parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.dag.rotation import quaternion_of_angles, quaternion_of_matrix
from cotree.errors import SceneError, nearest
from cotree.formulation.fields import lower_vector
from cotree.scene.expressions import Expression

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.components import MotionStep
    from cotree.dag.nodes import Dag, Node
    from cotree.formulation.fields import Resolver
    from cotree.scene.description import Edge


def initial_values(
    edge: Edge,
    space: Sequence[MotionStep],
    dag: Dag,
    resolve: Resolver,
    start: Mapping[str, Node],
) -> dict[str, Node]:
    """Bind the initial values of a branch; what the scene does not give is ``start``, or zero.

    Parameters
    ----------
    edge : Edge
        The branch.
    space : sequence of MotionStep
        Its motion space.
    dag : Dag
        The arena.
    resolve : callable
        From names of parameters to nodes.
    start : mapping of str to Node
        Values where the scene gives none, by short names of coordinates and rates.

    Returns
    -------
    dict of str to Node
        By the short names of coordinates and rates.

    Raises
    ------
    SceneError
        If the scene gives a value that the branch has no coordinate for.
    """
    values = {name: dag.zero for kind in space for name, _ in (*kind.coordinates, *kind.rates)}
    # Without a rotation the quaternion is one, not zero.
    if "q0" in values:
        values["q0"] = dag.one
    # What the scene says itself, below, has the last word.
    values |= start
    for name, given in edge.initial.items():
        if name == "rotation" and "q0" in values:
            turned = _quaternion(given, dag, resolve)
            values |= {f"q{i}": node for i, node in enumerate(turned)}
        elif name not in values:
            raise SceneError(
                f"edge '{edge.name}' moves along {', '.join(values) or 'nothing'} in this scene, "
                f"so it has no initial '{name}'{nearest(name, values)}"
            )
        else:
            # All but rotations are single expressions; the scene has checked their shape.
            assert isinstance(given, Expression)
            values[name] = given.lower(dag, resolve)
    return values


def _quaternion(given: object, dag: Dag, resolve: Resolver) -> tuple[Node, ...]:
    """Turn roll, pitch and yaw, or a matrix of numbers, into a quaternion."""
    assert isinstance(given, tuple)
    if isinstance(given[0], Expression):
        return quaternion_of_angles(lower_vector(given, dag, resolve))
    quaternion = quaternion_of_matrix([[entry.number for entry in row] for row in given])
    assert quaternion is not None  # checked when the scene was made
    return tuple(dag.constant(entry) for entry in quaternion)
