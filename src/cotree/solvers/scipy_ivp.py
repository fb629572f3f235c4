"""SciPy's methods, one step at a time.

In: rates and Jacobians. Out: a stepper between two breakpoints, which
:mod:`cotree.solvers.integration_loop` advances. SciPy's solver classes are used in place of
``solve_ivp``, which interpolates at every output whatever the interpolant is worth, and has no
budget.
"""

from __future__ import annotations

import contextlib
import math
import threading
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.model.linear import solve_with
from cotree.solvers.augmented import augmented_tolerances
from cotree.solvers.first_step import first_step
from cotree.solvers.messages import ROUNDING_LEVEL
from cotree.solvers.methods import METHODS
from cotree.tolerances import LIMITS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cotree.solvers.base import FloatArray
    from cotree.solvers.evaluate import Evaluator

# These interpolants are weaker than the steps: order 4 against 5, 7 against 8, 3 against 5. On
# x' = x cos t at rtol = 1e-9 the error between steps is 15, 30 and 160 times that of the steps.
# Shortening a step costs less than it seems: these methods have no memory to rebuild, and with 100
# outputs of slider-pendulum at rtol = 1e-12 the evaluations grow by 2, 13 and 0 per cent.
# RK23's cubic and the polynomials that BDF and LSODA step with are as good as their steps.
_LANDING = frozenset({"RK45", "DOP853", "Radau"})

_one_at_a_time = threading.RLock()

# The cosine of corrections that go against what is left, and how much shorter a step is then.
_TURNED, _SHORTER = LIMITS.opposed_cosine, 0.2

# Steps of so few units in the last place get nowhere.
_STEPS_OF_ROUNDING = LIMITS.stall_spacings

# A rounding of t below this share of the relative tolerance of a step is not felt.
_FINE = 1e-2


@contextlib.contextmanager
def alone(method: str) -> Iterator[None]:
    """Keep other threads out if a method has only one state in the whole process."""
    from scipy.integrate import _ode

    # LSODA was Fortran with common blocks once; SciPy counted its users then.
    if method == "LSODA" and hasattr(_ode.lsoda, "active_global_handle"):
        with _one_at_a_time:
            yield
    else:
        yield


class Idle:
    """The stepper of a problem without states, which SciPy does not accept."""

    lands = True
    has_memory = False
    nlu = 0

    def __init__(self, t: float, z: FloatArray) -> None:
        self.t, self.z = t, z

    def step(self, t_bound: float) -> str:
        """Move to the bound at once; see :meth:`ScipyStepper.step`."""
        self.t = t_bound
        return ""

    def interpolate(self, t: float) -> FloatArray:
        """Return z, which never changes between replacements."""
        return self.z

    def replace(self, z: FloatArray, dz: FloatArray) -> None:
        """Go on from other values."""
        self.z = z


class ScipyStepper:
    """A SciPy solver object between two breakpoints.

    The solver object has a time of its own, which begins at zero: late in a run the rounding of t
    would add up over its steps, and be longer than its first ones; an autonomous motion does not
    depend on t at all. It integrates the entries of z that do not vanish.

    Parameters
    ----------
    method : str
        "RK45", "DOP853", "RK23", "Radau", "BDF" or "LSODA".
    evaluator : Evaluator
        Gives rates and Jacobians.
    t : float
        Start, [s].
    z : ndarray
        Values there.
    t_end : float
        End of the segment, [s].

    Attributes
    ----------
    t : float
        Time reached, [s]. Where it differs from the solver's own by a rounding that is felt, ``z``
        is that at the rounded time.
    z : ndarray
        Values there; the array is never changed afterwards.
    lands : bool
        Whether steps end on outputs, because the method's interpolant is weaker than its steps.
    has_memory : bool
        Whether steps build on those before, so that ``replace`` costs a new start.
    """

    def __init__(
        self, method: str, evaluator: Evaluator, t: float, z: FloatArray, t_end: float
    ) -> None:
        self.lands = method in _LANDING
        self.has_memory = METHODS[method].multistep
        self.t, self.z = t, z
        self._method, self._evaluator = method, evaluator
        self._places = evaluator.problem.integrated
        self._origin, self._length = t, t_end - t
        # Where the solver's last two steps ended, in its own time, and what it integrates there.
        self._before = self._now = 0.0
        self._w = self._packed(z)
        self._nlu_before = 0
        self._interpolant: Any = None  # of the last step: DOP853's costs three evaluations
        self._solver = self._make()

    @property
    def nlu(self) -> int:
        """Return the number of factorisations so far."""
        return self._nlu_before + int(self._solver.nlu)

    def step(self, t_bound: float) -> str:
        """Take one step, not past ``t_bound``; return a reason if that fails, else ""."""
        bound, before = t_bound - self._origin, self._now
        reason = self._step_on(bound)
        if reason:
            return reason
        self._before = before
        self.t, self.z = t_bound, self._whole(self._w)
        if self._now != bound:
            self._round(t_bound)
        return ""

    def interpolate(self, t: float) -> FloatArray:
        """Return the values at a time inside the last step."""
        if self._interpolant is None:
            self._interpolant = self._solver.dense_output()
        low, high = sorted((self._before, self._now))
        # Subtracting the origin rounds, which may lead just outside of the step.
        inside = min(max(t - self._origin, low), high)
        return self._whole(np.asarray(self._interpolant(inside), dtype=np.float64))

    def replace(self, z: FloatArray, dz: FloatArray) -> None:
        """Go on from other values at the time reached, where the derivative is ``dz``.

        A method with a memory starts anew. The interpolant of the step before is lost.
        """
        # The new values are those at the rounded time, so the solver's own time moves there.
        if self._is_felt():
            self._now = self.t - self._origin
        self.z, self._w = z, self._packed(z)
        self._interpolant = None
        if self.has_memory and self._now != self._length:
            self._nlu_before = self.nlu
            self._solver = self._make()
        elif not self.has_memory:
            # The derivative at the end of a step is the first stage of the next one.
            solver = self._solver
            solver.t, solver.y, solver.f = self._now, self._w, self._packed(dz)

    def _packed(self, z: FloatArray) -> FloatArray:
        """Return z without the entries that vanish at all times."""
        left: FloatArray = z[self._places]
        return left

    def _whole(self, w: FloatArray) -> FloatArray:
        """Return z with zeros in the places of these entries."""
        z = np.zeros(self._evaluator.problem.size)
        z[self._places] = w
        return z

    def _rates(self, s: float, w: FloatArray) -> FloatArray:
        """Give the rates of what is integrated, at the solver's own time."""
        return self._packed(self._evaluator.rhs(self._origin + s, self._whole(w)))

    def _jacobian(self, s: float, w: FloatArray) -> Any:
        """Give the derivatives of these rates, sparse if cheaper and the method takes that."""
        is_full = self._method == "LSODA"
        form = self._evaluator.dense_jacobian if is_full else self._evaluator.sized_jacobian
        matrix, places = form(self._origin + s, self._whole(w)), self._places
        if self._evaluator.problem.places is None:
            return matrix
        if isinstance(matrix, np.ndarray):
            return np.ascontiguousarray(matrix[np.ix_(places, places)])
        return matrix[places][:, places]

    def _round(self, t_bound: float) -> None:
        """Round the time of a step that ends before its bound."""
        origin = self._origin
        self.t = origin + self._now
        # The rounded time must not lie beyond the step, where there is no value, nor at the bound,
        # which the step has not reached.
        is_ahead = abs(self.t - origin) > abs(self._now) or (self.t - t_bound) * self._now >= 0.0
        if is_ahead:
            self.t = math.nextafter(self.t, origin)
        if self._is_felt():
            self.z = self.interpolate(self.t)

    def _is_felt(self) -> bool:
        """Tell whether a time differs from its rounding by more than a step notices."""
        rounding = abs(self.t - self._origin - self._now)
        return rounding > _FINE * self._evaluator.problem.rtol * abs(self._now - self._before)

    def _step_on(self, bound: float) -> str:
        """Have the solver take a step, and a shorter one if the first cannot be right."""
        while True:
            now, w = self._now, self._w
            reason = self._try_step(bound)
            if reason or self._method != "Radau" or not self._is_turned(now, w):
                return reason
            first = _SHORTER * abs(self._now - now)
            self._now, self._w = now, w
            if first <= _STEPS_OF_ROUNDING * np.spacing(abs(now)):
                return ROUNDING_LEVEL
            self._nlu_before = self.nlu
            self._solver = self._make(first)

    def _is_turned(self, now: float, w: FloatArray) -> bool:
        """Tell whether a step is short of what its rates ask for because a mode grows fast.

        Newton's method corrects by what is left of the equations, solved with I - h J / 2 or its
        like. Where modes decay that goes the same way; with a mode that grows it goes the other
        way, is as small, and nothing is seen to be left.
        """
        solver = self._solver
        step = self._now - now
        # What the trapezoidal rule asks for beyond the step that was taken.
        left = 0.5 * step * (self._rates_before + solver.f) - (self._w - w)
        size = np.maximum(np.abs(w), np.abs(self._w))
        weights = 1.0 / (solver.atol + solver.rtol * size)
        # What is below the tolerance may point anywhere.
        seen = np.abs(left * weights) > 1.0
        if not np.any(seen):
            return False
        solved = _solve(solver.J, 0.5 * step, left)
        pair = (left * weights)[seen], (solved * weights)[seen]
        return bool(np.vdot(*pair) < -_TURNED * np.linalg.norm(pair[0]) * np.linalg.norm(pair[1]))

    def _try_step(self, bound: float) -> str:
        solver = self._solver
        # Read for Radau only; LSODA and BDF keep no rates and get a placeholder.
        self._rates_before = getattr(solver, "f", self._w)
        self._interpolant = None
        if self.lands:
            # The one-step methods read the bound afresh at each step. LSODA copies it at the
            # start and BDF rescales its history at each, so theirs is never moved.
            solver.t_bound = bound
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
            self._now, self._w = float(solver.t), np.array(solver.y, dtype=np.float64)
            return ""
        if message == solver.TOO_SMALL_STEP:
            return ROUNDING_LEVEL
        return "the solver gave up on its step"

    def _make(self, opening: float | None = None) -> Any:
        import scipy.integrate

        longest = self._evaluator.problem.max_step
        rtol, atol = augmented_tolerances(self._evaluator.problem)
        options: dict[str, Any] = {"rtol": rtol, "atol": atol, "max_step": longest}
        if METHODS[self._method].implicit:
            options |= {"jac": self._jacobian, "first_step": opening}
        # Its own first step is a share of the span, which fails where nothing moves yet.
        if self._method == "LSODA":
            longest = min(longest, abs(self._length - self._now))
            begin = self._now, self._w, self._length
            options["first_step"] = first_step(self._rates, *begin, longest, (rtol, atol))
        make = getattr(scipy.integrate, self._method)
        return make(self._rates, self._now, self._w, self._length, **options)


def _solve(jacobian: Any, share: float, left: FloatArray) -> FloatArray:
    """Solve with I - share J; zeros where that is singular."""
    from scipy.sparse import identity

    n = len(left)
    unit = np.eye(n) if isinstance(jacobian, np.ndarray) else identity(n, format="csc")
    try:
        return solve_with(unit - share * jacobian, left)
    except np.linalg.LinAlgError:
        return np.zeros_like(left)
