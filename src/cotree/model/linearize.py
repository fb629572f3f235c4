"""Linearisation of a model about a state, by the sensitivity graphs of its states and inputs.

In: equations, their derivatives along inputs, and numbers. Out: x' = A x + B u, y = C x + D u for
small deviations, of all states or of independent ones. Algebraic unknowns are eliminated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cotree.dag.evaluate import evaluate
from cotree.dag.multi_output import results
from cotree.dag.traverse import reachable, symbols_in
from cotree.equations import spread
from cotree.errors import Error, SingularSystemError
from cotree.model.algebraic import eliminated
from cotree.model.deviations import Reduced, Slopes, is_same, is_still, reduce
from cotree.model.unknowns import solve_states
from cotree.program.solved import SolvedSystem

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.equations import Derivative, Equations
    from cotree.model.arrays import Array
    from cotree.model.moment import Moment


#: How far to follow a motion, in the state that moves most, to see whether it stays the same.
_ASIDE = 0.1


@dataclass(frozen=True, eq=False, repr=False)
class Linearization:
    """A linear system about a motion: z' = A z + B u, y = C z + D u for small deviations.

    Attributes
    ----------
    A, B, C, D : ndarray
        Shapes (n, n), (n, n_inputs), (n_outputs, n) and (n_outputs, n_inputs) with n deviations;
        units follow from those of states, inputs and outputs.
    states, inputs, outputs : tuple of str
        Names along the axes. Of the full form: the states that have rates. Of the reduced one:
        those that are independent; rotations where a quaternion stands for them, ``EDGE.turn_x``
        to ``turn_z`` along the axes of the edge's first node and their rates, ``turn_x_dot``.
    basis : ndarray, shape (n_states, n)
        The deviations of all states that have rates for a unit of each z: the unit matrix in the
        full form.
    is_steady : bool
        Whether the motion through the point is steady: whatever the independent deviations depend
        on stays as it is, so that the reduced A is constant and its eigenvalues tell stability.
        About any other motion they do not: the system holds at this instant.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    basis: Array
    is_steady: bool

    def __repr__(self) -> str:
        from cotree.model.display import linear_text

        return linear_text(self)

    def _repr_html_(self) -> str:
        """Show the matrices with the names of their rows and columns in a notebook."""
        from cotree.model.display import linear_html

        return linear_html(self)

    @property
    def eigenvalues(self) -> npt.NDArray[np.complex128]:
        """The eigenvalues of A, [1/s], shape (n,): the largest real part first.

        They tell stability as :attr:`is_steady` says.
        """
        found = np.linalg.eigvals(self.A).astype(complex)
        return found[np.lexsort((-found.imag, -found.real))]

    def summary(self) -> str:
        """Say in a sentence what it is about, and what its eigenvalues tell."""
        size = f"{len(self.states)} deviations, {len(self.inputs)} inputs"
        if not self.is_steady:
            return (
                f"{size}, about no steady motion in these coordinates: A holds at this instant, "
                "and unless it is the same along the whole motion its eigenvalues do not tell "
                "stability"
            )
        if len(self.states) == len(self.basis):
            return f"{size}, about a steady motion"
        return f"{size}, about a steady motion: the eigenvalues of A tell stability"


class Linearizer:
    """The derivatives of equations along states and inputs, formed once.

    Parameters
    ----------
    equations : Equations
        The equations; they need no sensitivities.
    input_columns : sequence of Derivative
        Along each input.
    """

    def __init__(self, equations: Equations, input_columns: Sequence[Derivative]) -> None:
        self._equations = equations
        self._nodes, rates = _solved(equations, (*equations.columns, *input_columns))
        rows = equations.constraints
        with_value = [i for i, value in enumerate(rows.values) if value is not None]
        # Column by column: slopes of the values of constraints, then of their rates.
        held = [
            node
            for column in equations.columns
            for node in (*(column.held[i] for i in with_value), *column.held_rates)
        ]
        self._n_values = len(with_value)
        self._others = [*rates, *held]
        found = reachable([*self._nodes, *self._others])
        solves = [node for node in found if node.op == "solve"]
        # The last result of a `solve` tells whether its matrix was regular.
        self._accepted = [results(node, node.data.size + 2)[-1] for node in solves]
        self._symbols = symbols_in([*self._nodes, *self._others, *self._accepted])
        #: Whether time itself stands in the equations, or in the scene's inputs.
        self.is_timed = equations.dag.symbol("t", 0) in found
        self.has_timed_inputs = equations.dag.symbol("t", 0) in reachable(equations.input_values)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states that have rates."""
        n = len(self._equations.states) - self._equations.n_algebraic
        return tuple(state.name for state in self._equations.states[:n])

    def at(self, t: float, y: Sequence[float] | Array, p: Array, u: Array) -> Slopes:
        """Evaluate them.

        Parameters
        ----------
        t : float
            Time, [s].
        y, p, u : ndarray, shapes (n_states,), (n_parameters,), (n_inputs,)
            States, with their algebraic unknowns, parameters and inputs.

        Raises
        ------
        SingularSystemError
            If the mass matrix, or the matrix of the algebraic unknowns, is singular there.
        """
        equations = self._equations
        values = self._values(t, y, p, u)
        with np.errstate(all="ignore"):
            found = evaluate([*self._nodes, *self._others, *self._accepted], values)
        numbers = np.array([float(np.real(v)) for v in found[: len(found) - len(self._accepted)]])
        if not all(found[len(numbers) :]):
            raise SingularSystemError("the mass matrix is singular at this state")
        self._check_finite(numbers[: len(self._nodes)])
        n, m, k = len(equations.states), len(equations.inputs), len(equations.outputs)
        whole, others = np.split(numbers, [len(self._nodes)])
        # The nodes go column by column, along each state and then each input: rates, then outputs.
        whole = whole.reshape(n + m, n + k).T
        rates, held = np.split(others, [n])
        held = held.reshape(n, -1).T if n else held.reshape(0, 0)
        if equations.n_algebraic:
            # States with rates come first; the implicit function theorem eliminates the others.
            n -= equations.n_algebraic
            whole = _without_algebraic(whole, n, equations)
        return Slopes(
            y=np.array(y[:n], dtype=float),
            rates=rates[:n],
            A=whole[:n, :n].copy(),
            B=whole[:n, n:].copy(),
            C=whole[n:, :n].copy(),
            D=whole[n:, n:].copy(),
            held=held[: self._n_values, :n],
            held_rates=held[self._n_values :, :n],
            n_coordinates=equations.n_coordinates,
            n_speeds=equations.n_speeds,
            turns=self._turns,
        )

    @cached_property
    def _turns(self) -> dict[int, int]:
        """Places of the angular velocities that go with each quaternion."""
        equations, names = self._equations, list(self.states)
        symbols = [state.symbol for state in equations.states]
        return {
            # The angular velocities of an edge are w1, w2 and w3, in this order.
            symbols.index(symbols_of_edge[0]): names.index(f"{edge}.w1")
            for edge, symbols_of_edge in equations.constraints.quaternions
        }

    def about(self, at: Moment, y: Array, *, reduced: bool) -> Linearization:
        """Linearise about the motion through a point; see :meth:`cotree.Model.linearize`.

        Parameters
        ----------
        at : Moment
            The model at the point. The scene's inputs change with time, others stay.
        y : ndarray, shape (n_states,)
            The states there.
        reduced : bool
            Whether to linearise in independent deviations.
        """
        point = self.at(at.t, y, at.p, at.inputs)
        found = reduce(point, self.states)
        equations = self._equations
        return Linearization(
            A=found.A if reduced else point.A,
            B=found.B if reduced else point.B,
            C=found.C if reduced else point.C,
            D=point.D,
            states=found.names if reduced else self.states,
            inputs=tuple(row.name for row in equations.inputs),
            outputs=tuple(row.name for row in equations.outputs),
            basis=found.basis if reduced else np.eye(len(point.y)),
            is_steady=is_still(found, point) and self._stays(at, y, point, found),
        )

    def _stays(self, at: Moment, y: Array, point: Slopes, here: Reduced) -> bool:
        """Tell whether the linear equations remain the same along the motion and in time."""
        fastest = float(np.max(np.abs(point.rates), initial=0.0))
        # Nothing moves and nothing depends on time: an equilibrium.
        if not (fastest or self.is_timed or (self.has_timed_inputs and at.u is None)):
            return True
        # As far as the fastest state moves a tenth, and no longer than a tenth of a second.
        step = _ASIDE / max(fastest, 1.0)
        later = replace(at, t=at.t + step)
        y = np.concatenate([self._moved(point, at, y, step), y[len(point.y) :]])
        try:
            y = solve_states(later, y)
            there = self.at(later.t, y, at.p, later.inputs)
        # A motion that cannot be followed has not been shown to be steady.
        except (Error, ArithmeticError, ValueError):
            return False
        moved = reduce(there, self.states, here.names)
        return is_still(moved, there) and is_same(here, moved)

    def _moved(self, point: Slopes, at: Moment, y: Array, step: float) -> Array:
        """Follow the motion for a moment, by the classical method of fourth order."""
        n, u = len(point.y), at.inputs
        slopes = [point.rates]
        for share in (0.5, 0.5, 1.0):
            aside = y.copy()
            aside[:n] += share * step * slopes[-1]
            values = self._values(at.t + share * step, aside, at.p, u)
            # Inputs and algebraic unknowns are held; the latter are solved for at the end.
            rates = evaluate(self._others[: len(self._equations.states)], values)
            slopes.append(np.array([float(np.real(v)) for v in rates[:n]]))
        a, b, c, d = slopes
        moved: Array = y[:n] + step / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        return moved

    def _check_finite(self, numbers: Array) -> None:
        """Refuse derivatives that are not finite, by name."""
        wrong = np.flatnonzero(~np.isfinite(numbers))
        if wrong.size:
            equations = self._equations
            states = [state.name for state in equations.states]
            rows = [*states, *(output.name for output in equations.outputs)]
            columns = [*states, *(row.name for row in equations.inputs)]
            column, row = divmod(int(wrong[0]), len(rows))
            what = "the rate of" if row < len(states) else "output"
            raise SingularSystemError(
                f"the derivative of {what} '{rows[row]}' by '{columns[column]}' is "
                f"{numbers[wrong[0]]} at this state: linearise about another one"
            )

    def _values(
        self, t: float, y: Sequence[float] | Array, p: Array, u: Array
    ) -> Mapping[Node, float]:
        states = zip(self._equations.states, y, strict=True)
        values = {state.symbol: float(value) for state, value in states}
        known: dict[str, Sequence[float] | Array] = {"t": [t], "p": p, "u": u}
        for symbol in self._symbols:  # those that there are: a symbol made now would be shared
            kind, position = symbol.data
            if kind in known:
                values[symbol] = float(known[kind][position])
        return values


def _without_algebraic(whole: Array, cut: int, equations: Equations) -> Array:
    """Eliminate the algebraic unknowns, whose rows and columns are those from ``cut`` on."""
    own = range(cut, cut + equations.n_algebraic)
    # Outputs follow the states, so the algebraic rows and columns are moved behind them.
    order = [*(i for i in range(len(whole)) if i not in own), *own]
    columns = [*(j for j in range(whole.shape[1]) if j not in own), *own]
    moved = whole[np.ix_(order, columns)]
    n = len(own)
    try:
        inverse = np.linalg.inv(moved[-n:, -n:])
    except np.linalg.LinAlgError:
        names = ", ".join(f"'{state.name}'" for state in equations.states[cut:])
        raise SingularSystemError(
            f"the derivatives of the algebraic equations by {names} are singular at this state"
        ) from None
    return eliminated(moved, inverse.dot, len(moved) - n)


def _solved(equations: Equations, columns: Sequence[Derivative]) -> tuple[list[Node], list[Node]]:
    """Form the derivatives of the rates and of the outputs along each column, and the rates."""
    solved = SolvedSystem.of(equations)
    zero, n, k = equations.dag.zero, len(equations.states), len(equations.outputs)
    found = [
        node
        for row in solved.along(columns)
        for node in (*spread(row.rates, n, zero), *spread(row.outputs, k, zero))
    ]
    return found, solved.put(equations.rates)
