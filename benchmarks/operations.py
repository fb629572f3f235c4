"""Operation counts of the slider-pendulum, and times of the stages for a chain of rods.

Run it with ``python benchmarks/operations.py [N ...]``; it prints Markdown. Operation counts are
exact, but times depend on the machine.
"""

from __future__ import annotations

import statistics
import sys
import time
from pathlib import Path

import cotree
from cotree.codegen.c_files import render_model
from cotree.codegen.context import model_context
from cotree.pipeline import formulate, generate

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "example_scenes"))
import itertools

from rod_chain import rod_chain
from timing import surroundings, table

REPEATS = 5


def slider_pendulum() -> str:
    operations = cotree.load("slider-pendulum").compile(["L"]).operations
    rows = ((n, c.total, c.kernel) for n, c in operations.items() if c.total)
    return table(["kernel", "prepare counted in", "per call"], rows)


def sympy_counts() -> str:
    """Return operation counts of SymPy's ``cse`` for the equations of the paper."""
    import sympy as sp

    names = "m1 m2 L r zeta k s0 g s th sd thd sdd thdd s_L th_L sd_L thd_L sdd_L thdd_L"
    m1, m2, L, r, zeta, k, s0, g, s, th, sd, thd, sdd, thdd, *along = sp.symbols(names)
    a = m2 * L / 2
    matrix = sp.Matrix([[m1 + m2, a * sp.cos(th)], [a * sp.cos(th), m2 * (r**2 / 4 + L**2 / 3)]])
    forcing = sp.Matrix([a * sp.sin(th) * thd**2 - k * (s - s0), -a * g * sp.sin(th) - zeta * thd])
    residual = matrix * sp.Matrix([sdd, thdd]) - forcing
    chain = dict(zip((s, th, sd, thd, sdd, thdd), along, strict=True))
    derivative = residual.diff(L)
    for variable, tangent in chain.items():
        derivative += residual.diff(variable) * tangent

    def count(expressions: list[sp.Expr]) -> int:
        shared, results = sp.cse(expressions)
        return sum(e.count_ops() for e in results) + sum(e.count_ops() for _, e in shared)

    accelerations = matrix.LUsolve(forcing)
    fixed = derivative.subs({chain[sdd]: 0, chain[thdd]: 0})
    fixed = fixed.subs(dict(zip((sdd, thdd), accelerations, strict=True)))
    solved = count([*accelerations])
    both = count([*accelerations, *matrix.LUsolve(-fixed)])
    unsolved = count([*residual, *derivative])
    return (
        f"SymPy {sp.__version__} cse on Eq. (8) by hand: {solved} for the accelerations, "
        f"{both} with their derivatives by L; {unsolved} for the residuals of Eq. (8) and of "
        "its derivative alone, nothing solved"
    )


def chain_stages(n: int) -> tuple[list[float], int, int]:
    """Return processor times of formulation, generation and printing, operations and bytes."""
    scene, wanted = rod_chain(n)
    marks = [time.process_time()]
    _, equations, _ = formulate(scene, wanted, None)
    marks.append(time.process_time())
    program, _ = generate(equations)
    marks.append(time.process_time())
    files = render_model(model_context(program))
    marks.append(time.process_time())
    seconds = [later - earlier for earlier, later in itertools.pairwise(marks)]
    return seconds, program.operations["augmented_rhs"].total, sum(map(len, files.values()))


def chain(sizes: list[int]) -> str:
    rows = []
    for n in sizes:
        runs = [chain_stages(n) for _ in range(REPEATS)]
        stages = [statistics.median(run[0][i] for run in runs) for i in range(3)]
        total = statistics.median(sum(run[0]) for run in runs)
        cells = [n, 2 * n, runs[0][1], runs[0][2], *(f"{s:.2f}" for s in stages), f"{total:.2f}"]
        rows.append(cells)
    head = ["rods", "sensitivities", "operations", "C bytes"]
    return table([*head, "formulate", "generate", "print", "total s"], rows)


if __name__ == "__main__":
    print(surroundings())
    print(slider_pendulum(), "\n")
    print(sympy_counts(), "\n")
    print(chain([int(arg) for arg in sys.argv[1:]] or [5, 10, 20]))
