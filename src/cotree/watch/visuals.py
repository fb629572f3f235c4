"""Shapes that a robot's file gives, in the axes of the clusters that carry them."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cotree.readers.rotations import rotation_rows
from cotree.watch import shapes
from cotree.watch.meshes import MeshError, coarser, find_mesh, read_mesh

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.scene.origin import Origin, Visual
    from cotree.watch.poses import Place
    from cotree.watch.shapes import Mesh

#: Triangles of all meshes of a robot together; larger ones are made coarser.
MOST_FACES = 60_000

_FEWEST = 200  # of one mesh


def visual_meshes(
    origin: Origin, places: Mapping[str, Place], *, trust_paths: bool = False
) -> dict[int, list[tuple[str, Mesh]]]:
    """Give the shapes of each cluster, by the name of the node.

    Parameters
    ----------
    origin : Origin
        Shapes and names in the robot's file.
    places : mapping of str to Place
        Where the nodes are in their clusters.
    trust_paths : bool
        Whether meshes may lie outside the robot's folder.

    Warns
    -----
    RuntimeWarning
        Once, if meshes are missing or cannot be read; their links are then drawn as bars.
    """
    files: dict[str, Mesh] = {}
    failed: dict[str, str] = {}
    found: dict[int, list[tuple[str, Mesh]]] = {}
    for visual in origin.visuals:
        place = places.get(visual.node)
        if place is None:
            continue
        try:
            if visual.shape == "mesh":
                _read_once(visual, Path(origin.file), files, failed, trust_paths)
            mesh = _shape(visual, files)
        except MeshError as error:
            failed[visual.file] = str(error)
            continue
        # First to the node's axes by the visual's pose, then to those of the cluster.
        rows = rotation_rows(visual.rpy, 0.0)
        mesh = mesh.placed(np.array(visual.xyz), None if rows is None else np.array(rows))
        own = found.setdefault(place.cluster, [])
        own.append((visual.node, mesh.placed(place.local, place.turn)))
    if failed:
        reason = next(iter(failed.values()))
        warnings.warn(
            f"{len(failed)} of {len(failed) + len(files)} meshes are not drawn, bars stand in "
            f"their place: {reason}; packages are looked for above the robot's file and along "
            "ROS_PACKAGE_PATH",
            RuntimeWarning,
            stacklevel=4,  # whoever asked for the animation
        )
    return _bounded(found)


def _read_once(
    visual: Visual,
    robot: Path,
    files: dict[str, Mesh],
    failed: Mapping[str, str],
    trust_paths: bool,
) -> None:
    """Read the file of a mesh, unless that was tried before."""
    if visual.file in failed:
        raise MeshError(failed[visual.file])
    if visual.file not in files:
        files[visual.file] = read_mesh(find_mesh(visual.file, robot, trust_paths=trust_paths))


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
    """Share the triangle budget among the meshes in proportion to their sizes."""
    total = sum(len(mesh.faces) for own in found.values() for _, mesh in own)
    if total <= MOST_FACES:
        return found
    # The budget is that of the whole drawing: a robot may have many meshes of moderate size.
    share = MOST_FACES / total
    return {
        track: [
            (name, coarser(mesh, max(_FEWEST, int(share * len(mesh.faces))))) for name, mesh in own
        ]
        for track, own in found.items()
    }
