"""A block of members as C takes it, and what comes out of it.

In: a ``Pattern`` and rows. Out: a ``cotree_batch`` that workers share, and a ``Block``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.codegen.integrators import batch_declarations, batch_files
from cotree.ensemble.lanes import LoadedLanes, find_lanes
from cotree.ensemble.one_by_one import run_member
from cotree.ensemble.results import Results
from cotree.ensemble.starts import own_values, tolerances
from cotree.errors import BuildError
from cotree.model.shared_code import build_engine
from cotree.sharing import made_once
from cotree.solvers.base import Drift, Statistics, Trajectory
from cotree.solvers.evaluate import BUDGET_SPENT
from cotree.solvers.evaluate import FAILED as STATUS_FAILED
from cotree.solvers.prepare import prepared
from cotree.solvers.project import Projection
from cotree.solvers.simulate import redundancy
from cotree.solvers.timely import is_fine, timely
from cotree.solvers.trust import held
from cotree.tolerances import LIMITS

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from cotree.build import LoadedLibrary
    from cotree.ensemble.pattern import Pattern
    from cotree.ensemble.plan import Block
    from cotree.ensemble.worker import Worker
    from cotree.solvers.base import FloatArray
    from cotree.solvers.problem import Problem

# How members end in C; see cotree_batch.h.
WAITS, DONE, STOPPED, FAILED, REFUSED, UNSWEPT, STIFF = range(7)
LEFT = 10  # the budgets that are spent stand between

# Lanes do not look whether a member is stiff. Where that matters, one that takes so many steps is
# left to a worker that does: most members take fewer, and of those that are stiff little is lost.
_WATCHED_IN_LANES = 4 * LIMITS.most_stiff_steps

# In Python, of members that were run by themselves.
ALONE = 100


@made_once
def load_batch() -> LoadedLibrary:
    """Build and load the loop over members, once."""
    files = batch_files()
    library = build_engine(files, batch_declarations(files))
    if library is None:
        raise BuildError("no compiler can build the loop over members")
    return library


class BlockInC:
    """The members of a block; it is mutable, and shared by the workers that run it.

    Parameters
    ----------
    pattern : Pattern
        What they share.
    rows : ndarray, shape (n_members, n_columns)
        What each sets.

    Attributes
    ----------
    pattern : Pattern
        As given.
    rows : ndarray, shape (n_members, n_columns)
        As given.
    library : LoadedLibrary
        The loop over members.
    ended : ndarray of int, shape (n_members,)
        How members ended in C.
    batch : cotree_batch
        The structure.
    results : Results
        What comes out.
    lanes : LoadedLanes or str
        The lanes that members run in; or why they run one at a time.
    """

    def __init__(self, pattern: Pattern, rows: FloatArray) -> None:
        self.pattern, self.library, self.rows = pattern, load_batch(), rows
        self.results = Results(pattern.plan, len(rows))
        self.lanes = find_lanes(pattern)
        self._kept: list[Any] = []
        self.batch = self.library.ffi.new("cotree_batch *")
        self._set_shared()
        self._set_own()
        self._set_results()

    @property
    def most_threads(self) -> int:
        """The number of threads that may share them."""
        return int(self.library.lib.cotree_batch_most_threads())

    def stop(self) -> None:
        """Break off what is in work, and begin nothing else."""
        self.batch.is_stopped = 1

    def fail(self, member: int, message: str) -> None:
        """Put in a member that cannot begin."""
        self.ended[member] = REFUSED
        self.results.fail(member, STATUS_FAILED, message)

    def spend(self, member: int, message: str) -> None:
        """Put in a member whose budget is spent."""
        self.results.steps[member] = self.n_steps[member]
        self.results.fail(member, BUDGET_SPENT, message)

    def run_alone(self, member: int, method: str = "", note: str = "") -> None:
        """Run a member by itself, where C has not brought it to its end.

        Parameters
        ----------
        member : int
            Its place.
        method : str
            Another method than that of the plan.
        note : str
            What is said of a member that succeeds so.
        """
        plan = self.pattern.plan
        if method:
            plan = replace(plan, settings=replace(plan.settings, method=method))
        self.ended[member] = ALONE
        run_member(plan, self.rows[member].tolist(), self.results, member)
        if self.results.status[member] == 0:
            self.results.messages[member] = note

    def check(self, member: int, problem: Problem) -> None:
        """Look at a member that is done as a run by itself is looked at; run it so if it fails.

        Its times may be too late for its steps, or constraints may not have held it.
        """
        if self.ended[member] not in (DONE, STOPPED):
            return
        n, plan = self.n_kept[member], self.pattern.plan
        t, z = np.asarray(plan.settings.t_eval, dtype=float)[:n], self.results.z[member, :n].T
        work = Statistics(self.pattern.row.name, 0, 0, 0, int(self.n_steps[member]), 0.0)
        projection = problem.project if isinstance(problem.project, Projection) else None
        correction = float(self.corrections[member])
        drift = None if projection is None else Drift((), np.zeros((0, n)), correction)
        run = Trajectory(t, z, 0, "", work, drift)
        redundant = redundancy(plan.model, projection, run)
        # Reactions that are not unique have no sensitivities.
        is_left_out = redundant > 0 and problem.n_sensitivities > 0 and bool(plan.outputs)
        if held(problem, timely(problem, run), redundant).status != 0 or is_left_out:
            self.run_alone(member)

    def block(self, workers: Sequence[Worker]) -> Block:
        """Give what came out, once all workers are done."""
        results, is_done = self.results, (self.ended == DONE) | (self.ended == STOPPED)
        results.steps[is_done] = self.n_steps[is_done]
        # Those that were prepared in Python have been looked at.
        if self.pattern.is_timed and not self.pattern.is_searched:
            is_late = is_done & ~is_fine(self.pattern.problem, self.n_steps)
            for member in np.flatnonzero(is_late).tolist():
                self.run_alone(member)
            is_done &= ~is_late
        if self.pattern.problem.project is not None and not self.pattern.is_searched:
            for member in np.flatnonzero(is_done).tolist():
                if not self._is_held(member):
                    self.run_alone(member)
                    is_done[member] = False
        results.succeed(is_done)
        for worker in workers:
            rows = worker.happened()
            if len(rows) == 0:
                continue
            results.add_happened(rows[is_done[rows[:, 0].astype(np.intp)]])
        return results.block()

    def _is_held(self, member: int) -> bool:
        """Return whether constraints held a member that is done, as :meth:`check` does."""
        pattern, plan = self.pattern, self.pattern.plan
        problem, n = pattern.problem, self.n_kept[member]
        is_exact = problem.n_sensitivities > 0 and bool(plan.outputs)
        t, z = np.asarray(plan.settings.t_eval, dtype=float)[:n], self.results.z[member, :n].T
        work = Statistics(pattern.row.name, 0, 0, 0, int(self.n_steps[member]), 0.0)
        run = Trajectory(t, z, 0, "", work, Drift((), np.zeros((0, n)), self.corrections[member]))
        redundant = 0
        if is_exact or held(problem, run, 1).status != 0:
            settings = replace(plan.settings, sensitivities=plan.has_sensitivities)
            p = own_values(pattern, self.rows[member : member + 1]).p[0]
            redundant = redundancy(plan.model, prepared(plan.model, settings).projection(p), run)
        return held(problem, run, redundant).status == 0 and not (is_exact and redundant)

    def takes_back(self) -> bool:
        """Let members that lanes have left be run one at a time; tell whether there are any."""
        is_left = self.ended == LEFT
        if not is_left.any():
            return False
        self.ended[is_left] = WAITS
        self.batch.lanes, self.batch.next = self.library.ffi.NULL, 0
        return True

    def buffer(self, pointer: Any) -> Any:
        """Give the memory of an array that :meth:`pointer` was made of."""
        ffi = self.library.ffi
        address = ffi.cast("uintptr_t", pointer)
        return next(ffi.buffer(p) for p in self._kept if ffi.cast("uintptr_t", p) == address)

    def pointer(self, array: npt.NDArray[Any], kind: str = "double") -> Any:
        """Return a pointer to an array, and keep the array alive."""
        # Where there is nothing to point to, C computes no address of it either.
        array = np.ascontiguousarray(array) if array.size else np.zeros(1, dtype=array.dtype)
        pointer = self.library.ffi.from_buffer(f"{kind}[]", array)
        self._kept.append(pointer)
        return pointer

    def _set_shared(self) -> None:
        """Fill in what members share."""
        c, ffi, pattern = self.batch, self.library.ffi, self.pattern
        job, problem, engine = pattern.job.job, pattern.problem, pattern.engine.library
        c.pattern = ffi.cast("cotree_job *", int(engine.ffi.cast("uintptr_t", job)))
        for name in ("run", "end"):
            address = engine.ffi.cast("uintptr_t", getattr(engine.lib, f"cotree_job_{name}"))
            setattr(c, name, ffi.cast(ffi.typeof(getattr(c, name)), int(address)))
        c.memory = int(engine.lib.cotree_job_memory(job))
        c.max_steps, c.time_limit = problem.max_steps or 0, problem.time_limit or 0.0
        c.n_full = problem.size
        c.is_watched, c.are_asked_for = self.pattern.is_watched, self.pattern.is_searched
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
        """Fill in what finds the starts of members."""
        starts, ffi, problem = self.pattern.starts, self.library.ffi, self.pattern.problem
        if starts is None:
            return
        c, self._starts = self.batch, starts
        c.start_tables = ffi.cast("cotree_start_tables *", starts.address)
        c.find_start = ffi.cast(ffi.typeof(c.find_start), starts.function)
        if problem.singular is not None:
            # As a run by itself does, see Job.begin and refusal.
            is_own = self.pattern.row.family == "cotree" and self.pattern.row.implicit
            c.if_dependent = 2 if is_own else int(self.pattern.newton is None)

    def _set_given(self) -> None:
        """Fill in the inputs in place of the scene's, at the wanted times."""
        c, signals, times = self.batch, self.pattern.signals, self.pattern.problem.t_eval
        assert times is not None  # a plan gives them
        by_position = signals.by_position
        c.n_given = len(by_position)
        if not by_position:
            return
        c.given = self.pointer(np.array(list(by_position), dtype=np.intc), "int")
        values = [[signal(t) for signal in by_position.values()] for t in times.tolist()]
        c.given_values = self.pointer(np.array(values, dtype=float))

    def _set_own(self) -> None:
        """Fill in what members have of their own."""
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
            self.run_alone(member)

    def _set_results(self) -> None:
        """Make room for what comes out."""
        c, results, n = self.batch, self.results, len(self.rows)
        plan = self.pattern.plan
        places = [plan.model.outputs.index(name) for name in plan.outputs]
        c.n_outputs, c.outputs = len(places), self.pointer(np.array(places, np.intc), "int")
        c.values = self.pointer(results.z)
        c.output_values = self.pointer(results.outputs)
        c.output_slopes = self.pointer(results.slopes)
        self.n_steps = np.zeros(n, dtype=np.dtype("l"))
        c.n_steps = self.pointer(self.n_steps, "long")
        self.n_kept = np.zeros(n, dtype=np.intc)
        c.n_kept = self.pointer(self.n_kept, "int")
        c.seconds = self.pointer(results.seconds)
        self.corrections = np.zeros(n)
        c.corrections = self.pointer(self.corrections)
