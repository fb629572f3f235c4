"""Linearisation of a model about a state, by the sensitivity graphs of its states and inputs.

In: equations, their derivatives along inputs, and numbers. Out: x' = A x + B u, y = C x + D u for
small deviations. Algebraic unknowns are eliminated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cotree.dag.evaluate import evaluate
from cotree.dag.several import results
from cotree.dag.traverse import reachable, substitute, symbols_in
from cotree.equations import spread
from cotree.errors import SingularSystemError
from cotree.formulation.elimination import solve_unknowns
from cotree.model.algebraic import eliminated
from cotree.sensitivity.graphs import form_equations, input_columns

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.equations import Derivative, Equations
    from cotree.formulation.first_graph import FirstGraph

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Linearization:
    """A linear system about a state: x' = A x + B u, y = C x + D u.

    Attributes
    ----------
    A, B, C, D : ndarray
        Shapes (n_states, n_states), (n_states, n_inputs), (n_outputs, n_states) and
        (n_outputs, n_inputs); units follow from those of states, inputs and outputs.
    states, inputs, outputs : tuple of str
        Names along the axes; the states are those that have rates.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


class Linearizer:
    """The derivatives of a scene's equations along its states and inputs, formed once."""

    def __init__(self, equations: Equations, input_columns: Sequence[Derivative]) -> None:
        self._equations = equations
        self._nodes = _solved(equations, (*equations.columns, *input_columns))
        solves = [node for node in reachable(self._nodes) if node.op == "solve"]
        self._accepted = [results(node, node.data.size + 2)[-1] for node in solves]
        self._symbols = symbols_in([*self._nodes, *self._accepted])

    @classmethod
    def of(cls, first: FirstGraph) -> Linearizer:
        """Form the equations of a scene and their derivatives."""
        return cls(form_equations(first, ()), input_columns(first))

    def at(self, t: float, y: Sequence[float] | Array, p: Array, u: Array) -> Linearization:
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
        found = evaluate([*self._nodes, *self._accepted], values)
        numbers = np.array([float(np.real(v)) for v in found[: len(self._nodes)]])
        if not all(found[len(self._nodes) :]):
            raise SingularSystemError("the mass matrix is singular at this state")
        n, m, k = len(equations.states), len(equations.inputs), len(equations.outputs)
        whole = numbers.reshape(n + m, n + k).T
        if equations.n_algebraic:
            n -= equations.n_algebraic
            whole = _without_algebraic(whole, n, equations)
        return Linearization(
            A=whole[:n, :n].copy(),
            B=whole[:n, n:].copy(),
            C=whole[n:, :n].copy(),
            D=whole[n:, n:].copy(),
            states=tuple(state.name for state in equations.states[:n]),
            inputs=tuple(row.name for row in equations.inputs),
            outputs=tuple(row.name for row in equations.outputs),
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
    return eliminated(moved, np.asarray(inverse, dtype=np.float64))


def _solved(equations: Equations, columns: Sequence[Derivative]) -> list[Node]:
    """Form the derivatives of the rates and of the outputs along each column."""
    factors, solved = solve_unknowns(equations)
    zero, n, k = equations.dag.zero, len(equations.states), len(equations.outputs)
    found: list[Node] = []
    for column in columns:
        forcing = substitute(column.forcing, solved)
        tangents = dict(zip(equations.unknown_tangents, factors.solve(forcing), strict=True))
        rows = [*spread(column.rates, n, zero), *spread(column.outputs, k, zero)]
        found += substitute(rows, {**solved, **tangents})
    return found
