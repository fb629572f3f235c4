"""Profile likelihoods: how far a parameter may go while the others make up for it.

In: a problem at its estimates. Out: the least objective as a function of one parameter at a time,
and the interval in which it exceeds the least one by no more than a limit
(:meth:`~cotree.estimation.uncertainty.Uncertainty.rise`; Venzon and Moolgavkar 1988). This interval
of the likelihood ratio is the same on every scale, follows curved valleys, and stays open where the
data do not determine the parameter.

Both directions of all parameters walk side by side: whenever all of them wait for predictions,
these are computed in one call.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import numpy.typing as npt

from cotree.estimation.fixed import FixedProblem
from cotree.estimation.multistart import Search, Start
from cotree.estimation.rendezvous import Rendezvous, Stopped

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree.estimation.problem import Problem
    from cotree.estimation.uncertainty import Uncertainty

    Rows = Callable[[npt.NDArray[np.float64]], tuple[npt.NDArray[np.float64], Any]]

Array = npt.NDArray[np.float64]

# A step is to raise twice the objective by this share of the quantile: some four points on each
# side, and by no more than this before it is shortened.
_STEP, _TOO_FAR = 0.25, 1.0

# Steps of one walk at most, and by how much one may be longer than the one before.
_MOST, _LONGER = 60, 2.0

# Without bounds a walk ends after so many standard errors, or relative changes.
_FARTHEST = 50.0

# Digits of the others at their best: errors of the objective are squares of these.
_SEARCH = Search(ftol=1e-8, xtol=1e-8, gtol=1e-8)

# An end of an interval is refined until twice the objective is this near to the quantile.
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
        Twice the least objective there, above that of the estimates.
    thetas : ndarray, shape (n, n_estimated)
        All parameters there, on their scales.
    estimate : float
        The estimate.
    level : float
        Level of confidence.
    limit : float
        The rise at the ends of the interval.
    interval : tuple of float
        Ends of the interval; infinite or a bound where it does not close.
    is_closed : tuple of bool
        Whether the lower and the upper end lie inside of the bounds.
    sentence : str
        The interval, or why it stays open, in words.
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
        """Interpolate the profile for pictures.

        The signed root of the rise is interpolated, which is a straight line for a linear model,
        over the parameter on its scale.

        Parameters
        ----------
        n : int
            Number of points.

        Returns
        -------
        ndarray, ndarray, each of shape (n,)
            Values of the parameter, in its unit, and the rise there.
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
    problem: Problem,
    theta: Array,
    objective: float,
    chosen: Sequence[int],
    found: Uncertainty,
    *,
    level: float = 0.95,
    more_rows: Rows | None = None,
) -> tuple[Profile, ...]:
    """Form the profile likelihoods of some parameters.

    Parameters
    ----------
    problem : Problem
        What was estimated.
    theta : ndarray, shape (n,)
        Estimates on their scales.
    objective : float
        The objective there: the negative log-likelihood, with that of priors.
    chosen : sequence of int
        Numbers of the parameters.
    found : Uncertainty
        Uncertainty of the estimates, which gives the first steps and the limit.
    level : float
        Level of confidence.
    more_rows : callable, optional
        Rows of priors; see :func:`~cotree.estimation.multistart.minimise_from_starts`.
    """
    limit = found.rise(level)
    meeting = Rendezvous(problem.predict)
    at = (theta, objective, limit, found, more_rows, meeting)
    walks = [
        _Walk(problem, 2 * k + (side > 0), i, side, *at)
        for k, i in enumerate(chosen)
        for side in (-1, 1)
    ]
    meeting.meet([walk.run for walk in walks], lambda done, n: None)
    return tuple(
        _joined(problem, i, theta, level, limit, walks[2 * k], walks[2 * k + 1])
        for k, i in enumerate(chosen)
    )


class _Walk:
    """A walk from the estimates along one parameter, the others at their best."""

    def __init__(
        self,
        problem: Problem,
        number: int,
        index: int,
        side: int,
        theta: Array,
        objective: float,
        limit: float,
        found: Uncertainty,
        more_rows: Rows | None,
        meeting: Rendezvous,
    ) -> None:
        self._problem, self._number, self._index, self._side = problem, number, index, side
        self._objective, self._limit, self._more, self._meeting = (
            objective,
            limit,
            more_rows,
            meeting,
        )
        self.points: list[tuple[float, float, Array]] = [(float(theta[index]), 0.0, theta)]
        self.end: float | None = None  # where the limit is crossed
        self.why = ""
        scaled = problem.scaled
        bound = float((scaled.lower if side < 0 else scaled.upper)[index])
        error = float(found.errors[index])
        size = float(abs(found.split.sizes[index]))
        # Along what is not determined, and for what has no error yet, relative steps begin.
        self._first = error * math.sqrt(_STEP * limit) if math.isfinite(error) else 0.2 * size
        reach = _FARTHEST * (error if math.isfinite(error) else size)
        # A logarithm may have the bound minus infinity, which is a value of zero.
        self._bound = bound if math.isfinite(bound) else float(theta[index]) + side * reach
        self.is_bounded = math.isfinite(bound)
        self._along = np.zeros(len(theta))
        if math.isfinite(error) and error > 0.0:
            column = np.where(
                np.isfinite(found.covariance[:, index]), found.covariance[:, index], 0
            )
            self._along = column / error**2

    def run(self) -> None:
        """Walk until the limit is crossed, or the bound is met."""
        try:
            self._walk()
        except Stopped:
            self.why = "interrupted there"

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
                    self.why = "runs fail beyond"
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
        self.why = "the walk is long beyond"

    def _next(self, step: float, before: float, after: float) -> float:
        """Choose a step that raises by what is wanted, as the root of the rise goes on straight."""
        slope = (math.sqrt(max(after, 0.0)) - math.sqrt(max(before, 0.0))) / step
        wanted = math.sqrt(max(after, 0.0) + _STEP * self._limit) - math.sqrt(max(after, 0.0))
        return min(_LONGER * step, wanted / slope if slope > 0.0 else math.inf)

    def _refine(self) -> None:
        """Find where the limit is crossed, by regula falsi between the last two points."""
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
        """Give the rise at a value, the others at their best; None where runs fail."""
        nearest = min(self.points, key=lambda row: abs(row[0] - x))
        along = self._along
        if len(self.points) > 1:
            last, before = self.points[-1], self.points[-2]
            along = (last[2] - before[2]) / (last[0] - before[0])
        began = nearest[2] + along * (x - nearest[0])
        fixed = FixedProblem(self._problem, self._index, x, self._meeting, self._more)
        if not fixed.scaled.names:
            value = fixed.objective(self._number)
            there = np.array([x])
        else:
            # An optimiser uses no more of a problem and of a rendezvous than this one has.
            start = Start(
                cast("Problem", fixed),
                self._number,
                fixed.free(began),
                _SEARCH,
                fixed.more_rows,
                cast("Rendezvous", fixed),
            )
            start.run()
            row = start.record()
            value, there = row.objective, fixed.whole(row.theta)
        if not math.isfinite(value):
            return None
        return x, 2.0 * (value - self._objective), there


def _joined(
    problem: Problem, i: int, theta: Array, level: float, limit: float, down: _Walk, up: _Walk
) -> Profile:
    """Put both walks together."""
    points = sorted([*down.points[1:], *up.points], key=lambda row: row[0])
    thetas = np.array([row[2] for row in points])
    row = problem.estimated[i]
    ends, closed, said = [], [], []
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
            said.append(f"no {word} limit up to {reached:.4g}, {walk.why}")
        elif walk.is_bounded:
            said.append(f"no {word} limit within the bounds")
        else:
            said.append(f"no {word} limit up to {reached:.4g}")
    unit = f" {row.unit}" if row.unit else ""
    if any(closed):
        said.insert(0, f"{100 * level:g} % interval {ends[0]:.5g} to {ends[1]:.5g}{unit}")
    return Profile(
        row.name,
        row.unit,
        problem.scaled.values(thetas)[:, i],
        np.array([p[1] for p in points]),
        thetas,
        float(problem.scaled.values(theta)[i]),
        level,
        limit,
        (ends[0], ends[1]),
        (closed[0], closed[1]),
        "; ".join(said),
        row.scale,
    )
