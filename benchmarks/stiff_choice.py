"""Methods that `auto` selects for stiff systems, compared with the other methods.

Run it with ``python benchmarks/stiff_choice.py [NAME ...] [--rounds N] [--write]``. It prints
Markdown for the systems whose names begin with NAME, by default for all; with ``--write`` it
inserts the table into ``docs/engine.md``.

The systems are networks of random mass-action reactions with rate constants over four decades, from
fixed seeds, then ladders and a chemical reference. Each method runs at one tolerance per decade.
Errors are those of states and sensitivities at 101 points, relative to the largest value of each
kind; the reference is ``cvode`` at 1e-12. Times are minima of alternating rounds, from the first
call of C to the last. Times to an error are interpolated between tolerances.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "example_scenes"))
from domain_scenes import scene_of_domain
from network_scenes import rc_ladder
from reference_scenes import read_reference
from timing import put_on_page, surroundings, table

from cotree import Scene
from cotree.scene.settings import Settings
from cotree.solvers.prepare import prepared
from cotree.solvers.stiffness import share_of_rodas5

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cotree import Model, Result

PAGE = Path(__file__).parents[1] / "docs" / "engine.md"
METHODS = ("rodas5", "cvode", "ida")
ERRORS = (1e-4, 1e-6, 1e-8)
TOLERANCES = tuple(10.0**-k for k in range(3, 11))
POINTS = 101

#: Species, reactions for each, sensitivities and the seed.
NETWORKS = (
    (6, 2.0, 0, 11),
    (12, 3.0, 0, 13),
    (12, 3.0, 6, 14),
    (20, 3.0, 0, 1),
    (20, 6.0, 6, 2),
    (30, 8.0, 20, 18),
    (40, 8.0, 0, 4),
    (50, 4.0, 6, 5),
    (75, 8.24, 1, 7),
    (75, 8.24, 6, 1),
    (100, 3.0, 0, 19),
    (100, 5.0, 4, 20),
    (150, 3.0, 2, 21),
)


def network(n: int, per_species: float, n_sensitivities: int, seed: int) -> Model:
    """Compile random reactions: A to B, A + B to C + D, and A to C with the catalyst B."""
    rng, n_reactions = np.random.default_rng(seed), round(per_species * n)
    scene = Scene(f"net{n}-{n_reactions}-s{seed}")
    for i in range(n):
        initial = {"c": float(10.0 ** rng.uniform(-1.5, 0.5))}
        scene.edge(f"S{i}", "species", f"S{i}", "ground", volume=1.0, initial=initial)
    for r in range(n_reactions):
        scene.parameter(f"k{r}", float(10.0 ** rng.uniform(-2.5, 1.5)))
        kind, own = rng.random(), r % n
        others = rng.choice([j for j in range(n) if j != own], 3, replace=False)
        a, b, c, d = (f"S{j}" for j in (own, *others))
        reactants, products = [a, b], [c, b]
        if kind < 0.4:
            reactants, products = [a], [b]
        elif kind < 0.75:
            products = [c, d]
        scene.edge(f"R{r}", "reaction", reactants=reactants, products=products, rate=f"k{r}")
    step = max(1, n_reactions // max(n_sensitivities, 1))
    return scene.compile([f"k{j * step}" for j in range(n_sensitivities)])


def systems(names: tuple[str, ...]) -> Iterator[tuple[str, Model, float, float]]:
    """Return names, models, end times, [s], and ratios of absolute to relative tolerance."""
    for n, per_species, n_sensitivities, seed in NETWORKS:
        label = f"{n} species, {round(per_species * n)} reactions, {n_sensitivities}"
        if label.startswith(names):
            yield label, network(n, per_species, n_sensitivities, seed), 1000.0, 1e-3
    for wanted in (0, 3) if "HIRES".startswith(names) else ():
        data = read_reference("chem_hires")
        model = scene_of_domain("chem_hires").compile([*data["sensitivities"]["values"]][:wanted])
        yield f"HIRES, 8 species, {wanted}", model, data["t_end"], 1e-6
    for n in (60, 140) if "ladder".startswith(names) else ():
        yield f"ladder of {n} stages, 2", rc_ladder(n).compile(["R", "C"]), 1e4, 1e-3


def error(found: Result, reference: Result) -> float:
    """Return the largest error, relative to the largest state or sensitivity."""
    pairs = [(found.y, reference.y)]
    pairs += [(found.s[:, j], reference.s[:, j]) for j in range(found.s.shape[1])]
    return max(float(np.max(np.abs(a - b)) / np.max(np.abs(b))) for a, b in pairs)


def least_time(rows: list[tuple[float, float]], wanted: float) -> float:
    """Return the interpolated time to an error; infinite if no tolerance reaches it."""
    errors = np.minimum.accumulate(np.log([max(e, 1e-15) for e, _ in rows]))
    if errors[-1] > np.log(wanted):
        return float("inf")
    times = np.log([ms for _, ms in rows])
    return float(np.exp(np.interp(-np.log(wanted), -errors, times)))


def measured(model: Model, end: float, share: float, rounds: int) -> dict[str, list[float]]:
    """Return the minimum times to the errors for each method, [ms]."""
    times = np.linspace(0.0, end, POINTS)

    def run(method: str, rtol: float) -> Result:
        return model.simulate((0.0, end), times, method=method, rtol=rtol, atol=rtol * share)

    reference = run("cvode", 1e-12)
    errors = {(m, r): error(run(m, r), reference) for m in METHODS for r in TOLERANCES}
    spent: dict[tuple[str, float], list[float]] = {key: [] for key in errors}
    for _ in range(rounds):
        for method, rtol in errors:
            spent[method, rtol].append(1e3 * run(method, rtol).statistics.seconds)
    rows = {m: [(errors[m, r], min(spent[m, r])) for r in TOLERANCES] for m in METHODS}
    return {m: [least_time(rows[m], e) for e in ERRORS] for m in METHODS}


def line_of(label: str, model: Model, end: float, share: float, rounds: int) -> list[str]:
    """Return a row of the table."""
    settings = Settings((0.0, end), rtol=1e-6, atol=1e-6 * share)
    problem = prepared(model.kernels, settings).run(None, {})
    estimate = share_of_rodas5(problem)
    chosen = model.simulate((0.0, end), rtol=1e-6, atol=1e-6 * share).statistics.method
    found = measured(model, end, share, rounds)
    best = [min(found[m][i] for m in METHODS) for i in range(len(ERRORS))]
    cells = [" / ".join(f"{ms:.3g}" for ms in found[m]) for m in METHODS]
    of_best = [
        " / ".join(f"{found[m][i] / best[i]:.2f}" for i in range(len(ERRORS)))
        for m in ("rodas5", chosen)
    ]
    return [label, *cells, f"{estimate:.2g}", chosen, *of_best]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=[""])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()
    warnings.simplefilter("ignore", RuntimeWarning)
    print(surroundings())
    head = ["system, sensitivities", *(f"`{m}` ms" for m in METHODS)]
    head += ["estimate", "`auto`", "`rodas5` to best", "`auto` to best"]
    lines = []
    for label, model, end, share in systems(tuple(given.names)):
        lines.append(line_of(label, model, end, share, given.rounds))
        print(" | ".join(lines[-1]), flush=True)
    text = table(head, lines)
    print(f"\n{text}")
    if given.write:
        put_on_page(PAGE, "stiff_choice.py", text)
