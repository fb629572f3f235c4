"""Rigid stops, and rigid or compliant contact of bodies.

The mode of an edge (:mod:`cotree.hybrid.unilateral`) is 0 while it is open, 1 and -1 while it is
closed at its upper or its lower limit. The first node carries a plane or a sphere, the second the
body that touches it. Each point that may touch, such as a corner of a box, has a port for its gap
and ports for the directions of slip. The port of the gap is a rigid stop with the lower limit zero.
In planar systems, the port of a slip has dry friction, with the stop's force as normal force.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from cotree.components.component import (
    Adapted,
    Component,
    Demand,
    Field,
    Given,
    Nodes,
    Plane,
    Role,
    Shape,
    optional,
)
from cotree.components.law import Law, argument, larger, magnitude, sqrt
from cotree.components.ports import demands_on_limits, scalar
from cotree.components.terminal import (
    Friction,
    Kind,
    PortMeasure,
    Stop,
    Terminal,
    Touch,
    active_port,
)
from cotree.errors import SceneError


def rebound(across: Any, restitution: Any) -> Any:
    """Return the change of the relative speed ``across`` in an impact."""
    return -(1 + restitution) * across


def excess(across: Any, restitution: Any, rest_speed: Any) -> Any:
    """Return the rebound speed minus the speed below which the contact stays closed."""
    return restitution * magnitude(across) - rest_speed


def _port(domain: str, given: Given) -> Terminal:
    upper = Law(lambda stretch, upper: upper - stretch) if "upper" in given else None
    lower = Law(lambda stretch, lower: stretch - lower) if "lower" in given else None
    stop = Stop(upper, lower, Law(rebound), Law(excess))
    return active_port(domain, Kind.STOP, stop=stop)


BOUNDED = Demand(
    Law(lambda restitution: 1 + 1e-15 - restitution), "needs a restitution of one at most"
)


RESTITUTION = optional(
    "restitution", "1", "ratio of the speeds after and before an impact", 0.0, "nonnegative"
)


def _rest_speed(unit: str) -> Field:
    doc = "rebound speed below which the contact stays closed"
    return optional("rest_speed", unit, doc, 1e-3, "positive")


def _stop(domain: str, length: str, unit: str) -> Component:
    def adapt(edge: str, nodes: Nodes, given: Given) -> Adapted:
        demands = (*demands_on_limits(made.name, edge, given), BOUNDED)
        return replace(made, ports=(_port(domain, given),), demands=demands), nodes, given

    fields = (
        # Limits are constant, because moving limits would do work on the node.
        Field("lower", unit, f"smallest {length}; unlimited if omitted"),
        Field("upper", unit, f"largest {length}; unlimited if omitted"),
        RESTITUTION,
        _rest_speed(f"{unit}/s"),
    )
    both = {"lower": 0, "upper": 1}
    made = scalar(
        f"{domain}_rigid_stop", "rigid stops at one or two limits", fields, _port(domain, both)
    )
    return replace(made, adapt=adapt)


#: Fields of the shapes that may touch; the laws of contact do not use them.
SHAPES = (
    Field("normal", "1", "normal of the first node's plane, towards the second node", Shape.VECTOR),
    Field("ball", "m", "radius of the first node's sphere, instead of a plane", sign="positive"),
    Field(
        "radius",
        "m",
        "radius of the second node's sphere, disc or cylinder; a point has none",
        sign="positive",
    ),
    Field("axis", "1", "axis of the second node's disc or cylinder, in its frame", Shape.VECTOR),
    Field("length", "m", "length of the second node's cylinder", sign="positive"),
    Field(
        "semiaxes",
        "m",
        "semi-axes of the second node's ellipsoid, along its axes",
        Shape.VECTOR,
        sign="positive",
    ),
    Field(
        "size",
        "m",
        "edge lengths of the second node's box, along its axes",
        Shape.VECTOR,
        sign="nonnegative",
    ),
)

#: Fields of dry friction at the contact.
FRICTION = optional(
    "friction", "1", "coefficient of friction; no friction if omitted", None, "nonnegative"
)

#: The part of a contact that belongs to the multibody system.
GEOMETRY = Component(
    "contact_geometry",
    Role.TOUCH,
    "shapes of two bodies that may touch",
    SHAPES,
    keeps_plane=Plane(within=("normal",), along=("axis",)),
)


def spots_of(edge: str, given: Given) -> int:
    """Return the number of contact points of an edge; raise SceneError for unsupported shapes."""
    whose = f"edge '{edge}'"
    if ("normal" in given) == ("ball" in given):
        raise SceneError(
            f"{whose} needs the normal of a plane or the radius of a ball, which its first node "
            "carries: give one of them"
        )
    if "size" in given:
        if given.keys() & {"radius", "axis", "length", "semiaxes"}:
            raise SceneError(
                f"{whose} has the size of a box: remove radius, axis, length and semiaxes"
            )
        sides = box_edges(given["size"])
        if not sides:
            raise SceneError(
                f"size of {whose} is zero along every axis: give the lengths of the box's "
                "edges, or remove size, so that the node itself touches"
            )
        return 1 if "ball" in given else int(2 ** len(sides))
    if "semiaxes" in given:
        if given.keys() & {"radius", "axis", "length", "ball"}:
            raise SceneError(
                f"{whose} has the semiaxes of an ellipsoid, which touches a plane: remove "
                "radius, axis, length and ball; spheres, discs, cylinders and boxes touch balls"
            )
        return 1
    if "axis" in given:
        if "radius" not in given:
            raise SceneError(f"{whose} has the axis of a disc or cylinder: it needs a radius")
        return 2 if "length" in given and "ball" not in given else 1
    if "length" in given:
        raise SceneError(f"{whose} has the length of a cylinder, and needs its axis")
    return 1


def box_edges(size: Any) -> tuple[int, ...]:
    """Return the axes along which a box is extended; a plate has the size 0 along its normal."""
    if isinstance(size, Mapping) and "value" in size:
        return box_edges(size["value"])
    if not isinstance(size, (list, tuple)) or len(size) != 3:
        return (0, 1, 2)  # not a vector: rejected later
    return tuple(i for i, edge in enumerate(size) if not _is_written_zero(edge))


def _is_written_zero(edge: Any) -> bool:
    """Return whether a size in a scene is the number zero, possibly in quotes or with a unit."""
    if isinstance(edge, Mapping):
        return _is_written_zero(edge.get("value"))
    try:
        return float(edge) == 0.0
    except (TypeError, ValueError):  # an expression, not a number
        return False


def suffix_of(spot: int, n_spots: int) -> str:
    """Return the suffix of the port names of a contact point, empty if it is the only point."""
    return f"_{spot + 1}" if n_spots > 1 else ""


def slide_name(direction: int, suffix: str) -> str:
    """Return the name of a point's port along a slip direction; 0 is in the plane of motion."""
    return f"slide{direction + 1}{suffix}"


def shaped(made: Component, edge: str, given: Given) -> tuple[Component, Given]:
    """Return a contact with its part in the multibody system, and its fields.

    A box, disc or cylinder touches a ball with a face, an edge, a rim or a corner. Fields that are
    1 beyond a face or rim select the region: comparisons, which become modes with events.
    """
    # If the force passes through the second node, it does not affect the rotation of this node.
    is_central = not given.keys() & {"friction", "axis", "size", "semiaxes"}
    geometry = replace(GEOMETRY, domains=("translation",)) if is_central else GEOMETRY
    names: list[str] = []
    if "ball" in given and "size" in given:
        names = [f"beyond_{'xyz'[i]}" for i in box_edges(given["size"])]
    elif "ball" in given and "axis" in given:
        names = ["beyond_rim", "beyond_end"] if "length" in given else ["beyond_rim"]
    added = tuple(Field(name, "1", _BEYOND, constant=False) for name in names)
    regions = {name: f"where({edge}.{name} >= 0, 1, 0)" for name in names}
    geometry = replace(geometry, fields=(*geometry.fields, *added))
    return replace(made, fields=(*made.fields, *added), geometry=geometry), {**given, **regions}


_BEYOND = "1 while the ball's centre is beyond a face or rim of the second body"


#: Length, [m], added to the penetration depth in powers, so that derivatives are finite.
_OFFSET = 1e-30


class _ContactForces:
    """Laws of a contact point: the normal force during penetration, and friction."""

    def __init__(self, exponent: float, is_plane: bool, has_friction: bool) -> None:
        self._exponent = exponent
        # A plane has two slip directions. For a ball, slips are the tangential parts of three axes.
        self._slips = ("slip1", "slip2") if is_plane else ("part1", "part2", "part3")
        self._has_friction = has_friction

    def _normal_force(self) -> Any:
        """Return the normal force, which is never tensile.

        K. H. Hunt and F. R. E. Crossley, J. Appl. Mech. 42 (1975) 440: the force of a spring is
        multiplied by one plus a term proportional to the rate of approach.
        """
        depth = larger(-argument("stretch"), 0)
        share = 1 - 1.5 * argument("dissipation") * argument("across")
        # The offset is below rounding errors; it keeps second derivatives finite in open gaps.
        power = depth * (depth + _OFFSET) ** (self._exponent - 1)
        return argument("stiffness") * larger(share, 0) * power

    def ports(self, n_spots: int) -> tuple[Terminal, ...]:
        """Build the ports of all contact points."""
        force = -self._normal_force()
        found = []
        for spot in range(n_spots):
            end = suffix_of(spot, n_spots)
            normal = f"normal{end}"
            gap = Touch(spot, "gap")
            found.append(
                active_port("translational", Kind.SPRING, normal, through=force, touch=gap)
            )
            if self._has_friction:
                found += self._slides(spot, end, normal)
        return tuple(found)

    def _slides(self, spot: int, end: str, normal: str) -> list[Terminal]:
        names = tuple(slide_name(i, end) for i in range(len(self._slips)))

        # Friction is regularised: near rest, it is a smooth function of velocity.
        squares = sum(argument(f"across_{name}") ** 2 for name in names)
        speed = sqrt(squares + argument("transition") ** 2)
        factor = -argument(f"through_{normal}") * argument("friction") / speed
        return [
            active_port(
                "translational",
                Kind.DISSIPATOR,
                name,
                through=factor * argument(f"across_{name}"),
                touch=Touch(spot, slip),
            )
            for name, slip in zip(names, self._slips, strict=True)
        ]


def pushes(n_spots: int) -> tuple[PortMeasure, ...]:
    """Return the sum of the normal forces of all contact points, as a measure."""
    terms = tuple((-1, "through", f"normal{suffix_of(i, n_spots)}") for i in range(n_spots))
    return (PortMeasure("force", "N", terms),)


def _exponent(edge: str, given: Given) -> float:
    """Return the exponent of the contact law; raise SceneError unless it is a number >= 1."""
    value = given.get("exponent", 1.5)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 1 <= value <= 10:
        raise SceneError(f"exponent of edge '{edge}' must be a number from 1 to 10")
    return value


def _adapt(edge: str, nodes: Nodes, given: Given) -> Adapted:
    n_spots, has_friction = spots_of(edge, given), "friction" in given
    forces = _ContactForces(_exponent(edge, given), "normal" in given, has_friction)
    own = replace(CONTACT, ports=forces.ports(n_spots), measures=pushes(n_spots))
    own, fields = shaped(own, edge, given)
    return own, nodes, {name: value for name, value in fields.items() if name != "exponent"}


_LAWS = (
    Field(
        "stiffness", "", "stiffness k in the force k depth^exponent", required=True, sign="positive"
    ),
    Field(
        "exponent",
        "1",
        "exponent of the depth, a number: 1.5 for spheres (Hertz), 1 if linear",
        default=1.5,
    ),
    optional(
        "dissipation",
        "s/m",
        "dissipation coefficient d: the force has a factor 1 + d times speed of approach",
        0.0,
        "nonnegative",
    ),
    FRICTION,
    optional(
        "transition", "m/s", "sliding speed below which friction is smoothed", 1e-3, "positive"
    ),
)

CONTACT = scalar(
    "contact",
    "elastic contact of two bodies, with friction",
    (*SHAPES, *_LAWS),
    *_ContactForces(1.5, True, True).ports(1),
    adapt=_adapt,
    geometry=GEOMETRY,
    measures=pushes(1),
)


def _gap(spot: int, end: str) -> Terminal:
    stop = Stop(None, argument("stretch"), Law(rebound), Law(excess), f"_normal{end}")
    touch = Touch(spot, "gap")
    return active_port("translational", Kind.STOP, f"normal{end}", stop=stop, touch=touch)


def _slip(spot: int, end: str) -> Terminal:
    # The normal force is the negative through variable along the gap.
    most, name = -argument("friction") * argument(f"through_normal{end}"), slide_name(0, end)
    friction = Friction(most, -most, most, -most, presser=f"normal{end}", suffix=f"_{name}")
    return _sliding(spot, 0, end, friction)


def _sliding(spot: int, direction: int, end: str, friction: Friction) -> Terminal:
    name, touch = slide_name(direction, end), Touch(spot, f"slip{direction + 1}")
    return active_port("translational", Kind.FRICTION, name, friction=friction, touch=touch)


def _disc(spot: int, end: str) -> list[Terminal]:
    """Build the ports for both slip directions of a contact point on a plane in space."""
    names = slide_name(0, end), slide_name(1, end)
    most = -argument("friction") * argument(f"through_normal{end}")

    def friction(name: str) -> Friction:
        return Friction(
            # The scene adds this field: the component of the slip direction.
            most * argument(f"way_{name}"),
            # In an impact, friction acts along the slip after the impact.
            most * argument(f"direction_{name}"),
            most,
            None,
            presser=f"normal{end}",
            suffix=f"_{name}",
            leader="" if name == names[0] else names[0],
            followers=names[1:] if name == names[0] else (),
        )

    return [_sliding(spot, i, end, friction(name)) for i, name in enumerate(names)]


def _ports(n_spots: int, has_friction: bool, is_planar: bool = True) -> tuple[Terminal, ...]:
    found = []
    for spot in range(n_spots):
        end = suffix_of(spot, n_spots)
        found.append(_gap(spot, end))
        if has_friction and is_planar:
            found.append(_slip(spot, end))
        elif has_friction:
            found += _disc(spot, end)
    return tuple(found)


def with_discs(component: Component) -> Component:
    """Extend a rigid contact: friction acts in both directions of slip instead of one."""
    n_spots = sum(terminal.kind is Kind.STOP for terminal in component.ports)
    return replace(component, ports=_ports(n_spots, True, is_planar=False))


def _adapt_rigid(edge: str, nodes: Nodes, given: Given) -> Adapted:
    n_spots, has_friction = spots_of(edge, given), "friction" in given
    own = replace(RIGID_CONTACT, ports=_ports(n_spots, has_friction), measures=pushes(n_spots))
    own, fields = shaped(own, edge, given)
    return own, nodes, fields


RIGID_CONTACT = scalar(
    "rigid_contact",
    "rigid contact of two bodies, with impacts and dry friction",
    (*SHAPES, RESTITUTION, _rest_speed("m/s"), FRICTION),
    *_ports(1, True),
    adapt=_adapt_rigid,
    geometry=GEOMETRY,
    measures=pushes(1),
    demands=(BOUNDED,),
)

COMPONENTS = (
    _stop("translational", "length", "m"),
    _stop("rotational", "angle", "rad"),
    CONTACT,
    RIGID_CONTACT,
)
