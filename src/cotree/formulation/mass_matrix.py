"""The mass matrix: singularity checks, augmented bodies, and pivots that are certainly positive.

Suppose that each joint moves the inertia of its child cluster while all other joints are locked. If
this inertia is positive definite for every joint, so are the mass matrix in every configuration and
all its Schur complements: the cluster velocities are a linear map of the coordinate velocities,
whose matrix is block triangular from the ground outwards, with injective diagonal blocks. This
requires that no cluster has negative kinetic energy; otherwise the pivots of all joints that move
this cluster are unsafe.

If the trees differ, the clusters beyond a branch do not move as one body and have no composite
inertia. But all mass that the translation tree carries beyond a branch moves with the branch's
outer node, and acts as a point mass of the inner cluster at that node (augmented body: J.
Wittenburg, Dynamics of Systems of Rigid Bodies, 1977). The equations of a cluster's rotation then
contain only its augmented first moment and inertia.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import chain
from typing import TYPE_CHECKING, overload

import numpy as np

from cotree.dag import vector
from cotree.dag.nodes import Node, symbols_in
from cotree.equations import Guard
from cotree.errors import ParameterError, SingularSystemError
from cotree.formulation.clusters import Branch, Clusters, Inertia, combined, shifted
from cotree.formulation.constraints import along_speeds
from cotree.formulation.measures import Pull
from cotree.formulation.through import carried_inertia, resolved, unit_wrench
from cotree.scene.checks import ROUNDING

if TYPE_CHECKING:
    from cotree.dag.vector import Matrix, Vector
    from cotree.formulation.across import Motion, View
    from cotree.formulation.chords import Constraint
    from cotree.formulation.frames import Geometry
    from cotree.formulation.system import System


#: A gap between nodes, [m] or [rad], up to this size is a rounding error if no motion closes it.
_LARGEST_GAP = 1e-9


def check_inertia(
    system: System, matrix: Sequence[Sequence[Node]], gradient: Sequence[Sequence[Node]]
) -> None:
    """Raise SingularSystemError if neither inertia nor a constraint determines a coordinate."""
    # A structural test, for a clear message. Rows that vanish only in some states fail at run time.
    for speed, row in zip(system.speeds, matrix, strict=True):
        held = (constraint[speed.index] for constraint in gradient)
        if all(entry.is_zero for entry in (*row, *held)):
            direction = speed.name if speed.coordinate is None else speed.coordinate.name
            raise SingularSystemError(
                f"the mass matrix is singular: nothing beyond joint '{speed.edge}' has "
                f"inertia in the direction of '{direction}'; give a body beyond it mass or "
                "inertia, or weld the joint"
            )


def met_where_idle(rows: Sequence[Constraint], view: View) -> list[Guard]:
    """Return guards for constraints that no motion changes; raise an error if one is violated."""
    guards = []
    for row in rows:
        gap = row.measure.value(view)
        kinds = set() if gap is None else {symbol.data[0] for symbol in symbols_in([gap])}
        # A constraint on rates, or one that depends on states, is not violated by parameters alone.
        if gap is None or not kinds <= {"p", "t"}:
            continue
        guard = Guard(
            _LARGEST_GAP * _LARGEST_GAP - gap * gap,
            f"constraint '{row.name}'",
            is_strict=False,
            breach=(
                "is violated, and no motion changes it: change the vectors, axes or "
                f"prescribed motion that place the nodes of edge '{row.edge}', or add a "
                "joint that moves in this direction"
            ),
        )
        # Guards depend on parameters only: a gap that depends on time cannot have one.
        if "t" in kinds:
            raise ParameterError(guard.demand)
        if guard.value.value is None:
            guards.append(guard)
        else:
            guard.check(guard.value.value)
    return guards


def safe_pivots(system: System, clusters: Clusters) -> tuple[tuple[bool, ...], list[Guard]]:
    """Return whether each coordinate certainly moves inertia, and guards that ensure this."""
    safe: dict[str, bool] = {}
    guards: list[Guard] = []
    # Negative energy of a cluster reduces the inertia of every joint that moves it.
    unsafe = _below(clusters, _unreal(system, clusters))
    for branches in _by_cluster(clusters):
        own = _own_inertias(system, clusters, branches)
        # Positive for the values in the scene; guards detect violations by other parameters.
        is_safe = bool(own) and all(0.0 < system.at_scene(node) < math.inf for node in own)
        is_safe = is_safe and unsafe.isdisjoint(branch.child for branch in branches)
        if is_safe:
            edges = " and ".join(f"'{name}'" for name in dict.fromkeys(b.edge for b in branches))
            what = f"the inertia that joint {edges} carries itself"
            guards += [Guard(node, what, is_strict=True) for node in own if node.value is None]
        for branch in branches:
            for speed in branch.speeds:
                safe[speed.name] = is_safe
    return tuple(safe[v.name] for v in system.speeds), guards


def _unreal(system: System, clusters: Clusters) -> list[int]:
    """Return the clusters whose kinetic energy may be negative."""
    found = []
    for cluster, inertia in enumerate(clusters.inertias):
        if inertia is not None and not _is_real(system, inertia.tensor, inertia):
            found.append(cluster)
    # An impossible tensor has no guard, so other values must not compensate for it.
    for body in system.bodies:
        if body.inertia is None or _is_real(system, body.inertia):
            continue
        cluster = clusters.points[body.second].cluster
        inertia = clusters.inertias[cluster]
        if inertia is None or symbols_in([inertia.mass, *inertia.moment, *chain(*inertia.tensor)]):
            found.append(cluster)
    return found


def _is_real(system: System, tensor: Matrix, inertia: Inertia | None = None) -> bool:
    """Return whether all rotations have nonnegative energy for the values in the scene."""
    try:
        central = np.array([[system.at_scene(entry) for entry in row] for row in tensor])
        room = ROUNDING * np.trace(central)
        mass = 0.0 if inertia is None else system.at_scene(inertia.mass)
        if inertia is not None and mass:
            moment = np.array([system.at_scene(entry) for entry in inertia.moment])
            # Steiner: about the centre of mass, a real body's tensor has no negative eigenvalue.
            central -= (moment @ moment * np.eye(3) - np.outer(moment, moment)) / mass
        if system.plane:
            # In planar motion, only rotations about the plane's normal occur.
            axis = "xyz".index(system.plane)
            return bool(mass >= 0.0 and central[axis, axis] >= -room)
        return bool(mass >= 0.0 and np.linalg.eigvalsh(central)[0] >= -room)
    except (ArithmeticError, ValueError):  # ValueError includes LinAlgError
        return False


def _below(clusters: Clusters, outer: Sequence[int]) -> set[int]:
    """Return the ``outer`` clusters, and all clusters whose motion also moves them."""
    found: set[int] = set()
    waiting = list(outer)
    while waiting:
        cluster = waiting.pop()
        if cluster and cluster not in found:
            found.add(cluster)
            branch = clusters.to(cluster)
            # Motions that carry or rotate the cluster give it kinetic energy.
            waiting += [branch.parent, branch.turn_parent]
    return found


def _by_cluster(clusters: Clusters) -> list[list[Branch]]:
    """Group the branches by the joint that they form, from the ground outwards."""
    held = {point.cluster for point in clusters.points.values()}
    found: list[list[Branch]] = []
    own: list[Branch] = []
    for branch in clusters.branches:
        own.append(branch)
        # The massless clusters between the steps of a joint have no nodes.
        if branch.child in held:
            found.append(own)
            own = []
    return found


def _own_inertias(system: System, clusters: Clusters, branches: Sequence[Branch]) -> list[Node]:
    """Return values that are positive if all motions of a joint move inertia of its cluster."""
    inertia = clusters.inertias[branches[-1].child]
    branches = [branch for branch in branches if branch.speeds]
    if inertia is None or inertia.mass.is_zero or not branches:
        return []
    with system.dag.labelled("guards"):
        if len(branches) == 1 and branches[0].quaternion is None:
            return [_along(system, inertia, branches[0])]
        turning = [branch for branch in branches if branch.turns]
        sliding = [inertia.mass] if any(not branch.turns for branch in branches) else []
        if not turning:
            return sliding
        centre = vector.scale(1.0 / inertia.mass, inertia.moment)
        central = carried_inertia(inertia, vector.neg(centre)).tensor
        # Several axes may span all directions: the central tensor must be positive definite.
        if len(turning) > 1 or turning[0].quaternion is not None:
            return [*sliding, *_minors(central)]
        if turning[0] is not branches[-1]:
            return []  # the axis rotates relative to the cluster
        axis = turning[0].axes[0]
        # With free translations, rotations about the centre of mass have the least energy.
        return [*sliding, vector.dot(axis, vector.times(central, axis))]


def _along(system: System, inertia: Inertia, branch: Branch) -> Node:
    """Return the inertia that the single coordinate of a joint moves."""
    axis, zero = branch.axes[0], vector.zeros(system.dag)
    turning = axis if branch.turns else zero
    shifting = vector.scale(branch.slides[0], axis)
    # The origin of the cluster, through which the axis passes, is the joint's outer node.
    wrench = unit_wrench(inertia, turning, shifting)
    return vector.dot(turning, wrench.torque) + vector.dot(shifting, wrench.force)


def _minors(m: Matrix) -> list[Node]:
    plane = m[0][0] * m[1][1] - m[0][1] * m[1][0]
    return [m[0][0], plane, vector.dot(m[0], vector.cross(m[1], m[2]))]


def augmented_mass_matrix(motion: Motion) -> list[list[Node]]:
    """Form the symmetric mass matrix, one row per speed, from vectors in ground axes."""
    dag, n = motion.system.dag, len(motion.system.speeds)
    with dag.labelled("augmented bodies"):
        bodies = _augmented(motion)
        tensors = _turned_together(motion, bodies)
    matrix = [[dag.zero] * n for _ in range(n)]
    for geometry in motion.geometry:
        for i, speed in enumerate(geometry.branch.speeds):
            with dag.labelled(f"mass matrix, column of {speed.edge}"):
                # Forces of accelerated masses, then couplings of rotations and translations.
                pull = _forces(motion, bodies, geometry, i)
                rows = _own(motion, bodies, tensors, geometry, i)
                for row, entry in enumerate(along_speeds(motion, pull)):
                    # An acceleration of the carrier affects all carried clusters equally.
                    matrix[row][speed.index] = matrix[row][speed.index] + entry
                    matrix[speed.index][row] = matrix[speed.index][row] + entry
                for row, entry in rows.items():
                    matrix[row][speed.index] = matrix[row][speed.index] + entry
                    if row != speed.index:
                        matrix[speed.index][row] = matrix[row][speed.index]
    return matrix


def _augmented(motion: Motion) -> list[Inertia | None]:
    """Add to each cluster the mass that it carries, as point masses; results are in ground axes."""
    bodies = list(motion.clusters.inertias)
    for geometry in reversed(motion.geometry):
        branch = geometry.branch
        own = bodies[branch.child]
        if own is not None:
            # Sum in axes of the cluster, in which the arms are constant.
            mass = shifted(own.mass, _arm(branch), None)
            bodies[branch.parent] = combined(bodies[branch.parent], mass)
    axes = motion.frames.rotations
    return [None if b is None else resolved(b, axes[i].matrix) for i, b in enumerate(bodies)]


def _arm(branch: Branch) -> Vector:
    """Return the vector from the parent's origin to the child's origin, in the parent's axes."""
    arm = branch.anchor
    for axis, length in zip(branch.axes, branch.slides, strict=True):
        if not length.is_zero:
            along = vector.signed(branch.sign, axis)
            arm = vector.add(arm, vector.scale(length * branch.position, along))
    return arm


def _turned_together(motion: Motion, bodies: list[Inertia | None]) -> list[Matrix | None]:
    # A torque on a cluster acts on all rotations that move it: tensors are summed along their tree.
    tensors = [None if body is None else body.tensor for body in bodies]
    for geometry in reversed(motion.geometry):
        parent, own = geometry.branch.turn_parent, tensors[geometry.branch.child]
        if own is not None:
            known = tensors[parent]
            tensors[parent] = own if known is None else vector.matadd(known, own)
    return tensors


def _forces(motion: Motion, bodies: list[Inertia | None], geometry: Geometry, i: int) -> Pull:
    """Return the forces due to a unit acceleration, with the clusters on which they act."""
    branch, zero = geometry.branch, vector.zeros(motion.system.dag)
    wrenches = []
    # All clusters that rotate with the branch, in one pass because parents come first.
    turned = {branch.child} if branch.turns else set()
    for other in motion.geometry:
        if other.branch.turn_parent in turned:
            turned.add(other.branch.child)
    for cluster in sorted(turned):
        body = bodies[cluster]
        if body is not None:
            # alpha x h, with the augmented first moment h of all mass that alpha accelerates.
            wrenches.append((cluster, vector.cross(geometry.turning[i], body.moment), zero))
    body, shifting = bodies[branch.child], geometry.shifting[i]
    if body is not None and branch.parent and not vector.is_zero(shifting):
        # _own has the entries for the speeds of the branch itself.
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
    """Return a speed's matrix entries for its own branch and for the rotations that carry it."""
    branch = geometry.branch
    found: dict[int, Node] = {}
    tensor, body = tensors[branch.child], bodies[branch.child]
    if branch.turns and tensor is not None:
        # J alpha acts on all rotations between the ground and the branch.
        torque = vector.times(tensor, geometry.turning[i])
        for other in motion.clusters.turning_path(branch.child):
            outer = motion.to(other.child).turning
            for k, speed in enumerate(other.speeds):
                # Compute entries within a branch once; the caller fills in the transpose.
                if other is not branch or k <= i:
                    found[speed.index] = vector.dot(outer[k], torque)
    if body is not None and not vector.is_zero(geometry.shifting[i]):
        at, shifting = branch.speeds[i].index, geometry.shifting[i]
        # Add the carried mass to the branch's translation; _forces adds entries further inwards.
        push = body.mass * vector.dot(shifting, shifting)
        found[at] = found[at] + push if at in found else push
    return found


# Limit of the mean squared depth of the speeds, which is the number of operations per speed with
# the matrix. Elimination along the tree needs 90 (planar) to 600 (spatial).
_DEEP = 1000.0


def is_deep(motion: Motion) -> bool:
    """Return whether elimination along the tree certainly costs less than with the matrix."""
    depths, squares = {0: 0}, []
    for geometry in motion.geometry:
        branch = geometry.branch
        below = depths[branch.parent]
        depths[branch.child] = below + len(branch.speeds)
        # A speed at depth d is coupled to d speeds above it, so elimination changes d^2 entries.
        squares += [depth**2 for depth in range(below + 1, depths[branch.child] + 1)]
    return sum(squares) > _DEEP * len(squares)


class LateMatrix(Sequence[Sequence["Node"]]):
    """A bordered mass matrix; the first ``n`` rows, with n^2 entries, are formed on first use."""

    def __init__(
        self, form: Callable[[], Sequence[Sequence[Node]]], n: int, border: Sequence[Sequence[Node]]
    ) -> None:
        self._form, self._n, self._border = form, n, border
        self._upper: Sequence[Sequence[Node]] | None = None

    def __len__(self) -> int:
        return self._n + len(self._border)

    @overload
    def __getitem__(self, at: int) -> Sequence[Node]: ...
    @overload
    def __getitem__(self, at: slice) -> Sequence[Sequence[Node]]: ...
    def __getitem__(self, at: int | slice) -> Sequence[Node] | Sequence[Sequence[Node]]:
        places = range(len(self))[at]
        if isinstance(places, range):
            return [self._row(i) for i in places]
        return self._row(places)

    def _row(self, i: int) -> Sequence[Node]:
        if i >= self._n:
            return self._border[i - self._n]
        if self._upper is None:
            self._upper = self._form()
        return self._upper[i]
