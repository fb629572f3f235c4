"""Frozen records made of others: ``dataclasses.replace`` for calls that take microseconds.

``replace`` looks at every field and calls ``__init__``, which sets them one by one through
``object.__setattr__``: of a record of thirty fields that takes as long as a small integration.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from collections.abc import Mapping

T = TypeVar("T")


def changed(record: T, **values: Any) -> T:
    """Give a record with some other values.

    Parameters
    ----------
    record : object
        Of a frozen dataclass without ``__post_init__`` and without cached properties.
    **values
        The other values, by field.
    """
    return filled(type(record), vars(record) | values)


def filled(kind: type[T], values: Mapping[str, Any]) -> T:
    """Give a record of a frozen dataclass from the values of all its fields, by name."""
    record = object.__new__(kind)
    vars(record).update(values)
    return record
