"""Measured data as columns of numbers: data frames, mappings of arrays, and files in CSV.

Whatever cannot be read is refused by a sentence with file, row and column. A column may have its
unit in its name, ``angle [deg]``; missing values are nan.
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
from cotree.files import read_text
from cotree.units import check_fits, check_unit

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from cotree.units import Unit

Array = npt.NDArray[np.float64]

_LARGEST = 2**30  # of a file, [byte]
_MISSING = frozenset({"", "nan", "na", "n/a", "none", "null", "-"})

#: Names by which a column of times is known, in small letters.
_TIMES = ("t", "time")

_BRACKETS = re.compile(r"(.*\S)\s*\[([^\[\]]*)\]\s*\Z", re.DOTALL)
_PARENTHESES = re.compile(r"(.*\S)\s+\(([^()]*)\)\s*\Z", re.DOTALL)


@dataclass(frozen=True)
class Column:
    """Numbers of a column.

    Attributes
    ----------
    name, unit : str
        Of ``angle [deg]``, these are ``angle`` and ``deg``.
    values : ndarray, shape (n,)
        As they were given; missing ones are nan.
    """

    name: str
    unit: str
    values: Array


@dataclass(frozen=True)
class Table:
    """Columns of numbers over times.

    Attributes
    ----------
    where : str
        Where they are from, for messages.
    rows : sequence of str
        The name of each row, for messages: "line 5" of a file.
    t : ndarray, shape (n,)
        Times, [s], which increase.
    columns : mapping of str to Column
        By their names.
    """

    where: str
    rows: Sequence[str]
    t: Array
    columns: Mapping[str, Column]

    def column(self, name: str) -> Column:
        """Find a column, by its name with or without the unit.

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
        """Read the unit of a column, and compare it with the one of what was measured.

        Raises
        ------
        UnitError
            If it is no unit, or one of another dimension.
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
        Columns of one length, one of them of times.
    where : str
        Where they are from, for messages; of files, this is their name.
    time : str, optional
        The column of times; ``t`` or ``time`` where absent, in small or capital letters.

    Raises
    ------
    ParameterError, UnitError, SceneError
        If they cannot be read.
    """
    if isinstance(data, (str, os.PathLike)):
        where = Path(data).name
        columns, rows = _read_csv(Path(data), where)
    else:
        columns, rows = _read_mapping(data, where)
    own = _time_column(columns, where, time)
    times = columns.pop(own)
    unit = check_unit(times.unit, f"the unit of column '{own}' of {where}")
    if unit is not None:
        check_fits(unit, "s", f"column '{own}' of {where}")
    t = in_si(times.values, unit)
    # Lines that are empty but for their commas stand at the end of some tables.
    others = [column.values for column in columns.values()]
    kept = ~np.isnan(t)
    for i in np.flatnonzero(~kept):
        if any(not np.isnan(values[i]) for values in others):
            raise ParameterError(f"{where}, {rows[i]}: there is no time in column '{own}'")
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
    if all(_is_number(item) for item in header):
        raise ParameterError(
            f"{where} begins with numbers: its first line must name the columns, time,v say"
        )
    if not fields:
        raise ParameterError(f"{where} has no numbers below its first line")
    # Where commas separate no columns, they may be decimal points.
    if separator != ",":
        fields = [[item.replace(",", ".") for item in row] for row in fields]
    named = zip(header, zip(*fields, strict=True), strict=True)
    return _columns(named, rows, where), rows


def _read_mapping(data: Any, where: str) -> tuple[dict[str, Column], list[str]]:
    items: list[tuple[Any, Any]]
    index = getattr(data, "index", None)
    if hasattr(data, "columns") and index is not None:
        items = [(name, data[name]) for name in data.columns]
        # A column of times that was made the index is one still.
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
            raise ParameterError(f"{where} has the column {brief(repr(name))}: names are texts")
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
    """Turn named sequences into columns."""
    found: dict[str, Column] = {}
    for header, values in items:
        name, unit = split_unit(header)
        if name in found:
            raise ParameterError(f"{where} has two columns '{name}': rename one of them")
        if name:  # a separator at the end of each line makes a column without a name
            found[name] = Column(name, unit, _numbers(values, rows, f"{where}, ", name))
    return found


def _numbers(values: Any, rows: Sequence[str], where: str, name: str) -> Array:
    """Turn values into numbers, of which missing ones are nan."""
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
        # pandas has a missing value of its own.
        if type(value).__name__ == "NAType":
            return np.nan
        raise ParameterError(f"{where}: '{brief(str(value))}' is not a number") from None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


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
        f"{where} has no column 't' or 'time', only {listed}: name that of times, time=..."
    )


def _check_times(t: Array, rows: Sequence[str], where: str) -> None:
    """Refuse times that do not increase."""
    if not t.size:
        raise ParameterError(f"{where} holds no times, only missing values")
    wrong = np.flatnonzero(np.diff(t) <= 0.0)
    if not wrong.size:
        return
    i = int(wrong[0])
    if t[i + 1] == t[i]:
        raise ParameterError(
            f"{where}: the time {t[i]:g} s stands in {rows[i]} and in {rows[i + 1]}: repeated "
            "measurements need an Experiment each, or their mean"
        )
    raise ParameterError(
        f"{where}, {rows[i + 1]}: the time {t[i + 1]:g} s is before {t[i]:g} s of {rows[i]}: sort "
        "the rows by time"
    )
