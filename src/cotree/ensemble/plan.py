"""Data structures of an ensemble: the plan that all members share, and the results of a block.

A member is a row of the values that differ between members. A plan and rows are sufficient to run a
block, in SIMD lanes, in threads or on another machine.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from cotree.model.model import CompiledModel
    from cotree.scene.settings import Settings
    from cotree.solvers.result import FloatArray, RunRecord


#: Smallest number of members for which SIMD lanes are compiled without being requested.
FEW = 100


@dataclass(frozen=True, eq=False)
class Plan:
    """Model and settings that all members of an ensemble share."""

    model: CompiledModel
    #: Settings of each run, including ``t_eval`` and ``method``. The values of a member replace
    #: parameters and initial values here.
    settings: Settings
    #: Names of the parameters and states whose values members set, in the order of a row.
    columns: tuple[str, ...]
    outputs: tuple[str, ...] = ()  # names of the outputs that are evaluated
    #: Number of members per vector. 1 disables vectors; None selects the processor's vector width.
    lanes: int | None = None
    #: Whether the method was chosen automatically. A member that an explicit method finds stiff is
    #: then run again with a method for stiff problems.
    is_chosen: bool = False

    @property
    def n_sensitivities(self) -> int:
        """Number of parameters whose sensitivities are integrated."""
        return len(self.model.sensitivities) if self.settings.sensitivities else 0


#: Status of a member that was not run because the ensemble was stopped.
NOT_RUN = -3

#: Message of a member that was not run.
NOT_RUN_SENTENCE = "it was not run: the ensemble was stopped before"


class Block:
    """Results of the members of a block, in the order of its rows.

    Values are nan if a member failed, and after the end of a member that an event stopped.

    Attributes
    ----------
    z : ndarray, shape (n_members, n_t, n_states * (1 + n_sensitivities))
    outputs : ndarray, shape (n_members, n_t, n_outputs)
    output_sensitivities : ndarray, shape (n_members, n_t, n_sensitivities, n_outputs)
    status : ndarray of int8, shape (n_members,)
        As in :class:`cotree.solvers.result.Trajectory`, or -3 if the ensemble was stopped before
        the member had run.
    messages : list of str
        A sentence for each member that failed, was not run, or was run by another method.
    seconds : ndarray, shape (n_members,)
        Wall-clock times, [s]; the time of a vector is divided among its members.
    events : ndarray, shape (n_events, 3 + n_sensitivities)
        Index of the member in the block, index of the event in ``model.layout.events``, its time,
        [s], and the sensitivities of the time. Rows are sorted by member, then by time.
    """

    def __init__(self, plan: Plan, n_members: int) -> None:
        n_t, n, n_y = np.size(plan.settings.t_eval), len(plan.model.states), len(plan.outputs)
        m = plan.n_sensitivities
        self.z = np.empty((n_members, n_t, n * (1 + m)))
        self.outputs = np.empty((n_members, n_t, n_y))
        self.output_sensitivities = np.empty((n_members, n_t, m, n_y))
        self.status = np.full(n_members, NOT_RUN, dtype=np.int8)
        self.messages = [NOT_RUN_SENTENCE] * n_members
        self.steps = np.zeros(n_members, dtype=np.int64)
        self.seconds = np.zeros(n_members)
        self.events = np.zeros((0, 3 + m))
        self._parts: list[FloatArray] = []  # event rows, joined when the block is finished

    def fail(self, member: int, status: int, message: str) -> None:
        """Add a failed member."""
        self._blank(member)
        self.status[member], self.messages[member] = status, message

    def succeed(self, members: npt.NDArray[np.bool_]) -> None:
        """Mark members whose values are set as successful."""
        self.status[members] = 0
        if members.all():
            self.messages = [""] * len(members)
            return
        for member in np.flatnonzero(members).tolist():
            self.messages[member] = ""

    def add_run(self, plan: Plan, member: int, run: RunRecord) -> None:
        """Add the results of a member from the record of its run."""
        self.steps[member] = run.statistics.n_steps
        self.fail(member, run.status, run.message if run.status != 0 else "")
        if run.status != 0:
            return
        n, m = len(plan.model.states), plan.n_sensitivities
        # If an event ended the run, the last point is at the event, not at an output time.
        wanted = np.asarray(plan.settings.t_eval, dtype=float)
        k = min(len(run.t), len(wanted))
        reached = int(np.count_nonzero(run.t[:k] == wanted[:k]))
        self.z[member, :reached, :n] = run.y.T[:reached]
        self.z[member, :reached, n:] = (
            run.s[:, :m].transpose(2, 1, 0).reshape(len(run.t), m * n)[:reached]
        )
        places = [plan.model.outputs.index(name) for name in plan.outputs]
        self.outputs[member, :reached] = run.output_values[places].T[:reached]
        found = run.output_sensitivities[places, :m].transpose(2, 1, 0)
        self.output_sensitivities[member, :reached] = found[:reached]
        names = [event.name for event in plan.model.layout.events]
        rows = [
            [float(member), float(names.index(name)), float(t), *times.s[:m, j]]
            for name, times in run.events.items()
            for j, t in enumerate(times.t)
        ]
        # The record groups events by name. A stable sort keeps simultaneous events in model order.
        events = np.array(rows, dtype=float).reshape(len(rows), 3 + m)
        self.add_events(events[np.argsort(events[:, 2], kind="stable")])

    def add_events(self, rows: FloatArray) -> None:
        """Add event rows, which are in order of time for each member."""
        self._parts.append(rows)

    def finished(self) -> Block:
        """Complete and return the block; members that were not added are nan."""
        is_left = self.status == NOT_RUN
        if is_left.any():
            self._blank(is_left)
        rows = np.concatenate([self.events, *self._parts])
        self.events, self._parts = rows[np.argsort(rows[:, 0], kind="stable")], []
        return self

    def _blank(self, members: int | npt.NDArray[np.bool_]) -> None:
        for array in (self.z, self.outputs, self.output_sensitivities):
            array[members] = np.nan
