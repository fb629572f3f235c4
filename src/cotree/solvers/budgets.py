"""Limits of a run: steps, events, time, and memory for its stored points.

If the stored steps exceed this memory, every second one is dropped, and the run continues.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.progress import Progress as Bar
    from rich.progress import ProgressColumn


#: Maximum memory for the stored steps of a run, the values evaluated at them, and its events,
#: [byte]. Creating a result of this size needs up to four times as much memory.
MOST_STORED = 256 * 2**20

# Minimum number of rows that are stored, however long a row is.
_LEAST_ROWS = 64


def most_rows(width: int) -> int:
    """Return how many rows of ``width`` doubles the memory limit permits."""
    return max(_LEAST_ROWS, MOST_STORED // (8 * max(1, width)))


def steps_spent(limit: int) -> str:
    """Return a clause which states that the run reached its limit of steps."""
    return f"the limit of {limit} steps is reached"


def events_spent(limit: float) -> str:
    """Return a clause which states that the run reached its limit of events."""
    return f"the limit of {limit:g} events is reached"


def time_spent(limit: float) -> str:
    """Return a clause which states that the run reached its time limit, [s]."""
    return f"the time limit of {limit:g} s is spent"


class Thinning:
    """Selection of the steps that a run stores: all, then every second, fourth, and so on."""

    def __init__(self) -> None:
        self.stride = 1
        self._seen = 0

    def select(self, n_new: int) -> slice:
        """Return a slice that selects the steps to store among ``n_new`` new ones."""
        first = -self._seen % self.stride
        self._seen += n_new
        return slice(first, n_new, self.stride)

    def thin(self) -> slice:
        """Double the stride, and return a slice that selects the stored steps to keep."""
        self.stride *= 2
        # The stored steps are multiples of the old stride, beginning with step 0.
        return slice(None, None, 2)

    @property
    def note(self) -> str:
        """A message on steps that were not stored, or an empty string."""
        if self.stride == 1:
            return ""
        return (
            f"One step in {self.stride} is stored, since all of them would take more than "
            f"{MOST_STORED >> 20} MiB: choose times by t_eval."
        )


# Time until a progress bar appears, and interval between its updates, [s].
PATIENCE, _REFRESH = 1.0, 0.1


class OwnBar:
    """A progress bar that appears at its first update and ends with its ``with`` block."""

    _bar: Bar | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    @staticmethod
    def _begin(name: str, total: float, *columns: str | ProgressColumn) -> Bar:
        from rich.console import Console
        from rich.progress import Progress as Bar

        bar = Bar(*columns, console=Console(stderr=True), transient=True)
        bar.add_task(name, total=total, message="")
        bar.start()
        return bar


class CountingBar(OwnBar):
    """Progress bar for a number of items; hidden without a terminal or if the work is short."""

    def __init__(self, noun: str, n: int, is_wanted: bool) -> None:
        self._noun, self._n = noun, n
        self._is_watched = is_wanted and is_watched()
        self._begun = time.perf_counter()

    def count(self, done: int, note: Callable[[float], str]) -> None:
        """Show the number of items that are done, and the text ``note(elapsed)``."""
        elapsed = time.perf_counter() - self._begun
        if not self._is_watched or elapsed < PATIENCE:
            return
        if self._bar is None:
            from rich.progress import BarColumn, TextColumn, TimeRemainingColumn

            text, left = TextColumn("{task.fields[message]}"), TimeRemainingColumn(compact=True)
            self._bar = self._begin(self._noun, self._n, self._noun, BarColumn(), text, left)
        message = f"{done} of {self._n}{note(elapsed)}"
        self._bar.update(self._bar.task_ids[0], completed=done, message=message)


class Progress(OwnBar):
    """Progress bar of an integration; hidden without a terminal and outside the main thread."""

    def __init__(self, method: str, t_span: tuple[float, float]) -> None:
        self._method = method
        self._start, self._end = t_span
        self._next = time.perf_counter() + PATIENCE

    def reached(self, t: float) -> None:
        """Show that the integration has reached time t, [s]."""
        if time.perf_counter() < self._next:
            return
        if self._bar is None and not is_watched():
            self._next = math.inf
            return
        self._next = time.perf_counter() + _REFRESH
        if self._bar is None:
            self._bar = self._begin(self._method, 1.0)
        share = (t - self._start) / (self._end - self._start)
        self._bar.update(self._bar.task_ids[0], completed=share)


def is_watched() -> bool:
    """Return whether stderr is a terminal and this is the main thread."""
    # Progress bars of several threads would overwrite each other.
    is_main = threading.current_thread() is threading.main_thread()
    return is_main and sys.stderr is not None and sys.stderr.isatty()
