"""Growth with size: operations, code and times for chains of rods and RC ladders.

Run it with ``python benchmarks/growth.py [chain] [jacobian] [ladder] [--json FILE] [N ...]``; it
prints Markdown, by default all tables. ``chain`` measures only the rates of a planar chain. The
number of entries of its Jacobian grows with the square of the number of rods, so ``jacobian``
measures shorter chains. Sizes N apply to all named tables.

Times are processor times, which other load does not affect. The exponent of each column is that of
N in a least-squares fit of the logarithms over the larger half of the sizes.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cffi
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "example_scenes"))
from network_scenes import rc_ladder
from rod_chain import rod_chain
from timing import about, keep, surroundings, table

from cotree.build import BuildOptions, compiler_flags, find_toolchain
from cotree.choice import choose_first_graph
from cotree.codegen.c_files import render_model
from cotree.codegen.context import model_context
from cotree.pipeline import trees_to_try
from cotree.program.lower import lower
from cotree.program.passes import run_passes
from cotree.sensitivity.graphs import form_equations

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import cotree
    from cotree import Scene

#: Table, scene, sizes, kernel that is called, whether the Jacobian is formed.
TABLES: dict[str, tuple[Callable[[int], Scene], tuple[int, ...], str, bool]] = {
    "chain": (lambda n: rod_chain(n)[0], (10, 20, 50, 100, 200, 500, 1000), "rhs", False),
    "jacobian": (lambda n: rod_chain(n)[0], (10, 20, 30, 50), "jacobian", True),
    "ladder": (rc_ladder, (10, 100, 1000, 10_000, 100_000), "rhs", True),
}

#: Calls a kernel in a loop and gives the time of one, [ns]; every call sees another state.
HARNESS = """
#include <time.h>
#include "cotree_abi.h"
const cotree_model *PREFIX_abi(void);
double time_of_call(int n_calls, double *x, const double *u, const double *p, double *k, double *r)
{
    const cotree_model *m = PREFIX_abi();
    struct timespec a, b;
    int i;
    m->prepare(p, k);
    m->KERNEL(0.0, x, u, p, k, r);
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &a);
    for (i = 0; i < n_calls; ++i) {
        x[0] += 1e-9;
        m->KERNEL(0.0, x, u, p, k, r);
    }
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &b);
    return ((double)(b.tv_sec - a.tv_sec) * 1e9 + (double)(b.tv_nsec - a.tv_nsec)) / n_calls;
}
"""
_MOST_SECONDS = 0.2  # of calls that are timed at once
_REPEATS = 7


@dataclass(frozen=True)
class Row:
    """Costs of one size: processor times in seconds, time of a call in nanoseconds."""

    n: int
    operations: int
    lines: int
    c_bytes: int
    longest: int
    generation: float
    compilation: float
    call: float


def processor_seconds() -> float:
    """Return the processor time of this process and of its finished children."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(row.ru_utime + row.ru_stime for row in used)


def measure(name: str, n: int) -> Row:
    """Generate, compile and call the C code of one scene."""
    make, _, kernel, with_columns = TABLES[name]
    start = processor_seconds()
    scene = make(n)
    first, _ = choose_first_graph(scene, trees_to_try(scene, None), ())
    equations = form_equations(first, (), with_columns=with_columns)
    program, _ = run_passes(lower(equations))
    context = model_context(program)
    files = dict(render_model(context))
    generation = processor_seconds() - start
    found = next(k for k in context.kernels if f"_{kernel}(" in k.signature)
    sizes = context.n_written, context.n_written_in_all
    with tempfile.TemporaryDirectory() as folder:
        text = HARNESS.replace("PREFIX", context.prefix).replace("KERNEL", kernel)
        for file, content in {**files, "harness.c": text}.items():
            (Path(folder) / file).write_text(content)
        toolchain = find_toolchain()
        if toolchain is None:
            raise SystemExit("no C compiler was found: install one")
        # The harness takes the clock from POSIX, which strict C99 hides.
        flags = ["-D_POSIX_C_SOURCE=199309L", *compiler_flags(toolchain, BuildOptions(), *sizes)]
        command = [*toolchain.command, *flags, f"{context.prefix}.c", "harness.c"]
        start = processor_seconds()
        subprocess.run([*command, "-o", "model.so", "-lm"], cwd=folder, check=True)
        compilation = processor_seconds() - start
        call = time_of_call(str(Path(folder) / "model.so"), program, kernel)
    return Row(
        n,
        found.n_operations,
        sum(len(k.body.text) for k in context.kernels),
        len(files[f"{context.prefix}.c"]),
        context.n_written,
        generation,
        compilation,
        call,
    )


def time_of_call(path: str, program: cotree.program.Program, kernel: str) -> float:
    """Return the median time of a call, [ns]."""
    ffi = cffi.FFI()
    ffi.cdef("double time_of_call(int, double *, double *, double *, double *, double *);")
    library, layout = ffi.dlopen(path), program.layout
    rng = np.random.default_rng(0)
    sizes = (len(layout.states), len(layout.inputs) + 1)
    arrays = [rng.uniform(-1.0, 1.0, size) for size in sizes]
    arrays.append(np.array([*layout.parameter_values, 0.0]))
    arrays += [np.zeros(size + 1) for size in (program.n_prepared, _n_results(program, kernel))]
    pointers = [ffi.cast("double *", array.ctypes.data) for array in arrays]
    once = library.time_of_call(2, *pointers)
    n_calls = int(np.clip(_MOST_SECONDS * 1e9 / max(once, 1.0), 1, 1_000_000))
    return float(np.median([library.time_of_call(n_calls, *pointers) for _ in range(_REPEATS)]))


def _n_results(program: cotree.program.Program, kernel: str) -> int:
    return len(program.kernels[kernel].results)


def exponents(rows: Sequence[Row]) -> dict[str, float]:
    """Return the exponent of N of each column, fitted over the larger half of the sizes."""
    later = rows[-max(2, (len(rows) + 1) // 2) :]
    n = np.log([row.n for row in later])
    names = [name for name in asdict(rows[0]) if name != "n"]
    return {
        name: float(np.polyfit(n, np.log([max(1e-9, asdict(row)[name]) for row in later]), 1)[0])
        for name in names
    }


HEAD = (
    "N",
    "operations",
    "lines of C",
    "bytes of C",
    "longest function, operations",
    "generation s",
    "compilation s",
    "time per call us",
)


def markdown(rows: Sequence[Row], fitted: dict[str, float]) -> str:
    """Return a table with a row of exponents."""
    lines = []
    for row in rows:
        counts = (row.n, row.operations, row.lines, row.c_bytes, row.longest)
        times = (f"{row.generation:.2f}", f"{row.compilation:.2f}", f"{row.call / 1e3:.3f}")
        lines.append([*map(str, counts), *times])
    if fitted:
        lines.append(["exponent", *(f"{value:.2f}" for value in fitted.values())])
    return table(HEAD, lines)


def main() -> None:
    """Measure and print all tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("what", nargs="*", help="names of tables, and sizes")
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    given = parser.parse_args()
    sizes = [int(word) for word in given.what if word.isdigit()]
    names = [word for word in given.what if not word.isdigit()] or list(TABLES)
    if unknown := [name for name in names if name not in TABLES]:
        parser.error(f"no table '{unknown[0]}': take {', '.join(TABLES)}")
    print(surroundings())
    measure("chain", 3)  # imports are not counted
    tables = {}
    for name in names:
        rows = [measure(name, n) for n in sizes or TABLES[name][1]]
        fitted = exponents(rows) if len(rows) > 1 else {}
        print(f"{name}\n\n{markdown(rows, fitted)}\n", flush=True)
        tables[name] = {"rows": [asdict(row) for row in rows], "exponents": fitted}
    keep(given.json, about("as the library compiles it"), tables)


if __name__ == "__main__":
    main()
