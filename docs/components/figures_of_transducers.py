"""Figures of transducers: what couples two graphs."""

from __future__ import annotations

import numpy as np
from drawing import FIRST, FREEDOM, INK, METAL, SECOND, THROUGH, Sheet, figure, ring
from symbols import LIQUID


def _terminals(s: Sheet, x: float, letter: str) -> None:
    """Draw two wires at the left, with what flows in."""
    for y, name in ((0.45, "plus"), (-0.45, "minus")):
        s.line([(-1.75, y), (x, y)], lw=1.5)
        s.node((-1.75, y), name, (0.0, -0.2))
    s.arrow([(-1.45, 0.62), (-1.05, 0.62)], THROUGH, 1.7)
    s.text((-1.25, 0.8), letter, THROUGH)


def _shaft(s: Sheet, start: float) -> None:
    """Draw a shaft at the right, which turns."""
    s.line([(start, 0.0), (1.6, 0.0)], lw=4.0)
    s.node((1.6, 0.0), "shaft", (0.0, -0.3))
    s.arrow(ring((1.15, 0.0), 0.42, -60, 80), FREEDOM, 1.7)
    s.text((1.5, 0.55), "w", FREEDOM)


@figure
def dc_motor(s: Sheet) -> None:
    """Draw a machine with brushes."""
    _terminals(s, 0.0, "i")
    s.face(ring((0.0, 0.0), 0.62), FIRST)
    for y in (-0.68, 0.52):
        s.face([(-0.14, y), (0.14, y), (0.14, y + 0.16), (-0.14, y + 0.16)], METAL)
    s.text((0.0, 0.0), "M", size=14)
    _shaft(s, 0.62)


@figure
def voice_coil(s: Sheet) -> None:
    """Draw a coil on its former, in the gap of a magnet."""
    _terminals(s, -0.1, "i")
    for y in (-0.75, 0.57):
        s.face([(-0.75, y), (0.5, y), (0.5, y + 0.18), (-0.75, y + 0.18)], FIRST)
    s.face([(-0.2, -0.38), (0.9, -0.38), (0.9, 0.38), (-0.2, 0.38)], SECOND)
    for x in np.linspace(-0.1, 0.4, 5):
        for y in (-0.45, 0.45):
            s.face(ring((x, y), 0.055), ("#e8b57a", INK))
    s.line([(0.9, 0.0), (1.6, 0.0)], lw=3.0)
    s.node((1.6, 0.0), "coil", (0.0, -0.3))
    s.arrow([(1.0, 0.3), (1.5, 0.3)], FREEDOM, 1.7)
    s.text((1.25, 0.5), "v", FREEDOM)


@figure
def hydraulic_cylinder(s: Sheet) -> None:
    """Draw a piston in its cylinder."""
    s.face([(-0.8, -0.4), (0.7, -0.4), (0.7, 0.4), (-0.8, 0.4)], ("#ffffff", INK))
    s.face([(-0.8, -0.4), (0.0, -0.4), (0.0, 0.4), (-0.8, 0.4)], LIQUID)
    s.face([(0.0, -0.4), (0.14, -0.4), (0.14, 0.4), (0.0, 0.4)], METAL)
    s.face([(0.14, -0.06), (1.55, -0.06), (1.55, 0.06), (0.14, 0.06)], SECOND)
    s.line([(-1.75, 0.0), (-0.8, 0.0)], lw=1.5)
    s.node((-1.75, 0.0), "chamber", (0.1, -0.22))
    s.arrow([(-1.5, 0.2), (-1.05, 0.2)], THROUGH, 1.7)
    s.text((-1.27, 0.4), "q", THROUGH)
    s.node((1.55, 0.0), "rod", (0.0, -0.25))
    s.arrow([(0.95, 0.3), (1.5, 0.3)], FREEDOM, 1.7)
    s.text((1.22, 0.5), "v", FREEDOM)
    s.text((-0.4, 0.0), "p", THROUGH)
    s.text((-0.05, 0.6), "area", size=10)


@figure
def hydraulic_machine(s: Sheet) -> None:
    """Draw a circle with a triangle of flow."""
    _terminals(s, -0.35, "q")
    s.face(ring((0.0, 0.0), 0.62), LIQUID)
    s.face([(-0.62, 0.0), (-0.3, 0.2), (-0.3, -0.2)], METAL)
    s.text((0.12, 0.0), "displacement", size=8)
    _shaft(s, 0.62)


@figure
def solenoid(s: Sheet) -> None:
    """Draw a coil with its plunger."""
    _terminals(s, -0.7, "i")
    s.face([(-0.7, -0.55), (0.45, -0.55), (0.45, 0.55), (-0.7, 0.55)], ("#ffffff", INK))
    for x in np.linspace(-0.6, 0.35, 9):
        for y in (-0.45, 0.45):
            s.face(ring((x, y), 0.055), ("#e8b57a", INK))
    s.face([(-0.15, -0.22), (1.3, -0.22), (1.3, 0.22), (-0.15, 0.22)], SECOND)
    s.line([(1.3, 0.0), (1.6, 0.0)], lw=1.5)
    s.node((1.6, 0.0), "plunger", (0.0, -0.3))
    s.line([(-0.65, -0.75), (-0.15, -0.75)], lw=0.9)
    s.arrow([(-0.65, -0.75), (-0.15, -0.75)], FREEDOM, 1.3, both=True)
    s.text((-0.4, -0.93), "s", FREEDOM)
    s.arrow([(1.2, 0.4), (0.7, 0.4)], THROUGH, 1.7)
    s.text((0.95, 0.58), "f", THROUGH)
