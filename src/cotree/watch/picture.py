"""Rendering of frames: triangles with a depth buffer in NumPy, and GIF files by Pillow."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.watch.drawing import FAR, Drawing, Strut
from cotree.watch.shapes import Array, axes_along, joined

if TYPE_CHECKING:
    from cotree.watch.stage import Poses


Reach = tuple[float, float, float]

_HALF_ANGLE = np.deg2rad(13.0)  # half of the vertical field of view in spatial scenes, [rad]
#: Ratio of picture size to drawing size, with space for a line of text at the top.
MARGIN = 1.14


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera that projects points of the drawing onto the picture."""

    axes: Array  # columns: directions to the right, upwards and towards the viewer
    centres: Array  # centre of the view in each frame, [m]
    half: tuple[float, float]  # half the width and height of the visible region at the centre, [m]
    #: Distance from the viewer to the centre, [m]; infinite for the parallel projection of planes.
    distance: float

    def project(self, points: Array, frame: int) -> tuple[Array, Array]:
        """Project points of a frame, (n, 3) in ground axes, [m], to the picture.

        Picture coordinates, (n, 2), are -1 to 1 to the right and upwards. Nearness, (n,), is larger
        in front and linear in the picture coordinates on a plane.
        """
        own = (points - self.centres[frame]) @ self.axes
        # Parallel projection: nearness is the coordinate towards the viewer.
        if np.isinf(self.distance):
            return own[:, :2] / self.half, own[:, 2]
        # A point at or behind the viewer has no image; the lower bound avoids a division by zero.
        away = np.maximum(self.distance - own[:, 2], 0.01 * self.distance)
        return own[:, :2] / self.half * (self.distance / away)[:, None], 1.0 / away


def place_camera(drawing: Drawing, aspect: float | None) -> tuple[Camera, Reach]:
    """Position the camera so that every frame shows all shapes at the same scale.

    The default ``aspect``, width by height, is 4:3 in space; in a plane it is the mechanism's,
    limited to 0.6 to 2. The reach is half the extent to the right, upwards and towards the viewer,
    [m].
    """
    axes = axes_along(drawing.towards, drawing.up)
    low, high = drawing.bounds(axes)
    own = float((high - low).max())
    # The camera follows a mechanism that travels far, and is fixed otherwise.
    if float((high.max(axis=0) - low.min(axis=0)).max()) <= FAR * own:
        low, high = (
            np.repeat(a[None], len(low), axis=0) for a in (low.min(axis=0), high.max(axis=0))
        )
    centres = 0.5 * (low + high) @ axes.T
    right, above, ahead = (float(v) for v in 0.5 * (high - low).max(axis=0))
    if aspect is None:
        shape = right / above if above > 0.0 else 2.0
        aspect = min(max(shape, 0.6), 2.0) if drawing.is_flat else 4.0 / 3.0
    half = MARGIN * (max(above, right / aspect) or 1.0)
    if drawing.is_flat:
        return Camera(axes, centres, (half * aspect, half), np.inf), (right, above, ahead)
    # At this distance, the nearest side fits into the picture.
    slope = float(np.tan(_HALF_ANGLE))
    distance = half / slope + ahead
    camera = Camera(axes, centres, (slope * distance * aspect, slope * distance), distance)
    return camera, (right, above, ahead)


_PAPER, _INK, _LINE = (250, 250, 248), (70, 76, 84), (222, 223, 221)
_FINER = 2  # rendered pixels per pixel of the picture, in each direction
_LIGHT = np.array([-0.35, 0.55, 0.76])  # light direction: right, up, towards the viewer
_COLORS = 96  # colours of a GIF; more colours increase its size without visible difference


class Painter:
    """Painter of frames, with sizes in [px]; a height of None fits the drawing."""

    def __init__(self, drawing: Drawing, width: int, height: int | None) -> None:
        self.drawing = drawing
        aspect = None if height is None else width / height
        self.camera: Camera = place_camera(drawing, aspect)[0]
        half = self.camera.half
        self.size = (width, height or 2 * round(0.5 * width * half[1] / half[0]))
        self._floor = drawing.floor()
        shown = [(solid.mesh, solid.color) for solid in drawing.solids]
        shown += [(strut.mesh, strut.color) for strut in drawing.struts]
        # Faces are the same in all frames.
        self._faces = joined(mesh for mesh, _ in shown).faces
        self._colors = np.concatenate([np.tile(color, (len(m.faces), 1)) for m, color in shown])

    def paint(self, frame: int) -> Any:
        """Paint one frame as a Pillow image."""
        from PIL import Image, ImageDraw

        width, height = (_FINER * n for n in self.size)
        # Render at twice the size and reduce the picture, which smooths edges.
        paper = Image.new("RGB", (width, height), _PAPER)
        pen = ImageDraw.Draw(paper)
        for ends in self._floor:
            corners, _ = self.camera.project(ends, frame)
            pen.line([tuple(xy) for xy in self._pixels(corners)], fill=_LINE, width=_FINER)
        canvas = np.array(paper).reshape(-1, 3)
        points = np.concatenate(list(self._points(frame)))
        places, nearness = self.camera.project(points, frame)
        pixels = self._pixels(places)
        shades = self._shades(points)
        covered, shown = _visible(pixels, nearness, self._faces, width, height)
        canvas[covered] = (self._colors * shades)[shown].astype(np.uint8)
        image = Image.fromarray(canvas.reshape(height, width, 3)).reduce(_FINER)
        self._write(ImageDraw.Draw(image), frame)
        return image

    def _pixels(self, places: Array) -> Array:
        # Rows of a picture are counted downwards.
        return np.asarray((places * [1.0, -1.0] + 1.0) * (0.5 * _FINER * np.array(self.size)))

    def _points(self, frame: int) -> Any:
        poses = self.drawing.poses
        for solid in self.drawing.solids:
            yield (
                solid.mesh.points @ poses.axes[solid.track, frame].T
                + (poses.positions[solid.track, frame])
            )
        for strut in self.drawing.struts:
            yield strut_points(strut, poses, frame)

    def _shades(self, points: Array) -> Array:
        """Return the brightness of each face, shape (n_faces, 1); both sides are visible."""
        a, b, c = (points[self._faces[:, i]] for i in range(3))
        normals = np.cross(b - a, c - a)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        own = normals @ self.camera.axes
        # If the normal of a face points away from the viewer, its back is visible.
        own *= np.where(own[:, 2:] < 0.0, -1.0, 1.0)
        lit = np.clip(own @ (_LIGHT / np.linalg.norm(_LIGHT)), 0.0, 1.0)
        return np.asarray((0.62 + 0.38 * lit)[:, None])

    def _write(self, draw: Any, frame: int) -> None:
        from PIL import ImageFont

        font = ImageFont.load_default(13)
        times = self.drawing.frames.times
        text = f"t = {times[frame]:.{decimals(times)}f} s"
        draw.text((10, 8), text, fill=_INK, font=font)
        draw.text(
            (self.size[0] - 10, 8), self.drawing.title[:60], fill=_INK, font=font, anchor="ra"
        )
        if self.drawing.note:
            draw.text(
                (10, self.size[1] - 24), self.drawing.note[:90], fill=(190, 60, 60), font=font
            )


def decimals(times: Array) -> int:
    """Return the number of decimals, at least two, that distinguish frame times."""
    step = abs(float(times[1] - times[0])) if len(times) > 1 else 1.0
    return max(2, min(12, int(np.ceil(-np.log10(max(step, 1e-12))))))


def strut_points(strut: Strut, poses: Poses, frame: int) -> Array:
    """Stretch a strut between its ends; return its mesh points in ground axes, [m]."""
    ends = [
        poses.positions[track, frame] + poses.axes[track, frame] @ local
        for track, local in zip(strut.tracks, strut.ends, strict=True)
    ]
    gap = ends[1] - ends[0]
    length = float(np.linalg.norm(gap))
    # At length zero the strut has no direction and becomes a point.
    if length == 0.0:
        return np.repeat(ends[0][None], len(strut.mesh.points), axis=0)
    axes = axes_along(gap, poses.axes[strut.tracks[0], frame] @ strut.side)
    return np.asarray((strut.mesh.points * [1.0, 1.0, length]) @ axes.T + ends[0])


def _visible(
    pixels: Array, nearness: Array, faces: npt.NDArray[np.int64], width: int, height: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Fill each row of pixels that a face crosses; return the pixels and their nearest faces."""
    corners = pixels[faces]
    x, y = corners[:, :, 0], corners[:, :, 1]
    area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    # Range of pixel rows whose centres, at n + 1/2, are within the triangle.
    top = np.clip(np.ceil(y.min(axis=1) - 0.5), 0, height).astype(np.int64)
    bottom = np.clip(np.ceil(y.max(axis=1) - 0.5), 0, height).astype(np.int64)
    is_seen = (np.abs(area) > 1e-9) & np.isfinite(area)
    n_rows = np.where(is_seen, np.maximum(bottom - top, 0), 0)
    # One entry for each row that a face crosses, then one for each pixel of that row.
    face = np.repeat(np.arange(len(faces)), n_rows)
    row = np.arange(len(face)) - np.repeat(np.cumsum(n_rows) - n_rows, n_rows) + top[face]
    # Each edge cuts the row on one side; the inside is between the innermost cuts.
    low = np.zeros(len(face))
    high = np.full(len(face), float(width))
    for i in range(3):
        j = (i + 1) % 3
        rise = (y[:, j] - y[:, i])[face]
        with np.errstate(all="ignore"):
            cut = x[face, i] + (row + 0.5 - y[face, i]) / rise * (x[:, j] - x[:, i])[face]
        # If the area is positive, the inside is to the left of falling edges (rows count down).
        is_left = (rise < 0.0) == (area[face] > 0.0)
        low = np.where((rise != 0.0) & is_left, np.maximum(low, cut), low)
        high = np.where((rise != 0.0) & ~is_left, np.minimum(high, cut), high)
    first = np.ceil(low - 0.5).astype(np.int64)
    n = np.maximum(np.ceil(high - 0.5).astype(np.int64) - first, 0)
    span = np.repeat(np.arange(len(face)), n)
    column = np.arange(len(span)) - np.repeat(np.cumsum(n) - n, n) + first[span]
    face, row = face[span], row[span]
    # Nearness is linear over the picture: compute its value and slopes from the corners.
    z = nearness[faces]
    safe = np.where(is_seen, area, 1.0)
    along = (z[:, 1] - z[:, 0]) * (y[:, 2] - y[:, 0]) - (z[:, 2] - z[:, 0]) * (y[:, 1] - y[:, 0])
    down = (x[:, 1] - x[:, 0]) * (z[:, 2] - z[:, 0]) - (x[:, 2] - x[:, 0]) * (z[:, 1] - z[:, 0])
    depth = z[face, 0] + (along / safe)[face] * (column + 0.5 - x[face, 0])
    depth += (down / safe)[face] * (row + 0.5 - y[face, 0])
    pixel = row * width + column
    nearest = np.full(width * height, -np.inf)
    np.maximum.at(nearest, pixel, depth)
    is_front = depth >= nearest[pixel]
    return pixel[is_front], face[is_front]


def gif(drawing: Drawing, width: int, height: int | None, most: int) -> bytes:
    """Return a repeating GIF; with more than ``most`` frames, only every k-th frame is drawn."""
    from PIL import Image

    painter = Painter(drawing, width, height)
    n = len(drawing.frames.times)
    every = -(-n // most)
    shown = list(range(0, n, every))
    # All frames share a palette, so that colours do not flicker.
    few = [painter.paint(k) for k in shown[:: max(1, len(shown) // 6)]]
    sheet = Image.new("RGB", (few[0].width, few[0].height * len(few)))
    for i, image in enumerate(few):
        sheet.paste(image, (0, i * image.height))
    palette = sheet.quantize(_COLORS, dither=Image.Dither.NONE)
    images = [painter.paint(k).quantize(palette=palette, dither=Image.Dither.NONE) for k in shown]
    # A GIF has 16 bits for hundredths of a second; browsers slow down pauses below 0.02 s.
    pause = 10 * min(max(2, round(100.0 * drawing.frames.pause * every)), 65_535)
    buffer = io.BytesIO()
    images[0].save(
        buffer,
        "GIF",
        save_all=True,
        append_images=images[1:],
        duration=pause,
        loop=0,
        optimize=False,
        disposal=1,
    )
    return buffer.getvalue()
