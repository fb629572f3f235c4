"""Implementation of :meth:`cotree.Model.gradient`.

A run stores all its steps. C then sweeps over them in reverse order
(``templates/runtime/adjoint``), with the kernels of :mod:`cotree.program.adjoint`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from cotree.arguments import check_names, doubles
from cotree.build import find_toolchain
from cotree.codegen.adjoint import adjoint_context, adjoint_declarations, render_adjoint
from cotree.codegen.tableaus import TABLEAUS, Tableau
from cotree.dag.nodes import PARAMETER, symbols_in
from cotree.errors import BuildError, ParameterError, SolveError, check_known, listed
from cotree.gradient.goals import SUMMED, GoalFunction, GoalQuantity, Goals, check_times, variant_of
from cotree.model.arrays import CObjects
from cotree.model.further import load_further
from cotree.model.kernels import NO_COMPILER, build_engine, shared_code
from cotree.records import changed
from cotree.report import Facts, Report, Reported, Values
from cotree.sharing import locked_cache
from cotree.solvers.budgets import MOST_STORED
from cotree.solvers.engine import sweep
from cotree.solvers.prepare import prepared
from cotree.solvers.problem import check_values, restart_times, tested_rtol
from cotree.solvers.select import run as integrate
from cotree.solvers.trust import (
    check_time_resolution,
    is_balanced,
    warn_of_result,
    warn_of_tolerances,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from cotree.build import LoadedLibrary
    from cotree.model.arrays import Array
    from cotree.model.further import Rendered
    from cotree.model.model import CompiledModel
    from cotree.program.text import ModelText
    from cotree.scene.settings import Settings
    from cotree.solvers.problem import RunProblem
    from cotree.solvers.result import Trajectory
    from cotree.spec import BuildSpec

Places = npt.NDArray[np.intp]

#: Objective: an expression, or measured values by expression.
Objective = str | Mapping[str, Any]

#: Ending of each refusal.
_INSTEAD = "use forward sensitivities instead: compile the model with them and call simulate"

#: Quantities of a run that have no adjoint.
_FORWARD_ONLY = ("maximum", "minimum", "time")


@dataclass(frozen=True, repr=False)
class Gradient(Reported):
    """An objective of a run and its derivatives.

    Attributes
    ----------
    value : float
        The objective.
    gradient : ndarray, shape (n,)
        Its derivatives with respect to ``names``; ``result[name]`` is one of them.
    names : tuple of str
        Parameters and states; the derivative with respect to a state is that with respect to its
        initial value.
    n_steps : int
        Number of steps of the run.
    message : str
        Message of the run.
    """

    value: float
    gradient: Array
    names: tuple[str, ...]
    n_steps: int
    message: str

    def __getitem__(self, name: str) -> float:
        """Return the derivative with respect to a parameter or an initial value."""
        check_known([name], self.names, "the gradient has no entry", error=ParameterError)
        return float(self.gradient[self.names.index(name)])

    def report(self) -> Report:
        """Build the report: the value and the derivatives."""
        facts = Facts([("value", f"{self.value:.6g}"), ("steps", str(self.n_steps))])
        rows = list(zip(self.names, self.gradient.tolist(), strict=True))
        return Report(type(self).__name__, facts, Values(("by", "derivative"), rows))


class Parts(NamedTuple):
    """An objective at certain readings, with its derivatives."""

    value: float
    slopes: Array  # derivatives with respect to the readings
    explicit: Mapping[str, float]  # derivatives with respect to parameters, at constant readings


class OfText:
    """An objective given by an expression of quantities of a run."""

    def __init__(self, text: str, parameters: Collection[str]) -> None:
        goals = Goals(text, (), parameters)
        self.quantities = goals.quantities
        for row in self.quantities:
            if row.kind in _FORWARD_ONLY:
                raise ParameterError(
                    f"gradient() does not support {row.kind}(...) in objectives: {_INSTEAD}, or "
                    "cotree.optimise"
                )
        names = [name for name in parameters if name in goals.objective.names]
        self._formula = GoalFunction(goals.objective, len(goals.quantities), names)
        self._names = names

    def readings(self, span: tuple[float, float]) -> tuple[Array, Places]:
        """Return the time of each reading, and the index of its quantity."""
        check_times(self.quantities, span)
        times = {"start": span[0]}
        found = [q.t if q.kind == "at" else times.get(q.kind, span[1]) for q in self.quantities]
        return np.array(found), np.arange(len(found))

    def at(self, values: Array, known: Mapping[str, float], span: tuple[float, float]) -> Parts:
        """Evaluate the objective and its derivatives."""
        shares = np.array(
            [1.0 / (span[1] - span[0]) if q.kind == "mean" else 1.0 for q in self.quantities]
        )
        numbers = [*(shares * values), *(known[name] for name in self._names)]
        value, slopes = self._formula.value(numbers)
        n = len(values)
        return Parts(value, shares * slopes[:n], dict(zip(self._names, slopes[n:], strict=True)))


class Misfit:
    """The sum of squared deviations from measured values, divided by their standard deviations."""

    def __init__(self, data: Mapping[str, Any]) -> None:
        rows = [_read_data(text, given) for text, given in data.items()]
        self.quantities = [GoalQuantity("end", text) for text in data]
        self._times, self._measured, self._spreads = map(np.concatenate, zip(*rows, strict=True))
        self._places = np.repeat(np.arange(len(rows)), [len(row[0]) for row in rows])

    def readings(self, span: tuple[float, float]) -> tuple[Array, Places]:
        """Return the time of each measured value, and the index of its quantity."""
        for end in (self._times.argmin(), self._times.argmax()):
            text, t = self.quantities[self._places[end]].text, float(self._times[end])
            check_times([GoalQuantity("at", text, t)], span)
        return self._times, self._places

    def at(self, values: Array, known: Mapping[str, float], span: tuple[float, float]) -> Parts:
        """Evaluate the objective and its derivatives."""
        deviations = (values - self._measured) / self._spreads
        return Parts(float(deviations @ deviations), 2.0 * deviations / self._spreads, {})


def _read_data(text: str, given: Any) -> tuple[Array, Array, Array]:
    """Return times, values and standard deviations of measured values."""
    try:
        times, values, *rest = given
    except (TypeError, ValueError):
        raise ParameterError(f"the data of '{text}' must be (times, values)") from None
    arrays = [doubles(row) for row in (times, values, *(rest or [1.0]))]
    t, measured, spread = (None if row is None else np.atleast_1d(row) for row in arrays[:3])
    if t is None or measured is None or spread is None or t.shape != measured.shape or t.ndim != 1:
        raise ParameterError(
            f"the data of '{text}' must be (times, values) or (times, values, standard deviation), "
            "with as many times as values"
        )
    if not (len(t) and np.isfinite(t).all() and np.isfinite(measured).all() and (spread > 0).all()):
        raise ParameterError(
            f"the data of '{text}' must be finite numbers with positive standard deviations"
        )
    return t, measured, np.broadcast_to(spread, t.shape)


def gradient_of(
    kernels: CompiledModel,
    spec: BuildSpec,
    objective: Any,
    by: Sequence[str] | str | None,
    settings: Settings,
) -> Gradient:
    """Compute an objective of a run and its gradient; see :meth:`cotree.Model.gradient`."""
    names = tuple(kernels.parameters if by is None else check_names(by, "by", "names in quotes"))
    if isinstance(objective, str):
        key: object = objective
    elif isinstance(objective, Mapping) and objective:
        # Measured values change endlessly, and the model depends on the expressions only.
        key = tuple(objective)
    else:
        raise ParameterError(
            "the objective must be an expression, or a mapping of expressions to (times, values)"
        )
    replaced = frozenset(settings.inputs)
    goal = (
        OfText(objective, kernels.parameters) if isinstance(objective, str) else Misfit(objective)
    )
    reverse: Reverse = kernels.kept.of(
        (Reverse, key, names, replaced), lambda: Reverse(kernels, spec, goal, names, replaced)
    )
    return reverse.run(goal, settings)


class Reverse:
    """The model and the functions in C for the gradient of one kind of objective."""

    def __init__(
        self,
        kernels: CompiledModel,
        spec: BuildSpec,
        goal: OfText | Misfit,
        names: tuple[str, ...],
        replaced: frozenset[str],
    ) -> None:
        quantities, self.names = goal.quantities, names
        outputs: Mapping[GoalQuantity, str] = {row: row.text for row in quantities}
        self.model = kernels
        if any(row.kind in SUMMED or row.text not in kernels.outputs for row in quantities):
            self.model, outputs = variant_of(
                spec.scene, quantities, lambda changed: spec.of(changed, ()).compile()[0]
            )
        model = self.model
        # Output of each quantity.
        self._columns = np.array([model.outputs.index(outputs[q]) for q in quantities], dtype=int)
        rows = [
            row.name
            for row, is_unknown in zip(model.layout.states, model.layout.algebraic, strict=True)
            if not is_unknown
        ]
        check_known(names, [*model.parameters, *rows], "by names", error=ParameterError)
        self._parameters = tuple(name for name in names if name in model.parameters)
        _check_model(model, self._parameters, replaced)
        try:
            self._library = load_adjoint(model.text, self._parameters, replaced)
        except ArithmeticError as error:
            raise ParameterError(f"gradient() cannot differentiate the model: {error}") from None
        self._sweeps = load_sweeps()
        if self._library is None or self._sweeps is None:
            raise (
                SolveError(NO_COMPILER)
                if find_toolchain() is None
                else BuildError(
                    f"no compiler can build the adjoint kernels of '{model.layout.name}'"
                )
            )

    def run(self, goal: OfText | Misfit, settings: Settings) -> Gradient:
        """Run the model, and compute the objective and its gradient."""
        problem, trajectory = _forward(self.model, settings)
        span = settings.t_span
        read_at, which = goal.readings(span)
        times, at = np.unique(read_at, return_inverse=True)
        if span[1] < span[0]:  # the order of the run
            times, at = times[::-1].copy(), len(times) - 1 - at
        call = _Call(self, problem, trajectory, times)
        native = problem.native
        assert native is not None  # _forward runs compiled models
        values = sweep(native, times, call.read().T)[0].T
        places = at, self._columns[which]
        known = dict(zip(self.model.parameters, native.p.tolist(), strict=True))
        parts = goal.at(values[places], known, span)
        weights = np.zeros(values.shape)
        np.add.at(weights, places, parts.slopes)
        by_state, by_parameter = call.sweep(weights, settings.initial)
        found = dict(zip(self.model.states, by_state.tolist(), strict=True))
        found |= dict(zip(self._parameters, by_parameter.tolist(), strict=True))
        gradient = np.array([found[name] + parts.explicit.get(name, 0.0) for name in self.names])
        if not (np.isfinite(gradient).all() and np.isfinite(parts.value)):
            raise SolveError("the objective or its gradient is not finite")
        n_steps = int(trajectory.statistics.n_steps)
        return Gradient(float(parts.value), gradient, self.names, n_steps, trajectory.message)


def load_adjoint(
    text: ModelText, parameters: tuple[str, ...], replaced: frozenset[str]
) -> LoadedLibrary | None:
    """Build and load the adjoint kernels of a model; return None if that is impossible."""

    def render() -> Rendered:
        model = adjoint_context(text.program, parameters, replaced)
        declared = adjoint_declarations(model)
        return render_adjoint(model), declared, model.n_written, model.n_written_in_all

    return load_further(text, ("adjoint", parameters, replaced), render)


@locked_cache
def load_sweeps() -> LoadedLibrary | None:
    """Build and load the C functions of all models; return None if that is impossible."""
    return build_engine(shared_code("adjoint"))


def _check_model(
    model: CompiledModel, parameters: Sequence[str], replaced: Collection[str]
) -> None:
    """Raise ParameterError if the reverse sweep does not support the model."""
    layout, program = model.layout, model.program
    reasons = {
        "events": [row.name for row in layout.events],
        "laws with kinks": layout.kinks and [""],
        "algebraic unknowns": [
            row.name for row, is_own in zip(layout.states, layout.algebraic, strict=True) if is_own
        ],
        "constraints": [row.name for row in layout.constraints],
        "initial values of joints that are not states": list(layout.start_rows),
        "starts at an operating point": model.begins_at_rest and [""],
    }
    for what, names in reasons.items():
        if names:
            such = f", such as '{names[0]}'" if names[0] else ""
            raise ParameterError(f"gradient() does not support {what}{such}: {_INSTEAD}")
    own = {program.dag.symbol(PARAMETER, model.parameters.index(name)) for name in parameters}
    for name, events in program.time_events.items():
        nodes = [node for row in events for node in (row.first, row.period) if node is not None]
        moved = [node for node in symbols_in(nodes) if node in own and name not in replaced]
        if moved:
            raise ParameterError(
                f"gradient() does not support '{model.parameters[moved[0].data[1]]}', on which "
                f"times of jumps or kinks depend: {_INSTEAD}"
            )


def _forward(model: CompiledModel, settings: Settings) -> tuple[RunProblem, Trajectory]:
    """Run the model with all steps stored."""
    method = "dop853" if settings.method == "auto" else settings.method
    if method not in TABLEAUS:
        explicit = listed(list(TABLEAUS))
        raise SolveError(
            f"gradient() does not support the method '{method}': use {explicit}, or {_INSTEAD[4:]}"
        )
    settings = changed(settings, method=method, t_eval=None, sensitivities=False)
    problem = prepared(model, settings).run(settings.parameters, settings.initial)
    if problem.functions:
        raise ParameterError(
            "gradient() does not support inputs that are Python functions: give times and values, "
            "or an expression"
        )
    check_values(problem)
    warn_of_tolerances(problem)
    trajectory = check_time_resolution(problem, integrate(problem, method))
    if trajectory.status != 0:
        raise SolveError(trajectory.message)
    warn_of_result(problem, trajectory, model.layout.followers, lambda: is_balanced(model, problem))
    if len(trajectory.t) != trajectory.statistics.n_steps + 1:
        raise SolveError(
            f"the run takes {trajectory.statistics.n_steps} steps, whose states exceed "
            f"{MOST_STORED >> 20} MiB: shorten the run, loosen rtol, or {_INSTEAD}"
        )
    return problem, trajectory


def _value_of(coefficient: str) -> float:
    """Return the value of a coefficient, a number or a quotient of two numbers."""
    above, _, below = coefficient.partition("/")
    return float(above) / float(below or 1.0)


class _Method(CObjects):
    """The ``cotree_explicit_method`` of a method."""

    def __init__(self, ffi: Any, tableau: Tableau) -> None:
        super().__init__(ffi)
        n = len(tableau.nodes) + 1
        nodes, stages, solution = np.zeros(n), np.zeros((n, n)), np.zeros(n)
        nodes[1:] = [_value_of(node) for node in tableau.nodes]
        for row, weights in zip(
            (*stages[1:], solution), (*tableau.stages, tableau.solution), strict=True
        ):
            row[list(weights)] = [_value_of(weight) for weight in weights.values()]
        self.address = self.new("cotree_explicit_method *")
        self.address.n_stages, self.address.nodes = n, self.pointer(nodes)
        self.address.stages, self.address.solution = self.pointer(stages), self.pointer(solution)


@locked_cache
def method_in_c(name: str) -> _Method:
    """Return the coefficients of a method in C."""
    sweeps = load_sweeps()
    assert sweeps is not None  # the caller has loaded them
    return _Method(sweeps.ffi, TABLEAUS[name])


class _Call(CObjects):
    """A call of the C functions for one run."""

    def __init__(
        self, reverse: Reverse, problem: RunProblem, trajectory: Trajectory, times: Array
    ) -> None:
        sweeps, library, native = reverse._sweeps, reverse._library, problem.native
        assert sweeps is not None
        assert library is not None
        assert native is not None
        super().__init__(sweeps.ffi, sweeps, library)
        self._model, self._lib = native.model, sweeps.lib
        self._n_parameters = len(reverse._parameters)
        c = self.c = self.new("cotree_adjoint *")
        adjoint = getattr(library.lib, f"{native.model.text.prefix}_adjoint")()
        c.kernels = self._ffi.cast(
            "cotree_adjoint_kernels *", int(library.ffi.cast("uintptr_t", adjoint))
        )
        address = native.model.code.address_for(is_implicit=False)
        c.model = self._ffi.cast("cotree_model *", address)
        c.method = method_in_c(trajectory.statistics.method).address
        c.p, c.k = self.pointer(native.p), self.pointer(native.k)
        c.u = self.pointer(np.zeros(len(native.model.inputs)))
        c.n_replaced, c.replaced = len(problem.replaced), self.tables(problem.replaced)
        c.rtol, c.atols = tested_rtol(problem), self.pointer(problem.state_atol)
        breaks = restart_times(problem)
        forwards = problem.direction > 0
        rows = np.searchsorted(
            trajectory.t if forwards else -trajectory.t, breaks if forwards else -breaks
        )
        c.t, c.y = self.pointer(trajectory.t), self.pointer(trajectory.z.T)
        c.n_segments, c.breakpoints = len(breaks) - 1, self.pointer(breaks)
        c.rows, c.scale = self.ints(rows.tolist()), problem.scale
        c.is_start_sharp = int(breaks[0] in problem.breakpoints)
        c.is_end_sharp = int(breaks[-1] in problem.breakpoints)
        c.n_readings, c.times = len(times), self.pointer(times)
        size = -(-int(self._lib.cotree_adjoint_memory(c)) // 8)
        c.memory = self.pointer(np.zeros(size))

    def read(self) -> Array:
        """Return the states at the readings, shape (n_times, n_states)."""
        values = np.zeros((self.c.n_readings, len(self._model.states)))
        self.c.values = self.pointer(values)
        self._check(self._lib.cotree_adjoint_read(self.c))
        return values

    def sweep(self, weights: Array, initial: Mapping[str, float]) -> tuple[Array, Array]:
        """Return the derivatives with respect to initial states and parameters."""
        c, states = self.c, self._model.states
        c.weights = self.pointer(weights)
        c.is_free = self.ints([int(name not in initial) for name in states])
        found = np.zeros(len(states)), np.zeros(self._n_parameters)
        c.states, c.parameters = map(self.pointer, found)
        self._check(self._lib.cotree_adjoint_sweep(c))
        return found

    def _check(self, status: int) -> None:
        if status:
            raise SolveError(f"a kernel failed with status {status} in the reverse sweep")
