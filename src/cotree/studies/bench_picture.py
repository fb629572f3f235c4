"""Time over error of methods, a curve for each over its tolerances.

In: the report of a bench. Out: a matplotlib `Figure`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from cotree.plot.result import curve_colors, draw_grid, new_figure

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from cotree.studies.accuracy import BenchRow, Reference

_MARKERS = "osD^v<>Ph*X"


def plot_bench(
    scene: str,
    sensitivities: Sequence[str],
    rows: Sequence[BenchRow],
    reference: Reference,
    make: Callable[[float, float], Figure] = new_figure,
) -> Figure:
    """Plot seconds over error, of states and beside them of sensitivities.

    Errors that the reference cannot tell lie in grey, with open markers at its border; rows without
    a time or an error are left out. ``make`` makes a figure of a width and a height, [in].
    """
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
    # Panels share the axis of seconds, so a method stands at the same height in both.
    figure = make(1.6 + 4.8 * len(panels), 4.4)
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for ax, (what, error, agreement) in zip(axes, panels, strict=True):
        _draw_methods(ax, rows, error, agreement)
        _finish(ax, f"error of {what}", agreement)
    axes[0].set_ylabel("seconds of a run", fontsize=11)
    if axes[-1].get_legend_handles_labels()[1]:
        axes[-1].legend(loc="center left", bbox_to_anchor=(1, 0.5), frameon=False, fontsize=9)
    figure.suptitle(scene, fontsize=11)
    return figure


def _draw_methods(
    ax: Axes,
    rows: Sequence[BenchRow],
    error: Callable[[BenchRow], float],
    agreement: float,
) -> None:
    methods = list(dict.fromkeys(row.method for row in rows))
    for k, (method, color) in enumerate(zip(methods, curve_colors(len(methods)), strict=True)):
        found = [
            # Errors that cannot be told are drawn at the border of what can be.
            (max(error(row), agreement), row.seconds, error(row) < agreement)
            for row in rows
            if row.method == method and math.isfinite(error(row)) and math.isfinite(row.seconds)
        ]
        marker = _MARKERS[k % len(_MARKERS)]
        # A method that never gave a point keeps its place in the legend and its colour.
        ax.plot(
            [x for x, _, _ in found],
            [seconds for _, seconds, _ in found],
            color=color,
            lw=1.4,
            label=method if found else f"{method}: no run",
            marker="none" if not found else marker,
            ms=5,
        )
        # A second set of open markers on top of the curve's own.
        hidden = [(x, seconds) for x, seconds, is_below in found if is_below]
        ax.plot(
            [x for x, _ in hidden],
            [seconds for _, seconds in hidden],
            color=color,
            ls="none",
            marker=marker,
            ms=5,
            mfc="white",
        )


def _finish(ax: Axes, label: str, agreement: float) -> None:
    ax.set_xscale("log")
    ax.set_yscale("log")
    if ax.get_legend_handles_labels()[1] and agreement > 0.0:
        # Limits are read before the span is drawn, which would widen them.
        left, right = ax.get_xlim()
        ax.axvspan(min(left, 0.3 * agreement), agreement, color="0.92", zorder=0)
        ax.set_xlim(min(left, 0.3 * agreement), right)
    # Small errors to the right, as in diagrams of work and precision.
    ax.invert_xaxis()
    ax.set_xlabel(label, fontsize=11)
    draw_grid(ax)
