"""The passes in order, and the effect of each on the operation counts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.passes.balance import balance_sums
from cotree.passes.order import order_by_need
from cotree.passes.reciprocals import share_reciprocals
from cotree.passes.sines import pack_sines
from cotree.passes.stage import stage_parameters

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.program import Program

#: Each pass with its name, in the order they run.
# Reciprocals and sums come before staging, which then finds the reciprocals of parameters, and
# needs sums as they will be computed. The order of values is decided last, on what remains.
RECIPE: tuple[tuple[str, Callable[[Program], Program]], ...] = (
    ("reciprocals", share_reciprocals),
    ("sines", pack_sines),
    ("balance", balance_sums),
    ("stage", stage_parameters),
    ("order", order_by_need),
)


@dataclass(frozen=True)
class PassReport:
    """Effect of one pass on a program.

    Attributes
    ----------
    name : str
        The pass.
    earlier, later : Program
        The program before and after it.
    """

    name: str
    earlier: Program
    later: Program

    @property
    def before(self) -> dict[str, int]:
        """Operations of each kernel alone, before the pass."""
        return _counts(self.earlier)

    @property
    def after(self) -> dict[str, int]:
        """Operations of each kernel alone, after the pass."""
        return _counts(self.later)


def run_passes(program: Program) -> tuple[Program, tuple[PassReport, ...]]:
    """Run every pass of the recipe.

    Returns
    -------
    program : Program
        The rewritten program.
    reports : tuple of PassReport
        One for each pass.
    """
    reports = []
    for name, transform in RECIPE:
        # Programs are immutable, so the report keeps both as they are.
        earlier, program = program, transform(program)
        reports.append(PassReport(name, earlier, program))
    return program, tuple(reports)


def _counts(program: Program) -> dict[str, int]:
    return {name: kernel.operations.total for name, kernel in program.kernels.items()}
