"""Which pivots of the mass matrix are safe for every state.

Give each coordinate the inertia of the rigid cluster that its joint carries, as if all other
joints were locked. Where that is positive for every coordinate, no motion is without kinetic
energy: with clusters taken from the ground outwards, the velocities of the coordinates map to
those of the clusters by a block triangular matrix whose diagonal blocks are injective. The mass
matrix is then positive definite in every configuration, and so is each of its Schur complements.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.dag import vector
from cotree.equations import Guard
from cotree.errors import SingularSystemError
from cotree.formulation.through import unit_wrench

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree.dag.nodes import Node
    from cotree.formulation.clusters import Branch, Clusters
    from cotree.formulation.system import System


def check_inertia(system: System, matrix: Sequence[Sequence[Node]]) -> None:
    """Refuse coordinates that move nothing.

    Raises
    ------
    SingularSystemError
        If a row of the mass matrix is structurally zero.
    """
    for coordinate, row in zip(system.coordinates, matrix, strict=True):
        if all(entry.is_zero for entry in row):
            raise SingularSystemError(
                f"the mass matrix is singular: nothing beyond joint '{coordinate.edge}' has "
                f"inertia in the direction of '{coordinate.name}'; give a body beyond it mass or "
                "inertia, or weld the joint"
            )


def safe_pivots(
    system: System, clusters: Clusters, value: Callable[[Node], float]
) -> tuple[tuple[bool, ...], list[Guard]]:
    """Find the coordinates whose own cluster gives them inertia.

    Parameters
    ----------
    system, clusters : System, Clusters
        What moves.
    value : callable
        Evaluates a node of parameters at the scene's values.

    Returns
    -------
    is_safe : tuple of bool
        One for each coordinate.
    guards : list of Guard
        What must stay positive when parameters change.
    """
    safe: dict[str, bool] = {}
    guards = []
    for branch in clusters.branches[1:]:
        assert branch is not None
        own = _own_inertia(system, clusters, branch)
        is_safe = own is not None and value(own) > 0.0
        if is_safe and own is not None and own.value is None:
            what = f"the inertia that joint '{branch.edge}' carries itself"
            guards.append(Guard(own, what, is_strict=True))
        for coordinate in branch.coordinates:
            safe[coordinate.name] = is_safe
    return tuple(safe[c.name] for c in system.coordinates), guards


def _own_inertia(system: System, clusters: Clusters, branch: Branch) -> Node | None:
    """Form the inertia of a branch's own cluster along its only coordinate, if it has just one."""
    inertia = clusters.inertias[branch.child]
    if inertia is None or len(branch.coordinates) != 1:
        return None
    axis, zero = branch.axes[0], vector.zeros(system.dag)
    turning, shifting = (axis, zero) if branch.coordinates[0].freedom.rotates else (zero, axis)
    with system.dag.labelled("guards"):
        wrench = unit_wrench(inertia, turning, shifting)
        return vector.dot(turning, wrench.torque) + vector.dot(shifting, wrench.force)
