"""Simulation of conditions in ensemble blocks; those of a block share model, start and end time.

In: conditions, measured rows, and values of the estimated parameters. Out: the measured quantities
with their derivatives with respect to the estimated parameters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cotree.ensemble.batch import run_block, usable_cores
from cotree.ensemble.members import MEMBER, Members
from cotree.ensemble.run import make_plan
from cotree.estimation.columns import Columns
from cotree.estimation.steady import SteadyStates
from cotree.solvers.settings import Settings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.ensemble.plan import Block, Plan
    from cotree.estimation.columns import Accuracy
    from cotree.estimation.conditions import Condition, Measured

Array = npt.NDArray[np.float64]
Places = npt.NDArray[np.intp]

# Length of a run for which only the initial time was measured, [s].
_SHORTEST = 1.0


@dataclass(frozen=True, eq=False)
class Quantities:
    """Predicted quantities for some points in parameter space and all rows of a group.

    Attributes
    ----------
    values : ndarray, shape (n_thetas, n)
        Values.
    slopes : ndarray, shape (n_thetas, n, n_estimated)
        Derivatives with respect to the values of the estimated parameters, not their logarithms;
        empty if not requested.
    messages : tuple of str
        For each point, why a run failed, or an empty string.
    """

    values: Array
    slopes: Array
    messages: tuple[str, ...]


class Group:
    """Conditions that run in one block, with their measured rows.

    Parameters
    ----------
    conditions : sequence of Condition
        They share model, inputs, start, and the names of the initial values they set.
    numbers : sequence of int
        Their numbers in the problem.
    measured : Measured
        All measured rows.
    names : sequence of str
        Names of the estimated parameters.
    accuracy : Accuracy
        Method and tolerances.

    Attributes
    ----------
    rows : ndarray of int
        The measured rows of these conditions.
    """

    def __init__(
        self,
        conditions: Sequence[Condition],
        numbers: Sequence[int],
        measured: Measured,
        names: Sequence[str],
        accuracy: Accuracy,
    ) -> None:
        first = conditions[0]
        self._model, self._conditions, self._names = first.model, conditions, names
        parameters = dict.fromkeys(name for c in conditions for name in c.parameters)
        self._columns = (*parameters, *first.initial)
        self._maps = [Columns(c, self._columns, names) for c in conditions]
        through = [item.through for item in self._maps]
        self._steady = SteadyStates(conditions, names, accuracy) if first.before else None
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
        self._threads = usable_cores()
        self._settings = Settings(
            t_span=(start, end if end > start else start + _SHORTEST),
            t_eval=times,
            method=accuracy.method,
            rtol=accuracy.rtol,
            atol=accuracy.atol,
            inputs=first.inputs,
            max_steps=accuracy.max_steps,
        )
        self._quantities(measured)
        self._plans: dict[bool, Plan] = {}

    def _quantities(self, measured: Measured) -> None:
        """Locate the observables and standard deviations of the rows within a block."""
        wanted = [measured.observable[i] for i in self.rows.tolist()]
        noise = [measured.noise[i] for i in self.rows.tolist()]
        known = {*self._model.states, *self._model.outputs}
        self.numbers = np.array([np.nan if isinstance(v, str) else v for v in noise], dtype=float)
        self._with_noise = np.array([i for i, v in enumerate(noise) if v in known], dtype=np.intp)
        # Standard deviations that are estimated parameters: their rows and parameter numbers.
        direct = [i for i, v in enumerate(noise) if isinstance(v, str) and v not in known]
        self._direct = np.array(direct, dtype=np.intp)
        self._direct_of = np.array([self._names.index(str(noise[i])) for i in direct], np.intp)
        wanted += [str(noise[i]) for i in self._with_noise]
        states = self._model.states
        self._outputs = tuple(dict.fromkeys(name for name in wanted if name not in states))
        # Order of the columns: states, then the requested outputs.
        place = {name: i for i, name in enumerate((*states, *self._outputs))}
        self._which = np.array([place[name] for name in wanted], dtype=np.intp)
        self._member = np.concatenate([self._condition_of, self._condition_of[self._with_noise]])
        self._time = np.concatenate([self._at, self._at[self._with_noise]])

    def run(self, values: Array, *, slopes: bool) -> tuple[Quantities, Quantities]:
        """Run all conditions for each row of parameter values.

        Parameters
        ----------
        values : ndarray, shape (n_thetas, n_estimated)
            Values of the estimated parameters.
        slopes : bool
            Whether to compute derivatives.

        Returns
        -------
        Quantities, Quantities
            Observables and standard deviations; given numbers are passed through.
        """
        n, n_rows = len(values), len(self.rows)
        rows = np.array([item.row(theta) for theta in values for item in self._maps])
        columns, failed = self._columns, [""] * len(rows)
        if self._steady is not None:
            columns, rows, failed = self._steady.begin(columns, rows, values, slopes=slopes)
        block = run_block(self._plan(columns, rows, slopes=slopes), rows, threads=self._threads)
        found, along = self._read(block, n, slopes=slopes)
        messages = self._messages(block, failed, n)
        sigma = np.tile(self.numbers, (n, 1))
        sigma[:, self._with_noise] = found[:, n_rows:]
        sigma_along = np.zeros((n, n_rows, along.shape[2]))
        sigma_along[:, self._with_noise] = along[:, n_rows:]
        sigma[:, self._direct] = values[:, self._direct_of]
        if slopes:
            sigma_along[:, self._direct, self._direct_of] = 1.0
        return (
            Quantities(found[:, :n_rows], along[:, :n_rows], messages),
            Quantities(sigma, sigma_along, messages),
        )

    def _plan(self, columns: Sequence[str], rows: Array, *, slopes: bool) -> Plan:
        if slopes not in self._plans:
            # The method is chosen at the first point. If a distant point turns out to be stiff,
            # that is detected during its run.
            first = rows[: len(self._conditions)]
            members = Members(tuple(columns), first, {MEMBER: np.arange(len(first))})
            # It is chosen once, so that results do not depend on the history of evaluations.
            known = next(iter(self._plans.values()), None)
            settings = self._settings if known is None else known.settings
            plan = make_plan(
                self._model,
                settings,
                members,
                sensitivities=slopes,
                outputs=self._outputs,
                lanes=1,
            )
            if known is not None:
                plan = replace(plan, is_chosen=known.is_chosen)
            self._plans[slopes] = plan
        return self._plans[slopes]

    def _read(self, block: Block, n: int, *, slopes: bool) -> tuple[Array, Array]:
        """Extract values and their derivatives by the estimated parameters from a block."""
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
        """Return for each point why one of its runs failed, or an empty string."""
        n_c, found = len(self._conditions), []
        # An event may end a run before the last measurement.
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
