"""Views for measures: across variables between clusters, in the basis of a common ancestor.

The first graph sees vectors and nodes, a sensitivity graph their duals.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from cotree.dag import vector
from cotree.formulation.circuits import Circuits, inwards, outwards

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.dag.nodes import Node
    from cotree.dag.vector import Vector
    from cotree.formulation.across import Accelerations, Motion
    from cotree.formulation.clusters import Point


@dataclass(frozen=True)
class View:
    """Across variables of a graph, at some accelerations or without any.

    Attributes
    ----------
    motion : Motion
        Positions and velocities.
    accelerations : Accelerations or None
        The accelerations.
    first : View or None
        The first graph's, where this is a sensitivity graph's.
    """

    motion: Motion
    accelerations: Accelerations | None = None
    first: View | None = None

    @property
    def across(self) -> Accelerations:
        """The accelerations."""
        assert self.accelerations is not None  # views without them are for values and rates
        return self.accelerations

    @cached_property
    def _accelerations(self) -> Circuits:
        return Circuits(
            self.motion.clusters,
            self.motion.frames,
            lambda branch: self.across.across[branch.child - 1],
            None if self.first is None else self.first._accelerations,
        )

    @cached_property
    def _rates(self) -> dict[Node, Node]:
        speeds = self.motion.system.speeds
        # Zeros in the view for the right-hand side, symbols in that for the balances.
        return {v.acceleration: rate for v, rate in zip(speeds, self.across.rates, strict=True)}

    def _inwards(self, a: Vector, cluster: int, ancestor: int) -> Vector:
        return inwards(self.motion.clusters, self.motion.frames, a, cluster, ancestor)

    def scalar(self, node: Node) -> Node:
        """Give a field, a coordinate, a speed or an acceleration as this view sees it."""
        if self.accelerations is not None:
            # The symbol of an acceleration stands for the value that this view was formed at.
            node = self._rates.get(node, node)
        return self.motion.frames.seen(node)

    def fixed(self, cluster: int, local: Vector, ancestor: int) -> Vector:
        """See a vector of a cluster's axes that is constant there, but for explicit time.

        Parameters
        ----------
        cluster : int
            The cluster that carries it.
        local : Vector
            Its components, in the cluster's axes.
        ancestor : int
            The cluster in whose basis it is seen.
        """
        return self._inwards(self.motion.frames.resolved(cluster, local), cluster, ancestor)

    def position(self, point: Point, ancestor: int) -> Vector:
        """See the vector from an ancestor's origin to a point."""
        return self.motion.position(point, ancestor)

    def velocity(self, point: Point, ancestor: int) -> Vector:
        """See a point's velocity less that of an ancestor's origin."""
        return self.motion.velocity(point, ancestor)

    def acceleration(self, point: Point, ancestor: int) -> Vector:
        """See a point's acceleration less that of an ancestor's origin."""
        zero = vector.zeros(self.motion.system.dag)
        # Gravity enters at the ground's origin only; a sum from an ancestor on is free of it.
        own = vector.times(self.across.matrix[point.cluster], self.motion.arm(point))
        own = self._inwards(own, point.cluster, ancestor)
        return vector.add(self._accelerations.between(ancestor, point.cluster, zero), own)

    def omega(self, cluster: int, ancestor: int) -> Vector:
        """See an angular velocity."""
        return self._inwards(self.motion.omega[cluster], cluster, ancestor)

    def alpha(self, cluster: int, ancestor: int) -> Vector:
        """See an angular acceleration."""
        return self._inwards(self.across.alpha[cluster], cluster, ancestor)

    def formula(self, node: Node, arguments: Mapping[Node, Node]) -> Node:
        """Put values in the place of a formula's arguments."""
        return self.motion.frames.formula(node, arguments)

    def settled(self, a: Vector, ancestor: int, cluster: int) -> Vector:
        """Resolve a vector of an ancestor's basis in a cluster's.

        Parameters
        ----------
        a : Vector
            The vector.
        ancestor, cluster : int
            The bases before and after.
        """
        # Pulls are formed once, in the basis of the ancestor, for both clusters.
        return outwards(self.motion.clusters, self.motion.frames, a, ancestor, cluster)
