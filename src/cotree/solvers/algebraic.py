"""Problems with algebraic unknowns, made fit for methods of ordinary differential equations.

In: a ``Problem`` M y' = rhs(t, y), whose last unknowns have no rates but residuals. Out: the
problem x' = f(t, x, z(t, x)) of the others: each evaluation solves for z, beginning with the last
one found. Its sensitivities are those of x; those of z follow, S_z = -g_z^-1 (g_x S_x + g_p).
Every stored value is a solution of the equations to rounding.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cotree.model.algebraic import Algebraic, UnsolvedError

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.solvers.base import FloatArray, Trajectory
    from cotree.solvers.problem import Problem

#: How many solutions are remembered as guesses, and how many of them are tried.
_REMEMBERED, _NEAREST = 200, 3


def solve_reduced(problem: Problem, solve: Callable[[Problem], Trajectory]) -> Trajectory:
    """Integrate a checked problem, after eliminating its algebraic unknowns if it has any."""
    if not problem.n_algebraic:
        return solve(problem)
    trajectory = solve(reduce_problem(problem))
    if trajectory.t.size == 0:  # they were not even found at the start
        return replace(trajectory, z=np.zeros((problem.size, 0)))
    return trajectory


def reduce_problem(problem: Problem) -> Problem:
    """Eliminate the algebraic unknowns of a problem.

    Its stored values are complete again: they hold the algebraic unknowns and their sensitivities.
    """
    reduction = _Reduction(problem)
    cut, project, singular = reduction.cut, problem.project, problem.singular
    # A mask over z lets the positions be counted again in the shorter vector.
    is_left = np.zeros(problem.size)
    is_left[problem.integrated] = 1.0
    return replace(
        problem,
        rhs=reduction.rhs,
        jacobian=reduction.jacobian,
        # Both take the full states, and the reduced problem has fewer.
        state_rhs=None,
        undefined=None,
        n_states=cut,
        n_algebraic=0,
        # Entry by entry, the vectors lose the algebraic unknowns, which come last in each block.
        z0=reduction.without(problem.z0),
        atol=problem.atol if np.ndim(problem.atol) == 0 else np.asarray(problem.atol)[:cut],
        sizes=None if problem.sizes is None else problem.sizes[:cut],
        names=problem.names[:cut],
        # The model's projection takes full states; unknowns that it moves are solved for again.
        project=None
        if project is None
        else lambda t, w: reduction.without(project(t, reduction.widened(w))),
        singular=None if singular is None else lambda t, w: singular(t, reduction.widened(w)),
        complete=reduction.complete,
        residual=reduction.residual,
        constraints=reduction.residual_names,
        # Only methods in C integrate problems with events, and these keep the unknowns or eliminate
        # them in C. Here such a problem is reduced only to examine its Jacobian.
        events=None,
        places=None if problem.places is None else np.flatnonzero(reduction.without(is_left)),
    )


class _Reduction:
    """The callables of a reduced problem; it is mutable and belongs to one integration.

    Attributes
    ----------
    n, cut : int
        Number of states, and of those that have rates.
    """

    def __init__(self, problem: Problem) -> None:
        self.n = problem.n_states
        self.cut = problem.n_states - problem.n_algebraic
        self._problem = problem
        self._n_blocks = 1 + problem.n_sensitivities
        names = problem.names or tuple(f"state {i}" for i in range(self.n))
        jacobian = problem.jacobian
        assert jacobian is not None  # check_problem asks for it
        self._algebraic = Algebraic(_state_rates(problem), jacobian, names, problem.n_algebraic)
        self._z = np.array(problem.z0[self.cut : self.n], dtype=np.float64)
        self._found: deque[tuple[float, FloatArray]] = deque(maxlen=_REMEMBERED)
        self._completed = float(problem.t_span[0])
        self.residual_names = (*problem.constraints, *names[self.cut :])

    def without(self, full: FloatArray) -> FloatArray:
        """Return z without its algebraic unknowns and their sensitivities."""
        blocks: FloatArray = np.asarray(full).reshape(self._n_blocks, self.n)
        return blocks[:, : self.cut].ravel()

    def widened(self, w: FloatArray) -> FloatArray:
        """Return the full z, with the unknowns found last and zeros for their sensitivities."""
        full = np.zeros((self._n_blocks, self.n))
        full[:, : self.cut] = w.reshape(self._n_blocks, self.cut)
        full[0, self.cut :] = self._z
        return full.ravel()

    def rhs(self, t: float, w: FloatArray) -> FloatArray:
        """Give the rates of the states and of their sensitivities.

        Raises
        ------
        UnsolvedError
            If the algebraic unknowns cannot be followed there.
        """
        full = self.widened(w)
        rates = self._follow(t, full[: self.n])
        # Without sensitivities x' = f(t, x, z) is all there is.
        if self._n_blocks == 1:
            return rates[: self.cut]
        along, slopes, matrix = self._sensitivities(t, full)
        # S_x' = f_x S_x + f_z S_z + f_p, of which `along` has all but the term with S_z.
        along[1:, : self.cut] += slopes @ matrix[: self.cut, self.cut :].T
        return along[:, : self.cut].ravel()

    def jacobian(self, t: float, x: FloatArray) -> FloatArray:
        """Give the Jacobian of the states with the algebraic unknowns eliminated."""
        # By the implicit function theorem f_x - f_z g_z^-1 g_x, at solutions of g = 0 only.
        y = np.concatenate([x, self._z])
        self._follow(t, y)
        return self._algebraic.reduced(t, y)

    def complete(self, t: float, w: FloatArray) -> FloatArray:
        """Give states, algebraic unknowns and the sensitivities of both.

        Raises
        ------
        SolveError, SingularSystemError
            As :meth:`Algebraic.solve`.
        """
        full = self.widened(w)
        self._algebraic.solve(t, full[: self.n])
        self._completed = t
        self._z = full[self.cut : self.n].copy()
        self._found.append((t, self._z))
        if self._n_blocks > 1:
            # Sensitivities of z follow from those of x at each point and have no rates.
            slopes = self._sensitivities(t, full)[1]
            full.reshape(self._n_blocks, self.n)[1:, self.cut :] = slopes
        return full

    def residual(self, t: float, full: FloatArray) -> FloatArray:
        """Give what is left of constraints and algebraic equations."""
        # At a breakpoint constraints hold as before it, algebraic equations at that very time.
        left = self._algebraic.residual(self._completed, full[: self.n])
        if self._problem.residual is None:
            return left
        return np.concatenate([self._problem.residual(t, full), left])

    def _follow(self, t: float, y: FloatArray) -> FloatArray:
        """Solve for the algebraic unknowns, in place, from other guesses if the first one fails."""
        try:
            rates = self._algebraic.follow(t, y)
        except UnsolvedError:
            rates = self._approach(t, y)
        self._z = y[self.cut :].copy()
        self._found.append((t, self._z))
        return rates

    def _approach(self, t: float, y: FloatArray) -> FloatArray:
        """Solve from the last values, then from those found at the nearest times.

        The last ones may belong to a step that was refused, far ahead.
        """
        nearest = sorted(self._found, key=lambda item: abs(item[0] - t))
        for guess in (self._z, *(z for _, z in nearest[:_NEAREST])):
            y[self.cut :] = guess
            try:
                return self._algebraic.approach(t, y)
            except UnsolvedError as error:
                failure = error
        raise failure

    def _sensitivities(
        self, t: float, full: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Give the rates where those of the algebraic unknowns are zero, these, and the Jacobian.

        The rates are blocks, shape (1 + m, n), a fresh array; the sensitivities, shape (m, n_z).
        """
        # `widened` has set S_z to zero, so the last entries of each block are g_x S_x + g_p.
        along = np.array(self._problem.rhs(t, full)).reshape(self._n_blocks, self.n)
        matrix, linear = self._algebraic.linearised(t, full[: self.n])
        return along, -linear.solve(along[1:, self.cut :].T).T, matrix


def _state_rates(problem: Problem) -> Callable[[float, FloatArray], FloatArray]:
    """Give the rates of the states alone as a function."""
    if problem.state_rhs is not None:
        return problem.state_rhs
    n, z = problem.n_states, np.zeros(problem.size)

    def rates(t: float, y: FloatArray) -> FloatArray:
        z[:n] = y
        return problem.rhs(t, z)[:n]

    return rates
