"""Sensitivity terminal equations of the force elements (paper, Eq. (4)).

Each is the pre-formed derivative of the element's law, times the derivatives of its across
variables and fields.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.components import Role
from cotree.components.law import chain
from cotree.dag import vector
from cotree.formulation.circuits import inwards
from cotree.formulation.elements import Wrench, axis_spin, settled

if TYPE_CHECKING:
    from cotree.dag.nodes import Node
    from cotree.dag.vector import Vector
    from cotree.formulation.clusters import Point
    from cotree.formulation.elements import Action
    from cotree.sensitivity.across import MotionTangent


def wrench_tangents(moved: MotionTangent, action: Action) -> list[tuple[int, Wrench]]:
    """Differentiate the wrenches of an element on the clusters of its nodes."""
    if not _is_reached(moved, action):
        return []
    motion, ancestor = moved.motion, action.ancestor
    clusters, frames = motion.clusters, motion.frames
    d_reach = vector.sub(
        moved.position(action.second, ancestor), moved.position(action.first, ancestor)
    )
    d_force, d_torque = _through_tangent(moved, action, d_reach)
    d_arms = [
        inwards(clusters, frames, moved.arm(point), point.cluster, ancestor)
        for point in (action.first, action.second)
    ]
    reaction_arm, d_reaction_arm = action.arms[0], d_arms[0]
    if not action.is_central:
        reaction_arm = vector.add(reaction_arm, action.reach)
        d_reaction_arm = vector.add(d_reaction_arm, d_reach)
    found = []
    for point, sign, arm, d_arm in (
        (action.second, 1, action.arms[1], d_arms[1]),
        (action.first, -1, reaction_arm, d_reaction_arm),
    ):
        if point.cluster == 0:
            continue
        torque = vector.add(vector.cross(d_arm, action.force), vector.cross(arm, d_force))
        torque = vector.add(torque, d_torque)
        found.append((point.cluster, settled(motion, point, ancestor, sign, d_force, torque)))
    return found


def _is_reached(moved: MotionTangent, action: Action) -> bool:
    """Whether the seed reaches a node or a field of the element."""
    if any(moved.phi[point.cluster] is not None for point in (action.first, action.second)):
        return True
    edge, seed = action.edge, moved.seed
    if any(not seed.of(value).is_zero for value in edge.scalars.values()):
        return True
    fields = (*edge.vectors.values(), action.first.local, action.second.local)
    return not all(vector.is_zero(seed.vector(value)) for value in fields)


def _through_tangent(
    moved: MotionTangent, action: Action, d_reach: Vector
) -> tuple[Vector, Vector]:
    """Differentiate the force and the torque on the second node."""
    edge = action.edge
    if edge.component.role is Role.FORCE:
        return _carried(moved, action.first, edge.vectors["force"], action.ancestor), moved.zero
    if edge.component.role is Role.TORQUE:
        return moved.zero, _carried(moved, action.first, edge.vectors["torque"], action.ancestor)
    assert action.direction is not None
    assert action.magnitude is not None
    d_direction, d_arguments = _line_tangents(moved, action, d_reach)
    d_magnitude = chain(action.partials, d_arguments, moved.seed.dag.zero)
    d_force = vector.add(
        vector.scale(d_magnitude, action.direction), vector.scale(action.magnitude, d_direction)
    )
    return d_force, moved.zero


def _carried(moved: MotionTangent, point: Point, local: Vector, ancestor: int) -> Vector:
    """Differentiate a vector given in a node's axes, in the basis of an ancestor."""
    motion = moved.motion
    own = moved.carried(point.cluster, point.resolved(local))
    return inwards(motion.clusters, motion.frames, own, point.cluster, ancestor)


def _line_tangents(
    moved: MotionTangent, action: Action, d_reach: Vector
) -> tuple[Vector, dict[str, Node]]:
    """Differentiate the direction and the arguments of a scalar law."""
    direction, reach, ancestor = action.direction, action.reach, action.ancestor
    assert direction is not None
    if action.is_central:
        length = action.arguments["length"]
        d_length = vector.dot(direction, d_reach)
        across = vector.sub(d_reach, vector.scale(d_length, direction))
        d_direction = vector.scale(1.0 / length, across)
    else:
        d_direction = _carried(moved, action.first, action.edge.vectors["axis"], ancestor)
        d_length = vector.dot(d_direction, reach) + vector.dot(direction, d_reach)
    d_rate = moved.seed.dag.zero
    if action.closing is not None:
        d_closing = vector.sub(
            moved.velocity(action.second, ancestor), moved.velocity(action.first, ancestor)
        )
        d_rate = vector.dot(d_direction, action.closing) + vector.dot(direction, d_closing)
        if not action.is_central:
            d_rate = d_rate + _spin_tangent(moved, action, d_direction, d_reach)
    scalars = action.edge.scalars
    d_fields = {name: moved.seed.of(scalars[name]) for name in action.partials if name in scalars}
    return d_direction, {**d_fields, "length": d_length, "rate": d_rate}


def _spin_tangent(
    moved: MotionTangent, action: Action, d_direction: Vector, d_reach: Vector
) -> Node:
    """Differentiate (omega x axis) . reach, the part of the rate that the axis' turning makes."""
    motion, first, ancestor = moved.motion, action.first, action.ancestor
    assert action.direction is not None
    turn = axis_spin(motion, first, ancestor, action.direction)
    omega = inwards(
        motion.clusters, motion.frames, motion.omega[first.cluster], first.cluster, ancestor
    )
    d_omega = inwards(
        motion.clusters, motion.frames, moved.omega_of(first.cluster), first.cluster, ancestor
    )
    d_turn = vector.add(vector.cross(d_omega, action.direction), vector.cross(omega, d_direction))
    return vector.dot(d_turn, action.reach) + vector.dot(turn, d_reach)
