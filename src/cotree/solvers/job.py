"""One run of a method in C: a structure that C advances some steps at once, and what it says.

In: the engine of a method, and a ``Problem`` with its native form. Out: values, events, and the
reason of a failure.
"""

from __future__ import annotations

import operator
import sys
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.codegen.statuses import NUMBERS, STATUSES, TURNED
from cotree.errors import Error
from cotree.model.kernels import SINGULAR, Newton
from cotree.model.start_in_c import filled_tables
from cotree.solvers.augmented import Tolerances
from cotree.solvers.budgets import most_rows
from cotree.solvers.callbacks import Callbacks
from cotree.solvers.corners import corner_times, turn_tolerances, turning
from cotree.solvers.evaluate import Evaluator, IntegrationStopError
from cotree.solvers.event_messages import BY_STATUS, blamed, verdict
from cotree.solvers.messages import undefined_ahead
from cotree.solvers.problem import describe_entry
from cotree.solvers.rescue import Rescue
from cotree.solvers.rows import Rows
from cotree.solvers.shared import job_kind
from cotree.solvers.sundials_aid import SundialsAid
from cotree.solvers.tested import as_tested, is_integrated
from cotree.tolerances import LIMITS

if TYPE_CHECKING:
    from cotree.solvers.base import FloatArray
    from cotree.solvers.engine import Engine
    from cotree.solvers.methods import Method
    from cotree.solvers.problem import Native, Problem

# Singular positions of a run whose edges are named.
_MOST_CROSSINGS = 5

# Sentences by status.
_SENTENCES = {row.number: row.sentence for row in STATUSES}


# Members of the structure that times and the longest step decide.
_OF_TIMES = ("t", "n_corners", "scale", "max_step", "n_wanted")


def _times_of(problem: Problem) -> tuple[Any, ...]:
    t_span, t_eval = problem.settings.t_span, problem.settings.t_eval
    return t_span, t_eval, problem.breakpoints, problem.scale, problem.max_step


class Job:
    """A job of an engine, with all that it points to; end it, whatever happens.

    A job that has ended may begin again, with other values: what it points to stays in place.

    Parameters
    ----------
    engine : Engine
        The engine of the method's stepper.
    row : Method
        The method.
    problem : Problem
        A problem with a native form.
    newton : Newton, optional
        The factors of its model, which own implicit methods need.
    is_extended : bool
        Whether algebraic unknowns are integrated, too, by an explicit method.

    Attributes
    ----------
    job : cotree_job
        The structure.
    z : ndarray, shape (n_states * (1 + n_sensitivities),)
        The last good point, which C moves.
    rows : Rows
        What C keeps of the run.
    kind : object
        See :func:`job_kind`.
    is_reusable : bool
        Whether another run may begin with it.
    rescue : Rescue
        Looks for points that the iterations in C do not find.
    is_wide : bool
        Whether a sparse factorisation would be much cheaper than the banded one of SUNDIALS' steps.
    """

    def __init__(
        self,
        engine: Engine,
        row: Method,
        problem: Problem,
        newton: Newton | None = None,
        *,
        is_extended: bool = False,
    ) -> None:
        assert problem.native is not None  # else the method refuses it
        self._ffi, self._lib = engine.library.ffi, engine.library.lib
        self._kept: list[Any] = [engine, newton]
        self._arrays: dict[str, FloatArray] = {}
        self._pointers: dict[str, Any] = {}  # each keeps its array alive
        self._n_bytes = 0  # of all arrays
        self.rescue = Rescue(problem)
        self._callbacks = Callbacks(self._ffi, self.rescue)
        self.kind = job_kind(engine, row, problem, is_extended=is_extended)
        self._has_newton = newton is not None
        c = self.job = self._ffi.new("cotree_job *")
        # Zero would name the first entry.
        c.entry = c.row = c.column = -1
        c.has_sensitivities = int(problem.n_sensitivities > 0)
        c.is_held = int(problem.held is not None)
        c.is_extended = int(is_extended)
        self._set_model(problem, problem.native)
        self._crossings: FloatArray = np.zeros((0, 1 + problem.n_states))
        if problem.singular is not None:
            tables = filled_tables(self._ffi, problem.native.model.layout, self._kept)
            c.constraints = tables.assembly
            self._crossings = np.zeros((_MOST_CROSSINGS, 1 + problem.n_states))
            c.crossings = self._doubles(self._crossings)
            c.most_crossings = _MOST_CROSSINGS
        is_left = is_integrated(row, problem, is_extended=is_extended)
        self._places = problem.integrated[is_left]  # positions in z
        known = as_tested(row, problem)
        self._tolerances = Tolerances(known, is_left)
        c.n, c.atol = len(self._places), problem.settings.atol
        # Correctors do not go back to what happens within a step.
        c.is_tested = int(row.family == "correctors")
        c.stepper = getattr(self._lib, f"cotree_{engine.stepper}_stepper")()
        self.is_wide = False
        if newton is not None:
            c.aid = self._ffi.cast("void *", newton.address)
        elif engine.functions is not None:
            aid = SundialsAid(engine, row, problem, c.model)
            c.aid, self.is_wide = aid.address, aid.is_wide
            self._kept.append(aid)
        # SUNDIALS' own memory is made anew for each run, and functions of Python belong to one.
        native = problem.native
        asks_python = bool(native.functions) or problem.reach is not None
        self.is_reusable = engine.functions is None and not asks_python
        # A record holds time, event, sensitivities of the time, and states before and after.
        self._width = 2 + problem.n_sensitivities + 2 * problem.n_states
        self.records = np.zeros((0, self._width))
        # The most records of one step: C returns where there is no room for as many.
        self._at_once = 0
        if problem.events is not None:
            self._at_once = len(problem.events.rows) + LIMITS.event_rounds
        # The structure as each run begins with it: where things are, and nothing of a run.
        self._blank = self._ffi.new("cotree_job *", c[0])
        self.rows = Rows(self._ffi, c, problem.size)
        # What the tolerances and the times were put in place for.
        self._sizes: list[bytes | None] = []
        self._corners: FloatArray = np.zeros(0)
        self._wanted: FloatArray | None = None
        self._timed: tuple[Any, ...] = ()
        if self._at_once:
            self._make_records(4 * self._at_once)
        self.begin(problem)

    def begin(self, problem: Problem) -> None:
        """Begin a run: that of the job's own problem, or another one of the same kind.

        Parameters
        ----------
        problem : Problem
            It differs from the first one in values, times and functions alone.
        """
        assert problem.native is not None  # of the same kind
        c, native = self.job, problem.native
        c[0] = self._blank[0]
        self._callbacks.errors.clear()
        self.rescue.problem, self.rescue.complaint = problem, ""
        if not self._has_newton and problem.singular is not None:
            # Off constraints that depend on each other there are no rates: C projects points first.
            c.is_strict = int(bool(problem.singular(problem.settings.t_span[0], problem.z0)))
        self._put("p", native.model.p)
        self._put("k", native.model.k)
        if native.n_inputs:
            self._put("u", np.zeros(native.n_inputs))
        c.rtol = self._tolerances.rtol_of(problem)
        sizes = [row if row is None else row.tobytes() for row in (problem.sizes, problem.scales)]
        if sizes != self._sizes:
            self._sizes = sizes
            self._put("atols", self._tolerances.of(problem))
        self._put("z", problem.z0)
        self.z = self._arrays["z"]
        is_timed = self._is_timed(problem)
        if not is_timed:
            self._set_times(problem)
        self.rows.begin(problem)
        self._looks_from: int | None = None
        if self._at_once:
            bound = most_rows(self._width)
            c.most_events = min(problem.settings.max_events or bound, bound)
        # Last, since the size follows from all that is filled in.
        if is_timed:
            self._arrays["memory"].fill(0.0)
        else:
            self._clear_memory(int(self._lib.cotree_job_memory(c)))
            self._keep_times(problem)

    def _is_timed(self, problem: Problem) -> bool:
        """Return whether a run begins with the times of the last one, which are in place."""
        timed = _times_of(problem)
        return len(timed) == len(self._timed) and all(map(operator.is_, timed, self._timed))

    def _keep_times(self, problem: Problem) -> None:
        """Keep the times of this run for the next ones if no parameter moves them."""
        self._timed = () if len(problem.breakpoints) else _times_of(problem)
        if self._timed:
            for name in _OF_TIMES:
                setattr(self._blank, name, getattr(self.job, name))

    @property
    def n_bytes(self) -> int:
        """Counts the bytes that a job holds while it waits to begin again."""
        return self._n_bytes + self.rows.values.nbytes + self.records.nbytes

    def _set_model(self, problem: Problem, native: Native) -> None:
        """Fill in the model, its inputs, and the functions by which C asks Python."""
        c = self.job
        self._kept.append(native.model.library)
        c.model = self._ffi.cast("cotree_model *", native.model.address)
        c.n_replaced, c.replaced = len(native.replaced), self._tables(native)
        if native.functions:
            c.input_function = self._callbacks.ask_for_inputs(native.functions)
        if problem.reach is not None:
            c.reach = self._callbacks.reach(problem.reach, problem.size)
        if self.rescue.is_needed:
            c.helper = self._callbacks.helper(problem.n_states)

    def _set_times(self, problem: Problem) -> None:
        """Fill in the span, breakpoints and wanted times."""
        c, corners = self.job, corner_times(problem)
        c.t, c.n_corners = corners[0], len(corners)
        if not np.array_equal(corners, self._corners):
            self._corners = corners
            self._put("corners", corners)
        c.scale = problem.scale
        if len(problem.breakpoints):
            c.is_start_sharp = int(corners[0] in problem.breakpoints)
            c.is_end_sharp = int(corners[-1] in problem.breakpoints)
        c.max_step = min(problem.max_step, sys.float_info.max)
        self._let_turn(problem, corners)
        if problem.settings.t_eval is None:
            return
        c.n_wanted = len(problem.settings.t_eval)
        # Nobody changes the times of a problem, so that the same array needs no look.
        if problem.settings.t_eval is not self._wanted:
            self._wanted = problem.settings.t_eval
            self._put("wanted", np.asarray(problem.settings.t_eval, dtype=float))

    def run(self, most_steps: int) -> int:
        """Take some steps; see ``COTREE_JOB_DONE`` and its like.

        An exception of an input that is a Python function ends the job, and is raised here.
        """
        most_steps = self.rows.steps_with_room(most_steps)
        if self._at_once and self.job.n_records + self._at_once > self.job.most_records:
            self._make_records(2 * self.job.most_records)
        # Steps before `_looks_from` are taken without asking whether the problem is stiff.
        if self._looks_from is not None:
            unwatched = self._looks_from - int(self.job.n_steps)
            self.job.is_waiting = int(unwatched <= 0)
            # C would otherwise pass the step from which on it is to wait.
            most_steps = min(most_steps, unwatched) if unwatched > 0 else most_steps
        result = int(self._lib.cotree_job_run(self.job, most_steps))
        if self._callbacks.errors:
            raise self._callbacks.errors[0]
        self.rows.drop_between()
        return result

    def wait_where_stiff(self, first_step: int) -> None:
        """Make an explicit method wait where its problem is stiff, from ``first_step`` on."""
        self._looks_from = first_step

    def reason(self, problem: Problem) -> str:
        """Describe why the job failed."""
        c, status = self.job, int(self.job.status)
        if status in BY_STATUS:
            return self._verdict(problem, BY_STATUS[status])
        if status == TURNED:
            return turning(problem, float(c.t), int(c.turned))
        reasons = []
        if c.flag:
            known = status != NUMBERS["FLAGGED"]
            reasons = [f"SUNDIALS says: {_SENTENCES[status] if known else f'flag {c.flag}'}"]
        elif status != NUMBERS["RATE_NOT_FINITE"] or c.entry < 0:
            reasons = [_SENTENCES.get(status, f"the integrator gives status {status}")]
        if c.complaint == SINGULAR and not problem.n_algebraic:
            reasons.append("a linear system of the model is singular ahead")
        if c.row >= 0:
            of, by = describe_entry(problem, c.row), describe_entry(problem, c.column)
            reasons.append(f"the derivative of {of} differentiated by {by} is not finite ahead")
        if c.entry >= 0:
            name = describe_entry(problem, int(self._places[c.entry]))
            reasons.append(f"the derivative of {name} is not finite ahead")
        elif c.row < 0 and status in (NUMBERS["RATE_FAILED"], NUMBERS["RATE_NOT_FINITE"]):
            reasons += self._fault_of_jacobian(problem)
        reason = "; ".join(reasons)
        # What makes steps short may be that rates have no value beyond a point.
        why = undefined_ahead(problem, float(c.t), self.z)
        return f"{reason}: {why}" if why else reason

    def _fault_of_jacobian(self, problem: Problem) -> list[str]:
        """Name the entry of the Jacobian that is not finite where an implicit method stands."""
        if not self._has_newton or problem.n_algebraic:
            return []
        try:
            Evaluator(problem).state_jacobian(float(self.job.t), self.z)
        except (IntegrationStopError, Error) as error:
            return [str(error)]
        return []

    def stand(self) -> None:
        """Write where a job stands that is broken off."""
        self._lib.cotree_job_sync(self.job)

    def end(self) -> None:
        """Free what the stepper holds."""
        self._lib.cotree_job_end(self.job)

    @property
    def has_spent_events(self) -> bool:
        """Return whether the budget of events is spent."""
        return bool(0 < self.job.most_events <= self.job.n_records)

    @property
    def happened(self) -> FloatArray:
        """The events that happened; see :attr:`Trajectory.events`."""
        return self.records[: self.job.n_records].copy()

    @property
    def crossings(self) -> list[tuple[float, FloatArray]]:
        """Times and states at the first singular positions that were crossed."""
        rows = self._crossings[: self.job.n_crossed].copy()
        return [(float(row[0]), row[1:]) for row in rows]

    def _let_turn(self, problem: Problem, corners: FloatArray) -> None:
        """Describe how the times of corners depend on the parameters, where any does."""
        if not (len(problem.shifts) and problem.n_sensitivities):
            return
        # Corners that no parameter moves have slopes of zero.
        are_moved, slopes, spreads = problem.shifts.rows_at(corners)
        if not are_moved[:-1].any():
            return
        # These pointers are of this run only: where no corner moves, C finds none.
        self.job.slopes = self._placed("slopes", slopes)
        self.job.spreads = self._placed("spreads", spreads)
        self.job.turn_tolerances = self._placed("turn_tolerances", turn_tolerances(problem))

    def _verdict(self, problem: Problem, name: str) -> str:
        """Describe why an event ended the job."""
        c = self.job
        # Kinks of laws are located as events are, and have no names.
        rows = problem.events.rows if problem.events is not None else ()
        fired = [row.name for i, row in enumerate(rows) if c.has_fired[i]]
        events = blamed(name, rows[c.event].name, fired) if rows else ["kink of a law"]
        said = verdict(name, events, float(c.event_time), float(c.event_detail))
        return f"{said} ({self.rescue.complaint})" if self.rescue.complaint else said

    def _make_records(self, rows: int) -> None:
        """Make room for the records that events write; existing ones stay."""
        kept = int(self.job.n_records)
        records = np.zeros((rows, self._width))
        records[:kept] = self.records[:kept]
        self.records = records
        self._point("records", self._ffi.from_buffer("double[]", records))
        self.job.most_records = self._blank.most_records = rows

    def _put(self, name: str, values: FloatArray) -> None:
        """Set a pointer of the structure to values, for this run and the following ones."""
        known = self._pointers.get(name)
        pointer = self._placed(name, values)
        if pointer is not known:
            self._point(name, pointer)

    def _placed(self, name: str, values: FloatArray) -> Any:
        """Return a pointer to values, the same as before where they fit."""
        array = self._arrays.get(name)
        if array is not None and array.size == values.size:
            array[...] = values
            return self._pointers[name]
        self._n_bytes += values.nbytes - (0 if array is None else array.nbytes)
        array = self._arrays[name] = np.array(values, dtype=np.float64)
        pointer = self._ffi.from_buffer("double[]", array) if array.size else self._ffi.NULL
        self._pointers[name] = pointer
        return pointer

    def _point(self, name: str, pointer: Any) -> None:
        """Set a pointer of the structure, and of what the next runs begin with."""
        setattr(self.job, name, pointer)
        setattr(self._blank, name, pointer)

    def _clear_memory(self, n_bytes: int) -> None:
        """Return C memory for what it remembers, all of it zero."""
        memory = self._arrays.get("memory")
        if memory is None or memory.nbytes < n_bytes:
            self._put("memory", np.zeros(-(-n_bytes // 8)))  # rounded up to whole doubles
        else:
            memory.fill(0.0)

    def _doubles(self, array: FloatArray) -> Any:
        """Return a pointer to an array, and keep the array alive."""
        if not array.size:
            return self._ffi.NULL
        pointer = self._ffi.from_buffer("double[]", np.ascontiguousarray(array, dtype=np.float64))
        self._kept.append(pointer)
        return pointer

    def _tables(self, native: Native) -> Any:
        tables = self._ffi.new("cotree_table_input[]", max(1, len(native.replaced)))
        for row, (place, (times, values)) in zip(tables, native.replaced.items(), strict=False):
            row.input, row.length = place, len(times)
            row.t, row.u = self._doubles(times), self._doubles(values)
        self._kept.append(tables)
        return tables
