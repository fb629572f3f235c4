"""Members of an ensemble in one call into C for each thread, with nothing of Python between them.

In: a ``Plan`` and rows. Out: a ``Block``. Threads take members from one counter, and what comes out
of a member depends on nothing but the plan and its row: not on the number of threads, nor on the
order of rows, nor on who else is in the block.

For those who run members in another way (in vectors, say): C gives all that a member needs by its
number, in the ``cotree_batch`` of ``templates/runtime/batch/cotree_batch.h``. A function
``lanes(worker)`` in it is called by each worker in place of the loop over single members. It takes
members with ``cotree_batch_take``, begins each with ``prepare`` (which fills in prepared values and
the start), writes its points to ``values`` at the member's number, fills in ``n_kept``,
``n_steps``, ``seconds`` and ``ended``, and ends it with ``finish``, which evaluates its outputs.
What it cannot bring to an end it leaves as ``COTREE_MEMBER_LEFT``: these members are then run one
at a time, from their start, with all that a failure needs to be told. It looks at ``is_stopped``
now and then.
"""

from __future__ import annotations

import os
import threading
import weakref
from typing import TYPE_CHECKING

import numpy as np

from cotree.ensemble.block_in_c import BlockInC
from cotree.ensemble.one_by_one import run_one_by_one
from cotree.ensemble.pattern import Unfit, find_pattern
from cotree.ensemble.worker import Worker

if TYPE_CHECKING:
    from collections.abc import Sequence
    from threading import Event

    from cotree.ensemble.pattern import Pattern
    from cotree.ensemble.plan import Block, Plan
    from cotree.solvers.base import FloatArray

# How often the flag that stops an ensemble is looked at, [s].
_GLANCE = 0.05

# What plans have in common with C, found at their first block.
_patterns: weakref.WeakKeyDictionary[Plan, Pattern | Unfit] = weakref.WeakKeyDictionary()


def run_block(
    plan: Plan, rows: FloatArray, *, threads: int | None = 1, stop: Event | None = None
) -> Block:
    """Run some members of an ensemble.

    Parameters
    ----------
    plan : Plan
        What they share.
    rows : ndarray, shape (n_members, n_columns)
        What each sets.
    threads : int, optional
        How many threads run them; None for :func:`usable_cores`. Where members run in Python, there
        is one.
    stop : threading.Event, optional
        Once it is set, members in work are broken off, no other is begun, and what is done is
        returned. Ctrl-C does the same, and sets it.

    Returns
    -------
    Block
        Members that were not run have the status -3.
    """
    rows = np.ascontiguousarray(rows, dtype=np.float64).reshape(-1, len(plan.columns))
    pattern = pattern_of(plan)
    if isinstance(pattern, Unfit):
        return run_one_by_one(pattern.plan, rows, stop=stop)
    members = BlockInC(pattern, rows)
    wanted = usable_cores() if threads is None else max(1, threads)
    workers = [Worker(members) for _ in range(max(1, min(wanted, len(rows), members.most_threads)))]
    _drive(workers, members, stop)
    if members.takes_back():
        _drive(workers, members, stop)
    return members.block(workers)


def usable_cores() -> int:
    """Count the cores that this process may use.

    Those of its affinity; on Linux less, where a control group limits processor time, as containers
    do: then the whole cores of that limit.
    """
    try:
        cores = len(os.sched_getaffinity(0))
    except AttributeError:  # of systems without affinities
        cores = os.cpu_count() or 1
    try:
        with open("/sys/fs/cgroup/cpu.max") as file:
            quota, period = file.read().split()
        cores = min(cores, max(1, int(quota) // int(period)))
    except (OSError, ValueError):  # "max" is no number: there is no limit
        pass
    return max(1, cores)


def pattern_of(plan: Plan) -> Pattern | Unfit:
    """Find what members of a plan share, or why they run one by one in Python; once for a plan."""
    if plan not in _patterns:
        _patterns[plan] = find_pattern(plan)
    return _patterns[plan]


def _drive(workers: Sequence[Worker], members: BlockInC, stop: Event | None) -> None:
    """Let workers run members until none is left, or the ensemble is stopped."""
    if stop is not None and stop.is_set():
        members.stop()
    errors: list[BaseException] = []

    def work(worker: Worker) -> None:
        try:
            while worker.go_on(_GLANCE):
                pass
        except BaseException as error:
            errors.append(error)
            members.stop()

    # This thread works, too: where it only waited, systems would begin two others on one core and
    # move one of them some milliseconds later.
    threads = [threading.Thread(target=work, args=(worker,)) for worker in workers[1:]]
    for thread in threads:
        thread.start()
    try:
        _drive_here(workers[0], members, stop)
    except BaseException:
        members.stop()
        raise
    finally:
        _await(threads, members, stop)
    if errors:
        raise errors[0]


def _await(threads: Sequence[threading.Thread], members: BlockInC, stop: Event | None) -> None:
    """Wait until other threads have ended their work."""
    for thread in threads:
        while thread.is_alive():
            try:
                thread.join(_GLANCE)
                if stop is not None and stop.is_set():
                    members.stop()
            except KeyboardInterrupt:
                _stop(members, stop)


def _drive_here(worker: Worker, members: BlockInC, stop: Event | None) -> None:
    """Let one worker run members in this thread, which C gives back now and then."""
    try:
        while worker.go_on(_GLANCE):
            if stop is not None and stop.is_set():
                members.stop()
    except KeyboardInterrupt:
        _stop(members, stop)


def _stop(members: BlockInC, stop: Event | None) -> None:
    members.stop()
    if stop is not None:
        stop.set()
