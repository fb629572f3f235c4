"""Storages by content: what they hold is kept, and what follows from it has closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import sympy
from scipy.integrate import quad

from cotree import Scene
from cotree.components import COMPONENTS, register_component

METHODS = ("dopri5", "rkf45", "dop853", "rodas4", "rodas5", "cvode", "ida")
EPS = np.finfo(float).eps


@pytest.fixture
def own_type():
    """Register a type for one test."""
    made = []

    def register(name, *args, **settings):
        made.append(name)
        return register_component(name, *args, **settings)

    yield register
    for name in made:
        COMPONENTS.pop(name, None)


def charge(v):
    return 1e-6 * (np.tanh(v) + 0.2 * v)


def capacity(v):
    return 1e-6 * (1.2 - np.tanh(v) ** 2)


def two_capacitors(by_charge):
    """Join a charged and an empty capacitor of one law by a resistor."""
    scene = Scene("two")
    scene.parameter("R", 1e3)
    scene.parameter("c", 1e-6)
    laws = {name: f"c*(tanh({name}.v) + 0.2*{name}.v)" for name in ("C1", "C2")}
    for name, node in (("C1", "a"), ("C2", "b")):
        given = {"initial": {"v": 2.0}} if name == "C1" else {}
        if by_charge:
            scene.edge(name, "nonlinear_capacitor", node, "ground", charge=laws[name], **given)
        else:
            slope = f"c*(1.2 - tanh({name}.v)**2)"
            scene.edge(name, "capacitor", node, "ground", capacitance=slope, **given)
    scene.edge("R1", "resistor", "a", "b", resistance="R")
    scene.output("total", "C1.q + C2.q" if by_charge else f"{laws['C1']} + {laws['C2']}")
    return scene


@pytest.fixture(scope="module")
def joined():
    return two_capacitors(True).compile(["R", "c", "C1.v"])


@pytest.mark.parametrize("method", METHODS)
def test_charge_is_kept_to_rounding_at_loose_tolerances(joined, method):
    for rtol in (1e-2, 1e-3):
        result = joined.simulate((0, 5e-3), method=method, rtol=rtol)
        total = result["total"]
        # Every step adds and subtracts the same current: a rounding or two each of both charges.
        assert np.ptp(total) <= 4 * EPS * len(result.t) * charge(2.0)
        # Its sensitivities are kept, too: Q(v) by c, C(v) by v.
        kept = result.output_sensitivities[0]
        exact = [0.0, charge(2.0) / 1e-6, capacity(2.0)]
        exact = np.outer(exact, np.ones(len(result.t)))
        np.testing.assert_allclose(kept, exact, rtol=1e-9, atol=1e-20)


def test_charge_drifts_where_capacitance_is_given():
    """The law that the issue is about, so that the test above is seen to test something."""
    total = two_capacitors(False).compile().simulate((0, 5e-3), method="cvode", rtol=1e-3)["total"]
    assert np.ptp(total) > 1e-4 * charge(2.0)


@pytest.mark.parametrize("method", METHODS)
def test_a_constant_current_charges_by_closed_form(method):
    scene = Scene("charging")
    for name, value in (("I", 1e-3), ("c", 1e-6), ("a", 1.5), ("v0", 0.3)):
        scene.parameter(name, value)
    law = "c*(C.v + a*C.v**2/2)"
    scene.edge("C", "nonlinear_capacitor", "n", "ground", charge=law, initial={"v": "v0"})
    scene.edge("J", "current_source", "ground", "n", current="I")
    model = scene.compile(["I", "c", "a", "v0", "C.v"])
    assert model.states == ("C.q", "C.v")
    result = model.simulate((0, 1e-3), method=method, rtol=1e-8, t_eval=[1e-3])
    i, c, a, v0, t = (sympy.Symbol(name, positive=True) for name in ("I", "c", "a", "v0", "t"))
    v = (sympy.sqrt(1 + 2 * a * (v0 + a * v0**2 / 2 + i * t / c)) - 1) / a
    at = {i: 1e-3, c: 1e-6, a: 1.5, v0: 0.3, t: 1e-3}
    exact = [float(v.diff(p).subs(at)) for p in (i, c, a, v0, v0)]
    # A polynomial of first degree: no method errs; v follows by Newton's method to rounding.
    np.testing.assert_allclose(result["C.v"][-1], float(v.subs(at)), rtol=1e-12)
    np.testing.assert_allclose(result.s[1, :, -1], exact, rtol=1e-9)


def test_initial_values_of_runs_are_voltages_or_charges(joined):
    start = joined.start(initial={"C1.v": 1.0, "C2.q": 0.5e-6})
    names = dict(zip(joined.states, start.y, strict=True))
    assert names["C1.q"] == pytest.approx(charge(1.0), rel=1e-14)
    assert charge(names["C2.v"]) == pytest.approx(0.5e-6, rel=1e-12)
    # A run goes on from what another one ended with: all states of it.
    first = joined.simulate((0, 1e-3), rtol=1e-9)
    ended = dict(zip(joined.states, first.y[:, -1].tolist(), strict=True))
    rest = joined.simulate((1e-3, 2e-3), initial=ended, rtol=1e-9)
    whole = joined.simulate((0, 2e-3), rtol=1e-9)
    np.testing.assert_allclose(rest.y[:, -1], whole.y[:, -1], rtol=1e-7)


def looped(by_charge):
    """Put a source and two capacitors, one with a resistor beside it, into a loop."""
    scene = Scene("loop")
    for name, value in (("R", 1e3), ("A", 1.0), ("w", 1e3)):
        scene.parameter(name, value)
    scene.edge("V", "voltage_source", "a", "ground", voltage="A*sin(w*t)")
    if by_charge:
        law = "1e-6*(C1.v + 0.2*C1.v**3)"
        scene.edge("C1", "nonlinear_capacitor", "a", "b", charge=law)
    else:
        scene.edge("C1", "capacitor", "a", "b", capacitance="1e-6*(1 + 0.6*C1.v**2)")
    scene.edge("C2", "capacitor", "b", "ground", capacitance="0.5e-6", initial={"v": 0.2})
    scene.edge("R1", "resistor", "b", "ground", resistance="R")
    for name in ("V.i", "C1.i", "C2.i"):
        scene.output(name.replace(".", "_"), name)
    return scene


def test_loops_with_sources_and_capacitors_agree_with_rates_of_voltages():
    """The same equations differentiated: the source's own rate then stands in them."""
    model = looped(True).compile(["R", "A", "w", "C2.v"])
    other = looped(False).compile(["R", "A", "w", "C2.v"])
    assert model.states == ("C2.q_total", "C2.v")
    assert other.states == ("C2.v",)
    settings = {"t_eval": [2e-3, 5e-3], "rtol": 1e-11, "atol": 1e-13}
    reference = other.simulate((0, 5e-3), method="dop853", **settings)
    for method in ("dop853", "rodas5"):
        result = model.simulate((0, 5e-3), method=method, **settings)
        # Both err by some tolerances of steps.
        np.testing.assert_allclose(result["C2.v"], reference["C2.v"], rtol=1e-8)
        np.testing.assert_allclose(result.s[1], reference.s[0], rtol=1e-7)
        currents = [x.output_values for x in (result, reference)]
        np.testing.assert_allclose(*currents, rtol=1e-7, atol=1e-12)
        slopes = [x.output_sensitivities for x in (result, reference)]
        np.testing.assert_allclose(*slopes, rtol=1e-6, atol=1e-12)


def test_a_source_that_jumps_moves_voltages_and_no_charge():
    """Without the resistor the node between keeps its charge: C2 v = Q(V - v)."""
    scene = Scene("divider")
    scene.parameter("V0", 1.0)
    scene.parameter("td", 1e-3)
    scene.edge("V", "voltage_source", "a", "ground", voltage="where(t < td, 0, V0)")
    scene.edge("C1", "nonlinear_capacitor", "a", "b", charge="1e-6*(C1.v + 0.2*C1.v**3)")
    scene.edge("C2", "capacitor", "b", "ground", capacitance="0.5e-6")
    scene.output("v", "b.v")
    model = scene.compile(["V0", "td"])
    u = np.roots([0.2, 0.0, 1.5, -0.5])
    u = float(u[np.isreal(u)][0].real)  # across C1: u + 0.2 u^3 = 0.5 (1 - u)
    by_source = 1.0 - 0.5 / (1.5 + 0.6 * u**2)
    for method in ("dopri5", "rodas5", "cvode", "ida"):
        result = model.simulate((0, 2e-3), method=method, t_eval=[0.5e-3, 2e-3])
        np.testing.assert_allclose(result["v"], [0.0, 1.0 - u], rtol=1e-10, atol=1e-14)
        slopes = result.output_sensitivities[0]
        np.testing.assert_allclose(slopes, [[0.0, by_source], [0.0, 0.0]], rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("method", ["dopri5", "rodas5", "cvode", "ida"])
def test_a_saturating_inductor_follows_its_flux_linkage(method):
    scene = Scene("saturation")
    values = {"V": 10.0, "w": 314.0, "L": 0.1, "I": 0.5, "i0": 0.1}
    for name, value in values.items():
        scene.parameter(name, value)
    scene.edge("S", "voltage_source", "n", "ground", voltage="V*cos(w*t)")
    law = "L*I*atan(L1.i/I)"
    scene.edge("L1", "nonlinear_inductor", "n", "ground", flux=law, initial={"i": "i0"})
    model = scene.compile(list(values))
    assert model.states == ("L1.flux", "L1.i")
    result = model.simulate((0, 3e-3), method=method, rtol=1e-9, t_eval=[3e-3])
    symbols = {name: sympy.Symbol(name, positive=True) for name in values}
    v, w, inductance, i, i0 = symbols.values()
    flux = v / w * sympy.sin(w * 3e-3) + inductance * i * sympy.atan(i0 / i)
    current = i * sympy.tan(flux / (inductance * i))
    at = {symbols[name]: value for name, value in values.items()}
    exact = [[float(x.subs(at)) for x in (flux, current)]]
    np.testing.assert_allclose(result.y.T, exact, rtol=1e-7)
    slopes = [[float(x.diff(s).subs(at)) for s in symbols.values()] for x in (flux, current)]
    np.testing.assert_allclose(result.s[:, :, -1], slopes, rtol=1e-6)


def test_flux_linkages_of_a_cutset_are_one_state():
    """Inductors in series with a current source between: each winding holds its flux."""
    scene = Scene("series")
    scene.parameter("L", 0.1)
    scene.edge("S", "voltage_source", "a", "ground", voltage="3*cos(300*t)")
    scene.edge("L1", "nonlinear_inductor", "a", "b", flux="L*0.5*atan(L1.i/0.5)")
    scene.edge("L2", "inductor", "b", "c", inductance="0.3*L")
    scene.edge("L3", "nonlinear_inductor", "c", "ground", flux="L*(L3.i + L3.i**3)")
    scene.edge("J", "current_source", "b", "ground", current="0.1*t/1e-3")
    scene.output("flux", "L1.flux + 0.3*L*L2.i + L3.flux")
    model = scene.compile(["L"])
    assert len(model.states) == 2
    result = model.simulate((0, 2e-3), rtol=1e-10, atol=1e-12)
    # The source drives them all; the current source shifts what they share.
    np.testing.assert_allclose(result["flux"], np.sin(300 * result.t) * 1e-2, rtol=1e-8, atol=1e-12)
    assert np.max(np.abs(result.output_sensitivities)) < 1e-9


def pumped(own_type):
    """Drive a transistor-like store of charge from two sides, a sixth of a period apart."""
    charges = {
        "g": lambda across, across_d, c: c * (across - across_d / 3 + across * across_d / 5),
        "d": lambda across, across_g, c: c * (across / 2 - sympy.tanh(across_g) * across / 3),
    }
    places = {"terminals": ("G", "D", "S"), "between": {"g": ("G", "S"), "d": ("D", "S")}}
    own_type("own_charges", charges, domain="electrical", gives="content", **places)
    scene = Scene("pump")
    for name, value in (("c", 1e-9), ("R", 1e3), ("A", 1.0)):
        scene.parameter(name, value)
    for node, phase in (("g", "0"), ("d", "pi/3")):
        drive = f"A*sin(1e6*t + {phase})"
        scene.edge(f"V{node}", "voltage_source", f"{node}_", "ground", voltage=drive)
        scene.edge(f"R{node}", "resistor", f"{node}_", node, resistance="R")
    scene.edge("T", "own_charges", "g", "d", "ground", c="c", initial={"g.v": 0.1})
    scene.output("into_g", "T.g.i")
    scene.output("held", "T.g.q + T.d.q")
    return scene


def test_no_charge_is_pumped_into_a_periodic_store(own_type):
    model = pumped(own_type).compile(["c", "R", "A", "T.g.v"])
    assert model.states == ("T.g.q", "T.d.q", "T.g.v", "T.d.v")
    period = 2e-6 * np.pi
    times = period * np.array([0.0, 12.0, 13.0])
    settings = {"rtol": 1e-9, "atol": 1e-10, "t_eval": times}
    result = model.simulate((0, times[-1]), method="rodas5", **settings)
    # Transients have decayed by exp(-12 period/RC) < 1e-16: what one period brings, it takes.
    held = result["held"]
    assert abs(held[2] - held[1]) <= 1e-7 * 1e-9
    # The same by the current that flows in, between steps as close as they come.
    fine = np.linspace(times[1], times[2], 1501)
    again = model.simulate((0, times[-1]), method="dop853", rtol=1e-9, t_eval=fine)
    net = np.sum(0.5 * np.diff(fine) * (again["into_g"][1:] + again["into_g"][:-1]))
    # The trapezoidal rule converges fast for periods; 1e-9 C go in and out.
    assert abs(net) <= 1e-6 * 1e-9
    differences_of(model, times[-1], result)


def differences_of(model, t_end, result):
    """Compare sensitivities with central differences of runs."""
    for j, name in enumerate(model.sensitivities):
        ends = []
        for side in (1, -1):
            if name in model.parameters:
                value = dict(zip(model.parameters, model.default_parameters, strict=True))[name]
                step, changed = 1e-4 * value, {"parameters": {name: value * (1 + side * 1e-4)}}
            else:
                step, changed = 1e-4, {"initial": {name: 0.1 + side * 1e-4}}
            run = model.simulate((0, t_end), method="rodas5", rtol=1e-11, atol=1e-12, **changed)
            ends.append(run.y[:, -1])
        slopes = (ends[0] - ends[1]) / (2 * step)
        # Second order in 1e-4, and errors of the runs over twice the step.
        allowed = 1e-6 * np.max(np.abs(result.s[:, j]), axis=1) + 1e-9
        assert np.all(np.abs(slopes - result.s[:, j, -1]) <= allowed), name


@pytest.mark.parametrize(
    ("domain", "store", "rest", "content"),
    [
        ("hydraulic", "V", ("hydraulic_resistor", "resistance", "p"), 2.0),
        ("thermal", "H", ("thermal_resistor", "resistance", "T"), 2.0),
        ("translational", "p", ("translational_damper", "damping", "v"), 0.5),
    ],
)
def test_one_mechanism_serves_every_domain(own_type, domain, store, rest, content):
    """A store that holds k (u + u^3) empties through a resistance: an implicit closed form."""

    def law(across, k):
        return k * (across + across**3)

    own_type("own_store", law, domain=domain, gives="content")
    kind, field, symbol = rest
    scene = Scene("emptying")
    scene.parameter("r", 2.0)
    ends = ("ground", "n") if domain == "translational" else ("n", "ground")
    scene.edge("S", "own_store", *ends, k=0.7, initial={symbol: 1.0})
    scene.edge("R", kind, *ends, **{field: "r"})
    model = scene.compile(["r"])
    assert model.states == (f"S.{store}", f"S.{symbol}")
    result = model.simulate((0, 1), rtol=1e-10, atol=1e-12)
    u = float(result[f"S.{symbol}"][-1])
    # k (1 + 3 u^2) u' = -u / R: the time it takes to get there is an integral.
    time = quad(lambda x: content * 0.7 * (1 + 3 * x**2) / x, u, 1.0, epsabs=1e-13)[0]
    assert time == pytest.approx(1.0, rel=1e-8)
