"""Own methods in C: error and time on a few scenes; prints the table of ``docs/solvers.md``.

Run it with ``python benchmarks/engines.py``. Times are the least of many runs, from the first call
of C to the last, without outputs; errors are those of ``cotree bench``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "example_scenes"))
import circuits
from domain_scenes import scene_of_domain
from reference_scenes import read_reference

import cotree

RUNS, POINTS = 40, 101


def scenes():
    yield "slider-pendulum", cotree.load("slider-pendulum"), ["L"], 10.0, ("dop853", (1e-8, 1e-11))
    for name in ("chem_hires", "chem_robertson"):
        scene = scene_of_domain(name)
        wanted = list(scene.compile().parameters)[:3]
        yield name, scene, wanted, read_reference(name)["t_end"], ("rodas5", (1e-6, 1e-8))
    amplifier = "ivp_transistor_amplifier"
    for name, wanted in (
        (amplifier, []),
        (amplifier, ["R1", "beta", "UF"]),
        ("spice_rectifier", []),
    ):
        end = read_reference(name)["t_end"]
        for method in ("dop853", "rodas5"):
            yield name, circuits.circuit(name), wanted, end, (method, (1e-6, 1e-8))
    rectifier = cotree.load("bridge-rectifier")
    for method in ("dop853", "rodas5"):
        yield "bridge-rectifier", rectifier, ["C", "RL"], 0.1, (method, (1e-6, 1e-8))


def error(found, exact) -> float:
    largest = 0.0
    for a, b in ((found.y, exact.y), (found.s, exact.s)):
        scale = np.maximum(1.0, np.abs(b).max(axis=-1, keepdims=True, initial=0.0))
        largest = max(largest, float(np.max(np.abs(a - b) / scale, initial=0.0)))
    return largest


def main() -> None:
    print("| scene | sensitivities | method, rtol | largest error | time, ms |")
    print("|---|---|---|---|---|")
    for name, scene, wanted, end, (method, tolerances) in scenes():
        model, times = scene.compile(wanted), np.linspace(0.0, end, POINTS)
        exact = model.simulate((0.0, end), times, "Radau", 1e-11, 1e-14)
        for rtol in tolerances:
            atol = rtol * 1e-2
            runs = [model.simulate((0.0, end), times, method, rtol, atol) for _ in range(RUNS)]
            seconds = min(run.statistics.seconds for run in runs)
            print(
                f"| {name} | {len(wanted)} | `{method}` {rtol:.0e} | {error(runs[0], exact):.0e} | "
                f"{1e3 * seconds:.2g} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
