"""Times at which values jump or have a kink, determined from their nodes.

A condition is the argument of a selection, a sign, an absolute value, a floor or a table. If it
depends only on time and parameters, and is linear in time or in the time since the start of the
current period, the times at which it changes are known before a run. Integration restarts at these
times, so that no pulse is missed and no step contains a kink. Kinks of other conditions are located
during steps (:mod:`cotree.program.surfaces`).

If a law acts only during a part of each period, such as a diode driven by a sine, a long step may
miss this part and the kink in it. Steps are then limited to a fraction of the period.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import chain, product
from typing import TYPE_CHECKING

from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import dependent, reachable

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from cotree.dag.nodes import Dag, Node

#: Operations that jump or have a kink at certain values of their first argument.
_LOOKING = frozenset({"select", "sign", "abs", "floor", "table"})

#: Operations that may be nearly zero during most of a period; if states enter, steps are limited.
_PARTIAL = frozenset({"exp", "tanh", "select", "sign", "abs", "table"})

#: Minimum number of steps per period of a sine of time if such operations depend on states. For
#: example, a rectifier conducts for at least a twentieth of the period.
_SHARES = 32.0

#: Maximum number of linear pieces of a value; the error test of steps handles all other kinks.
_MOST_PIECES = 16


@dataclass(frozen=True)
class TimeEvent:
    """Times ``first + k * period`` for all integers k."""

    first: Node  # function of parameters
    period: Node | None = None  # function of parameters; None for a single time
    starts: bool = False  # whether the events begin at ``first``, so that k >= 0
    #: Derivatives of ``first`` and of the period along each direction.
    along: tuple[tuple[Node, Node], ...] = ()


@dataclass(frozen=True)
class _Count:
    """A number of periods, ``floor(offset + rate * t)``; zero before its start if ``starts``."""

    offset: Node
    rate: Node
    starts: bool


@dataclass(frozen=True)
class _Line:
    """The function ``offset + rate * t + step * count``; if ``starts``, zero before its root.

    The time events of all branches of a selection are used: maybe too many, but never too few.
    """

    offset: Node
    rate: Node
    step: Node
    count: _Count | None = None
    starts: bool = False


def find_time_events(dag: Dag, roots: Iterable[Node]) -> tuple[TimeEvent, ...]:
    """Return the time events of conditions in the roots that depend only on time and parameters."""
    return tuple(dict.fromkeys(chain.from_iterable(time_events_within(dag, roots).values())))


def time_events_within(dag: Dag, roots: Iterable[Node]) -> dict[Node, tuple[TimeEvent, ...]]:
    """Return the time events of each node that may jump or have a kink."""
    order = reachable(roots)
    if not any(node.op in _LOOKING for node in order):
        return {}
    pieces = _all_pieces(dag, order)
    found: dict[Node, tuple[TimeEvent, ...]] = {}
    for node in order:
        if node.op in _LOOKING:
            # Only nodes in ``pieces`` are known functions of time.
            own = (_events_of(node, line) for line in pieces.get(node.args[0], ()))
            found[node] = tuple(dict.fromkeys(chain.from_iterable(own)))
    return found


def is_cut(node: Node) -> bool:
    """Return whether all time-dependent parts of a value are piecewise linear in time.

    Integration then restarts at every change of a condition that depends on the value.
    """
    order = reachable([node])
    pieces = _all_pieces(node.dag, order)
    time = [item for item in order if item.op == "symbol" and item.data[0] == "t"]
    return all(item in pieces for item in dependent(order, time))


def find_longest_steps(dag: Dag, roots: Iterable[Node]) -> tuple[Node, ...]:
    """Return the step size limit for each sine of time, as nodes whose sign may be negative."""
    order = reachable(roots)
    waves = [node for node in order if node.op in ("sin", "cos")]
    pieces = _all_pieces(dag, order) if waves else {}
    lines = (line for node in waves for line in pieces.get(node.args[0], ()))
    # The argument of a sine changes by 2 pi in a period.
    rates = dict.fromkeys(line.rate for line in lines if not line.rate.is_zero)
    return tuple(2.0 * math.pi / _SHARES / rate for rate in rates)


def acts_in_part(roots: Iterable[Node]) -> bool:
    """Return whether an operation that may be zero most of the time depends on states."""
    moving: set[Node] = set()
    for node in reachable(roots):
        is_state = node.op == "symbol" and node.data[0] == "x"
        if is_state or any(arg in moving for arg in node.args):
            moving.add(node)
            if node.op in _PARTIAL:
                return True
    return False


def _all_pieces(dag: Dag, order: Sequence[Node]) -> dict[Node, tuple[_Line, ...]]:
    """Return the lines of all nodes that are piecewise linear in time and have few pieces."""
    pieces: dict[Node, tuple[_Line, ...]] = {}
    # States, inputs and unknowns are known only during a run.
    others = [n for n in order if n.op == "symbol" and n.data[0] not in ("p", "t")]
    moving = dependent(order, others)
    for node in order:
        own = _pieces(dag, node, pieces, node in moving)
        if 0 < len(own) <= _MOST_PIECES:
            pieces[node] = own
    return pieces


def _pieces(
    dag: Dag, node: Node, pieces: Mapping[Node, tuple[_Line, ...]], is_moving: bool
) -> tuple[_Line, ...]:
    """Return a node's lines; empty if the node is not piecewise linear in time."""
    zero = dag.zero
    if node.value is not None or (node.op == "symbol" and node.data[0] == "p"):
        return (_Line(node, zero, zero),)
    if node.op == "symbol":
        return (_Line(zero, dag.one, zero),) if node.data[0] == "t" else ()
    if node.op == "select":
        return _branches(dag, node, pieces)
    if not node.args or not all(arg in pieces for arg in node.args):
        return ()
    rows = [pieces[arg] for arg in node.args]
    # A node that depends only on parameters is a constant line.
    is_fixed = not is_moving and all(_is_fixed(line) for row in rows for line in row)
    if is_fixed and node.op != "result":
        return (_Line(node, zero, zero),)
    if node.op == "abs":
        return (*rows[0], *(_scaled(line, -dag.one) for line in rows[0]))
    if node.op == "sign":
        return tuple(_Line(dag.constant(value), zero, zero) for value in (-1.0, 0.0, 1.0))
    # Combine each piece of one argument with each piece of the others.
    made = [_line(dag, node, choice) for choice in product(*rows)]
    return tuple(dict.fromkeys(line for line in made if line is not None))


def _branches(dag: Dag, node: Node, pieces: Mapping[Node, tuple[_Line, ...]]) -> tuple[_Line, ...]:
    """Return both branches of a selection as linear functions of time."""
    condition, accepted, refused = node.args
    # max(x, 0), which occurs in sources with a delay, is a line that starts at its root.
    if condition is accepted and refused.is_zero and len(pieces.get(accepted, ())) == 1:
        (clipped,) = pieces[accepted]
        if clipped.count is None and not clipped.starts:
            return (_Line(clipped.offset, clipped.rate, dag.zero, starts=True),)
    own = (*pieces.get(accepted, ()), *pieces.get(refused, ()))
    return tuple(dict.fromkeys(own))


def _line(dag: Dag, node: Node, rows: Sequence[_Line]) -> _Line | None:
    """Return an operation on lines as a line, or None if it is not a line."""
    if node.op in ("add", "sub"):
        return _added(rows[0], rows[1], 1.0 if node.op == "add" else -1.0)
    if node.op == "neg":
        return _scaled(rows[0], -dag.one)
    if node.op == "mul" and _is_fixed(rows[0]):
        return _scaled(rows[1], rows[0].offset)
    if node.op == "mul" and _is_fixed(rows[1]):
        return _scaled(rows[0], rows[1].offset)
    if node.op == "div" and _is_fixed(rows[1]) and not rows[1].offset.is_zero:
        return _scaled(rows[0], 1.0 / rows[1].offset)
    if node.op == "floor" and rows[0].count is None:
        count = _Count(rows[0].offset, rows[0].rate, rows[0].starts)
        return _Line(dag.zero, dag.zero, dag.one, count)
    return None


def _is_fixed(line: _Line) -> bool:
    return line.rate.is_zero and line.count is None


def _added(a: _Line, b: _Line, sign: float) -> _Line | None:
    counts = {line.count for line in (a, b) if line.count is not None}
    # Two different counts do not form a line; a sum with a clipped line has a kink at its start.
    if len(counts) > 1 or a.starts or b.starts:
        return None
    return _Line(
        a.offset + b.offset * sign,
        a.rate + b.rate * sign,
        a.step + b.step * sign,
        next(iter(counts), None),
    )


def _scaled(line: _Line, factor: Node) -> _Line:
    scaled = (line.offset * factor, line.rate * factor, line.step * factor)
    return _Line(*scaled, line.count, line.starts)


def _events_of(node: Node, line: _Line) -> list[TimeEvent]:
    """Return the time events of a node whose argument is a line."""
    if line.rate.is_zero:
        return []  # the argument changes only at whole periods, which are events already
    if node.op == "floor" and line.count is None:
        # The argument is an integer at its root, and again after each change by one.
        return [TimeEvent(-line.offset / line.rate, 1.0 / line.rate, line.starts)]
    places = node.data.x if node.op == "table" else (0.0,)
    firsts = [(place - line.offset) / line.rate for place in places]
    if line.count is None:
        return [TimeEvent(first) for first in firsts]
    # Each period shifts the line by its step, so its zeros are periodic.
    period = -line.step / line.rate
    return [TimeEvent(first, period, line.count.starts) for first in firsts]


def longest_step(limits: Iterable[Node], values: Mapping[Node, float]) -> float:
    """Return the smallest limit of the step size, or infinity if there is none."""
    # An infinite rate leads to a limit of zero, which would halt the run: ignore zero and nan.
    sizes = [abs(value_of(limit, values)) for limit in limits]
    return min((size for size in sizes if size > 0.0), default=math.inf)


def value_of(node: Node | None, values: Mapping[Node, float]) -> float:
    """Evaluate a node that depends only on parameters; return nan if it is undefined."""
    if node is None:
        return math.nan
    if node.value is not None:
        return node.value
    return float(evaluate([node], values)[0])
