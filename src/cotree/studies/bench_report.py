"""Results of a bench, as a table, as JSON and as a plot."""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.files import atomic_write
from cotree.plot.figures import figure_for_people
from cotree.plot.result_figures import curve_colors, draw_grid
from cotree.report import Report, Reported, Table, json_values
from cotree.studies.accuracy import ERROR, OWN_ERROR, BenchRow, Reference, fastest

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


#: Errors for which methods are recommended.
TARGETS = (1e-3, 1e-6, 1e-9)

# Attributes of a row that are written to JSON in addition to its statistics.
_OF_ROW = (
    *("method", "rtol", "atol", "seconds", "least", "noise", "n_runs", "error_states"),
    *("error_sensitivities", "own_error_states", "own_error_sensitivities", "status", "message"),
    "substitute",
)


@dataclass(frozen=True, eq=False, repr=False)
class BenchReport(Reported):
    """Times and errors of methods on one scene.

    Attributes
    ----------
    scene : str
        Name of the scene.
    sensitivities : tuple of str
        Parameters and states with respect to which sensitivities are computed.
    n_states, n_points : int
        Number of states, and number of times at which errors are measured.
    t_end : float
        End of the runs, [s].
    repeats : int
        Maximum number of timed runs of a row.
    reference : Reference
        The reference solution for all errors.
    rows : tuple of BenchRow
        One row per method and tolerance.
    machine : mapping of str to str
        The machine and the versions of the software.
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

    def recommended(self, target: float) -> BenchRow | None:
        """Return the fastest row whose errors of states and sensitivities are at most ``target``.

        If several methods are equally fast, return the first in the table; :meth:`tied` returns
        all. Return None if no row has this accuracy, or if the reference is less accurate.
        """
        return next(iter(self.tied(target)), None)

    def tied(self, target: float) -> tuple[BenchRow, ...]:
        """Return the fastest rows whose errors are at most ``target``, one per method.

        Their times differ by less than the noise. If the reference is accurate enough, errors
        relative to the magnitude of each quantity must not exceed the target either.

        Parameters
        ----------
        target : float
            The error.
        """
        if self.reference.agreement > target:
            return ()
        judges_own = self.judges_own(target)
        # The comparison is also false if an error is nan.
        return fastest(
            row
            for row in self.rows
            if row.success
            and not row.substitute
            and row.n_runs
            and row.error <= target
            and (not judges_own or row.own_error <= target)
        )

    def judges_own(self, target: float) -> bool:
        """Return whether the reference is accurate enough for relative errors of ``target``."""
        return self.reference.own_agreement <= target

    def report(self) -> Report:
        """Return a report with the table and the recommended methods."""
        to = f", sensitivities to {', '.join(self.sensitivities)}" if self.sensitivities else ""
        m = self.machine
        versions = ("cotree", "SUNDIALS", "numpy", "scipy", "python")
        # Without sensitivities, their columns are omitted.
        errors = ["states", "own", "sensitivities", "own"][: 4 if self.sensitivities else 2]
        head = ["method", "rtol", "atol", "seconds", "spread", *errors, "steps", "evaluations", ""]
        caption = "recommended, the fastest whose error is at most (least times)"
        return Report(
            f"{self.scene}: {self.n_states} states{to}, t = 0 to {self.t_end:g} s",
            f"reference: {self.reference.summary()}",
            f"error: {ERROR} over {self.n_points} points; own: {OWN_ERROR}",
            f"seconds: medians of at most {self.repeats} runs, all methods in turn; spread: of "
            "the median above the minimum",
            f"machine: {m['processor']}, {m['processors']} cores, load {m['load_at_start']} at the "
            f"start and {m['load_at_end']} at the end; compiler: {m['compiler']}",
            "versions: " + ", ".join(f"{name} {m[name.lower()]}" for name in versions),
            Table(
                head,
                [self._cells(row) for row in self.rows],
                align=f"l{'r' * (len(head) - 2)}l",
                most=60,
            ),
            Table((), [*self._recommendations()], caption),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return all data except the trajectories as JSON-compatible values."""
        pair = self.reference
        found: dict[str, Any] = json_values(
            {
                "scene": self.scene,
                "sensitivities": list(self.sensitivities),
                "n_states": self.n_states,
                "n_points": self.n_points,
                "t_end": self.t_end,
                "repeats": self.repeats,
                "error": ERROR,
                "own_error": OWN_ERROR,
                "machine": dict(self.machine),
                "reference": {
                    "method": pair.solution.method,
                    "rtol": pair.solution.rtol,
                    "confirmed_by": pair.other.method,
                    "confirmed_at_rtol": pair.other.rtol,
                    "agreement_states": pair.agreement_states,
                    "agreement_sensitivities": pair.agreement_sensitivities,
                    "own_agreement": pair.own_agreement,
                },
                "rows": [
                    {
                        **{name: getattr(row, name) for name in _OF_ROW},
                        "statistics": row.statistics and dataclasses.asdict(row.statistics),
                    }
                    for row in self.rows
                ],
                "recommended": {
                    f"{target:.0e}": _advice(self.tied(target), self.judges_own(target))
                    for target in TARGETS
                },
            }
        )
        return found

    def to_json(self, path: str | os.PathLike[str]) -> None:
        """Write the result of ``to_dict()`` to a file; raise SceneError if that fails."""
        with atomic_write(path) as draft:
            draft.write_text(json.dumps(self.to_dict(), indent=1) + "\n", encoding="utf-8")

    def plot(self) -> Any:
        """Plot elapsed time over error, with one curve per method."""
        return plot_bench(self)

    def _cells(self, row: BenchRow) -> list[str]:
        pair, work = self.reference, row.statistics
        cells = [row.method, f"{row.rtol:.0e}", f"{row.atol:.0e}"]
        is_timed = row.success and row.n_runs > 0
        cells.append(f"{row.seconds:.3g}" if is_timed else "-")
        cells.append(f"{row.spread:.0%}" if is_timed else "-")
        own = pair.own_distance(pair.other)
        cells.append(_shown(row.error_states, pair.agreement_states))
        cells.append(_shown(row.own_error_states, own[0]))
        if self.sensitivities:
            cells.append(_shown(row.error_sensitivities, pair.agreement_sensitivities))
            cells.append(_shown(row.own_error_sensitivities, own[1]))
        counts = ["-", "-"] if work is None else [f"{work.n_steps}", f"{work.nfev}"]
        return [*cells, *counts, row.note]

    def _recommendations(self) -> Iterator[tuple[str, str]]:
        for target in TARGETS:
            tied = self.tied(target)
            texts = [
                f"{row.method} at rtol {row.rtol:.0e}, atol {row.atol:.0e}: {row.least:.3g} s"
                for row in tied
            ]
            if len(tied) > 1:
                texts[-1] += ", within noise of each other"
            if tied and not self.judges_own(target):
                texts.append("(small quantities are not judged by their own size here)")
            if not tied:
                known = self.reference.agreement
                of_it = f"unknown: the reference is accurate only to {known:.1e}"
                texts = ["none of these" if known <= target else of_it]
            for i, line in enumerate(texts):
                yield f"{target:.0e}" if i == 0 else "tie" if i < len(tied) else "", line


def _shown(error: float, agreement: float) -> str:
    """Return an error as text, or its upper bound if the reference is not accurate enough."""
    if math.isnan(error):
        return "-"
    return f"< {agreement:.1e}" if error < agreement else f"{error:.1e}"


def _advice(tied: tuple[BenchRow, ...], judges_own: bool) -> dict[str, Any] | None:
    if not tied:
        return None
    first, *others = ({"method": row.method, "rtol": row.rtol} for row in tied)
    return {**first, "tied": others, "judged_by_own_size": judges_own}


_MARKERS = "osD^v<>Ph*X"


def plot_bench(report: BenchReport) -> Figure:
    """Plot time over errors; open markers are errors below the accuracy of the reference."""
    sensitivities, rows, reference = report.sensitivities, report.rows, report.reference
    panels: list[tuple[str, Callable[[BenchRow], float], float]] = [
        ("states", lambda row: row.error_states, reference.agreement_states)
    ]
    if sensitivities:
        to = ", ".join(sensitivities[:3]) + (", …" if len(sensitivities) > 3 else "")
        panels.append(
            (
                f"sensitivities to {to}",
                lambda row: row.error_sensitivities,
                reference.agreement_sensitivities,
            )
        )
    figure = figure_for_people(1.6 + 4.8 * len(panels), 4.4)
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for ax, (what, error, agreement) in zip(axes, panels, strict=True):
        _draw_methods(ax, rows, error, agreement)
        _finish(ax, f"error of {what}", agreement)
    axes[0].set_ylabel("seconds of a run", fontsize=11)
    if axes[-1].get_legend_handles_labels()[1]:
        axes[-1].legend(loc="center left", bbox_to_anchor=(1, 0.5), frameon=False, fontsize=9)
    figure.suptitle(report.scene, fontsize=11)
    return figure


def _draw_methods(
    ax: Axes, rows: Sequence[BenchRow], error: Callable[[BenchRow], float], agreement: float
) -> None:
    methods = list(dict.fromkeys(row.method for row in rows))
    for k, (method, color) in enumerate(zip(methods, curve_colors(len(methods)), strict=True)):
        # error, elapsed time, and whether the error is below the accuracy of the reference
        found = [
            (max(error(row), agreement), row.seconds, error(row) < agreement)
            for row in rows
            if row.method == method and math.isfinite(error(row)) and math.isfinite(row.seconds)
        ]
        style: dict[str, Any] = {"color": color, "marker": _MARKERS[k % len(_MARKERS)], "ms": 5}
        # Methods without points also have an entry in the legend.
        label = method if found else f"{method}: no run"
        ax.plot([x for x, _, _ in found], [y for _, y, _ in found], lw=1.4, label=label, **style)
        hidden = [(x, y) for x, y, is_below in found if is_below]
        ax.plot([x for x, _ in hidden], [y for _, y in hidden], ls="none", mfc="white", **style)


def _finish(ax: Axes, label: str, agreement: float) -> None:
    ax.set_xscale("log")
    ax.set_yscale("log")
    if ax.get_legend_handles_labels()[1] and agreement > 0.0:
        # Read the axis limits before the grey region extends them.
        left, right = ax.get_xlim()
        ax.axvspan(min(left, 0.3 * agreement), agreement, color="0.92", zorder=0)
        ax.set_xlim(min(left, 0.3 * agreement), right)
    # Errors decrease to the right, as is usual in work-precision diagrams.
    ax.invert_xaxis()
    ax.set_xlabel(label, fontsize=11)
    draw_grid(ax)
