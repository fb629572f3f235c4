"""Events of a compiled model as Python sees them: the values that they look at, and a start on one.

Events are found, and happen, in C: see ``templates/c/run/cotree_events.h.jinja``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.errors import SolveError
from cotree.model.moment import Moment
from cotree.model.unknowns import solve_start

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.equations import EventRow
    from cotree.model.model import CompiledModel
    from cotree.solvers.base import FloatArray


# Rates on both sides of a jump that differ by a smaller share are the same.
_SAME_RATE = 1e-12


class ModelEvents:
    """The events of a model at fixed parameters.

    Parameters
    ----------
    model : CompiledModel
        A model with events.
    p : ndarray, shape (n_parameters,)
        Its parameters.
    u : callable
        ``u(t)`` gives the inputs, shape (n_inputs,), or None for the model's own.

    Attributes
    ----------
    rows : tuple of EventRow
        Names and directions of the events, and which of them end a run.
    """

    def __init__(
        self,
        model: CompiledModel,
        p: FloatArray,
        u: Callable[[float], FloatArray | None],
    ) -> None:
        self.rows: tuple[EventRow, ...] = model.layout.events
        self._model, self._p, self._u = model, p, u
        self._n, self._m = len(model.states), len(model.sensitivities)
        self._values = model.bound("events", p)
        self._jumps = model.bound("jumps", p)
        self._along = model.bound("event_sensitivity", p)
        self._rhs = model.bound("rhs", p)
        #: Where the new values of each event stand among those of all.
        self._own = [slice(row.results.start, row.results.stop) for row in self.rows]

    def values(self, t: float, z: FloatArray) -> FloatArray:
        """Evaluate what the events look at, shape (n_events,), a fresh array."""
        return self._values(t, z[: self._n], z[self._n :], self._u(t)).copy()

    def check_start(self, t: float, z: FloatArray) -> None:
        """Refuse sensitivities where an expression jumps right at the start.

        Raises
        ------
        SolveError
            If a parameter moves the start off the jump, to either side of it.
        """
        if not self._m or not any(row.is_jump for row in self.rows):
            return
        values = self.values(t, z)
        along = self._along(t, z[: self._n], z[self._n :], self._u(t)).reshape(self._m, -1).copy()
        for i, row in enumerate(self.rows):
            moving = np.flatnonzero(along[:, i])
            if not row.is_jump or values[i] != 0.0 or not moving.size:
                continue
            if self._has_jump(row.targets[0], t, z):
                raise SolveError(
                    f"'{row.name}' happens right at the start, t = {t:.6g}, and "
                    f"'{self._model.sensitivities[int(moving[0])]}' moves the start off it, to "
                    "either side: there is no derivative; begin aside of the jump, or compile "
                    "without this sensitivity"
                )

    def _has_jump(self, mode: int, t: float, z: FloatArray) -> bool:
        """Tell whether rates change with a mode that stands for a jump."""
        y, u = z[: self._n], self._u(t)
        s = z[self._n :].reshape(self._m, self._n).T
        new = self._jumps(t, y, z[self._n :], u).copy()
        rates = []
        for own, row in zip(self._own, self.rows, strict=True):
            if row.targets == (mode,):
                other = y.copy()
                other[mode] = new[own][0]
                other, _ = solve_start(Moment(self._model, t, self._p, u), other, s)
                rates.append(self._rhs(t, other, np.zeros(0), u).copy())
        spread = np.ptp(rates, axis=0)
        return bool(np.any(spread > _SAME_RATE * np.max(np.abs(rates), axis=0)))
