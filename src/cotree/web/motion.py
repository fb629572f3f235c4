"""Animation that follows the parameters: the poses of nodes are outputs of the page's program.

Shapes are attached to nodes instead of clusters, and bars are stretched between their nodes. Thus
they also move with nodes whose position in a cluster depends on parameters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.components import Role
from cotree.watch.animation import page_data
from cotree.watch.drawing import FAR, Label, Solid, Strut
from cotree.watch.shapes import Mesh, axes_along
from cotree.watch.stage import MotionValues, Place, Poses

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from cotree.formulation.first_graph import FirstGraph
    from cotree.watch.drawing import Drawing
    from cotree.watch.shapes import Array

#: Outputs of a node: its position, and two columns of its rotation matrix.
_POSITION, _ROTATION = ("x", "y", "z"), ("r11", "r21", "r31", "r12", "r22", "r32")


@dataclass(frozen=True)
class Track:
    """The motion of a node's position with the axes of its cluster."""

    node: str
    turning: str  # node whose axes determine those of the cluster; empty for the ground
    turn: tuple[float, ...]  # rotation from the cluster's axes to the turning node's, by rows

    def outputs(self) -> Iterator[str]:
        """Yield the variables of the scene that determine the pose."""
        if self.node != "ground":
            yield from (f"{self.node}.{name}" for name in _POSITION)
        if self.turning:
            yield from (f"{self.turning}.{name}" for name in _ROTATION)

    def data(self, place_of: Callable[[str], int]) -> dict[str, Any]:
        """Return the data for the page; ``place_of`` returns the index of an output."""
        at, turning = (
            place_of(f"{node}.{first}") if node not in ("", "ground") else -1
            for node, first in ((self.node, "x"), (self.turning, "r11"))
        )
        return {"at": at, "turning": turning, "turn": self.turn}


@dataclass(frozen=True)
class Moving:
    """A drawing whose shapes are attached to tracks."""

    drawing: Drawing
    tracks: tuple[Track, ...]

    def data(self, place_of: Callable[[str], int]) -> dict[str, Any]:
        """Return the data of the viewer, whose tracks the page computes."""
        data = page_data(self.drawing)
        low, high = self.drawing.bounds(np.eye(3))
        own = float((high - low).max())
        is_far = float((high.max(axis=0) - low.min(axis=0)).max()) > FAR * own
        tracks = [track.data(place_of) for track in self.tracks]
        centre = [data["unit"] * value for value in data["centres"][:3]]
        return data | {"tracks": tracks, "centre": centre, "follows": is_far}


def attach(first: FirstGraph, drawing: Drawing, p: Array) -> Moving:
    """Attach the shapes of a drawing to nodes; ``p`` are the parameters of the drawing."""
    points = first.motion.clusters.points
    values = MotionValues(
        first.motion, p, np.zeros(1), np.zeros((len(first.system.coordinates), 1))
    )
    places = {name: values.place(point) for name, point in points.items()}
    edges = {edge.name: (edge.first, edge.second) for edge in first.system.edges.values()}
    bars = {e.name for e in first.system.edges.values() if e.component.role is Role.ARM}
    found: list[str] = []

    def track_of(name: str, cluster: int, far: bool = False) -> int:
        """Return the track of a shape's node: an end of its edge in the cluster, or the first."""
        ends = edges.get(name, ())[:: -1 if far else 1]
        nodes = [*ends, *places]
        node = next(node for node in nodes if places[node].cluster == cluster)
        if node not in found:
            found.append(node)
        return found.index(node)

    def local(track: int) -> Array:
        return places[found[track]].local

    solids, struts = [], list(_struts(drawing.struts, track_of, local))
    for solid in drawing.solids:
        is_bar = solid.name in bars and _length(edges[solid.name], places) > 0.0
        if is_bar and {places[node].cluster for node in edges[solid.name]} == {solid.track}:
            struts.append(_stretched(solid, edges[solid.name], places, track_of))
        else:
            track = track_of(solid.name, solid.track, far=True)
            mesh = solid.mesh.placed(-local(track))
            solids.append(replace(solid, track=track, mesh=mesh))
    labels = []
    for label in drawing.labels:
        track = track_of(label.text, label.track, far=True)
        labels.append(Label(label.text, track, label.local - local(track)))
    poses, clusters = drawing.poses, [places[node].cluster for node in found]
    positions = [poses.of(c, places[node].local) for c, node in zip(clusters, found, strict=True)]
    placed = Poses(np.stack(positions), poses.axes[clusters])
    own = replace(
        drawing, poses=placed, solids=tuple(solids), struts=tuple(struts), labels=tuple(labels)
    )
    return Moving(own, tuple(_track(node, places) for node in found))


def _length(ends: Sequence[str], places: Mapping[str, Place]) -> float:
    return float(np.linalg.norm(places[ends[1]].local - places[ends[0]].local))


def _track(node: str, places: Mapping[str, Place]) -> Track:
    cluster = places[node].cluster
    if cluster == 0:
        return Track(node, "", ())
    turning = next(name for name, place in places.items() if place.cluster == cluster)
    return Track(node, turning, tuple(places[turning].turn.T.ravel().tolist()))


def _struts(
    rows: Sequence[Strut], track_of: Callable[..., int], local: Callable[[int], Array]
) -> Iterator[Strut]:
    for row in rows:
        tracks = track_of(row.name, row.tracks[0]), track_of(row.name, row.tracks[1], far=True)
        one, two = (end - local(track) for end, track in zip(row.ends, tracks, strict=True))
        yield replace(row, tracks=tracks, ends=(one, two))


def _stretched(
    bar: Solid,
    ends: tuple[str, str],
    places: Mapping[str, Place],
    track_of: Callable[..., int],
) -> Strut:
    """Return the shape of a bar, stretched between its nodes."""
    one, two = (places[node].local for node in ends)
    axes, length = axes_along(two - one), _length(ends, places)
    points = (bar.mesh.points - one) @ axes / np.array([1.0, 1.0, length])
    tracks = track_of(bar.name, bar.track), track_of(bar.name, bar.track, far=True)
    zero = np.zeros(3)
    return Strut(
        bar.name, tracks, (zero, zero), axes[:, 1], Mesh(points, bar.mesh.faces), bar.color
    )
