from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from fast_and_slow import cases
from ivp_cases import (
    oscillator,
    oscillator_exact,
    robertson,
    robertson_jacobian,
    scalar,
    shared_buffer,
)

from cotree.errors import SolveError
from cotree.methods import METHODS
from cotree.solvers import integrate

# Those that take Python functions.
ALL = [name for name, row in METHODS.items() if row.family == "scipy"]
LONG = ("RK23", "Radau")  # many steps at tight tolerances
SHORT = [name for name in ALL if name not in LONG]
IMPLICIT = [name for name, row in METHODS.items() if row.implicit and row.family == "scipy"]


def _error(trajectory) -> float:
    exact = oscillator_exact(trajectory.t)
    return float(np.max(np.abs(trajectory.z - exact) / np.maximum(1, np.abs(exact))))


@pytest.mark.sampled(2)
@pytest.mark.parametrize("damped", [True, False])
@pytest.mark.parametrize("method", cases(SHORT, ["Radau"]))
def test_closed_form_at_tight_tolerance(method, damped, monkeypatch):
    if not damped:
        monkeypatch.setattr("ivp_cases.DAMPING", 0.0)
    # Radau takes a thousand steps for one unit of time at this tolerance.
    end = 1.0 if method == "Radau" else 5.0
    times = np.linspace(0, end, 101)
    problem = oscillator(times, rtol=1e-12, atol=1e-14, t_span=(0.0, end))
    result = integrate(problem, method)
    assert result.status == 0, result.message
    assert np.array_equal(result.t, times)
    # Backward differences add up 3000 local errors of 1e-12, which nothing damps where the motion
    # is not damped; the others stay far below.
    multistep = 1e-9 if damped else 2e-9
    assert _error(result) < (1e-11 if method in ("RK45", "DOP853", "Radau") else multistep)


def test_closed_form_by_rk23():
    # Order 3 at 1e-12 would take a million steps; the global error here is about 30 rtol.
    result = integrate(oscillator(np.linspace(0, 5, 11), rtol=1e-8, atol=1e-10), "RK23")
    assert _error(result) < 1e-6


@pytest.mark.parametrize("method", ["RK23", "BDF", "LSODA"])
def test_outputs_between_steps_are_as_accurate_as_steps(method):
    rtol = 1e-6 if method == "RK23" else 1e-9
    problem = scalar(
        lambda t, x: x * math.cos(t), lambda t, x: math.cos(t), rtol=rtol, atol=rtol / 100
    )
    steps = integrate(problem, method)
    outputs = integrate(problem.with_settings(t_eval=np.linspace(0, 2, 201)), method)
    error = [np.max(np.abs(r.z[0] - np.exp(np.sin(r.t)))) for r in (steps, outputs)]
    # These show as 1.1 at most. The interpolants of RK45, DOP853 and Radau are weaker than their
    # steps, which shows as a factor of 15, 30 and 160.
    assert error[1] < 2 * error[0]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", ALL)
def test_own_steps_without_t_eval(method):
    result = integrate(oscillator(), method)
    assert result.t[0] == 0
    assert result.t[-1] == 5
    assert np.all(np.diff(result.t) > 0)
    assert result.z.shape == (6, result.t.size)
    assert result.statistics.n_steps == result.t.size - 1
    assert result.statistics.method == method


@pytest.mark.parametrize("method", ALL)
def test_backwards_in_time(method):
    times = np.array([2.0, 1.0, 0.5])
    problem = scalar(lambda t, x: -x, lambda t, x: -1, t_span=(2.0, 0.0), t_eval=times)
    result = integrate(problem, method)
    assert np.array_equal(result.t, times)
    # rtol = 1e-6 over two time constants, with a factor of 100 for the lowest orders.
    np.testing.assert_allclose(result.z[0], np.exp(2 - times), rtol=1e-4)


@pytest.mark.sampled(8)
@pytest.mark.parametrize("method", cases(SHORT, LONG))
@pytest.mark.parametrize(
    "times", [[0.0], [5.0], [0.0, 5.0], [2.5], [0.0, 1e-12, 1.0, np.nextafter(1.0, 2.0), 5.0]]
)
def test_edges_of_t_eval(method, times):
    result = integrate(oscillator(np.array(times), rtol=1e-8, atol=1e-10), method)
    assert result.status == 0, result.message
    assert np.array_equal(result.t, times)
    # A global error of 100 rtol, which BDF comes near to.
    assert _error(result) < 2e-6


@pytest.mark.sampled(1)
@pytest.mark.parametrize("method", ALL)
def test_kernels_that_reuse_their_buffer(method):
    problem = oscillator(np.linspace(0, 5, 11))
    plain = integrate(problem, method)
    shared = integrate(dataclasses.replace(problem, rhs=shared_buffer(problem)), method)
    assert np.array_equal(plain.z, shared.z)


@pytest.mark.parametrize("method", IMPLICIT)
def test_the_jacobian_is_used(method):
    calls = []

    def jacobian(t, y):
        calls.append(y.shape)
        return robertson_jacobian(t, y)

    result = integrate(robertson(40.0, jacobian=jacobian), method)
    assert result.statistics.njev == len(calls) > 0
    assert set(calls) == {(3,)}


@pytest.mark.parametrize("has_jacobian", [True, False])
@pytest.mark.parametrize("method", IMPLICIT)
def test_stiff_reactions_with_sensitivities(method, has_jacobian):
    problem = robertson(40.0)
    if not has_jacobian:
        problem = dataclasses.replace(problem, jacobian=None)
    result = integrate(problem, method)
    # Values of an integration in extended precision, 15 digits.
    exact = [
        0.715827068719405,
        9.185534764557764e-06,
        0.28416374574583037,
        -4.2475587717029,
        4.591196249250834e-05,
        4.247512859740408,
    ]
    # rtol = 1e-6 and up to 300 steps.
    np.testing.assert_allclose(result.z[:, -1], exact, rtol=1e-4)
    # SciPy's BDF took 12,000 Jacobians where the iteration matrix left second derivatives out.
    assert result.statistics.n_steps < 1000


@pytest.mark.sampled(1)
@pytest.mark.parametrize("method", IMPLICIT)
def test_sensitivities_outside_the_error_test_survive_a_stiff_problem(method):
    result = integrate(robertson(1e11, rtol=1e-8, error_test_sensitivities=False), method)
    assert result.status == 0, result.message
    # IDA lost a tenth of this value when its iteration left second derivatives out.
    exact = [2.083340149701294e-08, -1.0416672713408807e-06]
    np.testing.assert_allclose(result.z[[0, 3], -1], exact, rtol=2e-4)


@pytest.mark.parametrize("method", cases(SHORT, LONG))
def test_error_test_off_keeps_the_accuracy_of_states(method):
    times = np.linspace(0, 5, 21)
    tested = integrate(oscillator(times), method)
    untested = integrate(oscillator(times, error_test_sensitivities=False), method)
    # LSODA tests the largest entry in place of the mean square, and becomes stricter by sqrt(3);
    # with Adams' formulas of order 5 and more that is up to 3 ** (1 / 12) in steps.
    allowed = 1.15 if method == "LSODA" else 1.05
    assert untested.statistics.n_steps <= allowed * tested.statistics.n_steps
    exact = oscillator_exact(times)
    # The states' error at rtol = 1e-8 is at most 1e-6 with any method, tested or not.
    assert np.max(np.abs(untested.z[:2] - exact[:2])) < 2e-6
    # The sensitivities are of order 1 and follow the states' steps.
    assert np.max(np.abs(untested.z - exact)) < 1e-5


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", ALL)
@pytest.mark.parametrize("tests_sensitivities", [True, False])
def test_many_parameters_take_the_sparse_or_banded_way(method, tests_sensitivities):
    n_states, n_parameters = 12, 9
    rng = np.random.default_rng(0)
    matrix = rng.standard_normal((n_states, n_states)) - 5 * np.eye(n_states)
    values, vectors = np.linalg.eig(matrix)
    problem = oscillator(
        np.array([1.0]),
        rhs=lambda t, z: (z.reshape(-1, n_states) @ matrix.T).ravel(),
        jacobian=lambda t, y: matrix,
        n_states=n_states,
        n_sensitivities=n_parameters,
        z0=np.ones(n_states * (1 + n_parameters)),
        t_span=(0.0, 1.0),
        names=(),
        error_test_sensitivities=tests_sensitivities,
    )
    result = integrate(problem, method)
    exact = (vectors @ np.diag(np.exp(values)) @ np.linalg.inv(vectors) @ np.ones(n_states)).real
    # Global error at rtol = 1e-8, with a factor of 30 for the multistep methods.
    np.testing.assert_allclose(result.z.reshape(-1, n_states), [exact] * 10, atol=3e-7)


@pytest.mark.parametrize("method", ALL)
def test_pulse_between_breakpoints_is_not_stepped_over(method):
    problem = scalar(
        lambda t, x: 1.0 if 50 <= t < 50.01 else 0.0,
        lambda t, x: 0.0,
        z0=0.0,
        t_span=(0.0, 100.0),
        breakpoints=(50.0, 50.01, -3.0, 100.0, 400.0),
    )
    result = integrate(problem, method)
    # Exact up to the rounding of 50.01: every method integrates a constant exactly.
    assert result.z[0, -1] == pytest.approx(0.01, abs=1e-13)
    assert {50.0, 50.01} <= set(result.t)
    # Neither side of a jump is seen from the other, so no step is rejected there.
    assert result.statistics.n_steps < 100


@pytest.mark.parametrize("method", ALL)
def test_breakpoints_backwards_with_outputs(method):
    times = np.array([2.0, 1.5, 1.0, 0.5, 0.0])
    problem = scalar(
        lambda t, x: np.sign(t - 1), None, t_span=(2.0, 0.0), t_eval=times, breakpoints=(1.0,)
    )
    result = integrate(problem, method)
    np.testing.assert_allclose(result.z[0], [1.0, 0.5, 0.0, 0.5, 1.0], atol=1e-12)


@pytest.mark.parametrize("method", ALL)
def test_too_small_rtol_is_raised_and_said(method):
    problem = scalar(lambda t, x: -x, lambda t, x: -1.0, rtol=1e-16, t_span=(0.0, 0.1))
    result = integrate(problem, method)
    assert result.status == 0
    assert "rtol = 1e-16" in result.message


def test_unknown_method_names_the_nearest():
    with pytest.raises(SolveError, match=r"no method 'DOP835'.*'DOP853'"):
        integrate(oscillator(), "DOP835")


@pytest.mark.parametrize("method", ["cvode", "ida"])
def test_missing_sundials_names_the_package(method, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, f"sksundae.{method}", None)
    with pytest.raises(SolveError, match="pip install scikit-sundae"):
        integrate(oscillator(), method)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", ["dopri5", "rodas5", "cvode", "ida"])
def test_functions_of_python_are_left_to_scipy(method):
    if method in ("cvode", "ida"):
        pytest.importorskip("sksundae")
    result = integrate(oscillator(np.linspace(0, 5, 11)), method)
    assert result.statistics.method in ("RK45", "Radau", "BDF")
    assert f"was used instead of {method}: its equations are Python functions." in result.message
    assert _error(result) < 2e-6
