"""Time against error of every method, on shipped scenes and some references.

Run it with ``python benchmarks/work_precision.py [NAME ...] [--out DIR] [--repeats N] [--time-limit
S]``. It prints a Markdown table with one row for each scene: the accuracy of its reference, and the
fastest method for errors of 1e-3, 1e-6 and 1e-9. With ``--out``, the numbers of each scene are
written to this folder as JSON, and a plot as SVG. The measurements are those of ``cotree bench``.
Compare times only within one scene of one run.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "example_scenes"))
from circuits import circuit
from domain_scenes import scene_of_domain
from reference_scenes import read_reference, scene_of
from timing import heading, line, surroundings

import cotree
from cotree.plot import save_figure
from cotree.studies.bench_report import TARGETS

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree import Scene
    from cotree.studies.bench_report import BenchReport

#: Shipped scenes with the parameters that sensitivities are taken to.
SHIPPED = {
    "slider-pendulum": ["L", "zeta"],
    "spring-mass-damper": ["k"],
    "battery-cell": ["R0"],
    "bridge-rectifier": ["C"],
    "motor-linkage": [],
    "crane": ["load"],
}
#: References with the room that makes their scene, and the end time of the bench, [s].
REFERENCES: dict[str, tuple[Callable[[str], Scene], list[str], float | None]] = {
    "iftomm_a01_pendulum": (lambda name: scene_of(read_reference(name)), [], None),
    "heavy_top": (lambda name: scene_of(read_reference(name)), [], None),
    "chem_hires": (scene_of_domain, ["k1"], None),
    "ivp_transistor_amplifier": (circuit, [], None),
    "spice_rlc_ladder50": (circuit, [], None),
}


def report_of(name: str, repeats: int, time_limit: float) -> BenchReport:
    """Return the report of ``cotree bench`` for a shipped scene or a reference."""
    scene: str | Scene = name
    wanted, end = SHIPPED.get(name, []), None
    if name in REFERENCES:
        make, wanted, end = REFERENCES[name]
        scene, end = make(name), end or read_reference(name)["t_end"]
    return cotree.bench(scene, wanted, repeats=repeats, t_end=end, time_limit=time_limit)


def cells(report: BenchReport) -> list[str]:
    """Return the recommendation, and its speed relative to the slowest equally accurate method."""
    found = [f"{report.n_states}", ", ".join(report.sensitivities) or "–"]
    found.append(f"{report.reference.agreement:.0e}")
    for target in TARGETS:
        best = report.recommended(target)
        if best is None:
            found.append("–")
            continue
        able = {
            row.method: row.seconds
            for row in reversed(report.rows)
            if row.success and row.error <= target
        }  # of each method the loosest tolerance that is good enough
        ratio = max(able.values()) / best.seconds
        found.append(f"{best.method} {best.rtol:.0e} ({len(able)}, ×{ratio:.0f})")
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=[*SHIPPED, *REFERENCES])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--time-limit", type=float, default=5.0)
    given = parser.parse_args()
    print(surroundings())
    print(
        "The fastest method with its rtol for each error. In parentheses: the number of methods\n"
        "that reach this error, and the time of the slowest relative to the fastest.\n"
    )
    head = ["scene", "states", "sensitivities", "reference", *(f"{t:.0e}" for t in TARGETS)]
    print(heading(head))
    for name in given.names:
        try:
            report = report_of(name, given.repeats, given.time_limit)
        except cotree.Error as error:
            print(line([name, error]), flush=True)
            continue
        print(line([name, *cells(report)]), flush=True)
        if given.out is not None:
            given.out.mkdir(parents=True, exist_ok=True)
            report.to_json(given.out / f"{name}.json")
            save_figure(report.plot(), given.out / f"{name}.svg")
