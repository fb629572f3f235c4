"""Rigid clusters: nodes held together by branches with an empty motion space.

Such branches give no equation. Their across variables are constant in the cluster's frame, so
their circuit sums are formed once, of parameters only, and the inertias beyond them are lumped at
the cluster's origin. What remains between clusters are the branches that move; where the trees of
translation and rotation differ, a cluster's origin and its axes are reached from different ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.components import Freedom
from cotree.dag import vector

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.dag.nodes import Node
    from cotree.dag.vector import Matrix, Vector
    from cotree.formulation.system import Coordinate, Speed, Step


@dataclass(frozen=True)
class Point:
    """A node as a point of its cluster.

    Attributes
    ----------
    cluster : int
        The cluster.
    local : Vector
        Position from the cluster's origin, in its axes.
    turn : Matrix or None
        The node's own axes in the cluster's; None where they are the same.
    """

    cluster: int
    local: Vector
    turn: Matrix | None = None

    def resolved(self, a: Vector) -> Vector:
        """Resolve a vector of the node's axes in the cluster's."""
        # Most nodes have the axes of their cluster, for which no product is formed.
        return a if self.turn is None else vector.times(self.turn, a)


@dataclass(frozen=True)
class Branch:
    """A branch with a motion space, from a cluster to the one it carries.

    A joint whose freedoms follow one another is several branches, with clusters between them that
    carry nothing.

    Attributes
    ----------
    edge : str
        The joint.
    sign : int
        +1 if the edge points away from the ground, else -1.
    parent, child : int
        The clusters. The child's origin is the branch's outer node.
    turn_parent : int
        The cluster that the child's axes are turned from: the parent, unless the trees differ.
    carrier : int
        The cluster in whose axes the motion space is constant: that of the edge's first node, of
        the second for angular velocities.
    anchor : Vector
        Position of the branch's inner node in the parent's axes.
    step : Step or None
        Its coordinates and speeds; None where it only brings together the child's origin and axes.
    axes : tuple of Vector
        The direction of each speed, in the carrier's frame.
    slides : tuple of Node
        How far a unit of each speed moves along its axis: one for a translation, zero for a
        rotation, the pitch of a screw.
    mount : Matrix or None
        Of a free rotation: the axes that it starts from, in the turn parent's.
    """

    edge: str
    sign: int
    parent: int
    turn_parent: int
    child: int
    carrier: int
    anchor: Vector
    step: Step | None
    axes: tuple[Vector, ...]
    slides: tuple[Node, ...]
    mount: Matrix | None = None

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The coordinates along the motion space."""
        return () if self.step is None else self.step.coordinates

    @property
    def speeds(self) -> tuple[Speed, ...]:
        """The speeds along the motion space."""
        return () if self.step is None else self.step.speeds

    @property
    def turns(self) -> bool:
        """Tell whether it rotates its child."""
        return self.step is not None and self.step.kind.rotates

    @property
    def position(self) -> Node:
        """The only coordinate of a branch along one axis."""
        # A free rotation has four coordinates, which `quaternion` gives.
        return self.coordinates[0].symbol

    @property
    def quaternion(self) -> tuple[Node, ...] | None:
        """The coordinates of a free rotation."""
        if self.step is None or isinstance(self.step.kind, Freedom):
            return None
        return tuple(c.symbol for c in self.coordinates)


@dataclass(frozen=True)
class EdgeEntry:
    """The branches by which an edge leads a tree from one cluster to another.

    Attributes
    ----------
    sign : int
        +1 if the edge points away from the ground, else -1.
    first, last : int
        The clusters that the innermost and the outermost of its branches carry.
    """

    sign: int
    first: int
    last: int


@dataclass(frozen=True)
class Inertia:
    """Mass, first moment and second moment about the origin of a rigid cluster, in its axes."""

    mass: Node
    moment: Vector
    tensor: Matrix


@dataclass(frozen=True)
class Clusters:
    """The rigid clusters of a system; number 0 is the ground, parents come before children.

    Attributes
    ----------
    points : mapping of str to Point
        Every node.
    branches : tuple of Branch or None
        The branch that carries each cluster; None for the ground.
    inertias : tuple of Inertia or None
        The lumped inertia of each cluster; None where there is none.
    entries : mapping of str to mapping of str to EdgeEntry
        For each graph, the branches that belong to every edge with a motion space.
    """

    points: dict[str, Point]
    branches: tuple[Branch | None, ...]
    inertias: tuple[Inertia | None, ...]
    entries: Mapping[str, Mapping[str, EdgeEntry]]

    def path(self, cluster: int, ancestor: int = 0) -> list[Branch]:
        """List the branches of the translation tree from an ancestor out to a cluster."""
        found: list[Branch] = []
        while cluster != ancestor:
            branch = self.branches[cluster]
            assert branch is not None
            found.append(branch)
            cluster = branch.parent
        return found[::-1]

    def turning_path(self, cluster: int) -> list[Branch]:
        """List the branches of the rotation tree that turn a cluster, from the ground out."""
        found: list[Branch] = []
        while cluster:
            branch = self.branches[cluster]
            assert branch is not None
            # Branches that only slide leave the axes as they are.
            if branch.turns:
                found.append(branch)
            cluster = branch.turn_parent
        return found[::-1]

    def common_ancestor(self, a: int, b: int) -> int:
        """Give the outermost cluster on both paths to the ground."""
        while a != b:  # parents have smaller numbers than their children
            branch = self.branches[max(a, b)]
            assert branch is not None
            # The cluster of the larger number cannot lead to the other, so that it is the one to
            # step inwards.
            a, b = min(a, b), branch.parent
        return a


def shifted(mass: Node, offset: Vector, tensor: Matrix | None) -> Inertia:
    """Move an inertia from its centre of mass to a cluster's origin (Steiner).

    Parameters
    ----------
    mass : Node
        The mass, [kg].
    offset : Vector
        The centre of mass from the origin, [m].
    tensor : Matrix or None
        Inertia about the centre of mass, [kg m^2]; None of a particle.
    """
    moment = vector.scale(mass, offset)
    # A particle has no inertia about its own centre, but has one about the origin.
    steiner = _steiner(moment, offset)
    return Inertia(mass, moment, steiner if tensor is None else vector.matadd(tensor, steiner))


def _steiner(moment: Vector, offset: Vector) -> Matrix:
    """Form m (c.c 1 - c c^T) from m c and c."""
    # Each product m c_i c_j is formed once, and stands in two entries of the tensor.
    xx, yy, zz = (moment[i] * offset[i] for i in range(3))
    xy, xz, yz = moment[0] * offset[1], moment[0] * offset[2], moment[1] * offset[2]
    return ((yy + zz, -xy, -xz), (-xy, xx + zz, -yz), (-xz, -yz, xx + yy))


def combined(a: Inertia | None, b: Inertia) -> Inertia:
    """Add two inertias about the same origin."""
    if a is None:
        return b
    # Mass and both moments refer to one origin and one set of axes, so that they simply add.
    return Inertia(
        a.mass + b.mass, vector.add(a.moment, b.moment), vector.matadd(a.tensor, b.tensor)
    )
