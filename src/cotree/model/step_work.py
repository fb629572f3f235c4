"""Operation counts of a step of an implicit method.

In: a program after its passes. Out: operations of its kernels, and products of eliminations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.codegen.newton import is_unrolled
from cotree.linear.plan import narrow_band

if TYPE_CHECKING:
    from cotree.program import Program


@dataclass(frozen=True)
class StepWork:
    """Operation counts of the parts of a step.

    Attributes
    ----------
    rates, augmented, jacobian : int
        Operations to evaluate the rates, the rates with sensitivities, and the Jacobian.
    n_factors, n_products : int
        Entries of the factors of the planned sparse elimination, and products to compute them.
    is_unrolled : bool
        Whether its C code is fully unrolled.
    n_banded, n_banded_products : int
        The same for an elimination with row exchanges, banded if the band is narrow.
    """

    rates: int
    augmented: int
    jacobian: int
    n_factors: int
    n_products: int
    is_unrolled: bool
    n_banded: int
    n_banded_products: int


def count_step_work(program: Program) -> StepWork | None:
    """Count operations; None if the matrices of steps are structurally singular."""
    layout, plan = program.layout, program.elimination
    if plan is None:
        return None
    n, counts = len(layout.states), program.operations
    lower, upper, places = narrow_band(n, layout.column_starts, layout.row_indices)
    is_banded = places is not None
    return StepWork(
        counts["rhs"].total,
        counts["augmented_rhs"].total,
        counts["jacobian"].total,
        len(plan.factors),
        sum(len(entry.products) for entry in plan.factors),
        is_unrolled(plan),
        n * (2 * lower + upper + 1 if is_banded else n),
        n * lower * (lower + upper) if is_banded else n**3 // 3,
    )
