"""Ranges of what events look at, between which no zero is missed within a step.

What is linear in states, inputs and time turns round within a step no more often than these, which
the error test resolves. Anything else may pass through zero and return, as the sine of a large
angle does, however small the error is. For each such value the kernel ``event_ranges`` gives a
range of it and of its rate, from ranges of the quantities that it is made of: the largest linear
parts, and what nothing more is known of. The engine divides a step until each range, or that of
each rate, leaves out zero (``templates/runtime/events/cotree_scan.c``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.dag.derivative import tangents
from cotree.dag.lookup import HeldPlane, HeldTable
from cotree.dag.ranges import is_ranged, ranges
from cotree.dag.symbols import INPUT, PIECE, RANGE, STATE, TIME
from cotree.dag.traverse import reachable, symbols_in

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from cotree.dag.nodes import Node
    from cotree.equations import Equations

#: Functions that grow or fall throughout, so that the zeros of their argument tell theirs.
_MONOTONE = frozenset({"sqrt", "asin", "acos", "atan", "sinh", "tanh", "exp", "log", "erf"})

#: Values of more nodes than this are read as they are: their ranges would take longer than steps.
_MOST_NODES = 1000

#: How a value depends on what moves during a step.
_CONSTANT, _LINEAR, _CURVED = range(3)


@dataclass(frozen=True)
class EventRanges:
    """Ranges of what events and corners look at.

    Attributes
    ----------
    places : tuple of int
        The place of each of these among all events, corners behind them; -1: it is linear.
    quantities : tuple of Node
        What they are made of.
    results : tuple of Node
        For each of these four values: ends of its range, and of the range of its rate.
    """

    places: tuple[int, ...]
    quantities: tuple[Node, ...]
    results: tuple[Node, ...]


def find_ranges(equations: Equations, values: Sequence[Node]) -> EventRanges:
    """Form the ranges of some values that pass through zero.

    Parameters
    ----------
    equations : Equations
        The equations.
    values : sequence of Node
        What each event looks at, then each corner, without unknowns.
    """
    dag = equations.dag
    kinds = _kinds(equations, values)
    curved = [
        value
        for value in dict.fromkeys(values)
        if not _is_plain(value, kinds) and len(_inside(value, kinds)) <= _MOST_NODES
    ]
    quantities = _quantities(curved, kinds)
    n = len(quantities)
    symbols = [dag.symbol(RANGE, i) for i in range(4 * n)]
    known = {q: (symbols[i], symbols[n + i]) for i, q in enumerate(quantities)}
    # A rate has a symbol of its own, whose range is put in its place.
    speeds = [dag.symbol(RANGE, 4 * n + i) for i in range(n)]
    known |= {v: (symbols[2 * n + i], symbols[3 * n + i]) for i, v in enumerate(speeds)}
    rates = tangents(curved, dict(zip(quantities, speeds, strict=True)))
    found = ranges([*curved, *rates], known)
    of_values, of_rates = found[: len(curved)], found[len(curved) :]
    numbers = {value: i for i, value in enumerate(curved)}
    return EventRanges(
        tuple(numbers.get(value, -1) for value in values),
        tuple(quantities),
        tuple(end for own, rate in zip(of_values, of_rates, strict=True) for end in (*own, *rate)),
    )


def _kinds(equations: Equations, values: Iterable[Node]) -> dict[Node, int]:
    """Return how each value depends on what moves during a step."""
    still = {
        state.symbol
        for state, rate in zip(equations.states, equations.rates, strict=True)
        if rate.is_zero
    }
    kinds: dict[Node, int] = {}
    for node in reachable(values):
        if node.op == "symbol":
            moves = node.data[0] in (TIME, STATE, INPUT) and node not in still
            kinds[node] = _LINEAR if moves else _CONSTANT
            continue
        if _is_held(node):
            # A sign stays as it is, and enters through the values that it is taken of otherwise.
            kinds[node] = _CONSTANT if node.op == "select" else _LINEAR
            continue
        given = [kinds[arg] for arg in node.args]
        highest = max(given, default=_CONSTANT)
        is_linear = (
            node.op in ("add", "sub", "neg")
            or (node.op == "mul" and _CONSTANT in given)
            or (node.op == "div" and given[1] == _CONSTANT)
            # A piece of a table, held as it is, is a line.
            or isinstance(node.data, HeldTable)
            or (node.op == "result" and isinstance(node.args[0].data, HeldTable))
        )
        kinds[node] = highest if is_linear or highest == _CONSTANT else _CURVED
    return kinds


def _is_held(node: Node) -> bool:
    """Return whether a value is a sign that steps hold, or an end or the number of their piece."""
    if node.op == "select":
        return {symbol.data[0] for symbol in symbols_in(node.args[:1])} == {PIECE}
    data = node.args[0].data if node.op == "result" else None
    if not isinstance(data, (HeldTable, HeldPlane)):
        return False
    name: str = data.results[node.data]
    return name.startswith(("low", "high", "piece"))


def _is_plain(node: Node, kinds: dict[Node, int]) -> bool:
    """Return whether a value is linear, or grows or falls with one that is."""
    if kinds[node] != _CURVED:
        return True
    moving = [arg for arg in node.args if kinds[arg] != _CONSTANT]
    keeps_order = node.op in _MONOTONE or node.op in ("add", "sub", "neg", "mul", "div")
    if node.op == "div" and kinds[node.args[1]] != _CONSTANT:
        return False
    return keeps_order and len(moving) == 1 and len(node.args) <= 2 and _is_plain(moving[0], kinds)


def _is_leaf(node: Node, kinds: dict[Node, int]) -> bool:
    """Return whether a value that moves is read as it is."""
    return kinds[node] == _LINEAR or not is_ranged(node)


def _inside(value: Node, kinds: dict[Node, int]) -> list[Node]:
    """List what a value is made of, as far as the quantities."""
    leaves = {
        node for node in reachable([value]) if kinds[node] != _CONSTANT and _is_leaf(node, kinds)
    }
    return reachable([value], stop=leaves)


def _quantities(values: Sequence[Node], kinds: dict[Node, int]) -> list[Node]:
    """List the quantities that some values are made of, in order of evaluation."""
    found = {
        node
        for value in values
        for node in _inside(value, kinds)
        if kinds[node] != _CONSTANT and _is_leaf(node, kinds)
    }
    return sorted(found, key=lambda node: node.index)
