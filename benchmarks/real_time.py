"""Accuracy of fixed steps: C projects of the slider-pendulum for real time.

For each method and step size, ``python benchmarks/real_time.py`` prints the error of the final
position, compared with dop853 at a tolerance of 1e-13, and the time of a step.
"""

from __future__ import annotations

import subprocess
import tempfile
import time
from pathlib import Path

from timing import heading, line

import cotree

_END = 10.0
_STEPS = (0.01, 0.005, 0.001)  # shares of the span, so that all end at one time


def run(model: cotree.Model, method: str, step: float) -> tuple[float, float]:
    """Return the final j1.s, [m], and the time of a step, [s], from a run 100 times as long."""
    with tempfile.TemporaryDirectory() as folder:
        project = model.write(folder, method, step)
        subprocess.run(project.command, shell=True, cwd=folder, check=True)
        command = [str(Path(folder) / "slider_pendulum")]
        printed = subprocess.run(
            [*command, str(_END)], capture_output=True, text=True, check=True
        ).stdout
        lines = dict(line.split(" = ") for line in printed.splitlines())
        begin = time.perf_counter()
        subprocess.run([*command, str(100.0 * _END)], capture_output=True, check=True)
        seconds = time.perf_counter() - begin
    return float(lines["j1.s"]), seconds / (100.0 * _END / step)


def main() -> None:
    model = cotree.load("slider-pendulum").compile()
    exact = model.simulate((0.0, _END), [_END], "dop853", 1e-13, 1e-15)["j1.s"][-1]
    print(heading(["method", "step [s]", "error of j1.s at the end [m]", "time of a step [us]"]))
    for method in ("rk4", "euler"):
        for step in _STEPS:
            end, seconds = run(model, method, step)
            print(line([f"`{method}`", step, f"{abs(end - exact):.0e}", f"{1e6 * seconds:.2f}"]))


if __name__ == "__main__":
    main()
