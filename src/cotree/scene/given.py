"""Arguments of other kinds than numbers, as users give them: whole numbers, names and mappings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from numbers import Integral
from typing import Any

from cotree.errors import ParameterError, brief


def check_whole(value: object, what: str, least: int = 0) -> int:
    """Accept a whole number that is not too small."""
    if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
        raise ParameterError(
            f"{what} is {brief(repr(value))}: give a whole number of at least {least}"
        )
    return int(value)


def check_names(value: object, what: str, kind: str = "names") -> tuple[str, ...]:
    """Accept a name, or several; ``kind`` says what the texts are, for the message."""
    found = (value,) if isinstance(value, str) or not isinstance(value, Iterable) else tuple(value)
    if not all(isinstance(name, str) for name in found):
        raise ParameterError(f"{what} is {brief(repr(value))}: give a list of {kind}")
    return found


def check_mapping(value: object, what: str) -> dict[str, Any]:
    """Accept a mapping of names to values; none stands for an empty one."""
    if value is None:
        return {}
    if not isinstance(value, Mapping) or not all(isinstance(name, str) for name in value):
        raise ParameterError(f"{what} is {brief(repr(value))}: give a mapping of names to values")
    return dict(value)
