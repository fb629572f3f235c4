"""Triangle meshes, in metres, along the z axis, centred or from z = 0 to z = 1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

_ROUND = 28  # number of sides of round shapes


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh; corners are counter-clockwise as seen from outside."""

    points: Array  # corner points of the mesh
    faces: Indices  # indices of corners, three per face

    def placed(self, position: Array, axes: Array | None = None) -> Mesh:
        """Return the mesh rotated by ``axes``, then translated by ``position``."""
        turned = self.points if axes is None else self.points @ axes.T
        return Mesh(turned + position, self.faces)

    def scaled(self, factors: Sequence[float] | Array) -> Mesh:
        """Return the mesh scaled along the axes; if it is mirrored, faces are reversed."""
        factors = np.asarray(factors, dtype=float)
        faces = self.faces[:, ::-1] if np.prod(np.sign(factors)) < 0 else self.faces
        return Mesh(self.points * factors, faces)


def joined(meshes: Iterable[Mesh]) -> Mesh:
    """Combine several meshes into one."""
    points, faces, n = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)], 0
    for mesh in meshes:
        points.append(mesh.points)
        faces.append(mesh.faces + n)
        n += len(mesh.points)
    return Mesh(np.concatenate(points), np.concatenate(faces))


def box(a: float, b: float, c: float) -> Mesh:
    """Return a box centred at the origin with these lengths along x, y and z, [m]."""
    corners = [[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
    # Four corners of each side, counter-clockwise from outside. Bits of a number are x, y and z.
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [t for i, j, k, m in sides for t in ((i, j, k), (i, k, m))]
    return Mesh(np.array(corners) * [a, b, c], np.array(faces))


def turned(profile: Sequence[tuple[float, float]], sides: int = _ROUND) -> Mesh:
    """Rotate a profile of (radius, height) about z; it runs upwards on the outside."""
    angles = 2 * np.pi * np.arange(sides) / sides
    rows = [
        np.column_stack([r * np.cos(angles), r * np.sin(angles), np.full(sides, z)])
        for r, z in profile
    ]
    here, after = np.arange(sides), (np.arange(sides) + 1) % sides
    faces = []
    for i in range(len(profile) - 1):
        a, b = i * sides, (i + 1) * sides
        # On the axis, all corners of a ring coincide, so one of the two triangles is degenerate.
        if profile[i][0] > 0.0:
            faces.append(np.column_stack([a + here, a + after, b + after]))
        if profile[i + 1][0] > 0.0:
            faces.append(np.column_stack([a + here, b + after, b + here]))
    return Mesh(np.concatenate(rows), np.concatenate(faces))


def cylinder(radius: float, length: float) -> Mesh:
    """Return a cylinder."""
    h = 0.5 * length
    return turned([(0.0, -h), (radius, -h), (radius, h), (0.0, h)])


def sphere(radius: float) -> Mesh:
    """Return a sphere."""
    angles = np.linspace(-0.5 * np.pi, 0.5 * np.pi, _ROUND // 2 + 1)
    profile = [(radius * float(np.cos(a)), radius * float(np.sin(a))) for a in angles]
    # The end points are exactly zero; the cosine of a right angle would be 6e-17.
    profile[0], profile[-1] = (0.0, -radius), (0.0, radius)
    return turned(profile)


def capsule(radius: float, length: float) -> Mesh:
    """Return a cylinder along z that ends in hemispheres."""
    angles = np.linspace(-0.5 * np.pi, 0.0, _ROUND // 4 + 1)
    low = [(radius * float(np.cos(a)), radius * float(np.sin(a)) - 0.5 * length) for a in angles]
    low[0] = (0.0, low[0][1])
    return turned([*low, *((r, -z) for r, z in reversed(low))])


def plate(radius: float, length: float, thickness: float) -> Mesh:
    """Return a flat bar with round ends, long along z between their centres, and thin along y."""
    half = np.pi * np.arange(_ROUND // 2 + 1) / (_ROUND // 2)
    x, z = radius * np.cos(half), radius * np.sin(half)
    outline = np.column_stack(
        [np.concatenate([x, -x]), np.concatenate([z + 0.5 * length, -z - 0.5 * length])]
    )
    return extruded(outline, thickness)


def extruded(outline: Array, thickness: float) -> Mesh:
    """Extrude a convex outline (x, z), counter-clockwise in this plane, along y to a plate."""
    n, h = len(outline), 0.5 * thickness
    side = [np.column_stack([outline[:, 0], np.full(n, y), outline[:, 1]]) for y in (h, -h)]
    here, after = np.arange(n), (np.arange(n) + 1) % n
    fan = np.column_stack([np.zeros(n - 2, dtype=np.int64), here[1:-1], after[1:-1]])
    walls = [
        np.column_stack([here, n + after, n + here]),
        np.column_stack([here, after, n + after]),
    ]
    # Seen from +y, the rotation from x to z is clockwise.
    return Mesh(np.concatenate(side), np.concatenate([fan[:, ::-1], n + fan, *walls]))


def ring(radius: float, inner: float, length: float) -> Mesh:
    """Return a cylinder along z with a hole."""
    h = 0.5 * length
    # Wheels are large and have twice the number of sides.
    return turned([(inner, h), (inner, -h), (radius, -h), (radius, h), (inner, h)], 2 * _ROUND)


def wheel(radius: float, thickness: float) -> Mesh:
    """Return a wheel with spokes, which make its rotation visible."""
    rim = ring(radius, 0.86 * radius, thickness)
    spoke = box(1.76 * radius, 0.1 * radius, 0.5 * thickness)
    angles = np.pi * np.arange(3) / 3
    return joined([rim, *(spoke.placed(np.zeros(3), about_z(float(a))) for a in angles)])


def rod(radius: float) -> Mesh:
    """Return a cylinder from zero to one along z."""
    return cylinder(radius, 1.0).placed(np.array([0.0, 0.0, 0.5]))


def coil(radius: float, wire: float, length: float) -> Mesh:
    """Return a helical spring from zero to one along z; its wire is round at ``length``, [m]."""
    turns, around = 9, 6
    n = 16 * turns
    u = np.linspace(0.0, 1.0, n + 1)
    # The first and the last half turn lead from the axis to the coil.
    away = radius * np.clip(2.0 * turns * np.minimum(u, 1.0 - u), 0.0, 1.0)
    angles = 2 * np.pi * turns * u
    path = np.column_stack([away * np.cos(angles), away * np.sin(angles), 0.1 + 0.8 * u])
    tangent = np.gradient(path[:, :2], axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    across = np.column_stack([tangent[:, 1], -tangent[:, 0], np.zeros(n + 1)])
    turn = 2 * np.pi * np.arange(around) / around
    # The coil has length one; later stretching also stretches the height of its wire.
    up = np.array([0.0, 0.0, wire / length])
    rings = path[:, None] + wire * np.cos(turn)[:, None] * across[:, None]
    rings = rings + np.sin(turn)[:, None] * up
    a = (np.arange(n)[:, None] * around + np.arange(around)).ravel()
    b = (np.arange(n)[:, None] * around + (np.arange(around) + 1) % around).ravel()
    faces = np.concatenate(
        [np.column_stack([a, a + around, b]), np.column_stack([b, a + around, b + around])]
    )
    ends = [rod(wire).scaled([1, 1, 0.1]).placed(np.array([0, 0, z])) for z in (0.0, 0.9)]
    return joined([Mesh(rings.reshape(-1, 3), faces), *ends])


def piston(radius: float) -> Mesh:
    """Return a damper or cylinder from zero to one along z: a barrel and its rod."""
    barrel = cylinder(radius, 0.5).placed(np.array([0.0, 0.0, 0.37]))
    return joined([rod(0.35 * radius), barrel])


def about_z(angle: float) -> Array:
    """Return the rotation matrix about z."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def axes_along(z: Array, y: Array | None = None) -> Array:
    """Return right-handed axes with z along a vector, and y as close as possible to another."""
    z = z / np.linalg.norm(z)
    # The coordinate axis closest to perpendicular to z.
    near = np.eye(3)[int(np.argmin(np.abs(z)))] if y is None else y
    x = np.cross(near, z)
    # If both directions are parallel, y is arbitrary.
    if np.linalg.norm(x) < 1e-9:
        return axes_along(z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


#: Colour: red, green and blue, from 0 to 255.
Color = tuple[int, int, int]

#: Colours of the bodies, in order; adjacent colours also differ in lightness.
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
