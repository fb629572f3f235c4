"""Ranges of values: interval arithmetic with nodes.

The range of a value is given by two nodes, which bound the value while the quantities on which it
depends are within their own ranges. A range may be too wide, since arguments are treated as
independent; it shrinks to the value as the ranges of the quantities shrink. A value without bounds,
such as a quotient whose divisor may be zero, has a range with the ends :data:`ENDLESS`, or nan, for
which all comparisons are false.
"""

from __future__ import annotations

import math
from functools import partial, reduce
from itertools import pairwise
from typing import TYPE_CHECKING

from cotree.dag.lookup import HeldTable, LinearTable
from cotree.dag.nodes import reachable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from cotree.dag.nodes import Dag, Node

#: Magnitude of the ends of an unbounded range, finite because constants must be finite.
ENDLESS = 1e300

Range = tuple["Node", "Node"]

_INCREASING = frozenset({"exp", "sinh", "tanh", "atan", "erf", "sign", "floor"})


def is_ranged(node: Node) -> bool:
    """Return whether a node's range can be computed from the ranges of its arguments."""
    if node.op == "result":
        return isinstance(node.args[0].data, LinearTable)
    return node.op in _RULES or isinstance(node.data, LinearTable)


def ranges(roots: Iterable[Node], known: Mapping[Node, Range]) -> list[Range]:
    """Return a lower and an upper bound of each root as nodes.

    The roots consist of operations that :func:`is_ranged` accepts; ``known`` has the ranges of
    quantities. Values that depend on no quantity are constant.
    """
    roots = list(roots)
    found = dict(known)
    for node in reachable(roots, stop=known):
        if node in known or not any(arg in found for arg in node.args):
            continue
        if node.op == "result":
            found[node] = _of_table(node, found[node.args[0]])
        elif isinstance(node.data, LinearTable):
            found[node] = found[node.args[0]]  # its results have the same range
        else:
            found[node] = _RULES[node.op](node, [found.get(arg, (arg, arg)) for arg in node.args])
    return [found.get(root, (root, root)) for root in roots]


def _least(values: Sequence[Node]) -> Node:
    return reduce(lambda least, x: x.dag.select(least - x, x, least), values)


def _largest(values: Sequence[Node]) -> Node:
    return reduce(lambda largest, x: x.dag.select(largest - x, largest, x), values)


def _hull(values: Iterable[Node]) -> Range:
    values = list(dict.fromkeys(values))
    return _least(values), _largest(values)


def _endless(dag: Dag) -> Range:
    return dag.constant(-ENDLESS), dag.constant(ENDLESS)


def _where(condition: Node, accepted: Range, refused: Range) -> Range:
    dag = condition.dag
    low, high = (dag.select(condition, a, b) for a, b in zip(accepted, refused, strict=True))
    return low, high


def _of_product(node: Node, given: Sequence[Range]) -> Range:
    (a, b), (c, d) = given
    if node.args[0] is node.args[1]:
        return _of_even(node.dag, given[0], lambda x: x * x)
    if a.value is not None and a is b:
        return (a * c, a * d) if a.value >= 0.0 else (a * d, a * c)
    return _hull([x * y for x in (a, b) for y in (c, d)])


def _of_quotient(node: Node, given: Sequence[Range]) -> Range:
    (a, b), (c, d) = given
    if c is d:
        return _hull([a / c, b / c])
    if c.is_zero or d.is_zero:
        return _endless(node.dag)
    # The product of the ends of the divisor is positive if the divisor cannot be zero.
    corners = _hull([x / y for x in (a, b) for y in (c, d)])
    return _where(-(c * d), _endless(node.dag), corners)


def _of_even(dag: Dag, given: Range, function: Callable[[Node], Node]) -> Range:
    """Return the range of a function that decreases for x < 0 and increases for x > 0."""
    low, high = given
    ends = function(low), function(high)
    least = dag.select(low, ends[0], dag.select(-high, ends[1], function(dag.zero)))
    return least, _largest(ends)


def _of_wave(node: Node, given: Sequence[Range]) -> Range:
    """Return the range of a sine or cosine; extrema within the argument's range count."""
    dag, (low, high) = node.dag, given[0]
    ends = [dag.function(node.op, end) for end in (low, high)]
    first = 0.25 if node.op == "sin" else 0.0  # position of the maximum, in periods

    def passed(phase: float) -> Node:
        count = [dag.function("floor", end / (2.0 * math.pi) - phase) for end in (low, high)]
        return count[1] - count[0] - 0.5

    return (
        dag.select(passed(first + 0.5), -dag.one, _least(ends)),
        dag.select(passed(first), dag.one, _largest(ends)),
    )


def _of_tangent(node: Node, given: Sequence[Range]) -> Range:
    dag, (low, high) = node.dag, given[0]
    count = [dag.function("floor", end / math.pi + 0.5) for end in (low, high)]
    ends = dag.function("tan", low), dag.function("tan", high)
    return _where(count[1] - count[0] - 0.5, _endless(dag), ends)


def _of_increasing(node: Node, given: Sequence[Range]) -> Range:
    dag, (low, high) = node.dag, given[0]
    return dag.function(node.op, low), dag.function(node.op, high)


def _within(given: Range, low: float, high: float) -> Range:
    """Return a range clipped to the domain of a function."""
    dag = given[0].dag
    a, b = (_least([_largest([end, dag.constant(low)]), dag.constant(high)]) for end in given)
    return a, b


def _of_arc(node: Node, given: Sequence[Range]) -> Range:
    low, high = _of_increasing(node, [_within(given[0], -1.0, 1.0)])
    return (low, high) if node.op == "asin" else (high, low)


def _of_angle(node: Node, given: Sequence[Range]) -> Range:
    """Return the range of atan2: from corners, or -pi to pi if it may jump or be undefined."""
    dag, (y, x) = node.dag, given
    corners = _hull([dag.function("atan2", a, b) for a in y for b in x])
    anything = dag.constant(-math.pi), dag.constant(math.pi)
    is_right = dag.select(-x[0], -dag.one, dag.one)
    is_aside = dag.select(-(y[0] * y[1]), -dag.one, dag.one)
    return _where(_largest([is_right, is_aside]), corners, anything)


def _of_selection(node: Node, given: Sequence[Range]) -> Range:
    (low, high), accepted, refused = given
    both = _hull([accepted[0], refused[0]])[0], _hull([accepted[1], refused[1]])[1]
    return _where(low, accepted, _where(high, both, refused))


def _of_sum(node: Node, given: Sequence[Range]) -> Range:
    (a, b), (c, d) = given
    return (a + c, b + d) if node.op == "add" else (a - d, b - c)


def _of_table(node: Node, given: Range) -> Range:
    """Return the range of a piecewise linear table's result; ``given`` is the argument's range."""
    held, dag = node.args[0], node.dag
    data: LinearTable = held.data
    place: int = node.data
    slopes = [
        (y1 - y0) / (x1 - x0)
        for (x0, x1), (y0, y1) in zip(pairwise(data.x), pairwise(data.y), strict=True)
    ]
    is_held = isinstance(data, HeldTable)
    ends = [
        dag.several(held.op, [end, *held.args[1:]], data, 5 if is_held else 2)[place]
        for end in given
    ]
    if place == 1:
        slopes = [*slopes, 0.0]  # outside the table
        of_all = dag.constant(min(slopes)), dag.constant(max(slopes))
        # The slope in a frozen interval is constant.
        return (
            _where(-dag.function("abs", held.args[1]), of_all, _hull(ends)) if is_held else of_all
        )
    if place > 1 or min(slopes) >= 0.0 or max(slopes) <= 0.0:
        return _hull(ends)  # the function is monotonic
    # Half the width times the steepest slope bounds the deviation from the mean of the ends.
    steepest = max(map(abs, slopes))
    mean = 0.5 * (ends[0] + ends[1])
    reach = 0.5 * steepest * (given[1] - given[0])
    return mean - reach, mean + reach


_RULES: dict[str, Callable[[Node, Sequence[Range]], Range]] = {
    "add": _of_sum,
    "sub": _of_sum,
    "neg": lambda node, given: (-given[0][1], -given[0][0]),
    "mul": _of_product,
    "div": _of_quotient,
    "sin": _of_wave,
    "cos": _of_wave,
    "tan": _of_tangent,
    "sqrt": lambda node, given: _of_increasing(node, [_within(given[0], 0.0, ENDLESS)]),
    "log": lambda node, given: _of_increasing(node, [_within(given[0], 1.0 / ENDLESS, ENDLESS)]),
    "asin": _of_arc,
    "acos": _of_arc,
    "atan2": _of_angle,
    # Bounds are nan if the base may be negative, even for integer exponents.
    "pow": lambda node, given: _hull([node.dag.pow(a, b) for a in given[0] for b in given[1]]),
    "select": _of_selection,
    "abs": lambda node, given: _of_even(node.dag, given[0], partial(node.dag.function, "abs")),
    "cosh": lambda node, given: _of_even(node.dag, given[0], partial(node.dag.function, "cosh")),
    **dict.fromkeys(_INCREASING, _of_increasing),
}
