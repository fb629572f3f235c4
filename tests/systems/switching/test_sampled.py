"""Sampled inputs: called at their times, held between; against discrete linear systems."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm

import cotree
from cotree.errors import ParameterError

pytestmark = pytest.mark.compiler

PERIOD, GAINS = 0.02, (40.0, 8.0)


@pytest.fixture(scope="module")
def pole() -> cotree.Model:
    return cotree.load("cart-pole").compile()


def _law(t, x):
    return -GAINS[0] * x["hinge.theta"] - GAINS[1] * x["hinge.theta_dot"]


def _discrete(model: cotree.Model, x: np.ndarray, n: int) -> np.ndarray:
    """The linear system with a zero-order hold, after n periods."""
    linear = model.linearize(y=np.zeros(4))
    both = np.block([[linear.A, linear.B], [np.zeros((1, 5))]])
    step = expm(PERIOD * both)
    K = np.array([[0.0, GAINS[0], 0.0, GAINS[1]]])
    return np.linalg.matrix_power(step[:4, :4] - step[:4, 4:] @ K, n) @ x


@pytest.mark.parametrize("method", ["auto", "rodas5", "cvode", "DOP853", "LSODA"])
def test_a_held_feedback_is_the_discrete_system(pole, method):
    if method == "cvode":
        pytest.importorskip("sksundae")
    calls = []

    def law(t, x):
        calls.append(t)
        return _law(t, x)

    small = {"hinge.theta": 1e-4}
    result = pole.simulate(
        (0, 1),
        inputs={"push": cotree.sampled(law, PERIOD)},
        initial=small,
        method=method,
        rtol=1e-9,
        atol=1e-14,
    )
    exact = _discrete(pole, np.array([0.0, 1e-4, 0.0, 0.0]), 50)
    # The square of the angle, 1e-8, and 50 times a few steps at the tolerance, of multistep
    # methods that begin anew each time.
    np.testing.assert_allclose(result.y[:, -1], exact, atol=2e-11)
    # One call for each period that begins in the run, whatever probes and methods there were.
    np.testing.assert_allclose(calls, PERIOD * np.arange(50), atol=1e-15)


def test_values_are_held_and_read_before_they_change(pole):
    seen = []

    def law(t, x):
        seen.append((t, x["tip"], dict(x)["rail.s"]))
        return t

    t = np.linspace(0, 0.1, 21)
    result = pole.simulate((0, 0.1), t, inputs={"push": cotree.sampled(law, PERIOD)})
    # At the time of a sample the value is still the one before; the first acts from the start on.
    held = np.maximum(np.ceil(t / PERIOD - 1e-9) - 1, 0) * PERIOD
    np.testing.assert_allclose(result["push"], held, atol=1e-15)
    tips = [tip for _, tip, _ in seen]
    np.testing.assert_allclose(tips, result["tip"][0:20:4], atol=1e-12)
    assert len(seen) == 5


def test_functions_of_time_have_sensitivities():
    """m v' = a_k: what is held adds up, and no sample knows of m."""
    scene = cotree.Scene("pushed")
    scene.parameter("m", 2.0)
    scene.input("F", 0.0)
    scene.edge("guide", "prismatic", "ground", "A", axis=[1, 0, 0], force="F")
    scene.edge("body", "rigid_body", "ground", "A", mass="m")
    model = scene.compile(["m"])
    result = model.simulate((0, 1), inputs={"F": cotree.sampled(math.cos, 0.1)})
    impulse = 0.1 * sum(math.cos(0.1 * k) for k in range(10))
    assert result["guide.s_dot"][-1] == pytest.approx(impulse / 2.0, abs=1e-12)
    along = result.sensitivity("guide.s_dot", "m")[-1]
    assert along == pytest.approx(-impulse / 4.0, abs=1e-10)
    with pytest.raises(ParameterError, match="whose derivatives are unknown"):
        model.simulate((0, 1), inputs={"F": cotree.sampled(lambda t, x: 0.0, 0.1)})


def test_sampled_sources_of_networks():
    """The source of an RC circuit: an unknown follows it at once, from the first sample on."""
    scene = cotree.Scene("circuit")
    scene.input("u", 5.0)
    scene.edge("V", "voltage_source", "a", "ground", voltage="u")
    scene.edge("R", "resistor", "a", "b", resistance=1.0)
    scene.edge("C", "capacitor", "b", "ground", capacitance=1.0)
    scene.edge("D", "diode", "b", "ground", saturation_current=1e-12)
    scene.output("through", "R.i")
    law = cotree.sampled(lambda t, x: 0.4 if t < 0.35 else x["C.v"], 0.1)
    result = scene.compile().simulate((0, 1), inputs={"u": law}, rtol=1e-10)
    # Up to 0.4 s the diode conducts nothing to speak of: 1e-5 A at 0.4 V.
    at = 0.4 * (1.0 - math.exp(-0.4))
    place = int(np.argmin(abs(result.t - 0.4)))
    assert result["C.v"][place] == pytest.approx(at, abs=1e-6)
    assert result["through"][place] == pytest.approx(0.4 - at, abs=1e-6)
    # From then on the source follows the capacitor, whose charge stays.
    assert result["C.v"][-1] == pytest.approx(at, abs=1e-5)


@pytest.mark.parametrize(
    ("make", "span", "message"),
    [
        (lambda: cotree.sampled(_law, 0.0), (0, 1), "must be positive"),
        (lambda: cotree.sampled(3.0, 0.1), (0, 1), "takes a function"),
        (lambda: cotree.sampled(_law, 1e-9), (0, 1), "too short for this run"),
        (lambda: cotree.sampled(_law, 0.1), (1, 0), "go forwards only"),
        (
            lambda: cotree.sampled(lambda t, x: x["pole"], 0.1),
            (0, 1),
            "'pole', which is not a state",
        ),
        (
            lambda: cotree.sampled(lambda t: math.nan, 0.1),
            (0, 1),
            "a sample of input 'push' is nan",
        ),
    ],
)
def test_wrong_samples_are_refused(pole, make, span, message):
    with pytest.raises(ParameterError, match=message):
        pole.simulate(span, inputs={"push": make()})


@pytest.mark.parametrize("method", ["dop853", "DOP853"])
def test_what_a_sampled_function_raises_comes_out(pole, method):
    def law(t):
        if t > 0.5:
            raise KeyboardInterrupt
        return 0.0

    with pytest.raises(KeyboardInterrupt):
        pole.simulate((0, 1), inputs={"push": cotree.sampled(law, 0.1)}, method=method)
