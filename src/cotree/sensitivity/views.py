"""Across variables of a sensitivity graph beside those of the first, as duals."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from cotree.dag import vector
from cotree.dag.derivative import tangents
from cotree.dag.dual import Dual, paired
from cotree.dag.traverse import substitute
from cotree.formulation.circuits import Circuits, inwards, outwards

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.dag.nodes import Node
    from cotree.dag.vector import Vector
    from cotree.formulation.across import Motion
    from cotree.formulation.clusters import Branch, Point
    from cotree.formulation.views import FirstView
    from cotree.sensitivity.across import AccelerationTangent, MotionTangent


@dataclass(frozen=True)
class TangentView:
    """Duals of the first graph's across variables, accelerations of the branches held fixed."""

    first: FirstView
    moved: MotionTangent
    across: AccelerationTangent

    @property
    def motion(self) -> Motion:
        """The first graph."""
        return self.first.motion

    @cached_property
    def _accelerations(self) -> Circuits:
        return Circuits(self.motion.clusters, self.motion.frames, self._branch_acceleration)

    def _branch_acceleration(self, branch: Branch) -> Vector:
        """Differentiate the acceleration across a branch; its parent may move it alone."""
        return self.across.across[branch.child - 1] or self.moved.zero

    def _inwards(self, a: Vector, cluster: int, ancestor: int) -> Vector:
        return inwards(self.motion.clusters, self.motion.frames, a, cluster, ancestor)

    def scalar(self, node: Node) -> Dual:
        """See a scalar."""
        return Dual(self.first.scalar(node), self.moved.seed.of(node))

    def fixed(self, cluster: int, local: Vector, ancestor: int) -> Any:
        """See a vector of a cluster's axes."""
        d = self._inwards(self.moved.carried(cluster, local), cluster, ancestor)
        return paired(self.first.fixed(cluster, local, ancestor), d)

    def position(self, point: Point, ancestor: int) -> Any:
        """See a position."""
        return paired(self.first.position(point, ancestor), self.moved.position(point, ancestor))

    def velocity(self, point: Point, ancestor: int) -> Any:
        """See a velocity."""
        return paired(self.first.velocity(point, ancestor), self.moved.velocity(point, ancestor))

    def acceleration(self, point: Point, ancestor: int) -> Any:
        """See an acceleration."""
        cluster = point.cluster
        own = vector.times(self.first.across.matrix[cluster], self.moved.arm(point))
        d_matrix = self.across.matrix[cluster]
        if d_matrix is not None:
            own = vector.add(own, vector.times(d_matrix, self.motion.arm(point)))
        own = self._inwards(own, cluster, ancestor)
        d = vector.add(self._accelerations.between(ancestor, cluster, self.moved.zero), own)
        return paired(self.first.acceleration(point, ancestor), d)

    def omega(self, cluster: int, ancestor: int) -> Any:
        """See an angular velocity."""
        d = self._inwards(self.moved.omega_of(cluster), cluster, ancestor)
        return paired(self.first.omega(cluster, ancestor), d)

    def alpha(self, cluster: int, ancestor: int) -> Any:
        """See an angular acceleration."""
        d = self._inwards(self.across.alpha[cluster] or self.moved.zero, cluster, ancestor)
        return paired(self.first.alpha(cluster, ancestor), d)

    def formula(self, node: Node, arguments: Mapping[Node, Dual]) -> Dual:
        """Substitute, and differentiate by the arguments and by the seed itself."""
        seed = {**self.moved.seed.symbols, **{key: dual.d for key, dual in arguments.items()}}
        d = tangents([node], seed)[0]
        values = {key: dual.value for key, dual in arguments.items()}
        value, slope = substitute([node, d], values)
        return Dual(value, slope)

    def constant(self, a: Vector) -> Any:
        """See a constant vector."""
        return paired(a, self.moved.zero)

    def settled(self, a: Any, ancestor: int, cluster: int) -> Any:
        """Resolve in a cluster's basis: values and derivatives alike."""
        clusters, frames = self.motion.clusters, self.motion.frames
        x, y, z = a
        values = outwards(clusters, frames, (x.value, y.value, z.value), ancestor, cluster)
        return paired(values, outwards(clusters, frames, (x.d, y.d, z.d), ancestor, cluster))
