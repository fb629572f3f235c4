"""Grouping of the columns of a map for C, by the values that vanish in them."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce
from itertools import chain, product
from operator import or_
from typing import TYPE_CHECKING

from cotree.dag.linear_map import BLOCK

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.dag.linear_map import LinearMap

#: Operations that moving one value into a vector, zeros alone left out, or out of it costs.
_MOVE = 2
#: Number of times that exchanges of two columns are tried for all pairs; none for many columns.
_SWEEPS, _MOST_COLUMNS = 4, 400


def cost_of_map(linear: LinearMap) -> int:
    """Estimate the cost of a map, in scalar operations."""
    blocks = [linear.given[at : at + BLOCK] for at in range(0, linear.n_columns, BLOCK)]
    n_given = sum(reduce(or_, block).bit_count() for block in blocks)
    # A statement of one block is one vector operation, and so counts like a scalar one.
    return linear.n_times + _MOVE * (n_given + len(blocks) * len(linear.results))


def gather_columns(linear: LinearMap) -> tuple[LinearMap, list[int]]:
    """Put columns with similar zeros into one block, and leave out those that give nothing.

    Two columns of different blocks change places as long as fewer values are then computed.

    Returns
    -------
    (LinearMap, list of int)
        The map of the columns in their new order, and for each its place in the earlier one.
    """
    # The supports, turned over: for each column the statements that are not zero there, as bits.
    nonzero = [0] * linear.n_columns
    for k, node in enumerate(linear.statements):
        support = linear.supports[node]
        while support:
            lowest = support & -support
            nonzero[lowest.bit_length() - 1] |= 1 << k
            support ^= lowest
    # A column in which all results vanish gives nothing, whatever is computed in it.
    found = reduce(or_, (linear.supports[root] for root in linear.results), 0)
    places = [j for j in range(linear.n_columns) if found >> j & 1]
    blocks = [places[at : at + BLOCK] for at in range(0, len(places), BLOCK)]
    for _ in range(_SWEEPS if len(places) <= _MOST_COLUMNS else 0):
        pairs = ((a, b) for a in range(len(blocks)) for b in range(a))
        # Every pair is tried, whether or not the one before it was exchanged.
        if not any([_exchange(blocks[a], blocks[b], nonzero) for a, b in pairs]):
            break
    order = list(chain.from_iterable(blocks))
    return replace(linear, given=tuple(linear.given[j] for j in order)), order


def _exchange(first: list[int], second: list[int], nonzero: Sequence[int]) -> bool:
    """Let columns of two blocks change places where both blocks together then compute less."""
    least = _n_together(first, nonzero) + _n_together(second, nonzero)
    has_changed = False
    for i, k in product(range(len(first)), range(len(second))):
        first[i], second[k] = second[k], first[i]
        found = _n_together(first, nonzero) + _n_together(second, nonzero)
        if found < least:
            least, has_changed = found, True
        else:
            first[i], second[k] = second[k], first[i]
    return has_changed


def _n_together(block: Sequence[int], nonzero: Sequence[int]) -> int:
    """Count the values that are other than zero in some column of a block."""
    union = 0
    for column in block:
        union |= nonzero[column]
    return union.bit_count()
