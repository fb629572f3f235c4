"""A progress bar for ensembles: members done and failed, their rate, and the time left."""

from __future__ import annotations

from cotree.solvers.progress import CountingBar


class EnsembleProgress(CountingBar):
    """Show how many members are done; it does nothing where nobody looks, nor for short ensembles.

    Parameters
    ----------
    n : int
        Number of members.
    is_wanted : bool
        Whether it may be shown at all.
    """

    def __init__(self, n: int, is_wanted: bool) -> None:
        super().__init__("members", n, is_wanted)

    def reached(self, done: int, failed: int) -> None:
        """Take note of how many members are done, and how many of them failed."""
        bad = f"{failed} failed, " if failed else ""
        self.count(done, lambda elapsed: f", {bad}{_rate(done / elapsed)}")


def _rate(rate: float) -> str:
    """Write members a second with about three digits."""
    return f"{rate:,.0f}/s" if rate >= 100.0 else f"{rate:.3g}/s"
