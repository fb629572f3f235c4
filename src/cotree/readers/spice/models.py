"""Device models: conversion of ``.model`` parameters to fields of components."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.errors import brief, nearest
from cotree.readers.spice.values import Value, is_zero, scaled, text_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from cotree.readers.spice.netlist import ModelCard

#: k T / e at 27 degrees Celsius, [V], with the constants of ngspice (CODATA 2014).
THERMAL_VOLTAGE = 1.38064852e-23 * 300.15 / 1.6021766208e-19

#: Parameters for temperature dependence and noise, which have no effect.
_NO_EFFECT = frozenset(("eg", "xti", "xtb", "kf", "af", "tnom", "ptf", "vtotc", "betatce"))


@dataclass(frozen=True)
class ModelParameter:
    """A parameter of a device model."""

    default: float
    field: str  # field of the component
    area: str = ""  # how the area factor changes the value: ``*``, ``/``, or empty if it does not
    unit: str = ""


_DIODE = {
    "is": ModelParameter(1e-14, "saturation_current", "*", "A"),
    "n": ModelParameter(1.0, ""),
    "rs": ModelParameter(0.0, "series_resistance", "/", "ohm"),
    "cjo": ModelParameter(0.0, "junction_capacitance", "*", "F"),
    "vj": ModelParameter(1.0, "junction_potential", "", "V"),
    "m": ModelParameter(0.5, "junction_grading"),
    "fc": ModelParameter(0.5, "forward_share"),
    "tt": ModelParameter(0.0, "transit_time", "", "s"),
    "bv": ModelParameter(0.0, "breakdown_voltage", "", "V"),
    "ibv": ModelParameter(1e-3, "breakdown_current", "*", "A"),
}
_BIPOLAR = {
    "is": ModelParameter(1e-16, "saturation_current", "*", "A"),
    "bf": ModelParameter(100.0, "forward_gain"),
    "br": ModelParameter(1.0, "reverse_gain"),
    "nf": ModelParameter(1.0, "forward_ideality"),
    "nr": ModelParameter(1.0, "reverse_ideality"),
    "vaf": ModelParameter(0.0, "forward_early_voltage", "", "V"),
    "var": ModelParameter(0.0, "reverse_early_voltage", "", "V"),
    "ikf": ModelParameter(0.0, "forward_knee_current", "*", "A"),
    "ikr": ModelParameter(0.0, "reverse_knee_current", "*", "A"),
    "ise": ModelParameter(0.0, "be_recombination", "*", "A"),
    "ne": ModelParameter(1.5, "be_recombination_ideality"),
    "isc": ModelParameter(0.0, "bc_recombination", "*", "A"),
    "nc": ModelParameter(2.0, "bc_recombination_ideality"),
    "rb": ModelParameter(0.0, "base_resistance", "/", "ohm"),
    "rc": ModelParameter(0.0, "collector_resistance", "/", "ohm"),
    "re": ModelParameter(0.0, "emitter_resistance", "/", "ohm"),
    "cje": ModelParameter(0.0, "be_capacitance", "*", "F"),
    "vje": ModelParameter(0.75, "be_potential", "", "V"),
    "mje": ModelParameter(0.33, "be_grading"),
    "cjc": ModelParameter(0.0, "bc_capacitance", "*", "F"),
    "vjc": ModelParameter(0.75, "bc_potential", "", "V"),
    "mjc": ModelParameter(0.33, "bc_grading"),
    "fc": ModelParameter(0.5, "forward_share"),
    "cjs": ModelParameter(0.0, "substrate_capacitance", "*", "F"),
    "vjs": ModelParameter(0.75, "substrate_potential", "", "V"),
    "mjs": ModelParameter(0.0, "substrate_grading"),
    "tf": ModelParameter(0.0, "forward_transit_time", "", "s"),
    "tr": ModelParameter(0.0, "reverse_transit_time", "", "s"),
}
#: Field-effect transistors of level 1. Functions below compute fields and elements from these.
_FIELD_EFFECT = {
    "vto": ModelParameter(0.0, "", "", "V"),
    "kp": ModelParameter(2e-5, "", "", "A/V^2"),
    "lambda": ModelParameter(0.0, "", "", "1/V"),
    "gamma": ModelParameter(0.0, "", "", "V^0.5"),
    "phi": ModelParameter(0.6, "", "", "V"),
    "is": ModelParameter(1e-14, "", "", "A"),
    "rd": ModelParameter(0.0, "", "", "ohm"),
    "rs": ModelParameter(0.0, "", "", "ohm"),
    "cbd": ModelParameter(0.0, "", "", "F"),
    "cbs": ModelParameter(0.0, "", "", "F"),
    "pb": ModelParameter(0.8, "", "", "V"),
    "mj": ModelParameter(0.5, ""),
    "fc": ModelParameter(0.5, ""),
    "cgso": ModelParameter(0.0, "", "", "F/m"),
    "cgdo": ModelParameter(0.0, "", "", "F/m"),
    "cgbo": ModelParameter(0.0, "", "", "F/m"),
    "ld": ModelParameter(0.0, "", "", "m"),
    "level": ModelParameter(1.0, ""),
}
#: Junction field-effect transistors: the same channel, and diodes from gate to drain and source.
_JUNCTION_GATE = {
    "vto": ModelParameter(-2.0, "", "", "V"),
    "beta": ModelParameter(1e-4, "", "", "A/V^2"),
    "cgs": ModelParameter(0.0, "", "", "F"),
    "cgd": ModelParameter(0.0, "", "", "F"),
    "pb": ModelParameter(1.0, "", "", "V"),
    "n": ModelParameter(1.0, ""),
    **{name: _FIELD_EFFECT[name] for name in ("lambda", "is", "rd", "rs", "mj", "fc", "level")},
}
_ALIASES = {
    "d": {"cj0": "cjo", "cj": "cjo"},
    "q": {
        **{"va": "vaf", "vb": "var", "ik": "ikf", "ccs": "cjs"},
        **{"pe": "vje", "me": "mje", "pc": "vjc", "mc": "mjc", "ps": "vjs", "ms": "mjs"},
    },
    "m": {"vt0": "vto"},
    "j": {"vt0": "vto", "m": "mj"},
}
#: Resistances of switches, which are controlled by a voltage or a current.
_RESISTANCES = {
    "ron": ModelParameter(1.0, "", "", "ohm"),
    "roff": ModelParameter(1e12, "", "", "ohm"),
}
_VOLTAGE_SWITCH = {
    "vt": ModelParameter(0.0, "", "", "V"),
    "vh": ModelParameter(0.0, "", "", "V"),
    **_RESISTANCES,
}
_CURRENT_SWITCH = {
    "it": ModelParameter(0.0, "", "", "A"),
    "ih": ModelParameter(0.0, "", "", "A"),
    **_RESISTANCES,
}
_TABLES = {
    **{"d": _DIODE, "q": _BIPOLAR, "m": _FIELD_EFFECT, "j": _JUNCTION_GATE},
    **{"s": _VOLTAGE_SWITCH, "w": _CURRENT_SWITCH},
}

#: Element letter and component type, by model type.
TYPES = {
    **{"d": ("d", "diode"), "npn": ("q", "bjt_npn"), "pnp": ("q", "bjt_pnp")},
    **{"nmos": ("m", "mosfet_n"), "pmos": ("m", "mosfet_p")},
    **{"njf": ("j", "mosfet_n"), "pjf": ("j", "mosfet_p")},
    **{"sw": ("s", "resistor"), "csw": ("w", "resistor")},
}


@dataclass(frozen=True)
class DeviceModel:
    """A device model with its parameter values."""

    letter: str  # letter of the elements that may use the model
    component: str  # component type of its elements
    values: Mapping[str, Value]  # parameter values by name


def read_model(card: ModelCard, own: Callable[[str, str, str], Value]) -> DeviceModel:
    """Read a model's parameters; ``own(name, keyword, unit)`` returns the value for a keyword."""
    if card.type not in TYPES:
        hint = nearest(card.type, TYPES)
        raise card.at.error(f"models of type '{brief(card.type)}' are not supported{hint}")
    letter, component = TYPES[card.type]
    table, aliases = _TABLES[letter], _ALIASES.get(letter, {})
    values: dict[str, Value] = {name: row.default for name, row in table.items()}
    seen = set()
    for written, word in card.given.items():
        name = aliases.get(written, written)
        if name in seen:
            raise card.at.error(f"'{brief(written)}' is given twice")
        seen.add(name)
        if name in _NO_EFFECT:
            if own("", word, "") != 27.0 and name == "tnom":
                raise card.at.error("tnom must be 27: models are not scaled with temperature")
        elif name not in table:
            raise card.at.error(
                f"'{brief(written)}' of model '{brief(card.name)}' is not supported"
                f"{nearest(name, table)}"
            )
        else:
            values[name] = own(name, word, table[name].unit)
    if values.get("level", 1.0) != 1.0:
        raise card.at.error("only field-effect transistors of level 1 are supported")
    return DeviceModel(letter, component, values)


def device_fields(model: DeviceModel, area: Value, gmin: Value) -> dict[str, Value]:
    """Return the fields of a diode or bipolar transistor with ``gmin``, [S], at its junctions."""
    fields: dict[str, Value] = {}
    for name, row in _TABLES[model.letter].items():
        value = model.values[name]
        # If the default is zero, it means no resistance or charge, or infinite voltage or current.
        if row.field and not (is_zero(value) and row.default == 0.0):
            fields[row.field] = scaled(value, area, row.area) if row.area else value
    ideality = model.values.get("n", 1.0)
    fields["thermal_voltage"] = scaled(ideality, THERMAL_VOLTAGE)
    for name in ("forward_ideality", "reverse_ideality"):
        if fields.get(name) == 1.0:
            del fields[name]
    if gmin:
        fields["leakage"] = gmin
    return fields


def side_fields(model: DeviceModel, side: str, gmin: Value, count: Value = 1.0) -> dict[str, Value]:
    """Return the fields of the diode at a channel end; ``side`` names its capacitance: ``cbd``."""
    v = model.values
    fields: dict[str, Value] = {
        "saturation_current": scaled(v["is"], count),
        "thermal_voltage": scaled(v.get("n", 1.0), THERMAL_VOLTAGE),
    }
    if gmin:
        fields["leakage"] = gmin
    if not is_zero(v[side]):
        fields["junction_capacitance"] = scaled(v[side], count)
        fields["junction_potential"], fields["junction_grading"] = v["pb"], v["mj"]
        fields["forward_share"] = v["fc"]
    return fields


def channel_fields(model: DeviceModel, width: Value, length: Value) -> dict[str, Value]:
    """Return the fields for a field-effect transistor's channel of given width and length, [m]."""
    v = model.values
    # Lateral diffusion shortens the channel at both ends.
    inner = length if is_zero(v["ld"]) else f"{text_of(length)} - 2*{text_of(v['ld'])}"
    # The factor in level 1, by Shichman and Hodges, is KP W / L.
    fields = _channel(scaled(scaled(v["kp"], width), inner, "/"), v["vto"], v["lambda"])
    if not is_zero(v["gamma"]):
        fields["body_effect"], fields["surface_potential"] = v["gamma"], v["phi"]
    return fields


def gated_fields(model: DeviceModel, area: Value) -> dict[str, Value]:
    """Return the fields for the channel of a junction field-effect transistor."""
    v = model.values
    # The sign of the threshold depends on the polarity in the model, but not in the component.
    sign = 1.0 if model.component == "mosfet_n" else -1.0
    return _channel(scaled(scaled(v["beta"], 2.0), area), scaled(v["vto"], sign), v["lambda"])


def _channel(factor: Value, threshold: Value, modulation: Value) -> dict[str, Value]:
    fields: dict[str, Value] = {"factor": factor, "threshold": threshold, "leakage": 0.0}
    if not is_zero(modulation):
        fields["modulation"] = modulation
    return fields
