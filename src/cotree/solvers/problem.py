"""The initial value problem of every solver, and the checks made before work.

In: callables and numbers. Out: a frozen ``Problem``, or a ``SolveError`` that names the culprit.
The vector of unknowns is z = [y, s_1, ..., s_np]: the states, then the sensitivities of all states
parameter by parameter, so each block of ``n_states`` entries obeys the same state Jacobian.

At a breakpoint whose time t* depends on the parameters, rates may jump from f- to f+. Sensitivities
of the states, which are continuous, then jump by ``(f- - f+) dt*/dp``: a later breakpoint prolongs
the action of f- at the expense of f+.

C locates and applies events, see ``templates/runtime/events/cotree_events.h``, and projects on the
constraints during a run. ``HeldConstraints`` choose methods and judge results.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.dag.corners import RestartTimes
from cotree.errors import ModelError, SolveError
from cotree.methods import METHODS
from cotree.model.model import CompiledModel, EvaluationPoint
from cotree.records import changed
from cotree.solvers.budgets import most_rows
from cotree.tolerances import RANK

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from scipy.sparse import csc_matrix

    from cotree.equations import EventRow
    from cotree.methods import Method
    from cotree.model.kernels import NativeModel
    from cotree.scene.settings import Settings
    from cotree.solvers.job import Shared
    from cotree.solvers.result import FloatArray


#: Maximum size of augmented systems for dense factorisation; larger ones are factorised by blocks.
DENSE_LIMIT = 100

#: Minimum relative tolerance, as in SciPy; below it the error test measures only rounding.
RTOL_FLOOR = 100 * float(np.finfo(np.float64).eps)

#: Absolute tolerance of sensitivities outside the error test. Infinite weights would turn norms of
#: LSODA and SUNDIALS into 0 * inf; the square of this number is finite.
UNTESTED = 1e100


def _own_inputs(t: float) -> None:
    """Return None: the inputs of the model."""
    return


@dataclass(frozen=True, eq=False)
class Problem:
    """An initial value problem M z' = rhs(t, z) over states and sensitivities.

    M is the identity, but for algebraic unknowns: these are determined by rhs = 0.

    Attributes
    ----------
    rhs : callable
        ``rhs(t, z)``, both shapes (n_states * (1 + n_sensitivities),), [state unit / s]. It always
        receives a contiguous array and may return the same buffer at every call.
    jacobian : callable or None
        ``jacobian(t, y)`` of the states only, dense, shape (n_states, n_states), [1/s and mixed].
    n_states : int
        Number of states.
    n_sensitivities : int
        Number of parameters whose sensitivities are integrated.
    z0 : ndarray, shape (n_states * (1 + n_sensitivities),)
        Initial states and sensitivities.
    settings : Settings
        Span, times, tolerances and budgets. An rtol below ``RTOL_FLOOR`` is raised to it, and the
        message states that. Its other values are contained in the fields below.
    sizes : ndarray, shape (n_states,), or None
        Factors of the absolute tolerances of states. For the content of a storage, the factor is
        the change of the content per unit of the variable that follows from it. None for one.
    scales : ndarray, shape (n_sensitivities,), or None
        Sizes of the parameters, by which absolute tolerances of sensitivities are divided: the
        effect of a change of a parameter by its own size is then tested as the states are. None
        for one.
    breakpoints : sequence of float
        Times where the right-hand side jumps or has a kink, [s]; integration restarts there, so
        no pulse between two of them is stepped over. Those outside the span are ignored; nothing
        beyond an end of the span that is one is evaluated.
    scale : float
        The largest time in the computation of breakpoints, whose rounding error they have, [s].
    shifts : RestartTimes
        Derivatives of breakpoints, and of the start, by the parameters of sensitivity.
    names, parameters : tuple of str
        Names of the states and of the parameters of sensitivity, for messages; empty for none.
    max_step : float
        The longest step, [s]; a breakpoint or an output may cut it shorter.
    steps_taken : int
        Steps of the budget that other runs have taken before this one.
    held : HeldConstraints or None
        The constraints onto which C projects; None if there are none.
    constraints : tuple of str
        Names of the constraints' residuals.
    n_algebraic : int
        Number of algebraic unknowns, which are the last of the states. Their initial values need
        only be guesses.
    state_rhs : callable or None
        ``state_rhs(t, y)``, the first ``n_states`` entries of rhs, by which algebraic unknowns are
        found; None takes them from rhs.
    undefined : callable or None
        ``undefined(t, y)`` returns why the states' rates have no value at a point, without a
        capital and a full stop; empty if they have one.
    sparse_jacobian : callable or None
        ``sparse_jacobian(t, y)``, the same Jacobian in SciPy's CSC form, with the same pattern at
        all points; given if it has few entries, and used by methods that can.
    native : NativeModel or None
        The model in C with its parameters prepared, if C can integrate the problem.
    u : callable
        ``u(t)`` returns the inputs, (n_inputs,), or None for the model's own.
    replaced : mapping of int to (ndarray, ndarray)
        Inputs that are replaced by piecewise linear functions.
    functions : mapping of int to callable
        Inputs that are functions of time in Python, ``f(t)`` with t in [s].
    note : str
        A sentence on the start, for the message of the run.
    not_native : str
        The reason why C cannot integrate it, without a capital and a full stop.
    singular : callable or None
        ``singular(t, z)`` names the edges whose constraints are nearly dependent at a point; None
        where no edges are constrained.
    events : ModelEvents or None
        The events of the problem, for methods in C; time must increase.
    has_kinks : bool
        Whether the rates have kinks that methods in C locate while time increases; they restart
        after each.
    n_observed : int
        Number of values per stored point in addition to z, for the limit of memory.
    reach : callable or None
        ``reach(t, z)`` is called at the start of each segment between breakpoints, before any
        evaluation in it: inputs may change there.
    places : ndarray of int or None
        The positions in z of the entries that do not vanish at all times, states first, in order:
        methods integrate only these. None if no entry is known to vanish.
    shared : Shared or None
        Jobs and results of other runs of the same model with the same settings.
    """

    rhs: Callable[[float, FloatArray], FloatArray]
    jacobian: Callable[[float, FloatArray], FloatArray] | None
    n_states: int
    n_sensitivities: int
    z0: FloatArray
    settings: Settings
    sizes: FloatArray | None = None
    scales: FloatArray | None = None
    breakpoints: Sequence[float] | FloatArray = ()
    scale: float = 0.0
    shifts: RestartTimes = field(default_factory=RestartTimes.none)
    names: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    max_step: float = float("inf")
    steps_taken: int = 0
    held: HeldConstraints | None = None
    constraints: tuple[str, ...] = ()
    singular: Callable[[float, FloatArray], tuple[str, ...]] | None = None
    n_algebraic: int = 0
    state_rhs: Callable[[float, FloatArray], FloatArray] | None = None
    undefined: Callable[[float, FloatArray], str] | None = None
    sparse_jacobian: Callable[[float, FloatArray], csc_matrix] | None = None
    native: NativeModel | None = None
    u: Callable[[float], FloatArray | None] = _own_inputs
    replaced: Mapping[int, tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    functions: Mapping[int, Callable[[float], float]] = field(default_factory=dict)
    note: str = ""
    not_native: str = "its equations are Python functions"
    events: ModelEvents | None = None
    has_kinks: bool = False
    places: npt.NDArray[np.intp] | None = None
    n_observed: int = 0
    reach: Callable[[float, FloatArray], None] | None = None
    shared: Shared | None = None

    def with_settings(self, **values: Any) -> Problem:
        """Return the problem with some other settings, which are not checked."""
        return changed(self, settings=changed(self.settings, **values))

    @property
    def most_rows(self) -> int:
        """Return the largest number of stored steps if no times are requested."""
        return most_rows(1 + self.size + self.n_observed)

    @property
    def state_atol(self) -> FloatArray:
        """Return the absolute tolerance of each state."""
        if self.sizes is None:
            return np.full(self.n_states, self.settings.atol)
        return np.asarray(self.settings.atol * self.sizes)

    @property
    def size(self) -> int:
        """Return the length of z."""
        return self.n_states * (1 + self.n_sensitivities)

    @property
    def integrated(self) -> npt.NDArray[np.intp]:
        """Return the positions in z of the entries that are integrated."""
        return np.arange(self.size) if self.places is None else self.places

    @property
    def is_sparse(self) -> bool:
        """Return whether methods iterate with a sparse Jacobian.

        With sensitivities, the first columns of the Jacobian of z are dense finite differences.
        """
        return self.sparse_jacobian is not None and self.n_sensitivities == 0

    @property
    def direction(self) -> float:
        """Return +1 if time increases, -1 if it decreases."""
        start, end = self.settings.t_span
        return 1.0 if end > start else -1.0


class Tolerances:
    """Absolute tolerances of entries of z, for problems that differ only in values of parameters.

    Absolute tolerances of sensitivities are those of the states divided by the sizes of the
    parameters, as in CVODES (Hindmarsh et al. 2005): the rounding error of a sensitivity of 1e7 V/F
    to a capacitance of 1e-12 F exceeds the tolerance of a voltage.

    Solvers cannot exclude entries from the error test, so untested sensitivities have an absolute
    tolerance that no error reaches. Solvers average squares over all entries, so the states'
    tolerances are divided by the square root of the ratio of both numbers: states are then tested
    as without sensitivities. LSODA uses the maximum and becomes stricter by that factor.

    Sizes of states and of parameters may have a row for each of several problems. ``is_left``
    selects entries; by default all that are integrated.
    """

    def __init__(self, problem: Problem, is_left: npt.NDArray[np.bool_] | None = None) -> None:
        places = problem.integrated if is_left is None else problem.integrated[is_left]
        self._atol = problem.settings.atol
        # Block 0 of z contains the states, block k their sensitivities to parameter k - 1.
        self._block, self._state = np.divmod(places, max(1, problem.n_states))
        self._is_tested = problem.settings.error_test_sensitivities
        self._share = 1.0 if self._is_tested else _share(problem)

    def rtol_of(self, problem: Problem) -> float:
        """Return the relative tolerance of one of the problems, at least ``RTOL_FLOOR``."""
        return max(problem.settings.rtol / self._share, RTOL_FLOOR)

    def of(self, problem: Problem) -> FloatArray:
        """Return the tolerances of one of the problems, a fresh array of shape (..., n_entries)."""
        scales = problem.scales
        atol: Any = self._atol
        if problem.sizes is not None:
            atol = (atol * problem.sizes)[..., self._state]
        if not self._is_tested:
            return np.where(self._block > 0, UNTESTED, atol / self._share)
        if scales is None:
            scales = np.ones(problem.n_sensitivities)
        # The divisor of states is one.
        divisors = np.empty((*scales.shape[:-1], 1 + scales.shape[-1]))
        divisors[..., 0], divisors[..., 1:] = 1.0, scales
        found: FloatArray = atol / divisors.take(self._block, axis=-1)
        return np.minimum(found, UNTESTED, out=found)


def tested_rtol(problem: Problem) -> float:
    """Return the relative tolerance of the error test, at least ``RTOL_FLOOR``."""
    share = 1.0 if problem.settings.error_test_sensitivities else _share(problem)
    return max(problem.settings.rtol / share, RTOL_FLOOR)


def _share(problem: Problem) -> float:
    """Return the square root of the number of entries divided by that of states."""
    return float(np.sqrt(max(1, len(problem.integrated)) / max(1, problem.n_states)))


def tested(
    row: Method, problem: Problem, *, is_extended: bool
) -> tuple[npt.NDArray[np.intp], FloatArray]:
    """Return the places in z of integrated entries, (n,), and their tolerances, (..., n).

    ``is_extended``: an explicit method integrates the algebraic unknowns, too.
    """
    is_left = is_integrated(row, problem, is_extended=is_extended)
    known = as_tested(row, problem)
    return problem.integrated[is_left], Tolerances(known, is_left).of(known)


def is_integrated(row: Method, problem: Problem, *, is_extended: bool) -> npt.NDArray[np.bool_]:
    """Return which of the entries that do not vanish are integrated in C."""
    places = problem.integrated
    cut = problem.n_states - (0 if row.keeps_algebraic else problem.n_algebraic)
    # Sensitivities of algebraic unknowns are always solved for.
    lead = problem.n_states if is_extended else cut
    # States up to `lead`, and sensitivities up to `cut` in each block.
    found: npt.NDArray[np.bool_] = places % problem.n_states < np.where(
        places < problem.n_states, lead, cut
    )
    return found


def as_tested(row: Method, problem: Problem) -> Problem:
    """Return the problem with sensitivities in the error test if SUNDIALS excludes them itself."""
    return problem.with_settings(error_test_sensitivities=True) if row.corrector else problem


def describe_entry(problem: Problem, index: int) -> str:
    """Name an entry of z by its state, and by its parameter if it is a sensitivity."""
    # Block 0 of z contains the states, block k the sensitivities to parameter k - 1.
    block, state = divmod(index, problem.n_states)
    name = f"'{problem.names[state]}'" if problem.names else f"state {state}"
    if block == 0:
        return name
    by = f"'{problem.parameters[block - 1]}'" if problem.parameters else f"parameter {block - 1}"
    return f"the sensitivity of {name} to {by}"


def check_problem(problem: Problem) -> None:
    """Raise SolveError if a size, a breakpoint or an initial value cannot be accepted."""
    _check_sizes(problem)
    check_values(problem)


def check_values(problem: Problem) -> None:
    """Raise SolveError for values that depend on parameters; see :func:`check_problem`."""
    if problem.direction < 0 and problem.events is not None:
        raise SolveError("A scene with events runs forwards only, since events are not reversible.")
    times = problem.breakpoints
    if len(times) and not np.isfinite(np.asarray(times, dtype=float)).all():
        raise SolveError("A breakpoint is not finite; give times in seconds.")
    if not problem.max_step > 0:  # from the settings or the model; nan is rejected, too
        raise SolveError(f"max_step is {problem.max_step}; give positive seconds, or inf for none.")
    # A dot product finds nan and infinity in one pass; squares may overflow, too.
    if math.isfinite(problem.z0.dot(problem.z0)) or np.isfinite(problem.z0).all():
        return
    index = int(np.flatnonzero(~np.isfinite(problem.z0))[0])
    raise SolveError(
        f"The initial value of {describe_entry(problem, index)} is {problem.z0[index]}; "
        "give a finite number."
    )


def _check_sizes(problem: Problem) -> None:
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
    # The matrix of Newton's method for the unknowns is a block of the Jacobian.
    if problem.n_algebraic and problem.jacobian is None:
        raise SolveError("A problem with algebraic unknowns needs a Jacobian.")


def restart_times(problem: Problem) -> FloatArray:
    """List start, breakpoints inside the span, and end, in the order of the run."""
    start, end = map(float, problem.settings.t_span)
    if not len(problem.breakpoints):
        return np.array([start, end])
    low, high = min(start, end), max(start, end)
    inside = np.unique(np.asarray(problem.breakpoints, dtype=float))
    # A breakpoint at an end does not divide the span.
    inside = inside[(low < inside) & (inside < high)]
    return np.concatenate([[start], inside[:: int(problem.direction)], [end]])


def segments(problem: Problem) -> list[tuple[float, float]]:
    """Cut the span at the breakpoints inside it."""
    return list(itertools.pairwise(restart_times(problem).tolist()))


def turn_tolerances(problem: Problem) -> FloatArray:
    """Return the absolute tolerance of sensitivities to each parameter, shape (..., m).

    Sizes may have rows; see :class:`Tolerances`.
    """
    # Tolerance of the state divided by the size of the parameter, as in the error test.
    least = np.min(problem.state_atol, axis=-1, keepdims=True, initial=np.inf)
    found: FloatArray = least / np.array(
        [1.0] * problem.n_sensitivities if problem.scales is None else problem.scales
    )
    return found


def turning(problem: Problem, t: float, entry: int) -> str:
    """Return a message that the sensitivity at ``entry`` of z does not exist after time t."""
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


# A contact jams if friction increases its normal force by more than this factor.
_JAMMED = 100.0


class ModelEvents:
    """The events of a model at fixed parameters.

    ``rows`` has their names and directions, and which of them end a run. ``u(t)`` returns the
    inputs, (n_inputs,), or None for the model's own.
    """

    def __init__(
        self,
        model: CompiledModel,
        p: FloatArray,
        u: Callable[[float], FloatArray | None],
    ) -> None:
        self.rows: tuple[EventRow, ...] = model.layout.events
        self._model, self._p, self._u = model, p, u

    def _at(self, t: float) -> EvaluationPoint:
        return EvaluationPoint(self._model, t, self._p, self._u(t))

    def _parts(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the states, and the sensitivities of each parameter in a column."""
        n = len(self._model.states)
        return z[:n], z[n:].reshape(len(self._model.sensitivities), n).T

    def values(self, t: float, z: FloatArray) -> FloatArray:
        """Return the event functions, shape (n_events,), a fresh array."""
        return self._at(t).event_values(*self._parts(z))

    def jammed(self, t: float, z: FloatArray) -> str:
        """Return a sentence on contacts that jam at the end of a failed run; empty if none does.

        Sliding friction may increase the normal force of its contact, which grows without bound if
        the friction cancels the inertia that the contact accelerates.
        """
        from cotree.model.unknowns import solve_states

        y, s = self._parts(z)
        at, found = self._at(t), []
        for row in self.rows:
            # Its targets are its mode, then the mode of the stop.
            if not row.is_pressed or round(abs(y[row.targets[0]])) != 1:
                continue
            force = next(
                i
                for i, other in enumerate(self.rows)
                if other.is_lift and other.targets[0] == row.targets[1]
            )
            other = y.copy()
            other[row.targets[0]] = 2.0
            try:
                other = solve_states(at, other)
            except (ModelError, SolveError):
                continue
            with_friction, without = (at.event_values(point, s)[force] for point in (y, other))
            if with_friction > _JAMMED * without > 0.0:
                found.append(f"'{self.rows[force].name.removesuffix(' lifts')}'")
        if not found:
            return ""
        return (
            f"Sliding at {', '.join(found)} jams: with such strong friction the normal force grows "
            "without bound (Painleve's paradox): reduce the friction."
        )


# Edges that contribute more than this fraction to a dependent combination of constraints are named.
_INVOLVED = 0.1


class HeldConstraints:
    """Residuals and gradients of a model's constraints.

    Parameters
    ----------
    model : CompiledModel
        A model with constraints.
    p : ndarray, shape (n_parameters,)
        Its parameters.
    u : callable
        ``u(t)`` returns the inputs, shape (n_inputs,), or None for the model's own.
    """

    def __init__(
        self, model: CompiledModel, p: FloatArray, u: Callable[[float], FloatArray | None]
    ) -> None:
        self.names = tuple(row.name for row in model.layout.constraints)
        self._model, self._p, self._u = model, p, u
        self._edges = model.layout.constraint_edges
        self._residual = model.bound("constraints", p)

    def _gradients(self, t: float, z: FloatArray) -> tuple[FloatArray, float]:
        """Return gradients, and the singular value below which they are nearly dependent."""
        starts, n = self._model.start_in_c, len(self._model.states)
        assert starts is not None  # only used with a compiler
        return starts.gradients(EvaluationPoint(self._model, t, self._p, self._u(t)), z[:n])

    @property
    def has_rows(self) -> bool:
        """Whether there are constraints, and not only norms of quaternions."""
        return bool(self._edges)

    def singular(self, t: float, z: FloatArray) -> tuple[str, ...]:
        """Name the edges whose constraints are dependent, or nearly so, at a point."""
        rows, weakest = self._gradients(t, z)
        # Eigenvalues of C C^T are squared singular values of C; eigenvectors combine constraints.
        squares, directions = np.linalg.eigh(rows @ rows.T)
        weak = directions[:, squares <= weakest**2]
        involved = np.flatnonzero(np.max(np.abs(weak), axis=1, initial=0.0) > _INVOLVED)
        return tuple(dict.fromkeys(self._edges[i] for i in involved))

    def redundant(self, t: float, z: FloatArray) -> int:
        """Count the constraints that follow from the others at a point."""
        if not self._edges:
            return 0
        rows, _ = self._gradients(t, z)
        return len(rows) - int(np.linalg.matrix_rank(rows, tol=RANK))

    def residual(self, t: float, z: FloatArray) -> FloatArray:
        """Return the residuals of the constraints, a fresh array of the shape of ``names``."""
        n = len(self._model.states)
        return np.array(self._residual(t, z[:n], z[n:], self._u(t)))


# Maximum number of states for which algebraic unknowns are eliminated, which fills the Jacobian.
_MOST_REDUCED = 2000


def refusal(method: str, problem: Problem) -> str:
    """Return why a method in C cannot solve a checked problem; empty if it can."""
    row = METHODS[method]
    if problem.native is None:
        return problem.not_native
    if row.family == "correctors" and problem.events is not None:
        return "there are events"
    # SUNDIALS requires at least one rate.
    if row.family == "cotree":
        return _dependent(problem) if row.implicit else ""
    if problem.n_states == problem.n_algebraic:
        return "there are no states"
    is_reduced = problem.n_algebraic > 0 and not row.keeps_algebraic
    if is_reduced and problem.n_states > _MOST_REDUCED:
        return f"there are algebraic unknowns and more than {_MOST_REDUCED} states"
    return ""


def beyond_scipy(problem: Problem) -> str:
    """Return the part of a problem that SciPy's methods do not support; empty if there is none."""
    if problem.events is not None:
        return f"events, such as '{problem.events.rows[0].name}'"
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


def _dependent(problem: Problem) -> str:
    """Return a message on constraints that are dependent at the start; empty if none are.

    Stages of Rosenbrock methods violate these, which then contradict each other.
    """
    edges = (
        () if problem.singular is None else problem.singular(problem.settings.t_span[0], problem.z0)
    )
    names = ", ".join(f"'{edge}'" for edge in edges)
    return f"constraints of {names} are dependent at the start" if edges else ""
