"""A block of members as C takes it, and what comes out of it.

In: a ``Pattern`` and rows. Out: a ``cotree_batch`` that workers share, and a ``Block``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.codegen.integrators import batch_declarations, batch_files
from cotree.ensemble.one_by_one import run_member
from cotree.ensemble.results import Results
from cotree.ensemble.starts import own_values, tolerances
from cotree.errors import BuildError
from cotree.sharing import made_once
from cotree.solvers.engine import build_engine
from cotree.solvers.timely import is_fine

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from cotree.build import LoadedLibrary
    from cotree.ensemble.pattern import Pattern
    from cotree.ensemble.plan import Block
    from cotree.ensemble.worker import Worker
    from cotree.solvers.base import FloatArray

# How members end in C; see cotree_batch.h.
WAITS, DONE, STOPPED, FAILED, REFUSED, UNSWEPT, STIFF = range(7)
STEPS_SPENT, EVENTS_SPENT, TIME_SPENT, LEFT = range(7, 11)


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
    library : LoadedLibrary
        The loop over members.
    batch : cotree_batch
        The structure.
    results : Results
        What comes out.
    """

    def __init__(self, pattern: Pattern, rows: FloatArray) -> None:
        self.pattern, self.library, self._rows = pattern, load_batch(), rows
        self.results = Results(pattern.plan, len(rows))
        self._kept: list[Any] = []
        self.batch = self.library.ffi.new("cotree_batch *")
        self._set_shared()
        self._set_own()
        self._set_results()

    @property
    def most_threads(self) -> int:
        """How many threads may share them."""
        return int(self.library.lib.cotree_batch_most_threads())

    def stop(self) -> None:
        """Break off what is in work, and begin nothing else."""
        self.batch.is_stopped = 1

    def run_alone(self, member: int) -> None:
        """Run a member by itself, where C has not brought it to its end: for its sentence."""
        run_member(self.pattern.plan, self._rows[member].tolist(), self.results, member)

    def block(self, workers: Sequence[Worker]) -> Block:
        """Give what came out, once all workers are done."""
        results, is_done = self.results, (self.ended == DONE) | (self.ended == STOPPED)
        results.steps[is_done] = self.n_steps[is_done]
        if self.pattern.is_timed:
            is_late = is_done & ~is_fine(self.pattern.problem, self.n_steps)
            for member in np.flatnonzero(is_late).tolist():
                self.run_alone(member)
            is_done &= ~is_late
        results.status[is_done], results.messages[is_done] = 0, ""
        for worker in workers:
            rows = worker.happened()
            results.add_happened(rows[is_done[rows[:, 0].astype(np.intp)]])
        return results.block()

    def takes_back(self) -> bool:
        """Let members that lanes have left be run one at a time; tell whether there are any."""
        is_left = self.ended == LEFT
        self.ended[is_left] = WAITS
        self.batch.lanes, self.batch.next = self.library.ffi.NULL, 0
        return bool(is_left.any())

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
        lib = self.library.lib
        c.prepare, c.finish = lib.cotree_batch_prepare, lib.cotree_batch_finish
        self._set_given()

    def _set_given(self) -> None:
        """Fill in the inputs in place of the scene's, at the wanted times."""
        c, signals, times = self.batch, self.pattern.signals, self.pattern.problem.t_eval
        assert times is not None  # a plan gives them
        by_position = signals.by_position
        c.n_given = len(by_position)
        c.given = self.pointer(np.array(list(by_position), dtype=np.intc), "int")
        values = [[signal(t) for signal in by_position.values()] for t in times.tolist()]
        c.given_values = self.pointer(np.array(values, dtype=float))

    def _set_own(self) -> None:
        """Fill in what members have of their own."""
        c, own = self.batch, own_values(self.pattern, self._rows)
        c.n_members, c.n_set = len(self._rows), len(own.states)
        c.p, c.set_values = self.pointer(own.p), self.pointer(own.values)
        c.set, c.set_by = self.pointer(own.states, "int"), self.pointer(own.by, "int")
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
        c, results, n = self.batch, self.results, len(self._rows)
        plan = self.pattern.plan
        places = [plan.model.outputs.index(name) for name in plan.outputs]
        c.n_outputs, c.outputs = len(places), self.pointer(np.array(places, np.intc), "int")
        c.values = self.pointer(results.z)
        c.output_values = self.pointer(results.outputs)
        c.output_slopes = self.pointer(results.slopes)
        self.n_steps = np.zeros(n, dtype=np.dtype("l"))
        c.n_steps = self.pointer(self.n_steps, "long")
        c.n_kept = self.pointer(np.zeros(n, dtype=np.intc), "int")
        c.seconds = self.pointer(results.seconds)
        self.corrections = np.zeros(n)
        c.corrections = self.pointer(self.corrections)
