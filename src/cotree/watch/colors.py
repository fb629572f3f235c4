"""Colours."""

from __future__ import annotations

#: Red, green and blue, 0 to 255.
Color = tuple[int, int, int]

#: Colours of the bodies, one after another; neighbours differ in lightness too.
BODIES: tuple[Color, ...] = (
    (66, 122, 181),
    (233, 146, 62),
    (92, 163, 92),
    (200, 88, 86),
    (139, 112, 184),
    (148, 123, 98),
    (214, 138, 182),
    (64, 166, 166),
)
GROUND: Color = (158, 164, 170)
JOINT: Color = (66, 74, 86)
RAIL: Color = (186, 191, 197)
SPRING: Color = (44, 150, 138)
DAMPER: Color = (120, 132, 146)
FORCE: Color = (205, 70, 70)
