"""f-cutsets: through variables of branches as suffix sums, projected on motion spaces.

The through variable of a branch is the sum over all chords beyond the branch (paper, Eq. (1)). The
chords are force elements and inertias; only the terminal equations of inertias contain
accelerations. Projection on the motion space yields one equation per coordinate (Eq. (5)).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cotree.components import Role
from cotree.dag import vector
from cotree.dag.dual import is_varied
from cotree.formulation.clusters import Inertia, combined
from cotree.formulation.elements import Sums, Wrench, wrenches
from cotree.naming import split_name

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.dag.vector import Matrix, Vector
    from cotree.formulation.across import Accelerations, Motion
    from cotree.formulation.elements import Action
    from cotree.formulation.frames import Frames, Geometry
    from cotree.formulation.measures import Pull


@dataclass(frozen=True)
class Effort:
    """Force or torque that a joint's law exerts along a coordinate, with the law's arguments."""

    value: Node
    arguments: Mapping[str, Node]


@dataclass(frozen=True)
class Loads:
    """Through variables that do not depend on accelerations."""

    actions: tuple[Action, ...]  # forces and torques of the force elements
    on_cluster: tuple[Wrench | None, ...]  # sum of the forces on each cluster; None without forces
    efforts: tuple[Effort, ...]  # forces or torques of tree joints' laws along the speeds
    along: tuple[Node, ...]  # generalised force along each speed
    inertias: tuple[Inertia | None, ...]  # lumped inertia of each cluster, resolved in its basis

    def plus(self, pulls: Sequence[Pull]) -> Loads:
        """Add the through variables along measures."""
        on_cluster, along = list(self.on_cluster), list(self.along)
        for pull in pulls:
            for cluster, force, torque in pull.wrenches:
                known, wrench = on_cluster[cluster], Wrench(force, torque)
                on_cluster[cluster] = wrench if known is None else known.plus(wrench)
            for index, effort in pull.efforts.items():
                along[index] = along[index] + effort
        return replace(self, on_cluster=tuple(on_cluster), along=tuple(along))


@dataclass(frozen=True)
class Balance:
    """The f-cutset equations, projected on the motion spaces."""

    residual: tuple[Node, ...]  # one residual per speed, zero if the equations of motion hold
    #: Inertial forces minus loads of each cluster and of all clusters beyond it, at its origin.
    totals: tuple[Wrench, ...]
    #: Wrench that each moving branch transmits: the child's sum in the parent's basis.
    beyond: tuple[Wrench, ...]


def loads_of(motion: Motion, elements: Sequence[Action], first: Loads | None = None) -> Loads:
    """Sum the forces of the elements, evaluate the laws of joints, and resolve the inertias."""
    sums = Sums(len(motion.omega))
    for action in elements:
        with motion.system.dag.labelled(f"terminal equation of {action.edge.name}"):
            for cluster, wrench in wrenches(motion, action):
                sums.gather(cluster, wrench)
    with motion.system.dag.labelled("terminal equations of joints"):
        efforts = tuple(_joint_efforts(motion, first))
    with motion.system.dag.labelled("inertias"):
        inertias = tuple(
            None if inertia is None else resolved_field(motion.frames, i, inertia)
            for i, inertia in enumerate(motion.clusters.inertias)
        )
    return Loads(
        tuple(elements),
        tuple(sums.at(cluster) for cluster in range(len(motion.omega))),
        efforts,
        tuple(effort.value for effort in efforts),
        inertias,
    )


def _joint_efforts(motion: Motion, first: Loads | None) -> list[Effort]:
    system, seen = motion.system, motion.frames.seen
    efforts = []
    for speed in system.speeds:
        edge, coordinate = system.edges[speed.edge], speed.coordinate
        law = edge.component.law
        if law is None or coordinate is None or edge.component.role is not Role.JOINT:
            efforts.append(Effort(system.dag.zero, {}))
            continue
        name = split_name(coordinate.name)[1]
        arguments = {key: seen(node) for key, node in edge.scalars.items()}
        arguments |= {name: seen(coordinate.symbol), f"{name}_dot": seen(speed.symbol)}
        if first is not None and not is_varied(*arguments.values()):
            efforts.append(first.efforts[speed.index])
        else:
            efforts.append(Effort(law.value(system.dag, arguments), arguments))
    return efforts


def resolved(inertia: Inertia, axes: Matrix) -> Inertia:
    """Transform an inertia to other axes."""
    return Inertia(
        inertia.mass, vector.times(axes, inertia.moment), vector.congruence(axes, inertia.tensor)
    )


def resolved_field(frames: Frames, cluster: int, local: Inertia) -> Inertia:
    """Transform a cluster's inertia from cluster axes to the cluster's basis."""
    return Inertia(
        frames.seen(local.mass),
        frames.resolved(cluster, local.moment),
        frames.tensor(cluster, local.tensor),
    )


def inertial_wrench(
    motion: Motion, across: Accelerations, cluster: int, inertia: Inertia
) -> Wrench:
    """Return the terminal equation of a lumped inertia: its wrench at the cluster's origin.

    The force is ``m a + A h``, the torque ``h x a + J alpha + omega x (J omega)``, with A =
    [alpha]x + [omega]x[omega]x, moments h and J, and acceleration a of the origin ([1] eq. 3).
    """
    origin, matrix = across.origin[cluster], across.matrix[cluster]
    force = vector.add(vector.scale(inertia.mass, origin), vector.times(matrix, inertia.moment))

    def spin_torque(omega: Vector, alpha: Vector) -> Vector:
        gyroscopic = vector.cross(omega, vector.times(inertia.tensor, omega))
        return vector.add(vector.times(inertia.tensor, alpha), gyroscopic)

    spin = motion.frames.within(cluster, spin_torque, motion.omega[cluster], across.alpha[cluster])
    return Wrench(force, vector.add(vector.cross(inertia.moment, origin), spin))


def balance(motion: Motion, loads: Loads, across: Accelerations) -> Balance:
    """Form the f-cutset equations of the branches ([1] eq. 1), and project them ([1] eq. 5)."""
    zero = vector.zeros(motion.system.dag)
    nothing = Wrench(zero, zero)
    sums = Sums(len(motion.omega))
    gather_chords(motion, loads, across, sums)
    residual = project_cutsets(motion, loads, sums)
    totals = tuple(sums.at(cluster) or nothing for cluster in range(len(motion.omega)))
    beyond = tuple(
        carried(motion.frames, geometry.branch.child, totals[geometry.branch.child])
        for geometry in motion.geometry
    )
    return Balance(residual, totals, beyond)


def gather_chords(motion: Motion, loads: Loads, across: Accelerations, sums: Sums) -> None:
    """Add the inertia of each cluster, minus its loads, to ``sums``."""
    dag = motion.system.dag
    with dag.labelled("terminal equations of inertias"):
        for cluster, inertia in enumerate(loads.inertias[1:], start=1):
            if inertia is not None and sums.takes(
                cluster,
                inertia.mass,
                inertia.moment,
                inertia.tensor,
                motion.omega[cluster],
                across.alpha[cluster],
                across.origin[cluster],
            ):
                sums.gather(cluster, inertial_wrench(motion, across, cluster, inertia))
            applied = loads.on_cluster[cluster]
            if applied is not None:
                # Loads are subtracted: the cutset equation is total = 0.
                sums.gather(cluster, applied.minus())


def project_cutsets(motion: Motion, loads: Loads, sums: Sums) -> tuple[Node, ...]:
    """Sum the wrenches that branches transmit inwards, and project them on the motion spaces."""
    system, frames = motion.system, motion.frames
    residual: dict[str, Node] = {}
    for geometry in reversed(motion.geometry):
        branch = geometry.branch
        total = sums.at(branch.child)
        if total is None:
            continue
        # Outer branches were processed before, so the child's sum is complete.
        with system.dag.labelled(f"f-cutset of {branch.edge}"):
            wrench = carried(frames, branch.child, total)
            for i, speed in enumerate(branch.speeds):
                residual[speed.name] = project(geometry, i, wrench)
            hand_on(sums, geometry, wrench)
    with system.dag.labelled("projection on motion spaces"):
        return tuple(
            residual.get(speed.name, system.dag.zero) - effort
            for speed, effort in zip(system.speeds, loads.along, strict=True)
        )


def carried(frames: Frames, cluster: int, wrench: Wrench) -> Wrench:
    """Transform a wrench from a cluster's basis to its parent's basis."""
    return Wrench(frames.up(cluster, wrench.force), frames.up(cluster, wrench.torque))


def project(geometry: Geometry, i: int, wrench: Wrench) -> Node:
    """Return the scalar product of a wrench and direction ``i`` of the motion space."""
    return vector.dot(geometry.turning[i], wrench.torque) + vector.dot(
        geometry.shifting[i], wrench.force
    )


def shifted(wrench: Wrench, arm: Vector) -> Wrench:
    """Move a wrench inwards along an arm r: r x F is added to the torque."""
    return Wrench(wrench.force, vector.add(wrench.torque, vector.cross(arm, wrench.force)))


def hand_on(sums: Sums, geometry: Geometry, wrench: Wrench) -> None:
    """Add the wrench that a branch transmits to the sums of its parents."""
    branch = geometry.branch
    if branch.parent == branch.turn_parent:
        if branch.parent:  # forces on the ground are not used
            sums.gather(branch.parent, shifted(wrench, geometry.offset))
        return
    # If the trees differ, the torque follows the rotation tree and the force the translation tree.
    # The arm is fixed in the translation parent, on which its moment acts.
    zero = vector.zeros(branch.anchor[0].dag)
    sums.gather(branch.turn_parent, Wrench(zero, wrench.torque))
    sums.gather(branch.parent, shifted(Wrench(wrench.force, zero), geometry.offset))


def mass_matrix(motion: Motion, loads: Loads) -> list[list[Node]]:
    """Form the symmetric mass matrix from composite inertias (suffix sums over the tree)."""
    system = motion.system
    n = len(system.speeds)
    # Composite rigid bodies (R. Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 6).
    matrix = [[system.dag.zero] * n for _ in range(n)]
    composites = list(loads.inertias)
    for geometry in reversed(motion.geometry):
        branch = geometry.branch
        composite = composites[branch.child]
        if composite is None:
            continue
        with system.dag.labelled(f"composite inertia beyond {branch.edge}"):
            step = motion.frames.steps[branch.child]
            composite = composite if step is None else resolved(composite, step)
            at_parent = carried_inertia(composite, geometry.offset)
            known = composites[branch.parent]
            # The composite inertia of the ground is not needed.
            composites[branch.parent] = combined(known, at_parent) if branch.parent else None
        with system.dag.labelled(f"mass matrix, column of {branch.edge}"):
            for i, speed in enumerate(branch.speeds):
                wrench = unit_wrench(composite, geometry.turning[i], geometry.shifting[i])
                _project_column(motion, matrix, geometry, speed.index, wrench)
    return matrix


def carried_inertia(inertia: Inertia, arm: Vector) -> Inertia:
    """Move the reference point of an inertia inwards along an arm."""
    first = vector.add(inertia.moment, vector.scale(inertia.mass, arm))
    both = vector.add(first, inertia.moment)
    # The sum of m x x^T with x = a + p is that of m p p^T plus m a a^T + a h^T + h a^T (arm a).
    xx, yy, zz = (arm[i] * both[i] for i in range(3))

    def off(i: int, j: int) -> Node:
        return -(arm[i] * first[j] + inertia.moment[i] * arm[j])

    xy, xz, yz = off(0, 1), off(0, 2), off(1, 2)
    extra = ((yy + zz, xy, xz), (xy, xx + zz, yz), (xz, yz, xx + yy))
    return Inertia(inertia.mass, first, vector.matadd(inertia.tensor, extra))


def unit_wrench(inertia: Inertia, turning: Vector, shifting: Vector) -> Wrench:
    """Return the wrench of an inertia for a unit acceleration along a direction.

    Per unit of the speed's rate, ``turning`` is the angular acceleration e, and ``shifting`` the
    acceleration a of the origin: the force is ``m a + e x h``, the torque ``h x a + J e``.
    """
    return Wrench(
        vector.add(vector.scale(inertia.mass, shifting), vector.cross(turning, inertia.moment)),
        vector.add(vector.cross(inertia.moment, shifting), vector.times(inertia.tensor, turning)),
    )


def _project_column(
    motion: Motion, matrix: list[list[Node]], geometry: Geometry, column: int, wrench: Wrench
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
        # Entries between speeds that are not on one path to the ground remain zero.
        wrench = carried(frames, branch.parent, shifted(wrench, geometry.offset))
        geometry = motion.to(branch.parent)
