"""Figures of electrical components, as circuit diagrams draw them."""

from __future__ import annotations

import numpy as np
from drawing import FREEDOM, INK, METAL, THROUGH, Sheet, figure, ring
from symbols import rectangle, source, wires

_PAPER = ("#ffffff", INK)


def _winding(s: Sheet, x: float, side: int, low: float = -0.6, high: float = 0.6) -> None:
    """Draw half circles below one another, that bulge to one side."""
    n, radius = 4, (high - low) / 8
    for i in range(n):
        centre = (x, low + radius * (2 * i + 1))
        start = -90 if side > 0 else 90
        s.line(ring(centre, radius, start, start + 180), lw=1.6)


def _coil(s: Sheet, half: float) -> None:
    """Draw half circles in a row."""
    radius = half / 4
    for i in range(4):
        s.line(ring((-half + radius * (2 * i + 1), 0.0), radius, 0, 180), lw=1.6)


def _port(s: Sheet, x: float, name: str, side: int, reach: float) -> None:
    """Draw the two nodes of a port, one above the other, with wires to a symbol."""
    for y, sign in ((0.6, "+"), (-0.6, "−")):
        s.line([(x, y), (x - side * reach, y)], lw=1.5)
        s.node((x, y))
        s.text((x + side * 0.2, y), sign, italic=False, size=10)
    s.text((x + side * 0.12, 0.0), name, italic=False, size=9.5)
    s.arrow([(x - side * 0.12, 0.78), (x - side * 0.5, 0.78)], THROUGH, 1.5)


def _controlled(s: Sheet, by_voltage: bool, gives_voltage: bool, factor: str) -> None:
    """Draw what is measured at the left, and a source as a diamond at the right."""
    _port(s, -1.5, "control", -1, 0.5 if by_voltage else 0.8)
    if by_voltage:
        s.arrow([(-1.0, -0.45), (-1.0, 0.45)], FREEDOM, 1.4, head=0.1)
        s.text((-0.8, 0.0), "v", FREEDOM)
    else:
        s.line([(-0.7, 0.6), (-0.7, -0.6)], lw=1.5)
        s.arrow([(-0.55, 0.35), (-0.55, -0.35)], THROUGH, 1.5)
        s.text((-0.38, 0.0), "i", THROUGH)
    _port(s, 1.5, "output", 1, 0.9)
    s.line([(0.6, 0.6), (0.6, -0.6)], lw=1.5)
    s.face([(0.6, 0.4), (0.9, 0.0), (0.6, -0.4), (0.3, 0.0)], _PAPER)
    if gives_voltage:
        s.line([(0.6, 0.4), (0.6, -0.4)], lw=1.5)
    else:
        s.arrow([(0.6, 0.26), (0.6, -0.26)], THROUGH, 1.6)
    s.text((0.2, -0.95), factor, FREEDOM if gives_voltage else THROUGH, size=10)


def _waveform(s: Sheet, is_voltage: bool, points: list[tuple[float, float]], names: str) -> None:
    """Draw a source with its course over time."""
    wires(s, 0.36, through="i", across="v")
    source(s, "", is_voltage)
    color = FREEDOM if is_voltage else THROUGH
    s.arrow([(-0.75, 0.55), (0.85, 0.55)], lw=0.9, head=0.08)
    s.text((0.97, 0.55), "t", size=9.5)
    s.line([(-0.7 + 1.4 * x, 0.55 + 0.42 * y) for x, y in points], color, 1.7)
    s.text((1.5, 0.88), names, color, size=9)


_SINE = [(x, 0.45 + 0.5 * np.sin(4 * np.pi * (x - 0.2)) * (x > 0.2)) for x in np.linspace(0, 1, 90)]
_PULSE = [
    (0, 0),
    (0.15, 0),
    (0.22, 1),
    (0.42, 1),
    (0.5, 0),
    (0.65, 0),
    (0.72, 1),
    (0.92, 1),
    (1, 0),
]
_POINTS = [(0, 0.1), (0.2, 0.1), (0.4, 1), (0.65, 0.4), (0.85, 0.7), (1, 0.7)]


@figure
def resistor(s: Sheet) -> None:
    """Draw a box."""
    wires(s, 0.6, through="i", across="v")
    rectangle(s, 0.6, 0.2)
    s.text((0.0, 0.42), "resistance", size=10)


@figure
def capacitor(s: Sheet) -> None:
    """Draw two plates."""
    wires(s, 0.09, through="i", across="v")
    for x in (-0.09, 0.09):
        s.line([(x, -0.4), (x, 0.4)], lw=2.6)
    s.text((0.0, 0.6), "capacitance", size=10)


@figure
def nonlinear_capacitor(s: Sheet) -> None:
    """Draw two plates, one of them bent."""
    wires(s, 0.09, through="i", across="v")
    s.line([(-0.09, -0.4), (-0.09, 0.4)], lw=2.6)
    s.line([(0.16, -0.4), (0.09, -0.15), (0.09, 0.15), (0.16, 0.4)], lw=2.6)
    s.text((0.0, 0.6), "charge", size=10)


@figure
def three_terminal_capacitor(s: Sheet) -> None:
    """Draw two pairs of plates on a common wire."""
    for x, name in ((-0.9, "a"), (0.9, "b")):
        s.line([(x, 1.0), (x, 0.09)], lw=1.5)
        s.line([(x, -0.09), (x, -0.6)], lw=1.5)
        for y in (0.09, -0.09):
            s.line([(x - 0.35, y), (x + 0.35, y)], lw=2.6)
        s.node((x, 1.0), name, (0.2, 0.0))
        s.arrow([(x - 0.2, 0.85), (x - 0.2, 0.45)], THROUGH, 1.6)
        s.text((x - 0.5, 0.62), f"i of {name}", THROUGH, size=10)
        s.text((x + 0.75, 0.0), f"charge_{name}", size=10)
    s.line([(-0.9, -0.6), (0.9, -0.6)], lw=1.5)
    s.line([(0.0, -0.6), (0.0, -1.0)], lw=1.5)
    s.node((0.0, -1.0), "common", (0.45, 0.0))


@figure
def inductor(s: Sheet) -> None:
    """Draw a coil."""
    wires(s, 0.7, through="i", across="v")
    _coil(s, 0.7)
    s.text((0.0, 0.45), "inductance", size=10)


@figure
def nonlinear_inductor(s: Sheet) -> None:
    """Draw a coil on a core."""
    wires(s, 0.7, through="i", across="v")
    _coil(s, 0.7)
    s.line([(-0.6, 0.36), (0.6, 0.36)], lw=2.2)
    s.text((0.0, 0.6), "flux", size=10)


@figure
def switch(s: Sheet) -> None:
    """Draw a contact."""
    wires(s, 0.45, through="i", across="v")
    s.line([(-0.45, 0.0), (0.36, 0.42)], lw=2.2)
    s.line(ring((-0.45, 0.0), 0.045), lw=1.3)
    s.line(ring((0.45, 0.0), 0.045), lw=1.3)
    s.arrow(ring((-0.45, 0.0), 0.72, 24, 3), FREEDOM, 1.5)
    s.text((0.0, 0.66), "closed", FREEDOM, size=10)


@figure
def voltage_source(s: Sheet) -> None:
    """Draw a circle with a line."""
    wires(s, 0.36, through="i", across="v")
    source(s, "voltage", True)


@figure
def current_source(s: Sheet) -> None:
    """Draw a circle with an arrow."""
    wires(s, 0.36, through="i", across="v")
    source(s, "current", False)


@figure
def sine_voltage(s: Sheet) -> None:
    """Draw a source of voltage with a sine."""
    _waveform(s, True, _SINE, "amplitude")


@figure
def sine_current(s: Sheet) -> None:
    """Draw a source of current with a sine."""
    _waveform(s, False, _SINE, "amplitude")


@figure
def pulse_voltage(s: Sheet) -> None:
    """Draw a source of voltage with two pulses."""
    _waveform(s, True, _PULSE, "high, width")


@figure
def pulse_current(s: Sheet) -> None:
    """Draw a source of current with two pulses."""
    _waveform(s, False, _PULSE, "high, width")


@figure
def piecewise_voltage(s: Sheet) -> None:
    """Draw a source of voltage with a line through points."""
    _waveform(s, True, _POINTS, "times, values")


@figure
def piecewise_current(s: Sheet) -> None:
    """Draw a source of current with a line through points."""
    _waveform(s, False, _POINTS, "times, values")


@figure
def transformer(s: Sheet) -> None:
    """Draw two windings on a core."""
    _port(s, -1.5, "primary", -1, 1.2)
    _port(s, 1.5, "secondary", 1, 1.2)
    _winding(s, -0.3, 1)
    _winding(s, 0.3, -1)
    for x in (-0.05, 0.05):
        s.line([(x, -0.6), (x, 0.6)], METAL[1], 2.0)
    s.text((0.0, -0.85), "ratio", size=10)


@figure
def coupled_inductors(s: Sheet) -> None:
    """Draw two windings with a bow between."""
    _port(s, -1.5, "primary", -1, 1.1)
    _port(s, 1.5, "secondary", 1, 1.1)
    _winding(s, -0.4, 1)
    _winding(s, 0.4, -1)
    for x in (-0.55, 0.55):
        s.line(ring((x, 0.48), 0.035), lw=2.0)
    s.arrow(ring((0.0, 0.35), 0.42, 150, 30), FREEDOM, 1.2, both=True, head=0.1)
    s.text((0.0, 0.98), "coupling", FREEDOM, size=10)


@figure
def gyrator(s: Sheet) -> None:
    """Draw two half circles back to back."""
    _port(s, -1.5, "primary", -1, 1.3)
    _port(s, 1.5, "secondary", 1, 1.3)
    s.line([(-0.2, 0.6), (-0.2, -0.6)], lw=1.5)
    s.line([(0.2, 0.6), (0.2, -0.6)], lw=1.5)
    s.line(ring((-0.2, 0.0), 0.34, 90, 270), lw=1.6)
    s.line(ring((0.2, 0.0), 0.34, -90, 90), lw=1.6)
    s.text((0.0, -0.88), "conductance", size=10)


@figure
def vcvs(s: Sheet) -> None:
    """Draw a voltage that makes a voltage."""
    _controlled(s, True, True, "gain · v")


@figure
def vccs(s: Sheet) -> None:
    """Draw a voltage that makes a current."""
    _controlled(s, True, False, "transconductance · v")


@figure
def ccvs(s: Sheet) -> None:
    """Draw a current that makes a voltage."""
    _controlled(s, False, True, "transresistance · i")


@figure
def cccs(s: Sheet) -> None:
    """Draw a current that makes a current."""
    _controlled(s, False, False, "gain · i")


@figure
def ideal_op_amp(s: Sheet) -> None:
    """Draw the triangle of an amplifier."""
    for y, sign, name in ((0.35, "+", "plus"), (-0.35, "−", "minus")):
        s.line([(-1.3, y), (-0.6, y)], lw=1.5)
        s.node((-1.3, y), name, (-0.2, 0.0))
        s.text((-0.45, y), sign, italic=False, size=12)
    s.face([(-0.6, 0.75), (-0.6, -0.75), (0.65, 0.0)], _PAPER)
    for y, sign in ((0.35, "+"), (-0.35, "−")):
        s.text((-0.43, y), sign, italic=False, size=12)
    s.text((-0.05, 0.0), "∞", italic=False, size=13)
    s.line([(0.65, 0.0), (1.3, 0.0)], lw=1.5)
    s.node((1.3, 0.0), "output", (0.1, -0.22))
    s.arrow([(-0.95, -0.22), (-0.95, 0.22)], FREEDOM, 1.2, head=0.09)
    s.text((-1.22, 0.0), "0", FREEDOM, size=10)


@figure
def nullor(s: Sheet) -> None:
    """Draw an ellipse and two circles."""
    _port(s, -1.5, "input", -1, 0.8)
    s.line([(-0.7, 0.6), (-0.7, -0.6)], lw=1.5)
    angles = np.linspace(0, 2 * np.pi, 60)
    s.face(np.column_stack([-0.7 + 0.16 * np.cos(angles), 0.36 * np.sin(angles)]), _PAPER)
    s.text((-0.35, 0.0), "0, 0", FREEDOM, size=9.5)
    _port(s, 1.5, "output", 1, 0.8)
    s.line([(0.7, 0.6), (0.7, -0.6)], lw=1.5)
    for y in (-0.17, 0.17):
        s.line(ring((0.7, y), 0.19), lw=1.5)
    s.text((0.34, 0.0), "v, i", THROUGH, size=9.5)


@figure
def diode(s: Sheet) -> None:
    """Draw a triangle against a bar."""
    wires(s, 0.3, through="i", across="v")
    s.face([(-0.3, 0.34), (-0.3, -0.34), (0.3, 0.0)], ("#cfcfcf", INK))
    s.line([(0.3, 0.34), (0.3, -0.34)], lw=2.4)


def _bipolar(s: Sheet, is_npn: bool) -> None:
    s.line([(-1.2, 0.0), (-0.25, 0.0)], lw=1.5)
    s.line([(-0.25, 0.45), (-0.25, -0.45)], lw=3.0)
    s.node((-1.2, 0.0), "base", (0.0, -0.22))
    emitter = -1 if is_npn else 1
    for side, name in ((-emitter, "collector"), (emitter, "emitter")):
        bend, end = (0.45, 0.62 * side), (0.45, 0.95 * side)
        s.line([(-0.25, 0.2 * side), bend, end], lw=1.5)
        s.node(end, name, (0.2, 0.0))
    inner, outer = (-0.25, 0.2 * emitter), (0.45, 0.62 * emitter)
    tip = [inner, (0.22, 0.48 * emitter)] if is_npn else [outer, (-0.16, 0.26 * emitter)]
    s.arrow(tip, INK, 1.5, head=0.2)
    s.arrow([(-0.95, 0.16), (-0.55, 0.16)], THROUGH, 1.5)
    s.text((-0.75, 0.35), "ib", THROUGH)
    for side, name in ((-emitter, "ic"), (emitter, "ie")):
        s.arrow([(0.66, 0.72 * side), (0.66, 0.38 * side)], THROUGH, 1.5)
        s.text((0.86, 0.5 * side), name, THROUGH)


@figure
def bjt_npn(s: Sheet) -> None:
    """Draw a transistor whose arrow points outwards."""
    _bipolar(s, True)


@figure
def bjt_pnp(s: Sheet) -> None:
    """Draw a transistor whose arrow points inwards."""
    _bipolar(s, False)


def _field_effect(s: Sheet, is_n: bool) -> None:
    s.line([(-1.2, 0.0), (-0.4, 0.0)], lw=1.5)
    s.line([(-0.4, 0.42), (-0.4, -0.42)], lw=2.2)
    s.line([(-0.22, 0.5), (-0.22, -0.5)], lw=2.6)
    s.node((-1.2, 0.0), "gate", (0.0, -0.22))
    lower = -1 if is_n else 1
    for side, name in ((-lower, "drain"), (lower, "source")):
        end = (0.45, 0.95 * side)
        s.line([(-0.22, 0.38 * side), (0.45, 0.38 * side), end], lw=1.5)
        s.node(end, name, (0.2, 0.0))
    ends = [(-0.22, 0.38 * lower), (0.2, 0.38 * lower)]
    s.arrow(ends if is_n else [(0.45, 0.38 * lower), (-0.1, 0.38 * lower)], INK, 1.5, head=0.2)
    s.arrow([(0.66, -0.85 * lower), (0.66, -0.5 * lower)], THROUGH, 1.5)
    s.text((0.86, -0.65 * lower), "id", THROUGH)


@figure
def mosfet_n(s: Sheet) -> None:
    """Draw a field-effect transistor with its source below."""
    _field_effect(s, True)


@figure
def mosfet_p(s: Sheet) -> None:
    """Draw a field-effect transistor with its source above."""
    _field_effect(s, False)


@figure
def battery_cell(s: Sheet) -> None:
    """Draw a resistor, a pair and a store of charge in a row."""
    s.line([(-1.9, 0.0), (1.9, 0.0)], lw=1.5)
    s.node((-1.9, 0.0), "plus", (0.05, -0.22))
    s.node((1.9, 0.0), "minus", (-0.05, -0.22))
    s.arrow([(-1.75, 0.2), (-1.4, 0.2)], THROUGH, 1.6)
    s.text((-1.58, 0.39), "i", THROUGH)
    s.face([(-1.25, -0.12), (-0.7, -0.12), (-0.7, 0.12), (-1.25, 0.12)], _PAPER)
    s.text((-0.97, 0.3), "resistance", size=8.5)
    s.face([(-0.35, -0.3), (0.45, -0.3), (0.45, 0.3), (-0.35, 0.3)], _PAPER)
    s.line([(-0.35, 0.3), (0.02, 0.3)], lw=1.5)
    s.face([(-0.2, 0.2), (0.3, 0.2), (0.3, 0.4), (-0.2, 0.4)], _PAPER)
    s.face([(0.0, -0.31), (0.1, -0.31), (0.1, -0.29), (0.0, -0.29)], ("#ffffff", "#ffffff"))
    for x in (0.0, 0.1):
        s.line([(x, -0.48), (x, -0.12)], lw=2.2)
    s.text((0.05, 0.58), "resistance1", size=8.5)
    s.text((0.05, -0.64), "capacitance1", size=8.5)
    s.face([(0.98, -0.3), (1.12, -0.3), (1.12, 0.3), (0.98, 0.3)], ("#ffffff", "#ffffff"))
    s.line([(0.98, -0.34), (0.98, 0.34)], lw=1.8)
    s.line([(1.12, -0.18), (1.12, 0.18)], lw=3.4)
    s.text((1.08, 0.5), "soc", FREEDOM, size=10)
    s.arrow([(1.4, -0.85), (-1.4, -0.85)], FREEDOM, 1.3, head=0.1)
    s.text((0.0, -1.02), "v", FREEDOM)
