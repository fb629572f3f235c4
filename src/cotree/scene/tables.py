"""Tables: piecewise linear functions of time, and lookup tables over expressions."""

from __future__ import annotations

import ast
import math
import numbers
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from cotree.dag.lookup import Grid
from cotree.dag.multi_output import Table
from cotree.errors import SceneError, UnitError
from cotree.scene.expressions import Expression, parse
from cotree.scene.words import GridName

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.units import Unit


@dataclass(frozen=True)
class Lookup(Expression):
    """A lookup table over one or two expressions.

    Attributes
    ----------
    statement : mapping of str to object
        The table as a scene gives it.
    """

    statement: Mapping[str, Any] = field(default_factory=dict, compare=False, repr=False)

    @property
    def number(self) -> float | None:
        """Nothing: a table is no plain number."""
        return None


_ONE = {"of", "x", "y"}
_TWO = {"of", "x", "y", "values"}
_INTERPOLATIONS = ("linear", "monotone")
_BEYOND = ("hold", "extend")


def parse_lookup(value: Mapping[str, Any], where: str) -> Lookup:
    """Check a table over one expression, ``of``, ``x`` and ``y``, or over two.

    Raises
    ------
    ExpressionError, SceneError
        If an entry is missing, unknown, or of no use.
    """
    stated = {key: item for key, item in value.items() if key not in ("interpolation", "beyond")}
    is_pair = isinstance(value.get("of"), (list, tuple))
    if set(stated) != (_TWO if is_pair else _ONE):
        raise SceneError(
            f"{where} is a table: give 'of', an expression, and as many numbers 'x' as 'y'; or "
            "'of', two expressions in a list, 'x', 'y', and 'values', a row for each 'x'"
        )
    smooth = _choice(value, "interpolation", _INTERPOLATIONS, where) == "monotone"
    extends = _choice(value, "beyond", _BEYOND, where) == "extend"
    if not is_pair:
        made = make_table((value["x"], value["y"]), where, "x")
        grid = Grid((made.x,), made.y, smooth, extends)
        return _over(grid, (value["of"],), value, where)
    if len(value["of"]) != 2:
        raise SceneError(f"'of' of {where} needs an expression, or two in a list")
    axes = tuple(make_table((value[axis], value[axis]), where, axis).x for axis in "xy")
    grid = Grid((axes[0], axes[1]), _surface(value["values"], axes, where), smooth, extends)
    return _over(grid, tuple(value["of"]), value, where)


def parse_any(value: object, where: str) -> Expression:
    """Check a number, an expression, or a table over expressions.

    Raises
    ------
    ExpressionError, SceneError
        If it is none.
    """
    return parse_lookup(value, where) if isinstance(value, Mapping) else parse(value, where)


def _over(grid: Grid, places: tuple[Any, ...], stated: Mapping[str, Any], where: str) -> Lookup:
    """Make the call of a grid."""
    parts = [parse(place, f"'of' of {where}") for place in places]
    name = GridName("lookup", ast.Load())
    name.grid = grid
    text = f"lookup({', '.join(part.text for part in parts)})"
    names = frozenset[str]().union(*(part.names for part in parts))
    tree = ast.Call(name, [part.tree for part in parts], [])
    return Lookup(text, where, tree, names, dict(stated))


def _choice(value: Mapping[str, Any], key: str, known: tuple[str, ...], where: str) -> str:
    chosen = value.get(key, known[0])
    if chosen not in known:
        raise SceneError(f"{key} of {where} must be {' or '.join(map(repr, known))}")
    return str(chosen)


def _surface(rows: object, axes: Sequence[Sequence[float]], where: str) -> tuple[float, ...]:
    """Check the values of a table over two expressions, and list them row by row."""
    try:
        values = np.array(rows, dtype=float)
    except (TypeError, ValueError):
        values = np.zeros(0)
    if values.shape != tuple(len(axis) for axis in axes):
        raise SceneError(
            f"values of {where} must be {len(axes[0])} rows of {len(axes[1])} numbers: a row for "
            "each 'x', and in it a number for each 'y'"
        )
    if not np.all(np.isfinite(values)):
        raise SceneError(f"values of {where} hold one that is not finite")
    return tuple(values.ravel().tolist())


def make_table(value: object, where: str, argument: str) -> Table:
    """Check a pair of arguments and values.

    Parameters
    ----------
    value : pair of sequences of float
        Arguments and values.
    where : str
        What they belong to, for messages.
    argument : str
        What the arguments are called.

    Raises
    ------
    SceneError
        If they are not as many finite numbers each, at least two, or do not increase.
    """
    try:
        # Whatever a user gives is unpacked; what is no pair of rows fails here, with one message.
        x, y = cast("Any", value)
        made = Table(tuple(float(item) for item in x), tuple(float(item) for item in y))
    except (TypeError, ValueError):
        raise SceneError(
            f"{where} must be a number, an expression in quotes, or {argument} and values with as "
            "many numbers each"
        ) from None
    if len(made.x) != len(made.y) or len(made.x) < 2:
        raise SceneError(f"{where} needs as many values as {argument}, at least two")
    if not all(math.isfinite(number) for number in made.x + made.y):
        raise SceneError(f"{where} holds one of {argument} or a value that is not finite")
    # Equal arguments would make a jump, whose own value is left open.
    if any(b <= a for a, b in zip(made.x, made.x[1:], strict=False)):
        raise SceneError(f"{where} needs {argument} that increase")
    return made


def parse_signal(value: object, where: str, unit: Unit | None = None) -> Expression | Table:
    """Accept a number, an expression string or a pair (times, values).

    Parameters
    ----------
    value : object
        What the user gave.
    where : str
        What it belongs to, for messages.
    unit : Unit, optional
        The unit of numbers and values, which become those of SI.

    Raises
    ------
    SceneError, ExpressionError, UnitError
        If it is none of these, or an expression in a unit that is not of SI.
    """
    if isinstance(value, (str, numbers.Real)):
        return converted(parse(value, where), unit, where)
    made = make_table(value, where, "times")
    if unit is None or unit.is_si:
        return made
    return Table(made.x, tuple(unit.to_si(item) for item in made.y))


def converted(value: Expression, unit: Unit | None, where: str) -> Expression:
    """Convert a number to SI.

    Raises
    ------
    UnitError
        If it is an expression in a unit that is not of SI.
    """
    if unit is None or unit.is_si:
        return value
    if value.number is None:
        raise UnitError(
            f"{where} is an expression, whose value is in SI: its unit is '{unit.si}', not "
            f"'{unit.text}'"
        )
    return parse(unit.to_si(value.number), where)
