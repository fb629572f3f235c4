"""Gradient-based search for an optimal design by SciPy in scaled design variables.

If the run at a trial point fails, the optimiser receives a penalty, so that it rejects the step,
with the gradient of the last successful point.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import Error, ParameterError, brief, check_known, nearest
from cotree.estimation.estimated import Estimated, Scaled, estimated, spread_starts
from cotree.report import Facts, Report, Reported, Table, Values
from cotree.scene.expressions import check_number

if TYPE_CHECKING:
    from cotree.compiled import Model
    from cotree.design.evaluation import DesignPoint, Evaluation
    from cotree.model.arrays import Array
    from cotree.results import Result


#: Tolerance of constraints, relative to their size at the start, and of bounds, relative to the
#: distance between both bounds. It applies to violations and to the margin of active ones.
MET = 1e-6

#: Largest optimality residual of an optimal point. In a convex problem the objective could decrease
#: by at most this fraction, times the distance to the optimum in scaled variables.
OPTIMAL = 1e-4

#: The residual is relative to the objective, or to this fraction of the initial gradient if larger.
_LEAST_SIZE = 1e-3

#: Penalty for a failed run, relative to the magnitude of the objective.
_PENALTY = 1e3


@dataclass(frozen=True, eq=False)
class Trial:
    """One trial point of a search.

    Attributes
    ----------
    parameters : dict of str to float
        Values of the design variables.
    objective : float
        Objective at this point; nan if the run failed.
    missed : float
        Largest constraint violation, in the unit of the constraint; nan if the run failed.
    reason : str
        Reason why the run failed; empty if it succeeded.
    """

    parameters: dict[str, float]
    objective: float
    missed: float
    reason: str = ""


class Descent:
    """A search from one starting point in scaled design variables."""

    def __init__(self, evaluation: Evaluation, space: Space) -> None:
        self.evaluation, self.space = evaluation, space
        self.history: list[Trial] = []
        self.best: Array | None = None
        self._last: tuple[bytes, DesignPoint | Error] | None = None
        self._known: dict[bytes, DesignPoint] = {}
        self._good: DesignPoint | None = None
        rows = evaluation.goals.conditions
        self.equalities = np.array([row.is_equality for row in rows] * len(evaluation.runs), bool)
        self.steepest = 0.0
        # at the start: norm of the gradient, then size of each constraint
        self._first_slope = 0.0
        self.sizes = np.ones(len(self.equalities))

    def values(self, v: Array) -> dict[str, float]:
        """Convert normalised coordinates to design variables by name."""
        names = (row.name for row in self.space.rows)
        return dict(zip(names, self.space.values(v).tolist(), strict=True))

    def point(self, v: Array) -> DesignPoint | Error:
        """Evaluate a point and its gradients in scaled coordinates, or return the Error."""
        key = np.asarray(v, dtype=float).tobytes()
        if self._last is not None and self._last[0] == key:
            return self._last[1]
        values = self.values(v)
        found: DesignPoint | Error
        try:
            found = self.evaluation.at(values)
        except Error as error:
            found = error
            self.history.append(Trial(values, np.nan, np.nan, str(found)))
        else:
            slope = self.space.slopes(v)
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

    def violations(self, point: DesignPoint) -> Array:
        """Return the violation of each constraint; zero if the constraint holds."""
        excess = np.where(self.equalities, np.abs(point.conditions), point.conditions)
        return np.maximum(excess, 0.0)

    def missed(self, point: DesignPoint) -> float:
        """Return the largest constraint violation."""
        return float(np.max(self.violations(point), initial=0.0))

    def known(self, v: Array) -> DesignPoint:
        """Return the stored results at a point that was evaluated successfully."""
        return self._known[v.tobytes()]

    @property
    def rank(self) -> tuple[float, float]:
        """Constraint violation and objective at the best point."""
        assert self.best is not None
        return self._rank(self.known(self.best))

    def _keep(self, v: Array, found: DesignPoint) -> None:
        """Store a point if it is the best: least violation first, then least objective."""
        before = None if self.best is None else self._known[self.best.tobytes()]
        if before is None or self._rank(found) < self._rank(before):
            self.best = np.array(v, dtype=float)

    def _rank(self, found: DesignPoint) -> tuple[float, float]:
        missed = float(np.max(self.violations(found) / self.sizes, initial=0.0))
        return (0.0 if missed <= MET else missed, found.objective)

    def penalised(self, v: Array) -> DesignPoint:
        """Evaluate a point; if its run fails, return a penalty instead."""
        found = self.point(v)
        if not isinstance(found, Error):
            return found
        assert self._good is not None
        penalty = self._good.objective + _PENALTY * (
            abs(self._good.objective) + self.steepest + 1.0
        )
        return self._good._replace(objective=penalty)

    def run(self, start: Array, method: str, tolerance: float, most: int) -> Any:
        """Run SciPy's optimiser from a starting point and return its result."""
        from scipy.optimize import minimize

        first = self.point(start)
        if isinstance(first, Error):
            raise first
        # SciPy's tolerances are absolute, so the objective is scaled to order one.
        unit = max(abs(first.objective), float(np.linalg.norm(first.gradient)), 1e-300)
        return minimize(
            lambda v: self.penalised(v).objective / unit,
            start,
            jac=lambda v: self.penalised(v).gradient / unit,
            method="SLSQP" if method == "slsqp" else method,
            bounds=list(zip(self.space.lower, self.space.upper, strict=True)),
            constraints=self._constraints(method),
            options=_options(method, tolerance, most),
        )

    def _constraints(self, method: str) -> Any:
        """Return the constraints in the form expected by SciPy's method."""
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
            self._scaled_conditions, np.where(equal, 0.0, -np.inf), 0.0, jac=self._scaled_slopes
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
        """Return whether a point is optimal within the optimality or the search tolerances.

        If changes of the objective are smaller than integration errors, the search ends early. The
        residual is then compared with the largest gradient encountered.
        """
        if self.optimality(v) <= OPTIMAL:
            return True
        size = max(self.steepest, abs(self.known(v).objective), 1e-300)
        return bool(end.success) and self._residual(v, self.known(v)) <= OPTIMAL * size

    def _residual(self, v: Array, found: DesignPoint) -> float:
        """Return the norm of the gradient that active bounds and constraints do not balance."""
        from scipy.optimize import nnls

        columns: list[Array] = []
        # Active lower bounds balance positive gradient components, upper bounds negative ones.
        units = np.eye(len(v))
        columns += [*units[v - self.space.lower <= MET], *-units[self.space.upper - v <= MET]]
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


class Space:
    """Normalised coordinates of the design variables, with finite bounds at 0 and 1.

    A coordinate is linear in the variable or, on a logarithmic scale, in its logarithm. If a bound
    is infinite, the coordinate is 0 at the initial guess. ``rows`` contains the design variables:
    parameters, and states, whose names denote their initial values.
    """

    def __init__(self, rows: Sequence[Estimated]) -> None:
        self.rows, self._scaled = rows, Scaled(rows)
        lower, upper, start = self._scaled.lower, self._scaled.upper, spread_starts(rows, 1)[0]
        is_bounded = np.isfinite(upper - lower)
        self._origin = np.where(is_bounded, lower, start)
        self._unit = np.where(is_bounded, upper - lower, np.where(start == 0.0, 1.0, abs(start)))
        self.lower, self.upper = self._normalised(lower), self._normalised(upper)

    def _normalised(self, theta: Array) -> Array:
        return np.asarray((theta - self._origin) / self._unit)

    def starts(self, n: int, seed: int | None) -> Array:
        """Return starting points, (n, n_variables): the initial guess first, then random points."""
        return self._normalised(spread_starts(self.rows, n, seed))

    def values(self, v: Array) -> Array:
        """Convert coordinates to values of the design variables within their bounds."""
        with np.errstate(over="ignore"):
            values = self._scaled.values(self._origin + self._unit * v)
        return np.clip(values, [row.lower for row in self.rows], [row.upper for row in self.rows])

    def slopes(self, v: Array) -> Array:
        """Return the derivatives of the values with respect to the coordinates."""
        theta = self._scaled.scaled(self.values(v))
        return np.asarray(self._unit * self._scaled.slopes(theta))


def read_variables(
    over: Any, known: Mapping[str, float], guess: Mapping[str, float]
) -> list[Estimated]:
    """Read design variables from their ranges by name; ``known`` contains the default guesses."""
    if not isinstance(over, Mapping) or not over:
        raise ParameterError(
            'over must map names to bounds, as in over={"L": (0.5, 2), "k": (1, 1e3, "log")}'
        )
    check_known(guess, over, "guess names", ", which is not in 'over'", ParameterError)
    starts = {name: check_number(value, f"the guess of '{name}'") for name, value in guess.items()}
    return [
        estimated(name, bounds, starts.get(name), known.get(name)) for name, bounds in over.items()
    ]


@dataclass(frozen=True)
class ConditionValue:
    """A constraint, evaluated for the optimal design.

    Attributes
    ----------
    text : str
        The constraint as written by the user.
    run : int
        Index of the scenario, counted from zero.
    excess : float
        Left minus right side of ``<=`` and ``==``, right minus left side of ``>=``.
    holds : bool
        Whether it is satisfied.
    is_active : bool
        Whether it holds with equality and therefore limits the design.
    is_equality : bool
        Whether it is an equality constraint.
    """

    text: str
    run: int
    excess: float
    holds: bool
    is_active: bool
    is_equality: bool


@dataclass(frozen=True, eq=False, repr=False)
class Design(Reported):
    """The result of :func:`cotree.optimise`; ``design["L"]`` is the value of variable ``L``.

    Attributes
    ----------
    parameters : dict of str to float
        Optimal values of the design variables: parameters and initial values of states.
    objective : float
        The objective at these values.
    conditions : tuple of ConditionValue
        The constraints at these values, scenario by scenario.
    success : bool
        Whether the best point is an optimum: all constraints hold within 1e-6 of their size at the
        start, and ``optimality`` is at most 1e-4. If SciPy's method has converged, a residual of
        1e-4 of the largest gradient of the search also suffices.
    message : str
        Sentences that describe how the search ended.
    optimality : float
        Residual of the Karush-Kuhn-Tucker conditions: the part of the gradient that active bounds
        and constraints do not balance. Design variables are in units of the distance between their
        bounds, and the residual is relative to the objective (or to a thousandth of the gradient at
        the start if that is larger).
    violation : float
        The largest violation of a constraint, in its unit; zero if all hold exactly.
    history : tuple of Trial
        Every trial point, in order: ``parameters``, ``objective``, ``missed``, ``reason``.
    starts : tuple of float
        The final objective of each start; nan if its first run failed.
    results : tuple of Result
        The simulations of the optimal design, one for each scenario.
    model : cotree.Model
        The compiled model that was simulated, with an output for each quantity in the goals.
    n_runs : int
        Number of simulations.
    """

    parameters: dict[str, float]
    objective: float
    conditions: tuple[ConditionValue, ...]
    success: bool
    message: str
    optimality: float
    violation: float
    history: tuple[Trial, ...]
    starts: tuple[float, ...]
    results: tuple[Result, ...]
    model: Model
    n_runs: int

    @property
    def result(self) -> Result:
        """Simulation of the design in the first scenario."""
        return self.results[0]

    def __getitem__(self, name: str) -> float:
        """Return the value of a design variable: a parameter or an initial value."""
        if name not in self.parameters:
            raise ParameterError(f"'{brief(name)}' was not varied{nearest(name, self.parameters)}")
        return self.parameters[name]

    @property
    def settings(self) -> dict[str, dict[str, float]]:
        """Run arguments with the optimal values: ``model.simulate((0, 1), **design.settings)``."""
        names = self.model.parameters
        return {
            "parameters": {n: v for n, v in self.parameters.items() if n in names},
            "initial": {n: v for n, v in self.parameters.items() if n not in names},
        }

    def report(self) -> Report:
        """Return a report with message, values and conditions."""
        has_several_runs = len(self.results) > 1
        conditions = [
            (
                row.text + (f" in run {row.run + 1}" if has_several_runs else ""),
                "violated" if not row.holds else "active" if row.is_active else "holds",
                row.excess,
            )
            for row in self.conditions
        ]
        return Report(
            "Design",
            Facts([("status", self.message)]),
            Values((), [*self.parameters.items(), ("Objective", self.objective)], digits=10),
            Table(("condition", "", "excess"), conditions, digits=3),
        )
