"""Guarded calls of the right-hand side and the Jacobian during one integration.

z contains the states y and their sensitivities s_p. Its Jacobian has the state Jacobian J in each
diagonal block and, below the first block, the second derivatives d(J s_p + f_p)/dy, which are
differences of the right-hand side. Without these, Newton's method needs one more iteration, because
its error is nilpotent. SciPy's BDF and Radau allow 4 and 6 iterations, and would take up to a
hundred times as many steps on Robertson's problem. In IDA, sensitivities outside the error test
would have errors of 20 %.
"""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import SingularSystemError, SolveError
from cotree.solvers.budgets import time_spent
from cotree.solvers.problem import DENSE_LIMIT, RunProblem, Tolerances, describe_entry
from cotree.solvers.result import BUDGET_SPENT, FAILED
from cotree.tolerances import SAME

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.solvers.result import FloatArray


_ROOT_EPS = float(np.sqrt(np.finfo(np.float64).eps))


def assemble_dense(first: FloatArray, n_states: int) -> FloatArray:
    """Return the dense Jacobian of z from its first columns, (size, n_states).

    ``first`` has the derivatives of z' with respect to the states; all diagonal blocks equal J.
    """
    matrix = np.asarray(np.kron(np.eye(len(first) // n_states), first[:n_states]), np.float64)
    matrix[:, :n_states] = first
    return matrix


def assemble_sparse(first: FloatArray, n_states: int) -> Any:
    """Return the matrix of :func:`assemble_dense` in SciPy's CSC form."""
    from scipy.sparse import csc_matrix, hstack, identity, kron

    blocks = kron(identity(len(first) // n_states), first[:n_states], format="csc")
    return hstack([csc_matrix(first), blocks[:, n_states:]], format="csc")


def difference_columns(
    problem: RunProblem, rhs: Callable[[FloatArray], FloatArray], z: FloatArray
) -> FloatArray:
    """Approximate the derivatives of z' with respect to the states by forward differences."""
    rtol, atol = augmented_tolerances(problem)
    middle = rhs(z)
    columns = np.empty((problem.size, problem.n_states))
    for j in range(problem.n_states):
        # As in SUNDIALS, the increment is at least the tolerance of the state. Smaller increments
        # would increase the rounding error of the difference quotient.
        y = abs(z[j])
        shifted = z.copy()
        shifted[j] += max(_ROOT_EPS * y, rtol * y + atol[j])
        # Division by the rounded increment avoids its rounding error.
        columns[:, j] = (rhs(shifted) - middle) / (shifted[j] - z[j])
    return columns


def augmented_tolerances(problem: RunProblem) -> tuple[float, FloatArray]:
    """Return the relative tolerance and the absolute ones, shape (..., len(problem.integrated))."""
    tolerances = Tolerances(problem)
    return tolerances.rtol_of(problem), tolerances.of(problem)


class IntegrationStopError(Exception):
    """Raised in a callback to stop the solver; the trajectory then has a failure status."""

    def __init__(self, status: int, reason: str) -> None:
        super().__init__(reason)
        self.status, self.reason = status, reason


class Evaluator:
    """Counted and guarded calls of the functions of one integration.

    ``not_finite`` names the first value that was not finite since the last accepted step.
    """

    def __init__(self, problem: RunProblem) -> None:
        self.problem = problem
        self.nfev = 0
        self.njev = 0
        self.not_finite = ""
        self._last_jacobian: Any = None
        # Until the first segment starts, evaluations may use the whole time span.
        self._bounds = sorted(problem.settings.t_span)
        self._deadline = math.inf
        if problem.settings.time_limit is not None:
            rest = problem.settings.time_limit - problem.seconds_taken
            self._deadline = time.perf_counter() + rest
        # Evaluations per step are limited, because SciPy's step loops do not end if the step size
        # becomes nan. A step needs tens of evaluations, or as many as z has entries if the solver
        # computes the Jacobian by differences.
        self._per_step = 10_000 + 100 * problem.size
        self._allowed = self._per_step

    def open_segment(self, start: float, end: float) -> None:
        """Restrict evaluations to the times within a segment between two breakpoints."""
        # Rates may jump at the ends of a segment. If stages evaluated them beyond such a jump, the
        # error test would reject all steps. The margin covers the rounding of times.
        low, high = self.problem.settings.t_span
        size = max(abs(start), abs(end), self.problem.scale)
        margin = min(SAME * size, 0.25 * abs(end - start))
        margin = math.copysign(margin, end - start)
        sharp = self.problem.breakpoints
        first = start if start == low and low not in sharp else start + margin
        last = end if end == high and high not in sharp else end - margin
        self._bounds = sorted((first, last))

    def step_done(self) -> None:
        """Reset the limit of evaluations for the next step."""
        self._allowed = self.nfev + self._per_step

    def rhs(self, t: float, z: FloatArray) -> FloatArray:
        """Return the derivative of z as a new array."""
        dz = self._call(t, z)
        # The dot product is not finite if an entry is nan or infinite, but it may also overflow.
        if not math.isfinite(dz.dot(dz)) and not self.not_finite:
            self._remember(t, z, dz)
        return dz

    def inside(self, t: float) -> float:
        """Return the time nearest to t within the segment; see :meth:`open_segment`."""
        low, high = self._bounds
        return min(max(float(t), low), high)

    def state_jacobian(self, t: float, z: FloatArray) -> FloatArray:
        """Return the state Jacobian or, if an entry is not finite, the last finite one.

        Raises IntegrationStopError if there is none.
        """
        self.njev += 1
        n_states = self.problem.n_states
        if self.problem.jacobian is None:
            matrix = self._differences(t, z)[:n_states]
        else:
            matrix = self._evaluate(self.problem.jacobian, t, z[:n_states])
        checked: FloatArray = self._checked(t, np.array(matrix, dtype=np.float64))
        return checked

    def sparse_jacobian(self, t: float, z: FloatArray) -> Any:
        """Return the state Jacobian in SciPy's CSC form; see :attr:`RunProblem.sparse_jacobian`."""
        assert self.problem.sparse_jacobian is not None
        self.njev += 1
        point = z[: self.problem.n_states]
        return self._checked(t, self._evaluate(self.problem.sparse_jacobian, t, point))

    def first_columns(self, t: float, z: FloatArray) -> FloatArray:
        """Return the derivatives of z' with respect to the states, shape (size, n_states)."""
        n_states = self.problem.n_states
        if not self.problem.n_sensitivities:
            return self.state_jacobian(t, z)
        columns = self._differences(t, z)
        if self.problem.jacobian is None:
            self.njev += 1
            columns[:n_states] = self._checked(t, columns[:n_states])
        else:
            columns[:n_states] = self.state_jacobian(t, z)
        # The other rows are second derivatives. They only accelerate the iteration, so entries that
        # are not finite are replaced by zero.
        columns[~np.isfinite(columns)] = 0.0
        return columns

    def augmented_jacobian(self, t: float, z: FloatArray, *, is_dense: bool) -> Any:
        """Return the Jacobian of z, in SciPy's CSC form if that is cheaper and allowed."""
        if self.problem.is_sparse and not is_dense:
            return self.sparse_jacobian(t, z)
        # With many sensitivities most entries are zero, so a sparse matrix is cheaper.
        is_long = self.problem.n_sensitivities and self.problem.size > DENSE_LIMIT
        assemble = assemble_sparse if is_long and not is_dense else assemble_dense
        return assemble(self.first_columns(t, z), self.problem.n_states)

    def _call(self, t: float, z: FloatArray) -> FloatArray:
        self.nfev += 1
        # Copied, because solvers keep references to returned arrays and kernels reuse buffers.
        dz = np.array(self._evaluate(self.problem.rhs, t, z), dtype=np.float64)
        if dz.shape != z.shape:
            raise SolveError(
                f"The right-hand side returned shape {dz.shape} where {z.shape} is needed."
            )
        return dz

    def _evaluate(
        self, function: Callable[[float, FloatArray], Any], t: float, z: FloatArray
    ) -> Any:
        """Call a function; stop the run if the function is undefined or a limit is reached."""
        limit = self.problem.settings.time_limit
        if limit is not None and time.perf_counter() > self._deadline:
            raise IntegrationStopError(BUDGET_SPENT, time_spent(limit))
        if self.nfev > self._allowed:
            raise IntegrationStopError(FAILED, "the step size control does not come to an end")
        try:
            return function(self.inside(t), np.ascontiguousarray(z, dtype=np.float64))
        except SingularSystemError as error:  # the model is singular at this point
            raise IntegrationStopError(FAILED, str(error)) from None

    def _differences(self, t: float, z: FloatArray) -> FloatArray:
        point = np.array(z, dtype=np.float64)
        return difference_columns(self.problem, lambda shifted: self._call(t, shifted), point)

    def _checked(self, t: float, matrix: Any) -> Any:
        n_states = self.problem.n_states
        if matrix.shape != (n_states, n_states):
            raise SolveError(
                f"The Jacobian has shape {matrix.shape} where ({n_states}, {n_states}) is needed."
            )
        entries = matrix if isinstance(matrix, np.ndarray) else matrix.data
        if np.all(np.isfinite(entries)):
            self._last_jacobian = matrix.copy()
            return matrix
        row, column = _first_not_finite(matrix)
        of, by = describe_entry(self.problem, row), describe_entry(self.problem, column)
        entry = f"the Jacobian entry of {of} and {by}"
        phrase = f"{entry} is {matrix[row, column]} at t = {float(t):.10g}"
        if self._last_jacobian is None:
            raise IntegrationStopError(FAILED, phrase)
        # A trial step may leave the domain of the equations. The last finite Jacobian only slows
        # the iteration; if the right-hand side is not finite either, the solver shortens the step.
        self.not_finite = self.not_finite or phrase
        return self._last_jacobian.copy()

    def _remember(self, t: float, z: FloatArray, dz: FloatArray) -> None:
        indices = np.flatnonzero(~np.isfinite(dz))
        if indices.size:
            index = int(indices[0])
            self.not_finite = (
                f"the derivative of {describe_entry(self.problem, index)} is {dz[index]} "
                f"at t = {float(t):.10g}"
            )
            if self.problem.undefined is not None:
                why = self.problem.undefined(self.inside(t), z[: self.problem.n_states])
                self.not_finite += f" ({why})" if why else ""


def _first_not_finite(matrix: Any) -> tuple[int, int]:
    """Return row and column of an entry that is not finite in a dense or sparse matrix."""
    if isinstance(matrix, np.ndarray):
        row, column = np.argwhere(~np.isfinite(matrix))[0]
    else:
        place = np.flatnonzero(~np.isfinite(matrix.data))[0]
        # In CSC form, an entry belongs to the last column that does not start after it.
        row, column = matrix.indices[place], np.searchsorted(matrix.indptr, place, "right") - 1
    return int(row), int(column)
