"""Members of an ensemble as users give them: tables, mappings, lists, grids and samples.

In: any of these. Out: ``Members``, rows of finite numbers with the names of their columns and the
dimensions that results have. What a name stands for is checked against a model later.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.ensemble.grid import Grid
from cotree.ensemble.values import column_values
from cotree.errors import ParameterError, brief, nearest

if TYPE_CHECKING:
    from collections.abc import Container, Iterable

    import numpy.typing as npt

    from cotree.model.model import CompiledModel
    from cotree.solvers.base import FloatArray

#: The dimension along which members lie that are no grid.
MEMBER = "member"

_FORMS = (
    "give a DataFrame, a mapping of arrays, a list of mappings, cotree.grid(...) or "
    "cotree.sample(...)"
)


@dataclass(frozen=True, eq=False)
class Members:
    """Values that the members of an ensemble set.

    Attributes
    ----------
    columns : tuple of str
        Parameters, and states by their initial values.
    rows : ndarray, shape (n_members, n_columns)
        Their values.
    dimensions : mapping of str to ndarray
        Dimensions of the results with their coordinates, whose product the members are in the
        order of the rows: ``member``, or the axes of a grid.
    origin : mapping of str to object
        How they were drawn, if they were.
    is_grid : bool
        Whether they are the product of axes.
    """

    columns: tuple[str, ...]
    rows: FloatArray
    dimensions: Mapping[str, npt.NDArray[Any]]
    origin: Mapping[str, Any] = field(default_factory=dict)
    is_grid: bool = False

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the dimensions."""
        return tuple(len(values) for values in self.dimensions.values())

    def described(self, i: int) -> str:
        """Name a member by its label and values."""
        values = ", ".join(
            f"{name} = {value:.6g}"
            for name, value in zip(self.columns, self.rows[i].tolist(), strict=True)
        )
        if self.is_grid:
            return f"the member {values}"
        return f"member {brief(self.dimensions[MEMBER][i])} ({values})"


def read_members(given: Any) -> Members:
    """Read members.

    Parameters
    ----------
    given : DataFrame, mapping, sequence of mappings, Grid or Samples
        As users give them.

    Raises
    ------
    ParameterError
        If they are of another kind, or none, or a value is no finite number; the message names the
        column and the row.
    """
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
    """Refuse columns that a model does not have, or that a run sets otherwise.

    Parameters
    ----------
    columns : iterable of str
        Their names.
    model : CompiledModel
        The model.
    parameters, initial : container of str
        Names of what all members share.

    Raises
    ------
    ParameterError
        For the first such column.
    """
    derived = {row.name: row.told for row in model.layout.derived}
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
    """Read a table of pandas, or of another library with named columns."""
    names = list(frame.columns)
    for i, name in enumerate(names):
        if name in names[:i]:
            raise ParameterError(f"members have two columns '{brief(name)}': keep one of them")
    index = getattr(frame, "index", None)
    labels = None if index is None else _labels(index)
    return _from_columns({name: frame[name] for name in names}, labels, {})


def _labels(index: Any) -> npt.NDArray[Any]:
    """Read the labels of the rows of a table."""
    if getattr(index, "nlevels", 1) > 1:
        raise ParameterError(
            "the index of members has several levels: call reset_index() to make them columns, or "
            "give a plain index"
        )
    labels = np.asarray(index)
    if labels.dtype.kind in "OUS":  # files of results hold texts of any length, and no others
        labels = np.array([str(label) for label in labels], dtype=object)
    found, counts = np.unique(labels, return_counts=True)
    if len(found) < len(labels):
        raise ParameterError(
            f"the index of members has {brief(found[counts > 1][0])} {max(counts)} times: give "
            "each a label of its own, as reset_index(drop=True) does"
        )
    return labels


def _from_list(given: Sequence[Any]) -> Members:
    """Read a list of mappings, one for each member."""
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
    """Put columns together; a single number counts for all members."""
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
