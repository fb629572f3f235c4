"""Terminal equations of force elements, whose laws determine their through variables.

All vectors of an element are in the basis of the nearest common ancestor of its nodes, so that only
the circuit between the nodes is summed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from cotree.components import Role
from cotree.dag import vector
from cotree.errors import ParameterError
from cotree.formulation.across import inwards, outwards

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.dag.nodes import Node
    from cotree.dag.vector import Vector
    from cotree.formulation.across import Motion
    from cotree.formulation.clusters import Point
    from cotree.formulation.fields import BoundEdge


@dataclass(frozen=True)
class Wrench:
    """A torque, and a force at a cluster's origin, in the cluster's basis."""

    force: Vector
    torque: Vector

    def plus(self, other: Wrench) -> Wrench:
        """Return the sum of this wrench and another one at the same origin."""
        return Wrench(vector.add(self.force, other.force), vector.add(self.torque, other.torque))

    def minus(self) -> Wrench:
        """Return the opposite wrench."""
        return Wrench(vector.neg(self.force), vector.neg(self.torque))


class Sums:
    """Sums of wrenches on clusters or, in a sensitivity graph, of derivatives of wrenches."""

    def __init__(self, n_clusters: int) -> None:
        self._on_cluster: list[Wrench | None] = [None] * n_clusters

    def gather(self, cluster: int, wrench: Wrench) -> None:
        """Add a wrench to a cluster's sum."""
        known = self._on_cluster[cluster]
        self._on_cluster[cluster] = wrench if known is None else known.plus(wrench)

    def at(self, cluster: int) -> Wrench | None:
        """Return the sum on a cluster, or None if there is no wrench."""
        return self._on_cluster[cluster]

    def takes(self, cluster: int, *parts: Any) -> bool:
        """Return whether a wrench with the components ``parts`` must be added to a sum."""
        return True


@dataclass(frozen=True)
class Action:
    """Force and torque of an element on its second node; the first node receives the reaction."""

    edge: BoundEdge  # edge of the force element
    #: End points of the element.
    first: Point
    second: Point
    ancestor: int  # cluster in whose basis all vectors are resolved
    arms: tuple[Vector, Vector]  # vectors from the clusters' origins to the two nodes
    reach: Vector  # vector from the first node to the second
    arguments: Mapping[str, Node]  # arguments of the element's scalar law
    #: Force on the second node.
    force: Vector
    torque: Vector
    is_central: bool = False  # whether the force acts along the line between the nodes


def actions(motion: Motion) -> list[Action]:
    """Form the terminal equations of all force elements."""
    found = []
    for edge in motion.system.edges.values():
        if edge.component.role in (Role.LINE, Role.FORCE, Role.TORQUE):
            with motion.system.dag.labelled(f"terminal equation of {edge.name}"):
                found.append(act(motion, edge))
    return found


def act(motion: Motion, edge: BoundEdge) -> Action:
    """Form the terminal equation of a force element."""
    clusters, frames = motion.clusters, motion.frames
    first, second = clusters.points[edge.first], clusters.points[edge.second]
    # The ancestor moves both nodes equally, so its motion cancels in their circuit.
    ancestor = clusters.common_ancestor(first.cluster, second.cluster)
    zero = vector.zeros(motion.system.dag)
    arms = (
        inwards(clusters, frames, motion.arm(first), first.cluster, ancestor),
        inwards(clusters, frames, motion.arm(second), second.cluster, ancestor),
    )
    reach = vector.sub(motion.position(second, ancestor), motion.position(first, ancestor))
    still = Action(edge, first, second, ancestor, arms, reach, {}, zero, zero)
    if edge.component.role is Role.LINE:
        return _line(motion, still)
    if edge.component.role is Role.FORCE:
        return replace(still, force=carried(motion, first, edge.vectors["force"], ancestor))
    return replace(still, torque=carried(motion, first, edge.vectors["torque"], ancestor))


def carried(motion: Motion, point: Point, local: Vector, ancestor: int) -> Vector:
    """Transform a vector from node axes to the basis of an ancestor."""
    own = motion.frames.resolved(point.cluster, point.resolved(local))
    return inwards(motion.clusters, motion.frames, own, point.cluster, ancestor)


def _line(motion: Motion, still: Action) -> Action:
    """Add the force of a scalar law along an axis, or along the line between the nodes."""
    edge, first, ancestor, reach = still.edge, still.first, still.ancestor, still.reach
    law = edge.component.law
    assert law is not None
    is_central = "axis" not in edge.vectors
    dag = motion.system.dag
    if is_central:
        if vector.is_zero(reach):
            raise ParameterError(
                f"the nodes of edge '{edge.name}' coincide for all coordinates, so the line "
                "between them has no direction: give the edge an axis"
            )
        length, direction = vector.polar(
            reach, f"length of edge '{edge.name}', whose nodes must lie apart"
        )
    else:
        direction = carried(motion, first, edge.vectors["axis"], ancestor)
        length = vector.dot(direction, reach)
    seen = {name: motion.frames.seen(node) for name, node in edge.scalars.items()}
    arguments = {**seen, "length": length, "rate": dag.zero}
    # The rate requires velocities: compute it only if the law depends on it.
    if "rate" in law.arguments and not edge.scalars.get("damping", dag.one).is_zero:
        velocity = motion.velocity(still.second, ancestor)
        closing = vector.sub(velocity, motion.velocity(first, ancestor))
        # (e.r)' = e.r' + e'.r; along the line between the nodes, e' is perpendicular to r.
        arguments["rate"] = vector.dot(direction, closing)
        if not is_central:
            omega, cluster = motion.omega[first.cluster], first.cluster
            omega = inwards(motion.clusters, motion.frames, omega, cluster, ancestor)
            turn = vector.cross(omega, direction)
            arguments["rate"] = arguments["rate"] + vector.dot(turn, reach)
    force = vector.scale(law.value(dag, arguments), direction)
    return replace(still, arguments=arguments, force=force, is_central=is_central)


def wrenches(motion: Motion, action: Action) -> list[tuple[int, Wrench]]:
    """Return the wrenches of an element on its nodes' clusters, except on the ground."""
    found, clusters, frames = [], motion.clusters, motion.frames
    # Force and reaction act at the same point, so together they have no moment.
    reaction_arm = action.arms[0]
    if not action.is_central:
        # A central force passes through both nodes. A force along an axis may miss the first node.
        reaction_arm = vector.add(reaction_arm, action.reach)
    moved = ((action.second, 1, action.arms[1]), (action.first, -1, reaction_arm))
    for point, sign, arm in moved:
        # Loads on the ground have no effect.
        if point.cluster == 0:
            continue
        # Wrenches of a cluster are summed at its origin: add the moment of the arm.
        torque = vector.add(vector.cross(arm, action.force), action.torque)
        # The wrench is in the ancestor's basis: transform it for each node.
        force, torque = (
            outwards(clusters, frames, vector.signed(sign, part), action.ancestor, point.cluster)
            for part in (action.force, torque)
        )
        found.append((point.cluster, Wrench(force, torque)))
    return found
