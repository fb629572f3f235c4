"""Algebraic unknowns at the start are in C what they are in Python."""

from __future__ import annotations

import numpy as np
import pytest

import cotree
from cotree import Scene
from cotree.model import start as python_start
from cotree.model.model import Moment
from cotree.model.start_in_c import StartInC

pytestmark = pytest.mark.compiler


def hanging_rod() -> Scene:
    """Draw a free body on a rod, of whose start little is given: a quaternion, and a choice."""
    scene = Scene("swing", gravity=[0, 0, -9.81])
    scene.parameter("L", 1.25)
    start = {"x": 0.75, "y": 0, "vx": 0.4, "vy": 0.5}
    scene.edge("f", "free", "ground", "A", initial=start)
    scene.edge("arm", "arm", "A", "B", vector=[0.1, 0.2, 0.0])
    scene.edge("rod", "distance", "ground", "B", length="L")
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0, inertia=0.1)
    return scene


def turning_joint() -> Scene:
    """Draw a loop in which a joint that is no state has an initial value."""
    scene = Scene("four-bar", gravity=[0, -9.81, 0])
    scene.parameter("a", 0.5)
    scene.edge("crank", "revolute", "ground", "A", axis=[0, 0, 1])
    scene.edge("bar1", "arm", "A", "B", vector=["a", 0, 0])
    scene.edge("coupler", "revolute", "B", "C", axis=[0, 0, 1])
    scene.edge("bar2", "arm", "C", "D", vector=[1.5, 0, 0])
    scene.edge("base", "arm", "ground", "E", vector=[1.6, 0, 0])
    scene.edge("rocker", "revolute", "E", "F", axis=[0, 0, 1], initial={"theta": 1.9})
    scene.edge("bar3", "arm", "F", "G", vector=[1.2, 0, 0])
    scene.edge("close", "revolute", "D", "G", axis=[0, 0, 1], initial={"theta_dot": 0.1})
    for node in "ACF":
        scene.edge(f"m{node}", "rigid_body", "ground", node, mass=1.1, inertia=0.2)
    return scene


def ladder() -> Scene:
    """Draw a network whose source jumps with a state."""
    scene = Scene("ladder")
    scene.parameter("R", 2.0)
    scene.edge("V", "voltage_source", "a", "ground", voltage="where(C.v > 0.5, 1, 2)")
    scene.edge("R1", "resistor", "a", "b", resistance="R")
    scene.edge("D", "diode", "b", "c", saturation_current=1e-6)
    scene.edge("C", "capacitor", "c", "ground", capacitance=1.0, initial={"v": 0.7})
    return scene


def contents() -> Scene:
    """Draw capacitors whose charges are states, of which voltages or nothing are given."""
    scene = Scene("two")
    scene.parameter("R", 1e3)
    scene.parameter("c", 1e-6)
    for name, node, given in (("C1", "a", {"initial": {"v": 2.0}}), ("C2", "b", {})):
        law = f"c*(tanh({name}.v) + 0.2*{name}.v)"
        scene.edge(name, "nonlinear_capacitor", node, "ground", charge=law, **given)
    scene.edge("R1", "resistor", "a", "b", resistance="R")
    return scene


def transformer() -> Scene:
    """Draw two capacitors of which one follows from the other, with a value that agrees."""
    scene = Scene("sides")
    scene.parameter("r", 2.0)
    scene.edge("T", "transformer", "p", "s", ratio="r")
    scene.edge("P", "capacitor", "p", "ground", capacitance=1.0, initial={"v": 4.0})
    scene.edge("S", "capacitor", "s", "ground", capacitance=1.0, initial={"v": "4/r"})
    scene.edge("R", "resistor", "p", "ground", resistance=1.0)
    return scene


def geared_hinges() -> Scene:
    """Draw two hinges that turn together with dry friction, whose forces are unknowns."""
    scene = Scene("tied")
    scene.parameter("F", 0.3)
    turning = {"theta": 0.0, "theta_dot": -1.5}
    scene.edge("h0", "revolute", "ground", "a", axis=[0, 0, 1], initial=turning)
    scene.edge("h1", "revolute", "ground", "b", axis=[0, 0, 1])
    ends = {"coordinate1": "h1.theta", "coordinate2": "h0.theta"}
    scene.edge("g", "gear", "a", "b", ratio=0.5, **ends)
    for node, joint in (("a", "h0"), ("b", "h1")):
        scene.edge(f"m{node}", "rigid_body", "ground", node, mass=1.0, inertia=0.4)
        scene.edge(f"f{node}", "rotational_dry_friction", joint=joint, torque="F")
    return scene


SCENES = {
    "contents": (contents, ["c", "C1.v", "R"]),
    "motor-linkage": (lambda: cotree.load("motor-linkage"), ["L"]),
    "bridge-rectifier": (lambda: cotree.load("bridge-rectifier"), ["V"]),
    "swing": (hanging_rod, ["L", "f.x"]),
    "conditions": (turning_joint, ["a"]),
    "ladder": (ladder, ["R"]),
    "geared hinges": (geared_hinges, ["F"]),
    "transformer": (transformer, ["r"]),
}


@pytest.mark.parametrize("name", SCENES)
def test_both_find_the_same(name, monkeypatch):
    make, wanted = SCENES[name]
    model = make().compile(wanted)
    at = Moment(model.kernels, 0.0, 1.01 * model.default_parameters)
    found = model.kernels.start_in_c.find(at, {})
    assert found is not None
    monkeypatch.setattr(StartInC, "find", lambda *_: None)
    known = python_start.find_start(at, {})
    # Both stop where steps are rounding; that of a least move may be 1e-11 of the states' size.
    assert np.allclose(found.y, known.y, rtol=1e-11, atol=1e-11)
    # Sensitivities of a least move are differences, to ten digits.
    assert np.allclose(found.s, known.s, rtol=1e-8, atol=1e-8)
    assert found.is_chosen == known.is_chosen


@pytest.mark.parametrize("initial", [{}, {"C1.v": 1.0, "d(C1.v)/d(c)": 7.0}], ids=["rest", "slope"])
def test_values_that_python_gives(initial, monkeypatch):
    """An operating point, and initial values of sensitivities."""
    scene = contents()
    scene.edge("E", "voltage_source", "s", "ground", voltage=3.0)
    scene.edge("R2", "resistor", "s", "a", resistance="R")
    scene.edge("R3", "resistor", "b", "ground", resistance="R")
    scene.simulation(start="operating point")
    model = scene.compile(["c", "R"])
    at = Moment(model.kernels, 0.0, model.default_parameters)
    with monkeypatch.context() as patched:
        patched.setattr(python_start, "settle_jumps", None)  # C finds the start alone
        found = python_start.find_start(at, initial)
    monkeypatch.setattr(StartInC, "find", lambda *_: None)
    known = python_start.find_start(at, initial)
    # Both solve the same equations to rounding.
    assert np.allclose(found.y, known.y, rtol=1e-12, atol=1e-18)
    assert np.allclose(found.s, known.s, rtol=1e-12, atol=1e-18)
