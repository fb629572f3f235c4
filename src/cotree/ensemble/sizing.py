"""Estimates the number of members that take a given time, from runs of the first ones."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import numpy as np

from cotree.ensemble.batch import run_block
from cotree.ensemble.results import NOT_RUN

if TYPE_CHECKING:
    from cotree.ensemble.plan import Plan
    from cotree.solvers.base import FloatArray

# A trial is believed from this time on, [s], and given up after that one.
_ENOUGH, _TOO_LONG = 0.05, 1.0

# Growth of a trial from one to the next.
_GROWTH = 64


def timed_size(plan: Plan, rows: FloatArray, threads: int, piece: float, most: int) -> int:
    """Give the number of members that threads run together in some time, at least one.

    Parameters
    ----------
    plan : Plan
        What the members share.
    rows : ndarray, shape (n_members, n_columns)
        What each of them sets.
    threads : int
        Threads that share a block.
    piece : float
        The time, [s].
    most : int
        No more than so many are tried.
    """
    size = 1
    while True:
        stop = threading.Event()
        limit = threading.Timer(_TOO_LONG, stop.set)
        limit.start()
        block = run_block(plan, rows[:size], threads=threads, stop=stop)
        limit.cancel()
        if np.any(block.status == NOT_RUN):
            return 1
        # Times of members leave out those of compilers.
        seconds = max(float(block.seconds.sum()) / min(size, threads), 1e-9)
        if seconds >= _ENOUGH or size >= min(len(rows), most):
            return max(1, int(piece * size / seconds))
        size = min(len(rows), most, _GROWTH * size, int(_ENOUGH * size / seconds) + size)
