"""Tests whether the steps of a formulation can be written, naming the edge that prevents it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.components import Freedom, Role, Shape
from cotree.scene.expressions import Expression

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from cotree.components import MotionStep
    from cotree.formulation.first_graph import FirstGraph
    from cotree.graph import Tree
    from cotree.scene.description import Edge, SceneDescription

_AXES = frozenset({"axis", "x", "y", "z"})


def edge_beyond(
    scene: SceneDescription,
    spaces: Mapping[str, Sequence[MotionStep]],
    branches: Collection[str],
) -> str | None:
    """Name the first edge whose terminal equations cannot be written, and say why.

    Parameters
    ----------
    scene : SceneDescription
        The scene.
    spaces : mapping of str to sequence of MotionStep
        The motion space of each edge.
    branches : collection of str
        The edges in a tree.
    """
    for edge in scene.edges.values():
        reason = _reason(edge, spaces[edge.name], edge.name in branches)
        if reason:
            return f"{edge.component.name} '{edge.name}' {reason}"
    return None


def _reason(edge: Edge, space: Sequence[MotionStep], is_branch: bool) -> str | None:
    """Say which property of an edge the terminal equations of the steps cannot express."""
    role = edge.component.role
    if role is Role.CONSTRAINT and not edge.component.domains:
        return "couples coordinates outside the graphs, so that what it exerts is not in (1)"
    if role is Role.CONSTRAINT:
        return "holds its nodes by a force of unknown size, its multiplier"
    if any(
        row.shape is Shape.ROTATION and row.name in edge.fields for row in edge.component.fields
    ):
        return "turns the axes of its second node"
    if "motion" in edge.fields:
        return "has a prescribed motion"
    is_moving = role is Role.JOINT or (role is Role.BODY and is_branch)
    if is_moving and not all(_is_written(step) for step in space):
        return "has a motion space of more than one axis, or a screw's"
    if role is Role.JOINT and not is_branch and any(s.rotates for s in space) and _has_law(edge):
        return "closes a loop and has a spring, damper or drive about its axis"
    return None


def _is_written(step: MotionStep) -> bool:
    return isinstance(step, Freedom) and step.axis in _AXES and not step.pitch


def _has_law(edge: Edge) -> bool:
    """Whether a joint's own law can exert anything."""
    if edge.component.law is None:
        return False
    values = [edge.fields.get(name) for name in ("stiffness", "damping", "torque")]
    return any(isinstance(value, Expression) and value.number != 0.0 for value in values)


def chord_beyond(trees: Mapping[str, Tree], first: FirstGraph | None) -> str | None:
    """Say why a scene whose terminal equations are written has no projections to show."""
    first_tree, *others = trees.values()
    if any(set(tree.branches) != set(first_tree.branches) for tree in others):
        return (
            "translation and rotation have different trees, and the projections are written for "
            "branches of both; name the same edges for both, or leave the tree to cotree"
        )
    if first is None:
        return "no equations could be formed in the coordinates of this tree"
    if not first.constraints.rows:
        return None
    edge = first.scene.edges[first.constraints.rows[0].edge]
    return (
        f"{edge.component.name} '{edge.name}' closes a loop, so that the projections hold forces "
        "of unknown size, its multipliers"
    )
