"""Plots of a fit: data preparation for :mod:`cotree.plot.fits`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.estimation.bands import title_of
from cotree.plot.fits import Course, Residuals, draw_overview

if TYPE_CHECKING:
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
    likelihood, values = result.problem.likelihood, result.residuals
    computed = likelihood.transformed(result.predictions.values)
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


def overview(result: FitResult) -> Figure:
    """Plot time courses, residuals, and starts or correlations."""
    shown = courses(result, most=_MOST_IN_OVERVIEW)
    return draw_overview(shown, residuals(result), result.starts, result.names, result.correlation)


def _measured_parts(result: FitResult) -> list[tuple[int, str, np.ndarray]]:
    """Return the rows of each quantity in each experiment."""
    measured = result.problem.measured
    parts: dict[tuple[int, str], list[int]] = {}
    for i, name in enumerate(measured.observable):
        parts.setdefault((int(measured.condition[i]), name), []).append(i)
    return [(c, name, np.array(rows)) for (c, name), rows in parts.items()]
