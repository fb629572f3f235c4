"""Derivatives of linearisations and of their eigenvalues, and what other libraries take of them."""

from __future__ import annotations

import numpy as np
import pytest
from readme_linkage import four_bar

import cotree

pytestmark = pytest.mark.compiler

M, C, K = 1.5, 0.4, 60.0


@pytest.fixture(scope="module")
def oscillator():
    scene = cotree.Scene("oscillator")
    for name, value in (("m", M), ("c", C), ("k", K)):
        scene.parameter(name, value)
    scene.input("F", 0.0)
    joint = {"axis": [1, 0, 0], "force": "F", "stiffness": "k", "damping": "c"}
    scene.edge("j", "prismatic", "ground", "A", **joint)
    scene.edge("b", "rigid_body", "ground", "A", mass="m")
    scene.output("pull", "k*j.s")
    return scene.compile()


def test_matrices_of_an_oscillator_have_the_derivatives_of_their_closed_form(oscillator):
    linear = oscillator.linearize(sensitivities=["m", "c", "k"])
    by_m = linear.sensitivity("m")
    np.testing.assert_allclose(by_m.A, [[0, 0], [K / M**2, C / M**2]], rtol=1e-14)
    np.testing.assert_allclose(by_m.B, [[0], [-1 / M**2]], rtol=1e-14)
    np.testing.assert_allclose(linear.sensitivity("c").A, [[0, 0], [0, -1 / M]], rtol=1e-14)
    np.testing.assert_allclose(linear.sensitivity("k").C, [[1, 0]], rtol=1e-14)


def test_eigenvalues_of_an_oscillator_have_the_derivatives_of_their_closed_form(oscillator):
    linear = oscillator.linearize(sensitivities=["m", "c", "k"])
    pole = linear.eigenvalues[0]
    assert pole == pytest.approx(-C / (2 * M) + 1j * np.sqrt(K / M - (C / (2 * M)) ** 2), rel=1e-13)
    # From m z^2 + c z + k = 0.
    bottom = 2 * M * pole + C
    for name, top in (("m", pole**2), ("c", pole), ("k", 1.0)):
        found = linear.eigenvalue_sensitivity(name)
        np.testing.assert_allclose(found, [-top / bottom, np.conj(-top / bottom)], rtol=1e-12)


def test_coinciding_eigenvalues_are_refused(oscillator):
    critical = {"c": 2 * np.sqrt(K * M)}
    linear = oscillator.linearize(p=critical, sensitivities=["c"])
    with pytest.raises(cotree.SingularSystemError, match="is a multiple eigenvalue"):
        linear.eigenvalue_sensitivity("c")


def cart_pole():
    scene = cotree.Scene("cart-pole", gravity=[0, -9.81, 0])
    scene.parameter("l", 0.7)
    scene.parameter("m", 0.3)
    scene.input("F", 0.0)
    scene.edge("x", "prismatic", "ground", "A", axis=[1, 0, 0], force="F", damping=0.1)
    scene.edge("cart", "rigid_body", "ground", "A", mass=1.2)
    scene.edge("q", "revolute", "A", "B", axis=[0, 0, 1], initial={"theta": 0.4})
    scene.edge("rod", "arm", "B", "C", vector=[0, "l", 0])
    scene.edge("bob", "rigid_body", "ground", "C", mass="m")
    scene.output("tip", "x.s - l*sin(q.theta)")
    return scene.compile(["l", "q.theta"])


def differences(at, value, step):
    """Four-point differences, whose error is of order step^4, of the matrices of a system."""
    rows = [at(value + k * step) for k in (-2, -1, 1, 2)]
    weights = np.array([1.0, -8.0, 8.0, -1.0]) / (12.0 * step)
    return [
        sum(w * getattr(row, name) for w, row in zip(weights, rows, strict=True)) for name in "ABCD"
    ]


def test_a_cart_with_a_pole_agrees_with_differences():
    model = cart_pole()
    linear = model.linearize(sensitivities=["l", "m", "F", "q.theta"], u=[2.0])
    u = [2.0]
    ways = {
        "l": lambda v: model.linearize(p={"l": v}, u=u),
        "m": lambda v: model.linearize(p={"m": v}, u=u),
        "F": lambda v: model.linearize(u=[v]),
        "q.theta": lambda v: model.linearize(y=[0, v, 0, 0], u=u),
    }
    for (name, at), value in zip(ways.items(), (0.7, 0.3, 2.0, 0.4), strict=True):
        slopes = linear.sensitivity(name)
        found = [slopes.A, slopes.B, slopes.C, slopes.D]
        for own, other in zip(found, differences(at, value, 1e-3), strict=True):
            # h^4 = 1e-12 times a fifth derivative, and rounding of 1e-13 / h.
            np.testing.assert_allclose(own, other, atol=1e-8)


def loop():
    scene = four_bar()
    scene.parameter("mass", 1.0)
    scene.edge("extra", "rigid_body", "ground", "C", mass="mass")
    return scene.compile(["mass"])


def test_a_closed_loop_is_differentiated_in_independent_deviations_along_its_equilibrium():
    model = loop()

    def at(value):
        point = model.trim(p={"mass": value})
        return point.linearize(reduced=True)

    slopes = model.trim().linearize(reduced=True, sensitivities=["mass"]).sensitivity("mass")
    expected = differences(at, 1.0, 1e-2)
    # h^4 = 1e-8 times fifth derivatives well below one hundredth of the slope.
    np.testing.assert_allclose(slopes.A, expected[0], rtol=1e-7, atol=1e-9)


def test_starts_are_followed_where_asked_for():
    scene = cotree.Scene("falling", gravity=[0, -9.81, 0])
    scene.parameter("L", 2.0)
    scene.edge("j", "revolute", "ground", "A", axis=[0, 0, 1], initial={"theta": "0.2*L"})
    scene.edge("rod", "arm", "A", "B", vector=[0, "-L", 0])
    scene.edge("bob", "rigid_body", "ground", "B", mass=1.0)
    model = scene.compile(["L"])
    held = model.linearize(sensitivities="L").sensitivity("L").A[1, 0]
    total = model.linearize(sensitivities="L", total=True).sensitivity("L").A[1, 0]
    # A[1, 0] = -g cos(0.2 L) / L.
    assert held == pytest.approx(9.81 * np.cos(0.4) / 4.0, rel=1e-13)
    assert total == pytest.approx(held + 9.81 * np.sin(0.4) * 0.2 / 2.0, rel=1e-13)
    with pytest.raises(cotree.ParameterError, match="y was given"):
        model.linearize(y=[0.1, 0.0], sensitivities="L", total=True)


def test_an_algebraic_unknown_follows():
    scene = cotree.Scene("clamp")
    scene.parameter("R", 1e3)
    scene.parameter("n", 0.04)
    scene.edge("v", "voltage_source", "a", "ground", voltage=5.0)
    scene.edge("r", "resistor", "a", "b", resistance="R")
    scene.edge("d", "diode", "b", "e", saturation_current=1e-9, thermal_voltage="n")
    scene.edge("r2", "resistor", "e", "f", resistance="R")
    scene.edge("c", "capacitor", "f", "ground", capacitance=1e-6, initial={"v": 1.0})
    model = scene.compile()
    for name, value in (("R", 1e3), ("n", 0.04)):
        slope = model.linearize(sensitivities=[name]).sensitivity(name).A

        def at(v, name=name):
            return model.linearize(p={name: v})

        np.testing.assert_allclose(slope, differences(at, value, 1e-3 * value)[0], rtol=1e-8)


def test_other_libraries_take_a_linear_system(oscillator):
    linear = oscillator.linearize()
    plain = linear.to_scipy()
    np.testing.assert_array_equal(plain.A, linear.A)
    control = pytest.importorskip("control")
    system = linear.to_control()
    assert system.state_labels == ["j_s", "j_s_dot"]
    assert (system.input_labels, system.output_labels) == (["F"], ["pull"])
    # The force of the spring over the force at rest is one.
    assert control.dcgain(system) == pytest.approx(1.0, rel=1e-12)


def test_derivatives_that_were_not_asked_for_are_refused(oscillator):
    linear = oscillator.linearize(sensitivities=["m"])
    with pytest.raises(
        cotree.ParameterError, match=r"with respect to 'k' were not requested.*'m'|m"
    ):
        linear.sensitivity("k")
    with pytest.raises(cotree.ParameterError, match="'mm' is not a tunable parameter"):
        oscillator.linearize(sensitivities=["mm"])
