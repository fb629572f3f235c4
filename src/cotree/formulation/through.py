"""f-cutsets: through variables of the branches as suffix sums, projected on motion spaces.

The cutset equation of a branch says that its through variable is the sum of those of the chords
beyond it (paper, Eq. (1)). Chords are inertias, whose terminal equations need accelerations, and
force elements. Projection on the motion space gives one equation for each coordinate (Eq. (5)).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cotree.components import Role
from cotree.dag import vector
from cotree.formulation.clusters import Inertia, combined
from cotree.formulation.elements import Wrench, actions, gather, wrenches

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.dag.vector import Matrix, Vector
    from cotree.formulation.across import Accelerations, Motion
    from cotree.formulation.clusters import Branch
    from cotree.formulation.elements import Action
    from cotree.formulation.ends import Pull
    from cotree.formulation.frames import Geometry


@dataclass(frozen=True)
class Effort:
    """Value of a joint's law along a coordinate, its arguments and its partial derivatives."""

    value: Node
    arguments: Mapping[str, Node]
    partials: Mapping[str, Node]


@dataclass(frozen=True)
class Loads:
    """Through variables that do not depend on accelerations.

    Attributes
    ----------
    actions : tuple of Action
        The force elements.
    on_cluster : tuple of Wrench or None
        Their sum on each cluster.
    efforts : tuple of Effort
        Force or torque of each tree joint's own law along each speed.
    along : tuple of Node
        All that acts along each speed itself.
    inertias : tuple of Inertia or None
        Lumped inertia of each cluster, resolved in its basis.
    """

    actions: tuple[Action, ...]
    on_cluster: tuple[Wrench | None, ...]
    efforts: tuple[Effort, ...]
    along: tuple[Node, ...]
    inertias: tuple[Inertia | None, ...]

    def plus(self, pulls: Sequence[Pull]) -> Loads:
        """Add what acts along measures."""
        on_cluster, along = list(self.on_cluster), list(self.along)
        for pull in pulls:
            for cluster, force, torque in pull.wrenches:
                gather(on_cluster, cluster, Wrench(force, torque))
            for index, effort in pull.efforts.items():
                along[index] = along[index] + effort
        return replace(self, on_cluster=tuple(on_cluster), along=tuple(along))


@dataclass(frozen=True)
class Balance:
    """The projected f-cutset equations.

    Attributes
    ----------
    residual : tuple of Node
        One for each speed; zero on a motion.
    beyond : tuple of Wrench
        Sum of inertia less load beyond each moving branch, at the child's origin, in the parent's
        basis: what the branch transmits.
    """

    residual: tuple[Node, ...]
    beyond: tuple[Wrench, ...]


def load(motion: Motion) -> Loads:
    """Form the terminal equations of force elements and joint laws, and resolve the inertias."""
    on_cluster: list[Wrench | None] = [None] * len(motion.omega)
    elements = tuple(actions(motion))
    for action in elements:
        with motion.system.dag.labelled(f"terminal equation of {action.edge.name}"):
            for cluster, wrench in wrenches(motion, action):
                gather(on_cluster, cluster, wrench)
    with motion.system.dag.labelled("terminal equations of joints"):
        efforts = tuple(joint_efforts(motion))
    with motion.system.dag.labelled("inertias"):
        inertias = tuple(
            None if inertia is None else resolved(inertia, motion.frames.rotations[i].matrix)
            for i, inertia in enumerate(motion.clusters.inertias)
        )
    along = tuple(effort.value for effort in efforts)
    return Loads(elements, tuple(on_cluster), efforts, along, inertias)


def joint_efforts(motion: Motion) -> list[Effort]:
    """Evaluate the law of each tree joint along its coordinate."""
    system = motion.system
    efforts = []
    for speed in system.speeds:
        edge, coordinate = system.edges[speed.edge], speed.coordinate
        law = edge.component.law
        if law is None or coordinate is None or edge.component.role is not Role.JOINT:
            efforts.append(Effort(system.dag.zero, {}, {}))
            continue
        name = coordinate.name.partition(".")[2]
        arguments = {**edge.scalars, name: coordinate.symbol, f"{name}_dot": speed.symbol}
        efforts.append(
            Effort(
                law.value(system.dag, arguments),
                arguments,
                law.partial_values(system.dag, arguments),
            )
        )
    return efforts


def resolved(inertia: Inertia, axes: Matrix) -> Inertia:
    """Resolve an inertia in other axes."""
    return Inertia(
        inertia.mass,
        vector.times(axes, inertia.moment),
        vector.congruence(axes, inertia.tensor),
    )


def inertial_wrench(
    inertia: Inertia, omega: Vector, alpha: Vector, matrix: Matrix, origin: Vector
) -> Wrench:
    """Form the terminal equation of a lumped inertia, at its cluster's origin.

    Force ``m a + A h``; torque ``h x a + J alpha + omega x (J omega)``, with first moment h and
    second moment J about the origin, whose acceleration is a.
    """
    force = vector.add(vector.scale(inertia.mass, origin), vector.times(matrix, inertia.moment))
    torque = vector.add(
        vector.cross(inertia.moment, origin), spin_torque(inertia.tensor, omega, alpha)
    )
    return Wrench(force, torque)


def spin_torque(tensor: Matrix, omega: Vector, alpha: Vector) -> Vector:
    """Form J alpha + omega x (J omega)."""
    gyroscopic = vector.cross(omega, vector.times(tensor, omega))
    return vector.add(vector.times(tensor, alpha), gyroscopic)


def balance(motion: Motion, loads: Loads, across: Accelerations) -> Balance:
    """Form the f-cutset equations of the branches and project them on their motion spaces."""
    system, frames = motion.system, motion.frames
    zero = vector.zeros(system.dag)
    totals = [_cluster_total(motion, loads, across, c) for c in range(len(motion.omega))]
    beyond: list[Wrench] = []
    residual: dict[str, Node] = {}
    for geometry in reversed(motion.geometry):
        branch = geometry.branch
        with system.dag.labelled(f"f-cutset of {branch.edge}"):
            total = totals[branch.child] or Wrench(zero, zero)
            carried = Wrench(
                frames.up(branch.child, total.force), frames.up(branch.child, total.torque)
            )
            for i, speed in enumerate(branch.speeds):
                residual[speed.name] = project(geometry, i, carried)
            hand_on(totals, branch, carried, (geometry.offset, carried.force))
        beyond.append(carried)
    with system.dag.labelled("projection on motion spaces"):
        rows = tuple(
            residual[speed.name] - effort
            for speed, effort in zip(system.speeds, loads.along, strict=True)
        )
    return Balance(rows, tuple(reversed(beyond)))


def _cluster_total(
    motion: Motion, loads: Loads, across: Accelerations, cluster: int
) -> Wrench | None:
    """Sum the chords at one cluster: its inertia less its loads."""
    inertia, applied = loads.inertias[cluster], loads.on_cluster[cluster]
    if cluster == 0 or (inertia is None and applied is None):
        return None
    total = None
    with motion.system.dag.labelled("terminal equations of inertias"):
        if inertia is not None:
            total = inertial_wrench(
                inertia,
                motion.omega[cluster],
                across.alpha[cluster],
                across.matrix[cluster],
                across.origin[cluster],
            )
        if applied is not None:
            reaction = Wrench(vector.neg(applied.force), vector.neg(applied.torque))
            total = reaction if total is None else total.plus(reaction)
    return total


def project(geometry: Geometry, i: int, wrench: Wrench) -> Node:
    """Form the scalar product of a wrench with a direction of the motion space."""
    return vector.dot(geometry.turning[i], wrench.torque) + vector.dot(
        geometry.shifting[i], wrench.force
    )


def shifted(wrench: Wrench, arm: Vector) -> Wrench:
    """Move a wrench back along an arm: an arm adds r x F to the torque."""
    return Wrench(wrench.force, vector.add(wrench.torque, vector.cross(arm, wrench.force)))


def hand_on(
    totals: list[Wrench | None], branch: Branch, wrench: Wrench, *moments: tuple[Vector, Vector]
) -> None:
    """Add what a branch transmits to its parents: the force with its moments, and the torque.

    Each moment is an arm and a force. Where the trees differ the torque goes the way of the
    rotation graph.
    """
    torque = wrench.torque
    if branch.parent != branch.turn_parent:
        zero = vector.zeros(torque[0].dag)
        gather(totals, branch.turn_parent, Wrench(zero, torque))
        torque = zero
    for arm, force in moments:
        torque = vector.add(torque, vector.cross(arm, force))
    gather(totals, branch.parent, Wrench(wrench.force, torque))


def mass_matrix(motion: Motion, loads: Loads) -> list[list[Node]]:
    """Form the mass matrix from composite inertias, by suffix sums over the tree.

    Returns
    -------
    list of rows of Node
        Symmetric, one row for each speed.
    """
    system = motion.system
    n = len(system.speeds)
    matrix = [[system.dag.zero] * n for _ in range(n)]
    composites = list(loads.inertias)
    for geometry in reversed(motion.geometry):
        branch = geometry.branch
        composite = composites[branch.child]
        if composite is None:
            continue
        with system.dag.labelled(f"composite inertia beyond {branch.edge}"):
            composite = _up(motion, branch.child, composite)
            at_parent = carried_inertia(composite, geometry.offset)
            known = composites[branch.parent]
            composites[branch.parent] = combined(known, at_parent) if branch.parent else None
        with system.dag.labelled(f"mass matrix, column of {branch.edge}"):
            for i, speed in enumerate(branch.speeds):
                wrench = unit_wrench(composite, geometry.turning[i], geometry.shifting[i])
                _project_column(motion, matrix, geometry, speed.index, wrench)
    return matrix


def _up(motion: Motion, cluster: int, inertia: Inertia) -> Inertia:
    """Resolve a composite inertia in the parent's basis."""
    step = motion.frames.steps[cluster]
    return inertia if step is None else resolved(inertia, step)


def carried_inertia(inertia: Inertia, arm: Vector) -> Inertia:
    """Move an inertia's reference point back along an arm."""
    first = vector.add(inertia.moment, vector.scale(inertia.mass, arm))
    both = vector.add(first, inertia.moment)
    xx, yy, zz = (arm[i] * both[i] for i in range(3))

    def off(i: int, j: int) -> Node:
        return -(arm[i] * first[j] + inertia.moment[i] * arm[j])

    xy, xz, yz = off(0, 1), off(0, 2), off(1, 2)
    extra = ((yy + zz, xy, xz), (xy, xx + zz, yz), (xz, yz, xx + yy))
    return Inertia(inertia.mass, first, vector.matadd(inertia.tensor, extra))


def unit_wrench(inertia: Inertia, turning: Vector, shifting: Vector) -> Wrench:
    """Form the wrench that gives an inertia a unit acceleration along a direction."""
    return Wrench(
        vector.add(vector.scale(inertia.mass, shifting), vector.cross(turning, inertia.moment)),
        vector.add(vector.cross(inertia.moment, shifting), vector.times(inertia.tensor, turning)),
    )


def _project_column(
    motion: Motion,
    matrix: list[list[Node]],
    geometry: Geometry,
    column: int,
    wrench: Wrench,
) -> None:
    """Project a unit wrench on the motion spaces of all branches towards the ground."""
    frames = motion.frames
    while True:
        branch = geometry.branch
        for i, speed in enumerate(branch.speeds):
            row = speed.index
            matrix[row][column] = matrix[column][row] = project(geometry, i, wrench)
        if branch.parent == 0:
            return
        wrench = shifted(wrench, geometry.offset)
        wrench = Wrench(
            frames.up(branch.parent, wrench.force), frames.up(branch.parent, wrench.torque)
        )
        geometry = motion.to(branch.parent)
