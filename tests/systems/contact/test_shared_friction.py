"""Dry friction on joints that move together, and where a joint does not move with the motion."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from scipy.optimize import brentq

from cotree import Scene

pytestmark = pytest.mark.compiler

TIGHT = {"rtol": 1e-10, "atol": 1e-12}
METHODS = ("dop853", "rodas5", "dopri5", "cvode")


def _tied(seed: int) -> tuple[Scene, Scene, list[tuple[str, float, float]]]:
    """Draw hinges that turn together, and the one shaft that they amount to."""
    rng = np.random.default_rng([15, seed])
    n = int(rng.integers(2, 5))
    ratios = np.append(1.0, rng.choice([-2.5, -1, 0.5, 1, 3], n - 1))
    inertias, limits = rng.uniform(0.1, 1, n), rng.uniform(0.05, 0.6, n) * (rng.random(n) < 0.8)
    limits[0] = max(limits[0], 0.1)
    torque = f"{rng.uniform(0, 3)}*sin({rng.uniform(0.5, 6)}*t) + ({rng.normal() * 0.3})"
    speed = 0.0 if rng.random() < 0.5 else float(rng.normal() * 2)
    scene, one, rubs = Scene("tied"), Scene("one"), []
    for made in (scene, one):
        made.parameter("F", float(limits[0]))
    for i, ratio in enumerate(ratios.tolist()):
        given = {} if i else {"torque": torque, "initial": {"theta": 0.0, "theta_dot": speed}}
        scene.edge(f"h{i}", "revolute", "ground", f"n{i}", axis=[0, 0, 1], **given)
        scene.edge(f"b{i}", "rigid_body", "ground", f"n{i}", mass=0.0, inertia=float(inertias[i]))
        if i and rng.random() < 0.5:
            ends = {"coordinate1": f"h{i}.theta", "coordinate2": "h0.theta"}
            scene.edge(f"g{i}", "gear", "n0", f"n{i}", ratio=ratio, **ends)
        elif i:
            text = f"h{i}.theta - ({ratio})*h0.theta"
            scene.edge(f"g{i}", "constraint", "n0", f"n{i}", expression=text)
        if limits[i]:
            limit = float(limits[i]) if i else "F"
            scene.edge(f"f{i}", "rotational_dry_friction", joint=f"h{i}", torque=limit)
            scene.output(f"o{i}", f"f{i}.tau")
            rubs.append((f"o{i}", ratio, float(limits[i])))
    whole, rest = float(inertias @ ratios**2), float(np.abs(ratios[1:]) @ limits[1:])
    start = {"w": speed, "theta": 0.0}
    one.edge("J", "rotational_inertia", "ground", "a", inertia=whole, initial=start)
    one.edge("T", "torque_source", "ground", "a", torque=torque)
    one.edge("f", "rotational_dry_friction", "ground", "a", torque=f"F + {rest}")
    one.output("held", "f.tau")
    return scene, one, rubs


def _check_tied(seed: int) -> None:
    scene, one, rubs = _tied(seed)
    times = np.sort(np.random.default_rng(seed).uniform(0, 4, 40))
    alone = one.compile(["F"]).simulate((0, 4), t_eval=times, **TIGHT)
    method = METHODS[seed % len(METHODS)]
    found = scene.compile(["F"]).simulate((0, 4), method=method, t_eval=times, **TIGHT)
    assert found.status == 0, found.message
    # Errors of both runs, some hundred tolerances.
    assert found["h0.theta"] == pytest.approx(alone["J.theta"], abs=1e-7)
    slopes = [run.sensitivity(name, "F") for run, name in ((found, "h0.theta"), (alone, "J.theta"))]
    assert slopes[0] == pytest.approx(slopes[1], abs=1e-6)
    assert sum(found[name] * ratio for name, ratio, _ in rubs) == pytest.approx(
        alone["held"], abs=1e-6
    )
    for name, _, limit in rubs:
        assert np.max(np.abs(found[name])) <= limit + 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_friction_on_joints_that_turn_together_amounts_to_one(seed):
    _check_tied(seed)


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.parametrize("first", range(4, 244, 12))
def test_random_joints_that_turn_together_have_one_friction(first):
    for seed in range(first, first + 12):
        _check_tied(seed)


R, J, M, F, W, START = 0.2, 0.3, 0.7, 0.5, 6.0, 0.5


def _yoke(**of_crank) -> Scene:
    """A crank moves a slider by S.x = R cos(theta), with friction at the slider."""
    scene = Scene("yoke")
    scene.edge("h", "revolute", "ground", "A", axis=[0, 0, 1], **of_crank)
    scene.edge("wheel", "rigid_body", "ground", "A", mass=0.0, inertia=J)
    scene.edge("arm", "arm", "A", "P", vector=[R, 0, 0])
    scene.edge("p", "prismatic", "ground", "S", axis=[1, 0, 0])
    scene.edge("slider", "rigid_body", "ground", "S", mass=M)
    scene.edge("y", "constraint", "P", "S", expression="S.x - P.x")
    scene.parameter("F", F)
    scene.edge("f", "translational_dry_friction", joint="p", force="F")
    scene.output("held", "f.f")
    scene.output("v", "S.vx")
    return scene


NODES, WEIGHTS = leggauss(30)


def _by_work(t_end: float) -> tuple[float, float]:
    """Return the angle of the crank at a time, and its derivative by the force of friction.

    Energy gives the speed at each angle, and its reciprocal the time.
    """

    def inertia(q: np.ndarray) -> np.ndarray:
        return J + M * R**2 * np.sin(q) ** 2

    def way(q: np.ndarray) -> np.ndarray:
        """Return the way of the slider from the angle zero: 2 R for each half turn."""
        turns = np.floor(q / np.pi)
        return R * (2 * turns + 1 - np.cos(q - np.pi * turns))

    def speed(q: np.ndarray) -> np.ndarray:
        energy = inertia(np.array(START)) * W**2 / 2 - F * (way(q) - way(np.array(START)))
        return np.sqrt(2 * energy / inertia(q))

    def time(angle: float) -> tuple[float, float]:
        ends = np.array([START, *np.arange(np.pi / 4, angle, np.pi / 4), angle])
        q = ends[:-1, None] + np.diff(ends)[:, None] * (NODES + 1) / 2
        shares = np.diff(ends)[:, None] * WEIGHTS / 2 / speed(q)
        slope = shares * (way(q) - way(np.array(START))) / (inertia(q) * speed(q) ** 2)
        return float(np.sum(shares)), float(np.sum(slope))

    angle = float(brentq(lambda q: time(q)[0] - t_end, START + 1, START + W * t_end, xtol=1e-15))
    return angle, -float(speed(np.array(angle))) * time(angle)[1]


@pytest.mark.parametrize("method", METHODS)
def test_a_slider_with_friction_passes_its_dead_centres(method):
    scene = _yoke(initial={"theta": START, "theta_dot": W})
    result = scene.compile(["F"]).simulate((0, 3), method=method, rtol=1e-11, atol=1e-13)
    assert result.status == 0, result.message
    angle, slope = _by_work(3.0)
    assert angle > START + 5 * np.pi  # five dead centres at least
    # Cvode errs by some thousand tolerances of 1e-11.
    close = 1e-8 if method == "cvode" else 1e-9
    assert result["h.theta"][-1] == pytest.approx(angle, abs=close)
    assert result.sensitivity("h.theta", "F")[-1] == pytest.approx(slope, abs=close)


@pytest.mark.parametrize("method", METHODS)
def test_a_driven_slider_rubs_against_its_speed(method):
    result = _yoke(motion=f"{W}*t + {START}").compile(["F"]).simulate((0, 3), method=method)
    assert result.status == 0, result.message
    moving = np.abs(result["v"]) > 1e-3
    side = np.sign(result["v"][moving])
    assert result["held"][moving] == pytest.approx(F * side, abs=1e-12)
    assert result.sensitivity("held", "F")[moving] == pytest.approx(side, abs=1e-12)


@pytest.mark.parametrize("start", [0.5, 1.4])
def test_forces_that_follow_friction_are_found_with_it(start):
    """A torque of -0.3 times that of friction: in a law of its own, or in a field of the joint."""
    found = []
    for is_own in (True, False):
        scene = Scene("follower", gravity=[0, -9.81, 0])
        scene.parameter("F", 0.9)
        given = {} if is_own else {"torque": "-0.3*f.tau"}
        initial = {"theta": start}
        scene.edge("h", "revolute", "ground", "A", axis=[0, 0, 1], initial=initial, **given)
        scene.edge("a", "arm", "A", "B", vector=[1.0, 0, 0])
        scene.edge("b", "rigid_body", "ground", "B", mass=1.0)
        scene.edge("f", "rotational_dry_friction", joint="h", torque="F")
        if is_own:
            scene.edge("T", "torque_source", joint="h", torque="-0.3*f.tau")
        result = scene.compile(["F"]).simulate((0, 3), method="dop853", **TIGHT)
        found.append((result["h.theta"][-1], result.sensitivity("h.theta", "F")[-1]))
    # Two ways to solve the same equations, each to some hundred tolerances.
    assert found[0] == pytest.approx(found[1], abs=1e-8)
