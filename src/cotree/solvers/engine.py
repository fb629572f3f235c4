"""The C engine of a method: built once on a machine, loaded, and given jobs.

In: a ``Problem`` with its native form. Out: a job, a structure that C advances some steps at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.build import BuildOptions, find_toolchain, obtain_library
from cotree.codegen.integrators import engine_declarations, engine_files
from cotree.codegen.statuses import NUMBERS, STATUSES, TURNED
from cotree.dag.corners import Corner
from cotree.errors import BuildError
from cotree.model.kernels import SINGULAR
from cotree.sharing import made_once
from cotree.solvers.augmented import augmented_tolerances
from cotree.solvers.base import Occurrence
from cotree.solvers.corners import turn_tolerances, turning
from cotree.solvers.event_messages import BY_STATUS, verdict
from cotree.solvers.messages import undefined_ahead
from cotree.solvers.problem import describe_entry
from cotree.solvers.rescue import Rescue
from cotree.tolerances import LIMITS
from cotree.version import ABI_VERSION

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cotree.build import LoadedLibrary
    from cotree.model.kernels import NativeModel
    from cotree.model.newton import Newton
    from cotree.solvers.problem import FloatArray, Problem

# What a status means.
_SENTENCES = {row.number: row.sentence for row in STATUSES}


@dataclass(frozen=True, eq=False)
class Native:
    """The native form of a problem, which C needs.

    Attributes
    ----------
    model : NativeModel
        The model with its parameters prepared.
    n_inputs : int
        Number of inputs.
    replaced : mapping of int to (times, values)
        Inputs that are piecewise linear functions in place of the scene's own.
    functions : mapping of int to callable
        Inputs that are functions of time in Python, ``f(t)`` with t in [s].
    """

    model: NativeModel
    n_inputs: int
    replaced: Mapping[int, tuple[FloatArray, FloatArray]]
    functions: Mapping[int, Callable[[float], float]]


@made_once
def load_engine(method: str) -> LoadedLibrary | None:
    """Build and load the engine of a method; None where there is no compiler that can.

    Parameters
    ----------
    method : str
        A name in ``STEPPERS``.
    """
    files = engine_files(method)
    return build_engine(files, engine_declarations(files, method))


def build_engine(files: Mapping[str, str], declarations: str) -> LoadedLibrary | None:
    """Build and load C that is the same for every model; None where no compiler can."""
    toolchain = find_toolchain()
    if toolchain is None:
        return None
    # The least level that makes vectors of sums over equations: a fifth faster for 8 of them, a
    # quarter for 36. A number of equations known beforehand gains nothing. What is around the steps
    # takes the compiler longer than these do, and runs no faster.
    try:
        _, loaded = obtain_library(
            files,
            declarations,
            abi_version=ABI_VERSION,
            n_operations=1,
            options=BuildOptions("-O1"),
            toolchain=toolchain,
            levels={"engine.c": "-O3"},
        )
    except BuildError:
        return None
    return loaded


class Job:
    """A job of an engine, with all that it points to.

    Attributes
    ----------
    keeps_algebraic : bool
        Whether algebraic unknowns are integrated, not solved for at each evaluation.
    """

    keeps_algebraic = False

    def __init__(
        self,
        engine: LoadedLibrary,
        stepper: str,
        problem: Problem,
        corners: Sequence[float],
        is_extended: bool = False,
        newton: Newton | None = None,
    ) -> None:
        assert problem.native is not None
        self._ffi, self._lib = engine.ffi, engine.lib
        self._kept: list[Any] = [engine, problem.native, newton]
        native, n_full = problem.native, problem.size
        keeps = self.keeps_algebraic or newton is not None
        cut = problem.n_states - (0 if keeps else problem.n_algebraic)
        lead = problem.n_states if is_extended else cut
        rtol, atols = self._tolerances(problem)
        places = problem.integrated
        states = places % problem.n_states
        is_left = states < np.where(places < problem.n_states, lead, cut)
        # Positions in z of the entries that C integrates.
        self._places, atols = places[is_left], atols[is_left]
        n = len(atols)
        job = self._ffi.new("cotree_job *")
        job.model = self._ffi.cast("cotree_model *", native.model.address)
        job.p, job.k = self._doubles(native.model.p), self._doubles(native.model.k)
        job.u = self._doubles(np.zeros(native.n_inputs))
        job.n_replaced, job.replaced = len(native.replaced), self._tables(native)
        self._errors: list[BaseException] = []
        if native.functions:
            job.input_function = self._ask_for_inputs(native.functions)
        self.rescue = Rescue(problem)
        if self.rescue.is_needed:
            job.helper = self._helper(problem.n_states)
        job.has_sensitivities = int(problem.n_sensitivities > 0)
        job.is_held = int(problem.project is not None)
        job.is_extended = int(is_extended)
        if newton is None and problem.singular is not None:
            job.is_strict = int(bool(problem.singular(corners[0], problem.z0)))
        job.n, job.rtol, job.atols = n, rtol, self._doubles(atols)
        job.atol = float(np.min(problem.atol))
        job.max_step = min(problem.max_step, float(np.finfo(np.float64).max))
        job.n_corners, job.corners = len(corners), self._doubles(np.array(corners))
        wanted = problem.t_eval
        if wanted is not None:
            job.n_wanted, job.wanted = len(wanted), self._doubles(np.array(wanted, dtype=float))
        self.z = np.array(problem.z0, dtype=np.float64)
        job.z, job.t = self._doubles(self.z), corners[0]
        job.entry = job.row = job.column = -1
        self.job = job
        job.scale = problem.scale
        job.is_start_sharp = int(corners[0] in problem.breakpoints)
        job.is_end_sharp = int(corners[-1] in problem.breakpoints)
        self._let_turn(problem, corners)
        job.stepper = getattr(self._lib, f"cotree_{stepper}_stepper")()
        job.aid = self._ffi.cast("void *", self._make_aid(problem, newton))
        size = int(self._lib.cotree_job_memory(job))
        job.memory = self._doubles(np.zeros(-(-size // 8)))
        self._n = n_full
        self._room = 0
        self._looks_from: int | None = None
        self.times, self.values = np.zeros(0), np.zeros((0, n_full))
        self._keeps_steps = wanted is None
        self._make_room(256 if wanted is None else len(wanted))
        self._at_once = 0
        self._width = 2 + problem.n_sensitivities + 2 * problem.n_states
        self.records = np.zeros((0, self._width))
        if problem.events is not None:
            self._at_once = len(problem.events.rows) + LIMITS.event_rounds
            self._make_records(4 * self._at_once)
            job.most_events = problem.max_events or 0

    def _tolerances(self, problem: Problem) -> tuple[float, FloatArray]:
        """Return the relative tolerance, and the absolute tolerance of each entry of z."""
        return augmented_tolerances(problem)

    def run(self, most_steps: int) -> int:
        """Take some steps; see ``COTREE_JOB_DONE`` and its like.

        An exception of an input that is a Python function ends the job, and is raised here.
        """
        if self._keeps_steps:
            needed = int(self.job.n_kept) + most_steps + 1
            if needed > self._room:
                self._make_room(max(needed, 2 * self._room))
        if self._at_once and self.job.n_records + self._at_once > self.job.most_records:
            self._make_records(2 * self.job.most_records)
        if self._looks_from is not None:
            unwatched = self._looks_from - int(self.job.n_steps)
            self.job.is_waiting = int(unwatched <= 0)
            most_steps = min(most_steps, unwatched) if unwatched > 0 else most_steps
        result = int(self._lib.cotree_job_run(self.job, most_steps))
        if self._errors:
            raise self._errors[0]
        return result

    @property
    def is_stiff(self) -> bool:
        """Tell whether stability made an explicit method take many steps."""
        return bool(self.job.is_stiff) and int(self.job.n_stiff_steps) > LIMITS.most_stiff_steps

    def wait_where_stiff(self, first_step: int) -> None:
        """Make an explicit method wait where its problem is stiff, from ``first_step`` on."""
        self._looks_from = first_step

    def reason(self, problem: Problem) -> str:
        """Say why the job failed."""
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
        reason = "; ".join(reasons)
        # What makes steps short may be that rates have no value beyond a point.
        why = undefined_ahead(problem, float(c.t), self.z)
        return f"{reason}: {why}" if why else reason

    def end(self) -> None:
        """Free what the stepper holds."""
        self._lib.cotree_job_end(self.job)

    @property
    def has_spent_events(self) -> bool:
        """Tell whether the budget of events is spent."""
        return bool(0 < self.job.most_events <= self.job.n_records)

    def happened(self, problem: Problem) -> tuple[Occurrence, ...]:
        """List the events that happened."""
        n, m = problem.n_states, problem.n_sensitivities
        return tuple(
            Occurrence(int(row[1]), float(row[0]), row[2 + m : 2 + m + n], row[-n:], row[2 : 2 + m])
            for row in self.records[: self.job.n_records].copy()
        )

    def _let_turn(self, problem: Problem, corners: Sequence[float]) -> None:
        """Say how the times of corners depend on the parameters, where any does."""
        if not problem.n_sensitivities or problem.shifts.keys().isdisjoint(corners[:-1]):
            return
        still = Corner(0.0, *((0.0,) * problem.n_sensitivities,) * 2)
        rows = [problem.shifts.get(t, still) for t in corners]
        self.job.slopes = self._doubles(np.array([row.slopes for row in rows]))
        self.job.spreads = self._doubles(np.array([row.spreads for row in rows]))
        self.job.turn_tolerances = self._doubles(turn_tolerances(problem))

    def _verdict(self, problem: Problem, name: str) -> str:
        """Say why an event ended the job."""
        assert problem.events is not None  # whose status it is
        rows, c = problem.events.rows, self.job
        events = [rows[c.event].name]
        if name in ("endless", "slides"):
            events = [row.name for i, row in enumerate(rows) if c.has_fired[i]]
        said = verdict(name, events, float(c.event_time), float(c.event_detail))
        return f"{said} ({self.rescue.complaint})" if self.rescue.complaint else said

    def _make_aid(self, problem: Problem, newton: Newton | None) -> Any:
        """Point to what the stepper needs besides."""
        return self._ffi.NULL if newton is None else newton.address

    def _make_room(self, rows: int) -> None:
        """Make room for kept values; existing ones stay."""
        kept = int(self.job.n_kept)
        times, values = np.zeros(rows), np.zeros((rows, self._n))
        times[:kept], values[:kept] = self.times[:kept], self.values[:kept]
        self.times, self.values, self._room = times, values, rows
        self.job.times = self._ffi.from_buffer("double[]", times)
        self.job.values = self._ffi.from_buffer("double[]", values) if self._n else self._ffi.NULL

    def _make_records(self, rows: int) -> None:
        """Make room for the records that events write; existing ones stay."""
        kept = int(self.job.n_records)
        records = np.zeros((rows, self._width))
        records[:kept] = self.records[:kept]
        self.records = records
        self.job.records = self._ffi.from_buffer("double[]", records)
        self.job.most_records = rows

    def _doubles(self, array: FloatArray) -> Any:
        """Point to an array, which is kept."""
        if not array.size:
            return self._ffi.NULL
        pointer = self._ffi.from_buffer("double[]", np.ascontiguousarray(array, dtype=np.float64))
        self._kept.append(pointer)
        return pointer

    def _ask_for_inputs(self, functions: Mapping[int, Callable[[float], float]]) -> Any:
        """Give C a function that asks Python for inputs."""
        errors = self._errors

        def ask(t: float, u: Any, context: Any) -> int:
            if errors:  # C may try a shorter step before it gives up
                return -1
            for place, function in functions.items():
                u[place] = function(t)
            return 0

        return self._callback("cotree_input_function", ask)

    def _helper(self, n_states: int) -> Any:
        """Give C what looks farther than it does."""
        rescue, ffi = self.rescue, self._ffi

        def find_unknowns(t: float, x: Any, context: Any) -> int:
            point = np.frombuffer(ffi.buffer(x, 8 * n_states))
            return int(not rescue.find_unknowns(t, point))

        def find_states(t: float, x: Any, kept: Any, n_kept: int, context: Any) -> int:
            point = np.frombuffer(ffi.buffer(x, 8 * n_states))
            return int(not rescue.find_states(t, point, [kept[i] for i in range(n_kept)]))

        helper = ffi.new("cotree_helper *")
        helper.find_unknowns = self._callback("cotree_find_unknowns", find_unknowns)
        helper.find_states = self._callback("cotree_find_states", find_states)
        self._kept.append(helper)
        return helper

    def _callback(self, kind: str, function: Callable[..., int]) -> Any:
        """Give C a function of Python; exceptions, Ctrl-C among them, wait until C is back."""
        errors = self._errors

        def remember(kind: Any, error: BaseException, traceback: Any) -> None:
            errors.append(error)

        callback = self._ffi.callback(kind, function, error=-1, onerror=remember)
        self._kept.append(callback)
        return callback

    def _tables(self, native: Native) -> Any:
        tables = self._ffi.new("cotree_table_input[]", max(1, len(native.replaced)))
        for row, (place, (times, values)) in zip(tables, native.replaced.items(), strict=False):
            row.input, row.length = place, len(times)
            row.t, row.u = self._doubles(times), self._doubles(values)
        self._kept.append(tables)
        return tables
