"""An animated drawing: solids on tracks, struts between them, and their poses over time.

Pictures and pages are made from it; :mod:`cotree.watch.draft` makes it from a graph.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cotree.watch.shapes import Color, axes_along

if TYPE_CHECKING:
    from cotree.watch.frames import Moments
    from cotree.watch.shapes import Array, Mesh
    from cotree.watch.stage import Poses

#: The camera follows a mechanism that travels more than this many times its own size.
FAR = 15.0


def _spread(n: int) -> Array:
    """Spread directions evenly over the sphere, on a spiral by the golden angle."""
    # Slices of equal height have equal areas on a sphere (Archimedes).
    z = (2.0 * np.arange(n) + 1.0) / n - 1.0
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(n)
    r = np.sqrt(1.0 - z**2)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z])


# With this number, the error of a bounding box is a hundredth of the size of a shape.
_DIRECTIONS = _spread(200)


@dataclass(frozen=True, eq=False)
class Solid:
    """A shape that moves with a track."""

    name: str  # the edge or node that it shows
    track: int  # number of the rigid cluster that it moves with
    mesh: Mesh  # its shape, in the track's axes
    color: Color  # its colour


@dataclass(frozen=True, eq=False)
class Strut:
    """A shape that reaches from one point to another, stretched along its z from zero to one."""

    name: str
    tracks: tuple[int, int]  # numbers of the clusters that its ends move with
    ends: tuple[Array, Array]  # points of these clusters, in their axes
    side: Array  # its y direction is the one closest to this, in the first track's axes
    mesh: Mesh
    color: Color


@dataclass(frozen=True, eq=False)
class Label:
    """A label at a point of a track."""

    text: str
    track: int
    local: Array


@dataclass(frozen=True, eq=False)
class Drawing:
    """The shapes and names of an animation, and their motion."""

    #: Name of the scene, and a remark on the run; untrusted text.
    title: str
    note: str
    frames: Moments  # times of the frames
    poses: Poses  # of the tracks, which are the clusters, in each frame
    #: The shapes and names.
    solids: tuple[Solid, ...]
    struts: tuple[Strut, ...]
    labels: tuple[Label, ...]
    up: Array  # the axis that points up in the picture
    towards: Array  # direction from the mechanism to the viewer: the normal of a plane, or chosen
    is_flat: bool  # whether everything moves in a plane
    thickness: float  # of bars, [m]

    def floor(self) -> Array:
        """Return a reference grid at rest, shape (n_lines, 2, 3), [m].

        In space it is below the mechanism; if the camera follows the mechanism, dashes along its
        path replace the grid. In a plane there is a grid only if the camera follows the mechanism.
        """
        axes = axes_along(self.up, self.towards if self.is_flat else None)
        low, high = self.bounds(axes)
        # ``own`` is the largest size at one time, ``path`` that of the centre.
        own, path = float((high - low).max()), 0.5 * (low + high) @ axes.T
        low, high = low.min(axis=0), high.max(axis=0)
        is_far = float((high - low).max()) > FAR * own
        if own <= 0.0 or (self.is_flat and not is_far):
            return np.zeros((0, 2, 3))
        if is_far and not self.is_flat:
            return _dashes(path, 0.4 * own)
        # The two directions of the grid, horizontal in space, and the normal.
        one, two, still = (0, 2, 1) if self.is_flat else (0, 1, 2)
        size = max(float(high[one] - low[one]), float(high[two] - low[two]), 0.5 * own)
        step = _round_up(max(0.5 * own, size / 300.0) if is_far else size / 9.0)
        lines = []
        for fixed, free in ((one, two), (two, one)):
            # Lines are at multiples of the step, independent of the start of the motion.
            middle = {k: round(0.5 * (low[k] + high[k]) / step) * step for k in (fixed, free)}
            extent = {k: high[k] - low[k] if is_far else size for k in (fixed, free)}
            n = {k: int(np.ceil(0.6 * extent[k] / step)) + (2 if is_far else 0) for k in extent}
            for i in range(-n[fixed], n[fixed] + 1):
                ends = np.empty((2, 3))
                ends[:, fixed] = middle[fixed] + i * step
                ends[:, free] = middle[free] + np.array([-n[free], n[free]]) * step
                ends[:, still] = low[still] - (own if is_far else 0.0)
                lines.append(ends @ axes.T)
        return np.array(lines)

    def bounds(self, axes: Array) -> tuple[Array, Array]:
        """Return the bounding box of all shapes in every frame, along ``axes`` (columns).

        Least and greatest coordinates have shape (n_frames, 3), [m].
        """
        n = len(self.frames.times)
        low, high = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
        corners: dict[int, list[Array]] = {}
        for solid in self.solids:
            corners.setdefault(solid.track, []).append(_outermost(solid.mesh.points))
        for strut in self.struts:
            for track, end in zip(strut.tracks, strut.ends, strict=True):
                # The ends bound a strut.
                corners.setdefault(track, []).append(end[None])
        for track, parts in corners.items():
            points = np.concatenate(parts)
            turned = axes.T @ self.poses.axes[track]
            # Rotation and view are one product for all frames of a track.
            placed = turned @ points.T + (self.poses.positions[track] @ axes)[:, :, None]
            low, high = np.minimum(low, placed.min(axis=2)), np.maximum(high, placed.max(axis=2))
        return low, high


def _dashes(path: Array, length: float) -> Array:
    """Return dashes of about a length along a path, at most 300, shape (n_lines, 2, 3)."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    # Dashes and gaps are equally long.
    n = int(min(300.0, 0.5 * way[-1] / length))
    at = np.linspace(0.0, way[-1], 2 * n)
    points = np.stack([np.interp(at, way, column) for column in path.T], axis=1)
    return points.reshape(n, 2, 3)


def _round_up(x: float) -> float:
    """Round up to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(x))
    return float(next(m for m in (1.0, 2.0, 5.0, 10.0) if m * power >= x) * power)


def _outermost(points: Array) -> Array:
    """Return the outermost points in many directions, which determine a bounding box."""
    if len(points) <= len(_DIRECTIONS):
        return points
    return np.asarray(points[np.unique(np.argmax(points @ _DIRECTIONS.T, axis=0))])
