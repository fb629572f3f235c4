"""Minimum time to an error for each method, on stiff, index-1 and constrained references.

Run it with ``python benchmarks/references.py [NAME ...] [--methods A,B] [--runs N] [--json FILE]
[--write]``; it prints Markdown, and with ``--write`` inserts the table into ``docs/engine.md``.
Errors are differences from the published or computed values in tests/references, relative to the
largest value of each quantity. If a reference contains sensitivities, these are compared, too. Each
method runs at two tolerances per decade. For each error, the fastest run that reaches it counts.
Its time is the minimum of many runs, from the first call of C to the last.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "example_scenes"))
import circuits
from domain_scenes import scene_of_domain
from reference_scenes import absolute_tree, read_reference, scene_of
from timing import about, heading, keep, line, put_on_page

from cotree.methods import METHODS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from cotree import Model, Result

PAGE = Path(__file__).parents[1] / "docs" / "engine.md"

#: Those of them that this version has.
OURS = tuple(name for name in ("rodas4", "rodas5", "dop853", "cvode", "ida") if name in METHODS)
ERRORS = (1e-4, 1e-6, 1e-8)
TOLERANCES = tuple(10.0 ** (-0.5 * i) for i in range(5, 27))

#: A run that takes longer is given up, [s]; one that is slower is timed less often.
LIMIT, LONG = 5.0, 0.2
#: So many tolerances reach the last error, or fail one after another, before no further one is
#: tried.
ENOUGH, HOPELESS = 2, 5


@dataclass(frozen=True)
class Case:
    """A reference, with or without its sensitivities."""

    name: str
    kind: str
    model: Model
    output_of: Callable[[str], str]
    atol: float  # as a share of rtol
    sensitivities: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        more = f", {len(self.sensitivities)} sensitivities" if self.sensitivities else ""
        return f"{self.name}{more}"


@dataclass(frozen=True)
class Run:
    """Error and cost of a method at a tolerance."""

    method: str
    rtol: float
    error: float
    seconds: float
    steps: int


def cases(names: Sequence[str]) -> Iterator[Case]:
    """Compile the named references, or all."""
    for name, kind, parameters in (
        ("chem_hires", "stiff", 0),
        ("chem_hires", "stiff", 3),
        ("chem_robertson", "stiff", 0),
        ("chem_robertson", "stiff", 3),
        ("spice_rectifier", "index 1", 0),
        ("ivp_transistor_amplifier", "index 1", 0),
        ("ivp_transistor_amplifier", "index 1", 3),
        ("iftomm_a01_pendulum", "constrained", 0),
        ("slider_pendulum", "constrained", 0),
        ("ivp_andrews", "constrained", 0),
        ("ivp_car_axis", "constrained", 0),
        ("nonholonomic_skate", "constrained", 0),
        ("torque_free_top", "constrained", 0),
        ("heavy_top", "constrained", 0),
    ):
        if not names or name in names:
            yield case(name, kind, parameters)


def case(name: str, kind: str, parameters: int) -> Case:
    """Compile a reference with the first few sensitivities of its file."""
    data = read_reference(name)
    wanted = tuple(data.get("sensitivities", {}).get("values", {}))[:parameters]
    if name.startswith("chem"):
        # Concentrations fall over many decades.
        model = scene_of_domain(name).compile(list(wanted))
        return Case(name, kind, model, lambda key: f"{key}_c", 1e-6, wanted)
    if kind == "index 1":
        model = circuits.circuit(name).compile(list(wanted))
        return Case(name, kind, model, circuits.output_of, 1e-2, wanted)
    in_loop = name == "slider_pendulum"  # in joint coordinates it has no constraints
    scene = scene_of(data, with_free_joints=not in_loop)
    model = scene.compile(list(wanted), absolute_tree(scene) if in_loop else None)
    return Case(name, kind, model, str, 1.0, wanted)


def error(case: Case, found: Result) -> float:
    """Return the largest error of a run, relative to the largest value of each quantity."""
    data = read_reference(case.name)
    tables = {"": data["reference"]}
    tables |= {p: data["sensitivities"]["values"][p] for p in case.sensitivities}
    worst = 0.0
    for parameter, rows in tables.items():
        largest = max(abs(value) for row in rows for value in row["values"].values())
        for key in rows[0]["values"]:
            expected = np.array([row["values"][key] for row in rows])
            name = case.output_of(key)
            values = found.sensitivity(name, parameter) if parameter else found[name]
            # What is next to nothing all the time is left with rounding.
            scale = max(float(np.max(np.abs(expected))), 1e-12 * largest)
            worst = max(worst, float(np.max(np.abs(values - expected))) / scale)
    return worst


def measure(case: Case, method: str, rtol: float, runs: int) -> Run | None:
    """Run a method; return None if it fails or if a substitute replaces it."""
    times = [row["t"] for row in read_reference(case.name)["reference"]]

    def once() -> Result:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            return case.model.simulate(
                (0.0, times[-1]), times, method, rtol, case.atol * rtol, time_limit=LIMIT
            )

    first = once()
    if first.status != 0 or "stood in" in first.message:
        return None
    repeats = runs if first.statistics.seconds < LONG else 2
    seconds = min(once().statistics.seconds for _ in range(repeats))
    return Run(method, rtol, error(case, first), seconds, first.statistics.n_steps)


def sweep(case: Case, method: str, runs: int) -> list[Run]:
    """Run a method at decreasing tolerances until several runs reach every error."""
    found: list[Run] = []
    failures = 0
    for rtol in TOLERANCES:
        run = measure(case, method, rtol, runs)
        failures = failures + 1 if run is None else 0
        if run is not None:
            found.append(run)
        enough = sum(row.error <= ERRORS[-1] for row in found)
        if enough >= ENOUGH or failures >= HOPELESS:
            break
    return found


def best(runs: Sequence[Run], bound: float) -> Run | None:
    """Return the fastest method that reaches an error."""
    enough = [run for run in runs if run.error <= bound]
    return min(enough, key=lambda run: run.seconds, default=None)


def entry(run: Run | None, is_least: bool) -> str:
    """Return a time and the number of correct digits as text."""
    if run is None:
        return "–"
    digits = -np.log10(max(run.error, 1e-16))
    text = f"{1e3 * run.seconds:.2g}"
    return f"{f'**{text}**' if is_least else text} ({digits:.1f})"


def rows_of(case: Case, found: dict[str, list[Run]]) -> list[str]:
    """Return a row for each error."""
    lines = []
    for bound in ERRORS:
        at = {method: best(runs, bound) for method, runs in found.items()}
        least = min((run.seconds for run in at.values() if run), default=0.0)
        cells = [entry(run, run is not None and run.seconds == least) for run in at.values()]
        lines.append(line([case.label, case.kind, f"{bound:.0e}", *cells]))
    return lines


def as_data(case: Case, found: dict[str, list[Run]]) -> dict[str, Any]:
    """Return all measurements as data for JSON."""
    return {
        "reference": case.name,
        "kind": case.kind,
        "sensitivities": list(case.sensitivities),
        "states": len(case.model.states),
        "runs": {method: [vars(run) for run in runs] for method, runs in found.items()},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*")
    parser.add_argument("--methods", default=",".join(OURS))
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    methods = options.methods.split(",")
    lines = [heading(["reference", "kind", "error", *(f"`{method}`" for method in methods)])]
    print(*lines)
    data = []
    for one in cases(options.names):
        found = {method: sweep(one, method, options.runs) for method in methods}
        new = rows_of(one, found)
        print("\n".join(new), flush=True)
        lines += new
        data.append(as_data(one, found))
    keep(options.json, about("as the library compiles it"), data)
    if options.write:
        put_on_page(PAGE, "references.py", "\n".join(lines))


if __name__ == "__main__":
    main()
