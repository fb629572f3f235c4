"""Figures of hydraulic and thermal components."""

from __future__ import annotations

import numpy as np
from drawing import FIRST, FREEDOM, INK, METAL, SECOND, THROUGH, Sheet, figure, ring
from symbols import HOT, LIQUID, rectangle, source, wires


@figure
def hydraulic_resistor(s: Sheet) -> None:
    """Draw a thin tube with the profile of laminar flow."""
    wires(s, 0.9, through="q", across="p")
    rectangle(s, 0.9, 0.26, LIQUID)
    y = np.linspace(-0.95, 0.95, 7)
    for v in y:
        s.arrow(
            [(-0.5, 0.24 * v), (-0.5 + 0.15 + 0.75 * (1 - v * v), 0.24 * v)],
            THROUGH,
            0.9,
            head=0.07,
        )


@figure
def orifice(s: Sheet) -> None:
    """Draw a plate with a hole in a tube."""
    wires(s, 0.9, through="q", across="p")
    rectangle(s, 0.9, 0.4, LIQUID)
    for a, b in ((-0.4, -0.13), (0.13, 0.4)):
        s.face([(-0.06, a), (0.06, a), (0.06, b), (-0.06, b)], METAL)
    s.arrow([(-0.65, 0.0), (0.75, 0.0)], THROUGH, 1.7)
    s.text((0.0, 0.56), "area", size=10)


@figure
def valve(s: Sheet) -> None:
    """Draw two triangles with a stem."""
    wires(s, 0.55, through="q", across="p")
    for side in (-1, 1):
        s.face([(side * 0.55, -0.32), (side * 0.55, 0.32), (0.0, 0.0)], LIQUID)
    s.line([(0, 0), (0, 0.5)], lw=1.4)
    s.line([(-0.22, 0.5), (0.22, 0.5)], lw=2.2)
    s.arrow([(0.42, 0.3), (0.42, 0.72)], FREEDOM, 1.5, both=True)
    s.text((0.95, 0.55), "opening", FREEDOM, size=10)


@figure
def tank(s: Sheet) -> None:
    """Draw an open tank."""
    s.face([(-0.7, -0.55), (0.7, -0.55), (0.7, 0.35), (-0.7, 0.35)], LIQUID)
    s.line([(-0.7, 0.85), (-0.7, -0.55), (0.7, -0.55), (0.7, 0.85)], lw=2.0)
    s.line([(-0.7, -0.4), (-1.55, -0.4)], lw=1.5)
    s.node((-1.55, -0.4), "plus", (0.0, -0.22))
    s.arrow([(-1.3, -0.22), (-0.88, -0.22)], THROUGH, 1.7)
    s.text((-1.1, 0.0), "q", THROUGH)
    s.text((0.0, 0.5), "area", size=10)
    s.text((0.0, -0.3), "density", size=10)
    s.arrow([(1.3, 0.5), (1.3, -0.2)], lw=1.5)
    s.text((1.72, 0.15), "gravity", size=10)
    s.line([(0.0, -0.55), (0.0, -0.8)], lw=1.2, ls=(0, (3, 2)))
    s.ground((0.0, -0.8))
    s.text((0.62, -0.92), "minus", italic=False, size=10)


@figure
def accumulator(s: Sheet) -> None:
    """Draw a vessel with a membrane."""
    s.line([(-1.75, -0.5), (0.0, -0.5)], lw=1.5)
    s.node((-1.75, -0.5), "plus", (0.0, -0.22))
    s.arrow([(-1.3, -0.3), (-0.86, -0.3)], THROUGH, 1.7)
    s.text((-1.08, -0.1), "q", THROUGH)
    s.face(ring((0.0, 0.2), 0.62), ("#ffffff", INK))
    s.face(ring((0.0, 0.2), 0.62, 180, 360), LIQUID)
    s.line([(0.0, -0.42), (0.0, -0.5)], lw=1.5)
    s.line([(-0.62, 0.2), (0.62, 0.2)], INK, 1.8)
    s.arrow([(0.85, 0.0), (0.85, 0.42)], FREEDOM, 1.5, both=True)
    s.text((1.4, 0.22), "capacity", size=10)


@figure
def inertance(s: Sheet) -> None:
    """Draw a column in a frictionless tube."""
    wires(s, 0.95, through="q", across="p")
    rectangle(s, 0.95, 0.24, LIQUID)
    s.dimension((-0.95, 0.24), (0.95, 0.24), "inertance", 0.26)
    s.arrow([(-0.4, 0.0), (0.45, 0.0)], THROUGH, 1.9)


@figure
def pipe(s: Sheet) -> None:
    """Draw a long tube with flanges."""
    wires(s, 1.15, through="q", across="p")
    rectangle(s, 1.15, 0.2, LIQUID)
    for x in (-1.15, 1.15):
        s.line([(x, -0.3), (x, 0.3)], lw=3.0)
    s.arrow([(-0.6, 0.0), (0.6, 0.0)], THROUGH, 1.9)
    s.text((0.0, 0.46), "resistance, inertance", size=10)


@figure
def pump(s: Sheet) -> None:
    """Draw a circle with a triangle that points to the delivery."""
    wires(s, 0.45, through="q", across="p")
    s.face(ring((0.0, 0.0), 0.45), ("#ffffff", INK))
    s.face([(-0.45, 0.0), (0.22, 0.39), (0.22, -0.39)], ("#cfcfcf", INK))
    s.text((-1.3, -0.5), "delivery", italic=False, size=9)
    s.text((1.3, -0.5), "suction", italic=False, size=9)


@figure
def pressure_source(s: Sheet) -> None:
    """Draw a source of pressure."""
    wires(s, 0.36, through="q", across="p")
    source(s, "pressure", True)


@figure
def flow_source(s: Sheet) -> None:
    """Draw a source of flow."""
    wires(s, 0.36, across="p")
    source(s, "flow", False)


@figure
def heat_capacitor(s: Sheet) -> None:
    """Draw a warm block."""
    s.line([(-1.75, 0.1), (-0.6, 0.1)], lw=1.5)
    s.face([(-0.6, -0.45), (0.75, -0.45), (0.75, 0.65), (-0.6, 0.65)], HOT)
    s.node((-1.75, 0.1), "plus", (0.0, -0.22))
    s.arrow([(-1.35, 0.3), (-0.9, 0.3)], THROUGH, 1.7)
    s.text((-1.12, 0.5), "q", THROUGH)
    s.text((0.08, 0.3), "capacity")
    s.text((0.08, -0.12), "T", FREEDOM, size=13)
    s.text((0.08, -0.75), "minus: the ground, 0 K", italic=False, size=9)


@figure
def thermal_resistor(s: Sheet) -> None:
    """Draw a wall with the temperature through it."""
    wires(s, 0.45, through="q", across="T")
    rectangle(s, 0.45, 0.55, METAL)
    s.line([(-1.0, 0.62), (-0.45, 0.42), (0.45, -0.25), (1.0, -0.4)], FREEDOM, 1.6)
    s.text((0.0, 0.72), "resistance", size=10)


@figure
def convection(s: Sheet) -> None:
    """Draw a surface in a flow."""
    wires(s, 0.5, through="q", across="T")
    s.face([(-0.5, -0.5), (-0.1, -0.5), (-0.1, 0.6), (-0.5, 0.6)], HOT)
    for i, x in enumerate((0.08, 0.24, 0.4)):
        y = np.linspace(0.0, 1.0, 30)
        wave = np.column_stack([x + 0.04 * np.sin(9 * y + i), y - 0.48])
        s.arrow(wave, SECOND[1], 1.3, head=0.1)
    s.text((0.2, 0.78), "coefficient, area", size=10)


@figure
def radiation(s: Sheet) -> None:
    """Draw rays between two surfaces."""
    wires(s, 0.75, through="q")
    for x, colors in ((-0.75, HOT), (0.63, FIRST)):
        s.face([(x, -0.5), (x + 0.12, -0.5), (x + 0.12, 0.5), (x, 0.5)], colors)
    for y in (-0.3, 0.0, 0.3):
        x = np.linspace(-0.52, 0.5, 60)
        s.arrow(np.column_stack([x, y + 0.05 * np.sin(22 * x)]), FREEDOM, 1.3, head=0.1)
    s.text((0.0, 0.72), "area, emissivity", size=10)
    s.text((-1.1, -0.6), "T at plus", FREEDOM, size=10)
    s.text((1.1, -0.6), "T at minus", FREEDOM, size=10)


@figure
def temperature_source(s: Sheet) -> None:
    """Draw a source of temperature."""
    wires(s, 0.36, through="q", across="T")
    source(s, "temperature", True)


@figure
def heat_source(s: Sheet) -> None:
    """Draw a source of heat."""
    wires(s, 0.36, across="T")
    source(s, "heat_flow", False)
