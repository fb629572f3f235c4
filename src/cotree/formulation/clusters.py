"""Rigid clusters: nodes connected by branches with an empty motion space.

Circuit sums within a cluster depend on parameters only, and the inertias of all nodes of a cluster
are lumped at its origin. Moving branches connect the clusters. The translation tree determines the
positions of cluster origins, and the rotation tree the directions of cluster axes. If the trees
differ, the origin and the axes of a cluster are determined by different branches.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cotree.components import Freedom, FreeRotation, Role
from cotree.dag import vector
from cotree.errors import FormulationError, SceneError
from cotree.graph import TreeStep, tree_walk

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.dag.nodes import Node
    from cotree.dag.vector import Matrix, Vector
    from cotree.formulation.fields import BoundEdge
    from cotree.formulation.system import Coordinate, Speed, Step, System


@dataclass(frozen=True)
class Point:
    """A node as a point of a rigid cluster."""

    cluster: int
    local: Vector  # position relative to the cluster's origin, in the cluster's frame
    turn: Matrix | None = None  # rotation from node axes to cluster axes; None if they are equal

    def resolved(self, a: Vector) -> Vector:
        """Transform a vector from node axes to cluster axes."""
        # The axes of most nodes are those of the cluster, so no product is needed.
        return a if self.turn is None else vector.times(self.turn, a)


@dataclass(frozen=True)
class Branch:
    """A branch with a motion space, from a parent cluster to its child.

    The child's origin is the branch's outer node. A joint with several degrees of freedom consists
    of several branches in series, with empty clusters between them.
    """

    edge: str  # joint to which the branch belongs
    sign: int  # +1 if the edge points away from the ground, else -1
    parent: int
    #: Cluster relative to which the child's axes rotate: the parent, unless the trees differ.
    turn_parent: int
    child: int
    #: Cluster in whose axes the motion space is constant: that of the edge's first node or, for
    #: angular velocities, that of its second node.
    carrier: int
    anchor: Vector  # position of the branch's inner node in the parent's frame
    #: Coordinates and speeds; None if the branch only combines the origin and axes of both trees.
    step: Step | None
    axes: tuple[Vector, ...]  # direction of each speed, in the axes of the carrier
    #: Translation along the axis per unit of each speed: 1; 0 for a rotation; a pitch for a screw.
    slides: tuple[Node, ...]
    #: For a free rotation: the child's axes at the identity rotation, in axes of ``turn_parent``.
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
        """Whether the branch rotates its child."""
        return self.step is not None and self.step.kind.rotates

    @property
    def position(self) -> Node:
        """The coordinate of a branch with a single axis."""
        # A free rotation has four coordinates instead; see `quaternion`.
        return self.coordinates[0].symbol

    @property
    def quaternion(self) -> tuple[Node, ...] | None:
        """The coordinates of a free rotation; None for other branches."""
        if self.step is None or isinstance(self.step.kind, Freedom):
            return None
        return tuple(c.symbol for c in self.coordinates)


@dataclass(frozen=True)
class EdgeEntry:
    """The branches that represent a tree edge between two clusters."""

    sign: int  # +1 if the edge points away from the ground, else -1
    #: Clusters of the edge's innermost and outermost branches.
    first: int
    last: int


@dataclass(frozen=True)
class Inertia:
    """Mass, first moment and second moment of a rigid cluster about its origin, in its axes."""

    mass: Node
    moment: Vector
    tensor: Matrix


@dataclass(frozen=True)
class Clusters:
    """The rigid clusters of a system: number 0 is the ground, parents precede children."""

    points: dict[str, Point]  # points of all nodes
    branches: tuple[Branch, ...]  # branch that leads to each cluster except the ground
    #: Lumped inertia of each cluster; None if it has none.
    inertias: tuple[Inertia | None, ...]
    #: For each graph: the branches of every edge with a motion space.
    entries: Mapping[str, Mapping[str, EdgeEntry]]

    def to(self, cluster: int) -> Branch:
        """Return the branch that leads to a cluster."""
        return self.branches[cluster - 1]

    def path(self, cluster: int, ancestor: int = 0) -> list[Branch]:
        """Return the branches of the translation tree on the path from an ancestor to a cluster."""
        found: list[Branch] = []
        while cluster != ancestor:
            found.append(self.to(cluster))
            cluster = found[-1].parent
        return found[::-1]

    def turning_path(self, cluster: int) -> list[Branch]:
        """Return the branches that rotate a cluster, in the order of the rotation tree."""
        found: list[Branch] = []
        while cluster:
            branch = self.to(cluster)
            if branch.turns:
                found.append(branch)
            cluster = branch.turn_parent
        return found[::-1]

    def common_ancestor(self, a: int, b: int) -> int:
        """Return the outermost cluster that is on both clusters' paths to the ground."""
        while a != b:  # parents have smaller numbers than their children
            # The cluster with the larger number cannot be the ancestor: replace it by its parent.
            a, b = min(a, b), self.to(max(a, b)).parent
        return a


def shifted(mass: Node, offset: Vector, tensor: Matrix | None) -> Inertia:
    """Move an inertia by ``offset`` from its centre of mass to a cluster's origin (Steiner)."""
    moment = vector.scale(mass, offset)
    # A particle has no inertia about its own position.
    steiner = _steiner(moment, offset)
    return Inertia(mass, moment, steiner if tensor is None else vector.matadd(tensor, steiner))


def _steiner(moment: Vector, offset: Vector) -> Matrix:
    """Return m (c.c 1 - c c^T) from the first moment m c and the offset c."""
    # Each product m c_i c_j is computed once and used in two entries.
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


def lump(system: System) -> Clusters:
    """Group the nodes into rigid clusters, from the ground outwards, and lump their inertias."""
    found = _Walks(system)
    found.walk()
    inertias = _inertias(system, found.points, len(found.branches) + 1)
    return Clusters(found.points, tuple(found.branches), inertias, found.entries)


class _Walks:
    """Simultaneous traversal of both trees from the ground outwards."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.points = {"ground": Point(0, vector.zeros(system.dag))}
        self.branches: list[Branch] = []
        self.entries: dict[str, dict[str, EdgeEntry]] = {"translation": {}, "rotation": {}}
        # Rotation tree's step to each node; rotation from node to cluster axes, None if equal.
        self._to = {step.child: step for step in tree_walk(system.trees.rotation)}
        self._turns: dict[str, Matrix | None] = {"ground": None}

    def walk(self) -> None:
        """Traverse the translation tree; a node waits until the rotation tree has reached it."""
        # Each round processes the nodes that both trees have reached. If no node is left to
        # process, the trees wait for each other, and the clusters have no order.
        rest = list(tree_walk(self.system.trees.translation))
        while rest:
            waiting = [step for step in rest if not self._is_done(step)]
            if len(waiting) == len(rest):
                raise FormulationError(self._opposite(waiting))
            rest = waiting

    def _is_done(self, step: TreeStep) -> bool:
        """Process a node of the translation tree; return False if the node must wait."""
        inner = self.points.get(step.parent)
        if inner is None:
            return False
        edge = self.system.edges[step.edge]
        if edge.component.role is Role.ARM:
            # Arms and welds are branches either of both trees or of neither.
            self.points[step.child] = self._fixed_point(edge, step, inner)
            return True
        turning = self._entering(step.child)
        if turning.parent not in self.points:
            return False
        place = self._moved(step, inner, turning)
        self.points[step.child] = replace(place, turn=self._turn(step.child))
        return True

    def _opposite(self, waiting: list[TreeStep]) -> str:
        step = next(step for step in waiting if step.parent in self.points)
        turning = self._entering(step.child)
        return (
            "the trees reach bodies in opposite orders: the rotation tree reaches node "
            f"'{step.child}' by '{turning.edge}' from node '{turning.parent}', which the "
            f"translation tree cannot reach before it: name '{step.edge}' instead of "
            f"'{turning.edge}' in the rotation tree, or another translation tree"
        )

    def _entering(self, node: str) -> TreeStep:
        """Return the step of the rotation tree that leads into the cluster of a node."""
        step = self._to[node]
        # Arms stay within a cluster; the nearest inner edge that is not an arm leads into it.
        while self.system.edges[step.edge].component.role is Role.ARM:
            step = self._to[step.parent]
        return step

    def _turn(self, node: str) -> Matrix | None:
        """Return the rotation from a node's axes to its cluster's axes, by the rotation tree."""
        # Walk inwards to a node with known axes, then compose the rotations outwards.
        unknown = []
        while node not in self._turns:
            unknown.append(self._to[node])
            node = unknown[-1].parent
        turn = self._turns[node]
        for step in reversed(unknown):
            turn = self._turned(step, turn)
            self._turns[step.child] = turn
        return turn

    def _turned(self, step: TreeStep, turn: Matrix | None) -> Matrix | None:
        edge = self.system.edges[step.edge]
        if edge.component.role is Role.ARM:
            # The rotation of an arm or weld transforms from the second node's axes to the first's.
            own = edge.rotation
            if step.sign < 0 and own is not None:
                own = vector.transpose(own)
            return _product(turn, own)
        steps = self.system.steps.get(step.edge, ())
        # After a free rotation, the axes of the outer node are those of the child cluster.
        return None if any(isinstance(own.kind, FreeRotation) for own in steps) else turn

    def _fixed_point(self, edge: BoundEdge, step: TreeStep, inner: Point) -> Point:
        arm = edge.vectors.get("vector")
        if step.sign > 0:
            # The arm is in the axes of the edge's first node, which here is the inner node.
            local = inner.local if arm is None else vector.add(inner.local, inner.resolved(arm))
            return Point(inner.cluster, local, self._turn(step.child))
        # The first node is here the outer node, whose axes are needed to resolve the arm.
        first = replace(inner, turn=self._turn(step.child))
        if arm is None:
            return first
        return replace(first, local=vector.sub(first.local, first.resolved(arm)))

    def _moved(self, step: TreeStep, inner: Point, turning: TreeStep) -> Point:
        """Build the branches that lead into a cluster, and return the cluster's origin."""
        first = len(self.branches) + 1
        if turning == step:
            place = self._along(step, inner, inner)
            # An empty motion space forms no branch.
            if place is not inner:
                entry = EdgeEntry(step.sign, first, place.cluster)
                self.entries["translation"][step.edge] = entry
                self.entries["rotation"][step.edge] = entry
            return place
        # A joint slides in the axes of its first node. If this node is in the child cluster of the
        # joint, the axes of this cluster must be determined first.
        place, turned = inner, self.points[turning.parent]
        if step.sign > 0:
            place = self._along(step, place, place)
        first_turn = len(self.branches) + 1
        if self.system.steps.get(turning.edge):
            place = self._along(turning, place, turned)
        else:
            # Without a motion space in the rotation tree, the branch only combines origin and axes.
            place = self._add(turning, None, place, turned)
        self.entries["rotation"][turning.edge] = EdgeEntry(turning.sign, first_turn, place.cluster)
        if step.sign < 0:
            place = replace(place, turn=self._turn(step.child))
            place = self._along(step, place, place)
        self.entries["translation"][step.edge] = EdgeEntry(step.sign, first, place.cluster)
        return place

    def _along(self, step: TreeStep, place: Point, turned: Point) -> Point:
        # An edge that points inwards is traversed from its second node: its last step is first.
        for own in self.system.steps.get(step.edge, ())[:: step.sign]:
            place = turned = self._add(step, own, place, turned)
        return place

    def _add(self, step: TreeStep, own: Step | None, place: Point, turned: Point) -> Point:
        """Add a branch from ``place``, which rotates about ``turned``; return its outer node."""
        edge, sign, child = self.system.edges[step.edge], step.sign, len(self.branches) + 1
        dag = self.system.dag
        zero, units = vector.zeros(dag), vector.identity(dag)
        # At zero coordinates, the axes of the child and of its node are those of ``turned``.
        inner, outer = turned.cluster, Point(child, zero, turned.turn)
        carrier = inner if sign > 0 else child
        mount: Matrix | None = None
        axes: tuple[Vector, ...] = ()
        slides: tuple[Node, ...] = ()
        if own is not None and isinstance(own.kind, Freedom):
            axis = {**dict(zip("xyz", units, strict=True)), **edge.vectors}
            slide = dag.zero if own.kind.rotates else dag.one
            # A rotation leaves its axis unchanged: its components in both clusters are equal.
            axes = (turned.resolved(axis[own.kind.axis]),)
            slides = (edge.scalars[own.kind.pitch] if own.kind.pitch else slide,)
        elif own is not None:
            # A free rotation's speeds are in axes of the second node: the child's, if outwards.
            axes = units if sign > 0 else tuple(turned.resolved(unit) for unit in units)
            slides = (dag.zero, dag.zero, dag.zero)
            carrier = child if sign > 0 else inner
            mount, outer = turned.turn, Point(child, zero)
        parent, anchor = place.cluster, place.local
        self.branches.append(
            Branch(edge.name, sign, parent, inner, child, carrier, anchor, own, axes, slides, mount)
        )
        return outer


def _product(a: Matrix | None, b: Matrix | None) -> Matrix | None:
    if a is None or b is None:
        return a if b is None else b
    return vector.matmul(a, b)


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
                # The body's tensor is in node axes, the lumped tensor in cluster axes.
                tensor = vector.congruence(point.turn, tensor)
            own = shifted(body.scalars["mass"], point.local, tensor)
            inertias[point.cluster] = combined(inertias[point.cluster], own)
    return tuple(inertias)
