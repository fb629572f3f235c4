"""Plots of a fit: data preparation for :mod:`cotree.plot.fits`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.estimation.bands import title_of
from cotree.plot.fits import Course, Residuals, draw_overview, draw_profiles, draw_waterfall

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from cotree.estimation.result import FitResult

# Largest numbers of time plots in an overview and in a figure of their own; more are unreadable.
_MOST_IN_OVERVIEW, _MOST = 6, 24


def courses(result: FitResult, *, noise: bool = False, most: int = _MOST) -> list[Course]:
    """Return measured and computed values over time with bands, at most ``most`` of them."""
    measured, found = result.problem.measured, result.predictions
    parts = []
    for condition, name, rows in _measured_parts(result)[:most]:
        t = measured.t[rows]
        run = result.problem.conditions[condition]
        end = max(t.max(), run.t_start)
        times = np.unique(np.concatenate([np.linspace(run.t_start, end, 301), t]))
        band = result.bands(run.column(name), times, experiment=condition, noise=noise)
        is_plain = not result.problem.likelihood.is_log[rows].any()
        values = np.asarray(measured.value, dtype=float)[rows]
        sigma = found.sigma[rows] if is_plain else None
        parts.append(Course(title_of(run.name), band, t, values, sigma))
    return parts


def residuals(result: FitResult) -> list[Residuals]:
    """Return the residuals of each quantity in each experiment."""
    likelihood, found = result.problem.likelihood, result.predictions
    values = result.residuals
    computed = likelihood.transformed(found.values)
    target = likelihood.transformed(likelihood.value)
    has_several = len(result.problem.conditions) > 1
    return [
        Residuals(
            f"{run.column(name)} · {title_of(run.name)}" if has_several else run.column(name),
            result.problem.measured.t[rows],
            values[rows],
            target[rows],
            computed[rows],
        )
        for condition, name, rows in _measured_parts(result)
        for run in [result.problem.conditions[condition]]
    ]


def waterfall(result: FitResult) -> Figure:
    """Plot the objectives of the starts."""
    return draw_waterfall(*_starts(result))


def profiles(result: FitResult, names: Sequence[str] | None, level: float) -> Figure:
    """Compute profiles and plot them."""
    found = result.profiles(names, level=level)
    return draw_profiles(list(found.values()), result.standard_errors)


def overview(result: FitResult) -> Figure:
    """Plot time courses, residuals, and starts or correlations."""
    return draw_overview(
        courses(result, most=_MOST_IN_OVERVIEW),
        residuals(result),
        _starts(result),
        result.names,
        result.correlation,
    )


def _starts(result: FitResult) -> tuple[np.ndarray, list[bool]]:
    objectives = np.array([row.objective for row in result.starts])
    return objectives, [row.is_converged for row in result.starts]


def _measured_parts(result: FitResult) -> list[tuple[int, str, np.ndarray]]:
    """Return the rows of each quantity in each experiment."""
    measured = result.problem.measured
    parts: dict[tuple[int, str], list[int]] = {}
    for i, name in enumerate(measured.observable):
        parts.setdefault((int(measured.condition[i]), name), []).append(i)
    return [(c, name, np.array(rows)) for (c, name), rows in parts.items()]
