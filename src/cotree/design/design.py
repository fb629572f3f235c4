"""Results of an optimisation: parameters, constraints, and the course of the search."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.errors import ParameterError, brief, nearest
from cotree.report import Facts, Report, Reported, Table, Values

if TYPE_CHECKING:
    from cotree.compiled import Model
    from cotree.design.search import Trial
    from cotree.results import Result


@dataclass(frozen=True)
class ConditionValue:
    """A constraint evaluated at the design.

    Attributes
    ----------
    text : str
        The constraint as the user wrote it.
    run : int
        Index of the scenario, counted from zero.
    excess : float
        Left side minus right side of ``<=`` and ``==``, right minus left of ``>=``.
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
    """The outcome of :func:`cotree.optimise`; a value by name is ``design["L"]``.

    Attributes
    ----------
    parameters : dict of str to float
        Optimal values of the design variables: parameters and initial values of states.
    objective : float
        The objective at these values.
    conditions : tuple of ConditionValue
        The constraints at these values, scenario by scenario.
    success : bool
        Whether the search ended at an optimum: all constraints hold to 1e-6 of their size at the
        start, and ``optimality`` is at most 1e-4, or the search ended because the objective no
        longer changed by ``tolerance``. A search that ends at a limit has no success, unless its
        best point meets these tolerances.
    message : str
        How the search ended, in sentences.
    optimality : float
        Residual of the Karush-Kuhn-Tucker conditions: the part of the gradient that active bounds
        and constraints do not balance, by design variables in units of the distance between their
        bounds, relative to the objective (or to a thousandth of the gradient at the start, if that
        is larger).
    violation : float
        The largest violation of a constraint, in its unit; zero if all hold exactly.
    history : tuple of Trial
        Every trial point, in order: ``parameters``, ``objective``, ``missed``, ``reason``.
    starts : tuple of float
        The final objective of each start; nan where its first run failed.
    results : tuple of Result
        The simulations of the optimal design, one for each scenario.
    model : cotree.Model
        The compiled variant that was simulated, with an output for each quantity in the goals.
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
        """The simulation of the design; with several scenarios, that of the first."""
        return self.results[0]

    def __getitem__(self, name: str) -> float:
        """Return the value of a design variable: a parameter or an initial value."""
        if name not in self.parameters:
            raise ParameterError(f"'{brief(name)}' was not varied{nearest(name, self.parameters)}")
        return self.parameters[name]

    @property
    def settings(self) -> dict[str, dict[str, float]]:
        """Arguments for any model of the scene: ``simulate((0, 1), **design.settings)``."""
        names = self.model.parameters
        return {
            "parameters": {n: v for n, v in self.parameters.items() if n in names},
            "initial": {n: v for n, v in self.parameters.items() if n not in names},
        }

    def report(self) -> Report:
        """Build the report: message, values and conditions."""
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
