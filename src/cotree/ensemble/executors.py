"""Execution of blocks of members on an executor: thread or process pools, dask, MPI.

An executor is an object with ``submit`` as in ``concurrent.futures``. The number of submitted
blocks and their memory are bounded. If a worker dies, its blocks are run again one at a time, so
that a block that kills its worker does not affect others. If the worker dies again, the members of
that block fail.
"""

from __future__ import annotations

import concurrent.futures as futures
import hashlib
import math
import os
import pickle
import queue
import socket
import threading
import time
from collections import deque
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from cotree.ensemble.batch import run_block
from cotree.ensemble.plan import Block, Plan
from cotree.errors import BuildError, SolveError, brief
from cotree.solvers.result import FAILED

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from cotree.solvers.result import FloatArray


# Number of plans that a worker caches, because it may serve several ensembles.
_MOST_PLANS = 8

_plans: dict[str, Plan] = {}
_loading = threading.RLock()


@dataclass(frozen=True)
class Parcel:
    """A pickled plan, or only its hash if workers already have the plan."""

    key: str  # hash of the plan's bytes
    data: bytes | None  # bytes of the plan; None if the workers should have it already


def parcel_of(plan: Plan) -> Parcel:
    """Pickle a plan."""
    try:
        data = pickle.dumps(plan, pickle.HIGHEST_PROTOCOL)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise SolveError(
            f"the ensemble cannot be sent to other processes ({error}): give inputs as tables or "
            "expressions, or as functions of a module that workers can import"
        ) from error
    return Parcel(hashlib.sha256(data).hexdigest(), data)


def run_parcel(
    parcel: Parcel, rows: FloatArray, threads: int, attempt: int
) -> tuple[Block, float] | None:
    """Run members in a worker; return results and elapsed time, [s], or None if it lacks the plan.

    ``attempt`` makes calls differ, because dask returns the earlier result for equal arguments.
    """
    plan = _load(parcel)
    return None if plan is None else run_here(plan, rows, threads)


def run_here(
    plan: Plan, rows: FloatArray, threads: int, stop: threading.Event | None = None
) -> tuple[Block, float]:
    """Run members in this process; return their results and the elapsed time, [s]."""
    begun = time.perf_counter()
    block = run_block(plan, rows, threads=threads, stop=stop)
    return block, time.perf_counter() - begun


def _load(parcel: Parcel) -> Plan | None:
    """Return the plan of a parcel; only one thread unpickles it while others wait."""
    with _loading:
        if parcel.key not in _plans:
            if parcel.data is None:
                return None
            plan = pickle.loads(parcel.data)
            if plan.model.backend != "C":
                raise BuildError(
                    f"the worker on '{socket.gethostname()}' has no C compiler: install one on all "
                    "machines (or: pip install ziglang)"
                )
            _plans[parcel.key] = plan
            if len(_plans) > _MOST_PLANS:
                del _plans[next(iter(_plans))]
        return _plans[parcel.key]


#: Number of submitted blocks per worker: one runs and one waits, so that the worker does not idle
#: while results are transferred.
AHEAD = 2

# If more workers than this die in succession, their blocks are not the cause.
_MOST_DEATHS = 20

# Longest wait for a result before checking whether the ensemble is stopped, [s].
_PATIENCE = 0.1

# Time that running blocks have to finish after the ensemble is stopped, [s].
_GRACE = 2.0

# Interval after which workers are counted again, [s], since clusters grow and shrink.
_COUNTED_FOR = 5.0

#: Target duration of a block, [s]. It limits the delay of Ctrl-C and of the progress bar, and the
#: work lost if a worker is killed. The overhead of a block is small compared with it.
PIECE = 0.3

# Largest ratio of successive block sizes: the first time may include compilation.
_GROWTH = 8

# Names of errors that executors raise for lost workers or messages; their packages are optional.
_LOST = {"KilledWorker", "CommClosedError", "FutureCancelledError", "FuturesCancelledError"}


def read_executor(executor: Any) -> Any:
    """Return the executor for an argument, which is an executor, a dask client, or None."""
    if executor is None:
        return None
    if hasattr(executor, "get_executor"):
        return executor.get_executor()
    if isinstance(executor, type) or not callable(getattr(executor, "submit", None)):
        raise SolveError(
            f"executor is {brief(repr(executor))}: give a concurrent.futures.Executor, such as "
            "ProcessPoolExecutor(), dask's Client(...).get_executor() or mpi4py's "
            "MPIPoolExecutor()"
        )
    return executor


class AdaptiveRanges:
    """Iterator over ranges of rows, whose sizes adapt to the time that previous ranges took."""

    def __init__(self, n_members: int, most: int, least: int = 1) -> None:
        self._n, self._least, self._most = n_members, least, max(least, most)
        self._first, self._size = 0, least
        self.n_workers = 1

    def __iter__(self) -> Iterator[tuple[int, int]]:
        return self

    def __next__(self) -> tuple[int, int]:
        left = self._n - self._first
        if left <= 0:
            raise StopIteration
        # The last ranges are small, so that all workers finish at about the same time.
        size = min(self._size, max(1, math.ceil(left / self.n_workers)))
        first, self._first = self._first, self._first + size
        return first, self._first

    def update(self, n_members: int, seconds: float) -> None:
        """Update the range size from the time, [s], that one worker took for ``n_members``."""
        wanted = max(self._least, int(PIECE * n_members / max(seconds, 1e-9)))
        self._size = max(1, min(wanted, _GROWTH * n_members, self._most))


@dataclass(frozen=True)
class _Share:
    first: int
    end: int
    attempt: int = 0  # number of previous submissions
    with_plan: bool = False
    has_lost: bool = False  # whether a worker died while it ran this range


class ExecutorRun:
    """A run of all ranges on an executor; a broken process pool is replaced by an equal one."""

    def __init__(
        self, executor: Any, plan: Plan, rows: FloatArray, threads: int, stop: threading.Event
    ) -> None:
        self._executor, self._is_own, self._stop = executor, False, stop
        self._n_workers, self._counted = 1, -math.inf
        self._deaths = 0  # number of workers that died since the last result
        self._plan, self._rows, self._threads = plan, rows, threads
        # Subclasses may run tasks elsewhere, so only this class itself counts as local.
        is_here = type(executor) is futures.ThreadPoolExecutor
        self._parcel = None if is_here else parcel_of(plan)
        self._is_known = False  # whether at least one worker has received the plan
        self._flying: dict[futures.Future[Any], _Share] = {}
        self._arrived: queue.SimpleQueue[futures.Future[Any]] = queue.SimpleQueue()
        self._again: deque[_Share] = deque()

    def run(self, ranges: Iterable[tuple[int, int]]) -> Iterator[tuple[int, Block]]:
        """Yield blocks as they finish, and finally shut down a pool that replaced a broken one."""
        try:
            yield from self._blocks(ranges)
        finally:
            for future in self._flying:
                future.cancel()
            if self._is_own:
                self._executor.shutdown(wait=False, cancel_futures=True)

    def _blocks(self, ranges: Iterable[tuple[int, int]]) -> Iterator[tuple[int, Block]]:
        source, update, end = iter(ranges), getattr(ranges, "update", None), math.inf
        while True:
            if self._stop.is_set():
                end = min(end, time.monotonic() + _GRACE)
                self._again.clear()
                for future in self._flying:
                    future.cancel()
            else:
                self._fill(source, ranges)
            if not self._flying or time.monotonic() > end:
                return
            try:
                future = self._arrived.get(timeout=_PATIENCE)
            except queue.Empty:
                continue
            share = self._flying.pop(future)
            answer = self._answer(future, share)
            if answer is None:
                continue
            block, seconds = answer
            if update and seconds:
                update(share.end - share.first, seconds)
            yield share.first, block

    def _fill(self, source: Iterator[tuple[int, int]], ranges: Any) -> None:
        """Submit ranges up to the limit, but only one if it may have killed a worker."""
        n_workers = self._count()
        room = AHEAD * n_workers
        if hasattr(ranges, "n_workers"):
            ranges.n_workers = n_workers
        while len(self._flying) < room and not any(s.has_lost for s in self._flying.values()):
            if self._again and self._again[0].has_lost and self._flying:
                return
            found = None if self._again else next(source, None)
            if not self._again and found is None:
                return
            share = _Share(*found) if found else self._again.popleft()
            try:
                future = self._submit(share)
            except futures.BrokenExecutor:
                # The pool has broken. Other ranges' futures also report this failure.
                self._again.appendleft(share)
                self._renew("its processes ended")
                continue
            self._flying[future] = share
            future.add_done_callback(self._arrived.put)

    def _submit(self, share: _Share) -> futures.Future[Any]:
        rows, submit = self._rows[share.first : share.end], self._executor.submit
        try:
            if self._parcel is None:
                found = submit(run_here, self._plan, rows, self._threads, self._stop)
            else:
                # Workers may lack the plan until one of them has returned a result.
                is_sent = share.with_plan or not self._is_known
                parcel = self._parcel if is_sent else replace(self._parcel, data=None)
                found = submit(run_parcel, parcel, rows, self._threads, share.attempt)
        except futures.BrokenExecutor:
            raise
        except RuntimeError as error:
            raise SolveError(
                f"the executor takes no more blocks ({str(error).rstrip('.')}): keep it open until "
                "the ensemble is done"
            ) from error
        sent: futures.Future[Any] = found
        return sent

    def _answer(self, future: futures.Future[Any], share: _Share) -> tuple[Block, float] | None:
        """Return the block of a finished range; None if the range is run again or left out."""
        error = futures.CancelledError() if future.cancelled() else future.exception()
        again = replace(share, with_plan=True, attempt=share.attempt + 1)
        if error is None:
            self._is_known, self._deaths = True, 0
            found: tuple[Block, float] | None = future.result()
            if found is None:
                self._again.appendleft(again)
            return found
        if self._stop.is_set() or isinstance(error, KeyboardInterrupt):
            # A terminal sends Ctrl-C to all processes, including pool workers.
            self._stop.set()
            return None
        if isinstance(error, ImportError):
            raise BuildError(
                f"a worker cannot import what it needs ({error}): install cotree there, in the "
                "same version and with the same extras"
            )
        is_broken = isinstance(error, futures.BrokenExecutor)
        is_lost = is_broken or isinstance(error, futures.CancelledError)
        if not is_lost and type(error).__name__ not in _LOST:
            raise error
        if is_broken:
            self._renew(str(error))
        if not share.has_lost:
            self._again.append(replace(again, has_lost=True))
            return None
        reason = brief(f"{type(error).__name__}: {error}".split("\n")[0].rstrip(".: "))
        sentence = (
            f"its worker died both times that its block was run ({reason}): it may have run out of "
            "memory"
        )
        block = Block(self._plan, share.end - share.first)
        for member in range(share.end - share.first):
            block.fail(member, FAILED, sentence)
        return block.finished(), 0.0

    def _renew(self, reason: str) -> None:
        """Replace a broken pool once, although each range submitted to it reports the failure."""
        self._is_known, old = False, self._executor
        if not getattr(old, "_broken", True):
            return
        if type(old) is not futures.ProcessPoolExecutor:
            raise SolveError(
                f"the executor is broken ({reason.rstrip('.')}): make a new one and run again; "
                "with store=... only what is missing is computed"
            )
        self._deaths += 1
        if self._deaths > _MOST_DEATHS:
            raise SolveError(
                f"processes of the executor die before they return a block ({reason.rstrip('.')}): "
                "read their output, and check that the script guards its own call with "
                "if __name__ == '__main__'"
            )
        if self._is_own:
            old.shutdown(wait=False, cancel_futures=True)
        own: Any = old
        start = {"initializer": own._initializer, "initargs": own._initargs}
        self._is_own, self._executor = (
            True,
            futures.ProcessPoolExecutor(own._max_workers, own._mp_context, **start),
        )

    def _count(self) -> int:
        now = time.monotonic()
        if now - self._counted > _COUNTED_FOR:
            self._n_workers, self._counted = max(1, count_workers(self._executor)), now
        return self._n_workers


def count_workers(executor: Any) -> int:
    """Count the workers of an executor; if unknown, return the number of local processors."""
    client = getattr(executor, "_client", None)
    if client is not None:
        return int(sum(client.nthreads().values()))
    for name in ("num_workers", "_max_workers"):
        found = getattr(executor, name, None)
        if isinstance(found, int):
            return found
    return os.cpu_count() or 1
