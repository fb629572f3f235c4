"""Evenly spaced frame times, and the coordinates of a run at these times.

Between points, each coordinate is the quintic Hermite polynomial of its values, rates and
accelerations at both ends. For a sine with angular frequency w and step h, the error is
(w h)^6/46080 of the amplitude: 3e-5 for six points per period.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from cotree.components import FreeRotation
from cotree.dag.vector import quaternion_rates
from cotree.errors import Error, SceneError
from cotree.scene.expressions import check_number, check_positive

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cotree.formulation.system import System
    from cotree.model.model import CompiledModel
    from cotree.solvers import RunRecord
    from cotree.spec import BuildSpec
    from cotree.watch.shapes import Array

#: Largest number of frames, and of frames times bodies, of an animation.
MOST_FRAMES, MOST_POSES = 2000, 300_000
_FEWEST = 100  # minimum limit of frames, even with many bodies

# Shortest and longest runs shown in real time, and approximate duration of other animations, [s].
_SHORTEST, _LONGEST = 2.0, 30.0
_COMFORTABLE = 8.0
_PATIENCE = 86_400.0  # maximum duration of an animation, [s]


class WatchedModel(Protocol):
    """The attributes of :class:`cotree.Model` that animations need."""

    states: tuple[str, ...]
    kernels: CompiledModel

    @property
    def spec(self) -> BuildSpec:
        """The specification of the model, which provides the first graph."""

    def rhs(self, t: float, y: Any, p: Any = None, u: Any = None) -> Array:
        """Evaluate the rates of the states; see :meth:`cotree.Model.rhs`."""
        ...


@dataclass(frozen=True, eq=False)
class Moments:
    """Evenly spaced times of a run."""

    times: Array  # times of the run, [s]
    pause: float  # time between frames of the animation, [s]

    @property
    def speed(self) -> float:
        """Ratio of run time to animation time."""
        if len(self.times) < 2:
            return 1.0
        return abs(float(self.times[1] - self.times[0])) / self.pause


def choose_frames(
    start: float, end: float, fps: float, speed: float | None, n_bodies: int = 1
) -> Moments:
    """Return evenly spaced frame times of a run, [s]; ``fps`` frames are shown per second.

    ``speed`` is the ratio of run time to animation time; by default it is 1 for a run of 2 to 30 s,
    else 1, 2 or 5 times a power of ten.
    """
    if not 1.0 <= check_number(fps, "fps") <= 100.0:
        raise SceneError(f"fps is {fps:g}: give 1 to 100 frames per second")
    span = abs(end - start)
    if speed is None:
        is_comfortable = span == 0.0 or _SHORTEST <= span <= _LONGEST
        speed = 1.0 if is_comfortable else _round(span / _COMFORTABLE)
    else:
        check_positive(speed, "speed")
    lasting = span / speed
    if lasting > _PATIENCE:
        raise SceneError(
            f"at speed {speed:g} the animation lasts {lasting:.3g} s: give a larger speed"
        )
    most = min(MOST_FRAMES, max(_FEWEST, MOST_POSES // max(n_bodies, 1)))
    n = max(round(min(lasting * fps, most - 1.0)) + 1, 2) if span else 1
    return Moments(np.linspace(start, end, n), lasting / (n - 1) if n > 1 else 1.0 / fps)


def _round(x: float) -> float:
    """Round to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(x))
    return min((1.0, 2.0, 5.0, 10.0), key=lambda m: abs(math.log(x / (m * power)))) * power


def coordinates_at(
    result: RunRecord, model: WatchedModel, system: System, p: Array, times: Array
) -> Array:
    """Interpolate the coordinates of a run, (n_coordinates, n_frames); normalise quaternions."""
    t, y, u = _with_events(result)
    if len(t) == 1:
        return np.repeat(y[: len(system.coordinates)], len(times), axis=1)
    way = 1.0 if t[-1] >= t[0] else -1.0
    # At equal times take the last point, which is the state after all events.
    left = np.searchsorted(way * t, way * times, side="right") - 1
    left = np.clip(left, 0, len(t) - 2)
    # Evaluate accelerations only at the ends of intervals that contain a frame.
    points = np.unique(np.concatenate([left, left + 1]))
    motion = _motion_at(model, system, p, t[points], y[:, points], u[:, points])
    place = np.searchsorted(points, left)
    first, last = motion[:, :, place], motion[:, :, place + 1]
    h = t[left + 1] - t[left]
    # The points before and after an event have equal times: take the end of this empty interval.
    part = np.where(h != 0.0, (times - t[left]) / np.where(h != 0.0, h, 1.0), 1.0)
    found = _hermite(part, h, first, last)
    for rows in _quaternions(system):
        # Interpolation errors change the norm of quaternions.
        found[rows] /= np.linalg.norm(found[rows], axis=0)
    return found


def _with_events(result: RunRecord) -> tuple[Array, Array, Array]:
    """Return times, states and inputs, including the points just before and after each event."""
    way = 1.0 if result.t[-1] >= result.t[0] else -1.0
    found = [row for row in result.events.values() if len(row.t)]
    when = np.concatenate([np.zeros(0), *(row.t for row in found)])
    # ``way`` is -1 for runs backwards in time, else 1.
    is_within = (way * when >= way * result.t[0]) & (way * when <= way * result.t[-1])
    if not is_within.any():
        return result.t, result.y, result.input_values
    when = when[is_within]
    sides = [
        np.concatenate([getattr(row, side) for row in found], axis=1)[:, is_within]
        for side in ("y_before", "y_after")
    ]
    is_own = ~np.isin(result.t, when)  # points of events replace other points at the same time
    near = np.abs(result.t[:, None] - when).argmin(axis=0)
    t = np.concatenate([result.t[is_own], when, when])
    y = np.concatenate([result.y[:, is_own], *sides], axis=1)
    own, of_events = result.input_values[:, is_own], result.input_values[:, near]
    u = np.concatenate([own, of_events, of_events], axis=1)
    # A stable sort keeps the point before an event ahead of the point after it.
    order = np.argsort(way * t, kind="stable")
    return t[order], y[:, order], u[:, order]


def _motion_at(
    model: WatchedModel, system: System, p: Array, t: Array, y: Array, u: Array
) -> Array:
    """Return coordinates, their rates and accelerations, shape (3, n_coordinates, n_points)."""
    n, m = len(system.coordinates), len(system.speeds)
    values, speeds = y[:n], y[n : n + m]
    accelerations = np.zeros((m, len(t)))
    for k, when in enumerate(t):
        # At a singular point the acceleration is undefined, so zero is used.
        with suppress(Error):
            accelerations[:, k] = model.rhs(when, y[:, k], p, u[:, k])[n : n + m]
    motion = np.zeros((3, n, len(t)))
    motion[0] = values
    row = 0
    for steps in system.steps.values():
        for step in steps:
            own = [speed.index for speed in step.speeds]
            rows = slice(row, row := row + len(step.coordinates))
            if isinstance(step.kind, FreeRotation):
                q, w, a = list(values[rows]), list(speeds[own]), list(accelerations[own])
                motion[1, rows] = quaternion_rates(q, w)
                # q' = q w / 2 is linear in both: q'' = q' w / 2 + q w' / 2.
                motion[2, rows] = quaternion_rates(list(motion[1, rows]), w)
                motion[2, rows] += quaternion_rates(q, a)
            else:
                motion[1, rows], motion[2, rows] = speeds[own], accelerations[own]
    return motion


def _quaternions(system: System) -> Iterator[slice]:
    row = 0
    for steps in system.steps.values():
        for step in steps:
            if isinstance(step.kind, FreeRotation):
                yield slice(row, row + 4)
            row += len(step.coordinates)


def _hermite(x: Array, h: Array, first: Array, last: Array) -> Array:
    """Interpolate values, rates and accelerations at both ends, at fractions x of steps h."""
    (q0, v0, a0), (q1, v1, a1) = first, last
    # Deviations from the Taylor polynomial about the first end, each times a power of h.
    rest = q1 - (q0 + h * v0 + 0.5 * h**2 * a0)
    slope = h * (v1 - v0 - h * a0)
    bend = h**2 * (a1 - a0)
    cubic = 10.0 * rest - 4.0 * slope + 0.5 * bend
    quartic = -15.0 * rest + 7.0 * slope - bend
    quintic = 6.0 * rest - 3.0 * slope + 0.5 * bend
    taylor = q0 + x * h * (v0 + 0.5 * x * h * a0)
    return np.asarray(taylor + x**3 * (cubic + x * (quartic + x * quintic)))
