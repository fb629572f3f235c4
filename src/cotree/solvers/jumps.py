"""Events of a compiled model: what they look at, and what they do to states and sensitivities.

With f the rates, g what an event looks at, R what it makes of the states, and - and + before and
after it, its time depends on the parameters as ``t_p = -(g_x S- + g_p) / (g_x f- + g_t)``, and
``S+ = R_x S- + R_p + (R_x f- + R_t - f+) t_p``. The model's kernels give g_x S + g_p and
g_x f + g_t, and the same of R, as directional derivatives.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.errors import ParameterError, SolveError
from cotree.model.consistent import Start, consistent_start
from cotree.model.unknowns import solve_start
from cotree.solvers.verdicts import verdict

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree.equations import EventRow
    from cotree.model.model import CompiledModel
    from cotree.solvers.problem import FloatArray


# Rates on both sides of a jump that differ by a smaller share are the same.
_SAME_RATE = 1e-12


class ModelEvents:
    """The events of a model at fixed parameters; see :class:`cotree.solvers.problem.Events`.

    Parameters
    ----------
    model : CompiledModel
        A model with events.
    p : ndarray, shape (n_parameters,)
        Its parameters.
    u : callable
        ``u(t)`` gives the inputs, shape (n_inputs,), or None for the model's own.
    is_held : bool
        Whether what is set is to satisfy the constraints at once, as all of the run does.
    """

    def __init__(
        self,
        model: CompiledModel,
        p: FloatArray,
        u: Callable[[float], FloatArray | None],
        is_held: bool,
    ) -> None:
        self.rows: tuple[EventRow, ...] = model.layout.events
        self._model, self._p, self._u, self._is_held = model, p, u, is_held
        self._n, self._m = len(model.states), len(model.sensitivities)
        self._cut = self._n - model.layout.n_algebraic
        self._values = model.bound("events", p)
        self._jumps = model.bound("jumps", p)
        self._along = model.bound("event_sensitivity", p)
        self._rates = model.bound("event_rates", p)
        self._rhs = model.bound("rhs", p)
        self._jacobian = model.bound_jacobian(p)
        #: Where the new values of each event stand among those of all.
        self._own = [slice(row.results.start, row.results.stop) for row in self.rows]

    def values(self, t: float, z: FloatArray) -> FloatArray:
        """Evaluate what the events look at, shape (n_events,), a fresh array."""
        return self._values(t, z[: self._n], z[self._n :], self._u(t)).copy()

    def rates(self, t: float, z: FloatArray) -> FloatArray:
        """Evaluate its time derivatives along the motion, shape (n_events,)."""
        found: FloatArray = self._derivatives(t, z[: self._n])[1][: len(self.rows)]
        return found

    def apply(
        self, i: int, t: float, z: FloatArray, time_sensitivity: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Let an event happen.

        Parameters
        ----------
        i : int
            Which.
        t : float
            When, [s].
        z : ndarray
            States and sensitivities before it.
        time_sensitivity : ndarray, shape (n_parameters,), optional
            How its time depends on the parameters, where something else decides it.

        Returns
        -------
        z : ndarray
            States and sensitivities after it.
        time_sensitivity : ndarray, shape (n_parameters,)

        Raises
        ------
        SolveError
            If what it sets contradicts the constraints, or leaves a choice that sensitivities do
            not know of.
        """
        y, s = z[: self._n], z[self._n :].reshape(self._m, self._n)
        row, own, n_events = self.rows[i], self._own[i], len(self.rows)
        targets = list(row.targets)
        before, rates = self._derivatives(t, y)
        after = y.copy()
        if targets:
            after[targets] = self._jumps(t, y, z[self._n :], self._u(t))[own]
        moved = s.copy()
        t_p = np.zeros(self._m) if time_sensitivity is None else time_sensitivity
        if self._m:
            along = self._along(t, y, z[self._n :], self._u(t)).reshape(self._m, -1)
            if time_sensitivity is None:
                t_p = -along[:, i] / rates[i]
            moved[:, targets] = along[:, n_events:][:, own]
            before[targets] = rates[n_events:][own]
        after, found = self._settled(row, t, after, moved, before, t_p)
        return np.concatenate([after, found.ravel()]), t_p

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
                other, _ = solve_start(self._model, t, self._p, u, other, s)
                rates.append(self._rhs(t, other, np.zeros(0), u).copy())
        spread = np.ptp(rates, axis=0)
        return bool(np.any(spread > _SAME_RATE * np.max(np.abs(rates), axis=0)))

    def is_due(self, i: int, t: float, z: FloatArray) -> bool:
        """Tell whether an event that sets one mode would change it."""
        (target,) = self.rows[i].targets
        new = self._jumps(t, z[: self._n], z[self._n :], self._u(t))[self._own[i]]
        return bool(new[0] != z[target])

    def _derivatives(self, t: float, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Give the rates of all states, algebraic unknowns too, and the kernel's at these."""
        u = self._u(t)
        along = self._rhs(t, y, np.zeros(0), u).copy()
        along[self._cut :] = 0.0
        rates = self._rates(t, y, along, u).copy()
        if self._cut < self._n:
            # Residuals stay zero along the motion: g_x x' + g_t + g_z z' = 0.
            block = self._jacobian(t, y, u)[self._cut :, self._cut :]
            along[self._cut :] = -np.linalg.solve(block, rates[self._cut - self._n :])
            rates = self._rates(t, y, along, u).copy()
        return along, rates

    def _settled(
        self,
        row: EventRow,
        t: float,
        y: FloatArray,
        s: FloatArray,
        moving: FloatArray,
        t_p: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Bring what an event made onto the constraints; complete the sensitivities after it.

        ``moving`` is R_x f- + R_t. What was set is kept; the rest follows from the constraints.
        """
        try:
            start = self._consistent(t, y, s, row.kept)
        except ParameterError as error:
            raise SolveError(f"{verdict('contradicts', [row.name])} ({error})") from None
        if self._m and start.is_chosen:
            raise SolveError(verdict("chooses", [row.name]))
        y, _ = solve_start(self._model, t, self._p, self._u(t), start.y, start.s)
        if not self._m:
            return y, s
        after = self._rhs(t, y, np.zeros(0), self._u(t)).copy()
        s = s + np.outer(t_p, moving - after)
        s[:, self._cut :] = 0.0
        held = self._consistent(t, y, s, row.kept)
        return y, solve_start(self._model, t, self._p, self._u(t), y, held.s)[1].T

    def _consistent(self, t: float, y: FloatArray, s: FloatArray, kept: Sequence[int]) -> Start:
        if not self._is_held:
            return Start(y, s.T)
        return consistent_start(self._model, t, self._p, y, s.T, kept, is_initial=False)
