"""Scenes of circuits from the physical topology of reference files.

In: a file of tests/references with the elements of a circuit between nodes. Out: a scene whose
nodes are called ``n<name>``, ``0`` being the ground.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from reference_scenes import read_reference

from cotree import Scene
from cotree.components import COMPONENTS, register_component

if TYPE_CHECKING:
    from collections.abc import Mapping

Element = dict[str, Any]

_TYPES = {
    "V": ("voltage_source", "voltage"),
    "R": ("resistor", "resistance"),
    "L": ("inductor", "inductance"),
    "C": ("capacitor", "capacitance"),
}


def node(name: str) -> str:
    """Name the node that a file calls ``name``."""
    return "ground" if name == "0" else f"n{name}"


def circuit(name: str) -> Scene:
    """Build the scene of a reference file, with the quantities that it gives as outputs."""
    data = read_reference(name)
    scene = Scene(name)
    for parameter, value in data["parameters"].items():
        scene.parameter(parameter, value)
    potentials = data["initial"] if isinstance(data["initial"], dict) else {}
    for element in data["topology"].get("elements") or _ladder(50):
        _ELEMENTS.get(element["type"], _two_nodes)(scene, element, potentials)
    for quantity in data["reference"][0]["values"]:
        if found := re.fullmatch(r"v\((.*)\)", quantity):
            scene.output(f"v_{found[1]}", f"{node(found[1])}.v")
    return scene


def output_of(quantity: str) -> str:
    """Return the output of a quantity in the file; states have the same names in both."""
    own = {"i": "L.i", "vC": "C.v"}
    found = re.fullmatch(r"v\((.*)\)", quantity)
    return f"v_{found[1]}" if found else own[quantity]


def _ladder(n: int) -> list[Element]:
    """List the elements of the ladder, which its file describes in words."""
    rows: list[tuple[str, str, str, str, str]] = [
        ("Vs", "V", "s", "0", "V0"),
        ("R_source", "R", "s", "n0", "Rs"),
        ("Rload", "R", f"n{n}", "0", "RL"),
    ]
    for k in range(1, n + 1):
        rows += [
            (f"R{k}", "R", f"n{k - 1}", f"m{k}", "R"),
            (f"L{k}", "L", f"m{k}", f"n{k}", "L"),
            (f"C{k}", "C", f"n{k}", "0", "C"),
        ]
    return [
        {"name": name, "type": kind, "nodes": [a, b], "value": value}
        for name, kind, a, b, value in rows
    ]


def _two_nodes(scene: Scene, element: Element, potentials: Mapping[str, float]) -> None:
    """Add a source, resistor, inductor or capacitor; capacitors start as the nodes do."""
    kind, field = _TYPES[element["type"]]
    plus, minus = element["nodes"]
    initial = {}
    if element["type"] == "C" and potentials:
        initial["v"] = potentials.get(f"v({plus})", 0.0) - potentials.get(f"v({minus})", 0.0)
    fields = {field: element["value"]}
    scene.edge(element["name"], kind, node(plus), node(minus), initial=initial, **fields)


def _diode(scene: Scene, element: Element, _: Mapping[str, float]) -> None:
    nodes = map(node, element["nodes"])
    fields = {"saturation_current": element["Is"], "thermal_voltage": element["Vt"]}
    scene.edge(element["name"], "diode", *nodes, **fields)


def _amplifier_transistor(scene: Scene, element: Element, _: Mapping[str, float]) -> None:
    """Add the transistor of the amplifier, whose collector current follows the emitter's.

    The file gives what flows into base, emitter and collector: (1 - alpha) I, -I and alpha I.
    """
    import sympy

    def emitted(voltage: Any, beta: Any, uf: Any) -> Any:
        return beta * (sympy.exp(voltage / uf) - 1)

    register_component(
        "amplifier_transistor",
        {
            "be": lambda across, beta, uf: emitted(across, beta, uf),
            "bc": lambda across_be, alpha, beta, uf: -alpha * emitted(across_be, beta, uf),
        },
        domain="electrical",
        gives="through",
        terminals=("base", "emitter", "collector"),
        between={"be": ("base", "emitter"), "bc": ("base", "collector")},
        units={"beta": "A", "uf": "V"},
    )
    nodes = map(node, element["nodes"])
    fields = {"alpha": "alpha", "beta": "beta", "uf": "UF"}
    scene.edge(element["name"], "amplifier_transistor", *nodes, **fields)
    COMPONENTS.pop("amplifier_transistor")


_ELEMENTS = {"D": _diode, "J": _amplifier_transistor}


def battery() -> Scene:
    """Build the cell of battery_2rc from its store of charge, resistances and RC pairs."""
    data = read_reference("battery_2rc")
    scene = Scene("battery_2rc")
    for name, value in data["parameters"].items():
        scene.parameter(name, value)
    scene.edge(
        "cell",
        "battery_cell",
        "p",
        "ground",
        open_circuit_voltage="U0 + U1*cell.soc",
        capacity="3600*Q",
        resistance="R0",
        resistance1="R1",
        capacitance1="C1",
        resistance2="R2",
        capacitance2="C2",
        initial={"soc": "soc0"},
    )
    scene.edge("load", "current_source", "p", "ground", current="I*(1 - sign(t - tp))/2")
    scene.output("soc", "cell.soc")
    # The file counts these from the store of charge to the terminal, with the load's current.
    scene.output("v1", "-cell.pair1.v")
    scene.output("v2", "-cell.pair2.v")
    scene.output("vterm", "p.v")
    return scene
