"""A worker: what one thread needs to run members of a block in C, and what it does besides."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.ensemble.block_in_c import STIFF
from cotree.ensemble.lanes import LoadedLanes
from cotree.ensemble.one_by_one import settings_of
from cotree.ensemble.pattern import problem_of
from cotree.ensemble.spent import EVENTS_SPENT, STEPS_SPENT, TIME_SPENT, spent_sentence
from cotree.errors import Error
from cotree.quiet import without_warnings
from cotree.solvers.evaluate import FAILED
from cotree.solvers.methods import refusal
from cotree.solvers.stiffness_switching import is_confirmed, stiff_method
from cotree.tolerances import LIMITS

if TYPE_CHECKING:
    from cotree.ensemble.block_in_c import BlockInC
    from cotree.solvers.base import FloatArray
    from cotree.solvers.job import Job
    from cotree.solvers.problem import Problem

# Results of cotree_batch_work.
_EMPTY, _GLANCE, _ROOM, _ASK, _STOPPED, _GIVE = range(6)


class Worker:
    """Runs members in the thread that calls it; it is mutable.

    Parameters
    ----------
    members : BlockInC
        The members, which other workers take from, too.
    """

    def __init__(self, members: BlockInC) -> None:
        self._members, self._lib = members, members.library.lib
        self._ffi, self._pattern = members.library.ffi, members.pattern
        self._kept: dict[str, Any] = {}
        # The member that was prepared last, with its problem; and the job of all that are.
        self._asked: tuple[int, Problem] | None = None
        self._job: Job | None = None
        problem, model = self._pattern.problem, self._pattern.plan.model
        assert problem.t_eval is not None  # a plan gives them
        n_t, m, n_y = len(problem.t_eval), problem.n_sensitivities, len(model.outputs)
        n_y = n_y if members.batch.n_outputs else 0
        c = self._worker = self._ffi.new("cotree_worker *")
        c.batch, c.member = members.batch, -1
        for name, size in (
            ("k", members.batch.pattern.model.n_prepared),
            ("u", len(model.inputs)),
            ("z", problem.size),
            ("times", n_t),
            ("inputs", n_t * len(model.inputs) if n_y else 0),
            ("outputs", n_t * n_y),
            ("slopes", n_t * m * n_y),
            ("memory", -(-int(members.batch.memory) // 8)),
        ):
            setattr(c, name, self._point(name, np.zeros(max(1, size))))
        if isinstance(members.lanes, LoadedLanes):
            c.own = self._aligned("own", members.lanes.n_bytes)
        self._happened = np.zeros((0, 3 + m))
        self._width, self._at_once = 0, 0
        if problem.events is not None:
            self._width = 2 + m + 2 * problem.n_states
            # The most records of one step: C returns where there is no room for as many.
            self._at_once = len(problem.events.rows) + LIMITS.event_rounds
            self._make_room()

    def go_on(self, glance: float) -> bool:
        """Run members until something is to be done here, or for some time; tell if any is left.

        Parameters
        ----------
        glance : float
            That time, [s]; the same for all workers of a batch.
        """
        c, members = self._worker, self._members
        members.batch.glance = glance
        result = self._lib.cotree_batch_work(c)
        if result != _GLANCE and result != _ROOM:
            self._check_last()
        if result == _ROOM:
            self._make_room()
        elif result == _GIVE:
            self._give(int(c.member))
        elif result == _ASK:
            self._answer(int(c.member))
        elif result in (_EMPTY, _STOPPED):
            self._lib.cotree_batch_close(c)
            return False
        return True

    def happened(self) -> FloatArray:
        """Give the events of the members that it ran: member, event, time and its derivatives."""
        return self._happened[: int(self._worker.n_happened)]

    def _give(self, member: int) -> None:
        """Prepare a member: its start, its corners, its tolerances."""
        c, members = self._worker, self._members
        try:
            with without_warnings():
                problem = self._problem(member)
        except Error as error:
            members.fail(member, str(error))
            c.member = -1
            return
        if refusal(self._pattern.row.name, problem):
            # A run by itself has another method that stands in.
            members.run_alone(member)
            c.member = -1
            return
        self._asked = member, problem
        if self._job is None:
            self._job = self._pattern.job_of(problem)
        else:
            self._job.begin(problem)
        address = int(self._pattern.engine.library.ffi.cast("uintptr_t", self._job.job))
        c.asked = self._ffi.cast("cotree_job *", address)

    def _check_last(self) -> None:
        """Look at a member that was prepared here, once it is done, as a run by itself does."""
        if self._asked is None or int(self._worker.member) == self._asked[0]:
            return
        member, problem = self._asked
        self._asked = None
        self._members.check(member, problem)

    def _answer(self, member: int) -> None:
        """See to a member that has not come to its end."""
        members, ended = self._members, int(self._members.ended[member])
        if ended == STIFF and self._goes_on(member):
            return
        if ended in (STEPS_SPENT, EVENTS_SPENT, TIME_SPENT):
            self._spend(member, ended)
        elif ended != STIFF:
            members.run_alone(member)
        self._worker.member = -1

    def _spend(self, member: int, ended: int) -> None:
        """Put in a member whose budget is spent."""
        c, members, engine = self._worker, self._members, self._pattern.engine.library
        address = int(self._ffi.cast("uintptr_t", self._ffi.addressof(c, "job")))
        engine.lib.cotree_job_sync(engine.ffi.cast("cotree_job *", address))
        problem = self._problem_in_work(member)
        kept = members.results.z[member, : members.n_kept[member]].copy()
        method = self._pattern.row.name
        said = spent_sentence(problem, method, c.job, ended, kept, self._last_point())
        members.spend(member, said)

    def _last_point(self) -> FloatArray:
        """Give where the member in work stands."""
        size = self._pattern.problem.size
        return np.frombuffer(self._ffi.buffer(self._worker.job.z, 8 * size)).copy()

    def _problem_in_work(self, member: int) -> Problem:
        return self._asked[1] if self._asked is not None else self._problem(member)

    def _goes_on(self, member: int) -> bool:
        """Run a member that is stiff with another method; tell where it is to go on by itself."""
        c, members = self._worker, self._members
        problem, z = self._problem_in_work(member), self._last_point()
        job, method = c.job, self._pattern.row.name
        if not is_confirmed(problem, float(job.t), z, float(job.last_step), method):
            # Asking again costs eigenvalues: only after as many steps as were taken so far.
            c.watched_from = 2 * int(job.n_steps)
            return True
        other = stiff_method(problem)
        note = (
            f"{other} ran it, since it is stiff: from t = {float(job.stiff_since):.6g} on steps of "
            f"{method} were as short as stability asks."
        )
        members.run_alone(member, other, note)
        if members.results.status[member] == FAILED:
            c.watched_from = sys.maxsize
            return True
        return False

    def _problem(self, member: int) -> Problem:
        """Give the problem of a member."""
        plan, row = self._pattern.plan, self._members.rows[member].tolist()
        own = settings_of(plan.model, plan.settings, plan.columns, row)
        return problem_of(plan, own.parameters, own.initial)

    def _make_room(self) -> None:
        """Make more room for events; existing ones stay."""
        c = self._worker
        n_records = int(c.job.n_records)
        # Both grow by what one of them lacks: the events of one member, and those of all.
        most = max(4 * self._at_once, 2 * n_records)
        records = np.zeros((most, self._width))
        if "records" in self._kept:
            records[:n_records] = self._kept["records"][:n_records]
        c.records, c.most_records = self._point("records", records), most
        n, m = int(c.n_happened), self._happened.shape[1]
        happened = np.zeros((max(most, 2 * (n + n_records)), m))
        happened[:n] = self._happened[:n]
        self._happened = happened
        c.happened, c.most_happened = self._point("happened", happened), len(happened)

    def _aligned(self, name: str, n_bytes: int) -> Any:
        """Make room that begins at a multiple of 64 bytes, as vectors need."""
        room = np.zeros(n_bytes // 8 + 8)
        first = -room.ctypes.data % 64 // 8
        return self._point(name, room[first:])

    def _point(self, name: str, array: FloatArray) -> Any:
        self._kept[name] = array
        return self._ffi.from_buffer("double[]", array)
