"""Time events: times at which integration restarts, and their dependence on parameters.

Time events are given as nodes (:mod:`cotree.dag.switching_times`). For given parameter values, the
times within a span and their derivatives are computed; times that differ only by rounding are
merged. If rates jump by ``f+ - f-`` at a time ``t*``, state sensitivities jump by ``(f- - f+)
dt*/dp``.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cotree.dag.derivative import tangents
from cotree.dag.restart_times import RestartTimes
from cotree.dag.switching_times import TimeEvent, value_of
from cotree.tolerances import SAME

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy.typing as npt

    from cotree.dag.nodes import Node

    FloatArray = npt.NDArray[np.float64]

#: Maximum number of times in a run, and of numbers stored for them; more indicate wrong units.
_MOST, _MOST_NUMBERS = 10_000_000, 30_000_000

#: Up to this number of times, the search takes milliseconds and is not checked against the limit.
_FEW = 100_000


def time_events_along(
    events: Sequence[TimeEvent], seeds: Sequence[Mapping[Node, Node]]
) -> tuple[TimeEvent, ...]:
    """Return the time events with derivatives along each direction (:attr:`TimeEvent.along`)."""
    # For events without a period, ``first`` is a placeholder whose tangent is ignored.
    periods = [event.first if event.period is None else event.period for event in events]
    found = [tangents([*(event.first for event in events), *periods], seed) for seed in seeds]
    n = len(events)
    return tuple(
        replace(event, along=tuple((row[i], row[n + i]) for row in found))
        for i, event in enumerate(events)
    )


def find_restart_times(
    events: Sequence[TimeEvent],
    values: Mapping[Node, float],
    low: float,
    high: float,
    others: Sequence[float] = (),
    time_limit: float | None = None,
) -> RestartTimes:
    """Return the times of time events in the span from ``low`` to ``high``, including both ends.

    Times that differ only by rounding are merged and have the slopes of the first time. The ends of
    the span are fixed and have zero slopes; slopes of events at the ends add to the spreads. The
    additional times ``others`` have zero slopes. Raise ValueError if a period leads to too many
    times, or the search takes longer than ``time_limit``, [s].
    """
    # A time that differs from an end of the span only by rounding is moved to this end.
    margin = SAME * max(abs(low), abs(high))
    m = max((len(event.along) for event in events), default=0)
    series = [_series_of(event, values, low - margin, high + margin) for event in events]
    watch = _Watch(series, len(others), m, time_limit)
    found = [_Times(np.asarray(others, dtype=float), np.zeros((len(others), m)), 0.0)]
    for event, own in zip(events, series, strict=True):
        found.append(_times_of(event, own, values, m))
        watch.check()
    t = np.concatenate([row.t for row in found])
    slopes = np.concatenate([row.slopes for row in found])
    scales = np.repeat([row.scale for row in found], [len(row.t) for row in found])
    watch.check()
    ends = []
    for end in (low, high):
        ends.append(_is_same(t, end))
        watch.check()
    is_kept = ends[0] | ends[1] | ((low < t) & (t < high))
    order = np.flatnonzero(is_kept)
    watch.check()
    order = order[np.argsort(t[order], kind="stable")]
    watch.check()
    t, slopes, at_low, at_high = t[order], slopes[order], ends[0][order], ends[1][order]
    scale = float(np.max(scales[order], initial=0.0))
    watch.check()
    # The ends of the span are fixed, so slopes of events at the ends are stored as spreads.
    at_end = (at_low | at_high)[:, None]
    spreads = np.where(at_end, np.abs(slopes), 0.0)
    slopes = np.where(at_end, 0.0, slopes)
    t = np.where(at_low, low, np.where(at_high, high, t))
    if not len(t):
        return RestartTimes(t, slopes, spreads)
    watch.check()
    starts = np.flatnonzero(np.concatenate([[True], ~_is_same(t[1:], t[:-1])]))
    watch.check()
    first = np.repeat(slopes[starts], np.diff(np.append(starts, len(t))), axis=0)
    watch.check()
    differ = np.where(_is_same(first, slopes), 0.0, np.abs(first - slopes))
    watch.check()
    spreads = np.maximum.reduceat(np.maximum(spreads, differ), starts, axis=0)
    watch.check()
    return RestartTimes(t[starts], slopes[starts], spreads, scale)


def _is_same(a: FloatArray, b: FloatArray | float) -> npt.NDArray[np.bool_]:
    same: npt.NDArray[np.bool_] = np.abs(a - b) <= SAME * np.maximum(np.abs(a), np.abs(b))
    return same


class _Times(NamedTuple):
    """Times of one time event with their derivatives, and the magnitude of the first time."""

    t: FloatArray
    slopes: FloatArray
    scale: float


class _Series(NamedTuple):
    """Times ``first + k * period`` with k from ``start`` to ``end``."""

    first: float
    period: float
    start: int
    end: int

    @property
    def n_times(self) -> int:
        """The number of times."""
        return max(0, self.end - self.start + 1)


class _Watch:
    """Limits of time and memory for the search."""

    def __init__(
        self, series: Sequence[_Series], n_others: int, m: int, limit: float | None
    ) -> None:
        self._limit, self._begun = limit, time.perf_counter()
        self._n = n_others + sum(row.n_times for row in series)
        self._densest = max(series, key=lambda row: row.n_times, default=_Series(0.0, 0.0, 0, -1))
        count, period = self._densest.n_times, abs(self._densest.period)
        # Rounding at the ends of the span may add one event.
        if count > _MOST + 1:
            raise ValueError(
                f"a period of {period:.6g} s occurs {count - 1} times in the span: it is too "
                "short for this run; check its unit"
            )
        if series and (self._n > 2 * _MOST or self._n * (1 + 2 * m) > _MOST_NUMBERS):
            fewer = ", or compile with fewer sensitivities" if m else ""
            raise ValueError(
                f"the span contains {self._n} time events, too many to list; the shortest period "
                f"is {period:.6g} s: check its unit or shorten the span{fewer}"
            )

    def check(self) -> None:
        """Raise ValueError if the time limit is exceeded."""
        if self._limit is None or self._n < _FEW:
            return
        if time.perf_counter() - self._begun > self._limit:
            densest, period = self._densest.n_times, abs(self._densest.period)
            raise ValueError(
                f"the time limit of {self._limit:g} s was exceeded by the search for {self._n} "
                f"time events, {densest} of them with a period of {period:.6g} s: check the unit "
                "of the period, shorten the span, or raise time_limit"
            )


def _series_of(event: TimeEvent, values: Mapping[Node, float], low: float, high: float) -> _Series:
    """Return the range of the times of one time event within a span."""
    first, period = value_of(event.first, values), value_of(event.period, values)
    if not math.isfinite(first):
        return _Series(0.0, 0.0, 0, -1)
    if event.period is None or not math.isfinite(period) or period == 0.0:
        return _Series(first, 0.0, 0, 0)
    # The ends of the span are sorted, since the period may be negative.
    ends = sorted((at - first) / period for at in (low, high))
    start, end = math.ceil(ends[0]), math.floor(ends[1])
    # Events of a source that starts at ``first`` have k >= 0.
    return _Series(first, period, max(start, 0) if event.starts else start, end)


def _times_of(event: TimeEvent, own: _Series, values: Mapping[Node, float], m: int) -> _Times:
    along = np.zeros((2, m))
    if own.n_times:
        for j, row in enumerate(event.along):
            along[:, j] = [value_of(node, values) for node in row]
    if own.period == 0.0:
        return _Times(np.full(own.n_times, own.first), along[: own.n_times], 0.0)
    k = np.arange(own.start, own.end + 1, dtype=float)
    times = own.first + k * own.period
    return _Times(times, along[0] + k[:, None] * along[1], abs(own.first))
