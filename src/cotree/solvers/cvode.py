"""SUNDIALS' CVODE driven from C: no Python runs between the steps.

In: a ``Problem`` with its native form. Out: a ``Trajectory``. CVODE is the one that scikit-sundae
comes with; its functions are found in the library that is loaded there, and handed to C. The Newton
matrix of the states is factorised once for them and for all their sensitivities.
"""

from __future__ import annotations

import functools
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.codegen.integrators import cvode_declarations, cvode_files
from cotree.codegen.sundials import SUNDIALS_FUNCTIONS, SUNDIALS_VERSION
from cotree.model.kernels import SINGULAR
from cotree.solvers.drive import segments
from cotree.solvers.engine import Job, build_engine
from cotree.solvers.native import compiled_in, run_job, trajectory_of
from cotree.solvers.problem import describe_entry

if TYPE_CHECKING:
    from cotree.build import LoadedLibrary
    from cotree.solvers.base import Trajectory
    from cotree.solvers.problem import Problem

# Matrices up to this size are dense, whatever their pattern: an order for them costs more.
_SMALL = 40

# Multiplications of a factorisation beyond which a sparse one with an order of its own is better.
_MOST_MULTIPLICATIONS = 3e7

# What CVODE's flags say, and those of our own.
_REASONS = {
    9: "the solution is no longer finite",
    8: "SUNDIALS got no memory",
    3: "the step size fell to rounding level",
    -2: "the tolerances are too tight for double precision",
    -3: "the error test fails again and again, or the step size fell to its least",
    -4: "Newton's method fails again and again, or the step size fell to its least",
    -6: "the Newton matrix cannot be formed",
    -7: "the Newton matrix cannot be solved with",
    -8: "the right-hand side stopped the integration",
    -9: "it cannot start",
    -10: "the right-hand side fails again and again",
    -11: "the right-hand side fails, and the step cannot be shortened",
}


@dataclass(frozen=True, eq=False)
class Cvode:
    """The engine, and the functions of SUNDIALS that it calls.

    Attributes
    ----------
    engine : LoadedLibrary
        Runs jobs.
    functions : object
        A ``cotree_sundials``.
    library : object
        Keeps SUNDIALS loaded.
    """

    engine: LoadedLibrary
    functions: Any
    library: Any


def solve_with_cvode(problem: Problem) -> Trajectory | str:
    """Integrate a checked problem, or say why C cannot.

    Parameters
    ----------
    problem : Problem
        It has passed ``check_problem``.

    Returns
    -------
    Trajectory or str
        A reason is a sentence without a capital and an end.
    """
    if problem.native is None:
        return problem.not_native
    if problem.events is not None:
        return "there are events"
    if problem.project is not None:
        return "the motion is held to constraints"
    if problem.complete is not None:
        return "there are algebraic unknowns"
    if problem.size == 0:
        return "there are no states"
    before = time.perf_counter()
    cvode = load_cvode()
    if isinstance(cvode, str):
        return cvode
    begin = time.perf_counter()
    corners = segments(problem)
    job = CvodeJob(cvode, problem, [corners[0][0], *(end for _, end in corners)])
    if problem.is_sparse and job.is_wide:
        return "the Jacobian's band is wide"
    try:
        ended = run_job(job, problem, "cvode")
    finally:
        job.end()
    trajectory = trajectory_of(job, problem, "cvode", ended)
    return compiled_in(trajectory, begin - before)


def load_cvode() -> Cvode | str:
    """Find SUNDIALS' functions and build the engine, once; or say why that is not possible."""
    try:
        from sksundae import _cy_cvode
    except ImportError:
        return "scikit-sundae has no module '_cy_cvode'"
    return _load(str(_cy_cvode.__file__))


@functools.cache
def _load(path: str) -> Cvode | str:
    files = cvode_files()
    engine = build_engine(files, cvode_declarations(files))
    if engine is None:
        return "no compiler can build its engine"
    ffi = engine.ffi
    try:
        library = ffi.dlopen(path)
        major, minor, patch = (ffi.new("int *") for _ in range(3))
        failed = library.SUNDIALSGetVersionNumber(major, minor, patch, ffi.new("char[32]"), 32)
        if failed or (major[0], minor[0]) != SUNDIALS_VERSION:
            known = ".".join(map(str, SUNDIALS_VERSION))
            return f"SUNDIALS is of version {major[0]}.{minor[0]}, not {known}"
        functions = ffi.new("cotree_sundials *")
        for name in SUNDIALS_FUNCTIONS:
            setattr(functions, name, ffi.addressof(library, name))
    except (OSError, AttributeError) as error:
        return f"SUNDIALS' functions cannot be found ({error})"
    return Cvode(engine, functions, library)


class CvodeJob(Job):
    """A job that CVODE runs; end it, whatever happens."""

    def __init__(self, cvode: Cvode, problem: Problem, corners: list[float]) -> None:
        self._cvode = cvode
        super().__init__(cvode.engine, problem, corners)

    @property
    def is_wide(self) -> bool:
        """Tell whether a sparse factorisation would be much cheaper."""
        c, n = self._memory, self.job.model.n_states
        return bool(n * c.lower * (c.lower + c.upper) > _MOST_MULTIPLICATIONS)

    @property
    def n_jacobians(self) -> int:
        """Return how many Jacobians were evaluated."""
        return int(self._memory.n_jacobians)

    @property
    def n_factorisations(self) -> int:
        """Return how many matrices were factorised."""
        return int(self._memory.n_factorisations)

    def reason(self, problem: Problem) -> str:
        """Say why it failed."""
        status, c = int(self.job.status), self._memory
        reason = _REASONS.get(status, f"flag {status}")
        reasons = [f"SUNDIALS says: {reason}" if status < 0 else reason]
        if c.complaint == SINGULAR:
            reasons.append("a linear system of the model is singular ahead")
        if c.row >= 0:
            of, by = describe_entry(problem, c.row), describe_entry(problem, c.column)
            reasons.append(f"the derivative of {of} differentiated by {by} is not finite ahead")
        if self.job.entry >= 0:
            entry = describe_entry(problem, int(self.job.entry))
            reasons.append(f"the derivative of {entry} is not finite ahead")
        return "; ".join(reasons)

    def end(self) -> None:
        """Free what SUNDIALS holds."""
        self._lib.cotree_job_end(self.job)

    def _make_memory(self, problem: Problem) -> Any:
        ffi, job, n = self._ffi, self.job, problem.n_states
        c = self._memory = ffi.new("cotree_cvode *")
        c.sundials = self._cvode.functions
        c.row = c.column = -1
        # Nothing else would make the iteration go on for them.
        c.are_followed = problem.n_sensitivities > 0 and not problem.error_test_sensitivities
        c.lower, c.upper, order = _order(ffi, job.model)
        places = ffi.NULL if order is None else ffi.new("int[]", order.tolist())
        pivots = ffi.new("int[]", n)
        self._kept += [c, places, pivots]
        c.places, c.pivots = places, pivots
        size = self._lib.cotree_cvode_doubles(job.model, job.has_sensitivities, c.lower, c.upper)
        c.doubles = self._doubles(np.zeros(size))
        return c


def _order(ffi: Any, model: Any) -> tuple[int, int, Any]:
    """Give the bandwidths of the Jacobian, and the places of states that make them narrow.

    Places are None where the matrix is small or not sparse.
    """
    n, size = model.n_states, model.n_nonzeros
    if n > _SMALL:
        from scipy.sparse import csc_matrix
        from scipy.sparse.csgraph import reverse_cuthill_mckee

        starts = np.array(ffi.unpack(model.column_starts, n + 1))
        rows = np.array(ffi.unpack(model.row_indices, size), dtype=np.int64)
        pattern = csc_matrix((np.ones(size), rows, starts), shape=(n, n)).tocsr()
        places = np.empty(n, dtype=np.intc)
        places[reverse_cuthill_mckee(pattern, symmetric_mode=False)] = np.arange(n)
        below = places[rows] - np.repeat(places, np.diff(starts))
        lower, upper = int(max(below.max(initial=0), 0)), int(max((-below).max(initial=0), 0))
        if 2 * lower + upper + 1 < n:
            return lower, upper, places
    return n - 1, n - 1, None
