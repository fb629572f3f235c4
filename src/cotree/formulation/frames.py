"""Axes in which each cluster's vectors are resolved, and the geometry of the moving branches.

A cluster's vectors are resolved in its parent's axes or in its own. Ground axes throughout suit
planar chains, in which rotation angles add; own axes suit spatial arms, whose inertias are then
constant. Both give the same values; :mod:`cotree.choice` counts their costs. If the trees differ, a
cluster has two parents, and ground axes are used.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.dag import vector
from cotree.dag.nodes import substitute
from cotree.dag.vector import Rotation, no_rotation, of_quaternion

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from cotree.dag.nodes import Node
    from cotree.dag.vector import Matrix, Vector
    from cotree.formulation.clusters import Branch, Clusters
    from cotree.formulation.system import System


@dataclass(frozen=True)
class Frames:
    """Axes of the clusters, and the values resolved in them.

    The first graph uses plain values. In a sensitivity graph the axes rotate with the seed, and
    values are duals (:class:`cotree.sensitivity.turning.Turning`).
    """

    #: Rotation from each cluster's axes to its basis, in which its vectors are resolved.
    rotations: tuple[Rotation, ...]
    #: Rotation from each cluster's basis to its parent's; None if they are equal.
    steps: tuple[Matrix | None, ...]

    def is_kept(self, cluster: int) -> bool:
        """Return whether a cluster moves as in the first graph, so that values can be reused."""
        return False

    @property
    def turned(self) -> frozenset[int]:
        """The clusters whose bases rotate along the seed; none in the first graph."""
        return frozenset()

    def up(self, cluster: int, a: Vector) -> Vector:
        """Resolve a vector of a cluster's basis in its parent's."""
        step = self.steps[cluster]
        return a if step is None else vector.times(step, a)

    def down(self, cluster: int, a: Vector) -> Vector:
        """Resolve a vector of the parent's basis in the cluster's own."""
        step = self.steps[cluster]
        # Steps are rotations, whose inverse is the transpose.
        return a if step is None else vector.transposed_times(step, a)

    def resolved(self, cluster: int, local: Vector) -> Vector:
        """Resolve a vector field of the cluster's axes in its basis."""
        return vector.times(self.rotations[cluster].matrix, local)

    def constant(self, cluster: int, a: Vector) -> Vector:
        """Return a vector whose components in the cluster's basis are constant."""
        return a

    def tensor(self, cluster: int, local: Matrix) -> Matrix:
        """Resolve a symmetric tensor field of the cluster's axes in its basis."""
        return vector.congruence(self.rotations[cluster].matrix, local)

    def carried(self, branch: Branch, local: Vector) -> Vector:
        """Resolve a vector field of a branch's carrier in the basis of the branch's parent."""
        return vector.times(self.carrier_axes(branch), local)

    def carrier_axes(self, branch: Branch) -> Matrix:
        """Return the axes of a branch's carrier, resolved in the parent's basis."""
        if branch.carrier != branch.child:
            return self.rotations[branch.carrier].matrix
        # From the child's axes to its basis, then to that of its parent.
        step = self.steps[branch.child]
        own = self.rotations[branch.child].matrix
        return own if step is None else vector.matmul(step, own)

    def seen(self, node: Node) -> Node:
        """Return a field, coordinate or speed in this graph; the value itself in the first one."""
        return node

    def formula(self, node: Node, arguments: Mapping[Node, Node]) -> Node:
        """Substitute values for a formula's arguments."""
        return substitute([node], arguments)[0]

    def within(self, cluster: int, form: Callable[..., Vector], *vectors: Vector) -> Vector:
        """Form a vector from vectors and tensors that rotate with a cluster."""
        return form(*vectors)


def choose_frames(system: System, clusters: Clusters, own_axes: Collection[int]) -> Frames:
    """Resolve the clusters of ``own_axes`` in their own axes, the others in their parent's."""
    assert system.trees.is_one or not own_axes  # with two parents, neither basis is suitable
    rotations = [no_rotation(system.dag)]
    steps: list[Matrix | None] = [None]
    with system.dag.labelled("f-circuits, rotation"):
        for branch in clusters.branches[1:]:
            assert branch is not None
            # From the child's axes to the basis of its turn parent.
            relative = _turned(rotations[branch.turn_parent], branch)
            if branch.turns and branch.child in own_axes:
                rotations.append(no_rotation(system.dag))
                # The child has its own basis: its fields are constant there, and the rotation leads
                # to the parent's.
                steps.append(relative.matrix)
            else:
                # The child shares its parent's basis: vectors need no rotation between the two, but
                # its fields do.
                rotations.append(relative)
                steps.append(None)
    return Frames(tuple(rotations), tuple(steps))


def _turned(parent: Rotation, branch: Branch) -> Rotation:
    """Rotate the axes of the turn parent by a branch."""
    if not branch.turns:
        return parent
    if branch.quaternion is None:
        # Angles about one axis are added before their sine and cosine are formed, see `then`.
        angle = branch.position
        return parent.then(branch.axes[0], angle if branch.sign > 0 else -angle)
    own = of_quaternion(branch.quaternion)
    # The quaternion rotates the axes of the edge's second node to those of its first; an edge that
    # points inwards needs the inverse.
    matrix = own if branch.sign > 0 else vector.transpose(own)
    if branch.mount is not None:
        # The inner node may be rotated within its cluster, by a weld or an arm.
        matrix = vector.matmul(branch.mount, matrix)
    return Rotation(matrix if parent.is_identity else vector.matmul(parent.matrix, matrix))


@dataclass(frozen=True)
class Geometry:
    """A moving branch, resolved in the basis of its parent."""

    branch: Branch
    axes: tuple[Vector, ...]  # unit axes of the motion space, from first to second node
    #: Parts of the vector from the parent's origin to the child's that are fixed in the parent and
    #: in the child.
    from_parent: Vector
    from_child: Vector
    #: Motion space: angular velocity of the child and velocity of its origin, per unit of each
    #: speed.
    turning: tuple[Vector, ...]
    shifting: tuple[Vector, ...]
    sliding: tuple[Vector, ...]  # part of ``shifting`` that is a translation along the axes

    @property
    def offset(self) -> Vector:
        """The vector from the parent's origin to the child's."""
        return vector.add(self.from_parent, self.from_child)


def resolve_branch(system: System, frames: Frames, branch: Branch) -> Geometry:
    """Resolve a branch in the basis of its parent."""
    zero = vector.zeros(system.dag)
    axes = tuple(frames.carried(branch, axis) for axis in branch.axes)
    # Translations of a motion space are coordinates along axes that the carrier rotates.
    slide = zero  # displacement in the carrier's frame
    for axis, length in zip(branch.axes, branch.slides, strict=True):
        if not length.is_zero:
            slide = vector.add(slide, vector.scale(length * branch.position, axis))
    if branch.sign > 0:
        # The edge begins at the inner node: its parent carries the anchor and the slide.
        from_parent = frames.resolved(branch.parent, vector.add(branch.anchor, slide))
        from_child = zero
    else:
        # The edge begins at the outer node: the child carries the slide, which is positive inwards.
        from_parent = frames.resolved(branch.parent, branch.anchor)
        from_child = vector.neg(frames.carried(branch, slide))
    turning, shifting, sliding = [], [], []
    for axis, length in zip(axes, branch.slides, strict=True):
        along = vector.signed(branch.sign, axis)
        # Speeds are positive along the edge; sums run outwards, hence the sign.
        turning.append(along if branch.turns else zero)
        sliding.append(vector.scale(frames.seen(length), along))
        # If a child rotates about a point of its parent, the part of the vector that is fixed in
        # the child moves, too.
        shifting.append(vector.add(vector.cross(turning[-1], from_child), sliding[-1]))
    return Geometry(
        branch, axes, from_parent, from_child, tuple(turning), tuple(shifting), tuple(sliding)
    )
