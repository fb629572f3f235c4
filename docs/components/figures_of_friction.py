"""Figures of what sticks and slides, and of play."""

from __future__ import annotations

from drawing import FIRST, FREEDOM, INK, METAL, SECOND, THROUGH, Sheet, figure, ring
from symbols import FIRST_SECOND, wheel, wires


def _pulled(s: Sheet, half: float, through: str, across: str) -> None:
    wires(s, half, FIRST_SECOND, through, across)


def _rough(s: Sheet, y: float, start: float, stop: float) -> None:
    n = round((stop - start) / 0.1)
    step = (stop - start) / n
    teeth = [(start + step * (i / 2), y + (0.05 if i % 2 else 0.0)) for i in range(2 * n + 1)]
    s.line(teeth, INK, 1.0)


def _block(s: Sheet) -> None:
    s.face([(-0.7, -0.34), (0.7, -0.34), (0.7, -0.16), (-0.7, -0.16)], FIRST)
    s.face([(-0.4, -0.1), (0.5, -0.1), (0.5, 0.3), (-0.4, 0.3)], SECOND)
    _rough(s, -0.15, -0.5, 0.6)
    s.line([(0.5, 0.0), (0.72, 0.0)], lw=1.5)
    s.line([(-0.7, 0.0), (-0.7, -0.2)], lw=1.5)


@figure
def translational_dry_friction(s: Sheet) -> None:
    """Draw a block on a rough surface."""
    _pulled(s, 0.7, "f", "v")
    _block(s)


def _brush(s: Sheet) -> None:
    s.face([(-0.7, -0.4), (0.7, -0.4), (0.7, -0.22), (-0.7, -0.22)], FIRST)
    s.face([(-0.4, 0.0), (0.5, 0.0), (0.5, 0.36), (-0.4, 0.36)], SECOND)
    for i in range(9):
        x = -0.32 + 0.09 * i
        s.line([(x + 0.08, 0.0), (x, -0.22)], INK, 1.0)
    s.line([(0.5, 0.0), (0.72, 0.0)], lw=1.5)
    s.line([(-0.7, 0.0), (-0.7, -0.3)], lw=1.5)


@figure
def translational_lugre(s: Sheet) -> None:
    """Draw a block on bristles."""
    _pulled(s, 0.7, "f", "v")
    _brush(s)
    s.text((-0.62, -0.1), "z", FREEDOM)


@figure
def rotational_lugre(s: Sheet) -> None:
    """Draw a shaft on bristles."""
    _pulled(s, 0.6, "tau", "w")
    s.face(ring((0.0, 0.0), 0.6), FIRST)
    s.face(ring((0.0, 0.0), 0.32), SECOND)
    for i in range(16):
        a = 22.5 * i
        inner = ring((0.0, 0.0), 0.32, a, a)[0]
        outer = ring((0.0, 0.0), 0.6, a + 10, a + 10)[0]
        s.line([inner, outer], INK, 1.0)
    s.node((0.0, 0.0))


@figure
def translational_brake(s: Sheet) -> None:
    """Draw a block that is pressed onto a rough surface."""
    _pulled(s, 0.7, "f", "v")
    _block(s)
    s.arrow([(0.05, 0.85), (0.05, 0.36)], THROUGH, 1.8)
    s.text((0.62, 0.72), "normal_force", THROUGH, size=9)


def _faces(s: Sheet, *, is_fixed: bool = False) -> None:
    left = METAL if is_fixed else FIRST
    s.face([(-0.2, -0.5), (-0.06, -0.5), (-0.06, 0.5), (-0.2, 0.5)], left)
    s.face([(0.06, -0.5), (0.2, -0.5), (0.2, 0.5), (0.06, 0.5)], SECOND)
    for y in (-0.36, -0.12, 0.12, 0.36):
        s.line([(-0.05, y - 0.06), (0.05, y + 0.06)], INK, 1.0)
    s.line([(-0.6, 0.0), (-0.2, 0.0)], lw=1.5)
    s.line([(0.2, 0.0), (0.6, 0.0)], lw=1.5)


@figure
def rotational_dry_friction(s: Sheet) -> None:
    """Draw a shaft in a rough bearing."""
    _pulled(s, 0.6, "tau", "w")
    s.face(ring((0.0, 0.0), 0.6), FIRST)
    s.face(ring((0.0, 0.0), 0.4), SECOND)
    for i in range(12):
        inner = ring((0.0, 0.0), 0.42, 30 * i, 30 * i)[0]
        outer = ring((0.0, 0.0), 0.52, 30 * i + 8, 30 * i + 8)[0]
        s.line([inner, outer], INK, 1.0)
    s.node((0.0, 0.0))


@figure
def clutch(s: Sheet) -> None:
    """Draw two faces that are pressed together."""
    _pulled(s, 0.6, "tau", "w")
    _faces(s)
    for side in (-1, 1):
        s.arrow([(side * 0.75, 0.62), (side * 0.3, 0.62)], THROUGH, 1.7)
    s.text((0.0, 0.84), "normal_force", THROUGH, size=9)


@figure
def brake(s: Sheet) -> None:
    """Draw a disc between two pads."""
    _pulled(s, 0.6, "tau", "w")
    s.face([(-0.08, -0.45), (0.08, -0.45), (0.08, 0.55), (-0.08, 0.55)], SECOND)
    for side in (-1, 1):
        x = side * 0.12
        s.face([(x, 0.2), (x + side * 0.2, 0.2), (x + side * 0.2, 0.5), (x, 0.5)], METAL)
        s.arrow([(side * 0.95, 0.62), (side * 0.4, 0.4)], THROUGH, 1.7)
    s.line([(-0.6, 0.0), (0.6, 0.0)], lw=1.5)
    s.text((0.0, 0.8), "normal_force", THROUGH, size=9)


@figure
def one_way_clutch(s: Sheet) -> None:
    """Draw a ratchet."""
    _pulled(s, 0.62, "tau", "w")
    s.face(ring((0.0, 0.0), 0.62), FIRST)
    teeth = []
    for i in range(10):
        teeth += [
            ring((0.0, 0.0), 0.36, 36 * i, 36 * i)[0],
            ring((0.0, 0.0), 0.5, 36 * i, 36 * i)[0],
        ]
    s.face(teeth, SECOND)
    s.line([(0.28, 0.56), (0.02, 0.42)], INK, 2.4)
    s.arrow(ring((0.0, 0.0), 0.78, 120, 60), FREEDOM, 1.7)


@figure
def lossy_gear(s: Sheet) -> None:
    """Draw two wheels in mesh, one of which rubs."""
    wheel(s, (-0.35, 0.0), 0.42, 16, FIRST)
    wheel(s, (0.78, 0.0), 0.68, 26, SECOND)
    s.node((-0.35, 0.0), "input", (0.0, -0.62))
    s.node((0.78, 0.0), "output", (0.0, -0.86))
    s.arrow(ring((-0.35, 0.0), 0.6, 100, 210), FREEDOM, 1.7)
    s.text((-1.15, 0.3), "w", FREEDOM)
    s.arrow([(0.1, 0.1), (0.1, 0.75)], THROUGH, 1.7)
    s.text((0.1, 0.95), "loss", THROUGH, size=10)


def _play(s: Sheet) -> None:
    s.face([(-0.85, -0.42), (0.85, -0.42), (0.85, 0.42), (-0.85, 0.42)], FIRST)
    s.face([(-0.72, -0.3), (0.72, -0.3), (0.72, 0.3), (-0.72, 0.3)], ("#ffffff", INK))
    s.face([(-0.14, -0.18), (0.14, -0.18), (0.14, 0.18), (-0.14, 0.18)], SECOND)
    for side in (-1, 1):
        s.coil((side * 0.72, 0.0), (side * 0.34, 0.0), 4, 0.09)
        s.line([(side * 0.34, -0.16), (side * 0.34, 0.16)], INK, 1.6)
        s.line([(side * 0.34, 0.16), (side * 0.34, 0.52)], lw=0.8)
    s.text((-0.38, 0.62), "lower", size=10)
    s.text((0.38, 0.62), "upper", size=10)


@figure
def translational_backlash(s: Sheet) -> None:
    """Draw a block between two springs that it does not touch."""
    _pulled(s, 0.85, "f", "v, s")
    _play(s)
    s.line([(0.14, -0.1), (0.9, -0.1)], lw=1.5)


@figure
def rotational_backlash(s: Sheet) -> None:
    """Draw a claw with play between two others."""
    _pulled(s, 0.7, "tau", "w, theta")
    s.face(ring((0.0, 0.0), 0.7), FIRST)
    s.face([(0.0, 0.0), *ring((0.0, 0.0), 0.6, 40, 140)], ("#ffffff", INK))
    s.face([(0.0, 0.0), *ring((0.0, 0.0), 0.5, 80, 100)], SECOND)
    s.text((-0.72, 0.62), "upper", size=10)
    s.text((0.72, 0.62), "lower", size=10)
