"""Finite differences of runs against the closed form of an oscillator."""

from __future__ import annotations

import numpy as np
import pytest

from cotree import ParameterError, Scene
from cotree.check import RepeatedRun, quantities, sensitivities


def oscillator() -> RepeatedRun:
    """x'' = -k x from x(0) = a, x'(0) = 0: x = a cos(sqrt(k) t)."""
    scene = Scene("oscillator")
    scene.parameter("k", 4.0)
    scene.parameter("a", 0.5)
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0)
    scene.edge("s", "prismatic", "ground", "A", axis=[1, 0, 0], stiffness="k", initial={"s": "a"})
    scene.output("twice", "2*s.s")
    model = scene.compile(["k", "s.s"])
    settings = {"method": "dop853", "rtol": 1e-12, "atol": 1e-14}
    return RepeatedRun(model, np.linspace(0.0, 2.0, 9), settings)


def test_differences_are_derivatives() -> None:
    experiment = oscillator()
    t = experiment.t_eval
    found = experiment.central_difference("k", 1e-3)
    exact = -0.5 * np.sin(2.0 * t) * t / 4.0
    assert experiment.quantities == ("s.s", "s.s_dot", "twice")
    assert found.shape == (3, 9)
    # Truncation of h**2 / 6 times the third derivative by k, below 0.1.
    np.testing.assert_allclose(found[0], exact, atol=1e-7)
    np.testing.assert_allclose(found[2], 2.0 * exact, atol=2e-7)


def test_states_mean_their_initial_values() -> None:
    experiment = oscillator()
    assert experiment.value("s.s") == 0.5
    found = experiment.central_difference("s.s", 0.1)
    # Linear in the initial value: integration errors of 1e-12 over the step remain.
    np.testing.assert_allclose(found[0], np.cos(2.0 * experiment.t_eval), atol=1e-9)
    np.testing.assert_allclose(sensitivities(experiment.run(), "s.s"), found, atol=1e-9)


def test_values_of_the_settings_are_kept() -> None:
    experiment = oscillator()
    settings = {**experiment.settings, "parameters": {"a": 2.0}, "initial": {"s.s_dot": 1.0}}
    other = RepeatedRun(experiment.model, experiment.t_eval, settings)
    assert other.value("a") == 2.0
    assert other.value("s.s") == 2.0
    y = quantities(other.run({"k": 9.0}))
    t = other.t_eval
    np.testing.assert_allclose(y[0], 2.0 * np.cos(3.0 * t) + np.sin(3.0 * t) / 3.0, atol=1e-9)
    # What is given for one run is gone in the next.
    assert other.value("k") == 4.0


def test_size_of_a_step() -> None:
    experiment = oscillator()
    result = experiment.run()
    assert experiment.size("k", result) == 4.0
    # The largest rate on the way is a sqrt(k) = 1 at t = pi/4, near the fourth of nine times; at
    # the start it is zero.
    assert experiment.size("s.s_dot", result) == pytest.approx(1.0, abs=0.01)
    zero = RepeatedRun(
        experiment.model, experiment.t_eval, {**experiment.settings, "parameters": {"a": 0.0}}
    )
    assert zero.size("s.s", zero.run()) == 1.0


def test_refused_values_raise() -> None:
    with pytest.raises(ParameterError, match="k"):
        oscillator().run({"k": float("nan")})
