"""Rotations of frames as numbers: quarter turns give exact zeros, which fold away."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

Rows = list[list[float]]

#: Share of an angle within which it is a quarter turn that was written with all digits.
_ROUNDING = 4e-16
_QUARTERS = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))


def rotation_rows(rpy: Sequence[float], snap: float) -> Rows | None:
    """Form Rz(yaw) Ry(pitch) Rx(roll), which takes components of the turned frame to the first's.

    Parameters
    ----------
    rpy : sequence of three float
        Roll, pitch and yaw about the first frame's x, y and z axis, [rad].
    snap : float
        Angles this close to a multiple of a quarter turn are taken as that, [rad].

    Returns
    -------
    list of three rows of three float, or None
        None if nothing turns.
    """
    (cr, sr), (cp, sp), (cy, sy) = (_cosine_and_sine(angle, snap) for angle in rpy)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    rows = [[entry + 0.0 for entry in row] for row in rows]  # no negative zeros
    identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    # Without a rotation the axes of both nodes are the same, and no product is formed with them.
    return None if rows == identity else rows


def _cosine_and_sine(angle: float, snap: float) -> tuple[float, float]:
    quarters = round(angle / (0.5 * math.pi))
    # A quarter turn in decimals is off by the rounding of its last digit.
    gap = abs(angle - quarters * 0.5 * math.pi)
    if gap <= max(snap, _ROUNDING * abs(angle)):
        return _QUARTERS[quarters % 4]
    return math.cos(angle), math.sin(angle)
