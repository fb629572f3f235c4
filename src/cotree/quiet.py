"""Silence what other libraries say, while several threads may ask for that at once.

``warnings.catch_warnings`` and ``contextlib.redirect_stdout`` put back what they found on their
way in. Of two threads that overlap, the one that leaves last puts back what the other had made, and
the program stays mute. Here the first to come adds one thing, the last to leave takes that away.
"""

from __future__ import annotations

import contextlib
import re
import sys
import threading
import warnings
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
    """Ignore some warnings, in all threads meanwhile: filters belong to the process.

    Parameters
    ----------
    message, category, module
        As of ``warnings.filterwarnings``.
    """
    pattern = re.compile(message, re.IGNORECASE) if message else None
    entry = ("ignore", pattern, category, re.compile(module) if module else None, 0)
    with _lock:
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


class _Muted:
    """A stream that some threads do not write to."""

    def __init__(self, stream: Any) -> None:
        self.stream = stream
        self.threads: list[int] = []

    def write(self, text: str) -> int:
        if threading.get_ident() in self.threads:
            return len(text)
        return int(self.stream.write(text))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


@contextlib.contextmanager
def without_output() -> Iterator[None]:
    """Drop what this thread prints; others go on printing."""
    own = threading.get_ident()
    with _lock:
        stream: Any = sys.stdout
        muted = stream if isinstance(stream, _Muted) else _Muted(stream)
        sys.stdout = muted
        muted.threads.append(own)
    try:
        yield
    finally:
        with _lock:
            muted.threads.remove(own)
            if not muted.threads and sys.stdout is muted:
                sys.stdout = muted.stream
