"""Shapes of joints and constraints of points: pins, balls, rails with blocks, wheels, blades."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.watch import shapes
from cotree.watch.colors import JOINT, RAIL
from cotree.watch.elements import spring
from cotree.watch.touching import road

if TYPE_CHECKING:
    from cotree.formulation.fields import BoundEdge
    from cotree.watch.draft import Drafter
    from cotree.watch.shapes import Array


def revolute(draft: Drafter, edge: BoundEdge) -> None:
    """Show a pin on the axis."""
    if draft.is_hidden(edge):
        return
    radius = (1.1 if draft.stage.is_flat else 1.4) * draft.w
    draft.pin(edge, edge.first, draft.axis(edge, "axis", edge.first), radius, 3.2 * draft.w)
    draft.mark(edge)


def universal(draft: Drafter, edge: BoundEdge) -> None:
    """Show a cross of two pins."""
    if draft.is_hidden(edge):
        return
    # The second axis is carried by the second body, whose own turn it is.
    for name, end in (("axis", edge.first), ("axis2", edge.second)):
        draft.pin(edge, end, draft.axis(edge, name, end), 0.75 * draft.w, 4.2 * draft.w)
    draft.mark(edge)


def spherical(draft: Drafter, edge: BoundEdge) -> None:
    """Show a ball."""
    if draft.is_hidden(edge):
        return
    place = draft.places[edge.first]
    ball = shapes.sphere(1.6 * draft.w).placed(place.local)
    draft.solid(edge.name, place.cluster, ball, JOINT)
    draft.mark(edge)


def sliding(draft: Drafter, edge: BoundEdge) -> None:
    """Draw a rail on the first body and a block or a sleeve on the second."""
    if draft.is_hidden(edge):
        return
    w, two = draft.w, draft.places[edge.second]
    # A sliding joint does not turn its axis, so that both bodies see the same one.
    axis = draft.axis(edge, "axis", edge.second)
    if edge.component.name == "prismatic":
        block = shapes.box(3.4 * w, (0.75 if draft.stage.is_flat else 3.4) * w, 5.4 * w)
    else:
        # A body that also turns about the axis slides in a sleeve, not in a block.
        block = shapes.ring(1.8 * w, 0.9 * w, 5.0 * w)
    y = draft.towards(two.cluster) if draft.stage.is_flat else None
    at = two.local + draft.raised(two.cluster)
    draft.solid(edge.name, two.cluster, block.placed(at, shapes.axes_along(axis, y)), label=True)
    _rail(draft, edge, draft.values.numbers(edge.vectors["axis"]))
    stiffness = edge.scalars.get("stiffness")
    if stiffness is not None and not stiffness.is_zero:
        spring(draft, edge)


def _rail(draft: Drafter, edge: BoundEdge, along: Array) -> None:
    """Draw a rail over the range of the second node along an axis, in the first's axes."""
    w, one = draft.w, draft.places[edge.first]
    along = along / np.linalg.norm(along)
    way = draft.reach(edge) @ along
    # The rail covers the whole run and the length of the block.
    low, high = float(way.min()) - 4.0 * w, float(way.max()) + 4.0 * w
    axis = one.turn @ along
    at = one.local + 0.5 * (low + high) * axis
    if draft.stage.is_flat:
        at = at - 0.9 * draft.pitch * draft.towards(one.cluster)
    bar = shapes.cylinder(0.5 * w, high - low).placed(at, shapes.axes_along(axis))
    draft.solid(edge.name, one.cluster, bar, RAIL if one.cluster == 0 else None)


def slot(draft: Drafter, edge: BoundEdge) -> None:
    """Show a pin, and a rail where the line is fixed in the first body."""
    two = draft.places[edge.second]
    at = two.local + draft.raised(two.cluster)
    draft.solid(edge.name, two.cluster, shapes.sphere(1.2 * draft.w).placed(at), JOINT)
    # A line that turns with time has no one rail to draw.
    moving = draft.values.over_time(edge.vectors["axis"])
    if np.ptp(moving, axis=0).max() == 0.0:
        _rail(draft, edge, moving[0])


def disc(draft: Drafter, edge: BoundEdge) -> None:
    """Show a wheel of the disc's radius."""
    place = draft.places[edge.second]
    if place.cluster in draft.clothed:
        return
    radius = float(draft.values.numbers([edge.scalars["radius"]])[0])
    axes = shapes.axes_along(draft.axis(edge, "axis", edge.second))
    wheel = shapes.wheel(radius, 0.12 * radius)
    draft.solid(edge.name, place.cluster, wheel.placed(place.local, axes), label=True)
    if draft.stage.is_flat:
        normal = draft.values.numbers(edge.vectors["normal"])
        road(draft, edge, float(draft.reach(edge)[0] @ normal) - radius, radius)


def blade(draft: Drafter, edge: BoundEdge) -> None:
    """Show a thin blade across which nothing slides."""
    place = draft.places[edge.second]
    axes = shapes.axes_along(draft.axis(edge, "axis", edge.second), draft.upright()[:, 1])
    blade = shapes.box(5.0 * draft.w, 1.8 * draft.w, 0.5 * draft.w)
    draft.solid(edge.name, place.cluster, blade.placed(place.local, axes), JOINT)
