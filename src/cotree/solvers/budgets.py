"""Budgets of a run: steps, events, time, and the memory of what it stores.

Runs whose times nobody chose store each step, and a run that goes wrong may take steps without end.
Each has a bound, whatever the method. Where stored steps would take more memory, every second one
is dropped: what is left are points of the same accuracy, and the run goes on.
"""

from __future__ import annotations

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
    """Choice of the steps that a run stores: every one, then every second, fourth, and so on.

    Attributes
    ----------
    stride : int
        Every so many steps one is stored.
    """

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
