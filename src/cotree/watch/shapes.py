"""Triangle meshes, in metres: shapes, and meshes of robots.

Shapes extend along the z axis, centred or from z = 0 to z = 1. Files of robots are found, read and
coarsened: STL and OBJ here, other formats by trimesh. They are untrusted, so sizes are limited and
every number is checked.
"""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, urlparse

import numpy as np
import numpy.typing as npt

from cotree.readers.urdf.scene import rotation_rows

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from cotree.scene.description import Origin, Visual
    from cotree.watch.stage import Place

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


#: Maximum file size of a mesh, [byte].
LARGEST_FILE = 80_000_000

_LARGEST_LENGTH = 1e6  # maximum coordinate, [m]
_MOST_FACES = 2_000_000
# A triangle of binary STL: normal, three corners, an unused word; 50 bytes, packed.
_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


class MeshError(Exception):
    """Error for a mesh that cannot be read; the message is the reason."""


def find_mesh(name: str, beside: Path, *, trust_paths: bool = False) -> Path:
    """Return the file of a mesh from a path, ``file://`` or ``package://PACKAGE/...``.

    Packages are in the folder of the robot's file, in folders above it or on ROS_PACKAGE_PATH.
    Unless ``trust_paths``, the mesh must be inside its package or the folder of the robot's file,
    so that an untrusted file cannot copy other files into an animation. Raise MeshError otherwise.
    """
    scheme, _, rest = name.rpartition("://")
    # Other schemes could access a network.
    if scheme not in ("", "file", "package", "model"):
        raise MeshError(f"'{name[:80]}' is not a file name")
    if "\0" in name:
        raise MeshError("its name contains a NUL")
    if scheme in ("", "file"):
        path = unquote(urlparse(name).path) if scheme else rest
        places = [(beside.parent, folder / path) for folder in (Path(), beside.parent)]
    else:
        places = _package_places(rest, beside)
    outside = False
    try:
        for folder, place in places:
            if place.is_file():
                # Symbolic links must not lead out of the folder.
                if trust_paths or place.resolve().is_relative_to(folder.resolve()):
                    return place
                outside = True
    except OSError:
        pass  # OSError: the name is too long for a path
    if outside:
        raise MeshError(
            f"'{name[:80]}' lies outside the robot's folder: give trust_paths=True to read it"
        )
    raise MeshError(f"'{name[:80]}' is not found")


def _package_places(name: str, beside: Path) -> list[tuple[Path, Path]]:
    """Return candidates for a mesh's package folder, each with the path of the mesh in it."""
    package, _, inner = name.partition("/")
    above = beside.resolve().parents
    listed = [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
    places = []
    for folder in (*above, *listed):
        # The folder may contain the package or be the package itself.
        places.append((folder / package, folder / package / inner))
        if folder.name == package:
            places.append((folder, folder / inner))
    return places


def read_mesh(path: Path) -> Mesh:
    """Read a mesh; raise MeshError if it cannot be read or is too large."""
    try:
        # Check the size first, because the whole file is read at once.
        if path.stat().st_size > LARGEST_FILE:
            raise MeshError(f"'{path.name}' has more than {LARGEST_FILE // 1_000_000} MB")
        data = path.read_bytes()
    except OSError as error:
        raise MeshError(f"'{path.name}' cannot be read: {error.strerror}") from None
    suffix = path.suffix.lower()
    try:
        if suffix == ".stl":
            mesh = _read_stl(data)
        elif suffix == ".obj":
            mesh = _read_obj(data.decode("utf-8", errors="replace"))
        else:
            mesh = _read_other(data, suffix)
    except (ValueError, IndexError, OverflowError) as error:
        raise MeshError(f"'{path.name}' is not a mesh: {str(error)[:80]}") from None
    return _checked(mesh, path.name)


def _checked(mesh: Mesh, name: str) -> Mesh:
    points, faces = mesh.points, mesh.faces
    if not len(faces):
        raise MeshError(f"'{name}' has no triangles")
    if len(faces) > _MOST_FACES:
        raise MeshError(f"'{name}' has more than {_MOST_FACES} triangles")
    if faces.min() < 0 or faces.max() >= len(points):
        raise MeshError(f"'{name}' names corners that it does not have")
    if not np.isfinite(points).all() or np.abs(points).max() > _LARGEST_LENGTH:
        raise MeshError(f"'{name}' has corners that are not finite or too large")
    # STL repeats a corner in each of its triangles, so merge equal corners.
    corners, place = np.unique(points, axis=0, return_inverse=True)
    return Mesh(corners, place.reshape(-1)[faces])


def _read_stl(data: bytes) -> Mesh:
    """Read STL: binary if the length matches the number of triangles, else text."""
    # The number of triangles follows 80 bytes, which may begin with "solid" as text files do.
    n = int.from_bytes(data[80:84], "little") if len(data) >= 84 else -1
    if n >= 0 and len(data) >= 84 + n * _STL.itemsize and (n > 0 or data[:5] != b"solid"):
        rows = np.frombuffer(data, dtype=_STL, count=n, offset=84)
        corners = rows["corners"].astype(float).reshape(-1, 3)
    else:
        lines = data.decode("ascii", errors="replace").split("\n")
        words = [line.split() for line in lines if line.lstrip()[:6].lower() == "vertex"]
        corners = np.array([[float(x) for x in row[1:4]] for row in words]).reshape(-1, 3)
    if len(corners) % 3:
        raise ValueError("a triangle is cut off")
    return Mesh(corners, np.arange(len(corners)).reshape(-1, 3))


def _read_obj(text: str) -> Mesh:
    """Read corners and faces of OBJ; faces with more than three corners become triangle fans."""
    points: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    for line in text.splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == "v":
            points.append([float(x) for x in words[1:4]])
        elif words[0] == "f":
            numbers = [int(word.partition("/")[0]) for word in words[1:]]
            # OBJ counts from one; negative numbers count back from the last corner so far.
            corners = [i - 1 if i > 0 else len(points) + i for i in numbers]
            faces += [(corners[0], b, c) for b, c in pairwise(corners[1:])]
    return Mesh(np.array(points).reshape(-1, 3), np.array(faces, dtype=np.int64).reshape(-1, 3))


def _read_other(data: bytes, suffix: str) -> Mesh:
    """Read another format by trimesh, from memory only."""
    try:
        import trimesh
    except ImportError:
        raise MeshError(
            f"reading {suffix or 'such'} files needs trimesh: pip install cotree[meshes]"
        ) from None
    from io import BytesIO

    try:
        found: Any = trimesh.load(BytesIO(data), file_type=suffix.lstrip("."), force="mesh")
        return Mesh(np.array(found.vertices, dtype=float), np.array(found.faces, dtype=np.int64))
    except Exception as error:  # trimesh raises errors of many types for invalid files
        raise ValueError(str(error) or type(error).__name__) from None


def coarser(mesh: Mesh, most: int) -> Mesh:
    """Coarsen a mesh to about ``most`` triangles by merging corners in the same grid cell.

    Merged corners are at their mean position (J. Rossignac and P. Borrel, Multi-resolution 3D
    approximations, 1993).
    """
    low = mesh.points.min(axis=0)
    extent = float(np.ptp(mesh.points, axis=0).max()) or 1.0
    cells, n = 1000.0, len(mesh.faces)
    while n > most and cells > 2.0:
        keys = np.floor((mesh.points - low) / extent * cells).astype(np.int64)
        # Each side has at most 1001 cells, so cell numbers are distinct.
        _, place = np.unique(keys @ [1, 2000, 4_000_000], return_inverse=True)
        faces = place[mesh.faces]
        is_kept = (np.diff(np.sort(faces, axis=1), axis=1) > 0).all(axis=1)
        n = int(np.count_nonzero(is_kept))
        # The number of triangles is proportional to the square of the number of cells along a side.
        cells *= min(0.9, float(np.sqrt(most / max(n, 1))))
    if n == len(mesh.faces):
        return mesh
    counts = np.bincount(place)
    points = np.stack([np.bincount(place, w) / counts for w in mesh.points.T], axis=1)
    return Mesh(points, faces[is_kept])


#: Largest number of triangles in all meshes of a robot; larger meshes are coarsened.
MOST_FACES = 60_000

_FEWEST = 200  # minimum number of triangles of one mesh


def visual_meshes(
    origin: Origin, places: Mapping[str, Place], *, trust_paths: bool = False
) -> dict[int, list[tuple[str, Mesh]]]:
    """Return visual shapes and node names of each cluster; warn once about unreadable meshes."""
    files: dict[str, Mesh] = {}
    failed: dict[str, str] = {}
    found: dict[int, list[tuple[str, Mesh]]] = {}
    for visual in origin.visuals:
        place = places.get(visual.node)
        if place is None:
            continue
        try:
            if visual.file in failed:
                continue
            if visual.shape == "mesh" and visual.file not in files:
                path = find_mesh(visual.file, Path(origin.file), trust_paths=trust_paths)
                files[visual.file] = read_mesh(path)
            mesh = _shape(visual, files)
        except MeshError as error:
            failed[visual.file] = str(error)
            continue
        # Transform from visual axes to node axes, then to cluster axes.
        rows = rotation_rows(visual.rpy, 0.0)
        mesh = mesh.placed(np.array(visual.xyz), None if rows is None else np.array(rows))
        own = found.setdefault(place.cluster, [])
        own.append((visual.node, mesh.placed(place.local, place.turn)))
    if failed:
        reason = next(iter(failed.values()))
        warnings.warn(
            f"{len(failed)} of {len(failed) + len(files)} meshes are not drawn, but replaced by "
            f"bars: {reason}; packages are searched above the robot's file and along "
            "ROS_PACKAGE_PATH",
            RuntimeWarning,
            stacklevel=4,  # the warning points to the call of `animate`
        )
    return _bounded(found)


def _shape(visual: Visual, files: Mapping[str, Mesh]) -> Mesh:
    a, b, c = visual.size
    if visual.shape == "box":
        return box(a, b, c)
    if visual.shape == "sphere":
        return sphere(a)
    if visual.shape == "cylinder":
        return cylinder(a, c)
    if visual.shape == "capsule":
        return capsule(a, c)
    return files[visual.file].scaled(visual.size)


def _bounded(found: dict[int, list[tuple[str, Mesh]]]) -> dict[int, list[tuple[str, Mesh]]]:
    """Coarsen meshes to a total number of triangles, in proportion to their sizes."""
    total = sum(len(mesh.faces) for own in found.values() for _, mesh in own)
    if total <= MOST_FACES:
        return found
    share = MOST_FACES / total
    return {
        track: [
            (name, coarser(mesh, max(_FEWEST, int(share * len(mesh.faces))))) for name, mesh in own
        ]
        for track, own in found.items()
    }
