"""Results over time, with sensitivities beside them ([1] Fig. 5 and 6).

In: a result. Out: a matplotlib `Figure`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from cotree.errors import SceneError, nearest

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]

# Panels of sensitivities in a row, circles of an overlay, curves with a legend above them.
_COLUMNS = 3
_OPEN_CIRCLES = 40
_FEW = 4
_CIRCLES = "finite differences"


class PlottableResult(Protocol):
    """What `plot_result` needs of a result; arrays over time have shape (n_t,)."""

    @property
    def t(self) -> Array: ...  # noqa: D102
    @property
    def states(self) -> tuple[str, ...]: ...  # noqa: D102
    @property
    def outputs(self) -> tuple[str, ...]: ...  # noqa: D102
    @property
    def parameters_of_sensitivity(self) -> tuple[str, ...]: ...  # noqa: D102
    def __getitem__(self, name: str) -> Array: ...
    def sensitivity(self, state: str, parameter: str) -> Array: ...  # noqa: D102
    def unit(self, name: str) -> str: ...  # noqa: D102


def plot_result(
    result: PlottableResult,
    names: Sequence[str] | None = None,
    overlay: Mapping[tuple[str, str], tuple[Array, Array]] | None = None,
) -> Figure:
    """Plot states and outputs over time, and their sensitivities beside them.

    Parameters
    ----------
    result : PlottableResult
        The result of a simulation.
    names : sequence of str or None
        States and outputs to plot; None plots the coordinates, the states that are no rates.
    overlay : mapping of (name, parameter) to (t, values), or None
        Sensitivities found in another way, by finite differences for example, of shape (n,) each;
        drawn as open circles.

    Returns
    -------
    Figure
        On the left one panel for each unit; beside it one panel for each unit and parameter.

    Raises
    ------
    SceneError
        If a name is no state or output of the result, or an overlay belongs to no curve.
    """
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    names = _plotted_names(result, names)
    parameters = result.parameters_of_sensitivity
    overlay = overlay or {}
    _check_overlay(overlay, names, parameters)
    by_unit: dict[str, list[str]] = {}
    for name in names:
        by_unit.setdefault(result.unit(name), []).append(name)

    n_columns = min(len(parameters), _COLUMNS)
    # Rows of panels for each unit; a unit has its parameters in as many rows as they fill.
    n_rows = max(1, -(-len(parameters) // _COLUMNS))
    figure = Figure(
        figsize=(5.4 + 4.4 * n_columns, max(2.7 * n_rows * len(by_unit), 3.4)),
        layout=ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.08),
    )
    grid = figure.add_gridspec(n_rows * len(by_unit), 1 + n_columns)
    for i, (unit, group) in enumerate(by_unit.items()):
        ax = figure.add_subplot(grid[i * n_rows, 0])
        _draw_curves(ax, result.t, {name: result[name] for name in group})
        _finish(ax, group[0] if len(group) == 1 else "", unit)
        for j, parameter in enumerate(parameters):
            row, column = divmod(j, _COLUMNS)
            ax = figure.add_subplot(grid[i * n_rows + row, 1 + column])
            # The colours of many curves are explained once, on the left: matplotlib leaves labels
            # with an underscore out of legends.
            start = "" if len(group) <= _FEW else "_"
            curves = {
                f"{start}∂ {name} / ∂ {parameter}": result.sensitivity(name, parameter)
                for name in group
            }
            _draw_curves(ax, result.t, curves)
            _draw_circles(ax, [overlay.get((name, parameter)) for name in group])
            subject = f"∂ {group[0]} / ∂ {parameter}" if len(group) == 1 else f"∂ / ∂ {parameter}"
            _finish(ax, subject, _quotient(unit, result.unit(parameter)))
    return figure


def _plotted_names(result: PlottableResult, names: Sequence[str] | None) -> tuple[str, ...]:
    known = (*result.states, *result.outputs)
    if not known:
        raise SceneError("the result has neither states nor outputs to plot")
    if names is None:
        return tuple(name for name in result.states if not name.endswith("_dot")) or known
    for name in names:
        if name not in known:
            raise SceneError(f"cannot plot '{name}', no state or output{nearest(name, known)}")
    return tuple(names)


def _check_overlay(
    overlay: Iterable[tuple[str, str]], names: Sequence[str], parameters: Sequence[str]
) -> None:
    for name, parameter in overlay:
        if name not in names or parameter not in parameters:
            raise SceneError(
                f"the overlay of '{name}' by '{parameter}' belongs to no curve of the plot; "
                "plot this name, and ask for its sensitivity"
            )


def curve_colors(n: int) -> list[tuple[float, ...]]:
    """Give ten colours that are told apart, or as many as needed that at least come in order."""
    import matplotlib

    if n <= 10:
        return [matplotlib.colormaps["tab10"](i) for i in range(n)]
    return [matplotlib.colormaps["viridis"](x) for x in np.linspace(0, 0.92, n)]


def _draw_curves(ax: Axes, t: Array, curves: Mapping[str, Array]) -> None:
    for (name, values), color in zip(curves.items(), curve_colors(len(curves)), strict=True):
        ax.plot(t, values, color=color, lw=1.6, label=name)


def _draw_circles(ax: Axes, overlays: Sequence[tuple[Array, Array] | None]) -> None:
    """Lay open circles over those curves that have an overlay, few enough to be told apart."""
    style: dict[str, Any] = {"ls": "none", "marker": "o", "ms": 5.5, "mfc": "none"}
    for overlay, color in zip(overlays, curve_colors(len(overlays)), strict=True):
        if overlay is not None:
            every = max(1, -(-len(overlay[0]) // _OPEN_CIRCLES))
            times, values = (np.asarray(column)[::every] for column in overlay)
            ax.plot(times, values, color=color, **style)
    if any(overlay is not None for overlay in overlays):
        ax.plot([], [], color="0.3", label=_CIRCLES, **style)


def _finish(ax: Axes, subject: str, unit: str) -> None:
    """Add labels, grid and, where it says more than the label, the legend."""
    bracketed = f"[{unit}]" if unit else ""
    # A long label takes two lines, since it is not to be longer than its axis.
    between = "\n" if len(subject) + len(bracketed) > 26 else " "
    ax.set_xlabel("time [s]", fontsize=11)
    ax.set_ylabel(between.join(filter(None, (subject, bracketed))), fontsize=11)
    ax.margins(x=0.02, y=0.08)
    ax.grid(color="0.9", lw=0.8)
    ax.spines[["top", "right"]].set_visible(False)
    labels = ax.get_legend_handles_labels()[1]
    # Outside, where it hides no curve: above a few, beside many.
    if len(labels) > _FEW + 1:
        columns = 1 + len(labels) // 15
        ax.legend(
            loc="center left", bbox_to_anchor=(1, 0.5), ncols=columns, frameon=False, fontsize=8
        )
    elif len(labels) > 1 or _CIRCLES in labels:
        ax.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, frameon=False, fontsize=9)


def _quotient(unit: str, divisor: str) -> str:
    """Write a unit over another, m over N m as m/(N m); nothing if one of them is not known."""
    if not unit or not divisor:
        return ""
    if divisor == "1":
        return unit
    compound = any(mark in divisor for mark in " /*")
    return f"{unit}/{f'({divisor})' if compound else divisor}"
