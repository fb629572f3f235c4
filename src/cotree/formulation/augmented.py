"""The mass matrix where translation and rotation have different trees: augmented bodies.

What lies beyond a branch then does not move as one body, so that it has no composite inertia. But
all mass that the translation tree carries beyond a branch moves with the branch's outer node, so
that it counts as a point mass there of the cluster inside (an augmented body: J. Wittenburg,
Dynamics of Systems of Rigid Bodies, 1977). A turn of a cluster then needs its augmented first
moment and inertia only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.dag import vector
from cotree.formulation.clusters import combined, shifted
from cotree.formulation.constraints import along_speeds
from cotree.formulation.endpoints import Pull
from cotree.formulation.through import resolved

if TYPE_CHECKING:
    from cotree.dag.nodes import Node
    from cotree.dag.vector import Matrix, Vector
    from cotree.formulation.across import Motion
    from cotree.formulation.clusters import Branch, Inertia
    from cotree.formulation.frames import Geometry


def augmented_mass_matrix(motion: Motion) -> list[list[Node]]:
    """Form the mass matrix, for vectors in ground axes.

    Returns
    -------
    list of rows of Node
        Symmetric, one row for each speed.
    """
    dag, n = motion.system.dag, len(motion.system.speeds)
    with dag.labelled("augmented bodies"):
        bodies = _augmented(motion)
        tensors = _turned_together(motion, bodies)
    matrix = [[dag.zero] * n for _ in range(n)]
    for geometry in motion.geometry:
        for i, speed in enumerate(geometry.branch.speeds):
            with dag.labelled(f"mass matrix, column of {speed.edge}"):
                # Forces of the masses that are moved, then what turns and slides couple.
                pull = _forces(motion, bodies, geometry, i)
                rows = _own(motion, bodies, tensors, geometry, i)
                for row, entry in enumerate(along_speeds(motion, pull)):
                    # A carrier's acceleration does the same to what it carries.
                    matrix[row][speed.index] = matrix[row][speed.index] + entry
                    matrix[speed.index][row] = matrix[speed.index][row] + entry
                for row, entry in rows.items():
                    matrix[row][speed.index] = matrix[row][speed.index] + entry
                    if row != speed.index:
                        matrix[speed.index][row] = matrix[row][speed.index]
    return matrix


def _augmented(motion: Motion) -> list[Inertia | None]:
    """Add to each cluster the mass that it carries, as point masses, in ground axes."""
    bodies = list(motion.clusters.inertias)
    for geometry in reversed(motion.geometry):
        branch = geometry.branch
        own = bodies[branch.child]
        if own is not None:
            # In the cluster's own axes, where arms are constant.
            mass = shifted(own.mass, _arm(branch), None)
            bodies[branch.parent] = combined(bodies[branch.parent], mass)
    axes = motion.frames.rotations
    return [None if b is None else resolved(b, axes[i].matrix) for i, b in enumerate(bodies)]


def _arm(branch: Branch) -> Vector:
    """Give the vector from the parent's origin to the child's, in the parent's axes."""
    arm = branch.anchor
    for axis, length in zip(branch.axes, branch.slides, strict=True):
        if not length.is_zero:
            along = vector.signed(branch.sign, axis)
            arm = vector.add(arm, vector.scale(length * branch.position, along))
    return arm


def _turned_together(motion: Motion, bodies: list[Inertia | None]) -> list[Matrix | None]:
    """Sum the inertia tensors of all that turns with each cluster."""
    # A torque on a cluster reaches all that turns it, so that tensors add along the rotation tree.
    tensors = [None if body is None else body.tensor for body in bodies]
    for geometry in reversed(motion.geometry):
        parent, own = geometry.branch.turn_parent, tensors[geometry.branch.child]
        if own is not None:
            known = tensors[parent]
            tensors[parent] = own if known is None else vector.matadd(known, own)
    return tensors


def _forces(motion: Motion, bodies: list[Inertia | None], geometry: Geometry, i: int) -> Pull:
    """Form the forces that a unit acceleration needs, on the clusters where they act."""
    branch, zero = geometry.branch, vector.zeros(motion.system.dag)
    wrenches = []
    # All clusters that turn with the branch: in the rotation tree parents come first, so one pass
    # finds them.
    turned = {branch.child} if branch.turns else set()
    for other in motion.geometry:
        if other.branch.turn_parent in turned:
            turned.add(other.branch.child)
    for cluster in sorted(turned):
        body = bodies[cluster]
        if body is not None:
            # alpha x h: the augmented first moment holds all mass that this turn accelerates.
            wrenches.append((cluster, vector.cross(geometry.turning[i], body.moment), zero))
    body, shifting = bodies[branch.child], geometry.shifting[i]
    if body is not None and branch.parent and not vector.is_zero(shifting):
        # The branch itself is left to _own, which counts it once.
        force = vector.scale(body.mass, shifting)
        wrenches.append((branch.parent, force, vector.cross(geometry.offset, force)))
    return Pull(tuple(wrenches))


def _own(
    motion: Motion,
    bodies: list[Inertia | None],
    tensors: list[Matrix | None],
    geometry: Geometry,
    i: int,
) -> dict[int, Node]:
    """Form the entries of a speed's column by itself and by the turns that carry it, by speed."""
    branch = geometry.branch
    found: dict[int, Node] = {}
    tensor, body = tensors[branch.child], bodies[branch.child]
    if branch.turns and tensor is not None:
        # J alpha, felt by every turn between the ground and the branch.
        torque = vector.times(tensor, geometry.turning[i])
        for other in motion.clusters.turning_path(branch.child):
            outer = motion.to(other.child).turning
            for k, speed in enumerate(other.speeds):
                # Entries within one branch are formed once; the caller fills in the transpose.
                if other is not branch or k <= i:
                    found[speed.index] = vector.dot(outer[k], torque)
    if body is not None and not vector.is_zero(geometry.shifting[i]):
        at, shifting = branch.speeds[i].index, geometry.shifting[i]
        # The carried mass resists its own slide; what lies further inwards is in _forces.
        push = body.mass * vector.dot(shifting, shifting)
        found[at] = found[at] + push if at in found else push
    return found
