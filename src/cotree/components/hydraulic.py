"""Hydraulic components: across is pressure at plus minus that at minus, through flow to minus."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from cotree.components.component import optional, value
from cotree.components.law import Law, argument, magnitude, sqrt
from cotree.components.ports import across_source, resistance, scalar, storage, through_source
from cotree.components.terminal import Kind, Terminal, active_port

if TYPE_CHECKING:
    from cotree.components.component import Adapted, Given, Nodes

_DOMAIN = "hydraulic"

# Default: water. Oils have 850 to 900 kg/m^3.
_DENSITY = optional("density", "kg/m^3", "density of the liquid", 1000.0, "positive")

RESISTOR = resistance(
    _DOMAIN,
    "hydraulic_resistor",
    "linear resistance to laminar flow",
    value("resistance", "Pa s/m^3", "pressure drop per flow", "nonzero"),
)


def _root(pressure: Any, transition: Any) -> Any:
    """Return the signed square root of the pressure, replaced by a polynomial near zero.

    Slope and curvature are continuous, and finite at zero. Beyond the transition, ``u`` is 1 or -1
    and the polynomial in u^2 is 1, so that the square root remains.
    """
    size = magnitude(pressure)
    size = (size + transition + magnitude(size - transition)) / 2  # smooth maximum of both
    # At u = 1, the polynomial matches the root: value 1, slope 1/2, second derivative -1/4.
    u = pressure / size
    return sqrt(size) * u * (45 - 18 * u**2 + 5 * u**4) / 32


# Torricelli: Q = Cd A sqrt(2 dp / rho). The exact root has an infinite slope at dp = 0.
def _orifice(across: Any, area: Any, coefficient: Any, density: Any, transition: Any) -> Any:
    return coefficient * area * sqrt(2 / density) * _root(across, transition)


def _valve(
    across: Any, area: Any, opening: Any, coefficient: Any, density: Any, transition: Any
) -> Any:
    return opening * _orifice(across, area, coefficient, density, transition)


# A sharp-edged opening contracts the jet to about 0.62 of its area.
_COEFFICIENT = optional("coefficient", "1", "discharge coefficient", 0.62, "positive")
_TRANSITION = optional(
    "transition", "Pa", "pressure drop below which the law is smoothed", 1.0, "positive"
)

ORIFICE = scalar(
    "orifice",
    "turbulent flow through a fixed opening",
    (value("area", "m^2", "area of the opening"), _COEFFICIENT, _DENSITY, _TRANSITION),
    Terminal(_DOMAIN, Kind.DISSIPATOR, through=Law(_orifice)),
)

VALVE = scalar(
    "valve",
    "orifice with a variable opening",
    (
        value("area", "m^2", "area of the fully open valve"),
        value("opening", "1", "open fraction of the area, 0 to 1", "nonnegative"),
        _COEFFICIENT,
        _DENSITY,
        _TRANSITION,
    ),
    # A closed valve does not conduct: the equations are only positive semidefinite.
    active_port(_DOMAIN, Kind.DISSIPATOR, through=Law(_valve)),
)

TANK = scalar(
    "tank",
    "open tank with vertical walls; the pressure is that at its bottom",
    (
        value("area", "m^2", "area of the liquid's surface"),
        _DENSITY,
        optional("gravity", "m/s^2", "gravitational acceleration", 9.81, "positive"),
    ),
    # p = rho g h and A dh/dt = Q lead to Q = A / (rho g) dp/dt.
    Terminal(
        _DOMAIN,
        Kind.ACROSS_STORAGE,
        storage=Law(lambda area, density, gravity: area / (density * gravity)),
    ),
)

ACCUMULATOR = storage(
    _DOMAIN,
    "accumulator",
    "elastic volume, such as a gas-loaded accumulator",
    value("capacity", "m^3/Pa", "volume stored per pressure"),
)

INERTANCE = storage(
    _DOMAIN,
    "inertance",
    "inertia of the liquid in a pipe",
    value("inertance", "Pa s^2/m^3", "pressure per rate of flow: density times length over area"),
    Kind.THROUGH_STORAGE,
)

_PIPE = Terminal(
    _DOMAIN,
    Kind.THROUGH_STORAGE,
    across=Law(lambda through, resistance: resistance * through),
    storage=argument("inertance"),
    between=("plus", "minus"),
)
# An elastic line as a pi section: inertance and friction between two equal capacities.
_HALF = Terminal(_DOMAIN, Kind.ACROSS_STORAGE, storage=Law(lambda capacity: capacity / 2))


def _fit_pipe(edge: str, nodes: Nodes, fields: Given) -> Adapted:
    """Connect half the capacity of an elastic pipe to each end that is not the ground."""
    if "capacity" not in fields:
        return PIPE, nodes, fields
    # A capacity at the ground would be a self-loop without effect.
    ends = [end for end, node in zip(PIPE.terminals, nodes, strict=False) if node != "ground"]
    halves = (replace(_HALF, port=end, between=(end, "ground")) for end in ends)
    return replace(PIPE, ports=(*PIPE.ports, *halves)), nodes, fields


PIPE = scalar(
    "pipe",
    "pipe with inertia and friction, elastic if it has a capacity",
    (
        optional("resistance", "Pa s/m^3", "pressure drop per flow", 0.0, "nonnegative"),
        value(
            "inertance", "Pa s^2/m^3", "pressure per rate of flow: density times length over area"
        ),
        optional(
            "capacity",
            "m^3/Pa",
            "volume stored per pressure, half of it at each end",
            None,
            "positive",
        ),
    ),
    _PIPE,
    terminals=("plus", "minus"),
    adapt=_fit_pipe,
)


def _pump(across: Any, pressure: Any, resistance: Any, quadratic: Any) -> Any:
    """Return the flow -q on the curve ``across = pressure - resistance q - quadratic q |q|``."""
    # This form of the root avoids cancellation, and is also valid for quadratic = 0.
    lack = pressure - across
    root = sqrt(resistance**2 + 4 * quadratic * magnitude(lack))
    return -2 * lack / (resistance + root)


def _pump_rise(through: Any, pressure: Any, resistance: Any, quadratic: Any) -> Any:
    return pressure + resistance * through + quadratic * through * magnitude(through)


PUMP = scalar(
    "pump",
    "pump with a quadratic curve; it raises the pressure from minus to plus",
    (
        value("pressure", "Pa", "pressure rise at zero flow", ""),
        value("resistance", "Pa s/m^3", "linear coefficient of the pressure drop"),
        optional(
            "quadratic",
            "Pa s^2/m^6",
            "quadratic coefficient of the pressure drop",
            0.0,
            "nonnegative",
        ),
    ),
    Terminal(_DOMAIN, Kind.DISSIPATOR, across=Law(_pump_rise), through=Law(_pump)),
)

PRESSURE_SOURCE = across_source(
    _DOMAIN,
    "pressure_source",
    "prescribed pressure",
    value("pressure", "Pa", "pressure of the plus node above the minus node", ""),
)

FLOW_SOURCE = through_source(
    _DOMAIN,
    "flow_source",
    "prescribed volume flow",
    value("flow", "m^3/s", "volume flow inside the source, positive from plus to minus", ""),
)

COMPONENTS = (
    *(RESISTOR, ORIFICE, VALVE, TANK, ACCUMULATOR, INERTANCE, PIPE, PUMP),
    *(PRESSURE_SOURCE, FLOW_SOURCE),
)
