"""Counts of intervals that hold, by fits of simulated experiments, seed by seed.

Run it with ``python benchmarks/interval_coverage.py [CASE ...] [--seeds N] [--write]``; it prints
Markdown, of cases whose names begin so where any is given, and with ``--write`` puts it into
``docs/how_to/trust_a_fit.md``. Each seed draws the noise of all measured values of a case anew, the
fit begins at the truth, and an interval of 95 % either holds the true value or not. Seeds are those
from zero on, none is left out. Of 100 intervals that hold with 95 %, 93 to 97 hold in three of four
cases only, so where a count lies outside all seeds to 1000 are run as well.
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
    """Count side by side in processes, blocks of seeds of each case."""
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
    """Write counts into a cell."""
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
