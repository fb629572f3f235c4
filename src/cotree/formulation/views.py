"""Views for measures: across variables between clusters, in the basis of a common ancestor.

The first graph gives nodes; a sensitivity graph (:mod:`cotree.sensitivity.views`) gives duals, so
that each formula is written once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

from cotree.dag import vector
from cotree.dag.traverse import substitute
from cotree.formulation.circuits import Circuits, inwards, outwards

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.dag.nodes import Node
    from cotree.dag.vector import Vector
    from cotree.formulation.across import Accelerations, Motion
    from cotree.formulation.clusters import Point


class View(Protocol):
    """Across variables as nodes, or as duals of a sensitivity graph."""

    @property
    def motion(self) -> Motion:
        """The first graph's positions and velocities."""
        ...

    def scalar(self, node: Node) -> Any:
        """See a field, a coordinate, a speed or an acceleration."""
        ...

    def fixed(self, cluster: int, local: Vector, ancestor: int) -> Any:
        """See a vector of a cluster's axes that is constant there, but for explicit time."""
        ...

    def position(self, point: Point, ancestor: int) -> Any:
        """See the vector from an ancestor's origin to a point."""
        ...

    def velocity(self, point: Point, ancestor: int) -> Any:
        """See a point's velocity less that of an ancestor's origin."""
        ...

    def acceleration(self, point: Point, ancestor: int) -> Any:
        """See a point's acceleration less that of an ancestor's origin."""
        ...

    def omega(self, cluster: int, ancestor: int) -> Any:
        """See an angular velocity."""
        ...

    def alpha(self, cluster: int, ancestor: int) -> Any:
        """See an angular acceleration."""
        ...

    def formula(self, node: Node, arguments: Mapping[Node, Any]) -> Any:
        """Put values in the place of a formula's arguments."""
        ...

    def constant(self, a: Vector) -> Any:
        """See a vector of numbers that nothing moves."""
        ...

    def settled(self, a: Any, ancestor: int, cluster: int) -> Any:
        """Resolve a vector of an ancestor's basis in a cluster's."""
        ...


@dataclass(frozen=True)
class FirstView:
    """The first graph's across variables, at some accelerations or without any."""

    motion: Motion
    accelerations: Accelerations | None = None

    @property
    def across(self) -> Accelerations:
        """The accelerations."""
        assert self.accelerations is not None  # nobody asks a view without any
        return self.accelerations

    @cached_property
    def _accelerations(self) -> Circuits:
        return Circuits(
            self.motion.clusters,
            self.motion.frames,
            lambda branch: self.across.across[branch.child - 1],
        )

    @cached_property
    def _rates(self) -> dict[Node, Node]:
        speeds = self.motion.system.speeds
        return {v.acceleration: rate for v, rate in zip(speeds, self.across.rates, strict=True)}

    def _inwards(self, a: Vector, cluster: int, ancestor: int) -> Vector:
        return inwards(self.motion.clusters, self.motion.frames, a, cluster, ancestor)

    def scalar(self, node: Node) -> Node:
        """See a scalar; accelerations are those of this view."""
        return node if self.accelerations is None else self._rates.get(node, node)

    def fixed(self, cluster: int, local: Vector, ancestor: int) -> Vector:
        """See a vector of a cluster's axes."""
        return self._inwards(self.motion.frames.resolved(cluster, local), cluster, ancestor)

    def position(self, point: Point, ancestor: int) -> Vector:
        """See a position."""
        return self.motion.position(point, ancestor)

    def velocity(self, point: Point, ancestor: int) -> Vector:
        """See a velocity."""
        return self.motion.velocity(point, ancestor)

    def acceleration(self, point: Point, ancestor: int) -> Vector:
        """See an acceleration."""
        zero = vector.zeros(self.motion.system.dag)
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
        """Substitute."""
        return substitute([node], arguments)[0]

    def constant(self, a: Vector) -> Vector:
        """See a constant vector."""
        return a

    def settled(self, a: Vector, ancestor: int, cluster: int) -> Vector:
        """Resolve in a cluster's basis."""
        return outwards(self.motion.clusters, self.motion.frames, a, ancestor, cluster)
