"""Cost of the inputs of a run: a number, an expression, tables and Python functions.

``python benchmarks/inputs.py [--rounds 121]`` runs the drive of docs/how_to/inputs.md alternately
with each kind of input. It prints the minimum and the median time of a run.
"""

from __future__ import annotations

import argparse
import math
import time

import numpy as np
from timing import heading, line

import cotree

_SPAN = (0.0, 6.0)


def drive() -> cotree.Model:
    """Compile the drive of docs/how_to/inputs.md."""
    scene = cotree.Scene("drive", gravity=[0, -9.81, 0])
    scene.parameter("w", 3.0)
    scene.input("torque", 0.0, unit="N m")
    scene.edge("hinge", "revolute", "ground", "A", axis=[0, 0, 1], torque="torque", damping=0.2)
    scene.edge("rod", "arm", "A", "B", vector=[0, -1, 0])
    scene.edge("bob", "rigid_body", "ground", "B", mass=1.0)
    scene.output("height", "B.y")
    return scene.compile()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=121)
    rounds = parser.parse_args().rounds
    model, t = drive(), np.linspace(*_SPAN, 601)
    sampled = cotree.sampled(lambda t: math.sin(3.0 * t), 0.01)
    given = {
        "a number": 0.5,
        "an expression": "sin(w*t)",
        "a table of 601 points": (t, np.sin(3.0 * t)),
        "a Python function of time": lambda t: math.sin(3.0 * t),
        "`cotree.sampled(f, 0.01)`, 600 samples": sampled,
    }
    times: dict[str, list[float]] = {name: [] for name in given}
    for turn in range(rounds + 1):
        for name, value in given.items():
            begin = time.perf_counter()
            model.simulate(_SPAN, inputs={"torque": value})
            if turn:  # the first run of each compiles
                times[name].append(time.perf_counter() - begin)
    print(heading(["input", "least [ms]", "median [ms]"]))
    for name, own in times.items():
        print(line([name, f"{1e3 * min(own):.1f}", f"{1e3 * float(np.median(own)):.1f}"]))


if __name__ == "__main__":
    main()
