"""Shapes of forces and distances between two bodies."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.watch import shapes
from cotree.watch.colors import DAMPER, FORCE, JOINT, SPRING

if TYPE_CHECKING:
    from cotree.formulation.fields import BoundEdge
    from cotree.watch.draft import Drafter


def spring(draft: Drafter, edge: BoundEdge) -> None:
    """Show a coil."""
    length = draft.length(edge.first, edge.second)
    if length > 0.0:
        # A coil is slim even where bars are thick against its length.
        radius = min(1.5 * draft.w, 0.15 * length)
        mesh = shapes.coil(radius, min(0.28 * draft.w, 0.2 * radius), length)
        draft.strut(edge.name, edge.first, edge.second, mesh, SPRING)


def damper(draft: Drafter, edge: BoundEdge) -> None:
    """Show a piston in a barrel."""
    draft.strut(edge.name, edge.first, edge.second, shapes.piston(1.1 * draft.w), DAMPER)


def distance(draft: Drafter, edge: BoundEdge) -> None:
    """Show a rod."""
    draft.strut(edge.name, edge.first, edge.second, shapes.rod(0.5 * draft.w), JOINT)


def line_force(draft: Drafter, edge: BoundEdge) -> None:
    """Show a thin red line."""
    draft.strut(edge.name, edge.first, edge.second, shapes.rod(0.3 * draft.w), FORCE)


def bushing(draft: Drafter, edge: BoundEdge) -> None:
    """Show a ball where both nodes meet."""
    place = draft.places[edge.first]
    ball = shapes.sphere(1.5 * draft.w).placed(place.local + draft.raised(place.cluster))
    draft.solid(edge.name, place.cluster, ball, SPRING, label=True)
