"""Shapes of bodies that may touch: planes and roads, spheres, discs, cylinders and boxes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.watch import shapes
from cotree.watch.colors import RAIL

if TYPE_CHECKING:
    from cotree.formulation.fields import BoundEdge
    from cotree.watch.draft import Drafter
    from cotree.watch.shapes import Mesh

#: Radius of the ball that marks a point that touches, in widths of bars.
_MARKER = 0.75


def contact(draft: Drafter, edge: BoundEdge) -> None:
    """Show the surfaces of a contact."""
    place = draft.places[edge.second]
    own = _body(draft, edge)
    if own is not None and place.cluster not in draft.clothed:
        mesh, size = own
        draft.solid(edge.name, place.cluster, mesh.placed(place.local, place.turn), label=True)
    else:
        size = 3.0 * draft.w
        if own is None:  # a point: a small ball marks it, also on a body that is shown
            marker = shapes.sphere(_MARKER * draft.w).placed(place.local)
            draft.solid(edge.name, place.cluster, marker, label=True)
    if "normal" in edge.vectors:
        road(draft, edge, 0.0, size)
        return
    first = draft.places[edge.first]
    if first.cluster not in draft.clothed:
        ball = shapes.sphere(_number(draft, edge, "ball"))
        draft.solid(edge.name, first.cluster, ball.placed(first.local))


def _number(draft: Drafter, edge: BoundEdge, field: str) -> float:
    return float(draft.values.numbers([edge.scalars[field]])[0])


def _body(draft: Drafter, edge: BoundEdge) -> tuple[Mesh, float] | None:
    """Give the second body's shape in its node's axes, and its size; None of a point."""
    if "size" in edge.vectors:
        lengths = draft.values.numbers(edge.vectors["size"])
        mesh = shapes.box(*np.maximum(lengths, 0.75 * draft.w))
        return mesh, float(np.max(lengths))
    if "semiaxes" in edge.vectors:
        semiaxes = draft.values.numbers(edge.vectors["semiaxes"])
        return shapes.sphere(1.0).scaled(semiaxes), float(np.max(semiaxes))
    if "radius" not in edge.scalars:
        return None
    radius = _number(draft, edge, "radius")
    if "axis" not in edge.vectors:
        # Spokes make rolling visible in a plane, where a ball is a circle.
        flat = draft.stage.is_flat
        mesh = shapes.wheel(radius, 0.75 * draft.w) if flat else shapes.sphere(radius)
        turn = draft.places[edge.second].turn
        towards = turn.T @ draft.towards(draft.places[edge.second].cluster)
        return (mesh.placed(np.zeros(3), shapes.axes_along(towards)) if flat else mesh), radius
    axes = shapes.axes_along(draft.values.numbers(edge.vectors["axis"]))
    if "length" in edge.scalars:
        mesh = shapes.cylinder(radius, _number(draft, edge, "length"))
    else:
        mesh = shapes.wheel(radius, 0.12 * radius)
    return mesh.placed(np.zeros(3), axes), radius


def road(draft: Drafter, edge: BoundEdge, level: float, size: float) -> None:
    """Draw a plane through the first node, over the range of the second node's motion.

    Parameters
    ----------
    draft : Drafter
        The drawing.
    edge : BoundEdge
        The edge whose field ``normal`` is that of the plane.
    level : float
        Height of the plane above the first node, [m].
    size : float
        How far the second node's body extends, [m].
    """
    one = draft.places[edge.first]
    normal = draft.values.numbers(edge.vectors["normal"])
    if draft.stage.is_flat:
        # In the plane bodies move along what is normal to the view and to the road.
        along = np.cross(one.turn.T @ draft.towards(one.cluster), normal)
    else:
        along = shapes.axes_along(normal)[:, 0]
    aside = np.cross(normal, along)
    reach = draft.reach(edge)
    depth = 0.1 * size
    lengths, middle = [], (level - 0.5 * depth) * normal
    for axis in (aside, along):
        way = reach @ axis
        low, high = float(way.min()) - 1.5 * size, float(way.max()) + 1.5 * size
        if draft.stage.is_flat and axis is aside:
            low, high = -depth, depth
        lengths.append(high - low)
        middle = middle + 0.5 * (low + high) * axis
    bar = shapes.box(depth, lengths[0], lengths[1])
    axes = one.turn @ shapes.axes_along(along, aside)
    draft.solid(edge.name, one.cluster, bar.placed(one.local + one.turn @ middle, axes), RAIL)
