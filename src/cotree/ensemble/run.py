"""Execution of ensembles by blocks of members, in this process or on an executor.

Results of a member depend only on the plan and on its own row, not on block sizes or on where
blocks run.
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
from cotree.ensemble.batch import run_block
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
from cotree.sharing import usable_cores
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
    """Progress bar over members, which is hidden without a terminal and for short ensembles."""

    def __init__(self, n: int, is_wanted: bool) -> None:
        super().__init__("members", n, is_wanted)

    def reached(self, done: int, failed: int) -> None:
        """Show the numbers of finished and failed members."""
        bad = f"{failed} failed, " if failed else ""
        self.count(done, lambda elapsed: f", {bad}{_rate(done / elapsed)}")


def _rate(rate: float) -> str:
    """Format a number of members per second with about three digits."""
    return f"{rate:,.0f}/s" if rate >= 100.0 else f"{rate:.3g}/s"


# Minimum duration of a trial that measures speed, and duration after which a trial is stopped, [s].
_ENOUGH, _TOO_LONG = 0.05, 1.0

# Largest ratio of the numbers of members in successive trials.
_GROWTH = 64


def timed_size(plan: Plan, rows: FloatArray, threads: int, piece: float, most: int) -> int:
    """Return the number of members, at least one, that the threads run in ``piece`` seconds."""
    size = 1
    while True:
        stop = threading.Event()
        limit = threading.Timer(_TOO_LONG, stop.set)
        limit.start()
        block = run_block(plan, rows[:size], threads=threads, stop=stop)
        limit.cancel()
        if np.any(block.status == NOT_RUN):
            return 1
        # Unlike the time of the call, the times of its members exclude compilation.
        seconds = max(float(block.seconds.sum()) / min(size, threads), 1e-9)
        if seconds >= _ENOUGH or size >= min(len(rows), most):
            return max(1, int(piece * size / seconds))
        size = min(len(rows), most, _GROWTH * size, int(_ENOUGH * size / seconds) + size)


@contextmanager
def stopped_by_interrupt() -> Iterator[threading.Event]:
    """Yield an event that Ctrl-C sets, in the main thread of a program without its own handler.

    Elsewhere, KeyboardInterrupt may be raised at any statement.
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


# Number of members per thread in the first block if the lanes are chosen automatically.
_LANES = 8

# A store can write blocks at the rate at which this number of workers computes them.
_MOST_QUICK = 8

# Maximum size of the results of a block, [byte], which are in memory in addition to all results.
_LARGEST_BLOCK = 2**26

# Maximum size of the results of all blocks submitted to an executor, [byte].
_UNDER_WAY = 2**29


class MemberError(SolveError):
    """Error for a failed member in an ensemble with ``on_error="raise"``."""


@dataclass(frozen=True)
class Execution:
    """Options of execution: workers, store and errors; see :meth:`cotree.Model.ensemble`."""

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
            # With a handler of the program, Ctrl-C gets here. A second Ctrl-C propagates.
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

    ``threads`` is the number of threads in this process, or per worker of an executor.
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
    """Block sizes from the time of previous blocks and the size of results.

    ``threads`` is the number of threads that share a block.
    """

    def __init__(self, plan: Plan, execution: Execution) -> None:
        self.executor = read_executor(execution.executor)
        self.threads = execution.threads or (usable_cores() if self.executor is None else 1)
        most = _LARGEST_BLOCK
        if self.executor is not None:
            # Workers may be faster than this process, and finished blocks then wait in memory.
            most = min(most, _UNDER_WAY // (AHEAD * count_workers(self.executor)))
        self._most = max(1, most // max(1, member_bytes(plan)))
        # A block occupies all lanes of all threads.
        self._least = self.threads * (_LANES if plan.lanes is None else plan.lanes)

    def size(self, plan: Plan, rows: FloatArray) -> int:
        """Determine the size of stored blocks by trial runs, whose results are discarded."""
        n_workers = 1 if self.executor is None else count_workers(self.executor)
        # Make blocks longer for many workers, to limit the rate at which files are written.
        piece = PIECE * max(1.0, n_workers / _MOST_QUICK)
        return min(self._most, timed_size(plan, rows, self.threads, piece, self._most))

    def spread(self, members_of_a_block: int, opened: contextlib.ExitStack) -> None:
        """Run blocks in parallel, one per thread, if they have fewer members than threads."""
        if self.executor is None and members_of_a_block < self.threads:
            self.executor = opened.enter_context(ThreadPoolExecutor(self.threads))
            self.threads = 1

    def ranges(self, n: int) -> AdaptiveRanges:
        """Divide n members into blocks, whose sizes adapt to the time of previous blocks."""
        return AdaptiveRanges(n, self._most, self._least if self.executor is None else 1)


def make_plan(
    model: CompiledModel,
    settings: Settings,
    members: Members,
    *,
    outputs: Sequence[str] | None,
    lanes: int | None,
) -> Plan:
    """Build the plan: check the data that members share, and choose the method."""
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
