"""Late times: what succeeds is right to the tolerance, and all else names t and its rounding."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
import pytest

import cotree
from cotree.methods import METHODS
from cotree.solvers.native import is_available

INSTALLED = [name for name in METHODS if is_available(name)]

# Multistep methods err by three tolerances at t = 0, too.
ALLOWED = 5e-6


@pytest.fixture(scope="module")
def decay() -> cotree.Model:
    """v = exp(-t/2) from where it begins, and d v/d R = t/4 exp(-t/2)."""
    scene = cotree.Scene("decay")
    scene.parameter("R", 2.0)
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0, initial={"v": 1.0})
    scene.edge("R", "resistor", "a", "ground", resistance="R")
    return scene.compile(["R"])


@pytest.fixture(scope="module")
def driven() -> cotree.Model:
    """v' = (sin(t) - v)/2 from v = 1."""
    scene = cotree.Scene("driven")
    scene.edge("V", "voltage_source", "b", "ground", voltage="sin(t)")
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0, initial={"v": 1.0})
    scene.edge("R", "resistor", "b", "a", resistance=2.0)
    return scene.compile()


def run(
    model: cotree.Model, start: float, length: float, method: str, **more: Any
) -> cotree.Result:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of failures, which are looked at here
        settings = {"method": method, "rtol": 1e-6, "atol": 1e-9, **more}
        return model.simulate((start, start + length), **settings)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", INSTALLED)
def test_motion_that_knows_no_time_is_right_at_any(decay: cotree.Model, method: str) -> None:
    shares = np.array([0.0, 0.25, 0.5, 1.0])  # exact in the times below
    for start in (-1e9, 1.7e9, 1e11, 1e12, 1e13, 1e14, 1e15):
        for direction in (1.0, -1.0):
            result = run(decay, start, direction, method, t_eval=start + direction * shares)
            if not result.success:
                assert start >= 1e12
                assert "s apart, too far for the steps" in result.message
                continue
            t = result.t - start
            assert np.allclose(result["C.v"], np.exp(-t / 2), rtol=0.0, atol=ALLOWED)
            exact = t / 4 * np.exp(-t / 2)
            assert np.allclose(result.sensitivity("C.v", "R"), exact, rtol=0.0, atol=ALLOWED)
            steps = run(decay, start, direction, method).t
            assert np.all(direction * np.diff(steps) > 0.0)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", INSTALLED)
def test_motion_that_is_driven_is_right_or_refused(driven: cotree.Model, method: str) -> None:
    for start in (1.7e9, 1e11, 1e12, 1e13, 1e14):
        result = run(driven, start, 3.0, method)
        if not result.success:
            assert start >= 1e11
            assert "s apart" in result.message
            continue
        exact = driven_value(start, 3.0)
        assert result["C.v"][-1] == pytest.approx(exact, abs=ALLOWED)


def driven_value(start: float, length: float) -> float:
    """Return v: the decaying part of the start plus a (a sin t - cos t)/(a^2 + 1), for a = 1/2."""

    def steady(t: float) -> float:
        return 0.5 * (0.5 * math.sin(t) - math.cos(t)) / 1.25

    return steady(start + length) + (1.0 - steady(start)) * math.exp(-0.5 * length)


def test_rounding_of_time_names_both(driven: cotree.Model) -> None:
    """A method that is happy with too few times is not: RK45 at 1e13, 0.002 s from time to time."""
    result = run(driven, 1e13, 3.0, "RK45")
    assert result.status == -1
    assert "at t = 1e+13 times are 0.002 s apart, and over steps of" in result.message
    loose = driven.simulate((1e13, 1e13 + 3), method="RK45", rtol=1e-2, atol=1e-2)
    assert loose.success
    assert loose["C.v"][-1] == pytest.approx(driven_value(1e13, 3.0), abs=2e-2)


@pytest.mark.parametrize("method", ["LSODA", "rodas5"])
def test_tight_tolerances_at_ordinary_times_are_no_matter_of_rounding(method: str) -> None:
    """A stiff voltage follows its source through zero, where only atol is left of its tolerance.

    Five volts at 50 Hz change by 5e-15 V between times at 0.02 s, which no run can tell apart.
    """
    scene = cotree.Scene("follower")
    scene.edge("S", "sine_voltage", "s", "ground", amplitude=5.0, frequency=50.0)
    scene.edge("R", "resistor", "s", "a", resistance=10.0)
    scene.edge("C", "capacitor", "a", "ground", capacitance=1e-9)
    result = run(scene.compile(), 0.0, 0.02, method, rtol=1e-12, atol=1e-14)
    assert result.success, result.message
    omega, tau = 100.0 * math.pi, 1e-8
    slow = np.sin(omega * result.t) - omega * tau * np.cos(omega * result.t)
    exact = 5.0 / (1.0 + (omega * tau) ** 2) * (slow + omega * tau * np.exp(-result.t / tau))
    # Rounding of 5 V and of t in some ten thousand steps; steps' errors are 5e-12 V each.
    assert np.allclose(result["C.v"], exact, rtol=0.0, atol=1e-10)
