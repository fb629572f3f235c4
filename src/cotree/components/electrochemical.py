"""Electrodes and cells: electrical components whose laws come from chemistry."""

from __future__ import annotations

from typing import Any

from cotree.components.component import optional, value
from cotree.components.law import Law
from cotree.components.ports import scalar
from cotree.components.terminal import Integral, Kind, Terminal

_DOMAIN = "electrical"

#: Faraday's constant, [C/mol], and the molar gas constant, [J/(mol K)]: exact since the SI of 2019.
FARADAY, GAS = 96485.33212331, 8.31446261815324

_TEMPERATURE = optional("temperature", "K", "of the cell", 298.15, "positive")
_ELECTRONS = optional("electrons", "1", "that a turn of the reaction exchanges", 1.0, "positive")

#: State of charge, one when full: a positive current charges the cell.
STATE_OF_CHARGE = Integral("soc", "1", Law(lambda through, capacity: through / capacity))

OPEN_CIRCUIT_VOLTAGE = scalar(
    "open_circuit_voltage",
    "voltage of a cell without current, with its state of charge",
    (
        value("voltage", "V", "plus minus minus, by NAME.soc", ""),
        value("capacity", "C", "charge from empty to full"),
    ),
    Terminal(
        _DOMAIN,
        Kind.ACROSS_SOURCE,
        # The integral of its own through variable is a state that ``voltage`` may name.
        across=Law.field("voltage"),
        integral=STATE_OF_CHARGE,
    ),
)


# R T / F, 25.69 mV at 25 degrees Celsius.
def _thermal_voltage(temperature: Any) -> Any:
    import sympy

    return sympy.Float(GAS, 17) * temperature / sympy.Float(FARADAY, 17)


def _butler_volmer(
    across: Any, exchange_current: Any, symmetry: Any, electrons: Any, temperature: Any
) -> Any:
    import sympy

    # i = i0 (exp(a n F eta / (R T)) - exp(-(1 - a) n F eta / (R T))), oxidation positive, without
    # limits of mass transport (A. J. Bard and L. R. Faulkner, Electrochemical Methods, 2001).
    eta = electrons * across / _thermal_voltage(temperature)
    return exchange_current * (sympy.exp(symmetry * eta) - sympy.exp(-(1 - symmetry) * eta))


BUTLER_VOLMER = scalar(
    "butler_volmer",
    "current of an electrode by its overpotential",
    (
        value("exchange_current", "A", "both ways at equilibrium"),
        optional(
            "symmetry", "1", "share of the overpotential that drives oxidation", 0.5, "positive"
        ),
        _ELECTRONS,
        _TEMPERATURE,
    ),
    Terminal(_DOMAIN, Kind.DISSIPATOR, through=Law(_butler_volmer)),
)

DOUBLE_LAYER = scalar(
    "double_layer",
    "capacitance of an electrode's surface",
    (
        value("specific_capacitance", "F/m^2", "of a unit of the surface"),
        value("area", "m^2", "of the surface"),
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
    import sympy

    # E = E0 + R T / (n F) ln(oxidised / reduced); their ratio matters only, so that units cancel.
    return standard_potential + _thermal_voltage(temperature) / electrons * sympy.log(
        oxidised / reduced
    )


NERNST = scalar(
    "nernst",
    "equilibrium potential of an electrode by concentrations",
    (
        value("standard_potential", "V", "at equal activities", ""),
        value("oxidised", "any", "activity or concentration of the oxidised side"),
        value("reduced", "any", "the same of the reduced side"),
        _ELECTRONS,
        _TEMPERATURE,
    ),
    Terminal(_DOMAIN, Kind.ACROSS_SOURCE, across=Law(_nernst)),
)

COMPONENTS = (OPEN_CIRCUIT_VOLTAGE, BUTLER_VOLMER, DOUBLE_LAYER, NERNST)
