"""Scenes of hydraulic, thermal, chemical, mechatronic and one-dimensional mechanical references.

In: a file of tests/references. Out: a scene of its components, with its quantities as outputs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from reference_scenes import read_reference

from cotree import Scene

if TYPE_CHECKING:
    from collections.abc import Callable


def scene_of_domain(name: str) -> Scene:
    """Build the scene of a reference file."""
    reference = read_reference(name)
    scene = Scene(name)
    for parameter, value in reference["parameters"].items():
        scene.parameter(parameter, value)
    kind = reference["topology"]["kind"]
    build = _react if kind == "reactions" else _BUILDERS[name]
    build(scene, reference)
    return scene


def _surge_tank(scene: Scene, reference: dict[str, Any]) -> None:
    """Build it in heads: density times gravity is one."""
    scene.edge("reservoir", "pressure_source", "R", "ground", pressure="H0")
    start = {"q": "Q0"}
    tunnel = {"resistance": "rf", "inertance": "Lt/(g*A)", "initial": start}
    scene.edge("tunnel", "pipe", "R", "J", **tunnel)
    tank = {"area": "As", "density": 1.0, "gravity": 1.0, "initial": {"p": "H0 - rf*Q0"}}
    scene.edge("tank", "tank", "J", "ground", **tank)
    scene.edge("turbine", "flow_source", "J", "ground", flow="Qt")
    scene.output("Q", "tunnel.q")
    scene.output("z", "J.p")


def _tank_drain(scene: Scene, reference: dict[str, Any]) -> None:
    start = {"p": "1000*g*h0"}
    scene.edge("tank", "tank", "T", "ground", area="A", gravity="g", initial=start)
    scene.edge("hole", "orifice", "T", "ground", area="a", coefficient=1.0)
    scene.output("h", "T.p/(1000*g)")
    scene.output("q", "hole.q")


def _thermal(scene: Scene, reference: dict[str, Any]) -> None:
    for i in "123":
        start = {"T": "Ta"}
        scene.edge(f"C{i}", "heat_capacitor", f"n{i}", "ground", capacity=f"C{i}", initial=start)
        scene.output(f"T{i}", f"n{i}.T")
    for name, nodes in {"R12": ("n1", "n2"), "R23": ("n2", "n3"), "Ra": ("n3", "air")}.items():
        scene.edge(name, "thermal_resistor", *nodes, resistance=name)
    scene.edge("ambient", "temperature_source", "air", "ground", temperature="Ta")
    scene.edge("heater", "heat_source", "ground", "n1", heat_flow="q")


def _react(scene: Scene, reference: dict[str, Any]) -> None:
    for name in reference["topology"]["species"]:
        start = {"c": reference["initial"][name]}
        scene.edge(name, "species", name, "ground", volume=1.0, initial=start)
        scene.output(f"{name}_c", f"{name}.c")
    for i, (rate, reactants, products) in enumerate(reference["topology"]["reactions"]):
        scene.edge(f"r{i}", "reaction", reactants=reactants, products=products, rate=rate)


def _oscillator(scene: Scene, reference: dict[str, Any]) -> None:
    scene.edge("m", "translational_mass", "ground", "A", mass="m", initial={"v": "v0"})
    spring = {"stiffness": "k", "free_length": "l0", "initial": {"s": "x0"}}
    scene.edge("s", "translational_spring", "ground", "A", **spring)
    scene.edge("d", "translational_damper", "ground", "A", damping="c")
    scene.edge("f", "force_source", "ground", "A", force="F0*sin(w*t)")
    scene.output("x", "s.s")
    scene.output("v", "A.v")


def _water_tubes(scene: Scene, reference: dict[str, Any]) -> None:
    """Build the pipes with the published friction; Colebrook's equation by iteration.

    A turn of it leaves a fifth of the error, from 4.6, the value where flow turns turbulent.
    """
    topology = reference["topology"]
    area = "(pi*d**2/4)"
    for a, b in topology["pipes"]:
        name = f"P{a}_{b}"
        number = f"(abs({name}.q)*d/(nu*{area}))"
        root = "4.6"
        for _ in range(8):
            loss = f"2*k/d + 18.7*{root}/max({number}, Rcrit)"
            root = f"(1.74 - 2*log({loss})/log(10))"
        turbulent = f"rho*length*{name}.q/({area}**2*d)/{root}**2"
        laminar = f"32*nu*rho*length/({area}*d**2)"
        is_turbulent = f"(1 + sign({number} - Rcrit))/2"
        friction = f"{laminar} + {is_turbulent}*({turbulent} - {laminar})"
        column = {"resistance": friction, "inertance": f"rho*length/{area}"}
        scene.edge(name, "pipe", f"n{a}", f"n{b}", **column)
        scene.output(f"q_{a}_{b}", f"{name}.q")
    for node in topology["tanks"]:
        tank = {"area": "b", "density": "rho", "gravity": "g", "initial": {"p": 109800}}
        scene.edge(f"T{node}", "tank", f"n{node}", "ground", **tank)
    for node, flow in topology["inflow"].items():
        scene.edge(f"in{node}", "flow_source", "ground", f"n{node}", flow=flow)
    for node, flow in topology["outflow"].items():
        drain = flow.replace("^", "**")
        scene.edge(f"out{node}", "flow_source", f"n{node}", "ground", flow=drain)
    for node in range(1, 14):
        scene.output(f"p_{node}", f"n{node}.p")


def _geared_motor(scene: Scene, reference: dict[str, Any]) -> None:
    """Build a motor on an ideal gear; it has one constant, Kt = Ke."""
    winding = {"resistance": "R", "inductance": "L", "constant": "Kt"}
    scene.edge("Vs", "voltage_source", "a", "ground", voltage="V")
    scene.edge("M", "dc_motor", electrical=["a", "ground"], shaft=["ground", "m"], **winding)
    scene.edge("Im", "rotational_inertia", "ground", "m", inertia="Jm")
    scene.edge("Bm", "rotational_damper", "ground", "m", damping="bm")
    scene.edge("G", "ideal_gear", input=["ground", "m"], output=["ground", "l"], ratio="N")
    scene.edge("Il", "rotational_inertia", "ground", "l", inertia="Jl")
    scene.edge("Bl", "rotational_damper", "ground", "l", damping="bl")
    scene.edge("Load", "torque_source", "ground", "l", torque="-TL")
    scene.output("i", "M.i")
    scene.output("wm", "m.w")


_BUILDERS: dict[str, Callable[[Scene, dict[str, Any]], None]] = {
    "surge_tank": _surge_tank,
    "tank_drain": _tank_drain,
    "thermal_3node": _thermal,
    "spring_mass_damper": _oscillator,
    "ivp_water_tube": _water_tubes,
    "dc_motor_rigid_gear": _geared_motor,
}
