"""Evaluation of objective and constraints, with their gradients, by simulation of a model.

A peak value is found from values and sensitivities on a fine time grid. At the peak the time
derivative of the output is zero, so the derivative of the peak value with respect to a parameter is
the sensitivity at that time. Between grid points the output is interpolated by the polynomial
through nine points. If a polynomial of lower degree disagrees, a finer grid is requested.
Interpolation windows end at events, since the output may have a kink or a jump there.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cotree.errors import SolveError
from cotree.gradient.goals import GoalFunction, GoalQuantity, Goals, check_times
from cotree.methods import method_row
from cotree.quiet import without_warnings

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.compiled import Model
    from cotree.model.arrays import Array
    from cotree.results import Result
    from cotree.scene.settings import Settings


#: Number of interpolation points on either side of the largest value, and minimum total number.
_REACH, _FEWEST = 4, 5

#: Largest accepted difference between the two interpolants, relative to the range of the output.
_AGREE = 1e-7

#: Rounding error of the interpolants, relative to the largest magnitude of the output.
_ROUNDING = 1e-13


class CoarseError(SolveError):
    """The time grid is too coarse to resolve the output."""


def peak(t: Array, value: Array, slopes: Array, events: Array) -> tuple[float, Array]:
    """Return the maximum of an output and its derivatives with respect to the parameters.

    ``t`` is equidistant, (n_t,); ``slopes`` contains the output's sensitivities,
    (n_parameters, n_t). Raise CoarseError if the grid does not resolve the output, SolveError if
    the peak is next to an event.
    """
    from scipy.interpolate import barycentric_interpolate

    k = int(np.argmax(value))
    # The time of a maximum at an end of the run is fixed, so its derivative is the sensitivity.
    if k in (0, len(t) - 1):
        return float(value[k]), slopes[:, k].copy()
    before, after = events[events <= t[k]], events[events > t[k]]
    first = int(np.searchsorted(t, before.max(), "right")) if before.size else 0
    last = int(np.searchsorted(t, after.min(), "left")) if after.size else len(t)
    low, high = max(first, k - _REACH), min(last, k + _REACH + 1)
    if high - low < _FEWEST or k in (low, high - 1):
        raise CoarseError(
            f"the maximum lies next to an event at t = {t[k]:.6g}, where it is not differentiable"
        )
    step = t[k + 1] - t[k]
    s = (t[low:high] - t[k]) / step  # time since the largest value, in grid steps
    at, top = _top(s, value[low:high])
    # The rounding error is added to accept outputs that are constant.
    allowed = _AGREE * float(np.ptp(value)) + _ROUNDING * float(np.max(np.abs(value)))
    inner = slice(1, -1)
    if abs(top - _top(s[inner], value[low:high][inner])[1]) > allowed:
        raise CoarseError(
            f"the output changes too fast near its maximum at t = {t[k]:.6g} to be resolved"
        )
    return top, barycentric_interpolate(s, slopes[:, low:high], at, axis=1)


def _top(s: Array, value: Array) -> tuple[float, float]:
    """Return position and value of the interpolating polynomial's maximum on [-1, 1]."""
    polynomial = np.polynomial.Polynomial.fit(s, value, len(s) - 1, domain=[-1.0, 1.0])
    roots = polynomial.deriv().roots()
    near = roots[(np.abs(roots.imag) < 1e-9) & (np.abs(roots.real) <= 1.0)].real
    candidates = np.append(near, 0.0)
    values = polynomial(candidates)
    best = int(np.argmax(values))
    return float(candidates[best]), float(values[best])


#: Points of the coarse time grid for peaks, and of the fine one if the first is too coarse.
_TIMES = (801, 12801)

#: A run ends after _STEPS times the steps of the longest previous run, and never before
#: _FEWEST_STEPS: the step size may tend to zero, for example if a mechanism locks.
_STEPS, _FEWEST_STEPS = 50, 2000

#: Quantities that are defined even if an event ends the run early.
_EARLY = ("start", "at", "time")


class DesignPoint(NamedTuple):
    """Objective and constraints at one point in the design space."""

    objective: float  # value to be minimised: mean over all runs
    gradient: Array  # derivatives of the objective with respect to the design variables
    conditions: Array  # constraint values (left minus right side) of all runs
    slopes: Array  # derivatives of the constraint values with respect to the design variables


class Evaluation:
    """Evaluates the goals of a design; ``over`` names its variables, in order of sensitivities."""

    def __init__(
        self,
        model: Model,
        goals: Goals,
        names: Mapping[GoalQuantity, str],
        over: Sequence[str],
        runs: Sequence[Settings],
    ) -> None:
        self.model, self.goals, self.runs, self.over = model, goals, runs, tuple(over)
        self._names = names
        self.n_runs = 0
        self._most_steps = 0
        n = len(goals.quantities)
        self._formulas = [
            GoalFunction(expression, n, over)
            for expression in (goals.objective, *(row.excess for row in goals.conditions))
        ]
        for run in runs:
            check_times(goals.quantities, run.t_span)
            if run.method != "auto":
                method_row(run.method)

    def split(self, values: Mapping[str, float]) -> tuple[dict[str, float], dict[str, float]]:
        """Split the design variables into parameters and initial values."""
        parameters = {n: v for n, v in values.items() if n in self.model.parameters}
        return parameters, {n: v for n, v in values.items() if n not in parameters}

    def simulate(self, run: Settings, values: Mapping[str, float], t_eval: Any = None) -> Result:
        """Simulate a scenario; raise SolveError if the integration fails."""
        parameters, initial = self.split(values)
        self.n_runs += 1
        settings = dict(**run)
        if self._most_steps:
            settings["max_steps"] = min(run.max_steps or math.inf, self._most_steps)
        with without_warnings():  # the optimiser, not the user, chose these values
            result = self.model.simulate(
                run.t_span,
                t_eval,
                parameters={**run.parameters, **parameters},
                initial={**run.initial, **initial},
                inputs=run.inputs,
                throw=True,
                **settings,
            )
        steps = max(_STEPS * result.statistics.n_steps, _FEWEST_STEPS)
        self._most_steps = max(self._most_steps, steps)
        return result

    def at(self, values: Mapping[str, float]) -> DesignPoint:
        """Evaluate the goals; raise an Error if a run fails or a derivative is not finite."""
        found = [self._of_run(run, values) for run in self.runs]
        objectives = [rows[0] for rows in found]
        conditions = [row for rows in found for row in rows[1:]]
        n = len(self.over)
        return DesignPoint(
            float(np.mean([value for value, _ in objectives])),
            np.mean([slope for _, slope in objectives], axis=0),
            np.array([value for value, _ in conditions]),
            np.array([slope for _, slope in conditions]).reshape(-1, n),
        )

    def _of_run(self, run: Settings, values: Mapping[str, float]) -> list[tuple[float, Array]]:
        """Evaluate objective and constraints in one run, each with its gradient."""
        quantities, slopes = self._quantities(run, values)
        n, found = len(self.goals.quantities), []
        numbers = [*quantities, *(values[name] for name in self.over)]
        texts = ["minimise", *(f"'{row.text}'" for row in self.goals.conditions)]
        for text, formula in zip(texts, self._formulas, strict=True):
            value, partial = formula.value(numbers)
            # Total derivative: explicit part, plus the chain rule through the quantities.
            total = np.array(partial[n:]) + np.array(partial[:n]) @ slopes
            if not (math.isfinite(value) and np.all(np.isfinite(total))):
                raise SolveError(f"{text} has no finite value or derivative")
            found.append((value, total))
        return found

    def _quantities(self, run: Settings, values: Mapping[str, float]) -> tuple[list[float], Array]:
        """Simulate a run; return the quantities and their gradients over the design variables."""
        wanted = self.goals.quantities
        if not wanted:
            return [], np.zeros((0, len(self.over)))
        has_peaks = any(row.kind in ("maximum", "minimum") for row in wanted)
        for n_times in _TIMES if has_peaks else (2,):
            times = [*np.linspace(*run.t_span, n_times), *(q.t for q in wanted if q.kind == "at")]
            result = self.simulate(run, values, np.unique(times))
            grid = np.linspace(*run.t_span, n_times)
            try:
                rows = [self._quantity(q, result, run, grid) for q in wanted]
            except CoarseError:
                if n_times == _TIMES[-1]:
                    raise
                continue
            break
        return [value for value, _ in rows], np.array([slope for _, slope in rows])

    def _quantity(
        self, quantity: GoalQuantity, result: Result, run: Settings, grid: Array
    ) -> tuple[float, Array]:
        name, kind = self._names[quantity], quantity.kind
        if kind == "time":
            event = result.events[name]
            if not event.t.size:
                raise SolveError(f"event '{name}' does not occur")
            return float(event.t[0]), event.s[:, 0]
        end = result.t[-1]
        if end != run.t_span[1] and (kind not in _EARLY or quantity.t > end):
            raise SolveError(
                f"an event ends the run at t = {end:.6g}, and {kind}({quantity.text}) depends "
                "on that time: use time(event), or define the event without stop=True"
            )
        i = result.outputs.index(name)
        value, slopes = result.output_values[i], result.output_sensitivities[i]
        if kind in ("maximum", "minimum"):
            sign = 1.0 if kind == "maximum" else -1.0
            on_grid = np.isin(result.t, grid)
            events = np.concatenate([np.zeros(0), *(row.t for row in result.events.values())])
            top, slope = peak(
                result.t[on_grid], sign * value[on_grid], sign * slopes[:, on_grid], events
            )
            return sign * top, sign * slope
        time = {"at": quantity.t, "start": run.t_span[0]}.get(kind, end)
        # The time of an event is stored twice; the second entry has the value after the event.
        at = int(np.flatnonzero(result.t == time)[-1])
        share = 1.0 / (run.t_span[1] - run.t_span[0]) if kind == "mean" else 1.0
        return share * float(value[at]), share * slopes[:, at]
