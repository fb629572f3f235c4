"""Jobs and numbers that runs of one model with the same settings leave to those that follow.

In: jobs that have ended, and what was found out about a problem. Out: jobs to begin again, and the
same findings. Neither changes a result: a job begins as if it were new, and findings are kept by
all numbers that they follow from.
"""

from __future__ import annotations

from collections import deque
from hashlib import blake2b
from typing import TYPE_CHECKING, TypeVar

from cotree.sharing import Kept

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from cotree.solvers.base import FloatArray
    from cotree.solvers.engine import Engine
    from cotree.solvers.job import Job
    from cotree.solvers.methods import Method
    from cotree.solvers.problem import Problem

T = TypeVar("T")

# Jobs of one kind that wait to begin again: as many as threads may run at the same time on a small
# machine. Those with more memory than this, [byte], take longer to run than to make.
_MOST_JOBS, _MOST_BYTES = 8, 2**18

# Sets of values whose findings are kept.
_MOST_FINDINGS = 64


class Shared:
    """Jobs and numbers that runs with the same settings share; threads may use it at the same time.

    Parameters
    ----------
    is_repeatable : bool
        Whether runs with equal numbers are equal. Functions of Python may remember their calls.
    """

    def __init__(self, *, is_repeatable: bool) -> None:
        self._is_repeatable = is_repeatable
        self._idle: dict[Hashable, deque[Job]] = {}
        self._findings: Kept[object] = Kept(_MOST_FINDINGS)

    def idle_job(self, kind: Hashable) -> Job | None:
        """Take a job of a kind that waits to begin again; None where there is none."""
        idle = self._idle.get(kind)
        try:
            return idle.pop() if idle else None
        except IndexError:  # another thread was quicker
            return None

    def give_back(self, job: Job) -> None:
        """Return a finished job to the pool."""
        if job.is_reusable and job.n_bytes <= _MOST_BYTES:
            self._idle.setdefault(job.kind, deque(maxlen=_MOST_JOBS)).append(job)

    def finding(self, make: Callable[[], T], *of: FloatArray) -> T:
        """Return what was found out from some numbers, or find it out."""
        if not self._is_repeatable:
            return make()
        # Bits and lengths, so that no two sets of numbers are the same.
        key = blake2b(b"".join(array.tobytes() for array in of), digest_size=16).digest()
        found: T = self._findings.of((key, *map(len, of)), make)  # type: ignore[assignment]
        return found


def job_kind(engine: Engine, row: Method, problem: Problem, *, is_extended: bool) -> Hashable:
    """Return what distinguishes jobs of one model and its settings, values and functions aside."""
    return engine, row.name, is_extended, problem.settings.t_eval is None
