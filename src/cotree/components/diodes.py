"""The diode: Shockley's law with optional breakdown, series resistance and charge.

An optional term is present where the scene gives its fields: a diode without charge has no state.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

from cotree.components.component import optional, value
from cotree.components.junctions import (
    FORWARD_SHARE,
    depletion_capacity,
    depletion_fields,
    junction_current,
    split_extras,
    symbol,
)
from cotree.components.law import Law
from cotree.components.ports import resistive, scalar
from cotree.components.terminal import Kind, PortMeasure, Terminal

if TYPE_CHECKING:
    from cotree.components.component import Adapted, Component, Given, Nodes

_DOMAIN = "electrical"

_DOC = "Shockley diode: I (exp(v / V) - 1)"
_CAPACITANCE, *_SHAPE = depletion_fields("junction", 1.0, 0.5)

#: Fields that add a term to the laws, or a port, where a scene gives them.
_EXTRAS = (
    optional("leakage", "S", "beside the junction", 0.0, "nonnegative"),
    optional("series_resistance", "ohm", "of the material and its contacts", 0.0, "nonnegative"),
    optional("breakdown_voltage", "V", "backwards; none where left out", None, "positive"),
    _CAPACITANCE,
    optional("transit_time", "s", "charge stored per current", 0.0, "nonnegative"),
)

_FIELDS = (
    value("saturation_current", "A", "I, what flows backwards"),
    optional("thermal_voltage", "V", "k T / e, times an ideality factor", 0.02585, "positive"),
    *_EXTRAS,
    optional("breakdown_current", "A", "what flows at that voltage", 1e-3, "positive"),
    *_SHAPE,
    FORWARD_SHARE,
)


@lru_cache(maxsize=64)
def _diode(has: frozenset[str]) -> Component:
    """Make a diode with the terms of some fields."""
    if "series_resistance" not in has:
        return scalar("diode", _DOC, _FIELDS, _junction(has, "", ("", "")))
    # A series resistance needs an inner node between two ports.
    return scalar(
        "diode",
        _DOC,
        _FIELDS,
        _junction(has, "junction", ("inner", "cathode")),
        resistive(_DOMAIN, "series_resistance", "series", ("anode", "inner")),
        terminals=("anode", "cathode"),
        measures=(
            PortMeasure("v", "V", ((1, "across", "series"), (1, "across", "junction"))),
            PortMeasure("i", "A", ((1, "through", "series"),)),
        ),
    )


def _junction(has: frozenset[str], name: str, between: tuple[str, str]) -> Terminal:
    through, storage = Law.of(_current(has)), None
    # With a charge the voltage is a state, and the static current is added to C dv/dt.
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


def _adapted(edge: str, nodes: Nodes, given: Given) -> Adapted:
    """Keep the terms whose fields the scene gives."""
    has, rest = split_extras(_EXTRAS, given)
    return (_diode(has) if has else DIODE), nodes, rest


# Its law is not formed before something asks for it: SymPy takes long to import.
DIODE = scalar(
    "diode",
    _DOC,
    _FIELDS,
    Terminal(
        _DOMAIN,
        Kind.DISSIPATOR,
        through=Law.taking(("across", "saturation_current", "thermal_voltage"), junction_current),
    ),
    adapt=_adapted,
)
