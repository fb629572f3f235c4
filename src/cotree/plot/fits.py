"""Figures of fits: measured and computed values, residuals, starts, profiles and correlations."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from cotree.plot.figures import figure_for_people
from cotree.plot.result_figures import curve_colors, draw_grid, panels

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from cotree.plot.graph import Array

# Number of panels in a row; colours of measured values, computed values and limits.
_COLUMNS = 3
_DATA, _CURVE, _LIMIT = "0.35", "C0", "C3"


@dataclass(frozen=True, eq=False)
class Course:
    """The curve of one quantity over time, with its confidence band and its measured values."""

    title: str  # name of the experiment
    band: Any  # confidence band, see :class:`cotree.estimation.bands.Band`
    #: Times, measured values and their standard deviations.
    t_measured: Array | None = None
    measured: Array | None = None
    sigma: Array | None = None


@dataclass(frozen=True, eq=False)
class ResidualSeries:
    """Residuals of one quantity in one experiment, in standard deviations."""

    name: str  # name of the quantity, then of the experiment
    #: Times, [s], residuals, measured and computed values on the scale on which they are compared.
    t: Array
    values: Array
    measured: Array
    computed: Array


def draw_courses(courses: Sequence[Course], *, ax: Axes | None = None) -> Figure:
    """Draw quantities over time with confidence bands and measured values, each in a panel."""
    if ax is not None:
        draw_course(ax, courses[0])
        return cast("Figure", ax.figure)
    figure, places = _panels(len(courses))
    for where, course in zip(places, courses, strict=True):
        draw_course(where, course)
    return figure


def draw_course(ax: Axes, course: Course) -> None:
    """Draw one quantity over time with its confidence band and measured values."""
    band = course.band
    is_known = np.isfinite(band.lower) & np.isfinite(band.upper)
    if course.measured is not None and course.t_measured is not None:
        if course.sigma is not None and len(course.measured) <= 60:
            bars: Any = {"fmt": "o", "ms": 3, "color": _DATA, "elinewidth": 0.8, "zorder": 1}
            ax.errorbar(course.t_measured, course.measured, course.sigma, label="measured", **bars)
        else:
            ax.plot(course.t_measured, course.measured, ".", ms=3, color=_DATA, label="measured")
    label = f"{100 * band.level:g} % band"
    if is_known.any():
        style: dict[str, Any] = {"color": _CURVE, "alpha": 0.25, "lw": 0.0, "zorder": 2}
        known = is_known.tolist()
        ax.fill_between(band.t, band.lower, band.upper, where=known, label=label, **style)
    ax.plot(band.t, band.value, color=_CURVE, lw=1.6, label="computed", zorder=3)
    # If the band is much wider than the data, the data determine the limits.
    shown = [band.value] + ([] if course.measured is None else [course.measured])
    low, high = (f([float(f(np.asarray(x))) for x in shown]) for f in (min, max))
    room = 0.6 * ((high - low) or abs(high) or 1.0)
    ax.set_ylim(max(ax.get_ylim()[0], low - room), min(ax.get_ylim()[1], high + room))
    _label(ax, "time [s]", f"{band.name} {_bracketed(band.unit)}".strip(), course.title)
    ax.legend(fontsize=8, frameon=False)


def draw_residuals(parts: Sequence[ResidualSeries]) -> Figure:
    """Draw residuals over time, measured against computed values, and a normal probability plot."""
    figure = figure_for_people(12.0, 3.8)
    over, against, normal = figure.subplots(1, 3)
    draw_residuals_over_time(over, parts)
    draw_observed(against, parts)
    draw_normal(normal, parts)
    return figure


def draw_residuals_over_time(ax: Axes, parts: Sequence[ResidualSeries]) -> None:
    """Draw residuals over time, in standard deviations."""
    ax.axhspan(-1.96, 1.96, color="0.93", lw=0.0, zorder=0)
    ax.axhline(0.0, color="0.5", lw=0.8)
    for part, color in zip(parts, curve_colors(len(parts)), strict=True):
        ax.plot(part.t, part.values, "o", ms=3, color=color, label=part.name)
    _label(ax, "time [s]", "residual / standard deviation", "residuals")
    if 1 < len(parts) <= 8:
        below: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.2), "ncols": 2}
        ax.legend(fontsize=7, frameon=False, markerscale=1.3, **below)


def draw_observed(ax: Axes, parts: Sequence[ResidualSeries]) -> None:
    """Draw measured against computed values, each quantity scaled to its range."""
    is_one = len({part.name.split(" · ")[0] for part in parts}) == 1
    for part, color in zip(parts, curve_colors(len(parts)), strict=True):
        low, high = (0.0, 1.0) if is_one else (part.measured.min(), part.measured.max())
        width = (high - low) or 1.0
        x, y = (part.computed - low) / width, (part.measured - low) / width
        ax.plot(x, y, "o", ms=3, color=color, label=part.name)
    ends = [max(ax.get_xlim()[0], ax.get_ylim()[0]), min(ax.get_xlim()[1], ax.get_ylim()[1])]
    ax.plot(ends, ends, color="0.5", lw=0.8, zorder=0)
    scaled = "" if is_one else ", each over its range"
    _label(ax, f"computed{scaled}", f"measured{scaled}", "measured against computed")


def draw_normal(ax: Axes, parts: Sequence[ResidualSeries]) -> None:
    """Draw ordered residuals against quantiles of a normal distribution."""
    from scipy import special

    values = np.sort(np.concatenate([part.values for part in parts]))
    n = len(values)
    # Approximate means of the order statistics of a normal distribution (Blom 1958).
    expected = special.ndtri((np.arange(1, n + 1) - 0.375) / (n + 0.25))
    ax.plot(expected, values, "o", ms=3, color=_CURVE)
    ax.plot(expected[[0, -1]], expected[[0, -1]], color="0.5", lw=0.8, zorder=0)
    _label(ax, "normal quantile", "ordered residual", "normal probability plot")


def draw_waterfall(starts: Sequence[Any], ax: Axes | None = None) -> Figure:
    """Draw the objectives reached from all starting points, in ascending order."""
    from matplotlib.ticker import MaxNLocator

    if ax is None:
        figure = figure_for_people(5.2, 3.8)
        ax = figure.subplots()
    ended = [row for row in starts if math.isfinite(row.objective)]
    above = np.array([row.objective - starts[0].objective for row in ended])
    rank, done = np.arange(1, len(above) + 1), np.array([row.is_converged for row in ended], bool)
    style: dict[str, Any] = {"ls": "none", "ms": 5}
    if done.any():
        ax.plot(rank[done], above[done], marker="o", color=_CURVE, label="converged", **style)
    if not done.all():
        ax.plot(rank[~done], above[~done], marker="o", mfc="none", color=_LIMIT,
                label="not converged", **style)  # fmt: skip
    # The scale is linear below a hundredth, where differences are not significant.
    ax.set_yscale("symlog", linthresh=1e-2)
    ax.set_ylim(-2e-3, max(1.0, 2.0 * float(above.max(initial=0.0))))
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    n_failed = len(starts) - len(ended)
    title = "starts" + (f", {n_failed} failed" if n_failed else "")
    _label(ax, "start, best first", "objective minus the best one", title)
    ax.legend(fontsize=8, frameon=False)
    return cast("Figure", ax.figure)


def draw_profiles(curves: Sequence[Any], errors: Mapping[str, float]) -> Figure:
    """Draw the profiles of parameters, each with the parabola of its standard error, if finite."""
    figure, places = _panels(len(curves))
    for k, (ax, curve) in enumerate(zip(places, curves, strict=True)):
        ax.plot(curve.values, curve.rise, "o", ms=3.5, color=_CURVE)
        ax.plot(*curve.curve(), color=_CURVE, lw=1.6, label="profile")
        is_log, error = curve.scale != "lin", errors[curve.name]
        if math.isfinite(error) and error > 0.0:
            # Draw a parabola, the profile of a model that is linear in the scaled parameter.
            reach = np.linspace(-1.3, 1.3, 101) * math.sqrt(curve.limit)
            x = curve.estimate + reach * error
            if is_log:
                x = curve.estimate * np.exp(reach * error / curve.estimate)
            inside = (x >= curve.values.min()) & (x <= curve.values.max())
            line: dict[str, Any] = {"color": "0.6", "lw": 1.2, "ls": "--"}
            ax.plot(x[inside], reach[inside] ** 2, label="quadratic", **line)
        ax.axhline(curve.limit, color=_LIMIT, lw=1.0, ls="--", label="limit")
        low, high = float(curve.values.min()), float(curve.values.max())
        for end in curve.interval:
            if low <= end <= high:
                ax.axvline(end, color=_LIMIT, lw=0.8, ls=":", label="interval")
        ax.axvline(curve.estimate, color="0.5", lw=0.8, label="estimate")
        ax.set_ylim(-0.05 * curve.limit, 1.6 * curve.limit)
        if is_log and low > 0.0 and high > 5.0 * low:
            ax.set_xscale("log")
        label = f"{curve.name} {_bracketed(curve.unit)}".strip()
        _label(ax, label, "increase of 2 × objective", "")
        if k == 0:
            # Both ends of the interval share one legend entry.
            found = dict(zip(*reversed(ax.get_legend_handles_labels()), strict=True))
            style = {"fontsize": 8, "frameon": False, "loc": "upper center", "ncols": 2}
            ax.legend(list(found.values()), list(found), **style)
    return figure


def draw_correlation(names: Sequence[str], correlation: Array, ax: Axes | None = None) -> Figure:
    """Draw a correlation matrix as coloured cells with numbers."""
    n = len(names)
    if ax is None:
        size = min(max(3.6, 0.62 * n + 1.6), 12.0)
        figure = figure_for_people(size + 0.8, size)
        ax = figure.subplots()
    image = ax.imshow(correlation, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    image.cmap.set_bad("0.85")
    ax.figure.colorbar(image, ax=ax, shrink=0.8)
    ax.set_xticks(range(n), names, rotation=90 if n > 4 else 0)
    ax.set_yticks(range(n), names)
    ax.tick_params(length=0)
    ax.set_title("correlation", fontsize=10)
    if n <= 12:
        for i in range(n):
            for j in range(n):
                c = float(correlation[i, j])
                color = "white" if abs(c) > 0.6 else "black"
                text = f"{c:.2f}" if math.isfinite(c) else "–"
                ax.text(j, i, text, ha="center", va="center", fontsize=8, color=color)
    return cast("Figure", ax.figure)


def draw_overview(
    courses: Sequence[Course],
    parts: Sequence[ResidualSeries],
    starts: Sequence[Any],
    names: Sequence[str],
    correlation: Array,
) -> Figure:
    """Draw courses, residuals, and starts or correlations in one figure."""
    # The panels of courses may be wider than those of the last row.
    columns = 2 if len(courses) in (2, 4) else min(len(courses), _COLUMNS)
    n_rows = -(-len(courses) // columns)
    figure = figure_for_people(4.3 * _COLUMNS, 3.2 * (n_rows + 1) + 0.4)
    grid = figure.add_gridspec(n_rows + 1, 6)
    width = 6 // columns
    for k, course in enumerate(courses):
        down, right = divmod(k, columns)
        draw_course(figure.add_subplot(grid[down, right * width : (right + 1) * width]), course)
    last = [figure.add_subplot(grid[n_rows, 2 * j : 2 * j + 2]) for j in range(_COLUMNS)]
    draw_residuals_over_time(last[0], parts)
    draw_normal(last[1], parts)
    if len(starts) > 1:
        draw_waterfall(starts, last[2])
    else:
        draw_correlation(names, correlation, last[2])
    return figure


def _panels(n: int) -> tuple[Figure, list[Axes]]:
    columns = 2 if n == 4 else min(n, _COLUMNS)
    rows = -(-n // columns)
    figure = figure_for_people(1.0 + 4.0 * columns, 0.4 + 3.2 * rows)
    return figure, panels(figure, n, columns)


def _label(ax: Axes, x: str, y: str, title: str) -> None:
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    if title:
        ax.set_title(title, fontsize=10)
    draw_grid(ax)


def _bracketed(unit: str) -> str:
    return f"[{unit}]" if unit else ""
