"""Points of lookup tables in CSV files."""

from __future__ import annotations

import csv
import io

from cotree.errors import SceneError, brief
from cotree.files import is_number

#: Bytes that a file of points may have.
LARGEST_POINTS = 20_000_000


def read_points(
    text: str, file: str, where: str
) -> tuple[list[float], list[float] | None, list[float] | list[list[float]]]:
    """Read the points of a table: arguments, those of a second axis, and values.

    Two columns are arguments and values, below a line of names or without one. More columns are a
    table of two arguments: its first line holds the second argument after an empty or named corner,
    and each further line an argument and its values.

    Parameters
    ----------
    text : str
        The file.
    file, where : str
        The file and the table, for messages.

    Raises
    ------
    SceneError
        If a line is not of this form; the message names it.
    """
    try:
        lines = [
            (reader.line_num, row) for reader in (csv.reader(io.StringIO(text)),) for row in reader
        ]
    except csv.Error as error:
        raise SceneError(
            f"{where}: {file} is no table of comma-separated values: {error}"
        ) from None
    rows = [(n, row) for n, row in lines if any(item.strip() for item in row)]
    if not rows:
        raise SceneError(f"{where}: {file} is empty")
    width = len(rows[0][1])
    for n, row in rows:
        if len(row) != width or width < 2:
            raise SceneError(
                f"{where}: {file}, line {n} has {len(row)} columns: give two, or as many as in the "
                "first line"
            )

    def numbers(n: int, row: list[str]) -> list[float]:
        return [_number(item, f"{where}: {file}, line {n}") for item in row]

    if width == 2:
        own = rows if is_number(rows[0][1][0]) else rows[1:]
        points = [numbers(n, row) for n, row in own]
        return [point[0] for point in points], None, [point[1] for point in points]
    number, head = rows[0]
    y = numbers(number, head[1:])
    points = [numbers(n, row) for n, row in rows[1:]]
    return [point[0] for point in points], y, [point[1:] for point in points]


def _number(text: str, where: str) -> float:
    if not is_number(text):
        raise SceneError(f"{where}: {brief(repr(text.strip()))} is no number")
    return float(text)
