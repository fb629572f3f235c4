"""A tank that overflows: a root of a clipped level, with its closed form.

The level v follows v' = 1 - c sqrt(max(v - 1, 0)) from zero. It is t until t = 1. After that, with
z = sqrt(v - 1): t - 1 = -2/c (z + ln(1 - c z) / c).
"""

from __future__ import annotations

import math

import numpy as np
import pytest
import sympy
from scipy.optimize import brentq

import cotree

C, END = 0.8, 3.0


def _root(c):
    def late(z):
        return -2 / c * (z + math.log(1 - c * z) / c) - (END - 1)

    return brentq(late, 1e-6, (1 - 1e-12) / c, xtol=1e-15)


LEVEL = 1 + _root(C) ** 2
# A central difference of the closed form: truncation 1e-10, rounding 1e-11.
SLOPE = (_root(C + 1e-5) ** 2 - _root(C - 1e-5) ** 2) / 2e-5

LAWS = (
    "c*sqrt(max(C.v - 1, 0))",
    "c*max(C.v - 1, 0)**0.5",
    "c*sqrt(0.5*(C.v - 1 + abs(C.v - 1)))",
    "sqrt(max(c**2*(C.v - 1), 0))",
    "c*sqrt(where(C.v > 1, C.v - 1, 0))",
    "where(C.v > 1, c*sqrt(C.v - 1), 0)",
)


def _tank(law=None):
    scene = cotree.Scene("tank")
    scene.parameter("c", C)
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0)
    scene.edge("I", "current_source", "ground", "a", current=1.0)
    if law is not None:
        scene.edge("o", "current_source", "a", "ground", current=law)
    return scene


def _check(model, method):
    result = model.simulate((0, END), method=method, rtol=1e-8, time_limit=10)
    assert result.status == 0, result.message
    # Five tolerances of the level: a step ends where the overflow begins.
    assert result["C.v"][-1] == pytest.approx(LEVEL, abs=1e-7)
    assert result.sensitivity("C.v", "c")[-1] == pytest.approx(SLOPE, abs=1e-7)


@pytest.mark.parametrize("law", LAWS)
def test_every_way_to_write_an_overflow(law):
    model = _tank(law).compile(["c"])
    for method in ("dop853", "rodas5"):
        _check(model, method)
    # Below the edge nothing flows out, whatever the level.
    assert model.linearize().A.tolist() == [[0.0]]


@pytest.mark.parametrize("method", ["cvode", "ida"])
def test_methods_of_sundials(method):
    _check(_tank(LAWS[0]).compile(["c"]), method)


def test_the_clip_may_stand_in_another_edge():
    scene = _tank("c*sqrt(E.i)")
    scene.edge("E", "current_source", "b", "ground", current="max(C.v - 1, 0)")
    scene.edge("R", "resistor", "b", "ground", resistance=1.0)
    _check(scene.compile(["c"]), "rodas5")


def test_a_registered_law():
    cotree.register_component(
        "weir_of_test",
        lambda across, coefficient, edge: coefficient * sympy.sqrt(sympy.Max(across - edge, 0)),
        domain="electrical",
        units={"coefficient": "A", "edge": "V"},
    )
    scene = _tank()
    scene.edge("o", "weir_of_test", "a", "ground", coefficient="c", edge=1.0)
    _check(scene.compile(["c"]), "rodas5")


def test_lanes_of_an_ensemble():
    model = _tank(LAWS[0]).compile(["c"])
    values = np.linspace(0.7, 0.9, 8)
    for method in ("dopri5", "rodas5"):
        result = model.ensemble((0, END), {"c": values}, t_eval=[END], method=method, rtol=1e-8)
        expected = [1 + _root(c) ** 2 for c in values]
        assert result["C.v"].values[:, -1] == pytest.approx(expected, abs=1e-7)


def test_trim_of_a_level():
    """The level at rest is 1 + 1 / c^2."""
    model = _tank(LAWS[0]).compile(["c"])
    found = model.trim(guess={"C.v": 3.0})
    assert found["C.v"] == pytest.approx(1 + 1 / C**2, rel=1e-8)


def _preloaded_law(across, a, b):
    return sympy.Piecewise((a + sympy.sqrt(across - b), across > b), (0, True))


@pytest.mark.parametrize("is_registered", [False, True])
@pytest.mark.parametrize("method", ["dop853", "dopri5", "rodas5", "cvode", "ida"])
def test_a_root_ends_where_its_law_jumps(method, is_registered):
    """C v' = -I - (a + sqrt(v - b)) while v > b, then -I: b is reached at t = 2 - 2 A ln(1 + 1/A).

    With A = I + a and w = sqrt(v - b), 2 w w' = -(A + w), from w = 1. Steps end slightly beyond b.
    """
    scene = cotree.Scene("preloaded")
    scene.parameter("a", 0.3)
    scene.parameter("b", 0.2)
    scene.edge("C", "capacitor", "n", "ground", capacitance=1.0, initial={"v": 1.2})
    scene.edge("I", "current_source", "n", "ground", current=0.5)
    if is_registered:
        cotree.register_component(
            "preloaded_valve", _preloaded_law, domain="electrical", gives="through"
        )
        scene.edge("V", "preloaded_valve", "n", "ground", a="a", b="b")
    else:
        law = "where(C.v > b, a + sqrt(C.v - b), 0)"
        scene.edge("V", "current_source", "n", "ground", current=law)
    result = scene.compile(["a"]).simulate((0, 2), rtol=1e-8, atol=1e-10, method=method)
    assert result.status == 0, result.message
    A, way = 0.8, math.log(1.0 + 1.0 / 0.8)
    # Multistep methods begin anew at the jump: some hundreds of tolerances.
    assert result["C.v"][-1] == pytest.approx(0.2 - 0.5 * (2.0 - 2.0 * (1.0 - A * way)), abs=1e-6)
    slope = -0.5 * 2.0 * (way - 1.0 / (A + 1.0))
    assert result.sensitivity("C.v", "a")[-1] == pytest.approx(slope, abs=1e-5)


@pytest.mark.parametrize("method", ["rodas4", "rodas5", "ida"])
@pytest.mark.parametrize("law", ["where(C.v > 0, sqrt(C.v), 0)", "sqrt(max(C.v, 0))"])
def test_steps_that_a_root_makes_too_short_say_so(law, method):
    """Beside the root that the sensitivity has in time, the shortest step is too long."""
    scene = cotree.Scene("drained")
    scene.parameter("k", 1.0)
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0, initial={"v": 1.0})
    scene.edge("I", "current_source", "a", "ground", current=f"k*{law} - 0.3*sin(3*t)")
    model = scene.compile(["k"])
    rtol = 1e-10 if method == "ida" else 1e-12
    with pytest.warns(RuntimeWarning, match=r"'C\.v' has an infinite slope in 'C\.v' at t = 1\.66"):
        assert model.simulate((0, 3), method=method, rtol=rtol, atol=0.01 * rtol).status < 0
    assert model.simulate((0, 3), method=method, rtol=1e-7, atol=1e-9).status == 0


@pytest.mark.parametrize("rtol", [1e-8, 1e-9])
@pytest.mark.parametrize("method", ["auto", "dop853", "rodas5"])
def test_sensitivities_pass_a_valve_that_closes(method, rtol):
    """The valve opens by 0.2 V and closes; its flow has an infinite slope there."""
    scene = cotree.Scene("valve")
    scene.parameter("q", 1.0)
    flow = "2*sqrt(max(A.v - B.v - 0.2, 0))"
    for name, current in (("A", f"3*sin(4*t) - {flow}"), ("B", f"{flow} - q*B.v")):
        scene.edge(name, "capacitor", name, "ground", capacitance=1.0)
        scene.edge(f"I{name}", "current_source", "ground", name, current=current)
    model = scene.compile(["q"])
    result = model.simulate((0, 3), method=method, rtol=rtol, atol=0.01 * rtol)
    assert result.status == 0, result.message
    ends = [
        model.simulate((0, 3), parameters={"q": q}, rtol=1e-11, atol=1e-13, sensitivities=False)
        for q in (1.0 + 1e-5, 1.0 - 1e-5)
    ]
    for state in ("A.v", "B.v"):
        expected = (ends[0][state][-1] - ends[1][state][-1]) / 2e-5
        # The root of the rounding of time is 1e-7, of several closings.
        assert result.sensitivity(state, "q")[-1] == pytest.approx(expected, abs=1e-5)
