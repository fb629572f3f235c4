"""Electrical components: across is plus minus minus, through flows from plus to minus inside."""

from __future__ import annotations

from typing import Any

from cotree.components.component import Component, Field, Role
from cotree.components.law import Law
from cotree.components.terminal import Kind, Terminal

_DOMAIN = "electrical"


def _one_port(name: str, doc: str, fields: tuple[Field, ...], terminal: Terminal) -> Component:
    return Component(
        name, Role.NETWORK, doc, fields=fields, domains=(terminal.domain,), ports=(terminal,)
    )


def value(name: str, unit: str, doc: str, sign: str = "positive") -> Field:
    """Make the field of a law: an expression of anything, of a sign where it is constant."""
    return Field(name, unit, doc, required=True, constant=False, sign=sign)


RESISTOR = _one_port(
    "resistor",
    "linear resistance",
    (value("resistance", "ohm", "voltage per current"),),
    Terminal(
        _DOMAIN,
        Kind.DISSIPATOR,
        across=Law(lambda through, resistance: resistance * through),
        through=Law(lambda across, resistance: across / resistance),
    ),
)

CAPACITOR = _one_port(
    "capacitor",
    "linear capacitance, or one that depends on states",
    (value("capacitance", "F", "current per rate of voltage"),),
    Terminal(_DOMAIN, Kind.ACROSS_STORAGE, storage=Law(lambda capacitance: capacitance)),
)

INDUCTOR = _one_port(
    "inductor",
    "linear inductance, or one that depends on states",
    (value("inductance", "H", "voltage per rate of current"),),
    Terminal(_DOMAIN, Kind.THROUGH_STORAGE, storage=Law(lambda inductance: inductance)),
)

VOLTAGE_SOURCE = _one_port(
    "voltage_source",
    "given voltage",
    (value("voltage", "V", "plus minus minus", sign=""),),
    Terminal(_DOMAIN, Kind.ACROSS_SOURCE, across=Law(lambda voltage: voltage)),
)

CURRENT_SOURCE = _one_port(
    "current_source",
    "given current, from plus to minus inside",
    (value("current", "A", "from plus to minus inside", sign=""),),
    Terminal(_DOMAIN, Kind.THROUGH_SOURCE, through=Law(lambda current: current)),
)


def _diode(across: Any, saturation_current: Any, thermal_voltage: Any) -> Any:
    import sympy

    return saturation_current * (sympy.exp(across / thermal_voltage) - 1)


DIODE = _one_port(
    "diode",
    "Shockley diode: I (exp(v / V) - 1)",
    (
        value("saturation_current", "A", "I"),
        Field("thermal_voltage", "V", "V", default=0.02585, constant=False, sign="positive"),
    ),
    Terminal(_DOMAIN, Kind.DISSIPATOR, through=Law(_diode)),
)

TRANSFORMER = Component(
    "transformer",
    Role.NETWORK,
    "ideal transformer: voltage of the primary is ratio times that of the secondary",
    fields=(value("ratio", "1", "turns of the primary for each of the secondary", sign=""),),
    domains=(_DOMAIN,),
    ports=(
        Terminal(
            _DOMAIN,
            Kind.COUPLED,
            "primary",
            across=Law(lambda across_secondary, ratio: ratio * across_secondary),
            through=Law(lambda through_secondary, ratio: -through_secondary / ratio),
        ),
        Terminal(
            _DOMAIN,
            Kind.COUPLED,
            "secondary",
            across=Law(lambda across_primary, ratio: across_primary / ratio),
            through=Law(lambda through_primary, ratio: -ratio * through_primary),
        ),
    ),
)

COMPONENTS = (
    RESISTOR,
    CAPACITOR,
    INDUCTOR,
    VOLTAGE_SOURCE,
    CURRENT_SOURCE,
    DIODE,
    TRANSFORMER,
)
