"""Figures of results over time, with sensitivities next to them ([1] Fig. 5 and 6)."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from cotree.errors import SceneError, check_known
from cotree.units import quotient

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from cotree.plot.graph import Array
    from cotree.solvers.result import RunRecord


# Largest number of parameters whose sensitivities are drawn if none is named; each has a panel.
_MOST_UNNAMED = 4

_TITLE = re.compile(r"d\((.*)\)/d\((.*)\)\Z")

#: A curve as named by the user: a state, output, input or column title, or (name, parameter).
Name = str | tuple[str, str]


@dataclass(frozen=True)
class Curves:
    """Names of the curves to draw."""

    values: tuple[str, ...]  # names of states, outputs and inputs
    #: Names of states and outputs, each with the parameter of its sensitivity.
    sensitivities: tuple[tuple[str, str], ...]


def choose_curves(
    names: str | Sequence[Name] | None,
    states: Sequence[str],
    outputs: Sequence[str],
    inputs: Sequence[str],
    parameters: Sequence[str],
    *,
    is_alone: bool = False,
) -> Curves:
    """Return the curves with the given names; see :func:`plot_result`.

    No sensitivities are added if ``is_alone``. Raises SceneError if a name is unknown.
    """
    known = (*states, *outputs)
    # A result contains no equations, so the names identify rates.
    if names is None:
        names = [name for name in states if not name.endswith("_dot")] or known
        if not names:
            raise SceneError("the result has neither states nor outputs to plot")
    # Dicts preserve the order of names and remove duplicates.
    values: dict[str, None] = {}
    pairs: dict[tuple[str, str], None] = {}
    for name in [names] if isinstance(names, str) else names:
        pair = sensitivity_pair(name)
        if pair is not None:
            after = ", which is not a state or output"
            check_known(pair[:1], known, "cannot plot a sensitivity of", after)
            after = ", which were not computed"
            check_known(pair[1:], parameters, "cannot plot sensitivities to", after)
            pairs[pair] = None
        else:
            after = ", which is not a state, output or input"
            check_known([name], (*known, *inputs), "cannot plot", after)
            values[str(name)] = None
    if not values and not pairs:
        raise SceneError("there are no names of variables to plot")
    if not pairs and not is_alone:
        unnamed = parameters[:_MOST_UNNAMED]
        pairs = {(name, to): None for name in values if name in known for to in unnamed}
    return Curves(tuple(values), tuple(pairs))


def sensitivity_pair(name: object) -> tuple[str, str] | None:
    """Return quantity and parameter of a sensitivity's name, or None for any other name."""
    if isinstance(name, str):
        found = _TITLE.match(name)
        return (found[1], found[2]) if found else None
    if isinstance(name, (tuple, list)) and len(name) == 2:
        return str(name[0]), str(name[1])
    return None


Color = tuple[float, ...]

# Maximum numbers of panels in a row, circles of an overlay, and curves with a legend above.
_COLUMNS = 3
_OPEN_CIRCLES = 40
_FEW = 4
# Width of a panel, and of the line sample before a label, in letters of the legend.
_PANEL, _LINE = 66, 7
_CIRCLES = "finite differences"


@dataclass
class _Row:
    """A row of panels: the quantities of one unit, and their sensitivities by parameter."""

    unit: str
    values: list[str] = field(default_factory=list)
    by_parameter: dict[str, list[str]] = field(default_factory=dict)

    @property
    def height(self) -> int:
        return max(1, -(-len(self.by_parameter) // _COLUMNS))

    @property
    def colors(self) -> dict[str, Color]:
        groups = (self.values, *self.by_parameter.values())
        names = dict.fromkeys(name for group in groups for name in group)
        return dict(zip(names, curve_colors(len(names)), strict=True))


def plot_result(
    result: RunRecord,
    names: str | Sequence[Name] | None = None,
    overlay: Mapping[tuple[str, str], tuple[Array, Array]] | None = None,
    make: Callable[[float, float], Figure] | None = None,
) -> Figure:
    """Plot states, outputs and inputs over time, and sensitivities next to them.

    Names are states, outputs, inputs, and sensitivities as ``d(name)/d(parameter)`` or ``(name,
    parameter)``. If no sensitivity is named, those of the named states and outputs to the first
    four parameters are added. None means the coordinates, the states that are not rates.
    ``overlay`` has the times and values of sensitivities from another source, such as finite
    differences, drawn as open circles.

    The figure has on the left one panel for each unit; on the right one for each unit and
    parameter. Raises SceneError if a name is unknown, or an overlay belongs to no curve.
    """
    parameters = result.parameters_of_sensitivity
    curves = choose_curves(names, result.states, _followers(result), result.inputs, parameters)
    overlay = overlay or {}
    for name, parameter in overlay:
        if (name, parameter) not in curves.sensitivities:
            raise SceneError(
                f"the overlay of '{name}' by '{parameter}' belongs to no curve of the plot; "
                "plot this name, and compile with its sensitivity"
            )
    rows: dict[str, _Row] = {}
    for name in curves.values:
        rows.setdefault(result.unit(name), _Row(result.unit(name))).values.append(name)
    for name, parameter in curves.sensitivities:
        # A sensitivity is in the row of its quantity and has the same colour.
        row = rows.setdefault(result.unit(name), _Row(result.unit(name)))
        row.by_parameter.setdefault(parameter, []).append(name)

    first = 1 if curves.values else 0  # index of the first column of sensitivities
    n_columns = max((min(len(row.by_parameter), _COLUMNS) for row in rows.values()), default=0)
    n_rows = sum(row.height for row in rows.values())
    figure = (make or new_figure)((5.4 if first else 1.0) + 4.4 * n_columns, max(2.7 * n_rows, 3.4))
    grid = figure.add_gridspec(n_rows, first + n_columns)
    top = 0
    for row in rows.values():
        colors = row.colors
        if row.values:
            ax = figure.add_subplot(grid[top, 0])
            for name in row.values:
                ax.plot(result.t, result[name], color=colors[name], lw=1.6, label=name)
            _finish(ax, row.values[0] if len(row.values) == 1 else "", row.unit)
        for j, (parameter, group) in enumerate(row.by_parameter.items()):
            down, right = divmod(j, _COLUMNS)
            ax = figure.add_subplot(grid[top + down, first + right])
            # The left panel has the legend of many curves. Underscores hide other labels.
            is_explained = len(group) > _FEW and set(group) <= set(row.values)
            for name in group:
                label = f"{'_' if is_explained else ''}∂ {name} / ∂ {parameter}"
                values = result.sensitivity(name, parameter)
                ax.plot(result.t, values, color=colors[name], lw=1.6, label=label)
            _draw_circles(ax, {colors[name]: overlay.get((name, parameter)) for name in group})
            subject = f"∂ {group[0]} / ∂ {parameter}" if len(group) == 1 else f"∂ / ∂ {parameter}"
            _finish(ax, subject, quotient(row.unit, result.unit(parameter)))
        top += row.height
    return figure


def _followers(result: RunRecord) -> tuple[str, ...]:
    """List the variables that are computed from states: positions along f-circuits, and outputs."""
    # Results from other programs may lack positions.
    return (*(row.name for row in getattr(result, "positions", ())), *result.outputs)


def draw_curves(result: RunRecord, names: str | Sequence[Name] | None, ax: Axes) -> Figure:
    """Draw curves of one unit into the given axes, without sensitivities unless named.

    Raises SceneError if a name is unknown, or the curves have several units.
    """
    known = (result.states, _followers(result), result.inputs, result.parameters_of_sensitivity)
    curves = choose_curves(names, *known, is_alone=True)
    drawn = [(name, result.unit(name), result[name]) for name in curves.values]
    for name, to in curves.sensitivities:
        unit = quotient(result.unit(name), result.unit(to))
        drawn.append((f"∂ {name} / ∂ {to}", unit, result.sensitivity(name, to)))
    units = list(dict.fromkeys(unit for _, unit, _ in drawn))
    if len(units) > 1:
        raise SceneError(
            f"'{drawn[0][0]}' [{units[0]}] and another curve in [{units[1]}] do not share an axis: "
            "give axes of their own, or leave out ax"
        )
    is_first = not ax.lines
    for label, _, values in drawn:
        ax.plot(result.t, values, lw=1.6, label=label)
    # Axes that already contain curves keep their labels.
    if is_first:
        _finish(ax, drawn[0][0] if len(drawn) == 1 else "", units[0])
    elif ax.get_legend() is not None:
        ax.legend()
    return cast("Figure", ax.figure)


def new_figure(width: float, height: float, make: Callable[..., Figure] | None = None) -> Figure:
    """Make a figure of the given size, [in], by ``make``; by default pyplot does not manage it."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    # The layout reserves space for the labels of all panels.
    layout = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.08)
    return (make or Figure)(figsize=(width, height), layout=layout)


def panels(figure: Figure, n: int, columns: int) -> list[Axes]:
    """Add ``n`` panels to a figure, row by row."""
    grid = figure.add_gridspec(-(-n // columns), columns)
    return [figure.add_subplot(grid[divmod(i, columns)]) for i in range(n)]


def draw_grid(ax: Axes) -> None:
    """Draw a light grid, and remove the frame lines at the top and on the right."""
    ax.grid(color="0.9", lw=0.8)
    ax.spines[["top", "right"]].set_visible(False)


def curve_colors(n: int) -> list[Color]:
    """Return up to ten distinct colours, or a sequence of as many as needed."""
    import matplotlib

    if n <= 10:
        return [matplotlib.colormaps["tab10"](i) for i in range(n)]
    return [matplotlib.colormaps["viridis"](x) for x in np.linspace(0, 0.92, n)]


def _draw_circles(ax: Axes, by_color: Mapping[Color, tuple[Array, Array] | None]) -> None:
    """Draw overlays as a limited number of open circles."""
    style: dict[str, Any] = {"ls": "none", "marker": "o", "ms": 5.5, "mfc": "none"}
    overlays = {color: overlay for color, overlay in by_color.items() if overlay is not None}
    for color, overlay in overlays.items():
        every = max(1, -(-len(overlay[0]) // _OPEN_CIRCLES))
        times, values = (np.asarray(column)[::every] for column in overlay)
        ax.plot(times, values, color=color, **style)
    if overlays:
        # One grey entry in the legend represents circles of all colours.
        ax.plot([], [], color="0.3", label=_CIRCLES, **style)


def _finish(ax: Axes, subject: str, unit: str) -> None:
    bracketed = f"[{unit}]" if unit else ""
    # A label longer than the axis is broken into two lines.
    between = "\n" if len(subject) + len(bracketed) > 26 else " "
    ax.set_xlabel("time [s]", fontsize=11)
    ax.set_ylabel(between.join(filter(None, (subject, bracketed))), fontsize=11)
    ax.margins(x=0.02, y=0.08)
    draw_grid(ax)
    labels = ax.get_legend_handles_labels()[1]
    if len(labels) < 2 and _CIRCLES not in labels:
        return
    # The legend is outside the axes, so that it hides no curve: above few curves, otherwise on the
    # right.
    # Number of labels with line samples that fit side by side above a panel.
    widths = [len(label) + _LINE for label in labels]
    columns = len(labels) if sum(widths) <= _PANEL else max(1, _PANEL // max(widths))
    place, anchor, size = "lower right", (1.0, 1.0), 9
    if len(labels) > _FEW + 1 or len(labels) > 2 * columns:
        place, anchor, size, columns = "center left", (1.0, 0.5), 8, 1 + len(labels) // 15
    ax.legend(loc=place, bbox_to_anchor=anchor, ncols=columns, frameon=False, fontsize=size)
