"""Control blocks that ship as parts, against closed forms and difference equations."""

import numpy as np
import pytest
from scipy.signal import freqs

import cotree
from cotree.errors import SceneError

_TIGHT = {"rtol": 1e-11, "atol": 1e-13}


def _integrator(rate: str) -> cotree.Scene:
    """Build a scene in which x.v is the integral of an expression."""
    scene = cotree.Scene("loop")
    scene.edge("x", "capacitor", "n", "ground", capacitance=1.0)
    scene.edge("rate", "current_source", "ground", "n", current=rate)
    return scene


def _agrees_with_differences(model, name: str, parameter: str, t: float) -> None:
    place = model.parameters.index(parameter)
    value = model.default_parameters[place]
    h = 1e-4 * value
    run = {"rtol": 1e-11, "atol": 1e-13}
    high, low = (
        model.simulate((0, t), parameters={parameter: value + s}, **run)[name][-1] for s in (h, -h)
    )
    found = model.simulate((0, t), **run).sensitivity(name, parameter)[-1]
    # Central differences err by about h^2 = 1e-8, relative to slopes of order one.
    assert found == pytest.approx((high - low) / (2 * h), rel=1e-6, abs=1e-8)


def test_a_transfer_function_steps_as_its_closed_form() -> None:
    # y = s/(s^2 + 2 D w s + w^2) u + 0.5 u for a step of one.
    w, damping = 3.0, 0.2
    scene = cotree.Scene("scene")
    scene.add("G", "transfer-function", b2=0.5, b1=1 + damping * w, b0=0.5 * w**2, u=1.0)
    scene.set("G.a1", 2 * damping * w)
    scene.set("G.a0", w**2)
    model = scene.compile(["G.a0"])
    t = np.linspace(0, 4, 41)
    # b = 0.5 a + (0, 1, 0): the step answer of s/(s^2 + ...) is an impulse answer.
    wd = w * np.sqrt(1 - damping**2)
    exact = 0.5 + np.exp(-damping * w * t) * np.sin(wd * t) / wd
    np.testing.assert_allclose(model.simulate((0, 4), t, **_TIGHT)["G.y"], exact, atol=1e-9)
    _agrees_with_differences(model, "G.y", "G.a0", 2.0)


def test_a_delay_has_the_frequency_response_of_its_stages() -> None:
    scene = cotree.Scene("scene")
    scene.add("delay", "delay", T=0.8)
    model = scene.compile()
    linear, y = model.linearize(), model.outputs.index("delay.y")
    ones = np.eye(len(model.states))
    for w in (1.0, 5.0, 12.0):
        s = 1j * w
        found = (linear.C @ np.linalg.solve(s * ones - linear.A, linear.B) + linear.D)[y, 0]
        # An all-pass, whose phase is that of the delay; the stage's error is (w h)^5/720.
        assert abs(found) == pytest.approx(1.0, abs=1e-10)
        error = 4 * (w * 0.2) ** 5 / 720
        assert abs(found - np.exp(-0.8 * s)) < 1.1 * error


def test_a_pid_controller_obeys_its_equation_and_limits() -> None:
    scene = _integrator("C.y")
    scene.parameter("r", 1.0)
    scene.add("C", "pid", u="r - x.v", Kp=2.0, Ki=2.0)
    model = scene.compile(["C.Kp", "C.Ki"])
    t = np.linspace(0, 3, 31)
    # x'' + 2 x' + 2 x = 2 r with x'(0) = 2: e = 1 - x decays as exp(-t)(cos t - sin t).
    exact = 1 - np.exp(-t) * (np.cos(t) - np.sin(t))
    np.testing.assert_allclose(model.simulate((0, 3), t, **_TIGHT)["x.v"], exact, atol=1e-9)
    _agrees_with_differences(model, "x.v", "C.Ki", 1.5)
    # With a limit the output never leaves it, and the integral does not wind up: the overshoot of
    # the wanted value is less than without the way back.
    limited = {"C.upper": 0.5, "C.lower": -0.5, "C.Tt": 0.2}
    result = model.simulate((0, 12), parameters=limited)
    assert np.abs(result["C.y"]).max() <= 0.5
    wound = model.simulate((0, 12), parameters={**limited, "C.Tt": 1e6})
    assert result["x.v"].max() < wound["x.v"].max() - 0.1
    assert result["x.v"][-1] == pytest.approx(1.0, abs=1e-3)


def test_the_rate_of_a_pid_controller_is_filtered() -> None:
    scene = cotree.Scene("scene")
    scene.add("C", "pid", u="t**2", Kp=0.0, Kd=1.0, Tf=0.1)
    result = scene.compile().simulate((0, 2), **_TIGHT)
    # The filter lags by Tf: 2 (t - Tf) + 2 Tf exp(-t/Tf).
    assert result["C.y"][-1] == pytest.approx(2 * (2 - 0.1) + 0.2 * np.exp(-20.0), rel=1e-9)


def test_a_sampled_controller_obeys_its_difference_equation() -> None:
    scene = _integrator("C.y")
    scene.add("C", "sampled-pi", u="1 - x.v", T=0.25, Kp=1.5, Ki=0.8)
    model = scene.compile(["C.Kp"])
    x = total = 0.0
    for _ in range(8):
        total += 1 - x
        x += 0.25 * (1.5 * (1 - x) + 0.8 * 0.25 * total)
    result = model.simulate((0, 2), **_TIGHT)
    # At t = 2 the next sample is taken, which moves the output and not yet the state.
    assert result["x.v"][-1] == pytest.approx(x, rel=1e-9)
    _agrees_with_differences(model, "x.v", "C.Kp", 1.9)


def test_a_transfer_function_of_any_order_has_its_frequency_response() -> None:
    b, a = [2.0, 0.0, 5.0, 1.0], [0.5, 1.0, 4.0, 3.0]
    scene = cotree.Scene("scene")
    scene.add("G", cotree.transfer_function(b, a))
    model = scene.compile(["G.a1", "G.b3"])
    linear, y = model.linearize(), model.outputs.index("G.y")
    ones, w = np.eye(len(model.states)), np.array([0.3, 1.0, 4.0])
    found = [
        (linear.C @ np.linalg.solve(1j * x * ones - linear.A, linear.B) + linear.D)[y, 0] for x in w
    ]
    np.testing.assert_allclose(found, freqs(b, a, w)[1], rtol=1e-12)  # a few roundings


def test_a_state_space_is_what_its_matrices_say(tmp_path) -> None:
    A, B = [[0.0, 1.0], [-3.0, -0.5]], [[0.0, 1.0], [2.0, 0.0]]
    C, D = [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], [[0.0, 0.0], [4.0, 0.0], [0.0, 0.0]]
    scene = cotree.Scene("scene")
    scene.add("G", cotree.state_space(A, B, C, D))
    scene.save(tmp_path / "scene.toml")
    linear = cotree.load(tmp_path / "scene.toml").compile().linearize()
    for found, wanted in ((linear.A, A), (linear.B, B), (linear.C, C), (linear.D, D)):
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: cotree.transfer_function([1, 0, 0], [1, 1]), "numerator has order 2"),
        (lambda: cotree.transfer_function([1], [0, 1]), "highest power of s first"),
        (lambda: cotree.transfer_function(["a"], [1]), "must be an array of numbers"),
        (lambda: cotree.state_space([[1, 2]], [1], [1]), "A has the shape (1, 2)"),
        (lambda: cotree.state_space([[1]], [1, 2], [1]), "B has the shape (2, 1)"),
        (lambda: cotree.state_space([[np.nan]], [1], [1]), "finite numbers"),
    ],
)
def test_wrong_systems_are_refused(make, told) -> None:
    with pytest.raises(SceneError) as caught:
        make()
    assert told in str(caught.value)
