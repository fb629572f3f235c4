"""An estimation problem: conditions, measured values and estimated parameters.

A problem computes predictions, residuals, log-likelihood, gradient and Fisher information as
functions of the estimated parameters on their scales. One call of the ensemble engine computes the
runs at several points in parameter space.

With a measured value m, its prediction y and the transformation T, the residual is
r = (T(y) - T(m)) / sigma. A row with a normal distribution contributes
-(r^2 / 2 + log(sigma sqrt(2 pi)) + log(dm/dT)) to the log-likelihood; a row with a Laplace
distribution of scale sigma contributes -(abs(r) + log(2 sigma) + log(dm/dT)).

A steady state is found by a run until states stop changing. In networks with conserved quantities
it depends on the initial values and its Jacobian is singular, so a root finder would need the
conservation laws.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.ensemble.batch import run_block
from cotree.ensemble.members import MEMBER, Members
from cotree.ensemble.run import make_plan
from cotree.errors import ParameterError
from cotree.estimation.conditions import (
    Columns,
    Condition,
    Measured,
    check_condition,
    check_measured,
)
from cotree.estimation.estimated import LOGARITHMS, Array, Estimated, Scaled
from cotree.model.arrays import as_array
from cotree.scene.settings import STEPS_OF_FIT, Settings
from cotree.sharing import usable_cores

if TYPE_CHECKING:
    from collections.abc import Hashable, Sequence

    from cotree.compiled import Model
    from cotree.ensemble.plan import Block, Plan
    from cotree.estimation.conditions import Measured


@dataclass(frozen=True, eq=False)
class Predictions:
    """Predictions of the measured rows at one point in parameter space."""

    values: Array  # observables before transformation
    slopes: Array  # derivatives of the observables with respect to the scaled estimated parameters
    sigma: Array  # standard deviations of the transformed values (scales of Laplace distributions)
    sigma_slopes: Array  # derivatives of ``sigma`` with respect to the scaled estimated parameters
    message: str = ""  # reason why a run failed (values are then nan), or empty


class Likelihood:
    """Likelihood of measured values as a function of predictions."""

    def __init__(self, measured: Measured) -> None:
        logs = np.array(measured.transformation, dtype=object)
        self.is_log = logs != "lin"
        # T(x) = log(x) / factor, so its derivative is 1 / (factor x).
        self._factor = np.array([LOGARITHMS[word] for word in logs])
        self.is_normal = np.array(measured.distribution, dtype=object) == "normal"
        self.value = np.asarray(measured.value, dtype=float)
        self._target = self.transformed(self.value)
        # negative logarithms of the constant factors in the densities
        log_slope = np.where(
            self.is_log, np.log(self._factor * np.abs(self.value) + ~self.is_log), 0
        )
        log_norm = np.where(self.is_normal, 0.5 * math.log(2.0 * math.pi), math.log(2.0))
        self._constant = float(np.sum(log_norm + log_slope))

    def transformed(self, values: Array) -> Array:
        """Transform one value per row; values without a logarithm become nan."""
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = np.log(np.where(self.is_log, values, 1.0)) / self._factor
        return np.where(self.is_log, logs, values)

    def residuals(self, found: Predictions) -> Array:
        """Return the residual r of each row, shape (n_rows,)."""
        return np.asarray((self.transformed(found.values) - self._target) / found.sigma)

    def residual_slopes(self, found: Predictions) -> Array:
        """Return the derivatives of the residuals, shape (n_rows, n_estimated)."""
        slopes = self._mean_slopes(found)
        return np.asarray(
            slopes - (self.residuals(found) / found.sigma)[:, None] * found.sigma_slopes
        )

    def chi2(self, found: Predictions) -> float:
        """Return the sum of the squared residuals."""
        return float(np.sum(self.residuals(found) ** 2))

    def log_likelihood(self, found: Predictions) -> float:
        """Return the log-likelihood; minus infinity if a prediction is not finite."""
        r = self.residuals(found)
        parts = np.where(self.is_normal, 0.5 * r**2, np.abs(r)) + np.log(found.sigma)
        total = -float(np.sum(parts)) - self._constant
        return total if math.isfinite(total) else -math.inf

    def gradient(self, found: Predictions) -> Array:
        """Return the log-likelihood's gradient; at kinks, the mean of one-sided derivatives."""
        r = self.residuals(found)
        weights = np.where(self.is_normal, r, np.sign(r))
        by_sigma = found.sigma_slopes / found.sigma[:, None]
        return np.asarray(-weights @ self.residual_slopes(found) - np.sum(by_sigma, axis=0))

    def fisher(self, found: Predictions) -> Array:
        """Return the expected Fisher information, shape (n_estimated, n_estimated)."""
        rows = self.fisher_rows(found)
        return np.asarray(rows.T @ rows)

    def fisher_rows(self, found: Predictions) -> Array:
        """Return J such that J^T J is the Fisher information, shape (2 n_rows, n_estimated).

        Rows of the measured values precede rows of their standard deviations. Singular values of J
        identify undetermined directions with twice as many digits as eigenvalues of J^T J.
        """
        # Fisher information on sigma: 2 / sigma^2 (normal) or 1 / sigma^2 (Laplace).
        share = np.where(self.is_normal, math.sqrt(2.0), 1.0)
        by_sigma = found.sigma_slopes * (share / found.sigma)[:, None]
        return np.vstack([self._mean_slopes(found), by_sigma])

    def _mean_slopes(self, found: Predictions) -> Array:
        """Return the derivatives of the transformed predictions, divided by sigma."""
        scale = np.where(self.is_log, self._factor * found.values, 1.0) * found.sigma
        return np.asarray(found.slopes / scale[:, None])


# Times of tests for a steady state, [s]; as states settle, a decade takes only a few steps.
_TIMES = 10.0 ** np.arange(-2, 11)

# Largest change of a settled value over a decade of time, in multiples of the tolerances. In ten
# times the time, an exponential decays to a negligible remainder.
_CHANGE = 10.0


class _Runs:
    """Runs a model for rows of parameters and initial values, with or without sensitivities."""

    def __init__(self, model: Model, settings: Settings, outputs: Sequence[str] = ()) -> None:
        self._model, self._settings, self._outputs = model, settings, outputs
        self._threads = usable_cores()
        self._plans: dict[bool, Plan] = {}

    def run(self, columns: Sequence[str], rows: Array, n_first: int, *, slopes: bool) -> Block:
        """Run all rows; the first ``n_first`` rows belong to the first point in parameter space."""
        if slopes not in self._plans:
            # The method is chosen at the first point; later stiffness is detected during a run.
            members = Members(tuple(columns), rows[:n_first], {MEMBER: np.arange(n_first)})
            # The method is chosen once, so that results do not depend on previous evaluations.
            known = next(iter(self._plans.values()), None)
            own = replace(known.settings if known else self._settings, sensitivities=slopes)
            plan = make_plan(self._model.kernels, own, members, outputs=self._outputs, lanes=1)
            self._plans[slopes] = replace(plan, is_chosen=known.is_chosen) if known else plan
        return run_block(self._plans[slopes], rows, threads=self._threads)


class SteadyStates:
    """Computes the steady states from which the conditions of a group start."""

    def __init__(
        self, conditions: Sequence[Condition], names: Sequence[str], settings: Settings
    ) -> None:
        self._conditions, self._settings, self._names = conditions, settings, names
        self._model = conditions[0].model
        first_runs = [c.before for c in conditions if c.before is not None]
        # Several conditions may start from the same steady state.
        self._distinct = list(dict.fromkeys(first_runs))
        self._of = [self._distinct.index(before) for before in first_runs]
        parameters = dict.fromkeys(name for c in self._distinct for name in c.parameters)
        initial = dict.fromkeys(name for c in self._distinct for name in c.initial)
        for before in self._distinct:
            if before.model is not self._model or before.initial.keys() != initial.keys():
                raise ParameterError(
                    f"condition '{before.name}' leads to a steady state: it needs the model of the "
                    "conditions that begin there, and the same initial values as others"
                )
        self._columns: tuple[str, ...] = (*parameters, *initial)
        self._maps = [Columns(c, self._columns, names) for c in self._distinct]
        self._first = (
            SteadyStates(self._distinct, names, settings) if first_runs[0].before else None
        )
        self._runs = _Runs(
            self._model,
            replace(
                settings,
                t_span=(0.0, float(_TIMES[-1])),
                t_eval=_TIMES,
                # Explicit methods would need too many steps for such long runs.
                method="rodas5" if settings.method == "auto" else settings.method,
                inputs=self._distinct[0].inputs,
            ),
        )
        self._keeps: list[npt.NDArray[np.bool_]] = []

    def through(self, own: Sequence[Array]) -> list[Array]:
        """Return matrices from sensitivities to estimated parameters for runs from steady states.

        ``own`` contains the matrices ``through`` of these runs alone; see :class:`Columns`.
        """
        model, found = self._model, []
        earlier = [item.through for item in self._maps]
        if self._first is not None:
            earlier = self._first.through(earlier)
        for i, (condition, after) in enumerate(zip(self._conditions, own, strict=True)):
            before = earlier[self._of[i]]
            # Rows of values that only the previous run estimates are rows of its matrix.
            is_initial = np.array([name in model.states for name in model.sensitivities])
            both = np.where((is_initial & ~after.any(axis=1))[:, None], before, after)
            for m, j in np.argwhere((before != both) & (before != 0)):
                raise ParameterError(
                    f"the estimated parameter '{self._names[j]}' is '{model.sensitivities[m]}' in "
                    f"the run to the steady state of condition '{condition.name}', but not later"
                )
            # A parameter that is a fixed number in the previous run has zero sensitivities there.
            self._keeps.append(np.asarray(before.any(axis=1)))
            found.append(both)
        return found

    def begin(
        self, columns: Sequence[str], rows: Array, values: Array, *, slopes: bool
    ) -> tuple[tuple[str, ...], Array, list[str]]:
        """Add initial values at steady states to columns and rows, (n_thetas * n_conditions, ...).

        Initial values already set by members are kept. The third result contains the reason why a
        member has no steady state, or an empty string.
        """
        own = np.array([item.row(theta) for theta in values for item in self._maps])
        its, earlier = self._columns, [""] * len(own)
        if self._first is not None:
            its, own, earlier = self._first.begin(its, own, values, slopes=slopes)
        block = self._runs.run(its, own, len(self._distinct), slopes=slopes)
        n, m = len(self._model.states), len(self._model.sensitivities) if slopes else 0
        names = list(self._model.states)
        names += [f"d({x})/d({p})" for p in self._model.sensitivities[:m] for x in names]
        kept = [
            j
            for j, name in enumerate(names)
            if name not in columns and not any(name.startswith(f"d({c})/") for c in columns)
        ]
        found = np.zeros((len(rows), len(kept)))
        failed = [""] * len(rows)
        n_c, n_d = len(self._conditions), len(self._distinct)
        rest = [self._at_rest(block.z[k], n) for k in range(len(own))]
        for k in range(len(rows)):
            i = (k // n_c) * n_d + self._of[k % n_c]
            if earlier[i]:
                failed[k] = earlier[i]
            elif block.status[i] != 0:
                failed[k] = f"the run to its steady state: {block.messages[i]}"
            elif rest[i] is None:
                failed[k] = f"no steady state before it: states still change at t = {_TIMES[-1]:g}"
            else:
                is_kept = np.concatenate([np.ones(n), np.repeat(self._keeps[k % n_c], n)])
                found[k] = (block.z[i, rest[i]] * is_kept[: n * (1 + m)])[kept]
        return (*columns, *(names[j] for j in kept)), np.hstack([rows, found]), failed

    def _at_rest(self, z: Array, n: int) -> int | None:
        """Return the index of the first tested time after which values hardly change, or None."""
        a = self._settings
        size = np.maximum(np.abs(z[:-1]), np.abs(z[1:]))
        change = np.abs(np.diff(z, axis=0)) <= _CHANGE * (a.atol + a.rtol * size)
        # Small sensitivities are compared with the largest sensitivity to the same parameter.
        slopes = np.abs(z[:, n:].reshape(len(z), -1, n)).max(axis=2, keepdims=True)
        near = np.abs(np.diff(z[:, n:].reshape(len(z), -1, n), axis=0)) <= (
            _CHANGE * a.rtol * slopes[1:]
        )
        change[:, n:] |= near.reshape(len(z) - 1, -1)
        found = np.flatnonzero(change.all(axis=1))
        return int(found[0]) + 1 if found.size else None


# Duration of a run in which values were measured only at the initial time, [s].
_SHORTEST = 1.0


class Group:
    """Conditions that run in one block; ``rows`` contains the indices of their measured rows."""

    def __init__(
        self,
        conditions: Sequence[Condition],
        numbers: Sequence[int],
        measured: Measured,
        names: Sequence[str],
        settings: Settings,
    ) -> None:
        first = conditions[0]
        self._model, self._conditions, self._names = first.model, conditions, names
        parameters = dict.fromkeys(name for c in conditions for name in c.parameters)
        self._columns = (*parameters, *first.initial)
        self._maps = [Columns(c, self._columns, names) for c in conditions]
        through = [item.through for item in self._maps]
        self._steady = SteadyStates(conditions, names, settings) if first.before else None
        if self._steady is not None:
            through = self._steady.through(through)
        self._through = np.array(through)
        self.rows = np.flatnonzero(np.isin(measured.condition, numbers))
        order = {number: i for i, number in enumerate(numbers)}
        conditions_of_rows = [order[int(c)] for c in measured.condition[self.rows]]
        self._condition_of = np.array(conditions_of_rows, dtype=np.intp)
        times, self._at = np.unique(measured.t[self.rows], return_inverse=True)
        self._times: Array = times
        start, end = first.t_start, float(times[-1])
        span = (start, end if end > start else start + _SHORTEST)
        self._quantities(measured)
        own = replace(settings, t_span=span, t_eval=times, inputs=first.inputs)
        self._runs = _Runs(self._model, own, self._outputs)

    def _quantities(self, measured: Measured) -> None:
        """Determine the positions of observables and standard deviations in a block of results."""
        wanted = [measured.observable[i] for i in self.rows.tolist()]
        noise = [measured.noise[i] for i in self.rows.tolist()]
        known = {*self._model.states, *self._model.outputs}
        self.numbers = np.array([np.nan if isinstance(v, str) else v for v in noise], dtype=float)
        self._with_noise = np.array([i for i, v in enumerate(noise) if v in known], dtype=np.intp)
        # rows whose standard deviations are estimated parameters, and indices of these parameters
        direct = [i for i, v in enumerate(noise) if isinstance(v, str) and v not in known]
        self._direct = np.array(direct, dtype=np.intp)
        self._direct_of = np.array([self._names.index(str(noise[i])) for i in direct], np.intp)
        wanted += [str(noise[i]) for i in self._with_noise]
        states = self._model.states
        self._outputs = tuple(dict.fromkeys(name for name in wanted if name not in states))
        # Columns of results are the states, then the requested outputs.
        place = {name: i for i, name in enumerate((*states, *self._outputs))}
        self._which = np.array([place[name] for name in wanted], dtype=np.intp)
        self._member = np.concatenate([self._condition_of, self._condition_of[self._with_noise]])
        self._time = np.concatenate([self._at, self._at[self._with_noise]])

    def run(
        self, values: Array, *, slopes: bool
    ) -> tuple[Array, Array, Array, Array, tuple[str, ...]]:
        """Run all conditions for each row of parameter values.

        Return observables and their derivatives, standard deviations and their derivatives, and for
        each row the reason why its runs failed, or an empty string. Derivatives are with respect to
        the unscaled values of the estimated parameters; they are empty unless requested.
        """
        n, n_rows = len(values), len(self.rows)
        rows = np.array([item.row(theta) for theta in values for item in self._maps])
        columns, failed = self._columns, [""] * len(rows)
        if self._steady is not None:
            columns, rows, failed = self._steady.begin(columns, rows, values, slopes=slopes)
        block = self._runs.run(columns, rows, len(self._conditions), slopes=slopes)
        found, along = self._read(block, n, slopes=slopes)
        sigma = np.tile(self.numbers, (n, 1))
        sigma[:, self._with_noise] = found[:, n_rows:]
        sigma_along = np.zeros((n, n_rows, along.shape[2]))
        sigma_along[:, self._with_noise] = along[:, n_rows:]
        sigma[:, self._direct] = values[:, self._direct_of]
        if slopes:
            sigma_along[:, self._direct, self._direct_of] = 1.0
        messages = self._messages(block, failed, n)
        return found[:, :n_rows], along[:, :n_rows], sigma, sigma_along, messages

    def _read(self, block: Block, n: int, *, slopes: bool) -> tuple[Array, Array]:
        """Return the measured quantities in a block and their derivatives."""
        n_states, n_c = len(self._model.states), len(self._conditions)
        shape = (n, n_c, len(self._times))
        every = np.concatenate([block.z[..., :n_states], block.outputs], axis=2)
        every = every.reshape(*shape, -1)
        values = every[:, self._member, self._time, self._which]
        if not slopes:
            return values, np.zeros((n, len(self._which), 0))
        m = len(self._model.sensitivities)
        of_states = block.z[..., n_states:].reshape(*shape, m, n_states)
        of_outputs = block.output_sensitivities.reshape(*shape, m, len(self._outputs))
        along = np.concatenate([of_states, of_outputs], axis=4)
        along = along[:, self._member, self._time, :, self._which].swapaxes(0, 1)
        return values, np.einsum("qrm,rmj->qrj", along, self._through[self._member])

    def _messages(self, block: Block, failed: Sequence[str], n: int) -> tuple[str, ...]:
        """Return for each parameter point the reason why a run failed, or an empty string."""
        n_c, found = len(self._conditions), []
        # A terminal event may end a run before the last measurement.
        last = np.array([self._times[self._at[self._condition_of == c]].max() for c in range(n_c)])
        for i in range(n):
            message = ""
            for c, condition in enumerate(self._conditions):
                k = i * n_c + c
                place = int(np.searchsorted(self._times, last[c]))
                ended = np.isnan(block.z[k, place]).any()
                why = failed[k] or (block.messages[k] if block.status[k] != 0 else "")
                if not why and ended:
                    why = f"its run ended before the last measurement at t = {last[c]:g}"
                if why:
                    message = message or f"condition '{condition.name}': {why}"
            found.append(message)
        return tuple(found)


class Problem:
    """Measured values, and the simulations that predict them.

    Parameters
    ----------
    estimated : sequence of Estimated
        The estimated parameters, in the order of ``theta``.
    conditions : sequence of Condition
        The runs.
    measured : Measured
        The measured values.
    settings : Settings, optional
        Method, tolerances and budgets of the runs.

    Attributes
    ----------
    estimated, conditions, measured, settings
        The arguments.
    scaled : Scaled
        The estimated parameters on their scales.
    likelihood : Likelihood
        Likelihood as a function of predictions.

    Raises
    ------
    ParameterError
        If a name is unknown, or a row is invalid.
    """

    def __init__(
        self,
        estimated: Sequence[Estimated],
        conditions: Sequence[Condition],
        measured: Measured,
        settings: Settings | None = None,
    ) -> None:
        self.estimated, self.conditions = tuple(estimated), tuple(conditions)
        self.measured, self.settings = measured, settings or Settings(max_steps=STEPS_OF_FIT)
        self.scaled = Scaled(self.estimated)
        if len(set(self.scaled.names)) < len(self.scaled.names):
            raise ParameterError(
                f"two estimated parameters have the same name: {self.scaled.names}"
            )
        if not len(measured):
            raise ParameterError("there are no measured values: give at least one")
        for condition in self.conditions:
            for link in condition.chain:
                check_condition(link, self.scaled.names)
        check_measured(measured, self.conditions, self.scaled.names)
        self.likelihood = Likelihood(measured)
        self._last: tuple[bytes, Predictions] | None = None
        self._groups = self._grouped()

    def predict(self, thetas: Any, *, slopes: bool = True) -> list[Predictions]:
        """Predict the measured values at several points in parameter space in one call.

        Parameters
        ----------
        thetas : array_like, shape (n_thetas, n_estimated)
            Points on the scales of the parameters. Their results are independent of each other.
        slopes : bool
            Whether to compute derivatives. Without derivatives, runs are faster, and values differ
            within the tolerances.

        Returns
        -------
        list of Predictions
            One for each point; if a run fails, its values are nan and ``message`` contains the
            reason.
        """
        n_rows, n_est = len(self.measured), len(self.estimated)
        thetas = np.asarray(thetas, dtype=float)
        if thetas.ndim != 2 or thetas.shape[1] != n_est:
            raise ParameterError(
                f"thetas must be an array of shape (n_thetas, {n_est}), not of shape {thetas.shape}"
            )
        n = len(thetas)
        values, factors = self.scaled.values(thetas), self.scaled.slopes(thetas)
        width = n_est if slopes else 0
        observed, sigma = np.empty((2, n, n_rows))
        observed_slopes, sigma_slopes = np.empty((2, n, n_rows, width))
        messages = [""] * n
        for group in self._groups:
            *computed, failed = group.run(values, slopes=slopes)
            for whole, part in zip(
                (observed, observed_slopes, sigma, sigma_slopes), computed, strict=True
            ):
                whole[:, group.rows] = part
            messages = [a or b for a, b in zip(messages, failed, strict=True)]
        if slopes:
            observed_slopes *= factors[:, None, :]
            sigma_slopes *= factors[:, None, :]
        return [
            Predictions(observed[i], observed_slopes[i], sigma[i], sigma_slopes[i], messages[i])
            for i in range(n)
        ]

    def theta(self, parameters: Any = None) -> Array:
        """Convert values of the estimated parameters to their scales, shape (n_estimated,).

        Parameters
        ----------
        parameters : mapping of str to float, or array_like of shape (n_estimated,), optional
            Unscaled values; by default the initial guesses, or the middle of finite bounds if there
            is no guess.

        Raises
        ------
        ParameterError
            If a name is unknown, a value is missing, or a value has no logarithm.
        """
        names = self.scaled.names
        middle = self.scaled.values(0.5 * (self.scaled.lower + self.scaled.upper))
        given = {
            row.name: float(value) if row.start is None and np.isfinite(value) else row.start
            for row, value in zip(self.estimated, middle, strict=True)
        }
        if parameters is not None and not hasattr(parameters, "keys"):
            array = as_array(parameters, (len(names),), "the estimated parameters")
            parameters = dict(zip(names, array.tolist(), strict=True))
        for name, value in dict(parameters or {}).items():
            if name not in given:
                raise ParameterError(f"'{name}' is not estimated: {', '.join(names)} are")
            given[name] = value
        missing = [name for name, value in given.items() if value is None]
        if missing:
            raise ParameterError(f"'{missing[0]}' has no initial guess: give a value")
        theta = self.scaled.scaled(np.array(list(given.values()), dtype=float))
        for name, value in zip(names, theta, strict=True):
            if not np.isfinite(value):
                raise ParameterError(f"'{name}' is {given[name]}, which has no finite logarithm")
        return theta

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Bounds of the estimated parameters on their scales, as SciPy's ``minimize`` expects.

        They are infinite if there is no bound.
        """
        return list(zip(self.scaled.lower.tolist(), self.scaled.upper.tolist(), strict=True))

    def values(self, theta: Any) -> dict[str, float]:
        """Return the estimated parameters by name, in their units.

        Parameters
        ----------
        theta : array_like, shape (n_estimated,)
            Values of the estimated parameters on their scales.
        """
        given = as_array(theta, (len(self.estimated),), "theta")
        return dict(zip(self.scaled.names, self.scaled.values(given).tolist(), strict=True))

    def objective(self, theta: Any) -> tuple[float, Array]:
        """Return the negative log-likelihood and its gradient, for any optimiser.

        Parameters
        ----------
        theta : array_like, shape (n_estimated,)
            Values of the estimated parameters on their scales.

        Returns
        -------
        float, ndarray of shape (n_estimated,)
            The negative log-likelihood and its gradient; infinite and nan if a run fails.
        """
        found = self.predicted(theta)
        return -self.likelihood.log_likelihood(found), -self.likelihood.gradient(found)

    def residuals(self, theta: Any) -> Array:
        """Return the residuals divided by their noise, shape (n_rows,); nan if a run fails.

        Parameters
        ----------
        theta : array_like, shape (n_estimated,)
            Values of the estimated parameters on their scales.
        """
        return self.likelihood.residuals(self.predicted(theta))

    def jacobian(self, theta: Any) -> Array:
        """Return the exact Jacobian of the residuals, shape (n_rows, n_estimated).

        Parameters
        ----------
        theta : array_like, shape (n_estimated,)
            Values of the estimated parameters on their scales.
        """
        return self.likelihood.residual_slopes(self.predicted(theta))

    def predicted(self, theta: Any) -> Predictions:
        """Return predictions with derivatives at one point; the last result is cached.

        Parameters
        ----------
        theta : array_like, shape (n_estimated,)
            Values of the estimated parameters on their scales.
        """
        point = np.array(as_array(theta, (len(self.estimated),), "theta"), dtype=float)
        # Optimisers request values and derivatives at the same point by separate calls.
        key = point.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = key, self.predict([point])[0]
        return self._last[1]

    def _grouped(self) -> list[Group]:
        """Group the conditions that can run in one block; omit conditions without measurements."""
        found: dict[Hashable, list[int]] = {}
        for number, condition in enumerate(self.conditions):
            times = self.measured.t[self.measured.condition == number]
            if not times.size:
                continue
            key = (
                id(condition.model),
                # Tables cannot be hashed, so mappings of inputs are compared by identity.
                id(condition.inputs) if condition.inputs else 0,
                condition.t_start,
                float(times.max()),
                tuple(frozenset(link.initial) for link in condition.chain),
            )
            found.setdefault(key, []).append(number)
        names = self.scaled.names
        return [
            Group(
                [self.conditions[i] for i in numbers], numbers, self.measured, names, self.settings
            )
            for numbers in found.values()
        ]
