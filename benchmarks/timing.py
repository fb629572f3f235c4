"""C loops that call kernels of cotree and of other tools in the same way.

The first state grows by 1e-9 at each call, so that every call has different arguments. Times are
processor times of the thread, which other load does not affect. Kernels that are compared are
called alternately in rounds, so that disturbances affect all of them.
"""

from __future__ import annotations

import importlib.metadata
import json
import multiprocessing
import platform
import resource
import subprocess
import tempfile
import time
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cffi
import numpy as np

import cotree
import cotree.build.cache
from cotree.build import find_toolchain
from cotree.build.compile import processor_name
from cotree.model.further import whole_files

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

# What forms and prints programs is measured here: none is taken from the cache.
cotree.build.cache.KEEPS = False

DECLARATIONS = """
double time_state(void *, long, double *, double *, double *, double *, double *);
double time_sensitivity(void *, long, double *, double *, double *, double *, double *, double *);
double time_casadi(void *, long, double *, const double **, double **, long long *, double *);
double time_heyoka(void *, long, double *, double *, double *);
double time_plain(void *, long, double *, double *);
"""
_LOOP = """
double time_{name}(void *function, long n, double *x{more})
{{
    const {name}_call f = ({name}_call)function;
    const double began = now();
    for (long i = 0; i < n; ++i) {{
        x[0] += 1e-9;
        f({given});
    }}
    return (now() - began) / (double)n * 1e9;
}}
"""
#: Type of the function, further arguments of the loop, and what a call is given.
_KINDS = {
    "state": (
        "int (*{})(double, double *, double *, double *, double *, double *)",
        ", double *u, double *p, double *k, double *out",
        "0.0, x, u, p, k, out",
    ),
    "sensitivity": (
        "int (*{})(double, double *, double *, double *, double *, double *, double *)",
        ", double *s, double *u, double *p, double *k, double *out",
        "0.0, x, s, u, p, k, out",
    ),
    "casadi": (
        "int (*{})(const double **, double **, long long *, double *, int)",
        ", const double **arguments, double **results, long long *iw, double *w",
        "arguments, results, iw, w, 0",
    ),
    "heyoka": (
        "void (*{})(double *, double *, double *, double *)",
        ", double *p, double *out",
        "out, x, p, out",  # nothing reads the time
    ),
    "plain": ("void (*{})(double *, double *)", ", double *out", "x, out"),
}
_HEAD = """
#define _POSIX_C_SOURCE 200809L
#include <time.h>
static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}
"""


@dataclass
class Contender:
    """A tool that computes a kernel.

    Attributes
    ----------
    operations, c_bytes : int or None
        Size of its code; None if it cannot be counted.
    generation, compilation : float
        Processor times to generate and to compile the C code.
    note : str
        Compiler command, or the reason why there is no kernel.
    call : callable or None
        Function that calls the kernel n times and returns the time of one call, [ns].
    value : callable or None
        Function that returns the last results.
    """

    operations: int | None
    c_bytes: int | None
    generation: float
    compilation: float
    note: str
    call: Callable[[int], float] | None = None
    value: Callable[[], Any] | None = None
    times: list[float] = field(default_factory=list)

    def row(self) -> dict[str, Any]:
        """Return its numbers for JSON."""
        kept = {k: v for k, v in vars(self).items() if k not in ("call", "value", "times")}
        if self.times:
            kept |= {"median ns": float(np.median(self.times)), "least ns": min(self.times)}
        return kept


@cache
def harness() -> tuple[Any, Any]:
    """Compile and load the loops."""
    text = _HEAD
    for name, (kind, more, given) in _KINDS.items():
        text += f"typedef {kind.format(name + '_call')};" + _LOOP.format(
            name=name, more=more, given=given
        )
    folder = Path(tempfile.mkdtemp(prefix="loops"))
    (folder / "loops.c").write_text(text)
    command = [compiler(), "-O2", "-shared", "-fPIC", "loops.c", "-o", "loops.so"]
    subprocess.run(command, cwd=folder, check=True)
    ffi = cffi.FFI()
    ffi.cdef(DECLARATIONS)
    return ffi, ffi.dlopen(str(folder / "loops.so"))


def compiler() -> str:
    """Return the name of the C compiler; exit if there is none."""
    toolchain = find_toolchain()
    if toolchain is None:
        raise SystemExit("no C compiler was found: install one")
    return toolchain.command[0]


def pointer(array: Any) -> Any:
    """Return the address of an array's data."""
    return harness()[0].cast("double *", array.ctypes.data)


def loop(kind: str, address: int, first: Any, others: Sequence[Any]) -> Callable[[int], float]:
    """Return a loop that calls a function; ``first`` is reset at each start.

    Parameters
    ----------
    kind : str
        How it is called: ``state``, ``sensitivity``, ``casadi``, ``heyoka`` or ``plain``.
    address : int
        Address of the function.
    first : ndarray
        The array whose first number grows with the calls.
    others : sequence of ndarray or pointer
        Further arguments.
    """
    ffi, library = harness()
    function, start = ffi.cast("void *", address), first.copy()
    given = [pointer(a) if isinstance(a, np.ndarray) else a for a in (first, *others)]
    timed = getattr(library, f"time_{kind}")

    def call(n: int) -> float:
        first[:] = start
        return float(timed(function, n, *given))

    call.keeps = (first, *others)  # type: ignore[attr-defined]
    return call


def own(model: Any, kernel: str, x: Any, s: Any) -> Contender:
    """Return a kernel of a compiled model as a contender."""
    p, code = model.default_parameters, model.kernels.code
    ffi = code.library.ffi
    struct = ffi.cast("const cotree_model *", code.address_for(is_implicit=True))
    address = int(ffi.cast("uintptr_t", getattr(struct, kernel)))
    out = np.zeros(len(model.kernels.program.kernels[kernel].results) + 1)
    kind = "sensitivity" if "s" in model.kernels.program.kernels[kernel].spec.arguments else "state"
    before = [s.copy()] if kind == "sensitivity" else []
    rest = [np.zeros(struct.n_inputs + 1), p, model.kernels.prepared(p), out]
    files = whole_files(model.kernels.text)
    return Contender(
        model.operations[kernel].kernel,
        sum(len(text) for name, text in files.items() if name != "cotree_abi.h"),
        model.times["formulate"] + model.times["generate"],
        model.times["compile"],
        "",
        loop(kind, address, x.copy(), [*before, *rest]),
        lambda: out[:-1],
    )


def in_turn(contenders: Sequence[Contender], rounds: int, seconds: float = 0.01) -> None:
    """Time contenders alternately, each for some seconds per round."""
    able = [one for one in contenders if one.call is not None]
    counts = []
    for one in able:
        one.call(3)  # the first calls load the code
        counts.append(int(np.clip(seconds * 1e9 / max(one.call(10), 1.0), 1, 10_000_000)))
    for _ in range(rounds):
        for one, n in zip(able, counts, strict=True):
            one.times.append(one.call(n))


def difference(one: Contender, other: Contender) -> float:
    """Return the largest relative difference of two results at the same state."""
    found = []
    for contender in (one, other):
        contender.call(1)
        found.append(np.array(contender.value()))
    scale = max(1.0, float(np.max(np.abs(found[0]))))
    return float(np.max(np.abs(found[0] - found[1]))) / scale


def compile_c(
    text: str, levels: Sequence[Sequence[str]], limit: float
) -> tuple[Path | None, float, str]:
    """Compile C text with the first of several commands that ends in time.

    Returns
    -------
    library : Path or None
        None if no command ends in time.
    seconds : float
        Processor time.
    note : str
        The command, or the reason of the failure.
    """
    folder, note = Path(tempfile.mkdtemp(prefix="peer")), ""
    (folder / "peer.c").write_text(text)
    for level in levels:
        command = [*level, "-shared", "-fPIC", "peer.c", "-o", "peer.so", "-lm"]
        began = spent_by_children()
        try:
            subprocess.run(command, cwd=folder, check=True, capture_output=True, timeout=limit)
        except subprocess.TimeoutExpired:
            note += f"{' '.join(level[:2])} stopped after {limit:.0f} s; "
            continue
        except (OSError, subprocess.CalledProcessError) as reason:
            note += f"{' '.join(level[:2])} failed: {str(reason)[:80]}; "
            continue
        return folder / "peer.so", spent_by_children() - began, note + " ".join(level[:2])
    return None, 0.0, note.removesuffix("; ")


def within(limit: float, work: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    """Run a function in its own process, which is terminated after some seconds."""
    process = multiprocessing.get_context("fork").Process(target=work, args=arguments)
    process.start()
    process.join(limit)
    if process.is_alive():
        process.kill()
        process.join()


def spent_by_children() -> float:
    """Return the processor time of the finished child processes."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def about(flags: str) -> dict[str, str]:
    """Return the machine, the versions and the flags."""
    found = {
        "machine": platform.machine(),
        "processor": processor_name(),
        "cotree": cotree.__version__,
    }
    found |= {"python": platform.python_version(), "measured": time.strftime("%Y-%m-%d")}
    for name in ("casadi", "heyoka", "sympy", "pydy", "pin", "mujoco", "example-robot-data"):
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "none"
    toolchain = find_toolchain()
    found["compiler"] = "none" if toolchain is None else toolchain.version
    return {**found, "flags": flags}


def keep(path: Path | None, versions: dict[str, str], rows: Any) -> None:
    """Write numbers, machine and versions to a file, if one is named."""
    if path is not None:
        path.write_text(json.dumps({"about": versions, "rows": rows}, indent=1) + "\n")


def show(versions: dict[str, str], report: str) -> None:
    """Print the machine and versions, and the table."""
    print("\n".join(f"{key}: {value}" for key, value in versions.items()), end="\n\n")
    print(report)


def line(cells: Iterable[object]) -> str:
    """Return a row of a Markdown table."""
    return f"| {' | '.join(map(str, cells))} |"


def heading(names: Sequence[str]) -> str:
    """Return the first two lines of a Markdown table."""
    return f"{line(names)}\n{line(['---'] * len(names))}"


def table(head: Sequence[str], rows: Iterable[Iterable[object]]) -> str:
    """Return a Markdown table."""
    return "\n".join([heading(head), *map(line, rows)])


def surroundings() -> str:
    """Return versions and machine in one line, for printing above tables."""
    python = platform.python_version()
    return f"cotree {cotree.__version__}, Python {python}, {platform.machine()}\n"


def put_on_page(page: Path, script: str, text: str) -> None:
    """Insert the results of a script between its marks on a page of the documentation."""
    begin, end = (f"<!-- {script}: {side} -->\n" for side in ("begin", "end"))
    before, rest = page.read_text(encoding="utf-8").split(begin)
    after = rest.split(end)[1]
    page.write_text(f"{before}{begin}{text}\n{end}{after}", encoding="utf-8")
