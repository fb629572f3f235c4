"""Figures of one-dimensional mechanical components."""

from __future__ import annotations

import numpy as np
from drawing import FIRST, FREEDOM, INK, METAL, SECOND, THROUGH, Sheet, figure, ring
from symbols import FIRST_SECOND, rectangle, source, wheel, wires


@figure
def translational_mass(s: Sheet) -> None:
    """Draw a block on rollers."""
    s.ground((0.0, -0.62), 3.4)
    for x in (-0.1, 0.5):
        s.face(ring((x, -0.53), 0.09), ("#ffffff", INK))
    s.face([(-0.45, -0.44), (0.85, -0.44), (0.85, 0.36), (-0.45, 0.36)], SECOND)
    s.node((0.2, 0.0), "second", (0.0, -0.22))
    s.text((0.2, 0.2), "mass", size=10)
    s.node((-1.5, -0.62), "first: ground", (0.1, 0.22))
    s.arrow([(0.2, 0.6), (0.9, 0.6)], FREEDOM, 1.8)
    s.text((0.55, 0.8), "v", FREEDOM)
    s.arrow([(-1.5, -0.95), (0.2, -0.95)], FREEDOM, 1.2, head=0.1)
    s.text((-0.65, -1.08), "s", FREEDOM, size=10)


@figure
def rotational_inertia(s: Sheet) -> None:
    """Draw a flywheel on a shaft."""
    s.line([(-1.5, 0.0), (1.5, 0.0)], METAL[0], 6.0)
    s.face([(0.0, -0.7), (0.35, -0.7), (0.35, 0.7), (0.0, 0.7)], SECOND)
    s.node((1.5, 0.0), "second", (0.0, -0.25))
    s.node((-1.5, 0.0), "first: ground", (0.0, -0.25))
    s.text((0.18, 0.87), "inertia", size=10)
    s.arrow(ring((0.95, 0.0), 0.32, -70, 70), FREEDOM, 1.8)
    s.text((1.5, 0.3), "w", FREEDOM)


def _pulled(s: Sheet, half: float, through: str, across: str) -> None:
    wires(s, half, FIRST_SECOND, through, across)


@figure
def translational_spring(s: Sheet) -> None:
    """Draw a coil."""
    _pulled(s, 0.8, "f", "v, s")
    s.coil((-0.8, 0.0), (0.8, 0.0))


@figure
def rotational_spring(s: Sheet) -> None:
    """Draw a spiral."""
    _pulled(s, 0.55, "tau", "w, theta")
    a = np.linspace(0, 5 * np.pi, 160)
    r = 0.55 * a / (5 * np.pi)
    s.line(np.column_stack([-r * np.cos(a), r * np.sin(a)]) * np.array([-1, 1]), lw=1.5)
    s.line([(-0.55, 0.0), (-0.62, 0.0)], lw=1.5)
    s.face(ring((0.0, 0.0), 0.07), METAL)


@figure
def translational_damper(s: Sheet) -> None:
    """Draw a cup and its piston."""
    _pulled(s, 0.7, "f", "v")
    s.dashpot((-0.9, 0.0), (0.9, 0.0), 0.24)


@figure
def rotational_damper(s: Sheet) -> None:
    """Draw a disc in oil."""
    _pulled(s, 0.4, "tau", "w")
    s.line([(-0.4, 0.0), (-0.4, 0.45), (0.4, 0.45)], lw=1.8)
    s.line([(-0.4, 0.0), (-0.4, -0.45), (0.4, -0.45)], lw=1.8)
    s.line([(0.4, 0.0), (0.05, 0.0)], lw=1.5)
    s.line([(0.05, -0.32), (0.05, 0.32)], lw=3.0)


def _gap(s: Sheet) -> None:
    rectangle(s, 0.85, 0.42, FIRST)
    rectangle(s, 0.6, 0.3, ("#ffffff", INK))
    s.face([(-0.16, -0.2), (0.16, -0.2), (0.16, 0.2), (-0.16, 0.2)], SECOND)
    s.text((-0.4, 0.6), "lower", size=10)
    s.text((0.4, 0.6), "upper", size=10)
    for x in (-0.6, 0.6):
        s.line([(x, 0.3), (x, 0.5)], lw=0.8)


@figure
def translational_stop(s: Sheet) -> None:
    """Draw a block in a gap."""
    _pulled(s, 0.85, "f", "v, s")
    _gap(s)
    s.line([(0.16, 0.0), (0.9, 0.0)], lw=1.5)


@figure
def rotational_stop(s: Sheet) -> None:
    """Draw a claw in a gap."""
    _pulled(s, 0.7, "tau", "w, theta")
    s.face(ring((0.0, 0.0), 0.7), FIRST)
    wedge = np.vstack([[(0.0, 0.0)], ring((0.0, 0.0), 0.58, 30, 150)])
    s.face(wedge, ("#ffffff", INK))
    s.face(np.vstack([[(0.0, 0.0)], ring((0.0, 0.0), 0.5, 78, 102)]), SECOND)
    s.text((-0.72, 0.62), "upper", size=10)
    s.text((0.72, 0.62), "lower", size=10)


@figure
def translational_rigid_stop(s: Sheet) -> None:
    """Draw a block in a gap, with hatched walls."""
    translational_stop(s)
    _hatch(s)


def _hatch(s: Sheet) -> None:
    for side in (-1, 1):
        for y in (-0.3, -0.15, 0.0, 0.15, 0.3):
            s.line([(side * 0.66, y - 0.05), (side * 0.8, y + 0.05)], INK, 1.0)


@figure
def rotational_rigid_stop(s: Sheet) -> None:
    """Draw a claw in a gap, with hatched walls."""
    rotational_stop(s)
    for side in (-1, 1):
        for radius in (0.2, 0.35, 0.5):
            angle = 90 + side * 66
            start = ring((0.0, 0.0), radius, angle, angle)[0]
            end = ring((0.0, 0.0), radius + 0.05, angle + side * 14, angle + side * 14)[0]
            s.line([start, end], INK, 1.0)


@figure
def translational_friction(s: Sheet) -> None:
    """Draw a block that slides."""
    _pulled(s, 0.7, "f", "v")
    s.face([(-0.7, -0.3), (0.7, -0.3), (0.7, -0.12), (-0.7, -0.12)], FIRST)
    s.face([(-0.4, -0.12), (0.5, -0.12), (0.5, 0.3), (-0.4, 0.3)], SECOND)
    s.line([(0.5, 0.0), (0.72, 0.0)], lw=1.5)
    s.line([(-0.7, 0.0), (-0.7, -0.2)], lw=1.5)


@figure
def rotational_friction(s: Sheet) -> None:
    """Draw a disc with a brake."""
    _pulled(s, 0.6, "tau", "w")
    s.face(ring((0.25, 0.0), 0.45), SECOND)
    s.face([(-0.62, -0.25), (-0.2, -0.25), (-0.2, 0.25), (-0.62, 0.25)], METAL)
    s.node((0.25, 0.0))


def _driven(s: Sheet, letter: str, across: str) -> None:
    wires(s, 0.36, FIRST_SECOND, "", across)
    s.face(ring((0.0, 0.0), 0.36), ("#ffffff", INK))
    s.arrow([(-0.26, 0.0), (0.26, 0.0)], THROUGH, 1.8)
    s.text((0.0, 0.54), letter, THROUGH)


@figure
def force_source(s: Sheet) -> None:
    """Draw a source of force."""
    _driven(s, "force on second", "v")


@figure
def torque_source(s: Sheet) -> None:
    """Draw a source of torque."""
    _driven(s, "torque on second", "w")


@figure
def velocity_source(s: Sheet) -> None:
    """Draw a source of velocity."""
    _pulled(s, 0.36, "f", "v")
    source(s, "velocity", True)


@figure
def speed_source(s: Sheet) -> None:
    """Draw a source of speed."""
    _pulled(s, 0.36, "tau", "w")
    source(s, "speed", True)


@figure
def shaft(s: Sheet) -> None:
    """Draw a twisted shaft."""
    _pulled(s, 1.0, "tau", "w, theta")
    rectangle(s, 1.0, 0.2, METAL)
    x = np.linspace(-1.0, 1.0, 40)
    s.line(np.column_stack([x, 0.17 * np.sin(0.8 * x)]), "#ffffff", 1.4)
    s.text((0.0, 0.44), "stiffness, damping", size=10)


@figure
def lever(s: Sheet) -> None:
    """Draw a beam on a pivot."""
    s.face([(0.45, -0.12), (0.25, -0.6), (0.65, -0.6)], FIRST)
    s.ground((0.45, -0.6))
    s.face([(-1.6, -0.06), (1.5, -0.06), (1.5, 0.06), (-1.6, 0.06)], SECOND)
    s.node((0.45, 0.0))
    for x, name in ((-1.5, "input"), (1.4, "output")):
        s.node((x, 0.0), name, (0.0, -0.24))
        s.arrow([(x, 0.15), (x, 0.7)], FREEDOM, 1.7)
        s.text((x + 0.2, 0.5), "v", FREEDOM)
    s.text((-0.4, 0.35), "ratio < 0", size=10)


@figure
def ideal_gear(s: Sheet) -> None:
    """Draw two wheels in mesh."""
    wheel(s, (-0.35, 0.0), 0.42, 16, FIRST)
    wheel(s, (0.78, 0.0), 0.68, 26, SECOND)
    s.node((-0.35, 0.0), "input", (0.0, -0.62))
    s.node((0.78, 0.0), "output", (0.0, -0.86))
    s.arrow(ring((-0.35, 0.0), 0.6, 100, 210), FREEDOM, 1.7)
    s.text((-1.15, 0.3), "w", FREEDOM)
    s.arrow(ring((0.78, 0.0), 0.86, 60, -20), FREEDOM, 1.7)
    s.text((1.8, 0.3), "w", FREEDOM)
    s.text((-1.35, -0.75), "ratio < 0", size=10)


@figure
def planetary_gear(s: Sheet) -> None:
    """Draw a sun, three planets on a carrier, and a ring."""
    s.face(ring((0.0, 0.0), 1.0), SECOND)
    s.face(ring((0.0, 0.0), 0.88), ("#ffffff", INK))
    wheel(s, (0.0, 0.0), 0.32, 14, FIRST)
    for angle in (90.0, 210.0, 330.0):
        centre = ring((0.0, 0.0), 0.6, angle, angle)[0]
        s.line([(0.0, 0.0), tuple(centre)], INK, 2.0)
        wheel(s, tuple(centre), 0.26, 12, METAL)
    s.node((0.0, 0.0), "sun", (0.0, -0.52))
    s.node(tuple(ring((0.0, 0.0), 0.6, 90, 90)[0]), "carrier", (0.0, 0.54))
    s.node((0.94, 0.0), "ring", (0.34, 0.0))
    s.arrow(ring((0.0, 0.0), 1.14, 130, 200), FREEDOM, 1.7)
    s.text((-1.32, 0.3), "w", FREEDOM)


@figure
def rack_and_pinion(s: Sheet) -> None:
    """Draw a wheel on a toothed bar."""
    teeth = [
        (-1.6 + 0.14 * i + dx, -0.42 + dy)
        for i in range(23)
        for dx, dy in ((0.0, 0.0), (0.035, 0.09), (0.07, 0.09), (0.105, 0.0))
    ]
    s.face([(-1.6, -0.68), *teeth, (1.6, -0.68)], SECOND)
    wheel(s, (0.0, 0.24), 0.6, 26, FIRST)
    s.node((0.0, 0.24), "pinion", (0.0, -0.22))
    s.node((1.2, -0.56), "rack", (0.0, -0.25))
    s.line([(0.0, 0.24), (0.38, 0.66)], lw=1.0)
    s.text((0.02, 0.6), "radius", size=9)
    s.arrow(ring((0.0, 0.24), 0.78, 110, 200), FREEDOM, 1.7)
    s.text((-0.85, 0.7), "w", FREEDOM)
    s.arrow([(-1.4, -0.86), (-0.6, -0.86)], FREEDOM, 1.7)
    s.text((-1.0, -1.03), "v", FREEDOM)
