"""Figures of constraints and force elements: what is never in the tree."""

from __future__ import annotations

import numpy as np
from drawing import (
    FIRST,
    FREEDOM,
    INK,
    SECOND,
    THROUGH,
    Array,
    Sheet,
    blob,
    circle,
    figure,
    flat,
    moved,
    ring,
    turned,
    unit,
)


def _two_bodies(s: Sheet, left: float = -1.35, right: float = 1.35) -> None:
    s.face(blob((left - 0.2, 0), 0.55, 0.62, 0.3), FIRST)
    s.face(blob((right + 0.2, 0.0), 0.55, 0.62, 2.0), SECOND)


@figure
def distance(s: Sheet) -> None:
    """Draw a rod with a pin at either end."""
    _two_bodies(s)
    a, b = (-1.3, -0.15), (1.3, 0.25)
    s.line([a, b], INK, 3.4)
    s.line([a, b], "white", 1.4)
    s.node(a, "first", (-0.1, -0.22))
    s.node(b, "second", (0.1, -0.22))
    s.dimension(a, b, "length", 0.38)


@figure
def slot(s: Sheet) -> None:
    """Draw a pin in a slot."""
    s.face([(-1.9, -0.55), (0.95, -0.55), (0.95, 0.25), (-1.9, 0.25)], FIRST)
    groove = np.vstack([ring((0.6, -0.15), 0.14, -90, 90), ring((-1.0, -0.15), 0.14, 90, 270)])
    s.face(groove, ("#ffffff", FIRST[1]))
    s.face([(-0.22, -0.3), (0.12, -0.3), (1.6, 0.62), (1.35, 0.9)], SECOND)
    s.axis_line((-2.1, -0.15), (1.9, -0.15))
    s.face(ring((-0.05, -0.15), 0.14), SECOND)
    s.arrow([(-0.3, -0.15), (-0.85, -0.15)], FREEDOM, 1.9)
    s.arrow([(0.2, -0.15), (0.68, -0.15)], FREEDOM, 1.9)
    s.node((-1.55, -0.15), "first", (0.0, -0.2))
    s.node((-0.05, -0.15))
    s.line([(-0.05, -0.15), (-0.42, 0.42)], lw=0.7)
    s.text((-0.5, 0.54), "second", italic=False, size=10)
    s.text((1.75, -0.3), "axis")


@figure
def knife_edge(s: Sheet) -> None:
    """Draw a skate on ice."""
    s.box((-1.0, -1.6, -0.5), (0.9, 1.6, -0.4), FIRST)
    turn = turned((0, 0, 1), 15)
    sole = [(0, -0.55, -0.4), (0, 0.45, -0.4), (0, 0.7, -0.28), (0, 0.7, -0.05), (0, -0.55, -0.05)]
    s.face([turn @ np.array(p) for p in sole], SECOND)
    s.box((-0.12, -0.6, -0.05), (0.12, 0.72, 0.08), SECOND, turn)
    at = np.array((0, 0, 0.08))
    s.arrow([turn @ np.array((0, 0.85, -0.35)), turn @ np.array((0, 1.55, -0.35))], FREEDOM, 1.9)
    s.arrow([at, turn @ np.array((0.95, 0, 0.08))], lw=1.4)
    s.axis_line(at, (0, 0, 0.95))
    s.arrow(circle((0, 0, 0.58), (0, 0, 1), 0.3, -30, 220), FREEDOM, 1.9)
    s.node(at, "second", (-0.3, 0.22))
    s.node((0.5, -1.1, -0.4), "first", (0.13, 0.0))
    s.text((-0.42, -0.47), "axis")


@figure
def rolling_disc(s: Sheet) -> None:
    """Draw a leaning disc on a plane."""
    s.box((-0.85, -1.6, -0.68), (0.7, 1.45, -0.58), FIRST)
    axis = unit((0.85, -0.5, 0.3))
    radius = 0.75
    down = -unit(np.array((0, 0, 1.0)) - axis[2] * axis)
    contact = np.array((-0.1, 0.3, -0.58))
    centre = contact - radius * down
    s.face(circle(centre, axis, radius), SECOND)
    s.line([centre, contact], lw=1.0)
    s.arrow([centre, centre + 1.0 * axis], lw=1.4)
    post = np.array((0.2, -1.2, -0.58))
    s.arrow([post, moved(post, 0, 0, 0.85)], lw=1.4)
    s.arrow(circle(centre, axis, radius + 0.13, 25, 75), FREEDOM, 1.9)
    s.node(centre, "second", (0.0, 0.24))
    s.node(post, "first", (0.0, -0.18))
    s.text(moved(flat(post), 0.0, 0.92), "normal")
    s.text(moved(flat(centre + axis), -0.26, 0.0), "axis")
    s.text((flat(centre) + flat(contact)) / 2 + np.array((0.27, 0.06)), "radius", size=10)


@figure
def rolling_ellipsoid(s: Sheet) -> None:
    """Draw an ellipse on a plane."""
    s.face([(-1.7, -0.8), (1.7, -0.8), (1.7, -0.5), (-1.7, -0.5)], FIRST)
    turn, a, b = 0.3, 1.15, 0.5
    c, n = np.cos(turn), np.sin(turn)
    depth = float(np.hypot(a * n, b * c))
    around = ring((0.0, 0.0), 1.0) * (a, b)
    centre = np.array((0.1, -0.5 + depth))
    s.face(around @ np.array([[c, n], [-n, c]]) + centre, SECOND)
    s.arrow([centre, centre + 0.8 * np.array((c, n))], lw=1.2)
    s.arrow([centre, centre + 0.36 * np.array((-n, c))], lw=1.2)
    s.text(centre + np.array((0.45, 0.28)), "semiaxes", size=10)
    s.node(centre, "second", (-0.1, -0.2))
    s.node((-1.45, -0.5), "first", (0.1, -0.2))
    s.arrow([(-1.45, -0.5), (-1.45, 0.25)], lw=1.4)
    s.text((-1.45, 0.4), "normal")
    s.arrow(ring(centre, 1.3, 40, 10), FREEDOM, 1.8)


@figure
def contact(s: Sheet) -> None:
    """Draw a ball that presses into a plane."""
    s.face([(-1.7, -0.85), (1.7, -0.85), (1.7, -0.5), (-1.7, -0.5)], FIRST)
    centre = (0.0, 0.12)
    s.face(ring(centre, 0.68), SECOND)
    s.line([(-1.7, -0.5), (1.7, -0.5)], FIRST[1], 1.4)
    s.line([centre, (0.5, -0.34)], lw=1.0)
    s.text((0.52, -0.08), "radius", size=10)
    s.node(centre, "second", (0.0, 0.22))
    s.node((-1.4, -0.5), "first", (0.1, -0.2))
    s.arrow([(-1.4, -0.5), (-1.4, 0.3)], lw=1.4)
    s.text((-1.4, 0.45), "normal")
    s.arrow([(0.0, -0.56), (0.0, -0.02)], THROUGH, 1.9)
    s.text((-0.24, -0.3), "force", THROUGH, size=10)
    s.arrow([(0.0, -0.56), (-0.6, -0.56)], THROUGH, 1.7)
    s.text((-0.72, -0.68), "friction", THROUGH, size=10)
    s.arrow([(0.85, 0.12), (1.45, 0.12)], FREEDOM, 1.8)


@figure
def rigid_contact(s: Sheet) -> None:
    """Draw a box that stands on a corner."""
    s.face([(-1.7, -0.85), (1.7, -0.85), (1.7, -0.5), (-1.7, -0.5)], FIRST)
    s.line([(-1.7, -0.5), (1.7, -0.5)], FIRST[1], 1.4)
    corner, along, up = np.array([0.1, -0.5]), np.array([0.94, 0.34]), np.array([-0.34, 0.94])
    box = [corner, corner + along, corner + along + 0.7 * up, corner + 0.7 * up]
    s.face([(float(x), float(y)) for x, y in box], SECOND)
    centre = corner + 0.5 * along + 0.35 * up
    s.node((float(centre[0]), float(centre[1])), "second", (0.1, 0.2))
    s.node((-1.4, -0.5), "first", (0.1, -0.2))
    s.arrow([(-1.4, -0.5), (-1.4, 0.3)], lw=1.4)
    s.text((-1.4, 0.45), "normal")
    s.arrow([(0.1, -0.5), (0.1, 0.1)], THROUGH, 1.9)
    s.text((-0.3, -0.2), "normal.f", THROUGH, size=10)
    s.arrow([(0.1, -0.5), (-0.5, -0.5)], THROUGH, 1.7)
    s.text((-0.7, -0.66), "slide.f", THROUGH, size=10)


def _wheel(centre: tuple[float, float], radius: float, teeth: int, phase: float) -> Array:
    """Return the outline of a toothed wheel."""
    points = []
    for i in range(teeth):
        for place, r in ((-0.3, -0.06), (-0.17, 0.06), (0.17, 0.06), (0.3, -0.06)):
            a = 2 * np.pi * (i + place + phase) / teeth
            points.append(
                (centre[0] + (radius + r) * np.cos(a), centre[1] + (radius + r) * np.sin(a))
            )
    return np.array(points)


@figure
def gear(s: Sheet) -> None:
    """Draw two wheels in mesh."""
    a, b = (-0.95, 0.0), (0.48, 0.0)
    s.face(_wheel(a, 0.9, 24, 0.0), FIRST)
    s.face(_wheel(b, 0.525, 14, 0.5), SECOND)
    s.node(a, "first", (0.0, -0.22))
    s.node(b, "second", (0.0, -0.2))
    s.arrow(ring(a, 0.6, 30, 150), FREEDOM, 1.9)
    s.arrow(ring(b, 0.34, 150, 30), FREEDOM, 1.9)
    s.text((-0.95, 0.26), "coordinate1", FREEDOM, size=9)
    s.text((1.22, 0.5), "coordinate2", FREEDOM, size=9, ha="left")
    s.line([(1.2, 0.46), (0.8, 0.22)], FREEDOM, 0.7)
    s.text((1.22, -0.55), "ratio < 0", size=10, ha="left")


@figure
def constraint(s: Sheet) -> None:
    """Draw a rope over a pulley."""
    s.ground((0.0, 1.0), 0.7, 180)
    s.line([(0, 1.0), (0, 0.55)], lw=1.4)
    s.face(ring((0, 0.55), 0.32), ("#ffffff", INK))
    rope = np.vstack([[(-0.32, -0.1)], ring((0, 0.55), 0.32, 180, 0), [(0.32, -0.62)]])
    s.line(rope, lw=1.6)
    s.node((0, 0.55))
    for x, y, colors, name in ((-0.32, -0.1, FIRST, "first"), (0.32, -0.62, SECOND, "second")):
        s.face([(x - 0.22, y - 0.4), (x + 0.22, y - 0.4), (x + 0.22, y), (x - 0.22, y)], colors)
        s.node((x, y - 0.2), name, (0.34 if x > 0 else -0.34, 0.0))
    s.arrow([(-0.85, 0.1), (-0.85, 0.6)], FREEDOM, 1.9)
    s.arrow([(0.95, 0.6), (0.95, 0.1)], FREEDOM, 1.9)
    s.text((-1.5, 0.35), "A.y", FREEDOM, size=12)
    s.text((1.4, 0.35), "B.y", FREEDOM, size=12)
    s.text((-1.45, -0.95), "A.y + B.y + L = 0", size=10)


def _pair(s: Sheet, y: float = -0.4) -> None:
    """Draw the force on the second node and its reaction on the first."""
    s.arrow([(0.95, y), (0.35, y)], THROUGH, 2.0)
    s.arrow([(-0.95, y), (-0.35, y)], THROUGH, 2.0, ls=(0, (3, 2)))
    s.text((0.62, y - 0.2), "force", THROUGH)
    s.text((-0.62, y - 0.2), "reaction", THROUGH)


@figure
def spring(s: Sheet) -> None:
    """Draw a coil."""
    _two_bodies(s)
    a, b = (-1.2, 0.12), (1.2, 0.12)
    s.coil((-0.85, 0.12), (0.85, 0.12), 7)
    s.line([a, (-0.85, 0.12)], lw=1.4)
    s.line([b, (0.85, 0.12)], lw=1.4)
    s.node(a, "first", (-0.12, -0.22))
    s.node(b, "second", (0.12, -0.22))
    s.dimension(a, b, "length", 0.5)
    _pair(s, -0.42)


@figure
def damper(s: Sheet) -> None:
    """Draw a cup and its piston."""
    _two_bodies(s)
    a, b = (-1.2, 0.12), (1.2, 0.12)
    s.dashpot(a, b, 0.16)
    s.node(a, "first", (-0.12, -0.22))
    s.node(b, "second", (0.12, -0.22))
    s.dimension(a, b, "length, rate", 0.5)
    _pair(s, -0.42)


@figure
def force(s: Sheet) -> None:
    """Draw a force on the second node, with its reaction where it acts."""
    s.face(blob((-1.2, -0.15), 0.75, 0.68, 0.3), FIRST)
    s.face(blob((1.0, 0.0), 0.78, 0.7, 2.0), SECOND)
    s.axes((-1.35, -0.2))
    s.node((-1.35, -0.2), "first", (0.05, -0.22))
    s.arrow([(0.85, 0.0), (1.55, 0.85)], THROUGH, 2.2)
    s.arrow([(0.85, 0.0), (0.15, -0.85)], THROUGH, 1.6, ls=(0, (3, 2)))
    s.node((0.85, 0.0), "second", (0.16, -0.1))
    s.text((1.72, 1.0), "force", THROUGH)
    s.text((0.22, -1.02), "reaction, on the first node's body", THROUGH, size=9)


@figure
def torque(s: Sheet) -> None:
    """Draw a torque on the second node, with its reaction on the first."""
    _two_bodies(s, -1.1, 1.0)
    a, b = (-1.3, 0.0), (1.2, 0.0)
    s.axes(a, 0.0, 0.3)
    s.node(a, "first", (0.0, -0.22))
    s.node(b, "second", (0.0, -0.22))
    s.arrow(ring(b, 0.85, -40, 75), THROUGH, 2.2)
    s.arrow(ring(a, 0.85, 220, 105), THROUGH, 1.6, ls=(0, (3, 2)))
    s.text((1.55, 0.95), "torque", THROUGH)
    s.text((-1.45, 1.0), "reaction", THROUGH)


@figure
def line_force(s: Sheet) -> None:
    """Draw a force along the line of two nodes, by a curve of length."""
    _two_bodies(s)
    a, b = (-1.2, 0.12), (1.2, 0.12)
    s.line([a, b], lw=0.9, ls=(0, (5, 3)))
    s.node(a, "first", (-0.12, -0.22))
    s.node(b, "second", (0.12, -0.22))
    s.dimension(a, b, "length, rate", 0.5)
    s.face([(-0.3, -0.1), (0.3, -0.1), (0.3, 0.34), (-0.3, 0.34)], ("#ffffff", INK), 1.0)
    x = np.linspace(0.0, 1.0, 30)
    s.line(np.column_stack([0.46 * x - 0.23, 0.34 * x**3 - 0.04]), THROUGH, 1.8)
    _pair(s, -0.42)


@figure
def bushing(s: Sheet) -> None:
    """Draw a ring of rubber between a sleeve and a pin."""
    centre = (0.0, 0.0)
    s.face([(-1.9, -0.25), (-0.7, -0.25), (-0.7, 0.25), (-1.9, 0.25)], FIRST)
    s.face(ring(centre, 0.95), FIRST)
    s.face(ring(centre, 0.78), ("#a9a9a9", INK))
    for start in range(0, 360, 30):
        inner, outer = ring(centre, 0.36, start, start), ring(centre, 0.74, start + 18, start + 18)
        s.line([inner[0], outer[0]], "#d8d8d8", 0.9)
    s.face(ring(centre, 0.34), SECOND)
    s.axes(centre, 0.0, 0.5)
    s.node(centre)
    s.arrow(ring((0.0, 0.0), 1.08, -25, 25), THROUGH, 2.0, both=True)
    s.arrow([(-0.3, -1.08), (0.3, -1.08)], THROUGH, 2.0, both=True)
    s.text((-1.5, 0.42), "first", italic=False, size=10)
    s.line([(-0.1, -0.15), (1.2, -0.75)], lw=0.7)
    s.text((1.25, -0.8), "second", italic=False, size=10, ha="left")
    s.text((1.5, 0.2), "rotation", THROUGH, size=10)
