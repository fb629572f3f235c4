"""Reading of ensemble members from tables, mappings, lists, grids and samples.

Names are checked against a model later.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import ParameterError, brief, nearest
from cotree.scene.expressions import check_number

if TYPE_CHECKING:
    import numpy.typing as npt

    from cotree.model.model import CompiledModel
    from cotree.solvers.result import FloatArray


def column_values(values: Any, what: str) -> FloatArray:
    """Convert a number, or a sequence with one number per member, to an array."""
    if hasattr(values, "magnitude"):
        raise ParameterError(f"{what} has units: give plain numbers in SI units")
    try:
        # Masked values count as missing.
        array = (
            np.ma.filled(np.ma.asarray(values, dtype=None), np.nan)
            if np.ma.isMA(values)
            else np.asarray(values)
        )
    except ValueError:  # nested sequences have different lengths
        raise ParameterError(
            f"{what} is not a sequence of numbers: give one number for each member"
        ) from None
    if array.ndim > 1:
        raise ParameterError(f"{what} has shape {array.shape}: give one value for each member")
    if array.ndim == 0:
        return np.array(check_number(array.item(), what))
    if array.dtype.kind not in "fiu":
        # Check value by value, so that the message can quote the first invalid value.
        listed = [
            check_number(value, f"{what}, row {i},") for i, value in enumerate(array.tolist())
        ]
        return np.array(listed, dtype=float)
    numbers = array.astype(float)
    wrong = np.flatnonzero(~np.isfinite(numbers))
    if wrong.size:
        check_number(float(numbers[wrong[0]]), f"{what}, row {wrong[0]},")
    return numbers


# Largest number of members of a grid, to guard against mistakes: at this size the rows alone take
# gigabytes.
_MOST = 100_000_000


@dataclass(frozen=True, eq=False)
class Grid:
    """Members that form the Cartesian product of axes; see :func:`grid`."""

    axes: Mapping[str, FloatArray]  # values by axis, in the order of the dimensions of results

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the axes."""
        return tuple(self.axes)

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the axes."""
        return tuple(len(values) for values in self.axes.values())

    def __len__(self) -> int:
        return math.prod(self.shape)

    def __repr__(self) -> str:
        shown = " x ".join(f"{name} ({len(values)})" for name, values in self.axes.items())
        return f"<Grid of {len(self)} members: {shown}>"

    def rows(self) -> FloatArray:
        """Return all members, shape (n_members, n_axes); the last axis varies fastest."""
        meshed = np.meshgrid(*self.axes.values(), indexing="ij")
        return np.stack([values.ravel() for values in meshed], axis=1)


def grid(axes: Mapping[str, Any] | None = None, /, **more: Any) -> Grid:
    """Return members for all combinations of the given values.

    Parameters
    ----------
    axes : mapping of str to array_like of shape (n,), optional
        Values of parameters, and initial values of states, whose names have dots.
    **more : array_like of shape (n,)
        Further axes, by name.

    Returns
    -------
    Grid
        For ``members`` of :meth:`cotree.Model.ensemble`. Results have a dimension for each axis.

    Raises
    ------
    ParameterError
        If an axis is empty or given twice, or has a value that is repeated or not finite.

    Examples
    --------
    >>> import cotree
    >>> cotree.grid({"j1.s": [0.4, 0.5]}, L=[0.8, 1.0, 1.2])
    <Grid of 6 members: j1.s (2) x L (3)>
    """
    if axes is not None and not isinstance(axes, Mapping):
        raise ParameterError(f"grid takes a mapping of names to values, not {brief(repr(axes))}")
    first = dict(axes or {})
    for name in more:
        if name in first:
            raise ParameterError(f"the grid has two axes '{brief(name)}': give one")
    read = {}
    for name, values in {**first, **more}.items():
        if not isinstance(name, str):
            raise ParameterError(
                f"the grid has the axis {brief(repr(name))}: give its name as text"
            )
        what = f"axis '{brief(name)}' of the grid"
        read[name] = np.atleast_1d(column_values(values, what))
        if not read[name].size:
            raise ParameterError(f"{what} is empty: give at least one value")
        found, counts = np.unique(read[name], return_counts=True)
        if len(found) < len(read[name]):
            raise ParameterError(f"{what} has {found[counts > 1][0]:.17g} twice: give it once")
    if not read:
        raise ParameterError("the grid has no axes: give grid(L=[0.9, 1.0, 1.1])")
    made = Grid(read)
    if len(made) > _MOST:
        raise ParameterError(
            f"the grid has {len(made)} members, more than {_MOST}: take fewer values"
        )
    return made


#: Name of the dimension over members that are not a grid.
MEMBER = "member"

_FORMS = (
    "give a DataFrame, a mapping of arrays, a list of mappings, cotree.grid(...) or "
    "cotree.sample(...)"
)


@dataclass(frozen=True, eq=False)
class Members:
    """Parameter and initial values of all members of an ensemble."""

    columns: tuple[str, ...]  # names of parameters, and of states with initial values
    rows: FloatArray  # values of the columns, one row for each member
    #: Coordinates by dimension of the results: either ``member`` alone or the axes of a grid, whose
    #: combinations are in the order of the rows.
    dimensions: Mapping[str, npt.NDArray[Any]]
    origin: Mapping[str, Any] = field(default_factory=dict)  # description of a sample
    is_grid: bool = False  # whether the members are the product of their axes

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the result dimensions."""
        return tuple(len(values) for values in self.dimensions.values())

    def described(self, i: int) -> str:
        """Return a description of a member with its label and values."""
        values = ", ".join(
            f"{name} = {value:.6g}"
            for name, value in zip(self.columns, self.rows[i].tolist(), strict=True)
        )
        if self.is_grid:
            return f"the member {values}"
        return f"member {brief(self.dimensions[MEMBER][i])} ({values})"


def read_members(given: Any) -> Members:
    """Convert any accepted form of members to a ``Members`` object."""
    if isinstance(given, Grid):
        return Members(given.names, given.rows(), given.axes, is_grid=True)
    if isinstance(given, Mapping) and not hasattr(given, "data_vars"):
        return _from_columns(given, None, getattr(given, "origin", {}))
    if hasattr(given, "columns") and hasattr(given, "__getitem__"):
        return _from_frame(given)
    if getattr(getattr(given, "dtype", None), "names", None):
        return _from_columns({name: given[name] for name in given.dtype.names}, None, {})
    if isinstance(given, Sequence) and not isinstance(given, (str, bytes)):
        return _from_list(given)
    if given is None:
        raise ParameterError(
            f"members are missing: call ensemble((0, 10), members), or ensemble(members=...), and "
            f"{_FORMS}"
        )
    raise ParameterError(f"members cannot be a {type(given).__name__}: {_FORMS}")


def check_columns(
    columns: Iterable[str],
    model: CompiledModel,
    parameters: Container[str],
    initial: Container[str],
) -> None:
    """Raise an error if a column is not in the model, or the run sets it in another way."""
    derived = {row.name: row.dependence for row in model.layout.derived}
    for name in columns:
        if name in parameters or name in initial:
            where = "parameters" if name in parameters else "initial"
            raise ParameterError(f"'{name}' is a column of members and in {where}=: give it once")
        if name in derived:
            raise ParameterError(f"members: {derived[name]}: give columns of those, and it follows")
        if name in model.inputs:
            raise ParameterError(
                f"members have the column '{name}', an input: give inputs={{'{name}': "
                f"'{name}_value'}} and a column '{name}_value', or any other expression"
            )
        if name not in model.parameters and name not in model.states and name not in model.slopes:
            known = (*model.parameters, *model.states)
            raise ParameterError(
                f"members have the column '{brief(name)}', but the model has no tunable parameter "
                f"or state of this name{nearest(name, known)}"
            )


def _from_frame(frame: Any) -> Members:
    """Read members from a pandas table, or from another table with named columns."""
    names = list(frame.columns)
    for i, name in enumerate(names):
        if name in names[:i]:
            raise ParameterError(f"members have two columns '{brief(name)}': keep one of them")
    index = getattr(frame, "index", None)
    labels = None if index is None else _labels(index)
    return _from_columns({name: frame[name] for name in names}, labels, {})


def _labels(index: Any) -> npt.NDArray[Any]:
    if getattr(index, "nlevels", 1) > 1:
        raise ParameterError(
            "the index of members has several levels: call reset_index() to make them columns, or "
            "give a plain index"
        )
    labels = np.asarray(index)
    if labels.dtype.kind in "OUS":  # result files can store such labels only as texts
        labels = np.array([str(label) for label in labels], dtype=object)
    found, counts = np.unique(labels, return_counts=True)
    if len(found) < len(labels):
        raise ParameterError(
            f"the index of members has {brief(found[counts > 1][0])} {max(counts)} times: give "
            "each member a different label, for example by reset_index(drop=True)"
        )
    return labels


def _from_list(given: Sequence[Any]) -> Members:
    """Read members from a list of mappings, one per member."""
    for i, row in enumerate(given):
        if not isinstance(row, Mapping):
            raise ParameterError(
                f"member {i} is {brief(repr(row))}: give a mapping of names to values"
            )
    names = dict.fromkeys(name for row in given for name in row)
    for i, row in enumerate(given):
        for name in names:
            if name not in row:
                raise ParameterError(
                    f"member {i} has no value of '{brief(name)}', which another one has: give it "
                    "to all"
                )
    return _from_columns(
        {name: [row[name] for row in given] for name in names}, None, {}, len(given)
    )


def _from_columns(
    columns: Mapping[Any, Any],
    labels: npt.NDArray[Any] | None,
    origin: Mapping[str, Any],
    n: int | None = None,
) -> Members:
    """Combine columns to members; a single number applies to all members."""
    if not columns and n is None:
        raise ParameterError(f"members have no columns: {_FORMS}")
    read = {}
    for name, values in columns.items():
        if not isinstance(name, str):
            raise ParameterError(
                f"members have the column {brief(repr(name))}: name it as the parameter or state "
                "that it sets"
            )
        read[name] = column_values(values, f"column '{brief(name)}' of members")
    lengths = {name: len(values) for name, values in read.items() if values.ndim}
    if len(set(lengths.values())) > 1:
        (first, n_first), *others = lengths.items()
        other = next(row for row in others if row[1] != n_first)
        raise ParameterError(
            f"columns of members differ in length: '{brief(first)}' has {n_first} values, "
            f"'{brief(other[0])}' has {other[1]}"
        )
    n_members = next(iter(lengths.values()), 1 if n is None else n)
    if n_members == 0:
        raise ParameterError("members are empty: give at least one")
    rows = np.empty((n_members, len(read)))
    for j, values in enumerate(read.values()):
        rows[:, j] = values
    labels = np.arange(n_members) if labels is None else labels
    return Members(tuple(read), rows, {MEMBER: labels}, origin)
