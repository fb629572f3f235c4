"""Caches that threads share: one thread computes a value at its first use, the others wait.

Only one thread at a time may form derivatives, since the arena numbers their nodes in order.
"""

from __future__ import annotations

import functools
import os
import threading
from collections import OrderedDict
from typing import TYPE_CHECKING, Any, Generic, ParamSpec, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

_P = ParamSpec("_P")
_T = TypeVar("_T")

#: Lock for forming nodes in an arena that other threads can access, such as a compiled model's.
#: Compilation and integration do not hold it.
forming = threading.RLock()


def locked_cache(make: Callable[_P, _T]) -> Callable[_P, _T]:
    """Cache a function's results like ``functools.cache``; threads wait for pending results."""
    lock, found = threading.RLock(), functools.cache(make)

    @functools.wraps(make)
    def call(*args: _P.args, **kwargs: _P.kwargs) -> _T:
        with lock:
            return found(*args, **kwargs)  # type: ignore[arg-type]  # keys are hashable

    call.cache_clear = found.cache_clear  # type: ignore[attr-defined]
    return call


def usable_cores() -> int:
    """Count the cores that this process may use.

    Affinity and, on Linux, the control group of a container limit the number, rounded down.
    """
    try:
        cores = len(os.sched_getaffinity(0))
    except AttributeError:  # operating systems without processor affinities
        cores = os.cpu_count() or 1
    try:
        with open("/sys/fs/cgroup/cpu.max") as file:
            quota, period = file.read().split()
        cores = min(cores, max(1, int(quota) // int(period)))
    except (OSError, ValueError):  # cgroup files contain "max" if there is no limit
        pass
    return max(1, cores)


class RecentCache(Generic[_T]):
    """A thread-safe cache of the most recently used values.

    Simultaneous calls with a new key may each compute its value; one is stored. In contrast to
    ``functools.lru_cache``, values are computed from more than their keys, such as arrays. Without
    the cache, a whole call of ``simulate`` takes 2.2 to 2.6 times as long (benchmarks/calls.py).
    """

    def __init__(self, most: int) -> None:
        self._most, self._lock = most, threading.Lock()
        self._found: OrderedDict[Hashable, _T] = OrderedDict()

    def of(self, key: Hashable, make: Callable[[], _T]) -> _T:
        """Return the cached value of a key, or compute it by ``make``."""
        with self._lock:
            if key in self._found:
                self._found.move_to_end(key)
                return self._found[key]
        made = make()
        with self._lock:
            self._found[key] = made
            if len(self._found) > self._most:
                self._found.popitem(last=False)
        return made


class locked_cached_property(functools.cached_property[_T]):  # lower case, since it is a decorator
    """A property computed at its first use, by one thread at a time; see :data:`forming`."""

    # Type checkers see only the base class.
    if not TYPE_CHECKING:

        def __get__(self, instance: Any, owner: type | None = None) -> Any:
            """Return the value and store it in the instance, where later accesses find it."""
            with forming:
                return super().__get__(instance, owner)
