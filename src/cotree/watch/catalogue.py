"""Catalogue of the shapes that show the edges.

Arms are shown as bars, bodies without arms as boxes, joints as the parts that turn or slide in
them; springs, dampers and other edges between bodies are struts. Shapes from a robot's file replace
all these where they are available.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.components import Acts, Role
from cotree.watch import bodies, elements, joints, shapes, touching
from cotree.watch.colors import DAMPER
from cotree.watch.draft import Drafter

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from cotree.formulation.fields import BoundEdge
    from cotree.formulation.first_graph import FirstGraph
    from cotree.watch.poses import MotionValues
    from cotree.watch.shapes import Mesh
    from cotree.watch.stage import Stage

#: The function that shows an edge, by its component. Gears, free joints and loads are not shown.
SHOWN: dict[str, Callable[[Drafter, BoundEdge], None]] = {
    "arm": bodies.arm,
    "rigid_body": bodies.body,
    "revolute": joints.revolute,
    "universal": joints.universal,
    "spherical": joints.spherical,
    "prismatic": joints.sliding,
    "cylindrical": joints.sliding,
    "screw": joints.sliding,
    "slot": joints.slot,
    "rolling_disc": joints.disc,
    "rolling_ellipsoid": touching.contact,
    "knife_edge": joints.blade,
    "spring": elements.spring,
    "damper": elements.damper,
    "distance": elements.distance,
    "line_force": elements.line_force,
    "bushing": elements.bushing,
    "contact_geometry": touching.contact,
}


def draft_scene(
    first: FirstGraph,
    values: MotionValues,
    stage: Stage,
    visuals: Mapping[int, list[tuple[str, Mesh]]],
) -> Drafter:
    """Draw every edge.

    Parameters
    ----------
    first : FirstGraph
        The graph.
    values : MotionValues
        Gives positions and fields.
    stage : Stage
        Directions and sizes.
    visuals : mapping of int to list of (str, Mesh)
        Shapes of a robot's file by cluster, in place of its bars, boxes and joints.
    """
    draft = Drafter(first, values, stage, frozenset(visuals))
    for track, own in visuals.items():
        for name, mesh in own:
            draft.solid(name, track, mesh)
        draft.label(own[0][0], track, own[0][1].points.mean(axis=0))
    for edge in first.system.edges.values():
        show = SHOWN.get(edge.component.name)
        # Registered types have names that the table cannot know.
        if edge.component.role is Role.LAW and edge.component.acts is Acts.LINE:
            show = elements.line_force  # a law of a user's own
        if show is not None:
            show(draft, edge)
    for networked in first.scene.edges.values():
        if networked.component.geometry is not None:
            continue  # its surfaces are those of an edge above
        for ends in networked.ports:
            if len(ends.acts_on) == 2:  # a hydraulic cylinder between two bodies, for example
                draft.strut(networked.name, *ends.acts_on, shapes.piston(1.1 * draft.w), DAMPER)
    return draft
