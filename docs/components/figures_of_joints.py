"""Figures of bodies, arms and joints."""

from __future__ import annotations

import numpy as np
from drawing import (
    FIRST,
    FREEDOM,
    INK,
    METAL,
    SECOND,
    Sheet,
    blob,
    circle,
    figure,
    flat,
    moved,
    ring,
    turned,
)


@figure
def weld(s: Sheet) -> None:
    """Draw two boxes, one askew, with beads where they meet."""
    s.face([(-1.85, -0.62), (-0.2, -0.62), (-0.2, 0.62), (-1.85, 0.62)], FIRST)
    s.face([(-0.2, -0.62), (-0.2, 0.62), (1.35, 1.08), (1.7, -0.06)], SECOND)
    for y in (-0.62, 0.62):
        s.face([(-0.3, y), (-0.1, y), (-0.2, y + 0.14 * np.sign(y))], METAL)
    s.text((-1.3, 0.0), "first", italic=False, size=10)
    s.text((1.0, 0.5), "second", italic=False, size=10)
    s.axes((-0.2, 0.0), 0.0, 0.4)
    s.axes((-0.2, 0.0), 24.0, 0.4)
    s.node((-0.2, 0.0))
    s.arrow(ring((-0.2, 0.0), 0.68, 1, 23), lw=1.0, head=0.09)
    s.line([(0.5, 0.12), (0.74, -0.78)], lw=0.7)
    s.text((0.6, -0.92), "rotation", ha="left")


@figure
def arm(s: Sheet) -> None:
    """Draw one body with two nodes and the vector between them."""
    s.face(blob((0, 0), 1.75, 0.82, 0.4), FIRST)
    s.arrow([(-1.15, -0.25), (0.97, 0.24)], lw=2.0)
    s.text((-0.15, 0.2), "vector")
    s.axes((-1.15, -0.25))
    s.axes((1.0, 0.25), 30.0)
    s.node((-1.15, -0.25), "first", (0.06, -0.2))
    s.node((1.0, 0.25), "second", (0.08, -0.22))


@figure
def rigid_body(s: Sheet) -> None:
    """Draw a body with its centre of mass, seen from the ground."""
    origin, centre = np.array((0.0, -1.6, -0.45)), np.array((0.0, 0.75, 0.32))
    s.triad(origin)
    s.node(origin, "first (ground)", (0.05, -0.42))
    s.face(blob((0.85, 0.08), 1.02, 0.74, 1.0), SECOND)
    s.arrow([origin, centre], lw=1.0, ls=(0, (5, 3)))
    s.triad(centre, turned((1, 1, 0.4), 35), 0.45)
    middle = flat(centre)
    s.face(ring(middle, 0.11), ("#ffffff", INK))
    for start in (0, 180):
        s.face(np.vstack([[middle], ring(middle, 0.11, start, start + 90)]), (INK, INK), lw=0.5)
    s.text(moved(middle, 0.52, -0.1), "second", italic=False, size=10)
    s.text((1.12, -0.38), "mass, inertia", size=10)


def _hinge(s: Sheet) -> None:
    """Draw two leaves on a pin along z."""
    s.box((-0.2, -1.6, -0.28), (0.2, 0.0, -0.03), FIRST)
    s.cylinder((0, 0, -0.28), (0, 0, -0.03), 0.3, FIRST)
    leaf = turned((0, 0, 1), 24)
    s.box((-0.2, 0.0, -0.03), (0.2, 1.6, 0.22), SECOND, leaf)
    s.cylinder((0, 0, -0.03), (0, 0, 0.22), 0.3, SECOND)
    s.cylinder((0, 0, 0.22), (0, 0, 0.42), 0.11, METAL)


@figure
def revolute(s: Sheet) -> None:
    """Draw a hinge."""
    s.axis_line((0, 0, -1.0), (0, 0, -0.28))
    _hinge(s)
    s.axis_line((0, 0, 0.42), (0, 0, 1.15))
    s.arrow(circle((0, 0, 0.72), (0, 0, 1), 0.36, -30, 220), FREEDOM, 1.9)
    s.text((0.55, 0.68), "θ", FREEDOM, size=13)
    s.text((0.12, 1.04), "axis", ha="left")
    s.text((-1.05, 0.62), "first", italic=False, size=10)
    s.text((1.3, 0.36), "second", italic=False, size=10)


@figure
def prismatic(s: Sheet) -> None:
    """Draw a slider on a rail."""
    s.box((-0.22, -1.9, -0.2), (0.22, 1.9, 0.0), FIRST)
    s.axis_line((0, -2.3, 0.0), (0, 2.3, 0.0))
    s.node((0, -1.45, 0.0), "first", (-0.05, -0.42))
    s.box((-0.34, 0.2, -0.28), (0.34, 1.15, 0.32), SECOND)
    s.node((0.0, 0.68, 0.32), "second", (0.1, 0.34))
    s.arrow([(0, -1.45, 0.0), (0, 0.2, 0.0)], FREEDOM, 1.9)
    s.text((-0.55, 0.42), "s", FREEDOM, size=13)
    s.text((1.85, -0.68), "axis")


@figure
def cylindrical(s: Sheet) -> None:
    """Draw a rod in a sleeve."""
    s.cylinder((0, -1.75, 0), (0, 0.55, 0), 0.17, SECOND)
    s.cylinder((0, -0.75, 0), (0, 0.35, 0), 0.42, FIRST)
    s.face(circle((0, 0.35, 0), (0, 1, 0), 0.2), ("#707070", FIRST[1]))
    s.cylinder((0, 0.3, 0), (0, 1.45, 0), 0.17, SECOND)
    s.axis_line((0, 1.45, 0), (0, 2.3, 0))
    s.axis_line((0, -2.35, 0), (0, -1.75, 0))
    s.arrow(circle((0, 1.0, 0), (0, 1, 0), 0.42, -60, 170), FREEDOM, 1.9)
    s.arrow([(0, 0.5, 0.3), (0, 1.3, 0.3)], FREEDOM, 1.9)
    s.text((0.83, 0.42), "s", FREEDOM, size=13)
    s.text((1.22, -0.62), "θ", FREEDOM, size=13)
    s.text((-0.35, 0.62), "first", italic=False, size=10)
    s.text((-1.4, 0.0), "second", italic=False, size=10)
    s.text((1.85, -0.25), "axis")


@figure
def universal(s: Sheet) -> None:
    """Draw two forks on a cross."""
    bend = turned((1, 0, 0), 22)
    back = [bend @ p for p in ((-0.75, 0.0, 0.0), (-0.75, 0.7, 0.0), (0.0, 0.7, 0.0))]
    s.tube(back, SECOND, 6)
    s.tube([(0, -1.8, 0), (0, -0.6, 0)], FIRST, 8)
    s.tube([(0, 0, -0.5), (0, -0.6, -0.5), (0, -0.6, 0.5), (0, 0, 0.5)], FIRST, 6)
    s.tube([(0, 0, -0.55), (0, 0, 0.55)], METAL, 3.5)
    s.tube([bend @ np.array(p) for p in ((-0.8, 0, 0), (0.8, 0, 0))], METAL, 3.5)
    s.tube([bend @ np.array(p) for p in ((0, 0.7, 0), (0, 1.75, 0))], SECOND, 8)
    front = [bend @ np.array(p) for p in ((0.75, 0, 0), (0.75, 0.7, 0), (0, 0.7, 0))]
    s.tube(front, SECOND, 6)
    s.axis_line((0, 0, 0.6), (0, 0, 1.2))
    s.axis_line(bend @ np.array((0.9, 0, 0)), bend @ np.array((2.3, 0, 0)))
    s.arrow(circle((0, 0, 0.85), (0, 0, 1), 0.25, -40, 220), FREEDOM, 1.9)
    s.arrow(circle((1.3, 0, 0), (1, 0, 0), 0.25, 150, 400), FREEDOM, 1.9)
    s.text((0.48, 0.78), "θ₁", FREEDOM, size=12)
    s.text((-0.32, -0.78), "θ₂", FREEDOM, size=12)
    s.text((-0.15, 1.03), "axis", ha="right")
    s.text((-1.02, -0.98), "axis2", ha="right")
    s.text((-1.5, 0.62), "first", italic=False, size=10)
    s.text((1.5, 0.52), "second", italic=False, size=10)


@figure
def spherical(s: Sheet) -> None:
    """Draw a ball in a socket."""
    s.face([(-1.9, -0.16), (-0.6, -0.16), (-0.6, 0.16), (-1.9, 0.16)], FIRST)
    s.face(np.vstack([ring((-0.2, 0), 0.62, 55, 305), ring((-0.2, 0), 0.5, 305, 55)]), FIRST)
    s.tube([(0.1, 0.05), (1.7, 0.42)], SECOND, 9)
    s.face(ring((-0.2, 0), 0.47), SECOND)
    s.line(ring((-0.32, 0.14), 0.2, 110, 170), "white", 2.0)
    s.node((-0.2, 0.0))
    s.arrow(ring((-0.2, 0), 1.35, -12, 34), FREEDOM, 1.9, both=True)
    angles = np.linspace(-2.6, 2.4, 30)
    s.arrow(
        np.column_stack([0.62 + 0.1 * np.cos(angles), 0.2 + 0.27 * np.sin(angles)]), FREEDOM, 1.9
    )
    s.text((1.5, -0.2), "q, w", FREEDOM, size=12)
    s.text((-1.4, 0.36), "first", italic=False, size=10)
    s.text((1.5, 0.72), "second", italic=False, size=10)


@figure
def planar(s: Sheet) -> None:
    """Draw a block on a plate."""
    s.box((-1.0, -1.5, -0.5), (0.85, 1.6, -0.4), FIRST)
    o = np.array((0.2, -0.95, -0.4))
    s.arrow([o, moved(o, 0.7, 0, 0)], FREEDOM, 1.9)
    s.arrow([o, moved(o, 0, 1.1, 0)], FREEDOM, 1.9)
    s.arrow([o, moved(o, 0, 0, 0.85)], lw=1.2)
    s.node(o, "first", (-0.2, 0.1))
    spin, at = turned((0, 0, 1), 25), np.array((-0.15, 0.75, 0.05))
    local = spin.T @ at
    s.box(moved(local, -0.36, -0.36, -0.45), moved(local, 0.36, 0.36, 0.0), SECOND, spin)
    s.node(at, "second", (0.6, 0.1))
    s.axis_line(at, moved(at, 0, 0, 0.75))
    s.arrow(circle(moved(at, 0, 0, 0.4), (0, 0, 1), 0.3, -30, 220), FREEDOM, 1.9)
    s.text((1.22, 0.58), "θ", FREEDOM, size=13)
    s.text((-1.32, -0.62), "x", FREEDOM, size=12)
    s.text((0.13, -0.58), "y", FREEDOM, size=12)
    s.text((-0.93, 0.62), "normal")


@figure
def free(s: Sheet) -> None:
    """Draw a body that nothing holds."""
    first, second = np.array((0.0, -1.6, -0.4)), np.array((0.0, 0.95, 0.3))
    s.triad(first)
    s.node(first, "first", (0.05, -0.42))
    spin = turned((1, 0.5, 0.6), 40)
    at = spin.T @ second
    s.box(moved(at, -0.42, -0.36, -0.3), moved(at, 0.42, 0.36, 0.3), SECOND, spin)
    s.arrow([first, second], FREEDOM, 1.7)
    s.triad(second, spin, 0.62)
    s.node(second)
    s.arrow(ring(flat(second), 0.78, -50, 20), FREEDOM, 1.7, both=True)
    s.text((-0.45, 0.22), "x, y, z", FREEDOM, size=12)
    s.text((1.78, -0.42), "q, w", FREEDOM, size=12)
    s.text((0.75, -0.82), "second", italic=False, size=10)


def _thread(s: Sheet, first: float, last: float) -> None:
    """Draw the visible halves of a thread's turns."""
    for y in np.arange(first, last, 0.17):
        half = circle((0, y, 0), (0, 1, 0), 0.2, -35, 145)
        half[:, 1] += np.linspace(0.0, 0.09, len(half))
        s.line(half[::3], FIRST[1], 0.8)


@figure
def screw(s: Sheet) -> None:
    """Draw a nut on a thread."""
    s.cylinder((0, -1.8, 0), (0, 0.3, 0), 0.2, FIRST)
    _thread(s, -1.7, 0.2)
    nut = [
        circle((0, y, 0), (0, 1, 0), 0.5)[np.linspace(0, 39, 7).astype(int)] for y in (-0.25, 0.3)
    ]
    s.solid(np.vstack(nut), SECOND)
    s.face(nut[1], ("#e7f1fa", SECOND[1]))
    s.cylinder((0, 0.3, 0), (0, 1.75, 0), 0.2, FIRST)
    _thread(s, 0.4, 1.65)
    s.axis_line((0, -2.35, 0), (0, -1.8, 0))
    s.axis_line((0, 1.75, 0), (0, 2.35, 0))
    s.arrow(circle((0, 0.95, 0), (0, 1, 0), 0.48, -60, 170), FREEDOM, 1.9)
    s.arrow([(0, 0.45, 0.62), (0, 1.15, 0.62)], FREEDOM, 1.9)
    s.text((0.75, 0.68), "pitch θ", FREEDOM, size=11)
    s.text((1.2, -0.68), "θ", FREEDOM, size=13)
    s.text((-1.2, 0.72), "first", italic=False, size=10)
    s.text((-0.05, -0.75), "second", italic=False, size=10)
    s.text((1.95, -0.25), "axis")
