"""Gradients in reverse mode compared with forward sensitivities and with runs of the states alone.

``python benchmarks/gradients.py [--rounds 31]`` computes the deviation of an RC ladder from 101
measured values, with rtol 1e-6, and its gradient with respect to all resistances and capacitances.
The runs alternate. Times are the minimum over all rounds, and include the evaluation of outputs.
"""

from __future__ import annotations

import argparse
import time
from typing import TYPE_CHECKING, Any

import numpy as np
from timing import heading, line

import cotree

if TYPE_CHECKING:
    from collections.abc import Callable

_SPAN = (0.0, 10.0)
_SETTINGS: dict[str, Any] = {"rtol": 1e-6, "atol": 1e-8, "method": "dop853"}

#: Ladders up to this number of stages are also run with forward sensitivities.
_MOST_FORWARD = 50


def ladder(n: int) -> cotree.Scene:
    """Form an RC ladder of n stages with all values as parameters."""
    scene = cotree.Scene("ladder")
    scene.edge("source", "voltage_source", "n0", "ground", voltage="sin(t)")
    for i in range(1, n + 1):
        scene.parameter(f"R{i}", 1.0 + 0.01 * i)
        scene.parameter(f"C{i}", 1.0 + 0.02 * i)
        scene.edge(f"r{i}", "resistor", f"n{i - 1}", f"n{i}", resistance=f"R{i}")
        scene.edge(f"c{i}", "capacitor", f"n{i}", "ground", capacitance=f"C{i}")
    scene.output("end", f"c{n}.v")
    return scene


def measure(n: int, rounds: int) -> list[object]:
    """Return a row of the table for a ladder of n stages."""
    scene = ladder(n)
    model = scene.compile()
    times = np.linspace(*_SPAN, 101)
    data = {"end": (times, 0.1 * np.sin(times))}
    calls: dict[str, Callable[[], object]] = {
        "states": lambda: model.simulate(_SPAN, times, **_SETTINGS).output_values,
        "gradient": lambda: model.gradient(data, _SPAN, **_SETTINGS),
    }
    if n <= _MOST_FORWARD:
        whole = scene.compile(list(model.parameters))
        calls["forward"] = lambda: whole.simulate(_SPAN, times, **_SETTINGS).output_sensitivities
    found: dict[str, list[float]] = {name: [] for name in calls}
    for turn in range(rounds + 1):
        for name, call in calls.items():
            begin = time.perf_counter()
            call()
            if turn:  # the first call of each compiles
                found[name].append(1e3 * (time.perf_counter() - begin))
    least = {name: min(own) for name, own in found.items()}
    forward = f"{least['forward']:.1f}" if "forward" in least else "-"
    ratio = f"{least['gradient'] / least['states']:.1f}"
    return [n, 2 * n, f"{least['states']:.2f}", f"{least['gradient']:.2f}", ratio, forward]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=31)
    rounds = parser.parse_args().rounds
    head = ["stages", "parameters", "states [ms]", "gradient [ms]", "ratio", "forward [ms]"]
    print(heading(head))
    for n in (5, 50, 500):
        print(line(measure(n, rounds)))


if __name__ == "__main__":
    main()
