"""Three ways to integrate sensitivities with SUNDIALS.

Run it with ``python benchmarks/correctors.py [ROW ...] [--runs N] [--write]``. It needs CVODES and
IDAS (the extra cotree[sundials], or COTREE_SUNDIALS). With COTREE_SUNDIALS, CVODE and IDA are taken
from the same library. It prints Markdown, and with ``--write`` inserts the table into
``docs/engine.md``.

For each error, the table lists the minimum time over all tolerances that reach it. The error is max
|y - ref| / max(1, max |ref|) of states and sensitivities at 101 points. Times are minima of many
alternating runs, from the first call of C to the last. Compare them only within a row.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "example_scenes"))
from circuits import circuit
from domain_scenes import scene_of_domain
from network_scenes import rc_ladder
from reference_scenes import read_reference
from rod_chain import rod_chain
from timing import heading, line, put_on_page

import cotree

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree import Result

PAGE = Path(__file__).parents[1] / "docs" / "engine.md"

TOLERANCES = tuple(10.0 ** (-0.5 * i) for i in range(7, 27))
TARGETS = (1e-6, 1e-10)
WAYS = {
    "cvode": ("cvode", "cvodes", "cvodes-simultaneous"),
    "ida": ("ida", "idas"),  # IDAS' simultaneous corrector tests no sensitivities
}
#: So many tolerances reach the last error before no tighter one is tried.
ENOUGH = 2


@dataclass(frozen=True)
class Row:
    """A system, the parameters of its sensitivities, and the integrators of SUNDIALS to measure."""

    name: str
    make: Callable[[], cotree.Scene]
    wanted: Callable[[cotree.Scene], list[str]]
    end: float
    family: str
    initial: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Run:
    """One method at one tolerance."""

    error: float
    seconds: float
    steps: int


def _all(scene: cotree.Scene) -> list[str]:
    return list(scene.compile().parameters)


def _end(name: str) -> float:
    return float(read_reference(name)["t_end"])


def _of_file(name: str) -> list[str]:
    return list(read_reference(name)["sensitivities"]["values"])[:3]


ROWS = (
    Row("slider-pendulum", lambda: cotree.load("slider-pendulum"), lambda s: ["L"], 10.0, "cvode"),
    Row("slider-pendulum", lambda: cotree.load("slider-pendulum"), _all, 10.0, "cvode"),
    Row(
        "chem_hires",
        lambda: scene_of_domain("chem_hires"),
        lambda s: _all(s)[:3],
        _end("chem_hires"),
        "cvode",
    ),
    Row(
        "chain of 5 rods",
        lambda: rod_chain(5)[0],
        lambda s: rod_chain(5)[1],
        5.0,
        "cvode",
        {"h0.theta": -1.2},
    ),
    Row("ladder of 150 stages", lambda: rc_ladder(150), _all, 50.0, "cvode"),
    Row(
        "rectifier",
        lambda: circuit("spice_rectifier"),
        lambda s: _all(s)[:2],
        _end("spice_rectifier"),
        "ida",
    ),
    Row(
        "transistor amplifier",
        lambda: circuit("ivp_transistor_amplifier"),
        lambda s: _of_file("ivp_transistor_amplifier"),
        _end("ivp_transistor_amplifier"),
        "ida",
    ),
)


def errors(result: Result, reference: Result) -> float:
    """Return the largest error of states and sensitivities."""
    worst = 0.0
    for found, known in ((result.y, reference.y), (result.s, reference.s)):
        scale = np.maximum(1.0, np.abs(known).max(axis=-1, keepdims=True))
        worst = max(worst, float(np.max(np.abs(found - known) / scale, initial=0.0)))
    return worst


def measure(row: Row, runs: int) -> tuple[int, dict[str, list[Run]]]:
    """Run all ways at all tolerances alternately; also return the number of sensitivities."""
    scene = row.make()
    model = scene.compile(row.wanted(scene))
    times = np.linspace(0.0, row.end, 101)

    def once(method: str, rtol: float) -> Result:
        return model.simulate((0.0, row.end), times, method, rtol, 1e-2 * rtol, initial=row.initial)

    reference, check = once("dop853", 1e-13), once("rodas5", 1e-12)
    doubt = errors(check, reference)
    print(f"{row.name}: the reference is good to {doubt:.0e}", file=sys.stderr, flush=True)
    found: dict[str, list[Run]] = {method: [] for method in WAYS[row.family]}
    for rtol in TOLERANCES:
        going = [m for m in found if sum(r.error <= TARGETS[-1] for r in found[m]) < ENOUGH]
        results: dict[str, list[Result]] = {method: [] for method in going}
        for _ in range(runs):
            for method in going:
                results[method].append(once(method, rtol))
        for method, some in results.items():
            if some[0].status == 0:
                seconds = min(one.statistics.seconds for one in some)
                run = Run(errors(some[0], reference), seconds, some[0].statistics.n_steps)
                found[method].append(run)
    return len(model.sensitivities), found


def cells_of(target: float, found: Sequence[list[Run]]) -> list[str]:
    """Return the fastest run of each way that reaches each error."""
    best = [
        min((r for r in runs if r.error <= target), key=lambda r: r.seconds, default=None)
        for runs in found
    ]
    least = min((run.seconds for run in best if run), default=0.0)
    cells = []
    for run in (*best, None)[:3]:
        if run is None:
            cells.append("–")
            continue
        milliseconds = 1e3 * run.seconds
        text = f"{milliseconds:.2g}" if milliseconds < 99.5 else f"{milliseconds:.0f}"
        cells.append(f"{f'**{text}**' if run.seconds == least else text} ({run.steps})")
    return cells


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*")
    parser.add_argument("--runs", type=int, default=11)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    warnings.simplefilter("ignore", RuntimeWarning)  # of runs that fail, which are left out
    ways = ["augmented", "staggered", "simultaneous"]
    lines = [heading(["system, with its sensitivities", "of", "error", *ways])]
    print(*lines)
    for row in ROWS:
        if options.names and not any(name in row.name for name in options.names):
            continue
        count, found = measure(row, options.runs)
        for target in TARGETS:
            cells = cells_of(target, list(found.values()))
            own = [f"{row.name}, {count}", f"{row.family.upper()}(S)", f"{target:.0e}"]
            lines.append(line([*own, *cells]))
            print(lines[-1], flush=True)
    if options.write:
        put_on_page(PAGE, "correctors.py", "\n".join(lines))


if __name__ == "__main__":
    main()
