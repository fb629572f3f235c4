"""Gradients of published estimation problems: cotree compared with AMICI.

``python benchmarks/estimation.py [PROBLEM ...] [--folder DIR] [--amici PYTHON] [--rounds N]``

Problems are folders of the PEtab benchmark collection in DIR. Each tool reads a problem in its own
process with an empty cache. The elapsed times of imports, reading, compilation and the first
gradient are measured, and their sum. The gradient is with respect to the estimated parameters at
the nominal values. Later gradients are computed alternately, with tolerances of 1e-8; AMICI uses
forward sensitivities. Medians of elapsed and processor times are printed. AMICI runs in the Python
interpreter PYTHON, which may belong to another environment; without it, only cotree is measured.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
FOLDER = HERE.parents[1] / "shared" / "petab" / "benchmark"
PROBLEMS = ["Boehm_JProteomeRes2014", "Crauste_CellSystems2017"]
RTOL, ATOL = 1e-8, 1e-10


class OfCotree:
    """A problem in cotree."""

    def __init__(self, file: Path) -> None:
        import cotree

        self.imported = time.perf_counter()
        self.problem = cotree.read_petab(file, rtol=RTOL, atol=ATOL)
        self.n_states = len(self.problem.model.states)

    def gradient(self) -> tuple[float, list[float]]:
        """Return the log-likelihood and its gradient, which one run has both."""
        value, slopes = self.problem.objective(self.problem.theta())
        slopes = slopes + self.problem.priors.gradient(self.problem.theta())
        return -value - self.problem.log_prior(), (-slopes).tolist()

    def inside(self) -> float:
        """Return the time that the solver of the tool counted in the last gradient, [s]."""
        return float("nan")


class OfAmici:
    """A problem in AMICI, with its mapping and data prepared once."""

    def __init__(self, file: Path) -> None:
        import amici.sim.sundials as sundials
        import petab.v1 as petab
        from amici.importers.petab.v1 import import_petab_problem
        from amici.sim.sundials.petab import v1
        from amici.sim.sundials.petab.v1._parameter_mapping import create_parameter_mapping

        self.imported = time.perf_counter()
        self.v1, name = v1, file.stem
        folder = file.parent
        (measured,) = folder.glob("measurementData*.tsv")
        self.problem = petab.Problem.from_files(
            sbml_file=folder / f"model_{name}.xml",
            condition_file=folder / f"experimentalCondition_{name}.tsv",
            measurement_file=measured,
            parameter_file=folder / f"parameters_{name}.tsv",
            observable_files=folder / f"observables_{name}.tsv",
        )
        where = tempfile.mkdtemp()
        self.model = import_petab_problem(self.problem, where, model_name=name, verbose=False)
        self.n_states = self.model.nx_solver
        self.solver = self.model.create_solver()
        self.solver.set_relative_tolerance(RTOL)
        self.solver.set_absolute_tolerance(ATOL)
        self.solver.set_sensitivity_order(sundials.SensitivityOrder.first)
        self.solver.set_sensitivity_method(sundials.SensitivityMethod.forward)
        conditions = petab.get_simulation_conditions(self.problem.measurement_df)
        self.mapping = create_parameter_mapping(
            petab_problem=self.problem,
            simulation_conditions=conditions,
            scaled_parameters=True,
            amici_model=self.model,
        )
        self.data = v1.create_edatas(
            amici_model=self.model,
            petab_problem=self.problem,
            simulation_conditions=conditions,
        )
        names, values = self.problem.x_free_ids, self.problem.x_nominal_free_scaled
        self.names, self.theta = names, dict(zip(names, values, strict=True))

    def gradient(self) -> tuple[float, list[float]]:
        """Return the log-likelihood and its gradient."""
        self.found = self.v1.simulate_petab(
            petab_problem=self.problem,
            amici_model=self.model,
            solver=self.solver,
            problem_parameters=self.theta,
            edatas=self.data,
            parameter_mapping=self.mapping,
            scaled_parameters=True,
            scaled_gradients=True,
        )
        return float(self.found["llh"]), [float(self.found["sllh"][name]) for name in self.names]

    def inside(self) -> float:
        """Return the time that the solver of the tool counted in the last gradient, [s]."""
        return sum(run.cpu_time_total for run in self.found["rdatas"]) / 1e3


TOOLS: dict[str, Any] = {"cotree": OfCotree, "AMICI": OfAmici}


def work(tool: str, file: Path) -> None:
    """Read a problem, compute its first gradient, and another one for each line of input."""
    # Only the lines of answers may reach the other process.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    began = time.perf_counter()
    made = TOOLS[tool](file)
    ready = time.perf_counter()
    value, slopes = made.gradient()
    ended = time.perf_counter()
    first = {
        "import": made.imported - began,
        "read and compile": ready - made.imported,
        "first gradient": ended - ready,
        "total": ended - began,
        "states": made.n_states,
        "value": value,
        "slopes": slopes,
    }
    print(json.dumps(first), file=answers, flush=True)
    for _ in sys.stdin:
        began, cpu = time.perf_counter(), time.process_time()
        made.gradient()
        later = (time.perf_counter() - began, time.process_time() - cpu, made.inside())
        print(json.dumps(later), file=answers, flush=True)


class Worker:
    """A tool in its own process, with an empty cache."""

    def __init__(self, tool: str, python: str, file: Path, cache: str) -> None:
        # AMICI runs the programs that pip has put beside its Python.
        path = os.pathsep.join([str(Path(python).parent), os.environ["PATH"]])
        given = {**os.environ, "PATH": path, "XDG_CACHE_HOME": cache}
        given["OPENBLAS_NUM_THREADS"] = "1"
        command = [python, str(Path(__file__).resolve()), "--work", tool, str(file.resolve())]
        self.process = subprocess.Popen(
            command,
            env=given,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            cwd=cache,
        )
        self.first = self.answer()

    def answer(self) -> Any:
        """Return the next line of its output."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise SystemExit(f"{self.process.args} ended without an answer")
        return json.loads(line)

    def once(self) -> tuple[float, float, float]:
        """Compute one more gradient."""
        assert self.process.stdin is not None
        print(file=self.process.stdin, flush=True)
        return tuple(self.answer())


def compare(name: str, folder: Path, pythons: dict[str, str], rounds: int) -> list[list[str]]:
    """Measure one problem with all tools."""
    file = folder / name / f"{name}.yaml"
    with tempfile.TemporaryDirectory() as cache:
        workers = {tool: Worker(tool, python, file, cache) for tool, python in pythons.items()}
        later: dict[str, list[tuple[float, float, float]]] = {tool: [] for tool in workers}
        for _ in range(rounds):
            for tool, worker in workers.items():
                later[tool].append(worker.once())
        for worker in workers.values():
            assert worker.process.stdin is not None
            worker.process.stdin.close()
            worker.process.wait()
    rows = []
    for tool, worker in workers.items():
        first = worker.first
        wall, cpu, inside = (statistics.median(part) for part in zip(*later[tool], strict=True))
        row = [name.split("_")[0], tool, str(first["states"]), str(len(first["slopes"]))]
        stages = ("import", "read and compile", "first gradient", "total")
        row += [f"{first[stage]:.2f}" for stage in stages]
        row += [f"{1e3 * wall:.2f}", f"{1e3 * cpu:.2f}"]
        row += ["–" if inside != inside else f"{1e3 * inside:.2f}", f"{first['value']:.6f}"]
        rows.append(row)
    return rows


def has_module(python: str, module: str) -> bool:
    """Return whether a Python interpreter can import a module."""
    run = subprocess.run([python, "-c", f"import {module}"], capture_output=True)
    return run.returncode == 0


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("problems", nargs="*", default=PROBLEMS, metavar="PROBLEM")
    parser.add_argument("--folder", type=Path, default=FOLDER)
    parser.add_argument("--amici", default=sys.executable, metavar="PYTHON")
    parser.add_argument("--rounds", type=int, default=31)
    parser.add_argument("--work", nargs=2, metavar=("TOOL", "FILE"), help=argparse.SUPPRESS)
    parser.add_argument("--json", type=Path, help="also write the table to this file")
    given = parser.parse_args()
    if given.work:
        work(given.work[0], Path(given.work[1]))
        return
    from timing import about, keep, surroundings, table

    if not given.folder.is_dir():
        raise SystemExit(f"no problems of the PEtab benchmark collection in {given.folder}")
    print(surroundings())
    pythons = {"cotree": sys.executable}
    if has_module(given.amici, "amici"):
        pythons["AMICI"] = given.amici
    else:
        print(f"AMICI is not installed in {given.amici}: only cotree is measured\n")
    head = ["problem", "by", "states", "parameters", "import [s]", "read and compile [s]"]
    head += ["first gradient [s]", "in all [s]", "gradient [ms]", "processor [ms]"]
    head += ["in its solver [ms]", "log-likelihood"]
    rows = [
        row for name in given.problems for row in compare(name, given.folder, pythons, given.rounds)
    ]
    print(table(head, rows))
    keep(given.json, about("as a run chooses them"), {"gradients": [head, *rows]})


if __name__ == "__main__":
    main()
