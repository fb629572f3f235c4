"""Electrical components: closed forms beyond those of their pages, sensitivities, refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy
import sympy

import cotree
from cotree import Scene
from cotree.components import COMPONENTS, register_component
from cotree.errors import (
    ModelError,
    ParameterError,
    SceneError,
    SingularSystemError,
    TopologyError,
)

pytestmark = pytest.mark.compiler

TIGHT = {"rtol": 1e-11, "atol": 1e-13}


def _run(scene, t_end, sensitivities=(), **settings):
    model = scene.compile(list(sensitivities))
    return model.simulate((0.0, t_end), throw=True, **{**TIGHT, **settings})


def _pulsed(**fields):
    scene = Scene("pulsed")
    for name in ("delay", "width", "period", "high"):
        if isinstance(fields.get(name), float):
            scene.parameter(name, fields[name])
            fields[name] = name
    scene.edge("I1", "pulse_current", "ground", "a", **fields)
    scene.edge("C1", "capacitor", "a", "ground", capacitance=1.0)
    return scene


@pytest.mark.parametrize("method", ["dop853", "RK45", "LSODA", "BDF", "cvode"])
def test_a_pulse_of_a_microsecond_in_a_second_is_not_stepped_over(method):
    scene = _pulsed(high=1e6, width=1e-6, delay=0.37, rise=1e-8, fall=1e-8)
    result = _run(scene, 1.0, method=method, rtol=1e-8, atol=1e-10)
    # The tolerance, for each of a few hundred steps of the methods of low order.
    assert result["C1.v"][-1] == pytest.approx(1.01, rel=1e-6)


def _peak_detector():
    scene = Scene("peak")
    scene.parameter("C", 1e-4)
    scene.edge("V", "sine_voltage", "a", "ground", amplitude=10.0, frequency=50.0)
    scene.edge("D", "diode", "a", "c", saturation_current=1e-12, thermal_voltage=0.02585)
    scene.edge("C1", "capacitor", "c", "ground", capacitance="C")
    scene.edge("R2", "resistor", "c", "ground", resistance=1e5)
    return scene


@pytest.mark.slow
@pytest.mark.parametrize("sensitivities", [(), pytest.param(("C",), marks=pytest.mark.slow)])
def test_no_charge_of_a_peak_detector_is_stepped_over(sensitivities):
    model = _peak_detector().compile(list(sensitivities))
    times = np.linspace(0.0, 0.2, 41)
    reference = model.simulate((0.0, 0.2), times, "Radau", 1e-10, 1e-13, max_step=1e-4)["C1.v"]
    # Between charges the voltage falls by 2 %: one that is missed is off by 0.2 V at least.
    for method in ("dop853", "Radau", "LSODA", "cvode", "ida"):
        found = model.simulate((0.0, 0.2), times, method, 1e-6, 1e-8, throw=True)["C1.v"]
        # The tolerance, through about a hundred steps of a charge and ten charges.
        assert np.abs(found - reference).max() < 2e-4, method


def test_pulses_of_every_period_are_not_stepped_over():
    scene = _pulsed(high=1e6, width=1e-6, delay=0.05, period=0.01, rise=1e-8, fall=1e-8)
    result = _run(scene, 1.0, method="dop853")
    # 95 pulses after the delay, none before. Times have a rounding of 1e-16 by the width of 1e-6.
    assert result["C1.v"][-1] == pytest.approx(95 * 1.01, rel=1e-9)
    assert np.all(result["C1.v"][result.t < 0.05] == 0.0)


def test_pulses_follow_parameters_of_a_run():
    model = _pulsed(high=1e6, width=1e-6, delay=0.05, period=0.01).compile()
    changed = {"delay": 0.5, "period": 0.1, "width": 2e-6}
    result = model.simulate((0, 1), parameters=changed, method="DOP853", **TIGHT)
    assert result["C1.v"][-1] == pytest.approx(5 * 2.001, rel=1e-9)


@pytest.mark.parametrize("parameter", ["delay", "width", "period", "high"])
def test_sensitivities_of_pulses_against_differences(parameter):
    values = {"delay": 0.11, "width": 0.07, "period": 0.31, "high": 2.0}
    scene = Scene("pulses")
    for name, value in values.items():
        scene.parameter(name, value)
    fields = {name: name for name in values}
    scene.edge("V1", "pulse_voltage", "a", "ground", rise=0.02, fall=0.03, **fields)
    scene.edge("R1", "resistor", "a", "b", resistance=0.5)
    scene.edge("C1", "capacitor", "b", "ground", capacitance=0.4)
    model = scene.compile([parameter])

    def end(value):
        run = model.simulate((0, 1), parameters={parameter: value}, method="dop853", **TIGHT)
        return run["C1.v"][-1]

    h, value = 1e-5, values[parameter]
    found = model.simulate((0, 1), method="dop853", **TIGHT).sensitivity("C1.v", parameter)[-1]
    # Truncation is h**2 times a third derivative of some thousand; runs err by 1e-11 / h.
    assert found == pytest.approx((end(value + h) - end(value - h)) / (2 * h), rel=1e-5)


def test_a_capacitor_held_by_an_amplifier_is_found():
    """The differentiator: its capacitor is tied to the source by the amplifier's inputs."""
    scene = Scene("differentiator")
    scene.parameter("R", 2e3)
    scene.edge("V", "voltage_source", "a", "ground", voltage="sin(1000*t)")
    scene.edge("C", "capacitor", "a", "n", capacitance=1e-6)
    scene.edge("R1", "resistor", "n", "o", resistance="R")
    scene.edge("A", "ideal_op_amp", "ground", "n", "o")
    scene.edge("C2", "capacitor", "o", "b", capacitance=1e-6)
    scene.edge("R2", "resistor", "b", "ground", resistance=1e3)
    scene.output("v", "o.v")
    scene.output("i", "A.output.i")
    result = _run(scene, 1e-3, ["R"])
    assert set(scene.compile().states) == {"C2.v"}
    np.testing.assert_allclose(result["v"], -2.0 * np.cos(1000 * result.t), atol=1e-13)
    np.testing.assert_allclose(
        result.sensitivity("v", "R"), -1e-3 * np.cos(1000 * result.t), atol=1e-15
    )
    # What flows into the output comes from both of its neighbours.
    current = 1e-3 * np.cos(1000 * result.t) - (result["v"] - result["C2.v"]) / 1e3
    np.testing.assert_allclose(result["i"], current, atol=1e-15)


def test_an_inductor_made_of_two_amplifiers_and_a_capacitor():
    """Antoniou's circuit: L = C R**3 / R."""
    scene = Scene("antoniou")
    scene.edge("V", "voltage_source", "s", "ground", voltage=1.0)
    scene.edge("Rs", "resistor", "s", "a", resistance=1e3)
    for name, ends in {"R1": "ab", "R2": "bc", "R3": "cd"}.items():
        scene.edge(name, "resistor", *ends, resistance=1e3)
    scene.edge("C4", "capacitor", "d", "e", capacitance=1e-6)
    scene.edge("R5", "resistor", "e", "ground", resistance=1e3)
    scene.edge("A1", "ideal_op_amp", "a", "c", "d")
    scene.edge("A2", "ideal_op_amp", "e", "c", "b")
    scene.output("v", "a.v")
    result = _run(scene, 2e-3)
    np.testing.assert_allclose(result["v"], np.exp(-1e3 * result.t), atol=1e-10)


def test_an_active_filter_against_its_transfer_function():
    """Sallen and Key, with unity gain: 1 / (1 + 2 s R C2 + s**2 R**2 C1 C2)."""
    r, c1, c2 = 1e4, 2e-8, 1e-8
    scene = Scene("filter")
    scene.input("u", 0.0)
    scene.edge("V", "voltage_source", "s", "ground", voltage="u")
    scene.edge("R1", "resistor", "s", "a", resistance=r)
    scene.edge("R2", "resistor", "a", "b", resistance=r)
    scene.edge("C1", "capacitor", "a", "o", capacitance=c1)
    scene.edge("C2", "capacitor", "b", "ground", capacitance=c2)
    scene.edge("A", "ideal_op_amp", "b", "o", "o")
    scene.output("v", "o.v")
    system = scene.compile().linearize()
    for s in (1e2j, 5e3j, 3e4 + 1e5j):
        gain = system.C @ np.linalg.solve(s * np.eye(2) - system.A, system.B) + system.D
        assert gain[0, 0] == pytest.approx(
            1 / (1 + 2 * s * r * c2 + s**2 * r**2 * c1 * c2), rel=1e-12
        )


def test_a_gyrator_keeps_the_states_of_storages():
    scene = Scene("gyrators")
    scene.edge("V", "voltage_source", "a", "ground", voltage=1.0)
    scene.edge("R", "resistor", "a", "b", resistance=1.0)
    scene.edge("G1", "gyrator", "b", "c", conductance=2.0)
    scene.edge("G2", "gyrator", "c", "d", conductance=3.0)
    scene.edge("C", "capacitor", "d", "ground", capacitance=1.0)
    assert scene.compile().states == ("C.v",)


def test_windings_start_by_port_and_keep_their_flux():
    """A source drives one winding, the other is shorted: L2 i2 + M i1 stays as it is."""
    scene = Scene("windings")
    fields = {"inductance1": 1.0, "inductance2": 0.5, "coupling": 0.6}
    scene.edge("V", "voltage_source", "a", "ground", voltage="sin(t)")
    scene.edge("K", "coupled_inductors", "a", "b", initial={"secondary": {"i": 0.3}}, **fields)
    scene.edge("S", "voltage_source", "b", "ground", voltage=0.0)
    result = _run(scene, 3.0)
    assert result["K.secondary.i"][0] == 0.3
    flux = 0.5 * result["K.secondary.i"] + 0.6 * math.sqrt(0.5) * result["K.primary.i"]
    np.testing.assert_allclose(flux, 0.15, atol=1e-11)
    with pytest.raises(SceneError, match=r"no coordinate 'i'"):
        scene.edge("K2", "coupled_inductors", "a", "b", initial={"i": 1.0}, **fields)


def test_a_complete_coupling_is_refused_before_a_run_too():
    scene = Scene("windings")
    scene.parameter("k", 0.9)
    fields = {"inductance1": 1.0, "inductance2": 0.5, "coupling": "k"}
    scene.edge("V", "voltage_source", "a", "ground", voltage=1.0)
    scene.edge("K", "coupled_inductors", "a", "b", **fields)
    scene.edge("R", "resistor", "b", "ground", resistance=1.0)
    model = scene.compile()
    with pytest.raises(ParameterError, match=r"'K' has a complete coupling"):
        model.simulate((0, 1), parameters={"k": -1.0})


def test_three_windings_are_a_matrix_exponential():
    """Each on a resistor: M di/dt = -R i, with the derivatives of the matrices by parameters."""
    values = {"L1": 1.0, "L2": 2.0, "L3": 0.5, "k12": 0.8, "k13": -0.3, "k23": 0.2}
    scene = Scene("windings")
    for name, value in values.items():
        scene.parameter(name, value)
    fields = {f"inductance{i}": f"L{i}" for i in (1, 2, 3)}
    fields |= {"coupling": "k12", "coupling13": "k13", "coupling23": "k23"}
    start = {"primary": {"i": 1.0}, "winding3": {"i": -2.0}}
    scene.edge("T", "coupled_inductors", "a", "b", "c", initial=start, **fields)
    resistances = (1.0, 2.0, 0.3)
    for node, resistance in zip("abc", resistances, strict=True):
        scene.edge(f"R{node}", "resistor", node, "ground", resistance=resistance)
    model = scene.compile(["k23", "L3"])
    result = model.simulate((0, 1), rtol=1e-11, atol=1e-13)

    def end(**changed):
        v = values | changed
        own = np.sqrt([v["L1"], v["L2"], v["L3"]])
        k = [[1, v["k12"], v["k13"]], [v["k12"], 1, v["k23"]], [v["k13"], v["k23"], 1]]
        rates = -np.linalg.solve(np.outer(own, own) * k, np.diag(resistances))
        return scipy.linalg.expm(rates) @ [1.0, 0.0, -2.0]

    # Some hundred steps of rtol 1e-11.
    np.testing.assert_allclose(result.y[:, -1], end(), atol=1e-9)
    for j, name in enumerate(("k23", "L3")):
        h = 1e-5  # rounding 1e-16/h, truncation h^2
        ends = [end(**{name: values[name] + sign * h}) for sign in (1, -1)]
        np.testing.assert_allclose(result.s[:, j, -1], (ends[0] - ends[1]) / (2 * h), atol=1e-8)
    # |k12|, |k13|, |k23| < 1 is not enough.
    with pytest.raises(ParameterError, match="'T' couples its windings by more than their flux"):
        model.simulate((0, 1), parameters={"k23": 0.99})


def _mirror(kind, **fields):
    """Draw a current mirror: one transistor as a diode, the other in proportion."""
    scene = Scene("mirror")
    scene.parameter("I", 1e-3)
    supply, low = ("ground", "s") if kind.startswith(("bjt_pnp", "mosfet_p")) else ("s", "ground")
    scene.edge("V", "voltage_source", "s", "ground", voltage=5.0)
    scene.edge("I1", "current_source", supply, "b", current="I" if low == "ground" else "-I")
    scene.edge("Q1", kind, "b", "b", low, **fields)
    scene.edge("Q2", kind, "c", "b", low, **fields)
    scene.edge(
        "C",
        "capacitor",
        "c",
        low,
        capacitance=1e-3,
        initial={"v": 4.0 if low == "ground" else -4.0},
    )
    return scene


def test_a_current_mirror_of_bipolar_transistors():
    """ic = I / (1 + 2 / beta), however the second collector lies above the base."""
    scene = _mirror("bjt_npn", saturation_current=1e-14, forward_gain=100.0)
    scene.output("ic", "Q2.ic")
    result = _run(scene, 1e-3, ["I"], t_eval=[0.0, 5e-4, 1e-3])
    # The collector's own junction lets 2e-14 A through, besides the roundings of Newton's method.
    np.testing.assert_allclose(result["ic"], 1e-3 / 1.02, rtol=1e-10)
    np.testing.assert_allclose(result.sensitivity("ic", "I"), 1 / 1.02, rtol=1e-10)


def test_a_current_mirror_of_field_effect_transistors():
    scene = _mirror("mosfet_n", factor=1e-3, threshold=0.8)
    scene.output("id", "Q2.id")
    scene.output("vgs", "Q1.vgs")
    result = _run(scene, 1e-3, ["I"], t_eval=[0.0, 1e-3])
    # What leaks is 1e-12 S times the difference of drains.
    np.testing.assert_allclose(result["id"], 1e-3, rtol=1e-8)
    np.testing.assert_allclose(result["vgs"], 0.8 + math.sqrt(2.0), rtol=1e-9)
    exact = 1 / (1e-3 * math.sqrt(2.0))
    np.testing.assert_allclose(result.sensitivity("vgs", "I"), exact, rtol=1e-8)


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("n", "p"), [("bjt_npn", "bjt_pnp"), ("mosfet_n", "mosfet_p")])
def test_the_other_polarity_is_the_same_reversed(n, p):
    fields = {"factor": 1e-3, "threshold": 0.8, "modulation": 0.1}
    if n == "bjt_npn":
        fields = {"saturation_current": 1e-14, "forward_gain": 100.0}
    runs = []
    for kind, sign in ((n, 1.0), (p, -1.0)):
        own = {**fields, "threshold": 0.8 * sign} if "threshold" in fields else fields
        scene = Scene("stage")
        scene.edge("V", "voltage_source", "s", "ground", voltage=5.0 * sign)
        scene.edge("R", "resistor", "s", "c", resistance=1e3)
        scene.edge(
            "Vb", "sine_voltage", "g", "ground", amplitude=0.2, frequency=50, offset=1.5 * sign
        )
        scene.edge("Rb", "resistor", "g", "b", resistance=1e4)
        scene.edge("Q", kind, "c", "b", "ground", **own)
        scene.edge("C", "capacitor", "c", "ground", capacitance=1e-6)
        scene.edge("Cb", "capacitor", "b", "ground", capacitance=1e-9)
        if sign < 0:  # the same drive, reversed
            scene.edges.pop("Vb")
            scene.edge(
                "Vb", "sine_voltage", "g", "ground", amplitude=-0.2, frequency=50, offset=-1.5
            )
        runs.append(_run(scene, 0.02, t_eval=np.linspace(0, 0.02, 9), method="rodas5")["C.v"])
    # Two runs take the same steps but for roundings.
    np.testing.assert_allclose(runs[0], -runs[1], rtol=1e-6, atol=1e-9)


def test_a_chain_of_saturated_transistors_switches():
    """Three inverters without capacitances but at the end: six algebraic unknowns."""
    scene = Scene("chain")
    scene.edge("V", "voltage_source", "s", "ground", voltage=5.0)
    edges = {"rise": 1e-7, "fall": 1e-7, "width": 4e-6, "period": 1e-5, "delay": 1e-6}
    scene.edge("P", "pulse_voltage", "n0", "ground", high=5.0, **edges)
    for i in range(3):
        scene.edge(f"Rb{i}", "resistor", f"n{i}", f"b{i}", resistance=1e4)
        fields = {"saturation_current": 1e-14, "forward_gain": 100.0}
        scene.edge(f"Q{i}", "bjt_npn", f"n{i + 1}", f"b{i}", "ground", **fields)
        scene.edge(f"Rc{i}", "resistor", "s", f"n{i + 1}", resistance=1e3)
    scene.edge("C", "capacitor", "n3", "ground", capacitance=1e-10)
    scene.output("v", "n3.v")
    scene.output("power", "V.v*V.i + P.v*P.i + Rc0.v*Rc0.i + Rb0.v*Rb0.i + C.v*C.i")
    for i in range(3):
        scene.output(f"q{i}", f"Q{i}.vbe*Q{i}.ib + Q{i}.vce*Q{i}.ic")
        if i:
            scene.output(f"r{i}", f"Rc{i}.v*Rc{i}.i + Rb{i}.v*Rb{i}.i")
    times = [0.9e-6, 4e-6, 9e-6, 14e-6, 19e-6, 24e-6]
    result = _run(scene, 2.4e-5, t_eval=times, rtol=1e-7, atol=1e-9)
    low, high = result["v"][1::2], result["v"][::2]
    assert np.all(low < 0.1)
    assert np.all(high[1:] > 4.9)
    # Tellegen: what sources give, the others take; 5 V times some tens of mA.
    total = sum(result[name] for name in ("power", "q0", "q1", "q2", "r1", "r2"))
    np.testing.assert_allclose(total, 0.0, atol=1e-12)


def test_the_channel_is_symmetric_in_drain_and_source():
    law = COMPONENTS["mosfet_n"].ports[0].through
    rest = {"factor": 1e-3, "threshold": 0.7, "modulation": 0.1, "leakage": 0.0}
    for vgs, vds in ((2.0, 0.4), (2.0, 3.0), (0.3, 1.0), (1.0, 0.31)):
        one = law.form({**rest, "across_gs": vgs, "across": vds}.__getitem__)
        other = law.form({**rest, "across_gs": vgs - vds, "across": -vds}.__getitem__)
        assert one == pytest.approx(-other, abs=1e-18)


def test_the_cell_takes_tables_pairs_and_names_of_its_own():
    scene = Scene("cell")
    ocv = {"of": "cell.soc", "x": [0.0, 0.5, 1.0], "y": [3.0, 3.5, 4.2]}
    fields = {"open_circuit_voltage": ocv, "capacity": 100.0, "resistance": "R0 + 0.01*cell.soc"}
    scene.parameter("R0", 0.02)
    scene.edge("cell", "battery_cell", "p", "ground", initial={"soc": 1.0}, **fields)
    scene.edge("I", "current_source", "p", "ground", current=2.0)
    result = _run(scene, 40.0, t_eval=[0.0, 10.0, 40.0])
    soc = 1 - 0.02 * result.t
    np.testing.assert_allclose(result["cell.soc"], soc, rtol=1e-12)
    scene.output("v", "cell.v")
    result = _run(scene, 40.0, ["R0"], t_eval=[0.0, 10.0, 40.0])
    exact = np.interp(soc, ocv["x"], ocv["y"]) - 2.0 * (0.02 + 0.01 * soc)
    np.testing.assert_allclose(result["v"], exact, rtol=1e-12)
    np.testing.assert_allclose(result.sensitivity("v", "R0"), -2.0, rtol=1e-12)
    with pytest.raises(SceneError, match="needs the field 'capacitance2'"):
        scene.edge("other", "battery_cell", "p", "ground", resistance2=0.1, **fields)


@pytest.mark.parametrize("name", ["battery-cell", "bridge-rectifier"])
def test_shipped_circuits_against_differences(name):
    scene = cotree.load(name)
    parameter = {"battery-cell": "R1", "bridge-rectifier": "RL"}[name]
    t_end = {"battery-cell": 500.0, "bridge-rectifier": 0.03}[name]
    model = scene.compile([parameter])
    value = scene.parameters[parameter].value

    def end(factor):
        given = {parameter: value * factor}
        return model.simulate((0, t_end), parameters=given, **TIGHT)["voltage"][-1]

    h = 1e-4
    found = model.simulate((0, t_end), **TIGHT).sensitivity("voltage", parameter)[-1]
    # Truncation is h**2 of the value, and runs err by 1e-10 / h at most.
    assert found * value == pytest.approx((end(1 + h) - end(1 - h)) / (2 * h), rel=1e-5)


@pytest.fixture
def registry():
    before = dict(COMPONENTS)
    yield
    COMPONENTS.clear()
    COMPONENTS.update(before)


@pytest.mark.usefixtures("registry")
def test_laws_of_users_are_components_by_what_they_are_functions_of():
    def kind(law, **settings):
        return register_component("own", law, domain="thermal", **settings).ports[0].kind.name

    assert kind(lambda across, k: k * across**3) == "DISSIPATOR"
    assert kind(lambda through, k: k * through**3) == "DISSIPATOR"
    assert kind(lambda across, across_rate, c, g: c * across_rate + g * across) == "ACROSS_STORAGE"
    assert kind(lambda through_rate, k: k * through_rate) == "THROUGH_STORAGE"
    assert kind(lambda t, a: a * t, gives="through") == "THROUGH_SOURCE"
    assert kind(lambda t, a: a * t, gives="across") == "ACROSS_SOURCE"


@pytest.mark.usefixtures("registry")
def test_a_users_storage_with_leakage():
    register_component(
        "leaky", lambda across, across_rate, c, g: c * across_rate + g * across, domain="electrical"
    )
    scene = Scene("leaky")
    scene.parameter("g", 0.5)
    scene.edge("C", "leaky", "a", "ground", c=2.0, g="g", initial={"v": 3.0})
    result = _run(scene, 4.0, ["g"], t_eval=[4.0])
    assert result["C.v"][-1] == pytest.approx(3 * math.exp(-1), rel=1e-10)
    assert result.sensitivity("C.v", "g")[-1] == pytest.approx(-6 * math.exp(-1), rel=1e-9)


@pytest.mark.usefixtures("registry")
def test_a_users_law_with_an_error_function():
    """v' = erf((t - v)/w), against SciPy's integration of it."""
    register_component("step", lambda across, w: sympy.erf(across / w), domain="electrical")
    scene = Scene("error-function")
    scene.parameter("w", 0.7)
    scene.edge("V", "voltage_source", "a", "ground", voltage="t")
    scene.edge("R", "step", "a", "b", w="w")
    scene.edge("C", "capacitor", "b", "ground", capacitance=1.0)
    scene.output("difference", "erf((V.v - C.v)/w) - R.i")
    result = _run(scene, 2.0, ["w"], t_eval=[2.0])
    assert abs(result["difference"][-1]) < 1e-15

    def end(w):
        rate = lambda t, v: [math.erf((t - v[0]) / w)]  # noqa: E731
        return scipy.integrate.solve_ivp(rate, (0, 2), [0.0], rtol=1e-12, atol=1e-13).y[0, -1]

    assert result["C.v"][-1] == pytest.approx(end(0.7), rel=1e-9)
    # Differences over 1e-4 are off by 1e-8 of the value, and by 1e-12 / 1e-4.
    expected = (end(0.7001) - end(0.6999)) / 2e-4
    assert result.sensitivity("C.v", "w")[-1] == pytest.approx(expected, rel=1e-6)


@pytest.mark.usefixtures("registry")
@pytest.mark.parametrize(
    ("laws", "settings", "message"),
    [
        (lambda a: a, {}, "add gives="),
        (lambda across, through: across + through, {}, "give one variable"),
        (lambda across_rate, c: c * across_rate**2, {}, "not linear in across_rate"),
        (lambda across: undefined, {}, "returns no expression"),  # noqa: F821
        (lambda across: (across, 1), {}, "component 'own' returns no expression, but .*across, 1"),
        (lambda across: across > 1, {}, "component 'own' returns no expression, but across > 1"),
        (lambda across: sympy.zoo * across, {}, "component 'own' has no value"),
        (lambda across: sympy.gamma(across), {}, "component 'own' uses the function 'gamma'"),
        (
            lambda across: sympy.Piecewise((across, across < 1)),
            {},
            "component 'own' has a Piecewise without a default branch",
        ),
        (
            lambda across: sympy.Piecewise((across, sympy.Eq(across, 1)), (0, True)),
            {},
            "component 'own' has a condition that is not a comparison",
        ),
        (lambda across: across, {"domain": "magnetic"}, "unknown domain"),
        ({"one": lambda across: across}, {"terminals": ("a", "b")}, "must state the two nodes of"),
        (
            {"one": lambda across: across},
            {"terminals": ("a", "b"), "between": {"one": ("a", "c")}},
            "not one of its terminals",
        ),
        (lambda across: across, {"terminal": ("a",)}, "unexpected keyword"),
    ],
)
def test_laws_of_users_that_are_refused(laws, settings, message):
    with pytest.raises((SceneError, TypeError), match=message):
        register_component("own", laws, **{"domain": "electrical", **settings})


@pytest.mark.usefixtures("registry")
def test_ports_need_a_domain():
    with pytest.raises(SceneError, match="give the domain"):
        register_component("own", lambda across: across, gives="through")


def _refused(*edges):
    values = {
        "resistor": {"resistance": 1.0},
        "voltage_source": {"voltage": 0.0},
        "bjt_npn": {"saturation_current": 1e-14, "forward_gain": 10.0},
    }
    scene = Scene("refused")
    scene.edge("V", "voltage_source", "a", "ground", voltage=1.0)
    for name, kind, *nodes in edges:
        scene.edge(name, kind, *nodes, **values.get(kind, {}))
    scene.compile()


_LOAD = ("R1", "resistor", "o", "ground")


@pytest.mark.parametrize(
    ("edges", "message"),
    [
        ([("A", "ideal_op_amp", "a", "ground", "o"), _LOAD], "V, A.input form a loop of voltage"),
        ([("A", "ideal_op_amp", "o", "ground", "a"), _LOAD], "V, A.output form a loop of voltage"),
        (
            [("R", "resistor", "a", "b"), ("A", "ideal_op_amp", "b", "ground", "o"), _LOAD],
            "ideal amplifiers A leave their outputs undetermined",
        ),
        ([("A", "ideal_op_amp", "a", "a", "o"), _LOAD], "'A.input' begins and ends at node 'a'"),
        ([("W", "voltage_source", "a", "a")], "'W' begins and ends at node 'a'"),
    ],
)
def test_circuits_that_are_refused(edges, message):
    with pytest.raises((TopologyError, SceneError), match=message):
        _refused(*edges)


def test_a_source_by_an_expression_that_cancels_a_resistance_is_refused():
    """The matrix of the operating point is 1/R - 1/R: it is not positive definite."""
    scene = Scene("cancelling")
    for name, node in (("R1", "ground"), ("R2", "d")):
        scene.edge(name, "resistor", "c", node, resistance=1e3)
    scene.edge("C", "capacitor", "c", "ground", capacitance=1e-6)
    scene.edge("B", "voltage_source", "d", "ground", voltage="2*c.v")
    scene.simulation(start="operating point")
    with pytest.raises(SingularSystemError, match="the networks are singular"):
        scene.compile()


def test_lists_of_a_piecewise_source_are_checked():
    scene = Scene("piecewise")
    with pytest.raises(ModelError, match="must ascend: number 3 is 1, after 1"):
        scene.edge("V", "piecewise_voltage", "a", "ground", times=[0, 1, 1], values=[1, 2, 3])
    with pytest.raises(SceneError, match="needs the field 'values'"):
        scene.edge("V", "piecewise_voltage", "a", "ground", times=[0, 1])
    with pytest.raises(SceneError, match="no field 'value'; did you mean 'values'"):
        scene.edge("V", "piecewise_voltage", "a", "ground", times=[0], values=[0], value=1)
