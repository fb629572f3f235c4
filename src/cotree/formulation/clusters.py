"""Rigid clusters: nodes held together by branches with an empty motion space.

Such branches give no equation. Their across variables are constant in the cluster's frame, so
their circuit sums are formed once, of parameters only, and the inertias beyond them are lumped at
the cluster's origin. What remains between clusters are the branches that move.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.components import Role
from cotree.dag import vector
from cotree.errors import SceneError
from cotree.formulation.system import bodies
from cotree.graph import tree_walk

if TYPE_CHECKING:
    from cotree.dag.nodes import Node
    from cotree.dag.vector import Matrix, Vector
    from cotree.formulation.system import Coordinate, System


@dataclass(frozen=True)
class Point:
    """A node as a point of its cluster: position from the cluster's origin, in its axes."""

    cluster: int
    local: Vector


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
    carrier : int
        The cluster of the edge's first node, in whose axes the motion space is constant.
    anchor : Vector
        Position of the branch's inner node in the parent's axes.
    coordinates : tuple of Coordinate
        Its coordinates.
    axes : tuple of Vector
        Their axes, in the carrier's frame.
    """

    edge: str
    sign: int
    parent: int
    child: int
    carrier: int
    anchor: Vector
    coordinates: tuple[Coordinate, ...]
    axes: tuple[Vector, ...]


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
    """

    points: dict[str, Point]
    branches: tuple[Branch | None, ...]
    inertias: tuple[Inertia | None, ...]

    def path(self, cluster: int, ancestor: int = 0) -> list[Branch]:
        """List the branches from an ancestor out to a cluster."""
        found: list[Branch] = []
        while cluster != ancestor:
            branch = self.branches[cluster]
            assert branch is not None
            found.append(branch)
            cluster = branch.parent
        return found[::-1]

    def common_ancestor(self, a: int, b: int) -> int:
        """Give the outermost cluster on both paths to the ground."""
        while a != b:  # parents have smaller numbers than their children
            branch = self.branches[max(a, b)]
            assert branch is not None
            a, b = min(a, b), branch.parent
        return a


def lump(system: System) -> Clusters:
    """Group the nodes into rigid clusters and lump their inertias.

    Raises
    ------
    SceneError
        If a body does not begin at the ground, where accelerations are measured from.
    """
    dag = system.dag
    points = {"ground": Point(0, vector.zeros(dag))}
    branches: list[Branch | None] = [None]
    by_edge: dict[str, tuple[Coordinate, ...]] = {}
    for coordinate in system.coordinates:
        by_edge[coordinate.edge] = (*by_edge.get(coordinate.edge, ()), coordinate)
    for step in tree_walk(system.tree):
        edge = system.edges[step.edge]
        start = points[step.parent]
        if edge.component.role is Role.ARM:
            arm = vector.signed(step.sign, edge.vectors.get("vector", vector.zeros(dag)))
            points[step.child] = Point(start.cluster, vector.add(start.local, arm))
            continue
        for coordinate in by_edge[step.edge][:: step.sign]:
            child = len(branches)
            branches.append(
                Branch(
                    step.edge,
                    step.sign,
                    start.cluster,
                    child,
                    start.cluster if step.sign > 0 else child,
                    start.local,
                    (coordinate,),
                    (edge.vectors[coordinate.freedom.axis],),
                )
            )
            start = Point(child, vector.zeros(dag))
        points[step.child] = start
    return Clusters(points, tuple(branches), _inertias(system, points, len(branches)))


def _inertias(
    system: System, points: dict[str, Point], n_clusters: int
) -> tuple[Inertia | None, ...]:
    inertias: list[Inertia | None] = [None] * n_clusters
    for body in bodies(system):
        if body.first != "ground":
            raise SceneError(
                f"rigid body '{body.name}' begins at node '{body.first}': inertia is measured "
                f'from the ground, write nodes = ["ground", "{body.second}"]'
            )
        point = points[body.second]
        with system.dag.labelled(f"inertia of {body.name}"):
            own = shifted(body.scalars["mass"], point.local, body.inertia)
            inertias[point.cluster] = combined(inertias[point.cluster], own)
    return tuple(inertias)


def shifted(mass: Node, offset: Vector, tensor: Matrix | None) -> Inertia:
    """Move an inertia given about its centre of mass, which stands at ``offset``."""
    moment = vector.scale(mass, offset)
    steiner = _steiner(moment, offset)
    return Inertia(mass, moment, steiner if tensor is None else vector.matadd(tensor, steiner))


def _steiner(moment: Vector, offset: Vector) -> Matrix:
    """Form m (c.c 1 - c c^T) from m c and c."""
    xx, yy, zz = (moment[i] * offset[i] for i in range(3))
    xy, xz, yz = moment[0] * offset[1], moment[0] * offset[2], moment[1] * offset[2]
    return ((yy + zz, -xy, -xz), (-xy, xx + zz, -yz), (-xz, -yz, xx + yy))


def combined(a: Inertia | None, b: Inertia) -> Inertia:
    """Add two inertias about the same origin."""
    if a is None:
        return b
    return Inertia(
        a.mass + b.mass, vector.add(a.moment, b.moment), vector.matadd(a.tensor, b.tensor)
    )
