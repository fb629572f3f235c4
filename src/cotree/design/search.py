"""The search for a design by SciPy, with exact gradients, on scales from zero to one.

A trial whose run fails gets the value of a high wall, so that the optimiser steps back from it; its
gradient is that of the last point that had one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.design.evaluation import Point, trial
from cotree.errors import Error, ParameterError, brief

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.design.evaluation import Evaluation
    from cotree.design.scales import Scale
    from cotree.model.arrays import Array

METHODS = ("slsqp", "trust-constr")

#: Conditions hold where they are missed by less than this share of their size, or of one; bounds
#: and conditions are active where they are nearer than this.
MET = 1e-6

#: The share of the largest gradient that conditions and bounds may leave at an optimum.
OPTIMAL = 1e-4

#: A wall is so many times as high as the objective is large.
_WALL = 1e3


@dataclass(frozen=True, eq=False)
class Trial:
    """One point that was tried.

    Attributes
    ----------
    parameters : dict of str to float
        What was varied.
    objective : float
        The objective there; nan where the run failed.
    missed : float
        By how much the worst condition is missed; nan where the run failed.
    reason : str
        Why the run failed; empty where it did not.
    """

    parameters: dict[str, float]
    objective: float
    missed: float
    reason: str = ""


class Search:
    """One search from one start.

    Parameters
    ----------
    evaluation : Evaluation
        The goals.
    scales : sequence of Scale
        What is varied.
    """

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

    def values(self, v: Array) -> dict[str, float]:
        """Give what is varied at a place of the scales."""
        return {s.name: s.value(float(x)) for s, x in zip(self.scales, v, strict=True)}

    def point(self, v: Array) -> Point | Error:
        """Evaluate the goals at a place of the scales, gradients by places."""
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
            self._good = found
            self._known[key] = found
            self._keep(v, found)
        self._last = key, found
        return found

    def missed(self, point: Point) -> float:
        """Say by how much the worst condition is missed."""
        excess = np.where(self.equalities, np.abs(point.conditions), point.conditions)
        return float(np.max(excess, initial=0.0))

    def known(self, v: Array) -> Point:
        """Give the goals at a place that was tried with success."""
        return self._known[v.tobytes()]

    @property
    def rank(self) -> tuple[float, float]:
        """By how much the best point misses conditions, and its objective."""
        assert self.best is not None
        return self._rank(self.known(self.best))

    def _keep(self, v: Array, found: Point) -> None:
        """Remember the best point: the one that misses least, of those that hold the lowest."""
        before = None if self.best is None else self._known[self.best.tobytes()]
        if before is None or self._rank(found) < self._rank(before):
            self.best = np.array(v, dtype=float)

    def _rank(self, found: Point) -> tuple[float, float]:
        missed = self.missed(found)
        return (0.0 if missed <= MET else missed, found.objective)

    def or_wall(self, v: Array) -> Point:
        """Give the goals at a place, or a wall where they have no value."""
        found = self.point(v)
        if not isinstance(found, Error):
            return found
        assert self._good is not None
        high = self._good.objective + _WALL * (abs(self._good.objective) + self.steepest + 1.0)
        return self._good._replace(objective=high)

    def run(self, start: Array, method: str, tolerance: float, most: int) -> Any:
        """Search from a place.

        Returns
        -------
        scipy.optimize.OptimizeResult

        Raises
        ------
        Error
            If the goals have no value at the start.
        """
        from scipy.optimize import minimize

        first = self.point(start)
        if isinstance(first, Error):
            raise first
        # Both methods stop by changes of the objective, which count beside its size at the start.
        unit = max(abs(first.objective), float(np.linalg.norm(first.gradient)), 1e-300)
        return minimize(
            lambda v: self.or_wall(v).objective / unit,
            start,
            jac=lambda v: self.or_wall(v).gradient / unit,
            method="SLSQP" if method == "slsqp" else method,
            bounds=[(s.scaled(s.low), s.scaled(s.high)) for s in self.scales],
            constraints=self._constraints(method),
            options=_options(method, tolerance, most),
        )

    def _constraints(self, method: str) -> Any:
        """Give the conditions as SciPy takes them; of no rows there are none."""
        equal = self.equalities
        if not equal.size:
            return ()
        if method == "slsqp":
            # There inequalities are to be positive.
            return [
                {
                    "type": kind,
                    "fun": lambda v, own=own, s=sign: s * self.or_wall(v).conditions[own],
                    "jac": lambda v, own=own, s=sign: s * self.or_wall(v).slopes[own],
                }
                for kind, own, sign in (("eq", equal, 1.0), ("ineq", ~equal, -1.0))
                if np.any(own)
            ]
        from scipy.optimize import NonlinearConstraint

        return NonlinearConstraint(
            lambda v: self.or_wall(v).conditions,
            np.where(equal, 0.0, -np.inf),
            0.0,
            jac=lambda v: self.or_wall(v).slopes,
        )

    def optimality(self, v: Array) -> float:
        """Say how much of the gradient bounds and conditions leave, as a share of the largest.

        Multipliers of active bounds and conditions take away what they can (Karush, Kuhn, Tucker).
        """
        from scipy.optimize import nnls

        found = self.point(v)
        if isinstance(found, Error):
            return np.inf
        columns = []
        for i, scale in enumerate(self.scales):
            unit = np.eye(len(self.scales))[i]
            # A bound pushes inwards: at the lower one the gradient may point upwards.
            if v[i] - scale.scaled(scale.low) <= MET:
                columns.append(unit)
            if scale.scaled(scale.high) - v[i] <= MET:
                columns.append(-unit)
        for excess, slope, is_equal in zip(
            found.conditions, found.slopes, self.equalities, strict=True
        ):
            if is_equal:
                columns += [slope, -slope]
            elif excess >= -MET:
                columns.append(-slope)
        size = max(self.steepest, abs(found.objective), 1e-300)
        if not columns:
            return float(np.linalg.norm(found.gradient)) / size
        return float(nnls(np.array(columns).T, found.gradient)[1]) / size


def _options(method: str, tolerance: float, most: int) -> dict[str, float]:
    if method == "slsqp":
        return {"ftol": tolerance, "maxiter": most}
    return {"gtol": 100.0 * tolerance, "xtol": tolerance, "maxiter": most}


def check_method(method: object) -> str:
    """Accept the name of a method in any case."""
    name = str(method).lower()
    if name not in METHODS:
        raise ParameterError(
            f"method is {brief(repr(method))}: give 'slsqp' or 'trust-constr'; the method of the "
            "runs is set by solver"
        )
    return name
