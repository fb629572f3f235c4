from __future__ import annotations

import dataclasses
import importlib.util

import numpy as np
import pytest
from ivp_cases import oscillator, oscillator_exact, robertson, scalar

from cotree.solvers import choose_method, integrate


def test_oscillator_is_not_stiff():
    method, reason = choose_method(oscillator())
    assert method == "DOP853"
    assert "not stiff" in reason


def test_fast_oscillation_is_not_stiffness():
    def rhs(t, z):
        return np.array([z[1], -1e8 * z[0]])

    problem = oscillator(
        rhs=rhs,
        jacobian=lambda t, y: np.array([[0.0, 1.0], [-1e8, 0.0]]),
        n_sensitivities=0,
        z0=np.array([1.0, 0.0]),
    )
    assert choose_method(problem)[0] == "DOP853"


def test_stiffness_that_shows_after_a_few_steps():
    # At the start Robertson's fastest decay rate is 0.04.
    method, reason = choose_method(robertson(40.0))
    assert method == "cvode"
    assert "stiff" in reason


@pytest.mark.parametrize("has_jacobian", [True, False])
def test_stiff_without_sundials(has_jacobian, monkeypatch):
    problem = scalar(lambda t, x: -1e5 * x, lambda t, x: -1e5)
    if not has_jacobian:
        problem = dataclasses.replace(problem, jacobian=None)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert choose_method(problem)[0] == "BDF"


def test_backwards_in_time_growth_is_decay():
    forwards = scalar(lambda t, x: 1e5 * x, lambda t, x: 1e5, t_span=(0.0, 1e-4))
    backwards = dataclasses.replace(forwards, t_span=(2.0, 0.0))
    assert choose_method(forwards)[0] == "DOP853"
    assert choose_method(backwards)[0] == "cvode"


def test_auto_integrates_and_says_why():
    times = np.linspace(0, 5, 11)
    result = integrate(oscillator(times, rtol=1e-10, atol=1e-12), "auto")
    assert result.statistics.method == "DOP853"
    assert "DOP853 was chosen" in result.message
    # Order 8 at rtol = 1e-10 over 30 oscillations.
    np.testing.assert_allclose(result.z, oscillator_exact(times), atol=1e-8)


def test_auto_leaves_what_cannot_start_to_the_solver():
    result = integrate(scalar(lambda t, x: float("nan"), None), "auto")
    assert result.status == -1
    assert "'x' is nan" in result.message
