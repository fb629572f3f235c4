"""Reports of studies as people see them in a notebook."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.markup import block, paragraph, preformatted, table

if TYPE_CHECKING:
    from cotree.studies.accuracy import BenchRow
    from cotree.studies.bench_report import BenchReport
    from cotree.studies.check import CheckReport

_HEAD = ("parameter", "value", "closest", "deviation", "allowed", "verdict")


def check_html(report: CheckReport) -> str:
    """Show the verdict on each parameter of a check."""
    rows = [
        (
            *(row.name, row.value, row.closest, row.deviation, row.tolerance),
            "PASS" if row.passed else f"FAIL {row.note}".strip(),
        )
        for row in report.rows
    ]
    return block(
        report.verdict, paragraph(report.heading), table("", _HEAD, rows, n_rows=len(rows))
    )


def bench_html(report: BenchReport) -> str:
    """Show a row for each run of a bench, then the recommendations as they are printed."""
    rows = [
        (
            *(row.method, f"{row.rtol:.0e}", f"{row.atol:.0e}"),
            row.seconds if row.success and row.n_runs else "-",
            *(float(f"{x:.2g}") for x in _errors(row)),
            *(("-", "-") if not (work := row.statistics) else (work.n_steps, work.nfev)),
            row.note,
        )
        for row in report.rows
    ]
    head = ["method", "rtol", "atol", "seconds", "error of states", "own"]
    head += ["of sensitivities", "own", "steps", "evaluations", ""]
    # The text ends with what is recommended, after an empty line.
    before, _, advice = report.summary().rpartition("\n\n")
    return block(
        f"Bench of {report.scene}",
        preformatted(before.partition("\n\n")[0]),
        table("", head, rows, n_rows=len(rows), most=60),
        preformatted(advice),
    )


def _errors(row: BenchRow) -> tuple[float, ...]:
    """Return errors in the order of the table's columns."""
    return (
        *(row.error_states, row.own_error_states),
        *(row.error_sensitivities, row.own_error_sensitivities),
    )
