"""Multibody benchmarks: energy, a spatial arm, long chains, loops, singular positions.

Run it with ``python benchmarks/multibody.py [energy] [arm] [chain] [loop] [singular] [--full]``; it
prints Markdown, by default all tables. With ``--full``, the energy is computed over 10 000 periods
of the fastest mode instead of 100, which takes some minutes for each scene. Operation counts are
exact, but times depend on the machine.
"""

from __future__ import annotations

import itertools
import re
import sys
import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree import Scene
from cotree.choice import choose_first_graph
from cotree.pipeline import formulate, generate, trees_to_try

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "example_scenes"))
from reference_scenes import absolute_tree, read_reference, scene_of, tree_without
from rod_chain import rod_chain
from timing import surroundings, table

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree import Model, Result

TOLERANCES = (1e-6, 1e-8, 1e-10, 1e-13)
#: Times at which the energy is looked at: few, since every one of them ends a step.
SAMPLES = 101
METHODS = ("dopri5", "dop853", "rodas5", "cvode", "ida")
#: Steps after which a run counts as caught in a singular position: twice what any other takes.
PATIENCE = 10_000
BODY = ("m", "cx", "cy", "cz", "ixx", "iyy", "izz", "ixy", "ixz", "iyz")

#: Joint axes, offset to the next joint, mass, centre of mass and principal inertia of six links.
UR5 = (
    ("z", (0, 0.13585, 0), 3.7, (0, 0, 0), (0.015, 0.015, 0.0104)),
    ("y", (0, -0.1197, 0.425), 8.393, (0, 0, 0.28), (0.2269, 0.2269, 0.0151)),
    ("y", (0, 0, 0.39225), 2.275, (0, 0, 0.25), (0.0494, 0.0494, 0.0041)),
    ("y", (0, 0.093, 0), 1.219, (0, 0, 0), (0.1112, 0.1112, 0.2194)),
    ("z", (0, 0, 0.09465), 1.219, (0, 0, 0), (0.1112, 0.1112, 0.2194)),
    ("y", (0, 0.0823, 0), 0.1879, (0, 0, 0), (0.0171, 0.0171, 0.0338)),
)


# ---- energy


def double_pendulum() -> Scene:
    scene = Scene("double-pendulum", gravity=[0, -9.81, 0])
    end = "ground"
    for i, angle in enumerate((0.2, 0.1)):
        scene.edge(f"h{i}", "revolute", end, f"B{i}", axis=[0, 0, 1], initial={"theta": angle})
        scene.edge(f"c{i}", "arm", f"B{i}", f"C{i}", vector=[0, -0.5, 0])
        scene.edge(f"e{i}", "arm", f"B{i}", f"E{i}", vector=[0, -1.0, 0])
        scene.edge(f"b{i}", "rigid_body", "ground", f"C{i}", mass=1.0, inertia=1.0 / 12.0)
        end = f"E{i}"
    return scene


def heavy_top() -> Scene:
    """Return a top on a ball joint, whose spin is a few times the minimum for stability."""
    scene = Scene("heavy-top", gravity=[0, 0, -9.81])
    start = {"rotation": [0.3, 0, 0], "w3": 30.0}
    scene.edge("ball", "spherical", "ground", "P", initial=start)
    scene.edge("axle", "arm", "P", "C", vector=[0, 0, 0.3])
    scene.edge("top", "rigid_body", "ground", "C", mass=1.0, inertia=[0.04, 0.04, 0.06])
    return scene


def four_bar() -> Scene:
    """Return a four-bar linkage that hangs from the ground and swings on a spring."""
    scene = Scene("four-bar", gravity=[0, -9.81, 0])
    links = (("A", 0.5, 1.0), ("B", 0.8, 1.5), ("C", 0.6, 1.2))
    end = "ground"
    for name, length, mass in links:
        # The crank is given, the others follow.
        start = {"theta": -1.2} if name == "A" else {}
        scene.edge(name, "revolute", end, f"{name}1", axis=[0, 0, 1], initial=start)
        scene.edge(f"c{name}", "arm", f"{name}1", f"{name}c", vector=[length / 2, 0, 0])
        scene.edge(f"e{name}", "arm", f"{name}1", f"{name}2", vector=[length, 0, 0])
        inertia = mass * length**2 / 12.0
        scene.edge(f"b{name}", "rigid_body", "ground", f"{name}c", mass=mass, inertia=inertia)
        end = f"{name}2"
    scene.edge("base", "arm", "ground", "D1", vector=[0.7, 0, 0])
    scene.edge("D", "revolute", "D1", end, axis=[0, 0, 1])
    scene.edge("spring", "spring", "ground", "B2", stiffness=20.0, free_length=0.9)
    return scene


def with_energy(scene: Scene) -> Scene:
    scene.output("kinetic", "energy.kinetic")
    scene.output("energy", "energy.kinetic + energy.potential")
    return scene


def bodies(scene: Scene) -> list[str]:
    kinds = ("rigid_body", "arm")
    return [name for name, edge in scene.edges.items() if edge.component.name in kinds]


ENERGY: dict[str, tuple[Callable[[], Scene], bool]] = {
    "double pendulum, joint coordinates": (double_pendulum, False),
    "double pendulum, absolute coordinates": (double_pendulum, True),
    "heavy top, quaternion": (heavy_top, False),
    "four-bar, one loop": (four_bar, False),
}


def fastest_period(model: Model) -> float:
    """Return the shortest period of the model, linearised about its start."""
    return float(2.0 * np.pi / np.abs(np.linalg.eigvals(model.linearize().A).imag).max())


def energy_drift(periods: int) -> str:
    rows = []
    for name, (make, is_absolute) in ENERGY.items():
        scene = with_energy(make())
        model = scene.compile(tree=bodies(scene) if is_absolute else None)
        period = fastest_period(model)
        times = np.linspace(0.0, periods * period, SAMPLES)
        for tolerance in TOLERANCES:
            settings = {"method": "dop853", "rtol": tolerance, "atol": tolerance}
            result = model.simulate((0.0, times[-1]), times, throw=True, **settings)
            energy = result["energy"]
            error = np.abs(energy - energy[0]).max() / result["kinetic"].max()
            drift = result.drift
            held = [f"{drift.worst:.0e}", f"{drift.correction:.0e}"] if drift else ["–", "–"]
            cells = [name, f"{period:.2f}", f"{tolerance:.0e}", f"{error:.1e}", *held]
            rows.append([*cells, result.statistics.n_steps, f"{result.times['integrate']:.0f}"])
            print(*rows[-1], file=sys.stderr, flush=True)
    errors = ["energy error", "constraints", "correction"]
    head = ["scene", "period s", "rtol, atol", *errors, "steps", "run s"]
    return (
        f"Energy over {periods} periods of the fastest mode, by dop853. The energy error is the "
        "largest change relative to the largest kinetic energy. The other columns are the largest "
        "residual of the constraints, with norms of quaternions, and the largest correction.\n\n"
        + table(head, rows)
    )


# ---- the arm


def spatial_arm(n: int = 7) -> tuple[Scene, list[str]]:
    """Return an arm of revolute joints about alternating axes, with all inertial parameters."""
    scene, names, end = Scene(f"arm-{n}", gravity=[0, 0, -9.81]), [], "ground"
    values = (0.01, 0.02, 0.1, 0.1, 0.1, 0.05, 0.001, 0.002, 0.001)
    for i in range(n):
        for name, value in zip(BODY, (5.0 - 0.5 * i, *values), strict=True):
            scene.parameter(f"{name}{i}", value)
            names.append(f"{name}{i}")
        axis, start = ([0, 0, 1], [0, 1, 0])[i % 2], {"theta": 0.1 * i}
        scene.edge(f"j{i}", "revolute", end, f"L{i}", axis=axis, initial=start)
        com = [f"c{k}{i}" for k in "xyz"]
        scene.edge(f"c{i}", "arm", f"L{i}", f"C{i}", vector=com)
        tensor = [[f"i{min(a, b)}{max(a, b)}{i}" for b in "xyz"] for a in "xyz"]
        scene.edge(f"b{i}", "rigid_body", "ground", f"C{i}", mass=f"m{i}", inertia=tensor)
        scene.edge(f"a{i}", "arm", f"L{i}", f"E{i}", vector=[0.05 * (i % 2), 0, 0.3])
        end = f"E{i}"
    return scene, names


def ur5_like() -> Scene:
    """Return an arm of six joints with the lengths and masses of a UR5 as constants."""
    scene = Scene("ur5-like", gravity=[0, 0, -9.81])
    scene.edge("base", "arm", "ground", "S", vector=[0, 0, 0.089159])
    end = "S"
    for i, (axis, step, mass, com, inertia) in enumerate(UR5):
        direction = [float(k == axis) for k in "xyz"]
        scene.edge(f"j{i}", "revolute", end, f"L{i}", axis=direction, initial={"theta": 0.1})
        scene.edge(f"c{i}", "arm", f"L{i}", f"C{i}", vector=com)
        scene.edge(f"b{i}", "rigid_body", "ground", f"C{i}", mass=mass, inertia=inertia)
        scene.edge(f"a{i}", "arm", f"L{i}", f"E{i}", vector=step)
        end = f"E{i}"
    return scene


def arm_row(name: str, scene: Scene, wanted: Sequence[str]) -> list[object]:
    marks = [time.process_time()]
    _, equations, alternatives = formulate(scene, wanted, None)
    marks.append(time.process_time())
    program, _ = generate(equations)
    marks.append(time.process_time())
    counts = program.operations
    cells: list[object] = [name, len(wanted)]
    for kernel in ("rhs", "jacobian", "sensitivity_rhs", "augmented_rhs"):
        count = counts[kernel]
        cells.append(f"{count.kernel} ({count.prepare})" if count.total else "–")
    way = "along the tree" if alternatives[0].is_along_tree else "by the matrix"
    return [*cells, way, f"{marks[1] - marks[0]:.1f}", f"{marks[2] - marks[1]:.1f}"]


def arms() -> str:
    scene, wanted = spatial_arm()
    rows = [
        arm_row("6 joints, numbers", ur5_like(), ()),
        arm_row("7 joints, 70 parameters", scene, ()),
        arm_row("7 joints, 70 parameters", scene, wanted),
    ]
    kernels = ["`rhs`", "`jacobian`", "`sensitivity_rhs`", "`augmented_rhs`"]
    head = ["arm", "sensitivities", *kernels, "elimination", "formulate s", "generate s"]
    return "Operations per call; operations of `prepare` in parentheses.\n\n" + table(head, rows)


# ---- growth


def chain_row(n: int) -> list[object]:
    """Return operations of the accelerations by each elimination, in the cheapest axes."""
    scene, _ = rod_chain(n)
    start = time.process_time()
    _, tried = choose_first_graph(scene, trees_to_try(scene, None), ())
    seconds = time.process_time() - start
    ways = [
        [row.n_operations for row in tried if row.is_along_tree == way] for way in (False, True)
    ]
    least = [min(counts, default=None) for counts in ways]
    return [n, *least, *("–" if c is None else f"{c / n:.0f}" for c in least), f"{seconds:.1f}"]


def chains(sizes: Sequence[int] = (10, 20, 50, 100)) -> str:
    ways = ["by the matrix", "along the tree"]
    head = ["rods", *ways, *(f"{way}, per rod" for way in ways), "s, all ways"]
    return (
        "Operations for the accelerations of planar rods, including those of parameters.\n\n"
        + table(head, [chain_row(n) for n in sizes])
    )


# ---- closed loops


def loops() -> str:
    scene = scene_of(read_reference("ivp_andrews"))
    scene.outputs.clear()
    trees = {
        "chosen by the library": None,
        "joints, pins O, G, H cut": tree_without(scene, ("O", "G", "H")),
        "joints, pins E1, E2, E3 cut": tree_without(scene, ("E1", "E2", "E3")),
        "pins E1, E2, E3 cut, angles of the bodies": {
            "translation": tree_without(scene, ("E1", "E2", "E3")),
            "rotation": absolute_tree(scene),
        },
        "bodies": absolute_tree(scene),
    }
    rows = []
    for name, tree in trees.items():
        start = time.process_time()
        found = formulate(scene, (), tree)[2][0]
        seconds = time.process_time() - start
        cells = [name, found.n_states, found.n_multipliers, found.n_operations]
        rows.append([*cells, f"{seconds:.1f}"])
    head = ["tree", "states", "multipliers", "accelerations", "formulate s"]
    return (
        "Andrews' squeezer, 7 bodies and 10 pins in a plane. Operations for the accelerations and "
        "multipliers, including those of parameters.\n\n" + table(head, rows)
    )


# ---- singular positions


def passage(model: Model, times: Sequence[float], method: str, tolerance: float) -> Result:
    """Simulate a motion through singular positions, or into one."""
    settings = {"method": method, "rtol": tolerance, "atol": tolerance, "max_steps": PATIENCE}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # what they say goes into the table
        result = model.simulate((0.0, times[-1]), times, **settings)
    print(len(times), method, tolerance, result.message, file=sys.stderr, flush=True)
    return result


def told(result: Result, *numbers: float) -> str:
    """Return the numbers of a completed run, or the time at which it stopped."""
    if not result.success:
        stop = re.search(r"stopped at t = (\S+)", result.message)
        return f"stops at {float(stop[1]):.2f}"
    mark = "*" if "crossed" in result.message else ""
    return ", ".join(f"{number:.0e}" for number in numbers) + mark


def worst_error(result: Result, rows: Sequence[dict[str, Any]]) -> float:
    errors = [0.0]
    for name in rows[0]["values"] if result.success else ():
        expected = np.array([row["values"][name] for row in rows])
        errors.append(np.abs(result[name] - expected).max() / np.abs(expected).max())
    return max(errors)


def singular() -> str:
    reference = read_reference("iftomm_a02_fourbar_N2")
    scene = scene_of(reference)
    models = {"joints": scene.compile(), "bodies": scene.compile(tree=absolute_tree(scene))}
    rows, cases = reference["reference"], list(itertools.product(models, (1e-6, 1e-8, 1e-10)))
    by_method = []
    for method in ("rkf45", "rodas4", *METHODS):
        runs = [passage(models[n], [r["t"] for r in rows], method, tol) for n, tol in cases]
        by_method.append([method, *(told(run, worst_error(run, rows)) for run in runs)])
    passed = [sum("stops" not in row[k + 1] for row in by_method) for k in range(len(cases))]
    by_method.append(["passed", *passed])
    first = table(["method", *(f"{n}, {tol:.0e}" for n, tol in cases)], by_method)

    by_count, cases = [], list(itertools.product(models, (1e-8, 1e-10, 1e-12)))
    for count in (31, 61, 301, 601):
        times = np.linspace(0.0, 3.0, count)
        runs = [passage(models[n], times, "dop853", tol) for n, tol in cases]
        lost = [np.ptp(run["energy"]) / run["energy"][0] for run in runs]
        cells = [told(r, e, r.drift.correction) for r, e in zip(runs, lost, strict=True)]
        by_count.append([count, *cells])
    second = table(["outputs", *(f"{n}, {tol:.0e}" for n, tol in cases)], by_count)
    return (
        f"The N-four-bar, rtol = atol, at most {PATIENCE} steps. A star marks runs that crossed an "
        "interval with a looser tolerance. For 10 s with five outputs: the largest error of all "
        "quantities, relative to the largest value of each, or the time at which the run stops.\n\n"
        f"{first}\n\nFor 3 s by dop853: the relative change of the energy, and the largest "
        f"correction by a projection.\n\n{second}"
    )


TABLES: dict[str, Callable[[], str]] = {
    "arm": arms,
    "chain": chains,
    "loop": loops,
    "singular": singular,
}

if __name__ == "__main__":
    given = [arg for arg in sys.argv[1:] if arg != "--full"]
    is_full = "--full" in sys.argv
    print(surroundings())
    if not given or "energy" in given:
        print(energy_drift(10_000 if is_full else 100), "\n")
    for key, make_table in TABLES.items():
        if not given or key in given:
            print(make_table(), "\n")
