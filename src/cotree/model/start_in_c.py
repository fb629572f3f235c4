"""Search for consistent initial states, in C (``templates/runtime/start/cotree_start.c``).

If the iteration in C fails, Python searches for the algebraic unknowns. Python also factorises
large systems. If a kernel fails, Python calls it again to raise an exception that names the cause.

Prescribed initial values are kept, and all other values follow from the constraints. If prescribed
values are nearly consistent, the last ones are changed as little as possible, with a warning;
otherwise an error lists the residual of each joint. Values of the run have priority over values of
the scene.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from cotree.codegen.start_tables import start_tables
from cotree.errors import (
    Error,
    ParameterError,
    SingularSystemError,
    SolveError,
    UnsolvedError,
    listed,
)
from cotree.model.arrays import Array, CObjects
from cotree.model.kernels import SINGULAR, build_engine, shared_code
from cotree.model.start import Start
from cotree.model.unknowns import contradicting_jumps, of_model
from cotree.quiet import level_of_user
from cotree.sharing import locked_cache

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    import numpy.typing as npt

    from cotree.build import LoadedLibrary
    from cotree.equations import RedundantRow
    from cotree.model.bound import BoundModel
    from cotree.model.model import CompiledModel
    from cotree.program.layout import Layout


#: Number of algebraic unknowns above which sparse factorisation in Python is faster.
_MOST_UNKNOWNS = 200


@locked_cache
def load_start() -> LoadedLibrary | None:
    """Build and load the C library once; return None without a compiler."""
    return build_engine(shared_code("start"))


#: C statuses: initial values (100), or their derivatives (102), contradict the constraints.
_CONTRADICTIONS = (100, 102)

#: C statuses: no solution of the algebraic equations nearby; unknowns left undetermined.
_UNSOLVED, _UNDETERMINED = 104, 108

#: C status: the modes of jumps contradict the resulting states.
_REVERSED = 105

#: C statuses after which all states are known: no error; contradictory redundant values; a value
#: that is not finite (106); a start at a jump whose time depends on a parameter.
_REDUNDANT = 103
_ON_JUMP = 109
_COMPLETE = (0, _REDUNDANT, 106, _ON_JUMP)

#: Kernels that solve linear systems and that C may call at a start.
_LINEAR = (
    *("initial", "inputs", "constraints", "start", "rhs", "jacobian", "events", "jumps"),
    *("constraint_sensitivity", "start_sensitivity", "augmented_rhs", "event_sensitivity"),
)


class StartInC:
    """Search for consistent initial states of one model.

    ``tables`` is the model's ``cotree_start_tables`` and ``function`` the address of
    ``cotree_start_once``. If ``is_sparse``, Python factorises the Jacobian of algebraic unknowns.
    """

    def __init__(self, model: CompiledModel, library: LoadedLibrary) -> None:
        self._ffi, self._lib = library.ffi, library.lib
        self._objects = CObjects(library.ffi, library)
        self.tables = filled_tables(self._objects, model.layout)
        self.is_sparse = model.layout.n_algebraic > _MOST_UNKNOWNS
        for content, _ in model.layout.followers:
            # At an operating point, storage contents follow from the voltages.
            self.tables.given[content] &= not model.begins_at_rest
        self.address = int(self._ffi.cast("uintptr_t", self.tables))
        function = self._ffi.addressof(library.lib, "cotree_start_once")
        kind = "int (*)(cotree_start_call *)"
        self.function = int(self._ffi.cast("uintptr_t", self._ffi.cast(kind, function)))

    def find(
        self, at: BoundModel, initial: Mapping[str, float], given: Array | None = None
    ) -> Start:
        """Find the start of a run; ``initial`` replaces initial values of the scene.

        ``given``, (n_states * (1 + n_sensitivities),), replaces all initial values and
        sensitivities of the scene. Raise ParameterError if initial values contradict the
        constraints or each other, SolveError if the algebraic equations or the modes of jumps have
        no solution, and SingularSystemError if unknowns are undetermined.
        """
        return StartCall(self, at, initial, given).find()

    def gradients(self, at: BoundModel, y: Array) -> tuple[Array, float]:
        """Return the constraint gradients with respect to speeds, with unit length per edge.

        The second result is the singular value below which the gradients count as dependent.
        """
        call, layout = StartCall(self, at, {}, None), at.model.layout
        rows, weakest = np.zeros((len(layout.constraint_edges), layout.n_speeds)), np.zeros(1)
        call.z[: len(y)] = y
        if self._lib.cotree_start_gradients(call.c, call.pointer(rows), call.pointer(weakest)):
            call.fail(SINGULAR)
        return rows, float(weakest[0])


class UnknownsOfStart(CObjects):
    """Python functions that C calls to find the algebraic unknowns if its iteration fails."""

    def __init__(self, ffi: Any, at: BoundModel) -> None:
        super().__init__(ffi)
        self.algebraic, self._n = of_model(at), len(at.model.states)
        self.helper = self.new("cotree_helper *")
        self.helper.find_unknowns = self.callback("cotree_find_unknowns", self._find)

    def factorise(self, call: Any) -> None:
        """Set the functions with which a ``cotree_start_call`` factorises in Python."""
        rows = call.elimination = self.new("cotree_elimination *")
        rows.linearise = self.callback("int (*)(double, const double *, void *)", self._linearise)
        rows.solve = self.callback("int (*)(const double *, double *, void *)", self._solve)

    def _find(self, t: float, x: Any, context: Any) -> int:
        try:
            self.algebraic.solve(t, self._array(x, self._n))
        except Error as error:
            self.errors.append(error)
            return 1
        return 0

    def _linearise(self, t: float, x: Any, context: Any) -> int:
        try:
            _, self._linear = self.algebraic.linearised(t, self._array(x, self._n))
        except (SingularSystemError, UnsolvedError):
            return SINGULAR
        return 0

    def _solve(self, g: Any, step: Any, context: Any) -> int:
        m = self._n - self.algebraic.cut
        self._array(step, m)[:] = -self._linear.solve(self._array(g, m))
        return 0

    def _array(self, pointer: Any, size: int) -> Array:
        return np.frombuffer(self._ffi.buffer(pointer, 8 * size))


class StartCall(CObjects):
    """One call of ``cotree_start_once`` with all its arguments."""

    def __init__(
        self,
        starts: StartInC,
        at: BoundModel,
        initial: Mapping[str, float],
        given: Array | None,
    ) -> None:
        super().__init__(starts._ffi)
        model, ffi = at.model, starts._ffi
        self._starts, self._at, self._initial = starts, at, initial
        n, m = len(model.states), len(model.sensitivities)
        self.z = np.empty(n * (1 + m))
        self._search: UnknownsOfStart | None = None
        self.c = c = self.new("cotree_start_call *")
        c.tables, c.z = starts.tables, self.pointer(self.z)
        c.p, c.k = map(self.pointer, (at.p, at.k))
        c.model = ffi.cast("cotree_model *", model.code.address_for(is_implicit=False))
        c.t, c.has_sensitivities, c.n_set = at.t, m > 0, len(initial)
        places = np.array([model.states.index(name) for name in initial], dtype=np.intc)
        self.places = places
        c.set = self.pointer(places, "int")
        self._contradictions = np.zeros((1 + m, len(model.layout.redundant)), dtype=np.intc)
        c.contradictions = self.pointer(self._contradictions, "int")
        c.values = self.pointer(np.array([float(value) for value in initial.values()]))
        if given is not None:
            c.initial = self.pointer(given)
        self._set_inputs()
        if starts.is_sparse:
            self.search().factorise(c)

    def find(self) -> Start:
        """Find the start; see :meth:`StartInC.find`."""
        at, c = self._at, self.c
        status, report = self._run(), None
        if status in (*_CONTRADICTIONS, _UNSOLVED):
            if at.model.layout.n_algebraic:
                c.helper = self.search().helper
            if status in _CONTRADICTIONS:
                report = Violations(at, self.places, self)
            status = self._run()
        y, s = self._found()
        if report is not None and status in _CONTRADICTIONS:
            report.refuse(y, is_of_derivatives=status == _CONTRADICTIONS[1])
        if status == _REVERSED:
            raise contradicting_jumps(at)
        if status == _UNDETERMINED or (status in _COMPLETE and self._starts.is_sparse):
            self.search().algebraic.check_index(at.t, y)
        if status not in _COMPLETE:
            self.fail(status)
        if status == _REDUNDANT:
            raise contradiction(at, y, s, self._contradictions > 0)
        on_jump = self._jump_at_start() if status == _ON_JUMP else ""
        if report is None:
            return Start(y, s, bool(c.is_chosen), on_jump=on_jump)
        note = report.note(is_warning=not self._initial)
        report.warn()
        return Start(y, s, bool(c.is_chosen), note, report.is_mended, on_jump)

    def _jump_at_start(self) -> str:
        name, by = self._ffi.string(self.c.culprit), self._at.model.sensitivities[self.c.column]
        return (
            f"'{name.decode()}' occurs exactly at the start, t = {self._at.t:.6g}, and '{by}' "
            "moves the start to either side of it, so there is no derivative: start away from "
            "the jump, or compile without this sensitivity"
        )

    def fail(self, status: int) -> NoReturn:
        """Raise the exception for a status of C."""
        if self._search is not None and self._search.errors:
            raise self._search.errors[-1]
        if status in (_UNSOLVED, _UNDETERMINED):
            raise self._unsolved()
        y, s = self._found()
        for name in _LINEAR:
            self._at.call(name, y, s)  # raises the exception for a singular matrix
        raise SolveError(f"a kernel fails near the start at t = {self._at.t:.10g}")

    def _unsolved(self) -> SolveError:
        model, initial = self._at.model, self._initial
        states = [model.states[i] for i, _ in model.layout.followers]
        names = ", ".join(f"'{name}'" for name in states if name not in initial)
        t = f"{self._at.t:.10g}"
        if not names:
            return SolveError(
                f"the algebraic equations cannot be solved at t = {t}: give initial values nearer "
                "to a solution"
            )
        return SolveError(
            f"{names} cannot be found at t = {t} from initial values of dependent variables, since "
            f"these also depend on unknowns of nonlinear equations; prescribe {names} instead"
        )

    def search(self) -> UnknownsOfStart:
        """Return the Python functions for algebraic unknowns, created at the first call."""
        if self._search is None:
            self._search = UnknownsOfStart(self._ffi, self._at)
        return self._search

    def _run(self) -> int:
        return int(self._starts._lib.cotree_start_once(self.c))

    def _found(self) -> tuple[Array, Array]:
        model = self._at.model
        z = self.z.reshape(1 + len(model.sensitivities), len(model.states))
        return z[0].copy(), z[1:].T.copy()

    def _set_inputs(self) -> None:
        """Pass to C the inputs that override those of the scene, as tables with one point."""
        given = [] if self._at.u is None else self._at.u.tolist()
        rows = self.new("cotree_table_input[]", max(1, len(given)))
        for i, value in enumerate(given):
            own = self.new("double[]", [0.0, value])
            rows[i].input, rows[i].length, rows[i].t, rows[i].u = i, 1, own, own + 1
        self.c.n_replaced, self.c.replaced = len(given), rows


def filled_tables(objects: CObjects, layout: Layout) -> Any:
    """Return a model's ``cotree_start_tables``, which ``objects`` keeps alive."""
    tables, c = start_tables(layout), objects.new("cotree_start_tables *")
    if tables.has_assembly:
        c.assembly = rows = objects.new("cotree_assembly_tables *")
        for name in ("n_coordinates", "n_speeds", "n_values", "n_rows", "n_start", "n_groups"):
            setattr(rows, name, getattr(tables, name))
        rows.n_quaternions, rows.n_conditions = len(tables.quaternions), len(tables.is_rate)
        for name in ("value_rows", "quaternions", "is_rate", "groups"):
            setattr(rows, name, objects.ints(getattr(tables, name)))
        rows.rows = objects.quantities(tables.rows)
    for name in ("given", "seeds", "contents", "redundant_starts", "redundant_states"):
        setattr(c, name, objects.ints(getattr(tables, name)))
    c.n_contents, c.n_redundant = len(tables.contents) // 2, len(tables.redundant)
    c.redundant = objects.quantities(tables.redundant)
    return c


def start_in_c(model: CompiledModel) -> StartInC | None:
    """Return the C routine that searches for initial states, or None without a compiler."""
    library = load_start()
    return None if library is None else StartInC(model, library)


#: Smallest relative change that messages mention, and largest residual that counts as zero.
_NOTICED, _MET = 1e-4, 1e-10

#: Maximum number of residuals and of changes in a message.
_MOST_NAMED = 6

_LEVELS = ("positions", "velocities")


class Violations:
    """Messages on prescribed values, at ``places`` in the run's order, that violate constraints."""

    def __init__(self, at: BoundModel, places: npt.NDArray[np.intc], call: StartCall) -> None:
        layout = at.model.layout
        self._model, self._call = at.model, call
        rows = start_tables(layout).rows
        self._names = [row.name for row in rows]
        self._is_length = np.array([row.unit.startswith("m") for row in rows], dtype=bool)
        n, m = len(layout.states), len(layout.sensitivities)
        self._values = [*at.model.states, *layout.start_rows]
        self._c = c = call.c.report = call.new("cotree_start_report *")
        self._before, self._after, self._changes, self._left = (
            np.zeros(size) for size in (n, n, n + len(rows), len(rows))
        )
        for name in ("before", "after", "changes", "left"):
            setattr(c, name, call.pointer(getattr(self, f"_{name}")))
        # Values of the run come first, then values of the scene in its order.
        names = [*(at.model.states[i] for i in places), *layout.given_names, *at.model.states]
        order = {name: i for i, name in enumerate(dict.fromkeys(names))}
        c.ranks = call.new("int[]", [order.get(name, 0) for name in self._values])
        self._follows = np.zeros((m, len(self._values)), dtype=np.intc)
        c.follows = call.pointer(self._follows, "int")

    @property
    def is_mended(self) -> bool:
        """Whether prescribed initial values had to be changed."""
        return bool(np.any(self._changes))

    def _moved(self) -> list[str]:
        """Return descriptions of changed initial values and of residuals of relaxed conditions."""
        n, size = len(self._before), np.abs(self._changes)
        states = self._model.states
        found = [
            f"'{states[i]}' from {self._before[i]:.6g} to {self._after[i]:.6g}"
            for i in np.flatnonzero(size[:n] > _NOTICED)
        ]
        own = self._changes[n:] * self._units
        found += [
            f"'{self._names[i]}' by {own[i]:.3g}" for i in np.flatnonzero(size[n:] > _NOTICED)
        ]
        return found[:_MOST_NAMED]

    @property
    def _units(self) -> Array:
        """The factor from each scaled residual to its unit: a length, or one."""
        return np.where(self._is_length, self._c.length, 1.0)

    def warn(self) -> None:
        """Warn if prescribed initial values had to be changed."""
        moved = self._moved()
        if moved:
            warnings.warn(
                f"initial values were changed to satisfy the constraints: {', '.join(moved)}",
                RuntimeWarning,
                stacklevel=level_of_user(),
            )

    def note(self, *, is_warning: bool) -> str:
        """Return a message on initial values that change with parameters, or an empty string."""
        following: dict[str, list[str]] = {}
        for j, i in np.argwhere(self._follows).tolist():
            following.setdefault(self._values[i], []).append(self._model.sensitivities[j])
        if not following:
            return ""
        shown = listed(
            f"'{value}' with {listed(map(repr, names))}" for value, names in following.items()
        )
        message = (
            "initial values change with parameters, since values given before them are kept: "
            f"{shown}. Give them as expressions of these parameters, or leave them out"
        )
        if is_warning:
            warnings.warn(message, RuntimeWarning, stacklevel=level_of_user())
        return f"{message[0].upper()}{message[1:]}."

    def refuse(self, y: Array, *, is_of_derivatives: bool) -> NoReturn:
        """Raise the exception for a start near y that does not exist or has no derivatives."""
        for first in self._model.layout.quaternions:
            if not np.any(y[first : first + 4]):
                raise ParameterError(
                    f"the initial quaternion from '{self._model.states[first]}' on is zero: give "
                    "it a length, or angles"
                )
        if is_of_derivatives:
            self._refuse_derivative()
        size = np.nan_to_num(np.abs(self._left), nan=np.inf)
        order = [i for i in np.argsort(-size * self._units)[:_MOST_NAMED] if size[i] > _MET]
        own = self._left * self._units
        shown = ", ".join(f"{self._names[i]} = {own[i]:.3g}" for i in order)
        moved = self._moved()
        nearest = f". The nearest valid ones would change {', '.join(moved)}" if moved else ""
        raise ParameterError(
            f"the initial {_LEVELS[self._c.level]} violate the constraints, and the given values "
            f"cannot be adjusted; residuals: {shown}{nearest}. Change initial values or "
            "lengths of these joints, or give fewer initial values"
        )

    def _refuse_derivative(self) -> NoReturn:
        size = np.abs(self._left)
        order = [i for i in np.argsort(-size)[:4] if size[i] > 0.1 * np.max(size)]
        named = ", ".join(f"'{self._names[i]}'" for i in order)
        raise ParameterError(
            "the start has no derivative with respect to "
            f"'{self._model.sensitivities[self._c.column]}', which changes the "
            f"{_LEVELS[self._c.level]} that the constraints require: to first order, any change "
            f"of the states would violate {named}. The constraints are dependent there: start "
            "elsewhere, let all affected values depend on that parameter, or compile without "
            "this sensitivity"
        )


def contradiction(
    at: BoundModel, y: Array, s: Array, is_apart: npt.NDArray[np.bool_]
) -> ParameterError:
    """Return the exception for initial values that contradict states or sources.

    ``is_apart``, (1 + n_parameters, n_redundant), marks contradictions: row 0 of the values y, the
    other rows of the derivatives s.
    """
    rows, m, n = at.model.layout.redundant, len(at.model.sensitivities), is_apart.shape[1]
    if is_apart[0].any():
        # The last two rows are the redundant values: from the states, then as prescribed.
        follows, given = at.call("start", y)[-2 * n :].reshape(2, n)
        apart = {
            f"'{rows[i].name}' is given as {given[i]:.6g} but is {follows[i]:.6g} by "
            f"{_origin(rows[i].states, at.t)}": rows[i]
            for i in np.flatnonzero(is_apart[0])
        }
        return ParameterError(
            f"initial values contradict each other: {'; '.join(apart)}. Give values that agree, or "
            f"leave these out{_hint(apart.values())}"
        )
    # The derivatives with respect to each parameter end with the same two rows.
    found = at.call("start_sensitivity", y, s).reshape(m, -1)[:, -2 * n :].reshape(m, 2, n)
    apart = {
        f"d({rows[i].name})/d({at.model.sensitivities[j]}) is {found[j, 1, i]:.6g} as given but "
        f"{found[j, 0, i]:.6g} by {_origin(rows[i].states, at.t)}": rows[i]
        for j, i in np.argwhere(is_apart[1:])
    }
    return ParameterError(
        "initial values agree at these parameters, but their derivatives do not: "
        f"{'; '.join(apart)}. Give expressions that agree for all values of the parameters, or "
        f"leave these initial values out{_hint(apart.values())}"
    )


def _hint(rows: Iterable[RedundantRow]) -> str:
    """Return advice for messages on positions, which node positions determine; else empty."""
    if not any(row.is_position for row in rows):
        return ""
    return (
        "; edges between the same nodes have one position, and positions along a circuit add up to "
        "zero: set the initial stretch of a spring by its free_length or free_angle"
    )


def _origin(states: Sequence[str], t: float) -> str:
    """Return the names of the states or sources that determine a value."""
    if not states:
        return f"the sources at t = {t:g}"
    return ", ".join(f"'{name}'" for name in states)
