"""Derivatives of the through variables along measures."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.dag.dual import Dual
from cotree.formulation.ends import Pull

if TYPE_CHECKING:
    from cotree.formulation.laws import Applied
    from cotree.sensitivity.views import TangentView


def pull_tangent(view: TangentView, applied: Applied) -> Pull:
    """Differentiate the pull of a through variable; a multiplier itself is held fixed."""
    magnitude = Dual(applied.magnitude, view.moved.seed.dag.zero)
    if applied.formula is not None:
        magnitude = applied.amount(view)
    scaled = applied.measure.pull(view).scaled(magnitude)
    wrenches = tuple(
        (cluster, tuple(entry.d for entry in force), tuple(entry.d for entry in torque))
        for cluster, force, torque in scaled.wrenches
    )
    return Pull(wrenches, {index: effort.d for index, effort in scaled.efforts.items()})
