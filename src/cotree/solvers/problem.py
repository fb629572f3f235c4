"""The initial value problem that every solver integrates, and its checks.

The vector z = [y, s_1, ..., s_np] contains the states y, then their sensitivities to each
parameter. All blocks of ``n_states`` entries have the same state Jacobian.

At a breakpoint whose time t* depends on the parameters, rates may jump from f- to f+. The states
are continuous there, but their sensitivities jump by ``(f- - f+) dt*/dp``, because a later
breakpoint prolongs the effect of f- and shortens that of f+.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.dag.restart_times import RestartTimes
from cotree.errors import SolveError
from cotree.methods import METHODS
from cotree.model.arrays import are_finite
from cotree.records import changed
from cotree.solvers.budgets import most_rows

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from scipy.sparse import csc_matrix

    from cotree.methods import Method
    from cotree.model.bound import BoundModel
    from cotree.scene.settings import Settings
    from cotree.solvers.job import Shared
    from cotree.solvers.result import FloatArray


#: Maximum size of augmented systems with dense matrices; larger ones are factorised by blocks.
DENSE_LIMIT = 100

#: Minimum relative tolerance, as in SciPy; below it the error test measures only rounding errors.
RTOL_FLOOR = 100 * float(np.finfo(np.float64).eps)

#: Absolute tolerance of sensitivities outside the error test. If it were infinite, norms of LSODA
#: and SUNDIALS would be 0 * inf; the square of this number is finite, too.
UNTESTED = 1e100


@dataclass(frozen=True, eq=False)
class RunProblem:
    """An initial value problem M z' = rhs(t, z) in states and sensitivities.

    M is the identity except in rows of algebraic unknowns, which are determined by rhs = 0. z has
    shape (n_states * (1 + n_sensitivities),). Reasons are clauses without capital and full stop.
    """

    #: The argument is a contiguous array; the function may return the same buffer at every call.
    rhs: Callable[[float, FloatArray], FloatArray]
    #: Dense state Jacobian at (t, y), shape (n_states, n_states).
    jacobian: Callable[[float, FloatArray], FloatArray] | None
    n_states: int
    n_sensitivities: int
    z0: FloatArray
    #: Solvers read span, requested times, tolerances and limits from the settings, and all else
    #: from the fields below. An rtol below ``RTOL_FLOOR`` is raised to it.
    settings: Settings
    #: Factors of the absolute tolerances of states, (n_states,). The factor of a storage content is
    #: its derivative with respect to the variable that it determines.
    sizes: FloatArray | None = None
    #: Sizes of the parameters, (n_sensitivities,). Absolute tolerances of sensitivities are divided
    #: by them: the effect of a parameter change by this size is tested like a state.
    scales: FloatArray | None = None
    #: Times of jumps and kinks of the right-hand side, [s], at which integration restarts. Rates
    #: beyond a breakpoint at an end of the span are never evaluated.
    breakpoints: Sequence[float] | FloatArray = ()
    #: Largest time, [s], from which breakpoints are computed; it determines their rounding error.
    scale: float = 0.0
    #: Derivatives of the breakpoints and of the start time with respect to the parameters.
    shifts: RestartTimes = field(default_factory=RestartTimes.none)
    names: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    max_step: float = float("inf")
    #: Steps of earlier integrations, and time to compute breakpoints, [s]; the limits include them.
    steps_taken: int = 0
    seconds_taken: float = 0.0
    #: The model if C projects the states onto its constraints, else None.
    held: BoundModel | None = None
    constraints: tuple[str, ...] = ()
    #: Edges whose constraints are nearly dependent at (t, z); None if no edge has constraints.
    singular: Callable[[float, FloatArray], tuple[str, ...]] | None = None
    #: Number of algebraic unknowns, which are the last states. Their initial values may be guesses.
    n_algebraic: int = 0
    #: The first ``n_states`` entries of rhs at (t, y); if it is None, rhs is used.
    state_rhs: Callable[[float, FloatArray], FloatArray] | None = None
    #: Reason why rates are undefined at (t, y), or an empty string.
    undefined: Callable[[float, FloatArray], str] | None = None
    #: State Jacobian, with the same pattern at all points; None if it has many entries.
    sparse_jacobian: Callable[[float, FloatArray], csc_matrix] | None = None
    #: The model in C with the parameters and inputs of the run; its time is the start.
    native: BoundModel | None = None
    #: By index, inputs replaced by tables (times, values), and inputs that are Python functions.
    replaced: Mapping[int, tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    functions: Mapping[int, Callable[[float], float]] = field(default_factory=dict)
    #: Remark on the start for the message of the run.
    note: str = ""
    not_native: str = "its equations are Python functions"
    #: The model if it has events. Only C methods locate these, and time must increase.
    events: BoundModel | None = None
    #: Whether the rates have kinks at which C methods restart if time increases.
    has_kinks: bool = False
    #: Ascending indices in z of the integrated entries; all other entries are identically zero.
    places: npt.NDArray[np.intp] | None = None
    #: Number of values at a stored point in addition to z, for the limit of memory.
    n_observed: int = 0
    #: Called with (t, z) at the start of each segment between breakpoints; it may change inputs.
    reach: Callable[[float, FloatArray], None] | None = None
    #: Jobs and results that runs of the same model with the same settings share.
    shared: Shared | None = None

    def with_settings(self, **values: Any) -> RunProblem:
        """Return the problem with changed settings; these are not checked."""
        return changed(self, settings=changed(self.settings, **values))

    @property
    def most_rows(self) -> int:
        """The maximum number of stored steps if no times are requested."""
        return most_rows(1 + self.size + self.n_observed)

    @property
    def state_atol(self) -> FloatArray:
        """The absolute tolerance of each state."""
        if self.sizes is None:
            return np.full(self.n_states, self.settings.atol)
        return np.asarray(self.settings.atol * self.sizes)

    @property
    def size(self) -> int:
        """The length of z."""
        return self.n_states * (1 + self.n_sensitivities)

    @property
    def integrated(self) -> npt.NDArray[np.intp]:
        """The indices in z of the entries that are integrated."""
        return np.arange(self.size) if self.places is None else self.places

    @property
    def is_sparse(self) -> bool:
        """Whether implicit methods use a sparse Jacobian; problems with sensitivities never do."""
        return self.sparse_jacobian is not None and self.n_sensitivities == 0

    @property
    def direction(self) -> float:
        """+1 if time increases, -1 if it decreases."""
        start, end = self.settings.t_span
        return 1.0 if end > start else -1.0


class Tolerances:
    """Tolerances of the entries of z, for problems that differ only in parameter values.

    Absolute tolerances of sensitivities are those of the states divided by the parameter sizes, as
    in CVODES (Hindmarsh et al. 2005). For example, a voltage has a sensitivity of 1e7 V/F to a
    capacitance of 1e-12 F, and its rounding error exceeds the tolerance of the voltage.

    Solvers cannot exclude entries from the error test, so untested sensitivities have a tolerance
    that no error reaches. Because solvers average squares over all entries, the tolerances of
    states are then divided by sqrt(number of entries / number of states). LSODA uses the maximum
    norm, so its test becomes stricter by this factor. Sizes may have one row per problem.
    """

    def __init__(self, problem: RunProblem, is_left: npt.NDArray[np.bool_] | None = None) -> None:
        places = problem.integrated if is_left is None else problem.integrated[is_left]
        self._atol = problem.settings.atol
        # Block 0 of z contains the states, block k their sensitivities to parameter k - 1.
        self._block, self._state = np.divmod(places, max(1, problem.n_states))
        self._is_tested = problem.settings.error_test_sensitivities
        self._share = 1.0 if self._is_tested else _share(problem)

    def rtol_of(self, problem: RunProblem) -> float:
        """Return the relative tolerance for a problem, at least ``RTOL_FLOOR``."""
        return max(problem.settings.rtol / self._share, RTOL_FLOOR)

    def of(self, problem: RunProblem) -> FloatArray:
        """Return the absolute tolerances for a problem in a new array of shape (..., n_entries)."""
        scales = problem.scales
        atol: Any = self._atol
        if problem.sizes is not None:
            atol = (atol * problem.sizes)[..., self._state]
        if not self._is_tested:
            return np.where(self._block > 0, UNTESTED, atol / self._share)
        if scales is None:
            scales = np.ones(problem.n_sensitivities)
        # Column 0 belongs to the states, whose tolerances are not changed.
        divisors = np.empty((*scales.shape[:-1], 1 + scales.shape[-1]))
        divisors[..., 0], divisors[..., 1:] = 1.0, scales
        found: FloatArray = atol / divisors.take(self._block, axis=-1)
        return np.minimum(found, UNTESTED, out=found)


def tested_rtol(problem: RunProblem) -> float:
    """Return the relative tolerance of the error test, at least ``RTOL_FLOOR``."""
    share = 1.0 if problem.settings.error_test_sensitivities else _share(problem)
    return max(problem.settings.rtol / share, RTOL_FLOOR)


def _share(problem: RunProblem) -> float:
    """Return the square root of (number of integrated entries / number of states)."""
    n = problem.size if problem.places is None else len(problem.places)
    return math.sqrt(max(1, n) / max(1, problem.n_states))


def tested(
    row: Method, problem: RunProblem, *, is_extended: bool
) -> tuple[npt.NDArray[np.intp], FloatArray]:
    """Return the indices in z of entries integrated in C, (n,), and their tolerances, (..., n)."""
    is_left = is_integrated(row, problem, is_extended=is_extended)
    known = as_tested(row, problem)
    return problem.integrated[is_left], Tolerances(known, is_left).of(known)


def is_integrated(row: Method, problem: RunProblem, *, is_extended: bool) -> npt.NDArray[np.bool_]:
    """Return a mask of the entries ``problem.integrated`` that are integrated in C."""
    places = problem.integrated
    cut = problem.n_states - (0 if row.keeps_algebraic else problem.n_algebraic)
    # Sensitivities of algebraic unknowns are always solved for.
    lead = problem.n_states if is_extended else cut
    # The first `lead` states and, in each block, the first `cut` sensitivities are integrated.
    found: npt.NDArray[np.bool_] = places % problem.n_states < np.where(
        places < problem.n_states, lead, cut
    )
    return found


def as_tested(row: Method, problem: RunProblem) -> RunProblem:
    """Return the problem with finite tolerances of sensitivities if SUNDIALS can exclude them."""
    return problem.with_settings(error_test_sensitivities=True) if row.corrector else problem


def describe_entry(problem: RunProblem, index: int) -> str:
    """Return a name for an entry of z, from its state and, for a sensitivity, its parameter."""
    # Block 0 of z contains the states, block k the sensitivities to parameter k - 1.
    block, state = divmod(index, problem.n_states)
    name = f"'{problem.names[state]}'" if problem.names else f"state {state}"
    if block == 0:
        return name
    by = f"'{problem.parameters[block - 1]}'" if problem.parameters else f"parameter {block - 1}"
    return f"the sensitivity of {name} to {by}"


def check_problem(problem: RunProblem) -> None:
    """Raise SolveError if a size, a breakpoint or an initial value cannot be accepted."""
    _check_sizes(problem)
    check_values(problem)


def check_values(problem: RunProblem) -> None:
    """Raise SolveError if a value that may depend on parameters cannot be accepted."""
    if problem.events is not None and problem.direction < 0:
        raise SolveError("A scene with events runs forwards only, since events are not reversible.")
    times = problem.breakpoints
    if len(times) and not np.isfinite(np.asarray(times, dtype=float)).all():
        raise SolveError("A breakpoint is not finite; give times in seconds.")
    if not problem.max_step > 0:  # from the settings or the model; nan is rejected, too
        raise SolveError(f"max_step is {problem.max_step}; give positive seconds, or inf for none.")
    if are_finite(problem.z0):
        return
    index = int(np.flatnonzero(~np.isfinite(problem.z0))[0])
    raise SolveError(
        f"The initial value of {describe_entry(problem, index)} is {problem.z0[index]}; "
        "give a finite number."
    )


def _check_sizes(problem: RunProblem) -> None:
    if problem.n_states < 0 or problem.n_sensitivities < 0:
        raise SolveError("The numbers of states and sensitivities must not be negative.")
    if np.shape(problem.z0) != (problem.size,):
        raise SolveError(
            f"z0 has shape {np.shape(problem.z0)}, but {problem.n_states} states with "
            f"{problem.n_sensitivities} sensitivities each need shape ({problem.size},)."
        )
    if problem.names and len(problem.names) != problem.n_states:
        raise SolveError(f"{len(problem.names)} names are given for {problem.n_states} states.")
    if not 0 <= problem.n_algebraic <= problem.n_states:
        raise SolveError(
            f"{problem.n_algebraic} of {problem.n_states} states cannot be algebraic unknowns."
        )
    # Newton's method for the unknowns uses the last rows and columns of the Jacobian.
    if problem.n_algebraic and problem.jacobian is None:
        raise SolveError("A problem with algebraic unknowns needs a Jacobian.")


def restart_times(problem: RunProblem) -> FloatArray:
    """Return start, breakpoints inside the span, and end, in the order of the run."""
    start, end = map(float, problem.settings.t_span)
    if not len(problem.breakpoints):
        return np.array([start, end])
    low, high = min(start, end), max(start, end)
    inside = np.asarray(problem.breakpoints, dtype=float)
    if not (inside[1:] > inside[:-1]).all():
        inside = np.unique(inside)
    # A breakpoint at an end does not divide the span.
    inside = inside[(low < inside) & (inside < high)]
    return np.concatenate([[start], inside[:: int(problem.direction)], [end]])


def segments(problem: RunProblem) -> list[tuple[float, float]]:
    """Return the start and end of each segment between breakpoints."""
    return list(itertools.pairwise(restart_times(problem).tolist()))


def turn_tolerances(problem: RunProblem) -> FloatArray:
    """Return the absolute tolerance of the sensitivities to each parameter, shape (..., m)."""
    # As in the error test, the least tolerance of states is divided by the parameter size.
    least = np.min(problem.state_atol, axis=-1, keepdims=True, initial=np.inf)
    scales = np.ones(problem.n_sensitivities) if problem.scales is None else problem.scales
    found: FloatArray = least / scales
    return found


def turning(problem: RunProblem, t: float, entry: int) -> str:
    """Return a message that the sensitivity z[entry] does not exist after time t."""
    what = describe_entry(problem, entry)
    if t == problem.settings.t_span[0]:
        return (
            f"{what} does not exist: a source has a kink at the start, t = {t:.10g}, whose time "
            "depends on the parameter; start the run before it, or compile without this sensitivity"
        )
    return (
        f"{what} does not exist from t = {t:.10g} on: kinks of sources coincide there whose times "
        "depend on the parameter in different ways; choose values that separate them, or compile "
        "without this sensitivity"
    )


# Maximum number of states for the elimination of algebraic unknowns, which fills the Jacobian.
_MOST_REDUCED = 2000


def refusal(method: str, problem: RunProblem) -> str:
    """Return the reason why a C method cannot solve a checked problem, or an empty string."""
    row = METHODS[method]
    if problem.native is None:
        return problem.not_native
    if row.family == "correctors" and problem.events is not None:
        return "there are events"
    # The conditions below apply to SUNDIALS, which also requires at least one rate.
    if row.family == "cotree":
        return _dependent(problem) if row.implicit else ""
    if problem.n_states == problem.n_algebraic:
        return "there are no states"
    is_reduced = problem.n_algebraic > 0 and not row.keeps_algebraic
    if is_reduced and problem.n_states > _MOST_REDUCED:
        return f"there are algebraic unknowns and more than {_MOST_REDUCED} states"
    return ""


def beyond_scipy(problem: RunProblem) -> str:
    """Return the part of a problem that SciPy's methods do not support, or an empty string."""
    if problem.events is not None:
        return f"events, such as '{problem.events.event_rows[0].name}'"
    if problem.n_algebraic:
        unknowns = problem.names[problem.n_states - problem.n_algebraic :]
        return "algebraic unknowns" + (f", such as '{unknowns[0]}'" if unknowns else "")
    if problem.held is not None:
        return f"constraints, such as '{problem.constraints[0]}'"
    if problem.has_kinks:
        return "laws with kinks, which have to be located"
    if not problem.n_states:
        return "a problem without states"
    if problem.n_sensitivities and problem.shifts.rows_at(restart_times(problem)[:-1])[0].any():
        return "sensitivities to parameters on which times of kinks depend"
    return ""


def _dependent(problem: RunProblem) -> str:
    """Return a message on constraints that are dependent at the start, or an empty string.

    Stages of Rosenbrock methods violate such constraints, which then contradict each other.
    """
    start = problem.settings.t_span[0]
    edges = () if problem.singular is None else problem.singular(start, problem.z0)
    names = ", ".join(f"'{edge}'" for edge in edges)
    return f"constraints of {names} are dependent at the start" if edges else ""
