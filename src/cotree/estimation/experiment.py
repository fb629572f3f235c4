"""Experiments: measured data and the conditions under which they were recorded."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.arguments import check_choice, check_mapping
from cotree.errors import ParameterError, brief, nearest
from cotree.estimation.estimated import SCALES
from cotree.files import is_number, read_rows, read_text
from cotree.scene.expressions import check_number
from cotree.units import Unit, check_fits, check_unit

if TYPE_CHECKING:
    from cotree.estimation.estimated import Array

_LARGEST = 2**30  # maximum file size, [byte]
_MISSING = frozenset({"", "nan", "na", "n/a", "none", "null", "-"})

#: Recognised names of the time column, in lower case.
_TIMES = ("t", "time")

_BRACKETS = re.compile(r"(.*\S)\s*\[([^\[\]]*)\]\s*\Z", re.DOTALL)
_PARENTHESES = re.compile(r"(.*\S)\s+\(([^()]*)\)\s*\Z", re.DOTALL)


@dataclass(frozen=True)
class Column:
    """A column of numbers with its name and unit."""

    #: Name and unit: ``angle`` and ``deg`` for ``angle [deg]``.
    name: str
    unit: str
    values: Array  # values in the unit of the column; missing values are nan


@dataclass(frozen=True)
class MeasuredTable:
    """Measured columns over time."""

    where: str  # description of the data source, for messages
    rows: Sequence[str]  # name of each row in messages, such as "line 5"
    t: Array  # increasing times of the rows, [s]
    columns: Mapping[str, Column]  # columns by name, without the time column

    def column(self, name: str) -> Column:
        """Return a column by its name, which may include the unit."""
        plain = split_unit(name)[0]
        for known in (name, plain):
            if known in self.columns:
                return self.columns[known]
        raise ParameterError(f"{self.where} has no column '{name}'{nearest(name, self.columns)}")

    def unit(self, column: Column, wanted: str = "", given: str | None = None) -> Unit | None:
        """Return a column's unit; raise an error if the measured quantity has another dimension."""
        what = f"column '{column.name}' of {self.where}"
        unit = check_unit(column.unit if given is None else given, f"the unit of {what}")
        if unit is not None and wanted:
            check_fits(unit, wanted, what)
        return unit


def read_table(data: Any, where: str, time: str | None = None) -> MeasuredTable:
    """Read measured data from a file, DataFrame or mapping; messages call the data ``where``."""
    if isinstance(data, (str, os.PathLike)):
        where = Path(data).name
        columns, rows = _read_csv(Path(data), where)
    else:
        columns, rows = _read_mapping(data, where)
    name = _time_column(columns, where, time)
    times = columns.pop(name)
    unit = check_unit(times.unit, f"the unit of column '{name}' of {where}")
    if unit is not None:
        check_fits(unit, "s", f"column '{name}' of {where}")
    t = in_si(times.values, unit)
    # Spreadsheets may append lines that contain only separators.
    others = [column.values for column in columns.values()]
    kept = ~np.isnan(t)
    for i in np.flatnonzero(~kept):
        if any(not np.isnan(values[i]) for values in others):
            raise ParameterError(f"{where}, {rows[i]}: there is no time in column '{name}'")
    names = [rows[i] for i in np.flatnonzero(kept)]
    _check_times(t[kept], names, where)
    found = {n: Column(c.name, c.unit, c.values[kept]) for n, c in columns.items()}
    return MeasuredTable(where, names, t[kept], found)


def in_si(values: Array, unit: Unit | None) -> Array:
    """Convert values to SI units."""
    if unit is None or unit.is_si:
        return values
    return values * float(unit.factor) + float(unit.offset)


def split_unit(name: str) -> tuple[str, str]:
    """Split ``angle [deg]`` or ``angle (deg)`` into name and unit."""
    found = _BRACKETS.match(name) or _PARENTHESES.match(name)
    return (found[1].strip(), found[2].strip()) if found else (name.strip(), "")


def _read_csv(path: Path, where: str) -> tuple[dict[str, Column], list[str]]:
    found = read_rows(read_text(path, _LARGEST), where)
    if not found:
        raise ParameterError(f"{where} is empty: it needs a line of names, and lines of numbers")
    (_, head), *lines = found
    header = [item.strip() for item in head]
    for number, row in lines:
        if len(row) != len(header):
            raise ParameterError(
                f"{where}, line {number} has {len(row)} fields, but its first line names "
                f"{len(header)} columns"
            )
    if all(is_number(item) for item in header):
        raise ParameterError(
            f"{where} begins with numbers: its first line must name the columns, for example time,v"
        )
    if not lines:
        raise ParameterError(f"{where} has no numbers below its first line")
    rows = [f"line {number}" for number, _ in lines]
    named = zip(header, zip(*(row for _, row in lines), strict=True), strict=True)
    return _columns(named, rows, where), rows


def _read_mapping(data: Any, where: str) -> tuple[dict[str, Column], list[str]]:
    items: list[tuple[Any, Any]]
    index = getattr(data, "index", None)
    if hasattr(data, "columns") and index is not None:
        items = [(name, data[name]) for name in data.columns]
        # A named index may be the time column.
        if index.name is not None:
            items.insert(0, (index.name, index))
    elif isinstance(data, Mapping):
        items = list(data.items())
    else:
        raise ParameterError(
            f"{where} is {brief(repr(data))}: give a DataFrame, a mapping of columns, or the path "
            "of a file in CSV"
        )
    lengths = {}
    for name, values in items:
        if not isinstance(name, str):
            raise ParameterError(
                f"{where} has the column {brief(repr(name))}: names must be strings"
            )
        if np.ndim(values) != 1:
            raise ParameterError(
                f"column '{name}' of {where} has shape {np.shape(values)}: give one value for each "
                "time"
            )
        lengths[name] = len(values)
    if not lengths or not any(lengths.values()):
        raise ParameterError(f"{where} is empty: it needs a column of times, and measured ones")
    first = next(iter(lengths))
    for name, n in lengths.items():
        if n != lengths[first]:
            raise ParameterError(
                f"column '{name}' of {where} has {n} values, but '{first}' has {lengths[first]}"
            )
    rows = [f"row {i}" for i in range(lengths[first])]
    return _columns(items, rows, where), rows


def _columns(
    items: Iterable[tuple[str, Any]], rows: Sequence[str], where: str
) -> dict[str, Column]:
    found: dict[str, Column] = {}
    for header, values in items:
        name, unit = split_unit(header)
        if name in found:
            raise ParameterError(f"{where} has two columns '{name}': rename one of them")
        if name:  # a trailing separator creates a column without a name
            found[name] = Column(name, unit, _numbers(values, rows, f"{where}, ", name))
    return found


def _numbers(values: Any, rows: Sequence[str], where: str, name: str) -> Array:
    """Convert values to numbers; missing values become nan."""
    if hasattr(values, "to_numpy"):
        values = values.to_numpy()
    array = np.asarray(values)
    if array.dtype.kind in "fiu":
        found = array.astype(float)
    elif array.dtype.kind in "mM":
        raise ParameterError(f"{where}column '{name}' holds dates: give seconds as numbers")
    elif array.dtype.kind == "c":
        raise ParameterError(f"{where}column '{name}' holds complex numbers: give real ones")
    else:
        found = np.array(
            [
                _number(v, f"{where}{row}, column '{name}'")
                for v, row in zip(values, rows, strict=True)
            ]
        )
    for i in np.flatnonzero(np.isinf(found)).tolist():
        raise ParameterError(f"{where}{rows[i]}, column '{name}': {found[i]} is not finite")
    return found


def _number(value: Any, where: str) -> float:
    if value is None or (isinstance(value, str) and value.strip().lower() in _MISSING):
        return np.nan
    try:
        return float(value)
    except (TypeError, ValueError):
        # pandas.NA, recognised by its type name, because pandas is optional
        if type(value).__name__ == "NAType":
            return np.nan
        raise ParameterError(f"{where}: '{brief(str(value))}' is not a number") from None


def _time_column(columns: Mapping[str, Column], where: str, time: str | None) -> str:
    if time is not None:
        name = split_unit(time)[0]
        if name not in columns:
            raise ParameterError(f"{where} has no column '{time}'{nearest(time, columns)}")
        return name
    for name in columns:
        if name.lower() in _TIMES:
            return name
    listed = ", ".join(f"'{brief(name)}'" for name in list(columns)[:8])
    raise ParameterError(
        f"{where} has no column 't' or 'time', only {listed}: name the time column, time=..."
    )


def _check_times(t: Array, rows: Sequence[str], where: str) -> None:
    if not t.size:
        raise ParameterError(f"{where} holds no times, only missing values")
    wrong = np.flatnonzero(np.diff(t) <= 0.0)
    if not wrong.size:
        return
    i = int(wrong[0])
    if t[i + 1] == t[i]:
        raise ParameterError(
            f"{where}: the time {t[i]:g} s occurs in {rows[i]} and in {rows[i + 1]}: give repeated "
            "measurements as separate Experiments, or average them"
        )
    raise ParameterError(
        f"{where}, {rows[i + 1]}: the time {t[i + 1]:g} s is before {t[i]:g} s of {rows[i]}: sort "
        "the rows by time"
    )


class Experiment:
    """Measured data of one run, and the conditions under which they were recorded.

    Parameters
    ----------
    data : path of a CSV file, DataFrame, or mapping of str to array_like
        A column of increasing times, [s], and any number of measured columns, all of shape
        (n_times,). Missing values are nan, or empty cells in a file. Column names may include
        units, as in ``angle [deg]``; columns without a unit are in SI units.
    inputs : mapping of str to number, str or (times, values), optional
        Inputs of this run that replace the scene's; see :meth:`cotree.Model.simulate`. New names in
        expressions are parameters, which must be set in ``parameters`` or estimated. A column with
        the name of an input replaces this input, with linear interpolation, unless ``inputs``
        contains it.
    initial, parameters : mapping of str to float or str, optional
        Initial values of states and values of parameters in this run, in SI units; a string is the
        name of an estimated parameter.
    observables : mapping of str to str, or sequence of str, optional
        The quantity measured by each column: an expression with the syntax of scene outputs. By
        default, columns with names of states and outputs are used.
    noise : number, str, or mapping of str to number or str, optional
        Standard deviation of the noise, for all columns or for each: a number in the unit of the
        column, the name of another column, or an expression or estimated parameter in SI units. By
        default it is estimated.
    units : mapping of str to str, optional
        Units of columns whose names do not contain them.
    transform : str or mapping of str to str, optional
        ``log`` or ``log10``, for all columns or for each. Logarithms of measured and computed
        values are then compared, and ``noise`` is the standard deviation of the logarithms.
    time : str, optional
        Name of the time column; by default ``t`` or ``time``.
    t_start : float
        Time at which the run starts, [s], not after the first measurement.
    name : str, optional
        Name in tables and plots; by default the name of the file or the number of the experiment.

    Raises
    ------
    ParameterError, UnitError, SceneError
        If the data cannot be read; the message names file, row and column.

    Examples
    --------
    >>> run = Experiment({"time": [0, 1, 2], "T [degC]": [80, 62, 50]}, noise=0.5,
    ...                  observables={"T": "body.T"})
    >>> run.table.t.tolist()
    [0.0, 1.0, 2.0]
    """

    def __init__(
        self,
        data: Any,
        *,
        inputs: Mapping[str, Any] | None = None,
        initial: Mapping[str, float | str] | None = None,
        parameters: Mapping[str, float | str] | None = None,
        observables: Mapping[str, str] | Sequence[str] | None = None,
        noise: float | str | Mapping[str, float | str] | None = None,
        units: Mapping[str, str] | None = None,
        transform: str | Mapping[str, str] | None = None,
        time: str | None = None,
        t_start: float = 0.0,
        name: str | None = None,
    ) -> None:
        is_file = isinstance(data, (str, os.PathLike))
        self.name = name if name is not None or not is_file else Path(data).stem
        where = "the data" if self.name is None else f"the data of experiment '{self.name}'"
        self.table: MeasuredTable = read_table(data, where, time)
        self.where = self.table.where
        self.inputs = check_mapping(inputs, f"inputs of {self.where}")
        self.initial = self._values("initial", initial)
        self.parameters = self._values("parameters", parameters)
        self.observables = self._observed(observables)
        self._noise = self._by_column("noise", noise)
        self._units = self._by_column("units", units)
        self._transform = self._by_column("transform", transform)
        for word in self._transform.values():
            check_choice(word, f"transform of {self.where}", SCALES)
        self.t_start = check_number(t_start, f"t_start of {self.where}")
        early = np.flatnonzero(self.table.t < self.t_start)
        if early.size:
            raise ParameterError(
                f"{self.where}, {self.table.rows[early[0]]}: the time {self.table.t[early[0]]:g} s "
                f"is before the start of the run at {self.t_start:g} s: give t_start"
            )

    def __repr__(self) -> str:
        names = ", ".join(self.table.columns)
        t = self.table.t
        return f"<Experiment {self.name or ''}: {names} at {t.size} times to {t[-1]:g} s>"

    def noise_of(self, column: str) -> float | str | None:
        """Return the user's noise of a column; None if it is to be estimated."""
        found = self._noise.get(column, self._noise.get(""))
        if found is None or isinstance(found, str):
            return found
        return check_number(found, f"the noise of column '{column}' of {self.where}")

    def unit_of(self, column: str) -> str | None:
        """Return the unit of a column in ``units``, or None."""
        return self._units.get(column)

    def transform_of(self, column: str) -> str:
        """Return the transformation with which values of a column are compared."""
        return str(self._transform.get(column, self._transform.get("", "lin")))

    def _values(self, what: str, given: Any) -> dict[str, float | str]:
        """Return values by name after checking that they are numbers or names."""
        where = f"{what} of {self.where}"
        return {
            name: v if isinstance(v, str) else check_number(v, f"'{brief(name)}' in {where}")
            for name, v in check_mapping(given, where).items()
        }

    def _observed(self, given: Any) -> dict[str, str] | None:
        """Return the quantity measured by each column; keys are column names without units."""
        if given is None:
            return None
        if isinstance(given, str):
            given = [given]
        if not isinstance(given, Mapping):
            given = {name: split_unit(str(name))[0] for name in given}
        if not given:
            raise ParameterError(f"observables of {self.where} names no column: omit it")
        for name, text in given.items():
            if isinstance(text, bool) or not isinstance(text, str):
                raise ParameterError(
                    f"column '{brief(str(name))}' of {self.where} measures {text!r}: give an "
                    "expression of states and outputs in quotes"
                )
        return {self.table.column(str(name)).name: text for name, text in given.items()}

    def _by_column(self, what: str, given: Any) -> dict[str, Any]:
        """Return a mapping by column; the key ``""`` has a value for all columns."""
        if given is None:
            return {}
        if not isinstance(given, Mapping):
            return {"": given}
        try:
            return {self.table.column(str(name)).name: value for name, value in given.items()}
        except ParameterError as error:
            raise ParameterError(f"{what}: {error}") from None
