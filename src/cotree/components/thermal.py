"""Thermal components: across is temperature, [K]; heat flows from plus to minus inside."""

from __future__ import annotations

from typing import Any

from cotree.components.component import optional, value
from cotree.components.law import Law
from cotree.components.ports import across_source, resistance, scalar, storage, through_source
from cotree.components.terminal import Kind, Terminal, active_port

_DOMAIN = "thermal"

#: Stefan-Boltzmann constant, W/(m^2 K^4), exact since the SI of 2019.
STEFAN_BOLTZMANN = 5.670374419e-8

HEAT_CAPACITOR = storage(
    _DOMAIN,
    "heat_capacitor",
    "lumped heat capacity",
    value("capacity", "J/K", "heat stored per kelvin"),
)

RESISTOR = resistance(
    _DOMAIN,
    "thermal_resistor",
    "heat conduction",
    value("resistance", "K/W", "temperature difference per heat flow"),
)

# Newton's law of cooling.
CONVECTION = scalar(
    "convection",
    "heat transfer between a surface and a fluid",
    (
        value("coefficient", "W/(m^2 K)", "heat transfer coefficient"),
        value("area", "m^2", "area of the surface"),
    ),
    Terminal(
        _DOMAIN,
        Kind.DISSIPATOR,
        across=Law(lambda through, coefficient, area: through / (coefficient * area)),
        through=Law(lambda across, coefficient, area: coefficient * area * across),
    ),
)


def _radiation(potential_head: Any, potential_tail: Any, area: Any, emissivity: Any) -> Any:
    # Stefan-Boltzmann law: both absolute temperatures matter, not only their difference.
    fall = potential_head**4 - potential_tail**4
    return STEFAN_BOLTZMANN * area * emissivity * fall


RADIATION = scalar(
    "radiation",
    "radiation between grey surfaces",
    (
        value("area", "m^2", "area of the surface times its view factor"),
        optional("emissivity", "1", "effective emissivity of the two surfaces", 1.0, "positive"),
    ),
    # Not passive: the derivatives with respect to the two temperatures differ in magnitude.
    active_port(_DOMAIN, Kind.DISSIPATOR, through=Law(_radiation)),
)

# Temperatures are absolute, since radiation does not depend on their difference alone.
TEMPERATURE_SOURCE = across_source(
    _DOMAIN,
    "temperature_source",
    "prescribed temperature",
    value(
        "temperature",
        "K",
        "temperature of the plus node above the minus node; the ground is at 0 K",
        "",
    ),
)

HEAT_SOURCE = through_source(
    _DOMAIN,
    "heat_source",
    "prescribed heat flow",
    value("heat_flow", "W", "heat flow inside the source, positive from plus to minus", ""),
)

COMPONENTS = (HEAT_CAPACITOR, RESISTOR, CONVECTION, RADIATION, TEMPERATURE_SOURCE, HEAT_SOURCE)
