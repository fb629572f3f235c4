"""Network benchmarks: ladders, grids and meshes of increasing size, with the time of each stage.

Run it with ``python benchmarks/networks.py [ladder] [other] [N ...]``; it prints Markdown, by
default all tables. N are sizes of the ladder. Every model is compiled in its own cache folder. A
small model runs first, so that imports are not counted. ``total`` is the elapsed time from the
first edge of the scene to the last output. ``CPU`` is the processor time of this process and of the
compiler, which other load does not affect.
"""

from __future__ import annotations

import os
import resource
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "example_scenes"))
from network_scenes import rc_grid, rc_ladder, resistor_mesh, rlc_ladder
from timing import surroundings, table

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree import Scene

SIZES = (5, 50, 500, 1000, 4000, 9000)
#: Ten time constants of a stage, R C = 1 s, at 101 times.
SPAN, SAMPLES = 10.0, 101

OTHERS: tuple[tuple[str, Callable[[int], Scene], int], ...] = (
    ("RLC ladder, 50 stages", rlc_ladder, 50),
    ("RLC ladder, 1000 stages", rlc_ladder, 1000),
    ("RC grid, 30 x 30", rc_grid, 30),
    ("RC grid, 60 x 60", rc_grid, 60),
    ("resistor mesh, 10 x 10", resistor_mesh, 10),
    ("resistor mesh, 20 x 20", resistor_mesh, 20),
)

HEAD = (
    "states",
    "operations",
    "scene s",
    "formulate s",
    "generate s",
    "compile s",
    "simulate s",
    "total s",
    "CPU s",
)


def processor_seconds() -> float:
    """Return the processor time of this process and of its finished children."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(row.ru_utime + row.ru_stime for row in used)


def run(make: Callable[[int], Scene], n: int) -> list[object]:
    """Run one network through all stages."""
    used, marks = processor_seconds(), [time.perf_counter()]
    scene = make(n)
    marks.append(time.perf_counter())
    model = scene.compile()
    marks.append(time.perf_counter())
    model.simulate((0.0, SPAN), np.linspace(0.0, SPAN, SAMPLES), throw=True)
    marks.append(time.perf_counter())
    stages = [model.times[stage] for stage in ("formulate", "generate", "compile")]
    seconds = [
        marks[1] - marks[0],
        *stages,
        marks[3] - marks[2],
        marks[3] - marks[0],
        processor_seconds() - used,
    ]
    counts: list[object] = [len(model.states), model.operations["rhs"].total]
    return [*counts, *(f"{s:.2f}" for s in seconds)]


def ladders(sizes: Sequence[int]) -> str:
    rows = [[n, *run(rc_ladder, n)] for n in sizes]
    return "RC ladder, from rest after a step.\n\n" + table(["n", *HEAD], rows)


def others() -> str:
    rows = [[name, *run(make, n)] for name, make, n in OTHERS]
    return "Other networks, from rest after a step.\n\n" + table(["network", *HEAD], rows)


if __name__ == "__main__":
    names = [arg for arg in sys.argv[1:] if not arg.isdigit()]
    chosen = [int(arg) for arg in sys.argv[1:] if arg.isdigit()]
    print(surroundings())
    with tempfile.TemporaryDirectory() as folder:
        os.environ["COTREE_CACHE_DIR"] = folder
        run(rc_ladder, 3)
        if not names or "ladder" in names:
            print(ladders(chosen or SIZES), "\n")
        if not names or "other" in names:
            print(others(), "\n")
