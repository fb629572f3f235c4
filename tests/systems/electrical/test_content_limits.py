"""Refusals and warnings of storages by content, and their starts."""

from __future__ import annotations

import re

import numpy as np
import pytest
import sympy

from cotree import Scene
from cotree.components import COMPONENTS, register_component
from cotree.errors import FormulationError, ParameterError, SceneError, SingularSystemError


def driven(charge="c*(C.v + C.v**3)", source="E + 0.1*sin(1e9*t)", **given):
    """Drive a capacitor of some picofarads through a resistor."""
    scene = Scene("driven")
    for name, value in (("R", 1e3), ("E", 1.5), ("c", 1e-12), ("v1", 0.5)):
        scene.parameter(name, value)
    scene.edge("V", "voltage_source", "a", "ground", voltage=source)
    scene.edge("R", "resistor", "a", "b", resistance="R")
    scene.edge("C", "nonlinear_capacitor", "b", "ground", charge=charge, **given)
    return scene


def second(charge="c*C2.v", **given):
    """Put another one beside it."""
    scene = driven(**given.pop("first", {}))
    scene.edge("C2", "nonlinear_capacitor", "b", "ground", charge=charge, **given)
    return scene


def test_tolerances_of_charges_are_those_of_their_voltages():
    """Charges of 1e-12 C would pass any test at the default of 1e-10."""
    model = driven().compile(["R", "c"])
    settings = {"t_eval": [5e-9], "rtol": 1e-12, "atol": 1e-14}
    exact = model.simulate((0, 5e-9), method="dop853", **settings)
    for method in ("dopri5", "rkf45", "dop853", "rodas4", "rodas5", "cvode", "ida"):
        result = model.simulate((0, 5e-9), method=method, t_eval=[5e-9], rtol=1e-8)
        # Errors of a hundred steps or two.
        np.testing.assert_allclose(result["C.v"], exact["C.v"], rtol=1e-7)
        np.testing.assert_allclose(result.s[1], exact.s[1], rtol=1e-6)


def test_a_run_says_where_a_tolerance_of_charge_says_little_of_voltage():
    scene = driven("c*(tanh(C.v) + 1e-6*C.v)", "9*t/(1e-9 + t)", initial={"v": 0.1})
    with pytest.warns(RuntimeWarning, match=r"tolerance of 'C\.q' allows errors of .* in 'C\.v'"):
        scene.compile().simulate((0, 2e-8))


def test_a_corner_of_a_charge_is_an_event():
    """It is a jump of capacitance, which a step of high order would pass over many times."""
    scene = driven("where(C.v > v1, c*v1 + 3*c*(C.v - v1), c*C.v)", "E")
    model = scene.compile(["c", "v1"])
    # v = E (1 - exp(-t / R c)) up to v1, then E - (E - v1) exp(-(t - t1) / 3 R c).
    e, r, c, v1, t = sympy.symbols("E R c v1 t", positive=True)
    v = e - (e - v1) * sympy.exp(-(t + r * c * sympy.log((e - v1) / e)) / (3 * r * c))
    at = {e: 1.5, r: 1e3, c: 1e-12, v1: 0.5, t: 2e-9}
    for method in ("dopri5", "rodas5", "cvode"):
        result = model.simulate((0, 2e-9), method=method, t_eval=[2e-9], rtol=1e-9)
        assert result["C.v"][-1] == pytest.approx(float(v.subs(at)), rel=1e-7)
        exact = [float(v.diff(p).subs(at)) for p in (c, v1)]
        np.testing.assert_allclose(result.s[-1, :, -1], exact, rtol=1e-6)
        assert result.statistics.n_steps < 400


@pytest.mark.parametrize(
    "charge", ["where(C.v > v1, 3*c*C.v, c*C.v)", "c*(C.v + 0.1*sign(C.v - v1))", "c*floor(C.v)"]
)
def test_a_charge_that_jumps_is_refused(charge):
    with pytest.raises(SceneError, match=r"edge 'C'.*discontinuous"):
        driven(charge).compile()


def test_a_charge_of_nothing_of_its_own_is_refused():
    with pytest.raises(FormulationError, match="'C' does not depend on its own voltage"):
        driven("2*c").compile()


@pytest.mark.parametrize("charge", ["c*C.v**2", "c*(C.v**3 + 3*C.v**2)"])
def test_where_charge_does_not_grow_the_edge_is_named(charge):
    with pytest.raises(SingularSystemError, match=r"do not determine 'C\.v'"):
        driven(charge).compile().start()


def test_initial_values_that_contradict_each_other_are_refused():
    both = re.escape("initial values of both 'C.q' and 'C.v'")
    with pytest.raises(ParameterError, match=both):
        driven(initial={"v": 0.5, "q": 0.625e-12}).compile()
    model = driven().compile()
    with pytest.raises(ParameterError, match=r"'C\.v' is given as 0\.4 but is 0\.5 by 'C\.q'"):
        model.start(initial={"C.v": 0.4, "C.q": 0.625e-12})
    with pytest.raises(ParameterError, match=r"'C2\.v' is given as 0\.5 but is 0\.4"):
        second(first={"initial": {"v": 0.4}}, initial={"v": 0.5}).compile().start()
    with pytest.raises(
        ParameterError,
        match=r"'C2\.q' cannot have an initial value of its own.*initial values of 'v'",
    ):
        second(first={"initial": {"v": 0.4}}, initial={"q": 1e-13}).compile()
    start = second(first={"initial": {"v": 0.4}}, initial={"v": 0.4}).compile().start()
    assert start.y[0] == pytest.approx((0.4 + 0.4**3 + 0.4) * 1e-12, rel=1e-14)


def test_a_start_from_charge_has_sensitivities_of_either():
    start = driven(initial={"q": "2*c"}).compile(["c", "C.q", "C.v"]).start()
    # c (v + v^3) = 2 c at v = 1, where dq/dv = 4 c.
    np.testing.assert_allclose(start.y, [2e-12, 1.0], rtol=1e-12)
    exact = [[2.0, 1.0, 4e-12], [0.0, 0.25e12, 1.0]]
    np.testing.assert_allclose(start.s, exact, rtol=1e-12, atol=1e-10)


def test_operating_points_and_linearisation():
    scene = driven("c*(C.v + C.v**3)", initial={"v": 0.1})
    scene.simulation(start="operating point")
    model = scene.compile(["E", "c"])
    start = model.start()
    np.testing.assert_allclose(start.y, [4.875e-12, 1.5], rtol=1e-12)
    np.testing.assert_allclose(start.s, [[7.75e-12, 4.875], [1.0, 0.0]], rtol=1e-12, atol=1e-12)
    about = model.linearize(0.0, start.y)
    assert about.states == ("C.q",)
    assert about.A[0, 0] == pytest.approx(-1 / (1e3 * 7.75e-12), rel=1e-12)


def test_events_set_charges():
    scene = driven("c*C.v", "E")
    scene.event("discharge", "C.v - 1", direction=1, set={"C.q": 0.0})
    model = scene.compile(["E"])
    result = model.simulate((0, 2e-9), rtol=1e-10)
    # It rises to 1 V in R c log(E / (E - 1)), then once more.
    first = 1e-9 * np.log(3.0)
    slope = 1e-9 * (1 / 1.5 - 1 / 0.5)
    np.testing.assert_allclose(result.events["discharge"].t, [first], rtol=1e-8)
    last = 1.5 * (1 - np.exp(-(2e-9 - first) / 1e-9))
    assert result["C.v"][-1] == pytest.approx(last, rel=1e-8)
    by_source = last / 1.5 - 1.5 * np.exp(-(2e-9 - first) / 1e-9) * slope / 1e-9
    assert result.s[1, 0, -1] == pytest.approx(by_source, rel=1e-7)
    scene.event("voltage", "C.v - 2", set={"C.v": 0.0})
    with pytest.raises(SceneError, match=r"sets 'C\.v', an algebraic unknown"):
        scene.compile()


@pytest.mark.parametrize(
    ("law", "domain", "told"),
    [
        (lambda across, across_rate, c: c * across * across_rate, "electrical", "of no rate"),
        (lambda c: c, "electrical", "a function of across, or of through"),
        (lambda across, through, c: c * across * through, "electrical", "of across, or of through"),
        (lambda stretch, c: c * stretch, "translational", "stretch or potential"),
        (lambda through, c: c * through, "thermal", "no such storage"),
        (lambda through, c: c * through, "translational", "give through as a function of stretch"),
    ],
)
def test_laws_that_give_no_content_are_refused(law, domain, told):
    with pytest.raises(SceneError, match=told):
        register_component("odd", law, domain=domain, gives="content")
    assert "odd" not in COMPONENTS


def test_what_laws_give_is_checked():
    law = {"a": lambda across, c: c * across}
    for gives, told in (("charge", "give one of"), ({"b": "content"}, "not one of its ports")):
        with pytest.raises(SceneError, match=told):
            register_component("odd", law, domain="electrical", gives=gives)


def test_one_port_holds_and_another_conducts():
    """Laws of one component may give different things, port by port."""
    laws = {"q": lambda across, c: c * across, "i": lambda across_q, g: g * across_q}
    places = {"terminals": ("A", "B"), "between": {"q": ("A", "B"), "i": ("A", "B")}}
    gives = {"q": "content", "i": "through"}
    register_component("leaky", laws, domain="electrical", gives=gives, **places)
    try:
        scene = Scene("leak")
        scene.edge("C", "leaky", "n", "ground", c=2.0, g=0.5, initial={"q.v": 1.0})
        model = scene.compile()
        assert model.states == ("C.q.q", "C.q.v")
        result = model.simulate((0, 4), rtol=1e-9)
        assert result["C.q.v"][-1] == pytest.approx(np.exp(-1.0), rel=1e-8)
    finally:
        COMPONENTS.pop("leaky")
