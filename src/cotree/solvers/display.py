"""A result as people see it in a notebook: what came out, and how it went."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.markup import block, paragraph, table

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cotree.solvers.result import RunRecord


def result_html(result: RunRecord) -> str:
    """Show the end, least and largest value of each column, the events and the work."""
    work = result.statistics
    n = (len(result.states) + len(result.outputs)) * (1 + len(result.parameters_of_sensitivity))
    span = f", t = {result.t[0]:.6g} to {result.t[-1]:.6g} s" if result.t.size else ""
    events = [
        (name, len(row.t), float(row.t[-1]) if row.t.size else "never")
        for name, row in result.events.items()
    ]
    return block(
        f"Result: {len(result.states)} states at {len(result.t)} times{span}",
        paragraph(("" if result.success else "The run failed. ") + result.message),
        table(
            "",
            ["", "unit", "start", "end", "least", "largest"],
            _rows(result),
            n_rows=n + len(result.inputs) if result.t.size else 0,
        ),
        table("events", ["name", "times", "last [s]"], events, n_rows=len(events)),
        paragraph(
            f"{work.method}: {work.n_steps} steps, {work.nfev} evaluations, {work.njev} Jacobians",
            muted=True,
        ),
    )


def _rows(result: RunRecord) -> Iterator[tuple[object, ...]]:
    """Return a row for each column of the result, the sensitivities last."""
    for name in (*result.states, *result.outputs, *result.inputs):
        yield _row(name, result.unit(name), result[name])
    for name in (*result.states, *result.outputs):
        for to in result.parameters_of_sensitivity:
            yield _row(f"∂ {name} / ∂ {to}", "", result.sensitivity(name, to))


def _row(title: str, unit: str, values: np.ndarray) -> tuple[object, ...]:
    # Sensitivities of reactions that are not unique are nan throughout.
    is_known = bool(np.any(np.isfinite(values)))
    low, high = (np.nanmin(values), np.nanmax(values)) if is_known else (np.nan, np.nan)
    return (title, unit, *map(float, (values[0], values[-1], low, high)))
