"""Profile likelihoods of estimated parameters.

A profile is the minimum of the objective over all other parameters, as a function of one parameter.
The likelihood-ratio interval is the range in which the profile rises by no more than a limit
(:meth:`~cotree.estimation.uncertainty.Uncertainty.rise`; Venzon and Moolgavkar 1988). The interval
is invariant under reparametrisation, follows curved valleys, and is unbounded if the data do not
determine the parameter.

Both directions of all parameters are computed concurrently: when all of them wait for predictions,
one batch computes them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from cotree.estimation.estimated import Scaled
from cotree.estimation.multistart import Rendezvous, Search, StartRun, Stopped

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree.estimation.estimated import Array
    from cotree.estimation.multistart import MoreRows
    from cotree.estimation.problem import Predictions
    from cotree.estimation.uncertainty import Uncertainty


# Target and maximum of a step's rise of twice the objective, as fractions of the limit.
_STEP, _TOO_FAR = 0.25, 1.0

# Maximum number of steps in one direction, and largest growth factor of the step size.
_MOST, _LONGER = 60, 2.0

# Range of unbounded parameters, in standard errors or, if undetermined, units of change.
_FARTHEST = 50.0

# Tolerances of the optimised parameters; their effect on the objective is of second order.
_SEARCH = Search(ftol=1e-8, xtol=1e-8, gtol=1e-8)

# Largest difference between the rise at the end of an interval and the limit.
_NEAR = 5e-3


@dataclass(frozen=True, eq=False)
class Profile:
    """The profile likelihood of one parameter.

    Attributes
    ----------
    name, unit : str
        The parameter.
    values : ndarray, shape (n,)
        Its values, ascending, in its unit.
    rise : ndarray, shape (n,)
        Twice the increase of the minimised objective above its value at the estimates.
    thetas : ndarray, shape (n, n_estimated)
        All parameters at these values, on their scales.
    estimate : float
        The estimate.
    level : float
        Confidence level.
    limit : float
        Rise at the limits of the interval.
    interval : tuple of float
        Interval of the parameter. If the rise does not reach the limit, an end is the bound, which
        may be infinite.
    is_closed : tuple of bool
        Whether the lower and the upper end are inside the bounds.
    sentence : str
        A sentence with the interval, or with the reason why it is open.
    scale : str
        The scale on which the parameter is estimated.
    """

    name: str
    unit: str
    values: Array
    rise: Array
    thetas: Array
    estimate: float
    level: float
    limit: float
    interval: tuple[float, float]
    is_closed: tuple[bool, bool]
    sentence: str
    scale: str = "lin"

    def curve(self, n: int = 201) -> tuple[Array, Array]:
        """Interpolate the profile for plotting.

        The signed root of the rise is interpolated over the parameter on its scale. For a linear
        model it is a straight line.

        Parameters
        ----------
        n : int
            Number of points.

        Returns
        -------
        ndarray, ndarray, each of shape (n,)
            Values of the parameter, in its unit, and the rise at these values.
        """
        from scipy.interpolate import PchipInterpolator

        values, first = np.unique(self.values, return_index=True)
        if len(values) < 2:
            return values, self.rise[first]
        is_log = self.scale != "lin" and values[0] > 0.0
        x = np.log(values) if is_log else values
        root = np.sqrt(np.maximum(self.rise[first], 0.0)) * np.sign(values - self.estimate)
        fine = np.linspace(x[0], x[-1], n)
        rise = np.asarray(PchipInterpolator(x, root)(fine) ** 2)
        return np.exp(fine) if is_log else fine, rise

    def __repr__(self) -> str:
        return f"<Profile of {self.name}: {self.sentence}>"


def profiles_of(
    found: Uncertainty,
    objective: float,
    chosen: Sequence[int],
    *,
    level: float = 0.95,
    more_rows: MoreRows | None = None,
) -> tuple[Profile, ...]:
    """Return profile likelihoods; ``objective`` is the minimum of -log L, including priors."""
    meeting = Rendezvous(found.problem.predict)
    walks = [
        _Walk(found, objective, level, more_rows, partial(meeting.ask, 2 * k + (side > 0)), i, side)
        for k, i in enumerate(chosen)
        for side in (-1, 1)
    ]
    meeting.run_all([walk.run for walk in walks], lambda done, n: None)
    return tuple(
        _joined(found, i, level, walks[2 * k], walks[2 * k + 1]) for k, i in enumerate(chosen)
    )


class _Walk:
    """Follows a profile from the estimate in one direction, with the other parameters optimised."""

    def __init__(
        self,
        found: Uncertainty,
        objective: float,
        level: float,
        more_rows: MoreRows | None,
        ask: Callable[[Array], Predictions],
        index: int,
        side: int,
    ) -> None:
        self._problem, self._objective, self._limit = found.problem, objective, found.rise(level)
        self._more, self._ask, self._index, self._side = more_rows, ask, index, side
        theta, scaled = found.theta, found.problem.scaled
        self.points: list[tuple[float, float, Array]] = [(float(theta[index]), 0.0, theta)]
        self.end: float | None = None  # parameter value at which the limit is crossed
        self.why = ""
        bound = float((scaled.lower if side < 0 else scaled.upper)[index])
        error = float(found.errors[index])
        size = float(abs(found.split.sizes[index]))
        # Undetermined parameters have infinite standard errors; their first step is relative.
        self._first = error * math.sqrt(_STEP * self._limit) if math.isfinite(error) else 0.2 * size
        reach = _FARTHEST * (error if math.isfinite(error) else size)
        # On a logarithmic scale a lower bound of zero is minus infinity, which counts as no bound.
        self._bound = bound if math.isfinite(bound) else float(theta[index]) + side * reach
        self.is_bounded = math.isfinite(bound)
        self._along = np.zeros(len(theta))
        if math.isfinite(error) and error > 0.0:
            column = found.covariance[:, index]
            self._along = np.where(np.isfinite(column), column, 0) / error**2

    def run(self) -> None:
        """Follow the profile until the limit is crossed or the bound is reached."""
        try:
            self._walk()
        except Stopped:
            self.why = "where it was interrupted"

    def _walk(self) -> None:
        step = self._first
        for _ in range(_MOST):
            x, rise, _ = self.points[-1]
            left = abs(self._bound - x)
            if left <= 1e-9 * max(1.0, abs(x)):
                return
            step = min(step, left)
            point = self._at(x + self._side * step)
            if point is None:
                step *= 0.25
                if step < 1e-3 * self._first:
                    self.why = "beyond which runs fail"
                    return
                continue
            if (
                point[1] - rise > _TOO_FAR * self._limit
                and rise < 0.8 * self._limit
                and (step > 0.05 * self._first)
            ):
                step *= 0.4
                continue
            self.points.append(point)
            if point[1] >= self._limit:
                self._refine()
                return
            step = self._next(step, rise, point[1])
        self.why = "where the limit of steps was reached"

    def _next(self, step: float, before: float, after: float) -> float:
        """Return the step for the target rise, by linear extrapolation of the root of the rise."""
        slope = (math.sqrt(max(after, 0.0)) - math.sqrt(max(before, 0.0))) / step
        wanted = math.sqrt(max(after, 0.0) + _STEP * self._limit) - math.sqrt(max(after, 0.0))
        return min(_LONGER * step, wanted / slope if slope > 0.0 else math.inf)

    def _refine(self) -> None:
        """Find the crossing of the limit between the last two points, by regula falsi."""
        (a, low, _), (b, high, _) = self.points[-2:]
        wanted = math.sqrt(self._limit)
        for _ in range(6):
            u, v = math.sqrt(max(low, 0.0)), math.sqrt(high)
            share = (wanted - u) / (v - u)
            x = a + min(max(share, 0.02), 0.98) * (b - a)
            self.end = a + share * (b - a)
            if abs(high - self._limit) <= _NEAR or abs(low - self._limit) <= _NEAR:
                return
            point = self._at(x)
            if point is None:
                return
            self.points.append(point)
            if point[1] < self._limit:
                a, low = point[0], point[1]
            else:
                b, high = point[0], point[1]

    def _at(self, x: float) -> tuple[float, float, Array] | None:
        """Evaluate the profile at a parameter value; return None if runs fail."""
        nearest = min(self.points, key=lambda row: abs(row[0] - x))
        along = self._along
        if len(self.points) > 1:
            last, before = self.points[-1], self.points[-2]
            along = (last[2] - before[2]) / (last[0] - before[0])
        began = nearest[2] + along * (x - nearest[0])
        others = [row for i, row in enumerate(self._problem.estimated) if i != self._index]
        more = None if self._more is None else partial(self._more_at, x)
        start = StartRun(
            self._problem,
            Scaled(others),
            np.delete(began, self._index),
            _SEARCH,
            more,
            partial(self._ask_at, x),
        )
        start.run()
        row = start.record()
        if not math.isfinite(row.objective):
            return None
        there = np.insert(row.theta, self._index, x)
        return x, 2.0 * (row.objective - self._objective), there

    def _ask_at(self, x: float, others: Array) -> Predictions:
        """Return predictions for values ``others``, with this parameter fixed at x."""
        found, i = self._ask(np.insert(others, self._index, x)), self._index
        return replace(
            found,
            slopes=np.delete(found.slopes, i, axis=1),
            sigma_slopes=np.delete(found.sigma_slopes, i, axis=1),
        )

    def _more_at(self, x: float, others: Array) -> tuple[Array, Array]:
        """Return prior residuals for values ``others``, with this parameter fixed at x."""
        assert self._more is not None
        rows, slopes = self._more(np.insert(others, self._index, x))
        return rows, np.delete(slopes, self._index, axis=1)


def _joined(found: Uncertainty, i: int, level: float, down: _Walk, up: _Walk) -> Profile:
    problem, theta = found.problem, found.theta
    points = sorted([*down.points[1:], *up.points], key=lambda row: row[0])
    thetas = np.array([row[2] for row in points])
    row = problem.estimated[i]
    ends, closed, parts = [], [], []
    for walk, word, bound in ((down, "lower", row.lower), (up, "upper", row.upper)):
        closed.append(walk.end is not None)
        if walk.end is not None:
            at = theta.copy()
            at[i] = walk.end
            ends.append(float(problem.scaled.values(at)[i]))
            continue
        ends.append(bound)
        reached = float(problem.scaled.values(walk.points[-1][2])[i])
        if walk.why:
            parts.append(f"no {word} limit up to {reached:.4g}, {walk.why}")
        elif walk.is_bounded:
            parts.append(f"no {word} limit within the bounds")
        else:
            parts.append(f"no {word} limit up to {reached:.4g}")
    unit = f" {row.unit}" if row.unit else ""
    if any(closed):
        parts.insert(0, f"{100 * level:g} % interval {ends[0]:.5g} to {ends[1]:.5g}{unit}")
    return Profile(
        row.name,
        row.unit,
        problem.scaled.values(thetas)[:, i],
        np.array([p[1] for p in points]),
        thetas,
        float(problem.scaled.values(theta)[i]),
        level,
        found.rise(level),
        (ends[0], ends[1]),
        (closed[0], closed[1]),
        "; ".join(parts),
        row.scale,
    )
