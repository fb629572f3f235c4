"""Benchmark of methods on one scene: time and error of every method at every tolerance."""

from __future__ import annotations

import math
import os
import platform
import time
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.api import Model, Scene
from cotree.api import load as load_scene
from cotree.arguments import check_names
from cotree.build import find_toolchain
from cotree.build.compile import processor_name
from cotree.errors import Error, ParameterError, SolveError
from cotree.methods import METHODS, SUNDIALS_VERSION, method_row
from cotree.quiet import without_warnings
from cotree.scene.expressions import check_number
from cotree.solvers.native import is_available
from cotree.studies.accuracy import BenchRow, Reference, find_reference, starts_implicit, worse
from cotree.studies.bench_report import BenchReport
from cotree.tolerances import loose_rtol, rtol_fault
from cotree.version import VERSION

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path
    from typing import Unpack

    import numpy.typing as npt

    from cotree.results import Result
    from cotree.scene.graphs import TreeChoice
    from cotree.scene.settings import SettingsDict


def time_in_rounds(
    rows: Sequence[BenchRow],
    run: Callable[[BenchRow], bool],
    repeats: int,
    *,
    longest: float,
    until: float,
    clock: Callable[[], float] = time.perf_counter,
    spent: Callable[[], float] = time.process_time,
    tell: Callable[[int], None] = lambda _: None,
) -> None:
    """Run all rows once per round, each round from a different row, and append successful times.

    A row whose times sum to more than ``longest`` seconds is omitted from further rounds. No run
    begins after the processor time ``until``, so that other processes do not affect the number of
    rounds. ``tell`` receives the number of each round.
    """
    for k in range(repeats):
        tell(k)
        first = k % max(1, len(rows))
        for row in (*rows[first:], *rows[:first]):
            if sum(row.times) > longest:
                continue
            if spent() > until:
                return
            start = clock()
            if run(row):
                row.times.append(clock() - start)


def machine(backend: str) -> dict[str, str]:
    """Return processor, compiler, software versions and the ``backend`` of kernels by name."""
    import scipy

    toolchain = find_toolchain()
    return {
        "cotree": VERSION,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        # Engines can load only this version of SUNDIALS.
        "sundials": ".".join(map(str, SUNDIALS_VERSION)) if is_available("cvode") else "none",
        "system": f"{platform.system()} {platform.machine()}",
        "processor": processor_name(),
        "processors": str(os.cpu_count()),
        "kernels": backend,
        "compiler": "none" if toolchain is None else toolchain.version,
    }


def machine_load() -> str:
    """Return the mean processor load in the last minute; "unknown" on Windows."""
    return f"{os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else "unknown"


if TYPE_CHECKING:
    Progress = Callable[[str, float], None]

#: Default relative tolerances of a bench.
TOLERANCES = tuple(10.0**-k for k in range(3, 12))
N_POINTS = 101
# Default time limit of a run, [s].
_TIME_LIMIT = 5.0
# Ratio of relative to absolute tolerance, as in the default tolerances of runs.
_RTOL_PER_ATOL = 100.0
# Time limit of a reference run, which has tight tolerances, relative to the limit of other runs.
_PATIENCE = 12.0
# Tolerances of each method's first run, which builds its engine.
_LOOSE = (1e-3, 1e-5)
#: Default budget: processor time of all runs, without compilation and reference, [s].
BUDGET = 20.0
#: Budget, tolerances and numbers of runs of a quick bench.
QUICK_BUDGET, QUICK_TOLERANCES, QUICK_REPEATS = 4.0, (1e-3, 1e-6, 1e-9), 9
# Fraction of the budget for the first runs of all rows.
_TRIES = 0.6
# Runs shorter than this, [s], are repeated this number of times in the first round.
_SHORT, _TRIES_OF_SHORT = 0.02, 3
# Fractions of the progress bar for building engines and the reference, and for first runs.
_TO_BUILD, _TO_TRY = 0.2, 0.5
# Rows slower by this factor than a row of at least equal accuracy are timed last.
_FAR = 3.0
# Status of a run that exceeded its time limit.
_SPENT = -2


def bench(
    source: str | Path | Scene | Model,
    sensitivities: Sequence[str] = (),
    methods: Sequence[str] | None = None,
    tolerances: Sequence[float | tuple[float, float]] = TOLERANCES,
    repeats: int = 25,
    *,
    t_end: float | None = None,
    budget: float = BUDGET,
    values: Mapping[str, float] | None = None,
    tree: TreeChoice = None,
    progress: Progress | None = None,
    **settings: Unpack[SettingsDict],
) -> BenchReport:
    """Measure time and error of every method at every tolerance.

    Parameters
    ----------
    source : str, Path, Scene or Model
        A scene, the name of a shipped scene, a TOML file, or a compiled model.
    sensitivities : sequence of str
        Parameters and states to which sensitivities are computed; a compiled model has its own.
    methods : sequence of str, optional
        Methods; by default all that are installed.
    tolerances : sequence of float or (float, float)
        Relative tolerances, or pairs of relative and absolute tolerances; by default the absolute
        tolerance is a hundredth of the relative one.
    repeats : int
        Number of timed runs of each row, within the budget.
    t_end : float, optional
        End of the runs, [s]; by default the scene's.
    budget : float
        Processor time of all runs, without compilation and reference, [s]; it may be infinite.
        Tight tolerances of slow methods are omitted first, then repeated runs of methods that are
        far slower than others.
    values : mapping of str to float, optional
        Parameter values that replace the scene's.
    tree : None, sequence of str, or mapping of domain to sequence of str
        As for :meth:`cotree.Scene.compile`.
    progress : callable, optional
        Function called with a description of the next run and the completed fraction of the work.
    **settings
        Budgets and other settings of all runs, as in :meth:`cotree.Model.simulate`. ``time_limit``
        is 5 s by default. If a run exceeds it, its row has no numbers, and the method is not run at
        tighter tolerances. All timed runs of a row together take little longer.

    Returns
    -------
    BenchReport
        Rows, the reference, ``recommended(error)`` and ``tied(error)``.

    Raises
    ------
    ModelError
        If the scene, a name or a value is invalid.
    SolveError
        If a method is unknown, or no two methods agree within 1e-6 on a reference.

    Notes
    -----
    The error of a run is the maximum of |y - ref| / max(1, max |ref|) over 101 times, for states
    and for sensitivities. The maximum of |ref| is over time, for each state and sensitivity
    separately. Quantities below one are thus compared absolutely, in their units. ``own_error`` is
    relative to max |ref| even if that is small, and is also a criterion for recommendations.

    The reference is the solution of one method, confirmed by another, both at tolerances of 1e-12
    or 1e-13. Errors below their difference cannot be measured.

    The first run of each row determines its error. All rows are then timed in turn, in several
    rounds, so that the load of the machine affects all of them equally. Each time is the elapsed
    time of the whole call. A single method is recommended if its minimum time is shorter than all
    others by more than a tenth, and by more than the difference between lower quartile and minimum
    of either; otherwise methods are tied. Rows for which another method was used are not timed.

    Examples
    --------
    >>> report = bench("spring-mass-damper", ["k"], ["DOP853"], [1e-6], repeats=1, t_end=0.5)
    >>> report.recommended(1e-3).method
    'DOP853'
    """
    if not budget > 0.0:  # also rejects nan
        raise ParameterError(f"budget is {budget}: give a positive number of seconds")
    chosen = filter(is_available, METHODS) if methods is None else methods
    names = [method_row(name).name for name in chosen]
    pairs = [_pair(entry) for entry in tolerances]
    for text in filter(None, (loose_rtol(rtol) for rtol, _ in pairs)):
        warnings.warn(text, RuntimeWarning, stacklevel=2)
    if repeats < 1:
        raise ParameterError(f"repeats is {repeats}: give 1 or more")
    if {"rtol", "atol"} & settings.keys():
        raise ParameterError("a bench runs at several tolerances: give tolerances=[1e-6, ...]")
    limit = check_number(settings.pop("time_limit", _TIME_LIMIT), "time_limit")
    tell = progress or (lambda text, share: None)
    load_before = machine_load()
    model = _model(source, sensitivities, tree)
    with without_warnings(category=RuntimeWarning):  # rows contain the messages of runs
        own = {**settings, "parameters": dict(values or {})}
        runner = _BenchRuns(model, t_end, own, limit)
        expected = _warm_up(runner, names, tell)
        tell("a reference", _TO_BUILD)
        reference = runner.reference()
        trials = [BenchRow(name, *pair) for name in names for pair in pairs]
        begun = time.process_time()
        _try_all(runner, trials, reference, expected, begun + _TRIES * budget, tell)
        _time_all(runner, trials, repeats, begun + budget, tell)
    return BenchReport(
        scene=model.kernels.layout.name,
        sensitivities=model.sensitivities,
        n_states=len(model.states),
        n_points=N_POINTS,
        t_end=runner.t_end,
        repeats=repeats,
        reference=reference,
        rows=tuple(trials),
        machine={
            **machine(model.kernels.backend),
            "load_at_start": load_before,
            "load_at_end": machine_load(),
        },
    )


class _BenchRuns:
    """Runs one model with any method and returns values at the same times."""

    def __init__(
        self, model: Model, t_end: float | None, settings: dict[str, Any], time_limit: float
    ) -> None:
        if not model.states:
            raise SolveError(
                f"'{model.kernels.layout.name}' has no states: there is nothing to integrate"
            )
        self.model, self.settings, self.time_limit = model, settings, time_limit
        # A run at loose tolerances determines the end time and the method chosen for the scene.
        probe = model.simulate(
            None if t_end is None else (0.0, t_end),
            method="auto",
            rtol=1e-3,
            atol=1e-5,
            time_limit=_PATIENCE * time_limit,
            throw=True,
            **self.settings,
        )
        self.t_end = float(probe.t[-1])
        self.is_stiff = starts_implicit(probe.statistics.method)
        # All methods return values at the same times, so that errors exclude interpolation.
        self.points: npt.NDArray[np.float64] = np.linspace(0.0, self.t_end, N_POINTS)

    def run(self, method: str, rtol: float, atol: float, patience: float = 1.0) -> Result:
        return self.model.simulate(
            (0.0, self.t_end),
            self.points,
            method=method,
            rtol=rtol,
            atol=atol,
            time_limit=patience * self.time_limit,
            **self.settings,
        )

    def reference(self) -> Reference:
        return find_reference(
            lambda method, rtol: self.run(method, rtol, rtol / _RTOL_PER_ATOL, _PATIENCE),
            self.is_stiff,
        )


def _warm_up(runner: _BenchRuns, methods: Sequence[str], tell: Progress) -> dict[str, float]:
    """Run each method once to build its engine; return the elapsed times, [s]."""
    seconds = {}
    for k, method in enumerate(methods):
        tell(f"building {method}", _TO_BUILD * k / len(methods))
        result = _attempt(runner, BenchRow(method, *_LOOSE))
        seconds[method] = 0.0 if result is None else result.statistics.seconds
    return seconds


def _try_all(
    runner: _BenchRuns,
    trials: Sequence[BenchRow],
    reference: Reference,
    expected: dict[str, float],
    until: float,
    tell: Progress,
) -> None:
    """Run each row once, fast methods first, without tight tolerances of slow methods."""
    waiting = {
        method: sorted((t for t in trials if t.method == method), key=lambda trial: -trial.rtol)
        for method in dict.fromkeys(trial.method for trial in trials)
    }
    # The expected time of a run is the time of its method at the previous, looser tolerance.
    n_tried = 0
    while any(waiting.values()):
        method = min((m for m in waiting if waiting[m]), key=lambda m: expected[m])
        trial, *waiting[method] = waiting[method]
        tell(f"{method} at rtol {trial.rtol:.0e}", _TO_BUILD + _TO_TRY * n_tried / len(trials))
        n_tried += 1
        if time.process_time() + expected[method] > until:
            _leave_out([trial, *waiting[method]], "the budget of the bench is exceeded")
            waiting[method] = []
            continue
        start = time.perf_counter()
        _try(runner, trial, reference)
        expected[method] = time.perf_counter() - start
        if trial.status == _SPENT:
            _leave_out(
                [t for t in waiting[method] if t.rtol < trial.rtol],
                f"a run at rtol {trial.rtol:.0e} exceeded the time limit",
            )
            waiting[method] = [t for t in waiting[method] if t.rtol == trial.rtol]


def _leave_out(trials: Sequence[BenchRow], why: str) -> None:
    for trial in trials:
        trial.status, trial.message = _SPENT, f"not run: {why}"


def _try(runner: _BenchRuns, trial: BenchRow, reference: Reference) -> None:
    result, trial.first = _timed(runner, trial)
    if result is None:
        return
    trial.statistics, trial.status = result.statistics, result.status
    trial.message = result.message
    if result.success:
        trial.error_states, trial.error_sensitivities = reference.solution.distance(result)
        own = reference.own_distance(result)
        trial.own_error_states, trial.own_error_sensitivities = own
    # A single time of a short run is too inaccurate to select the fastest rows.
    for _ in range(_TRIES_OF_SHORT if trial.first < _SHORT else 0):
        trial.first = min(trial.first, _timed(runner, trial)[1])


def _timed(runner: _BenchRuns, trial: BenchRow) -> tuple[Result | None, float]:
    start = time.perf_counter()
    result = _attempt(runner, trial)
    return result, time.perf_counter() - start


def _attempt(runner: _BenchRuns, trial: BenchRow) -> Result | None:
    """Run a row; on an exception, store its message in the row and return None."""
    try:
        return runner.run(trial.method, trial.rtol, trial.atol)
    except (Error, ArithmeticError, ValueError, RuntimeError) as error:
        trial.status, trial.message = -1, str(error) or type(error).__name__
    return None


def _time_all(
    runner: _BenchRuns, trials: Sequence[BenchRow], repeats: int, until: float, tell: Progress
) -> None:
    """Time the successful rows repeatedly, first the rows that may be recommended."""

    def run(trial: BenchRow) -> bool:
        result = _attempt(runner, trial)
        if result is not None and not result.success and not trial.times:
            # Although the first run was barely within the time limit, this run exceeds it.
            trial.status, trial.message = result.status, result.message
        return result is not None and result.success

    left = [trial for trial in trials if trial.status == 0 and not trial.substitute]
    contenders = _contenders(left)
    others = [trial for trial in left if trial not in contenders]
    done = _TO_BUILD + _TO_TRY
    for share, group in ((0.7 * (1.0 - done), contenders), (0.3 * (1.0 - done), others)):
        time_in_rounds(
            group,
            run,
            repeats,
            longest=runner.time_limit,
            until=until,
            tell=lambda k, done=done, share=share: tell(  # type: ignore[misc]
                f"times, {k + 1} of {repeats}", done + share * k / repeats
            ),
        )
        done += share
    for trial in left:
        if trial.status == 0 and not trial.times:
            trial.times.append(trial.first)


def _contenders(trials: Sequence[BenchRow]) -> list[BenchRow]:
    """Return the rows that are not much slower than another row of at least equal accuracy."""

    def error(row: BenchRow) -> float:
        known = worse(row.error, row.own_error)
        return math.inf if math.isnan(known) else known

    found = []
    for trial in trials:
        as_good = (other.first for other in trials if error(other) <= error(trial))
        if trial.first <= _FAR * min(as_good, default=trial.first):
            found.append(trial)
    return found


def _model(
    source: str | Path | Scene | Model, sensitivities: Sequence[str], tree: TreeChoice
) -> Model:
    if isinstance(source, Model):
        names = check_names(sensitivities, "sensitivities")
        if names and names != source.sensitivities:
            raise ParameterError(
                "a compiled model has the sensitivities that it was compiled with, "
                f"{list(source.sensitivities)}: give the scene, or omit sensitivities"
            )
        return source
    scene = source if isinstance(source, Scene) else load_scene(source)
    return scene.compile(sensitivities, tree)


def _pair(entry: float | tuple[float, float]) -> tuple[float, float]:
    """Return relative and absolute tolerance of an entry of ``tolerances``, and check them."""
    try:
        rtol, atol = entry if isinstance(entry, tuple) else (entry, entry / _RTOL_PER_ATOL)
    except (TypeError, ValueError):
        raise SolveError(f"tolerances holds {entry!r}: give rtol, or (rtol, atol)") from None
    for name, value in (("rtol", rtol), ("atol", atol)):
        if not check_number(value, name) > 0.0:
            raise SolveError(f"tolerances holds {name} = {value}: give a positive number")
    if rtol_fault(rtol):
        raise SolveError(f"tolerances contains an invalid value: {rtol_fault(rtol)}")
    return rtol, atol
