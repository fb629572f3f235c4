"""Symbols of scalar components: nodes, wires, and what lies between."""

from __future__ import annotations

import numpy as np
from drawing import FREEDOM, INK, THROUGH, Array, Sheet, ring

Point = tuple[float, float]

#: Names of the nodes, in order, where the first has the higher across variable.
PLUS_MINUS = ("plus", "minus")
#: Names of the nodes of one-dimensional mechanics.
FIRST_SECOND = ("first", "second")

LIQUID = ("#d5e8f7", "#5a8fb8")
HOT = ("#f6d9cf", "#b86a4b")


def wires(
    s: Sheet,
    half: float,
    names: tuple[str, str] = PLUS_MINUS,
    through: str = "",
    across: str = "",
) -> None:
    """Draw two nodes with wires to a symbol of some width, the through and the across variable.

    Flow goes from plus to minus; a force pulls at both nodes.
    """
    end, is_flow = 1.75, names == PLUS_MINUS
    s.line([(-end, 0), (-half, 0)], lw=1.5)
    s.line([(half, 0), (end, 0)], lw=1.5)
    for x, name in zip((-end, end), names, strict=True):
        s.node((x, 0), name, (0.0, -0.22))
    x = (half + end) / 2
    if through and is_flow:
        s.arrow([(-x - 0.22, 0.2), (-x + 0.22, 0.2)], THROUGH, 1.7)
        s.text((-x, 0.39), through, THROUGH)
    elif through:
        for side in (-1, 1):
            s.arrow([(side * (x - 0.22), 0.2), (side * (x + 0.22), 0.2)], THROUGH, 1.7)
        s.text((x, 0.39), through, THROUGH)
    if across:
        tip = -1.4 if is_flow else 1.4
        s.arrow([(-tip, -0.72), (tip, -0.72)], FREEDOM, 1.3, head=0.1)
        s.text((0.0, -0.9), across, FREEDOM)


def source(s: Sheet, letter: str, is_across: bool) -> None:
    """Draw a circle: with a line for what is given across, with an arrow for what flows."""
    s.face(ring((0.0, 0.0), 0.36), ("#ffffff", INK))
    if is_across:
        s.line([(-0.36, 0.0), (0.36, 0.0)], lw=1.5)
    else:
        s.arrow([(-0.25, 0.0), (0.25, 0.0)], THROUGH, 1.8)
    s.text((0.0, 0.54), letter, FREEDOM if is_across else THROUGH)


def rectangle(
    s: Sheet, half: float, height: float, colors: tuple[str, str] = ("#ffffff", INK), y: float = 0.0
) -> None:
    """Draw a box about the middle."""
    low, high = y - height, y + height
    s.face([(-half, low), (half, low), (half, high), (-half, high)], colors)


def wheel(s: Sheet, centre: Point, radius: float, teeth: int, colors: tuple[str, str]) -> None:
    """Draw a toothed wheel."""
    points = []
    for i in range(teeth):
        for place, r in ((-0.3, -0.05), (-0.17, 0.05), (0.17, 0.05), (0.3, -0.05)):
            a = 2 * np.pi * (i + place) / teeth
            points.append(
                (centre[0] + (radius + r) * np.cos(a), centre[1] + (radius + r) * np.sin(a))
            )
    s.face(points, colors)


def curve(x: Array, y: Array, centre: Point, width: float, height: float) -> Array:
    """Fit a curve into a frame: x from 0 to 1, y from -1 to 1."""
    return np.column_stack([centre[0] + width * (2 * x - 1), centre[1] + height * y])
