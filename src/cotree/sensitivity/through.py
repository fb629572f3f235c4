"""Through variables of a sensitivity graph: the same suffix sums and projections."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.components.law import chain
from cotree.dag import vector
from cotree.formulation.elements import Wrench, gather
from cotree.formulation.through import hand_on, spin_torque
from cotree.sensitivity.elements import wrench_tangents
from cotree.sensitivity.pulls import pull_tangent

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.dag.nodes import Node
    from cotree.dag.vector import Matrix, Vector
    from cotree.formulation.across import Accelerations
    from cotree.formulation.clusters import Inertia
    from cotree.formulation.ends import Pull
    from cotree.formulation.frames import Geometry
    from cotree.formulation.laws import Applied
    from cotree.formulation.through import Balance, Loads
    from cotree.sensitivity.across import AccelerationTangent, GeometryTangent, MotionTangent
    from cotree.sensitivity.views import TangentView


def balance_tangent(
    moved: MotionTangent,
    loads: Loads,
    across: Accelerations,
    balance: Balance,
    view: TangentView,
    applied: Sequence[Applied],
) -> list[Node]:
    """Form the projected f-cutset equations of a sensitivity graph.

    Parameters
    ----------
    moved : MotionTangent
        Its positions and velocities.
    loads, across, balance : Loads, Accelerations, Balance
        The first graph's through and across variables, at the actual accelerations.
    view : TangentView
        Its across variables.
    applied : sequence of Applied
        The through variables along measures that change.

    Returns
    -------
    list of Node
        Derivative of each coordinate's equation, accelerations of coordinates held fixed.
    """
    motion, frames = moved.motion, moved.motion.frames
    system = motion.system
    totals = _cluster_tangents(moved, loads, across, view.across)
    d_along = _effort_tangents(moved, loads)
    for row in applied:
        with system.dag.labelled(f"through variable of {row.edge}, derivative"):
            _add_pull(pull_tangent(view, row), totals, d_along)
    residual: dict[str, Node] = {}
    for geometry in reversed(motion.geometry):
        branch = geometry.branch
        own, total = moved.geometry[branch.child - 1], totals[branch.child]
        if own is None and total is None:
            continue
        with system.dag.labelled(f"f-cutset, derivative of {branch.edge}"):
            wrench = balance.beyond[branch.child - 1]
            d_wrench = Wrench(moved.zero, moved.zero)
            if total is not None:
                d_wrench = Wrench(
                    frames.up(branch.child, total.force), frames.up(branch.child, total.torque)
                )
            for i, speed in enumerate(branch.speeds):
                residual[speed.name] = _project_tangent(geometry, own, i, wrench, d_wrench)
            if branch.parent or branch.turn_parent:
                moments = [(geometry.offset, d_wrench.force)]
                if own is not None:
                    moments.append((own.offset, wrench.force))
                hand_on(totals, branch, d_wrench, *moments)
    with system.dag.labelled("projection on motion spaces, derivative"):
        return [
            residual.get(speed.name, system.dag.zero) - d_effort
            for speed, d_effort in zip(system.speeds, d_along, strict=True)
        ]


def _add_pull(pull: Pull, totals: list[Wrench | None], along: list[Node]) -> None:
    """Take a pull from the sums on clusters, which count reactions, and add it along speeds."""
    for cluster, force, torque in pull.wrenches:
        if vector.is_zero(force) and vector.is_zero(torque):
            continue
        gather(totals, cluster, Wrench(vector.neg(force), vector.neg(torque)))
    for index, effort in pull.efforts.items():
        along[index] = along[index] + effort


def _project_tangent(
    geometry: Geometry, own: GeometryTangent | None, i: int, wrench: Wrench, d_wrench: Wrench
) -> Node:
    """Differentiate the scalar product of a wrench with a direction of the motion space."""
    total = vector.dot(geometry.turning[i], d_wrench.torque) + vector.dot(
        geometry.shifting[i], d_wrench.force
    )
    if own is not None:
        total = total + vector.dot(own.turning[i], wrench.torque)
        total = total + vector.dot(own.shifting[i], wrench.force)
    return total


def _cluster_tangents(
    moved: MotionTangent, loads: Loads, across: Accelerations, d_across: AccelerationTangent
) -> list[Wrench | None]:
    """Differentiate the chords at each cluster: its inertia less its loads."""
    dag = moved.motion.system.dag
    totals: list[Wrench | None] = [None] * len(moved.motion.omega)
    with dag.labelled("terminal equations of inertias, derivative"):
        for cluster, inertia in enumerate(loads.inertias):
            if cluster and inertia is not None:
                totals[cluster] = _inertia_tangent(moved, inertia, across, d_across, cluster)
    for action in loads.actions:
        with dag.labelled(f"terminal equation of {action.edge.name}, derivative"):
            for cluster, applied in wrench_tangents(moved, action):
                reaction = Wrench(vector.neg(applied.force), vector.neg(applied.torque))
                gather(totals, cluster, reaction)
    return totals


def _inertia_tangent(
    moved: MotionTangent,
    inertia: Inertia,
    across: Accelerations,
    d_across: AccelerationTangent,
    cluster: int,
) -> Wrench | None:
    """Differentiate the terminal equation of a lumped inertia; None where nothing reaches it."""
    seed, motion = moved.seed, moved.motion
    local = motion.clusters.inertias[cluster]
    assert local is not None
    d_mass, d_moment_local, d_tensor_local = (
        seed.of(local.mass),
        seed.vector(local.moment),
        seed.matrix(local.tensor),
    )
    is_changed = not d_mass.is_zero or not all(
        vector.is_zero(row) for row in (d_moment_local, *d_tensor_local)
    )
    is_moved = moved.phi[cluster] is not None
    d_origin = d_across.origin[cluster]
    if not is_changed and not is_moved and d_origin is None:
        return None
    d_origin = d_origin or moved.zero
    d_moment = moved.carried(cluster, local.moment)
    origin, matrix = across.origin[cluster], across.matrix[cluster]
    force = vector.add(vector.scale(d_mass, origin), vector.scale(inertia.mass, d_origin))
    force = vector.add(force, vector.times(matrix, d_moment))
    d_matrix = d_across.matrix[cluster]
    if d_matrix is not None:
        force = vector.add(force, vector.times(d_matrix, inertia.moment))
    torque = vector.add(vector.cross(d_moment, origin), vector.cross(inertia.moment, d_origin))
    d_tensor = None
    if is_changed:
        axes = motion.frames.rotations[cluster].matrix
        d_tensor = vector.congruence(axes, d_tensor_local)
    torque = vector.add(
        torque, _spin_tangent(moved, inertia.tensor, d_tensor, across, d_across, cluster)
    )
    return Wrench(force, torque)


def _spin_tangent(
    moved: MotionTangent,
    tensor: Matrix,
    d_tensor: Matrix | None,
    across: Accelerations,
    d_across: AccelerationTangent,
    cluster: int,
) -> Vector:
    """Differentiate J alpha + omega x (J omega).

    As seen from the turning cluster J does not change by the turn: the torque turns with the
    cluster, and the spins change by what remains of their derivatives.
    """
    omega, alpha = moved.motion.omega[cluster], across.alpha[cluster]
    total = moved.zero
    if d_tensor is not None:
        total = spin_torque(d_tensor, omega, alpha)
    if moved.phi[cluster] is None:
        return total
    phi = moved.phi_of(cluster)
    d_omega = vector.sub(moved.omega_of(cluster), vector.cross(phi, omega))
    d_alpha = vector.sub(d_across.alpha[cluster] or moved.zero, vector.cross(phi, alpha))
    total = vector.add(total, vector.cross(phi, spin_torque(tensor, omega, alpha)))
    total = vector.add(total, vector.times(tensor, d_alpha))
    total = vector.add(total, vector.cross(d_omega, vector.times(tensor, omega)))
    return vector.add(total, vector.cross(omega, vector.times(tensor, d_omega)))


def _effort_tangents(moved: MotionTangent, loads: Loads) -> list[Node]:
    """Differentiate the law of each joint along its coordinate."""
    zero = moved.motion.system.dag.zero
    return [
        chain(e.partials, {name: moved.seed.of(e.arguments[name]) for name in e.partials}, zero)
        for e in loads.efforts
    ]
