"""The axes in which each cluster's vectors are resolved, and the geometry of moving branches.

The vectors of a cluster are resolved either in the basis of its parent or in the cluster's axes.
Ground axes for all clusters suit planar chains, in which rotation angles add. Cluster axes suit
spatial arms, because inertias are then constant. :mod:`cotree.choice` compares the costs of both.
If the trees differ, a cluster has two parents, and ground axes are used.
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
    """The axes of all clusters, and transformations of vectors and tensors between them.

    In a sensitivity graph, the axes rotate along the seed, and values are dual numbers
    (:class:`cotree.sensitivity.turning.Turning`).
    """

    #: Rotation from each cluster's axes to its basis, in which its vectors are resolved.
    rotations: tuple[Rotation, ...]
    #: Rotation from each cluster's basis to its parent's basis; None if they are equal.
    steps: tuple[Matrix | None, ...]

    def is_kept(self, cluster: int) -> bool:
        """Return whether a cluster moves as in the first graph, so that values can be reused."""
        return False

    @property
    def turned(self) -> frozenset[int]:
        """Clusters whose bases rotate along the seed; none in the first graph."""
        return frozenset()

    def up(self, cluster: int, a: Vector) -> Vector:
        """Transform a vector from a cluster's basis to its parent's basis."""
        step = self.steps[cluster]
        return a if step is None else vector.times(step, a)

    def down(self, cluster: int, a: Vector) -> Vector:
        """Transform a vector from the parent's basis to the cluster's basis."""
        step = self.steps[cluster]
        return a if step is None else vector.transposed_times(step, a)

    def resolved(self, cluster: int, local: Vector) -> Vector:
        """Transform a vector field from a cluster's axes to its basis."""
        return vector.times(self.rotations[cluster].matrix, local)

    def constant(self, cluster: int, a: Vector) -> Vector:
        """Return a vector with constant components in the cluster's basis."""
        return a

    def tensor(self, cluster: int, local: Matrix) -> Matrix:
        """Transform a symmetric tensor field from a cluster's axes to its basis."""
        return vector.congruence(self.rotations[cluster].matrix, local)

    def carried(self, branch: Branch, local: Vector) -> Vector:
        """Transform a vector field from the carrier's axes to the basis of the branch's parent."""
        return vector.times(self.carrier_axes(branch), local)

    def carrier_axes(self, branch: Branch) -> Matrix:
        """Return the axes of a branch's carrier in the basis of the branch's parent."""
        if branch.carrier != branch.child:
            return self.rotations[branch.carrier].matrix
        # From the child's axes to the child's basis, then to the parent's basis.
        step = self.steps[branch.child]
        own = self.rotations[branch.child].matrix
        return own if step is None else vector.matmul(step, own)

    def seen(self, node: Node) -> Node:
        """Return a field, coordinate or speed as a value of this graph."""
        return node

    def formula(self, node: Node, arguments: Mapping[Node, Node]) -> Node:
        """Substitute values for the arguments of a formula."""
        return substitute([node], arguments)[0]

    def within(self, cluster: int, form: Callable[..., Vector], *vectors: Vector) -> Vector:
        """Compute a vector from vectors and tensors that rotate with a cluster."""
        return form(*vectors)


def choose_frames(system: System, clusters: Clusters, own_axes: Collection[int]) -> Frames:
    """Resolve the clusters in ``own_axes`` in cluster axes, all others in the parent's basis."""
    assert system.trees.is_one or not own_axes  # with two parents, only ground axes are suitable
    rotations = [no_rotation(system.dag)]
    steps: list[Matrix | None] = [None]
    with system.dag.labelled("f-circuits, rotation"):
        for branch in clusters.branches:
            # From the child's axes to the basis of its ``turn_parent``.
            relative = _turned(rotations[branch.turn_parent], branch)
            if branch.turns and branch.child in own_axes:
                rotations.append(no_rotation(system.dag))
                # The child has its own basis, in which its fields are constant.
                steps.append(relative.matrix)
            else:
                # The child shares the basis of its parent; only its fields are rotated.
                rotations.append(relative)
                steps.append(None)
    return Frames(tuple(rotations), tuple(steps))


def _turned(parent: Rotation, branch: Branch) -> Rotation:
    if not branch.turns:
        return parent
    if branch.quaternion is None:
        # `then` adds angles about the same axis before sine and cosine are formed.
        angle = branch.position
        return parent.then(branch.axes[0], angle if branch.sign > 0 else -angle)
    own = of_quaternion(branch.quaternion)
    # The quaternion rotates from the second node's axes to the first's; inwards, use the inverse.
    matrix = own if branch.sign > 0 else vector.transpose(own)
    if branch.mount is not None:
        # A weld or an arm may rotate the inner node relative to its cluster.
        matrix = vector.matmul(branch.mount, matrix)
    return Rotation(matrix if parent.is_identity else vector.matmul(parent.matrix, matrix))


@dataclass(frozen=True)
class Geometry:
    """The geometry of a moving branch, in the basis of its parent."""

    branch: Branch
    axes: tuple[Vector, ...]  # unit axes of the motion space, from first to second node
    #: Parts of the vector between the origins: fixed in the parent, and fixed in the child.
    from_parent: Vector
    from_child: Vector
    #: Motion space, per unit of each speed: angular velocity of the child, velocity of its origin.
    turning: tuple[Vector, ...]
    shifting: tuple[Vector, ...]
    sliding: tuple[Vector, ...]  # the part of ``shifting`` that is a translation along the axes

    @property
    def offset(self) -> Vector:
        """Vector from the parent's origin to the child's origin."""
        return vector.add(self.from_parent, self.from_child)


def resolve_branch(system: System, frames: Frames, branch: Branch) -> Geometry:
    """Compute the geometry of a branch in the basis of its parent."""
    zero = vector.zeros(system.dag)
    axes = tuple(frames.carried(branch, axis) for axis in branch.axes)
    # The coordinates of translations are displacements along axes that rotate with the carrier.
    slide = zero  # displacement in axes of the carrier
    for axis, length in zip(branch.axes, branch.slides, strict=True):
        if not length.is_zero:
            slide = vector.add(slide, vector.scale(length * branch.position, axis))
    if branch.sign > 0:
        # If the edge begins at the inner node, anchor and displacement are fixed in the parent.
        from_parent = frames.resolved(branch.parent, vector.add(branch.anchor, slide))
        from_child = zero
    else:
        # If the edge begins at the outer node, the displacement points inwards, fixed in the child.
        from_parent = frames.resolved(branch.parent, branch.anchor)
        from_child = vector.neg(frames.carried(branch, slide))
    turning, shifting, sliding = [], [], []
    for axis, length in zip(axes, branch.slides, strict=True):
        along = vector.signed(branch.sign, axis)
        # Speeds are positive along the edge, while sums run outwards: hence the sign.
        turning.append(along if branch.turns else zero)
        sliding.append(vector.scale(frames.seen(length), along))
        # A rotation about a point of the parent also moves the arm that is fixed in the child.
        shifting.append(vector.add(vector.cross(turning[-1], from_child), sliding[-1]))
    return Geometry(
        branch, axes, from_parent, from_child, tuple(turning), tuple(shifting), tuple(sliding)
    )
