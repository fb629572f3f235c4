"""Variables of an ensemble's Dataset by the names that people give them.

In: a Dataset, of which nothing but names, dimensions and arrays is asked. Out: ``Variable``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import SceneError, brief, nearest
from cotree.plot.curves import sensitivity_pair
from cotree.plot.result import quotient

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.plot.layout import Array

#: What is no dimension of members.
_OTHERS = ("time", "parameter", "occurrence")

_PER_MEMBER = ("status", "message", "steps", "seconds")


@dataclass(frozen=True, eq=False)
class Variable:
    """One quantity of all members.

    Attributes
    ----------
    name, label, unit : str
        Its name as it was given, how pictures call it, and its unit.
    array : xarray.DataArray
        Its values, the dimensions of members first, then time, if it has that.
    is_sensitivity : bool
        Whether it is a derivative.
    """

    name: str
    label: str
    unit: str
    array: Any
    is_sensitivity: bool

    @property
    def dims(self) -> tuple[str, ...]:
        """The dimensions of members."""
        return tuple(str(dim) for dim in self.array.dims if dim not in _OTHERS)

    @property
    def times(self) -> Array:
        """The times, [s]."""
        return np.asarray(self.array["time"].values, dtype=float)

    def flat(self) -> Array:
        """Give the values, shape (n_members, n_t)."""
        values = np.asarray(self.array.values, dtype=float)
        return values.reshape(-1, values.shape[-1])

    def coordinate(self, i: int) -> tuple[str, Array]:
        """Give the title and the values of a dimension of members."""
        dim = self.dims[i]
        values = self.array[dim].values
        if values.dtype.kind not in "fiu":
            raise SceneError(f"the dimension '{dim}' has no numbers to draw along")
        return _titled(dim, self.array[dim]), np.asarray(values, dtype=float)

    def column(self, name: str | None) -> tuple[str, Array]:
        """Give the title and, for each member, the value of a column; the first where None.

        Raises
        ------
        SceneError
            If members have no such column.
        """
        known = [
            str(title)
            for title, row in self.array.coords.items()
            if title not in _OTHERS and row.dtype.kind in "fiu" and row.dims
            if set(row.dims) <= set(self.dims)
        ]
        # The number of a member says nothing where it has columns.
        ordered = sorted(known, key=lambda title: title == "member")
        if name is not None and name not in known:
            raise SceneError(f"members have no column '{brief(name)}'{nearest(name, known)}")
        if not ordered:
            raise SceneError("members have no columns of numbers to colour them by")
        chosen = ordered[0] if name is None else name
        like = self.array.isel(time=0, drop=True)
        values = self.array[chosen].broadcast_like(like).transpose(*self.dims).values
        return _titled(chosen, self.array[chosen]), np.asarray(values, dtype=float).ravel()

    def summary(self, time: float | None, of: str) -> tuple[Array, str]:
        """Give one value of each member, and which one that is.

        Raises
        ------
        SceneError
            If there is no such value.
        """
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
        # xarray leaves out what an event cut off, and leaves nan for members without any value.
        return np.asarray(getattr(self.array, of)("time").values), f"({of} over time)"


def chosen_variables(dataset: Any, names: str | Sequence[str] | None) -> list[str]:
    """Give the names that are to be drawn: those that are named, or all coordinates.

    Raises
    ------
    SceneError
        If the dataset is none, or has nothing to draw.
    """
    if not hasattr(dataset, "data_vars"):
        raise SceneError(
            f"a {type(dataset).__name__} cannot be drawn: give the Dataset of an ensemble"
        )
    if names is not None:
        listed = [names] if isinstance(names, str) else list(names)
        if not listed:
            raise SceneError("nothing is named that could be drawn")
        return listed
    known = _known(dataset)
    chosen = [name for name in known if not name.endswith("_dot")] or known
    if not chosen:
        raise SceneError("the dataset has nothing to draw")
    # Modes and rates are left out where there are coordinates, which have units.
    return [name for name in chosen if dataset[name].attrs.get("units")][:6] or chosen[:6]


def read_variable(dataset: Any, name: str, *, over_time: bool) -> Variable:
    """Find what a name stands for.

    Raises
    ------
    SceneError
        If there is nothing of the name, or it is not over time.
    """
    pair = sensitivity_pair(name)
    title = name if pair is None else f"d({pair[0]})"
    if title not in dataset.data_vars:
        known = [
            *_known(dataset),
            *(str(row) for row in dataset.data_vars if "time" not in dataset[row].dims),
        ]
        raise SceneError(
            f"cannot draw '{brief(name)}', no variable of this ensemble{nearest(name, known)}"
        )
    array = dataset[title]
    unit = str(array.attrs.get("units", ""))
    if pair is not None:
        known = [str(row) for row in dataset["parameter"].values] if "parameter" in dataset else []
        if pair[1] not in known:
            raise SceneError(
                f"there are no sensitivities to '{brief(pair[1])}'{nearest(pair[1], known)}"
            )
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
    """List the variables over members and time alone."""
    return [
        str(name)
        for name, row in dataset.data_vars.items()
        if "time" in row.dims and "parameter" not in row.dims and row.dtype.kind == "f"
    ]


def _titled(name: str, row: Any) -> str:
    unit = row.attrs.get("units", "")
    return f"{name} [{unit}]" if unit else name
