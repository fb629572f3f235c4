"""Estimate of the cost of a million members on a cluster, from measurements on this machine.

``python benchmarks/million.py [--members 20000] [--workers 64] [--page]`` runs members of the
slider-pendulum with its sensitivity to L in memory, with a store and in a pool of processes. It
prints the cost of each and the estimate for a million members. ``--page`` inserts the table into
the documentation.
"""

from __future__ import annotations

import argparse
import pickle
import tempfile
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from timing import put_on_page, surroundings, table

import cotree
from cotree.build.compile import processor_name
from cotree.ensemble.dataset import DatasetSchema
from cotree.ensemble.executors import ExecutorRun, parcel_of, run_parcel
from cotree.ensemble.members import Members
from cotree.ensemble.plan import Plan
from cotree.ensemble.store import Store
from cotree.scene.settings import Settings

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.ensemble.plan import Block

_PAGE = Path(__file__).parents[1] / "docs" / "how_to" / "clusters.md"
_MILLION, _TIMES = 10**6, np.linspace(0.0, 10.0, 101)

# Members of a block: some tenths of a second.
_BLOCK = 4000

# Bytes a second between machines, as of a network of 10 Gbit/s.
_NETWORK = 1.25e9


def timed(call: Callable[[], Any], clock: Callable[[], float] = time.perf_counter) -> float:
    """Return the time of a call, [s]."""
    begun = clock()
    call()
    return clock() - begun


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--members", type=int, default=20_000)
    parser.add_argument("--workers", type=int, default=64)
    parser.add_argument("--page", action="store_true")
    given = parser.parse_args()
    n, rng = given.members, np.random.default_rng(1)
    model = cotree.load("slider-pendulum").compile(["L"])
    members = {"L": rng.uniform(0.9, 1.1, n), "k": rng.uniform(45.0, 55.0, n)}
    settings = {"method": "dop853", "rtol": 1e-6, "threads": 1, "progress": False}

    def run(count: int = n, store: str | None = None) -> Any:
        some = {name: values[:count] for name, values in members.items()}
        return model.ensemble((0, 10), some, store=store, **settings)

    with tempfile.TemporaryDirectory() as folder:
        # Compilers, imports and starts of processes are paid once, and are no part of a member.
        run(10, f"{folder}/first")
        here = timed(run, time.process_time) / n
        run(store=f"{folder}/runs")
        opened = timed(lambda: run(store=f"{folder}/runs")) / n
        files = [path for path in Path(folder, "runs").rglob("*") if path.is_file()]
        on_disk = sum(path.stat().st_size for path in files) / n
    plan = Plan(
        model.kernels, Settings((0.0, 10.0), _TIMES, "dop853", 1e-6), ("L", "k"), model.outputs
    )
    parcel, rows = parcel_of(plan), np.column_stack(list(members.values()))
    assert parcel.data is not None
    loaded = min(timed(lambda: pickle.loads(parcel.data)) for _ in range(5))
    answer = run_parcel(parcel, rows[:_BLOCK], 1, 0)
    assert answer is not None
    back = len(pickle.dumps(answer)) / _BLOCK
    written = writing(plan, rows[:_BLOCK], answer[0]) / _BLOCK
    with ProcessPoolExecutor(1) as pool:
        trip = trip_of(pool, plan, rows)
    pool_of_workers = f"on {given.workers} workers"
    lines = [
        ["a member on one core", f"{1e6 * here:.0f} us"],
        ["writing a member to a store, on another core", f"{1e6 * written:.0f} us"],
        ["results of a member in memory, in transfer and in the store", f"{on_disk / 1e3:.1f} kB"],
        ["model and settings, sent once to each worker", f"{len(parcel.data) / 1e3:.0f} kB"],
        ["loading them in a worker, with the library in the cache", f"{1e3 * loaded:.1f} ms"],
        ["sending a block to a process and back", f"{1e3 * trip:.1f} ms"],
        ["opening a complete store", f"{1e6 * opened:.0f} us per member"],
        ["**a million members**: on one core", f"{_MILLION * here:.0f} s"],
        [f"**a million members**: {pool_of_workers}", f"{_MILLION * here / given.workers:.1f} s"],
        ["**a million members**: size of the store", f"{_MILLION * on_disk / 1e9:.1f} GB"],
        ["**a million members**: through 10 Gbit/s", f"{_MILLION * back / _NETWORK:.1f} s"],
        ["**a million members**: writing to the store", f"{_MILLION * written:.0f} s"],
    ]
    text = f"{surroundings()}{processor_name()}; {n} members with 101 times, 4 states, 1 output, "
    text += f"and their sensitivities to L.\n\n{table(['what', 'cost'], lines)}"
    print(text)
    if given.page:
        put_on_page(_PAGE, "million.py", text)


def writing(plan: Plan, rows: Any, block: Block) -> float:
    """Return the time to write a block to a store."""
    members = Members(plan.columns, rows, {"member": np.arange(len(rows))})
    with tempfile.TemporaryDirectory() as folder:
        store = Store(f"{folder}/runs", DatasetSchema(plan, members, {}), lambda: len(rows))
        found = min(timed(lambda: store._write(0, block)) for _ in range(5))
        store.close()
    return found


def trip_of(pool: ProcessPoolExecutor, plan: Plan, rows: Any) -> float:
    """Return the time to send a block of one member and receive it, without its computation."""
    n = 200
    ranges = [(i, i + 1) for i in range(n)]

    def run() -> float:
        found = ExecutorRun(pool, plan, rows, 1, threading.Event()).run(ranges)
        return sum(float(block.seconds.sum()) for _, block in found)

    run()
    begun = time.perf_counter()
    work = run()
    return (time.perf_counter() - begun - work) / n


if __name__ == "__main__":
    main()
