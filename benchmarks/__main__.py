"""All benchmarks, or some, with one command: ``python benchmarks [NAME ...] [--out DIR]``.

Each script runs in a process of its own, one after the other. What it prints is kept as
``DIR/NAME.md``, its tables as ``DIR/NAME.json``, both with machine, compiler, flags, versions and
time; ``DIR/README.md`` lists them. A script that cannot run, since a peer is not installed, is
listed with its reason, and the others run.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from timing import about, table

HERE = Path(__file__).parent

#: Scripts with what they measure, quick ones first.
SCRIPTS = {
    "operations": "operations of the slider-pendulum, and a chain of rods stage by stage",
    "real_time": "steps of one length, in C projects for real time",
    "networks": "networks of growing size, stage by stage",
    "growth": "growth of code and times with the number of rods or stages",
    "multibody": "energy, arms, chains, loops, singular positions",
    "kernels": "time of a call of each kernel beside other tools",
    "claim": "sensitivity graphs beside differentiating the assembled equations",
    "robots": "robots from file to kernel beside other tools",
    "peers": "time to an error beside other tools",
    "references": "least time to an error of each method, on references",
    "correctors": "augmented sensitivities beside CVODES' and IDAS' correctors",
    "work_precision": "speed against error of every method",
    "hard_cases": "digits, drift and cost of hard cases",
}


@dataclass
class Outcome:
    """Output of a script.

    Attributes
    ----------
    name : str
        Of the script.
    command : list of str
        What was run, from the repository's root.
    seconds : float
        On the clock.
    problem : str
        Why it stopped; empty where it ended.
    text : str
        What it printed.
    tables : list of dict
        Head and rows of each table in it, as text.
    """

    name: str
    command: list[str]
    seconds: float
    problem: str
    text: str
    tables: list[dict[str, Any]] = field(default_factory=list)


def run(name: str) -> Outcome:
    """Run a script from the root of the repository."""
    command = ["python", f"benchmarks/{name}.py"]
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, HERE / f"{name}.py"],
        cwd=HERE.parent,
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
    """Read the tables of a Markdown text."""
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
    """Write what numbers were measured with, a line each."""
    return "\n".join(f"- {key}: {value}" for key, value in versions.items())


def keep(outcome: Outcome, versions: dict[str, str], folder: Path) -> None:
    """Write what a script gave, with what it was measured with, as Markdown and as JSON."""
    said = f"It stopped: {outcome.problem}\n\n" if outcome.problem else ""
    took = f"`{' '.join(outcome.command)}`, {outcome.seconds:.0f} s"
    text = f"# {outcome.name}\n\n{heading(versions)}\n\n{took}\n\n{said}{outcome.text}"
    (folder / f"{outcome.name}.md").write_text(text.rstrip() + "\n", encoding="utf-8")
    kept = {key: value for key, value in asdict(outcome).items() if key != "text"}
    numbers = json.dumps({"about": versions, **kept}, indent=1, ensure_ascii=False)
    (folder / f"{outcome.name}.json").write_text(numbers + "\n", encoding="utf-8")


def main() -> None:
    """Run what is named, and list it."""
    parser = argparse.ArgumentParser(
        prog="python benchmarks",
        description="Run benchmarks, and keep their tables as Markdown and JSON.",
        epilog="; ".join(f"{name}: {what}" for name, what in SCRIPTS.items()),
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="all of them if absent")
    parser.add_argument("--out", type=Path, default=Path("out") / "benchmarks", metavar="DIR")
    given = parser.parse_args()
    unknown = [name for name in given.names if name not in SCRIPTS]
    if unknown:
        parser.error(f"there is no benchmark '{unknown[0]}'; the known ones: {', '.join(SCRIPTS)}")
    given.out.mkdir(parents=True, exist_ok=True)
    versions = about("as each table says; else those that the library takes")
    rows = []
    for name in given.names or SCRIPTS:
        print(f"{name}: {SCRIPTS[name]}", file=sys.stderr, flush=True)
        outcome = run(name)
        keep(outcome, versions, given.out)
        state = outcome.problem or "ended"
        rows.append([f"[{name}]({name}.md)", SCRIPTS[name], f"{outcome.seconds:.0f}", state])
        print(f"{name}: {state} after {outcome.seconds:.0f} s", file=sys.stderr, flush=True)
        listed = table(["benchmark", "what it measures", "s", "how it ended"], rows)
        text = f"# Benchmarks\n\n{heading(versions)}\n\n{listed}\n"
        (given.out / "README.md").write_text(text, encoding="utf-8")
    print(given.out / "README.md")
    if any(row[-1] != "ended" for row in rows):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
