"""Parsing of the ranges of estimated parameters: bounds, scale and initial guess."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from cotree.errors import ParameterError, brief
from cotree.estimation.estimated import SCALES, Estimated
from cotree.scene.expressions import check_number

# Default bounds of a positive parameter: its initial guess divided and multiplied by this.
_SPAN = 100.0


def read_ranges(parameters: Any) -> dict[str, Any]:
    """Read names of estimated parameters with their ranges, which :func:`estimated` reads.

    Raises
    ------
    ParameterError
        If there are none, or something is not a name.
    """
    if isinstance(parameters, str):
        parameters = [parameters]
    if not isinstance(parameters, (Mapping, Sequence)):
        raise ParameterError(
            'give what is estimated as parameters={"k": (10, 100, "log"), ...}, with bounds of each'
        )
    found: dict[str, Any] = {}
    for item in parameters:
        name = item.name if isinstance(item, Estimated) else item
        if not isinstance(name, str) or not name:
            raise ParameterError(f"parameters holds {brief(repr(item))}: give names of parameters")
        if name in found:
            raise ParameterError(f"'{name}' is given twice: name it once")
        found[name] = parameters[item] if isinstance(parameters, Mapping) else item
        if found[name] is name:  # an entry of a list of names, without a range
            found[name] = None
    if not found:
        raise ParameterError("nothing is estimated: name at least one parameter")
    return found


def estimated(
    name: str, given: Any, start: float | None, nominal: float | None, unit: str = ""
) -> Estimated:
    """Read the range of one parameter.

    Parameters
    ----------
    name : str
        Its name.
    given : tuple, Estimated or None
        ``(lower, upper)`` or ``(lower, upper, scale)``, where None means no bound; or None: from a
        hundredth to a hundred times the initial guess, on a logarithmic scale.
    start : float or None
        The user's initial guess.
    nominal : float or None
        The model's value, which is the default guess if it is within the bounds.
    unit : str
        Its unit.

    Raises
    ------
    ParameterError
        If the range is invalid, or there is neither a range nor a positive guess.
    """
    what = f"estimated parameter '{name}'"
    if isinstance(given, Estimated):
        start = given.start if start is None else start
        given = (given.lower, given.upper, given.scale)
    begin = nominal if start is None else start
    if given is None:
        if begin is None or not begin > 0.0:
            reason = "has no initial guess" if begin is None else f"starts at {begin:g}"
            raise ParameterError(
                f'{what} {reason}, so it has no default bounds: give "{name}": (lower, upper)'
            )
        return Estimated(name, begin / _SPAN, begin * _SPAN, "log", begin, unit)
    if isinstance(given, str) or not isinstance(given, Sequence) or len(given) not in (2, 3):
        raise ParameterError(
            f"{what} has the range {brief(repr(given))}: give (lower, upper) or "
            f"(lower, upper, scale), with the scale {' or '.join(map(repr, SCALES))}"
        )
    ends = (-math.inf, math.inf) if tuple(given[2:]) in ((), ("lin",)) else (0.0, math.inf)
    lower, upper = (
        end if value is None else _bound(value, what)
        for value, end in zip(given[:2], ends, strict=True)
    )
    scale = str(given[2]) if len(given) == 3 else "lin"
    if start is None:
        # The scene's value is only a default: it is dropped if it violates the bounds.
        inside = (
            nominal is not None and lower <= nominal <= upper and (scale == "lin" or nominal > 0.0)
        )
        begin = nominal if inside else None
    elif scale != "lin" and not start > 0.0:
        raise ParameterError(f"{what} starts at {start:g}, which has no logarithm")
    return Estimated(name, lower, upper, scale, begin, unit)


def _bound(value: Any, what: str) -> float:
    """Check a bound, which may be infinite."""
    if isinstance(value, float) and math.isinf(value):
        return value
    return check_number(value, f"a bound of {what}")
