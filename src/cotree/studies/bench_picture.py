"""Plot of time over error, with a curve over the tolerances for each method."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from cotree.plot.figures import figure_for_people
from cotree.plot.result import curve_colors, draw_grid

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from cotree.studies.accuracy import BenchRow
    from cotree.studies.bench_report import BenchReport

_MARKERS = "osD^v<>Ph*X"


def plot_bench(report: BenchReport) -> Figure:
    """Plot seconds over error, of states and of sensitivities.

    Errors below the accuracy of the reference are open markers at the border of a grey region. Rows
    without a time or an error are left out.
    """
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
    ax: Axes,
    rows: Sequence[BenchRow],
    error: Callable[[BenchRow], float],
    agreement: float,
) -> None:
    methods = list(dict.fromkeys(row.method for row in rows))
    for k, (method, color) in enumerate(zip(methods, curve_colors(len(methods)), strict=True)):
        # Error, time, and whether the error is below the accuracy of the reference.
        found = [
            (max(error(row), agreement), row.seconds, error(row) < agreement)
            for row in rows
            if row.method == method and math.isfinite(error(row)) and math.isfinite(row.seconds)
        ]
        style: dict[str, Any] = {"color": color, "marker": _MARKERS[k % len(_MARKERS)], "ms": 5}
        # A method without points has an entry in the legend, too.
        label = method if found else f"{method}: no run"
        ax.plot([x for x, _, _ in found], [y for _, y, _ in found], lw=1.4, label=label, **style)
        hidden = [(x, y) for x, y, is_below in found if is_below]
        ax.plot([x for x, _ in hidden], [y for _, y in hidden], ls="none", mfc="white", **style)


def _finish(ax: Axes, label: str, agreement: float) -> None:
    ax.set_xscale("log")
    ax.set_yscale("log")
    if ax.get_legend_handles_labels()[1] and agreement > 0.0:
        # The span would widen the limits, so these are read before.
        left, right = ax.get_xlim()
        ax.axvspan(min(left, 0.3 * agreement), agreement, color="0.92", zorder=0)
        ax.set_xlim(min(left, 0.3 * agreement), right)
    # As in work-precision diagrams, errors decrease to the right.
    ax.invert_xaxis()
    ax.set_xlabel(label, fontsize=11)
    draw_grid(ax)
