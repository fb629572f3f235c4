"""Semiconductor junctions and the diode, with charges and capacitances.

Capacitances are C = dQ/dv, so that a capacitive current is the rate of a charge. Optional terms
exist only if the scene gives their fields; without them, a diode stores no charge and has no state.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

from cotree.components.component import Adapted, Component, Field, Given, Nodes, optional, value
from cotree.components.law import Law, argument, exp, larger
from cotree.components.ports import resistive, scalar
from cotree.components.terminal import Kind, PortMeasure, Terminal

if TYPE_CHECKING:
    from collections.abc import Mapping


def junction_current(voltage: Any, saturation_current: Any, thermal_voltage: Any) -> Any:
    """Return I (exp(v / V) - 1): W. Shockley, Bell Syst. Tech. J. 28 (1949) 435."""
    # The reverse current saturates at -I. The thermal voltage V is k T / e times ideality factor.
    return saturation_current * (exp(voltage / thermal_voltage) - 1)


def depletion_capacity(voltage: Any, prefix: str, share: Any = None) -> Any:
    """Return the capacitance C (1 - v/V)^-m, continued by its tangent for v > F V.

    C, V and m are the fields ``PREFIX_capacitance``, ``_potential`` and ``_grading``. F is
    ``share``, by default ``forward_share``; it limits the base of the power to at least 1 - F.
    """
    names = ("capacitance", "potential", "grading")
    capacitance, potential, grading = (argument(f"{prefix}_{name}") for name in names)
    share = argument("forward_share") if share is None else share
    # ``over`` = max(v/V - F, 0) limits the base, and is the argument of the tangent.
    over = larger(voltage / potential - share, 0)
    base = 1 - voltage / potential + over
    # Value and slope are continuous where the tangent begins.
    return capacitance * base ** (-grading) * (1 + grading * over / (1 - share))


def depletion_fields(prefix: str, potential: float, grading: float) -> tuple[Field, ...]:
    """Build the fields of a depletion capacitance: default built-in potential, [V], and grading."""
    capacitance = "depletion capacitance at zero voltage"
    built_in = "built-in potential of the junction"
    exponent = "grading exponent: 0.5 for an abrupt junction, 0.33 for a linear one"
    return (
        optional(f"{prefix}_capacitance", "F", capacitance, 0.0, "nonnegative"),
        optional(f"{prefix}_potential", "V", built_in, potential, "positive"),
        optional(f"{prefix}_grading", "1", exponent, grading, "nonnegative"),
    )


FORWARD_SHARE = optional(
    "forward_share",
    "1",
    "fraction of the built-in potential above which capacitance is linear",
    0.5,
)


def split_extras(
    fields: tuple[Field, ...], given: Mapping[str, Any]
) -> tuple[frozenset[str], dict[str, Any]]:
    """Return the names in ``fields`` that add a term, and the given values without zero terms."""
    names = {row.name for row in fields}
    has = frozenset(name for name in names if not is_absent(given.get(name)))
    return has, {
        key: item
        for key, item in given.items()
        if item is not None and (key in has or key not in names)
    }


def is_absent(value: Any) -> bool:
    """Return whether a field is not given, or given as the number zero."""
    return value is None or (isinstance(value, (int, float)) and value == 0)


_DOMAIN = "electrical"

_DOC = "Shockley diode with the current I (exp(v / V) - 1)"
_CAPACITANCE, *_SHAPE = depletion_fields("junction", 1.0, 0.5)

#: Optional fields, each of which adds a port or a term of a law.
_EXTRAS = (
    optional("leakage", "S", "conductance parallel to the junction", 0.0, "nonnegative"),
    optional(
        "series_resistance", "ohm", "resistance in series with the junction", 0.0, "nonnegative"
    ),
    optional(
        "breakdown_voltage",
        "V",
        "reverse breakdown voltage; no breakdown if omitted",
        None,
        "positive",
    ),
    _CAPACITANCE,
    optional("transit_time", "s", "transit time: diffusion charge per current", 0.0, "nonnegative"),
)

_FIELDS = (
    value("saturation_current", "A", "saturation current I"),
    optional(
        "thermal_voltage",
        "V",
        "thermal voltage k T / e times the ideality factor",
        0.02585,
        "positive",
    ),
    *_EXTRAS,
    optional(
        "breakdown_current", "A", "reverse current at the breakdown voltage", 1e-3, "positive"
    ),
    *_SHAPE,
    FORWARD_SHARE,
)


@lru_cache(maxsize=64)
def _diode(has: frozenset[str]) -> Component:
    if "series_resistance" not in has:
        return scalar("diode", _DOC, _FIELDS, _junction(has, "", ("", "")))
    # With a series resistance, an inner node lies between two ports.
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
    through, storage = _current(has), None
    # If the junction stores charge, its voltage is a state; the static current adds to C dv/dt.
    if has & {"junction_capacitance", "transit_time"}:
        storage = _capacity(has)
    kind = Kind.DISSIPATOR if storage is None else Kind.ACROSS_STORAGE
    return Terminal(_DOMAIN, kind, name, through=through, storage=storage, between=between)


def _current(has: frozenset[str]) -> Any:
    v, thermal = argument("across"), argument("thermal_voltage")
    current = junction_current(v, argument("saturation_current"), thermal)
    if "leakage" in has:
        current += argument("leakage") * v
    if "breakdown_voltage" in has:
        beyond = v + argument("breakdown_voltage")
        # Avalanche current beyond the breakdown voltage; it is exponential in the voltage.
        current -= argument("breakdown_current") * exp(-beyond / thermal)
    return current


def _capacity(has: frozenset[str]) -> Any:
    v, thermal = argument("across"), argument("thermal_voltage")
    capacity: Any = 0
    if "junction_capacitance" in has:
        capacity += depletion_capacity(v, "junction")
    if "transit_time" in has:
        # The diffusion charge is the transit time times the current.
        slope = junction_current(v, argument("saturation_current"), thermal).slope("across")
        capacity += argument("transit_time") * slope
    return capacity


def _adapted(edge: str, nodes: Nodes, given: Given) -> Adapted:
    has, rest = split_extras(_EXTRAS, given)
    return (_diode(has) if has else DIODE), nodes, rest


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
