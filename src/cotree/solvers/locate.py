"""Location of the point within a step where a value passes through zero, and the state there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from cotree.errors import SingularSystemError, SolveError
from cotree.model.algebraic import UnsolvedError
from cotree.solvers.evaluate import FAILED, IntegrationStopError

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.solvers.evaluate import Evaluator
    from cotree.solvers.problem import Events, FloatArray, Problem
    from cotree.solvers.stepper import StartStepper, Stepper

_Answer = TypeVar("_Answer")

# Fractions of a step at which values are sampled, in addition to its end.
_SHARES = (0.25, 0.5, 0.75)

# Limit on the Newton steps onto a root that an interpolant is close to.
_MOST_NEWTON = 12

# Limit on the halvings on the way back to a start at zero whose rounding has the wrong sign.
_MOST_HALVINGS = 50

# Limit on the steps that repeat a step as far as an event.
_MOST_STEPS = 1000


@dataclass(frozen=True, eq=False)
class Located:
    """A crossing, as the end of a step that stops there.

    Attributes
    ----------
    t : float
        Time of the crossing, [s].
    z : ndarray
        The values just before it.
    stepper : Stepper
        The stepper whose last step the crossing lies in.
    events : tuple of int
        The events that happen there.
    margin : float
        Uncertainty of its time, [s].
    is_crossing : bool
        False where the motion, computed more accurately, has not reached the crossing there.
    """

    t: float
    z: FloatArray
    stepper: Stepper
    events: tuple[int, ...] = ()
    margin: float = 0.0
    is_crossing: bool = True

    def with_events(self, events: tuple[int, ...], margin: float) -> Located:
        """Return the same crossing with the events that happen there."""
        return replace(self, events=events, margin=margin)


@dataclass(frozen=True, eq=False)
class Looked:
    """A step that is sampled at a few points.

    Attributes
    ----------
    times : list of float
        From its start to its end, [s].
    points : list of ndarray
        z at these times.
    g : ndarray, shape (n_times, n_events)
        The values that the events watch.
    stepper : Stepper
        The stepper whose last step it is.
    """

    times: list[float]
    points: list[FloatArray]
    g: FloatArray
    stepper: Stepper


class Guarded:
    """Events evaluated at times within the segment; a refusal by the model ends the run."""

    def __init__(self, events: Events, evaluator: Evaluator) -> None:
        self.rows = events.rows
        self._events, self._evaluator = events, evaluator

    def values(self, t: float, z: FloatArray) -> FloatArray:
        """Evaluate the values that the events watch."""
        return self._call(self._events.values, t, z)

    def rates(self, t: float, z: FloatArray) -> FloatArray:
        """Evaluate the time derivatives of these values."""
        return self._call(self._events.rates, t, z)

    def apply(
        self, i: int, t: float, z: FloatArray, time_sensitivity: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """Let an event happen."""
        return self._call(lambda t, z: self._events.apply(i, t, z, time_sensitivity), t, z)

    def is_due(self, i: int, t: float, z: FloatArray) -> bool:
        """Tell whether an event would change the mode that it sets."""
        return self._call(lambda t, z: self._events.is_due(i, t, z), t, z)

    def _call(
        self, function: Callable[[float, FloatArray], _Answer], t: float, z: FloatArray
    ) -> _Answer:
        try:
            return function(self._evaluator.inside(t), z)
        except (SolveError, SingularSystemError, UnsolvedError) as error:
            raise IntegrationStopError(FAILED, str(error).rstrip(".")) from None


class Locator:
    """Locates crossings of one integration."""

    def __init__(
        self, problem: Problem, events: Guarded, evaluator: Evaluator, start: StartStepper
    ) -> None:
        self._events = events
        self._evaluator = evaluator
        self._start = start
        self._has_algebraic = problem.n_algebraic > 0
        blocks = np.ones((1 + problem.n_sensitivities, problem.n_states))
        blocks[:, problem.n_states - problem.n_algebraic :] = 0.0
        self._has_rate = blocks.ravel()

    def look(self, stepper: Stepper, t: float, z: FloatArray, first: FloatArray) -> Looked:
        """Sample the last step, which began at t with z, where the values were ``first``."""
        times = [t + share * (stepper.t - t) for share in _SHARES]
        points = [stepper.interpolate(at) for at in times]
        times, points = [*times, stepper.t], [*points, stepper.z]
        g = [self._events.values(at, point) for at, point in zip(times, points, strict=True)]
        return Looked([t, *times], [z, *points], np.array([first, *g]), stepper)

    def turn(self, looked: Looked, i: int, j: int, side: float) -> tuple[float, float] | None:
        """Find the minimum of side * g between samples j - 1 and j: its time and its value.

        None where the value does not turn round there, or cannot reach zero.
        """
        g = side * looked.g[:, i]
        nearest = int(np.argmin(g))
        if j not in (nearest, nearest + 1) or g[j] <= 0.0 or g[j - 1] < 0.0:
            return None
        if g[nearest] > 2.0 * float(np.ptp(g)):
            return None
        at = [(looked.times[k], looked.points[k]) for k in (j - 1, j)]
        left, right = (side * self._events.rates(t, z)[i] for t, z in at)
        if not left < 0.0 < right:
            return None
        # The tangents must meet below zero: where the value is convex, it does not fall lower.
        (a, _), (b, _) = at
        if (g[j - 1] / -left + g[j] / right) > b - a:
            return None
        return self._lowest(looked.stepper, i, a, b, side)

    def _lowest(
        self, stepper: Stepper, i: int, a: float, b: float, side: float
    ) -> tuple[float, float]:
        from scipy.optimize import minimize_scalar

        found = minimize_scalar(
            lambda t: side * float(self._events.values(t, stepper.interpolate(t))[i]),
            bounds=(a, b),
            method="bounded",
            options={"xatol": 1e-9 * (b - a)},
        )
        return float(found.x), float(found.fun)

    def root(self, stepper: Stepper, i: int, a: float, b: float, side: float) -> float:
        """Find the root of a value on the interpolant, between a on one side of it and b."""
        from scipy.optimize import brentq

        def g(t: float) -> float:
            z = stepper.z if t == stepper.t else stepper.interpolate(t)
            return side * float(self._events.values(t, z)[i])

        start, width = a, b - a
        for _ in range(_MOST_HALVINGS):
            if g(start) > 0.0:
                break
            width *= 0.5
            start = a + width
        else:
            return a
        if g(b) > 0.0:  # what was looked at there is rounding
            return b
        return float(brentq(g, start, b, xtol=4 * np.spacing(abs(b)), rtol=1e-15))

    def arrive(
        self,
        stepper: Stepper,
        crossing: tuple[float, int, float],
        start: tuple[float, FloatArray],
        end: float,
        band: float,
    ) -> Located:
        """Give the values at a crossing, as accurate as steps are.

        Parameters
        ----------
        stepper : Stepper
            The stepper whose last step the crossing lies in.
        crossing : (float, int, float)
            Approximate time, number of the event, and the side from which its value comes.
        start : (float, ndarray)
            Where the step began.
        end : float
            End of the segment, [s].
        band : float
            Size below which the value is rounding.
        """
        t, i, side = crossing
        if t == stepper.t:
            z = stepper.z
        elif stepper.lands:
            z = self._repeated(start, t, end)
        else:
            z = stepper.interpolate(t)
        found = Located(t, self._evaluator.project(t, z), stepper)
        if self._has_algebraic:
            return found  # IDA's own polynomial, whose root this is
        exact = self._improved(found, i, side, (start[0], end), band)
        if exact is not None:
            return exact
        # A step so short that its error hides the value: what the method itself says is taken.
        if side * self._events.rates(found.t, found.z)[i] < 0.0:
            return found
        return self._from_start(stepper, i, side, start)

    def _improved(
        self, found: Located, i: int, side: float, bounds: tuple[float, float], band: float
    ) -> Located | None:
        """Take Newton steps onto the root itself, with steps of the motion; None if they fail."""
        t, z, stepper = found.t, found.z, found.stepper
        width = 0.1 * (stepper.t - bounds[0])
        for _ in range(_MOST_NEWTON):
            g, rate = self._events.values(t, z)[i], self._events.rates(t, z)[i]
            if rate == 0.0 or side * rate > 0.0:
                break
            step = -g / rate
            if abs(g) <= band or abs(step) <= np.spacing(abs(t)):
                return Located(t, z, stepper)
            step = float(np.clip(step, max(bounds[0] - t, -width), min(bounds[1] - t, width)))
            if step == 0.0:
                return Located(t, z, stepper)
            z, t = self._evaluator.project(t + step, self.advanced(t, z, step)), t + step
        return None

    def _from_start(
        self, stepper: Stepper, i: int, side: float, start: tuple[float, FloatArray]
    ) -> Located:
        """Find a crossing so soon after the start that the interpolant does not show it well."""
        from scipy.optimize import brentq

        t, z = start

        def at(step: float) -> FloatArray:
            return self._evaluator.project(t + step, self.advanced(t, z, step))

        def g(step: float) -> float:
            return side * float(self._events.values(t + step, at(step))[i])

        width = stepper.t - t
        for k in range(_MOST_HALVINGS):
            if g(width) > 0.0:
                if k == 0:
                    return Located(stepper.t, at(width), stepper, is_crossing=False)
                step = float(brentq(g, width, 2.0 * width, xtol=np.spacing(abs(t)), rtol=1e-15))
                return Located(t + step, at(step), stepper)
            width *= 0.5
        return Located(t, z, stepper)

    def _repeated(self, start: tuple[float, FloatArray], t: float, end: float) -> FloatArray:
        """Repeat a step as far as t, for methods whose interpolant is weaker than their steps."""
        if t == start[0]:
            return start[1]
        stepper = self._start(self._evaluator, *start, end)
        for _ in range(_MOST_STEPS):
            if stepper.step(t) or stepper.t >= t:
                break
        return stepper.z

    def advanced(self, t: float, z: FloatArray, step: float) -> FloatArray:
        """Take a short step, forwards or back, by the classical method of order four."""

        def rhs(t: float, z: FloatArray) -> FloatArray:
            return self._has_rate * self._evaluator.rhs(t, z)

        k1 = rhs(t, z)
        k2 = rhs(t + 0.5 * step, z + 0.5 * step * k1)
        k3 = rhs(t + 0.5 * step, z + 0.5 * step * k2)
        k4 = rhs(t + step, z + step * k3)
        return z + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
