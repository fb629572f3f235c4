"""Kernels that implicit methods need, built when one is first used, and the work of their steps.

In: a program after its passes. Out: a ``cotree_newton`` in this process; operations of its kernels,
and products of eliminations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.build import BuildOptions, LoadedLibrary, find_toolchain, obtain_library
from cotree.errors import BuildError
from cotree.linear.plan import narrow_band
from cotree.sharing import forming
from cotree.version import ABI_VERSION

if TYPE_CHECKING:
    from cotree.program import Program


@dataclass(frozen=True, eq=False)
class Newton:
    """Factors and second derivatives of a model, as C sees them."""

    address: int  # address of its ``cotree_newton``
    library: LoadedLibrary  # the library, which keeps the code loaded


def load_newton(program: Program) -> Newton | None:
    """Build and load the factors and second derivatives of a model; None where no compiler can.

    Parameters
    ----------
    program : Program
        The program after its passes.
    """
    toolchain = find_toolchain()
    if toolchain is None:
        return None
    # Explicit methods need nothing of what prints C.
    from cotree.codegen.newton import (
        newton_context,
        newton_declarations,
        render_newton,
    )

    # Second derivatives are new nodes of the model's arena, which threads share.
    with forming:
        model = newton_context(program)
        files = render_newton(model)
    try:
        _, loaded = obtain_library(
            files,
            newton_declarations(model),
            abi_version=ABI_VERSION,
            n_operations=model.n_written,
            n_all=model.n_written_in_all,
            options=BuildOptions(),
            toolchain=toolchain,
        )
    except BuildError:
        return None
    address = getattr(loaded.lib, f"{model.prefix}_newton")()
    return Newton(int(loaded.ffi.cast("uintptr_t", address)), loaded)


@dataclass(frozen=True)
class StepWork:
    """Operation counts of the parts of a step."""

    #: Operations to evaluate the rates, the rates with sensitivities, and the Jacobian.
    rates: int
    augmented: int
    jacobian: int
    #: Entries of the factors of the planned sparse elimination, and products to compute them.
    n_factors: int
    n_products: int
    is_unrolled: bool  # whether its C code is fully unrolled
    #: The same for an elimination with row exchanges, banded if the band is narrow.
    n_banded: int
    n_banded_products: int


def count_step_work(program: Program) -> StepWork | None:
    """Count operations; None if the matrices of steps are structurally singular."""
    layout, plan = program.layout, program.elimination
    if plan is None:
        return None
    from cotree.codegen.newton import is_unrolled

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
