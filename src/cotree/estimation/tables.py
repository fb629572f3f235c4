"""Import of measured data from data frames, mappings of arrays, and CSV files.

Error messages name the file, row and column at fault. The name of a column may include its unit,
``angle [deg]``; missing values are nan.
"""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.errors import ParameterError, brief, nearest
from cotree.files import is_number, read_text
from cotree.units import check_fits, check_unit

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from cotree.units import Unit

Array = npt.NDArray[np.float64]

_LARGEST = 2**30  # file size, [byte]
_MISSING = frozenset({"", "nan", "na", "n/a", "none", "null", "-"})

#: Recognised names of the time column, in lower case.
_TIMES = ("t", "time")

_BRACKETS = re.compile(r"(.*\S)\s*\[([^\[\]]*)\]\s*\Z", re.DOTALL)
_PARENTHESES = re.compile(r"(.*\S)\s+\(([^()]*)\)\s*\Z", re.DOTALL)


@dataclass(frozen=True)
class Column:
    """A column of numbers.

    Attributes
    ----------
    name, unit : str
        Name and unit: ``angle`` and ``deg`` for ``angle [deg]``.
    values : ndarray, shape (n,)
        Values in this unit; missing ones are nan.
    """

    name: str
    unit: str
    values: Array


@dataclass(frozen=True)
class Table:
    """Columns of numbers as functions of time.

    Attributes
    ----------
    where : str
        Origin of the data, for messages.
    rows : sequence of str
        Designation of each row, for messages, such as "line 5".
    t : ndarray, shape (n,)
        Increasing times, [s].
    columns : mapping of str to Column
        The other columns by name.
    """

    where: str
    rows: Sequence[str]
    t: Array
    columns: Mapping[str, Column]

    def column(self, name: str) -> Column:
        """Return a column by its name with or without the unit.

        Raises
        ------
        ParameterError
            If there is none.
        """
        plain = split_unit(name)[0]
        for known in (name, plain):
            if known in self.columns:
                return self.columns[known]
        raise ParameterError(f"{self.where} has no column '{name}'{nearest(name, self.columns)}")

    def unit(self, column: Column, wanted: str = "", given: str | None = None) -> Unit | None:
        """Parse the unit of a column and check it against that of the measured quantity.

        Raises
        ------
        UnitError
            If it is not a unit, or has another dimension.
        """
        what = f"column '{column.name}' of {self.where}"
        unit = check_unit(column.unit if given is None else given, f"the unit of {what}")
        if unit is not None and wanted:
            check_fits(unit, wanted, what)
        return unit


def read_table(data: Any, where: str, time: str | None = None) -> Table:
    """Read measured data.

    Parameters
    ----------
    data : path, DataFrame, or mapping of str to array_like
        Columns of equal length, including one of times.
    where : str
        Origin of the data, for messages; for files, their name is used.
    time : str, optional
        The time column; by default ``t`` or ``time``, in lower or upper case.

    Raises
    ------
    ParameterError, UnitError, SceneError
        If the data cannot be read.
    """
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
    # Spreadsheets may append lines that contain nothing but separators.
    others = [column.values for column in columns.values()]
    kept = ~np.isnan(t)
    for i in np.flatnonzero(~kept):
        if any(not np.isnan(values[i]) for values in others):
            raise ParameterError(f"{where}, {rows[i]}: there is no time in column '{name}'")
    names = [rows[i] for i in np.flatnonzero(kept)]
    _check_times(t[kept], names, where)
    found = {n: Column(c.name, c.unit, c.values[kept]) for n, c in columns.items()}
    return Table(where, names, t[kept], found)


def in_si(values: Array, unit: Unit | None) -> Array:
    """Convert values to SI."""
    if unit is None or unit.is_si:
        return values
    return values * float(unit.factor) + float(unit.offset)


def split_unit(name: str) -> tuple[str, str]:
    """Split ``angle [deg]`` or ``angle (deg)``."""
    found = _BRACKETS.match(name) or _PARENTHESES.match(name)
    return (found[1].strip(), found[2].strip()) if found else (name.strip(), "")


def _read_csv(path: Path, where: str) -> tuple[dict[str, Column], list[str]]:
    text = read_text(path, _LARGEST)
    if not text.strip():
        raise ParameterError(f"{where} is empty: it needs a line of names, and lines of numbers")
    first = next(line for line in text.splitlines() if line.strip() and line[0] != "#")
    separator = max(",;\t", key=first.count)
    reader = csv.reader(io.StringIO(text), delimiter=separator, skipinitialspace=True)
    header: list[str] | None = None
    fields, rows = [], []
    for row in reader:
        if not any(item.strip() for item in row) or row[0].startswith("#"):
            continue
        if header is None:
            header = [item.strip() for item in row]
            continue
        if len(row) != len(header):
            raise ParameterError(
                f"{where}, line {reader.line_num} has {len(row)} fields, but its first line names "
                f"{len(header)} columns"
            )
        fields.append(row)
        rows.append(f"line {reader.line_num}")
    header = header or []
    if all(is_number(item) for item in header):
        raise ParameterError(
            f"{where} begins with numbers: its first line must name the columns, time,v say"
        )
    if not fields:
        raise ParameterError(f"{where} has no numbers below its first line")
    # If another separator is used, commas may be decimal points.
    if separator != ",":
        fields = [[item.replace(",", ".") for item in row] for row in fields]
    named = zip(header, zip(*fields, strict=True), strict=True)
    return _columns(named, rows, where), rows


def _read_mapping(data: Any, where: str) -> tuple[dict[str, Column], list[str]]:
    items: list[tuple[Any, Any]]
    index = getattr(data, "index", None)
    if hasattr(data, "columns") and index is not None:
        items = [(name, data[name]) for name in data.columns]
        # The time column may be the index.
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
    """Convert named sequences to columns."""
    found: dict[str, Column] = {}
    for header, values in items:
        name, unit = split_unit(header)
        if name in found:
            raise ParameterError(f"{where} has two columns '{name}': rename one of them")
        if name:  # a separator at the end of each line creates a column without a name
            found[name] = Column(name, unit, _numbers(values, rows, f"{where}, ", name))
    return found


def _numbers(values: Any, rows: Sequence[str], where: str, name: str) -> Array:
    """Convert values to numbers; missing ones become nan."""
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
        # The missing value of pandas; the package need not be installed.
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
    """Refuse times that are not strictly increasing."""
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
