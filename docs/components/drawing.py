"""Pen and paper for the figures of component types: solids, arrows, nodes in one style.

Points have two entries (on paper) or three (in space, z up, seen from above the front left).
Later strokes cover earlier ones.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull

if TYPE_CHECKING:
    from collections.abc import Callable

Array = npt.NDArray[np.float64]

#: Fill and outline of the first node's body, of the second's, and of what is neither.
FIRST = ("#e8e8e8", "#404040")
SECOND = ("#cfe3f5", "#1f77b4")
METAL = ("#9a9a9a", "#303030")

INK = "#222222"
FREEDOM = "#d62728"  # what may move
THROUGH = "#2ca02c"  # what acts

_AZIMUTH, _ELEVATION = np.radians(28.0), np.radians(26.0)
_RIGHT = np.array([-np.sin(_AZIMUTH), np.cos(_AZIMUTH), 0.0])
_TOWARDS = np.array(
    [
        np.cos(_AZIMUTH) * np.cos(_ELEVATION),
        np.sin(_AZIMUTH) * np.cos(_ELEVATION),
        np.sin(_ELEVATION),
    ]
)
_UP = np.cross(_TOWARDS, _RIGHT)
_HEAD = 0.13
_FONT = 11.0


def flat(point: Any) -> Array:
    """Put a point on paper."""
    p = np.asarray(point, dtype=float)
    return p if len(p) == 2 else np.array([p @ _RIGHT, p @ _UP])


def moved(point: Any, *by: float) -> Array:
    """Shift a point."""
    return np.asarray(np.asarray(point, dtype=float) + np.array(by))


def unit(vector: Any) -> Array:
    """Scale a vector to length one."""
    v = np.asarray(vector, dtype=float)
    return v / np.linalg.norm(v)


def turned(axis: Any, angle: float) -> Array:
    """Return the rotation matrix about an axis by an angle in degrees."""
    x, y, z = unit(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    a = np.radians(angle)
    return np.asarray(np.eye(3) + np.sin(a) * k + (1 - np.cos(a)) * (k @ k))


def circle(centre: Any, axis: Any, radius: float, start: float = 0, stop: float = 360) -> Array:
    """Return points of an arc about an axis in space, by angles in degrees."""
    n = unit(axis)
    first = unit(np.cross(n, [0.0, 0.0, 1.0]) if abs(n[2]) < 0.9 else [1.0, 0.0, 0.0])
    second = np.cross(n, first)
    angles = np.radians(np.linspace(start, stop, 40))[:, None]
    around = np.cos(angles) * first + np.sin(angles) * second
    return np.asarray(centre, dtype=float) + radius * around


def ring(centre: Any, radius: float, start: float = 0, stop: float = 360) -> Array:
    """Return points of an arc on paper, by angles in degrees."""
    angles = np.radians(np.linspace(start, stop, 40))
    around = np.column_stack([np.cos(angles), np.sin(angles)])
    return np.asarray(centre, dtype=float) + radius * around


def blob(centre: Any, width: float, height: float, seed: float = 0.0) -> Array:
    """Return the outline of a body of no special shape."""
    a = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    r = 1 + 0.09 * np.cos(2 * a + seed) + 0.07 * np.sin(3 * a + 2 * seed)
    around = np.column_stack([width * r * np.cos(a), height * r * np.sin(a)])
    return np.asarray(centre, dtype=float) + around


class Sheet:
    """One figure."""

    def __init__(self, width: float = 4.4, height: float = 2.4) -> None:
        self.figure = Figure(figsize=(width, height))
        self.ax = self.figure.add_axes((0, 0, 1, 1))
        self.ax.set_xlim(-width / 2, width / 2)
        self.ax.set_ylim(-height / 2, height / 2)
        self.ax.set_axis_off()
        self._order = 1.0

    def _next(self) -> float:
        self._order += 0.01
        return self._order

    def line(self, points: Any, color: str = INK, lw: float = 1.1, ls: Any = "-") -> None:
        """Draw a line through points."""
        xy = np.array([flat(p) for p in points])
        self.ax.plot(
            xy[:, 0],
            xy[:, 1],
            color=color,
            lw=lw,
            ls=ls,
            zorder=self._next(),
            solid_capstyle="round",
            solid_joinstyle="round",
        )

    def axis_line(self, first: Any, last: Any) -> None:
        """Draw an axis in dashes and dots."""
        self.line([first, last], lw=0.9, ls=(0, (9, 3, 1.5, 3)))

    def face(self, points: Any, colors: tuple[str, str], lw: float = 1.2) -> None:
        """Fill a polygon."""
        xy = np.array([flat(p) for p in points])
        fill, edge = colors
        patch = Polygon(xy, closed=True, fc=fill, ec=edge, lw=lw, joinstyle="round")
        patch.set_zorder(self._next())
        self.ax.add_patch(patch)

    def tube(self, points: Any, colors: tuple[str, str], width: float = 7.0) -> None:
        """Draw a bent rod."""
        self.line(points, colors[1], width + 2.4)
        self.line(points, colors[0], width)

    def solid(self, points: Any, colors: tuple[str, str]) -> None:
        """Fill the outline of a convex solid from its corners."""
        xy = np.array([flat(p) for p in points])
        self.face(xy[ConvexHull(xy).vertices], colors)

    def cylinder(self, first: Any, last: Any, radius: float, colors: tuple[str, str]) -> None:
        """Draw a cylinder between the centres of its ends."""
        a, b = np.asarray(first, dtype=float), np.asarray(last, dtype=float)
        ends = [circle(p, b - a, radius) for p in (a, b)]
        self.solid(np.vstack(ends), colors)
        seen = ends[1] if (b - a) @ _TOWARDS > 0 else ends[0]
        self.face(seen, (_lighter(colors[0]), colors[1]))

    def box(
        self, low: Any, high: Any, colors: tuple[str, str], rotation: Array | None = None
    ) -> None:
        """Draw a box between two corners, turned about the origin."""
        r = np.eye(3) if rotation is None else rotation
        lo, hi = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
        for k in range(3):
            side = 1.0 if r[:, k] @ _TOWARDS > 0 else -1.0
            i, j = (k + 1) % 3, (k + 2) % 3
            corners = []
            for a, b in ((lo[i], lo[j]), (hi[i], lo[j]), (hi[i], hi[j]), (lo[i], hi[j])):
                corner = np.zeros(3)
                corner[i], corner[j], corner[k] = a, b, (hi if side > 0 else lo)[k]
                corners.append(r @ corner)
            fill = _lighter(colors[0]) if k == 2 else colors[0]
            self.face(corners, (fill, colors[1]))

    def arrow(
        self,
        points: Any,
        color: str = INK,
        lw: float = 1.6,
        both: bool = False,
        ls: Any = "-",
        head: float = _HEAD,
    ) -> None:
        """Draw an arrow along points."""
        xy = np.array([flat(p) for p in points])
        tips = [(xy[-1], unit(xy[-1] - xy[-2]))]
        if both:
            tips.append((xy[0], unit(xy[0] - xy[1])))
        body = xy.copy()
        for i, (tip, along) in zip((-1, 0), tips, strict=False):
            body[i] = tip - 0.8 * head * along
        self.line(body, color, lw, ls)
        for tip, along in tips:
            across = 0.36 * head * np.array([-along[1], along[0]])
            back = tip - head * along
            self.face([tip, back + across, back - across], (color, color), lw=0.3)

    def text(
        self,
        place: Any,
        words: str,
        color: str = INK,
        italic: bool = True,
        size: float = _FONT,
        ha: str = "center",
    ) -> None:
        """Write words."""
        x, y = flat(place)
        self.ax.text(
            x,
            y,
            words,
            color=color,
            fontsize=size,
            fontstyle="italic" if italic else "normal",
            ha=ha,
            va="center",
            parse_math=False,
            zorder=self._next() + 5,
        )

    def node(self, place: Any, name: str = "", away: tuple[float, float] = (0, -0.2)) -> None:
        """Draw a node and its name."""
        x, y = flat(place)
        self.ax.plot(
            [x], [y], "o", color=INK, ms=5.2, mec="white", mew=0.8, zorder=self._next() + 4
        )
        if name:
            ha = "left" if away[0] > 0.12 else "right" if away[0] < -0.12 else "center"
            self.text((x + away[0], y + away[1]), name, italic=False, size=10, ha=ha)

    def triad(self, origin: Any, rotation: Array | None = None, size: float = 0.42) -> None:
        """Draw the axes of a frame in space."""
        r = np.eye(3) if rotation is None else rotation
        o = np.asarray(origin, dtype=float)
        for k, name in enumerate("xyz"):
            tip = o + size * r[:, k]
            self.arrow([o, tip], lw=1.0, head=0.09)
            self.text(flat(o) + 1.27 * (flat(tip) - flat(o)), name, size=8.5)

    def axes(self, origin: Any, angle: float = 0.0, size: float = 0.36) -> None:
        """Draw the axes of a frame on paper."""
        o, a = np.asarray(origin, dtype=float), np.radians(angle)
        for name, along in zip(
            "xy", ((np.cos(a), np.sin(a)), (-np.sin(a), np.cos(a))), strict=True
        ):
            tip = o + size * np.array(along)
            self.arrow([o, tip], lw=1.0, head=0.09)
            self.text(o + 1.3 * (tip - o), name, size=8.5)

    def ground(self, place: Any, width: float = 0.6, angle: float = 0.0) -> None:
        """Draw a hatched line, the ground below it."""
        a = np.radians(angle)
        along, down = np.array([np.cos(a), np.sin(a)]), np.array([np.sin(a), -np.cos(a)])
        o = flat(place)
        self.line([o - width / 2 * along, o + width / 2 * along], lw=1.4)
        for s in np.arange(-width / 2 + 0.09, width / 2 + 0.01, 0.11):
            start = o + s * along
            self.line([start, start + 0.11 * down - 0.09 * along], lw=0.8)

    def coil(self, first: Any, last: Any, turns: int = 6, radius: float = 0.13) -> None:
        """Draw a spring."""
        a, b = flat(first), flat(last)
        along = unit(b - a)
        across = np.array([-along[1], along[0]])
        zigzag = [a, a + 0.18 * (b - a)]
        for i in range(2 * turns):
            s = 0.18 + 0.64 * (i + 0.5) / (2 * turns)
            zigzag.append(a + s * (b - a) + (1 if i % 2 else -1) * radius * across)
        self.line([*zigzag, a + 0.82 * (b - a), b], lw=1.4)

    def dashpot(self, first: Any, last: Any, radius: float = 0.11) -> None:
        """Draw a damper: a cup and its piston."""
        a, b = flat(first), flat(last)
        along = unit(b - a)
        across = radius * np.array([-along[1], along[0]])
        bottom, mouth, piston = (a + s * (b - a) for s in (0.32, 0.68, 0.52))
        self.line([a, bottom], lw=1.4)
        self.line([mouth + across, bottom + across, bottom - across, mouth - across], lw=1.4)
        self.line([piston + 0.8 * across, piston - 0.8 * across], lw=2.2)
        self.line([piston, b], lw=1.4)

    def dimension(self, first: Any, last: Any, words: str, away: float, color: str = INK) -> None:
        """Measure the distance of two points beside them."""
        a, b = flat(first), flat(last)
        along = unit(b - a)
        across = np.array([-along[1], along[0]])
        for p in (a, b):
            self.line([p + 0.3 * away * across, p + 1.15 * away * across], color, 0.7)
        self.arrow([a + away * across, b + away * across], color, 1.2, both=True, head=0.1)
        self.text((a + b) / 2 + (away + np.sign(away) * 0.15) * across, words, color)


def _lighter(color: str) -> str:
    levels = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
    return "#" + "".join(f"{(level + 255) // 2:02x}" for level in levels)


#: Drawings by the name of their component type.
FIGURES: dict[str, Callable[[Sheet], None]] = {}


def figure(draw: Callable[[Sheet], None]) -> Callable[[Sheet], None]:
    """Enter a drawing under its function's name."""
    FIGURES[draw.__name__] = draw
    return draw
