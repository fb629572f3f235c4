"""Tables of a long elimination, over which loops in C run.

In: a plan. Out: the numbers of the tables. Factors are stored row by row in the order of the
pivots, and each row in the order of its columns, so that an update of one row by another touches a
few runs of consecutive entries, which C can vectorise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.codegen.printing import int_table

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cotree.codegen.printing import Constants
    from cotree.linear.plan import Elimination


def elimination_tables(plan: Elimination) -> list[Constants]:
    """List the tables that the factorisation and the solution in C read.

    Parameters
    ----------
    plan : Elimination
        The plan; C forms its products in the same order.

    Returns
    -------
    list of Constants
        ``factor_values``: the place of each factor among the nonzeros, or -1. ``factor_columns``:
        the rank of its column. ``pivot_rows``: for each pivot its row, its column, the numbers of
        factors before and after it in the row, and whether the shift is added. ``updates``: for
        each pivot the number of rows that it updates, and for each of these rows the place of the
        multiplier and the number of runs; for each run its destination, source and length.
    """
    ranks = _ranks(plan)
    starts = [0]
    for row in ranks:
        starts.append(starts[-1] + len(row))
    place = {(k, j): starts[k] + at for k, row in enumerate(ranks) for at, j in enumerate(row)}
    # The plan numbers factors in another order.
    number = {(k, k): factor for k, factor in enumerate(plan.pivots)}
    for k in range(len(plan.rows)):
        number |= {(k, j): factor for j, factor in (*plan.lower[k], *plan.upper[k])}
    steps = [plan.factors[number[k, j]] for k, row in enumerate(ranks) for j in row]
    pivots = [
        entry
        for k, (row, column) in enumerate(zip(plan.rows, plan.columns, strict=True))
        for entry in (
            row,
            column,
            len(plan.lower[k]),
            len(plan.upper[k]),
            int(plan.factors[plan.pivots[k]].has_shift),
        )
    ]
    return [
        int_table("factor_values", [step.value for step in steps]),
        int_table("factor_columns", [j for row in ranks for j in row]),
        int_table("pivot_rows", pivots),
        int_table("updates", list(_updates(plan, place))),
    ]


def _ranks(plan: Elimination) -> list[list[int]]:
    """Give the columns of each row's factors, by the ranks of their pivots."""
    return [
        [*(m for m, _ in before), k, *(j for j, _ in after)]
        for k, (before, after) in enumerate(zip(plan.lower, plan.upper, strict=True))
    ]


def _updates(plan: Elimination, place: dict[tuple[int, int], int]) -> Iterator[int]:
    below: list[list[int]] = [[] for _ in plan.rows]
    for k, before in enumerate(plan.lower):
        for m, _ in before:
            below[m].append(k)
    for m, rows in enumerate(below):
        yield len(rows)
        columns = [j for j, _ in plan.upper[m]]
        for k in rows:
            runs = _runs([(place[k, j], place[m, j]) for j in columns])
            yield place[k, m]
            yield len(runs)
            for run in runs:
                yield from run


def _runs(pairs: Sequence[tuple[int, int]]) -> list[tuple[int, int, int]]:
    """Join consecutive pairs of places into runs: destination, source and length."""
    runs: list[tuple[int, int, int]] = []
    for to, source in pairs:
        if runs:
            first_to, first, length = runs[-1]
            if (to, source) == (first_to + length, first + length):
                runs[-1] = (first_to, first, length + 1)
                continue
        runs.append((to, source, 1))
    return runs
