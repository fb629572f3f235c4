"""Jobs: runs of C methods, which C advances by a given number of steps per call."""

from __future__ import annotations

import operator
import sys
from collections import deque
from hashlib import blake2b
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from cotree.errors import Error
from cotree.model.arrays import CObjects, pointer_to
from cotree.sharing import RecentCache
from cotree.solvers.budgets import Thinning, most_rows
from cotree.solvers.problem import (
    RunProblem,
    Tolerances,
    as_tested,
    is_integrated,
    restart_times,
    turn_tolerances,
)
from cotree.tolerances import LIMITS

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Mapping

    from cotree.methods import Method
    from cotree.model.kernels import Newton
    from cotree.solvers.engine import Engine
    from cotree.solvers.result import FloatArray


class Callbacks(CObjects):
    """Python functions and C objects that must live as long as their job."""

    def __init__(self, ffi: Any, rescue: Rescue, *kept: Any) -> None:
        super().__init__(ffi, *kept)
        self._rescue = rescue

    def input_function(self, functions: Mapping[int, Callable[[float], float]]) -> Any:
        """Return a C function that evaluates inputs in Python."""
        errors = self.errors

        def evaluate(t: float, u: Any, context: Any) -> int:
            if errors:  # after an error C may call again with a shorter step
                return -1
            for place, function in functions.items():
                u[place] = function(t)
            return 0

        return self.callback("cotree_input_function", evaluate)

    def reach(self, reach: Callable[[float, FloatArray], None], size: int) -> Any:
        """Return a C function for ``reach``, called at the start of each segment."""
        ffi = self._ffi

        def call(t: float, z: Any, context: Any) -> int:
            reach(t, np.frombuffer(ffi.buffer(z, 8 * size)))
            return 0

        return self.callback("cotree_reach", call)

    def helper(self, n_states: int) -> Any:
        """Return the ``cotree_helper``, whose functions C calls if its iterations fail."""
        rescue, ffi = self._rescue, self._ffi

        def find_unknowns(t: float, x: Any, context: Any) -> int:
            point = np.frombuffer(ffi.buffer(x, 8 * n_states))
            return int(not rescue.find_unknowns(t, point))

        helper = self.new("cotree_helper *")
        helper.find_unknowns = self.callback("cotree_find_unknowns", find_unknowns)
        return helper


class Rescue:
    """Python solver for algebraic equations on which C failed; ``reason`` is its error message."""

    def __init__(self, problem: RunProblem) -> None:
        self.problem = problem
        self.reason = ""

    def find_unknowns(self, t: float, y: FloatArray) -> bool:
        """Solve for the algebraic unknowns in place; if that fails, store the reason."""
        from cotree.model.algebraic import Algebraic

        problem = self.problem
        assert problem.state_rhs is not None  # compiled models have both functions
        assert problem.jacobian is not None
        unknowns = Algebraic(
            problem.state_rhs, problem.jacobian, problem.names, problem.n_algebraic
        )

        try:
            # C needs the old point after a failure, so a copy is changed.
            found = y.copy()
            unknowns.solve(t, found)
        except Error as error:
            self.reason = str(error).rstrip(".")
            return False
        y[:], self.reason = found, ""
        return True


# Initial number of rows, and number of rows that are copied at once when steps are dropped.
_FIRST_ROWS, _ROWS_AT_ONCE = 256, 1024


class StoredRows:
    """Stored points of a job, one per row; the first ``job.n_kept`` rows are valid."""

    def __init__(self, ffi: Any, job: Any, problem: RunProblem) -> None:
        self._ffi, self._job, self._n, self._room = ffi, job, problem.size, -1
        self._most_room = problem.most_rows
        self.times, self.values = np.zeros(0), np.zeros((0, self._n))
        self._pointers: tuple[Any, Any] = (ffi.NULL, ffi.NULL)

    def begin(self, problem: RunProblem) -> None:
        """Allocate the rows of a run, and discard those of an earlier run."""
        self._keeps_steps = problem.settings.t_eval is None
        self.thinning, self._n_thinned = Thinning(), 0
        first = min(_FIRST_ROWS, self._most_room)
        wanted = first if problem.settings.t_eval is None else len(problem.settings.t_eval)
        if self._room != wanted:
            self._make_room(wanted)
        self._job.times, self._job.values = self._pointers

    def stored(self, z: FloatArray, *, is_cut: bool) -> tuple[FloatArray, FloatArray]:
        """Return the stored times and values (..., n_t); if ``is_cut``, append the last point z."""
        kept = int(self._job.n_kept)
        # The last step may not be stored if the stride exceeds 1.
        if is_cut or self.thinning.stride > 1:
            if kept == self._room:
                self._make_room(kept + 1)
            if not (kept and self.times[kept - 1] == self._job.t):
                self.times[kept], self.values[kept] = self._job.t, z
                kept += 1
        return self.times[:kept].copy(), self.values[:kept].T.copy()

    def steps_with_room(self, most_steps: int) -> int:
        """Allocate rows or drop stored steps; return the number of steps that now fit."""
        if not self._keeps_steps:
            return most_steps
        while True:
            kept = int(self._job.n_kept)
            # A step needs one row, or two if steps are thinned out and events are stored as well.
            # The start and the end need one row each.
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
        """Drop the new steps that the thinning does not select."""
        if not self._keeps_steps:
            return
        # ``n_kept`` may have decreased, because an event can replace the last row.
        first = min(self._n_thinned, int(self._job.n_kept))
        chosen = self.thinning.select(int(self._job.n_kept) - first)
        self._keep_rows(first, chosen)

    def _keep_rows(self, first: int, chosen: slice) -> None:
        """From row ``first`` on, keep only the rows that ``chosen`` selects."""
        if chosen.step != 1:
            places = range(first, int(self._job.n_kept))[chosen]
            # Moving rows in blocks avoids a copy of the whole array.
            for start in range(0, len(places), _ROWS_AT_ONCE):
                part = places[start : start + _ROWS_AT_ONCE]
                to = slice(first + start, first + start + len(part))
                of = slice(part.start, part.stop, part.step)
                self.times[to], self.values[to] = self.times[of], self.values[of]
            self._job.n_kept = first + len(places)
        self._n_thinned = int(self._job.n_kept)

    def _make_room(self, rows: int) -> None:
        kept = int(self._job.n_kept)
        times, values = np.zeros(rows), np.zeros((rows, self._n))
        times[:kept], values[:kept] = self.times[:kept], self.values[:kept]
        self.times, self.values, self._room = times, values, rows
        values_at = self._ffi.from_buffer("double[]", values) if self._n else self._ffi.NULL
        self._pointers = self._ffi.from_buffer("double[]", times), values_at
        self._job.times, self._job.values = self._pointers


T = TypeVar("T")

# Maximum number of idle jobs of one kind, for the threads of a small machine, and maximum size of
# an idle job, [byte]. Larger jobs take much longer to run than to create.
_MOST_JOBS, _MOST_BYTES = 8, 2**18

# Maximum number of results that :class:`Shared` caches.
_MOST_FINDINGS = 64


class Shared:
    """Thread-safe pool of jobs and cache of results for runs with the same settings.

    Results are cached only if ``is_repeatable``, that is, if runs call no Python functions.
    """

    def __init__(self, *, is_repeatable: bool) -> None:
        self._is_repeatable = is_repeatable
        self._idle: dict[Hashable, deque[Job]] = {}
        self._findings: RecentCache[object] = RecentCache(_MOST_FINDINGS)

    def acquire(self, kind: Hashable) -> Job | None:
        """Take an idle job of a kind out of the pool; return None if there is none."""
        idle = self._idle.get(kind)
        try:
            return idle.pop() if idle else None
        except IndexError:  # another thread took the last job
            return None

    def release(self, job: Job) -> None:
        """Put a finished job into the pool."""
        if job.is_reusable and job.n_bytes <= _MOST_BYTES:
            self._idle.setdefault(job.kind, deque(maxlen=_MOST_JOBS)).append(job)

    def finding(self, make: Callable[[], T], *of: FloatArray) -> T:
        """Return the result of ``make()``, cached under the arrays ``of`` that determine it."""
        if not self._is_repeatable:
            return make()
        # The key contains bits and lengths of the arrays, so different arrays have different keys.
        key = blake2b(b"".join(array.tobytes() for array in of), digest_size=16).digest()
        found: T = self._findings.of((key, *map(len, of)), make)  # type: ignore[assignment]
        return found


def job_kind(row: Method, problem: RunProblem, *, is_extended: bool) -> Hashable:
    """Return a key that is equal for jobs which differ only in values, times and functions."""
    return row.name, is_extended, problem.settings.t_eval is None


# Maximum number of singular positions that a run records.
_MOST_CROSSINGS = 5

# Fields of ``cotree_job`` that depend only on times and the maximum step size.
_OF_TIMES = ("t", "n_breakpoints", "scale", "max_step", "n_wanted")


def _times_of(problem: RunProblem) -> tuple[Any, ...]:
    t_span, t_eval = problem.settings.t_span, problem.settings.t_eval
    return t_span, t_eval, problem.breakpoints, problem.scale, problem.max_step


class Job:
    """A C job with the arrays that it points to; :meth:`end` must be called.

    A job that has ended can begin again with other values in the same arrays. ``z`` is the last
    valid point, which C updates. ``is_wide`` is true if a sparse factorisation would be much
    cheaper than the banded one of SUNDIALS.
    """

    def __init__(
        self,
        engine: Engine,
        row: Method,
        problem: RunProblem,
        newton: Newton | None = None,
        *,
        is_extended: bool = False,
    ) -> None:
        assert problem.native is not None  # C methods reject problems without C code
        model = problem.native.model
        self._ffi, self._lib = engine.library.ffi, engine.library.lib
        self.engine = engine
        self._arrays: dict[str, FloatArray] = {}
        self._pointers: dict[str, Any] = {}  # C pointers, which keep the arrays alive
        self._n_bytes = 0  # total size of the arrays
        self.rescue = Rescue(problem)
        self._callbacks = Callbacks(self._ffi, self.rescue, newton, model.code.library)
        self.kind = job_kind(row, problem, is_extended=is_extended)
        self.has_newton = newton is not None
        c = self.job = self._ffi.new("cotree_job *")
        # The index -1 means none, because 0 is the first entry.
        c.entry = c.row = c.column = -1
        c.has_sensitivities = int(problem.n_sensitivities > 0)
        c.is_held = int(problem.held is not None)
        c.is_extended = int(is_extended)
        self._set_model(problem, is_implicit=row.implicit or row.family != "cotree")
        self._crossings: FloatArray = np.zeros((0, 1 + problem.n_states))
        if problem.singular is not None:
            from cotree.model.start_in_c import filled_tables

            tables = filled_tables(self._callbacks, model.layout)
            c.constraints = tables.assembly
            self._crossings = np.zeros((_MOST_CROSSINGS, 1 + problem.n_states))
            c.crossings = self._callbacks.pointer(self._crossings)
            c.most_crossings = _MOST_CROSSINGS
        is_left = is_integrated(row, problem, is_extended=is_extended)
        self.places = problem.integrated[is_left]  # indices in z of the integrated values
        known = as_tested(row, problem)
        self._tolerances = Tolerances(known, is_left)
        c.n, c.atol = len(self.places), problem.settings.atol
        # Corrector methods leave kinks to the error test: they cannot return to a point in a step.
        c.is_tested = int(row.family == "correctors")
        c.stepper = getattr(self._lib, f"cotree_{engine.stepper}_stepper")()
        self.is_wide = False
        if newton is not None:
            c.aid = self._ffi.cast("void *", newton.address)
        elif engine.functions is not None:
            from cotree.solvers.sundials import SundialsAid

            self._aid = aid = SundialsAid(engine, row, problem, c.model)
            c.aid, self.is_wide = aid.address, aid.is_wide
        # A job with SUNDIALS memory or Python functions serves a single run.
        asks_python = bool(problem.functions) or problem.reach is not None
        self.is_reusable = engine.functions is None and not asks_python
        # An event record: time, event, sensitivities of the time, states before, states after.
        self._width = 2 + problem.n_sensitivities + 2 * problem.n_states
        self.records = np.zeros((0, self._width))
        # Maximum number of event records in one step; C needs space for them before the step.
        self._at_once = 0
        if problem.events is not None:
            self._at_once = len(problem.events.event_rows) + LIMITS.event_rounds
        # Copy of the structure, mainly pointers, to which each run resets it.
        self._blank = self._ffi.new("cotree_job *", c[0])
        self.rows = StoredRows(self._ffi, c, problem)
        # Bytes of the values from which the tolerances of the last run were computed.
        self._sizes: list[bytes | None] = []
        self._times: FloatArray = np.zeros(0)
        self._wanted: FloatArray | None = None
        self._timed: tuple[Any, ...] = ()
        if self._at_once:
            self._make_records(4 * self._at_once)
        self.begin(problem)

    def begin(self, problem: RunProblem) -> None:
        """Begin a run; its values, times and functions may differ from those of the last run."""
        assert problem.native is not None  # all problems of a job have C code
        c, native = self.job, problem.native
        c[0] = self._blank[0]
        self._callbacks.errors.clear()
        self.rescue.problem, self.rescue.reason = problem, ""
        if not self.has_newton and problem.singular is not None:
            # With dependent constraints, rates are unique only at points that C has projected.
            c.is_strict = int(bool(problem.singular(problem.settings.t_span[0], problem.z0)))
        self._set_array("p", native.p)
        self._set_array("k", native.k)
        if native.model.inputs:
            self._set_array("u", np.zeros(len(native.model.inputs)))
        c.rtol = self._tolerances.rtol_of(problem)
        sizes = [row if row is None else row.tobytes() for row in (problem.sizes, problem.scales)]
        if sizes != self._sizes:
            self._sizes = sizes
            self._set_array("atols", self._tolerances.of(problem))
        self._set_array("z", problem.z0)
        self.z = self._arrays["z"]
        is_timed = self._is_timed(problem)
        if not is_timed:
            self._set_times(problem)
        self.rows.begin(problem)
        self._tested_from: int | None = None
        if self._at_once:
            bound = most_rows(self._width)
            c.most_events = min(problem.settings.max_events or bound, bound)
        # C computes the size of its memory from all other fields.
        size = 0 if is_timed else -(-int(self._lib.cotree_job_memory(c)) // 8)
        memory = self._arrays.get("memory")
        if memory is None or memory.size < size:
            self._set_array("memory", np.zeros(size))
        else:
            memory.fill(0.0)
        if not is_timed:
            self._keep_times(problem)

    def _is_timed(self, problem: RunProblem) -> bool:
        timed = _times_of(problem)
        return len(timed) == len(self._timed) and all(map(operator.is_, timed, self._timed))

    def _keep_times(self, problem: RunProblem) -> None:
        """Store the times of this run for later runs, unless they depend on parameters."""
        self._timed = () if len(problem.breakpoints) else _times_of(problem)
        if self._timed:
            for name in _OF_TIMES:
                setattr(self._blank, name, getattr(self.job, name))

    @property
    def n_bytes(self) -> int:
        """The memory of the job's arrays, [byte]."""
        return self._n_bytes + self.rows.values.nbytes + self.records.nbytes

    def _set_model(self, problem: RunProblem, *, is_implicit: bool) -> None:
        """Set the model, its inputs, and the Python functions that C calls."""
        assert problem.native is not None
        c = self.job
        code = problem.native.model.code
        c.model = self._ffi.cast("cotree_model *", code.address_for(is_implicit=is_implicit))
        c.n_replaced, c.replaced = len(problem.replaced), self._callbacks.tables(problem.replaced)
        if problem.functions:
            c.input_function = self._callbacks.input_function(problem.functions)
        if problem.reach is not None:
            c.reach = self._callbacks.reach(problem.reach, problem.size)
        if problem.n_algebraic:
            c.helper = self._callbacks.helper(problem.n_states)

    def _set_times(self, problem: RunProblem) -> None:
        c, times = self.job, restart_times(problem)
        c.t, c.n_breakpoints = times[0], len(times)
        if not np.array_equal(times, self._times):
            self._times = times
            self._set_array("breakpoints", times)
        c.scale = problem.scale
        if len(problem.breakpoints):
            c.is_start_sharp = int(times[0] in problem.breakpoints)
            c.is_end_sharp = int(times[-1] in problem.breakpoints)
        c.max_step = min(problem.max_step, sys.float_info.max)
        self._set_slopes(problem, times)
        if problem.settings.t_eval is None:
            return
        c.n_wanted = len(problem.settings.t_eval)
        # Arrays of times are never changed in place, so the same object has the same values.
        if problem.settings.t_eval is not self._wanted:
            self._wanted = problem.settings.t_eval
            self._set_array("wanted", np.asarray(problem.settings.t_eval, dtype=float))

    def run(self, most_steps: int) -> int:
        """Take at most ``most_steps`` steps; return a code such as ``COTREE_JOB_DONE``."""
        most_steps = self.rows.steps_with_room(most_steps)
        if self._at_once and self.job.n_records + self._at_once > self.job.most_records:
            self._make_records(2 * self.job.most_records)
        # Steps before `_tested_from` are not tested for stiffness.
        if self._tested_from is not None:
            unwatched = self._tested_from - int(self.job.n_steps)
            self.job.is_waiting = int(unwatched <= 0)
            # C stops at the step at which the test for stiffness begins.
            most_steps = min(most_steps, unwatched) if unwatched > 0 else most_steps
        result = int(self._lib.cotree_job_run(self.job, most_steps))
        if self._callbacks.errors:
            raise self._callbacks.errors[0]
        self.rows.drop_between()
        return result

    def pause_if_stiff(self, first_step: int) -> None:
        """Make an explicit method pause if it detects stiffness from step ``first_step`` on."""
        self._tested_from = first_step

    def sync_state(self) -> None:
        """Update the time and point in the structure of a job that has not ended."""
        self._lib.cotree_job_sync(self.job)

    def end(self) -> None:
        """Free the memory of the stepper."""
        self._lib.cotree_job_end(self.job)

    @property
    def event_records(self) -> FloatArray:
        """The records of the events so far; see :attr:`Trajectory.events`."""
        return self.records[: self.job.n_records].copy() if self._at_once else self.records

    @property
    def crossings(self) -> list[tuple[float, FloatArray]]:
        """Times and states of the first singular positions that the motion has crossed."""
        rows = self._crossings[: self.job.n_crossed].copy()
        return [(float(row[0]), row[1:]) for row in rows]

    def _set_slopes(self, problem: RunProblem, times: FloatArray) -> None:
        """Set the parameter derivatives of the breakpoint times unless all are zero."""
        if not (len(problem.shifts) and problem.n_sensitivities):
            return
        # Slopes of breakpoints that do not depend on parameters are zero.
        are_moved, slopes, spreads = problem.shifts.rows_at(times)
        if not are_moved[:-1].any():
            return
        # These pointers are set only for this run.
        self.job.slopes = self._placed("slopes", slopes)
        self.job.spreads = self._placed("spreads", spreads)
        self.job.turn_tolerances = self._placed("turn_tolerances", turn_tolerances(problem))

    def _make_records(self, rows: int) -> None:
        kept = int(self.job.n_records)
        records = np.zeros((rows, self._width))
        records[:kept] = self.records[:kept]
        self.records = records
        self._point("records", self._ffi.from_buffer("double[]", records))
        self.job.most_records = self._blank.most_records = rows

    def _set_array(self, name: str, values: FloatArray) -> None:
        """Copy values to an array, and point a field of the structure to it in all runs."""
        known = self._pointers.get(name)
        pointer = self._placed(name, values)
        if pointer is not known:
            self._point(name, pointer)

    def _placed(self, name: str, values: FloatArray) -> Any:
        """Copy values to an array; return its pointer, which changes only with the size."""
        array = self._arrays.get(name)
        if array is not None and array.size == values.size:
            array[...] = values
            return self._pointers[name]
        self._n_bytes += values.nbytes - (0 if array is None else array.nbytes)
        array = self._arrays[name] = np.array(values, dtype=np.float64)
        self._pointers[name] = pointer_to(self._ffi, array)
        return self._pointers[name]

    def _point(self, name: str, pointer: Any) -> None:
        """Set a pointer of the structure for this run and later runs."""
        setattr(self.job, name, pointer)
        setattr(self._blank, name, pointer)
