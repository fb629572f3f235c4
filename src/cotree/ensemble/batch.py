"""Execution of a block of ensemble members in C.

Threads take members from a common counter. The results of a member depend only on the plan and its
own row, not on the number of threads, the order of rows, or other members.

SIMD lanes run several members in one vector: each worker calls the function ``lanes`` of
``cotree_batch.h`` instead of the loop over single members. It takes members with
``cotree_batch_take``, starts each with ``prepare``, writes its points to ``values`` and its outcome
to ``n_kept``, ``n_steps``, ``seconds`` and ``ended``, and evaluates its outputs with ``finish``.
Members whose outcome is ``COTREE_MEMBER_LEFT`` are then run one at a time from the start.
"""

from __future__ import annotations

import sys
import threading
import weakref
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.ensemble.pattern import (
    LoadedLanes,
    NotBatchable,
    Pattern,
    find_lanes,
    find_pattern,
    own_values,
    problem_of,
    tolerances,
)
from cotree.ensemble.plan import Block, Plan
from cotree.ensemble.reasons import EVENTS_SPENT, STEPS_SPENT, TIME_SPENT, budget_message
from cotree.ensemble.trial import run_member, run_one_by_one, settings_of
from cotree.errors import BuildError, Error
from cotree.model.arrays import CObjects
from cotree.model.kernels import build_engine, shared_code
from cotree.quiet import without_warnings
from cotree.sharing import locked_cache, usable_cores
from cotree.solvers.prepare import prepared
from cotree.solvers.problem import refusal
from cotree.solvers.result import BUDGET_SPENT, Drift, FloatArray, Statistics, Trajectory
from cotree.solvers.result import FAILED as STATUS_FAILED
from cotree.solvers.simulate import redundancy
from cotree.solvers.stiffness import is_confirmed, stiff_method
from cotree.solvers.trust import check_constraint_drift, check_time_resolution, is_fine
from cotree.tolerances import LIMITS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from threading import Event

    from cotree.build import LoadedLibrary
    from cotree.model.bound import BoundModel
    from cotree.solvers.job import Job
    from cotree.solvers.problem import RunProblem


# Outcomes of members in C, as in cotree_batch.h.
WAITS, DONE, STOPPED, FAILED, REFUSED, NO_OUTPUTS, STIFF = range(7)
LEFT = 10  # values between STIFF and LEFT mean that a budget is exhausted

# Number of steps after which a member leaves the SIMD lanes, which do not detect stiffness, and is
# run alone with detection. Most members take fewer steps.
_WATCHED_IN_LANES = 4 * LIMITS.most_stiff_steps

# Outcome of members that were run one at a time in Python.
RERUN = 100


@locked_cache
def load_batch() -> LoadedLibrary:
    """Build and load the C loop over members, once."""
    library = build_engine(shared_code("batch"))
    if library is None:
        raise BuildError("no compiler can build the loop over members")
    return library


class BlockInC(CObjects):
    """The members of a block as a C structure that its workers share.

    ``lanes`` is the library of SIMD lanes, or the reason why members run without them.
    """

    def __init__(self, pattern: Pattern, rows: FloatArray) -> None:
        self.pattern, self.library, self.rows = pattern, load_batch(), rows
        super().__init__(self.library.ffi)
        self.results = Block(pattern.plan, len(rows))
        self.lanes = find_lanes(pattern)
        self.batch = self.new("cotree_batch *")
        self._set_shared()
        self._set_own()
        self._set_results()

    def stop(self) -> None:
        """Interrupt running members and do not start others."""
        self.batch.is_stopped = 1

    def fail(self, member: int, message: str) -> None:
        """Record a member that cannot start."""
        self.ended[member] = REFUSED
        self.results.fail(member, STATUS_FAILED, message)

    def rerun_single(self, member: int, method: str = "", note: str = "") -> None:
        """Run a member by ``simulate``; ``note`` becomes the message of a successful run."""
        plan = self.pattern.plan
        if method:
            plan = replace(plan, settings=replace(plan.settings, method=method))
        self.ended[member] = RERUN
        run_member(plan, self.rows[member].tolist(), self.results, member)
        if self.results.status[member] == 0:
            self.results.messages[member] = note

    def check(self, member: int, problem: RunProblem) -> None:
        """Repeat a finished member as a single run if such a run would report a failure.

        Its steps may be smaller than the resolution of time, or its constraints may have drifted.
        """
        if self.ended[member] in (DONE, STOPPED):
            run = check_time_resolution(problem, self._trajectory(member))
            if not self._is_consistent(problem, run, lambda: problem.held):
                self.rerun_single(member)

    def block(self, workers: Sequence[Worker]) -> Block:
        """Return the results of the block after all workers have finished."""
        results, pattern, problem = self.results, self.pattern, self.pattern.problem
        is_done = (self.ended == DONE) | (self.ended == STOPPED)
        results.steps[is_done] = self.n_steps[is_done]
        # Members prepared in Python were checked when they finished.
        is_good = is_done.copy()
        if pattern.is_timed and not pattern.is_searched:
            is_good &= is_fine(problem, self.n_steps)
        if problem.held is not None and not pattern.is_searched:
            for member in np.flatnonzero(is_good).tolist():
                run, constraints = self._trajectory(member), partial(self._constraints, member)
                is_good[member] = self._is_consistent(problem, run, constraints)
        for member in np.flatnonzero(is_done & ~is_good).tolist():
            self.rerun_single(member)
        results.succeed(is_good)
        for worker in workers:
            rows = worker.event_records()
            results.add_events(rows[is_good[rows[:, 0].astype(np.intp)]])
        return results.finished()

    def _trajectory(self, member: int) -> Trajectory:
        n, t_eval = self.n_kept[member], self.pattern.plan.settings.t_eval
        t, z = np.asarray(t_eval, dtype=float)[:n], self.results.z[member, :n].T
        work = Statistics(self.pattern.row.name, 0, 0, 0, int(self.n_steps[member]), 0.0)
        drift = Drift((), np.zeros((0, n)), float(self.corrections[member]))
        return Trajectory(t, z, 0, "", work, drift)

    def _constraints(self, member: int) -> BoundModel | None:
        p = own_values(self.pattern, self.rows[member : member + 1]).p[0]
        plan = self.pattern.plan
        return prepared(plan.model, plan.settings).bound(p)

    def _is_consistent(
        self, problem: RunProblem, run: Trajectory, constraints: Callable[[], BoundModel | None]
    ) -> bool:
        """Return whether a run succeeded without constraint drift."""
        # If constraints are redundant, reactions are not unique and have no sensitivities.
        is_exact, redundant = problem.n_sensitivities > 0 and bool(self.pattern.plan.outputs), 0
        if is_exact or check_constraint_drift(problem, run, 1).status != 0:
            redundant = redundancy(self.pattern.plan.model, constraints(), run)
        return check_constraint_drift(problem, run, redundant).status == 0 and not (
            is_exact and redundant
        )

    def requeue_rejected(self) -> bool:
        """Requeue members that SIMD lanes left, for scalar runs; return whether there are any."""
        is_left = self.ended == LEFT
        if not is_left.any():
            return False
        self.ended[is_left] = WAITS
        self.batch.lanes, self.batch.next = self.library.ffi.NULL, 0
        return True

    def _set_shared(self) -> None:
        c, ffi, pattern = self.batch, self.library.ffi, self.pattern
        job, problem, engine = pattern.job.job, pattern.problem, pattern.engine.library
        c.pattern = ffi.cast("cotree_job *", int(engine.ffi.cast("uintptr_t", job)))
        for name in ("run", "end"):
            address = engine.ffi.cast("uintptr_t", getattr(engine.lib, f"cotree_job_{name}"))
            setattr(c, name, ffi.cast(ffi.typeof(getattr(c, name)), int(address)))
        c.memory = int(engine.lib.cotree_job_memory(job))
        settings = problem.settings
        c.max_steps, c.time_limit = settings.max_steps or 0, settings.time_limit or 0.0
        c.n_full = problem.size
        c.is_watched, c.has_given_jobs = self.pattern.is_watched, self.pattern.is_searched
        if self.pattern.is_watched:
            c.most_in_lanes = _WATCHED_IN_LANES
        lib = self.library.lib
        c.prepare, c.finish = lib.cotree_batch_prepare, lib.cotree_batch_finish
        c.now = lib.cotree_batch_now
        if isinstance(self.lanes, LoadedLanes):
            c.lanes = ffi.cast(ffi.typeof(c.lanes), self.lanes.work)
        self._set_start()
        self._set_given()

    def _set_start(self) -> None:
        """Set the tables and the C function that compute the initial states of members."""
        starts, ffi, problem = self.pattern.starts, self.library.ffi, self.pattern.problem
        if starts is None:
            return
        c, self._starts = self.batch, starts
        c.start_tables = ffi.cast("cotree_start_tables *", starts.address)
        c.find_start = ffi.cast(ffi.typeof(c.find_start), starts.function)
        if problem.singular is not None:
            # Repeat the decision of a single run, see Job.begin and refusal.
            is_own = self.pattern.row.family == "cotree" and self.pattern.row.implicit
            c.if_dependent = 2 if is_own else int(self.pattern.newton is None)

    def _set_given(self) -> None:
        """Set the values of replaced inputs at the output times."""
        c, signals, times = self.batch, self.pattern.signals, self.pattern.problem.settings.t_eval
        assert times is not None  # settings of a plan always contain ``t_eval``
        by_position = signals.by_position
        c.n_given = len(by_position)
        if not by_position:
            return
        c.given = self.pointer(np.array(list(by_position), dtype=np.intc), "int")
        values = [[signal(t) for signal in by_position.values()] for t in times.tolist()]
        c.given_values = self.pointer(np.array(values, dtype=float))

    def _set_own(self) -> None:
        c, own = self.batch, own_values(self.pattern, self.rows)
        c.n_members, c.n_set = len(self.rows), len(own.states)
        c.p, c.set_values = self.pointer(own.p), self.pointer(own.values)
        c.set = self.pointer(own.states, "int")
        atols, turns = tolerances(self.pattern, own.p)
        if atols is not None:
            c.atols = self.pointer(atols)
        if turns is not None:
            c.turn_tolerances = self.pointer(turns)
        self.ended = np.where(own.is_refused, REFUSED, WAITS).astype(np.intc)
        c.ended = self.pointer(self.ended, "int")
        for member in np.flatnonzero(own.is_refused).tolist():
            self.rerun_single(member)

    def _set_results(self) -> None:
        c, results, n = self.batch, self.results, len(self.rows)
        plan = self.pattern.plan
        places = [plan.model.outputs.index(name) for name in plan.outputs]
        c.n_outputs, c.outputs = len(places), self.pointer(np.array(places, np.intc), "int")
        c.values = self.pointer(results.z)
        c.output_values = self.pointer(results.outputs)
        c.output_slopes = self.pointer(results.output_sensitivities)
        self.n_steps = np.zeros(n, dtype=np.dtype("l"))
        c.n_steps = self.pointer(self.n_steps, "long")
        self.n_kept = np.zeros(n, dtype=np.intc)
        c.n_kept = self.pointer(self.n_kept, "int")
        c.seconds = self.pointer(results.seconds)
        self.corrections = np.zeros(n)
        c.corrections = self.pointer(self.corrections)


# Return values of cotree_batch_work.
_NONE_LEFT, _AGAIN, _NO_SPACE, _UNFINISHED, _STOPPED, _PREPARE = range(6)


class Worker:
    """Runs members of a block in the thread that calls it."""

    def __init__(self, members: BlockInC) -> None:
        self._members, self._lib = members, members.library.lib
        self._ffi, self._pattern = members.library.ffi, members.pattern
        self._kept: dict[str, Any] = {}
        # The member prepared last, with its problem; the job that all prepared members use.
        self._prepared: tuple[int, RunProblem] | None = None
        self._job: Job | None = None
        problem, model = self._pattern.problem, self._pattern.plan.model
        assert problem.settings.t_eval is not None  # settings of a plan always contain ``t_eval``
        n_t, m, n_y = len(problem.settings.t_eval), problem.n_sensitivities, len(model.outputs)
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
            room = np.zeros(members.lanes.n_bytes // 8 + 8)
            # Vectors need an alignment of 64 bytes.
            c.own = self._point("own", room[-room.ctypes.data % 64 // 8 :])
        self._events = np.zeros((0, 3 + m))
        self._width, self._at_once = 0, 0
        if problem.events is not None:
            self._width = 2 + m + 2 * problem.n_states
            # C requires space for all event records of one step before the step.
            self._at_once = len(problem.events.event_rows) + LIMITS.event_rounds
            self._grow_records()

    def advance(self, interval: float) -> bool:
        """Run members until Python must act or ``interval`` seconds pass; return if any remain."""
        c, members = self._worker, self._members
        members.batch.interval = interval
        result = self._lib.cotree_batch_work(c)
        if result != _AGAIN and result != _NO_SPACE:
            self._check_last()
        if result == _NO_SPACE:
            self._grow_records()
        elif result == _PREPARE:
            self._prepare_member(int(c.member))
        elif result == _UNFINISHED:
            self._resolve(int(c.member))
        elif result in (_NONE_LEFT, _STOPPED):
            self._lib.cotree_batch_close(c)
            return False
        return True

    def event_records(self) -> FloatArray:
        """Return a row for each event: member, event, time and derivatives of the time."""
        return self._events[: int(self._worker.n_events)]

    def _prepare_member(self, member: int) -> None:
        """Prepare a member in Python: initial state, time events and tolerances."""
        c, members = self._worker, self._members
        try:
            with without_warnings():
                problem = self._problem(member)
        except Error as error:
            members.fail(member, str(error))
            c.member = -1
            return
        if refusal(self._pattern.row.name, problem):
            # Run alone, because a single run would use another method.
            members.rerun_single(member)
            c.member = -1
            return
        self._prepared = member, problem
        if self._job is None:
            self._job = self._pattern.job_of(problem)
        else:
            self._job.begin(problem)
        address = int(self._pattern.engine.library.ffi.cast("uintptr_t", self._job.job))
        c.given_job = self._ffi.cast("cotree_job *", address)

    def _check_last(self) -> None:
        if self._prepared is None or int(self._worker.member) == self._prepared[0]:
            return
        member, problem = self._prepared
        self._prepared = None
        self._members.check(member, problem)

    def _resolve(self, member: int) -> None:
        """Decide how to continue with a member that ended early."""
        members, ended = self._members, int(self._members.ended[member])
        if ended == STIFF and self._run_stiff(member):
            return
        if ended in (STEPS_SPENT, EVENTS_SPENT, TIME_SPENT):
            self._record_budget(member, ended)
        elif ended != STIFF:
            members.rerun_single(member)
        self._worker.member = -1

    def _record_budget(self, member: int, ended: int) -> None:
        c, members, engine = self._worker, self._members, self._pattern.engine.library
        address = int(self._ffi.cast("uintptr_t", self._ffi.addressof(c, "job")))
        engine.lib.cotree_job_sync(engine.ffi.cast("cotree_job *", address))
        problem = self._problem_in_work(member)
        kept = members.results.z[member, : members.n_kept[member]].copy()
        method = self._pattern.row.name
        message = budget_message(problem, method, c.job, ended, kept, self._last_point())
        members.results.steps[member] = members.n_steps[member]
        members.results.fail(member, BUDGET_SPENT, message)

    def _last_point(self) -> FloatArray:
        size = self._pattern.problem.size
        return np.frombuffer(self._ffi.buffer(self._worker.job.z, 8 * size)).copy()

    def _problem_in_work(self, member: int) -> RunProblem:
        return self._prepared[1] if self._prepared is not None else self._problem(member)

    def _run_stiff(self, member: int) -> bool:
        """Run a stiff member with another method; return True if this method shall continue."""
        c, members = self._worker, self._members
        problem, z = self._problem_in_work(member), self._last_point()
        job, method = c.job, self._pattern.row.name
        if not is_confirmed(problem, float(job.t), z, float(job.last_step), method):
            # The checks compute eigenvalues, so the interval between them doubles.
            c.watched_from = 2 * int(job.n_steps)
            return True
        other = stiff_method(problem)
        note = (
            f"{other} ran it, since it is stiff: from t = {float(job.stiff_since):.6g} on steps of "
            f"{method} were limited by stability."
        )
        members.rerun_single(member, other, note)
        if members.results.status[member] == STATUS_FAILED:
            c.watched_from = sys.maxsize
            return True
        return False

    def _problem(self, member: int) -> RunProblem:
        plan, row = self._pattern.plan, self._members.rows[member].tolist()
        own = settings_of(plan.model, plan.settings, plan.columns, row)
        return problem_of(plan, own.parameters, own.initial)

    def _grow_records(self) -> None:
        c = self._worker
        n_records = int(c.job.n_records)
        # ``records`` has the events of the current member, ``events`` those of all members.
        most = max(4 * self._at_once, 2 * n_records)
        records = np.zeros((most, self._width))
        if "records" in self._kept:
            records[:n_records] = self._kept["records"][:n_records]
        c.records, c.most_records = self._point("records", records), most
        n, m = int(c.n_events), self._events.shape[1]
        events = np.zeros((max(most, 2 * (n + n_records)), m))
        events[:n] = self._events[:n]
        self._events = events
        c.events, c.most_events = self._point("events", events), len(events)

    def _point(self, name: str, array: FloatArray) -> Any:
        self._kept[name] = array
        return self._ffi.from_buffer("double[]", array)


# Interval at which workers check whether the ensemble is stopped, [s].
_INTERVAL = 0.05

# Patterns by plan, determined when the first block of a plan is run.
_patterns: weakref.WeakKeyDictionary[Plan, Pattern | NotBatchable] = weakref.WeakKeyDictionary()


def run_block(
    plan: Plan, rows: FloatArray, *, threads: int | None = 1, stop: Event | None = None
) -> Block:
    """Run the members with the given rows; those that were not run have the status -3."""
    rows = np.ascontiguousarray(rows, dtype=np.float64).reshape(-1, len(plan.columns))
    pattern = pattern_of(plan)
    if isinstance(pattern, NotBatchable):
        return run_one_by_one(pattern.plan, rows, stop=stop)
    members = BlockInC(pattern, rows)
    wanted = usable_cores() if threads is None else max(1, threads)
    most = min(wanted, len(rows), int(members.library.lib.cotree_batch_most_threads()))
    workers = [Worker(members) for _ in range(max(1, most))]
    stop = threading.Event() if stop is None else stop
    _drive(workers, members, stop)
    if members.requeue_rejected():
        _drive(workers, members, stop)
    return members.block(workers)


def pattern_of(plan: Plan) -> Pattern | NotBatchable:
    """Return the pattern of a plan, or the reason why its members run one by one; cached."""
    if plan not in _patterns:
        _patterns[plan] = find_pattern(plan)
    return _patterns[plan]


def _drive(workers: Sequence[Worker], members: BlockInC, stop: Event) -> None:
    """Run members in threads until none is left, or the ensemble is stopped."""
    errors: list[BaseException] = []

    def work(worker: Worker) -> None:
        try:
            while worker.advance(_INTERVAL):
                halt_if_stopped()
        except KeyboardInterrupt:
            stop.set()
        except BaseException as error:
            errors.append(error)
            members.stop()

    def halt_if_stopped() -> None:
        if stop.is_set():
            members.stop()

    halt_if_stopped()
    # The calling thread also runs members. If it only waited, two threads could start on one core,
    # and the system would separate them only after some milliseconds.
    threads = [threading.Thread(target=work, args=(worker,)) for worker in workers[1:]]
    for thread in threads:
        thread.start()
    work(workers[0])
    for thread in threads:
        while thread.is_alive():
            try:
                halt_if_stopped()
                thread.join(_INTERVAL)
            except KeyboardInterrupt:
                stop.set()
    if errors:
        raise errors[0]
