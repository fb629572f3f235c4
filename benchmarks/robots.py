"""Robots from file to compiled kernel, compared with Pinocchio, CasADi and MuJoCo.

Run it with ``python benchmarks/robots.py [NAME ...] [--seconds S] [--json FILE] [--profile]``; it
prints Markdown. It needs ``pip install cotree[robots]``. Pinocchio in C++ and CasADi's code of its
forward dynamics need ``pip install cmeel-eigen casadi`` and g++ (they are built once, in some
minutes). MuJoCo needs ``pip install mujoco``. Tools that are missing are omitted.

Times of calls are minima of many rounds over 64 random states in a C loop, in separate programs.
Generated code of cotree and CasADi is compiled with the same flags: with gcc -O2, gcc -O3 and clang
-O2 up to 6,000 operations, otherwise with clang -O1 and clang -O2, limited to 100 s each. The
fastest result counts.
"""

from __future__ import annotations

import argparse
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "robots"))

import robots_mujoco
from robot_files import installed_file, without_losses
from timing import about, keep, show, table

import cotree
import cotree.model.columns
from cotree.model.further import whole_files

HERE = Path(__file__).parent
#: File, base.
ROBOTS = {
    "ur5": ("ur_description/urdf/ur5_robot.urdf", "fixed"),
    "panda": ("panda_description/urdf/panda.urdf", "fixed"),
    "kinova": ("kinova_description/robots/kinova.urdf", "fixed"),
    "solo12": ("solo_description/robots/solo12.urdf", "free"),
    "anymal": ("anymal_b_simple_description/robots/anymal.urdf", "free"),
    "talos": ("talos_data/robots/talos_reduced.urdf", "free"),
}
FLAGS = ("-march=native", "-fno-math-errno", "-ffp-contract=fast")
_MANY = 6_000  # operations from which gcc takes minutes
_LIMIT = 100.0  # seconds that a compiler gets
_KERNELS = ("rhs", "jacobian")
#: Pinocchio has more types of joints than Boost's lists hold by themselves.
_DEFINES = (
    "-DNDEBUG",
    "-DBOOST_MPL_LIMIT_LIST_SIZE=30",
    "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
)

LOOP = """
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
static double number(void) { return 2.0 * rand() / RAND_MAX - 1.0; }
static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}
static double states[64][%(n)d], out[%(out)d], work[100000];
int main(int argc, char **argv)
{
    double best = 1e30, spent = 0.0, sink = 0.0;
    const double seconds = argc > 1 ? atof(argv[1]) : 1.0;
    for (int i = 0; i < 64; i++)
        for (int j = 0; j < %(n)d; j++) states[i][j] = number();
    while (spent < seconds) {
        const double began = now();
        for (int r = 0; r < %(rounds)d; r++)
            for (int i = 0; i < 64; i++) {
                const double *x = states[i];
                %(call)s
                __asm__ volatile("" : : "r"(out), "r"(states) : "memory"); /* all of it is wanted */
                sink += out[%(n)d / 2];
            }
        const double took = now() - began;
        if (took / (%(rounds)d * 64) < best) best = took / (%(rounds)d * 64);
        spent += took;
    }
    printf("%%.1f\\n", 1e9 * best);
    (void)work;
    return sink == 1.0;
}
"""


def compilers(n_operations: int) -> list[tuple[str, str]]:
    """Return the compilers and optimisation levels for code of a size."""
    if not shutil.which("clang"):
        return [("gcc", "-O2" if n_operations <= _MANY else "-O1")]
    if n_operations <= _MANY:
        return [("gcc", "-O2"), ("gcc", "-O3"), ("clang", "-O2")]
    return [("clang", "-O1"), ("clang", "-O2")]


def run(command: list[str], limit: float = _LIMIT) -> tuple[str | None, float]:
    """Run a command; return its output, or None after a failure or time-out, and its time."""
    began = time.perf_counter()
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=limit, check=False)
    except subprocess.TimeoutExpired:
        return None, time.perf_counter() - began
    took = time.perf_counter() - began
    if done.returncode:
        print(f"{command[0]}: {done.stderr[:300]}", file=sys.stderr)
        return None, took
    return done.stdout, took


def timed_loop(folder: Path, source: str, call: dict[str, Any], n_operations: int, seconds: float):
    """Compile a C loop around a call; return ns per call, compilation time and bytes.

    The results are those of the compiler with the fastest code.
    """
    file = folder / "loop.c"
    file.write_text(source + LOOP % {"rounds": max(1, 20_000 // (n_operations + 1)), **call})
    found = []
    for name, level in compilers(n_operations):
        common = [level, *FLAGS, "-std=gnu11", f"-I{folder}"]
        built, took = run([name, *common, str(file), "-o", str(folder / "loop"), "-lm"])
        printed = None if built is None else run([str(folder / "loop"), str(seconds)])[0]
        ns = None if printed is None else float(printed)
        how = {"compiler": f"{name} {level}", "compile s": took}
        found.append({"C bytes": len(source), **how, "ns": ns})
    return min(found, key=lambda row: row["ns"] or math.inf)


# ---- cotree


def own(path: Path, base: str, snap: float, seconds: float, profile: bool) -> dict[str, Any]:
    """Measure all stages of a robot, with constant and with tunable parameters."""
    began = time.perf_counter()
    scene = without_losses(cotree.read_urdf(path, base, mimic=False, snap=snap))
    read = time.perf_counter() - began
    model = scene.compile(tunable=[])
    began = time.perf_counter()
    model.rhs(0.0, model.initial_state)
    first_call = time.perf_counter() - began
    found: dict[str, Any] = {"read s": read, **{f"{k} s": v for k, v in model.times.items()}}
    found |= {
        "first call s": first_call,
        "C bytes": len(model.kernels.source),
        "states": len(model.states),
    }
    for name in _KERNELS:
        count = model.operations[name].total
        with tempfile.TemporaryDirectory() as folder:
            measured = timed_loop(
                Path(folder),
                kernel_text(model, name, Path(folder)),
                own_call(model, name),
                count,
                seconds,
            )
        found[name] = {"operations": count, **measured}
    found["points"] = many_points(model)
    if profile:
        found["profile"] = sections(model)
    tunable = without_losses(cotree.read_urdf(path, base, mimic=False, snap=snap)).compile()
    found["tunable"] = {
        "parameters": len(tunable.parameters),
        **{f"{k} s": v for k, v in tunable.times.items()},
        **{name: tunable.operations[name].kernel for name in ("prepare", *_KERNELS)},
    }
    return found


def many_points(model: Any, n: int = 4096, rounds: int = 9) -> dict[str, dict[str, float]]:
    """Measure kernels at many points in one call, on one core; times are medians, in us a point."""
    y = np.random.default_rng(0).uniform(-1.0, 1.0, (len(model.states), n))
    u = np.zeros((len(model.inputs), n))
    code, found, columns = model.kernels.code, {}, cotree.model.columns
    in_lanes, cores, columns.usable_cores = code.in_lanes, columns.usable_cores, lambda: 1
    for name in _KERNELS:
        times: dict[str, list[float]] = {"scalar": [], "lanes": []}
        began = time.perf_counter()
        if in_lanes(name) is None:
            continue
        compilation = time.perf_counter() - began
        for _ in range(rounds + 1):
            for way, own in times.items():
                code.in_lanes = in_lanes if way == "lanes" else lambda _: None
                began = time.thread_time()
                getattr(model, name)(0.0, y, u=u)
                own.append(1e6 * (time.thread_time() - began) / n)
        ratios = np.divide(times["scalar"], times["lanes"])[1:]  # the first calls load the code
        medians = {way: float(np.median(own[1:])) for way, own in times.items()}
        found[name] = {**medians, "ratio": float(np.median(ratios)), "compile s": compilation}
    code.in_lanes, columns.usable_cores = in_lanes, cores
    return found


def kernel_text(model: Any, name: str, folder: Path) -> str:
    """Return the C text of a single kernel and its headers."""
    files = whole_files(model.kernels.text)
    for file, text in files.items():
        if file.endswith(".h"):
            (folder / file).write_text(text)
    prefix, source = model.kernels.text.prefix, model.kernels.source
    starts = [found.start() for found in re.finditer(rf"^int {prefix}_", source, re.MULTILINE)]
    ends = [source.index("\n}\n", start) + 3 for start in starts]
    place = starts.index(source.index(f"int {prefix}_{name}("))
    # The blocks of a long kernel stand between it and the one before.
    head = source[: source.rindex("/*", 0, starts[0])]
    return head + source[ends[place - 1] : ends[place]]


def own_call(model: Any, name: str) -> dict[str, Any]:
    prefix = model.kernels.text.prefix
    n, m = len(model.states), len(model.inputs)
    size = n if name == "rhs" else len(model.kernels.layout.row_indices)
    return {
        "n": n + m,
        "out": size + n + m,
        "call": f"{prefix}_{name}(0.0, x, x + {n}, NULL, NULL, out);",
    }


def sections(model: Any) -> dict[str, dict[str, int]]:
    """Return the operations of each kernel by step of the formulation."""
    from cotree.dag.nodes import reachable

    program = model.spec.formed.reports[0].earlier  # passes make most values anew
    return {
        name: dict(
            Counter(
                re.sub(r" (of|beyond) .*", "", node.section) or "chain rule"
                for node in reachable(program.kernels[name].results)
                if node.args and node.op != "result"
            ).most_common()
        )
        for name in _KERNELS
    }


# ---- peers


class Peers:
    """Pinocchio in C++ and CasADi's code of its algorithm, which are built once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.loop = self._build("robots_pinocchio", ["-O3", "-march=native"], [])
        self.writer = None
        try:
            import casadi
        except ImportError:
            return
        there = Path(casadi.__file__).parent
        library = max(there.glob("libcasadi.so*"), key=lambda file: len(file.name))
        self.writer = self._build(
            "robots_casadi",
            ["-O1", f"-I{there / 'include'}"],
            [f"-L{there}", f"-Wl,-rpath,{there}", f"-l:{library.name}"],
        )

    def _build(self, name: str, flags: list[str], libraries: list[str]) -> Path | None:
        target = self.folder / name
        if target.exists():
            return target
        prefix = next(
            (Path(p) / "cmeel.prefix" for p in sys.path if (Path(p) / "cmeel.prefix").is_dir()),
            None,
        )
        if prefix is None or not shutil.which("g++"):
            return None
        include = [f"-I{prefix}/include", f"-I{prefix}/include/eigen3"]
        ends = [f"-L{prefix}/lib", f"-Wl,-rpath,{prefix}/lib", "-lboost_serialization", *libraries]
        command = ["g++", "-std=c++17", *_DEFINES, "-w", *include]
        # Both parts for the same machine: the alignment of vectors depends on it.
        machine = [flag for flag in flags if flag.startswith("-march")]
        model = str(target) + "_model.o"
        reading = [*command, "-O0", *machine, "-c", str(HERE / "robots_model.cpp"), "-o", model]
        built, took = run(reading, 1800.0)
        if built is not None:
            source = str(HERE / f"{name}.cpp")
            built, more = run([*command, *flags, source, model, "-o", str(target), *ends], 1800.0)
            took += more
        print(f"{name} built in {took:.0f} s", file=sys.stderr)
        return None if built is None else target

    def measure(self, path: Path, base: str, seconds: float) -> dict[str, Any]:
        import pinocchio

        root = (pinocchio.JointModelFreeFlyer(),) if base == "free" else ()
        model = pinocchio.buildModelFromUrdf(str(path), *root)
        found: dict[str, Any] = {"python": through_python(model)}
        with tempfile.TemporaryDirectory() as folder:
            found["mujoco"] = {"rhs": robots_mujoco.forward_time(model, Path(folder), seconds)}
            text = Path(folder) / "model.txt"
            model.saveToText(str(text))
            if self.loop:
                printed, _ = run([str(self.loop), str(text), str(seconds)])
                if printed:
                    found["pinocchio"] = dict(
                        zip(_KERNELS, map(float, printed.split()), strict=True)
                    )
            if self.writer:
                found["casadi"] = self._casadi(Path(folder), text, model, seconds)
        return found

    def _casadi(self, folder: Path, text: Path, model: Any, seconds: float) -> dict[str, Any]:
        began = os.getcwd()
        os.chdir(folder)  # CasADi writes where it runs
        try:
            printed, took = run([str(self.writer), str(text), "."])
        finally:
            os.chdir(began)
        if printed is None:
            return {}
        found: dict[str, Any] = {"generate s": took}
        counts = map(int, printed.split())
        for kernel, file, count in zip(_KERNELS, ("forward", "jacobian"), counts, strict=True):
            n = model.nq + 2 * model.nv
            call = {
                "n": n,
                "out": model.nv * n + n,
                "call": f"const double *in[3] = {{x, x + {model.nq}, x + {model.nq + model.nv}}}; "
                f"double *to[1] = {{out}}; {file}(in, to, NULL, work, 0);",
            }
            source = (folder / f"{file}.c").read_text()
            found[kernel] = {
                "operations": count,
                **timed_loop(folder, source, call, count, seconds),
            }
        return found


def through_python(model: Any, calls: int = 2000) -> float:
    """Return the time of a call of Pinocchio from Python, including the overhead, [ns]."""
    import pinocchio

    data = model.createData()
    q, v = pinocchio.neutral(model), np.ones(model.nv)
    best = np.inf
    for _ in range(5):
        began = time.perf_counter()
        for _ in range(calls):
            pinocchio.aba(model, data, q, v, v)
        best = min(best, (time.perf_counter() - began) / calls)
    return 1e9 * best


# ---- tables


def _ns(entry: dict[str, Any] | None) -> str:
    value = (entry or {}).get("ns")
    return "–" if value is None else f"{value:,.0f}"


def report(found: dict[str, dict[str, Any]]) -> str:
    stages = table(
        [
            "robot",
            "states",
            "read",
            "formulate",
            "generate",
            "compile",
            "first call",
            "C, kB",
            "parameters",
            "the same, all tunable: formulate",
            "generate",
            "compile",
            "prepare / rhs / Jacobian, operations",
        ],
        [
            [
                name,
                row["states"],
                *(
                    f"{row[k]:.3f}"
                    for k in ("read s", "formulate s", "generate s", "compile s", "first call s")
                ),
                f"{row['C bytes'] / 1e3:.0f}",
                row["tunable"]["parameters"],
                *(f"{row['tunable'][k]:.3f}" for k in ("formulate s", "generate s", "compile s")),
                " / ".join(str(row["tunable"][k]) for k in ("prepare", *_KERNELS)),
            ]
            for name, row in found.items()
        ],
    )
    calls = []
    for name, row in found.items():
        peers = row.get("peers", {})
        for kernel in _KERNELS:
            mine, other = row[kernel], peers.get("casadi", {}).get(kernel)
            plain = peers.get("pinocchio", {}).get(kernel)
            third = peers.get("mujoco", {}).get(kernel)
            ratio = "–"
            if mine["ns"] and other and other["ns"]:
                ratio = f"{mine['ns'] / other['ns']:.2f}"
            calls.append(
                [
                    name,
                    kernel,
                    mine["operations"],
                    other["operations"] if other else "–",
                    _ns(mine),
                    _ns(other),
                    "–" if plain is None else f"{plain:,.0f}",
                    "–" if third is None else f"{third:,.0f}",
                    ratio,
                    f"{mine['C bytes'] / 1e3:.0f}",
                    f"{mine['compile s']:.1f} ({mine['compiler']})",
                    f"{other['compile s']:.1f} ({other['compiler']})" if other else "–",
                ]
            )
    head = [
        "robot",
        "kernel",
        "operations",
        "CasADi",
        "ns per call",
        "CasADi",
        "Pinocchio, C++",
        "MuJoCo",
        "cotree / CasADi",
        "C, kB",
        "compilation s",
        "CasADi",
    ]
    points = [
        [name, kernel, *(f"{own[key]:.3f}" for key in ("scalar", "lanes", "ratio", "compile s"))]
        for name, row in found.items()
        for kernel, own in row["points"].items()
    ]
    heading = ["robot", "kernel", "4,096 points, one core: scalar, us a point", "lanes"]
    heading += ["scalar / lanes", "compilation s"]
    parts = [stages, table(head, calls), table(heading, points)]
    for name, row in found.items():
        for kernel, counts in row.get("profile", {}).items():
            parts.append(f"{name}, {kernel}: " + ", ".join(f"{k} {n}" for k, n in counts.items()))
    return "\n\n".join(parts)


def versions() -> dict[str, str]:
    found = about(" ".join(FLAGS))
    for name in ("gcc", "clang"):
        printed = run([name, "--version"])[0] if shutil.which(name) else None
        found[name] = printed.splitlines()[0] if printed else "none"
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(ROBOTS))
    parser.add_argument("--seconds", type=float, default=1.0, help="time of each loop, in s")
    parser.add_argument("--snap", type=float, default=0.0, help="argument snap of read_urdf")
    parser.add_argument("--json", type=Path, help="write all numbers to this file")
    parser.add_argument(
        "--profile", action="store_true", help="print the operations by step of the formulation"
    )
    parser.add_argument(
        "--peers", type=Path, help="folder in which the programs of other tools are built"
    )
    given = parser.parse_args()
    warnings.simplefilter("ignore", RuntimeWarning)  # inertias that no body has
    with tempfile.TemporaryDirectory() as folder:
        os.environ["COTREE_CACHE_DIR"] = folder  # nothing was compiled before
        peers = Peers(given.peers or Path(folder))
        found = {}
        for name in given.names or ROBOTS:
            path, base = installed_file(ROBOTS[name][0]), ROBOTS[name][1]
            print(name, file=sys.stderr)
            found[name] = own(path, base, given.snap, given.seconds, given.profile)
            found[name]["peers"] = peers.measure(path, base, given.seconds)
    measured_with = versions()
    show(measured_with, report(found))
    keep(given.json, measured_with, [{"robot": name, **row} for name, row in found.items()])


if __name__ == "__main__":
    main()
