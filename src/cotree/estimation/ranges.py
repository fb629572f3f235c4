"""Ranges of estimated parameters as users give them: bounds, a scale, and where to begin."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from cotree.errors import ParameterError, brief
from cotree.estimation.estimated import SCALES, Estimated
from cotree.scene.expressions import check_number

# Bounds of a positive parameter without any: this share and this multiple of where it begins.
_SPAN = 100.0


def read_ranges(parameters: Any) -> dict[str, Any]:
    """Read names of estimated parameters with their ranges, which :func:`estimated` reads.

    Raises
    ------
    ParameterError
        If there are none, or they are no names.
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
            raise ParameterError(f"'{name}' is estimated twice: name it once")
        found[name] = parameters[item] if isinstance(parameters, Mapping) else item
        if found[name] is name:  # of a list, which has names only
            found[name] = None
    if not found:
        raise ParameterError("nothing is estimated: name at least one parameter")
    return found


def estimated(
    name: str, given: Any, start: float | None, own: float | None, unit: str = ""
) -> Estimated:
    """Read the range of one parameter.

    Parameters
    ----------
    name : str
        Its name.
    given : tuple, Estimated or None
        ``(lower, upper)``, ``(lower, upper, scale)``, where None stands for no bound, or None: a
        hundredth to a hundred times where it begins, on a logarithmic scale.
    start : float or None
        Where a user lets it begin.
    own : float or None
        The model's value, which is taken for the start if it is within the bounds.
    unit : str
        Its unit.

    Raises
    ------
    ParameterError
        If the range makes no sense, or none was given and there is no positive start.
    """
    what = f"estimated parameter '{name}'"
    if isinstance(given, Estimated):
        start = given.start if start is None else start
        given = (given.lower, given.upper, given.scale)
    begin = own if start is None else start
    if given is None:
        if begin is None or not begin > 0.0:
            told = "has no value to begin with" if begin is None else f"begins at {begin:g}"
            raise ParameterError(
                f'{what} {told}, so its bounds are not clear: give them, "{name}": (lower, upper)'
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
        # The value of the scene is a guess: bounds count for more.
        inside = own is not None and lower <= own <= upper and (scale == "lin" or own > 0.0)
        begin = own if inside else None
    elif scale != "lin" and not start > 0.0:
        raise ParameterError(f"{what} begins at {start:g}, which has no logarithm")
    return Estimated(name, lower, upper, scale, begin, unit)


def _bound(value: Any, what: str) -> float:
    """Check a bound, which may be infinite."""
    if isinstance(value, float) and math.isinf(value):
        return value
    return check_number(value, f"a bound of {what}")
