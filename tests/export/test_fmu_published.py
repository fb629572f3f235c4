"""Every published point of four Reference-FMUs, and closed forms, from FMUs that FMPy simulates.

The published trajectories are those of Euler's method. Their own step error is about twice what
halving the step changes; an exact trajectory is that far away and no farther.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from fmu_importer import simulated
from published import shared_folder
from test_fmu_references import (
    _bouncing_ball,
    _dahlquist,
    _exact_height,
    _state_space,
    _van_der_pol,
)

pytestmark = [pytest.mark.slow, pytest.mark.compiler]

CASES = [(kind, version) for kind in ("ModelExchange", "CoSimulation") for version in (3, 2)]


def _published(name):
    with (shared_folder("fmi") / f"{name}_out.csv").open() as file:
        next(file)
        rows = [line.replace(" ", ",").split(",") for line in file if line.strip()]
    values = np.array(rows, float)
    return values[:, 0], values[:, 1:]


def _simulated(scene, path, version, kind, t_end, interval, names):
    scene.compile().export_fmu(path, version)
    found = simulated(path, kind, t_end, interval, names, 1e-13)
    return np.asarray(found["time"]), np.column_stack([found[name] for name in names])


@pytest.mark.parametrize(("kind", "version"), CASES)
def test_dahlquist(tmp_path, kind, version):
    t, published = _published("Dahlquist")
    path = tmp_path / "x.fmu"
    times, found = _simulated(_dahlquist(), path, version, kind, t[-1], 0.1, ["level"])
    np.testing.assert_allclose(times, t, atol=1e-12)
    np.testing.assert_allclose(found[:, 0], np.exp(-t), atol=1e-9)
    # Each point of Euler's method is 0.9^n = exp(-1.0537 t): less by at most 0.054 t exp(-t).
    np.testing.assert_allclose(published[:, 0], 0.9 ** np.arange(len(t)), rtol=1e-12)
    assert np.all(np.abs(found - published)[:, 0] <= 0.054 * t * np.exp(-t) + 1e-9)


@pytest.mark.parametrize(("kind", "version"), CASES)
def test_state_space(tmp_path, kind, version):
    t, published = _published("StateSpace")
    names, path = ["y1", "y2", "y3"], tmp_path / "x.fmu"
    times, found = _simulated(_state_space(), path, version, kind, t[-1], 1.0, names)
    np.testing.assert_allclose(times, t, atol=1e-12)
    np.testing.assert_allclose(found, np.outer(np.exp(t), [1, 2, 3]), rtol=1e-9)
    # (1 + h)^(t/h) is less than e^t by a share of h t/2.
    assert np.all(np.abs(found - published) <= 0.5e-3 * t[:, None] * found + 1e-9)


def _euler(h, t, every):
    x = np.array([2.0, 0.0])
    rows = [x]
    for _ in range(len(t) - 1):
        for _ in range(every):
            x = x + h * np.array([x[1], (1.0 - x[0] ** 2) * x[1] - x[0]])
        rows.append(x)
    return np.array(rows)


@pytest.mark.parametrize(("kind", "version"), CASES)
def test_van_der_pol(tmp_path, kind, version):
    t, published = _published("VanDerPol")
    path = tmp_path / "x.fmu"
    times, found = _simulated(_van_der_pol(), path, version, kind, t[-1], 1e-2, ["x0", "x1"])
    np.testing.assert_allclose(times, t, atol=1e-9)
    np.testing.assert_allclose(published, _euler(1e-2, t, 1), atol=1e-9)
    # What is left after Richardson's extrapolation is of second order: 64 times less in each step.
    fine, finer = _euler(1e-2 / 64, t, 64), _euler(1e-2 / 128, t, 128)
    left = np.max(np.abs(2.0 * finer - fine - found))
    error = np.max(np.abs(published - found))
    assert left <= 1e-3 * error
    assert error <= 2.0 * np.max(np.abs(published - _euler(5e-3, t, 2))) * 1.2


@pytest.mark.parametrize(("kind", "version"), CASES)
def test_bouncing_ball(tmp_path, kind, version):
    t, published = _published("BouncingBall")
    path = tmp_path / "x.fmu"
    times, found = _simulated(_bouncing_ball(), path, version, kind, 3.0, 1e-2, ["h"])
    exact = np.array([_exact_height(at) for at in times])
    # FMPy looks for the events of Model Exchange to some 1e-12 s, and the bounces add up.
    assert np.max(np.abs(found[:, 0] - exact)) <= 1e-9
    # Steps of 1e-3 s err by g h t/2 in the fall, and an impact is up to a step late, at any speed.
    impact = math.sqrt(2 * 9.81)
    bound = 1e-3 * (0.5 * 9.81 * t + 4.0 * impact * (t > 0.45))
    own = np.array([_exact_height(at) for at in t])
    assert np.all(np.abs(own - published[:, 0]) <= bound + 1e-9)
