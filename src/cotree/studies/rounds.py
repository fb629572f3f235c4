"""Times of several tasks, taken in rounds, so that what else the machine does hits all alike."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


class Task(Protocol):
    """A task that is timed.

    Attributes
    ----------
    seconds : list of float
        The times taken so far, [s].
    """

    seconds: list[float]

    def run(self) -> bool:
        """Do it once; a time counts where it succeeds."""


def time_in_rounds(
    tasks: Sequence[Task],
    repeats: int,
    *,
    longest: float,
    until: float,
    clock: Callable[[], float] = time.perf_counter,
    spent: Callable[[], float] = time.process_time,
    tell: Callable[[int], None] = lambda _: None,
) -> None:
    """Run each task once in each round.

    Parameters
    ----------
    tasks : sequence of Task
        They begin in turn: each round begins with another one.
    repeats : int
        Number of rounds.
    longest : float
        A task whose times sum to more is left out of further rounds, [s].
    until : float
        When the last run may begin, by ``spent``, [s].
    clock : callable
        Gives the time, [s].
    spent : callable
        Gives the processor time, [s]: beside other processes as many rounds are made.
    tell : callable
        Is told the number of each round.
    """
    for k in range(repeats):
        tell(k)
        first = k % max(1, len(tasks))
        for task in (*tasks[first:], *tasks[:first]):
            if sum(task.seconds) > longest:
                continue
            if spent() > until:
                return
            start = clock()
            if task.run():
                task.seconds.append(clock() - start)
