"""Stiffness: rates of the modes of a problem, and the switch to a method for stiff problems.

The coefficients of the time estimates were fitted to 20 networks of 6 to 200 species with up to 20
sensitivities (``benchmarks/stiff_choice.py``). Estimates are 0.6 to 1.3 times the measured times.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import SingularSystemError, UnsolvedError
from cotree.solvers.engine import has_sundials
from cotree.solvers.guarded_calls import Evaluator, IntegrationStopError
from cotree.solvers.problem import beyond_scipy, refusal
from cotree.solvers.result import Drift, FloatArray, Statistics, Trajectory

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from cotree.codegen.newton import StepWork
    from cotree.solvers.problem import RunProblem


# Number of computed eigenvalues of a sparse Jacobian, and their relative tolerance, which is loose
# because only their magnitudes matter.
_FEW = 6
_ROUGH = 1e-2

# Maximum number of restarts of the eigenvalue iteration. Well separated eigenvalues need a few
# restarts; the clustered slow modes of a long ladder network would need ten thousand.
_MOST_RESTARTS = 200


def fastest_decay(problem: RunProblem, points: Sequence[tuple[float, FloatArray]]) -> float:
    """Return the largest decay rate, [1/s], of modes that decay faster than they oscillate."""
    modes = _modes(problem, points, problem.direction)
    # If |Im| > -Re, a mode oscillates faster than it decays.
    return float(np.max(-modes[np.abs(modes.imag) <= -modes.real].real, initial=0.0))


def fastest_growth(problem: RunProblem, t: float, z: FloatArray) -> float:
    """Return the largest growth rate of a mode at a point, [1/s], or zero if no mode grows."""
    # Integration backwards in time turns growth into decay.
    modes = _modes(problem, [(t, z)], -problem.direction)
    return float(np.max(-modes.real, initial=0.0))


def _modes(
    problem: RunProblem, points: Sequence[tuple[float, FloatArray]], way: float
) -> npt.NDArray[np.complex128]:
    """Return the eigenvalues of decaying modes at all points; ``way`` = -1: backwards in time."""
    evaluator = Evaluator(problem)
    return np.concatenate([np.zeros(0), *(_modes_at(evaluator, t, z, way) for t, z in points)])


def _modes_at(
    evaluator: Evaluator, t: float, z: FloatArray, way: float
) -> npt.NDArray[np.complex128]:
    problem = evaluator.problem
    try:
        if problem.n_algebraic:
            matrix = _reduced(evaluator, t, z)
        elif problem.sparse_jacobian is not None:
            matrix = evaluator.sparse_jacobian(t, z)
        else:
            matrix = evaluator.state_jacobian(t, z)
    except (IntegrationStopError, UnsolvedError, SingularSystemError):
        return np.zeros(0, dtype=np.complex128)
    # Modes that grow forwards in time decay backwards in time.
    eigenvalues = way * _eigenvalues(matrix, way, way == problem.direction)
    return eigenvalues[eigenvalues.real < 0.0]


def _reduced(evaluator: Evaluator, t: float, z: FloatArray) -> FloatArray:
    """Return the state Jacobian after elimination of the algebraic unknowns."""
    from cotree.model.algebraic import Algebraic

    problem = evaluator.problem
    assert problem.state_rhs is not None  # compiled models have rates
    assert problem.jacobian is not None
    unknowns = Algebraic(problem.state_rhs, problem.jacobian, problem.names, problem.n_algebraic)
    y, inside = np.array(z[: problem.n_states]), evaluator.inside(t)
    # The elimination is valid only if the algebraic equations are satisfied.
    unknowns.follow(inside, y)
    return unknowns.reduced(inside, y)


def _eigenvalues(matrix: Any, direction: float, is_bounded: bool) -> npt.NDArray[np.complex128]:
    """Return the eigenvalues; for a sparse matrix, only a few with the fastest decay.

    If the iteration does not converge, return the smaller of the 1-norm and the infinity norm if
    ``is_bounded``, and otherwise no eigenvalues.
    """
    if isinstance(matrix, np.ndarray):
        return np.asarray(np.linalg.eigvals(matrix), dtype=np.complex128)
    import scipy.sparse.linalg

    start = np.random.default_rng(0).normal(size=matrix.shape[0])  # the same vector in every run
    # ARPACK's SR selects the smallest real parts, whose modes decay fastest forwards in time; LR
    # selects the largest ones, for backwards in time.
    which = "SR" if direction > 0 else "LR"
    try:
        options = {"v0": start, "tol": _ROUGH, "maxiter": _MOST_RESTARTS}
        found = scipy.sparse.linalg.eigs(
            matrix, k=_FEW, which=which, return_eigenvectors=False, **options
        )
    except scipy.sparse.linalg.ArpackNoConvergence:
        if not is_bounded:
            return np.zeros(0, dtype=np.complex128)
        # Both norms are upper bounds of the magnitudes of all eigenvalues.
        rows = abs(matrix).sum(axis=1).max()
        columns = abs(matrix).sum(axis=0).max()
        found = np.array([-direction * min(rows, columns)])
    return np.asarray(found, dtype=np.complex128)


# Number of cvode steps per rodas5 step at equal error. Medians for the networks above, at errors
# from 1e-3 to 1e-9, are 2.3 to 2.9; the middle half of the values is between 1.6 and 3.5.
_STEPS = 2.5

# Stages of rodas5; number of sensitivities that it solves for at once if elimination is in loops.
_STAGES, _AT_A_TIME = 8, 8

# Per cvode step: evaluations of the rates, evaluations with sensitivities, and linear solutions of
# each block.
_RATES, _ALL, _SOLUTIONS = 1.6, 1.3, 1.5

# With sensitivities, cvode factorises in each step if this takes at most this number of
# multiplications (FEW_MULTIPLICATIONS in C); otherwise in every tenth step.
_FEW_MULTIPLICATIONS, _SELDOM = 8000, 0.1


def share_of_rodas5(problem: RunProblem) -> float | None:
    """Estimate the time of rodas5 divided by that of cvode; return None if costs are unknown."""
    work = None if problem.native is None else problem.native.model.code.step_work()
    if work is None:
        return None
    n, m = problem.n_states, problem.n_sensitivities
    return _of_rodas5(work, m) / (_STEPS * _of_cvode(work, n, m))


def _of_rodas5(work: StepWork, m: int) -> float:
    evaluation = 0.43 * (work.augmented if m else work.rates)
    if work.is_unrolled:
        solution = 1.1 * work.n_factors * (1 + m)
        factorisation = 0.5 * work.n_products
    else:
        # One solution serves the states, and one serves each group of sensitivities.
        solution = 2.2 * work.n_factors * (1 - (-m // _AT_A_TIME))
        factorisation = 0.19 * work.n_products
    own = 300.0 + factorisation + 0.5 * work.jacobian
    return own + _STAGES * (evaluation + solution)


def _of_cvode(work: StepWork, n: int, m: int) -> float:
    evaluation = 0.25 * (_RATES * work.rates + (_ALL * work.augmented if m else 0.0))
    solution = 0.34 * _SOLUTIONS * work.n_banded * (1 + m)
    is_fresh = m > 0 and work.n_banded_products <= _FEW_MULTIPLICATIONS
    factorisation = 0.32 * work.n_banded_products * (1.0 if is_fresh else _SELDOM)
    # Vector operations of SUNDIALS: prediction, error test and history.
    vectors = 27.0 * n * (1 + m)
    return 600.0 + evaluation + solution + factorisation + vectors


# With more states, cvode is cheaper than rodas5, because it reuses its factors.
_MOST_STATES = 150

# Maximum number of breakpoints with cvode: after each, a multistep method takes about thirty short
# steps, while a whole run takes hundreds.
_MOST_BREAKPOINTS = 3

# The integrator detects stiffness by finite differences, which rounding may disturb. Stiffness is
# confirmed if a mode of the Jacobian reaches this fraction of the stability limit.
_CONFIRMED = 0.5

# An event function counts as zero within this number of absolute tolerances. A method that starts
# there may locate the same event again, or an event of a value that remains zero.
_AT_ZERO = 10.0


def stiff_method(problem: RunProblem) -> str:
    """Return the name of the method for a stiff problem, by default "rodas5".

    The method is "cvode" if a run then costs less, if there are many states, or if there are loops,
    whose singular configurations "rodas5" cannot pass. If scikit-sundae is not installed, "BDF"
    replaces "cvode", or a C method if SciPy's methods do not support the problem.
    """
    is_wide = problem.n_states > _MOST_STATES and not problem.n_algebraic
    if problem.singular is None and not is_wide and not refusal("rodas5", problem):
        return "cvode" if cost_of_rodas5(problem) > 1.0 else "rodas5"
    if has_sundials():
        return "cvode"
    if not beyond_scipy(problem):
        return "BDF"
    return "rodas5" if not refusal("rodas5", problem) else "dop853"


def cost_of_rodas5(problem: RunProblem) -> float:
    """Return the estimated time of "rodas5" divided by that of "cvode", or zero without "cvode".

    "cvode" is not considered for problems with events, many breakpoints or projections, because
    multistep methods restart with order one after each. It is not considered for algebraic unknowns
    either, which it would solve for at each evaluation.
    """
    # Runs that locate events or kinks may restart often.
    locates = problem.events is not None or (problem.has_kinks and problem.direction > 0)
    has_restarts = locates or len(problem.breakpoints) > _MOST_BREAKPOINTS
    is_wide = problem.n_states > _MOST_STATES  # planning the elimination would take long
    if has_restarts or is_wide or problem.n_algebraic or problem.held is not None:
        return 0.0
    if not has_sundials() or refusal("cvode", problem):
        return 0.0
    return share_of_rodas5(problem) or 0.0


def is_confirmed(problem: RunProblem, t: float, z: FloatArray, step: float, method: str) -> bool:
    """Return whether stability limits the step size of an explicit method at (t, z), [s]."""
    from cotree.codegen.tableaus import TABLEAUS

    # The method is stable for decaying modes up to |lambda| h = bound.
    bound = float(TABLEAUS[method].stable)
    sizes = np.abs(_modes(problem, [(t, z)], problem.direction))
    return step * float(np.max(sizes, initial=0.0)) >= _CONFIRMED * bound


def obstacle(problem: RunProblem, t: float, z: FloatArray, method: str) -> str:
    """Return the reason why no other method can start at a point, or an empty string."""
    if problem.events is None:
        return ""
    point = replace(problem.events, t=t)
    values = np.abs(point.event_values(*point.parts(z)))
    near = np.flatnonzero(values <= _AT_ZERO * float(np.min(problem.settings.atol)))
    if not near.size:
        return ""
    name = problem.events.event_rows[int(near[0])].name
    return (
        f"{method} continued, although the problem is stiff at t = {t:.6g}: the function of event "
        f"'{name}' is zero there, where no other method can start."
    )


def rest(problem: RunProblem, first: Trajectory, t: float, z: FloatArray) -> RunProblem | None:
    """Return the problem for the rest of a run, or None if a limit is reached."""
    own = problem.settings
    wanted = own.t_eval
    if wanted is not None:
        wanted = wanted[len(first.t) :]
        # If no requested time remains, the end of the span is requested.
        wanted = wanted if len(wanted) else np.array([own.t_span[1]])
    work, steps, events, limit = first.statistics, None, None, None
    taken = problem.steps_taken + work.n_steps
    # The remaining steps are only tested here, not stored: `steps_taken` includes these steps.
    if own.max_steps is not None:
        steps = own.max_steps - taken
    if own.max_events is not None:
        events = own.max_events - len(first.events)
    if own.time_limit is not None:
        limit = own.time_limit - work.seconds
    if any(left is not None and left <= 0 for left in (steps, events, limit)):
        return None
    rest = problem.with_settings(
        t_span=(t, own.t_span[1]), t_eval=wanted, max_events=events, time_limit=limit
    )
    return replace(rest, z0=z, steps_taken=taken)


def joined(problem: RunProblem, first: Trajectory, second: Trajectory) -> Trajectory:
    """Join two trajectories, the second of which begins at the end of the first."""
    skipped = 0
    if problem.settings.t_eval is None:
        # If all steps are stored, the second trajectory repeats the last point of the first.
        skipped = int(bool(first.t.size and second.t.size and first.t[-1] == second.t[0]))
    elif len(first.t) == len(problem.settings.t_eval) and second.status == 0:
        skipped = len(second.t)  # only the end of the span, which was not requested
    t, z, drift = second.t[skipped:], second.z[:, skipped:], second.drift
    if first.drift is not None and drift is not None:
        residual = np.hstack([first.drift.residual, drift.residual[:, skipped:]])
        drift = Drift(drift.names, residual, max(first.drift.correction, drift.correction))
    return replace(
        second,
        t=np.concatenate([first.t, t]),
        z=np.hstack([first.z, z]),
        statistics=summed(first.statistics, second.statistics),
        drift=drift,
        # An array without events may lack columns, so it cannot be stacked.
        events=np.vstack([first.events, second.events]) if len(first.events) else second.events,
    )


def summed(first: Statistics, second: Statistics) -> Statistics:
    """Return the total work of two integrations of one run."""
    names = ("nfev", "njev", "nlu", "n_steps", "seconds", "compile_seconds")
    work = {name: getattr(first, name) + getattr(second, name) for name in names}
    return replace(second, began_with=first.method, **work)
