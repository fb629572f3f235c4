"""Robot meshes: search for their files, reading with limits on size, and coarsening.

STL and OBJ are read here, other formats by trimesh. Files are untrusted: sizes are limited and
every number is checked.
"""

from __future__ import annotations

import os
import warnings
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, urlparse

import numpy as np

from cotree.readers.urdf.scene import rotation_rows
from cotree.watch import shapes
from cotree.watch.shapes import Mesh

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.scene.description import Origin, Visual
    from cotree.watch.stage import Place


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
        return shapes.box(a, b, c)
    if visual.shape == "sphere":
        return shapes.sphere(a)
    if visual.shape == "cylinder":
        return shapes.cylinder(a, c)
    if visual.shape == "capsule":
        return shapes.capsule(a, c)
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
