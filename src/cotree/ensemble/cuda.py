"""Members of an ensemble on a graphics processor: one thread runs one member after another.

In: a ``Plan`` of an explicit method, and rows. Out: a ``Block``, equal to that of
:func:`cotree.ensemble.batch.run_block` to rounding: sines and their like come from another library.
The C is the same; see :mod:`cotree.codegen.cuda`. Members that do not come to their end there are
run by themselves here.
"""

from __future__ import annotations

import weakref
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from cotree.codegen.cuda import ROOMS, cuda_text
from cotree.codegen.integrators import INTEGRATORS
from cotree.ensemble.block_in_c import ALONE, DONE, STOPPED, BlockInC
from cotree.ensemble.pattern import Pattern, Unfit, find_pattern
from cotree.errors import SolveError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.ensemble.plan import Block, Plan
    from cotree.solvers.base import FloatArray

# Threads of a block; steps of members differ, so that large ones would wait for their slowest.
_THREADS = 64
# More threads than this wait for each other's memory; their room in all, in bytes.
_MOST_THREADS, _MOST_ROOM = 1 << 16, 1 << 30
# Kernels call each other through pointers, so that the compiler cannot tell how deep stacks grow.
_STACK, _STACK_LIMIT = 1 << 14, 0
#: What the compiler is told. Products and sums are not fused, as in the library of a model.
OPTIONS = ("-default-device", "--fmad=false")

# Arrays of a batch and of a job that threads read, and those that they write.
_READ = (*("p", "set", "set_values", "set_by", "atols", "turn_tolerances"), "outputs")
_WRITTEN = (
    *("values", "output_values", "output_slopes", "ended", "n_kept", "n_steps", "seconds"),
    "corrections",
)


# Patterns, and their machines with the text that was compiled for them.
_fitted: weakref.WeakKeyDictionary[Plan, tuple[Pattern, _Graphics]] = weakref.WeakKeyDictionary()


class Machine(Protocol):
    """Runs the text of :func:`cotree.codegen.cuda.cuda_text`, with a memory of its own."""

    def put(self, data: bytes) -> int:
        """Copy bytes to its memory; give their address."""

    def make_room(self, n_bytes: int) -> int:
        """Give the address of so many zeros."""

    def fetch(self, address: int, n_bytes: int) -> bytes:
        """Copy bytes from its memory."""

    def launch(self, name: str, n_threads: int, arguments: Sequence[Any]) -> None:
        """Run a function in many threads, and wait for them."""


def run_block_on_cuda(plan: Plan, rows: FloatArray) -> Block:
    """Run some members of an ensemble on a graphics processor.

    Parameters
    ----------
    plan : Plan
        What they share: an explicit method by its name, and no events, constraints, algebraic
        unknowns or inputs in place of the scene's.
    rows : ndarray, shape (n_members, n_columns)
        What each sets.

    Raises
    ------
    SolveError
        If the plan asks for more than that, or there is no CuPy or no such processor.
    """
    if plan not in _fitted:
        pattern = fitting_pattern(plan)
        _fitted[plan] = pattern, _Graphics(pattern_text(pattern))
    pattern, machine = _fitted[plan]
    try:
        return run_block_on(machine, pattern, rows)
    finally:
        machine.forget()


def fitting_pattern(plan: Plan) -> Pattern:
    """Find what members share, or refuse what threads of such a processor cannot run."""
    found = find_pattern(replace(plan, lanes=1))
    why = found.why if isinstance(found, Unfit) else _refusal(found)
    if why or isinstance(found, Unfit):
        raise SolveError(f"this ensemble cannot run on a graphics processor: {why}")
    return found


def pattern_text(pattern: Pattern) -> str:
    """Write the CUDA of a model and its engine."""
    model: Any = pattern.plan.model  # a model of the public kind, which keeps its text
    return cuda_text(model._compiled.text, pattern.engine.stepper)


def _refusal(pattern: Pattern) -> str:
    """Say why; empty where there is nothing against it."""
    problem, job = pattern.problem, pattern.job.job
    if pattern.row.stepper not in INTEGRATORS or pattern.row.implicit:
        return f"'{pattern.row.name}' is no explicit method of its own; take 'dop853' or 'dopri5'"
    if problem.events is not None:
        return "it has events"
    if pattern.plan.model.layout.corners:
        return "corners of its laws are located"
    if pattern.is_searched or problem.project is not None:
        return "its constraints or corners belong to each member"
    if job.n_replaced or pattern.signals.by_position:
        return "it has inputs in place of the scene's"
    if job.slopes:
        return "parameters move its corners"
    return ""


def run_block_on(machine: Machine, pattern: Pattern, rows: FloatArray) -> Block:
    """Run some members on a machine; parameters as of :func:`run_block_on_cuda`."""
    rows = np.ascontiguousarray(rows, dtype=np.float64).reshape(-1, len(pattern.plan.columns))
    members = BlockInC(pattern, rows)
    if len(rows):
        _run(machine, members)
    is_open = ~np.isin(members.ended, (DONE, STOPPED, ALONE))
    for member in np.flatnonzero(is_open).tolist():
        members.run_alone(member)
    return members.block([])


def _run(machine: Machine, members: BlockInC) -> None:
    """Copy a block to a machine, run it there, and copy what comes out."""
    sizes = _sizes(members)
    n_room = int(sizes.sum())
    n_threads = min(len(members.rows), _MOST_THREADS, max(1, _MOST_ROOM // (8 * n_room)))
    ffi = members.library.ffi
    batch = ffi.new("cotree_batch *", members.batch[0])
    # Whoever finds a member stiff leaves it to the processor that asked.
    batch.is_watched = 0
    places = _place(machine, members, ffi, batch)
    on_machine = machine.put(bytes(ffi.buffer(batch)))
    pattern = machine.put(_job_bytes(machine, members.pattern))
    machine.launch("cotree_cuda_begin", 1, (np.uintp(on_machine), np.uintp(pattern)))
    rooms = machine.make_room(8 * n_room * n_threads)
    arguments = (
        np.uintp(on_machine),
        np.uintp(machine.put(sizes.tobytes())),
        np.uintp(rooms),
        np.int64(n_room),
        np.int32(n_threads),
    )
    machine.launch("cotree_cuda_members", n_threads, arguments)
    for name in _WRITTEN:
        if name in places:
            address, buffer = places[name]
            buffer[:] = machine.fetch(address, len(buffer))


def _sizes(members: BlockInC) -> FloatArray:
    """Count the doubles of what each thread needs, in the order of ``ROOMS``."""
    problem, model = members.pattern.problem, members.pattern.plan.model
    assert problem.t_eval is not None  # a plan gives them
    n_t, n_u = len(problem.t_eval), len(model.inputs)
    n_y = len(model.outputs) if members.batch.n_outputs else 0
    counts = {
        "memory": -(-int(members.batch.memory) // 8),
        "k": int(members.batch.pattern.model.n_prepared),
        "u": n_u,
        "z": problem.size,
        "times": n_t,
        "inputs": n_t * n_u if n_y else 0,
        "outputs": n_t * n_y,
        "slopes": n_t * problem.n_sensitivities * n_y,
    }
    return np.array([max(1, counts[name]) for name in ROOMS], dtype=np.int64)


def _place(machine: Machine, members: BlockInC, ffi: Any, batch: Any) -> dict[str, tuple[int, Any]]:
    """Copy the arrays of a batch to a machine; give the address and the own memory of each."""
    places = {}
    for name in (*_READ, *_WRITTEN):
        pointer = getattr(batch, name)
        if not pointer:
            continue
        buffer = members.buffer(pointer)
        address = machine.put(bytes(buffer))
        setattr(batch, name, ffi.cast(ffi.typeof(pointer), address))
        places[name] = address, buffer
    return places


def _job_bytes(machine: Machine, pattern: Pattern) -> bytes:
    """Copy what the job of the pattern points to; give the job with these addresses."""
    ffi, job = pattern.engine.library.ffi, pattern.job.job
    copy = ffi.new("cotree_job *", job[0])
    for name, n in (("atols", job.n), ("corners", job.n_corners), ("wanted", job.n_wanted)):
        pointer = getattr(job, name)
        address = machine.put(bytes(ffi.buffer(pointer, 8 * n)))
        setattr(copy, name, ffi.cast("double *", address))
    return bytes(ffi.buffer(copy))


class _Graphics:
    """The first graphics processor, by CuPy, which compiles with NVRTC."""

    def __init__(self, text: str) -> None:
        try:
            import cupy
        except ImportError as error:
            raise SolveError(
                "a graphics processor is reached through CuPy: pip install cotree[cuda]"
            ) from error
        self._cupy = cupy
        self._kept: list[Any] = []
        try:
            n_devices = cupy.cuda.runtime.getDeviceCount()
        except cupy.cuda.runtime.CUDARuntimeError as error:
            raise SolveError(f"CuPy finds no graphics processor ({error})") from error
        if not n_devices:
            raise SolveError("CuPy finds no graphics processor")
        cupy.cuda.runtime.deviceSetLimit(_STACK_LIMIT, _STACK)
        self._module = cupy.RawModule(code=text, options=OPTIONS, backend="nvrtc")

    def put(self, data: bytes) -> int:
        return self._keep(self._cupy.asarray(np.frombuffer(data, dtype=np.uint8)))

    def make_room(self, n_bytes: int) -> int:
        return self._keep(self._cupy.zeros(n_bytes, dtype=np.uint8))

    def _keep(self, array: Any) -> int:
        self._kept.append(array)
        return int(array.data.ptr)

    def forget(self) -> None:
        """Free its memory."""
        self._kept.clear()

    def fetch(self, address: int, n_bytes: int) -> bytes:
        array = next(kept for kept in self._kept if kept.data.ptr == address)
        return bytes(self._cupy.asnumpy(array)[:n_bytes])

    def launch(self, name: str, n_threads: int, arguments: Sequence[Any]) -> None:
        kernel = self._module.get_function(name)
        kernel((-(-n_threads // _THREADS),), (min(n_threads, _THREADS),), tuple(arguments))
        self._cupy.cuda.runtime.deviceSynchronize()
