"""Which pivots of the mass matrix are safe for every state.

Give each joint the inertia of the rigid cluster that it carries, as if all other joints were
locked. Where that is positive definite for every joint, no motion is without kinetic energy: with
clusters taken from the ground outwards, the velocities of the coordinates map to those of the
clusters by a block triangular matrix whose diagonal blocks are injective. The mass matrix is then
positive definite in every configuration, and so is each of its Schur complements.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.dag import vector
from cotree.dag.traverse import symbols_in
from cotree.equations import Guard
from cotree.errors import ParameterError, SingularSystemError
from cotree.formulation.through import carried_inertia, unit_wrench

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree.dag.nodes import Node
    from cotree.dag.vector import Matrix
    from cotree.formulation.chords import Row
    from cotree.formulation.clusters import Branch, Clusters, Inertia
    from cotree.formulation.system import System
    from cotree.formulation.views import FirstView

#: Metres or radians that nodes may be apart where nothing can bring them together: rounding.
_LARGEST_GAP = 1e-9


def check_inertia(
    system: System, matrix: Sequence[Sequence[Node]], gradient: Sequence[Sequence[Node]]
) -> None:
    """Refuse coordinates that move nothing and that no constraint holds.

    Raises
    ------
    SingularSystemError
        If a row of the mass matrix is structurally zero.
    """
    for speed, row in zip(system.speeds, matrix, strict=True):
        held = (constraint[speed.index] for constraint in gradient)
        if all(entry.is_zero for entry in (*row, *held)):
            direction = speed.name if speed.coordinate is None else speed.coordinate.name
            raise SingularSystemError(
                f"the mass matrix is singular: nothing beyond joint '{speed.edge}' has "
                f"inertia in the direction of '{direction}'; give a body beyond it mass or "
                "inertia, or weld the joint"
            )


def met_where_idle(rows: Sequence[Row], view: FirstView) -> list[Guard]:
    """Ask of constraints that no motion changes, such as those out of a plane, that they hold.

    Raises
    ------
    ParameterError
        If one does not, whatever the parameters are.
    """
    guards = []
    for row in rows:
        gap = row.measure.value(view)
        kinds = set() if gap is None else {symbol.data[0] for symbol in symbols_in([gap])}
        # What has a rate only, and what states still stand in, is never off by parameters alone.
        if gap is None or not kinds <= {"p", "t"}:
            continue
        guard = Guard(
            _LARGEST_GAP * _LARGEST_GAP - gap * gap,
            f"constraint '{row.name}'",
            is_strict=False,
            breach="is not met and nothing moves along it: change the vectors, axes or prescribed "
            f"motion that place the nodes of edge '{row.edge}', or give a joint this direction",
        )
        if "t" in kinds:
            raise ParameterError(guard.demand)
        if guard.value.value is None:
            guards.append(guard)
        else:
            guard.check(guard.value.value)
    return guards


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
    guards: list[Guard] = []
    for branches in _by_cluster(clusters):
        own = _own_inertias(system, clusters, branches)
        is_safe = bool(own) and all(_is_positive(node, value) for node in own)
        if is_safe:
            edges = " and ".join(f"'{name}'" for name in dict.fromkeys(b.edge for b in branches))
            what = f"the inertia that joint {edges} carries itself"
            guards += [Guard(node, what, is_strict=True) for node in own if node.value is None]
        for branch in branches:
            for speed in branch.speeds:
                safe[speed.name] = is_safe
    return tuple(safe[v.name] for v in system.speeds), guards


def _is_positive(node: Node, value: Callable[[Node], float]) -> bool:
    try:
        return value(node) > 0.0
    except (ArithmeticError, ValueError):
        return False


def _by_cluster(clusters: Clusters) -> list[list[Branch]]:
    """Gather the branches into each cluster that holds nodes, from the ground outwards."""
    held = {point.cluster for point in clusters.points.values()}
    found: list[list[Branch]] = []
    own: list[Branch] = []
    for branch in clusters.branches[1:]:
        assert branch is not None
        own.append(branch)
        if branch.child in held:
            found.append(own)
            own = []
    return found


def _own_inertias(system: System, clusters: Clusters, branches: Sequence[Branch]) -> list[Node]:
    """List values that are positive only if the joint's own cluster resists all its motions.

    Nothing is listed where no such values of parameters only are known.
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
        if len(turning) > 1 or turning[0].quaternion is not None:
            return [*sliding, *_minors(central)]
        if turning[0] is not branches[-1]:
            return []  # the axis turns in the cluster's frame
        axis = turning[0].axes[0]
        return [*sliding, vector.dot(axis, vector.times(central, axis))]


def _along(system: System, inertia: Inertia, branch: Branch) -> Node:
    """Form the inertia of a cluster along the only coordinate of its joint."""
    axis, zero = branch.axes[0], vector.zeros(system.dag)
    turning = axis if branch.turns else zero
    shifting = vector.scale(branch.slides[0], axis)
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
