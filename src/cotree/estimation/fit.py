"""``cotree.fit``: estimation of parameters by least squares from several starts."""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.errors import ParameterError, SolveError, brief
from cotree.estimation.assembly import estimation_problem
from cotree.estimation.multistart import Search, minimise_from_starts
from cotree.estimation.result import FitResult
from cotree.estimation.spread import spread_starts
from cotree.scene.expressions import check_number
from cotree.scene.given import check_whole

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.api import Scene
    from cotree.compiled import Model
    from cotree.estimation.experiment import Experiment
    from cotree.estimation.problem import Problem

Array = npt.NDArray[np.float64]

_LOSSES = ("linear", "soft_l1", "huber", "cauchy", "arctan")
_OPTIMISERS = ("trf", "dogbox", "lm")


def fit(
    model: Model | Scene,
    experiments: Experiment | Sequence[Experiment],
    parameters: Any,
    *,
    shared: Sequence[str] | None = None,
    per_experiment: Sequence[str] = (),
    noise: str | None = None,
    start: Mapping[str, float] | None = None,
    loss: str = "linear",
    f_scale: float = 1.0,
    starts: int = 20,
    seed: int = 0,
    method: str | None = None,
    rtol: float = 1e-8,
    atol: float = 1e-10,
    optimiser: str = "trf",
    max_evaluations: int | None = None,
    progress: bool = True,
) -> FitResult:
    """Estimate parameters and initial values from measurements, by maximum likelihood.

    ``scipy.optimize.least_squares`` receives the residuals and their exact Jacobian. It searches
    from several starts side by side, whose runs the ensemble engine computes together. The outcome
    of a start does not depend on the others.

    Parameters
    ----------
    model : Model or Scene
        The model. It is compiled again if it lacks sensitivities to what is estimated, or outputs
        that were measured.
    experiments : Experiment or sequence of Experiment
        The measurements.
    parameters : mapping of str to tuple, or sequence of str
        Parameters to estimate: parameters of the scene, initial values (by the names of states),
        new parameters in expressions of experiments, and names that experiments use as values. The
        range of each is ``(lower, upper)`` or ``(lower, upper, scale)`` in SI, with the scale
        ``"lin"``, ``"log"`` or ``"log10"``; None means no bound. Without a range, a positive
        parameter lies between a hundredth and a hundred times its start, on a logarithmic scale.
    shared, per_experiment : sequence of str, optional
        Parameters with one estimate for all experiments, and with a separate one for each, named
        ``k[1]`` or ``k[name]``. All are shared by default; if ``shared`` is given, all others are
        estimated for each experiment.
    noise : str, optional
        ``"given"`` requires that experiments specify their noise; ``"estimated"`` estimates a
        standard deviation ``noise[column]`` for each column and ignores what they specify. By
        default only noise that is not specified is estimated.
    start : mapping of str to float, optional
        The first start; by default the scene's values if they lie within the bounds, else the
        middle of the bounds.
    loss : str
        ``"linear"``, or one of the robust losses ``"soft_l1"``, ``"huber"``, ``"cauchy"`` and
        ``"arctan"``, which reduce the influence of outliers and require a given noise; see
        ``scipy.optimize.least_squares``.
    f_scale : float
        The residual, in standard deviations, beyond which a value counts as an outlier.
    starts : int
        Number of starts; all but the first are spread between the bounds.
    seed : int
        Seed of these starts; equal seeds give equal results.
    method, rtol, atol
        Method and tolerances of the runs; see :meth:`cotree.Model.simulate`.
    optimiser : str
        ``"trf"``, ``"dogbox"``, or ``"lm"``, which does not support bounds.
    max_evaluations : int, optional
        Largest number of evaluations of each start; a hundred per parameter if absent.
    progress : bool
        Whether to show a progress bar, on terminals and after a second.

    Returns
    -------
    FitResult
        Estimates with standard errors, intervals, findings, profiles and plots. After Ctrl-C it
        contains the best points found so far.

    Raises
    ------
    ModelError
        If a name is unknown, something is missing, or arguments contradict each other.
    SolveError
        If the runs of all starts fail.

    Examples
    --------
    >>> import numpy as np, cotree
    >>> scene = cotree.Scene("discharge")
    >>> scene.parameter("R", 2.0)
    >>> scene.edge("C", "capacitor", "a", "ground", capacitance=1.0, initial={"v": 4.0})
    >>> scene.edge("R", "resistor", "a", "ground", resistance="R")
    >>> t = np.linspace(0, 5, 11)
    >>> run = cotree.Experiment({"t": t, "C.v": 5 * np.exp(-t / 3)}, noise=0.1)
    >>> result = cotree.fit(scene, run, {"R": (0.1, 100, "log"), "C.v": (0, 10)})
    >>> {name: round(value, 4) for name, value in result.parameters.items()}
    {'R': 3.0, 'C.v': 5.0}
    """
    if loss not in _LOSSES:
        raise ParameterError(f"loss is {brief(repr(loss))}: give {_either(_LOSSES)}")
    if optimiser not in _OPTIMISERS:
        raise ParameterError(f"optimiser is {brief(repr(optimiser))}: give {_either(_OPTIMISERS)}")
    starts, seed = check_whole(starts, "starts", 1), check_whole(seed, "seed")
    if max_evaluations is not None:
        max_evaluations = check_whole(max_evaluations, "max_evaluations", 1)
    f_scale = check_number(f_scale, "f_scale")
    if not f_scale > 0.0:
        raise ParameterError(f"f_scale is {f_scale:g}: give a positive number")
    problem = estimation_problem(
        model,
        experiments,
        parameters,
        shared=shared,
        per_experiment=per_experiment,
        noise=noise,
        start=start,
        method=method,
        rtol=rtol,
        atol=atol,
    )
    _check_search(problem, loss, optimiser)
    search = Search(optimiser, loss, f_scale, max_evaluations=max_evaluations)
    return solve(problem, search, starts, seed, progress=progress)


def solve(
    problem: Problem, search: Search, n_starts: int, seed: int, *, progress: bool = True
) -> FitResult:
    """Search from several starts, at least one of which must succeed.

    Parameters
    ----------
    problem : Problem
        What is estimated.
    search : Search
        Settings of the optimiser.
    n_starts, seed : int
        Number of starts, and seed of all but the first one.
    progress : bool
        Whether a progress bar may be shown.

    Raises
    ------
    ParameterError
        If no measured value depends on anything that is estimated.
    SolveError
        If no run succeeds.
    """
    points = sized(problem, spread_starts(problem, n_starts, seed))
    records = minimise_from_starts(problem, points, search, progress=progress)
    if not math.isfinite(records[0].objective):
        subject = f"all {n_starts} starts failed" if n_starts > 1 else "the only start failed"
        raise SolveError(f"{subject}: {records[0].message}")
    _check_determined(problem, records[0].theta)
    if any(row.message.startswith("interrupted") for row in records):
        warnings.warn(
            "the fit was interrupted: the result holds the best points found so far",
            RuntimeWarning,
            stacklevel=3,
        )
    return FitResult(problem, records, search)


def sized(problem: Problem, points: Array) -> Array:
    """Initialise noise parameters that have no guess by the root mean square of the residuals."""
    noise = np.array([v if isinstance(v, str) else "" for v in problem.measured.noise])
    unset = [
        (j, noise == row.name)
        for j, row in enumerate(problem.estimated)
        if row.start is None and (noise == row.name).any()
    ]
    if not unset:
        return points
    points = points.copy()
    target = problem.likelihood.transformed(problem.likelihood.value)
    for point, found in zip(points, problem.predict(points), strict=True):
        difference = problem.likelihood.transformed(found.values) - target
        for j, rows in unset:
            size = float(np.sqrt(np.mean(difference[rows] ** 2)))
            if math.isfinite(size) and size > 0.0:
                values = problem.scaled.values(point)
                values[j] = size
                point[j] = problem.scaled.scaled(values)[j]
    return np.clip(points, problem.scaled.lower, problem.scaled.upper)


def _check_search(problem: Problem, loss: str, optimiser: str) -> None:
    """Refuse a loss or an optimiser that does not support the problem."""
    unknown = [name for name in problem.measured.noise if isinstance(name, str)]
    if loss != "linear" and unknown:
        raise ParameterError(
            f"loss='{loss}' needs a given noise, but '{unknown[0]}' is estimated: give the "
            "standard deviation of every measured column"
        )
    if optimiser == "lm":
        _check_minpack(problem, loss, len(unknown))


def _check_minpack(problem: Problem, loss: str, n_unknown: int) -> None:
    """Refuse what MINPACK does not support: bounds, robust losses, fewer rows than parameters."""
    bounded = [
        row.name for row in problem.estimated if row.lower > -math.inf or row.upper < math.inf
    ]
    if bounded:
        raise ParameterError(
            f"optimiser='lm' does not support bounds, but '{bounded[0]}' has some: use 'trf', "
            "or give (None, None)"
        )
    if loss != "linear":
        raise ParameterError(f"optimiser='lm' does not support loss '{loss}': use 'trf'")
    # Each value with estimated noise contributes a second row.
    if len(problem.measured) + n_unknown < len(problem.estimated):
        raise ParameterError(
            "optimiser='lm' needs at least as many measured values as parameters, of which there "
            f"are {len(problem.estimated)}: use 'trf'"
        )


def _check_determined(problem: Problem, theta: Array) -> None:
    """Refuse a problem in which no parameter influences any measured value."""
    (found,) = problem.predict([theta])
    if not np.any(found.slopes):
        names = ", ".join(f"'{name}'" for name in problem.scaled.names)
        raise ParameterError(
            f"no measured value depends on {names}: measure other quantities, or estimate "
            "other parameters"
        )


def _either(words: Sequence[str]) -> str:
    return f"{', '.join(map(repr, words[:-1]))} or {words[-1]!r}"
