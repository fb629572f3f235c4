"""Linear systems of members that run side by side in the lanes of vectors.

In: a program after its passes. Out: the kernels of derivatives that a Rosenbrock method reads, and
its elimination as statements of vectors: those of the scalar engine, each with a member in a lane.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING

from cotree.codegen.newton import elimination_context
from cotree.codegen.printing import int_table
from cotree.codegen.targets import MEMBERS
from cotree.passes.curvature import form_curvature
from cotree.passes.time_slope import form_time_slope

if TYPE_CHECKING:
    from collections.abc import Iterable

    from cotree.codegen.newton import EliminationContext
    from cotree.codegen.printing import Constants
    from cotree.program import Kernel, Layout, Program


@dataclass(frozen=True)
class StiffLanes:
    """Data of the template.

    Attributes
    ----------
    elimination : EliminationContext
        The factors of ``shift - J`` and solutions with them.
    n_values : int
        Nonzeros of J.
    n_carried, n_couplings : int
        Values of the two kernels of second derivatives; zero where there are none.
    has_slope : bool
        Whether rates change with time, so that there is a kernel of these derivatives.
    is_whole : bool
        Whether no sensitivity vanishes.
    tables : list of Constants
        The pattern of J by rows, and of the sensitivities.
    """

    elimination: EliminationContext
    n_values: int
    n_carried: int
    n_couplings: int
    has_slope: bool
    is_whole: bool
    tables: list[Constants]

    @property
    def text(self) -> list[str]:
        """Its lines, for the digest of a file."""
        tables = [*self.elimination.tables, *self.tables]
        lines = [line for table in tables for line in table.lines]
        return [*self.elimination.factor.text, *self.elimination.solve.text, *lines]


def form_stiff(program: Program, *, has_sensitivities: bool) -> tuple[StiffLanes, list[Kernel]]:
    """Form what a Rosenbrock method needs besides the rates.

    Parameters
    ----------
    program : Program
        After its passes, one without algebraic unknowns.
    has_sensitivities : bool
        Whether sensitivities are integrated.

    Returns
    -------
    stiff : StiffLanes
        Data of the template.
    kernels : list of Kernel
        Derivatives of the rates, which are still to be printed.
    """
    layout, plan = program.layout, program.elimination
    assert plan is not None  # the shift is on all of the diagonal
    slope = form_time_slope(program)
    if slope is not None and not has_sensitivities:
        slope = replace(slope, results=slope.results[: len(layout.states)])
    curvature = form_curvature(program) if has_sensitivities else None
    kernels = [program.kernels["jacobian"]]
    kernels += [slope] if slope is not None else []
    kernels += [curvature.at, curvature.along] if curvature is not None else []
    couplings = () if curvature is None else curvature.places
    tables = [*_rows_of(layout)]
    if couplings:
        tables.append(int_table("couplings", couplings))
    widths = {b - a for a, b in pairwise(layout.sensitivity_starts)} if has_sensitivities else set()
    is_whole = widths <= {len(layout.states)}
    if not is_whole:
        tables.append(int_table("sensitivity_starts", layout.sensitivity_starts))
        tables.append(int_table("sensitivity_rows", layout.sensitivity_rows))
    stiff = StiffLanes(
        elimination=elimination_context(plan, MEMBERS),
        n_values=len(layout.row_indices),
        n_carried=0 if curvature is None else len(curvature.at.results),
        n_couplings=len(couplings),
        has_slope=slope is not None,
        is_whole=is_whole,
        tables=tables,
    )
    return stiff, kernels


def _rows_of(layout: Layout) -> Iterable[Constants]:
    """List where rows of the Jacobian begin, and places and columns of their values."""
    entries: list[tuple[int, int, int]] = []
    for column, (first, last) in enumerate(pairwise(layout.column_starts)):
        entries += [(layout.row_indices[at], at, column) for at in range(first, last)]
    entries.sort()
    lengths = Counter(row for row, _, _ in entries)
    rows = range(len(layout.states))
    yield int_table("row_starts", [*accumulate((lengths[row] for row in rows), initial=0)])
    yield int_table("row_values", [at for _, at, _ in entries])
    yield int_table("row_columns", [column for _, _, column in entries])
