"""Presentation of fit results: text, tables and plots."""

from __future__ import annotations

import json
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from cotree.estimation.problem import Problem
    from cotree.estimation.result import FitResult


class ShownFit:
    """Text, tables and plots of a :class:`~cotree.estimation.result.FitResult`."""

    @cached_property
    def units(self) -> dict[str, str]:
        """Units by name; an empty string if unknown."""
        return {
            row.name: row.unit or _unit(self._fit.problem, row.name)
            for row in self._fit.problem.estimated
        }

    @property
    def is_converged(self) -> bool:
        """Whether the best start met the tolerances of the optimiser."""
        return self._fit.starts[0].is_converged

    @property
    def optimality(self) -> float:
        """The optimality of the best start; see :class:`~cotree.estimation.start_record`."""
        return self._fit.starts[0].optimality

    def to_dict(self) -> dict[str, Any]:
        """Return everything as JSON-compatible values; numbers that are not finite are None."""
        from cotree.estimation.report import as_dict

        return as_dict(self._fit)

    def to_json(self, path: str | os.PathLike[str] | None = None) -> str:
        """Return the same as JSON text; if a path is given, also write it to that file."""
        from cotree.files import written_whole

        text = json.dumps(self.to_dict(), indent=2, allow_nan=False)
        if path is not None:
            with written_whole(path) as draft:
                draft.write_text(text + "\n", encoding="utf-8")
        return text

    def to_dataframe(self, level: float = 0.95) -> Any:
        """Return a pandas DataFrame with a row for each parameter."""
        from cotree.estimation.report import estimate_rows, frame

        return frame(estimate_rows(self._fit, level), "parameter")

    def starts_table(self) -> Any:
        """Return a pandas DataFrame with a row for each start, the best one first."""
        from cotree.estimation.report import frame, starts_rows

        return frame(starts_rows(self._fit), "rank")

    def plot(self) -> Figure:
        """Plot data and predictions with bands, residuals, and starts or correlations."""
        from cotree.estimation.pictures import overview

        return overview(self._fit)

    def plot_courses(self, *, noise: bool = False) -> Figure:
        """Plot measured and predicted values over time with bands, which may include noise."""
        from cotree.estimation.pictures import courses
        from cotree.plot.fits import draw_courses

        return draw_courses(courses(self._fit, noise=noise))

    def plot_residuals(self) -> Figure:
        """Plot residuals over time, measured against predicted values, and a probability plot."""
        from cotree.estimation.pictures import residuals
        from cotree.plot.fits import draw_residuals

        return draw_residuals(residuals(self._fit))

    def plot_waterfall(self) -> Figure:
        """Plot the objectives of all starts in ascending order."""
        from cotree.estimation.pictures import waterfall

        return waterfall(self._fit)

    def plot_profiles(self, names: Sequence[str] | None = None, *, level: float = 0.95) -> Figure:
        """Compute and plot profile likelihoods."""
        from cotree.estimation.pictures import profiles

        return profiles(self._fit, names, level)

    def plot_correlation(self) -> Figure:
        """Plot the correlation matrix of the estimates as a heat map."""
        from cotree.plot.fits import draw_correlation

        return draw_correlation(self._fit.names, self._fit.correlation)

    def __str__(self) -> str:
        """Return a summary as plain text."""
        from cotree.estimation.report import as_text

        return as_text(self._fit)

    def __repr__(self) -> str:
        """Return the estimates on one line."""
        found = ", ".join(f"{name} = {value:.6g}" for name, value in self._fit.parameters.items())
        return f"<FitResult: {found}>"

    def _repr_html_(self) -> str:
        from cotree.estimation.report import as_html

        return as_html(self._fit)

    @property
    def _fit(self) -> FitResult:
        return cast("FitResult", self)


def _unit(problem: Problem, name: str) -> str:
    """Find the unit of the model parameter or state to which an estimated parameter is tied."""
    for condition in problem.conditions:
        for target, value in (*condition.parameters.items(), *condition.initial.items()):
            if value == name:
                return condition.model.layout.units.get(target, "")
    return ""
