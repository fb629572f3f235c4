"""Projection of points in space onto the picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cotree.watch.drawing import FAR
from cotree.watch.shapes import axes_along

if TYPE_CHECKING:
    from cotree.watch.drawing import Drawing
    from cotree.watch.shapes import Array

Reach = tuple[float, float, float]

_HALF_ANGLE = np.deg2rad(13.0)  # half of the vertical field of view of a spatial scene
#: Size of the picture relative to its contents: room for a line of text at the top.
MARGIN = 1.14


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera, which projects points of the drawing onto the picture.

    Attributes
    ----------
    axes : ndarray, shape (3, 3)
        Directions to the right, upwards and towards the viewer, as columns.
    centres : ndarray, shape (n_frames, 3)
        Point in the middle of each frame, [m].
    half : (float, float)
        Half the width and half the height of the visible region there, [m].
    distance : float
        From the viewer to that point, [m]; infinite in a plane: a parallel projection.
    """

    axes: Array
    centres: Array
    half: tuple[float, float]
    distance: float

    def project(self, points: Array, frame: int) -> tuple[Array, Array]:
        """Project points, and give a measure of their nearness.

        Parameters
        ----------
        points : ndarray, shape (n, 3), [m]
            In ground axes.
        frame : int
            Number of the frame.

        Returns
        -------
        places : ndarray, shape (n, 2)
            Coordinates in the picture, -1 to 1 from left to right and from bottom to top.
        nearness : ndarray, shape (n,)
            Larger in front; linear over the picture of a plane.
        """
        own = (points - self.centres[frame]) @ self.axes
        # Parallel projection: nearness is the coordinate towards the viewer itself.
        if np.isinf(self.distance):
            return own[:, :2] / self.half, own[:, 2]
        # A point at or behind the viewer has no image; the bound keeps the division defined.
        away = np.maximum(self.distance - own[:, 2], 0.01 * self.distance)
        return own[:, :2] / self.half * (self.distance / away)[:, None], 1.0 / away


def place_camera(drawing: Drawing, aspect: float | None) -> tuple[Camera, Reach]:
    """Place the camera so that every frame shows all shapes at the same scale.

    Parameters
    ----------
    drawing : Drawing
        The drawing.
    aspect : float or None
        Width by height of the picture. None takes that of the mechanism in a plane, between 0.6
        and 2, and 4:3 in space.

    Returns
    -------
    camera : Camera
        The view.
    reach : tuple of three float
        Half the extent of the shapes to the right, upwards and towards the viewer, [m].
    """
    axes = axes_along(drawing.towards, drawing.up)
    low, high = drawing.bounds(axes)
    own = float((high - low).max())
    # What stays near is seen from a camera at rest; what travels far is followed.
    if float((high.max(axis=0) - low.min(axis=0)).max()) <= FAR * own:
        low, high = (
            np.repeat(a[None], len(low), axis=0) for a in (low.min(axis=0), high.max(axis=0))
        )
    centres = 0.5 * (low + high) @ axes.T
    right, above, ahead = (float(v) for v in 0.5 * (high - low).max(axis=0))
    if aspect is None:
        shape = right / above if above > 0.0 else 2.0
        aspect = min(max(shape, 0.6), 2.0) if drawing.is_flat else 4.0 / 3.0
    # The narrower side decides on the scale.
    half = MARGIN * (max(above, right / aspect) or 1.0)
    if drawing.is_flat:
        return Camera(axes, centres, (half * aspect, half), np.inf), (right, above, ahead)
    # Perspective enlarges near shapes: move back until the nearest side fits into the picture.
    slope = float(np.tan(_HALF_ANGLE))
    distance = half / slope + ahead
    camera = Camera(axes, centres, (slope * distance * aspect, slope * distance), distance)
    return camera, (right, above, ahead)
