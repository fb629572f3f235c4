"""A progress bar for ensembles: members done and failed, their rate, and the time left."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from cotree.solvers.progress import PATIENCE, OwnBar, is_watched

if TYPE_CHECKING:
    from rich.progress import Progress as Bar


class EnsembleProgress(OwnBar):
    """Show how many members are done; it does nothing where nobody looks, nor for short ensembles.

    Parameters
    ----------
    n : int
        Number of members.
    is_wanted : bool
        Whether it may be shown at all.
    """

    def __init__(self, n: int, is_wanted: bool) -> None:
        self._n = n
        self._is_watched = is_wanted and is_watched()
        self._begun = time.perf_counter()
        super().__init__()

    def reached(self, done: int, failed: int) -> None:
        """Take note of how many members are done, and how many of them failed."""
        elapsed = time.perf_counter() - self._begun
        if not self._is_watched or elapsed < PATIENCE:
            return
        if self._bar is None:
            self._bar = self._begin()
        told = (
            f"{done} of {self._n}, {f'{failed} failed, ' if failed else ''}{_rate(done / elapsed)}"
        )
        self._bar.update(self._bar.task_ids[0], completed=done, told=told)

    def _begin(self) -> Bar:
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        columns = (
            TextColumn("members"),
            BarColumn(),
            TextColumn("{task.fields[told]}"),
            TimeRemainingColumn(compact=True),
        )
        bar = Bar(*columns, console=Console(stderr=True), transient=True)
        bar.add_task("members", total=self._n, told="")
        bar.start()
        return bar


def _rate(rate: float) -> str:
    """Write members a second with about three digits."""
    return f"{rate:,.0f}/s" if rate >= 100.0 else f"{rate:.3g}/s"
