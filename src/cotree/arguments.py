"""Argument checks for public functions: whole numbers, names, mappings, lists and tables."""

from __future__ import annotations

import numbers
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeGuard

import numpy as np
import numpy.typing as npt

from cotree.errors import ParameterError, brief, nearest

# A larger integer may have no exact double.
_LARGEST_INTEGER = 2**53
_UNREAL = {"c", "m", "M"}  # NumPy kinds of complex numbers, durations, dates
_DEEPEST = 4  # maximum nesting depth, since a list may contain itself


def check_whole(value: object, what: str, least: int = 0) -> int:
    """Return ``value`` if it is an integer of at least ``least``, otherwise raise an error."""
    if isinstance(value, bool) or not isinstance(value, numbers.Integral) or value < least:
        raise ParameterError(
            f"{what} is {brief(repr(value))}: give a whole number of at least {least}"
        )
    return int(value)


def check_choice(value: object, what: str, known: Sequence[str]) -> str:
    """Return ``value`` if it is one of the ``known`` words, otherwise raise an error."""
    if not isinstance(value, str) or value not in known:
        hint = nearest(value, known)
        if "did you mean" not in hint:
            hint = f": give {', '.join(map(repr, known[:-1]))} or {known[-1]!r}"
        raise ParameterError(f"{what} is {brief(repr(value))}{hint}")
    return value


def check_names(value: object, what: str, kind: str = "names") -> tuple[str, ...]:
    """Return one name, several names or None as a tuple; messages call the names ``kind``."""
    if value is None:
        return ()
    found = (value,) if isinstance(value, str) or not isinstance(value, Iterable) else tuple(value)
    if not all(isinstance(name, str) for name in found):
        raise ParameterError(f"{what} is {brief(repr(value))}: give a list of {kind}")
    return found


def by_name(value: Any) -> Any:
    """Convert a pandas Series with names as labels to a dict; return other values unchanged."""
    if not hasattr(value, "to_dict") or isinstance(value, Mapping):
        return value
    # Labels identify the values, so their order does not matter.
    found = value.to_dict()
    return found if all(isinstance(name, str) for name in found) else value


def check_mapping(value: object, what: str) -> dict[str, Any]:
    """Return a dict of values by name, empty for None; raise an error for other types."""
    value = by_name(value)
    if value is None:
        return {}
    if not isinstance(value, Mapping) or not all(isinstance(name, str) for name in value):
        raise ParameterError(f"{what} is {brief(repr(value))}: give a mapping of names to values")
    return dict(value)


def plain(value: Any, depth: int = 0) -> Any:
    """Copy a value with its nested lists and tables; NumPy numbers become Python numbers.

    Values of other types are returned unchanged; later checks reject them.
    """
    if isinstance(value, (str, bytes, bool)) or depth > _DEEPEST:
        return value
    # TOML can write Python numbers, but not NumPy scalars.
    if isinstance(value, numbers.Integral) and abs(int(value)) <= _LARGEST_INTEGER:
        return int(value)
    if isinstance(value, numbers.Real):
        try:
            return float(value)
        except (OverflowError, ValueError):
            return value
    if hasattr(value, "tolist"):  # arrays of NumPy and similar libraries
        return plain(value.tolist(), depth + 1)
    if isinstance(value, Mapping):
        return {key: plain(item, depth + 1) for key, item in value.items()}
    if isinstance(value, Iterable):
        return [plain(item, depth + 1) for item in value]
    return value


def doubles(value: Any) -> npt.NDArray[np.float64] | None:
    """Convert a value to a contiguous array of doubles; return None if it is not real."""
    if getattr(getattr(value, "dtype", None), "kind", "") in _UNREAL:
        return None
    try:
        return np.array(value, dtype=float, order="C")
    except (TypeError, ValueError, OverflowError):
        return None


def is_list(value: object) -> TypeGuard[Sequence[Any]]:
    """Return whether a value is a sequence other than a string."""
    return isinstance(value, Sequence) and not isinstance(value, str)
