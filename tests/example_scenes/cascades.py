"""Scenes in which some sensitivities vanish at all times: no path leads to the state."""

from __future__ import annotations

from loop_with_network import four_bar

from cotree import Scene


def heater():
    """An electric circuit heats a body, which does not act on the circuit.

    The parameter Ca is read by the thermal part alone, k by an output alone.
    """
    scene = Scene("heater")
    for name, value in (("R", 2.0), ("L", 0.5), ("Ca", 3.0), ("Ra", 1.5), ("k", 2.0)):
        scene.parameter(name, value)
    scene.edge("V", "voltage_source", "a", "ground", voltage="5*sin(3*t)")
    scene.edge("R1", "resistor", "a", "b", resistance="R")
    scene.edge("L1", "inductor", "b", "ground", inductance="L")
    scene.edge("Q", "heat_source", "ground", "w", heat_flow="R*L1.i**2")
    scene.edge("W", "heat_capacitor", "w", "ground", capacity="Ca")
    scene.edge("air", "thermal_resistor", "w", "ground", resistance="Ra")
    scene.output("felt", "k*W.T")
    return scene


HEATER = ("R", "L", "Ca", "Ra", "k")

#: States i, T by these parameters.
HEATER_PATTERN = [[True, True, False, False, False], [True, True, True, True, False]]


def pendulums(n=2):
    """Pendulums that hang side by side, each with a length of its own."""
    scene = Scene("pendulums", gravity=[0, -9.81, 0])
    for k in range(1, n + 1):
        _pendulum(scene, k)
    return scene


def _pendulum(scene, k):
    scene.parameter(f"L{k}", 0.5 + 0.25 * k)
    scene.edge(f"h{k}", "revolute", "ground", f"A{k}", axis=[0, 0, 1], initial={"theta": 0.3 * k})
    scene.edge(f"r{k}", "arm", f"A{k}", f"B{k}", vector=[f"L{k}", 0, 0])
    scene.edge(f"b{k}", "rigid_body", "ground", f"B{k}", mass=1.0, inertia=0.02)


def ladders(n=25):
    """Two ladders of capacitors, side by side: a wide system with a narrow band."""
    scene = Scene("ladders")
    for k in "12":
        scene.parameter(f"R{k}", 1.0)
        scene.edge(f"V{k}", "voltage_source", f"n{k}_0", "ground", voltage=1.0)
        for i in range(n):
            here, there = f"n{k}_{i}", f"n{k}_{i + 1}"
            scene.edge(f"r{k}_{i}", "resistor", here, there, resistance=f"R{k}")
            scene.edge(f"c{k}_{i}", "capacitor", there, "ground", capacitance=0.1)
    return scene


def rectifier_with_heater():
    """A diode charges a capacitor through a resistor; its loss heats a body. One way only."""
    scene = Scene("rectifier-with-heater")
    for name, value in (("R", 10.0), ("Ca", 2.0)):
        scene.parameter(name, value)
    scene.edge("V", "voltage_source", "a", "ground", voltage="3*sin(20*t)")
    scene.edge("R1", "resistor", "a", "b", resistance="R")
    scene.edge("D", "diode", "b", "c", saturation_current=1e-9)
    scene.edge("C1", "capacitor", "c", "ground", capacitance=0.01)
    scene.edge("R2", "resistor", "c", "ground", resistance=50.0)
    scene.edge("Q", "heat_source", "ground", "w", heat_flow="R1.v*R1.i")
    scene.edge("W", "heat_capacitor", "w", "ground", capacity="Ca")
    scene.edge("air", "thermal_resistor", "w", "ground", resistance=1.5)
    return scene


def loop_beside_circuit():
    """A loop of bars, and a circuit that does not know of it."""
    scene = four_bar()
    scene.parameter("R", 2.0)
    scene.edge("R1", "resistor", "x", "ground", resistance="R")
    scene.edge("C1", "capacitor", "x", "ground", capacitance=0.5, initial={"v": 1.0})
    return scene


def ball_beside_pendulum():
    """A ball that bounces, and a pendulum that does not know of it."""
    scene = Scene("ball-beside-pendulum", gravity=[0, -9.81, 0])
    _pendulum(scene, 1)
    scene.parameter("e", 0.8)
    scene.edge("j", "prismatic", "ground", "B", axis=[0, 1, 0], initial={"s": 1.0})
    scene.edge("body", "rigid_body", "ground", "B", mass=1.0)
    scene.event("hit", "j.s", direction=-1, set={"j.s_dot": "-e*j.s_dot"})
    return scene


CASCADES = {
    "heater": heater,
    "pendulums": pendulums,
    "rectifier-with-heater": rectifier_with_heater,
    "loop-beside-circuit": loop_beside_circuit,
    "ball-beside-pendulum": ball_beside_pendulum,
}


def whole_pattern(equations, factors, timed=()):
    """Take no sensitivity to vanish; in the place of ``reached_states``."""
    return tuple(tuple(range(len(equations.states))) for _ in equations.sensitivities)
