"""Pivots of the mass matrix that are safe for every state.

Give each joint the inertia of the rigid cluster that it carries, as if all other joints were
locked. If it is positive definite for every joint, every motion has kinetic energy: with
clusters taken from the ground outwards, the velocities of the coordinates map to those of the
clusters by a block triangular matrix whose diagonal blocks are injective. The mass matrix is then
positive definite in every configuration, and so is each of its Schur complements.

This requires clusters whose kinetic energy is never negative. A cluster whose inertia tensor, at
the scene's values, is not that of any body makes the pivots of all joints that move it unsafe.
"""

from __future__ import annotations

import math
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np

from cotree.dag import vector
from cotree.dag.traverse import symbols_in
from cotree.equations import Guard
from cotree.errors import ParameterError, SingularSystemError
from cotree.formulation.through import carried_inertia, unit_wrench
from cotree.scene.inertias import ROUNDING

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree.dag.nodes import Node
    from cotree.dag.vector import Matrix
    from cotree.formulation.chords import Row
    from cotree.formulation.clusters import Branch, Clusters, Inertia
    from cotree.formulation.system import System
    from cotree.formulation.views import View

#: Metres or radians that nodes may be apart where nothing can bring them together: rounding.
_LARGEST_GAP = 1e-9


def check_inertia(
    system: System, matrix: Sequence[Sequence[Node]], gradient: Sequence[Sequence[Node]]
) -> None:
    """Refuse coordinates that move nothing and that no constraint holds.

    Parameters
    ----------
    system : System
        The bound scene.
    matrix : sequence of rows of Node, shape (n_speeds, n_speeds)
        The mass matrix.
    gradient : sequence of rows of Node, shape (n_constraints, n_speeds)
        Derivatives of the constraints' rates by the speeds.

    Raises
    ------
    SingularSystemError
        If a row of the mass matrix is structurally zero.
    """
    # A structural test, for the message: rows that vanish for some states only are found at run
    # time.
    for speed, row in zip(system.speeds, matrix, strict=True):
        held = (constraint[speed.index] for constraint in gradient)
        if all(entry.is_zero for entry in (*row, *held)):
            direction = speed.name if speed.coordinate is None else speed.coordinate.name
            raise SingularSystemError(
                f"the mass matrix is singular: nothing beyond joint '{speed.edge}' has "
                f"inertia in the direction of '{direction}'; give a body beyond it mass or "
                "inertia, or weld the joint"
            )


def met_where_idle(rows: Sequence[Row], view: View) -> list[Guard]:
    """Require that constraints that no motion changes, such as those out of a plane, hold.

    Raises
    ------
    ParameterError
        If one does not hold, whatever the parameters are.
    """
    guards = []
    for row in rows:
        gap = row.measure.value(view)
        kinds = set() if gap is None else {symbol.data[0] for symbol in symbols_in([gap])}
        # A constraint on rates only, or one that states enter, never fails by parameters alone.
        if gap is None or not kinds <= {"p", "t"}:
            continue
        guard = Guard(
            _LARGEST_GAP * _LARGEST_GAP - gap * gap,
            f"constraint '{row.name}'",
            is_strict=False,
            breach="is not met and nothing moves along it: change the vectors, axes or prescribed "
            f"motion that place the nodes of edge '{row.edge}', or give a joint this direction",
        )
        # A guard is a function of parameters only, which a gap that varies with time is not.
        if "t" in kinds:
            raise ParameterError(guard.demand)
        if guard.value.value is None:
            guards.append(guard)
        else:
            guard.check(guard.value.value)
    return guards


def safe_pivots(system: System, clusters: Clusters) -> tuple[tuple[bool, ...], list[Guard]]:
    """Find the coordinates whose own cluster gives them inertia.

    Parameters
    ----------
    system, clusters : System, Clusters
        The bound system and its rigid clusters.

    Returns
    -------
    is_safe : tuple of bool
        One for each coordinate.
    guards : list of Guard
        Values that must stay positive when parameters change.
    """
    safe: dict[str, bool] = {}
    guards: list[Guard] = []
    # A tensor of negative energy takes inertia away from every joint that moves it.
    unsafe = _below(clusters, _unreal(system, clusters))
    for branches in _by_cluster(clusters):
        own = _own_inertias(system, clusters, branches)
        # At the scene's values now; guards keep it so when parameters change.
        is_safe = bool(own) and all(_is_positive(node, system.at_scene) for node in own)
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
    """List the clusters whose kinetic energy may be negative."""
    found = []
    for cluster, inertia in enumerate(clusters.inertias):
        if inertia is not None and not _is_real(system, inertia.tensor, inertia):
            found.append(cluster)
    # Parameters may take away what makes up for a tensor that is no body's: it has no guard.
    for body in system.bodies:
        if body.inertia is None or _is_real(system, body.inertia):
            continue
        cluster = clusters.points[body.second].cluster
        inertia = clusters.inertias[cluster]
        if inertia is None or symbols_in([inertia.mass, *inertia.moment, *chain(*inertia.tensor)]):
            found.append(cluster)
    return found


def _is_real(system: System, tensor: Matrix, inertia: Inertia | None = None) -> bool:
    """Whether a tensor, about the origin of an inertia if given, is that of some body or none.

    That is: at the scene's values, and but for rounding, it turns nothing at negative energy.
    """
    try:
        central = np.array([[system.at_scene(entry) for entry in row] for row in tensor])
        room = ROUNDING * np.trace(central)
        mass = 0.0 if inertia is None else system.at_scene(inertia.mass)
        if inertia is not None and mass:
            moment = np.array([system.at_scene(entry) for entry in inertia.moment])
            # Steiner: about the centre of mass, where a real body's tensor has no negative
            # eigenvalue.
            central -= (moment @ moment * np.eye(3) - np.outer(moment, moment)) / mass
        if system.plane:
            # In a plane only turns about its normal occur.
            axis = "xyz".index(system.plane)
            return bool(mass >= 0.0 and central[axis, axis] >= -room)
        return bool(mass >= 0.0 and np.linalg.eigvalsh(central)[0] >= -room)
    except (ArithmeticError, ValueError):  # LinAlgError among them
        return False


def _below(clusters: Clusters, outer: Sequence[int]) -> set[int]:
    """List some clusters and all whose motion moves them."""
    found: set[int] = set()
    waiting = list(outer)
    while waiting:
        cluster = waiting.pop()
        branch = clusters.branches[cluster]
        if branch is not None and cluster not in found:
            found.add(cluster)
            # Whatever carries or turns the cluster gives it kinetic energy.
            waiting += [branch.parent, branch.turn_parent]
    return found


def _is_positive(node: Node, value: Callable[[Node], float]) -> bool:
    return bool(0.0 < value(node) < math.inf)


def _by_cluster(clusters: Clusters) -> list[list[Branch]]:
    """Gather the branches into each cluster that holds nodes, from the ground outwards."""
    held = {point.cluster for point in clusters.points.values()}
    found: list[list[Branch]] = []
    own: list[Branch] = []
    for branch in clusters.branches[1:]:
        assert branch is not None
        own.append(branch)
        # A joint of several steps is one motion: its massless clusters in between carry no nodes.
        if branch.child in held:
            found.append(own)
            own = []
    return found


def _own_inertias(system: System, clusters: Clusters, branches: Sequence[Branch]) -> list[Node]:
    """List values that are positive only if the joint's own cluster resists all its motions.

    The list is empty where no such values that depend on parameters only are known.
    """
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
        central = _central(inertia)
        # Several axes may reach any direction: the central tensor has to be positive definite,
        # which leading minors tell.
        if len(turning) > 1 or turning[0].quaternion is not None:
            return [*sliding, *_minors(central)]
        if turning[0] is not branches[-1]:
            return []  # the axis turns in the cluster's frame
        axis = turning[0].axes[0]
        # Where translations are free the kinetic energy of a turn is at least that about the
        # centre of mass.
        return [*sliding, vector.dot(axis, vector.times(central, axis))]


def _along(system: System, inertia: Inertia, branch: Branch) -> Node:
    """Form the inertia of a cluster along the only coordinate of its joint."""
    axis, zero = branch.axes[0], vector.zeros(system.dag)
    turning = axis if branch.turns else zero
    shifting = vector.scale(branch.slides[0], axis)
    # Inertia about the axis through the origin of the cluster, which is the joint's outer node.
    wrench = unit_wrench(inertia, turning, shifting)
    return vector.dot(turning, wrench.torque) + vector.dot(shifting, wrench.force)


def _central(inertia: Inertia) -> Matrix:
    """Form the inertia tensor about the centre of mass."""
    offset = vector.scale(1.0 / inertia.mass, inertia.moment)
    moved = carried_inertia(inertia, vector.neg(offset))
    return moved.tensor


def _minors(m: Matrix) -> list[Node]:
    """Form the leading principal minors."""
    plane = m[0][0] * m[1][1] - m[0][1] * m[1][0]
    return [m[0][0], plane, vector.dot(m[0], vector.cross(m[1], m[2]))]
