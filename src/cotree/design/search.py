"""Gradient-based search for a design by SciPy, in scaled design variables.

If the run of a trial point fails, the optimiser receives a penalty value, so that it rejects the
step; the gradient is then that of the last point that could be evaluated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.arguments import check_whole
from cotree.design.evaluation import Evaluation, Point, trial
from cotree.errors import Error, ParameterError, brief, check_known
from cotree.scene.expressions import check_number

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.model.arrays import Array


METHODS = ("slsqp", "trust-constr")

#: Constraints are satisfied if they are violated by less than this, relative to their size at the
#: start, and active if the distance is less; bounds are active within this share of their distance.
MET = 1e-6

#: Largest optimality residual of an optimum. By convexity the objective could fall by no more than
#: this share from there, times the distance to the optimum in the scaled design variables.
OPTIMAL = 1e-4

#: The residual counts relative to the objective, or to this share of the gradient at the start,
#: where the least objective is zero.
_LEAST_SIZE = 1e-3

#: The penalty of a failed run, relative to the magnitude of the objective.
_PENALTY = 1e3


@dataclass(frozen=True, eq=False)
class Trial:
    """One trial point.

    Attributes
    ----------
    parameters : dict of str to float
        Values of the design variables.
    objective : float
        The objective there; nan where the run failed.
    missed : float
        Largest constraint violation, in the unit of the constraint; nan where the run failed.
    reason : str
        Why the run failed; empty if it succeeded.
    """

    parameters: dict[str, float]
    objective: float
    missed: float
    reason: str = ""


class Search:
    """One search from one starting point over scaled design variables."""

    def __init__(self, evaluation: Evaluation, scales: Sequence[Scale]) -> None:
        self.evaluation, self.scales = evaluation, scales
        self.history: list[Trial] = []
        self.best: Array | None = None
        self._last: tuple[bytes, Point | Error] | None = None
        self._known: dict[bytes, Point] = {}
        self._good: Point | None = None
        rows = evaluation.goals.conditions
        self.equalities = np.array([row.is_equality for row in rows] * len(evaluation.runs), bool)
        self.steepest = 0.0
        # Of the start: the norm of the gradient, and the size of each constraint.
        self._first_slope = 0.0
        self.sizes = np.ones(len(self.equalities))

    def values(self, v: Array) -> dict[str, float]:
        """Convert scaled coordinates to values by name."""
        return {s.name: s.value(float(x)) for s, x in zip(self.scales, v, strict=True)}

    def point(self, v: Array) -> Point | Error:
        """Evaluate a point, with gradients with respect to the scaled coordinates."""
        key = np.asarray(v, dtype=float).tobytes()
        if self._last is not None and self._last[0] == key:
            return self._last[1]
        values = self.values(v)
        found = trial(self.evaluation, values)
        if isinstance(found, Error):
            self.history.append(Trial(values, np.nan, np.nan, str(found)))
        else:
            slope = np.array([s.slope(values[s.name]) for s in self.scales])
            found = found._replace(gradient=found.gradient * slope, slopes=found.slopes * slope)
            self.history.append(Trial(values, found.objective, self.missed(found)))
            self.steepest = max(self.steepest, float(np.linalg.norm(found.gradient)))
            if self._good is None:
                self._first_slope = self.steepest
                self.sizes = np.maximum(
                    np.abs(found.conditions), np.linalg.norm(found.slopes, axis=1)
                )
                self.sizes[self.sizes == 0.0] = 1.0
            self._good = found
            self._known[key] = found
            self._keep(v, found)
        self._last = key, found
        return found

    def violations(self, point: Point) -> Array:
        """Return by how much each constraint is violated, zero if it holds exactly."""
        excess = np.where(self.equalities, np.abs(point.conditions), point.conditions)
        return np.maximum(excess, 0.0)

    def missed(self, point: Point) -> float:
        """Return the largest constraint violation."""
        return float(np.max(self.violations(point), initial=0.0))

    def known(self, v: Array) -> Point:
        """Return a point that was evaluated successfully before."""
        return self._known[v.tobytes()]

    @property
    def rank(self) -> tuple[float, float]:
        """Constraint violation of the best point, and its objective."""
        assert self.best is not None
        return self._rank(self.known(self.best))

    def _keep(self, v: Array, found: Point) -> None:
        """Keep the best point: least violation first; among feasible ones, the least objective."""
        before = None if self.best is None else self._known[self.best.tobytes()]
        if before is None or self._rank(found) < self._rank(before):
            self.best = np.array(v, dtype=float)

    def _rank(self, found: Point) -> tuple[float, float]:
        missed = float(np.max(self.violations(found) / self.sizes, initial=0.0))
        return (0.0 if missed <= MET else missed, found.objective)

    def penalised(self, v: Array) -> Point:
        """Evaluate a point; if its run fails, return the penalty instead."""
        found = self.point(v)
        if not isinstance(found, Error):
            return found
        assert self._good is not None
        penalty = self._good.objective + _PENALTY * (
            abs(self._good.objective) + self.steepest + 1.0
        )
        return self._good._replace(objective=penalty)

    def run(self, start: Array, method: str, tolerance: float, most: int) -> Any:
        """Search from a starting point."""
        from scipy.optimize import minimize

        first = self.point(start)
        if isinstance(first, Error):
            raise first
        # Both methods stop on absolute changes of the objective, so it is scaled to order one.
        unit = max(abs(first.objective), float(np.linalg.norm(first.gradient)), 1e-300)
        return minimize(
            lambda v: self.penalised(v).objective / unit,
            start,
            jac=lambda v: self.penalised(v).gradient / unit,
            method="SLSQP" if method == "slsqp" else method,
            bounds=[(s.scaled(s.low), s.scaled(s.high)) for s in self.scales],
            constraints=self._constraints(method),
            options=_options(method, tolerance, most),
        )

    def _constraints(self, method: str) -> Any:
        """Return the constraints in the form that the method of SciPy expects."""
        equal = self.equalities
        if not equal.size:
            return ()
        if method == "slsqp":
            # SLSQP expects inequalities in the form g >= 0.
            return [
                {
                    "type": kind,
                    "fun": lambda v, rows=rows, s=sign: s * self._scaled_conditions(v)[rows],
                    "jac": lambda v, rows=rows, s=sign: s * self._scaled_slopes(v)[rows],
                }
                for kind, rows, sign in (("eq", equal, 1.0), ("ineq", ~equal, -1.0))
                if np.any(rows)
            ]
        from scipy.optimize import NonlinearConstraint

        return NonlinearConstraint(
            self._scaled_conditions,
            np.where(equal, 0.0, -np.inf),
            0.0,
            jac=self._scaled_slopes,
        )

    def _scaled_conditions(self, v: Array) -> Array:
        return self.penalised(v).conditions / self.sizes

    def _scaled_slopes(self, v: Array) -> Array:
        return self.penalised(v).slopes / self.sizes[:, None]

    def optimality(self, v: Array) -> float:
        """Return the Karush-Kuhn-Tucker residual, relative to the objective."""
        found = self.known(v)
        return self._residual(v, found) / max(
            abs(found.objective), _LEAST_SIZE * self._first_slope, 1e-300
        )

    def is_optimal(self, v: Array, end: Any) -> bool:
        """Return whether a point meets the tolerance of optimality, or that of the search.

        A search may also end because the objective no longer changes, by less than the errors of
        integration: the residual is then compared with the largest gradient encountered.
        """
        if self.optimality(v) <= OPTIMAL:
            return True
        size = max(self.steepest, abs(self.known(v).objective), 1e-300)
        return bool(end.success) and self._residual(v, self.known(v)) <= OPTIMAL * size

    def _residual(self, v: Array, found: Point) -> float:
        """Return the norm of the part of the gradient that bounds and constraints do not balance.

        Nonnegative multipliers of the active bounds and constraints follow by least squares.
        """
        from scipy.optimize import nnls

        columns = []
        for i, scale in enumerate(self.scales):
            unit = np.eye(len(self.scales))[i]
            # At an active lower bound the objective may increase with the variable.
            if v[i] - scale.scaled(scale.low) <= MET:
                columns.append(unit)
            if scale.scaled(scale.high) - v[i] <= MET:
                columns.append(-unit)
        for excess, slope, is_equal in zip(
            found.conditions / self.sizes,
            found.slopes / self.sizes[:, None],
            self.equalities,
            strict=True,
        ):
            if is_equal:
                columns += [slope, -slope]
            elif excess >= -MET:
                columns.append(-slope)
        if not columns:
            return float(np.linalg.norm(found.gradient))
        return float(nnls(np.array(columns).T, found.gradient)[1])


def _options(method: str, tolerance: float, most: int) -> dict[str, float]:
    if method == "slsqp":
        return {"ftol": tolerance, "maxiter": most}
    return {"gtol": 100.0 * tolerance, "xtol": tolerance, "maxiter": most}


def check_method(method: object) -> str:
    """Check the name of a method, which may be in upper or lower case."""
    name = str(method).lower()
    if name not in METHODS:
        raise ParameterError(
            f"method is {brief(repr(method))}: give 'slsqp' or 'trust-constr'; the method of the "
            "runs is set by solver"
        )
    return name


@dataclass(frozen=True)
class Scale:
    """The scale of one design variable."""

    name: str  # a parameter, or a state, whose name denotes its initial value
    #: Bounds; infinite if there is none.
    low: float
    high: float
    is_log: bool  # whether the scale is logarithmic
    start: float  # initial guess

    @property
    def _span(self) -> tuple[float, float]:
        """Origin and unit of the scale, in terms of the logarithm for a logarithmic scale."""
        low, high, start = (self._plain(x) for x in (self.low, self.high, self.start))
        if math.isfinite(low) and math.isfinite(high):
            return low, high - low
        return start, abs(start) or 1.0

    def _plain(self, value: float) -> float:
        if not self.is_log:
            return value
        return math.log(value) if 0.0 < value < math.inf else math.copysign(math.inf, value - 1.0)

    def scaled(self, value: float) -> float:
        """Convert a value to its scaled coordinate."""
        origin, unit = self._span
        return (self._plain(value) - origin) / unit

    def value(self, v: float) -> float:
        """Convert a scaled coordinate to a value, clipped to the bounds."""
        origin, unit = self._span
        plain = origin + unit * v
        found = math.exp(min(plain, 700.0)) if self.is_log else plain
        return min(max(found, self.low), self.high)

    def slope(self, value: float) -> float:
        """Return the derivative of the value with respect to its scaled coordinate."""
        return self._span[1] * (value if self.is_log else 1.0)


def read_scales(
    over: Mapping[str, Any], known: Mapping[str, float], guess: Mapping[str, float]
) -> list[Scale]:
    """Read bounds, scales and starts.

    ``over`` has (lower, upper) or (lower, upper, "log") by name. Guesses are the scene's values
    unless ``guess`` overrides them. Raises ParameterError if bounds are invalid, or a guess
    violates them.
    """
    if not isinstance(over, dict) or not over:
        raise ParameterError(
            'over must map names to bounds, as in over={"L": (0.5, 2), "k": (1, 1e3, "log")}'
        )
    check_known(guess, over, "guess names", ", which is not in over", ParameterError)
    return [_read(name, bounds, known, guess) for name, bounds in over.items()]


def _read(name: str, bounds: Any, known: Mapping[str, float], guess: Mapping[str, float]) -> Scale:
    what = f"over of '{brief(name)}'"
    if not isinstance(bounds, (tuple, list)) or len(bounds) not in (2, 3):
        raise ParameterError(
            f'{what} is {brief(repr(bounds))}: give (lower, upper) or (lower, upper, "log")'
        )
    kind = bounds[2] if len(bounds) == 3 else "linear"
    if kind not in ("linear", "log"):
        raise ParameterError(f"{what} has the scale {brief(repr(kind))}: give 'linear' or 'log'")
    low, high = (_bound(value, what) for value in bounds[:2])
    if not low < high:
        raise ParameterError(
            f"{what} goes from {low:g} to {high:g}: the lower bound must be below the upper one"
        )
    is_log = kind == "log"
    if is_log and low <= 0.0:
        raise ParameterError(
            f"{what} is logarithmic, but its lower bound is {low:g}: give a positive lower bound"
        )
    if name in guess:
        start = check_number(guess[name], f"the guess of '{name}'")
        if not low <= start <= high:
            raise ParameterError(
                f"the guess of '{name}' is {start:g}, outside its bounds {low:g} to {high:g}"
            )
    else:
        start = known.get(name, math.nan)
        if not low <= start <= high:  # also where it is nan: there is no nominal value
            start = _middle(low, high, is_log=is_log)
    return Scale(name, low, high, is_log, start)


def _bound(value: Any, what: str) -> float:
    if isinstance(value, (int, float)) and not isinstance(value, bool) and math.isinf(value):
        return float(value)
    return check_number(value, what)


def _middle(low: float, high: float, *, is_log: bool) -> float:
    if not math.isfinite(low) or not math.isfinite(high):
        return low if math.isfinite(low) else high if math.isfinite(high) else 0.0
    return math.sqrt(low * high) if is_log else 0.5 * (low + high)


def drawn_starts(scales: Sequence[Scale], starts: int, seed: int | None) -> list[Array]:
    """Return the starting points in scaled coordinates: the guess first, then random ones.

    Raises ParameterError if random starts are requested and a variable is unbounded.
    """
    first = np.array([scale.scaled(scale.start) for scale in scales])
    starts = check_whole(starts, "starts", 1)
    seed = None if seed is None else check_whole(seed, "seed")
    if starts == 1:
        return [first]
    for scale in scales:
        if not (math.isfinite(scale.low) and math.isfinite(scale.high)):
            raise ParameterError(
                f"starts are drawn between bounds, and '{scale.name}' has none: give both"
            )
    from scipy.stats import qmc

    # Even a few points of a Latin hypercube cover the range of every variable.
    rows = qmc.LatinHypercube(len(scales), seed=seed).random(starts - 1)
    return [first, *rows]
