"""Execution of ensembles: blocks of members, run in this process or by an executor.

In: a model, settings of a run, members. Out: a ``Plan``, blocks of rows, and an ``xarray.Dataset``
of their results. Numbers depend only on the plan and on a member's own row, not on the sizes of
blocks or on where they run.
"""

from __future__ import annotations

import contextlib
import signal
import threading
import warnings
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from numbers import Integral
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.arguments import check_names
from cotree.ensemble.batch import run_block, usable_cores
from cotree.ensemble.dataset import Collected, DatasetSchema, check_xarray, member_bytes
from cotree.ensemble.executors import (
    AHEAD,
    PIECE,
    AdaptiveRanges,
    ExecutorRun,
    count_workers,
    read_executor,
    run_here,
)
from cotree.ensemble.plan import FEW, NOT_RUN, Block, Plan
from cotree.ensemble.store import Store, read_path
from cotree.ensemble.trial import tried_settings
from cotree.errors import SceneError, SolveError, check_known
from cotree.quiet import level_of_user
from cotree.solvers.budgets import CountingBar

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
    from types import FrameType

    from cotree.ensemble.members import Members
    from cotree.ensemble.reasons import Reasons
    from cotree.model.model import CompiledModel
    from cotree.scene.settings import Settings
    from cotree.solvers.result import FloatArray


class EnsembleProgress(CountingBar):
    """Progress bar of members; disabled without a terminal and for short ensembles."""

    def __init__(self, n: int, is_wanted: bool) -> None:
        super().__init__("members", n, is_wanted)

    def reached(self, done: int, failed: int) -> None:
        """Update the numbers of finished and failed members."""
        bad = f"{failed} failed, " if failed else ""
        self.count(done, lambda elapsed: f", {bad}{_rate(done / elapsed)}")


def _rate(rate: float) -> str:
    """Format a rate of members per second with about three digits."""
    return f"{rate:,.0f}/s" if rate >= 100.0 else f"{rate:.3g}/s"


# A trial is long enough above the first time, [s], and is stopped after the second time.
_ENOUGH, _TOO_LONG = 0.05, 1.0

# Growth factor of the size of successive trials.
_GROWTH = 64


def timed_size(plan: Plan, rows: FloatArray, threads: int, piece: float, most: int) -> int:
    """Return how many members the threads run in ``piece`` seconds; at least one."""
    size = 1
    while True:
        stop = threading.Event()
        limit = threading.Timer(_TOO_LONG, stop.set)
        limit.start()
        block = run_block(plan, rows[:size], threads=threads, stop=stop)
        limit.cancel()
        if np.any(block.status == NOT_RUN):
            return 1
        # Times of members exclude compilation.
        seconds = max(float(block.seconds.sum()) / min(size, threads), 1e-9)
        if seconds >= _ENOUGH or size >= min(len(rows), most):
            return max(1, int(piece * size / seconds))
        size = min(len(rows), most, _GROWTH * size, int(_ENOUGH * size / seconds) + size)


@contextmanager
def stopped_by_interrupt() -> Iterator[threading.Event]:
    """Return an event that Ctrl-C sets.

    In threads other than the main one, which receive no signals, and in programs with their own
    handler, nothing sets it; KeyboardInterrupt is then raised at any statement.
    """
    stop = threading.Event()
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield stop
        return

    def handle(number: int, frame: FrameType | None) -> None:
        if stop.is_set():
            signal.default_int_handler(number, frame)
        stop.set()

    signal.signal(signal.SIGINT, handle)
    try:
        yield stop
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


# Members of the first block per thread, if the number of lanes is not given.
_LANES = 8

# Maximum number of workers for which a store can write the blocks in time.
_MOST_QUICK = 8

# Maximum size of the results of a block, [byte], in addition to the whole results.
_LARGEST_BLOCK = 2**26

# Maximum size of the results of all blocks that an executor has in progress, [byte].
_UNDER_WAY = 2**29


class MemberError(SolveError):
    """A member failed in an ensemble with ``on_error="raise"``."""


@dataclass(frozen=True)
class Execution:
    """Execution of an ensemble: workers, store, errors; see :meth:`cotree.Model.ensemble`."""

    threads: int | None = None
    executor: Any = None
    store: Any = None
    progress: bool = True
    on_error: str = "keep"

    def __post_init__(self) -> None:
        if self.threads is not None:
            check_count(self.threads, "threads")
        read_executor(self.executor)
        if self.store is not None:
            read_path(self.store)
        if self.on_error not in ("keep", "raise"):
            raise SolveError(f"on_error is {self.on_error!r}: give 'keep' or 'raise'")


def run_ensemble(
    plan: Plan, members: Members, execution: Execution, attributes: Mapping[str, Any]
) -> Any:
    """Run members and return their results as a Dataset."""
    check_xarray()
    n, schema = len(members.rows), DatasetSchema(plan, members, attributes)
    pace = BlockSizes(plan, execution)
    with (
        stopped_by_interrupt() as stop,
        EnsembleProgress(n, execution.progress) as bar,
        contextlib.ExitStack() as opened,
    ):
        done: Collected | Store
        if execution.store is None:
            done = Collected(schema, pace.ranges(n))
        else:
            done = Store(execution.store, schema, partial(pace.size, plan, members.rows))
            pace.spread(done.members_of_a_block, opened)
        opened.callback(done.close)
        run = partial(run_blocks, threads=pace.threads, executor=pace.executor, stop=stop)
        try:
            _check(execution, members, done.reasons)
            while True:
                with contextlib.closing(run(plan, members.rows, done.ranges())) as blocks:
                    for first, block in blocks:
                        done.add_block(first, block)
                        bar.reached(done.reasons.done, done.reasons.failed)
                        _check(execution, members, done.reasons)
                if not done.wait(stop):
                    break
                _check(execution, members, done.reasons)
        except KeyboardInterrupt:
            # With a custom handler KeyboardInterrupt is raised here; a second one propagates.
            if stop.is_set():
                raise
            stop.set()
        except BaseException:
            stop.set()
            raise
    reasons, level = done.reasons, level_of_user()
    if reasons.done < n:
        warnings.warn(
            f"stopped after {reasons.done} of {n} members: the others are nan, with status "
            f"{NOT_RUN}",
            RuntimeWarning,
            stacklevel=level,
        )
    if reasons.failed:
        warnings.warn(reasons.summary(n), RuntimeWarning, stacklevel=level)
    return done.dataset()


def run_blocks(
    plan: Plan,
    rows: FloatArray,
    ranges: Iterable[tuple[int, int]],
    *,
    threads: int,
    executor: Any,
    stop: threading.Event,
) -> Generator[tuple[int, Block]]:
    """Run ranges of rows; yield each finished block with the index of its first row.

    ``threads`` is the number of threads on this machine, or per worker of an executor.
    """
    if executor is not None:
        yield from ExecutorRun(executor, plan, rows, threads, stop).run(ranges)
        return
    update = getattr(ranges, "update", None)
    for first, end in ranges:
        if stop.is_set():
            return
        block, seconds = run_here(plan, rows[first:end], threads, stop)
        if update:
            update(end - first, seconds)
        yield first, block


class BlockSizes:
    """Sizes of blocks, from the time of previous ones or the size of their results.

    ``threads`` share a block: as many as the process may use, or those of one worker.
    """

    def __init__(self, plan: Plan, execution: Execution) -> None:
        self.executor = read_executor(execution.executor)
        self.threads = execution.threads or (usable_cores() if self.executor is None else 1)
        most = _LARGEST_BLOCK
        if self.executor is not None:
            # Workers together may be faster than this process can store their results.
            most = min(most, _UNDER_WAY // (AHEAD * count_workers(self.executor)))
        self._most = max(1, most // max(1, member_bytes(plan)))
        # All lanes of all threads are occupied.
        self._least = self.threads * (_LANES if plan.lanes is None else plan.lanes)

    def size(self, plan: Plan, rows: FloatArray) -> int:
        """Choose the size of stored blocks by trial runs, whose results are discarded."""
        n_workers = 1 if self.executor is None else count_workers(self.executor)
        # So many workers together write as many files as a few with smaller blocks.
        piece = PIECE * max(1.0, n_workers / _MOST_QUICK)
        return min(self._most, timed_size(plan, rows, self.threads, piece, self._most))

    def spread(self, members_of_a_block: int, opened: contextlib.ExitStack) -> None:
        """Run one block per thread if blocks have fewer members than there are threads."""
        if self.executor is None and members_of_a_block < self.threads:
            self.executor = opened.enter_context(ThreadPoolExecutor(self.threads))
            self.threads = 1

    def ranges(self, n: int) -> AdaptiveRanges:
        """Divide n members into blocks, sized by the time of previous ones."""
        return AdaptiveRanges(n, self._most, self._least if self.executor is None else 1)


def make_plan(
    model: CompiledModel,
    settings: Settings,
    members: Members,
    *,
    outputs: Sequence[str] | None,
    lanes: int | None,
) -> Plan:
    """Check the data that members share, and choose their method."""
    wanted = _outputs(model, outputs)
    if lanes is not None:
        check_count(lanes, "lanes")
    elif len(members.rows) < FEW:
        lanes = 1
    is_chosen = settings.method == "auto"
    settings = tried_settings(model, settings, members)
    return Plan(model, settings, members.columns, wanted, lanes, is_chosen)


def check_count(value: object, name: str) -> None:
    """Check that a value is a positive whole number, or None."""
    if isinstance(value, bool) or not isinstance(value, Integral) or value < 1:
        raise SolveError(f"{name} is {value!r}: give a whole number of at least 1, or None")


def _outputs(model: CompiledModel, outputs: Sequence[str] | None) -> tuple[str, ...]:
    """Return the requested outputs; by default all."""
    if outputs is None:
        return model.outputs
    names = tuple(dict.fromkeys(check_names(outputs, "outputs")))
    for name in names:
        if name in model.states:
            raise SceneError(f"outputs name '{name}', a state: results have all states")
    check_known(names, model.outputs, "outputs name", ", but the model has no output of this name")
    return names


def _check(execution: Execution, members: Members, reasons: Reasons) -> None:
    """Raise an error for the first failed member if ``on_error`` is "raise"."""
    if execution.on_error == "raise" and reasons.first is not None:
        i, sentence = reasons.first
        raise MemberError(f"{members.described(i)} failed: {sentence}")
