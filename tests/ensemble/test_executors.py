"""Ensembles on executors: the same numbers from each, and nothing lost where workers die."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from concurrent import futures

import numpy as np
import pytest

import cotree
from cotree import BuildError, SolveError
from cotree.ensemble import executors, run
from cotree.ensemble import executors as parcel
from cotree.ensemble.batch import run_block
from cotree.ensemble.executors import AdaptiveRanges, ExecutorRun, read_executor
from cotree.ensemble.plan import Plan
from cotree.ensemble.run import EnsembleProgress
from cotree.scene.settings import Settings

pytestmark = pytest.mark.compiler

TIMES = np.linspace(0.0, 2.0, 5)
ROWS = np.random.default_rng(7).uniform([0.9, 40.0], [1.1, 60.0], (120, 2))

needs_fork = pytest.mark.skipif(sys.platform != "linux", reason="pools are forked here")


@pytest.fixture(scope="module")
def model():
    return cotree.load("slider-pendulum").compile(["L"])


@pytest.fixture(scope="module")
def plan(model):
    return Plan(model.kernels, Settings((0.0, 2.0), TIMES, "dop853"), ("L", "k"), ("rod_x",))


@pytest.fixture(scope="module")
def wanted(plan):
    return run_block(plan, ROWS, threads=1)


def forked(n_workers=2, **options):
    context = multiprocessing.get_context("fork")
    return futures.ProcessPoolExecutor(n_workers, mp_context=context, **options)


def gathered(plan, executor, ranges=None, each=lambda i: None):
    """Run all rows and put blocks into the order of the members; each may come once."""
    found = {}
    stop = threading.Event()
    ranges = AdaptiveRanges(len(ROWS), 8) if ranges is None else ranges
    for i, (first, block) in enumerate(ExecutorRun(executor, plan, ROWS, 1, stop).run(ranges)):
        assert first not in found
        found[first] = block
        each(i)
    assert not stop.is_set()
    return [found[first] for first in sorted(found)]


def assert_same(blocks, wanted):
    for name in ("z", "outputs", "output_sensitivities", "status", "steps"):
        values = np.concatenate([getattr(block, name) for block in blocks])
        np.testing.assert_array_equal(values, getattr(wanted, name))


class Inline(futures.Executor):
    """Runs each call when its result is asked for last, and counts what it was given."""

    def __init__(self, n_workers=2):
        self._max_workers, self.with_plan, self.most, self.waiting = n_workers, 0, 0, []

    def submit(self, call, *args):
        future = futures.Future()
        self.waiting.append((future, call, args))
        self.most = max(self.most, len(self.waiting))
        self.with_plan += any(isinstance(arg, parcel.Parcel) and arg.data for arg in args)
        if len(self.waiting) == executors.AHEAD * self._max_workers:
            self.work()
        else:
            threading.Timer(0.01, self.work).start()
        return future

    def work(self):
        while self.waiting:
            future, call, args = self.waiting.pop()
            # As executors do: a result of a cancelled call would end a thread of a later test.
            if not future.set_running_or_notify_cancel():
                continue
            try:
                future.set_result(call(*args))
            except Exception as error:
                future.set_exception(error)


def test_threads_give_the_same(plan, wanted):
    with futures.ThreadPoolExecutor(2) as pool:
        assert_same(gathered(plan, pool), wanted)


@needs_fork
def test_forked_processes_give_the_same(plan, wanted):
    with forked() as pool:
        assert_same(gathered(plan, pool), wanted)


@pytest.mark.slow
def test_spawned_processes_give_the_same(plan, wanted):
    context = multiprocessing.get_context("spawn")
    with futures.ProcessPoolExecutor(2, mp_context=context) as pool:
        assert_same(gathered(plan, pool), wanted)


@needs_fork
def test_a_killed_process_loses_nothing(plan, wanted):
    with forked() as pool:

        def kill(i):
            if i == 3:
                os.kill(next(iter(pool._processes)), signal.SIGKILL)

        assert_same(gathered(plan, pool, each=kill), wanted)


@needs_fork
def test_a_member_that_kills_its_worker_fails_alone(plan, wanted, monkeypatch):
    whole, deadly = parcel.run_here, ROWS[50, 0]

    def dying(plan, rows, threads):
        if deadly in rows:
            os._exit(3)
        return whole(plan, rows, threads)

    monkeypatch.setattr(parcel, "run_here", dying)  # forked processes have it, too
    ranges = [(first, first + 10) for first in range(0, len(ROWS), 10)]
    with forked() as pool:
        blocks = gathered(plan, pool, ranges)
    status = np.concatenate([block.status for block in blocks])
    assert np.flatnonzero(status).tolist() == list(range(50, 60))
    assert blocks[5].messages[0].startswith("its worker died both times")
    rest = status == 0
    np.testing.assert_array_equal(
        np.concatenate([block.z for block in blocks])[rest], wanted.z[rest]
    )


@needs_fork
def test_processes_that_never_begin_are_told(plan, monkeypatch):
    monkeypatch.setattr(executors, "_MOST_DEATHS", 3)
    with (
        forked(initializer=os._exit, initargs=(1,)) as pool,
        pytest.raises(SolveError, match="die before they return a block"),
    ):
        gathered(plan, pool, [(i, i + 1) for i in range(len(ROWS))])


@pytest.mark.slow
def test_dask_loses_nothing_where_a_worker_is_killed(plan, wanted):
    distributed = pytest.importorskip("distributed")
    cluster = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    )
    with cluster, distributed.Client(cluster) as client:
        executor = read_executor(client)
        assert_same(gathered(plan, executor), wanted)

        def kill(i):
            if i == 3:
                os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)

        assert_same(gathered(plan, executor, each=kill), wanted)


def test_the_plan_is_sent_until_it_is_known_and_few_blocks_are_under_way(plan, wanted):
    parcel._plans.clear()
    executor = Inline(3)
    assert_same(gathered(plan, executor, [(i, i + 2) for i in range(0, len(ROWS), 2)]), wanted)
    assert executor.most <= executors.AHEAD * 3
    assert executor.with_plan <= executors.AHEAD * 3  # of 60 blocks
    # A worker that comes later asks for it.
    forgetful, seen = Inline(1), []

    def forget(i):
        seen.append(i)
        parcel._plans.clear()

    assert_same(gathered(plan, forgetful, [(0, 60), (60, 120)], each=forget), wanted)
    assert len(seen) == 2


class KilledWorker(Exception):
    """Stands for the error of dask where a task was on several workers that died."""


class Lossy(Inline):
    """Loses the calls of some numbers: their workers die, or their futures are cancelled."""

    def __init__(self, lost):
        super().__init__(2)
        self.lost, self.n_calls = lost, 0

    def submit(self, call, *args):
        number, self.n_calls = self.n_calls, self.n_calls + 1
        if number not in self.lost:
            return super().submit(call, *args)
        future = futures.Future()
        if number % 2:
            future.set_exception(KilledWorker("run_parcel", "tcp://127.0.0.1"))
        else:
            future.cancel()
            future.set_running_or_notify_cancel()
        return future


def test_lost_calls_are_submitted_again(plan, wanted):
    executor, ranges = Lossy({0, 3, 9}), [(i, i + 10) for i in range(0, len(ROWS), 10)]
    assert_same(gathered(plan, executor, ranges), wanted)
    assert executor.n_calls >= len(ranges) + 3
    hopeless = gathered(plan, Lossy(range(1000)), [(0, 2), (2, 4)])
    assert [block.status.tolist() for block in hopeless] == [[-1, -1]] * 2
    assert "its worker died both times" in hopeless[0].messages[0]


def test_blocks_grow_by_the_time_that_they_took():
    shares = AdaptiveRanges(1000, 100)
    shares.n_workers = 2
    assert next(shares) == (0, 1)
    shares.update(1, 0.01)
    assert next(shares) == (1, 9)  # eight times as many, at first
    shares.update(8, 0.08)
    assert next(shares) == (9, 39)  # 0.3 s
    shares.update(30, 0.0003)
    assert next(shares) == (39, 139)
    ranges = [(0, 1), (1, 9), (9, 39), (39, 139), *shares]
    assert [first for first, _ in ranges[1:]] == [end for _, end in ranges[:-1]]
    assert ranges[-1][1] == 1000
    assert ranges[-1][1] - ranges[-1][0] < 10  # the last ones are small, so that all end together


def test_a_stopped_ensemble_gives_what_is_done(plan):
    stop, firsts = threading.Event(), []
    with futures.ThreadPoolExecutor(1) as pool:
        ranges = ((i, i + 1) for i in range(len(ROWS)))
        for first, _ in ExecutorRun(pool, plan, ROWS, 1, stop).run(ranges):
            firsts.append(first)
            stop.set()
    assert 1 <= len(firsts) <= 1 + executors.AHEAD


def test_what_is_no_executor_is_refused(plan):
    for wrong in ("dask", 4, futures.ProcessPoolExecutor):
        with pytest.raises(SolveError, match=r"give a concurrent\.futures\.Executor"):
            read_executor(wrong)
    closed = futures.ThreadPoolExecutor(1)
    closed.shutdown()
    with pytest.raises(SolveError, match="keep it open until the ensemble is done"):
        gathered(plan, closed)


def test_what_cannot_be_sent_is_refused(plan):
    settings = Settings((0.0, 2.0), TIMES, "dop853", inputs={"u": lambda t: t})
    with pytest.raises(SolveError, match="give inputs as tables or expressions"):
        gathered(Plan(plan.model, settings, ("L", "k")), Inline())


def test_a_worker_without_a_compiler_or_cotree_is_told(plan, monkeypatch):
    sent = parcel.parcel_of(plan)
    with monkeypatch.context() as there:
        there.setenv("COTREE_COMPILER", "none")
        with (
            pytest.warns(RuntimeWarning, match="models cannot be evaluated"),
            pytest.raises(BuildError, match="has no C compiler: install one on all machines"),
        ):
            parcel.run_parcel(parcel.Parcel("0" * 64, sent.data), ROWS[:1], 1, 0)

    def missing(*args):
        raise ModuleNotFoundError("No module named 'cotree'")

    monkeypatch.setattr(parcel, "_load", missing)
    with pytest.raises(BuildError, match="install cotree there"):
        gathered(plan, Inline())


@needs_fork
def test_an_ensemble_takes_an_executor(model):
    members = {"L": ROWS[:40, 0], "k": ROWS[:40, 1]}
    settings = {"t_eval": 5, "method": "dop853", "progress": False}
    here = model.ensemble((0, 2), members, **settings)
    with forked() as pool:
        there = model.ensemble((0, 2), members, executor=pool, **settings)
    assert here.drop_vars("seconds").identical(there.drop_vars("seconds"))
    with pytest.raises(SolveError, match="give a concurrent"):
        model.ensemble((0, 2), members, executor="processes")


@needs_fork
def test_interrupted_workers_leave_what_is_done(model, monkeypatch):
    """Ctrl-C goes to all processes of a terminal."""
    whole = parcel.run_here

    def slow(plan, rows, threads):
        time.sleep(0.05)
        return whole(plan, rows, threads)

    monkeypatch.setattr(parcel, "run_here", slow)
    members = {"L": np.linspace(0.9, 1.1, 40)}
    with forked() as pool:
        # After a time it might come before the ensemble has begun, where it ends the tests.
        reached, interrupted = EnsembleProgress.reached, []

        def reached_first(bar, done, failed):
            reached(bar, done, failed)
            if not interrupted:
                interrupted.extend((*pool._processes, os.getpid()))
                for pid in interrupted:
                    os.kill(pid, signal.SIGINT)

        monkeypatch.setattr(EnsembleProgress, "reached", reached_first)
        monkeypatch.setattr(executors, "PIECE", 0.0)  # one member in each block
        with pytest.warns(RuntimeWarning, match="stopped after"):
            runs = model.ensemble(
                (0, 2), members, t_eval=5, method="dop853", lanes=1, executor=pool, progress=False
            )
    assert 0 < int((runs["status"] == 0).sum()) < 40


def test_results_under_way_are_bounded(plan):
    execution = run.Execution(executor=Inline(64))
    one = run.BlockSizes(plan, execution)
    n_bytes = one._most * 8 * len(TIMES) * 5 * 2
    assert n_bytes * executors.AHEAD * 64 <= 2**29
    assert run.BlockSizes(plan, run.Execution())._most > 8 * one._most
