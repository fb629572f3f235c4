"""Figures of chemical and electrochemical components."""

from __future__ import annotations

import numpy as np
from drawing import FREEDOM, INK, METAL, THROUGH, Sheet, figure, ring
from symbols import LIQUID, curve, rectangle, source, wires


def _flask(s: Sheet, x: float, name: str) -> None:
    s.face([(x - 0.42, -0.5), (x + 0.42, -0.5), (x + 0.42, 0.2), (x - 0.42, 0.2)], LIQUID)
    s.line([(x - 0.42, 0.5), (x - 0.42, -0.5), (x + 0.42, -0.5), (x + 0.42, 0.5)], lw=1.8)
    s.text((x, -0.15), name, size=12)


@figure
def species(s: Sheet) -> None:
    """Draw a stirred vessel."""
    _flask(s, 0.2, "c")
    s.line([(0.2, 0.85), (0.2, 0.1)], METAL[1], 1.6)
    s.line([(0.02, 0.06), (0.38, 0.14)], METAL[1], 2.4)
    s.line([(-1.6, -0.15), (-0.22, -0.15)], lw=1.5)
    s.node((-1.6, -0.15), "plus", (0.0, -0.22))
    s.arrow([(-1.2, 0.05), (-0.75, 0.05)], THROUGH, 1.7)
    s.text((-0.98, 0.25), "n", THROUGH)
    s.text((1.15, -0.15), "volume", size=10)


@figure
def reaction(s: Sheet) -> None:
    """Draw what comes and what goes."""
    rectangle(s, 0.5, 0.4, LIQUID)
    s.text((0.0, 0.0), "rate")
    for y, name in ((0.5, "A"), (-0.5, "B")):
        s.node((-1.7, y), name, (0.0, -0.2))
        s.arrow([(-1.55, y), (-0.55, 0.4 * y)], THROUGH, 1.6)
    s.node((1.7, 0.0), "C", (0.0, -0.2))
    s.arrow([(0.55, 0.0), (1.55, 0.0)], THROUGH, 1.6)
    s.text((-1.3, 0.95), "reactants", size=10)
    s.text((1.4, 0.45), "products", size=10)


@figure
def molar_flow_source(s: Sheet) -> None:
    """Draw a source of molar flow."""
    wires(s, 0.36, across="c")
    source(s, "flow", False)


@figure
def concentration_source(s: Sheet) -> None:
    """Draw a source of concentration."""
    wires(s, 0.36, through="n", across="c")
    source(s, "concentration", True)


@figure
def open_circuit_voltage(s: Sheet) -> None:
    """Draw a cell with its curve."""
    wires(s, 0.1, through="i", across="v")
    s.line([(-0.1, -0.42), (-0.1, 0.42)], lw=1.8)
    s.line([(0.1, -0.22), (0.1, 0.22)], lw=4.0)
    rectangle(s, 0.42, 0.26, ("#ffffff", INK), 0.8)
    x = np.linspace(0.02, 0.98, 40)
    y = 0.5 * (x - 0.5) + 0.08 * np.log(x / (1 - x)) * 1.4
    s.line(curve(x, y, (0.0, 0.8), 0.4, 0.34), FREEDOM, 1.6)
    s.text((0.75, 0.72), "soc", FREEDOM, size=10)


@figure
def butler_volmer(s: Sheet) -> None:
    """Draw a box with the curve of the kinetics."""
    wires(s, 0.55, through="i", across="v")
    rectangle(s, 0.55, 0.5)
    s.line([(-0.5, 0.0), (0.5, 0.0)], lw=0.7)
    s.line([(0.0, -0.45), (0.0, 0.45)], lw=0.7)
    x = np.linspace(0.0, 1.0, 60)
    s.line(curve(x, np.sinh(6 * (x - 0.5)) / np.sinh(3), (0.0, 0.0), 0.42, 0.44), THROUGH, 1.8)


@figure
def double_layer(s: Sheet) -> None:
    """Draw ions before a metal."""
    wires(s, 0.5, through="i", across="v")
    s.face([(-0.5, -0.5), (-0.12, -0.5), (-0.12, 0.5), (-0.5, 0.5)], METAL)
    s.face([(-0.12, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.12, 0.5)], LIQUID)
    for y in (-0.33, 0.0, 0.33):
        s.text((-0.22, y), "+", "#ffffff", italic=False, size=12)
        s.face(ring((0.04, y), 0.09), ("#ffffff", INK), 0.9)
        s.text((0.04, y), "−", italic=False, size=9)
    s.text((0.0, 0.68), "area", size=10)


@figure
def nernst(s: Sheet) -> None:
    """Draw an electrode with two sides."""
    wires(s, 0.36, through="i", across="v")
    source(s, "oxidised / reduced", True)
