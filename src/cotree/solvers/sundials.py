"""SUNDIALS' CVODE and IDA.

In: a ``Problem``. Out: a ``Trajectory``. Where C can drive them, :mod:`cotree.solvers.bdf` does.
Else they run through scikit-sundae's own interface, one step at a time, and statistics say so.
Their outputs come from the polynomials that they step with, which are as accurate as the steps:
stopping at outputs costs more and gains nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import SolveError
from cotree.quiet import without_output, without_warnings
from cotree.solvers.algebraic import solve_reduced
from cotree.solvers.augmented import DENSE_LIMIT, augmented_tolerances, diagonal_blocks
from cotree.solvers.bdf import solve_in_c
from cotree.solvers.drive import drive
from cotree.solvers.first_step import first_step
from cotree.solvers.problem import check_problem

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType

    import numpy.typing as npt

    from cotree.solvers.base import Trajectory
    from cotree.solvers.evaluate import Evaluator
    from cotree.solvers.problem import FloatArray, Problem


@dataclass(frozen=True)
class SundialsSolver:
    """CVODE or IDA.

    Attributes
    ----------
    method : str
        "cvode" or "ida".
    """

    method: str

    def solve(self, problem: Problem) -> Trajectory:
        """Integrate a problem.

        Raises
        ------
        SolveError
            If scikit-sundae is not installed, or the problem cannot be accepted.
        """
        _sksundae(self.method)
        check_problem(problem)
        found = solve_in_c(problem, self.method)
        if not isinstance(found, str):
            return found
        trajectory = solve_reduced(problem, lambda p: drive(p, self.method, self._start))
        if not found:  # a problem of Python's own
            return trajectory
        through = f"scikit-sundae's Python interface: {found}"
        statistics = replace(trajectory.statistics, through=through)
        message = f"{trajectory.message} {self.method} ran through {through}."
        return replace(trajectory, message=message, statistics=statistics)

    def _start(
        self, evaluator: Evaluator, t: float, z: FloatArray, t_end: float
    ) -> SundialsStepper:
        def make(t: float, z: FloatArray) -> Any:
            if self.method == "cvode":
                return _make_cvode(evaluator, t, z)
            return _make_ida(evaluator, t, z, t_end)

        return SundialsStepper(make, t, z)


class SundialsStepper:
    """A CVODE or IDA object between two breakpoints."""

    lands = False
    has_memory = True
    nlu = 0

    def __init__(self, make: Callable[[float, FloatArray], Any], t: float, z: FloatArray) -> None:
        self.t = t
        self.z = z
        self._make = make
        self._solver = make(t, z)
        self._has_interpolated = False

    def step(self, t_bound: float) -> str:
        """Take one step, not past ``t_bound``."""
        if self._has_interpolated:
            # After an interpolation SUNDIALS first returns the end of the last step once more.
            self._has_interpolated = False
            self._advance(t_bound)
        answer = self._advance(t_bound)
        if answer.status < 0:
            return f"SUNDIALS says: {answer.message.rstrip('.').lower()}"
        self.t, self.z = float(answer.t), np.asarray(answer.y, dtype=np.float64)
        return ""

    def interpolate(self, t: float) -> FloatArray:
        """Return the values at a time inside the last step."""
        self._has_interpolated = True
        return np.asarray(self._solver.step(t, "normal", None).y, dtype=np.float64)

    def replace(self, z: FloatArray, dz: FloatArray) -> None:
        """Start anew from other values."""
        self.z = z
        self._solver = self._make(self.t, z)
        self._has_interpolated = False

    def _advance(self, t_bound: float) -> Any:
        # scikit-sundae prints what SUNDIALS says of an error; the message has it already.
        with without_output():
            return self._solver.step(t_bound, "onestep", t_bound)


@dataclass(frozen=True, eq=False)
class _Pattern:
    """The pattern of a sparse Jacobian with the whole diagonal, which iterations add to.

    Attributes
    ----------
    options : dict
        What SUNDIALS is told of it.
    entries, diagonal : ndarray of int
        Places of the Jacobian's own entries, and of the diagonal, among the pattern's.
    """

    options: dict[str, Any]
    entries: npt.NDArray[np.intp]
    diagonal: npt.NDArray[np.intp]

    @classmethod
    def of(cls, matrix: Any) -> _Pattern:
        from scipy.sparse import csc_matrix, identity

        n = matrix.shape[0]
        own = csc_matrix((np.ones_like(matrix.data), matrix.indices, matrix.indptr), matrix.shape)
        whole = csc_matrix(own + 2.0 * identity(n, format="csc"))
        whole.sort_indices()
        return cls(
            {"linsolver": "sparse", "sparsity": whole},
            np.flatnonzero(whole.data != 2.0),
            np.flatnonzero(whole.data >= 2.0),
        )


def _make_cvode(evaluator: Evaluator, t: float, z: FloatArray) -> Any:
    def rhs(t: float, z: FloatArray, dz: FloatArray) -> None:
        dz[:] = evaluator.rhs(t, z)

    def dense(t: float, z: FloatArray, dz: FloatArray, matrix: FloatArray) -> None:
        matrix[:] = evaluator.dense_jacobian(t, z)

    def banded(t: float, z: FloatArray, dz: FloatArray, matrix: FloatArray) -> None:
        # The memory starts as zeros and is the solver's own; only the blocks are ever written.
        blocks = diagonal_blocks(matrix, evaluator.problem.n_states)
        blocks[...] = evaluator.state_jacobian(t, z)

    options = _options(evaluator.problem)
    options["jacfn"] = banded if options["linsolver"] == "band" else dense
    if evaluator.problem.is_sparse:
        pattern = _Pattern.of(evaluator.sparse_jacobian(t, z))
        options |= pattern.options

        def sparse(t: float, z: FloatArray, dz: FloatArray, values: FloatArray) -> None:
            values[:] = 0.0
            values[pattern.entries] = evaluator.sparse_jacobian(t, z).data

        options["jacfn"] = sparse
    solver = _made(_sksundae("cvode").CVODE, rhs, options)
    solver.init_step(t, z)
    return solver


def _make_ida(evaluator: Evaluator, t: float, z: FloatArray, t_end: float) -> Any:
    problem = evaluator.problem
    own = np.eye(problem.n_states)

    def residual(t: float, z: FloatArray, dz: FloatArray, result: FloatArray) -> None:
        result[:] = dz - evaluator.rhs(t, z)

    def dense(
        t: float, z: FloatArray, dz: FloatArray, result: FloatArray, cj: float, matrix: FloatArray
    ) -> None:
        np.negative(evaluator.dense_jacobian(t, z), out=matrix)
        matrix.flat[:: len(z) + 1] += cj

    def banded(
        t: float, z: FloatArray, dz: FloatArray, result: FloatArray, cj: float, matrix: FloatArray
    ) -> None:
        blocks = diagonal_blocks(matrix, problem.n_states)
        blocks[...] = cj * own - evaluator.state_jacobian(t, z)

    options = _options(problem)
    options["jacfn"] = banded if options["linsolver"] == "band" else dense
    tolerances = options["rtol"], options["atol"]
    if t_end > t:  # scikit-sundae takes none backwards
        options["first_step"] = first_step(evaluator, t, z, t_end, tolerances)
    if problem.is_sparse:
        pattern = _Pattern.of(evaluator.sparse_jacobian(t, z))
        options |= pattern.options

        def sparse(
            t: float,
            z: FloatArray,
            dz: FloatArray,
            result: FloatArray,
            cj: float,
            values: FloatArray,
        ) -> None:
            values[:] = 0.0
            values[pattern.entries] = -evaluator.sparse_jacobian(t, z).data
            values[pattern.diagonal] += cj

        options["jacfn"] = sparse
    solver = _made(_sksundae("ida").IDA, residual, options)
    solver.init_step(t, z, evaluator.rhs(t, z))
    return solver


def _made(make: Any, function: Any, options: dict[str, Any]) -> Any:
    # It says that the pattern is not used for differences, which nobody asked for.
    with without_warnings("Custom sparse Jacobian"):
        return make(function, **options)


def _options(problem: Problem) -> dict[str, Any]:
    rtol, atol = augmented_tolerances(problem)
    options: dict[str, Any] = {"rtol": rtol, "atol": atol, "linsolver": "dense"}
    if np.isfinite(problem.max_step):
        options["max_step"] = problem.max_step
    # Without the blocks below the first the matrix is banded, and is factored block by block as
    # such. The iterations that this costs are only made where the sensitivities are tested.
    is_large = problem.n_sensitivities > 0 and problem.size > DENSE_LIMIT
    if is_large and problem.places is None and problem.error_test_sensitivities:
        width = problem.n_states - 1
        options |= {"linsolver": "band", "lband": width, "uband": width}
    return options


def _sksundae(module: str) -> ModuleType:
    import importlib

    try:
        return importlib.import_module(f"sksundae.{module}")
    except ImportError as error:
        raise SolveError(
            f"The method '{module}' needs SUNDIALS: run `pip install scikit-sundae`, or use "
            "'BDF', 'Radau' or 'LSODA'."
        ) from error
