"""What projection and reports need of the constraints."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.components import FreeRotation
from cotree.equations import ConstraintSet, Quantity

if TYPE_CHECKING:
    from cotree.formulation.first_graph import FirstGraph


def gather_constraints(first: FirstGraph) -> ConstraintSet:
    """Gather what projection and reports need of the constraints."""
    rows = first.constraints
    steps = [step for own in first.system.steps.values() for step in own]
    return ConstraintSet(
        rows=tuple(Quantity(row.name, row.unit) for row in rows.rows),
        edges=tuple(row.edge for row in rows.rows),
        values=rows.values,
        rates=rows.rates,
        gradient=rows.gradient,
        sizes=rows.sizes,
        quaternions=tuple(
            (step.edge, tuple(c.symbol for c in step.coordinates))
            for step in steps
            if isinstance(step.kind, FreeRotation)
        ),
        start_rows=tuple(Quantity(row.name) for row in first.conditions),
        start_is_rate=tuple(row.is_rate for row in first.conditions),
        start_values=tuple(
            (row.measure.rate(first.view) if row.is_rate else row.measure.value(first.view))
            - row.given
            for row in first.conditions
        ),
        start_gradient=tuple(row.gradient for row in first.conditions),
    )
