"""The diode: Shockley's law with optional breakdown, series resistance and charge.

An optional term is present where the scene gives its fields: a diode without charge has no state.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

from cotree.components.component import Component, Role
from cotree.components.junctions import (
    FORWARD_SHARE,
    depletion_capacity,
    depletion_fields,
    extras,
    junction_current,
    symbol,
    without_absent,
)
from cotree.components.law import Law
from cotree.components.ports import optional, resistive, value
from cotree.components.terminal import Kind, PortMeasure, Terminal

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

_DOMAIN = "electrical"

#: What adds a term to the laws, or a port.
_EXTRAS = (
    optional("leakage", "S", "beside the junction", 0.0, "nonnegative"),
    optional("series_resistance", "ohm", "of the material and its contacts", 0.0, "nonnegative"),
    optional("breakdown_voltage", "V", "backwards; none where left out", None, "positive"),
    *depletion_fields("junction", 1.0, 0.5)[:1],
    optional("transit_time", "s", "charge stored per current", 0.0, "nonnegative"),
)

_FIELDS = (
    value("saturation_current", "A", "I, what flows backwards"),
    optional("thermal_voltage", "V", "k T / e, times an ideality factor", 0.02585, "positive"),
    *_EXTRAS,
    optional("breakdown_current", "A", "what flows at that voltage", 1e-3, "positive"),
    *depletion_fields("junction", 1.0, 0.5)[1:],
    FORWARD_SHARE,
)


@lru_cache(maxsize=64)
def _diode(has: frozenset[str]) -> Component:
    """Make a diode with the terms of some fields."""
    # A series resistance needs an inner node between two ports.
    is_split = "series_resistance" in has
    between = ("inner", "cathode") if is_split else ("", "")
    junction = _junction(has, "junction" if is_split else "", between)
    doc = "Shockley diode: I (exp(v / V) - 1)"
    if not is_split:
        return Component(
            "diode", Role.NETWORK, doc, fields=_FIELDS, domains=(_DOMAIN,), ports=(junction,)
        )
    series = resistive(_DOMAIN, "series_resistance", "series", ("anode", "inner"))
    return Component(
        "diode",
        Role.NETWORK,
        doc,
        fields=_FIELDS,
        domains=(_DOMAIN,),
        ports=(junction, series),
        terminals=("anode", "cathode"),
        measures=(
            PortMeasure("v", "V", ((1, "across", "series"), (1, "across", "junction"))),
            PortMeasure("i", "A", ((1, "through", "series"),)),
        ),
    )


def _junction(has: frozenset[str], name: str, between: tuple[str, str]) -> Terminal:
    through, storage = Law.of(_current(has)), None
    if has & {"junction_capacitance", "transit_time"}:
        storage = Law.of(_capacity(has))
    kind = Kind.DISSIPATOR if storage is None else Kind.ACROSS_STORAGE
    return Terminal(_DOMAIN, kind, name, through=through, storage=storage, between=between)


def _current(has: frozenset[str]) -> Any:
    import sympy

    v, thermal = symbol("across"), symbol("thermal_voltage")
    current = junction_current(v, symbol("saturation_current"), thermal)
    if "leakage" in has:
        current += symbol("leakage") * v
    if "breakdown_voltage" in has:
        beyond = v + symbol("breakdown_voltage")
        # Avalanche current, an exponential of the voltage beyond breakdown.
        current -= symbol("breakdown_current") * sympy.exp(-beyond / thermal)
    return current


def _capacity(has: frozenset[str]) -> Any:
    import sympy

    v, thermal = symbol("across"), symbol("thermal_voltage")
    capacity = sympy.Integer(0)
    if "junction_capacitance" in has:
        capacity += depletion_capacity(v, "junction")
    if "transit_time" in has:
        # Diffusion charge is the transit time times the current.
        slope = sympy.diff(junction_current(v, symbol("saturation_current"), thermal), v)
        capacity += symbol("transit_time") * slope
    return capacity


def _adapted(
    edge: str, nodes: Sequence[object], given: Mapping[str, Any]
) -> tuple[Component, Sequence[object], Mapping[str, Any]]:
    """Keep the terms whose fields the scene gives."""
    has = extras(_EXTRAS, given)
    rest = without_absent(_EXTRAS, given)
    return (_diode(has) if has else DIODE), nodes, rest


DIODE = Component(
    "diode",
    Role.NETWORK,
    "Shockley diode: I (exp(v / V) - 1)",
    fields=_FIELDS,
    domains=(_DOMAIN,),
    ports=(
        Terminal(
            _DOMAIN,
            Kind.DISSIPATOR,
            through=Law.taking(
                ("across", "saturation_current", "thermal_voltage"), junction_current
            ),
        ),
    ),
    adapt=_adapted,
)
