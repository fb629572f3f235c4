"""Events of a compiled model as Python sees them: the values that they look at, and a start on one.

Events are found, and happen, in C: see ``templates/runtime/events/cotree_events.h``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.errors import ModelError, SolveError
from cotree.model.model import Moment
from cotree.model.unknowns import solve_start

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.equations import EventRow
    from cotree.model.model import CompiledModel
    from cotree.solvers.base import FloatArray


# Rates on both sides of a jump that differ by a smaller share are the same.
_SAME_RATE = 1e-12


# A contact jams where friction makes its force this many times larger.
_JAMMED = 100.0


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

    def _at(self, t: float) -> Moment:
        return Moment(self._model, t, self._p, self._u(t))

    def _parts(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the states, and the sensitivities of each parameter in a column."""
        n = len(self._model.states)
        return z[:n], z[n:].reshape(len(self._model.sensitivities), n).T

    def values(self, t: float, z: FloatArray) -> FloatArray:
        """Evaluate the values that the events watch, shape (n_events,), a fresh array."""
        return self._at(t).event_values(*self._parts(z))

    def check_start(self, t: float, z: FloatArray) -> None:
        """Refuse sensitivities where an expression jumps right at the start.

        Raises
        ------
        SolveError
            If a parameter moves the start off the jump, to either side of it.
        """
        wanted = self._model.sensitivities
        if not wanted or not any(row.is_jump for row in self.rows):
            return
        values = self.values(t, z)
        # One row for each parameter, with the derivative of what each event looks at.
        along = self._at(t).call("event_sensitivity", *self._parts(z)).reshape(len(wanted), -1)
        for i, row in enumerate(self.rows):
            moving = np.flatnonzero(along[:, i])
            # There are two sides only where the start lies on a jump and a parameter moves it.
            if not row.is_jump or values[i] != 0.0 or not moving.size:
                continue
            if self._has_jump(row.targets[0], t, z):
                raise SolveError(
                    f"'{row.name}' happens right at the start, t = {t:.6g}, and "
                    f"'{wanted[int(moving[0])]}' moves the start off it, to "
                    "either side: there is no derivative; begin aside of the jump, or compile "
                    "without this sensitivity"
                )

    def jammed(self, t: float, z: FloatArray) -> str:
        """Describe which contacts jam at a point where an integration fails; empty if none does.

        Friction that slides may press its contact together the harder, the harder it is pressed. It
        does so without bound where it takes away all of what the contact has to move.

        Parameters
        ----------
        t : float
            Time of the point, [s].
        z : ndarray, shape (n_states * (1 + n_sensitivities),)
            The point.
        """
        y, s = self._parts(z)
        at, found = self._at(t), []
        for row in self.rows:
            # Its targets are its mode, then that of the stop.
            if not row.is_pressed or round(abs(y[row.targets[0]])) != 1:
                continue
            force = next(
                i
                for i, other in enumerate(self.rows)
                if other.is_lift and other.targets[0] == row.targets[1]
            )
            other = y.copy()
            other[row.targets[0]] = 2.0
            try:
                other, _ = solve_start(at, other, s)
            except (ModelError, SolveError):
                continue
            with_friction, without = (at.event_values(point, s)[force] for point in (y, other))
            if with_friction > _JAMMED * without > 0.0:
                found.append(f"'{self.rows[force].name.removesuffix(' lifts')}'")
        if not found:
            return ""
        return (
            f"What slides at {', '.join(found)} jams: with friction as strong as this, the force "
            "that presses it together grows beyond all bounds (Painleve's paradox)."
        )

    def _has_jump(self, mode: int, t: float, z: FloatArray) -> bool:
        """Return whether rates change with a mode that stands for a jump."""
        at, (y, s), rates = self._at(t), self._parts(z), []
        new = at.call("jumps", y, s)
        for row in self.rows:
            # The events that set this mode stand for the sides of the jump, each with its rates.
            if row.targets == (mode,):
                other = y.copy()
                other[mode] = new[row.results.start]
                other, _ = solve_start(at, other, s)
                rates.append(at.call("rhs", other))
        spread = np.ptp(rates, axis=0)
        return bool(np.any(spread > _SAME_RATE * np.max(np.abs(rates), axis=0)))
