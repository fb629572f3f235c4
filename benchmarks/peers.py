"""cotree's methods compared with other tools on the same systems.

Run it with ``python benchmarks/peers.py [ROW ...] [--json FILE] [--repeats N]``. It needs ``pip
install heyoka casadi`` and omits tools that are missing. For each error, the table lists the
minimum time over all tolerances that reach it. The error is max |y - ref| / max(1, max |ref|) of
states and sensitivities at 101 points. Times are minima of many alternating runs and cover only the
integration, not compilation or preparation. Compare them only within a row.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
import time
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "example_scenes"))
import hard_cases
from circuits import circuit
from domain_scenes import scene_of_domain
from peer_equations import Equations, slopes
from reference_scenes import read_reference
from rod_chain import rod_chain
from timing import heading, line

import cotree
from cotree.build import find_toolchain

if TYPE_CHECKING:
    from collections.abc import Callable

POINTS = 101
CALL = "call of dop853"  # including the time in Python
TOLERANCES = [10.0 ** (-k / 2) for k in range(6, 27)]


@dataclass(frozen=True)
class Row:
    """A system, the parameters of its sensitivities, and the tools to measure."""

    name: str
    make: Callable[[], Any]
    wanted: Callable[[Any], list[str]]
    end: float
    targets: tuple[float, ...]
    methods: tuple[str, ...]
    peers: tuple[str, ...]
    reach: str  # what is aimed at
    is_stiff: bool = False
    initial: dict[str, float] = field(default_factory=dict)


def _reference(name: str) -> float:
    return float(read_reference(name)["t_end"])


def _chain() -> Any:
    return rod_chain(5)[0]


EXPLICIT = ("dop853", "dopri5", "cvode", "DOP853")
STIFF = ("rodas4", "rodas5", "cvode", "ida", "dop853")
ROWS = [
    Row("slider-pendulum, L", lambda: cotree.load("slider-pendulum"), lambda s: ["L"], 10.0,
        (1e-6, 1e-10), EXPLICIT, ("heyoka", "casadi"), "0.7 x heyoka"),
    Row("slider-pendulum, all 8", lambda: cotree.load("slider-pendulum"),
        lambda s: list(s.compile().parameters), 10.0, (1e-6, 1e-10), EXPLICIT,
        ("heyoka", "casadi"), "0.6 x heyoka"),
    Row("chain of 5 rods, 10", _chain, lambda s: rod_chain(5)[1], 5.0, (1e-6, 1e-10), EXPLICIT,
        ("heyoka", "casadi"), "0.5 x DOP853 from C", initial={"h0.theta": -1.2}),
    Row("chem_hires, 3", lambda: scene_of_domain("chem_hires"),
        lambda s: list(s.compile().parameters)[:3], _reference("chem_hires"), (1e-4, 1e-6, 1e-8),
        STIFF, ("casadi",), "0.6 x CVODE from C", True),
    Row("transistor amplifier", lambda: circuit("ivp_transistor_amplifier"), lambda s: [],
        _reference("ivp_transistor_amplifier"), (1e-6,), STIFF, ("heyoka", "casadi"),
        "0.7 x heyoka"),
    Row("transistor amplifier, 3", lambda: circuit("ivp_transistor_amplifier"),
        lambda s: ["R1", "C1", "beta"], _reference("ivp_transistor_amplifier"), (1e-6,), STIFF,
        ("heyoka", "casadi"), "0.7 x heyoka"),
    Row("rectifier", lambda: circuit("spice_rectifier"), lambda s: [],
        _reference("spice_rectifier"), (1e-4, 1e-6, 1e-8), STIFF, ("casadi",), "0.4 x IDA from C",
        True),
    Row("Andrews", lambda: hard_cases.CASES["ivp_andrews"].make(), lambda s: [],
        _reference("ivp_andrews"), (1e-6,), EXPLICIT, ("heyoka", "casadi"), "0.5 x heyoka"),
    Row("Andrews, 4", lambda: hard_cases.CASES["ivp_andrews"].make(),
        lambda s: ["m1", "m2", "c0", "mom"], _reference("ivp_andrews"), (1e-6,), EXPLICIT,
        ("casadi",), "0.5 x CVODE from C"),
]  # fmt: skip


class Own:
    """A method of cotree, or of SUNDIALS called by cotree; its time in C or of the whole call."""

    def __init__(
        self, model: Any, initial: dict[str, float], method: str, *, is_whole: bool = False
    ) -> None:
        self.model, self.initial, self.method, self.is_whole = model, initial, method, is_whole

    def run(self, times: Any, tolerance: float) -> tuple[float, Any, Any]:
        def call() -> cotree.Result:
            return self.model.simulate(
                (float(times[0]), float(times[-1])), times, self.method, tolerance,
                tolerance * 1e-2, initial=self.initial, time_limit=5.0,
            )  # fmt: skip

        if self.is_whole:
            call()  # prepares runs with this tolerance
        begin = time.perf_counter()
        found = call()
        seconds = time.perf_counter() - begin if self.is_whole else found.statistics.seconds
        if not found.success or "stood in" in found.message:
            raise ArithmeticError(found.message)
        return seconds, found.y, found.s


class Heyoka:
    """Taylor's method with variational equations; algebraic unknowns have rates."""

    def __init__(self, model: Any, initial: dict[str, float]) -> None:
        import heyoka as hy

        self.hy, self.n = hy, len(model.states)
        self.start = model.start(initial=initial)
        m, free = model.kernels.program.layout.n_algebraic, model.sensitivities
        states = [hy.make_vars(f"x{i}") for i in range(self.n)]
        clock = hy.make_vars("clock") if m else hy.time
        made = Equations(model, hy, states, [hy.par[i] for i in range(len(free))], clock)
        rates, self.values = made.rates, made.values
        if m:  # the clock is a state, since the equations are differentiated by it
            rates = [*rates[: self.n - m], *slopes(rates, states, m, clock, hy.diff), 1.0]
            states.append(clock)
        self.initial = np.zeros(len(states) * (1 + len(free)))
        self.initial[: self.n] = self.start.y
        if free:
            self.initial[len(states) :].reshape(-1, len(free))[: self.n] = self.start.s
        rates = [hy.expression(r) if isinstance(r, float) else r for r in rates]
        self.system = list(zip(states, rates, strict=True))
        self.size = len(states)
        if free:
            parameters = [hy.par[i] for i in range(len(free))]
            self.system = hy.var_ode_sys(self.system, parameters, order=1)
        # Else it would compile for minutes.
        self.is_large = (
            len(model.kernels.program.kernels["rhs"].order) > 200 or len(self.initial) > 50
        )
        self.made: dict[float, Any] = {}

    def run(self, times: Any, tolerance: float) -> tuple[float, Any, Any]:
        if tolerance not in self.made:
            initial = self.initial[: self.size] if self.values else self.initial
            self.made[tolerance] = self.hy.taylor_adaptive(
                self.system, initial, pars=self.values, tol=tolerance,
                compact_mode=self.is_large,
            )  # fmt: skip
        integrator = self.made[tolerance]
        integrator.time = 0.0
        integrator.state[:] = self.initial
        begin = time.perf_counter()
        *_, found = integrator.propagate_grid(times)
        seconds = time.perf_counter() - begin
        s = found[:, self.size :].T.reshape(self.size, len(self.values), len(times))
        return seconds, found[:, : self.n].T, s[: self.n]


class Casadi:
    """CasADi's CVODES or IDAS with forward sensitivities."""

    def __init__(self, model: Any, initial: dict[str, float]) -> None:
        import casadi as ca

        self.ca, self.start = ca, model.start(initial=initial)
        n, m = len(model.states), model.kernels.program.layout.n_algebraic
        x, clock = ca.SX.sym("x", n), ca.SX.sym("t")
        p = ca.SX.sym("p", len(model.sensitivities))
        states, parameters = ([v[i] for i in range(v.numel())] for v in (x, p))
        made = Equations(model, ca, states, parameters, clock)
        self.values, self.m, self.n = made.values, m, n
        rates = ca.vertcat(*made.rates)
        self.problem = {"x": x[: n - m], "p": p, "t": clock, "ode": rates[: n - m]}
        if m:
            self.problem |= {"z": x[n - m :], "alg": rates[n - m :]}
        self.made: dict[float, Any] = {}

    def run(self, times: Any, tolerance: float) -> tuple[float, Any, Any]:
        ca, n, m = self.ca, self.n, self.m
        if tolerance not in self.made:
            options = {"reltol": tolerance, "abstol": tolerance * 1e-2, "max_num_steps": 1000000}
            kind = "idas" if m else "cvodes"
            solver = ca.integrator("F", kind, self.problem, times[0], times[1:], options)
            forward = solver.forward(len(self.values)) if self.values else None
            self.made[tolerance] = (solver, forward)
        solver, forward = self.made[tolerance]
        y0, s0 = self.start.y, self.start.s
        given = {"x0": y0[: n - m], "p": self.values}
        if m:
            given["z0"] = y0[n - m :]
        begin = time.perf_counter()
        found = solver(**given)
        if forward is not None:
            seeds = {"fwd_x0": ca.DM(s0[: n - m]), "fwd_p": ca.DM.eye(len(self.values))}
            outs = {f"out_{key}": value for key, value in found.items()}
            tangent = forward(**given, **outs, **seeds)
        seconds = time.perf_counter() - begin
        y = np.vstack([y0, np.hstack([found["xf"].T, found["zf"].T]) if m else found["xf"].T]).T
        s = np.zeros((n, len(self.values), len(times)))
        if forward is not None:
            k = len(self.values)
            s[:, :, 0] = s0
            ends = np.array(tangent["fwd_xf"]).reshape(n - m, k, len(times) - 1)
            s[: n - m, :, 1:] = ends
        return seconds, y, s


@dataclass
class Trial:
    """A tool at one tolerance."""

    tool: str
    tolerance: float
    runner: Any
    error: float
    seconds: list[float] = field(default_factory=list)


def error(y: Any, s: Any, exact: Any) -> float:
    """Return the largest error of states and sensitivities."""
    largest = 0.0
    for found, right in ((y, exact.y), (s, exact.s)):
        if right.size:
            scale = np.maximum(1.0, np.abs(right).max(axis=-1, keepdims=True))
            largest = max(largest, float(np.max(np.abs(found - right) / scale)))
    return largest if np.isfinite(largest) else np.inf


def tools(row: Row, model: Any) -> dict[str, Any]:
    """Return the tools; print those that are missing."""
    found: dict[str, Any] = {m: Own(model, row.initial, m) for m in row.methods}
    found[CALL] = Own(model, row.initial, "dop853", is_whole=True)
    for name, kind in (("heyoka", Heyoka), ("casadi", Casadi)):
        if name in row.peers:
            try:
                found[name] = kind(model, row.initial)
            except (ImportError, NotImplementedError) as reason:
                print(f"{row.name}: {name} is left out: {reason}", file=sys.stderr)
    return found


def measure(row: Row, repeats: int) -> dict[str, Any]:
    """Measure a row."""
    scene = row.make()
    model = scene.compile(row.wanted(scene))
    times = np.linspace(0.0, row.end, POINTS)
    tight = ("Radau", "cvode") if row.is_stiff else ("DOP853", "dop853")
    if model.kernels.program.layout.n_algebraic:  # SciPy's methods take no algebraic unknowns
        tight = ("dop853", "rodas5")
    exact, other = (
        model.simulate((0.0, row.end), times, method, 1e-13, 1e-15, initial=row.initial)
        for method in tight
    )
    trials = []
    for tool, runner in tools(row, model).items():
        for tolerance in TOLERANCES:
            try:
                seconds, y, s = runner.run(times, tolerance)
            except Exception as reason:  # whatever another tool raises
                print(f"{row.name}: {tool} at {tolerance:.0e}: {reason}"[:200], file=sys.stderr)
                continue
            trials.append(Trial(tool, tolerance, runner, error(y, s, exact), [seconds]))
            if seconds > 2.0:
                break
    chosen = [trial for trial in trials if trial in _useful(trials, row.targets)]
    for _ in range(repeats):
        for trial in chosen:
            if sum(trial.seconds) < 3.0:
                trial.seconds.append(trial.runner.run(times, trial.tolerance)[0])
    best: dict[str, dict[str, Any]] = {}
    for target in row.targets:
        for trial in chosen:
            kept = best.setdefault(f"{target:.0e}", {})
            seconds = min(trial.seconds)
            if trial.error <= target and seconds < kept.get(trial.tool, (np.inf,))[0]:
                kept[trial.tool] = (seconds, trial.tolerance, trial.error)
    return {
        "row": row.name, "states": len(model.states), "sensitivities": list(model.sensitivities),
        "reference agrees to": error(other.y, other.s, exact), "reach": row.reach, "best": best,
    }  # fmt: skip


def _useful(trials: list[Trial], targets: tuple[float, ...]) -> list[Trial]:
    """Omit tolerances that cannot be the fastest for a target, except by noise."""
    found = []
    for target in targets:
        for tool in {trial.tool for trial in trials}:
            able = [t for t in trials if t.tool == tool and t.error <= target]
            found += sorted(able, key=lambda t: -t.tolerance)[:4]
    return found


def cell(best: dict[str, Any], tool: str) -> str:
    """Return a time as text, in ms."""
    return f"{1e3 * best[tool][0]:.3g}" if tool in best else "–"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rows", nargs="*", help="parts of the names of rows; default: all rows")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--repeats", type=int, default=30)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    toolchain = find_toolchain()
    compiler = toolchain.version if toolchain else "no compiler"
    print(f"cotree {cotree.__version__}, {platform.machine()}, {compiler}. Times in ms.\n")
    shown = [
        "dop853",
        CALL,
        "dopri5",
        "rodas4",
        "rodas5",
        "cvode",
        "ida",
        "DOP853",
        "heyoka",
        "casadi",
    ]
    print(heading(["system", "error", *shown, "aim"]))
    results = []
    for row in ROWS:
        if given.rows and not any(part in row.name for part in given.rows):
            continue
        result = measure(row, given.repeats)
        results.append(result)
        for target, best in result["best"].items():
            cells = [cell(best, tool) for tool in shown]
            print(line([row.name, target, *cells, row.reach]), flush=True)
    if given.json is not None:
        given.json.write_text(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
