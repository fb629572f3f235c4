"""Catalogue of the shapes that represent edges; meshes from a robot's file replace them."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from cotree.components import Acts, Role
from cotree.watch import shapes
from cotree.watch.drawing import DrawingBuilder
from cotree.watch.shapes import DAMPER, FORCE, JOINT, RAIL, SPRING, Array, Color, Mesh

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from cotree.formulation.fields import BoundEdge
    from cotree.formulation.first_graph import FirstGraph
    from cotree.watch.stage import MotionValues, Stage


def arm(draft: DrawingBuilder, edge: BoundEdge) -> None:
    """Draw an arm as a bar, which is thin if it only leads to a centre of mass."""
    one, two = draft.places[edge.first], draft.places[edge.second]
    if one.cluster != two.cluster:  # the arm is a chord, which multipliers keep rigid
        strut(draft, edge, shapes.rod, 0.7, RAIL)
        return
    gap = two.local - one.local
    length = float(np.linalg.norm(gap))
    # Draw no bar on bodies with meshes. An arm without length is a rotation.
    if one.cluster in draft.with_visuals or length < 1e-9 * draft.stage.size:
        return
    is_thin = edge.name in draft.stage.spurs or (one.cluster == 0 and draft.stage.is_flat)
    width = 0.35 * draft.w if is_thin else 0.8 * draft.w
    middle = 0.5 * (one.local + two.local) + draft.raised(one.cluster)
    if draft.stage.is_flat:
        bar = shapes.plate(1.15 * width, length, 0.75 * draft.w * (0.6 if is_thin else 1.0))
        axes = shapes.axes_along(gap, draft.towards(one.cluster))
    else:
        bar, axes = shapes.capsule(width, length), shapes.axes_along(gap)
    draft.solid(edge.name, one.cluster, bar.placed(middle, axes), label=one.cluster != 0)


def body(draft: DrawingBuilder, edge: BoundEdge) -> None:
    """Draw a body as a dot on its bars, or as a box with the body's inertia."""
    place = draft.places[edge.second]
    cluster, w = place.cluster, draft.w
    if cluster in draft.with_visuals or cluster == 0 or cluster in draft.stage.shown:
        return
    at = place.local + draft.raised(cluster)
    has_bars = cluster in draft.stage.reach
    tensor = None
    if edge.inertia is not None:
        tensor = draft.values.matrix(edge.inertia)
    elif "inertia" in edge.scalars:
        tensor = _number(draft, edge, "inertia") * np.eye(3)
    # In a plane, a dot marks the centre of mass on the bars.
    if draft.stage.is_flat and has_bars:
        dot = shapes.cylinder(0.42 * w, 0.9 * w)
        draft.solid(
            edge.name, cluster, dot.placed(at, shapes.axes_along(draft.towards(cluster))), JOINT
        )
        return
    found = None if tensor is None else body_box(_number(draft, edge, "mass"), tensor)
    if found is None or (has_bars and edge.inertia is None):
        draft.solid(edge.name, cluster, shapes.sphere((1.3 if has_bars else 2.4) * w).placed(at))
        return
    lengths, axes = found
    if has_bars:
        # The box is smaller than the arms of its body, and so does not hide the mechanism.
        lengths = lengths * min(1.0, 0.6 * draft.stage.reach[cluster] / max(lengths.max(), w))
    lengths = np.maximum(lengths, (1.0 if has_bars else 3.0) * w)
    if draft.stage.is_flat:
        # The box is a thin plate in the direction of view, so that layers do not intersect.
        towards = np.abs(place.turn.T @ draft.towards(cluster))
        side = float(np.median(lengths))
        lengths, axes = np.where(towards > 0.5, 0.75 * w, side), np.eye(3)
    mesh = shapes.box(*lengths).placed(at, place.turn @ axes)
    draft.solid(edge.name, cluster, mesh, label=not has_bars)


def body_box(mass: float, tensor: Array) -> tuple[Array, Array] | None:
    """Return lengths, [m], and axes of the homogeneous box with this mass and tensor, or None.

    From I1 = m (b^2 + c^2) / 12 and its permutations, a^2 = 6 (I2 + I3 - I1) / m; a length is zero
    if no homogeneous box exists. The principal axes are right-handed columns.
    """
    if not np.all(np.isfinite(tensor)) or mass < 0.0:
        return None
    # The axes of a diagonal tensor are kept; `eigh` would sort them by the moments.
    is_diagonal = np.count_nonzero(tensor - np.diag(np.diag(tensor))) == 0
    moments, axes = (np.diag(tensor), np.eye(3)) if is_diagonal else np.linalg.eigh(tensor)
    # The signs of eigenvectors are arbitrary; the axes must be right-handed.
    if np.linalg.det(axes) < 0.0:
        axes = axes * np.array([1.0, 1.0, -1.0])
    # A body with inertia but without mass is drawn at the minimum size.
    squares = 6.0 * (moments.sum() - 2.0 * moments) / (mass or np.inf)
    if moments.max() <= 0.0:
        return None
    return np.sqrt(np.maximum(squares, 0.0)), axes


#: Radius of the ball that marks a contact point, in widths of bars.
_MARKER = 0.75


def contact(draft: DrawingBuilder, edge: BoundEdge) -> None:
    """Draw the surfaces of a contact."""
    place = draft.places[edge.second]
    own = _body(draft, edge)
    if own is not None and place.cluster not in draft.with_visuals:
        mesh, size = own
        draft.solid(edge.name, place.cluster, mesh.placed(place.local, place.turn), label=True)
    else:
        size = 3.0 * draft.w
        if own is None:  # a point of contact is marked by a small ball, also on bodies with visuals
            marker = shapes.sphere(_MARKER * draft.w).placed(place.local)
            draft.solid(edge.name, place.cluster, marker, label=True)
    if "normal" in edge.vectors:
        road(draft, edge, 0.0, size)
        return
    first = draft.places[edge.first]
    if first.cluster not in draft.with_visuals:
        ball = shapes.sphere(_number(draft, edge, "ball"))
        draft.solid(edge.name, first.cluster, ball.placed(first.local))


def _number(draft: DrawingBuilder, edge: BoundEdge, field: str) -> float:
    return float(draft.values.numbers([edge.scalars[field]])[0])


def _body(draft: DrawingBuilder, edge: BoundEdge) -> tuple[Mesh, float] | None:
    """Return a contact's second body: shape, in node axes, and size; None if it is a point."""
    if "size" in edge.vectors:
        lengths = draft.values.numbers(edge.vectors["size"])
        return shapes.box(*np.maximum(lengths, 0.75 * draft.w)), float(np.max(lengths))
    if "semiaxes" in edge.vectors:
        semiaxes = draft.values.numbers(edge.vectors["semiaxes"])
        return shapes.sphere(1.0).scaled(semiaxes), float(np.max(semiaxes))
    if "radius" not in edge.scalars:
        return None
    radius = _number(draft, edge, "radius")
    if "axis" not in edge.vectors:
        # In a plane a ball would be a circle; spokes make its rolling visible.
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


def road(draft: DrawingBuilder, edge: BoundEdge, level: float, size: float) -> None:
    """Draw a plane ``level``, [m], above the first node along the path of a body of ``size``."""
    one = draft.places[edge.first]
    normal = draft.values.numbers(edge.vectors["normal"])
    if draft.stage.is_flat:
        # In planar scenes, bodies move along the cross product of view direction and normal.
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


def spring(draft: DrawingBuilder, edge: BoundEdge) -> None:
    """Draw a spring as a coil."""
    length = draft.length(edge.first, edge.second)
    if length > 0.0:
        # The length of the spring and the width of bars limit the radius of the coil.
        radius = min(1.5 * draft.w, 0.15 * length)
        mesh = shapes.coil(radius, min(0.28 * draft.w, 0.2 * radius), length)
        draft.strut(edge.name, edge.first, edge.second, mesh, SPRING)


def strut(
    draft: DrawingBuilder,
    edge: BoundEdge,
    mesh: Callable[[float], Mesh],
    width: float,
    color: Color,
) -> None:
    """Draw a shape between both nodes; ``width`` is relative to the width of bars."""
    draft.strut(edge.name, edge.first, edge.second, mesh(width * draft.w), color)


#: Draws a force along a line as a thin red line.
LINE_FORCE = partial(strut, mesh=shapes.rod, width=0.3, color=FORCE)


def bushing(draft: DrawingBuilder, edge: BoundEdge) -> None:
    """Draw a bushing as a ball at its nodes."""
    place = draft.places[edge.first]
    ball = shapes.sphere(1.5 * draft.w).placed(place.local + draft.raised(place.cluster))
    draft.solid(edge.name, place.cluster, ball, SPRING, label=True)


def revolute(draft: DrawingBuilder, edge: BoundEdge) -> None:
    """Draw a revolute joint as a pin on its axis."""
    radius = (1.1 if draft.stage.is_flat else 1.4) * draft.w
    draft.pin(edge, edge.first, draft.axis(edge, "axis", edge.first), radius, 3.2 * draft.w)
    draft.mark(edge)


def universal(draft: DrawingBuilder, edge: BoundEdge) -> None:
    """Draw a universal joint as a cross of two pins."""
    # The second axis is fixed in the second body.
    for name, end in (("axis", edge.first), ("axis2", edge.second)):
        draft.pin(edge, end, draft.axis(edge, name, end), 0.75 * draft.w, 4.2 * draft.w)
    draft.mark(edge)


def spherical(draft: DrawingBuilder, edge: BoundEdge) -> None:
    """Draw a spherical joint as a ball."""
    place = draft.places[edge.first]
    ball = shapes.sphere(1.6 * draft.w).placed(place.local)
    draft.solid(edge.name, place.cluster, ball, JOINT)
    draft.mark(edge)


def sliding(draft: DrawingBuilder, edge: BoundEdge) -> None:
    """Draw a rail on the first body and a block or a sleeve on the second."""
    w, two = draft.w, draft.places[edge.second]
    # The axis of a sliding joint has the same direction in both bodies.
    axis = draft.axis(edge, "axis", edge.second)
    if edge.component.name == "prismatic":
        block = shapes.box(3.4 * w, (0.75 if draft.stage.is_flat else 3.4) * w, 5.4 * w)
    else:
        # A body that also rotates about the axis has a sleeve instead of a block.
        block = shapes.ring(1.8 * w, 0.9 * w, 5.0 * w)
    y = draft.towards(two.cluster) if draft.stage.is_flat else None
    at = two.local + draft.raised(two.cluster)
    draft.solid(edge.name, two.cluster, block.placed(at, shapes.axes_along(axis, y)), label=True)
    _rail(draft, edge, draft.values.numbers(edge.vectors["axis"]))
    stiffness = edge.scalars.get("stiffness")
    if stiffness is not None and not stiffness.is_zero:
        spring(draft, edge)


def _rail(draft: DrawingBuilder, edge: BoundEdge, along: Array) -> None:
    """Draw a rail along an axis in the first node's axes, over the range of the second node."""
    w, one = draft.w, draft.places[edge.first]
    along = along / np.linalg.norm(along)
    way = draft.reach(edge) @ along
    # The rail covers the range of the run and the length of the block.
    low, high = float(way.min()) - 4.0 * w, float(way.max()) + 4.0 * w
    axis = one.turn @ along
    at = one.local + 0.5 * (low + high) * axis
    if draft.stage.is_flat:
        at = at - 0.9 * draft.pitch * draft.towards(one.cluster)
    bar = shapes.cylinder(0.5 * w, high - low).placed(at, shapes.axes_along(axis))
    draft.solid(edge.name, one.cluster, bar, RAIL if one.cluster == 0 else None)


def slot(draft: DrawingBuilder, edge: BoundEdge) -> None:
    """Draw a slot as a pin, and as a rail if its line is fixed in the first body."""
    two = draft.places[edge.second]
    at = two.local + draft.raised(two.cluster)
    draft.solid(edge.name, two.cluster, shapes.sphere(1.2 * draft.w).placed(at), JOINT)
    moving = draft.values.over_time(edge.vectors["axis"])
    if np.ptp(moving, axis=0).max() == 0.0:
        _rail(draft, edge, moving[0])


def disc(draft: DrawingBuilder, edge: BoundEdge) -> None:
    """Draw a disc as a wheel of the same radius."""
    place = draft.places[edge.second]
    if place.cluster in draft.with_visuals:
        return
    radius = _number(draft, edge, "radius")
    axes = shapes.axes_along(draft.axis(edge, "axis", edge.second))
    wheel = shapes.wheel(radius, 0.12 * radius)
    draft.solid(edge.name, place.cluster, wheel.placed(place.local, axes), label=True)
    if draft.stage.is_flat:
        normal = draft.values.numbers(edge.vectors["normal"])
        road(draft, edge, float(draft.reach(edge)[0] @ normal) - radius, radius)


def blade(draft: DrawingBuilder, edge: BoundEdge) -> None:
    """Draw a blade as a thin plate in the direction of motion."""
    place = draft.places[edge.second]
    axes = shapes.axes_along(draft.axis(edge, "axis", edge.second), draft.upright()[:, 1])
    blade = shapes.box(5.0 * draft.w, 1.8 * draft.w, 0.5 * draft.w)
    draft.solid(edge.name, place.cluster, blade.placed(place.local, axes), JOINT)


#: Drawing functions by component. Gears, free joints and loads are not drawn.
SHOWN: dict[str, Callable[[DrawingBuilder, BoundEdge], None]] = {
    "arm": arm,
    "rigid_body": body,
    "revolute": revolute,
    "universal": universal,
    "spherical": spherical,
    "prismatic": sliding,
    "cylindrical": sliding,
    "screw": sliding,
    "slot": slot,
    "rolling_disc": disc,
    "rolling_ellipsoid": contact,
    "knife_edge": blade,
    "spring": spring,
    "damper": partial(strut, mesh=shapes.piston, width=1.1, color=DAMPER),
    "distance": partial(strut, mesh=shapes.rod, width=0.5, color=JOINT),
    "line_force": LINE_FORCE,
    "bushing": bushing,
    "contact_geometry": contact,
}


def draft_scene(
    first: FirstGraph,
    values: MotionValues,
    stage: Stage,
    visuals: Mapping[int, list[tuple[str, Mesh]]],
) -> DrawingBuilder:
    """Draw all edges; the ``visuals`` of a cluster replace its bars, boxes and joints."""
    draft = DrawingBuilder(first, values, stage, frozenset(visuals))
    for track, own in visuals.items():
        for name, mesh in own:
            draft.solid(name, track, mesh)
        draft.label(own[0][0], track, own[0][1].points.mean(axis=0))
    for edge in first.system.edges.values():
        show = SHOWN.get(edge.component.name)
        if edge.component.role is Role.LAW and edge.component.acts is Acts.LINE:
            show = LINE_FORCE  # a component that the user registered
        is_hidden = edge.component.role is Role.JOINT and draft.is_hidden(edge)
        if show is not None and not is_hidden:
            show(draft, edge)
    for networked in first.scene.edges.values():
        if networked.component.geometry is not None:
            continue  # contacts were drawn above
        for ends in networked.ports:
            if len(ends.acts_on) == 2:  # the edge acts on two bodies, like a hydraulic cylinder
                draft.strut(networked.name, *ends.acts_on, shapes.piston(1.1 * draft.w), DAMPER)
    return draft
