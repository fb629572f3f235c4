"""Starts satisfy the equations, and their sensitivities are those of neighbouring starts."""

from __future__ import annotations

import numpy as np
import pytest

import cotree
from cotree import Scene
from cotree.model.bound import BoundModel
from cotree.model.start import find_start

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


def _differences(model, seed, initial):
    """Differentiate the start by a parameter or an initial value; return rounding, too."""
    p = model.default_parameters
    place = model.parameters.index(seed) if seed in model.parameters else None
    base = find_start(BoundModel(model.kernels, 0.0, p), initial).y
    value = base[model.states.index(seed)] if place is None else p[place]
    step = 1e-3 * (abs(value) or 1e-3)
    total = np.zeros(len(base))
    for way, weight in ((-2, 1), (-1, -8), (1, 8), (2, -1)):
        moved, own = p.copy(), dict(initial)
        if place is None:
            own[seed] = value + way * step
        else:
            moved[place] += way * step
        total += weight * find_start(BoundModel(model.kernels, 0.0, moved), own).y
    # Starts are found to a share of 1e-12 of each state.
    return total / (12 * step), 1e-12 * np.abs(base) / step


def _check(model, initial):
    """Compare a start with the equations, and its sensitivities with differences."""
    at = BoundModel(model.kernels, 0.0, model.default_parameters)
    found, n = find_start(at, initial), model.kernels.layout.n_algebraic
    # Rows of a size of one, to rounding; those of contents are smaller.
    left = model.kernels.rhs(0.0, found.y, at.p)[len(found.y) - n :]
    assert np.all(np.abs(left) < 1e-12)
    assert np.all(np.abs(model.kernels.constraint_values(0.0, found.y, at.p)) < 1e-12)
    for j, seed in enumerate(model.kernels.sensitivities):
        known, rounding = _differences(model, seed, initial)
        # The step is 1e-3 of the size, and the error its fourth power times the fifth derivative.
        atol = rounding + 1e-7 * np.max(np.abs(known))
        assert np.allclose(found.s[:, j], known, rtol=1e-7, atol=atol)


@pytest.mark.parametrize("name", SCENES)
def test_a_start_satisfies_the_equations_and_so_do_its_sensitivities(name):
    make, wanted = SCENES[name]
    _check(make().compile(wanted), {})


def _at_rest():
    scene = contents()
    scene.edge("E", "voltage_source", "s", "ground", voltage=3.0)
    scene.edge("R2", "resistor", "s", "a", resistance="R")
    scene.edge("R3", "resistor", "b", "ground", resistance="R")
    scene.simulation(start="operating point")
    return scene.compile(["c", "R"])


def test_contents_at_an_operating_point():
    model = _at_rest()
    _check(model, {})
    at = BoundModel(model.kernels, 0.0, model.default_parameters)
    # Three equal resistors in series divide 3 V.
    found = dict(zip(model.states, find_start(at, {}).y, strict=True))
    assert found["C1.v"] == pytest.approx(2.0, rel=1e-12)
    assert found["C2.q"] == pytest.approx(1e-6 * (np.tanh(1.0) + 0.2), rel=1e-12)


def test_a_given_sensitivity_of_a_voltage_is_that_of_the_charge_times_the_capacitance():
    model, slope = _at_rest(), 7.0
    at = BoundModel(model.kernels, 0.0, model.default_parameters)
    start = find_start(at, {"C1.v": 1.0, "d(C1.v)/d(c)": slope})
    q, v = model.states.index("C1.q"), model.states.index("C1.v")
    law, slope_of_law = np.tanh(1.0) + 0.2, 1.2 - np.tanh(1.0) ** 2
    assert start.y[q] == pytest.approx(1e-6 * law, rel=1e-12)
    assert start.s[v, 0] == slope
    assert start.s[q, 0] == pytest.approx(law + 1e-6 * slope_of_law * slope, rel=1e-12)


def test_many_unknowns_are_solved_for_with_sparse_factorisations():
    scene = Scene("bank")
    scene.parameter("E", 1.0)
    scene.edge("V", "voltage_source", "a", "ground", voltage="E")
    for i in range(201):
        scene.edge(f"D{i}", "diode", "a", f"b{i}", saturation_current=1e-12)
        scene.edge(f"S{i}", "resistor", f"b{i}", f"c{i}", resistance=1e3)
        scene.edge(f"C{i}", "capacitor", f"c{i}", "ground", capacitance=1e-6)
    model = scene.compile(["E"])
    assert model.kernels.start_in_c.is_sparse
    _check(model, {})
    # A guess from which exponentials overflow is left to the search.
    at = BoundModel(model.kernels, 0.0, model.default_parameters)
    poor = find_start(at, {name: 60.0 for name in model.states if name.startswith("D")})
    assert np.allclose(poor.y, find_start(at, {}).y, rtol=1e-10)


@pytest.mark.parametrize("sensitivities", [(), ("V",)])
def test_a_start_without_states_is_refused_by_name(sensitivities):
    scene = cotree.Scene("stiff-source")
    scene.parameter("V", 2.0)
    scene.velocity_source("u", "ground", "x", velocity="V")
    scene.translational_mass("M", "ground", "x", mass=1.0, initial={"v": 1.0})
    with pytest.raises(cotree.ParameterError, match=r"'M\.v' is given as 1 but is 2 by the source"):
        scene.compile(list(sensitivities), optimize="-O0").simulate((0, 1))


@pytest.mark.parametrize("q", [(1, 0, 0, 0), (0.6, 0.8, 0, 0), (0.5, 0.5, -0.5, 0.5), (1, 1, 0, 0)])
def test_a_start_without_search_has_the_bits_of_the_search(q):
    scene = Scene("thrown", gravity=[0, 0, -9.81])
    scene.edge("f", "free", "ground", "A", initial={"x": 0.75, "vx": 0.4, "vy": 0.3})
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0, inertia=[0.1, 0.2, 0.25])
    model = scene.compile().kernels
    assert "start_in_c" not in vars(model)  # compilation needed no search
    at = BoundModel(model, 0.0, model.default_parameters)
    given = {f"f.q{i}": value for i, value in enumerate(q)}
    own, searched = find_start(at, given), model.start_in_c.find(at, given)
    np.testing.assert_array_equal(own.y, searched.y)
    assert own.s.shape == searched.s.shape
    assert (own.is_chosen, own.is_mended, own.note) == (False, False, searched.note)
    assert not searched.is_chosen
