"""Rates at which the modes of a problem decay and grow: the eigenvalues of its Jacobian.

In: a ``Problem`` and points of its motion. Out: rates in 1/s, which reveal stiff problems.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import SingularSystemError, SolveError
from cotree.model.algebraic import Algebraic, UnsolvedError
from cotree.solvers.evaluate import Evaluator, IntegrationStopError

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from cotree.solvers.base import FloatArray
    from cotree.solvers.problem import Problem

# Number of eigenvalues sought of a sparse Jacobian, and their tolerance: only their size counts.
_FEW = 6
_ROUGH = 1e-2

# Most restarts of the iteration. Eigenvalues that stand apart need a few; the slow modes of a long
# ladder lie so close together that their order would take ten thousand.
_MOST_RESTARTS = 200


def fastest_decay(problem: Problem, points: Sequence[tuple[float, FloatArray]]) -> float:
    """Return the largest decay rate among modes that decay faster than they oscillate, [1/s].

    Parameters
    ----------
    problem : Problem
        The problem whose modes are examined.
    points : sequence of (float, ndarray)
        Times, [s], and states with sensitivities there.
    """
    modes = _modes(problem, points, problem.direction)
    # Modes with |Im| > -Re oscillate faster than they decay.
    return float(np.max(-modes[np.abs(modes.imag) <= -modes.real].real, initial=0.0))


def bound_of_decay(problem: Problem, t: float, z: FloatArray) -> float:
    """Return an upper bound of the rates at which modes decay at a point, [1/s].

    It is the Frobenius norm of the Jacobian, which no eigenvalue exceeds in size; infinity where it
    is not known, or its unknowns have to be eliminated first. It takes a small part of the time of
    eigenvalues.

    Parameters
    ----------
    problem, t, z
        As for :func:`fastest_growth`.
    """
    # Unknowns would have to be eliminated, and where constraints depend on each other it is large.
    if problem.n_algebraic or problem.singular is not None or problem.jacobian is None:
        return math.inf
    y = z[: problem.n_states]
    try:
        if problem.sparse_jacobian is not None:
            entries = problem.sparse_jacobian(t, y).data
        else:
            entries = np.asarray(problem.jacobian(t, y)).ravel()
    except (SingularSystemError, SolveError):
        return math.inf
    square = float(entries.dot(entries))
    return math.sqrt(square) if math.isfinite(square) else math.inf


def fastest_growth(problem: Problem, t: float, z: FloatArray) -> float:
    """Return the largest rate at which a mode grows at a point, [1/s]; 0 where none is found.

    Parameters
    ----------
    problem : Problem
        The problem whose modes are examined.
    t : float
        Time, [s].
    z : ndarray
        States with sensitivities there.
    """
    # Modes that grow decay when the integration runs the other way.
    modes = _modes(problem, [(t, z)], -problem.direction)
    return float(np.max(-modes.real, initial=0.0))


def largest_decaying(problem: Problem, t: float, z: FloatArray) -> float:
    """Return the size of the largest eigenvalue among modes that decay, however slowly, [1/s].

    Parameters
    ----------
    problem, t, z
        As for :func:`fastest_growth`.
    """
    modes = _modes(problem, [(t, z)], problem.direction)
    return float(np.max(np.abs(modes), initial=0.0))


def _modes(
    problem: Problem, points: Sequence[tuple[float, FloatArray]], way: float
) -> npt.NDArray[np.complex128]:
    """Return the eigenvalues, at all points, of modes that decay in a direction of time."""
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
    # Modes that grow forwards in time decay when they are integrated backwards.
    eigenvalues = way * _eigenvalues(matrix, way, way == problem.direction)
    return eigenvalues[eigenvalues.real < 0.0]


def _reduced(evaluator: Evaluator, t: float, z: FloatArray) -> FloatArray:
    """Return the Jacobian of the states whose algebraic unknowns are eliminated."""
    problem = evaluator.problem
    assert problem.state_rhs is not None  # of a compiled model
    assert problem.jacobian is not None
    unknowns = Algebraic(problem.state_rhs, problem.jacobian, problem.names, problem.n_algebraic)
    y, inside = np.array(z[: problem.n_states]), evaluator.inside(t)
    # By the implicit function theorem, which holds at solutions only.
    unknowns.follow(inside, y)
    return unknowns.reduced(inside, y)


def _eigenvalues(matrix: Any, direction: float, is_bounded: bool) -> npt.NDArray[np.complex128]:
    """Return the eigenvalues; for a sparse matrix, a few of those that decay fastest.

    Where the iteration for these does not converge, the smaller of the matrix's 1-norm and infinity
    norm stands in for them if a bound is wanted; otherwise none are returned.
    """
    if isinstance(matrix, np.ndarray):
        return np.asarray(np.linalg.eigvals(matrix), dtype=np.complex128)
    import scipy.sparse.linalg

    start = np.random.default_rng(0).normal(size=matrix.shape[0])  # the same at every run
    # ARPACK's names for the smallest and the largest real parts: forwards in time modes with the
    # smallest ones decay fastest, backwards those with the largest.
    which = "SR" if direction > 0 else "LR"
    try:
        found = scipy.sparse.linalg.eigs(
            matrix,
            k=_FEW,
            which=which,
            v0=start,
            tol=_ROUGH,
            maxiter=_MOST_RESTARTS,
            return_eigenvectors=False,
        )
    except scipy.sparse.linalg.ArpackNoConvergence:
        if not is_bounded:
            return np.zeros(0, dtype=np.complex128)
        # Each of these norms is an upper bound of every eigenvalue's modulus.
        rows = abs(matrix).sum(axis=1).max()
        columns = abs(matrix).sum(axis=0).max()
        found = np.array([-direction * min(rows, columns)])
    return np.asarray(found, dtype=np.complex128)
