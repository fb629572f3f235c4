"""Accuracy and cost of hard cases at several tolerances.

Run it with ``python benchmarks/hard_cases.py [CASE ...] [--write]``. It prints Markdown. Without
names it runs all cases, which takes some minutes; with ``--write`` it writes
``docs/hard_cases.md``. The cost is the number of steps and evaluations, so that the page is the
same on all machines up to rounding errors. The cases are defined in
``tests/example_scenes/hard_cases.py``; tests run the fast ones.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "example_scenes"))
import timing  # noqa: E402
from hard_cases import CASES, Outcome, model_of, outcome, reversal  # noqa: E402

PAGE = ROOT / "docs" / "hard_cases.md"
REVERSAL = ((5.0, 10.0, 20.0), (1e-7, 1e-10, 1e-13))

HEAD = """# Hard cases

`python benchmarks/hard_cases.py --write` writes this page. Each case runs at the relative
tolerances 1e-4, 1e-7 and 1e-10, unless the table states others. The three numbers in a cell belong
to these tolerances. The absolute tolerance is the relative tolerance times 1e-2, or times 1e-12 and
1e-14 for the two chemical reactions. `auto` selects the method; `*` marks a method that was
selected by name.

- **against**: the reference solution. It is a file of `tests/references`, a closed form, or a
  solution on which two different methods agree.
- **digits**: −log₁₀ of the largest error of all quantities at all times. The error is relative to
  the largest value of the quantity. If the list below states "digits of each", it is relative to
  each value itself. The accuracy of the reference limits this number.
- **drift**: the change of the energy relative to its value (in J if the value is below 1 J), or the
  residual of the constraints.
- **steps, evaluations**: the number of steps and of evaluations of the right-hand side. Times
  depend on the machine: measure them with `cotree bench`.
"""

AFTER = """## Time reversal

The final state of a chaotic motion cannot be compared with a reference, because initial errors grow
by a factor e about every 1.3 s. Instead, the double pendulum from the table is integrated forwards
and then backwards to its start. The table lists the largest difference between the initial and the
final angles and rates. The method is dop853 with `atol = rtol`.
"""


def rounded(values: list[str]) -> str:
    """Return a cell with three values, or one value if they are equal."""
    return values[0] if len(set(values)) == 1 else " / ".join(values)


def row(name: str, runs: list[Outcome]) -> str:
    """Return a row of the table."""
    case = CASES[name]
    methods = list(dict.fromkeys(run.method for run in runs))
    mark = "" if case.method == "auto" else "*"
    digits = [run.stopped or f"{run.digits:.1f}" for run in runs]
    drifts = [f"{run.drift:.0e}" for run in runs if math.isfinite(run.drift)]
    drift = f"{case.drift[0]} {rounded(drifts)}" if case.drift and drifts else "–"
    steps = [str(run.steps) for run in runs]
    evaluations = [str(run.evaluations) for run in runs]
    at = "" if case.tolerances == CASES["slider_pendulum"].tolerances else " (at 1e-7 / 1e-10)"
    cells = [
        name,
        case.against,
        f"{', '.join(methods)}{mark}",
        f"{rounded(digits)}{at}",
        drift,
        rounded(steps),
        rounded(evaluations),
    ]
    return timing.line(cells)


def table(names: list[str]) -> str:
    """Run cases and return the table."""
    lines = [
        timing.heading(["case", "against", "method", "digits", "drift", "steps", "evaluations"])
    ]
    for name in names:
        lines.append(row(name, [outcome(name, rtol) for rtol in CASES[name].tolerances]))
        print(lines[-1], file=sys.stderr, flush=True)
    return "\n".join(lines)


def what_was_hard(names: list[str]) -> str:
    return "\n".join(f"- **{name}**: {CASES[name].hard}." for name in names)


def reversals() -> str:
    """Integrate the double pendulum forwards and backwards."""
    times, tolerances = REVERSAL
    model = model_of("double pendulum, 10 s")
    rows = []
    for t_end in times:
        found = [reversal(model, t_end, "dop853", rtol) for rtol in tolerances]
        rows.append([f"{t_end:g} s", *(f"{x:.0e}" for x in found)])
    return timing.table(["there and back", *(f"{r:.0e}" for r in tolerances)], rows)


if __name__ == "__main__":
    names = [name for name in sys.argv[1:] if name != "--write"]
    chosen = names or list(CASES)
    text = f"{HEAD}\n{table(chosen)}\n\n## What is hard\n\n{what_was_hard(chosen)}\n"
    if not names:
        text += f"\n{AFTER}\n{reversals()}\n"
    if "--write" in sys.argv:
        if names:
            raise SystemExit("--write takes all cases: name none")
        PAGE.write_text(text, encoding="utf-8")
    print(text)
