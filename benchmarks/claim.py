"""Sensitivity graphs compared with direct differentiation of the assembled equations.

Run it with ``python benchmarks/claim.py [SYSTEM ...] [--rounds N] [--json FILE]``; it prints
Markdown. Three ways compute the rates of states and sensitivities, ``s' = J s + f_p``:

- graphs: the formulation is evaluated for sensitivity graphs, whose linear equations are solved
  with the factors of the first graph, as in cotree
- direct: the solved accelerations are differentiated by the same forward rules, passes, printing
  and compiler (tangents along each sensitivity, or the Jacobian times s, whichever has fewer
  operations)
- SymPy: ``jacobian`` and ``cse`` of the rates as SymPy expressions, limited to one minute.

Generation times are processor times from the scene to the C code, without the Jacobian and other
kernels of the model. Calls are timed alternately.
"""

from __future__ import annotations

import argparse
import gc
import sys
import time
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "example_scenes"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "robots"))
from kernel_peers import sympy
from robot_files import stored_file, without_losses
from rod_chain import rod_chain
from timing import Contender, about, difference, in_turn, keep, loop, show, spent_by_children, table

import cotree
from cotree.build import BuildOptions, build_library, find_toolchain, load_library
from cotree.choice import choose_first_graph
from cotree.codegen.c_files import cdef, render_model
from cotree.codegen.context import model_context
from cotree.dag.derivative import tangents
from cotree.dag.nodes import symbols_in
from cotree.model.kernels import Kernels
from cotree.pipeline import trees_to_try
from cotree.program.lower import lower
from cotree.program.passes import run_passes
from cotree.program.text import ModelText
from cotree.sensitivity.graphs import form_equations
from cotree.version import ABI_VERSION

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree import Scene
    from cotree.program.program import Kernel, Program

_SYMPY_LIMIT = 60.0  # seconds
_AGREE = 1e-9  # rounding of some thousand operations


@dataclass(frozen=True)
class System:
    """A scene, its parameters, the numbers of parameters, and whether SymPy is measured."""

    make: Callable[[], Scene]
    order: Callable[[Scene], Sequence[str]]
    counts: tuple[int, ...]
    with_sympy: bool = False


def _masses_and_lengths(scene: Scene) -> list[str]:
    n = len(scene.parameters) // 2
    return [f"{kind}{i}" for i in range(n) for kind in "mL"]


def _chain(n: int, counts: tuple[int, ...], with_sympy: bool = False) -> System:
    return System(lambda: rod_chain(n)[0], _masses_and_lengths, counts, with_sympy)


def _ur5() -> Scene:
    return without_losses(cotree.read_urdf(stored_file("ur5"), "fixed", mimic=False))


def acting(scene: Scene) -> list[str]:
    """Return the parameters on which the rates depend, in the order of the scene."""
    first, _ = choose_first_graph(scene, trees_to_try(scene, None), ())
    equations = form_equations(first, (), with_columns=False)
    found = {node.data for node in symbols_in(lower(equations).kernels["rhs"].results)}
    return [quantity.name for i, quantity in enumerate(equations.parameters) if ("p", i) in found]


SYSTEMS = {
    "slider-pendulum": System(
        lambda: cotree.load("slider-pendulum"), acting, (1, 2, 4, 8), with_sympy=True
    ),
    "chain of 2": _chain(2, (1, 4), with_sympy=True),
    "chain of 3": _chain(3, (1, 6), with_sympy=True),
    "chain of 5": _chain(5, (1, 5, 10)),
    "chain of 10": _chain(10, (1, 5, 10, 20)),
    "chain of 20": _chain(20, (1, 10, 20, 40)),
    "UR5": System(_ur5, acting, (1, 10, 30, 0)),  # 0: all of them
}


def by_graphs(scene: Scene, names: Sequence[str]) -> Program:
    """Form the program as cotree does, without the Jacobian."""
    first, _ = choose_first_graph(scene, trees_to_try(scene, None), names)
    return run_passes(lower(form_equations(first, names, with_columns=False)))[0]


def directly(scene: Scene, names: Sequence[str]) -> tuple[Program, float]:
    """Differentiate the assembled rates; also return the time of steps common to all ways."""
    first, _ = choose_first_graph(scene, trees_to_try(scene, None), names)
    plain = lower(form_equations(first, (), with_columns=False))
    rates = list(plain.kernels["rhs"].results)
    along = min(
        (_tangents(plain, rates, names), _products(plain, rates, names)),
        key=lambda rows: _kernel(plain, [*rates, *rows]).operations.total,
    )
    began = time.process_time()
    frame = lower(form_equations(first, names, with_columns=False))  # names, places, starts
    apart = time.process_time() - began
    kernels = {
        **frame.kernels,
        "augmented_rhs": replace(frame.kernels["augmented_rhs"], results=(*rates, *along)),
        "sensitivity_rhs": replace(frame.kernels["sensitivity_rhs"], results=tuple(along)),
    }
    return run_passes(replace(frame, kernels=kernels))[0], apart


def _kernel(program: Program, results: Sequence[Any]) -> Kernel:
    return replace(program.kernels["rhs"], results=tuple(results))


def _parameter(program: Program, name: str) -> Any:
    names = [quantity.name for quantity in program.layout.parameters]
    return program.dag.symbol("p", names.index(name))


def _tangents(program: Program, rates: list[Any], names: Sequence[str]) -> list[Any]:
    """Differentiate along each sensitivity, for all states and the parameter together."""
    dag, n, found = program.dag, len(rates), []
    for j, name in enumerate(names):
        seed = {dag.symbol("x", i): dag.symbol("s", j * n + i) for i in range(n)}
        found += tangents(rates, {**seed, _parameter(program, name): dag.one})
    return found


def _products(program: Program, rates: list[Any], names: Sequence[str]) -> list[Any]:
    """Differentiate with respect to each state and parameter, then multiply."""
    dag, n, found = program.dag, len(rates), []
    columns = [tangents(rates, {dag.symbol("x", i): dag.one}) for i in range(n)]
    for j, name in enumerate(names):
        own = tangents(rates, {_parameter(program, name): dag.one})
        for row in range(n):
            total = own[row]
            for i in range(n):
                total = total + columns[i][row] * dag.symbol("s", j * n + i)
            found.append(total)
    return found


def compiled(
    program: Program, generation: float, options: BuildOptions, x: Any, s: Any
) -> Contender:
    """Print and compile a program and return a kernel that can be called."""
    began = time.process_time()
    context = model_context(program)
    files = render_model(context)
    generation += time.process_time() - began
    toolchain = find_toolchain()
    if toolchain is None:
        raise SystemExit("no C compiler was found: install one")
    kernel = program.kernels["augmented_rhs"]
    size = sum(len(text) for name, text in files.items() if name != "cotree_abi.h")
    before = spent_by_children()
    library = build_library(
        files,
        abi_version=ABI_VERSION,
        n_operations=context.n_written,
        n_all=context.n_written_in_all,
        options=options,
        toolchain=toolchain,
    )
    took = spent_by_children() - before
    found = Contender(program.operations["augmented_rhs"].kernel, size, generation, took, "")
    loaded = load_library(library.path, cdef(files["cotree_abi.h"], context.prefix))
    kernels = Kernels(ModelText.of(program, prefix=context.prefix), loaded)
    p = np.array(program.layout.parameter_values)
    kernels.prepare(p)
    struct = loaded.ffi.cast("const cotree_model *", kernels.address_for(is_implicit=True))
    address = int(loaded.ffi.cast("uintptr_t", struct.augmented_rhs))
    out = np.zeros(len(kernel.results))
    u = np.zeros(len(program.layout.inputs) + 1)
    found.call = loop("sensitivity", address, x.copy(), [s.copy(), u, p, kernels.prepared(), out])
    found.call.keeps += (kernels,)  # type: ignore[attr-defined]
    found.value = lambda: out
    found.note = library.command.split()[2]
    return found


def measure(
    name: str, system: System, n_names: int, rounds: int, options: BuildOptions
) -> dict[str, Any]:
    """Measure a system with the given number of parameters, or with all."""
    every = system.order(system.make())
    names = list(every[: n_names or len(every)])
    rng = np.random.default_rng(0)
    ways: dict[str, Contender] = {}
    gc.disable()
    began = time.process_time()
    graphs = by_graphs(system.make(), names)
    spent = time.process_time() - began
    began = time.process_time()
    other, apart = directly(system.make(), names)
    direct = time.process_time() - began - apart
    gc.enable()
    n = len(graphs.layout.states)
    x, s = rng.uniform(-1.0, 1.0, n), rng.uniform(-1.0, 1.0, n * len(names))
    ways["graphs"] = compiled(graphs, spent, options, x, s)
    ways["direct"] = compiled(other, direct, options, x, s)
    if system.with_sympy:
        model = system.make().compile(names)
        ways["SymPy"] = sympy(model, "augmented_rhs", x, s, _SYMPY_LIMIT)
    for way, one in ways.items():
        if one.call is not None:
            found = difference(ways["graphs"], one)
            if not found < _AGREE:
                raise SystemExit(f"{name}, {names}: {way} computes something else, by {found:.1e}")
    in_turn(list(ways.values()), rounds)
    row: dict[str, Any] = {"system": name, "parameters": len(names)}
    for way, one in ways.items():
        row[way] = one.row()
        if one.times:
            shares = np.array(ways["graphs"].times) / np.array(one.times)
            row[way]["graphs / this"] = float(np.median(shares))
    return row


def report(rows: Sequence[dict[str, Any]]) -> str:
    """Print the table; a dash marks cases in which SymPy exceeds one minute."""
    head = ["system", "parameters", "generation s: graphs", "direct", "SymPy"]
    head += ["operations: graphs", "direct", "SymPy", "ns per call: graphs", "direct", "SymPy"]
    head += ["graphs / direct: operations", "time"]
    lines: list[list[object]] = []
    for row in rows:
        ways = [row[way] for way in ("graphs", "direct")]
        ways += [row.get("SymPy", {})]
        line: list[object] = [row["system"], row["parameters"]]
        ended = [way.get("operations") is not None for way in ways]
        line += [f"{w['generation']:.2f}" if ok else "–" for w, ok in zip(ways, ended, strict=True)]
        line += [w["operations"] if ok else "–" for w, ok in zip(ways, ended, strict=True)]
        line += [f"{way['median ns']:,.0f}" if "median ns" in way else "–" for way in ways]
        line.append(f"{ways[0]['operations'] / ways[1]['operations']:.2f}")
        line.append(f"{ways[1]['graphs / this']:.2f}" if "graphs / this" in ways[1] else "–")
        lines.append(line)
    return table(head, lines)


def main() -> None:
    """Measure all systems and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("systems", nargs="*", metavar="SYSTEM", help=", ".join(SYSTEMS))
    parser.add_argument("--rounds", type=int, default=31)
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    if unknown := [name for name in given.systems if name not in SYSTEMS]:
        parser.error(f"no system '{unknown[0]}': take {', '.join(SYSTEMS)}")
    options = BuildOptions(native=True)
    versions = about("cotree's flags for native code; SymPy's code by -O3 -march=native")
    by_graphs(rod_chain(2)[0], ["m0"])  # imports are not counted
    rows = []
    for name in given.systems or SYSTEMS:
        for n_names in SYSTEMS[name].counts:
            print(name, n_names, file=sys.stderr, flush=True)
            rows.append(measure(name, SYSTEMS[name], n_names, given.rounds, options))
            keep(given.json, versions, rows)
    show(versions, report(rows))


if __name__ == "__main__":
    main()
