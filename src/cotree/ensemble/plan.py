"""The two data structures of an ensemble: what all members share, and the results of some of them.

In: a model, settings of a run and the names of what members differ in. Members themselves are rows
of numbers. Whoever runs a block of rows, on lanes, threads or another machine, gets a ``Plan`` and
these rows, and gives a ``Block``, whose numbers depend on nothing else.
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


#: Members for which the code of lanes is not compiled, where nobody asks for lanes.
FEW = 100


@dataclass(frozen=True, eq=False)
class Plan:
    """Model and settings that all members of an ensemble share."""

    model: CompiledModel
    #: Settings of each run; ``t_eval`` and ``method`` are given. A member's own values go before
    #: the parameters and initial values here.
    settings: Settings
    #: Parameters, and states by their initial values, that members set, in the order of a row.
    columns: tuple[str, ...]
    outputs: tuple[str, ...] = ()  # the outputs that are evaluated
    #: Members side by side in vectors: 1 for none, None for as many as the processor has.
    lanes: int | None = None
    #: Whether the method was chosen for all members and not asked for, and some may become stiff: a
    #: member that an explicit one finds stiff on its way is then run from its start with one for
    #: stiff problems.
    is_chosen: bool = False

    @property
    def has_sensitivities(self) -> bool:
        """Whether sensitivities are integrated."""
        return self.settings.sensitivities and bool(self.model.sensitivities)


@dataclass(frozen=True, eq=False)
class Happened:
    """The events of some members, one entry for each time that one happened."""

    member: npt.NDArray[np.intp]  # places of the members in the block, in increasing order
    event: npt.NDArray[np.intp]  # numbers of the events in ``model.layout.events``
    t: FloatArray  # times, [s], increasing for each member
    s: FloatArray  # sensitivities of the times, [s / parameter unit]


@dataclass(frozen=True, eq=False)
class Block:
    """Results of some members, in the order of their rows."""

    #: States, then their sensitivities parameter by parameter. All values of a member that failed
    #: are nan, and those behind the end of one that an event stopped.
    z: FloatArray
    outputs: FloatArray  # outputs, likewise
    output_sensitivities: FloatArray  # their sensitivities
    #: As of :class:`cotree.solvers.result.Trajectory`; -3 where the ensemble was stopped before the
    #: member had run.
    status: npt.NDArray[np.int8]
    #: A sentence for each member that failed or was not run, or that another method ran; empty for
    #: others.
    messages: tuple[str, ...]
    steps: npt.NDArray[np.int64]  # accepted steps
    #: Wall-clock time of each, [s]; members in the lanes of one vector share theirs.
    seconds: FloatArray
    happened: Happened  # the events


#: The status of a member that was not run, since the ensemble was stopped.
NOT_RUN = -3

#: What a member says then.
NOT_RUN_SENTENCE = "it was not run: the ensemble was stopped before"


class Results:
    """Results of the members of a block; it is mutable, and members are put in in any order.

    Attributes
    ----------
    z, outputs, slopes, status, messages, steps, seconds
        As the arrays of a ``Block``; of members that are not put in ``z``, ``outputs`` and
        ``slopes`` hold anything.
    """

    def __init__(self, plan: Plan, n_members: int) -> None:
        n_t, n, n_y = np.size(plan.settings.t_eval), len(plan.model.states), len(plan.outputs)
        m = self.n_sensitivities = n_sensitivities(plan)
        self._plan = plan
        self._events = [event.name for event in plan.model.layout.events]
        self._places = [plan.model.outputs.index(name) for name in plan.outputs]
        self._happened: list[FloatArray] = []
        self.z = np.empty((n_members, n_t, n * (1 + m)))
        self.outputs = np.empty((n_members, n_t, n_y))
        self.slopes = np.empty((n_members, n_t, m, n_y))
        self.status = np.full(n_members, NOT_RUN, dtype=np.int8)
        self.messages = [NOT_RUN_SENTENCE] * n_members
        self.steps = np.zeros(n_members, dtype=np.int64)
        self.seconds = np.zeros(n_members)

    def leave_blank(self, member: int) -> None:
        """Set all values of a member to nan."""
        for array in (self.z, self.outputs, self.slopes):
            array[member] = np.nan

    def fail(self, member: int, status: int, message: str) -> None:
        """Put in a member that failed."""
        self.leave_blank(member)
        self.status[member], self.messages[member] = status, message

    def succeed(self, members: npt.NDArray[np.bool_]) -> None:
        """Put in members whose values are all there."""
        self.status[members] = 0
        if members.all():
            self.messages = [""] * len(members)
            return
        for member in np.flatnonzero(members).tolist():
            self.messages[member] = ""

    def put(self, member: int, run: RunRecord) -> None:
        """Put in a member that ran by itself."""
        self.steps[member] = run.statistics.n_steps
        if run.status != 0:
            self.fail(member, run.status, run.message)
            return
        self.leave_blank(member)
        self.status[member], self.messages[member] = 0, ""
        n, m = len(self._plan.model.states), self.n_sensitivities
        # Where an event ends a run, its last point is that of the event, which nobody asked for.
        wanted = np.asarray(self._plan.settings.t_eval, dtype=float)
        k = min(len(run.t), len(wanted))
        reached = int(np.count_nonzero(run.t[:k] == wanted[:k]))
        self.z[member, :reached, :n] = run.y.T[:reached]
        self.z[member, :reached, n:] = (
            run.s[:, :m].transpose(2, 1, 0).reshape(len(run.t), m * n)[:reached]
        )
        self.outputs[member, :reached] = run.output_values[self._places].T[:reached]
        found = run.output_sensitivities[self._places, :m].transpose(2, 1, 0)
        self.slopes[member, :reached] = found[:reached]
        self._happened.append(_happened(run, member, self._events, m))

    def add_events(self, rows: FloatArray) -> None:
        """Add events, a row each: member, event, time, and the derivatives of the time."""
        self._happened.append(rows)

    def block(self) -> Block:
        """Return what was put in; other members were not run."""
        is_left = self.status == NOT_RUN
        for array in (self.z, self.outputs, self.slopes) if is_left.any() else ():
            array[is_left] = np.nan
        return Block(
            self.z,
            self.outputs,
            self.slopes,
            self.status,
            tuple(self.messages),
            self.steps,
            self.seconds,
            _gathered(self._happened, self.n_sensitivities),
        )


def n_sensitivities(plan: Plan) -> int:
    """Count the parameters of sensitivity of a run."""
    return len(plan.model.sensitivities) if plan.has_sensitivities else 0


def _happened(run: RunRecord, member: int, names: list[str], m: int) -> FloatArray:
    """List the events of one run, a row each."""
    rows = [
        [float(member), float(names.index(name)), float(t), *times.s[:m, j]]
        for name, times in run.events.items()
        for j, t in enumerate(times.t)
    ]
    # Events are grouped by name; those at one time stay in the order of the model.
    found = np.array(rows, dtype=float).reshape(len(rows), 3 + m)
    return found[np.argsort(found[:, 2], kind="stable")]


def _gathered(parts: list[FloatArray], m: int) -> Happened:
    """Put events together, by member; those of each are in order already."""
    rows = np.concatenate([np.zeros((0, 3 + m)), *parts])
    if len(rows):
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
    return Happened(
        rows[:, 0].astype(np.intp), rows[:, 1].astype(np.intp), rows[:, 2].copy(), rows[:, 3:]
    )
