"""Electrical components of two ports: transformers, gyrators, controlled sources, op-amps."""

from __future__ import annotations

from dataclasses import replace

from cotree.components.component import Component, value
from cotree.components.law import Law
from cotree.components.ports import ideal_coupling, ideal_gyration, scalar
from cotree.components.terminal import Kind, Terminal

_DOMAIN = "electrical"

TRANSFORMER = ideal_coupling(
    "transformer",
    "ideal transformer: voltage of the primary is ratio times that of the secondary",
    value("ratio", "1", "turns of the primary for each of the secondary", ""),
    (_DOMAIN, "primary"),
    (_DOMAIN, "secondary"),
)


GYRATOR = ideal_gyration(
    "gyrator",
    "current of each port in proportion to the voltage of the other, without losses",
    value("conductance", "S", "current of the primary per voltage of the secondary", ""),
    (_DOMAIN, "primary"),
    (_DOMAIN, "secondary"),
)

#: Controlling ports: an open one measures a voltage, a short-circuited one a current.
_VOLTMETER = Terminal(
    _DOMAIN, Kind.THROUGH_SOURCE, "control", through=Law(lambda: 0), is_passive=False
)
_AMMETER = Terminal(_DOMAIN, Kind.ACROSS_SOURCE, "control", across=Law(lambda: 0), is_passive=False)


def _controlled(
    name: str, by_voltage: bool, gives_voltage: bool, field: tuple[str, str, str]
) -> Component:
    """Make a controlled source."""
    # The controlled port alone takes up power, which comes from nowhere: none of these is passive.
    measured = "across_control" if by_voltage else "through_control"
    law = Law.taking((measured, field[0]), lambda control, factor: factor * control)
    if gives_voltage:
        output = Terminal(_DOMAIN, Kind.ACROSS_SOURCE, "output", across=law, is_passive=False)
    else:
        output = Terminal(_DOMAIN, Kind.THROUGH_SOURCE, "output", through=law, is_passive=False)
    given, by = ("voltage", "current")[not gives_voltage], ("voltage", "current")[not by_voltage]
    doc = f"{given} in proportion to a {by} elsewhere"
    return scalar(name, doc, (value(*field, ""),), _VOLTMETER if by_voltage else _AMMETER, output)


VCVS = _controlled("vcvs", True, True, ("gain", "1", "voltage per voltage"))
VCCS = _controlled("vccs", True, False, ("transconductance", "S", "current per voltage"))
CCVS = _controlled("ccvs", False, True, ("transresistance", "ohm", "voltage per current"))
CCCS = _controlled("cccs", False, False, ("gain", "1", "current per current"))


# Infinite gain holds voltage and current of the input at zero; those of the output follow from the
# rest of the network.
_INPUT = Terminal(
    _DOMAIN,
    Kind.NULLATOR,
    "input",
    across=Law(lambda: 0),
    through=Law(lambda: 0),
    is_passive=False,
)
_OUTPUT = Terminal(_DOMAIN, Kind.NORATOR, "output", is_passive=False)

IDEAL_OP_AMP = scalar(
    "ideal_op_amp",
    "operational amplifier of infinite gain, with feedback",
    (),
    replace(_INPUT, between=("plus", "minus")),
    replace(_OUTPUT, between=("output", "ground")),
    terminals=("plus", "minus", "output"),
)

NULLOR = scalar("nullor", "ideal amplifier whose output may float", (), _INPUT, _OUTPUT)

COMPONENTS = (
    TRANSFORMER,
    GYRATOR,
    VCVS,
    VCCS,
    CCVS,
    CCCS,
    IDEAL_OP_AMP,
    NULLOR,
)
