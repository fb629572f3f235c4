"""A thousand runs in one call, compared with loops of single runs and other tools.

Run it with ``python benchmarks/ensembles.py [ROW ...] [--members N] [--rounds N] [--json FILE]``.
It needs ``pip install heyoka diffrax`` and omits tools that are missing. Parameters are drawn
within 10 % of their values in the scene. Each tool uses the loosest tolerance, in steps of an
eighth of a decade, for which the error of every member is at most 1e-6 at all of 101 points. The
error is |y - ref| / max(1, max |ref|) of states and sensitivities; the reference has a tolerance of
1e-12.

The tools run alternately. Times are medians per member, [us], with minima in parentheses. ``one
thread`` is processor time, which other load does not affect; ``on the clock`` and ``two threads``
are elapsed times. Compilation times are not included.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "example_scenes"))
from domain_scenes import scene_of_domain
from ensemble_peers import ATOL, PEERS
from reference_scenes import read_reference
from rod_chain import rod_chain
from timing import about, keep, surroundings, table

import cotree
from cotree.ensemble.batch import run_block
from cotree.ensemble.plan import Plan
from cotree.scene.settings import Settings

if TYPE_CHECKING:
    from collections.abc import Callable

POINTS, SPREAD, WANTED = 101, 0.1, 1e-6
#: Exponents of tolerances that are tried, and what is then taken from the first that will do.
COARSE, FINE = [k / 2 for k in range(6, 25)], [3 / 8, 2 / 8, 1 / 8]
#: Members that the loop of single runs, and the slow peers, get: they take long.
FEW = 100
LOOP, IN_C = "loop of `simulate`", "its time in C"


@dataclass(frozen=True)
class Row:
    """A scene, the distributions of its parameters, its sensitivities, and the tools to measure."""

    name: str
    make: Callable[[], Any]
    drawn: Callable[[Any], list[str]]
    wanted: Callable[[Any], list[str]]
    end: float
    members: int = 1000
    methods: tuple[str, ...] = ("dop853", "dopri5")
    peers: tuple[str, ...] = ("heyoka", "Diffrax")
    initial: dict[str, float] = field(default_factory=dict)
    reference: str = "dop853"
    beside: str = ""  # what members are compared with, if not the best peer


def _first_three(scene: Any) -> list[str]:
    return list(scene.compile().parameters)[:3]


def _pendulum() -> Any:
    return cotree.load("slider-pendulum")


def _every(scene: Any) -> list[str]:
    return list(scene.parameters)


def _chain() -> Any:
    return rod_chain(5)[0]


def _of_rods(scene: Any) -> list[str]:
    return rod_chain(5)[1]


def _none(scene: Any) -> list[str]:
    return []


SWING = {"h0.theta": -1.2}
ROWS = [
    Row("slider-pendulum, states", _pendulum, _every, _none, 10.0),
    Row("slider-pendulum, s_L", _pendulum, _every, lambda s: ["L"], 10.0),
    Row("slider-pendulum, all 8", _pendulum, _every, _every, 10.0),
    Row("chain of 5 rods, states", _chain, _of_rods, _none, 5.0, 200, initial=SWING),
    Row("chain of 5 rods, 10", _chain, _of_rods, _of_rods, 5.0, 40, initial=SWING),
    Row("HIRES, 3", lambda: scene_of_domain("chem_hires"), _first_three, _first_three,
        float(read_reference("chem_hires")["t_end"]), 200, ("rodas5",), (), reference="rodas5",
        beside=IN_C),
    Row("bouncing ball, 4", lambda: cotree.load("bouncing-ball"), _every, _every, 8.0, 1000,
        ("dop853",), (), beside=LOOP),
]  # fmt: skip


@dataclass
class Entry:
    """A tool with the tolerance that it needs.

    Attributes
    ----------
    run : callable
        Runs a number of threads; the seconds of a member, where the tool itself tells them.
    members : int
        How many it runs.
    """

    tool: str
    tolerance: float
    error: float
    members: int
    run: Callable[[int], Any]
    is_threaded: bool = False
    processor: list[float] = field(default_factory=list)
    clock: list[float] = field(default_factory=list)
    threaded: list[float] = field(default_factory=list)

    def measure(self) -> None:
        """Take one more time of each."""
        used, begin = time.process_time(), time.perf_counter()
        own = self.run(1)
        seconds, used = time.perf_counter() - begin, time.process_time() - used
        # What a tool tells of itself leaves the loop around it out.
        self.processor.append((used if own is None else own) / self.members)
        self.clock.append(seconds / self.members)
        if self.is_threaded:
            begin = time.perf_counter()
            self.run(2)
            self.threaded.append((time.perf_counter() - begin) / self.members)


class Work:
    """A row with its model, its members and their reference."""

    def __init__(self, row: Row, n_members: int | None) -> None:
        self.row, scene = row, row.make()
        self.columns = tuple(row.drawn(scene))
        self.model = scene.compile(row.wanted(scene))
        layout = self.model.kernels.program.layout
        values = dict(zip(self.model.parameters, layout.parameter_values, strict=True))
        middle = np.array([float(values[name]) for name in self.columns])
        draw = np.random.default_rng(0).uniform(-1.0, 1.0, (n_members or row.members, len(middle)))
        self.rows = middle * (1.0 + SPREAD * draw)
        self.times = np.linspace(0.0, row.end, POINTS)
        block = run_block(self.plan(row.reference, 1e-12), self.rows)
        if np.any(block.status != 0):
            raise ArithmeticError(f"{row.name}: {set(block.messages) - {''}}")
        self.exact = block.z

    def plan(self, method: str, tolerance: float, lanes: int | None = 1) -> Plan:
        """Return the settings with which members are run."""
        settings = Settings(
            (0.0, self.row.end), self.times, method, tolerance, tolerance * ATOL,
            initial=self.row.initial,
        )  # fmt: skip
        return Plan(self.model, settings, self.columns, lanes=lanes)

    def error(self, found: Any) -> float:
        """Return the largest error of all members."""
        exact = self.exact[: len(found)]
        share = np.abs(found - exact) / np.maximum(1.0, np.abs(exact).max(axis=1, keepdims=True))
        # A member that failed is nan.
        return float(np.max(share)) if np.all(np.isfinite(found)) else np.inf

    def loosest(self, values: Callable[[float], Any]) -> tuple[float, float]:
        """Return the loosest tolerance that satisfies the error, and this error."""
        for exponent in COARSE:
            error = self.error(values(10.0**-exponent))
            if error <= WANTED:
                break
        else:
            raise ArithmeticError(f"no tolerance reaches {WANTED:g}")
        for looser in FINE if exponent > COARSE[0] else ():
            finer = self.error(values(10.0 ** (looser - exponent)))
            if finer <= WANTED:
                return 10.0 ** (looser - exponent), finer
        return 10.0**-exponent, error

    def start(self) -> Any:
        """Initial states and sensitivities, which are the same for all members."""
        start = self.model.start(initial=self.row.initial)
        return np.concatenate([start.y, start.s.T.ravel()])


def own(work: Work) -> list[Entry]:
    """Add cotree's methods, in lanes if available, and a loop of single runs."""
    entries = []
    for method in work.row.methods:
        tolerance, error = work.loosest(
            lambda tol, method=method: run_block(work.plan(method, tol), work.rows).z
        )
        for lanes, what in ((None, "lanes"), (1, "one by one")):
            plan = work.plan(method, tolerance, lanes)
            error = work.error(run_block(plan, work.rows).z)

            def run(threads: int, plan: Plan = plan) -> None:
                run_block(plan, work.rows, threads=threads)

            tool = f"cotree `{method}`, {what}"
            entries.append(Entry(tool, tolerance, error, len(work.rows), run, True))
        entries += _single(work, method, tolerance, error)
    return entries


def _single(work: Work, method: str, tolerance: float, error: float) -> list[Entry]:
    """Add a loop of ``simulate``, and its time in C."""
    some = work.rows[:FEW].tolist()

    def run(threads: int) -> float:
        seconds = 0.0
        for values in some:
            found = work.model.simulate(
                (0.0, work.row.end), work.times, method, tolerance, tolerance * ATOL,
                parameters=dict(zip(work.columns, values, strict=True)), initial=work.row.initial,
            )  # fmt: skip
            seconds += found.statistics.seconds
        return seconds

    def whole(threads: int) -> None:
        run(threads)

    return [
        Entry(f"{LOOP}, `{method}`", tolerance, error, len(some), whole),
        Entry(f"{IN_C}, `{method}`", tolerance, error, len(some), run),
    ]


def others(work: Work) -> list[Entry]:
    """Add the other tools that are installed."""
    entries = []
    for kind in PEERS:
        if kind.name not in work.row.peers:
            continue
        try:
            peer = kind(work.model, list(work.columns), work.start())
        except (ImportError, NotImplementedError) as reason:
            print(f"{work.row.name}: {kind.name} is left out: {reason}", file=sys.stderr)
            continue
        rows = work.rows if kind.is_quick else work.rows[:FEW]
        tolerance, error = work.loosest(
            lambda tol, peer=peer, rows=rows: peer.run(rows, work.times, tol)[0]
        )

        def run(threads: int, peer: Any = peer, rows: Any = rows, tol: float = tolerance) -> float:
            return float(peer.run(rows, work.times, tol)[1])

        entries.append(Entry(kind.name, tolerance, error, len(rows), run))
    return entries


def measure(row: Row, n_members: int | None, rounds: int) -> list[Entry]:
    """Measure all tools in turn."""
    work = Work(row, n_members)
    entries = [*own(work), *others(work)]
    for _ in range(rounds):
        for entry in entries:
            entry.measure()
    return entries


def line(entry: Entry, peers: list[Entry]) -> list[str]:
    """Return the cells of an entry, with the ratio to the best time of other tools."""
    clock, cells = median(entry.clock), [entry.tool, f"{entry.tolerance:.1e}", f"{entry.error:.0e}"]
    own = [of(entry.processor) for of in (median, min)]
    best = [min(of(peer.processor) for peer in peers) for of in (median, min)]
    cells.append("{:.3g} ({:.3g})".format(*(1e6 * value for value in own)))
    cells.append("{:.2f} ({:.2f})".format(*(a / b for a, b in zip(own, best, strict=True))))
    cells.append(f"{1e6 * clock:.3g}")
    if not entry.threaded:
        return [*cells, "", ""]
    return [*cells, f"{1e6 * median(entry.threaded):.3g}", f"{clock / median(entry.threaded):.2f}"]


HEAD = (
    *("tool", "tolerance", "error", "one thread", "of the best other tool"),
    *("on the clock", "two threads", "gain"),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rows", nargs="*", help="parts of the names of rows; default: all rows")
    parser.add_argument("--members", type=int)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    print(surroundings())
    kept = {}
    for row in ROWS:
        if given.rows and not any(part in row.name for part in given.rows):
            continue
        entries = measure(row, given.members, given.rounds)
        beside = (row.beside,) if row.beside else row.peers
        # Without the other tools members are compared with single runs.
        peers = [e for e in entries if e.tool.startswith(beside)] or entries[2:3]
        n = given.members or row.members
        print(f"{row.name}: {n} members\n\n{table(HEAD, [line(e, peers) for e in entries])}\n")
        sys.stdout.flush()
        kept[row.name] = [{k: v for k, v in vars(e).items() if k != "run"} for e in entries]
    keep(given.json, about("as a run chooses them"), kept)


if __name__ == "__main__":
    main()
