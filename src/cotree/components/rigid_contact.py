"""Rigid contact of bodies of a multibody system: impacts, rest, lift-off, and Coulomb friction.

Each place that may touch has a rigid stop along its gap, whose lower limit is zero, and in planar
systems dry friction along the surface, which that stop presses together.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from cotree.components.component import optional
from cotree.components.contact import GEOMETRY, SHAPES, spots_of
from cotree.components.law import Law
from cotree.components.ports import scalar
from cotree.components.stops import BOUNDED, excess, rebound
from cotree.components.terminal import Friction, Kind, PortMeasure, Stop, Terminal, Touch
from cotree.errors import SceneError

if TYPE_CHECKING:
    from cotree.components.component import Adapted, Given, Nodes


def _symbol(name: str) -> Any:
    import sympy

    return sympy.Symbol(name, real=True)


def _suffix(spot: int, n_spots: int) -> str:
    return f"_{spot + 1}" if n_spots > 1 else ""


def _gap(spot: int, end: str) -> Terminal:
    stop = Stop(None, Law.field("stretch"), Law(rebound), Law(excess), f"_normal{end}")
    touch = Touch(spot, "gap")
    return Terminal(
        "translational", Kind.STOP, f"normal{end}", is_passive=False, stop=stop, touch=touch
    )


def _slip(spot: int, end: str) -> Terminal:
    def most(way: int) -> Law:
        # What pushes is the negative of the through variable along the gap.
        return Law.formed_by(lambda: -way * _symbol("friction") * _symbol(f"through_normal{end}"))

    friction = Friction(
        most(1), most(-1), most(1), most(-1), presser=f"normal{end}", suffix=f"_slide{end}"
    )
    return Terminal(
        "translational",
        Kind.FRICTION,
        f"slide{end}",
        is_passive=False,
        friction=friction,
        touch=Touch(spot, "slip"),
    )


def _ports(n_spots: int, has_friction: bool) -> tuple[Terminal, ...]:
    found = []
    for spot in range(n_spots):
        end = _suffix(spot, n_spots)
        found.append(_gap(spot, end))
        if has_friction:
            found.append(_slip(spot, end))
    return tuple(found)


def _push(n_spots: int) -> tuple[PortMeasure, ...]:
    terms = tuple((-1, "through", f"normal{_suffix(i, n_spots)}") for i in range(n_spots))
    return (PortMeasure("force", "N", terms),)


def _adapt(edge: str, nodes: Nodes, given: Given) -> Adapted:
    n_spots, has_friction = spots_of(edge, given), "friction" in given
    if has_friction and "ball" in given:
        raise SceneError(
            f"edge '{edge}' has friction on a ball, which rigid contact knows on planes only: "
            "leave it out, or take a contact that gives way"
        )
    is_central = not has_friction and not given.keys() & {"axis", "size", "semiaxes"}
    geometry = replace(GEOMETRY, domains=("translation",)) if is_central else GEOMETRY
    own = replace(
        CONTACT,
        ports=_ports(n_spots, has_friction),
        measures=_push(n_spots),
        geometry=geometry,
    )
    return own, nodes, given


CONTACT = scalar(
    "rigid_contact",
    "rigid contact of two bodies, with impacts and dry friction",
    (
        *SHAPES,
        optional("restitution", "1", "speed after an impact over that before", 0.0, "nonnegative"),
        optional("rest_speed", "m/s", "after an impact, below it is held", 1e-3, "positive"),
        optional(
            "friction", "1", "coefficient of friction; none where left out", None, "nonnegative"
        ),
    ),
    *_ports(1, True),
    adapt=_adapt,
    geometry=GEOMETRY,
    measures=_push(1),
    demands=(BOUNDED,),
)

COMPONENTS = (CONTACT,)
