"""Thread-safe suppression of warnings, a lock for parsers, and pauses of the cycle collector.

If two threads overlap in ``warnings.catch_warnings``, the one that ends last restores the filters
of the other, and warnings remain suppressed. Here the first thread adds a filter, and the last one
removes it.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import re
import sys
import threading
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator

#: Held by callers of ``ast.parse``. Python before 3.11.8 fails in it with a ``SystemError`` if
#: another thread parses while the cycle collector runs Python code (python/cpython#106905).
parsing = threading.RLock()

_lock = threading.Lock()

#: Number of users of each filter, and its list; None if the program had the filter already.
_ignored: dict[tuple[Any, ...], tuple[int, list[Any]]] = {}


@contextlib.contextmanager
def without_warnings(
    message: str = "", category: type[Warning] = Warning, module: str = ""
) -> Iterator[None]:
    """Ignore warnings in all threads; for arguments see ``warnings.filterwarnings``."""
    pattern = re.compile(message, re.IGNORECASE) if message else None
    # In the form of `warnings.filters`: action, message, category, module, line (0 for any line).
    entry = ("ignore", pattern, category, re.compile(module) if module else None, 0)
    with _lock:
        # The filter is added by its first user, unless the program has already set it.
        count, filters = _ignored.get(entry, (0, []))
        if not count and entry not in warnings.filters:
            filters = _filters()
            filters.insert(0, entry)
        _ignored[entry] = count + 1, filters
    try:
        yield
    finally:
        with _lock:
            count, filters = _ignored.pop(entry)
            if count > 1:
                _ignored[entry] = count - 1, filters
            elif filters:
                # A `catch_warnings` elsewhere may have replaced the list.
                for listed in (filters, _filters()):
                    while entry in listed:
                        listed.remove(entry)


def _filters() -> list[Any]:
    found: list[Any] = warnings.filters  # type: ignore[assignment]
    return found


def level_of_user() -> int:
    """Return the stack level of the first caller outside this package, for ``warnings.warn``."""
    inner, level = (str(Path(__file__).parent), functools.__file__), 1
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(inner):
        frame, level = frame.f_back, level + 1
    return level


@contextlib.contextmanager
def without_collection() -> Iterator[None]:
    """Pause the cycle collector, which would search a large arena in vain."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()
