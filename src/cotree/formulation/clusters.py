"""Rigid clusters: nodes held together by branches with an empty motion space.

Such branches give no equation. Their across variables are constant in the cluster's frame, so
their circuit sums are formed once, of parameters only, and the inertias beyond them are lumped at
the cluster's origin. What remains between clusters are the branches that move.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.components import Freedom, Role
from cotree.dag import vector
from cotree.errors import SceneError
from cotree.graph import tree_walk

if TYPE_CHECKING:
    from cotree.dag.nodes import Node
    from cotree.dag.vector import Matrix, Vector
    from cotree.formulation.fields import BoundEdge
    from cotree.formulation.system import Speed, Step, System


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
    carrier : int
        The cluster in whose axes the motion space is constant: that of the edge's first node, of
        the second for angular velocities.
    anchor : Vector
        Position of the branch's inner node in the parent's axes.
    step : Step
        Its coordinates and speeds.
    axes : tuple of Vector
        The direction of each speed, in the carrier's frame.
    slides : tuple of Node
        How far a unit of each speed moves along its axis: one for a translation, zero for a
        rotation, the pitch of a screw.
    mount : Matrix or None
        Of a free rotation: the axes that it starts from, in the parent's.
    """

    edge: str
    sign: int
    parent: int
    child: int
    carrier: int
    anchor: Vector
    step: Step
    axes: tuple[Vector, ...]
    slides: tuple[Node, ...]
    mount: Matrix | None = None

    @property
    def speeds(self) -> tuple[Speed, ...]:
        """The speeds along the motion space."""
        return self.step.speeds

    @property
    def turns(self) -> bool:
        """Whether it rotates its child."""
        return self.step.kind.rotates

    @property
    def position(self) -> Node:
        """The only coordinate of a branch along one axis."""
        return self.step.coordinates[0].symbol

    @property
    def quaternion(self) -> tuple[Node, ...] | None:
        """The coordinates of a free rotation."""
        if isinstance(self.step.kind, Freedom):
            return None
        return tuple(c.symbol for c in self.step.coordinates)


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
    for step in tree_walk(system.tree):
        edge = system.edges[step.edge]
        start = points[step.parent]
        if edge.component.role is Role.ARM:
            points[step.child] = _fixed_point(edge, step.sign, start)
            continue
        for own in system.steps.get(step.edge, ())[:: step.sign]:
            branch, start = _moving(edge, own, step.sign, start, len(branches))
            branches.append(branch)
        points[step.child] = start
    return Clusters(points, tuple(branches), _inertias(system, points, len(branches)))


def _fixed_point(edge: BoundEdge, sign: int, start: Point) -> Point:
    """Place the other node of an arm or a weld."""
    arm = edge.vectors.get("vector")
    if sign > 0:
        local = start.local if arm is None else vector.add(start.local, start.resolved(arm))
        return Point(start.cluster, local, _product(start.turn, edge.rotation))
    turned = None if edge.rotation is None else vector.transpose(edge.rotation)
    first = Point(start.cluster, start.local, _product(start.turn, turned))
    local = start.local if arm is None else vector.sub(start.local, first.resolved(arm))
    return Point(start.cluster, local, first.turn)


def _product(a: Matrix | None, b: Matrix | None) -> Matrix | None:
    if a is None or b is None:
        return a if b is None else b
    return vector.matmul(a, b)


def _moving(
    edge: BoundEdge, own: Step, sign: int, start: Point, child: int
) -> tuple[Branch, Point]:
    """Make one branch of a joint, and its outer node."""
    dag = own.speeds[0].symbol.dag
    zero, units = vector.zeros(dag), vector.identity(dag)
    inner, outer = start.cluster, Point(child, zero, start.turn)
    if isinstance(own.kind, Freedom):
        axis = {**dict(zip("xyz", units, strict=True)), **edge.vectors}
        slide = dag.zero if own.kind.rotates else dag.one
        branch = Branch(
            edge.name,
            sign,
            inner,
            child,
            inner if sign > 0 else child,
            start.local,
            own,
            (start.resolved(axis[own.kind.axis]),),
            (edge.scalars[own.kind.pitch] if own.kind.pitch else slide,),
        )
        return branch, outer
    # The outer node's axes become the child's.
    axes = units if sign > 0 else tuple(start.resolved(unit) for unit in units)
    carrier = child if sign > 0 else inner
    branch = Branch(
        edge.name,
        sign,
        inner,
        child,
        carrier,
        start.local,
        own,
        axes,
        (dag.zero, dag.zero, dag.zero),
        start.turn,
    )
    return branch, Point(child, zero)


def _inertias(
    system: System, points: dict[str, Point], n_clusters: int
) -> tuple[Inertia | None, ...]:
    inertias: list[Inertia | None] = [None] * n_clusters
    for body in system.bodies:
        if body.first != "ground":
            raise SceneError(
                f"rigid body '{body.name}' begins at node '{body.first}': inertia is measured "
                f'from the ground, write nodes = ["ground", "{body.second}"]'
            )
        point = points[body.second]
        with system.dag.labelled(f"inertia of {body.name}"):
            tensor = body.inertia
            if tensor is not None and point.turn is not None:
                tensor = vector.congruence(point.turn, tensor)
            own = shifted(body.scalars["mass"], point.local, tensor)
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
