"""Linearisation of a model about a state, in deviations of all states or of independent states.

Algebraic unknowns are eliminated. Derivatives of the linear system are formed once, along a
symbolic direction, and then evaluated for each parameter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.arguments import check_names
from cotree.dag.derivative import tangents
from cotree.dag.evaluate import evaluate
from cotree.dag.multi_output import results
from cotree.dag.nodes import (
    INPUT,
    INPUT_CHANGE,
    PARAMETER,
    STATE,
    STATE_CHANGE,
    TUNED_CHANGE,
    Dag,
    Node,
    reachable,
    symbols_in,
)
from cotree.equations import Derivative, Equations, spread
from cotree.errors import Error, ParameterError, SingularSystemError, brief, nearest
from cotree.model.algebraic import eliminated
from cotree.model.arrays import one_point
from cotree.model.deviations import Reduced, Slopes, is_same, is_still, reduce, reduce_along
from cotree.model.linearization import Linearization, LinearSlopes
from cotree.model.start import find_start
from cotree.model.unknowns import check_friction, solve_states
from cotree.program.solved import SolvedSystem
from cotree.sharing import locked_cached_property

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from cotree.model.arrays import Array
    from cotree.model.bound import BoundModel


_CHANGES = {STATE: STATE_CHANGE, INPUT: INPUT_CHANGE, PARAMETER: TUNED_CHANGE}


@dataclass(frozen=True, eq=False)
class Direction:
    """A direction in the space of states, inputs and parameters."""

    #: Components of the direction; entries of ``y`` for algebraic unknowns are ignored.
    y: Array
    u: Array
    p: Array


class Variation:
    """Directional derivatives of nodes along a symbolic direction, formed once."""

    def __init__(self, dag: Dag, nodes: Sequence[Node]) -> None:
        seed = {
            symbol: dag.symbol(_CHANGES[symbol.data[0]], symbol.data[1])
            for symbol in sorted(symbols_in(nodes), key=lambda node: node.data)
            if symbol.data[0] in _CHANGES
        }
        self._nodes = tangents(nodes, seed)
        found = symbols_in(self._nodes)
        changes = [symbol for symbol in found if symbol.data[0] in _CHANGES.values()]
        self._changes = {symbol: symbol.data for symbol in changes}
        #: Symbols whose values the evaluation needs in addition to the direction.
        self.symbols = frozenset(found) - frozenset(changes)

    def along(self, values: Mapping[Node, float], direction: Direction) -> Array:
        """Evaluate the derivatives along a direction, shape (n_nodes,)."""
        by_kind = {STATE_CHANGE: direction.y, INPUT_CHANGE: direction.u, TUNED_CHANGE: direction.p}
        changes = {
            symbol: float(by_kind[kind][place]) for symbol, (kind, place) in self._changes.items()
        }
        with np.errstate(all="ignore"):
            found = evaluate(self._nodes, {**values, **changes})
        return np.array([float(np.real(value)) for value in found])


def eliminated_along(moved: Array, change: Array, cut: int) -> Array:
    """Differentiate the Schur complement of :func:`cotree.model.algebraic.eliminated`."""
    n = len(moved) - cut
    # Schur complement A - B X with X = D^-1 C, hence X' = D^-1 (C' - D' X).
    x = np.linalg.solve(moved[cut:, -n:], moved[cut:, :-n])
    dx = np.linalg.solve(moved[cut:, -n:], change[cut:, :-n] - change[cut:, -n:] @ x)
    return np.asarray(change[:cut, :-n] - change[:cut, -n:] @ x - moved[:cut, -n:] @ dx)


#: Relative change of the fastest state after which the linear system is compared.
_ASIDE = 0.1


class Linearizer:
    """Symbolic derivatives of the equations with respect to states and inputs."""

    def __init__(self, equations: Equations, input_columns: Sequence[Derivative]) -> None:
        self._equations = equations
        solved = SolvedSystem.of(equations)
        self._nodes = _columns(equations, solved, (*equations.columns, *input_columns))
        rates = solved.substitute(equations.rates)
        rows = equations.constraints
        valued = {i: value for i, value in enumerate(rows.values) if value is not None}
        with_value = list(valued)
        # Each column has the constraint entries, then the entries of the constraint rates.
        held = [
            node
            for column in equations.columns
            for node in (*(column.held[i] for i in with_value), *column.held_rates)
        ]
        #: Constraints and their rates, which are differentiated only with respect to parameters.
        self._values_held = [*valued.values(), *rows.rates]
        # Event functions follow the outputs in ``output_values``.
        self._outputs = solved.substitute(equations.output_values[: len(equations.outputs)])
        self._n_values = len(with_value)
        self._others = [*rates, *held]
        found = reachable([*self._nodes, *self._others])
        solves = [node for node in found if node.op == "solve"]
        # The last result of a `solve` node is true if its matrix is regular.
        self._accepted = [results(node, node.data.size + 2)[-1] for node in solves]
        self._symbols = symbols_in([*self._nodes, *self._others, *self._accepted])
        #: Whether the equations depend explicitly on time, and whether the scene's inputs do.
        self.is_timed = equations.dag.symbol("t", 0) in found
        self.has_timed_inputs = equations.dag.symbol("t", 0) in reachable(equations.input_values)

    @locked_cached_property
    def _variation(self) -> Variation:
        """Directional derivatives of the matrices of the linear system."""
        return Variation(self._equations.dag, [*self._nodes, *self._others])

    @locked_cached_property
    def _first(self) -> Variation:
        """Directional derivatives of rates, outputs and constraints."""
        n = len(self._equations.states)
        rows = [*self._others[:n], *self._outputs, *self._values_held]
        return Variation(self._equations.dag, rows)

    @locked_cached_property
    def _inputs(self) -> Variation:
        return Variation(self._equations.dag, self._equations.input_values)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the differential states except modes, which have no deviations."""
        return tuple(self._equations.states[i].name for i in self._kept)

    @property
    def _n_differential(self) -> int:
        return len(self._equations.states) - self._equations.n_algebraic

    @cached_property
    def _kept(self) -> list[int]:
        return [i for i in range(self._n_differential) if i not in self.modes]

    @property
    def modes(self) -> range:
        """Indices of the modes among the states; modes change only at events."""
        first = self._equations.n_coordinates + self._equations.n_speeds
        return range(first, first + self._equations.n_modes)

    def at(self, t: float, y: Sequence[float] | Array, p: Array, u: Array) -> Slopes:
        """Linearise at a point that satisfies the algebraic equations."""
        rates, whole, held = self.whole(t, y, p, u)
        return self._slopes(y, rates, self._without_algebraic(whole), held)

    def whole(
        self, t: float, y: Sequence[float] | Array, p: Array, u: Array
    ) -> tuple[Array, Array, Array]:
        """Evaluate the rates and the full Jacobian, in which algebraic unknowns count as states.

        Return the rates and algebraic residuals, (n_states,); the Jacobian of these and the outputs
        with respect to states and inputs; and the Jacobian of the constraints and their rates.
        """
        values = self._values(t, y, p, u)
        with np.errstate(all="ignore"):
            found = evaluate([*self._nodes, *self._others, *self._accepted], values)
        numbers = np.array([float(np.real(v)) for v in found[: len(found) - len(self._accepted)]])
        if not all(found[len(numbers) :]):
            raise SingularSystemError("the mass matrix is singular at this state")
        self._check_finite(numbers[: len(self._nodes)])
        return self._arranged(numbers)

    def _arranged(self, numbers: Array) -> tuple[Array, Array, Array]:
        """Split the values of all nodes into rates, Jacobian and constraint Jacobian."""
        equations = self._equations
        n, m, k = len(equations.states), len(equations.inputs), len(equations.outputs)
        whole, others = np.split(numbers, [len(self._nodes)])
        # Columns of states precede columns of inputs; rows of rates precede rows of outputs.
        whole = whole.reshape(n + m, n + k).T
        rates, held = np.split(others, [n])
        return rates, whole, held.reshape(n, -1).T if n else held.reshape(0, 0)

    def _slopes(
        self, y: Sequence[float] | Array, rates: Array, whole: Array, held: Array
    ) -> Slopes:
        """Select the rows and columns of the differential states except modes."""
        equations, n, kept = self._equations, self._n_differential, self._kept
        return Slopes(
            y=np.array(y, dtype=float)[kept],
            rates=rates[kept],
            A=whole[np.ix_(kept, kept)],
            B=whole[kept, n:],
            C=whole[n:, kept],
            D=whole[n:, n:].copy(),
            held=held[: self._n_values, kept],
            held_rates=held[self._n_values :, kept],
            n_coordinates=equations.n_coordinates,
            n_speeds=equations.n_speeds,
            turns=self._turns,
        )

    def by_parameters(self, at: BoundModel, y: Array, direction: Direction) -> Array:
        """Differentiate rates, residuals, outputs, constraints and their rates, in this order."""
        values = self._values(at.t, y, at.p, at.inputs, self._first.symbols)
        return self._first.along(values, direction)

    def inputs_by_parameters(self, at: BoundModel, dp: Array) -> Array:
        """Return the derivatives of inputs along a change of the parameters, shape (n_inputs,)."""
        none, y = np.zeros(len(self._equations.inputs)), np.zeros(len(self._equations.states))
        values = self._values(at.t, y, at.p, none, self._inputs.symbols)
        return self._inputs.along(values, Direction(y, none, dp))

    def _changed(self, at: BoundModel, y: Array, direction: Direction) -> Slopes:
        """Differentiate the linearisation along a direction, including the algebraic unknowns."""
        n, whole = self._n_differential, self.whole(at.t, y, at.p, at.inputs)[1]
        if self._equations.n_algebraic:
            moved, dy = self._moved_behind(whole), direction.y.copy()
            dy[n:] = 0.0
            held = replace(direction, y=dy)
            # The change of the unknowns follows from g(y, u, p) = 0.
            left = self.by_parameters(at, y, held)[n : len(dy)]
            dy[n:] = -np.linalg.solve(moved[-len(left) :, -len(left) :], left)
            direction = replace(direction, y=dy)
        values = self._values(at.t, y, at.p, at.inputs, self._variation.symbols)
        rates, change, rows = self._arranged(self._variation.along(values, direction))
        if self._equations.n_algebraic:
            moved = self._moved_behind(whole)
            cut = len(moved) - self._equations.n_algebraic
            change = eliminated_along(moved, self._moved_behind(change), cut)
        return self._slopes(direction.y, rates, change, rows)

    def _moved_behind(self, whole: Array) -> Array:
        """Move the rows and columns of algebraic unknowns to the end."""
        cut = self._n_differential
        algebraic = range(cut, cut + self._equations.n_algebraic)
        # Algebraic unknowns are between the differential states and the outputs or inputs.
        order = [*(i for i in range(len(whole)) if i not in algebraic), *algebraic]
        columns = [*(j for j in range(whole.shape[1]) if j not in algebraic), *algebraic]
        return whole[np.ix_(order, columns)]

    def _without_algebraic(self, whole: Array) -> Array:
        """Eliminate the algebraic unknowns by the implicit function theorem."""
        equations = self._equations
        if not equations.n_algebraic:
            return whole
        moved, n = self._moved_behind(whole), equations.n_algebraic
        try:
            inverse = np.linalg.inv(moved[-n:, -n:])
        except np.linalg.LinAlgError:
            names = ", ".join(f"'{state.name}'" for state in equations.states[-n:])
            raise SingularSystemError(
                f"the derivatives of the algebraic equations with respect to {names} are singular "
                "at this state"
            ) from None
        return eliminated(moved, inverse.dot, len(moved) - n)

    @cached_property
    def _turns(self) -> dict[int, int]:
        """Index of an edge's first angular velocity, by the index of its first quaternion entry."""
        equations, names = self._equations, list(self.states)
        symbols = [state.symbol for state in equations.states]
        return {
            # The angular velocities w1, w2 and w3 of an edge are consecutive.
            symbols.index(symbols_of_edge[0]): names.index(f"{edge}.w1")
            for edge, symbols_of_edge in equations.constraints.quaternions
        }

    def about(
        self,
        at: BoundModel,
        y: Array,
        *,
        reduced: bool,
        directions: Mapping[str, Direction] | None = None,
    ) -> Linearization:
        """Linearise about a motion; ``directions`` maps names to derivatives of the point."""
        point = self.at(at.t, y, at.p, at.inputs)
        found = reduce(point, self.states)
        equations, n = self._equations, self._n_differential
        basis = np.zeros((n, found.basis.shape[1] if reduced else len(self._kept)))
        basis[self._kept] = found.basis if reduced else np.eye(len(self._kept))
        slopes = {}
        for name, direction in (directions or {}).items():
            change = self._changed(at, y, direction)
            matrices = change.A, change.B, change.C
            if reduced:
                matrices = reduce_along(point, change, found, self.states)
            slopes[name] = LinearSlopes(*matrices, change.D)
        return Linearization(
            A=found.A if reduced else point.A,
            B=found.B if reduced else point.B,
            C=found.C if reduced else point.C,
            D=point.D,
            states=found.names if reduced else self.states,
            inputs=tuple(row.name for row in equations.inputs),
            outputs=tuple(row.name for row in equations.outputs),
            basis=basis,
            is_steady=is_still(found, point) and self._stays(at, y, point, found),
            modes={equations.states[i].name: float(y[i]) for i in self.modes},
            slopes=slopes,
        )

    def _stays(self, at: BoundModel, y: Array, point: Slopes, here: Reduced) -> bool:
        """Return whether the linear system is constant along the motion and in time."""
        fastest = float(np.max(np.abs(point.rates), initial=0.0))
        # This is the equilibrium of an autonomous system.
        if not (fastest or self.is_timed or (self.has_timed_inputs and at.u is None)):
            return True
        # In this time, at most 0.1 s, the fastest state changes by a tenth.
        step = _ASIDE / max(fastest, 1.0)
        later = replace(at, t=at.t + step)
        y, y[self._kept] = y.copy(), self._moved(point, at, y, step)
        try:
            y = solve_states(later, y)
            there = self.at(later.t, y, at.p, later.inputs)
        # A motion that cannot be continued does not count as steady.
        except (Error, ArithmeticError, ValueError):
            return False
        moved = reduce(there, self.states, here.names)
        return is_still(moved, there) and is_same(here, moved)

    def _moved(self, point: Slopes, at: BoundModel, y: Array, step: float) -> Array:
        """Return the states after one step of the classical Runge-Kutta method."""
        kept, u = self._kept, at.inputs
        slopes = [point.rates]
        for share in (0.5, 0.5, 1.0):
            aside = y.copy()
            aside[kept] += share * step * slopes[-1]
            values = self._values(at.t + share * step, aside, at.p, u)
            # Inputs and algebraic unknowns are constant here; the caller updates the unknowns.
            rates = evaluate(self._others[: len(self._equations.states)], values)
            slopes.append(np.array([float(np.real(rates[i])) for i in kept]))
        a, b, c, d = slopes
        return np.asarray(y[kept] + step / 6.0 * (a + 2.0 * b + 2.0 * c + d))

    def _check_finite(self, numbers: Array) -> None:
        wrong = np.flatnonzero(~np.isfinite(numbers))
        if wrong.size:
            equations = self._equations
            states = [state.name for state in equations.states]
            rows = [*states, *(output.name for output in equations.outputs)]
            columns = [*states, *(row.name for row in equations.inputs)]
            column, row = divmod(int(wrong[0]), len(rows))
            what = "the rate of" if row < len(states) else "output"
            raise SingularSystemError(
                f"the derivative of {what} '{rows[row]}' with respect to '{columns[column]}' is "
                f"{numbers[wrong[0]]} at this state: linearise about another state"
            )

    def _values(
        self,
        t: float,
        y: Sequence[float] | Array,
        p: Array,
        u: Array,
        symbols: Iterable[Node] | None = None,
    ) -> Mapping[Node, float]:
        states = zip(self._equations.states, y, strict=True)
        values = {state.symbol: float(value) for state, value in states}
        known: dict[str, Sequence[float] | Array] = {"t": [t], "p": p, "u": u}
        # Symbols are looked up, because creating one would alter the shared graph.
        for symbol in self._symbols if symbols is None else symbols:
            kind, position = symbol.data
            if kind in known:
                values[symbol] = float(known[kind][position])
        return values


def _columns(
    equations: Equations, solved: SolvedSystem, columns: Sequence[Derivative]
) -> list[Node]:
    zero, n, k = equations.dag.zero, len(equations.states), len(equations.outputs)
    return [
        node
        for row in solved.along(columns)
        for node in (*spread(row.rates, n, zero), *spread(row.outputs, k, zero))
    ]


def linearize(
    linearizer: Linearizer,
    at: BoundModel,
    y: Any = None,
    *,
    reduced: bool = False,
    sensitivities: Sequence[str] | str = (),
    total: bool = False,
) -> Linearization:
    """Linearise about the motion through a state; see :meth:`cotree.Model.linearize`."""
    # Expression graphs bypass the parameter checks of the compiled kernels.
    model = at.model
    model.check_parameters(at.p)
    names = check_names(sensitivities, "sensitivities")
    moves = _starts_along(at, names) if total and y is None else {}
    if total and y is not None:
        raise ParameterError(
            "total=True differentiates through the model's initial states, but y was given: "
            "omit it, or use model.trim(...).linearize(...), which follows equilibria"
        )
    y = find_start(at, {}).y if y is None else one_point(y, model.states, "state")
    directions = {name: unit_direction(linearizer, at, name) for name in names}
    for name, dy in moves.items():
        directions[name] = replace(directions[name], y=dy)
    # The implicit function theorem is valid only if the algebraic equations are satisfied.
    y = solve_states(at, y)
    check_friction(at, y)
    return linearizer.about(at, y, reduced=reduced, directions=directions)


def _starts_along(at: BoundModel, names: Sequence[str]) -> dict[str, Array]:
    known = at.model.sensitivities
    for name in names:
        if name not in known:
            raise ParameterError(
                f"total=True needs sensitivities of the initial states to '{name}': compile "
                f"the model with sensitivities to it{nearest(name, known)}"
            )
    s = find_start(at, {}).s
    return {name: s[:, known.index(name)] for name in names}


def unit_direction(linearizer: Linearizer, at: BoundModel, name: str) -> Direction:
    """Return the unit direction of a parameter, input or state, or else raise ParameterError.

    Along a parameter, inputs of the scene that depend on it change, too.
    """
    model = at.model
    y, u, p = (np.zeros(len(row)) for row in (model.states, model.inputs, model.parameters))
    if name in model.parameters:
        p[model.parameters.index(name)] = 1.0
        if at.u is None:  # inputs of the scene may depend on parameters
            u = linearizer.inputs_by_parameters(at, p)
    elif name in model.inputs:
        u[model.inputs.index(name)] = 1.0
    elif name in model.states:
        y[model.states.index(name)] = 1.0
    else:
        known = [*model.parameters, *model.inputs, *model.states]
        raise ParameterError(
            f"'{brief(name)}' is not a tunable parameter, input or state of the model"
            f"{nearest(name, known)}"
        )
    return Direction(y, u, p)
