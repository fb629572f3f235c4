"""Rigid contact of bodies of a multibody system: impacts, rest, lift-off, and Coulomb friction.

Each place that may touch has a rigid stop along its gap, whose lower limit is zero, and in planar
systems dry friction along the surface, which that stop presses together.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from cotree.components.component import optional
from cotree.components.contact import (
    FRICTION,
    GEOMETRY,
    SHAPES,
    geometry_of,
    pushes,
    slide_name,
    spots_of,
    suffix_of,
)
from cotree.components.law import Law, law_symbol
from cotree.components.ports import scalar
from cotree.components.stops import BOUNDED, excess, rebound
from cotree.components.terminal import Friction, Kind, Stop, Terminal, Touch
from cotree.errors import SceneError

if TYPE_CHECKING:
    from cotree.components.component import Adapted, Given, Nodes


def _gap(spot: int, end: str) -> Terminal:
    stop = Stop(None, Law.field("stretch"), Law(rebound), Law(excess), f"_normal{end}")
    touch = Touch(spot, "gap")
    return Terminal(
        "translational", Kind.STOP, f"normal{end}", is_passive=False, stop=stop, touch=touch
    )


def _slip(spot: int, end: str) -> Terminal:
    def most(way: int) -> Law:
        # What pushes is the negative of the through variable along the gap.
        return Law.formed_by(
            lambda: -way * law_symbol("friction") * law_symbol(f"through_normal{end}")
        )

    name = slide_name(0, end)
    friction = Friction(
        most(1), most(-1), most(1), most(-1), presser=f"normal{end}", suffix=f"_{name}"
    )
    return Terminal(
        "translational",
        Kind.FRICTION,
        name,
        is_passive=False,
        friction=friction,
        touch=Touch(spot, "slip1", is_planar=True),
    )


def _ports(n_spots: int, has_friction: bool) -> tuple[Terminal, ...]:
    found = []
    for spot in range(n_spots):
        end = suffix_of(spot, n_spots)
        found.append(_gap(spot, end))
        if has_friction:
            found.append(_slip(spot, end))
    return tuple(found)


def _adapt(edge: str, nodes: Nodes, given: Given) -> Adapted:
    n_spots, has_friction = spots_of(edge, given), "friction" in given
    if has_friction and "ball" in given:
        raise SceneError(
            f"edge '{edge}' has friction on a ball, which rigid contact knows on planes only: "
            "leave it out, or take a contact that gives way"
        )
    own = replace(
        CONTACT,
        ports=_ports(n_spots, has_friction),
        measures=pushes(n_spots),
        geometry=geometry_of(given),
    )
    return own, nodes, given


CONTACT = scalar(
    "rigid_contact",
    "rigid contact of two bodies, with impacts and dry friction",
    (
        *SHAPES,
        optional("restitution", "1", "speed after an impact over that before", 0.0, "nonnegative"),
        optional("rest_speed", "m/s", "after an impact, below it is held", 1e-3, "positive"),
        FRICTION,
    ),
    *_ports(1, True),
    adapt=_adapt,
    geometry=GEOMETRY,
    measures=pushes(1),
    demands=(BOUNDED,),
)

COMPONENTS = (CONTACT,)
