"""Events within one integration: found after each step, located, let happen.

An event watches a value g. It happens where g passes through zero in its direction, after which
the same crossing does not count again. A step is sampled at a few points, and more closely where g
turns round near zero, so that two crossings within a step are not lost. Events that cannot be told
apart in time happen in the order of the scene, each from the state that the one before left, if
its value still moves through zero; a value that jumps through zero makes its event happen, too.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cotree.solvers.evaluate import FAILED, IntegrationStopError
from cotree.solvers.locate import Guarded, Locator
from cotree.solvers.verdicts import verdict

if TYPE_CHECKING:
    from cotree.solvers.evaluate import Evaluator
    from cotree.solvers.locate import Located, Looked
    from cotree.solvers.problem import Events, FloatArray, Problem
    from cotree.solvers.stepper import StartStepper, Stepper

# Values of g below this share of the largest seen are rounding.
_ROUNDING = 16 * float(np.finfo(np.float64).eps)

# Rates below this share of the rate at the crossing count as zero; a crossing shallower than this
# many tolerances may as well not take place.
_STILL, _GRAZING = 1e-10, 10.0

# So many of one event within this share of the span are too many; as many as a few are enough to
# call by its name what has become too small for the tolerance.
_CROWD, _CROWDED, _A_FEW = 100, 1e-9, 3

# Intervals that shrink this often in a row by the same ratio, within this share, are a geometric
# series; the run ends where the rest of the series is below this share of the span.
_IN_A_ROW, _SAME_RATIO, _LEFT = 8, 0.02, 1e-6

# Values reached by two orders of the same jumps count as equal within this share.
_SAME = 1e-8

# How often one event may make others happen at the same time.
_MOST_ROUNDS = 50


@dataclass(frozen=True, eq=False)
class Occurrence:
    """One event that happened.

    Attributes
    ----------
    event : int
        Number of the event.
    t : float
        Time of the event, [s].
    before, after : ndarray
        States and sensitivities.
    time_sensitivity : ndarray, shape (n_sensitivities,)
        Derivatives of its time by the parameters.
    """

    event: int
    t: float
    before: FloatArray
    after: FloatArray
    time_sensitivity: FloatArray


class Watch:
    """Watches the values of events; it is mutable and belongs to one integration.

    Attributes
    ----------
    happened : list of Occurrence
        Events that have happened so far.
    stopped : str
        The event that ends the run, once it happened.
    """

    def __init__(
        self, problem: Problem, events: Events, evaluator: Evaluator, start: StartStepper
    ) -> None:
        self.happened: list[Occurrence] = []
        self.stopped = ""
        self._evaluator = evaluator
        self._events = Guarded(events, evaluator)
        self._locator = Locator(problem, self._events, evaluator, start)
        self._span = abs(problem.t_span[1] - problem.t_span[0])
        self._has_sensitivities = problem.n_sensitivities > 0
        n = len(events.rows)
        self._direction = np.array([row.direction for row in events.rows])
        self._is_jump = np.array([row.is_jump for row in events.rows])
        #: Values that count from a mode, and that mode: their rounding is its, too.
        self._counts = [(i, row.targets[0]) for i, row in enumerate(events.rows) if row.is_count]
        self._g = np.zeros(n)
        #: The sign of each value since it last passed zero; zero where it has not left it.
        self._side = np.zeros(n)
        self._largest = np.zeros(n)
        #: The largest value since anything happened: what the tolerance is relative to.
        self._flight = np.zeros(n)
        self._times: list[deque[float]] = [deque(maxlen=_CROWD) for _ in range(n)]

    def begin(self, t: float, z: FloatArray) -> FloatArray:
        """Examine the start of a run: events whose values pass through zero just then happen."""
        self._look(t, z)
        rates = self._events.rates(t, z)
        at_zero = np.abs(self._g) <= self._band
        moving = np.where(at_zero, np.sign(rates), np.sign(self._g))
        for i in np.flatnonzero(at_zero & (rates == 0.0)):
            moving[i] = np.sign(self._bend(t, z)[i])
        self._side = moving
        starting = np.flatnonzero(at_zero & (self._direction != 0) & (moving == self._direction))
        return self._happen(t, z, [int(i) for i in starting], moving)

    def resume(self, t: float, z: FloatArray, slopes: FloatArray) -> FloatArray:
        """Examine a breakpoint, whose time has slopes: events that jump through zero happen."""
        self._look(t, z)
        return self._happen(t, z, [], -self._side, slopes)

    def find(self, stepper: Stepper, t: float, z: FloatArray, end: float) -> Located | None:
        """Find the first crossing within the last step, which began at t with z; else go on."""
        looked = self._locator.look(stepper, t, z, self._g)
        self._note(looked.g, stepper.z)
        found: list[tuple[float, int, float]] = []
        for i in range(len(self._side)):
            bracket = self._crossing(looked, i)
            if bracket is not None:
                found.append((self._locator.root(stepper, i, *bracket), i, bracket[2]))
        is_ahead = not found
        if is_ahead:
            found = self._about_to_cross(stepper, t, looked.g[-1])
        if found:
            i = min(found)[1]
            located = self._locator.arrive(stepper, min(found), (t, z), end, self._band[i])
            if located.is_crossing:
                margin = self._margin(located, i, stepper.t - t)
                at_once = {i, *(j for at, j, _ in found if at <= located.t + margin)}
                at_once.update(self._passing(located))
                return located.with_events(tuple(sorted(at_once)), margin)
            if not is_ahead:
                return located  # the step went wrong: it is taken anew, without an event
        self._g = looked.g[-1]
        left = np.abs(self._g) > self._band
        for j in np.flatnonzero(left & (self._side == 0.0) & self._is_jump):
            self._check_left(int(j), stepper)
        self._side = np.where(left, np.sign(self._g), self._side)
        return None

    def _check_left(self, i: int, stepper: Stepper) -> None:
        """Refuse a value that rested at a jump and left to a side that needs another mode."""
        if np.sign(self._g[i]) == self._direction[i]:
            t = self._evaluator.inside(stepper.t)
            if self._events.is_due(i, t, stepper.z):
                raise self._refusal("leaves", i, stepper.t)

    def _passing(self, located: Located) -> list[int]:
        """List the events whose values are at zero on their way through.

        A step that ends there may show one of two events at once beyond rounding, and the other
        within.
        """
        g = self._events.values(located.t, located.z)
        rates = self._events.rates(located.t, located.z)
        passing = (np.abs(g) <= self._band) & (self._side * rates < 0.0)
        passing &= (self._direction == 0) | (self._direction == -self._side)
        return [int(i) for i in np.flatnonzero(passing)]

    def happen(self, located: Located) -> FloatArray:
        """Let the located events happen."""
        way = np.sign(self._events.rates(located.t, located.z))
        for i in located.events[:1]:
            if way[i] * self._side[i] > 0.0:  # it left zero by less than rounding
                raise self._refusal("rests", i, located.t)
        return self._happen(located.t, located.z, list(located.events), way)

    @property
    def _band(self) -> FloatArray:
        found: FloatArray = _ROUNDING * self._largest
        return found

    @property
    def _tolerance(self) -> FloatArray:
        """Return the uncertainty of the values of g, as far as the error test knows."""
        problem = self._evaluator.problem
        found: FloatArray = problem.rtol * self._flight + float(np.min(problem.atol))
        return found

    def _note(self, g: FloatArray, z: FloatArray) -> None:
        if not np.all(np.isfinite(g)):
            i = int(np.argwhere(~np.isfinite(np.atleast_2d(g)))[0][1])
            raise self._refusal("not finite", i)
        size = np.max(np.abs(np.atleast_2d(g)), axis=0)
        self._flight = np.maximum(self._flight, size)
        for i, mode in self._counts:
            size[i] += abs(z[mode])
        self._largest = np.maximum(self._largest, size)

    def _look(self, t: float, z: FloatArray) -> None:
        self._g = self._events.values(t, z)
        self._note(self._g, z)

    def _bend(self, t: float, z: FloatArray) -> FloatArray:
        """Give second time derivatives of g, by differences; only their sizes matter."""
        step = 1e-7 * self._span
        ahead = self._locator.advanced(t, z, step)
        found: FloatArray = (self._events.rates(t + step, ahead) - self._events.rates(t, z)) / step
        return found

    def _margin(self, located: Located, i: int, step: float) -> float:
        """Return the uncertainty of the time of an event."""
        rate = abs(float(self._events.rates(located.t, located.z)[i]))
        least = 4 * float(np.spacing(abs(located.t)))
        known = self._tolerance[i] / rate if rate > 0.0 else np.inf
        return float(max(least, min(known, 1e-3 * abs(step))))

    def _crossing(self, looked: Looked, i: int) -> tuple[float, float, float] | None:
        """Bracket the first crossing of one value: two times, and the side it comes from."""
        side, band, wanted = self._side[i], self._band[i], self._direction[i]
        times, g = looked.times, looked.g[:, i]
        for j in range(1, len(times)):
            turn = self._locator.turn(looked, i, j, side) if side else None
            if turn is not None:
                at, lowest = turn
                if self._has_sensitivities and abs(lowest) <= _GRAZING * self._tolerance[i]:
                    self._refuse_grazing(i, at)
                if lowest < -band:
                    is_first = wanted in (0, -side)
                    return (times[j - 1], at, side) if is_first else (at, times[j], -side)
            sign = np.sign(g[j]) if abs(g[j]) > band else 0.0
            if sign and side and sign != side and wanted in (0, sign):
                return times[j - 1], times[j], side
            side = sign or side
        return None

    def _about_to_cross(
        self, stepper: Stepper, t: float, g: FloatArray
    ) -> list[tuple[float, int, float]]:
        """List the crossings at the end of a step, or a negligible time after it."""
        near = (np.abs(g) <= self._tolerance) & (self._side != 0.0) & (self._side * g >= 0.0)
        near &= (self._direction == 0) | (self._direction == -self._side)
        if not np.any(near):
            return []
        rates = self._events.rates(stepper.t, stepper.z)
        soon = 1e-9 * abs(stepper.t - t) + 4 * np.spacing(abs(stepper.t))
        near &= (rates * self._side < 0.0) & (np.abs(g) <= soon * np.abs(rates))
        return [(stepper.t, int(i), float(self._side[i])) for i in np.flatnonzero(near)]

    def _happen(
        self,
        t: float,
        z: FloatArray,
        events: list[int],
        way: FloatArray,
        t_p: FloatArray | None = None,
    ) -> FloatArray:
        """Let events happen, each moving its ``way``, then those that these make happen."""
        self._check_order(t, z, [i for i in events if self._is_jump[i]])
        fired: list[int] = []
        speed = np.abs(self._events.rates(t, z))
        if events:  # what is at zero passes it, whether it is an event in that direction or not
            passing = np.abs(self._events.values(t, z)) <= self._band
            self._side = np.where(passing, way, self._side)
        for i in events:
            if fired and not self._events.rates(t, z)[i] * way[i] > 0.0:
                continue  # another one turned it round
            z, t_p = self._fire(i, t, z, None)
            fired.append(i)
            self._side[i] = self._sides(t, z, fired, speed)[i]
        for _ in range(_MOST_ROUNDS):
            side = self._sides(t, z, fired, speed)
            crossed = side * self._side < 0.0
            crossed &= (self._direction == 0) | (self._direction == side)
            crossed[self._leaving(t, z, side, is_timed=t_p is not None)] = True
            self._side = np.where(crossed, self._side, side)
            if not np.any(crossed):
                break
            i = int(np.flatnonzero(crossed)[0])
            # Its time is that of the event before, or of a breakpoint.
            fixed = np.zeros(self._evaluator.problem.n_sensitivities) if t_p is None else t_p
            z, t_p = self._fire(i, t, z, fixed)
            fired.append(i)
            self._side[i] = self._sides(t, z, fired, speed)[i]
        else:
            rows = [self._events.rows[i] for i in sorted(set(fired))]
            why = "slides" if all(row.is_jump for row in rows) else "endless"
            raise IntegrationStopError(FAILED, verdict(why, [row.name for row in rows], t))
        for i in fired:
            self._check_rest(i, t, z, way[i], speed[i])
        if fired:
            self._flight = np.abs(self._g)
        return z

    def _leaving(self, t: float, z: FloatArray, side: FloatArray, *, is_timed: bool) -> list[int]:
        """List the values that rested at a jump and now leave to a side with another mode.

        Something happened to them, or a breakpoint is there, or it is only found now.
        """
        left = self._is_jump & (self._side == 0.0) & (side != 0.0) & (side == self._direction)
        due = [int(i) for i in np.flatnonzero(left) if self._events.is_due(int(i), t, z)]
        if due and self._has_sensitivities and not is_timed:
            raise self._refusal("leaves", due[0], t)
        return due

    def _check_order(self, t: float, z: FloatArray, jumps: list[int]) -> None:
        """Refuse simultaneous jumps whose order matters: nothing has sensitivities there."""
        if len(jumps) < 2 or not self._has_sensitivities:
            return
        ends = []
        for order in (jumps, jumps[::-1]):
            end = z
            for i in order:
                end, _ = self._events.apply(i, self._evaluator.inside(t), end, None)
            ends.append(end)
        size = np.max(np.abs(ends), axis=0)
        atol = float(np.min(self._evaluator.problem.atol))
        if np.any(np.abs(ends[0] - ends[1]) > _SAME * size + atol):
            raise self._refusal("parts", jumps[0], t)

    def _sides(self, t: float, z: FloatArray, fired: list[int], speed: FloatArray) -> FloatArray:
        """Return the side of zero of each value; a value at zero takes the side it moves to."""
        self._look(t, z)
        rates = self._events.rates(t, z)
        moving = np.where(np.abs(rates) > _STILL * speed, np.sign(rates), 0.0)
        near = self._band
        near[fired] = np.maximum(near, self._tolerance)[fired]
        found: FloatArray = np.where(np.abs(self._g) > near, np.sign(self._g), moving)
        return found

    def _check_rest(self, i: int, t: float, z: FloatArray, way: float, speed: float) -> None:
        """Refuse a value that is left at zero without a speed but is pushed on through it."""
        if self._side[i] != 0.0 or self.stopped:
            return
        bend = self._bend(t, z)[i]
        if bend * way > 0.0 and abs(bend) * self._span > _STILL * speed:
            raise self._refusal("rests", i, t)

    def _fire(
        self, i: int, t: float, z: FloatArray, t_p: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """Let one event happen, and note it."""
        row, inside = self._events.rows[i], self._evaluator.inside(t)
        self._count(i, t)
        if self._has_sensitivities and t_p is None:
            self._check_grazing(i, t, z)
        after, t_p = self._events.apply(i, inside, z, t_p)
        if not np.all(np.isfinite(after)):
            raise self._refusal("set not finite", i)
        complete = self._evaluator.complete
        self.happened.append(
            Occurrence(i, t, complete(inside, z).copy(), complete(inside, after).copy(), t_p)
        )
        if row.is_stop:
            self.stopped = row.name
        return after, t_p

    def _check_grazing(self, i: int, t: float, z: FloatArray) -> None:
        """Refuse a crossing that is so shallow that it may as well not take place."""
        rate, bend = self._events.rates(t, z)[i], self._bend(t, z)[i]
        depth = 0.5 * rate**2
        if depth <= _GRAZING * self._tolerance[i] * abs(bend) or rate == 0.0:
            self._refuse_grazing(i, t)

    def _refusal(self, name: str, i: int, t: float = 0.0, detail: float = 0.0) -> Exception:
        row = self._events.rows[i]
        return IntegrationStopError(FAILED, verdict(name, [row.name], t, detail))

    def _refuse_grazing(self, i: int, t: float) -> None:
        self._refuse_series(i, t, _A_FEW, np.inf)
        raise self._refusal("grazes", i, t)

    def explain(self, t: float) -> None:
        """Refuse, by name, events that have made the steps too short."""
        for i, times in enumerate(self._times):
            if len(times) > _A_FEW and t - times[-_A_FEW - 1] <= _LEFT * self._span:
                raise self._refusal("accumulates", i, t, t)

    def _refuse_series(self, i: int, t: float, n: int, longest: float) -> None:
        """Refuse events whose last n intervals are a geometric series that soon ends."""
        intervals = np.diff(list(self._times[i])[-n - 1 :])
        if len(intervals) < n or not np.all(intervals > 0.0):
            return
        ratios = intervals[1:] / intervals[:-1]
        ratio = float(ratios[-1])
        if ratio >= 1.0 or np.any(np.abs(ratios - ratio) > _SAME_RATIO * ratio):
            return
        left = float(intervals[-1]) * ratio / (1.0 - ratio)
        if left <= longest:
            raise self._refusal("accumulates", i, t, t + left)

    def _count(self, i: int, t: float) -> None:
        """Refuse events that accumulate."""
        times = self._times[i]
        times.append(t)
        self._refuse_series(i, t, _IN_A_ROW, _LEFT * self._span)
        if len(times) == _CROWD and t - times[0] <= _CROWDED * self._span:
            raise self._refusal("chatters", i, t, t - times[0])
