"""Directional derivatives of a linearisation, which are second derivatives of the equations.

In: the nodes of a :class:`~cotree.model.linearize.Linearizer`, which are functions of states,
inputs and parameters. Out: their derivatives along any direction. The nodes are differentiated once
along a symbolic direction, which is evaluated for each parameter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cotree.dag.derivative import tangents
from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import (
    INPUT,
    INPUT_CHANGE,
    PARAMETER,
    STATE,
    STATE_CHANGE,
    TUNED_CHANGE,
    symbols_in,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.model.arrays import Array

_CHANGES = {STATE: STATE_CHANGE, INPUT: INPUT_CHANGE, PARAMETER: TUNED_CHANGE}


@dataclass(frozen=True, eq=False)
class Direction:
    """A change of states, inputs and parameters.

    Attributes
    ----------
    y, u, p : ndarray, shapes (n_states,), (n_inputs,) and (n_parameters,)
        Components of the direction; those of algebraic unknowns are recomputed and ignored.
    """

    y: Array
    u: Array
    p: Array


class Variation:
    """Directional derivatives of nodes, formed once for all directions.

    Parameters
    ----------
    dag : Dag
        The graph that owns the nodes.
    nodes : sequence of Node
        Functions of states, inputs, parameters and time.
    """

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
        #: Symbols other than the direction, whose values are needed for evaluation.
        self.symbols = frozenset(found) - frozenset(changes)

    def along(self, values: Mapping[Node, float], direction: Direction) -> Array:
        """Evaluate the derivatives along a direction.

        Parameters
        ----------
        values : mapping of Node to float
            Values of the symbols of states, inputs, parameters and time.
        direction : Direction
            The direction.

        Returns
        -------
        ndarray, shape (n_nodes,)
        """
        by_kind = {
            STATE_CHANGE: direction.y,
            INPUT_CHANGE: direction.u,
            TUNED_CHANGE: direction.p,
        }
        changes = {
            symbol: float(by_kind[kind][place]) for symbol, (kind, place) in self._changes.items()
        }
        with np.errstate(all="ignore"):
            found = evaluate(self._nodes, {**values, **changes})
        return np.array([float(np.real(value)) for value in found])


def eliminated_along(moved: Array, change: Array, cut: int) -> Array:
    """Differentiate the result of :func:`cotree.model.algebraic.eliminated`.

    Parameters
    ----------
    moved, change : ndarray, shape (cut + n, m + n)
        A matrix whose last block is eliminated, and its derivative.
    cut : int
        Number of rows before the block.

    Returns
    -------
    ndarray, shape (cut, m)
    """
    n = len(moved) - cut
    # Schur complement A - B X with X = D^-1 C, hence X' = D^-1 (C' - D' X).
    x = np.linalg.solve(moved[cut:, -n:], moved[cut:, :-n])
    dx = np.linalg.solve(moved[cut:, -n:], change[cut:, :-n] - change[cut:, -n:] @ x)
    found: Array = change[:cut, :-n] - change[:cut, -n:] @ x - moved[:cut, -n:] @ dx
    return found
