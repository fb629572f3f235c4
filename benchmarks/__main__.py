"""Run benchmarks: ``python -m benchmarks [NAME ...] [--all] [--quick] [--out DIR]``.

Without a name, the command lists the benchmarks. ``--quick`` selects small cases, which take some
minutes in total; published numbers are measured without it. Each script runs in its own process,
one after another. Its output is written to ``DIR/NAME.md`` and its tables to ``DIR/NAME.json``.
Both files state the machine, compiler, flags, versions and time. ``DIR/README.md`` lists all files.
If a script cannot run, for example because another tool is not installed, the list states the
reason, and the other scripts run.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import subprocess
import sys
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

try:
    import cotree
except ModuleNotFoundError:
    raise SystemExit("cotree is not installed here: run `pip install .` in the clone") from None

if __package__:
    from benchmarks.timing import about, table
else:  # the folder itself was run
    from timing import about, table

HERE = Path(__file__).parent

#: Scripts with what they measure, quick ones first.
SCRIPTS = {
    "operations": "operations of the slider-pendulum; times of stages for a chain of rods",
    "real_time": "error and time of fixed steps in C projects for real time",
    "transitions": "instructions of a mode change of one of twelve frictions and of an event",
    "calls": "time of a call of simulate outside its C code, for small models",
    "gradients": "gradients in reverse mode, compared with forward sensitivities",
    "inputs": "cost of inputs: numbers, expressions, tables, functions",
    "million": "cost per ensemble member in memory, in a store and in processes",
    "first_run": "times of the first run of a scene on a machine and of later runs",
    "estimation": "gradients of published estimation problems, compared with AMICI",
    "interval_coverage": "share of intervals of fits that contain the true value",
    "networks": "networks of increasing size: time of each stage",
    "growth": "code size and times against the number of rods or stages",
    "multibody": "energy, arms, chains, loops, singular positions",
    "kernels": "time per call of each kernel, compared with other tools",
    "claim": "sensitivity graphs compared with direct differentiation",
    "robots": "robots from the file to the kernel, compared with other tools",
    "ensembles": "a thousand runs in one call, compared with other tools",
    "peers": "time to an error, compared with other tools",
    "references": "minimum time to an error for each method, on references",
    "correctors": "augmented sensitivities compared with the correctors of CVODES and IDAS",
    "stiff_choice": "the choice of `auto` for stiff systems, compared with the other methods",
    "work_precision": "time against error for every method",
    "hard_cases": "digits, drift and cost of hard cases",
}

#: The smallest cases of each, which show that it runs and about what it finds.
QUICK = {
    "operations": ["5"],
    "calls": ["--rounds", "11"],
    "gradients": ["--rounds", "3"],
    "inputs": ["--rounds", "11"],
    "million": ["--members", "2000"],
    "first_run": ["command", "--rounds", "1"],
    "estimation": ["Crauste_CellSystems2017", "--rounds", "3"],
    "interval_coverage": ["bouncing-ball", "--seeds", "20"],
    "networks": ["ladder", "5", "50", "500"],
    "growth": ["ladder", "10", "100"],
    "multibody": ["arm", "loop"],
    "kernels": ["slider-pendulum, rhs + L", "--rounds", "3"],
    "claim": ["chain of 2", "--rounds", "3"],
    "robots": ["ur5", "--seconds", "0.05"],
    "ensembles": ["slider-pendulum, states", "--members", "100", "--rounds", "3"],
    "peers": ["slider-pendulum, L", "--repeats", "3"],
    "references": ["chem_hires", "--runs", "3"],
    "correctors": ["slider-pendulum", "--runs", "2"],
    "stiff_choice": ["6 species", "--rounds", "1"],
    "work_precision": ["slider-pendulum", "--repeats", "3", "--time-limit", "1"],
    "hard_cases": ["slider_pendulum"],
}


@dataclass
class Outcome:
    """Output of a script.

    Attributes
    ----------
    name : str
        Name of the script.
    command : list of str
        Command, run from the root of the repository.
    seconds : float
        Elapsed time.
    problem : str
        Reason of a failure; empty if the script succeeded.
    text : str
        Printed text.
    tables : list of dict
        Header and rows of each table of the text.
    """

    name: str
    command: list[str]
    seconds: float
    problem: str
    text: str
    tables: list[dict[str, Any]] = field(default_factory=list)


def run(name: str, *, is_quick: bool) -> Outcome:
    """Run a script from the root of the repository with this installation of cotree."""
    given = QUICK.get(name, []) if is_quick else []
    command = ["python", f"benchmarks/{name}.py", *given]
    # Another folder may be the current one, against which a path of this process was meant.
    paths = [str(Path(cotree.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, HERE / f"{name}.py", *given],
        cwd=HERE.parent,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))},
        capture_output=True,
        text=True,
        check=False,
    )
    seconds = time.perf_counter() - began
    problem = ""
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"it ended with {done.returncode}"]
        problem = lines[-1][:200]
    return Outcome(name, command, seconds, problem, done.stdout, tables_of(done.stdout))


def tables_of(text: str) -> list[dict[str, Any]]:
    """Return the tables of a Markdown text."""
    found: list[dict[str, Any]] = []
    rows: list[list[str]] = []
    for line in [*text.splitlines(), ""]:
        if line.startswith("|"):
            rows.append([cell.strip() for cell in line.strip().strip("|").split("|")])
        elif rows:
            found.append({"head": rows[0], "rows": rows[2:]})
            rows = []
    return found


def heading(versions: dict[str, str]) -> str:
    """Return lines with the machine, the versions and the command of a measurement."""
    return "\n".join(f"- {key}: {value}" for key, value in versions.items())


def keep(outcome: Outcome, versions: dict[str, str], folder: Path) -> None:
    """Write the output of a script as Markdown and JSON, with machine and versions."""
    said = f"It stopped: {outcome.problem}\n\n" if outcome.problem else ""
    took = f"`{shlex.join(outcome.command)}`, {outcome.seconds:.0f} s"
    text = f"# {outcome.name}\n\n{heading(versions)}\n\n{took}\n\n{said}{outcome.text}"
    (folder / f"{outcome.name}.md").write_text(text.rstrip() + "\n", encoding="utf-8")
    kept = {key: value for key, value in asdict(outcome).items() if key != "text"}
    numbers = json.dumps({"about": versions, **kept}, indent=1, ensure_ascii=False)
    (folder / f"{outcome.name}.json").write_text(numbers + "\n", encoding="utf-8")


def listing() -> str:
    """Return the list of benchmarks."""
    return "\n".join(f"  {name}: {what}" for name, what in SCRIPTS.items())


def main() -> None:
    """Run the named benchmarks and write the list of results."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="Run benchmarks, print their tables, and write them as Markdown and JSON.",
        epilog=f"benchmarks:\n{listing()}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help="benchmark to run; default: list all"
    )
    parser.add_argument("--all", action="store_true", help="run all benchmarks, which takes hours")
    parser.add_argument(
        "--quick", action="store_true", help="run small cases; without a name, of all benchmarks"
    )
    parser.add_argument(
        *("--out",),
        type=Path,
        default=Path("out") / "benchmarks",
        metavar="DIR",
        help="folder of the results; default: out/benchmarks",
    )
    given = parser.parse_args()
    if not (given.names or given.all or given.quick):
        print(
            f"{listing()}\n\npython -m benchmarks NAME runs a benchmark; "
            "--quick runs small cases of all"
        )
        return
    unknown = [name for name in given.names if name not in SCRIPTS]
    if unknown:
        parser.error(f"there is no benchmark '{unknown[0]}'; the known ones: {', '.join(SCRIPTS)}")
    given.out.mkdir(parents=True, exist_ok=True)
    versions = about("as each table states; otherwise the default flags")
    rows = []
    for name in given.names or SCRIPTS:
        print(f"{name}: {SCRIPTS[name]}", file=sys.stderr, flush=True)
        outcome = run(name, is_quick=given.quick)
        print(f"# {name}\n\n{outcome.text}", flush=True)
        keep(outcome, versions, given.out)
        state = outcome.problem or "ended"
        rows.append([f"[{name}]({name}.md)", SCRIPTS[name], f"{outcome.seconds:.0f}", state])
        print(f"{name}: {state} after {outcome.seconds:.0f} s", file=sys.stderr, flush=True)
        listed = table(["benchmark", "what it measures", "s", "how it ended"], rows)
        text = f"# Benchmarks\n\n{heading(versions)}\n\n{listed}\n"
        (given.out / "README.md").write_text(text, encoding="utf-8")
    print(f"written to {given.out / 'README.md'}", file=sys.stderr)
    if any(row[-1] != "ended" for row in rows):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
