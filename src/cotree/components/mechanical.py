"""One-dimensional mechanics: across is the velocity of the second node relative to the first.

Stretch is the integral of across. The through variable flows from the second node into the element:
tension in a spring is positive, and a positive force on the second node is negative.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from cotree.components.component import (
    Adapt,
    Adapted,
    Component,
    Field,
    Given,
    Nodes,
    Plane,
    Role,
    Shape,
    optional,
    value,
)
from cotree.components.law import Law, argument, larger, smaller, sqrt, tanh
from cotree.components.ports import (
    across_source,
    demands_on_limits,
    ideal_coupling,
    scalar,
    storage,
    through_source,
)
from cotree.components.terminal import Kind, Terminal, active_port
from cotree.errors import SceneError


@dataclass(frozen=True)
class _Motion:
    """Names and units for translation or for rotation."""

    domain: str
    force: str
    force_unit: str
    length: str
    length_unit: str

    @property
    def speed_unit(self) -> str:
        return f"{self.length_unit}/s"

    @property
    def stiffness_unit(self) -> str:
        return f"{self.force_unit}/{self.length_unit}"

    @property
    def damping_unit(self) -> str:
        return f"{self.force_unit} s/{self.length_unit}"

    def name(self, what: str) -> str:
        return f"{self.domain}_{what}"


_TRANSLATION = _Motion("translational", "force", "N", "length", "m")
_ROTATION = _Motion("rotational", "torque", "N m", "angle", "rad")


def _damper(m: _Motion) -> Component:
    field = value("damping", m.damping_unit, f"damping {m.force} per relative speed", "nonzero")
    terminal = Terminal(
        m.domain,
        Kind.DISSIPATOR,
        across=Law(lambda through, damping: through / damping),
        through=Law(lambda across, damping: damping * across),
    )
    return scalar(m.name("damper"), "linear damper", (field,), terminal)


def _stiffness(m: _Motion, sign: str = "positive") -> Field:
    return value("stiffness", m.stiffness_unit, f"{m.force} per {m.length}", sign)


def _free(m: _Motion) -> Field:
    return optional(
        f"free_{m.length}", m.length_unit, f"{m.length} at which the {m.force} is zero", 0.0
    )


def _linear(m: _Motion) -> Terminal:
    return Terminal(
        m.domain,
        Kind.SPRING,
        # The third argument is the field ``free_length`` or ``free_angle``.
        through=Law.taking(
            ("stretch", "stiffness", f"free_{m.length}"), lambda s, k, free: k * (s - free)
        ),
        storage=argument("stiffness"),
    )


def _by_expression(spring: Component, m: _Motion) -> Adapt:
    """Return a function that gives a spring its stiffness, or the expression of its force."""
    # The slope of the expression may have any sign: the port is not passive.
    law = argument(m.force)
    bent = active_port(m.domain, Kind.SPRING, through=law)
    stiffness = replace(_stiffness(m, "nonzero"), required=True)

    def adapt(edge: str, nodes: Nodes, fields: Given) -> Adapted:
        # A linear spring and a spring given by an expression have different fields and laws.
        if m.force not in fields:
            rest = (field for field in spring.fields if field.name not in ("stiffness", m.force))
            return replace(spring, fields=(stiffness, *rest)), nodes, fields
        if "stiffness" in fields:
            raise SceneError(f"edge '{edge}' has a stiffness and a {m.force}: give one of them")
        own = tuple(field for field in spring.fields if field.name == m.force)
        return replace(spring, fields=own, ports=(bent,)), nodes, fields

    return adapt


def _spring(m: _Motion) -> Component:
    force = f"{m.force} of a nonlinear spring, instead of stiffness: an expression"
    fields = (
        replace(_stiffness(m, "nonzero"), required=False),
        _free(m),
        optional(m.force, m.force_unit, force, None),
    )
    doc = "linear spring, or a spring with any characteristic"
    made = scalar(m.name("spring"), doc, fields, _linear(m))
    return replace(made, adapt=_by_expression(made, m))


def _stop_law(
    stretch: Any, across: Any, lower: Any, upper: Any, stiffness: Any, damping: Any, transition: Any
) -> Any:
    """Return the force of the stops at both limits, which sets in smoothly over ``transition``."""
    # (x + sqrt(x^2 + d^2)) / 2 tends to 0 before the limit and to x beyond it; at it, d / 2.
    above, below = stretch - upper, lower - stretch
    reach, depth = (sqrt(x**2 + transition**2) for x in (above, below))
    # Damping is proportional to the derivative of the penetration, which rises from 0 to 1.
    contact = 1 + (above / reach + below / depth) / 2
    # Tension is positive: the stop pulls back beyond the upper limit, and pushes below the lower.
    return stiffness / 2 * (above + reach - below - depth) + damping * across * contact


def _stop(m: _Motion) -> Component:
    transition = f"{m.length} over which the stiffness sets in smoothly"
    fields = (
        value("lower", m.length_unit, f"{m.length} below which the lower stop acts", ""),
        value("upper", m.length_unit, f"{m.length} above which the upper stop acts", ""),
        value("stiffness", m.stiffness_unit, f"{m.force} per {m.length} in contact"),
        optional("damping", m.damping_unit, "damping in contact", 0.0, "nonnegative"),
        optional("transition", m.length_unit, transition, 1e-6, "positive"),
    )
    # The force depends on stretch, as in a spring.
    port = active_port(m.domain, Kind.SPRING, through=Law(_stop_law))
    return scalar(m.name("stop"), "elastic stops at both ends of a free travel", fields, port)


def _backlash(m: _Motion) -> Component:
    """Build a backlash with two elastic limits; a scene may omit one."""
    below = f"{m.length} below which the lower limit is in contact"
    above = f"{m.length} above which the upper limit is in contact"
    damping = "damping in contact; the contact never pulls"
    fields = (
        optional("lower", m.length_unit, below, None),
        optional("upper", m.length_unit, above, None),
        _stiffness(m),
        optional("damping", m.damping_unit, damping, 0.0, "nonnegative"),
    )

    def port(has_lower: bool, has_upper: bool) -> Terminal:
        def law(stretch: Any, across: Any, lower: Any, upper: Any, k: Any, d: Any) -> Any:
            above = k * larger(stretch - upper, 0) if has_upper else 0
            below = k * larger(lower - stretch, 0) if has_lower else 0
            # Damping is at most the elastic force: contact never pulls and begins without a jump.
            reach = above + below
            return above - below + larger(-reach, smaller(reach, d * across))

        names = ("stretch", "across", "lower", "upper", "stiffness", "damping")
        # Omit the arguments of a limit that is absent.
        through = law(*map(argument, names))
        return active_port(m.domain, Kind.SPRING, through=through)

    def adapt(edge: str, nodes: Nodes, given: Given) -> Adapted:
        own = port("lower" in given, "upper" in given)
        demands = demands_on_limits(made.name, edge, given)
        return replace(made, ports=(own,), demands=demands), nodes, given

    made = scalar(m.name("backlash"), "play between two elastic limits", fields, port(True, True))
    return replace(made, adapt=adapt)


def _friction(m: _Motion) -> Component:
    def law(across: Any, force: Any, damping: Any, transition: Any) -> Any:
        # The law is smooth and has no events: a loaded contact creeps instead of sticking.
        return force * tanh(across / transition) + damping * across

    transition = "speed below which dry friction is smoothed"
    fields = (
        value(m.force, m.force_unit, f"{m.force} of dry friction", "nonnegative"),
        optional("damping", m.damping_unit, "coefficient of viscous friction", 0.0, "nonnegative"),
        optional("transition", m.speed_unit, transition, 1e-3, "positive"),
    )
    through = Law.taking(("across", m.force, "damping", "transition"), law)
    port = active_port(m.domain, Kind.DISSIPATOR, through=through)
    return scalar(m.name("friction"), "smoothed dry friction with viscous friction", fields, port)


def _force_source(m: _Motion) -> Component:
    field = value(m.force, m.force_unit, f"{m.force} on the second node", "")
    doc = f"prescribed {m.force} on the second node"
    return through_source(m.domain, f"{m.force}_source", doc, field, acts_on_head=True)


def _speed_source(m: _Motion, name: str) -> Component:
    field = value(name, m.speed_unit, f"{name} of the second node relative to the first", "")
    made = across_source(m.domain, f"{name}_source", f"prescribed {name}", field)
    doc = "joint of a mechanism to drive, instead of nodes"
    place = Field("joint", "", doc, Shape.EXPRESSION, required=True)
    fields = (place, replace(field, constant=True, timed=True))
    # On a joint, the source constrains the joint velocity, and the multiplier is its effort.
    held = Component(
        made.name, Role.CONSTRAINT, made.doc, fields=fields, domains=(), keeps_plane=Plane()
    )

    def adapt(edge: str, nodes: Nodes, fields: Given) -> Adapted:
        return (held if "joint" in fields else made), nodes, fields

    return replace(made, adapt=adapt)


#: Velocity sources, which are constraints on joints: whether they rotate, and their field.
VELOCITY_SOURCES = {"velocity_source": (False, "velocity"), "speed_source": (True, "speed")}


MASS = storage(
    "translational",
    "translational_mass",
    "mass in translation along a line",
    value("mass", "kg", "mass of the body"),
    # Inertial forces depend on absolute velocity, so one node of a mass must be the ground.
    is_absolute=True,
)

INERTIA = storage(
    "rotational",
    "rotational_inertia",
    "moment of inertia in rotation about an axis",
    value("inertia", "kg m^2", "moment of inertia about the axis"),
    is_absolute=True,
)

# Torque and stretch determine the relative speed across the damper, as in a dissipator.
SHAFT = scalar(
    "shaft",
    "elastic shaft with damping",
    (
        _stiffness(_ROTATION),
        value("damping", _ROTATION.damping_unit, "damping torque per relative speed"),
        _free(_ROTATION),
    ),
    Terminal(
        "rotational",
        Kind.DISSIPATOR,
        across=Law(
            lambda through, stretch, stiffness, damping, free_angle: (
                (through - stiffness * (stretch - free_angle)) / damping
            )
        ),
        through=Law(
            lambda across, stretch, stiffness, damping, free_angle: (
                stiffness * (stretch - free_angle) + damping * across
            )
        ),
    ),
)

LEVER = ideal_coupling(
    "lever",
    "ideal lever at small angles",
    value(
        "ratio",
        "1",
        "input velocity per output velocity; negative if the pivot is between the ends",
        "",
    ),
    ("translational", "input"),
    ("translational", "output"),
)

IDEAL_GEAR = ideal_coupling(
    "ideal_gear",
    "ideal gear without losses",
    value(
        "ratio",
        "1",
        "speed of the input per speed of the output; negative for opposite directions",
        "",
    ),
    ("rotational", "input"),
    ("rotational", "output"),
)

RACK_AND_PINION = ideal_coupling(
    "rack_and_pinion",
    "ideal rack and pinion",
    value("radius", "m/rad", "velocity of the rack per speed of the pinion", ""),
    ("translational", "rack"),
    ("rotational", "pinion"),
)

_SET = ideal_coupling(
    "planetary_gear",
    "ideal planetary gear: a sun, a ring, and planets on a carrier",
    value("ratio", "1", "number of teeth of the ring over that of the sun", "positive"),
    ("rotational", "sun"),
    ("rotational", "ring"),
    reverses=True,
)

# In the frame of the carrier, the planets are a gear that reverses sun and ring.
PLANETARY_GEAR = replace(
    _SET,
    terminals=("sun", "carrier", "ring"),
    ports=tuple(replace(port, between=("carrier", port.port)) for port in _SET.ports),
)

#: Functions that build a component for translation or for rotation.
_FOR_BOTH = (_spring, _damper, _stop, _backlash, _friction, _force_source)

COMPONENTS = (
    MASS,
    *(make(_TRANSLATION) for make in _FOR_BOTH),
    _speed_source(_TRANSLATION, "velocity"),
    LEVER,
    INERTIA,
    *(make(_ROTATION) for make in _FOR_BOTH),
    _speed_source(_ROTATION, "speed"),
    *(SHAFT, IDEAL_GEAR, PLANETARY_GEAR, RACK_AND_PINION),
)


#: Rotational components, by the names of their translational counterparts.
_ALIKE = ("spring", "damper", "stop", "rigid_stop", "friction", "dry_friction", "lugre", "backlash")
_PAIRS = {
    **{f"rotational_{name}": f"translational_{name}" for name in _ALIKE},
    "rotational_inertia": "translational_mass",
    "torque_source": "force_source",
    "speed_source": "velocity_source",
    "ideal_gear": "lever",
    "dc_motor": "voice_coil",
    "hydraulic_machine": "hydraulic_cylinder",
}
_COUNTERPARTS = {**_PAIRS, **{along: about for about, along in _PAIRS.items()}}

#: Components of one-dimensional graphs between two nodes that may also act on a joint.
ON_JOINTS = {
    "spring": ("translational_spring", "rotational_spring"),
    "damper": ("translational_damper", "rotational_damper"),
    "force": ("force_source",),
    "line_force": ("force_source",),
    "torque": ("torque_source",),
    "rigid_body": ("translational_mass", "rotational_inertia"),
}


def counterpart_of(type: str) -> str:
    """Return the rotational type of a translational one, or vice versa; empty if none exists."""
    return _COUNTERPARTS.get(type, "")
