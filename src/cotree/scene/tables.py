"""Tables: piecewise linear functions of time, or of an expression in a field."""

from __future__ import annotations

import ast
import math
import numbers
from typing import TYPE_CHECKING, Any, cast

from cotree.dag.multi_output import Table
from cotree.errors import SceneError, UnitError
from cotree.scene.calls import name_of
from cotree.scene.expressions import Expression, parse
from cotree.scene.grammar import names_in
from cotree.scene.lookup import make_lookup

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.units import Unit


_OF_FIELDS = ("of", "x", "y", "interpolation", "beyond")


def parse_lookup(value: Mapping[str, Any], where: str) -> Expression:
    """Check a table over an expression: ``of``, ``x`` that ascend, ``y``, and what is between.

    Raises
    ------
    ExpressionError, SceneError
        If an entry is missing, unknown, or of no use.
    """
    if not {"of", "x", "y"} <= set(value) <= set(_OF_FIELDS):
        raise SceneError(
            f"{where} is a table: give 'of', an expression, and as many numbers 'x' as 'y'"
        )
    given = dict(value)
    of = parse(given.pop("of"), f"'of' of {where}")
    made = make_lookup("table", given.pop("x"), given.pop("y"), None, **given, where=where)
    tree = ast.Call(name_of("table", made), [of.tree], [])
    return Expression(f"table({of.text})", where, tree, names_in(tree))


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
    except (TypeError, ValueError, OverflowError):
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
