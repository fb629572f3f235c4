"""Nonlinear components that meet at nodes without storage: their potentials are algebraic."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from cotree import Scene, load
from cotree.errors import SingularSystemError

# Local errors of 1e-9 over some hundred steps of a stiff method.
SETTINGS = {"rtol": 1e-9, "atol": 1e-12}


def test_two_orifices_in_series_are_one_of_less_area():
    scene = Scene("series")
    scene.parameter("a", 0.02)
    scene.edge("T", "tank", "n", "ground", area=0.5, initial={"p": 2e4})
    scene.edge("one", "orifice", "n", "m", area="a", coefficient=0.6)
    scene.edge("two", "orifice", "m", "ground", area="a", coefficient=0.6)
    scene.output("root", "sqrt(n.p)")
    scene.output("share", "m.p/n.p")
    model = scene.compile(["a"])
    assert len(model.states) == 2  # the level, and the pressure between
    result = model.simulate((0, 20), **SETTINGS)
    # C d(sqrt p)/dt = -c a / sqrt(2) sqrt(2 / rho) / 2
    slope = -0.6 / np.sqrt(2) * np.sqrt(2 / 1000.0) / 2 / (0.5 / 9810.0)
    np.testing.assert_allclose(result["root"], np.sqrt(2e4) + 0.02 * slope * result.t, rtol=1e-7)
    np.testing.assert_allclose(result["share"], 0.5, rtol=1e-9)
    by_area = result.sensitivity("root", "a")
    np.testing.assert_allclose(by_area, slope * result.t, rtol=1e-6, atol=1e-6)


def test_a_radiation_shield_halves_the_heat_flow():
    def run(with_shield):
        scene = Scene("shield")
        scene.edge("C", "heat_capacitor", "a", "ground", capacity=5.0, initial={"T": 900.0})
        scene.edge("E", "temperature_source", "b", "ground", temperature=300.0)
        if with_shield:
            scene.edge("r1", "radiation", "a", "s", area=0.1)
            scene.edge("r2", "radiation", "s", "b", area=0.1)
            scene.output("shield", "(2*s.T**4 - a.T**4 - b.T**4)/a.T**4")
        else:
            scene.edge("r", "radiation", "a", "b", area=0.05)
        scene.output("T", "a.T")
        return scene.compile().simulate((0, 10), t_eval=[1.0, 10.0], **SETTINGS)

    shielded = run(True)
    np.testing.assert_allclose(shielded["T"], run(False)["T"], rtol=1e-7)
    assert np.max(np.abs(shielded["shield"])) < 1e-9


def test_a_species_that_reacts_on_at_once():
    """Without A at the start both b and its equation's slope are zero: that is refused."""
    scene = Scene("quasi-steady")
    scene.parameter("k", 5.0)
    scene.edge("A", "species", "A", "ground", volume=1.0, initial={"c": 0.1})
    scene.edge("C", "species", "C", "ground", volume=1.0)
    scene.edge("feed", "molar_flow_source", "ground", "A", flow=2.0)
    scene.edge("r1", "reaction", reactants=["A"], products=["B"], rate="k")
    scene.edge("r2", "reaction", reactants=["B", "B"], products=["C"], rate=50.0)
    scene.output("a", "A.c")
    scene.output("b", "r1.B.c")
    result = scene.compile(["k"]).simulate((0, 1), t_eval=np.linspace(0.1, 1, 10), **SETTINGS)
    a = 2.0 / 5.0 + (0.1 - 2.0 / 5.0) * np.exp(-5.0 * result.t)
    np.testing.assert_allclose(result["a"], a, rtol=1e-7)
    # r1 makes k a of B, r2 takes 2 * 50 b**2.
    np.testing.assert_allclose(result["b"], np.sqrt(5.0 * a / 100.0), rtol=1e-7)


def test_a_start_where_nothing_determines_a_species_is_refused():
    """b^2 = 0 holds at b = 0, with a slope of zero."""
    scene = Scene("nothing-yet")
    for name in "AC":
        scene.edge(name, "species", name, "ground", volume=1.0)
    scene.edge("r1", "reaction", reactants=["A"], products=["B"], rate=5.0)
    scene.edge("r2", "reaction", reactants=["B", "B"], products=["C"], rate=50.0)
    with pytest.raises(SingularSystemError, match=r"do not determine 'r2\.B\.c'"):
        scene.compile()


def test_an_electrode_behind_a_resistance():
    scene = Scene("electrode")
    scene.parameter("i0", 0.02)
    scene.edge("layer", "double_layer", "p", "ground", specific_capacitance=0.5, area=2.0)
    scene.edge("I", "current_source", "ground", "p", current="0.4*sin(2*t)")
    scene.edge("R", "resistor", "p", "q", resistance=1.5)
    scene.edge("B", "butler_volmer", "q", "ground", exchange_current="i0", symmetry=0.3)
    scene.output("p", "p.v")
    scene.output("q", "q.v")
    result = scene.compile(["i0"]).simulate((0, 3), t_eval=np.linspace(0, 3, 7), **SETTINGS)
    thermal = 8.31446261815324 * 298.15 / 96485.33212331

    def kinetics(v):
        return 0.02 * (np.exp(0.3 * v / thermal) - np.exp(-0.7 * v / thermal))

    for p, q in zip(result["p"], result["q"], strict=True):
        exact = brentq(lambda v, p=p: kinetics(v) - (p - v) / 1.5, -1.0, 1.0, xtol=1e-15)
        assert q == pytest.approx(exact, abs=1e-10)


def test_an_electrode_that_turns_its_species_over():
    """A given current: what it has carried says all concentrations, and they the voltage."""
    scene = Scene("electrode")
    for name, c in (("Ox", 2.0), ("Red", 1.0)):
        scene.edge(name, "species", name, "ground", volume=1.0, initial={"c": c})
    faraday, gas, current = 96485.33212331, 8.31446261815324, 1e5
    fields = {"oxidised": "Ox.c", "reduced": "Red.c", "electrons": 2.0, "temperature": 300.0}
    scene.edge("N", "nernst", "p", "ground", standard_potential=0.5, **fields)
    scene.edge("I", "current_source", "ground", "p", current=current)
    scene.edge("turned", "molar_flow_source", "Red", "Ox", flow=f"N.i/(2*{faraday})")
    scene.output("v", "p.v")
    result = scene.compile().simulate((0, 1.5), rtol=1e-10, atol=1e-12)
    made = current * result.t / (2 * faraday)
    expected = 0.5 + gas * 300.0 / (2 * faraday) * np.log((2 + made) / (1 - made))
    # A constant rate: no error of integration but rounding.
    np.testing.assert_allclose(result["v"], expected, rtol=0, atol=1e-13)


def test_dry_friction_holds_what_viscous_friction_lets_slip():
    scene = Scene("slip")
    scene.edge("pull", "velocity_source", "ground", "a", velocity=1.0)
    scene.edge("k", "translational_spring", "a", "b", stiffness=10.0)
    fields = {"force": 2.0, "damping": 0.5, "transition": 0.01}
    scene.edge("F", "translational_friction", "ground", "b", **fields)
    scene.output("v", "b.v")
    scene.output("pull", "-k.f")
    result = scene.compile().simulate((0, 3), t_eval=[0.1, 3.0], **SETTINGS)
    # It creeps at first, and slides with the source in the end: 2 + 0.5 in steady motion.
    assert 0.0 < result["v"][0] < 0.01
    assert result["v"][-1] == pytest.approx(1.0, abs=1e-6)
    assert result["pull"][-1] == pytest.approx(2.5, abs=1e-6)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("method", ["auto", "cvode", "rodas5", "ida"])
def test_the_shipped_rectifier_by_several_methods(method):
    """Refused steps lead far ahead; solutions found there are poor guesses for shorter ones."""
    result = load("bridge-rectifier").compile().simulate(method=method)
    assert result.success
    # Four ways agree to 1e-6; tolerances are 1e-8 per step, of some hundred steps.
    assert result["voltage"][-1] == pytest.approx(10.01079, abs=1e-5)
