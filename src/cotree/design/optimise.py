"""``cotree.optimise``: parameters that minimise an objective of simulated runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.api import Model, Scene
from cotree.arguments import check_choice, check_mapping, check_names, check_whole
from cotree.compiled import compile_spec
from cotree.design.evaluation import Evaluation
from cotree.design.search import (
    MET,
    OPTIMAL,
    ConditionValue,
    Descent,
    Design,
    Space,
    read_variables,
)
from cotree.errors import Error, ParameterError, SolveError, brief, check_known, listed
from cotree.gradient.goals import Goals, variant_of
from cotree.model.start import scene_start
from cotree.quiet import without_warnings
from cotree.scene.expressions import check_positive
from cotree.scene.settings import settings_from

if TYPE_CHECKING:
    from typing import Unpack

    from cotree.design.evaluation import DesignPoint
    from cotree.scene.description import SceneDescription
    from cotree.scene.settings import Settings, SettingsDict

#: Keys that a scenario may have.
_OF_RUN = ("parameters", "initial", "inputs", "t_span")


def optimise(
    system: Model | Scene,
    minimise: str,
    over: Mapping[str, tuple[float, float] | tuple[float, float, str]],
    subject_to: Sequence[str] | str = (),
    *,
    t_span: tuple[float, float] | None = None,
    parameters: Mapping[str, float] | None = None,
    initial: Mapping[str, float] | None = None,
    inputs: Mapping[str, Any] | None = None,
    runs: Sequence[Mapping[str, Any]] | None = None,
    guess: Mapping[str, float] | None = None,
    starts: int = 1,
    seed: int | None = 0,
    method: str = "slsqp",
    tolerance: float = 1e-12,
    max_iterations: int = 200,
    solver: str | None = None,
    **settings: Unpack[SettingsDict],
) -> Design:
    """Find the parameters that minimise an objective subject to constraints.

    Objective and constraints are expressions. The name of a design variable denotes its value; any
    other name ``x`` denotes ``end(x)``, its value at the end of the run. ``start(x)`` and
    ``at(2.0, x)`` are values at other times, ``integral(x)`` and ``mean(x)`` extend over the run,
    ``maximum(x)`` and ``minimum(x)`` are extremes over time, and ``time(EVENT)`` is the time of the
    first occurrence of an event. ``x`` is any expression of states, outputs, inputs, parameters and
    ``t``. Gradients are exact: the scene is compiled once with all these quantities, and their
    sensitivities are integrated with the states.

    Parameters
    ----------
    system : cotree.Model or cotree.Scene
        The system. A compiled model keeps its tree and compiler options.
    minimise : str
        The objective. To maximise a quantity, minimise it with a minus sign.
    over : mapping of str to (lower, upper) or (lower, upper, "log")
        Design variables and their bounds in SI units: parameters, and initial values by the names
        of states.
    subject_to : sequence of str
        Constraints with ``<=``, ``>=`` or ``==``: ``"maximum(P) <= 40"``, ``"L + d <= 3"``.
    t_span : (float, float), optional
        Start and end of the runs, [s]; by default from zero to the scene's end.
    parameters, initial, inputs : mapping, optional
        Values common to all runs; see :meth:`cotree.Model.simulate`.
    runs : sequence of mapping, optional
        Scenarios, each with its own ``parameters``, ``initial``, ``inputs`` and ``t_span``. The
        objective is the mean over all scenarios, and the constraints must hold in each.
    guess : mapping of str to float, optional
        Initial guess; by default the scene's values, or the middle of the bounds if these values
        are outside.
    starts : int
        Number of searches: the first starts at the guess, the others at points of a Latin
        hypercube.
    seed : int
        Seed of these points.
    method : {"slsqp", "trust-constr"}
        SciPy's method.
    tolerance : float
        A search ends if the objective changes by less than this, relative to the objective or its
        gradient at the start.
    max_iterations : int
        Maximum number of iterations of a search.
    solver, **settings
        Method, tolerances, budgets and other settings of the runs; see
        :meth:`cotree.Model.simulate`.

    Returns
    -------
    Design
        The optimal ``parameters``, with ``objective``, ``conditions``, ``message``, ``history`` and
        the ``result`` of their run.

    Raises
    ------
    ModelError
        If a name is unknown, or an expression or a bound is invalid.
    SolveError
        If the solver or a tolerance is invalid, or the run fails at every start.

    Examples
    --------
    >>> import cotree
    >>> scene = cotree.Scene("damper")
    >>> scene.parameter("c", 3.0)
    >>> joint = {"axis": [1, 0, 0], "stiffness": 60.0, "damping": "c", "initial": {"s": 1.0}}
    >>> scene.edge("j", "prismatic", "ground", "A", **joint)
    >>> scene.edge("body", "rigid_body", "ground", "A", mass=1.5)
    >>> best = cotree.optimise(scene, "integral(j.s**2)", {"c": (1, 50)}, t_span=(0, 40))
    >>> round(best["c"], 3)  # the closed form is sqrt(k m)
    9.487
    """
    described, method = _scene_of(system), str(method).lower()
    check_choice(method, "method (solver selects that of the runs)", ("slsqp", "trust-constr"))
    texts = check_names(subject_to, "subject_to", "conditions in quotes")
    tolerance = check_positive(tolerance, "tolerance")
    max_iterations = check_whole(max_iterations, "max_iterations", 1)
    names = list(over) if isinstance(over, Mapping) else []
    # A name with a dot may be a state, and states are known only after compilation.
    own, after = (n for n in names if "." not in str(n)), ", which is not a parameter of the scene"
    check_known(own, described.parameters, "over names", after, ParameterError)
    goals = Goals(minimise, texts, [n for n in names if n in described.parameters])
    guess = check_mapping(guess, "guess")
    starts, seed = check_whole(starts, "starts", 1), seed and check_whole(seed, "seed")
    read_variables(over, {}, guess)
    model, found = variant_of(
        described, goals.quantities, lambda changed: _compiled(system, changed, names)
    )
    given: dict[str, Any] = {
        "t_span": t_span,
        "method": solver,
        "parameters": check_mapping(parameters, "parameters"),
        "initial": initial,
        "inputs": inputs,
        **settings,
    }
    common = settings_from(described.defaults, given)
    scenarios = _scenarios(common, runs, names)
    evaluation = Evaluation(model, goals, found, names, scenarios)
    space = Space(read_variables(over, _known(model, common), guess))
    _check_reach(evaluation)
    searches: list[Descent] = []
    ends, failures = [], []
    for start in space.starts(starts, seed):
        search = Descent(evaluation, space)
        try:
            if not searches:
                _check_objective(search, start)
            ends.append(search.run(start, method, tolerance, max_iterations))
        except ParameterError:
            raise
        except Error as error:
            failures.append(str(error))
            continue
        searches.append(search)
    if not searches:
        raise SolveError(
            f"the run fails at the start: {failures[0]}; give another guess, narrower bounds, or "
            "more starts"
        )
    best = min(range(len(searches)), key=lambda i: searches[i].rank)
    return _design(evaluation, searches, best, ends[best], len(failures), max_iterations)


def _scene_of(source: Any) -> SceneDescription:
    """Return the scene of a model, or the argument if it is a scene."""
    if isinstance(source, Model):
        return source.spec.scene
    if not isinstance(source, Scene):
        raise ParameterError(
            f"optimise takes a scene or a compiled model, not {type(source).__name__}: "
            "cotree.load(...) gives a scene"
        )
    return source


def _compiled(source: Any, changed: SceneDescription, over: Sequence[str]) -> Model:
    """Compile a changed scene, with the compiler options of ``source`` if that is a model."""
    if isinstance(source, Model):
        return compile_spec(source.spec.of(changed, over))
    assert isinstance(changed, Scene)
    with without_warnings():  # the caller reports design variables without effect
        return changed.compile(list(over))


def _scenarios(
    common: Settings, runs: Sequence[Mapping[str, Any]] | None, names: Sequence[str]
) -> list[Settings]:
    """Return the settings of each scenario, which replace the common ones."""
    found = []
    if runs is not None and not isinstance(runs, Sequence):
        raise ParameterError(f"runs is {brief(repr(runs))}: give a list of mappings")
    for i, given in enumerate([{}] if runs is None else runs):
        if not isinstance(given, Mapping) or not set(given) <= set(_OF_RUN):
            raise ParameterError(f"run {i + 1} must be a mapping with {listed(_OF_RUN)}")
        more: dict[str, Any] = {
            word: {**common[word], **check_mapping(given.get(word), f"{word} of run {i + 1}")}
            for word in ("parameters", "initial", "inputs")
        }
        found.append(replace(common, **more, t_span=given.get("t_span", common.t_span)))
    if not found:
        raise ParameterError("runs is empty: give at least one scenario")
    for run in found:
        start, end = run.t_span
        if not start < end:
            raise ParameterError(f"t_span goes from {start:g} to {end:g}: the end must be later")
        for name in names:
            if name in run.parameters or name in run.initial:
                raise ParameterError(
                    f"'{name}' is both in 'over' and set for a run: remove one of the two"
                )
    return found


def _known(model: Model, common: Settings) -> dict[str, float]:
    """Return the nominal values of parameters and the initial values of states."""
    known = dict(zip(model.parameters, map(float, model.default_parameters), strict=True))
    try:
        start = scene_start(model.kernels).y
    except Error:  # the nominal values may have no consistent initial state
        start = model.kernels.initial(model.default_parameters)
    known |= dict(zip(model.states, map(float, start), strict=True))
    return {**known, **common.parameters, **common.initial}


def _check_reach(evaluation: Evaluation) -> None:
    """Raise an error for design variables that cannot affect any goal."""
    model, goals = evaluation.model, evaluation.goals
    written = goals.objective.names.union(*(row.excess.names for row in goals.conditions))
    for name in model.kernels.unreached:
        if name in evaluation.over and name not in written:
            raise ParameterError(
                f"nothing depends on '{name}': remove it from over, or use it in the scene"
            )


def _check_objective(search: Descent, start: Any) -> None:
    """Raise an error if the objective does not depend on any design variable."""
    found = search.point(start)
    if isinstance(found, Error) or np.any(found.gradient):
        return
    # The gradient is also zero if the start is an optimum, so test a second point.
    second = search.point(np.asarray(start) * 0.9 + 0.037)
    if not isinstance(second, Error) and not np.any(second.gradient):
        names = listed(f"'{row.name}'" for row in search.space.rows)
        raise ParameterError(
            f"the objective does not change with {names}: vary parameters that affect it, or "
            "minimise another quantity"
        )


def _design(
    evaluation: Evaluation,
    searches: Sequence[Descent],
    best: int,
    end: Any,
    n_failed: int,
    most: int,
) -> Design:
    search = searches[best]
    at = search.best
    assert at is not None
    point = search.known(at)
    values = search.values(at)
    conditions = _conditions(evaluation, search, point)
    holds = all(row.holds for row in conditions)
    is_optimal = search.is_optimal(at, end)
    results = tuple(evaluation.simulate(run, values) for run in evaluation.runs)
    return Design(
        parameters=values,
        objective=point.objective,
        conditions=conditions,
        success=holds and is_optimal,
        message=_message(search, values, conditions, end, most, is_optimal=is_optimal),
        optimality=search.optimality(at),
        violation=search.missed(point),
        history=tuple(row for one in searches for row in one.history),
        starts=(*(one.rank[1] for one in searches), *([float("nan")] * n_failed)),
        results=results,
        model=evaluation.model,
        n_runs=evaluation.n_runs,
    )


def _conditions(
    evaluation: Evaluation, search: Descent, point: DesignPoint
) -> tuple[ConditionValue, ...]:
    rows = evaluation.goals.conditions
    found = []
    for i, excess in enumerate(point.conditions):
        row, run = rows[i % len(rows)], i // len(rows)
        allowed = MET * search.sizes[i]
        holds = search.violations(point)[i] <= allowed
        found.append(
            ConditionValue(
                row.text, run, float(excess), bool(holds), abs(excess) <= allowed, row.is_equality
            )
        )
    return tuple(found)


def _message(
    search: Descent,
    values: Mapping[str, float],
    conditions: Sequence[ConditionValue],
    end: Any,
    most: int,
    *,
    is_optimal: bool,
) -> str:
    work = f"after {end.nit} iterations and {search.evaluation.n_runs} runs"
    missed = [row for row in conditions if not row.holds]
    assert search.best is not None
    optimality = search.optimality(search.best)
    violation = search.missed(search.known(search.best))
    if missed:
        worst = max(missed, key=lambda row: abs(row.excess))
        message = (
            f"No feasible point was found {work}: '{worst.text}' is violated by "
            f"{abs(worst.excess):.4g} at the best point."
        )
    elif is_optimal:
        message = f"Converged {work}: the optimality is {optimality:.1e}."
    else:
        is_limited = end.nit >= most
        reason = (
            f"at the limit max_iterations = {most}"
            if is_limited
            else f"before reaching an optimum ({str(end.message).strip().rstrip('.')})"
        )
        advice = (
            "raise max_iterations, or try another guess"
            if is_limited
            else "try another guess, more starts, tighter integration tolerances, or the other "
            "method"
        )
        message = (
            f"Stopped {work} {reason}: the optimality is {optimality:.1e}, more than "
            f"{OPTIMAL:.0e}, and the largest violation of a constraint {violation:.1e}; "
            f"{advice}."
        )
    space = search.space
    at_bound = [
        f"{row.name} is at its {which} bound"
        for i, row in enumerate(space.rows)
        for which, bound in (("lower", space.lower[i]), ("upper", space.upper[i]))
        if abs(search.best[i] - bound) <= MET
    ]
    active = [
        f"'{row.text}' holds with equality"
        for row in conditions
        if row.is_active and not row.is_equality
    ]
    notes = [*at_bound, *dict.fromkeys(active)]
    failed = sum(bool(row.reason) for row in search.history)
    message += f" {listed(notes)}." if notes else ""
    return message + (
        f" {failed} trial points were rejected because their run failed." if failed else ""
    )
