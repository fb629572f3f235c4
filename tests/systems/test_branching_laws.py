"""Laws of users that branch or jump: events where scalar components do, else refused by name."""

from __future__ import annotations

import math

import pytest
import sympy

from cotree import Scene
from cotree.components import COMPONENTS, register_component
from cotree.errors import SceneError

pytestmark = pytest.mark.compiler

TIGHT = {"rtol": 1e-10, "atol": 1e-12}


@pytest.fixture(autouse=True)
def registry():
    before = dict(COMPONENTS)
    yield
    COMPONENTS.clear()
    COMPONENTS.update(before)


def _circuit(law, values, **fields):
    """A capacitor, charged through a resistor, with an element of a user's across it."""
    register_component("own", law, domain="electrical")
    scene = Scene("own-law")
    for name, value in values.items():
        scene.parameter(name, value)
    scene.edge("V", "voltage_source", "a", "ground", voltage="2*cos(3*t)")
    scene.edge("R", "resistor", "a", "b", resistance=0.7)
    scene.edge("C", "capacitor", "b", "ground", capacitance=0.3)
    scene.edge("D", "own", "b", "ground", **(fields or {name: name for name in values}))
    return scene


LAWS = {
    "knee": lambda across, g, c: sympy.Piecewise((0, across < c), (g * (across - c) ** 2, True)),
    "step": lambda across, g, c: sympy.Piecewise((0, across < c), (g, across >= c), (0, True)),
    "several": lambda across, g, c: (
        g * sympy.sign(across - c) + g * sympy.Heaviside(across + c) + sympy.Mod(across, c) / 9
    ),
    "charge": lambda across, across_rate, g, c: (
        across_rate * sympy.Piecewise((g, sympy.And(across < c, across > -c)), (2 * g, True))
    ),
    "counted": lambda across, g, c: g * sympy.ceiling(across / c),
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", list(LAWS))
def test_branches_are_events_with_exact_sensitivities(name):
    values = {"g": 0.3, "c": 0.53}
    model = _circuit(LAWS[name], values).compile(list(values))
    result = model.simulate((0, 2.0), method="dop853", **TIGHT)
    assert sum(len(event.t) for event in result.events.values()) >= 2
    for parameter, value in values.items():
        ends = [
            model.simulate((0, 2.0), parameters={parameter: value * (1 + h)}, **TIGHT)["C.v"][-1]
            for h in (1e-4, -1e-4)
        ]
        # The next term of a difference over 1e-4 is 1e-8 of the value.
        expected = (ends[0] - ends[1]) / (2e-4 * value)
        assert result.sensitivity("C.v", parameter)[-1] == pytest.approx(expected, rel=1e-5)


def test_a_kink_of_a_charge_is_passed_exactly():
    """C(v) v' = 1 with C = 1 + k (v - c) beyond c and 1 below: quadratic in v beyond the kink."""
    register_component(
        "store",
        lambda across, across_rate, k, c: (
            across_rate * sympy.Piecewise((1 + k * (across - c), across > c), (1, True))
        ),
        domain="electrical",
    )
    scene = Scene("kink")
    scene.parameter("k", 30.0)
    scene.parameter("c", 0.37)
    scene.edge("I", "current_source", "ground", "a", current=1.0)
    scene.edge("S", "store", "a", "ground", k="k", c="c")
    model = scene.compile(["k", "c"])
    beyond = (math.sqrt(1 + 2 * 30 * 0.63) - 1) / 30
    for method in ("dop853", "rodas5", "rodas4", "cvode"):
        result = model.simulate((0, 1.0), method=method, **TIGHT)
        assert result["S.v"][-1] == pytest.approx(0.37 + beyond, rel=1e-7), method
        # v = c + x with x + k x^2/2 = t - c: x_c = -1/(1 + k x).
        expected = 1 - 1 / (1 + 30 * beyond)
        assert result.sensitivity("S.v", "c")[-1] == pytest.approx(expected, rel=1e-6), method
        assert result.events["S.v <= c down"].t == pytest.approx([0.37], rel=1e-8)


def test_branches_of_parameters_and_known_times_need_no_events():
    values = {"g": 0.3, "c": 0.5}
    law = lambda across, t, g, c: sympy.Piecewise(  # noqa: E731
        (g * across, sympy.And(c > 0, t < 1)), (2 * g * across, True)
    )
    assert _circuit(law, values).compile(["g"]).states == ("C.v",)


def _falling(law, along="line"):
    register_component("own", law, along=along)
    scene = Scene("falling", gravity=[0, 0, -9.81])
    scene.parameter("k", 2.0)
    scene.edge("j", "prismatic", "ground", "B", axis=[0, 0, 1], initial={"s": 1.0})
    scene.edge("b", "rigid_body", "ground", "B", mass=1.0)
    scene.edge("o", "own", "ground", "B", k="k")
    return scene


@pytest.mark.parametrize(
    "law",
    [
        lambda length, rate, k: sympy.Piecewise((k * (1 - length) - rate, length < 1), (0, True)),
        lambda length, k: k * sympy.floor(length),
        lambda length, rate, k: k * sympy.sign(rate),
    ],
)
def test_force_laws_that_jump_are_refused_with_sensitivities(law):
    scene = _falling(law)
    with pytest.raises(SceneError, match="the law of edge 'o', of type 'own', jumps"):
        scene.compile(["k"])
    scene.compile()


def test_force_laws_with_corners_are_taken():
    scene = _falling(lambda length, k: sympy.Piecewise((k * (1 - length), length < 1), (0, True)))
    assert scene.compile(["k"]).states == ("j.s", "j.s_dot")
