"""Fast copies of frozen records, instead of ``dataclasses.replace``.

``replace`` calls ``__init__``, which sets fields by ``object.__setattr__``. With it, a whole call
of ``simulate`` takes 1.25 to 1.37 times as long (slider-pendulum; see benchmarks/calls.py).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from collections.abc import Mapping

T = TypeVar("T")


def changed(record: T, **values: Any) -> T:
    """Return a record with some fields replaced; it must have no ``__post_init__`` or caches."""
    return filled(type(record), vars(record) | values)


def filled(kind: type[T], values: Mapping[str, Any]) -> T:
    """Make a record of a frozen dataclass whose ``__dict__`` is ``values`` itself, not a copy."""
    record = object.__new__(kind)
    # One assignment of all fields is fast. Frozen classes require object.__setattr__.
    object.__setattr__(record, "__dict__", values if type(values) is dict else dict(values))
    return record
