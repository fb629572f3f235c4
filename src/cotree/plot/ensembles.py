"""Figures of ensembles: bands over time, families of curves, and heat maps over grids.

Failed members, whose values are nan, are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from cotree.arguments import check_names
from cotree.errors import SceneError, brief, check_known, nearest
from cotree.plot.figures import figure_for_people
from cotree.plot.result_figures import curve_colors, draw_grid, panels, sensitivity_pair
from cotree.units import quotient

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import numpy.typing as npt
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

    from cotree.plot.graph import Array


#: Array dimensions that do not distinguish members.
_OTHERS = ("time", "parameter", "occurrence")

_PER_MEMBER = ("status", "message", "steps", "seconds")


@dataclass(frozen=True, eq=False)
class Variable:
    """The values of one quantity for all members."""

    name: str  # name as given by the user
    label: str  # label in pictures
    unit: str
    array: Any  # values over the member dimensions, then time, if any
    is_sensitivity: bool  # whether the quantity is a derivative

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the member dimensions."""
        return tuple(str(dim) for dim in self.array.dims if dim not in _OTHERS)

    @property
    def times(self) -> Array:
        """The times, [s]."""
        return np.asarray(self.array["time"].values, dtype=float)

    def flat(self) -> Array:
        """Return the values, shape (n_members, n_t)."""
        values = np.asarray(self.array.values, dtype=float)
        return values.reshape(-1, values.shape[-1])

    def coordinate(self, i: int) -> tuple[str, Array]:
        """Return the title and the values of a member dimension."""
        dim = self.dims[i]
        values = self.array[dim].values
        if values.dtype.kind not in "fiu":
            raise SceneError(f"the dimension '{dim}' has no numbers to draw along")
        return _titled(dim, self.array[dim]), np.asarray(values, dtype=float)

    def column(self, name: str | None) -> tuple[str, Array]:
        """Return title and values of a member column, by default the first."""
        known = [
            str(title)
            for title, row in self.array.coords.items()
            if title not in _OTHERS and row.dtype.kind in "fiu" and row.dims
            if set(row.dims) <= set(self.dims)
        ]
        # The member number is the default column only if there is no other.
        ordered = sorted(known, key=lambda title: title == "member")
        if name is not None:
            check_known([name], known, "members have no column")
        if not ordered:
            raise SceneError("members have no columns of numbers to colour them by")
        chosen = ordered[0] if name is None else name
        like = self.array.isel(time=0, drop=True)
        values = self.array[chosen].broadcast_like(like).transpose(*self.dims).values
        return _titled(chosen, self.array[chosen]), np.asarray(values, dtype=float).ravel()

    def summary(self, time: float | None, of: str) -> tuple[Array, str]:
        """Return one value for each member, at ``time`` or summarised by ``of``, and its label."""
        if "time" not in self.array.dims:
            return np.asarray(self.array.values, dtype=float), ""
        times = self.times
        if time is not None:
            if not times.min() <= time <= times.max():
                raise SceneError(
                    f"there is no time {time:g}: runs go from {times[0]:g} to {times[-1]:g} s"
                )
            at = int(np.argmin(np.abs(times - time)))
            return np.asarray(self.array.values[..., at]), f"at {times[at]:g} s"
        if of == "last":
            return np.asarray(self.array.values[..., -1]), f"at {times[-1]:g} s"
        if of not in ("max", "min", "mean"):
            raise SceneError(f"of is {of!r}: give 'last', 'max', 'min' or 'mean'")
        # After an event that ended a run, values are nan, which xarray ignores.
        return np.asarray(getattr(self.array, of)("time").values), f"({of} over time)"


def chosen_variables(dataset: Any, names: str | Sequence[str] | None) -> list[str]:
    """Return the given names, by default the coordinates; raise SceneError if there are none."""
    if not hasattr(dataset, "data_vars"):
        raise SceneError(
            f"a {type(dataset).__name__} cannot be drawn: give the Dataset of an ensemble"
        )
    if names is not None:
        listed = list(check_names(names, "names"))
        if not listed:
            raise SceneError("there are no names of variables to draw")
        return listed
    known = _known(dataset)
    chosen = [name for name in known if not name.endswith("_dot")] or known
    if not chosen:
        raise SceneError("the dataset has nothing to draw")
    # Modes have no unit and are not plotted.
    return [name for name in chosen if dataset[name].attrs.get("units")][:6] or chosen[:6]


def read_variable(dataset: Any, name: str, *, over_time: bool) -> Variable:
    """Return the named variable; raise SceneError if it is unknown, or not a function of time."""
    pair = sensitivity_pair(name)
    title = name if pair is None else f"d({pair[0]})"
    if title not in dataset.data_vars:
        known = [
            *_known(dataset),
            *(str(row) for row in dataset.data_vars if "time" not in dataset[row].dims),
        ]
        raise SceneError(
            f"cannot draw '{brief(name)}', which is not a variable of this ensemble"
            f"{nearest(name, known)}"
        )
    array = dataset[title]
    unit = str(array.attrs.get("units", ""))
    if pair is not None:
        known = [str(row) for row in dataset["parameter"].values] if "parameter" in dataset else []
        check_known([pair[1]], known, "there are no sensitivities to")
        at = known.index(pair[1])
        own = str(dataset[pair[0]].attrs.get("units", "")) if pair[0] in dataset else ""
        unit = quotient(
            own,
            str(dataset["parameter_unit"].values[at]) if "parameter_unit" in dataset.coords else "",
        )
        array = array.isel(parameter=at)
    elif "parameter" in array.dims:
        first = dataset["parameter"].values[0]
        raise SceneError(
            f"'{brief(name)}' are sensitivities to several parameters: name one, "
            f"'{name}/d({first})'"
        )
    if over_time and "time" not in array.dims:
        raise SceneError(f"'{brief(name)}' is not a curve over time")
    label = name if pair is None else f"∂ {pair[0]} / ∂ {pair[1]}"
    dims = [dim for dim in array.dims if dim not in _OTHERS]
    last = ["time"] if "time" in array.dims else []
    return Variable(name, label, unit, array.transpose(*dims, *last), pair is not None)


def _known(dataset: Any) -> list[str]:
    return [
        str(name)
        for name, row in dataset.data_vars.items()
        if "time" in row.dims and "parameter" not in row.dims and row.dtype.kind == "f"
    ]


def _titled(name: str, row: Any) -> str:
    unit = row.attrs.get("units", "")
    return f"{name} [{unit}]" if unit else name


if TYPE_CHECKING:
    Make = Callable[[float, float], Figure]

# Fraction of members, opacity and label of each band, from the outer to the inner one.
_BANDS = ((0.95, 0.18, "95 %"), (0.5, 0.38, "50 %"))

# Largest number of panels in a row.
_COLUMNS = 2

# An axis is logarithmic above this ratio of the largest to the smallest positive value: the first
# is for values that increase by a constant factor, the second for any values.
_LEAST_RATIO, _WIDE_RATIO = 3.0, 30.0

_NOTHING = "all members failed: there is nothing to draw"

#: Summaries of a member's curve for heat maps, by name.
SUMMARIES = ("last", "max", "min", "mean")


def bands(
    dataset: Any,
    names: str | Sequence[str] | None = None,
    *,
    ax: Axes | None = None,
    make: Make = figure_for_people,
) -> Figure:
    """Draw median and bands over all members at each time.

    Parameters
    ----------
    dataset : xarray.Dataset
        Of :meth:`cotree.Model.ensemble`, or derived from it.
    names : str or sequence of str, optional
        States, outputs, sensitivities as ``d(j1.s)/d(L)``, or variables of your own over time; by
        default coordinates and outputs.
    ax : Axes, optional
        Axes to draw a single variable into.
    make : callable, optional
        Function that makes a figure of the given width and height, [in].

    Returns
    -------
    Figure
        A panel for each name: the median, and bands that hold 50 % and 95 % of the members.

    Raises
    ------
    SceneError
        If a name is unknown.
    """

    def draw(where: Axes, row: Variable, color: Any) -> None:
        low, middle, high = _quantiles(row.flat())
        for (_, alpha, label), below, above in zip(_BANDS, low, high, strict=True):
            where.fill_between(
                row.times, below, above, color=color, alpha=alpha, lw=0.0, label=label
            )
        where.plot(row.times, middle, color=color, lw=1.8, label="median")
        _label_time(where, row)
        where.legend(loc="best", fontsize=8, frameon=False, title=_counted(row), title_fontsize=8)

    return _panels(dataset, names, draw, ax, make)


def curves(
    dataset: Any,
    names: str | Sequence[str] | None = None,
    *,
    color_by: str | None = None,
    ax: Axes | None = None,
    make: Make = figure_for_people,
) -> Figure:
    """Draw the curve of each member, coloured by one of its values, in a panel for each name.

    Parameters
    ----------
    dataset, names, ax, make
        As of :func:`bands`.
    color_by : str, optional
        Column of the members by which curves are coloured, by default the first.

    Raises
    ------
    SceneError
        If a name is unknown, or members have no such column.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm, Normalize

    def draw(where: Axes, row: Variable, _: Any) -> None:
        title, values = row.column(color_by)
        is_log = _is_logarithmic(values)
        norm = (LogNorm if is_log else Normalize)(float(values.min()), float(values.max()))
        shown = ScalarMappable(norm, "viridis")
        for curve, value in zip(row.flat(), values, strict=True):
            where.plot(row.times, curve, color=shown.to_rgba(value), lw=1.2)
        _label_time(where, row)
        bar = where.figure.colorbar(shown, ax=where, label=title)
        _tick_plainly(bar.ax.yaxis)

    return _panels(dataset, names, draw, ax, make)


def heat_map(
    dataset: Any,
    name: str | None = None,
    *,
    time: float | None = None,
    of: str = "last",
    ax: Axes | None = None,
    make: Make = figure_for_people,
) -> Figure:
    """Draw one value of each member on a two-dimensional grid as a colour; failed ones are grey.

    Parameters
    ----------
    dataset : xarray.Dataset
        Of :meth:`cotree.Model.ensemble` with a two-dimensional grid; reduce a larger grid by
        ``dataset.sel(...)``.
    name : str, optional
        A state, output, sensitivity as ``d(j1.s)/d(L)``, or a variable of your own; by default the
        first state.
    time : float, optional
        Time, [s]; the nearest time of the dataset is taken.
    of : {"last", "max", "min", "mean"}
        Summary of each curve, if no time is given.
    ax, make
        As of :func:`bands`.

    Raises
    ------
    SceneError
        If the name is unknown, or the members are not a grid of two dimensions.
    """
    chosen = chosen_variables(dataset, name)[0]
    row = read_variable(dataset, chosen, over_time=False)
    if len(row.dims) != 2:
        raise SceneError(
            f"a heat map needs a grid of two dimensions, and '{row.name}' has "
            f"{' x '.join(row.dims) or 'none'}: choose values of others with dataset.sel(...), or "
            "draw bands"
        )
    values, when = row.summary(time, of)
    if np.isnan(values).all():
        raise SceneError(_NOTHING)
    figure = make(6.0, 4.4) if ax is None else cast("Figure", ax.figure)
    where = figure.subplots() if ax is None else ax
    upright, level = _axis(row, 0), _axis(row, 1)
    ordered = values[np.ix_(upright.order, level.order)]
    style: dict[str, Any] = {"cmap": "viridis"}
    if row.is_sensitivity:
        # Positive and negative sensitivities have different colours.
        most = float(np.nanmax(np.abs(values), initial=0.0)) or 1.0
        style = {"cmap": "RdBu_r", "vmin": -most, "vmax": most}
    if figure.get_layout_engine() is None:
        # Without a layout engine, the title of a colour bar may overlap labels of other axes.
        figure.set_layout_engine("constrained")
    where.set_facecolor("0.85")
    where.grid(False)  # the user's style may draw a grid
    mesh = where.pcolormesh(level.edges, upright.edges, ordered, **style)
    where.set(xlabel=level.title, xscale=level.scale, ylabel=upright.title, yscale=upright.scale)
    for axis in (where.xaxis, where.yaxis):
        _tick_plainly(axis)
    what = when if not row.unit else f"[{row.unit}] {when}"
    figure.colorbar(mesh, ax=where, label=f"{row.label} {what}".strip())
    return figure


def picture(dataset: Any, names: Sequence[str] = (), of: str = "last") -> Figure:
    """Draw heat maps of a two-dimensional grid, curves of a one-dimensional grid, or else bands."""
    chosen = chosen_variables(dataset, names or None)
    dims = read_variable(dataset, chosen[0], over_time=False).dims
    if len(dims) == 1 and "member" not in dims:
        return curves(dataset, chosen)
    if len(dims) != 2:
        return bands(dataset, chosen)
    rows, columns = _layout(len(chosen))
    figure = figure_for_people(6.0 * columns, 4.4 * rows)
    for name, ax in zip(chosen, panels(figure, len(chosen), columns), strict=True):
        heat_map(dataset, name, of=of, ax=ax)
    return figure


def _panels(
    dataset: Any,
    names: str | Sequence[str] | None,
    draw: Callable[[Axes, Variable, Any], None],
    ax: Axes | None,
    make: Make,
) -> Figure:
    """Draw a panel for each variable, or a single variable into the given axes."""
    chosen = chosen_variables(dataset, names)
    variables = [read_variable(dataset, name, over_time=True) for name in chosen]
    if ax is not None:
        if len(variables) != 1:
            raise SceneError(
                f"{len(variables)} variables do not share axes: name one, or leave out ax"
            )
        draw(ax, variables[0], ax._get_lines.get_next_color())  # type: ignore[attr-defined]
        return cast("Figure", ax.figure)
    rows, columns = _layout(len(variables))
    figure = make(max(6.0, 5.2 * columns), max(3.4, 2.9 * rows))
    n, colors = len(variables), curve_colors(len(variables))
    for where, row, color in zip(panels(figure, n, columns), variables, colors, strict=True):
        draw(where, row, color)
        draw_grid(where)
        where.set_axisbelow(True)  # the grid is drawn below the transparent bands
    return figure


def _layout(n: int) -> tuple[int, int]:
    columns = min(n, _COLUMNS)
    return -(-n // columns), columns


def _label_time(ax: Axes, row: Variable) -> None:
    ax.set_xlabel("time [s]", fontsize=11)
    ax.set_ylabel(f"{row.label} [{row.unit}]" if row.unit else row.label, fontsize=11)
    ax.margins(x=0.02)


def _counted(row: Variable) -> str:
    curves_of_members = row.flat()
    failed = int(np.isnan(curves_of_members).all(axis=1).sum())
    n = len(curves_of_members)
    return f"{n} members" if not failed else f"{n - failed} of {n} members"


def _quantiles(values: Array) -> tuple[list[Array], Array, list[Array]]:
    there = values[~np.isnan(values).all(axis=1)]
    if not len(there):
        raise SceneError(_NOTHING)
    low = [(1.0 - share) / 2.0 for share, *_ in _BANDS]
    wanted = [*low, 0.5, *(1.0 - q for q in low)]
    # After an event that ended a run, values are nan, which only the slower function ignores.
    has_gaps = bool(np.isnan(there).any())
    columns = ~np.isnan(there).all(axis=0)
    found = np.full((len(wanted), there.shape[1]), np.nan)
    quantile = np.nanquantile if has_gaps else np.quantile
    found[:, columns] = quantile(there[:, columns], wanted, axis=0)
    k = len(_BANDS)
    return list(found[:k]), found[k], list(found[k + 1 :])


@dataclass(frozen=True, eq=False)
class _Axis:
    """An axis of a heat map: the boundaries of its cells, and the order of its values."""

    title: str
    scale: str
    edges: Array
    order: npt.NDArray[np.intp]


def _axis(row: Variable, i: int) -> _Axis:
    title, values = row.coordinate(i)
    order = np.argsort(values, kind="stable")
    is_log = _is_logarithmic(values)
    at = np.log(values[order]) if is_log else values[order]
    middle = 0.5 * (at[1:] + at[:-1])
    # An outer cell is as wide as its neighbour. The width of a single cell is its value.
    first, last = (at[1] - at[0], at[-1] - at[-2]) if len(at) > 1 else (abs(at[0]) or 1.0,) * 2
    edges = np.concatenate([[at[0] - first / 2], middle, [at[-1] + last / 2]])
    scale, edges = ("log", np.exp(edges)) if is_log else ("linear", edges)
    return _Axis(title, scale, edges, order)


def _tick_plainly(axis: Axis) -> None:
    """Label a logarithmic axis at 1, 2 and 5 of each power of ten, or at powers of ten only."""
    if axis.get_scale() != "log":
        return
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    low, high = axis.get_view_interval()
    subs = (1.0, 2.0, 5.0) if high < 1e3 * low else (1.0,)
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def _is_logarithmic(values: Array) -> bool:
    """Return whether values cover several powers of ten, or increase by a constant factor."""
    ordered = np.sort(values)
    if ordered[0] <= 0.0 or ordered[-1] < _LEAST_RATIO * ordered[0]:
        return False
    steps = np.diff(np.log(ordered))
    is_even = len(steps) > 1 and bool(np.allclose(steps, steps[0], rtol=1e-6))
    return is_even or bool(ordered[-1] >= _WIDE_RATIO * ordered[0])
