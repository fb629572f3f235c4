"""Kernels compared with those of other tools: time per call, operations, code, compilation.

Run it with ``python benchmarks/kernels.py [ROW ...] [--rounds N] [--json FILE]``; it prints
Markdown. Other tools need ``pip install casadi heyoka sympy pydy`` and are omitted if they are
missing. ``--pinocchio FOLDER`` also measures Pinocchio, with the requirements of ``robots.py``.

All parameters can change between calls. Other tools receive the same equations with parameters as
arguments and differentiate them. In cotree, ``prepare`` computes values that depend only on
parameters; the other tools compute them at each call. All kernels of a row are called alternately.
Their results are compared, and those of cotree also with an evaluation of its program in Python.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "example_scenes"))
from evaluated_kernels import EvaluatedKernels
from rod_chain import rod_chain
from timing import Contender, about, difference, in_turn, keep, own, show, table

import cotree
from cotree import Scene
from cotree.build import BuildOptions, compiler_flags, find_toolchain
from cotree.codegen.context import model_context

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

OWN = {"native": True, "portable": False}
ALL = ("CasADi", "heyoka", "SymPy")
CHAIN = (*ALL, "PyDy")  # whose equations are PyDy's own
_AGREE = 1e-9  # rounding of some thousand operations


def four_bar() -> Scene:
    """Build a four-bar linkage whose lengths and masses are parameters."""
    scene = Scene("four-bar", gravity=[0, "-g", 0])
    scene.parameter("g", 9.81)
    end = "ground"
    for name, length, mass in (("A", 0.5, 1.0), ("B", 0.8, 1.5), ("C", 0.6, 1.2)):
        scene.parameter(f"L{name}", length)
        scene.parameter(f"m{name}", mass)
        start = {"theta": -1.2} if name == "A" else {}
        scene.edge(name, "revolute", end, f"{name}1", axis=[0, 0, 1], initial=start)
        scene.edge(f"c{name}", "arm", f"{name}1", f"{name}c", vector=[f"L{name}/2", 0, 0])
        scene.edge(f"e{name}", "arm", f"{name}1", f"{name}2", vector=[f"L{name}", 0, 0])
        inertia = [0, 0, f"m{name}*L{name}**2/12"]
        mass = f"m{name}"
        scene.edge(f"b{name}", "rigid_body", "ground", f"{name}c", mass=mass, inertia=inertia)
        end = f"{name}2"
    scene.parameter("d", 0.7)
    scene.edge("base", "arm", "ground", "D1", vector=["d", 0, 0])
    scene.edge("D", "revolute", "D1", end, axis=[0, 0, 1])
    return scene


FOUR_BAR = ("LA", "LB", "LC", "mA", "mB", "mC", "d")


@dataclass(frozen=True)
class Row:
    """A kernel, and the target as a fraction of the best time of other tools."""

    name: str
    make: Callable[[], tuple[Scene, Sequence[str]]]
    kernel: str
    reach: str
    peers: tuple[str, ...] = ALL
    rods: int = 0  # of the chain that Pinocchio takes, too


def _slider(*names: str) -> Callable[[], tuple[Scene, Sequence[str]]]:
    return lambda: (cotree.load("slider-pendulum"), names)


def _chain(n: int, with_parameters: bool = False) -> Callable[[], tuple[Scene, Sequence[str]]]:
    return lambda: (rod_chain(n)[0], rod_chain(n)[1] if with_parameters else ())


_EIGHT = ("m1", "m2", "L", "r", "zeta", "k", "s0", "g")
ROWS = [
    Row("slider-pendulum, rhs", _slider(), "rhs", "1.00"),
    Row("slider-pendulum, rhs + L", _slider("L"), "augmented_rhs", "0.86"),
    Row("slider-pendulum, rhs + 8", _slider(*_EIGHT), "augmented_rhs", "0.71"),
    Row("chain of 5, rhs", _chain(5), "rhs", "–", CHAIN),
    Row("chain of 20, rhs", _chain(20), "rhs", "0.58", ("CasADi", "heyoka", "PyDy")),
    Row("chain of 50, rhs", _chain(50), "rhs", "0.57", ("CasADi", "heyoka")),
    Row("chain of 10, Jacobian", _chain(10), "jacobian", "0.43", ("CasADi", "heyoka"), 10),
    Row("chain of 20, Jacobian", _chain(20), "jacobian", "0.29", ("CasADi",), 20),
    Row("chain of 50, Jacobian", _chain(50), "jacobian", "0.20 of Pinocchio", ("CasADi",), 50),
    Row("chain of 5, rhs + 10", _chain(5, True), "augmented_rhs", "0.41", ("CasADi", "heyoka")),
    Row("chain of 10, rhs + 20", _chain(10, True), "augmented_rhs", "0.31", ("CasADi",)),
    Row("chain of 20, rhs + 40", _chain(20, True), "augmented_rhs", "0.18", ("CasADi",)),
    Row("chain of 50, rhs + 100", _chain(50, True), "augmented_rhs", "80 us", ("CasADi",)),
    Row("four-bar, rhs", lambda: (four_bar(), ()), "rhs", "0.78", ("CasADi", "heyoka")),
    Row("four-bar, rhs + 7", lambda: (four_bar(), FOUR_BAR), "augmented_rhs", "0.54",
        ("CasADi", "heyoka")),
]  # fmt: skip


def measure(
    row: Row, rounds: int, folder: Path | None = None, peers: Sequence[str] = CHAIN
) -> dict[str, Any]:
    """Measure a row, also with Pinocchio if a folder for its program is specified."""
    models: dict[str, Any] = {}
    contenders: dict[str, Contender] = {}
    for name, native in OWN.items():
        scene, wanted = row.make()
        models[name] = scene.compile(wanted, native=native)
    model = models["native"]
    rng = np.random.default_rng(0)
    x = model.start().y + rng.uniform(-0.1, 0.1, len(model.states))
    s = rng.uniform(-1.0, 1.0, len(model.states) * max(1, len(model.sensitivities)))
    for name, one in models.items():
        contenders[name] = own(one, row.kernel, x, s)
        contenders[name].note = " ".join(flags(one, OWN[name]))
        _check(row, one, contenders[name], x, s)
    for name in row.peers:
        if name in peers:
            found = _peer(name, row, model, x, s)
            if found is not None:
                contenders[name] = found
    for name, one in contenders.items():
        if one.call is not None:
            found = difference(contenders["native"], one)
            if not found < _AGREE:
                raise SystemExit(f"{row.name}: {name} computes something else, by {found:.1e}")
    in_turn(list(contenders.values()), rounds)
    found = {"row": row.name, "reach": row.reach} | {k: c.row() for k, c in contenders.items()}
    if row.rods and folder is not None:
        import kernel_peers

        least = kernel_peers.pinocchio_chain(row.rods, folder).get(row.kernel)
        if least is not None:
            found["Pinocchio"] = {"least ns": least, "note": "C++ -O3, in a program of its own"}
    # Round by round, since what disturbs one of them disturbs the other.
    found["ratios"] = {
        name: float(np.median(np.array(contenders["native"].times) / np.array(one.times)))
        for name, one in contenders.items()
        if one.times and name not in OWN
    }
    return found


def _check(row: Row, model: Any, one: Contender, x: Any, s: Any) -> None:
    """Compare the compiled code with an evaluation of its program in Python."""
    assert one.call is not None
    one.call(1)
    kernels = EvaluatedKernels(model.kernels.program)
    kernels.prepare(model.default_parameters)
    step = np.zeros_like(x)
    step[0] = 1e-9  # which a call begins with
    expected = kernels(row.kernel, 0.0, x + step, s, np.zeros(len(model.inputs)))
    found = np.max(np.abs(one.value() - expected)) / max(1.0, np.max(np.abs(expected)))
    if not found < _AGREE:
        raise SystemExit(f"{row.name}: C computes something else than Python, by {found:.1e}")


def flags(model: Any, native: bool) -> tuple[str, ...]:
    """Return the flags with which cotree compiles a model."""
    toolchain = find_toolchain()
    if toolchain is None:
        raise SystemExit("no C compiler was found: install one")
    context = model_context(model.kernels.text.program)
    sizes = context.n_written, context.n_written_in_all
    return compiler_flags(toolchain, BuildOptions(native=native), *sizes)


def _peer(name: str, row: Row, model: Any, x: Any, s: Any) -> Contender | None:
    import kernel_peers

    try:
        return kernel_peers.PEERS[name](model, row.kernel, x, s)
    except ImportError as reason:
        print(f"{name} is left out: {reason}", file=sys.stderr)
        return None


def _ns(found: dict[str, Any], key: str = "median ns") -> str:
    value = found.get(key)
    return "–" if value is None else f"{value:,.0f}" if value >= 100 else f"{value:.1f}"


def ratio(result: dict[str, Any]) -> str:
    """Return the ratio to the best time of other tools, and the name of that tool."""
    ratios = result["ratios"]
    cells = []
    if ratios:
        best = max(ratios, key=lambda name: ratios[name])
        cells.append(f"{ratios[best]:.2f} of {best}")
    if "Pinocchio" in result:
        share = result["native"]["least ns"] / result["Pinocchio"]["least ns"]
        cells.append(f"{share:.2f} of Pinocchio")
    return ", ".join(cells) or "–"


def report(results: Sequence[dict[str, Any]]) -> str:
    """Print both tables."""
    times, sizes = [], []
    for result in results:
        cells = [
            f"{_ns(result[name])} ({_ns(result[name], 'least ns')})"
            if "median ns" in result.get(name, {})
            else "–"
            for name in (*OWN, *CHAIN)
        ]
        cells.append(_ns(result.get("Pinocchio", {}), "least ns"))
        times.append([result["row"], *cells, ratio(result), result["reach"]])
        line = [result["row"], result["native"]["operations"]]
        line.append(result.get("CasADi", {}).get("operations", "–"))
        for name in ("native", "CasADi"):
            c_bytes = result.get(name, {}).get("c_bytes")
            line.append("–" if c_bytes is None else f"{c_bytes / 1e3:.0f}")
        mine, other = result["native"], result.get("CasADi")
        line += [f"{mine['generation']:.2f}", f"{mine['compilation']:.2f}"]
        line.append(f"{other['generation']:.2f}" if other else "–")
        line.append(f"{other['compilation']:.1f} ({other['note']})" if other else "–")
        sizes.append(line)
    head = ["kernel", *OWN, *CHAIN, "Pinocchio", "cotree / best other tool", "target"]
    more = ["kernel", "operations", "CasADi's", "C of the model, kB", "CasADi's C, kB"]
    more += ["generation s", "compilation s", "CasADi's generation s", "compilation s"]
    return f"{table(head, times)}\n\n{table(more, sizes)}"


def main() -> None:
    """Measure all rows and print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("rows", nargs="*", help="parts of the names of rows; default: all rows")
    parser.add_argument("--rounds", type=int, default=31)
    parser.add_argument("--pinocchio", type=Path, help="folder for the program of Pinocchio")
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    versions = about("own: native and portable code as the library compiles it")
    results = []
    cotree.load("spring-mass-damper").compile()  # imports are not counted
    for row in ROWS:
        if given.rows and not any(part in row.name for part in given.rows):
            continue
        print(row.name, file=sys.stderr, flush=True)
        with tempfile.TemporaryDirectory() as folder:
            os.environ["COTREE_CACHE_DIR"] = folder  # nothing was compiled before
            results.append(measure(row, given.rounds, given.pinocchio))
        keep(given.json, versions, results)
    show(versions, report(results))


if __name__ == "__main__":
    main()
