"""Algebraic unknowns, M y' = f of index 1: closed forms, a jump, diodes, a transistor amplifier."""

from __future__ import annotations

import math

import numpy as np
import pytest
from amplifier import AMPLIFIER, POTENTIALS, SENSITIVITIES, TIMES
from hand_made import Made, model_of
from loop_with_network import four_bar, with_a_network
from scipy.integrate import quad
from scipy.special import lambertw

import cotree
from cotree.check import check_sensitivities
from cotree.errors import ParameterError, SingularSystemError, SolveError
from cotree.pipeline import formulate

ALL = ["dopri5", "dop853", "rodas4", "rodas5", "cvode", "ida", "auto"]

# x' = -a x + z, 0 = z - b x - sin(w t): x' = (b - a) x + sin(w t).
LINEAR = Made(
    "linear",
    {"x": "x0"},
    {"z": 7.0},
    {"a": 3.0, "b": 1.0, "w": 2.0, "x0": 0.5},
    lambda v: [
        -v["a"] * v["x"] + v["z"],
        v["z"] - v["b"] * v["x"] - v["t"].dag.function("sin", v["w"] * v["t"]),
    ],
    lambda v: {"power": v["x"] * v["z"]},
)


def linear_exact(t, a, b, w, x0):
    c = b - a
    size = c * c + w * w
    x = (x0 + w / size) * np.exp(c * t) - (c * np.sin(w * t) + w * np.cos(w * t)) / size
    return np.array([x, b * x + np.sin(w * t)])


def linear_derivative(t, name):
    """The closed form by complex step: exact to rounding."""
    values = {**LINEAR.parameters, name: LINEAR.parameters[name] + 1e-30j}
    return linear_exact(t, **values).imag / 1e-30


@pytest.mark.sampled(5)
@pytest.mark.parametrize("method", ALL)
def test_linear_with_sensitivities(method):
    model = LINEAR.model(list(LINEAR.parameters))
    times = np.linspace(0.0, 2.0, 9)
    result = model.simulate((0.0, 2.0), times, method, 1e-9, 1e-11, throw=True)
    # Multistep methods at rtol = 1e-9 gather some hundred errors of it; order 8 and 5 are better.
    np.testing.assert_allclose(result.y, linear_exact(times, **LINEAR.parameters), atol=2e-7)
    for name in LINEAR.parameters:
        expected = linear_derivative(times, name)
        np.testing.assert_allclose(result.sensitivity("x", name), expected[0], atol=5e-7)
        np.testing.assert_allclose(result.sensitivity("z", name), expected[1], atol=5e-7)
    # Every stored z is a solution to rounding, whatever the tolerance.
    x, z = result.y
    assert np.max(np.abs(z - LINEAR.parameters["b"] * x - np.sin(2.0 * times))) < 1e-14
    assert result.drift is not None
    assert result.drift.names == ("z",)
    assert result.drift.worst < 1e-14
    np.testing.assert_allclose(result["power"], x * z, rtol=1e-14)


def test_start_and_its_sensitivities():
    model = LINEAR.model(list(LINEAR.parameters))
    start = model.start(0.3)
    # z = b x0 + sin(w t) at the scene's x0, and not its guess of 7.
    assert start.y == pytest.approx([0.5, 0.5 + math.sin(0.6)], rel=1e-15)
    expected = {"a": 0.0, "b": 0.5, "w": 0.3 * math.cos(0.6), "x0": 1.0}
    assert start.s[1].tolist() == pytest.approx(list(expected.values()), abs=1e-15)
    assert model.rhs(0.3, start.y)[1] == pytest.approx(0.0, abs=1e-15)


def test_start_follows_parameters_and_guesses():
    model = LINEAR.model()
    p = model.kernels.parameter_array({"b": 4.0, "x0": 2.0})
    assert model.start(0.0, p).y.tolist() == pytest.approx([2.0, 8.0], rel=1e-15)
    assert model.start(0.0, initial={"x": 3.0, "z": -1e6}).y.tolist() == pytest.approx([3.0, 3.0])
    result = model.simulate((0.0, 1.0), [1.0], parameters={"b": 2.0}, rtol=1e-10, atol=1e-12)
    changed = {**LINEAR.parameters, "b": 2.0}
    assert result.y[:, -1] == pytest.approx(linear_exact(1.0, **changed), rel=1e-8)


def test_linearize_eliminates():
    model = LINEAR.model()
    found = model.linearize(0.7, [0.2, 0.0])
    assert found.states == ("x",)
    z = 0.2 + math.sin(1.4)
    np.testing.assert_allclose(found.A, [[-2.0]], rtol=1e-14)
    # power = x z(x) with z = b x + sin: its derivative is z + b x.
    np.testing.assert_allclose(found.C, [[z + 0.2]], rtol=1e-14)
    assert found.B.shape == (1, 0)


def test_linearize_with_an_input():
    made = Made(
        "driven",
        {"x": 1.0},
        {"z": 0.0},
        {"g": 2.0},
        lambda v: [v["z"] - v["x"], v["z"] ** 3 + v["g"] * v["z"] - v["x"] - v["e"]],
        lambda v: {"both": v["z"] + v["e"]},
        {"e": lambda v: 2.0 + 0.0 * v["t"]},
    )
    found = made.model().linearize()
    # At x = 1, e = 2 the root of z^3 + 2 z = 3 is 1, where the derivative is 5.
    for matrix, value in zip(
        (found.A, found.B, found.C, found.D), (-0.8, 0.2, 0.2, 1.2), strict=True
    ):
        np.testing.assert_allclose(matrix, [[value]], rtol=1e-13)


def test_check_of_sensitivities():
    report = check_sensitivities(LINEAR.model(["b", "x0"]), t_end=1.0)
    assert report.passed, report.summary()


def test_a_sensitivity_to_a_guess_is_refused():
    with pytest.raises(ParameterError, match="'z' is an algebraic unknown"):
        LINEAR.model(["z"])


@pytest.mark.parametrize("method", ALL)
def test_an_input_replaced_in_a_run_moves_the_start(method):
    made = Made(
        "driven",
        {"x": 0.0},
        {"z": 0.0},
        {"g": 2.0},
        lambda v: [v["z"], v["g"] * v["z"] - v["e"]],
        inputs={"e": lambda v: v["t"] * 0.0},
    )
    result = made.model().simulate(
        (0.0, 2.0), [0.0, 1.0, 2.0], method, inputs={"e": ([0, 1, 1.0001, 2], [4, 4, 8, 8])}
    )
    np.testing.assert_allclose(result["z"], [2.0, 2.0, 4.0], rtol=1e-14)
    # The ramp lasts 1e-4 and is passed at 3 on average.
    assert result["x"][-1] == pytest.approx(2.0 + 3e-4 + 4.0 * 0.9999, rel=1e-7)


SATURATION, THERMAL = 1e-14, 0.02585


def diode_charging(n_diodes):
    """A source over a resistor and diodes in series, charging a capacitor with a leak."""
    names = [f"D{i + 1}" for i in range(n_diodes)]

    def rates(v):
        dag = v["t"].dag
        current = (v["E"] - v["C.v"] - sum((v[f"{n}.v"] for n in names), dag.zero)) / v["R"]
        return [
            (current - v["C.v"] / v["G"]) / v["C"],
            *(
                v["Is"] * (dag.function("exp", v[f"{n}.v"] / v["Vt"]) - 1.0) - current
                for n in names
            ),
        ]

    values = {"E": 5.0, "R": 100.0, "G": 1e4, "C": 1e-6, "Is": SATURATION, "Vt": THERMAL}
    return Made(f"diodes{n_diodes}", {"C.v": 0.0}, {f"{n}.v": 0.0 for n in names}, values, rates)


def diode_current(v, n, E, R, Is, Vt, **others):
    """Solve E - v = R i + n Vt log(1 + i/Is) by Lambert's function."""
    a = n * Vt / R
    # i + Is = a W(Is/a exp((E - v + R Is)/(n Vt))): the argument stays below 1e200 here.
    return a * lambertw(Is / a * np.exp((E - v + R * Is) / (n * Vt))).real - Is


@pytest.mark.sampled(2)
@pytest.mark.parametrize("n", [1, 3, 8])
@pytest.mark.parametrize("guess", [0.0, 0.6, 15.0, -30.0, 40.0])
def test_diodes_in_series_find_their_start(n, guess):
    made = diode_charging(n)
    start = made.model().start(initial={name: guess for name in made.algebraic})
    current = diode_current(0.0, n, **made.parameters)
    # The exponent amplifies the rounding of a voltage of 5 V forty times.
    np.testing.assert_allclose(start.y[1:], THERMAL * np.log1p(current / SATURATION), rtol=1e-13)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", ["rodas5", "cvode", "ida", "auto"])
def test_diode_charges_a_capacitor(method):
    """The reduced equation by Lambert's function, integrated with Radau's method of its own."""
    from scipy.integrate import solve_ivp

    made = diode_charging(2)
    values = made.parameters

    def rate(t, v):
        return (diode_current(v, 2, **values) - v / values["G"]) / values["C"]

    times = np.linspace(0.0, 2e-3, 6)
    known = solve_ivp(rate, (0.0, 2e-3), [0.0], "LSODA", times, rtol=1e-12, atol=1e-13)
    result = made.model(["Is"]).simulate((0.0, 2e-3), times, method, 1e-9, 1e-11, throw=True)
    # Some hundred steps at 1e-9.
    np.testing.assert_allclose(result["C.v"], known.y[0], atol=1e-7)
    current = diode_current(result["C.v"], 2, **values)
    np.testing.assert_allclose(result["D1.v"], THERMAL * np.log1p(current / SATURATION), rtol=1e-12)


@pytest.mark.parametrize("method", ALL)
def test_unknowns_alone(method):
    """A divider of two resistors whose source follows the sine of time."""
    made = Made(
        "divider",
        {},
        {"v": 0.0, "i": 0.0},
        {"R": 3.0, "Q": 1.0},
        lambda v: [
            function(v, "sin", v["t"]) - v["R"] * v["i"] - v["v"],
            v["v"] - v["Q"] * v["i"],
        ],
    )
    times = np.linspace(0.0, 9.0, 7)
    model = made.model(["R"])
    result = model.simulate((0.0, 9.0), times, method, throw=True)
    # One linear system, solved to rounding.
    np.testing.assert_allclose(result["v"], np.sin(times) / 4.0, atol=1e-15)
    np.testing.assert_allclose(result.sensitivity("i", "R"), -np.sin(times) / 16.0, atol=1e-15)
    assert model.linearize().A.shape == (0, 0)


def exp_case(rates, guess=0.0, n=1):
    names = {f"D{i + 1}.v": guess for i in range(n)}
    return Made("start", {"x": 1.0}, names, {"p": 1.0}, rates).model()


def function(v, name, node):
    return v["t"].dag.function(name, node)


@pytest.mark.parametrize(
    ("rate", "guess", "root"),
    [
        (lambda v, z: function(v, "tanh", z) - 0.5, 18.0, math.atanh(0.5)),
        (lambda v, z: function(v, "atan", z) - 1.5, -50.0, math.tan(1.5)),
        (lambda v, z: z * z - 4.0, 0.0, None),
        (lambda v, z: z**3 - 2.0 * z + 2.0, 0.0, -1.7692923542386314),  # Newton's own cycle
        (lambda v, z: function(v, "exp", z / 0.026) - 1e-3, 30.0, 0.026 * math.log(1e-3)),
        (
            lambda v, z: 1e-12 * z + 1e-14 * (function(v, "exp", z / 0.026) - 1) - 0.1,
            0.0,
            0.7782737614,
        ),
        (lambda v, z: z + 1e6 * (z + abs_of(v, z)) - 5e5, -3.0, 5e5 / 2000001.0),
    ],
)
def test_starts_that_newton_alone_does_not_find(rate, guess, root):
    model = exp_case(lambda v: [-v["x"], rate(v, v["D1.v"])], guess)
    z = model.start().y[1]
    # Where there are two, either will do. The sixth is known to ten digits.
    expected, found = (2.0, abs(z)) if root is None else (root, z)
    assert found == pytest.approx(expected, rel=1e-10 if root == 0.7782737614 else 1e-12)


def abs_of(v, node):
    return function(v, "abs", node)


def test_no_solution_names_the_unknown():
    def rates(v):
        a, b = v["D1.v"], v["D2.v"]
        return [-v["x"], a - 1.0, b * b + 1.0]

    with pytest.raises(SolveError, match=r"the residual of 'D2\.v' stays"):
        exp_case(rates, n=2).start()


@pytest.mark.parametrize(
    ("rates", "names"),
    [
        (
            lambda v: [
                -v["x"],
                v["D1.v"] + v["D2.v"] - 1,
                2 * v["D1.v"] + 2 * v["D2.v"] - 2,
                v["D3.v"],
            ],
            "'D1.v', 'D2.v':",
        ),
        (
            lambda v: [
                -v["x"],
                v["D1.v"] + v["D2.v"] - 1,
                2 * v["D1.v"] + 2 * v["D2.v"] - 3,
                v["D3.v"],
            ],
            "'D1.v', 'D2.v':",
        ),
        (lambda v: [v["D3.v"], v["D1.v"] - 1, v["D2.v"], v["x"] - 1.0], "'D3.v':"),
        (lambda v: [v["D3.v"], v["D1.v"] - 1, v["D2.v"], v["x"] - 2.0], "'D3.v':"),
    ],
)
def test_singular_systems_name_what_they_leave_free(rates, names):
    with pytest.raises(SingularSystemError, match="do not determine") as caught:
        exp_case(rates, n=3).start()
    assert f"determine {names}" in str(caught.value)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("method", ALL)
def test_a_run_into_a_fold_stops_with_its_reason(method):
    """x' = -1, 0 = z^2 - x: no solution is left beyond t = 1."""
    made = Made(
        "fold", {"x": 1.0}, {"z": 1.0}, {}, lambda v: [-1.0 + 0.0 * v["z"], v["z"] ** 2 - v["x"]]
    )
    with pytest.warns(RuntimeWarning, match="stopped at"):
        result = made.model().simulate((0.0, 2.0), method=method)
    assert not result.success
    # z changes without bound there: steps shrink until they get nowhere. What is left of x has the
    # rounding of 1.
    assert 0.999 < result.t[-1] <= 1.0 + 4 * np.finfo(float).eps
    assert "algebraic" in result.message
    np.testing.assert_allclose(result["z"] ** 2, result["x"], atol=1e-12)


@pytest.mark.parametrize(
    ("method", "tolerance"),
    [
        pytest.param("cvode", 1e-11, marks=pytest.mark.slow),
        ("auto", 1e-9),
        ("ida", 1e-11),
    ],
)
def test_transistor_amplifier(method, tolerance):
    model = AMPLIFIER.model(list(SENSITIVITIES))
    times = TIMES
    settings = {"rtol": tolerance, "atol": tolerance / 100.0, "throw": True}
    result = model.simulate((0.0, times[-1]), times, method, **settings)
    n = len(times)
    found = np.array([result[f"outv{i}"] for i in range(1, 9)])
    # Eight digits. v1, of some mV at these instants, is the difference of two potentials of 3 V.
    np.testing.assert_allclose(found[1:], POTENTIALS[1:, :n], rtol=1e-8)
    np.testing.assert_allclose(found[0], POTENTIALS[0, :n], atol=3e-8)
    for name, expected in SENSITIVITIES.items():
        along = np.array([result.sensitivity(f"outv{i}", name) for i in range(1, 9)])
        # Eight of the nine digits of the reference, of the largest potential's sensitivity.
        largest = np.max(np.abs(expected))
        np.testing.assert_allclose(along, expected[:, :n], atol=1e-8 * largest)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["dop853", "cvode", "ida"])
def test_constraints_and_algebraic_unknowns_live_together(method):
    alone = four_bar().compile(["a"])
    model = model_of(with_a_network(formulate(four_bar(), ["a"], None)[1]))
    layout, n = model.kernels.layout, len(alone.states)
    assert (layout.n_coordinates, layout.n_speeds, layout.n_algebraic) == (n // 2, n // 2, 1)
    times = np.linspace(0.0, 1.0, 6)
    settings = {"rtol": 1e-9, "atol": 1e-11, "throw": True}
    result = model.simulate((0.0, 1.0), times, method, **settings)
    expected = alone.simulate((0.0, 1.0), times, "dop853", 1e-12, 1e-13, throw=True)
    # Some hundred steps at 1e-9 by multistep methods, enlarged some ten times by the motion.
    np.testing.assert_allclose(result.y[:n], expected.y, atol=1e-5)
    np.testing.assert_allclose(result.s[:n], expected.s, atol=1e-4)
    z, theta = result["z"], result["crank.theta"]
    np.testing.assert_allclose(z + z**3, theta, rtol=1e-14)
    along = result.sensitivity("crank.theta", "a") / (1.0 + 3.0 * z**2)
    np.testing.assert_allclose(result.sensitivity("z", "a"), along, rtol=1e-13, atol=1e-15)
    assert result.drift.names == (*alone.kernels.constraints, "z")
    assert result.drift.worst < 1e-12


def _amplifier():
    """An amplifier without storages, whose output saturates at 4 V: o = -g (a + o) / 2."""
    scene = cotree.Scene("amplifier")
    scene.parameter("g", 1000.0)
    scene.edge("V", "voltage_source", "a", "ground", voltage="5*sin(2*pi*t)")
    scene.edge("r1", "resistor", "a", "m", resistance=1000.0)
    scene.edge("r2", "resistor", "o", "m", resistance=1000.0)
    scene.edge("A", "voltage_source", "o", "ground", voltage="min(4, max(-4, -g*m.v))")
    scene.output("o", "o.v")
    return scene


@pytest.mark.parametrize("method", ["auto", "rodas5", "cvode", "ida", "Radau"])
def test_a_circuit_without_states_is_solved_in_c(method):
    model = _amplifier().compile(["g"])
    t = np.linspace(0.0, 1.0, 301)
    result = model.simulate((0, 1), t, method=method)
    # Python took a millisecond for each time; only methods in C have lower-case names.
    assert result.statistics.method in ("dop853", "rodas5")
    a = 5.0 * np.sin(2 * np.pi * t)
    linear = -1000.0 * a / 1002.0
    # Newton's method ends at rounding.
    np.testing.assert_allclose(result["o"], np.clip(linear, -4.0, 4.0), atol=1e-11)
    slope = np.where(np.abs(linear) < 4.0, -2.0 * a / 1002.0**2, 0.0)
    np.testing.assert_allclose(result.sensitivity("o", "g"), slope, atol=1e-13)


def test_an_event_of_a_circuit_without_states():
    scene = _amplifier()
    scene.event("low", "o.v + 2", direction=-1, stop=True)
    result = scene.compile().simulate((0, 1))
    # 1000/1002 * 5 sin(2 pi t) = 2.
    expected = math.asin(2.0 / 5.0 * 1.002) / (2 * math.pi)
    assert result.t[-1] == pytest.approx(expected, rel=1e-8)


def test_members_without_states():
    model = _amplifier().compile()
    found = model.ensemble((0, 0.25), {"g": [10.0, 100.0]}, t_eval=[0.05])
    a = 5.0 * math.sin(0.1 * math.pi)
    expected = [-g * a / (2 + g) for g in (10.0, 100.0)]
    assert found["o"].values[:, -1] == pytest.approx(expected, rel=1e-10)


FOLLOWING = ["dop853", "dopri5", "rkf45", "rodas4", "rodas5", "cvode", "ida"]


def _stopped_at_fold(scene, t_end, method):
    """Return a result whose message names the fold at which it stopped."""
    model = scene.compile(optimize="-O0")
    with pytest.warns(RuntimeWarning, match="have a fold"):
        result = model.simulate((0, t_end), method=method)
    assert result.status < 0
    return result


@pytest.mark.compiler
@pytest.mark.parametrize("method", FOLLOWING)
@pytest.mark.parametrize("gain", [5, 20, 1000])
def test_methods_stop_at_a_fold(gain, method):
    """A comparator with hysteresis: beyond the fold only a solution of other sign is left."""
    scene = cotree.Scene("schmitt")
    scene.resistor("Rf", "o", "c", resistance=1e4)
    scene.capacitor("C", "c", "ground", capacitance=1e-7, initial={"v": 0.5})
    scene.resistor("r1", "o", "p", resistance=2e4)
    scene.resistor("r2", "p", "ground", resistance=1e4)
    scene.voltage_source("A", "o", "ground", voltage=f"10*tanh({gain}*(r2.v - C.v))")
    result = _stopped_at_fold(scene, 2e-3, method)
    # All values are on one branch, between the folds.
    output = result["A.v"]
    assert len(set(np.sign(output))) == 1
    assert np.all(np.diff(result["C.v"]) * np.sign(output[0]) >= 0.0)
    # With o = 10 tanh(u) the capacitor's voltage is c = o/3 - u/gain, and t = RC times the integral
    # of dc/du / (o - c) up to the fold, where dc/du = 0.
    fold = math.copysign(math.acosh(math.sqrt(gain / 0.3)), output[0])

    def slope(u):
        o = 10.0 * math.tanh(u)
        return 1e-3 * ((100.0 - o * o) / 30.0 - 1 / gain) / (2 / 3 * o + u / gain)

    expected = quad(slope, gain * (output[0] / 3.0 - 0.5), fold)[0]
    # At gain 1000 cvode's error test fails in the bend before the fold, 1.6 us wide.
    assert 0.996 * expected < result.t[-1] < (1 + 1e-4) * expected


@pytest.mark.compiler
@pytest.mark.parametrize("method", FOLLOWING)
def test_methods_stop_at_a_fold_of_a_cubic_law(method):
    """A current v**3 - 3 v in an inductor: dt = (3 v**2 - 3) dv / (-3 - v) up to v = 1."""
    scene = cotree.Scene("relaxation")
    scene.voltage_source("S", "a", "ground", voltage=-3.0)
    scene.inductor("L", "a", "b", inductance=1.0, initial={"i": 0.0})
    scene.current_source("D", "b", "ground", current="D.v**3 - 3*D.v", initial={"v": 3**0.5})
    scene.output("v", "D.v")
    result = _stopped_at_fold(scene, 3.0, method)
    # The square root of the error of the current, some 1e-7.
    assert result["v"][-1] == pytest.approx(1.0, abs=2e-3)
    expected = quad(lambda v: (3 * v**2 - 3) / (-3 - v), 3**0.5, 1.0)[0]
    # One step of a method that is restarted there, and a default tolerance of 1e-8.
    assert result.t[-1] == pytest.approx(expected, rel=1e-6)


@pytest.mark.compiler
@pytest.mark.parametrize("method", ["auto", "dopri5", "rodas5", "cvode", "ida"])
@pytest.mark.parametrize(
    ("law", "current", "expected"),
    [
        ("D.v**3 - 3*D.v", "4*sin(t)", math.pi / 6),
        ("D.v + 2*sin(D.v)", "3*t", (2 * math.pi / 3 + math.sqrt(3.0)) / 3),
        ("D.v**2", "1 - t", 1.0),
    ],
)
def test_methods_stop_at_a_fold_that_time_reaches(law, current, expected, method):
    """A source drives a law whose slope vanishes; beyond it another solution is left, or none."""
    scene = cotree.Scene("driven")
    scene.current_source("I", "ground", "a", current=current)
    scene.current_source("D", "a", "ground", current=law)
    scene.resistor("R", "b", "ground", resistance=1.0)
    scene.capacitor("C", "b", "ground", capacitance=1.0, initial={"v": 1.0})
    scene.output("v", "D.v")
    result = _stopped_at_fold(scene, 4.0, method)
    assert "Nor did ida" not in result.message
    # Steps end where the change of the unknown, a square root, exceeds their tolerance.
    assert result.t[-1] == pytest.approx(expected, rel=1e-6)


@pytest.mark.compiler
@pytest.mark.parametrize("method", FOLLOWING)
def test_methods_pass_an_inflection(method):
    """A current v**3 changes its sign where its slope vanishes, which is no fold."""
    scene = cotree.Scene("inflection")
    scene.voltage_source("S", "a", "ground", voltage=-3.0)
    scene.inductor("L", "a", "b", inductance=1.0, initial={"i": 1.0})
    scene.current_source("D", "b", "ground", current="D.v**3", initial={"v": 1.0})
    scene.output("v", "D.v")
    result = scene.compile(optimize="-O0").simulate((0, 1.0), method=method, throw=True)
    expected = quad(lambda v: 3 * v**2 / (-3 - v), 1.0, result["v"][-1])[0]
    # The voltage is the cube root of the current, whose error at zero is some 1e-8.
    assert expected == pytest.approx(1.0, rel=1e-5)
