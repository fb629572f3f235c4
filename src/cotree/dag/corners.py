"""Corners: times at which integration stops and restarts, and their dependence on parameters.

In: stops, as nodes (:mod:`cotree.dag.stops`), and values of parameters. Out: times within a span,
indistinguishable ones merged, with their derivatives. Where rates jump by ``f+ - f-`` at
a time ``t*``, sensitivities of states jump by ``(f- - f+) dt*/dp``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cotree.dag.derivative import tangents
from cotree.dag.stops import SAME, value_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.dag.stops import Stop

#: A run is not cut more often than this: a period far below the span is a mistake in units.
_MOST = 10_000_000


@dataclass(frozen=True)
class Corner:
    """A time at which integration stops, with its derivatives along some directions.

    Attributes
    ----------
    t : float
        The time, [s].
    slopes : tuple of float
        Its derivative along each direction; empty where it changes along none.
    spreads : tuple of float
        Largest difference of these derivatives among all stops that meet at this time.
    scale : float
        Size of the first time of a stop that repeats, whose rounding the corner has, [s].
    """

    t: float
    slopes: tuple[float, ...] = ()
    spreads: tuple[float, ...] = ()
    scale: float = 0.0


def stops_along(stops: Sequence[Stop], seeds: Sequence[Mapping[Node, Node]]) -> tuple[Stop, ...]:
    """Differentiate the times of stops along some directions; see :attr:`Stop.along`.

    Parameters
    ----------
    stops : sequence of Stop
        The stops.
    seeds : sequence of mapping of Node to Node
        Tangents of symbols, for each direction.
    """
    # Stops without a period fill their place with the first time, whose tangent is not used.
    periods = [stop.first if stop.period is None else stop.period for stop in stops]
    found = [tangents([*(stop.first for stop in stops), *periods], seed) for seed in seeds]
    n = len(stops)
    return tuple(
        replace(stop, along=tuple((row[i], row[n + i]) for row in found))
        for i, stop in enumerate(stops)
    )


def find_corners(
    stops: Sequence[Stop],
    values: Mapping[Node, float],
    low: float,
    high: float,
    others: Iterable[float] = (),
) -> list[Corner]:
    """List the times of some stops within a span, ascending, both ends included.

    Times that differ by rounding are one corner, with the slopes of the first of them. At an end of
    the span, whose time is given, slopes are zero; the spreads tell how the stops there move.

    Parameters
    ----------
    stops : sequence of Stop
        The stops.
    values : mapping of Node to float
        Values of the parameters' symbols.
    low, high : float
        The span.
    others : iterable of float
        Further times, which do not change along any direction.

    Raises
    ------
    ValueError
        If a period is so short that there are too many.
    """
    # A corner within rounding of an end is at the end.
    margin = SAME * max(abs(low), abs(high))
    found: list[Corner] = [Corner(at) for at in others]
    for stop in stops:
        found += _corners_of(stop, values, low - margin, high + margin)
    n = max((len(corner.slopes) for corner in found), default=0)
    still = (0.0,) * n
    kept: list[Corner] = []
    # In ascending order each time is compared with the last one that was kept.
    for corner in sorted(found, key=lambda corner: corner.t):
        own = replace(corner, slopes=corner.slopes or still, spreads=still)
        end = next((end for end in (low, high) if _is_same(own.t, end)), None)
        if end is not None:
            # An end stays where it is, whatever the parameters are. Met by a stop that moves, its
            # spread is the slope of that stop.
            own = _met(Corner(end, still, still), own)
        elif not low < own.t < high:
            continue
        if kept and _is_same(own.t, kept[-1].t):
            kept[-1] = _met(kept[-1], own)
        else:
            kept.append(own)
    return kept


def _is_same(a: float, b: float) -> bool:
    return abs(a - b) <= SAME * max(abs(a), abs(b))


def _met(corner: Corner, other: Corner) -> Corner:
    """Merge two corners at the same time."""
    rows = zip(corner.spreads, other.spreads, corner.slopes, other.slopes, strict=True)
    return replace(
        corner,
        spreads=tuple(max(s, o, _differ(a, b)) for s, o, a, b in rows),
        scale=max(corner.scale, other.scale),
    )


def _differ(a: float, b: float) -> float:
    """Give the difference of two slopes, zero where it is rounding."""
    return 0.0 if _is_same(a, b) else abs(a - b)


def _corners_of(stop: Stop, values: Mapping[Node, float], low: float, high: float) -> list[Corner]:
    """List the times of one stop within a span."""
    first, period = value_of(stop.first, values), value_of(stop.period, values)
    if not math.isfinite(first):
        return []
    along = [(value_of(a, values), value_of(b, values)) for a, b in stop.along]
    if stop.period is None or not math.isfinite(period) or period == 0.0:
        return [Corner(first, tuple(a for a, _ in along))]
    # The times are first + k period. The period may be negative, so the ends are sorted.
    ends = sorted((at - first) / period for at in (low, high))
    start, end = math.ceil(ends[0]), math.floor(ends[1])
    # A source that starts at its first time does not repeat before it.
    start = max(start, 0) if stop.starts else start
    if end - start > _MOST:
        raise ValueError(
            f"a period of {period:.6g} s passes {end - start} times in the span: it is too "
            "short for this run; check its unit"
        )
    return [
        Corner(first + k * period, tuple(a + k * b for a, b in along), scale=abs(first))
        for k in range(start, end + 1)
    ]
