"""Through variables of a sensitivity graph: changes of the first graph's sums."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cotree.dag.dual import is_varied, tangent_of, varied
from cotree.formulation.elements import Sums, Wrench, act
from cotree.formulation.through import gather_chords, loads_of, project_cutsets

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cotree.dag.nodes import Node
    from cotree.formulation.across import Motion, View
    from cotree.formulation.elements import Action
    from cotree.formulation.endpoints import Pull
    from cotree.formulation.laws import Applied
    from cotree.formulation.through import Balance, Loads


class Changes(Sums):
    """Wrenches on clusters as duals: the first graph's sums, and their tangents along the seed.

    Zero changes are left out, so that a traversal visits only values that depend on the seed.
    """

    def __init__(self, motion: Motion, first: Balance) -> None:
        super().__init__(len(motion.omega))
        self._frames, self._first = motion.frames, first.totals

    def gather(self, cluster: int, wrench: Wrench) -> None:
        """Add the change of a wrench."""
        if is_varied(wrench.force, wrench.torque):
            # The value is in the first graph's total already; only the tangent is added.
            super().gather(cluster, Wrench(tangent_of(wrench.force), tangent_of(wrench.torque)))

    def at(self, cluster: int) -> Wrench | None:
        """Return the sum on a cluster; None if neither it nor the cluster's motion changes."""
        # Projection and arms are products, whose tangent needs the value of the sum, too.
        first, change = self._first[cluster], super().at(cluster)
        if change is None:
            # The sum on the cluster is constant, but its directions change: the total of the first
            # graph is projected on rotating motion spaces.
            return None if self._frames.is_kept(cluster) else first
        return Wrench(varied(first.force, change.force), varied(first.torque, change.torque))

    def takes(self, cluster: int, *parts: Any) -> bool:
        """Return whether a wrench of a cluster that is formed of some parts changes."""
        return not self._frames.is_kept(cluster) or is_varied(*parts)


def residual_tangents(
    view: View, loads: Loads, balance: Balance, applied: Sequence[Applied]
) -> list[Node]:
    """Form the projected f-cutset equations of a sensitivity graph, by coordinate.

    Accelerations of coordinates are constant. ``loads`` and ``balance`` are the first graph's, at
    the actual accelerations, ``applied`` the changing through variables along measures.
    """
    motion = view.motion
    # The traversal of the first graph, over duals: terminal equations (Eq. (4)), then f-cutsets
    # (Eq. (1)), then the projection on the motion spaces (Eq. (5)).
    changes, loaded = Changes(motion, balance), _loads(view, loads, applied)
    gather_chords(motion, loaded, view.across, changes)
    rows = project_cutsets(motion, loaded, changes)
    # Only tangents are needed: the values are the balances of the first graph, which are zero.
    return [tangent_of(row) for row in rows]


def _loads(view: View, first: Loads, applied: Sequence[Applied]) -> Loads:
    """Form the loads that change, and all inertias."""
    motion = view.motion
    elements = []
    for action in first.actions:
        if _is_reached(motion, action):
            with motion.system.dag.labelled(f"terminal equation of {action.edge.name}"):
                elements.append(act(motion, action.edge))
    return loads_of(motion, elements, first).plus(list(_pulls(view, applied)))


def _is_reached(motion: Motion, action: Action) -> bool:
    """Return whether a node or a field of the element depends on the seed."""
    frames, edge = motion.frames, action.edge
    points = (action.first, action.second)
    # A moved node changes the circuit between the two, even if no field does.
    if not all(frames.is_kept(point.cluster) for point in points):
        return True
    if is_varied(*(frames.seen(value) for value in edge.scalars.values())):
        return True
    fields = (*edge.vectors.values(), *(point.local for point in points))
    return any(is_varied(*map(frames.seen, field)) for field in fields)


def _pulls(view: View, applied: Sequence[Applied]) -> Iterator[Pull]:
    """Form the pulls of the through variables that change; a multiplier itself is constant."""
    for row in applied:
        with view.motion.system.dag.labelled(f"through variable of {row.edge}"):
            # The derivative of a multiplier is an unknown of the sensitivity graph, on the
            # left-hand side; here only its pull changes.
            amount = row.magnitude if row.formula is None else row.amount(view)
            yield row.measure.pull(view).scaled(amount)
