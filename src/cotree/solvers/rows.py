"""Rows that C writes the stored points of a run to, within a bound.

In: the structure of a job. Out: times and values. Where times are asked for there is a row for
each; else each step has one, until they fill the memory that a run may take.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.solvers.budgets import Thinning

if TYPE_CHECKING:
    from cotree.solvers.base import FloatArray
    from cotree.solvers.problem import Problem

# Rows to begin with, and rows that move at once when others are dropped.
_FIRST_ROWS, _ROWS_AT_ONCE = 256, 1024


class Rows:
    """The rows of a job; it is mutable and belongs to one.

    Parameters
    ----------
    ffi : object
        Of the engine.
    job : cotree_job
        The structure that points to the rows.
    n_values : int
        How many values a row has.

    Attributes
    ----------
    times, values : ndarray
        The rows; the first ``job.n_kept`` count.
    thinning : Thinning
        Which steps are stored.
    """

    def __init__(self, ffi: Any, job: Any, n_values: int) -> None:
        self._ffi, self._job, self._n, self._room = ffi, job, n_values, -1
        self.times, self.values = np.zeros(0), np.zeros((0, n_values))
        self._pointers: tuple[Any, Any] = (ffi.NULL, ffi.NULL)

    def begin(self, problem: Problem) -> None:
        """Make room for the rows of a run; those of an earlier one are void."""
        self._most_room, self._keeps_steps = problem.most_rows, problem.settings.t_eval is None
        self.thinning, self._n_thinned = Thinning(), 0
        first = min(_FIRST_ROWS, self._most_room)
        wanted = first if problem.settings.t_eval is None else len(problem.settings.t_eval)
        if self._room != wanted:
            self._make_room(wanted)
        self._job.times, self._job.values = self._pointers

    def stored(self, z: FloatArray, *, is_cut: bool) -> tuple[FloatArray, FloatArray]:
        """Return times and values that are kept, each shape (..., n_t), with where the job stands.

        Parameters
        ----------
        z : ndarray
            Where the job stands.
        is_cut : bool
            Whether it stopped early: that point is then stored whether it was asked for or not.
        """
        kept = int(self._job.n_kept)
        # A step that was dropped may be the last one.
        if is_cut or self.thinning.stride > 1:
            if kept == self._room:
                self._make_room(kept + 1)
            if not (kept and self.times[kept - 1] == self._job.t):
                self.times[kept], self.values[kept] = self._job.t, z
                kept += 1
        return self.times[:kept].copy(), self.values[:kept].T.copy()

    def steps_with_room(self, most_steps: int) -> int:
        """Make room for steps up to the bound, drop some beyond it; tell how many may be taken."""
        if not self._keeps_steps:
            return most_steps
        while True:
            kept = int(self._job.n_kept)
            # A row for each step, one for the start, one for the end, and where others were dropped
            # those of events beside them.
            each = 1 if self.thinning.stride == 1 else 2
            needed = kept + each * most_steps + 2
            if needed <= self._room:
                return most_steps
            if self._room < self._most_room:
                self._make_room(min(max(needed, 2 * self._room), self._most_room))
                continue
            allowed = (self._room - kept - 2) // each
            if 4 * allowed >= self._room // each:
                return allowed
            self._keep_rows(0, self.thinning.thin())

    def drop_between(self) -> None:
        """Drop the new steps between those that are to be stored."""
        if not self._keeps_steps:
            return
        # An event may have replaced the last row that was counted.
        first = min(self._n_thinned, int(self._job.n_kept))
        chosen = self.thinning.taken(int(self._job.n_kept) - first)
        self._keep_rows(first, chosen)

    def _keep_rows(self, first: int, chosen: slice) -> None:
        """Keep some of the rows from ``first`` on."""
        if chosen.step != 1:
            places = range(first, int(self._job.n_kept))[chosen]
            # Rows move to where nothing is needed any more, part by part: no copy of all is made.
            for start in range(0, len(places), _ROWS_AT_ONCE):
                part = places[start : start + _ROWS_AT_ONCE]
                to = slice(first + start, first + start + len(part))
                of = slice(part.start, part.stop, part.step)
                self.times[to], self.values[to] = self.times[of], self.values[of]
            self._job.n_kept = first + len(places)
        self._n_thinned = int(self._job.n_kept)

    def _make_room(self, rows: int) -> None:
        """Make room for kept values; existing ones stay."""
        kept = int(self._job.n_kept)
        times, values = np.zeros(rows), np.zeros((rows, self._n))
        times[:kept], values[:kept] = self.times[:kept], self.values[:kept]
        self.times, self.values, self._room = times, values, rows
        values_at = self._ffi.from_buffer("double[]", values) if self._n else self._ffi.NULL
        self._pointers = self._ffi.from_buffer("double[]", times), values_at
        self._job.times, self._job.values = self._pointers
