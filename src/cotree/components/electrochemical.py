"""Electrodes, electrochemical cells and battery cells."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from cotree.components.component import Adapted, Field, Given, Nodes, optional, value
from cotree.components.law import Law, argument, exp, log
from cotree.components.ports import resistive, scalar
from cotree.components.terminal import Integral, Kind, PortMeasure, Terminal

if TYPE_CHECKING:
    from collections.abc import Sequence


_DOMAIN = "electrical"

#: Faraday's constant, [C/mol], and the molar gas constant, [J/(mol K)], both exact since 2019.
FARADAY, GAS = 96485.33212331, 8.31446261815324

_TEMPERATURE = optional("temperature", "K", "absolute temperature", 298.15, "positive")
_ELECTRONS = optional(
    "electrons", "1", "electrons transferred per turnover of the reaction", 1.0, "positive"
)

#: State of charge, one for a full cell. Positive current charges the cell.
STATE_OF_CHARGE = Integral("soc", "1", Law(lambda through, capacity: through / capacity))

OPEN_CIRCUIT_VOLTAGE = scalar(
    "open_circuit_voltage",
    "open-circuit voltage of a cell as a function of its state of charge",
    (
        value("voltage", "V", "open-circuit voltage, an expression of NAME.soc", ""),
        value("capacity", "C", "charge between empty and full"),
    ),
    Terminal(
        _DOMAIN,
        Kind.ACROSS_SOURCE,
        # ``voltage`` may depend on the state of charge, the integral of the through variable.
        across=argument("voltage"),
        integral=STATE_OF_CHARGE,
    ),
)


# The thermal voltage R T / F is 25.69 mV at 25 degrees Celsius.
def _thermal_voltage(temperature: Any) -> Any:
    return GAS / FARADAY * temperature


def _butler_volmer(
    across: Any, exchange_current: Any, symmetry: Any, electrons: Any, temperature: Any
) -> Any:
    # Butler-Volmer equation i = i0 (exp(a n F eta / (R T)) - exp(-(1 - a) n F eta / (R T))),
    # positive for oxidation, without mass transport limits (A. J. Bard and L. R. Faulkner,
    # Electrochemical Methods, 2001).
    eta = electrons * across / _thermal_voltage(temperature)
    return exchange_current * (exp(symmetry * eta) - exp(-(1 - symmetry) * eta))


BUTLER_VOLMER = scalar(
    "butler_volmer",
    "electrode kinetics: current as a function of the overpotential",
    (
        value(
            "exchange_current", "A", "exchange current: forward and backward current at equilibrium"
        ),
        optional("symmetry", "1", "charge transfer coefficient of the oxidation", 0.5, "positive"),
        _ELECTRONS,
        _TEMPERATURE,
    ),
    Terminal(_DOMAIN, Kind.DISSIPATOR, through=Law(_butler_volmer)),
)

DOUBLE_LAYER = scalar(
    "double_layer",
    "double-layer capacitance of an electrode",
    (
        value("specific_capacitance", "F/m^2", "capacitance per area"),
        value("area", "m^2", "area of the electrode"),
    ),
    Terminal(
        _DOMAIN,
        Kind.ACROSS_STORAGE,
        storage=Law(lambda specific_capacitance, area: specific_capacitance * area),
    ),
)


def _nernst(
    standard_potential: Any, oxidised: Any, reduced: Any, electrons: Any, temperature: Any
) -> Any:
    # Nernst equation E = E0 + R T / (n F) ln(oxidised / reduced), with any concentration unit.
    return standard_potential + _thermal_voltage(temperature) / electrons * log(oxidised / reduced)


NERNST = scalar(
    "nernst",
    "equilibrium potential of an electrode as a function of concentrations",
    (
        value("standard_potential", "V", "standard potential of the electrode", ""),
        value("oxidised", "any", "activity or concentration of the oxidised species"),
        value("reduced", "any", "activity or concentration of the reduced species"),
        _ELECTRONS,
        _TEMPERATURE,
    ),
    Terminal(_DOMAIN, Kind.ACROSS_SOURCE, across=Law(_nernst)),
)


_EVERY = range(1, 4)  # numbers of the RC pairs that a cell may have


def _ports(pairs: Sequence[int]) -> tuple[Terminal, ...]:
    """Build the ports of a cell in series from plus to minus: resistance, RC pairs, charge storage.

    This is Thevenin's equivalent circuit, v = OCV(soc) + R i + sum of v_k, with i positive into the
    plus node and R_k C_k dv_k/dt = R_k i - v_k. A capacity of 1 Ah is 3600 C.
    """
    places = ["plus", *(f"n{i}" for i in range(len(pairs) + 1)), "minus"]
    ports = [resistive(_DOMAIN, "resistance", "series", (places[0], places[1]))]
    # The last two nodes belong to the charge storage, at the minus terminal.
    for i, between in zip(pairs, pairwise(places[1:]), strict=False):
        storage = argument(f"capacitance{i}")
        ports += [
            resistive(_DOMAIN, f"resistance{i}", f"resistor{i}", between),
            Terminal(_DOMAIN, Kind.ACROSS_STORAGE, f"pair{i}", storage=storage, between=between),
        ]
    # The charge storage is an across source; its voltage depends on the integral of its current.
    voltage, ends = argument("open_circuit_voltage"), (places[-2], "minus")
    store = Terminal(
        _DOMAIN, Kind.ACROSS_SOURCE, across=voltage, between=ends, integral=STATE_OF_CHARGE
    )
    return (*ports, store)


def _measures(pairs: Sequence[int]) -> tuple[PortMeasure, ...]:
    # The terminal voltage is the sum along the chain. Each RC pair counts once, as its capacitor.
    parts = ("series", *(f"pair{i}" for i in pairs), "")
    return (
        PortMeasure("v", "V", tuple((1, "across", part) for part in parts)),
        PortMeasure("i", "A", ((1, "through", "series"),)),
    )


def _fields(pairs: Sequence[int]) -> tuple[Field, ...]:
    voltage = "open-circuit voltage, a table or an expression of NAME.soc"
    own = [
        value("open_circuit_voltage", "V", voltage, ""),
        value("capacity", "C", "charge between empty and full"),
        value("resistance", "ohm", "series resistance"),
    ]
    for i in pairs:
        for quantity, unit in (("resistance", "ohm"), ("capacitance", "F")):
            doc = f"{quantity} of RC pair {i}; give both or none"
            own.append(Field(f"{quantity}{i}", unit, doc, constant=False, sign="positive"))
    return tuple(own)


def _as_given(edge: str, nodes: Nodes, fields: Given) -> Adapted:
    del edge
    # Keep a pair with only one of its two fields, so that the missing field raises an error.
    pairs = [i for i in _EVERY if {f"resistance{i}", f"capacitance{i}"} & fields.keys()]
    given = tuple(replace(row, required=True) for row in _fields(pairs))
    own = replace(BATTERY_CELL, fields=given, ports=_ports(pairs), measures=_measures(pairs))
    return own, nodes, fields


BATTERY_CELL = scalar(
    "battery_cell",
    "equivalent circuit of a cell: open-circuit voltage, resistance and up to three RC pairs",
    _fields(_EVERY),
    *_ports(_EVERY),
    terminals=("plus", "minus"),
    measures=_measures(_EVERY),
    adapt=_as_given,
)

COMPONENTS = (OPEN_CIRCUIT_VOLTAGE, BUTLER_VOLMER, DOUBLE_LAYER, NERNST, BATTERY_CELL)
