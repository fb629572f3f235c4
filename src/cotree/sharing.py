"""Objects that threads share: one thread makes each at its first use while the others wait.

Objects that a call changes belong to the call or to its thread. Objects that persist are made once:
compiled libraries, and derivatives that are rarely needed. Forming derivatives creates nodes, which
an arena numbers in order, so that only one thread at a time may do it.
"""

from __future__ import annotations

import functools
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, ParamSpec, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

_P = ParamSpec("_P")
_T = TypeVar("_T")

#: Held while nodes are made in an arena that other threads can reach, such as that of a compiled
#: model. Neither compilation nor integration runs under it.
forming = threading.RLock()


def locked_cache(make: Callable[_P, _T]) -> Callable[_P, _T]:
    """Cache the results of a function as ``functools.cache`` does; other threads wait for them."""
    lock, found = threading.RLock(), functools.cache(make)

    @functools.wraps(make)
    def call(*args: _P.args, **kwargs: _P.kwargs) -> _T:
        with lock:
            return found(*args, **kwargs)  # type: ignore[arg-type]  # keys are hashable

    call.cache_clear = found.cache_clear  # type: ignore[attr-defined]
    return call


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


class locked_cached_property(functools.cached_property[_T]):  # a decorator, as its base is
    """A property computed at its first use, by one thread at a time; see :data:`forming`."""

    # For type checkers it is its base.
    if not TYPE_CHECKING:

        def __get__(self, instance: Any, owner: type | None = None) -> Any:
            """Return the value; from the second time on Python finds it in the instance itself."""
            with forming:
                return super().__get__(instance, owner)
