"""Choose a method for a problem, and integrate.

In: a ``Problem`` and a method's name or "auto". Out: the method with its reason, or the
``Trajectory``.
"""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cotree.errors import SolveError
from cotree.records import changed
from cotree.solvers.corners import corner_times
from cotree.solvers.engine import load_engine
from cotree.solvers.evaluate import FAILED
from cotree.solvers.integration_loop import IN_C, beyond_scipy, solve_with_scipy
from cotree.solvers.methods import method_row, refusal
from cotree.solvers.native import check_available, compiled_in, solve_in_c
from cotree.solvers.problem import check_problem
from cotree.solvers.stiffness_probe import fastest_decay, fastest_growth
from cotree.solvers.stiffness_switching import Succession, cost_of_rodas5, stiff_method
from cotree.solvers.sundials_library import has_sundials

if TYPE_CHECKING:
    from cotree.solvers.base import FloatArray, Trajectory
    from cotree.solvers.methods import Method
    from cotree.solvers.problem import Problem

# DOP853 is stable up to about |lambda| h = 6 with 12 evaluations a step. At this number of time
# constants in the span its evaluations, 4000, equal those of an implicit method at usual
# tolerances.
_STIFF_TIME_CONSTANTS = 2000.0

# An explicit method may begin where modes decay at most so many times as fast as the fastest one
# grows: steps that follow the growth are then not much longer than stability allows.
_MILD = 10.0

_PROBE_STEPS = 20
_PROBE_RTOL = 1e-3


def integrate(problem: Problem, method: str = "auto") -> Trajectory:
    """Integrate a problem with a named or chosen method.

    Parameters
    ----------
    problem : Problem
        The problem to integrate.
    method : str
        A name in ``methods.METHODS``, or "auto".

    Returns
    -------
    Trajectory
        A failed integration is a value with status != 0. The message of a chosen method ends with
        the reason of the choice.

    Raises
    ------
    SolveError
        If the method is unknown or not installed, or the problem cannot be accepted.
    """
    check_problem(problem)
    return run(problem, method)


def run(problem: Problem, method: str) -> Trajectory:
    """Integrate a problem that was checked; see :func:`integrate`."""
    if method != "auto":
        return _solve(problem, method)
    before = time.perf_counter()
    # The choice below probes with this engine: its compilation is counted apart from the run.
    if not refusal("dop853", problem):
        load_engine("dop853")
    compiling = time.perf_counter() - before
    chosen, reason = _choose(problem)
    trajectory = _solve_watched(problem, chosen)
    trajectory = compiled_in(trajectory, trajectory.statistics.compile_seconds + compiling)
    return changed(trajectory, message=f"{trajectory.message} {reason}")


def _solve_watched(problem: Problem, method: str) -> Trajectory:
    """Integrate, and let a method for stiff problems take over where one becomes stiff."""
    row = method_row(method)
    # Only the explicit steppers of the engine watch the stability of their steps.
    if row.family != "cotree" or row.implicit:
        return _solve(problem, method)
    return _solve(problem, method, Succession(_solve))


def _solve(problem: Problem, method: str, successor: Succession | None = None) -> Trajectory:
    """Integrate a checked problem with a named method, or with the one that stands in for it."""
    row = method_row(method)
    if not row.stepper:
        return solve_with_scipy(problem, method)
    check_available(method)
    found = solve_in_c(problem, method, successor)
    if isinstance(found, str):
        return _stand_in(problem, row, found)
    if found.status != FAILED or problem.singular is None or beyond_scipy(problem):
        return found
    # Around SciPy's methods Python crosses singular positions with a looser tolerance.
    # What C did counts in the budget.
    taken = problem.steps_taken + found.statistics.n_steps
    left = changed(problem, steps_taken=taken)
    return _stand_in(left, row, found.message.rstrip("."))


def _stand_in(problem: Problem, row: Method, why: str) -> Trajectory:
    """Integrate with another method where C cannot run the one that was asked for, and say so.

    Raises
    ------
    SolveError
        If nothing stands in, or the problem has what only methods in C take, and none of them can.
    """
    what, other, method = beyond_scipy(problem), row.instead, row.name
    if row.family == "correctors":
        raise SolveError(
            f"The method '{method}' cannot take this problem: {why}. "
            f"Use '{other}', which takes states and sensitivities as one vector."
        )
    # Rosenbrock methods, for which "Radau" stands in, are the only ones with a substitute in C.
    if what and (problem.native is None or other != "Radau"):
        raise SolveError(
            f"The method '{method}' cannot run: {why}. '{other}', which stands in for it, cannot "
            f"take {what}: {IN_C}."
        )
    if what:  # Rosenbrock's stages are off constraints that depend on each other
        other = "cvode" if has_sundials() else "dopri5"
    trajectory = _solve(problem, other)
    message = f"{trajectory.message} {other} stood in for {method}: {why}."
    return changed(trajectory, message=message)


def choose_method(problem: Problem) -> tuple[str, str]:
    """Choose a method by the fastest decay at the start and after a few steps.

    Strongly damped modes whose time constant is a small part of the span force explicit methods
    to steps that accuracy does not ask for. Modes that oscillate faster than they decay do not
    count: accuracy needs short steps for them with any method. Stiffness that appears later than
    the probed steps is seen by "dop853" itself; see :mod:`cotree.solvers.stiffness_switching`.

    Modes that grow at the start, from below the tolerance to where they decide, are damped by the
    long steps of methods for stiff problems, whose error estimates cannot see them: there an
    explicit method begins where it can, and the reason says so where it cannot.

    Parameters
    ----------
    problem : Problem
        The problem to integrate.

    Returns
    -------
    method : str
        "dop853" or, where the problem is stiff, "rodas5", or "cvode" where that takes less time by
        the counts of its steps; where C cannot take it, "DOP853", and "cvode", or "BDF" without
        scikit-sundae. These take stiff problems of many states, too, and of loops, which "rodas5"
        does not bring through singular configurations.
    reason : str
        One sentence.

    Raises
    ------
    SolveError
        If the problem cannot be accepted.
    """
    check_problem(problem)
    return _choose(problem)


def _choose(problem: Problem) -> tuple[str, str]:
    """Choose a method for a problem that was checked; see :func:`choose_method`."""
    # Any method does: only the algebraic unknowns are solved for at each stored time.
    if problem.n_states == problem.n_algebraic:
        return "DOP853", "There are no states to integrate."
    explicit = "DOP853" if refusal("dop853", problem) else "dop853"
    span = abs(problem.t_span[1] - problem.t_span[0])
    rates = _rates(problem, explicit)
    # The number of time constants of the fastest damped mode in the span.
    count = span * rates.decay
    length = f"the span is {float(f'{count:.2g}'):.6g} times the shortest decay"
    if count <= _STIFF_TIME_CONSTANTS:
        reason = f"not stiff, {length}" if count >= 1.0 else "not stiff, nothing decays fast"
        return explicit, f"{explicit} was chosen: {reason}."
    method = stiff_method(problem)
    growth = rates.growth
    # A mode that begins at the tolerance and grows e-fold this often stays below one: an implicit
    # method may damp it and the result is still as good as the tolerance.
    if span * growth <= math.log(1.0 / _smallest_tolerance(problem)):
        return method, f"{method} was chosen: stiff, {length}{_saving(problem, method)}."
    grows = f"at the start a mode grows e-fold every {1.0 / growth:.3g} s"
    if explicit == "dop853" and rates.first_decay <= _MILD * growth:
        return explicit, (
            f"{explicit} was chosen to begin with: stiff, {length}, but {grows}, which {method} "
            "would damp while it is below the tolerance."
        )
    return method, (
        f"{method} was chosen: stiff, {length}. But {grows}: what is below the tolerance there "
        "may decide the result, so compare with that of a tighter one."
    )


def _saving(problem: Problem, method: str) -> str:
    """Say that rodas5 would take longer, where that is why another method was chosen."""
    cost = cost_of_rodas5(problem) if method == "cvode" else 0.0
    return f", and rodas5 would take about {cost:.2g} times as long" if cost > 1.0 else ""


class Rates(NamedTuple):
    """Rates of the modes that a choice follows from, [1/s].

    The fastest decay at the start and after a few steps, the one at the start alone, and the
    fastest growth there; the latter two are sought where the first makes the problem stiff.
    """

    decay: float
    first_decay: float = 0.0
    growth: float = 0.0


def _rates(problem: Problem, explicit: str) -> Rates:
    """Find the rates; once for the same numbers, where runs of a model share what they find."""
    native, shared = problem.native, problem.shared
    if native is None or shared is None:
        return _find_rates(problem, explicit)
    return shared.finding(lambda: _find_rates(problem, explicit), native.model.p, problem.z0)


def _find_rates(problem: Problem, explicit: str) -> Rates:
    points = _probe(problem, explicit)
    decay = fastest_decay(problem, points)
    if abs(problem.t_span[1] - problem.t_span[0]) * decay <= _STIFF_TIME_CONSTANTS:
        return Rates(decay)
    first = fastest_decay(problem, points[:1])
    return Rates(decay, first, fastest_growth(problem, *points[0]))


def _smallest_tolerance(problem: Problem) -> float:
    """Give the smaller of both tolerances, at least a rounding unit."""
    return max(min(problem.rtol, problem.least_atol), float(np.finfo(np.float64).eps))


def _probe(problem: Problem, method: str) -> list[tuple[float, FloatArray]]:
    """Return the start and a point a few loose steps later, without algebraic unknowns."""
    span = problem.t_span
    if problem.reach is not None:
        # Samples are taken by the run itself, from states that are as accurate as it is.
        span = corner_times(problem)[0], corner_times(problem)[1]
    rtol = max(problem.rtol, _PROBE_RTOL)
    probe = changed(problem, t_eval=None, rtol=rtol, max_steps=_PROBE_STEPS, t_span=span)
    trajectory = _solve(probe, method)
    if not trajectory.t.size:
        return []
    # The examined problem is the reduced one, whose blocks end before the algebraic unknowns.
    n, cut = problem.n_states, problem.n_states - problem.n_algebraic
    points = trajectory.z.reshape(-1, n, trajectory.t.size)[:, :cut]
    return [(float(trajectory.t[i]), points[:, :, i].ravel()) for i in (0, -1)]
