"""Coverage of confidence intervals in fits of simulated experiments.

Run it with ``python benchmarks/interval_coverage.py [CASE ...] [--seeds N] [--write]``. It prints
Markdown for the cases whose names begin with CASE, by default for all; with ``--write`` it inserts
the table into ``docs/how_to/trust_a_fit.md``.

Each seed draws new noise for all measured values of a case. The fit begins at the true values, and
each 95 % interval is tested for the true value. Seeds are consecutive from zero, and none is
omitted. If the intervals are exact, the count in 100 seeds is between 93 and 97 in three of four
cases only. Cases with a count outside this range are run with 1000 seeds, too.
"""

from __future__ import annotations

import argparse
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "example_scenes"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "estimation"))
from simulated_fits import CASES, covered
from timing import put_on_page, surroundings, table

PAGE = Path(__file__).parents[1] / "docs" / "how_to" / "trust_a_fit.md"
SEEDS, MORE_SEEDS = 100, 1000
# Seeds that a process runs in one go.
BLOCK = 50
# Of 100; where a count lies outside, more seeds tell whether it was by chance.
WISHED = (93, 97)


def counted(names: list[str], seeds: range) -> dict[str, dict[str, int]]:
    """Count in parallel processes, in blocks of seeds of each case."""
    blocks = [
        (name, range(first, min(first + BLOCK, seeds.stop)))
        for name in names
        for first in range(seeds.start, seeds.stop, BLOCK)
    ]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        parts = list(pool.map(covered, *zip(*blocks, strict=True))) if blocks else []
    found = {name: dict.fromkeys(CASES[name].truth, 0) for name in names}
    for (name, _), part in zip(blocks, parts, strict=True):
        for key, n in part.items():
            found[name][key] += n
    return found


def cells(counts: dict[str, int] | None) -> str:
    """Return the cells with counts."""
    return ", ".join(f"{key} {n}" for key, n in counts.items()) if counts else ""


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=[""])
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()
    print(surroundings())
    chosen = [name for name in CASES if name.startswith(tuple(given.names))]
    first = counted(chosen, range(given.seeds))
    low, high = WISHED
    outside = [
        name
        for name, counts in first.items()
        if given.seeds == SEEDS and not all(low <= n <= high for n in counts.values())
    ]
    more = {
        name: {key: n + first[name][key] for key, n in counts.items()}
        for name, counts in counted(outside, range(SEEDS, MORE_SEEDS)).items()
    }
    head = ["case", "values", "noise", f"covered of {given.seeds}", f"covered of {MORE_SEEDS}"]
    lines = []
    for name in chosen:
        case = CASES[name]
        n_values = case.t.size * len(case.inputs) * len(case.noise)
        noise = "given" if case.is_noise_given else "estimated"
        lines.append([name, n_values, noise, cells(first[name]), cells(more.get(name))])
    text = table(head, lines)
    print(text)
    if given.write:
        put_on_page(PAGE, "interval_coverage.py", text)
