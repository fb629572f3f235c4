"""Initial values of more storages than have states: taken where they agree, else named together."""

from __future__ import annotations

import numpy as np
import pytest

from cotree import Scene
from cotree.errors import ParameterError

TIGHT = {"method": "dop853", "rtol": 1e-11, "atol": 1e-13}


def _parallel(first, second):
    """Two capacitors side by side, 3 F, that a resistor of 1 ohm discharges."""
    scene = Scene("parallel")
    scene.parameter("v0", 2.0)
    for name, capacitance, v in (("C1", 1.0, first), ("C2", 2.0, second)):
        scene.edge(name, "capacitor", "a", "ground", capacitance=capacitance, initial={"v": v})
    scene.edge("R", "resistor", "a", "ground", resistance=1.0)
    return scene


@pytest.mark.parametrize("second", ["v0", "2*v0 - sqrt(v0*v0)", 2.0 * (1 + 1e-10)])
def test_values_that_agree_are_accepted(second):
    scene = _parallel("v0", second)
    wanted = ["v0"] if isinstance(second, str) else []
    result = scene.compile(wanted).simulate((0, 3), **TIGHT)
    decay = np.exp(-result.t / 3)
    np.testing.assert_allclose(result["C1.v"], 2 * decay, rtol=1e-9)
    if wanted:
        np.testing.assert_allclose(result.sensitivity("C1.v", "v0"), decay, rtol=1e-9)


def test_values_that_agree_by_chance_have_no_sensitivity():
    """C2 is given a number, C1 a parameter: another value of it would contradict C2."""
    scene = _parallel("v0", 2.0)
    assert scene.compile().initial_state == [2.0]
    with pytest.raises(ParameterError, match=r"d\(C2.v\)/d\(v0\) is 0 as given but 1 by 'C1.v'"):
        scene.compile(["v0"])
    model = scene.compile()
    with pytest.raises(ParameterError, match=r"'C2.v' is given as 2 but is 3 by 'C1.v'"):
        model.simulate((0, 1), parameters={"v0": 3.0})


def test_a_state_that_is_given_anew_takes_the_others_along():
    model = _parallel(2.0, 2.0).compile(["C1.v"])
    result = model.simulate((0, 3), initial={"C1.v": 5.0}, **TIGHT)
    np.testing.assert_allclose(result["C1.v"], 5 * np.exp(-result.t / 3), rtol=1e-9)
    np.testing.assert_allclose(result.sensitivity("C1.v", "C1.v"), np.exp(-result.t / 3), rtol=1e-9)


def _pipes(flow):
    """Eighteen pipes between the nodes of a grid, with one way in and one way out."""
    scene = Scene("pipes")
    scene.parameter("q0", 0.0)
    nodes = [(i, j) for i in range(3) for j in range(5)]
    pairs = [((i, j), (i, j + 1)) for i, j in nodes if j < 4]
    pairs += [((i, j), (i + 1, j)) for i, j in nodes if i < 2 and j % 2 == 0]
    assert len(pairs) == 18
    for n, (a, b) in enumerate(pairs):
        ends = [f"n{i}{j}" for i, j in (a, b)]
        fields = {"resistance": 1.0, "inertance": 1.0 + 0.1 * n}
        scene.edge(f"P{n}", "pipe", *ends, **fields, initial={"q": flow(n)})
    scene.edge("inlet", "pressure_source", "n00", "ground", pressure=1.0)
    scene.edge("outlet", "hydraulic_resistor", "n24", "ground", resistance=1.0)
    return scene


def test_a_network_of_pipes_may_be_given_all_its_flows():
    model = _pipes(lambda n: "q0").compile()
    assert len(model.states) < 18
    assert not model.initial_state.any()


def test_all_that_contradict_are_listed_at_once():
    with pytest.raises(ParameterError) as caught:
        _pipes(lambda n: 0.1 * n).compile()
    message = str(caught.value)
    n_states = len(_pipes(lambda n: 0.0).compile().states)
    assert message.startswith("initial values contradict each other: ")
    # Each flow has a decimal of its own, so that none of the others agrees.
    assert message.count(" is given as ") == 18 - n_states
    assert message.endswith("Give values that agree, or leave these out")
    with pytest.raises(ParameterError, match=r"d\(P\d+.q\)/d\(q0\) is 1 as given but"):
        _pipes(lambda n: "q0").compile(["q0"])


def _driven(voltage, v):
    scene = Scene("driven")
    scene.parameter("v0", 2.0)
    scene.edge("V", "voltage_source", "a", "ground", voltage=voltage)
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0, initial={"v": v})
    scene.edge("R", "resistor", "a", "b", resistance=1.0)
    scene.edge("D", "capacitor", "b", "ground", capacitance=1.0)
    return scene


def test_a_source_gives_the_voltage_of_a_capacitor_beside_it():
    model = _driven("v0*cos(t)", "v0").compile(["v0"])
    result = model.simulate((0, 2), **TIGHT)
    t = result.t
    exact = (np.cos(t) + np.sin(t) - np.exp(-t)) / 2  # of v' + v = cos t
    np.testing.assert_allclose(result["D.v"], 2 * exact, atol=1e-9)
    np.testing.assert_allclose(result.sensitivity("D.v", "v0"), exact, atol=1e-9)
    with pytest.raises(ParameterError, match=r"'C.v' is given as 2 but .* by the sources at t = 1"):
        model.simulate((1, 2))
    with pytest.raises(ParameterError, match=r"d\(C.v\)/d\(v0\) is 0 as given but 1 by the source"):
        _driven("v0*cos(t)", 2.0).compile(["v0"]).start()


def test_a_start_at_a_later_time_may_agree():
    """At t = 0 the source contradicts the capacitor: the model is made, and starts where it may."""
    model = _driven("v0*(1 + t)", 4.0).compile()
    assert model.simulate((1, 2)).success
    with pytest.raises(
        ParameterError, match=r"'C.v' is given as 4 but is 2 by the sources at t = 0"
    ):
        model.simulate((0, 1))


def test_an_input_gives_the_voltage_too():
    scene = _driven("u", 3.0)
    scene.input("u", "3*cos(t)")
    model = scene.compile()
    assert model.start().y == [0.0]
    with pytest.raises(ParameterError, match=r"'C.v' is given as 3 but is 4 by the sources"):
        model.start(u=[4.0])


@pytest.mark.parametrize(("current", "voltage"), [(0.0, 0.0), (2.5, 0.0), (0.0, 5.0)])
def test_a_storage_may_be_given_its_other_variable(current, voltage):
    """A capacitor at its source's constant voltage takes nothing; an inductor at rest all of it."""
    scene = Scene("other")
    scene.edge("V", "voltage_source", "a", "ground", voltage=5.0)
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0, initial={"i": current})
    scene.edge("L", "inductor", "a", "b", inductance=1.0, initial={"i": 0.0, "v": voltage})
    scene.edge("R", "resistor", "b", "ground", resistance=1.0)
    if (current, voltage) == (0.0, 5.0):
        assert scene.compile().states == ("L.i",)
        return
    with pytest.raises(ParameterError) as caught:
        scene.compile()
    assert ("'C.i' is given as 2.5 but is 0" in str(caught.value)) is (current != 0.0)
    assert ("'L.v' is given as 0 but is 5 by 'L.i'" in str(caught.value)) is (voltage != 5.0)


def test_both_sides_of_a_transformer():
    def build(v):
        scene = Scene("sides")
        scene.parameter("r", 2.0)
        scene.edge("T", "transformer", "p", "s", ratio="r")
        scene.edge("P", "capacitor", "p", "ground", capacitance=1.0, initial={"v": 4.0})
        scene.edge("S", "capacitor", "s", "ground", capacitance=1.0, initial={"v": v})
        scene.edge("R", "resistor", "p", "ground", resistance=1.0)
        return scene

    assert build("4/r").compile(["r"]).states in (("P.v",), ("S.v",))
    with pytest.raises(ParameterError, match=r"but their derivatives do not: d\([PS].v\)/d\(r\)"):
        build(2.0).compile(["r"])
    with pytest.raises(ParameterError, match=r"'[PS].v' is given as [46] but is"):
        build(3.0).compile()


def test_springs_that_are_tied_to_each_other():
    """Two springs in a row, with nothing between: forces are one, stretches follow."""

    def build(second):
        scene = Scene("row")
        scene.edge("m", "translational_mass", "ground", "A", mass=1.0)
        scene.edge("k1", "translational_spring", "ground", "B", stiffness=2.0, initial={"s": 0.3})
        scene.edge("k2", "translational_spring", "B", "A", stiffness=3.0, initial={"s": second})
        return scene

    assert build(0.2).compile().initial_state.max() in (0.2, 0.3)
    with pytest.raises(ParameterError, match=r"'k[12].s' is given as 0.[35] but is"):
        build(0.5).compile()


def test_a_rotor_that_is_geared_to_a_joint():
    """Its speed is the joint's, 3 rad/s times 20: a state of the multibody system."""

    def build(w):
        scene = Scene("geared")
        scene.parameter("w0", 3.0)
        scene.edge("h", "revolute", "ground", "A", axis=[0, 0, 1], initial={"theta_dot": "w0"})
        scene.edge("body", "rigid_body", "ground", "A", mass=1.0, inertia=0.6)
        scene.edge("J", "rotational_inertia", "ground", "s", inertia=1e-3, initial={"w": w})
        scene.edge("drag", "rotational_damper", "ground", "s", damping=1e-3)
        scene.edge("gear", "ideal_gear", input=["ground", "s"], joint="h", ratio=20)
        return scene

    free = build("20*w0").compile(["w0"])
    assert free.states == ("h.theta", "h.theta_dot")
    result = free.simulate((0, 1), **TIGHT)
    # 0.6 + 400 * 1e-3 kg m^2 against 400 * 1e-3 N m s/rad: a rate of 0.4 /s.
    np.testing.assert_allclose(result["h.theta_dot"], 3 * np.exp(-0.4 * result.t), rtol=1e-9)
    with pytest.raises(ParameterError, match=r"d\(J.w\)/d\(w0\) is 0 as given but 20 by"):
        build(60.0).compile(["w0"])
    with pytest.raises(ParameterError, match=r"'J.w' is given as 50 but is 60 by 'h.theta_dot'"):
        build(50.0).compile()


def test_in_a_c_project_and_alone(tmp_path):
    _parallel(2.0, "v0").compile().write(tmp_path / "agree")
    assert _parallel("v0", "v0").compile(["v0"]).start().s == [[1.0]]
    with pytest.raises(ParameterError, match=r"'C2.v' is given as 3 but is 2 by 'C1.v'"):
        _parallel(2.0, 3.0).compile()


@pytest.mark.parametrize("kind", ["capacitor", "inductor"])
def test_a_loop_of_capacitors_and_a_row_of_inductors(kind):
    """Voltages of the loop add up to the source's; currents of the row are one."""

    def build(first, second):
        scene = Scene("tied")
        symbol, field = {"capacitor": ("v", "capacitance"), "inductor": ("i", "inductance")}[kind]
        scene.edge("V", "voltage_source", "a", "ground", voltage=1.0)
        scene.edge("X1", kind, "a", "b", **{field: 1.0}, initial={symbol: first})
        scene.edge("X2", kind, "b", "ground", **{field: 1.0}, initial={symbol: second})
        return scene

    assert len(build(*((0.25, 0.75) if kind == "capacitor" else (2.0, 2.0))).compile().states) == 1
    with pytest.raises(ParameterError, match=r"'X[12].[vi]' is given as 1 but is [05] by 'X[12]"):
        build(1.0, 1.0 if kind == "capacitor" else 5.0).compile()
