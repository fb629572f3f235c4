"""Detection of jumps by comparing values on both sides of a point.

The functions test whether a node jumps. For time events
(:mod:`cotree.dag.switching_times`), the results are nodes that are negative if the value jumps. For
other conditions, the value is evaluated along random motions with random parameters. For a single
condition, its two branches are compared at its zeros.
"""

from __future__ import annotations

import math
import random
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import PARAMETER, dependent, reachable, substitute, symbols_in, ways_to_zero
from cotree.dag.switching_times import find_time_events, time_events_within

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    import numpy.typing as npt

    from cotree.dag.nodes import Dag, Node

    Array = npt.NDArray[np.float64]
    Places = npt.NDArray[np.intp]
    #: Function from an array of times to the values of all symbols.
    _Motion = Callable[[Array], Mapping[Node, Array]]

#: Type of the compared values: nodes of parameters, or numbers.
_Value = TypeVar("_Value", "Node", float)

# Operations that may jump if their first argument is zero or an integer.
_JUMPING = frozenset({"select", "sign", "floor"})

# Values are compared at this distance from a time, relative to the time: about a thousand rounding
# errors, and less than the pulse edges that double precision resolves well. The second number, [s],
# is added for times near zero.
_NEAR, _NEAR_ZERO = 1e-12, 1e-18

# A change across a time is a jump if it exceeds the sum of two terms: the first number times the
# changes on both sides (slopes), and the second number times the values (rounding).
_STEEP, _ROUNDING = 10.0, 1e-10

# Random points on a boundary are examined in blocks, which end at these numbers of points. Both
# branches must agree at _N_SHOWN points.
_BLOCKS, _N_SHOWN = (0, 20, 600), 12

# Range of random magnitudes, as powers of ten. A third of the values is instead drawn near a
# constant of the law.
_SIZES = (-3.0, 1.5)

# Distances from a boundary at which both branches are compared, relative to the symbol that is
# varied. From each distance to the next, the difference must fall by the factor _FALLS, or below
# rounding: _FLOOR times the largest value. A difference that varies as the fifth root of the
# distance still passes; a jump does not decrease.
_DISTANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10)
_FALLS, _FLOOR = 0.5, 1e-12

_MOST_SECANTS = 30

# Shortest and longest sampled time on both sides of zero, [s]; number of times, which form a
# geometric series; number of motions.
_SHORTEST, _LONGEST, _N_TIMES, _N_MOTIONS = 1e-12, 1e6, 270, 3


def margins(dag: Dag, value: Node, time: Node) -> list[Node]:
    """Return functions of parameters that are negative if a value jumps at a time event."""
    found: dict[Node, None] = {}
    for event in find_time_events(dag, [value]):
        times = [event.first]
        if event.period is not None:
            # The first event may differ from later ones, for example at the start of a source.
            times.append(event.first + event.period)
        for at in times:
            way = _NEAR * dag.function("abs", at) + _NEAR_ZERO
            # Two values on each side show the slope, which is no jump.
            sides = [at - 3.0 * way, at - way, at + way, at + 3.0 * way]
            values = [substitute([value], {time: side})[0] for side in sides]
            # The dictionary serves as an ordered set and removes equal margins.
            found[_margin(values, lambda node: dag.function("abs", node))] = None
    return list(found)


def _margin(values: Sequence[_Value], size: Callable[[_Value], _Value]) -> _Value:
    """Return the change that slopes and rounding explain, minus the change across the time."""
    a, b, c, d = values
    allowed = (size(b - a) + size(d - c)) * _STEEP + (size(b) + size(c)) * _ROUNDING
    return allowed - size(c - b)


def have_time_events(dag: Dag, value: Node, moving: Sequence[Node]) -> bool:
    """Return whether time events are known for all conditions at which a value may jump."""
    known = time_events_within(dag, [value])
    return all(known.get(node) for node in _conditions(value, moving))


def jumps_at_time_events(dag: Dag, value: Node, time: Node) -> bool:
    """Return whether a value jumps, or is undefined, at one of its time events.

    Other symbols are continuous in time; they have random values.
    """
    # The fixed seed makes the result reproducible.
    found, numbers = margins(dag, value, time), random.Random(1)
    for _ in range(_N_MOTIONS if found else 0):
        place = _motion(found, (), time, numbers)(np.zeros(1))
        # "not >=" also counts nan, an undefined value, as a jump.
        if not (_values(found, place) >= 0.0).all():
            return True
    return False


def _conditions(value: Node, moving: Sequence[Node]) -> list[Node]:
    """Return the conditions that depend on ``moving`` and at whose zeros a value may jump."""
    found = [node for node in reachable([value]) if node.op in _JUMPING]
    return [node for node in found if not set(symbols_in(node.args[:1])).isdisjoint(moving)]


def may_jump(value: Node, moving: Sequence[Node], time: Node) -> bool:
    """Return whether a value jumps along a random motion, or a condition has no sampled zero."""
    conditions = _conditions(value, moving)
    numbers = random.Random(1)
    met: set[Node] = set()
    for _ in range(_N_MOTIONS):
        motion = _motion([value], moving, time, numbers)
        for condition in conditions:
            for t in _crossings(condition, motion):
                met.add(condition)
                if _jumps(value, motion, t):
                    return True
    # Without a crossing, a condition cannot be assessed: assume a jump.
    return len(met) < len(conditions)


def _motion(
    roots: Sequence[Node], moving: Sequence[Node], time: Node, numbers: random.Random
) -> _Motion:
    """Return a random motion: ``moving`` symbols are linear in time, all others are constant."""
    symbols = [symbol for symbol in symbols_in(roots) if symbol is not time]
    starts = {symbol: numbers.uniform(0.3, 2.0) for symbol in symbols}
    rates = {
        symbol: numbers.uniform(-1.0, 1.0) if symbol in set(moving) else 0.0 for symbol in symbols
    }

    def at(t: Array) -> Mapping[Node, Array]:
        return {time: t} | {s: start + rates[s] * t for s, start in starts.items()}

    return at


def _values(
    roots: Sequence[Node], given: Mapping[Node, Array], order: Sequence[Node] | None = None
) -> Array:
    """Evaluate nodes for arrays of n values, shape (n_roots, n); undefined values are nan."""
    size = len(next(iter(given.values())))
    with np.errstate(all="ignore"):
        try:
            found = evaluate(roots, given, "array", order)
        except (ArithmeticError, ValueError):
            return np.full((len(roots), size), math.nan)
    return np.array([np.broadcast_to(value, size) for value in found])


def _crossings(condition: Node, motion: _Motion, most: int = 4) -> list[float]:
    """Return the first times, exact to rounding, at which a condition changes sign in a motion."""
    looked = condition.args[0]

    def side(t: Array) -> Array:
        (values,) = _values([looked], motion(t))
        own = np.floor(values) if condition.op == "floor" else np.copysign(1.0, values)
        found: Array = np.where(np.isnan(values), values, own)
        return found

    # The spacing of times is geometric, since the time scale of the scene is unknown.
    ratio = (_LONGEST / _SHORTEST) ** (1.0 / _N_TIMES)
    ahead = [_SHORTEST * ratio**k for k in range(_N_TIMES)]
    times = [*(-t for t in reversed(ahead)), 0.0, *ahead]
    sides = side(np.array(times)).tolist()
    found: list[float] = []
    for i in range(len(times) - 1):
        a, b, before = times[i], times[i + 1], sides[i]
        if len(found) == most:
            break
        if before == sides[i + 1] or math.isnan(before) or math.isnan(sides[i + 1]):
            continue
        # Bisect until a and b are neighbouring doubles.
        while a < (middle := 0.5 * (a + b)) < b:
            is_before = side(np.array([middle]))[0] == before
            a, b = (middle, b) if is_before else (a, middle)
        found.append(b)
    return found


def _jumps(value: Node, motion: _Motion, t: float) -> bool:
    """Return whether a value jumps at a time; see :func:`margins`."""
    way = _NEAR * abs(t) + _NEAR_ZERO
    (values,) = _values([value], motion(t + way * np.array([-3.0, -1.0, 1.0, 3.0])))
    # "not >=" also counts nan as a jump.
    return not _margin(values.tolist(), abs) >= 0.0


def kink_symbols(node: Node, moving: Iterable[Node]) -> frozenset[Node]:
    """Return the symbols in ``moving`` on which the kinks of a continuous value depend."""
    order = reachable([node])
    changing = dependent(order, moving)
    looked_at = [
        item.args[0]
        for item in order
        if item.op in ("select", "sign", "abs", "floor", "table") and item.args[0] in changing
    ]
    return frozenset(symbols_in(looked_at))


def agree_at(above: Node, below: Node, boundary: Node) -> bool:
    """Return whether two branches agree at all zeros of a boundary.

    They agree if they become the same node when the boundary is replaced by zero, or one of its
    terms by the others. Otherwise they are compared at random points on the boundary. The result is
    false if they differ at one point, or if the points cover only one side of a further condition
    inside the branches, unless this condition has the same value at all points.
    """
    return _folds(above - below, boundary) or _Boundary(above, below, boundary).is_continuous()


def _folds(difference: Node, boundary: Node) -> bool:
    """Return whether a difference simplifies to the constant zero on a boundary."""
    try:
        return any(substitute([difference], way)[0].is_zero for way in ways_to_zero(boundary))
    except (ArithmeticError, ValueError):  # undefined at the boundary
        return False


class _Boundary:
    """Comparison of two branches at random points on the boundary between them."""

    def __init__(self, above: Node, below: Node, boundary: Node) -> None:
        order = reachable([boundary, above, below])
        self._symbols = symbols_in(order)
        # Parameters are constant during a run, so they are varied only if there are no variables.
        looked_at = symbols_in([boundary])
        self._moved = [symbol for symbol in looked_at if symbol.data[0] != PARAMETER] or looked_at
        own = _argument(boundary)
        conditions = {node.args[0]: None for node in order if node.op in (*_JUMPING, "abs")}
        self._conditions = [node for node in conditions if _argument(node) is not own]
        self._roots = [boundary, above, below, *self._conditions]
        self._order, self._own = order, reachable([boundary])
        constants = {abs(node.value) for node in order if node.op == "constant" and node.value}
        self._constants = sorted(value for value in constants if math.isfinite(value))

    @np.errstate(all="ignore")
    def is_continuous(self) -> bool:
        """Return whether both branches agree at all tested points, and enough points are tested."""
        n_shown, met = 0, [set[float]() for _ in self._conditions]
        for first, end in pairwise(_BLOCKS) if self._moved else ():
            is_met, values = self._compare(first, end)
            for agrees, conditions in zip(is_met, values.T, strict=True):
                if not agrees:
                    return False
                n_shown += 1
                for known, value in zip(met, conditions, strict=True):
                    known.add(value)
                if n_shown >= _N_SHOWN and all(map(_is_covered, met)):
                    return True
        return False

    def _draw(self, first: int, end: int) -> dict[Node, Array]:
        """Return random values of all symbols for the trials ``first`` to ``end``."""
        place = {}
        for i, symbol in enumerate(self._symbols):
            exponents, which, constants, factors, signs = _uniform(i)[:, first:end]
            low, high = _SIZES
            sizes = 10.0 ** (low + (high - low) * exponents)
            if self._constants:
                near = np.array(self._constants)[(constants * len(self._constants)).astype(int)]
                near = near * np.array([0.5, 1.0, 2.0])[(3.0 * factors).astype(int)]
                sizes = np.where(which < 1 / 3, near, sizes)
            place[symbol] = np.where(signs < 0.5, sizes, -sizes)
        return place

    def _compare(self, first: int, end: int) -> tuple[Array, Array]:
        """Return for each valid trial whether the branches agree, and other conditions' values.

        A trial varies one symbol. It is invalid if no value of this symbol lies on the boundary, or
        if a branch is undefined near the boundary. Conditions have shape (n_conditions, n_valid).
        """
        place = self._draw(first, end)
        # Index of the symbol that each trial varies.
        which = np.arange(first, end) % len(self._moved)
        start = np.array([place[symbol] for symbol in self._moved])[which, np.arange(end - first)]

        def moved(at: Array, trials: Places) -> dict[Node, Array]:
            """Return all symbols' values in ``trials``; the varied symbol has the values ``at``."""
            n, own = len(at), which[trials]
            given = {symbol: np.tile(values[trials], n) for symbol, values in place.items()}
            for k, symbol in enumerate(self._moved):
                given[symbol] = np.where(np.tile(own == k, n), at.ravel(), given[symbol])
            return given

        def boundary(at: Array, trials: Places) -> Array:
            found: Array = _values(self._roots[:1], moved(at[None], trials), self._own)[0]
            return found

        at = _zeros(boundary, start)
        trials = np.flatnonzero(np.isfinite(at))
        at, start = at[trials], start[trials]
        scale = np.maximum(np.abs(start), np.abs(at))
        steps = [sign * distance for distance in (0.0, *_DISTANCES) for sign in (1.0, -1.0)]
        near = at + np.array(steps)[:, None] * scale
        values = _values(self._roots, moved(near, trials), self._order)
        # Values on both sides of the boundary, shape (n_roots, n_distances, 2, n_trials).
        sides = values.reshape(len(values), len(_DISTANCES) + 1, 2, -1)
        conditions, (side, above, below) = sides[3:, 0, 0], sides[:3, 1:]
        is_above = side[:, 0] > 0.0
        above = np.where(is_above, above[:, 0], above[:, 1])
        below = np.where(is_above, below[:, 1], below[:, 0])
        gaps = np.abs(above - below)
        is_valid = ((np.sign(side).prod(axis=1) < 0.0) & np.isfinite(gaps)).all(axis=0)
        floor = _FLOOR * np.maximum(np.abs(above), np.abs(below)).max(axis=0)
        is_met = (gaps[1:] <= np.maximum(_FALLS * gaps[:-1], floor)).all(axis=0)
        return is_met[is_valid], conditions[:, is_valid]


@cache
def _uniform(column: int) -> Array:
    """Return reproducible random numbers between 0 and 1 for the symbol with index ``column``."""
    numbers = random.Random(column)
    return np.array([numbers.random() for _ in range(5 * _BLOCKS[-1])]).reshape(5, -1)


def _zeros(function: Callable[[Array, Places], Array], start: Array) -> Array:
    """Return a zero near each start by the secant method, or nan if it does not converge.

    ``function`` receives arguments and the indices of their starts.
    """
    found, places = np.full(start.shape, math.nan), np.arange(len(start))
    a, b = start, 1.1 * start + 0.1
    at_a, at_b = function(a, places), function(b, places)
    for _ in range(_MOST_SECANTS):
        is_zero = at_b == 0.0
        found[places[is_zero]] = b[is_zero]
        is_open = ~is_zero & np.isfinite(at_b - at_a) & (at_b != at_a)
        a, b, at_a, at_b, places = (row[is_open] for row in (a, b, at_a, at_b, places))
        a, b, at_a = b, b - at_b * (b - a) / (at_b - at_a), at_b
        has_ended = np.abs(b - a) <= 1e-15 * np.abs(b)
        found[places[has_ended]] = b[has_ended]
        a, b, at_a, places = (row[~has_ended] for row in (a, b, at_a, places))
        if not len(places):
            break
        at_b = function(b, places)
    return found


def _argument(node: Node) -> Node:
    """Return a condition without its sign and constant factor."""
    while node.op == "neg" or (node.op == "mul" and node.args[0].value is not None):
        node = node.args[-1]
    return node


def _is_covered(values: set[float]) -> bool:
    """Return whether the values of a condition are on both sides of zero, or are constant."""
    low, high = min(values), max(values)
    return low < 0.0 < high or high - low <= _FLOOR * max(abs(low), abs(high))
