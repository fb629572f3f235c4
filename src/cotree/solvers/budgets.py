"""Budgets of a run: steps, events, time, and the memory of what it stores.

Runs whose times nobody chose store each step, and a run that goes wrong may take steps without end.
Each has a bound, whatever the method. Where stored steps would take more memory, every second one
is dropped: what is left are points of the same accuracy, and the run goes on.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType

    from rich.progress import Progress as Bar


#: Memory for the steps that a run stores with what is evaluated at them, and for its events,
#: [byte]. A result of this size takes up to four times as much while it is made.
MOST_STORED = 256 * 2**20

# With fewer points a curve cannot be drawn, however wide its rows are.
_LEAST_ROWS = 64


def most_rows(width: int) -> int:
    """Return how many rows of so many doubles are stored at most."""
    return max(_LEAST_ROWS, MOST_STORED // (8 * max(1, width)))


def steps_spent(limit: int) -> str:
    """Describe that a budget of steps is spent, without a capital and a full stop."""
    return f"the limit of {limit} steps is reached"


def time_spent(limit: float) -> str:
    """Describe that a budget of time is spent, [s]."""
    return f"the time limit of {limit:g} s is spent"


class Thinning:
    """Choice of the steps that a run stores: every one, then every second, fourth, and so on."""

    def __init__(self) -> None:
        self.stride = 1
        self._seen = 0

    def taken(self, n_new: int) -> slice:
        """Return the places, among so many new steps, of those to store."""
        first = -self._seen % self.stride
        self._seen += n_new
        return slice(first, n_new, self.stride)

    def thin(self) -> slice:
        """Double the stride, and give the places of the stored steps that stay."""
        self.stride *= 2
        # The first step is stored, and the others at multiples of the stride behind it.
        return slice(None, None, 2)

    @property
    def note(self) -> str:
        """A sentence on the steps that a result leaves out; empty where it has all of them."""
        if self.stride == 1:
            return ""
        return (
            f"One step in {self.stride} is stored, since all of them would take more than "
            f"{MOST_STORED >> 20} MiB: choose times by t_eval."
        )


# How long nothing is shown, and how often the bar moves, [s].
PATIENCE, _REFRESH = 1.0, 0.1


class OwnBar:
    """A bar that is begun where it is first needed, and ends with its ``with`` statement."""

    _bar: Bar | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._bar.stop()


class CountingBar(OwnBar):
    """Progress bar of a count; hidden if stderr is no terminal or the work is short."""

    def __init__(self, noun: str, n: int, is_wanted: bool) -> None:
        self._noun, self._n = noun, n
        self._is_watched = is_wanted and is_watched()
        self._begun = time.perf_counter()

    def count(self, done: int, told: Callable[[float], str]) -> None:
        """Take note of how many are done; ``told(elapsed)`` says more, for people."""
        elapsed = time.perf_counter() - self._begun
        if not self._is_watched or elapsed < PATIENCE:
            return
        if self._bar is None:
            self._bar = self._begin()
        said = f"{done} of {self._n}{told(elapsed)}"
        self._bar.update(self._bar.task_ids[0], completed=done, told=said)

    def _begin(self) -> Bar:
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        columns = (
            TextColumn(self._noun),
            BarColumn(),
            TextColumn("{task.fields[told]}"),
            TimeRemainingColumn(compact=True),
        )
        bar = Bar(*columns, console=Console(stderr=True), transient=True)
        bar.add_task(self._noun, total=self._n, told="")
        bar.start()
        return bar


class Progress(OwnBar):
    """Progress bar of an integration; hidden without a terminal and outside the main thread."""

    def __init__(self, method: str, t_span: tuple[float, float]) -> None:
        self._method = method
        self._start, self._end = t_span
        self._next = time.perf_counter() + PATIENCE

    def reached(self, t: float) -> None:
        """Take note of a time reached, [s]."""
        if time.perf_counter() < self._next:
            return
        if self._bar is None and not is_watched():
            self._next = math.inf
            return
        self._next = time.perf_counter() + _REFRESH
        if self._bar is None:
            self._bar = self._begin()
        share = (t - self._start) / (self._end - self._start)
        self._bar.update(self._bar.task_ids[0], completed=share)

    def _begin(self) -> Bar:
        from rich.console import Console
        from rich.progress import Progress as Bar

        bar = Bar(console=Console(stderr=True), transient=True)
        bar.add_task(self._method, total=1.0)
        bar.start()
        return bar


def is_watched() -> bool:
    """Return whether somebody looks."""
    # Bars of several threads would write over each other, and take each other's streams.
    is_main = threading.current_thread() is threading.main_thread()
    return is_main and sys.stderr is not None and sys.stderr.isatty()
