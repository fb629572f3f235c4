"""Choose a method for a problem, and integrate.

In: a ``Problem`` and a method's name or "auto". Out: the method with its reason, or the
``Trajectory``.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.solvers.algebraic import reduce_problem, solve_reduced
from cotree.solvers.engine import load_engine
from cotree.solvers.evaluate import Evaluator, IntegrationStopError
from cotree.solvers.methods import method_row, solver_for
from cotree.solvers.native import compiled_in, refusal
from cotree.solvers.problem import check_problem

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from cotree.solvers.base import Trajectory
    from cotree.solvers.problem import FloatArray, Problem

# DOP853 is stable up to about |lambda| h = 6 with 12 evaluations a step. At this number of time
# constants in the span its evaluations, 4000, equal those of an implicit method at usual
# tolerances.
_STIFF_TIME_CONSTANTS = 2000.0

# Beyond it, factors that are kept for many steps win over eight stages that are cheap.
_MOST_STATES = 150

_PROBE_STEPS = 20
_PROBE_RTOL = 1e-3

# Eigenvalues of a sparse Jacobian that are looked for, and how exactly: only their size counts.
_FEW = 6
_ROUGH = 1e-2


def integrate(problem: Problem, method: str = "auto") -> Trajectory:
    """Integrate a problem with a named or chosen method.

    Parameters
    ----------
    problem : Problem
        What to integrate.
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
    if method != "auto":
        return _solve(problem, method)
    check_problem(problem)
    before = time.perf_counter()
    if not refusal("dop853", problem):
        load_engine("dop853")
    compiling = time.perf_counter() - before
    chosen, reason = choose_method(problem)
    trajectory = _solve(problem, chosen)
    trajectory = compiled_in(trajectory, trajectory.statistics.compile_seconds + compiling)
    return dataclasses.replace(trajectory, message=f"{trajectory.message} {reason}")


def _solve(problem: Problem, method: str) -> Trajectory:
    """Integrate; SciPy's methods need algebraic unknowns eliminated."""
    if method_row(method).family != "scipy":
        return solver_for(method).solve(problem)
    check_problem(problem)
    return solve_reduced(problem, solver_for(method).solve)


def choose_method(problem: Problem) -> tuple[str, str]:
    """Choose a method by the fastest decay at the start and after a few steps.

    Strongly damped modes whose time constant is a small part of the span force explicit methods
    to steps that accuracy does not ask for. Modes that oscillate faster than they decay do not
    count: accuracy needs short steps for them with any method. Stiffness that appears later than
    the probed steps is not seen; name a method in such cases.

    Parameters
    ----------
    problem : Problem
        What to integrate.

    Returns
    -------
    method : str
        "dop853" or, where the problem is stiff, "rodas5"; where C cannot take it, "DOP853", and
        "cvode", or "BDF" without scikit-sundae. These take stiff problems of many states, too,
        and of loops, which "rodas5" does not bring through singular configurations.
    reason : str
        One sentence.

    Raises
    ------
    SolveError
        If the problem cannot be accepted.
    """
    check_problem(problem)
    if problem.n_states == problem.n_algebraic:
        return "DOP853", "There are no states to integrate."
    explicit = "DOP853" if refusal("dop853", problem) else "dop853"
    span = abs(problem.t_span[1] - problem.t_span[0])
    count = span * _fastest_decay(problem, _probe(problem, explicit))
    length = f"the span is {float(f'{count:.2g}'):.6g} times the shortest decay"
    if count <= _STIFF_TIME_CONSTANTS:
        reason = f"not stiff, {length}" if count >= 1.0 else "not stiff, nothing decays fast"
        return explicit, f"{explicit} was chosen: {reason}."
    method = "cvode" if importlib.util.find_spec("sksundae") is not None else "BDF"
    is_wide = problem.n_states > _MOST_STATES and not problem.n_algebraic
    if problem.singular is None and not is_wide and not refusal("rodas5", problem):
        method = "rodas5"
    return method, f"{method} was chosen: stiff, {length}."


def _probe(problem: Problem, method: str) -> list[tuple[float, FloatArray]]:
    """Return the start and a point a few loose steps later, without algebraic unknowns."""
    probe = dataclasses.replace(
        problem, t_eval=None, rtol=max(problem.rtol, _PROBE_RTOL), max_steps=_PROBE_STEPS
    )
    trajectory = _solve(probe, method)
    if not trajectory.t.size:
        return []
    n, cut = problem.n_states, problem.n_states - problem.n_algebraic
    points = trajectory.z.reshape(-1, n, trajectory.t.size)[:, :cut]
    return [(float(trajectory.t[i]), points[:, :, i].ravel()) for i in (0, -1)]


def _fastest_decay(problem: Problem, points: Sequence[tuple[float, FloatArray]]) -> float:
    """Return the largest decay rate among modes that decay faster than they oscillate, [1/s]."""
    evaluator = Evaluator(reduce_problem(problem) if problem.n_algebraic else problem)
    rates = [_decay_at(evaluator, t, z) for t, z in points]
    return max(rates, default=0.0)


def _decay_at(evaluator: Evaluator, t: float, z: FloatArray) -> float:
    """Return the largest decay rate at a point."""
    problem = evaluator.problem
    try:
        if problem.sparse_jacobian is not None:
            matrix = evaluator.sparse_jacobian(t, z)
        else:
            matrix = evaluator.state_jacobian(t, z)
    except IntegrationStopError:
        return 0.0
    # Integrated backwards in time, what grows forwards decays.
    eigenvalues = problem.direction * _eigenvalues(matrix, problem.direction)
    decays = -eigenvalues.real[np.abs(eigenvalues.imag) <= np.abs(eigenvalues.real)]
    return float(np.max(decays, initial=0.0))


def _eigenvalues(matrix: Any, direction: float) -> npt.NDArray[np.complex128]:
    """Return the eigenvalues, of a sparse matrix a few of those that decay fastest.

    Where the iteration for these does not converge, the sums of the entries' sizes bound them.
    """
    if isinstance(matrix, np.ndarray):
        return np.asarray(np.linalg.eigvals(matrix), dtype=np.complex128)
    import scipy.sparse.linalg

    start = np.random.default_rng(0).normal(size=matrix.shape[0])  # the same at every run
    which = "SR" if direction > 0 else "LR"
    try:
        found = scipy.sparse.linalg.eigs(
            matrix, k=_FEW, which=which, v0=start, tol=_ROUGH, return_eigenvectors=False
        )
    except scipy.sparse.linalg.ArpackNoConvergence:
        rows = abs(matrix).sum(axis=1).max()
        columns = abs(matrix).sum(axis=0).max()
        found = np.array([-direction * min(rows, columns)])
    return np.asarray(found, dtype=np.complex128)
