"""Starts at a steady state: a run that goes on until nothing changes, with its sensitivities.

In networks with conserved quantities the steady state depends on the initial values, and the
Jacobian there is singular. A root finder would need the conservation laws; a run and its
sensitivities respect them by themselves.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cotree.ensemble.batch import run_block, usable_cores
from cotree.ensemble.members import MEMBER, Members
from cotree.ensemble.run import make_plan
from cotree.errors import ParameterError
from cotree.estimation.columns import Columns
from cotree.solvers.settings import Settings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.ensemble.plan import Plan
    from cotree.estimation.columns import Accuracy
    from cotree.estimation.conditions import Condition

Array = npt.NDArray[np.float64]

# Times at which a run to the steady state is checked, [s]. Steps of implicit methods grow as the
# states settle, so that each of the last decades takes only a few steps.
_TIMES = 10.0 ** np.arange(-2, 11)

# Values are at rest if they change by less than this, in multiples of the tolerances, over a decade
# of time: within ten times the time an exponential decays to a negligible rest.
_CHANGE = 10.0


class SteadyStates:
    """Steady states at which the conditions of a group begin.

    Parameters
    ----------
    conditions : sequence of Condition
        They have ``before``.
    names : sequence of str
        Names of the estimated parameters.
    accuracy : Accuracy
        Method and tolerances.

    Raises
    ------
    ParameterError
        If an estimated parameter acts in a different place in the run before, or if the models
        differ.
    """

    def __init__(
        self, conditions: Sequence[Condition], names: Sequence[str], accuracy: Accuracy
    ) -> None:
        self._conditions, self._accuracy, self._names = conditions, accuracy, names
        self._model = conditions[0].model
        first_runs = [c.before for c in conditions if c.before is not None]
        # Several conditions may begin at one steady state.
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
            SteadyStates(self._distinct, names, accuracy) if first_runs[0].before else None
        )
        self._threads = usable_cores()
        self._plans: dict[bool, Plan] = {}
        self._keeps: list[npt.NDArray[np.bool_]] = []

    def through(self, own: Sequence[Array]) -> list[Array]:
        """Map sensitivities to estimated parameters for runs that begin at the steady states.

        Parameters
        ----------
        own : sequence of ndarray, shapes (n_sensitivities, n_estimated)
            The maps of the later runs alone; see :class:`Columns`.

        Raises
        ------
        ParameterError
            If a parameter acts in a different place than in the run before.
        """
        model, found = self._model, []
        earlier = [item.through for item in self._maps]
        if self._first is not None:
            earlier = self._first.through(earlier)
        for i, (condition, after) in enumerate(zip(self._conditions, own, strict=True)):
            before = earlier[self._of[i]]
            # Sensitivities to initial values that only the run before estimates are free here.
            is_initial = np.array([name in model.states for name in model.sensitivities])
            both = np.where((is_initial & ~after.any(axis=1))[:, None], before, after)
            for m, j in np.argwhere((before != both) & (before != 0)):
                raise ParameterError(
                    f"the estimated parameter '{self._names[j]}' is '{model.sensitivities[m]}' in "
                    f"the run to the steady state of condition '{condition.name}', but not later"
                )
            # Sensitivities to what was a fixed number before begin at zero.
            self._keeps.append(np.asarray(before.any(axis=1)))
            found.append(both)
        return found

    def begin(
        self, columns: Sequence[str], rows: Array, values: Array, *, slopes: bool
    ) -> tuple[tuple[str, ...], Array, list[str]]:
        """Add the steady states to the columns of members.

        Parameters
        ----------
        columns : sequence of str
            Columns that members set already; initial values among them are kept.
        rows : ndarray, shape (n_thetas * n_conditions, n_columns)
            Their values.
        values : ndarray, shape (n_thetas, n_estimated)
            Values of the estimated parameters.
        slopes : bool
            Whether sensitivities are wanted.

        Returns
        -------
        columns : tuple of str
            More columns.
        rows : ndarray
            More values.
        failed : list of str
            For each member the reason why there is no steady state, or an empty string.
        """
        own = np.array([item.row(theta) for theta in values for item in self._maps])
        its, said = self._columns, [""] * len(own)
        if self._first is not None:
            its, own, said = self._first.begin(its, own, values, slopes=slopes)
        block = run_block(self._plan(its, own, slopes=slopes), own, threads=self._threads)
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
            if said[i]:
                failed[k] = said[i]
            elif block.status[i] != 0:
                failed[k] = f"the run to its steady state: {block.messages[i]}"
            elif rest[i] is None:
                failed[k] = f"no steady state before it: states still change at t = {_TIMES[-1]:g}"
            else:
                goes_on = np.concatenate([np.ones(n), np.repeat(self._keeps[k % n_c], n)])
                found[k] = (block.z[i, rest[i]] * goes_on[: n * (1 + m)])[kept]
        return (*columns, *(names[j] for j in kept)), np.hstack([rows, found]), failed

    def _at_rest(self, z: Array, n: int) -> int | None:
        """Find the first of the checked times at which values have stopped changing."""
        a = self._accuracy
        size = np.maximum(np.abs(z[:-1]), np.abs(z[1:]))
        change = np.abs(np.diff(z, axis=0)) <= _CHANGE * (a.atol + a.rtol * size)
        # Small sensitivities are compared with the largest one to the same parameter.
        slopes = np.abs(z[:, n:].reshape(len(z), -1, n)).max(axis=2, keepdims=True)
        near = np.abs(np.diff(z[:, n:].reshape(len(z), -1, n), axis=0)) <= (
            _CHANGE * a.rtol * slopes[1:]
        )
        change[:, n:] |= near.reshape(len(z) - 1, -1)
        found = np.flatnonzero(change.all(axis=1))
        return int(found[0]) + 1 if found.size else None

    def _plan(self, columns: Sequence[str], rows: Array, *, slopes: bool) -> Plan:
        if slopes not in self._plans:
            accuracy, first = self._accuracy, self._distinct[0]
            settings = Settings(
                t_span=(0.0, float(_TIMES[-1])),
                t_eval=_TIMES,
                # Explicit methods would take too many steps to the last of these times.
                method="rodas5" if accuracy.method == "auto" else accuracy.method,
                rtol=accuracy.rtol,
                atol=accuracy.atol,
                inputs=first.inputs,
                max_steps=accuracy.max_steps,
            )
            members = Members(tuple(columns), rows, {MEMBER: np.arange(len(rows))})
            self._plans[slopes] = make_plan(
                self._model, settings, members, sensitivities=slopes, outputs=(), lanes=1
            )
        return self._plans[slopes]
