"""Objects that threads share: one thread makes each at its first use while the others wait.

Objects that a call changes belong to the call or to its thread. Objects that persist are made once:
compiled libraries, and derivatives that are rarely needed. Forming derivatives creates nodes, which
an arena numbers in order, so that only one thread at a time may do it.
"""

from __future__ import annotations

import functools
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, ParamSpec, TypeVar, overload

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

_P = ParamSpec("_P")
_T = TypeVar("_T")

#: Held while nodes are made in an arena that other threads can reach, such as that of a compiled
#: model. Neither compilation nor integration runs under it.
forming = threading.RLock()


def made_once(make: Callable[_P, _T]) -> Callable[_P, _T]:
    """Cache the results of a function, and let one thread at a time compute them.

    ``functools.cache`` lets two threads compute the same value. ``cache_clear`` forgets everything.
    """
    lock, made = threading.RLock(), {}

    @functools.wraps(make)
    def given(*args: _P.args, **kwargs: _P.kwargs) -> _T:
        key = (args, tuple(kwargs.items()))
        if key not in made:
            with lock:
                if key not in made:
                    made[key] = make(*args, **kwargs)
        return made[key]

    given.cache_clear = made.clear  # type: ignore[attr-defined]
    return given


class Kept(Generic[_T]):
    """The last few things that were made, by what they were made for.

    Parameters
    ----------
    most : int
        How many are kept. The oldest one that nobody has asked for again makes room.
    """

    def __init__(self, most: int) -> None:
        self._most, self._lock = most, threading.Lock()
        self._kept: dict[Hashable, _Entry[_T]] = {}

    def of(self, key: Hashable, make: Callable[[], _T]) -> _T:
        """Give what was made for a key, or make it.

        Threads that ask at the same time may each make one: it takes no lock, and one of them is
        kept.
        """
        found = self._kept.get(key)  # looked up once: the key of a run is long
        if found is not None:
            found.is_asked_for = True
            return found.value
        made = make()
        with self._lock:
            while len(self._kept) >= self._most:
                oldest = next(iter(self._kept))
                entry = self._kept.pop(oldest)
                if entry.is_asked_for:
                    entry.is_asked_for = False
                    self._kept[oldest] = entry  # behind the others, until its turn comes again
            self._kept[key] = _Entry(made)
        return made


@dataclass
class _Entry(Generic[_T]):
    """One thing that was made, and whether anybody has asked for it since its turn to leave."""

    value: _T
    is_asked_for: bool = False


class formed_once(Generic[_T]):  # a decorator, as cached_property is
    """A property formed at its first use, by one thread at a time; see :data:`forming`."""

    def __init__(self, form: Callable[[Any], _T]) -> None:
        self._form = form
        self._name = ""
        self.__doc__ = form.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    @overload
    def __get__(self, instance: None, owner: type) -> formed_once[_T]: ...

    @overload
    def __get__(self, instance: object, owner: type | None = None) -> _T: ...

    def __get__(self, instance: object | None, owner: type | None = None) -> formed_once[_T] | _T:
        if instance is None:
            return self
        kept = instance.__dict__  # where Python finds the value from the second time on
        if self._name not in kept:
            with forming:
                if self._name not in kept:
                    kept[self._name] = self._form(instance)
        value: _T = kept[self._name]
        return value
