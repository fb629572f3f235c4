"""Shapes of a body: bars for its arms, and a box that has its inertia."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.watch import shapes
from cotree.watch.colors import JOINT, RAIL

if TYPE_CHECKING:
    from cotree.formulation.fields import BoundEdge
    from cotree.watch.draft import Drafter
    from cotree.watch.shapes import Array


def arm(draft: Drafter, edge: BoundEdge) -> None:
    """Show an arm as a bar, thin where it only leads to a centre of mass."""
    one, two = draft.places[edge.first], draft.places[edge.second]
    if one.cluster != two.cluster:  # held by multipliers
        draft.strut(edge.name, edge.first, edge.second, shapes.rod(0.7 * draft.w), RAIL)
        return
    gap = two.local - one.local
    length = float(np.linalg.norm(gap))
    # Meshes of a robot's file show the body already; an arm without length is a turn only.
    if one.cluster in draft.clothed or length < 1e-9 * draft.stage.size:
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


def body(draft: Drafter, edge: BoundEdge) -> None:
    """Show a mass as a dot on its bars, or as a box with its inertia."""
    place = draft.places[edge.second]
    cluster, w = place.cluster, draft.w
    if cluster in draft.clothed or cluster == 0 or cluster in draft.stage.shown:
        return
    at = place.local + draft.raised(cluster)
    has_bars = cluster in draft.stage.reach
    tensor = _inertia(draft, edge)
    mass = float(draft.values.numbers([edge.scalars["mass"]])[0])
    # In a plane bars show the body, and a dot suffices for its centre of mass.
    if draft.stage.is_flat and has_bars:
        dot = shapes.cylinder(0.42 * w, 0.9 * w)
        draft.solid(
            edge.name, cluster, dot.placed(at, shapes.axes_along(draft.towards(cluster))), JOINT
        )
        return
    found = None if tensor is None else body_box(mass, tensor)
    if found is None or (has_bars and edge.inertia is None):
        draft.solid(edge.name, cluster, shapes.sphere((1.3 if has_bars else 2.4) * w).placed(at))
        return
    lengths, axes = found
    if has_bars:
        # A box that is larger than the arms of its body would hide the mechanism.
        lengths = lengths * min(1.0, 0.6 * draft.stage.reach[cluster] / max(lengths.max(), w))
    lengths = np.maximum(lengths, (1.0 if has_bars else 3.0) * w)
    if draft.stage.is_flat:
        # Towards the viewer the box is as thin as a plate, so that layers stay apart.
        towards = np.abs(place.turn.T @ draft.towards(cluster))
        side = float(np.median(lengths))
        lengths, axes = np.where(towards > 0.5, 0.75 * w, side), np.eye(3)
    mesh = shapes.box(*lengths).placed(at, place.turn @ axes)
    draft.solid(edge.name, cluster, mesh, label=not has_bars)


def _inertia(draft: Drafter, edge: BoundEdge) -> Array | None:
    """Give the inertia tensor in the node's axes."""
    if edge.inertia is not None:
        return draft.values.matrix(edge.inertia)
    if "inertia" in edge.scalars:
        return float(draft.values.numbers([edge.scalars["inertia"]])[0]) * np.eye(3)
    return None


def body_box(mass: float, tensor: Array) -> tuple[Array, Array] | None:
    """Find the homogeneous box with a mass and an inertia about its centre.

    Its lengths follow from I1 = m (b^2 + c^2) / 12 and so on: a^2 = 6 (I2 + I3 - I1) / m.

    Parameters
    ----------
    mass : float
        Not negative, [kg].
    tensor : ndarray, shape (3, 3)
        [kg m^2].

    Returns
    -------
    lengths : ndarray, shape (3,), [m]
        Zero along a principal axis for which no homogeneous box exists.
    axes : ndarray, shape (3, 3)
        The principal axes, right-handed, as columns.
    None
        If the inertia is zero or invalid.
    """
    if not np.all(np.isfinite(tensor)) or mass < 0.0:
        return None
    # Axes of a diagonal tensor are kept as they are: eigenvectors come in the order of the moments.
    is_diagonal = np.count_nonzero(tensor - np.diag(np.diag(tensor))) == 0
    moments, axes = (np.diag(tensor), np.eye(3)) if is_diagonal else np.linalg.eigh(tensor)
    # Eigenvectors have any sign; a mirrored box would be inside out.
    if np.linalg.det(axes) < 0.0:
        axes = axes * np.array([1.0, 1.0, -1.0])
    # A body with inertia but no mass is drawn at the least size.
    squares = 6.0 * (moments.sum() - 2.0 * moments) / (mass or np.inf)
    if moments.max() <= 0.0:
        return None
    return np.sqrt(np.maximum(squares, 0.0)), axes
