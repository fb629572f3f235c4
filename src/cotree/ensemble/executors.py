"""Blocks of members on an executor: pools of threads or processes, dask, MPI.

In: a plan as bytes with their hash. Out: the block of some rows. A worker keeps the last plans by
their hashes, since most blocks come with the hash alone; one that does not know it asks for it.

In: a plan, rows, ranges of them, and anything with ``submit`` as of ``concurrent.futures``. Out:
blocks as they are done, each once. A bounded number is under way, so that neither the executor nor
this process holds more. Where a worker dies, its blocks are submitted again: first one at a time,
so that one which kills its worker is known, and takes no others with it.
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
from collections import OrderedDict, deque
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from cotree.ensemble.batch import run_block
from cotree.ensemble.plan import Block, Plan, Results
from cotree.errors import BuildError, SolveError, brief
from cotree.solvers.evaluate import FAILED

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from cotree.solvers.base import FloatArray


# A worker that serves several ensembles in turn keeps their models; libraries stay loaded anyway.
_MOST_KEPT = 8

_kept: OrderedDict[str, Plan] = OrderedDict()
_keeping = threading.RLock()


@dataclass(frozen=True)
class Parcel:
    """A plan on its way."""

    key: str  # hash of the bytes
    backend: str  # the evaluator of the sender's kernels; another one gives other last digits
    data: bytes | None  # the pickled plan; None where the worker presumably has it


def parcel_of(plan: Plan) -> Parcel:
    """Pickle a plan."""
    try:
        data = pickle.dumps(plan, pickle.HIGHEST_PROTOCOL)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise SolveError(
            f"the ensemble cannot be sent to other processes ({error}): give inputs as tables or "
            "expressions, or as functions of a module that workers can import"
        ) from error
    return Parcel(hashlib.sha256(data).hexdigest(), plan.model.backend, data)


def run_parcel(
    parcel: Parcel, rows: FloatArray, threads: int, attempt: int
) -> tuple[Block, float] | None:
    """Run members in a worker.

    Parameters
    ----------
    parcel : Parcel
        The plan.
    rows : ndarray, shape (n_members, n_columns)
        The members.
    threads : int
        Threads to run them in.
    attempt : int
        How often they were submitted before. Executors that know a call by its arguments, as
        dask does, would else give the answer of the first.

    Returns
    -------
    (Block, float) or None
        The results, and how long they took, [s]. None where the plan is not known here.

    Raises
    ------
    BuildError
        If the model cannot be compiled here as where it comes from.
    """
    plan = _plan_of(parcel)
    return None if plan is None else run_here(plan, rows, threads)


def run_here(
    plan: Plan, rows: FloatArray, threads: int, stop: threading.Event | None = None
) -> tuple[Block, float]:
    """Run members in this process; see :func:`run_parcel`. They are broken off by an event."""
    begun = time.perf_counter()
    block = run_block(plan, rows, threads=threads, stop=stop)
    return block, time.perf_counter() - begun


def _plan_of(parcel: Parcel) -> Plan | None:
    """Give the plan of a parcel, unpickled by one thread while others wait."""
    with _keeping:
        plan = _kept.get(parcel.key)
        if plan is None:
            if parcel.data is None:
                return None
            plan = pickle.loads(parcel.data)
            _check_backend(plan.model, parcel.backend)
            _kept[parcel.key] = plan
            if len(_kept) > _MOST_KEPT:
                _kept.popitem(last=False)
        _kept.move_to_end(parcel.key)
        return plan


def _check_backend(model: Any, backend: str) -> None:
    if model.backend != backend:
        raise BuildError(
            f"the worker on '{socket.gethostname()}' evaluates the model in {model.backend}, and "
            f"where the ensemble was started it is {backend}: results would differ in their last "
            "digits. Install a C compiler on all machines (or: pip install ziglang), or set "
            "COTREE_COMPILER=none on all"
        )


#: Blocks under way for each worker: one runs and one waits, so that none idles while the answer
# travels.
AHEAD = 2

# How often a block may lose its worker while nothing else is under way.
_MOST_LOSSES = 2

# How many new pools in a row may give nothing: more, and it is not their blocks that kill them.
_MOST_BARREN = 20

# Between looks at whether the ensemble is stopped, [s]; answers are taken at once.
_PATIENCE = 0.1

# Blocks that run when the ensemble is stopped may still end, [s].
_GRACE = 2.0

# How long a count of workers is believed, [s]: clusters grow and shrink.
_COUNTED_FOR = 5.0

# Work of a block, [s], and growth from one to the next: first blocks wait for compilers.
_PIECE, _GROWTH = 0.3, 8

# Errors of executors that tell of a lost worker or message, by name: their packages need not be
# there.
_LOST = {"KilledWorker", "CommClosedError", "FutureCancelledError", "FuturesCancelledError"}


def read_executor(executor: Any) -> Any:
    """Accept an executor, or a client of dask, which has one; None stays None."""
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


class Shares:
    """Ranges of rows for workers, each as large as the time of those before tells.

    Parameters
    ----------
    n_members : int
        How many rows there are.
    most : int
        Members of a block at most.
    """

    def __init__(self, n_members: int, most: int) -> None:
        self._n, self._most, self._first, self._size = n_members, max(1, most), 0, 1
        self.n_workers = 1

    def __iter__(self) -> Iterator[tuple[int, int]]:
        return self

    def __next__(self) -> tuple[int, int]:
        left = self._n - self._first
        if left <= 0:
            raise StopIteration
        # Towards the end all workers are to be done at about the same time.
        size = min(self._size, max(1, math.ceil(left / self.n_workers)))
        first, self._first = self._first, self._first + size
        return first, self._first

    def learn(self, n_members: int, seconds: float) -> None:
        """Take in how long some members took in one worker."""
        wanted = int(_PIECE * n_members / max(seconds, 1e-9))
        self._size = max(1, min(wanted, _GROWTH * n_members, self._most))


@dataclass(frozen=True)
class _Share:
    """A range of rows, how often it was submitted, and how often it alone lost a worker."""

    first: int
    end: int
    attempt: int = 0
    losses: int = 0
    with_plan: bool = False
    is_suspect: bool = False


def run_on(
    executor: Any,
    plan: Plan,
    rows: FloatArray,
    ranges: Iterable[tuple[int, int]],
    *,
    threads: int,
    stop: threading.Event,
) -> Iterator[tuple[int, Block]]:
    """Run ranges of rows on an executor; parameters as of :func:`cotree.ensemble.run.run_blocks`.

    Parameters
    ----------
    executor : concurrent.futures.Executor
        Who runs them. A pool of processes that loses one is of no use any more: a new one of the
        same size takes its place, and is shut down at the end.
    threads : int
        Threads of each worker.

    Raises
    ------
    SolveError
        If the plan cannot be sent, or workers cannot run anything.
    """
    crew = _Crew(executor, plan, rows, threads, stop)
    try:
        yield from crew.run(ranges)
    finally:
        crew.leave()


class _Crew:
    """An executor at work: the shares under way, those to submit again, and their answers."""

    def __init__(
        self,
        executor: Any,
        plan: Plan,
        rows: FloatArray,
        threads: int,
        stop: threading.Event,
    ) -> None:
        self._executor, self._own, self._stop = executor, False, stop
        self._plan, self._rows, self._threads = plan, rows, threads
        # Threads of this process share its memory. Other classes, even those derived from it, may
        # have none in common.
        self._is_here = type(executor) is futures.ThreadPoolExecutor
        self._parcel = None if self._is_here else parcel_of(plan)
        self._flying: dict[futures.Future[Any], _Share] = {}
        self._arrived: queue.SimpleQueue[futures.Future[Any]] = queue.SimpleQueue()
        self._again: deque[_Share] = deque()
        self._is_known = False  # whether some worker has the plan
        self._n_workers, self._counted = 1, -math.inf
        self._barren = 0

    def run(self, ranges: Iterable[tuple[int, int]]) -> Iterator[tuple[int, Block]]:
        """Give blocks as they are done."""
        source, learn = iter(ranges), getattr(ranges, "learn", None)
        end: float | None = None
        while True:
            if self._stop.is_set():
                end = end or time.monotonic() + _GRACE
                self._again.clear()
                for future in self._flying:
                    future.cancel()
            else:
                self._fill(source, ranges)
            if not self._flying or (end is not None and time.monotonic() > end):
                return
            try:
                future = self._arrived.get(timeout=_PATIENCE)
            except queue.Empty:
                continue
            share = self._flying.pop(future, None)
            answer = None if share is None else self._answer(future, share)
            if share is None or answer is None:
                continue
            block, seconds = answer
            if learn and seconds:
                learn(share.end - share.first, seconds)
            yield share.first, block

    def leave(self) -> None:
        """Cancel what has not begun, and end a pool that was made here."""
        for future in self._flying:
            future.cancel()
        if self._own:
            self._executor.shutdown(wait=False, cancel_futures=True)

    def _fill(self, source: Iterator[tuple[int, int]], ranges: Any) -> None:
        """Submit as many shares as are to be under way: one, if it may have killed a worker."""
        if any(share.is_suspect for share in self._flying.values()):
            return
        room = AHEAD * self._workers()
        if hasattr(ranges, "n_workers"):
            ranges.n_workers = self._n_workers
        while len(self._flying) < room:
            if self._again:
                if self._again[0].is_suspect and self._flying:
                    return
                share = self._again.popleft()
            else:
                found = next(source, None)
                if found is None:
                    return
                share = _Share(*found)
            if not self._submit(share):
                # The pool broke meanwhile; shares under way will say so, too.
                self._again.appendleft(share)
                self._renew("its processes ended")
                continue
            if share.is_suspect:
                return

    def _submit(self, share: _Share) -> bool:
        rows = self._rows[share.first : share.end]
        try:
            if self._parcel is None:
                future = self._executor.submit(
                    run_here, self._plan, rows, self._threads, self._stop
                )
            else:
                # Until a first answer nobody has the plan.
                is_sent = share.with_plan or not self._is_known
                parcel = self._parcel if is_sent else replace(self._parcel, data=None)
                future = self._executor.submit(
                    run_parcel, parcel, rows, self._threads, share.attempt
                )
        except futures.BrokenExecutor:
            return False
        except RuntimeError as error:
            raise SolveError(
                f"the executor takes no more blocks ({str(error).rstrip('.')}): keep it open until "
                "the ensemble is done"
            ) from error
        self._flying[future] = share
        future.add_done_callback(self._arrived.put)
        return True

    def _answer(self, future: futures.Future[Any], share: _Share) -> tuple[Block, float] | None:
        """Give the block of a share; None where it is submitted again, or left out."""
        error = futures.CancelledError() if future.cancelled() else future.exception()
        if error is None:
            self._is_known, self._barren = True, 0
            found: tuple[Block, float] | None = future.result()
            if found is None:
                again = replace(share, with_plan=True, attempt=share.attempt + 1)
                self._again.appendleft(again)
            return found
        if self._stop.is_set() or isinstance(error, KeyboardInterrupt):
            # Ctrl-C goes to all processes of a terminal, those of a pool among them.
            self._stop.set()
            return None
        if not _is_loss(error):
            raise _told(error)
        return self._lost(share, error)

    def _lost(self, share: _Share, error: BaseException) -> tuple[Block, float] | None:
        """Submit a share again whose worker died; fail its members where it dies each time."""
        losses = share.losses + (1 if share.is_suspect else 0)
        if isinstance(error, futures.BrokenExecutor):
            self._renew(str(error))
        if losses >= _MOST_LOSSES:
            sentence = (
                f"its worker died each of the {share.attempt + 1} times that its block was run "
                f"({_short(error)}): it may have run out of memory"
            )
            rows = self._rows[share.first : share.end]
            return failed_block(self._plan, len(rows), sentence), 0.0
        self._again.append(
            replace(
                share,
                attempt=share.attempt + 1,
                losses=losses,
                with_plan=True,
                is_suspect=True,
            )
        )
        return None

    def _renew(self, reason: str) -> None:
        """Take a new pool in place of a broken one; other shares of the old one say so, too."""
        old: Any = self._executor
        if not getattr(old, "_broken", True):
            return  # another share of the broken pool came before
        kind = type(old)
        if kind is not futures.ProcessPoolExecutor:
            raise SolveError(
                f"the executor is broken ({reason.rstrip('.')}): make a new one and run again; "
                "with store=... only what is missing is computed"
            )
        self._barren += 1
        if self._barren > _MOST_BARREN:
            raise SolveError(
                f"processes of the executor die before they give anything ({reason.rstrip('.')}): "
                "look at what they print, and whether a script guards its own call with "
                "if __name__ == '__main__'"
            )
        if self._own:
            old.shutdown(wait=False, cancel_futures=True)
        self._executor, self._own = (
            futures.ProcessPoolExecutor(
                old._max_workers,
                mp_context=old._mp_context,
                initializer=old._initializer,
                initargs=old._initargs,
            ),
            True,
        )
        self._is_known = False

    def _workers(self) -> int:
        """Count the workers; as many as processors where the executor does not tell."""
        now = time.monotonic()
        if now - self._counted > _COUNTED_FOR:
            self._n_workers, self._counted = max(1, count_workers(self._executor)), now
        return self._n_workers


def count_workers(executor: Any) -> int:
    """Count the workers of an executor; the processors of this machine where it does not tell."""
    client = getattr(executor, "_client", None)
    if client is not None:
        return int(sum(client.nthreads().values()))
    for name in ("num_workers", "_max_workers"):
        found = getattr(executor, name, None)
        if isinstance(found, int):
            return found
    return os.cpu_count() or 1


def _is_loss(error: BaseException) -> bool:
    kinds = (futures.BrokenExecutor, futures.CancelledError)
    return isinstance(error, kinds) or type(error).__name__ in _LOST


def _told(error: BaseException) -> BaseException:
    """Say what is wrong with workers that cannot run a block; other errors are themselves."""
    if isinstance(error, ImportError):
        return BuildError(
            f"a worker cannot import what it needs ({error}): install cotree there, in the same "
            "version and with the same extras"
        )
    return error


def _short(error: BaseException) -> str:
    return brief(f"{type(error).__name__}: {error}".split("\n")[0].rstrip(".: "))


def failed_block(plan: Plan, n_members: int, sentence: str) -> Block:
    """Give the block of members that all failed for one reason."""
    results = Results(plan, n_members)
    for member in range(n_members):
        results.fail(member, FAILED, sentence)
    return results.block()
