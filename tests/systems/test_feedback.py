"""Expressions as inputs of a run: compiled into the model, with all that follows from them."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

import cotree
from cotree.cli import main
from cotree.errors import ExpressionError, ModelError, ParameterError

pytestmark = pytest.mark.compiler

TIGHT = {"rtol": 1e-11, "atol": 1e-13}
MASS, K, D = 2.0, 8.0, 4.0


def _cart() -> cotree.Scene:
    scene = cotree.Scene("cart")
    scene.parameter("m", MASS)
    scene.input("push", 0.0, unit="N")
    scene.edge("rail", "prismatic", "ground", "A", axis=[1, 0, 0], force="push", initial={"s": 1.0})
    scene.edge("cart", "rigid_body", "ground", "A", mass="m")
    scene.output("power", "push*rail.s_dot")
    scene.output("place", "A.x")
    return scene


@pytest.fixture(scope="module")
def cart() -> cotree.Model:
    return _cart().compile(["m", "rail.s"])


def _position(t: float, k: float = K, d: float = D, m: float = MASS) -> float:
    """The solution of m x'' = -k x - d x' from x = 1 at rest, with less than critical damping."""
    a = d / (2 * m)
    w = math.sqrt(k / m - a * a)
    return math.exp(-a * t) * (math.cos(w * t) + a / w * math.sin(w * t))


LAW = "-k_p*rail.s - k_d*rail.s_dot"
GAINS = {"k_p": K, "k_d": D}


@pytest.mark.parametrize("method", ["auto", "rodas5", "dop853", "cvode"])
def test_feedback_of_states_with_new_gains(cart, method):
    if method == "cvode":
        pytest.importorskip("sksundae")
    result = cart.simulate((0, 2), inputs={"push": LAW}, parameters=GAINS, method=method, **TIGHT)
    # A few hundred local errors of 1e-11.
    assert result["rail.s"][-1] == pytest.approx(_position(2.0), abs=1e-8)
    h = 1e-5
    slope = (_position(2.0, m=MASS + h) - _position(2.0, m=MASS - h)) / (2 * h)
    # Differences of a closed form are good to h^2.
    assert result.sensitivity("rail.s", "m")[-1] == pytest.approx(slope, abs=1e-8)
    # What is linear is proportional to its initial value.
    along = result.sensitivity("rail.s", "rail.s")[-1]
    assert along == pytest.approx(_position(2.0), abs=1e-8)
    force = -K * result["rail.s"] - D * result["rail.s_dot"]
    np.testing.assert_allclose(result["push"], force, atol=1e-12)
    np.testing.assert_allclose(result["power"], force * result["rail.s_dot"], atol=1e-12)


def test_sensitivities_to_gains():
    model = _cart().with_inputs({"push": LAW}, GAINS).compile(["k_p", "k_d"])
    result = model.simulate((0, 2), **TIGHT)
    h = 1e-5
    for name, change in {"k_p": {"k": h}, "k_d": {"d": h}}.items():
        ((key, _),) = change.items()
        at = {"k": K, "d": D}
        high, low = (_position(2.0, **{**at, key: at[key] + side}) for side in (h, -h))
        # Differences of a closed form are good to h^2.
        assert result.sensitivity("rail.s", name)[-1] == pytest.approx(
            (high - low) / (2 * h), abs=1e-8
        )


def test_a_text_is_compiled_once(cart, monkeypatch):
    from cotree.spec import BuildSpec

    made = []
    whole = BuildSpec.compile
    monkeypatch.setattr(BuildSpec, "compile", lambda spec: made.append(spec) or whole(spec))
    for gain in (1.0, 2.0, 3.0):
        result = cart.simulate(
            (0, 1), inputs={"push": "-once*rail.s"}, parameters={"once": gain}, **TIGHT
        )
        exact = math.cos(math.sqrt(gain / MASS))
        assert result["rail.s"][-1] == pytest.approx(exact, abs=1e-9)
    assert len(made) == 1
    assert result.parameter_values["once"] == 3.0
    # Numbers in quotes are numbers.
    cart.simulate((0, 1), inputs={"push": "0.5"})
    assert len(made) == 1


def test_feedback_of_outputs_and_other_inputs():
    scene = _cart()
    scene.input("wanted", 0.5)
    law = {"push": f"{K}*(wanted - place) - {D}*rail.s_dot"}
    result = scene.compile().simulate((0, 2), inputs=law, **TIGHT)
    # The wanted place is half way to where it begins.
    exact = 0.5 + 0.5 * _position(2.0)
    assert result["rail.s"][-1] == pytest.approx(exact, abs=1e-8)
    with_step = {**law, "wanted": ([0.0, 2.0], [0.5, 0.5])}
    again = scene.compile().simulate((0, 2), inputs=with_step, **TIGHT)
    assert again["rail.s"][-1] == pytest.approx(exact, abs=1e-8)


def test_jumps_of_feedback_are_located(cart):
    """A force of constant size towards zero: parabolas, whose fourth part takes sqrt(2 m)."""
    result = cart.simulate((0, 5), inputs={"push": "-sign(rail.s)"}, **TIGHT)
    quarter = math.sqrt(2.0 * MASS)
    times = np.concatenate([event.t for event in result.events.values()])
    np.testing.assert_allclose(np.unique(times.round(6)), [quarter], atol=1e-6)
    # From m v' = -1 follows the time t* of the jump, and with it x after it: -1 + (t - 2 t*)^2/2m.
    assert result["rail.s"][-1] == pytest.approx(-1.0 + (5 - 2 * quarter) ** 2 / (2 * MASS))
    slope = (result.event_sensitivity(name, "m") for name in result.events)
    found = np.concatenate(list(slope))
    np.testing.assert_allclose(found[found != 0.0], 1.0 / math.sqrt(2 * MASS), rtol=1e-8)


def test_jumps_of_time_are_breakpoints(cart):
    law = {"push": "where(t < 0.7, 3, 0) + max(t - 1, 0)"}
    result = cart.simulate((0, 2), inputs=law, **TIGHT)
    assert result["rail.s_dot"][-1] == pytest.approx((3 * 0.7 + 0.5) / MASS, abs=1e-11)
    assert {0.7, 1.0} <= set(result.t)


def test_stiff_feedback_is_seen(cart):
    stiff = {"push": "-k_d*rail.s_dot - 10*rail.s"}
    result = cart.simulate((0, 10), inputs=stiff, parameters={"k_d": 1e5})
    assert result.statistics.method == "rodas5"
    # What is slow decays with 10 / 1e5 per second; the next term is 1e-9 of it.
    assert result["rail.s"][-1] == pytest.approx(math.exp(-1e-3), rel=1e-7)


def test_loops_through_networks_are_solved():
    """A source that feeds back the voltage of what it drives: v_R = u - v_C, u = 1 - v_R / 2."""
    scene = cotree.Scene("loop")
    scene.input("u", 1.0)
    scene.edge("V", "voltage_source", "a", "ground", voltage="u")
    scene.edge("R", "resistor", "a", "b", resistance=2.0)
    scene.edge("C", "capacitor", "b", "ground", capacitance=1.0)
    scene.output("seen", "R.v")
    for law in ("1 - 0.5*R.v", "1 - 0.5*seen"):
        result = scene.compile().simulate((0, 1), inputs={"u": law}, **TIGHT)
        # u = (1 + v_C / 2) / 1.5, so that v_C' = (u - v_C) / 2 = (1 - v_C) / 3.
        np.testing.assert_allclose(result["C.v"], 1.0 - np.exp(-result.t / 3.0), atol=1e-9)
        np.testing.assert_allclose(result["u"], (1.0 + 0.5 * result["C.v"]) / 1.5, atol=1e-12)


@pytest.mark.parametrize(
    ("law", "parameters", "message"),
    [
        ("power", None, "'push' -> 'power' -> 'push', which is an algebraic loop"),
        ("push + 1", None, "an algebraic loop"),
        ("-k*rail.s", None, "unknown name 'k'.*needs its value in parameters"),
        ("-k*rail.q", {"k": 1.0}, "uses 'rail.q', which is not a coordinate"),
        (
            "A.ax",
            None,
            "reactions can be used in fields of friction and dampers on joints only",
        ),
        ("__import__('os')", None, "not a known function"),
        ("t", {"k": 1.0}, "no tunable parameter 'k'"),
    ],
)
def test_what_cannot_be_fed_back_is_refused(cart, law, parameters, message):
    with pytest.raises((ParameterError, ExpressionError), match=message):
        cart.simulate((0, 1), inputs={"push": law}, parameters=parameters)


@pytest.mark.parametrize(
    ("inputs", "parameters", "message"),
    [
        ({"pull": "t"}, None, "no input 'pull'"),
        ({"push": math.sin}, None, "a Python function: give it to a run"),
        ({"push": "m*t"}, {"m": 1.0}, "'m' is a parameter of the scene already"),
        ({"push": "k*t"}, {"k": 1.0, "q": 1.0}, "no input uses the parameter 'q'"),
    ],
)
def test_what_a_scene_cannot_take_is_refused(inputs, parameters, message):
    with pytest.raises(ModelError, match=message):
        _cart().with_inputs(inputs, parameters)


def test_a_closed_loop_is_a_scene_like_others(tmp_path):
    closed = _cart().with_inputs({"push": LAW}, GAINS)
    model = closed.compile()
    A = model.linearize().A
    np.testing.assert_allclose(A, [[0.0, 1.0], [-K / MASS, -D / MASS]], atol=1e-14)
    closed.save(tmp_path / "closed.toml")
    again = cotree.load(tmp_path / "closed.toml").compile()
    y = np.array([0.3, -0.2])
    np.testing.assert_array_equal(model.rhs(0.0, y), again.rhs(0.0, y))
    # The scene stays as it was.
    assert _cart().with_inputs({"push": 1.0}).inputs.keys() == {"push"}
    written = [file.read_text(encoding="utf-8") for file in model.write(tmp_path / "c").files]
    assert any("k_p" in text for text in written)


def test_the_shipped_pendulum_falls_and_is_held():
    """Its unstable pole is sqrt((M + m) g / (M L)); a law of angle and speed holds the rod."""
    model = cotree.load("cart-pole").compile()
    poles = np.linalg.eigvals(model.linearize(y=np.zeros(4)).A)
    assert np.max(poles.real) == pytest.approx(math.sqrt(1.2 * 9.81 / 0.5), rel=1e-12)
    law = {"push": "-k*hinge.theta - d*hinge.theta_dot"}
    result = model.simulate((0, 5), inputs=law, parameters={"k": 40.0, "d": 8.0})
    # M L s^2 + d s + k - (M + m) g = 0 has its slower pole at -5.25: e^-26 of 0.1 rad.
    assert abs(result["hinge.theta"][-1]) < 1e-10


def test_an_input_may_be_undefined_before_the_run(cart):
    """It is not looked at where the run does not begin."""
    result = cart.simulate((2, 3), inputs={"push": "sqrt(t - 2)"}, **TIGHT)
    # The root has an infinite slope at the start, which costs steps but no accuracy.
    assert result["rail.s_dot"][-1] == pytest.approx(2.0 / 3.0 / MASS, abs=1e-8)


def test_the_command_takes_feedback_with_sensitivities_to_gains(tmp_path, capsys):
    _cart().save(tmp_path / "cart.toml")
    command = ["run", str(tmp_path / "cart.toml"), "--t-end", "2", "--input", f"push={LAW}"]
    command += ["--set", f"k_p={K}", "--set", f"k_d={D}", "-s", "k_p", "--rtol", "1e-10"]
    assert main(command) == 0
    printed = capsys.readouterr().out
    (found,) = re.findall(r"^  rail\.s += +(\S+) m$", printed, re.MULTILINE)
    assert float(found) == pytest.approx(_position(2.0), abs=1e-8)
    assert "d(rail.s)/d(k_p)" in printed
    assert main(command[:-6]) == 2
    assert "unknown name 'k_d'" in capsys.readouterr().err
