"""Whole runs against reference solutions, with every method."""

from __future__ import annotations

import numpy as np
import pytest
from reference_solutions import oscillator_values, reference

import cotree

pytestmark = pytest.mark.compiler

METHODS = [
    "RK45",
    "dop853",
    "LSODA",
    pytest.param("Radau", marks=pytest.mark.slow),  # a hundred thousand stages at this tolerance
    "BDF",
    "cvode",
    "ida",
]

#: The issue's bound for |y - ref| / max(1, |ref|) at rtol=1e-12, atol=1e-14.
BOUND = 1e-9
TIGHT = {"rtol": 1e-12, "atol": 1e-14}


def error(found, expected):
    return np.max(np.abs(found - expected) / np.maximum(1.0, np.abs(expected)))


@pytest.mark.sampled(1)
@pytest.mark.parametrize("method", METHODS)
def test_states_and_all_sensitivities(model_of, scene_name, method):
    t, states, sensitivities = reference(scene_name)
    model = model_of(scene_name)
    # Ten thousand steps in Python, each with factors of its own, show nothing that a part does not.
    t = t[t <= 2.0] if method == "Radau" else t
    result = model.simulate((0, t[-1]), t_eval=t, method=method, throw=True, **TIGHT)
    assert np.array_equal(result.t, t)
    assert t.size >= 2
    for state, expected in states.items():
        assert error(result[state], expected[: t.size]) < BOUND, state
    assert len(sensitivities) >= len(states) * 6
    for (state, parameter), expected in sensitivities.items():
        found = result.sensitivity(state, parameter)
        assert error(found, expected[: t.size]) < BOUND, (state, parameter)


def test_the_closed_form_agrees_with_the_reference_file():
    t, states, sensitivities = reference("spring-mass-damper")
    scene = cotree.load("spring-mass-damper")
    parameters = {name: row.value for name, row in scene.parameters.items()}
    values, along = oscillator_values(t, parameters)
    # Both are evaluated with 40 digits and rounded to doubles.
    assert error(values, np.array(list(states.values()))) < 1e-14
    for (state, parameter), expected in sensitivities.items():
        i, j = list(states).index(state), list(parameters).index(parameter)
        assert error(along[i, j], expected) < 1e-14


def test_other_parameters_against_the_closed_form(model_of):
    model = model_of("spring-mass-damper")
    changed = {"m": 3.0, "k": 20.0, "c": 0.5, "l0": -0.2, "F0": 7.0, "w": 2.0, "x0": 1.5, "v0": -2}
    t = np.linspace(0.0, 8.0, 9)
    result = model.simulate((0, 8), t_eval=t, parameters=changed, method="dop853", **TIGHT)
    values, along = oscillator_values(t, {name: changed[name] for name in model.parameters})
    # Order 8 at this tolerance is good to a few 1e-12; sizes reach 30.
    np.testing.assert_allclose(result.y, values, atol=1e-10)
    np.testing.assert_allclose(result.s, along, atol=1e-9)


def test_initial_expressions_carry_sensitivities(model_of):
    model = model_of("spring-mass-damper")
    j = [model.sensitivities.index(name) for name in ("x0", "v0")]
    assert np.array_equal(model.kernels.initial_sensitivity()[:, j], np.eye(2))


def test_sensitivity_to_an_initial_value_by_the_states_name(model_of):
    model = model_of("spring-mass-damper", ["s.s", "s.s_dot", "x0", "v0"])
    t = np.linspace(0.0, 5.0, 6)
    result = model.simulate((0, 5), t_eval=t, method="dop853", **TIGHT)
    np.testing.assert_allclose(result.s[:, 0], result.s[:, 2], atol=1e-15)
    np.testing.assert_allclose(result.s[:, 1], result.s[:, 3], atol=1e-15)
    parameters = dict(zip(model.parameters, model.default_parameters, strict=True))
    _, along = oscillator_values(t, parameters)
    np.testing.assert_allclose(result.s[:, 2:], along[:, 6:], atol=1e-11)


def test_an_initial_value_given_for_a_run_depends_on_no_parameter(model_of):
    model = model_of("spring-mass-damper", ["x0", "v0", "s.s"])
    result = model.simulate((0, 1), initial={"s.s": 0.9}, method="dop853", **TIGHT)
    assert result["s.s"][0] == 0.9
    assert result.s[:, :, 0].tolist() == [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]
    assert np.all(result.sensitivity("s.s", "x0") == 0.0)
    same = model.simulate((0, 1), parameters={"x0": 0.9}, method="dop853", **TIGHT)
    assert abs(result["s.s"][-1] - same["s.s"][-1]) < 1e-13


def _differences(run, name, value, h):
    above, below = run({name: value + h}), run({name: value - h})
    return (above - below) / (2 * h)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("parameter", ["L", "m2", "s0"])
def test_output_sensitivity_against_finite_differences(model_of, parameter):
    model = model_of("slider-pendulum")
    t = [0.5, 1.0, 3.0, 10.0]

    def run(parameters):
        settings = {"t_eval": t, "parameters": parameters, "method": "dop853"}
        return model.simulate((0, 10), **settings, **TIGHT)["rod_x"]

    result = model.simulate((0, 10), t_eval=t, method="dop853", **TIGHT)
    value = dict(zip(model.parameters, model.default_parameters, strict=True))[parameter]
    found = _differences(run, parameter, value, 1e-4)
    # Truncation h**2 f'''/6 is about 1e-8; errors of the runs 1e-12 / h are as small.
    np.testing.assert_allclose(result.sensitivity("rod_x", parameter), found, atol=1e-7)


def test_the_output_is_where_the_rod_is(model_of):
    result = model_of("slider-pendulum").simulate((0, 2), method="dop853", **TIGHT)
    expected = result["j1.s"] + 0.5 * np.sin(result["h2.theta"])
    np.testing.assert_allclose(result["rod_x"], expected, atol=1e-15)
    along = result.sensitivity("rod_x", "L")
    theta, theta_l = result["h2.theta"], result.sensitivity("h2.theta", "L")
    by_hand = result.sensitivity("j1.s", "L") + 0.5 * np.sin(theta) + 0.5 * np.cos(theta) * theta_l
    np.testing.assert_allclose(along, by_hand, atol=1e-15)


def test_an_autonomous_system_does_not_look_at_the_clock(model_of):
    model = model_of("slider-pendulum", ["L"])
    runs = [
        model.simulate((start, start + 2), t_eval=[start + 2], method="dop853", **TIGHT)
        for start in (0.0, 50.0)
    ]
    # Times near 50 are rounded to 7e-15, and so are steps.
    np.testing.assert_allclose(runs[0].y, runs[1].y, atol=1e-11)
    np.testing.assert_allclose(runs[0].s, runs[1].s, atol=1e-11)


def test_energy_is_lost_to_the_damper_alone(model_of):
    """Without damping the slider-pendulum keeps its energy."""
    model = model_of("slider-pendulum", [])
    result = model.simulate((0, 10), parameters={"zeta": 0.0}, method="dop853", **TIGHT)
    s, theta, v, w = result.y
    m1, m2, length, r, _, k, s0, g = model.default_parameters
    inertia = m2 * (r**2 / 4 + length**2 / 3)
    kinetic = (m1 + m2) * v**2 / 2 + inertia * w**2 / 2 + m2 * length / 2 * np.cos(theta) * v * w
    energy = kinetic + k * (s - s0) ** 2 / 2 - m2 * g * length / 2 * np.cos(theta)
    # Order 8 at rtol 1e-12: a few hundred steps.
    assert np.max(np.abs(energy - energy[0])) < 1e-10


@pytest.mark.parametrize("method", ["auto", "cvode", "LSODA"])
def test_default_tolerances_reach_what_they_promise(model_of, scene_name, method):
    t, states, _ = reference(scene_name)
    result = model_of(scene_name).simulate((0, 10), t_eval=t, method=method)
    assert result.success
    # rtol=1e-8: multistep methods accumulate a few hundred local errors.
    for state, expected in states.items():
        assert error(result[state], expected) < 3e-6
