"""Tables of a scene: functions of one or two arguments, defined by points.

Values that are expressions become separate terms, so that sensitivities include them.
"""

from __future__ import annotations

import ast
import math
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from cotree.dag.lookup import LinearTable
from cotree.errors import SceneError, brief, check_known, nearest
from cotree.files import is_number, read_rows
from cotree.naming import RESERVED, check_name, check_text
from cotree.scene.expressions import (
    FUNCTIONS,
    WHERE,
    Expression,
    finite,
    name_of,
    names_in,
    parse,
    shown,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.scene.description import SceneDescription


#: Maximum number of values in a table, and of values that are expressions: each adds a term.
LARGEST_TABLE, _MOST_EXPRESSIONS = 100_000, 100

_INTERPOLATIONS = ("linear", "monotone")
_BEYOND = ("hold", "extend")


@dataclass(frozen=True)
class LookupTable:
    """A function defined by its points."""

    name: str  # name in expressions; "table" if it belongs to a single field
    x: tuple[float, ...]  # ascending values of the argument, at least two
    y: tuple[float, ...]  # values of the second argument; empty for a table of one argument
    #: Values at the points; for two arguments one row per ``x``, row after row.
    values: tuple[Expression, ...]
    interpolation: str = "linear"  # ``linear`` (bilinear) or ``monotone`` (cubic)
    #: Extrapolation: ``hold`` keeps the last value, ``extend`` keeps the last slope.
    beyond: str = "hold"
    doc: str = field(default="")  # its meaning as text

    @property
    def n_arguments(self) -> int:
        """Number of arguments."""
        return 2 if self.y else 1

    @property
    def names(self) -> frozenset[str]:
        """Parameters on which the values depend."""
        return frozenset[str]().union(*(value.names for value in self.values))

    def node(self, dag: Dag, args: list[Node], resolve: Callable[[str], Node]) -> Node:
        """Return the node of the table's value."""
        from cotree.dag.lookup import CubicTable, PlaneTable, look_up
        from cotree.dag.multi_output import table

        numbers = [value.number for value in self.values]
        if any(number is None for number in numbers):
            return self._written_out(dag, args[0], [v.lower(dag, resolve) for v in self.values])
        z = cast("tuple[float, ...]", tuple(numbers))
        if self.y:
            # If arguments are not clamped, the outermost intervals extend beyond the ends.
            if self.beyond == "hold":
                args = [_held(at, axis) for at, axis in zip(args, (self.x, self.y), strict=True)]
            return look_up(dag, PlaneTable(self.x, self.y, z), args)
        at = args[0]
        if self.interpolation == "linear":
            inside = table(dag, LinearTable(self.x, z), at)[0]
            ends = [(z[i + 1] - z[i]) / (self.x[i + 1] - self.x[i]) for i in (0, len(z) - 2)]
        else:
            slopes = _monotone_slopes(self.x, z)
            inside = look_up(dag, CubicTable(self.x, z, slopes), [_held(at, self.x)])
            ends = [slopes[0], slopes[-1]]
        if self.beyond == "hold":
            return inside
        below = dag.select(self.x[0] - at, (at - self.x[0]) * ends[0], dag.zero)
        above = dag.select(at - self.x[-1], (at - self.x[-1]) * ends[1], dag.zero)
        return inside + below + above

    def _written_out(self, dag: Dag, at: Node, values: Sequence[Node]) -> Node:
        """Return a linear table as a sum: each interval adds the change of the value within it."""
        found, last = values[0], len(self.x) - 2
        for k, (start, end) in enumerate(pairwise(self.x)):
            way = at - start
            if k > 0 or self.beyond == "hold":
                way = dag.select(way, way, dag.zero)
            if k < last or self.beyond == "hold":
                whole = dag.constant(end - start)
                way = dag.select(way - whole, whole, way)
            found = found + (values[k + 1] - values[k]) * (way / (end - start))
        return found


def _held(at: Node, axis: Sequence[float]) -> Node:
    dag = at.dag
    low, high = dag.constant(axis[0]), dag.constant(axis[-1])
    return dag.select(at - low, dag.select(at - high, high, at), low)


def _monotone_slopes(x: Sequence[float], z: Sequence[float]) -> tuple[float, ...]:
    """Return slopes of monotone cubic pieces, as in SciPy.

    F. N. Fritsch, J. Butland, SIAM J. Sci. Stat. Comput. 5 (1984) 300.
    """
    from scipy.interpolate import PchipInterpolator

    return tuple(PchipInterpolator(x, z)(x, nu=1).tolist())


def make_lookup(
    name: str,
    x: object,
    y: object,
    values: object,
    interpolation: object = "linear",
    beyond: object = "hold",
    *,
    doc: str = "",
    where: str = "",
) -> LookupTable:
    """Create and check a table from ``x`` and ``y``, or from ``x``, ``y`` and ``values``."""
    where = where or f"table '{name}'"
    if beyond == "stop":
        raise SceneError(
            f"beyond of {where} is 'stop': tables do not end runs; use 'hold' or 'extend', "
            "and a terminal event (stop = true) at the limit of the argument"
        )
    for key, value, known in (
        ("interpolation", interpolation, _INTERPOLATIONS),
        ("beyond", beyond, _BEYOND),
    ):
        if value not in known:
            hint = nearest(str(value), known)
            raise SceneError(f"{key} of {where} is {brief(repr(value))}{hint}")
    # The values of a table of one argument are given as ``y`` or as ``values``.
    is_plane = values is not None and y is not None
    rows = _listed(values if values is not None else y, "values", where)
    first = _axis(x, "x", where)
    second = _axis(y, "y", where) if is_plane else ()
    if len(rows) != len(first):
        what = "rows of values" if is_plane else "values"
        raise SceneError(f"{where} has {len(first)} numbers x but {len(rows)} {what}")
    if is_plane:
        rows = _flat(rows, len(second), where)
    if len(rows) > LARGEST_TABLE:
        raise SceneError(f"{where} has {len(rows)} values: at most {LARGEST_TABLE} are allowed")
    made = tuple(parse(item, f"value {i} of {where}") for i, item in enumerate(rows, 1))
    is_written = any(item.number is None for item in made)
    if is_written and (is_plane or interpolation == "monotone" or len(made) > _MOST_EXPRESSIONS):
        raise SceneError(
            f"{where} has values that are expressions: only linear tables of one argument and "
            f"at most {_MOST_EXPRESSIONS} values may have these; give numbers"
        )
    if is_plane and interpolation == "monotone":
        raise SceneError(
            f'{where} has two arguments, for which interpolation = "monotone" does not exist: '
            'use "linear"'
        )
    return LookupTable(name, first, second, made, str(interpolation), str(beyond), doc)


def _listed(value: object, what: str, where: str) -> list[Any]:
    if hasattr(value, "tolist"):
        value = value.tolist()
    if not isinstance(value, (list, tuple)):
        raise SceneError(f"{what} of {where} must be a list")
    return list(value)


def _axis(value: object, what: str, where: str) -> tuple[float, ...]:
    """Return at least two finite numbers in ascending order; raise for other values."""
    items = _listed(value, what, where)
    if len(items) < 2:
        raise SceneError(f"{what} of {where} needs two numbers or more")
    for i, item in enumerate(items, 1):
        if finite(item) is None:
            raise SceneError(
                f"number {i} of {what} of {where} is {shown(item)}: give a finite number"
            )
    for i, (a, b) in enumerate(pairwise(items), 2):
        if not b > a:
            raise SceneError(f"{what} of {where} must ascend: number {i} is {b!r}, after {a!r}")
    return tuple(map(float, items))


def _flat(rows: list[Any], width: int, where: str) -> list[Any]:
    """Return the values of a table of two arguments as one list, row after row."""
    found: list[Any] = []
    for i, row in enumerate(rows, 1):
        items = _listed(row, f"row {i} of values", where)
        if len(items) != width:
            raise SceneError(
                f"row {i} of values of {where} has {len(items)} numbers, but y has {width}"
            )
        found += items
    return found


_OF_FIELDS = ("of", "x", "y", "interpolation", "beyond")


def parse_lookup(value: Mapping[str, Any], where: str) -> Expression:
    """Return a table over an expression, from ``of``, ascending ``x``, ``y``, and interpolation."""
    if not {"of", "x", "y"} <= set(value) <= set(_OF_FIELDS):
        raise SceneError(
            f"{where} is a table: give 'of', an expression, and as many numbers 'x' as 'y'"
        )
    given = dict(value)
    of = parse(given.pop("of"), f"'of' of {where}")
    made = make_lookup("table", given.pop("x"), given.pop("y"), None, **given, where=where)
    tree = ast.Call(name_of("table", made), [of.tree], [])
    return Expression(f"table({of.text})", where, tree, names_in(tree))


def make_table(value: object, where: str, argument: str) -> LinearTable:
    """Create a table over one argument from a checked pair of arguments and values."""
    try:
        # The value may be any object; if it is not a pair, one error message covers all cases.
        x, y = cast("Any", value)
        made = LinearTable(tuple(float(item) for item in x), tuple(float(item) for item in y))
    except (TypeError, ValueError, OverflowError):
        raise SceneError(
            f"{where} must be a number, an expression in quotes, or {argument} and values with as "
            "many numbers each"
        ) from None
    if len(made.x) != len(made.y) or len(made.x) < 2:
        raise SceneError(f"{where} needs as many values as {argument}, at least two")
    if not all(math.isfinite(number) for number in made.x + made.y):
        raise SceneError(f"{where} holds an argument or a value that is not finite")
    # Equal arguments would define a jump whose value is unknown.
    if any(b <= a for a, b in zip(made.x, made.x[1:], strict=False)):
        raise SceneError(f"{where} needs {argument} that increase")
    return made


#: Maximum size of a file of points, [byte].
LARGEST_POINTS = 20_000_000


def read_points(
    text: str, file: str, where: str
) -> tuple[list[float], list[float] | None, list[float] | list[list[float]]]:
    """Return the arguments, second arguments and values of a table from the text of a CSV file.

    Two columns contain arguments and values, and a line of names may precede them. With more
    columns, the first line contains an unused entry, then the second arguments; each further line
    contains a first argument, then a row of values.
    """
    rows = read_rows(text, f"{where}: {file}")
    if not rows:
        raise SceneError(f"{where}: {file} is empty")
    width = len(rows[0][1])
    for n, row in rows:
        if len(row) != width or width < 2:
            raise SceneError(
                f"{where}: {file}, line {n} has {len(row)} columns: give two, or as many as "
                "in the first line"
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
        raise SceneError(f"{where}: {brief(repr(text.strip()))} is not a number")
    return float(text)


_ENTRIES = ("x", "y", "values", "file", "interpolation", "beyond", "doc")


def add_table(
    scene: SceneDescription, name: str, given: Mapping[str, Any], read: Callable[[Any], str]
) -> None:
    """Add a table to a scene."""
    check_name("table", name)
    whose = f"table '{name}'"
    if name in FUNCTIONS or name == WHERE or name in RESERVED:
        raise SceneError(f"{whose} has the name of a function of expressions: rename it")
    if name in scene.tables:
        raise SceneError(f"the name of {whose} is taken: every table needs its own")
    check_known(given, _ENTRIES, f"{whose} has no entry")
    rest = dict(given)
    doc = check_text(rest.pop("doc", ""), f"doc of {whose}")
    file = rest.pop("file", None)
    if file is not None:
        if stated := [key for key in ("x", "y", "values") if key in rest]:
            raise SceneError(f"{whose} has both a file and '{stated[0]}': give one of them")
        text = read(file)
        rest["x"], y, values = read_points(text, Path(file).name, whose)
        rest |= {"values": values} if y is None else {"y": y, "values": values}
    elif "x" not in rest or not ("y" in rest or "values" in rest):
        raise SceneError(f"{whose} needs 'x' and its values, or 'file'")
    x, y, values = (rest.pop(key, None) for key in ("x", "y", "values"))
    scene.tables[name] = make_lookup(name, x, y, values, **rest, doc=doc)
