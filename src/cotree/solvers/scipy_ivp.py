"""SciPy's methods, driven one step at a time.

In: a ``Problem``. Out: a ``Trajectory``. The solver classes are used in place of ``solve_ivp``,
which interpolates at every output whatever the interpolant is worth, and has no budget.
"""

from __future__ import annotations

import contextlib
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.solvers.augmented import augmented_tolerances
from cotree.solvers.drive import drive
from cotree.solvers.first_step import first_step
from cotree.solvers.messages import ROUNDING_LEVEL
from cotree.solvers.methods import METHODS
from cotree.solvers.problem import check_problem

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cotree.solvers.base import Trajectory
    from cotree.solvers.evaluate import Evaluator
    from cotree.solvers.problem import FloatArray, Problem

# These interpolants are weaker than the steps: order 4 against 5, 7 against 8, 3 against 5. On
# x' = x cos t at rtol = 1e-9 the error between steps is 15, 30 and 160 times that of the steps.
# Shortening a step costs less than it seems: these methods have no memory to rebuild, and with 100
# outputs of slider-pendulum at rtol = 1e-12 the evaluations grow by 2, 13 and 0 per cent.
# RK23's cubic and the polynomials that BDF and LSODA step with are as good as their steps.
_LANDING = frozenset({"RK45", "DOP853", "Radau"})

_one_at_a_time = threading.RLock()


# The cosine of corrections that go against what is left, and how much shorter a step is then.
_TURNED, _SHORTER = 0.7, 0.2

# Steps of so few units in the last place get nowhere.
_STEPS_OF_ROUNDING = 16


@dataclass(frozen=True)
class ScipySolver:
    """One of SciPy's initial value methods.

    Attributes
    ----------
    method : str
        "RK45", "DOP853", "RK23", "Radau", "BDF" or "LSODA".
    """

    method: str

    def solve(self, problem: Problem) -> Trajectory:
        """Integrate a problem.

        Raises
        ------
        SolveError
            If the problem cannot be accepted.
        """
        check_problem(problem)
        with _alone(self.method):
            return drive(problem, self.method, self._start)

    def _start(self, evaluator: Evaluator, t: float, z: FloatArray, t_end: float) -> ScipyStepper:
        return ScipyStepper(self.method, evaluator, t, z, t_end)


@contextlib.contextmanager
def _alone(method: str) -> Iterator[None]:
    """Keep other threads out where a method has one state in the whole process."""
    from scipy.integrate import _ode

    # LSODA was Fortran with common blocks once; SciPy counted its users then.
    if method == "LSODA" and hasattr(_ode.lsoda, "active_global_handle"):
        with _one_at_a_time:
            yield
    else:
        yield


class ScipyStepper:
    """A SciPy solver object between two breakpoints."""

    def __init__(
        self, method: str, evaluator: Evaluator, t: float, z: FloatArray, t_end: float
    ) -> None:
        self.lands = method in _LANDING
        self.has_memory = METHODS[method].multistep
        self.t = t
        self.z = z
        self._method = method
        self._evaluator = evaluator
        self._t_end = t_end
        self._nlu_before = 0
        self._interpolant: Any = None  # of the last step: DOP853's costs three evaluations
        self._solver = self._make()

    @property
    def nlu(self) -> int:
        """Return the number of factorisations so far."""
        return self._nlu_before + int(self._solver.nlu)

    def step(self, t_bound: float) -> str:
        """Take one step, not past ``t_bound``."""
        while True:
            t, z = self.t, self.z
            reason = self._try_step(t_bound)
            if reason or self._method != "Radau" or not self._is_turned(t, z):
                return reason
            first = _SHORTER * abs(self.t - t)
            self.t, self.z = t, z
            if first <= _STEPS_OF_ROUNDING * np.spacing(abs(self.t)):
                return ROUNDING_LEVEL
            self._nlu_before = self.nlu
            self._solver = self._make(first)

    def _is_turned(self, t: float, z: FloatArray) -> bool:
        """Tell whether a step is short of what its rates ask for because a mode grows fast.

        Newton's method corrects by what is left of the equations, solved with I - h J / 2 or its
        like. Where modes decay that goes the same way; with a mode that grows it goes the other
        way, is as small, and nothing is seen to be left.
        """
        solver = self._solver
        step = self.t - t
        left = 0.5 * step * (self._rates + solver.f) - (self.z - z)
        size = np.maximum(np.abs(z), np.abs(self.z))
        weights = 1.0 / (solver.atol + solver.rtol * size)
        seen = np.abs(left * weights) > 1.0
        if not np.any(seen):
            return False
        solved = _solve(solver.J, 0.5 * step, left)
        pair = (left * weights)[seen], (solved * weights)[seen]
        return bool(np.vdot(*pair) < -_TURNED * np.linalg.norm(pair[0]) * np.linalg.norm(pair[1]))

    def _try_step(self, t_bound: float) -> str:
        solver = self._solver
        self._rates = getattr(solver, "f", self.z)
        self._interpolant = None
        if self.lands:
            # The one-step methods read the bound afresh at each step. LSODA copies it at the
            # start and BDF rescales its history at each, so theirs is never moved.
            solver.t_bound = t_bound
            solver.status = "running"
        try:
            message = solver.step()
        except (RuntimeError, ValueError) as error:
            # SuperLU and the checks before LAPACK raise these; any other error is the user's own.
            if not str(error).endswith(("exactly singular", "infs or NaNs")):
                raise
            return "the iteration matrix is singular or not finite"
        if solver.status != "failed":
            # LSODA in some versions of SciPy steps on in the same array.
            self.t, self.z = float(solver.t), np.array(solver.y, dtype=np.float64)
            return ""
        if message == solver.TOO_SMALL_STEP:
            return ROUNDING_LEVEL
        return "the solver gave up on its step"

    def interpolate(self, t: float) -> FloatArray:
        """Return the values at a time inside the last step."""
        if self._interpolant is None:
            self._interpolant = self._solver.dense_output()
        return np.asarray(self._interpolant(t), dtype=np.float64)

    def replace(self, z: FloatArray, dz: FloatArray) -> None:
        """Go on from other values; a method with a memory starts anew."""
        self.z = z
        self._interpolant = None
        if self.has_memory and self.t != self._t_end:
            self._nlu_before = self.nlu
            self._solver = self._make()
        elif not self.has_memory:
            # The derivative at the end of a step is the first stage of the next one.
            self._solver.t, self._solver.y, self._solver.f = self.t, z, dz

    def _make(self, opening: float | None = None) -> Any:
        import scipy.integrate

        evaluator = self._evaluator
        rtol, atol = augmented_tolerances(evaluator.problem)
        options: dict[str, Any] = {"max_step": evaluator.problem.max_step}
        if self._method in ("Radau", "BDF"):
            options |= {"jac": evaluator.sized_jacobian, "first_step": opening}
        elif self._method == "LSODA":
            options["jac"] = evaluator.dense_jacobian
            options["first_step"] = first_step(evaluator, self.t, self.z, self._t_end, (rtol, atol))
        return getattr(scipy.integrate, self._method)(
            evaluator.rhs, self.t, self.z, self._t_end, rtol=rtol, atol=atol, **options
        )


def _solve(jacobian: Any, share: float, left: FloatArray) -> FloatArray:
    """Solve with I - share J; zeros where that is singular."""
    try:
        if isinstance(jacobian, np.ndarray):
            matrix = np.eye(len(left)) - share * jacobian
            return np.asarray(np.linalg.solve(matrix, left), dtype=np.float64)
        from scipy.sparse import csc_matrix, identity
        from scipy.sparse.linalg import splu

        sparse = csc_matrix(identity(len(left), format="csc") - share * jacobian)
        return np.asarray(splu(sparse).solve(left), dtype=np.float64)
    except (np.linalg.LinAlgError, RuntimeError):
        return np.zeros_like(left)
