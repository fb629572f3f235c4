"""Dry friction with sticking and sliding: in linear guides, clutches and gears.

The mode of an edge (:mod:`cotree.hybrid.unilateral`) is 0 while the edge sticks, 1 or -1 while it
slides forwards or backwards, and 2 while it is disengaged.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from cotree.components.component import Component, Field, optional, value
from cotree.components.law import ZERO, Law, argument, exp, larger, magnitude, smaller
from cotree.components.ports import ideal_coupling, scalar
from cotree.components.terminal import Friction, Integral, Kind, Terminal, active_port
from cotree.domains import DOMAINS
from cotree.errors import SceneError

if TYPE_CHECKING:
    from cotree.components.component import Adapted, Given, Nodes


def _is_positive(given: object) -> bool:
    """Return whether a field is a positive number, which no parameter can change."""
    return isinstance(given, (int, float)) and not isinstance(given, bool) and given > 0.0


@dataclass(frozen=True)
class _DryFriction:
    """A component with dry friction: laws of the sliding force and of the force at rest."""

    domain: str  # domain of the port
    force: Law  # dry friction force while sliding
    raised: Law  # maximum force at rest, if the scene gives the field ``peak``
    peak: str  # name of the field with the maximum force at rest
    #: Fields that multiply the force; if one is zero, friction is disengaged. The last may be a
    #: table over speed.
    factors: tuple[str, ...]
    is_one_way: bool = False
    backward: str = ""  # field with the force of backward sliding, if this may differ

    def port(self, given: Given) -> Terminal:
        """Build the terminal equation from the given fields."""

        def pressed(force: Law) -> Any:
            """Clip the force of a one-way clutch at zero, since the clutch cannot disengage."""
            return force if is_engaged or not self.is_one_way else larger(force, 0)

        is_engaged = all(_is_positive(given.get(name)) for name in self.factors)
        across, sliding = argument("across"), pressed(self.force)
        back = argument(self.backward) if self.backward in given else sliding
        # A scene gives either the force at rest or the force of backward sliding.
        upper, lower = (pressed(self.raised),) * 2 if self.peak in given else (sliding, back)
        forward, backward = sliding, back
        if "stribeck_speed" in given:
            # Stribeck curve with exponent two (L. C. Bo, D. Pavelescu, Wear 82 (1982) 277).
            share = exp(-((across / argument("stribeck_speed")) ** 2))
            forward += (upper - sliding) * share
            backward += (lower - back) * share
        viscous = argument("damping") * across if "damping" in given else ZERO
        friction = Friction(
            forward=forward + viscous,
            backward=viscous - backward,
            upper=upper,
            lower=None if self.is_one_way else -lower,
            # A one-way clutch locks backwards even without a normal force.
            grip=None if is_engaged or self.is_one_way else sliding,
        )
        return Terminal(self.domain, Kind.FRICTION, friction=friction)

    def component(self, name: str, doc: str, fields: tuple[Field, ...]) -> Component:
        """Build the component type; its laws adapt to the fields that a scene gives."""

        def adapt(edge: str, nodes: Nodes, given: Given) -> Adapted:
            rest = dict(given)
            if self.backward in given and self.peak in given:
                raise SceneError(
                    f"edge '{edge}' has {self.backward} and {self.peak}, which is the same in both "
                    f"directions: remove one of them"
                )
            if isinstance(rest.get(self.factors[-1]), (list, tuple)):
                speed = f"{edge}.{DOMAINS[self.domain].across_symbol}"
                rest[self.factors[-1]] = _curve(edge, self.factors[-1], rest, speed)
            return replace(made, ports=(self.port(rest),)), nodes, rest

        made = scalar(name, doc, fields, self.port({}))
        return replace(made, adapt=adapt)


def _curve(edge: str, field: str, given: Given, speed: str) -> dict[str, Any]:
    """Build a lookup table over speed, with linear interpolation and constant extrapolation."""
    rows = given[field]
    whose = f"{field} of edge '{edge}'"
    if not rows or not all(isinstance(row, (list, tuple)) and len(row) == 2 for row in rows):
        raise SceneError(f"{whose} must be a value, or a list of pairs: a speed and a value each")
    speeds = [row[0] for row in rows]
    if not all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in speeds):
        raise SceneError(f"the speeds in {whose} must be numbers")
    if speeds[0] != 0 or any(not b > a for a, b in pairwise(speeds)):
        raise SceneError(f"the speeds in {whose} must begin with 0 and ascend")
    return {"of": f"abs({speed})", "x": speeds, "y": [row[1] for row in rows]}


def _stribeck(unit: str) -> Field:
    doc = "Stribeck speed, over which friction falls from its peak; at once if omitted"
    return optional("stribeck_speed", unit, doc, None, "positive")


def _dry(domain: str, force: str, force_unit: str, speed_unit: str) -> Component:
    dry = _DryFriction(
        domain, argument(force), argument("breakaway"), "breakaway", (force,), backward="backward"
    )
    rest = f"largest {force} at rest; by default `{force}`"
    backward = f"{force} of dry friction in backward sliding; by default `{force}`"
    viscous = "coefficient of viscous friction in sliding"
    slope_unit = f"{force_unit} s/{speed_unit.removesuffix('/s')}"
    fields: tuple[Field, ...] = (
        value(force, force_unit, f"{force} of dry friction in sliding", "nonnegative"),
        optional("breakaway", force_unit, rest, None, "nonnegative"),
        optional("backward", force_unit, backward, None, "nonnegative"),
        _stribeck(speed_unit),
        optional("damping", slope_unit, viscous, None, "nonnegative"),
    )
    if domain == "translational":
        # Friction at the surface of a rod also brakes its rotation; see ``scene.joint_friction``.
        fields += (Field("radius", "m", _RADIUS, sign="positive"),)
    return dry.component(f"{domain}_dry_friction", "dry friction with sticking and sliding", fields)


_RADIUS = "radius at which a cylindrical joint rubs; its rotation then shares the limit"

_PRESSED = _DryFriction(
    "rotational",
    argument("radius") * argument("friction") * argument("normal_force"),
    argument("peak") * argument("radius") * argument("friction") * argument("normal_force"),
    "peak",
    ("normal_force", "friction"),
)

_BRAKED = replace(
    _PRESSED,
    domain="translational",
    force=argument("friction") * argument("normal_force"),
    raised=argument("peak") * argument("friction") * argument("normal_force"),
)


def _pressed(speed_unit: str, torque: bool) -> tuple[Field, ...]:
    normal = "force that presses the faces together; no friction if negative"
    radius = value("radius", "m", "mean radius times the number of friction interfaces")
    peak = "ratio of static to sliding friction; by default 1"
    return (
        value("normal_force", "N", normal, ""),
        value("friction", "1", "coefficient of sliding friction", "nonnegative"),
        *((radius,) if torque else ()),
        optional("peak", "1", peak, None, "positive"),
        _stribeck(speed_unit),
    )


def _bristles(domain: str, force: str, force_unit: str, length: str) -> Component:
    """Build a friction component with the LuGre model of elastic bristles.

    The law is that of C. Canudas, H. Olsson, K. J. Astrom and P. Lischinsky, IEEE Trans. Autom.
    Control 40 (1995) 419.
    """
    v, sliding, most = argument("across"), argument(force), argument("breakaway")
    level = sliding + (most - sliding) * exp(-((v / argument("stribeck_speed")) ** 2))
    rate = v - argument("stiffness") * magnitude(v) * argument("stretch") / level
    bent = argument("stiffness") * argument("stretch") + argument("damping") * rate
    speed_unit, slope_unit = f"{length}/s", f"{force_unit} s/{length}"
    through, bending = bent + argument("viscous") * v, Integral("z", length, rate)
    port = active_port(domain, Kind.SPRING, through=through, integral=bending)
    falls = "Stribeck speed, over which friction falls from its peak"
    fields = (
        value(force, force_unit, f"{force} of dry friction in steady sliding", "positive"),
        value("breakaway", force_unit, f"largest {force} at rest", "positive"),
        value("stribeck_speed", speed_unit, falls, "positive"),
        value("stiffness", f"{force_unit}/{length}", "stiffness of the bristles"),
        optional("damping", slope_unit, "damping of the bristles", 0.0, "nonnegative"),
        optional("viscous", slope_unit, "coefficient of viscous friction", 0.0, "nonnegative"),
    )
    return scalar(f"{domain}_lugre", "LuGre friction: bristles that bend and slip", fields, port)


def _gear_with_losses(given: Given) -> Component:
    """Build a gear with friction in teeth and bearings, from the fields that a scene gives.

    Let t be the transmitted torque at the input, T the bearing torque, and e and f the
    efficiencies. The tooth loss is (t (1 - e) + T) / e if the input drives, and (1 - f) |t| + f T
    if the output drives (C. Pelchen, C. Schweiger, M. Otter, Modeling and Simulating the Efficiency
    of Gearboxes, Modelica Conference 2002). The expression that applies is always the larger one.
    """
    passed, e = argument("through_input"), argument("efficiency")
    f = argument("back_efficiency") if "back_efficiency" in given else e
    bearing = argument("torque") if "torque" in given else ZERO

    def drives(way: int) -> Law:
        return (passed * (1 - e) + way * bearing) / e

    def driven(way: int) -> Law:
        return passed * (f - 1) + way * f * bearing

    def sliding(way: int) -> Law:
        own = (1 + way * argument("side")) / 2
        return own * drives(way) + (1 - own) * driven(way)

    def limit(way: int) -> Any:
        # The input drives if its torque has the same sign as the speed.
        return (larger if way > 0 else smaller)(drives(way), driven(way))

    load = passed + argument("through")
    friction = Friction(sliding(1), sliding(-1), upper=limit(1), lower=limit(-1), load=load)
    ideal = ideal_coupling("", "", _RATIO, ("rotational", "input"), ("rotational", "output"))
    ports = tuple(replace(p, between=(p.port, "ground")) for p in ideal.ports)
    ends = ("input", "ground")
    teeth = active_port("rotational", Kind.FRICTION, "teeth", between=ends, friction=friction)
    return replace(_GEAR, ports=(*ports, teeth))


def _adapt_gear(edge: str, nodes: Nodes, given: Given) -> Adapted:
    return _gear_with_losses(given), nodes, given


_RATIO = value("ratio", "1", "speed of the input per speed of the output; may be negative", "")

_GEAR = scalar(
    "lossy_gear",
    "gear with losses in teeth and bearings; it may be self-locking",
    (
        _RATIO,
        value("efficiency", "1", "efficiency of the teeth if the input drives", "positive"),
        optional(
            "back_efficiency",
            "1",
            "efficiency if the output drives; by default `efficiency`",
            None,
            "positive",
        ),
        optional(
            "torque",
            "N m",
            "friction torque of the bearings, referred to the input",
            None,
            "nonnegative",
        ),
    ),
    terminals=("input", "output"),
    adapt=_adapt_gear,
)


COMPONENTS = (
    _gear_with_losses({}),
    _dry("translational", "force", "N", "m/s"),
    _dry("rotational", "torque", "N m", "rad/s"),
    _bristles("translational", "force", "N", "m"),
    _bristles("rotational", "torque", "N m", "rad"),
    _PRESSED.component("clutch", "friction clutch between two shafts", _pressed("rad/s", True)),
    _PRESSED.component("brake", "brake on a shaft", _pressed("rad/s", True)),
    _BRAKED.component("translational_brake", "brake on a mass", _pressed("m/s", False)),
    replace(_PRESSED, is_one_way=True).component(
        "one_way_clutch",
        "overrunning clutch: turns freely in one direction, locks in the other",
        _pressed("rad/s", True),
    ),
)
