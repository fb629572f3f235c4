"""Redundant loops at loose tolerances: a projection far beyond the tolerance is a failed step."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from reference_scenes import read_reference, scene_of

import cotree

# Corners of Bricard's mechanism, a way along six edges of a cube; hinges stand across both rods.
CORNERS = [(0, 0, 0), (1, 0, 0), (1, -1, 0), (1, -1, 1), (0, -1, 1), (0, 0, 1)]
AXES = [(0, 1, 0), (0, 0, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 0)]
TIMES = np.linspace(0.0, 12.0, 25)


@pytest.fixture(scope="module")
def model() -> cotree.Model:
    """Five rods of 1 m and 1 kg and the ground, six hinges, one of six conditions redundant."""
    scene, node = cotree.Scene("bricard", gravity=[0, -9.81, 0]), "ground"
    for i in range(5):
        rod = np.subtract(CORNERS[i + 1], CORNERS[i])
        initial = {"theta": 0.0, "theta_dot": 0.0} if i == 0 else {}
        scene.edge(f"j{i}", "revolute", node, f"A{i}", axis=list(AXES[i]), initial=initial)
        scene.edge(f"c{i}", "arm", f"A{i}", f"C{i}", vector=(rod / 2).tolist())
        scene.edge(f"r{i}", "arm", f"A{i}", f"B{i}", vector=rod.tolist())
        inertia = np.where(rod == 0, 1.0 / 12.0, 1e-4).tolist()
        scene.edge(f"m{i}", "rigid_body", "ground", f"C{i}", mass=1.0, inertia=inertia)
        node = f"B{i}"
    scene.edge("base", "arm", "ground", "E", vector=list(CORNERS[5]))
    scene.edge("j5", "revolute", node, "E", axis=list(AXES[5]))
    scene.output("energy", "energy.kinetic + energy.potential")
    for axis in "xyz":
        scene.output(f"p3{axis}", f"B2.{axis}")
    return scene.compile(optimize="-O0")


@pytest.fixture(scope="module")
def places(model: cotree.Model) -> np.ndarray:
    """Return the path of P3 by dop853 at rtol 1e-10, which conserves the energy."""
    result = model.simulate((0, 12), TIMES, "dop853", 1e-10, 1e-12, throw=True)
    assert np.ptp(result["energy"]) < 1e-7
    return np.array([result[f"p3{axis}"] for axis in "xyz"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "rtol", "metres", "joules"),
    [
        # A projection took P3 1.8 m and 4.3 J away in one step; what is left are errors of steps.
        ("dopri5", 1e-3, 0.05, 0.4),
        ("rkf45", 1e-3, 0.2, 0.7),
        ("dop853", 1e-3, 1e-4, 1e-3),
        ("dopri5", 1e-4, 1e-3, 1e-3),
        # With rates and Jacobians taken off redundant constraints cvode was 1.3 m and 4.8 J off in
        # 12,000 steps, and ida 1.2 m.
        ("cvode", 1e-4, 0.02, 0.1),
        ("cvode", 1e-5, 3e-4, 1e-3),
        ("ida", 1e-4, 5e-3, 0.02),
    ],
)
def test_no_step_goes_another_way(
    model: cotree.Model, places: np.ndarray, method: str, rtol: float, metres: float, joules: float
) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of redundant constraints
        result = model.simulate((0, 12), TIMES, method, rtol, rtol, throw=True, max_steps=1000)
    found = np.array([result[f"p3{axis}"] for axis in "xyz"])
    assert np.max(np.abs(found - places)) < metres
    assert np.ptp(result["energy"]) < joules
    assert result.drift.correction < 10 * rtol  # and not 1.0


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("method", "rtol", "limit"),
    [
        *((method, 1e-2, 1e-3) for method in ("dop853", "dopri5", "rkf45")),
        *((method, 1e-3, 1e-4) for method in ("cvode", "ida")),
    ],
)
def test_looser_tolerances_fail(
    model: cotree.Model, method: str, rtol: float, limit: float
) -> None:
    """At 1e-2 runs of 12 s ended by up to 3 m aside; at 1e-3 that of cvode ends 0.3 m aside."""
    with pytest.warns(RuntimeWarning, match=f"redundant.*give an rtol of {limit:g} or less"):
        result = model.simulate((0, 0.2), [0.2], method, rtol, rtol)
    assert not result.success


@pytest.mark.parametrize("method", ["dopri5", "rkf45"])
def test_loose_tolerances_are_warned_of(model: cotree.Model, method: str) -> None:
    with pytest.warns(RuntimeWarning, match=f"constraints are redundant, and errors of {method}"):
        model.simulate((0, 0.2), [0.2], method, 1e-3, 1e-3)
    assert model.simulate((0, 0.2), [0.2], method, 1e-4, 1e-4).success


@pytest.mark.slow
@pytest.mark.parametrize(("method", "rtol"), [("rodas4", 1e-9), ("rodas5", 1e-10)])
def test_no_energy_is_lost_where_links_fall_in_one_line(method: str, rtol: float) -> None:
    """The N-four-bar with N = 2, whose links first are in one line at t = 0.71 s."""
    model = scene_of(read_reference("iftomm_a02_fourbar_N2")).compile(optimize="-O0")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of a run that stops there
        result = model.simulate((0, 1), [0.5, 0.7, 1.0], method, rtol, rtol, max_steps=3000)
    assert result.success or result.t[-1] > 0.7
    assert np.ptp(result["energy"]) < 1e-6
