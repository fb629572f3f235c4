"""The passes, in order, and what each did to the operation counts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.passes.reciprocals import share_reciprocals
from cotree.passes.stage import stage_parameters

if TYPE_CHECKING:
    from cotree.program import Program

#: Each pass with its name, in the order they run.
RECIPE: tuple[tuple[str, Callable[[Program], Program]], ...] = (
    ("reciprocals", share_reciprocals),
    ("stage", stage_parameters),
)


@dataclass(frozen=True)
class PassReport:
    """What a pass did: operations of each kernel alone, before and after."""

    name: str
    before: dict[str, int]
    after: dict[str, int]


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
    before = _counts(program)
    for name, transform in RECIPE:
        program = transform(program)
        after = _counts(program)
        reports.append(PassReport(name, before, after))
        before = after
    return program, tuple(reports)


def _counts(program: Program) -> dict[str, int]:
    return {name: kernel.operations.total for name, kernel in program.kernels.items()}
