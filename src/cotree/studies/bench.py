"""Speed against error on a scene of the user's own: every method at every tolerance.

In: a scene, or a compiled model. Out: a :class:`BenchReport`: time and error of each method at each
tolerance against a reference of the scene's own, and the method to take for an error.
"""

from __future__ import annotations

import itertools
import math
import os
import platform
import statistics
import time
import warnings
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.api import Model, Scene, load
from cotree.build import find_toolchain
from cotree.errors import Error, ParameterError, SolveError
from cotree.quiet import without_warnings
from cotree.scene.expressions import check_number
from cotree.solvers.methods import METHODS, method_row
from cotree.solvers.native import is_available
from cotree.studies.accuracy import find_reference, starts_implicit
from cotree.studies.bench_report import BenchReport
from cotree.studies.bench_row import BenchRow
from cotree.tolerances import loose_rtol, rtol_fault
from cotree.version import VERSION

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    import numpy.typing as npt

    from cotree.results import Result
    from cotree.scene.graphs import TreeChoice
    from cotree.solvers.base import Statistics
    from cotree.studies.accuracy import Reference

#: Relative tolerances of a bench that names none.
TOLERANCES = tuple(10.0**-k for k in range(3, 12))
N_POINTS = 101
# The ratio of the library's defaults.
_RTOL_PER_ATOL = 100.0
# A reference may take this many times the limit of a run: it is made once, at tight tolerances.
_PATIENCE = 12.0
# The status of a run that has spent its budget.
_SPENT = -2


def bench(
    source: str | Path | Scene | Model,
    sensitivities: Sequence[str] = (),
    methods: Sequence[str] | None = None,
    tolerances: Sequence[float | tuple[float, float]] = TOLERANCES,
    repeats: int = 7,
    *,
    t_end: float | None = None,
    time_limit: float = 5.0,
    values: Mapping[str, float] | None = None,
    tree: TreeChoice = None,
    progress: Callable[[str], None] | None = None,
) -> BenchReport:
    """Measure speed against error of every method at every tolerance.

    Parameters
    ----------
    source : str, Path, Scene or Model
        A scene, the name of a shipped one, a TOML file, or a compiled model.
    sensitivities : sequence of str
        Parameters and states to take sensitivities to; a model has its own.
    methods : sequence of str, optional
        All of them where absent.
    tolerances : sequence of float or (float, float)
        Relative tolerances, or pairs with the absolute ones, which else are a hundredth.
    repeats : int
        Timed runs of each.
    t_end : float, optional
        End of the runs, [s]; the scene's where absent.
    time_limit : float
        The longest run, [s]. One that takes longer is a row without numbers, and the same method at
        tighter tolerances is not run. All timed runs of a row together take little more.
    values : mapping of str to float, optional
        Parameter values in place of the scene's.
    tree : None, sequence of str, or mapping of domain to sequence of str
        As for :meth:`cotree.Scene.compile`.
    progress : callable, optional
        Is told in a few words what runs next.

    Returns
    -------
    BenchReport
        Rows, the reference, and ``recommended(error)``.

    Raises
    ------
    ModelError
        If the scene, a name or a value is wrong.
    SolveError
        If a method is unknown, or no two methods agree to 1e-6 on a reference.

    Notes
    -----
    The error of a run is the largest |y - ref| / max(1, max |ref|) over 101 points, of states and
    of sensitivities; max |ref| is the largest over the points, of each state and each sensitivity
    on its own. So quantities below one are compared absolutely, in their units.

    The reference is the solution of one method that another confirms, both at tolerances of 1e-12
    or 1e-13. What they differ by is the least error that can be told.

    Each run is made once to take its error and to warm up. Then all are timed in turn, again and
    again, so that what else the machine does hits all alike. A time holds everything between the
    call and the result.

    Examples
    --------
    >>> report = bench("spring-mass-damper", ["k"], ["DOP853"], [1e-6], repeats=1, t_end=0.5)
    >>> report.recommended(1e-3).method
    'DOP853'
    """
    names = _installed() if methods is None else [method_row(name).name for name in methods]
    pairs = [_pair(entry) for entry in tolerances]
    for text in filter(None, (loose_rtol(rtol) for rtol, _ in pairs)):
        warnings.warn(text, RuntimeWarning, stacklevel=2)
    if repeats < 1:
        raise ParameterError(f"repeats is {repeats}: give 1 or more")
    limit = check_number(time_limit, "time_limit")
    tell = progress or (lambda text: None)
    model = _model(source, sensitivities, tree)
    with without_warnings(category=RuntimeWarning):  # what a run warns of stands in its row
        runner = _Runner(model, t_end, dict(values or {}), limit)
        tell("a reference")
        reference = runner.reference()
        # Method by method, which the search for slow methods relies on.
        trials = [_Trial(name, *pair) for name in names for pair in pairs]
        _try_all(runner, trials, reference, tell)
        _time_all(runner, trials, repeats, tell)
    return BenchReport(
        scene=model.layout.name,
        sensitivities=model.sensitivities,
        n_states=len(model.states),
        n_points=N_POINTS,
        t_end=runner.t_end,
        repeats=repeats,
        reference=reference,
        rows=tuple(trial.row() for trial in trials),
        machine=_machine(model),
    )


def _installed() -> list[str]:
    """List the methods whose libraries are there."""
    return [name for name in METHODS if is_available(name)]


@dataclass
class _Trial:
    """A row of a bench before it is complete."""

    method: str
    rtol: float
    atol: float
    seconds: list[float] = field(default_factory=list)
    errors: tuple[float, float] = (math.nan, math.nan)
    statistics: Statistics | None = None
    status: int = -1
    message: str = ""

    def row(self) -> BenchRow:
        return BenchRow(
            method=self.method,
            rtol=self.rtol,
            atol=self.atol,
            # The median passes over single runs that the machine has delayed.
            seconds=statistics.median(self.seconds) if self.seconds else math.nan,
            n_runs=len(self.seconds),
            error_states=self.errors[0],
            error_sensitivities=self.errors[1],
            statistics=self.statistics,
            status=self.status,
            message=self.message,
        )


class _Runner:
    """Runs of one model over the same points."""

    def __init__(
        self, model: Model, t_end: float | None, values: Mapping[str, float], time_limit: float
    ) -> None:
        if not model.states:
            raise SolveError(f"'{model.layout.name}' has no states: there is nothing to integrate")
        self.model, self.time_limit = model, time_limit
        self.settings: dict[str, Any] = {"parameters": values}
        # A loose run, to learn where the scene ends and what is chosen for it.
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
        # A reference then begins with implicit methods.
        self.is_stiff = starts_implicit(probe.statistics.method)
        # The same points for all methods, so that errors are compared without interpolation.
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


def _try_all(
    runner: _Runner, trials: Sequence[_Trial], reference: Reference, tell: Callable[[str], None]
) -> None:
    """Make each run once; of a method that is too slow, none at a tighter tolerance."""
    for method, rows in itertools.groupby(trials, key=lambda trial: trial.method):
        tell(method)
        slow = math.inf  # the loosest tolerance at which the time limit was met
        for trial in rows:
            # Tolerances may come in any order; only tighter ones than the slow one are given up.
            if trial.rtol < slow < math.inf:
                trial.status = _SPENT
                trial.message = f"not run: over the time limit at rtol {slow:.0e} already"
                continue
            _try(runner, trial, reference)
            if trial.status == _SPENT:
                slow = trial.rtol


def _try(runner: _Runner, trial: _Trial, reference: Reference) -> None:
    result = _attempt(runner, trial)
    if result is None:
        return
    trial.statistics, trial.status = result.statistics, result.status
    trial.message = result.message
    if result.success:
        trial.errors = reference.solution.distance(result)


def _attempt(runner: _Runner, trial: _Trial) -> Result | None:
    """Run a trial; an exception becomes its message, so that the others go on."""
    try:
        return runner.run(trial.method, trial.rtol, trial.atol)
    except (Error, ArithmeticError, ValueError, RuntimeError) as error:
        trial.status, trial.message = -1, str(error) or type(error).__name__
    return None


def _time_all(
    runner: _Runner, trials: Sequence[_Trial], repeats: int, tell: Callable[[str], None]
) -> None:
    """Time the runs that succeed, all in turn, slow ones fewer times."""
    # Rows inside, repeats outside: what disturbs the machine for a while then hits all rows alike.
    for k in range(repeats):
        tell(f"times, {k + 1} of {repeats}")
        for trial in trials:
            # A slow row keeps the median of fewer runs.
            if trial.status != 0 or sum(trial.seconds) > runner.time_limit:
                continue
            start = time.perf_counter()
            result = _attempt(runner, trial)
            seconds = time.perf_counter() - start
            if result is not None and result.success:
                trial.seconds.append(seconds)
            elif result is not None and not trial.seconds:
                # It was just below the limit before.
                trial.status, trial.message = result.status, result.message


def _model(
    source: str | Path | Scene | Model, sensitivities: Sequence[str], tree: TreeChoice
) -> Model:
    if isinstance(source, Model):
        # A single name is no sequence of its letters.
        names = (sensitivities,) if isinstance(sensitivities, str) else tuple(sensitivities)
        if names and names != source.sensitivities:
            raise ParameterError(
                "a compiled model has the sensitivities that it was compiled with, "
                f"{list(source.sensitivities)}: give the scene, or no others"
            )
        return source
    scene = source if isinstance(source, Scene) else load(source)
    return scene.compile(sensitivities, tree)


def _pair(entry: float | tuple[float, float]) -> tuple[float, float]:
    """Give both tolerances."""
    try:
        rtol, atol = entry if isinstance(entry, tuple) else (entry, entry / _RTOL_PER_ATOL)
    except (TypeError, ValueError):
        raise SolveError(f"tolerances holds {entry!r}: give rtol, or (rtol, atol)") from None
    for name, value in (("rtol", rtol), ("atol", atol)):
        if not check_number(value, name) > 0.0:
            raise SolveError(f"tolerances holds {name} = {value}: give a positive number")
    if rtol_fault(rtol):
        raise SolveError(f"tolerances holds a wrong one: {rtol_fault(rtol)}")
    return rtol, atol


def _machine(model: Model) -> dict[str, str]:
    """Describe the machine and the software of the measurements."""
    import scipy

    toolchain = find_toolchain()
    return {
        "cotree": VERSION,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "system": f"{platform.system()} {platform.machine()}",
        "processors": str(os.cpu_count()),
        "kernels": model.backend,
        "compiler": "none" if toolchain is None else toolchain.version,
    }
