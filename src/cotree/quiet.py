"""Silence what other libraries say, while several threads may ask for that at once.

The cycle collector is paused here, too.

``warnings.catch_warnings`` restores the filters that it found on its way in. Of two threads that
overlap, the one that leaves last restores those that the other had made, and the program stays
mute. Here the first to come adds one filter, and the last to leave removes it.
"""

from __future__ import annotations

import contextlib
import gc
import re
import sys
import threading
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator

_lock = threading.Lock()

#: How many ask for a filter, and the list that it was put into; none where it stood there before.
_ignored: dict[tuple[Any, ...], tuple[int, list[Any]]] = {}


@contextlib.contextmanager
def without_warnings(
    message: str = "", category: type[Warning] = Warning, module: str = ""
) -> Iterator[None]:
    """Ignore some warnings, as ``warnings.filterwarnings``, in all threads meanwhile."""
    pattern = re.compile(message, re.IGNORECASE) if message else None
    # As `warnings` keeps its filters: action, message, category, module, line; 0 is any line.
    entry = ("ignore", pattern, category, re.compile(module) if module else None, 0)
    with _lock:
        # Only the first of those who ask adds the filter, and none if the program has it already.
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
                # Somebody's catch_warnings may have copied the list, or put an older one back.
                for listed in (filters, _filters()):
                    while entry in listed:
                        listed.remove(entry)


def _filters() -> list[Any]:
    found: list[Any] = warnings.filters  # type: ignore[assignment]
    return found


def level_of_user() -> int:
    """Return the stack level for ``warnings.warn`` that blames the line of the user.

    It is that of the first caller outside this package, however deep the call is inside.
    """
    package, level = str(Path(__file__).parent), 1
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(package):
        frame, level = frame.f_back, level + 1
    return level


@contextlib.contextmanager
def without_collection() -> Iterator[None]:
    """Pause the cycle collector: an arena is one large structure that lives as a whole."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()
