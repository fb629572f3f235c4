"""Inputs of a run: number, expression, table, function; against integrals known by hand."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest

import cotree
from cotree.errors import ModelError, ParameterError

pytestmark = pytest.mark.compiler

TIGHT = {"rtol": 1e-11, "atol": 1e-13}
MASS = 2.0
#: A trapezoidal pulse: force 3 N from 1.1 s to 1.2 s, with ramps of 0.1 s. Its integral is 0.6.
PULSE = ([1.0, 1.1, 1.2, 1.3], [0.0, 3.0, 3.0, 0.0])


@pytest.fixture(scope="module")
def mass():
    scene = cotree.Scene("pushed")
    scene.parameter("m", MASS)
    scene.parameter("a", 3.0)
    scene.input("F", 0.0, unit="N")
    scene.edge("guide", "prismatic", "ground", "A", axis=[1, 0, 0], force="F")
    scene.edge("body", "rigid_body", "ground", "A", mass="m")
    scene.output("force", "F")
    return scene.compile(["m"])


CASES = {
    "number": (1.5, 1.5 * 5.0),
    "expression": ("a*sin(t)", 3.0 * (1.0 - math.cos(5.0))),
    "table": (PULSE, 0.6),
    "function": (lambda t: 3.0 * math.sin(t), 3.0 * (1.0 - math.cos(5.0))),
}

METHODS = ["RK45", "LSODA", "BDF", "dop853", "dopri5", "rodas4", "rodas5", "cvode", "ida", "auto"]


@pytest.mark.sampled(5)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", CASES)
def test_momentum_is_the_integral_of_the_force(mass, kind, method):
    if method in ("cvode", "ida"):
        pytest.importorskip("sksundae")
    value, impulse = CASES[kind]
    result = mass.simulate((0, 5), inputs={"F": value}, method=method, **TIGHT)
    assert result.statistics.method == (method if method != "auto" else "dop853")
    # The velocity is a plain integral, which damps nothing: BDF's few hundred local errors of
    # 1e-11 add up.
    assert result["guide.s_dot"][-1] == pytest.approx(impulse / MASS, abs=3e-9)
    along = result.sensitivity("guide.s_dot", "m")[-1]
    assert along == pytest.approx(-impulse / MASS**2, abs=3e-9)


class OfTheUserError(Exception):
    """An exception that the package knows nothing of."""


@pytest.mark.parametrize("wrong", [OfTheUserError, KeyboardInterrupt, ZeroDivisionError])
@pytest.mark.parametrize("method", ["RK45", "dop853", "rodas5", "cvode", "ida"])
def test_what_a_function_raises_comes_out(mass, method, wrong):
    if method in ("cvode", "ida"):
        pytest.importorskip("sksundae")
    calls = []

    def force(t):
        calls.append(t)
        if t > 1.0:
            raise wrong("beyond one second")
        return 1.0

    with pytest.raises(wrong, match="beyond one second"):
        mass.simulate((0, 5), inputs={"F": force}, method=method)
    # Nothing goes on after it: it was the only call that late.
    assert sum(t > 1.0 for t in calls) == 1


@pytest.mark.parametrize("method", ["dop853", "rodas5", "cvode", "ida"])
def test_a_function_without_a_number_is_named(mass, method):
    if method in ("cvode", "ida"):
        pytest.importorskip("sksundae")
    with pytest.raises(ParameterError, match=r"input 'F' is None at t = \d"):
        mass.simulate((0, 5), inputs={"F": lambda t: None if t > 1.0 else 1.0}, method=method)


@pytest.mark.parametrize("method", ["dop853", "rodas5", "cvode"])
def test_a_slow_function_keeps_to_the_time_limit(mass, method):
    if method == "cvode":
        pytest.importorskip("sksundae")

    def slow(t):
        time.sleep(1e-3)
        return math.sin(50.0 * t)

    with pytest.warns(RuntimeWarning, match="time limit of 0.05 s is spent"):
        result = mass.simulate((0, 50), inputs={"F": slow}, method=method, time_limit=0.05)
    assert result.status == -2
    # A look at the clock follows the limit within tenths of a second, of tens that it would take.
    assert result.times["integrate"] < 5.0


@pytest.mark.parametrize("method", ["dop853", "rodas5", "cvode"])
def test_events_with_a_function_as_input(method):
    """A stop at a position: the force 2 t makes t^3 / 3 of it."""
    if method == "cvode":
        pytest.importorskip("sksundae")
    scene = cotree.Scene("pushed")
    scene.input("F", 0.0)
    scene.edge("guide", "prismatic", "ground", "A", axis=[1, 0, 0], force="F")
    scene.edge("body", "rigid_body", "ground", "A", mass=1.0)
    scene.event("there", "guide.s - 9", direction=1, stop=True)
    result = scene.compile().simulate((0, 5), inputs={"F": lambda t: 2.0 * t}, method=method)
    assert result.statistics.method == method
    # Many steps of the default tolerance, 1e-8.
    assert result.t[-1] == pytest.approx(3.0, abs=1e-7)


def test_inputs_and_what_depends_on_them_are_reported(mass):
    t = np.linspace(0, 2, 41)
    result = mass.simulate((0, 2), t_eval=t, inputs={"F": PULSE})
    expected = np.interp(t, *PULSE)
    np.testing.assert_allclose(result["F"], expected, atol=1e-15)
    np.testing.assert_allclose(result["force"], expected, atol=1e-15)


def test_a_short_pulse_is_not_stepped_over(mass):
    late = ([900.0, 900.01, 900.02], [0.0, 100.0, 0.0])
    result = mass.simulate((0, 1000), inputs={"F": late}, method="dop853")
    # The kinks are restarts: nothing is lost however long the steps around them grow.
    assert result["guide.s_dot"][-1] == pytest.approx(0.5, rel=1e-7)


def test_a_scenes_own_table_is_not_stepped_over_either():
    scene = cotree.Scene("pulse")
    scene.input("F", ([900.0, 900.01, 900.02], [0.0, 100.0, 0.0]))
    scene.edge("guide", "prismatic", "ground", "A", axis=[1, 0, 0], force="F")
    scene.edge("body", "rigid_body", "ground", "A", mass=MASS)
    model = scene.compile()
    result = model.simulate((0, 1000), method="dop853")
    assert result["guide.s_dot"][-1] == pytest.approx(0.5, rel=1e-7)
    replaced = model.simulate((0, 1000), method="dop853", inputs={"F": 0.0})
    assert replaced["guide.s_dot"][-1] == 0.0


def test_inputs_of_the_scene_and_of_the_run_agree(mass):
    scene = cotree.Scene("driven")
    scene.parameter("a", 3.0)
    scene.input("F", "a*sin(t) + a*t")
    scene.edge("guide", "prismatic", "ground", "A", axis=[1, 0, 0], force="F")
    scene.edge("body", "rigid_body", "ground", "A", mass=MASS)
    own = scene.compile().simulate((0, 3), parameters={"a": 2.0}, method="dop853", **TIGHT)
    values = {"parameters": {"a": 2.0}, "method": "dop853"}
    given = mass.simulate((0, 3), inputs={"F": "a*sin(t) + a*t"}, **values, **TIGHT)
    assert own["guide.s"][-1] == pytest.approx(given["guide.s"][-1], abs=1e-10)


def test_sensitivity_to_a_parameter_of_the_scenes_own_input():
    scene = cotree.Scene("driven")
    scene.parameter("a", 3.0)
    scene.input("F", "a*t")
    scene.edge("guide", "prismatic", "ground", "A", axis=[1, 0, 0], force="F")
    scene.edge("body", "rigid_body", "ground", "A", mass=MASS)
    result = scene.compile(["a"]).simulate((0, 2), method="dop853", **TIGHT)
    exact = 2.0**2 / 2 / MASS
    assert result.sensitivity("guide.s_dot", "a")[-1] == pytest.approx(exact, abs=1e-10)


@pytest.mark.parametrize(
    ("inputs", "message"),
    [
        ({"G": 1.0}, "no input 'G'"),
        ({"F": "b"}, "the unknown name 'b'"),
        ({"F": ([0, 1], [0])}, "as many values as times"),
        ({"F": math.nan}, "finite number"),
    ],
)
def test_wrong_inputs_are_refused(mass, inputs, message):
    with pytest.raises(ModelError, match=message):
        mass.simulate((0, 1), inputs=inputs)


def test_an_input_whose_sensitivity_is_compiled_in_cannot_be_replaced():
    scene = cotree.Scene("driven")
    scene.parameter("a", 3.0)
    scene.input("F", "a*t")
    scene.edge("guide", "prismatic", "ground", "A", axis=[1, 0, 0], force="F")
    scene.edge("body", "rigid_body", "ground", "A", mass=MASS)
    with pytest.raises(ModelError, match="input 'F' depends on 'a'"):
        scene.compile(["a"]).simulate((0, 1), inputs={"F": 1.0})


def test_an_expression_of_a_sensitivity_parameter_has_its_sensitivity():
    """m v' = 2 a - a v from rest: v = 2 (1 - e^(-a t / m))."""
    scene = cotree.Scene("driven")
    scene.parameter("a", 3.0)
    scene.input("F", 1.0)
    edge = {"axis": [1, 0, 0], "force": "F", "damping": "a"}
    scene.edge("guide", "prismatic", "ground", "A", **edge)
    scene.edge("body", "rigid_body", "ground", "A", mass=MASS)
    result = scene.compile(["a"]).simulate((0, 1), inputs={"F": "2*a"}, **TIGHT)
    exact = 2.0 / MASS * math.exp(-3.0 / MASS)
    assert result.sensitivity("guide.s_dot", "a")[-1] == pytest.approx(exact, abs=1e-10)
