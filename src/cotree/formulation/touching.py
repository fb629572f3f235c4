"""The places of two bodies that may touch, as measures that the ports of a contact act along."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING

from cotree.dag import vector
from cotree.errors import FormulationError
from cotree.formulation.contact import Centres, Tangent, Touching, surface_of
from cotree.formulation.endpoints import carried_by, chord_ends
from cotree.formulation.fields import plane_axes

if TYPE_CHECKING:
    from cotree.components.terminal import Touch
    from cotree.dag.vector import Vector
    from cotree.formulation.across import Motion
    from cotree.formulation.contact import Facing
    from cotree.formulation.endpoints import Ends
    from cotree.formulation.fields import BoundEdge


def touching(motion: Motion, edge: BoundEdge, touch: Touch) -> Touching:
    """Measure the gap or a slip at one of the places of a contact.

    Parameters
    ----------
    motion : Motion
        The multibody system.
    edge : BoundEdge
        The shapes that may touch.
    touch : Touch
        The place, and what is measured there.

    Raises
    ------
    FormulationError
        If laws that hold in a plane act where not everything moves in one.
    """
    ends = _ends_at(chord_ends(motion, edge), edge, touch.spot)
    dag = motion.system.dag
    surface = surface_of(motion, edge, ends)
    facing: Facing = Centres(ends, edge.name)
    rise = edge.scalars.get("ball", dag.zero)
    if "normal" in edge.vectors:
        facing = carried_by(motion, ends, 0, edge.vectors["normal"])
    if touch.quantity == "gap":
        return Touching(ends, facing, surface, facing, rise)
    if touch.is_planar and not motion.system.plane:
        raise FormulationError(
            f"edge '{edge.name}' has friction, which rigid contact knows where everything moves in "
            "one plane: leave it out, or take a contact that gives way"
        )
    along = _directions(motion, edge)[int(touch.quantity.removeprefix("slip")) - 1]
    # No two directions are across that of the centres wherever they are: three axes always have
    # parts that span them.
    direction: Facing = Tangent(facing, along)
    if "normal" in edge.vectors:
        direction = carried_by(motion, ends, 0, along)
    return Touching(ends, facing, surface, direction, None)


def _directions(motion: Motion, edge: BoundEdge) -> tuple[Vector, ...]:
    """List the directions in which a body slides: across a plane's normal, and axes of a ball.

    The first two and the normal are right-handed. In a planar system the first is normal x e, with
    e the axis across the plane of motion, and the second is against e.
    """
    axes = vector.identity(motion.system.dag)
    if "normal" not in edge.vectors:
        return tuple(axes)
    normal, plane = edge.vectors["normal"], motion.system.plane
    if not plane:
        return plane_axes(normal)
    first = vector.cross(normal, axes["xyz".index(plane)])
    return first, vector.cross(normal, first)


def _ends_at(ends: Ends, edge: BoundEdge, spot: int) -> Ends:
    """Move the second end from its node to a place that may touch."""
    offset = _offset(edge, spot)
    if offset is None:
        return ends
    point = ends.second
    local = vector.add(point.local, point.resolved(offset))
    return replace(ends, second=replace(point, local=local))


def _offset(edge: BoundEdge, spot: int) -> Vector | None:
    """Give the place from the node, in its axes; None where it is the node."""
    if "size" in edge.vectors:
        size = edge.vectors["size"]
        corner = list(vector.zeros(size[0].dag))
        sides = [i for i in range(3) if not size[i].is_zero]
        # An edge that a parameter makes zero has two corners at one place, as many as otherwise.
        signs = list(product((-1, 1), repeat=len(sides)))
        for i, sign in zip(sides, signs[spot % len(signs)], strict=True):
            corner[i] = 0.5 * sign * size[i]
        return (corner[0], corner[1], corner[2])
    if "length" in edge.scalars:
        return vector.scale((spot - 0.5) * edge.scalars["length"], edge.vectors["axis"])
    return None
