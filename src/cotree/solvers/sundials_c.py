"""SUNDIALS' CVODE and IDA driven from C: no Python runs between the steps.

In: a ``Problem`` with its native form. Out: a ``Trajectory``. The integrators are those that
scikit-sundae comes with; their functions are found in the library that is loaded there, and handed
to C. Their nonlinear systems are solved by C of our own: the Newton matrix of the states is
factorised once for them and for all their sensitivities.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.codegen.integrators import engine_declarations, engine_files
from cotree.codegen.sundials import SUNDIALS_FUNCTIONS, SUNDIALS_VERSION
from cotree.sharing import made_once
from cotree.solvers.corners import segments
from cotree.solvers.engine import Job, build_engine
from cotree.solvers.native import compiled_in, run_job, trajectory_of
from cotree.solvers.sundials_library import library_path, version_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.build import LoadedLibrary
    from cotree.model.newton import Newton
    from cotree.solvers.base import Trajectory
    from cotree.solvers.problem import Problem

# Matrices up to this size are dense, whatever their pattern: an order for them costs more.
_SMALL = 40

# What is left after an elimination of algebraic unknowns is dense: more states are none of C's.
_MOST_REDUCED = 2000

# Multiplications of a factorisation beyond which a sparse one with an order of its own is better.
_MOST_MULTIPLICATIONS = 3e7


@dataclass(frozen=True, eq=False)
class Sundials:
    """The engine of a method, and the functions of SUNDIALS that it calls.

    Attributes
    ----------
    name : str
        A name in ``SUNDIALS_FUNCTIONS``.
    engine : LoadedLibrary
        Runs jobs.
    functions : object
        A ``cotree_sundials``.
    library : object
        Keeps SUNDIALS loaded.
    """

    name: str
    engine: LoadedLibrary
    functions: Any
    library: Any


def solve_in_c(
    problem: Problem,
    method: str,
    library: str = "",
    make_job: Callable[..., SundialsJob] | None = None,
) -> Trajectory | str:
    """Integrate a checked problem, or say why C cannot.

    Parameters
    ----------
    problem : Problem
        It has passed ``check_problem``.
    method : str
        What the user calls it.
    library : str
        A name in ``SUNDIALS_FUNCTIONS``; the method where empty.
    make_job : callable or None
        Makes another job than a ``SundialsJob``, of a method that nothing in Python stands in for.

    Returns
    -------
    Trajectory or str
        A reason is a sentence without a capital and an end.
    """
    if problem.native is None:
        return problem.not_native
    if problem.events is not None and make_job is not None:
        return "there are events"
    if problem.n_states == problem.n_algebraic:
        return "there are no states"
    is_reduced = (library or method).startswith("cvode") and problem.n_algebraic > 0
    if is_reduced and problem.n_states > _MOST_REDUCED:
        return f"more than {_MOST_REDUCED} states have algebraic unknowns beside them"
    before = time.perf_counter()
    sundials = load_sundials(library or method)
    if isinstance(sundials, str):
        return sundials
    begin = time.perf_counter()
    corners = segments(problem)
    times = [corners[0][0], *(end for _, end in corners)]
    job = (make_job or SundialsJob)(sundials, problem, times, method)
    if problem.is_sparse and job.is_wide and problem.events is None:
        return "the Jacobian's band is wide"
    try:
        ended = run_job(job, problem, method)
    finally:
        job.end()
    trajectory = trajectory_of(job, problem, method, ended)
    return compiled_in(trajectory, begin - before)


def load_sundials(library: str) -> Sundials | str:
    """Find SUNDIALS' functions and build the engine, once; or say why that is not possible.

    Parameters
    ----------
    library : str
        A name in ``SUNDIALS_FUNCTIONS``.
    """
    found = library_path(library)
    return found.why_not or _load(library, found.path)


@made_once
def _load(name: str, path: str) -> Sundials | str:
    files = engine_files(name)
    engine = build_engine(files, engine_declarations(files, name))
    if engine is None:
        return "no compiler can build its engine"
    ffi = engine.ffi
    try:
        # Lazily: of a module of Python nothing is called that needs Python.
        library = ffi.dlopen(path, ffi.RTLD_LAZY)
        version = version_of(ffi, library, path)
        if version != SUNDIALS_VERSION:
            here, known = (".".join(map(str, v)) or "unknown" for v in (version, SUNDIALS_VERSION))
            return f"SUNDIALS is of version {here}, not {known}"
        functions = ffi.new("cotree_sundials *")
        for function in SUNDIALS_FUNCTIONS[name]:
            setattr(functions, function, ffi.addressof(library, function))
    except (OSError, AttributeError) as error:
        return f"SUNDIALS' functions cannot be found ({error})"
    return Sundials(name, engine, functions, library)


class SundialsJob(Job):
    """A job that SUNDIALS runs; end it, whatever happens.

    Attributes
    ----------
    name : str
        Of the method.
    """

    def __init__(
        self, sundials: Sundials, problem: Problem, corners: list[float], name: str
    ) -> None:
        self._sundials, self.name = sundials, name
        # IDA's equations need not be solved for the rates.
        self.keeps_algebraic = sundials.name.startswith("ida")
        super().__init__(sundials.engine, sundials.name, problem, corners)

    @property
    def is_wide(self) -> bool:
        """Tell whether a sparse factorisation would be much cheaper."""
        c, n = self._aid, self.job.model.n_states
        return bool(n * c.lower * (c.lower + c.upper) > _MOST_MULTIPLICATIONS)

    def _make_aid(self, problem: Problem, newton: Newton | None) -> Any:
        c = self._aid = self._ffi.new("cotree_sundials_aid *")
        c.sundials = self._sundials.functions
        # Nothing else would make the iteration go on for them.
        c.are_followed = problem.n_sensitivities > 0 and not problem.error_test_sensitivities
        if problem.n_algebraic and not self.keeps_algebraic:
            # What is left after an elimination has no pattern.
            c.lower = c.upper = problem.n_states - problem.n_algebraic - 1
        else:
            c.lower, c.upper, order = _order(self._ffi, self.job.model)
            if order is not None:
                self._kept.append(self._ffi.new("int[]", order.tolist()))
                c.places = self._kept[-1]
        self._kept.append(c)
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
