"""Index of the values that depend on a symbol, so that a sensitivity graph visits no others."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING

from cotree.dag.traverse import symbols_of_each

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.formulation.first_graph import FirstGraph


@dataclass(frozen=True)
class Reach:
    """Index of the values that depend on each symbol, so that a direction looks at no others.

    Attributes
    ----------
    outputs, initial : mapping of Node to list of int
        Places of outputs and initial values, by symbol.
    moving : tuple of int
        Places of outputs that depend on unknowns, which every direction may change.
    starts : tuple of Node
        The initial values.
    held, pulled : mapping of Node to list of int
        Places of constraints, and of through variables along measures, by symbol: each of them
        involves only two of many bodies.
    """

    outputs: Mapping[Node, list[int]]
    initial: Mapping[Node, list[int]]
    moving: tuple[int, ...]
    starts: tuple[Node, ...]
    held: Mapping[Node, list[int]]
    pulled: Mapping[Node, list[int]]

    @classmethod
    def of(cls, first: FirstGraph, changing: Iterable[Node]) -> Reach:
        """Look at everything that the equations are made of, for symbols that may change."""
        # Only symbols that some direction changes are worth an index.
        among = {*changing, *first.unknowns, *first.measured}
        outputs = _by_symbol(first.outputs.values, among)
        # Reactions in fields of friction hold accelerations.
        unknowns = (*first.unknowns, *first.reactions)
        moving = {i for symbol in unknowns for i in outputs.get(symbol, ())}
        starts = tuple(state.initial for state in first.states)
        rows = first.constraints
        held = [
            # All levels of a constraint: any of them may depend on a symbol that the others do not
            # have.
            [*gradient, rate, bias, *([] if value is None else [value])]
            for gradient, rate, bias, value in zip(
                rows.gradient, rows.rates, rows.biases, rows.values, strict=True
            )
        ]
        pulled = [[row.magnitude, *row.pull.entries] for row in first.applied]
        return cls(
            outputs,
            _by_symbol(starts, among),
            tuple(moving),
            starts,
            _rows_by_symbol(held, among),
            _rows_by_symbol(pulled, among),
        )


def _by_symbol(nodes: Sequence[Node], among: set[Node]) -> dict[Node, list[int]]:
    return _rows_by_symbol([[node] for node in nodes], among)


def _rows_by_symbol(rows: Sequence[Sequence[Node]], among: set[Node]) -> dict[Node, list[int]]:
    found: defaultdict[Node, dict[int, None]] = defaultdict(dict)
    # One pass over all nodes of all rows; `places` tells the row of each.
    places = [i for i, row in enumerate(rows) for _ in row]
    for i, symbols in zip(places, symbols_of_each([*chain(*rows)], among), strict=True):
        for symbol in symbols:
            found[symbol][i] = None
    return {symbol: list(own) for symbol, own in found.items()}


def rows_touched(rows: Mapping[Node, list[int]], symbols: Iterable[Node]) -> list[int]:
    """List the places of rows that depend on some symbols, in order."""
    return sorted({i for symbol in symbols for i in rows.get(symbol, ())})
