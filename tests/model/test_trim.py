"""Equilibria and steady motions against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from readme_linkage import four_bar

import cotree

pytestmark = pytest.mark.compiler

G, M, L = 9.81, 1.5, 2.0


@pytest.fixture(scope="module")
def pendulum():
    scene = cotree.Scene("pendulum", gravity=[0, -G, 0])
    scene.parameter("L", L)
    scene.parameter("d", 0.3)
    scene.input("M", 0.0)
    start = {"theta": 1.0}
    hinge = {"axis": [0, 0, 1], "torque": "M", "damping": "d", "initial": start}
    scene.edge("j", "revolute", "ground", "A", **hinge)
    scene.edge("rod", "arm", "A", "B", vector=[0, "-L", 0])
    scene.edge("bob", "rigid_body", "ground", "B", mass=M)
    scene.output("h", "-L*cos(j.theta)")
    return scene.compile()


@pytest.mark.parametrize(("guess", "expected"), [(1.0, 0.0), (3.0, math.pi), (math.pi / 2, 0.0)])
def test_both_equilibria_of_a_pendulum_are_found(pendulum, guess, expected):
    point = pendulum.trim(guess={"j.theta": guess})
    assert point["j.theta"] == pytest.approx(expected, abs=1e-12)
    assert point.is_unique


def test_inputs_and_parameters_are_solved_for(pendulum):
    held = pendulum.trim(["M"], fixed={"j.theta": 0.5})
    assert held["M"] == pytest.approx(M * G * L * math.sin(0.5), rel=1e-13)
    assert held.sensitivity("M", "L") == pytest.approx(M * G * math.sin(0.5), rel=1e-13)
    assert held.sensitivity("M", "j.theta") == pytest.approx(M * G * L * math.cos(0.5), rel=1e-13)
    long = pendulum.trim(["L"], fixed={"j.theta": 0.5, "M": 5.0}, guess={"L": 1.0})
    assert long["L"] == pytest.approx(5.0 / (M * G * math.sin(0.5)), rel=1e-12)


def test_outputs_can_be_prescribed(pendulum):
    point = pendulum.trim(["M"], outputs={"h": -1.0})
    assert point["j.theta"] == pytest.approx(math.pi / 3, rel=1e-12)
    assert point["M"] == pytest.approx(M * G * L * math.sqrt(0.75), rel=1e-12)


def test_a_run_from_an_equilibrium_stays_there(pendulum):
    point = pendulum.trim(fixed={"M": 5.0})
    run = pendulum.simulate((0, 2), **point.settings)
    # The only deviation is rounding of the start, and the equilibrium is stable.
    np.testing.assert_allclose(run["j.theta"], point["j.theta"], atol=1e-12)


def test_a_steady_motion_has_rates_and_names_undetermined_states(pendulum):
    scene = cotree.Scene("sled")
    scene.input("F", 0.0)
    scene.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], force="F", damping=3.0)
    scene.edge("b", "rigid_body", "ground", "A", mass=1.0)
    model = scene.compile()
    for conditions in ({"rates": {"j.s": 2.0}}, {"fixed": {"j.s_dot": 2.0}}):
        point = model.trim(["F"], **conditions)
        assert point["F"] == pytest.approx(6.0, rel=1e-14)
        assert point["j.s_dot"] == pytest.approx(2.0, rel=1e-14)
        assert point.undetermined == (("j.s",),)
        assert "'j.s' may have any value" in point.summary()
    fixed = model.trim(["F"], fixed={"j.s": 0.0}, rates={"j.s": 2.0})
    assert fixed.is_unique


def test_a_run_from_an_equilibrium_of_a_loop_stays_there():
    scene = four_bar()
    model = scene.compile()
    point = model.trim()
    assert point.residual < 1e-10
    assert np.max(np.abs(model.kernels.constraint_values(0.0, point.y))) < 1e-12
    run = model.simulate((0, 0.2), initial=point.settings["initial"])
    # If the equilibrium is unstable, rounding errors grow by less than a factor of 1000 in 0.2 s.
    np.testing.assert_allclose(run.y[:, -1], point.y, atol=1e-10)


def test_the_operating_point_of_a_network_satisfies_its_law():
    scene = cotree.Scene("diode")
    scene.parameter("R", 1e3)
    scene.input("V", 5.0)
    scene.edge("v", "voltage_source", "a", "ground", voltage="V")
    scene.edge("r", "resistor", "a", "b", resistance="R")
    scene.edge("d", "diode", "b", "ground", saturation_current=1e-14)
    scene.edge("c", "capacitor", "b", "ground", capacitance=1e-6)
    scene.output("i", "r.i")
    model = scene.compile()
    point = model.trim(["R"], outputs={"i": 1e-3})
    assert point["R"] == pytest.approx((5.0 - point["c.v"]) / 1e-3, rel=1e-9)
    step = 0.1
    above, below = (model.trim(p={"R": 1e3 + side})["c.v"] for side in (step, -step))
    # Central differences of 1e-4 of the value are off by 1e-8 of the slope.
    slope = model.trim().sensitivity("c.v", "R")
    assert slope == pytest.approx((above - below) / (2 * step), rel=1e-7)


@pytest.mark.parametrize(
    ("conditions", "sentence"),
    [
        ({"solve": 3}, "solve is 3: give a list of names"),
        ({"fixed": 3}, "fixed is 3: give a mapping"),
        ({"t": "a"}, "t is 'a': give a number"),
        ({"solve": ["Q"]}, "solve names 'Q', which is no state, input or tunable parameter"),
        ({"rates": {"M": 1.0}}, "rates names 'M', which is no state"),
        ({"outputs": {"x": 1.0}}, "outputs names 'x', which is no output"),
        ({"fixed": {"j.theta": math.nan}}, "'j.theta' is nan"),
        ({"solve": ["M"], "fixed": {"M": 1.0}}, "remove it from one of them"),
        ({"fixed": {"j.theta": 0.5}}, r"the rate of 'j.theta_dot' is -?\d.* instead of 0"),
        ({"fixed": {"M": 40.0}}, "no equilibrium or steady motion was found"),
    ],
)
def test_invalid_conditions_get_a_message_of_one_sentence(pendulum, conditions, sentence):
    with pytest.raises(cotree.Error, match=sentence) as caught:
        pendulum.trim(**conditions)
    assert "\n" not in str(caught.value)


def motor(law):
    """Build a hinge whose torque gains a unit by a mode that an event sets."""
    scene = cotree.Scene("motor")
    scene.parameter("T", 1.0)
    scene.input("u", 0.0)
    scene.mode("level", 0)
    scene.output("level_now", "level")
    scene.output("angle", "h.theta")
    scene.event("passed", "h.theta - 2", set={"level": "1"})
    hinge = {"axis": [0, 0, 1], "torque": law, "initial": {"theta": 0.5}}
    scene.edge("h", "revolute", "ground", "A", **hinge)
    scene.edge("body", "rigid_body", "ground", "A", mass=1.0, inertia=0.1)
    return scene.compile()


@pytest.mark.parametrize("name", ["u", "T"])
def test_an_input_or_a_parameter_of_a_model_with_events_is_solved_for(name):
    model = motor(f"{name} + level - 0.1*h.theta_dot")
    found = model.trim([name], fixed={"h.theta": 0.5}, rates={"h.theta": 15.0})
    # At 15 rad/s damping takes 1.5 N m.
    assert found[name] == pytest.approx(1.5, rel=1e-12)


def test_a_point_of_a_model_with_events_and_constraints_moves_with_a_parameter():
    scene = cotree.Scene("hung", gravity=[0, -G, 0])
    scene.parameter("L", L)
    scene.mode("n", 0)
    scene.event("aside", "px.s - 5", set={"n": "1"})
    scene.edge("px", "prismatic", "ground", "X", axis=[1, 0, 0], initial={"s": 1.2})
    scene.edge("py", "prismatic", "X", "P", axis=[0, 1, 0], initial={"s": -1.6})
    scene.edge("m", "rigid_body", "ground", "P", mass=M)
    scene.edge("d", "distance", "ground", "P", length="L")
    model = scene.compile()
    found = model.trim()
    # It hangs at (0, -L).
    assert found["py.s"] == pytest.approx(-L, rel=1e-9)
    assert found.sensitivity("py.s", "L") == pytest.approx(-1.0, rel=1e-9)
    free = model.trim(["L"])
    assert free["py.s"] == pytest.approx(-free["L"], rel=1e-9)
    assert not free.is_unique


def test_a_run_begins_at_a_point_though_its_input_decides_an_event():
    scene = cotree.Scene("charged")
    scene.parameter("R", 2.0)
    scene.input("limit", 3.0)
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0)
    scene.edge("R", "resistor", "a", "ground", resistance="R")
    scene.edge("S", "current_source", "ground", "a", current=1.0)
    scene.event("full", "C.v - limit", set={"C.v": "0"})
    model = scene.compile(["R"])
    run = model.simulate((0, 1), **model.trim().settings)
    assert run["C.v"][-1] == pytest.approx(2.0, rel=1e-9)  # the point is an equilibrium


def test_a_network_without_states_is_solved_for_its_inputs():
    scene = cotree.Scene("divider")
    scene.input("u", 1.0)
    scene.edge("V", "voltage_source", "a", "ground", voltage="u")
    scene.edge("R1", "resistor", "a", "b", resistance=2.0)
    scene.edge("R2", "resistor", "b", "ground", resistance=3.0)
    scene.output("y", "R2.v")
    model = scene.compile()
    assert model.trim().unknowns == ()
    assert model.trim(["u"], outputs={"y": 6.0})["u"] == pytest.approx(10.0, rel=1e-12)


def test_a_rate_that_only_vanishes_at_infinity_is_no_equilibrium():
    """The rate (2 - v)/C at v = 0.1 is never zero, however large the capacitance."""
    scene = cotree.Scene("charging")
    scene.parameter("C", 1.0)
    scene.current_source("I", "ground", "a", current=2.0)
    scene.resistor("R", "a", "ground", resistance=1.0)
    scene.capacitor("K", "a", "ground", capacitance="C")
    scene.output("v", "a.v")
    model = scene.compile(["C"], optimize="-O0")
    with pytest.raises(cotree.SolveError, match=r"the rate of 'K\.v'"):
        model.trim("C", outputs={"v": 0.1})
    assert model.trim().y == pytest.approx([2.0], rel=1e-12)
