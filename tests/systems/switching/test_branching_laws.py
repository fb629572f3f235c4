"""Laws of users that branch or jump: events where scalar components do, else refused by name."""

from __future__ import annotations

import math

import pytest
import sympy
from scipy.integrate import solve_ivp

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
    "knee": lambda across, g, c: sympy.Piecewise((c, across < c), (g * (across - c) ** 2, True)),
    "step": lambda across, g, c: sympy.Piecewise((0, across < c), (g, across >= c), (0, True)),
    "several": lambda across, g, c: (
        g * sympy.sign(across - c) + g * sympy.Heaviside(across + c) + sympy.Mod(across, c) / 9
    ),
    "charge": lambda across, across_rate, g, c: (
        across_rate * sympy.Piecewise((g, sympy.And(across < c, across > -c)), (2 * g, True))
    ),
    "counted": lambda across, g, c: g * sympy.ceiling(across / c),
    "quotient": lambda across, g, c: g * sympy.sign(across / c - 1) + g * across / c,
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


CONTINUOUS = {
    "knee": lambda across, g, c: sympy.Piecewise((0, across < c), (g * (across - c) ** 2, True)),
    "diode": lambda across, g, c: sympy.Piecewise(
        (g * across, across < c), ((across - c) * 40 + g * c, True)
    ),
    "powers": lambda across, g, c: sympy.Piecewise(
        (g * (across - c) ** sympy.Rational(3, 2), across > c), (0, True)
    ),
    "signed": lambda across, g, c: g * sympy.sign(across - c) * sympy.sqrt(abs(across - c)),
    "exchanged": lambda across, g, c: sympy.Piecewise(
        (-g * (sympy.exp(-across) - 1), across < 0), (g * (sympy.exp(across) - 1), True)
    ),
    "clipped": lambda across, g, c: g * sympy.Max(0, across - c, 2 * (across - c)),
}


@pytest.mark.parametrize("name", list(CONTINUOUS))
def test_laws_whose_branches_meet_have_no_events(name):
    """Charged across the corner, and from rest on it; against the same law as an expression."""
    values = {"g": 0.3, "c": 0.53}
    model = _circuit(CONTINUOUS[name], values).compile()
    assert model.states == ("C.v",)
    start = 0.0 if name == "exchanged" else 0.53
    function = sympy.lambdify(
        (across := sympy.Symbol("across", real=True), *sympy.symbols("g c")),
        CONTINUOUS[name](across, *sympy.symbols("g c")),
        modules="math",
    )
    # The slope of a root has no value on its corner, which implicit methods need.
    for initial in (start, start + 0.4)[name == "signed" :]:
        exact = solve_ivp(
            lambda t, v: [((2 * math.cos(3 * t) - v[0]) / 0.7 - function(v[0], 0.3, 0.53)) / 0.3],
            (0, 2.0),
            [initial],
            method="Radau",
            rtol=1e-10,
            atol=1e-12,
            max_step=0.01,
        )
        for method in ("dop853", "rodas5", "cvode"):
            result = model.simulate((0, 2.0), initial={"C.v": initial}, method=method, **TIGHT)
            # Multistep methods err by some hundred tolerances, Radau by as much.
            assert result["C.v"][-1] == pytest.approx(exact.y[0, -1], abs=1e-7), method


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
