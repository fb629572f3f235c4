"""Inputs of a run: numbers, expressions, tables or functions in place of the scene's own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.dag.evaluate import evaluate
from cotree.dag.multi_output import Table, table
from cotree.dag.nodes import Dag
from cotree.dag.traverse import reachable
from cotree.errors import ExpressionError, ParameterError, nearest
from cotree.scene.tables import parse_signal

if TYPE_CHECKING:
    from cotree.dag.nodes import Node
    from cotree.model.arrays import Array
    from cotree.scene.expressions import Expression

Signal = Callable[[float], float]


@dataclass(frozen=True)
class ReplacedInputs:
    """The inputs that a run puts in place of the scene's.

    Attributes
    ----------
    by_position : mapping of int to callable
        The replaced inputs, by their place in u, as functions of time.
    breakpoints : tuple of float
        Times where a table has a kink.
    parameters : mapping of str to frozenset of str
        The names that each replaced input's expression uses.
    tables : mapping of int to (times, values)
        The replaced inputs that are numbers or tables.
    """

    by_position: Mapping[int, Signal]
    breakpoints: tuple[float, ...]
    parameters: Mapping[str, frozenset[str]]
    tables: Mapping[int, tuple[Array, Array]] = field(default_factory=dict)

    def apply(self, t: float, u: Array) -> Array:
        """Replace entries of u at a time, in place."""
        for position, signal in self.by_position.items():
            u[position] = signal(t)
        return u


def read_signals(
    values: Mapping[str, Any], names: tuple[str, ...], parameters: Mapping[str, float]
) -> ReplacedInputs:
    """Read the inputs of a run.

    Parameters
    ----------
    values : mapping of str to number, str, (times, values) or callable
        By name of the input.
    names : tuple of str
        The model's inputs.
    parameters : mapping of str to float
        Parameters that expressions may use besides ``t``.

    Raises
    ------
    ParameterError
        If a name is not an input.
    ModelError
        If a value is not accepted.
    """
    by_position: dict[int, Signal] = {}
    breakpoints: list[float] = []
    used: dict[str, frozenset[str]] = {}
    tables: dict[int, tuple[Array, Array]] = {}
    for name, value in values.items():
        if name not in names:
            raise ParameterError(f"the model has no input '{name}'{nearest(name, names)}")
        if callable(value):
            by_position[names.index(name)] = value
            continue
        parsed = parse_signal(value, f"input '{name}'")
        if isinstance(parsed, Table):
            breakpoints += parsed.x
            tables[names.index(name)] = np.array(parsed.x), np.array(parsed.y)
        else:
            used[name] = parsed.names
            if isinstance(value, (int, float)):
                # A table of one point is constant, and C reads it without asking Python.
                tables[names.index(name)] = np.zeros(1), np.array([float(value)])
        by_position[names.index(name)] = _function_of_time(parsed, parameters)
    return ReplacedInputs(by_position, tuple(breakpoints), used, tables)


def _function_of_time(value: Expression | Table, parameters: Mapping[str, float]) -> Signal:
    """Make a function of time by evaluating nodes."""
    # An arena of its own: these nodes are evaluated in Python and never meet those of the model.
    dag = Dag()
    time = dag.symbol("t", 0)

    def resolve(name: str) -> Node:
        if name == "t":
            return time
        if name in parameters:
            return dag.constant(parameters[name])
        raise ExpressionError(
            f"uses '{name}', but may depend on parameters and t only{nearest(name, parameters)}"
        )

    node = table(dag, value, time)[0] if isinstance(value, Table) else value.lower(dag, resolve)
    order = reachable([node])

    def signal(t: float) -> float:
        return float(evaluate([node], {time: t}, order=order)[0])

    return signal
