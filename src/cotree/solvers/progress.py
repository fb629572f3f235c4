"""A progress bar for integrations that take longer than a second, on terminals only."""

from __future__ import annotations

import math
import sys
import threading
import time
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from types import TracebackType

    from rich.progress import Progress as Bar

# How long nothing is shown, and how often the bar moves, [s].
PATIENCE, _REFRESH = 1.0, 0.1


class OwnBar:
    """A bar that is begun where it is first needed, and ends with its ``with`` statement."""

    def __init__(self) -> None:
        self._bar: Bar | None = None

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


class Progress(OwnBar):
    """Show how far an integration is; it does nothing where nobody looks, nor outside main threads.

    Parameters
    ----------
    method : str
        Name of the method that runs.
    t_span : (float, float)
        Start and end, [s].
    """

    def __init__(self, method: str, t_span: tuple[float, float]) -> None:
        self._method = method
        self._start, self._end = t_span
        self._next = time.perf_counter() + PATIENCE
        super().__init__()

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
    """Tell whether somebody looks."""
    # Bars of several threads would write over each other, and take each other's streams.
    is_main = threading.current_thread() is threading.main_thread()
    return is_main and sys.stderr is not None and sys.stderr.isatty()
