"""The outcome of a bench: rows of methods and tolerances, as a table and as JSON."""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.files import written_whole
from cotree.studies.accuracy import ERROR
from cotree.studies.display import bench_html

if TYPE_CHECKING:
    import os
    from collections.abc import Mapping

    from cotree.studies.accuracy import Reference
    from cotree.studies.bench_row import BenchRow

#: Errors that methods are recommended for.
TARGETS = (1e-3, 1e-6, 1e-9)


@dataclass(frozen=True, eq=False, repr=False)
class BenchReport:
    """Speed against error of methods on one scene.

    Attributes
    ----------
    scene : str
        Its name.
    sensitivities : tuple of str
        Parameters and states that sensitivities are taken to.
    n_states, n_points : int
        Number of states, and of points that errors are taken over.
    t_end : float
        End of the runs, [s].
    repeats : int
        The most runs that a time is the median of.
    reference : Reference
        The reference of all errors.
    rows : tuple of BenchRow
        A row for each method and tolerance.
    machine : mapping of str to str
        The machine and the software that times were taken with.
    """

    scene: str
    sensitivities: tuple[str, ...]
    n_states: int
    n_points: int
    t_end: float
    repeats: int
    reference: Reference
    rows: tuple[BenchRow, ...]
    machine: Mapping[str, str]

    def __repr__(self) -> str:
        return f"<BenchReport of {self.scene}: {len(self.rows)} runs; print(report) for the table>"

    def __str__(self) -> str:
        """Give the table and the recommendations."""
        return self.summary()

    def _repr_html_(self) -> str:
        """Show the table and the recommendations in a notebook."""
        return bench_html(self)

    def recommended(self, target: float) -> BenchRow | None:
        """Give the fastest run whose error, of states and sensitivities, is at most ``target``.

        None where there is none, or where the reference itself is not known that well.
        """
        if self.reference.agreement > target:
            return None
        # An error of nan, where there is nothing to compare, fails this test, too.
        able = [row for row in self.rows if row.success and row.error <= target]
        return min(able, key=lambda row: row.seconds, default=None)

    def summary(self) -> str:
        """Give the table, then the recommended methods."""
        to = f", sensitivities to {', '.join(self.sensitivities)}" if self.sensitivities else ""
        head = [
            f"{self.scene}: {self.n_states} states{to}, t = 0 to {self.t_end:g} s",
            f"reference: {self.reference.summary()}",
            f"error: {ERROR} over {self.n_points} points",
            f"seconds: medians of {self.repeats} runs at most, all methods in turn",
            "",
        ]
        return "\n".join([*head, *self._table(), "", *self._recommendations()])

    def to_dict(self) -> dict[str, Any]:
        """Give everything but the trajectories as numbers, texts, lists and dicts for JSON."""
        pair = self.reference
        return {
            "scene": self.scene,
            "sensitivities": list(self.sensitivities),
            "n_states": self.n_states,
            "n_points": self.n_points,
            "t_end": self.t_end,
            "repeats": self.repeats,
            "error": ERROR,
            "machine": dict(self.machine),
            "reference": {
                "method": pair.solution.method,
                "rtol": pair.solution.rtol,
                "confirmed_by": pair.other.method,
                "confirmed_at_rtol": pair.other.rtol,
                "agreement_states": _number(pair.agreement_states),
                "agreement_sensitivities": _number(pair.agreement_sensitivities),
            },
            "rows": [_row_dict(row) for row in self.rows],
            "recommended": {
                f"{target:.0e}": None if row is None else {"method": row.method, "rtol": row.rtol}
                for target in TARGETS
                # A list of one gives the row a name inside the comprehension.
                for row in [self.recommended(target)]
            },
        }

    def to_json(self, path: str | os.PathLike[str]) -> None:
        """Write ``to_dict()``, whole or not at all.

        Raises
        ------
        SceneError
            If the file cannot be written.
        """
        with written_whole(path) as draft:
            draft.write_text(json.dumps(self.to_dict(), indent=1) + "\n", encoding="utf-8")

    def plot(self) -> Any:
        """Draw time over error, for ``plt.show()``, too; see ``cotree.studies.bench_picture``."""
        from cotree.plot.known import figure_for_people
        from cotree.studies.bench_picture import plot_bench

        parts = self.scene, self.sensitivities, self.rows, self.reference
        return plot_bench(*parts, make=figure_for_people)

    def _table(self) -> list[str]:
        with_sensitivities = bool(self.sensitivities)
        # Without sensitivities their column is left out.
        errors = ["states", "sensitivities"][: 1 + with_sensitivities]
        table = [["method", "rtol", "atol", "seconds", *errors, "steps", "evaluations"]]
        notes = [""]
        for row in self.rows:
            table.append(self._cells(row))
            notes.append("" if row.success else f"  {row.message}")
        # Messages stand behind the columns and widen none.
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        return [
            (
                "  ".join(
                    [cells[0].ljust(widths[0])]
                    + [cell.rjust(width) for cell, width in zip(cells[1:], widths[1:], strict=True)]
                )
                + note
            ).rstrip()
            for cells, note in zip(table, notes, strict=True)
        ]

    def _cells(self, row: BenchRow) -> list[str]:
        pair, work = self.reference, row.statistics
        cells = [row.method, f"{row.rtol:.0e}", f"{row.atol:.0e}"]
        cells.append(f"{row.seconds:.3g}" if row.success else "-")
        cells.append(_shown(row.error_states, pair.agreement_states))
        if self.sensitivities:
            cells.append(_shown(row.error_sensitivities, pair.agreement_sensitivities))
        return (
            [*cells, *("-", "-")] if work is None else [*cells, f"{work.n_steps}", f"{work.nfev}"]
        )

    def _recommendations(self) -> list[str]:
        lines = ["recommended, the fastest whose error is at most"]
        for target in TARGETS:
            row = self.recommended(target)
            if row is not None:
                said = (
                    f"{row.method} at rtol {row.rtol:.0e}, atol {row.atol:.0e}: {row.seconds:.3g} s"
                )
            elif self.reference.agreement > target:
                said = f"not known: the reference is good to {self.reference.agreement:.1e} only"
            else:
                said = "none of these"
            lines.append(f"  {target:.0e}  {said}")
        return lines


def _shown(error: float, agreement: float) -> str:
    """Write an error, or the bound that is known of it."""
    if math.isnan(error):
        return "-"
    # Below the agreement of both references an error cannot be told from theirs.
    return f"< {agreement:.1e}" if error < agreement else f"{error:.1e}"


def _row_dict(row: BenchRow) -> dict[str, Any]:
    fields = {key: value for key, value in vars(row).items() if key != "statistics"}
    numbers = {k: _number(v) if isinstance(v, float) else v for k, v in fields.items()}
    work = None if row.statistics is None else dataclasses.asdict(row.statistics)
    return {**numbers, "statistics": work}


def _number(value: float) -> float | None:
    """Turn a number that is not finite into null, for JSON."""
    return value if math.isfinite(value) else None
