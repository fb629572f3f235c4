"""Electrical elements of two nodes: across is plus minus minus, through flows from plus to minus.

Sources, couplings and semiconductors have modules of their own.
"""

from __future__ import annotations

from typing import Any

from cotree.components.component import optional, value
from cotree.components.law import Law
from cotree.components.ports import content_storage, resistance, scalar, storage
from cotree.components.terminal import Kind, Terminal

_DOMAIN = "electrical"

RESISTOR = resistance(
    _DOMAIN,
    "resistor",
    "linear resistance",
    value("resistance", "ohm", "voltage per current", "nonzero"),
)

# i = C dv/dt even where C depends on states. Where charge is a function of the voltage, the
# nonlinear capacitor conserves it: i = dq/dt.
CAPACITOR = storage(
    _DOMAIN,
    "capacitor",
    "linear capacitance, or one that depends on states",
    value("capacitance", "F", "current per rate of voltage"),
)

INDUCTOR = storage(
    _DOMAIN,
    "inductor",
    "linear inductance, or one that depends on states",
    value("inductance", "H", "voltage per rate of current"),
    Kind.THROUGH_STORAGE,
)

NONLINEAR_CAPACITOR = content_storage(
    _DOMAIN,
    "nonlinear_capacitor",
    "charge by voltage",
    value("charge", "C", "an expression of NAME.v", ""),
)

NONLINEAR_INDUCTOR = content_storage(
    _DOMAIN,
    "nonlinear_inductor",
    "flux linkage by current",
    value("flux", "V s", "an expression of NAME.i", ""),
    Kind.THROUGH_STORAGE,
)


def _charge(port: str) -> Terminal:
    content, ends = Law.field(f"charge_{port}"), (port, "common")
    return Terminal(
        _DOMAIN, Kind.ACROSS_STORAGE, port, content=content, is_passive=False, between=ends
    )


# Each charge depends on both voltages; the derivatives of both are a matrix that need not be
# symmetric, so that neither port is passive.
THREE_TERMINAL_CAPACITOR = scalar(
    "three_terminal_capacitor",
    "two charges against a common terminal, each by both voltages",
    (
        value("charge_a", "C", "an expression of NAME.a.v and NAME.b.v", ""),
        value("charge_b", "C", "another one", ""),
    ),
    _charge("a"),
    _charge("b"),
    terminals=("a", "b", "common"),
)


def _contact(closed: Any, on_resistance: Any, off_resistance: Any) -> Any:
    """Give the resistance of a contact, interpolated logarithmically between open and closed."""
    import sympy

    # Resistances differ by many decades: between them their logarithms are interpolated, so that
    # slopes are moderate compared with the values.
    share = sympy.Piecewise((0, closed <= 0), (1, closed >= 1), (closed, True))
    return off_resistance * sympy.exp(share * sympy.log(on_resistance / off_resistance))


def _switch_voltage(through: Any, closed: Any, on_resistance: Any, off_resistance: Any) -> Any:
    return _contact(closed, on_resistance, off_resistance) * through


def _switch_current(across: Any, closed: Any, on_resistance: Any, off_resistance: Any) -> Any:
    return across / _contact(closed, on_resistance, off_resistance)


SWITCH = scalar(
    "switch",
    "resistance between open and closed",
    (
        value("closed", "1", "open up to 0, closed from 1 on, between them in between", ""),
        optional("on_resistance", "ohm", "where it is closed", 1e-3, "positive"),
        optional("off_resistance", "ohm", "where it is open", 1e9, "positive"),
    ),
    Terminal(_DOMAIN, Kind.DISSIPATOR, across=Law(_switch_voltage), through=Law(_switch_current)),
)

COMPONENTS = (
    *(RESISTOR, CAPACITOR, NONLINEAR_CAPACITOR, THREE_TERMINAL_CAPACITOR),
    *(INDUCTOR, NONLINEAR_INDUCTOR, SWITCH),
)
