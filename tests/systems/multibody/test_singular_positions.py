"""Positions where constraints lose rank: said of these only; sensitivities pass or are refused."""

from __future__ import annotations

import copy
import warnings

import numpy as np
import pytest
from reference_scenes import absolute_tree, read_reference, scene_of
from scipy.integrate import solve_ivp

import cotree
from cotree.model.bound import BoundModel


def windows(n: int) -> cotree.Scene:
    """The N-four-bar of the IFToMM benchmark, whose links first fall in one line at t = 0.71 s."""
    reference = copy.deepcopy(read_reference("iftomm_a02_fourbar_N2"))
    topology = reference["topology"]
    crank, coupler = topology["bodies"]["V0"], topology["bodies"]["H0"]
    rows = [("V", i, crank, 0) for i in range(n + 1)] + [("H", i, coupler, "L") for i in range(n)]
    topology["bodies"] = {
        f"{kind}{i}": {**body, "initial": {**body["initial"], "r": [f"{i}*L", y]}}
        for kind, i, body, y in rows
    }
    joints = [(f"A{i}", ["ground", [f"{i}*L", 0]], [f"V{i}", [0, 0]]) for i in range(n + 1)]
    for i in range(n):
        joints.append((f"Bl{i}", [f"V{i}", ["L", 0]], [f"H{i}", [0, 0]]))
        joints.append((f"Br{i}", [f"H{i}", ["L", 0]], [f"V{i + 1}", ["L", 0]]))
    topology["joints"] = [
        {"name": name, "type": "revolute", "a": a, "b": b} for name, a, b in joints
    ]
    return scene_of(reference)


def as_a_pendulum(n: int, times: np.ndarray) -> np.ndarray:
    """The rate of the cranks, and its derivatives by g and v0, shape (3, n_times).

    All cranks turn as one: th'' = (g/L) ((N+1)/2 + N) / ((N+1)/3 + N) sin(th).
    """
    c = ((n + 1) / 2 + n) / ((n + 1) / 3 + n)

    def rates(t, y):
        pull, slope = 9.81 * c * np.sin(y[0]), 9.81 * c * np.cos(y[0])
        return [y[1], pull, y[3], slope * y[2] + c * np.sin(y[0]), y[5], slope * y[4]]

    start = [0, 1, 0, 0, 0, 1]
    found = solve_ivp(rates, (0, times[-1]), start, "DOP853", times, rtol=1e-12, atol=1e-13)
    return found.y[[1, 3, 5]]


@pytest.mark.sampled(1)
@pytest.mark.parametrize("method", ["dop853", "cvode"])
def test_sensitivities_pass_singular_positions(method: str) -> None:
    model, times = windows(2).compile(["g", "v0"], optimize="-O0"), np.linspace(0.25, 3, 12)
    result = model.simulate((0, 3), times, method, 1e-8, 1e-8, throw=True, max_steps=1000)
    found = [result["thdot"], *(result.sensitivity("thdot", p) for p in ("g", "v0"))]
    # Some forty steps of dop853, hundreds of cvode's, whose errors add up.
    for own, expected in zip(found, as_a_pendulum(2, times), strict=True):
        assert np.max(np.abs(own - expected)) < 3e-5 * np.max(np.abs(expected))


def test_links_in_one_line_are_said_to_lose_rank() -> None:
    model = windows(2).compile(optimize="-O0")
    projection, y = (
        BoundModel(model.kernels, 0.0, model.default_parameters),
        model.start().y,
    )
    assert projection.singular(0.0, y) == ()
    for name, value in (("A", 0.01), ("Bl", -0.01)):  # cranks 0.6 degrees above the line
        for i, state in enumerate(model.states):
            if state.startswith(name) and state.endswith("theta"):
                y[i] = value
    assert projection.singular(0.0, y) == ("Br0", "Br1")


@pytest.mark.parametrize(
    ("method", "rtol"),
    [
        ("dop853", 1e-8),
        pytest.param("dop853", 1e-10, marks=pytest.mark.slow),
        pytest.param("dop853", 1e-13, marks=pytest.mark.slow),
        pytest.param("dopri5", 1e-11, marks=pytest.mark.slow),
        pytest.param("rkf45", 1e-10, marks=pytest.mark.slow),
    ],
)
def test_tight_tolerances_pass_singular_positions(method: str, rtol: float) -> None:
    """A step that ends 1e-4 from a position loses eight digits of a sensitivity to rounding."""
    model, times = windows(2).compile(["g", "v0"], optimize="-O0"), np.linspace(0.25, 3, 12)
    result = model.simulate((0, 3), times, method, rtol, rtol, throw=True, max_steps=1000)
    found = [result["thdot"], *(result.sensitivity("thdot", p) for p in ("g", "v0"))]
    # A stretch as long as a step is crossed at 1e-9; elsewhere hundreds of errors of rtol add up.
    for own, expected in zip(found, as_a_pendulum(2, times), strict=True):
        assert np.max(np.abs(own - expected)) < max(1e-8, 300 * rtol) * np.max(np.abs(expected))
    if "crossed with a looser tolerance" in result.message:
        assert rtol < 1e-9
        assert "the constraints of 'Br0', 'Br1' lose rank" in result.message


@pytest.mark.slow
@pytest.mark.parametrize("rtol", [1e-8, 1e-10, 1e-12])
@pytest.mark.parametrize("coordinates", ["joints", "bodies"])
def test_outputs_may_lie_in_singular_positions(coordinates: str, rtol: float) -> None:
    """Of 601 outputs some are a thousandth of a radian away, between the ends of a step."""
    scene, times = windows(2), np.linspace(0.0, 3.0, 601)
    tree = absolute_tree(scene) if coordinates == "bodies" else None
    model = scene.compile(tree=tree, optimize="-O0")
    result = model.simulate((0, 3), times, "dop853", rtol, rtol, throw=True, max_steps=1000)
    rate = as_a_pendulum(2, times)[0]
    # Errors of some forty to a hundred steps add up; rounding, enlarged a thousandfold, is 1e-11.
    bound = max(1e-10, 30 * rtol) * np.max(np.abs(rate))
    assert np.max(np.abs(result["thdot"] - rate)) < bound


@pytest.mark.slow
def test_many_loops_pass_a_singular_position() -> None:
    model, times = windows(5).compile(["g"], optimize="-O0"), np.linspace(0.25, 3, 12)
    result = model.simulate((0, 3), times, "dop853", 1e-8, 1e-8, throw=True, max_steps=200)
    rate, by_g, _ = as_a_pendulum(5, times)
    # Some forty steps, whose errors add up.
    assert np.max(np.abs(result["thdot"] - rate)) < 1e-6 * np.max(np.abs(rate))
    assert np.max(np.abs(result.sensitivity("thdot", "g") - by_g)) < 1e-6 * np.max(np.abs(by_g))


@pytest.mark.slow
def test_sensitivities_that_rounding_decides_are_refused_by_name() -> None:
    """At 1e-12 rounding, a thousand times as large near the position, exceeds the tolerance."""
    model = windows(5).compile(["g"], optimize="-O0")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        result = model.simulate((0, 3), np.linspace(0.25, 3, 12), "dop853", 1e-12, 1e-12)
    if not result.success:  # rounding decides whether a step ends there
        assert result.statistics.n_steps < 6000  # it took 30,000 steps and more
        assert "constraints of 'Br0', 'Br1', 'Br2', 'Br3', 'Br4' nearly lose rank" in result.message


def rods(*lengths: float) -> tuple[cotree.Scene, str]:
    """Rods on hinges, the first of which turns at 8 rad/s; and where they end."""
    scene, end = cotree.Scene("rods", gravity=[0, -9.81, 0]), "ground"
    for name, length in zip("ABC", lengths, strict=False):
        initial = {"theta": 1.0, "theta_dot": 8.0} if name == "A" else {}
        scene.edge(name, "revolute", end, f"{name}1", axis=[0, 0, 1], initial=initial)
        scene.edge(f"c{name}", "arm", f"{name}1", f"{name}c", vector=[length / 2, 0, 0])
        scene.edge(f"e{name}", "arm", f"{name}1", f"{name}2", vector=[length, 0, 0])
        inertia = length**2 / 12.0
        scene.edge(f"b{name}", "rigid_body", "ground", f"{name}c", mass=1.0, inertia=inertia)
        end = f"{name}2"
    return scene, end


def four_bar() -> cotree.Scene:
    scene, end = rods(0.3, 0.9, 0.8)
    scene.edge("base", "arm", "ground", "D1", vector=[1.0, 0, 0])
    scene.edge("D", "revolute", "D1", end, axis=[0, 0, 1])
    return scene


def slider_crank() -> cotree.Scene:
    scene, end = rods(0.3, 1.0)
    scene.edge("guide", "prismatic", "ground", "S", axis=[1, 0, 0])
    scene.edge("slider", "rigid_body", "ground", "S", mass=0.8, inertia=0.01)
    scene.edge("pin", "revolute", "S", end, axis=[0, 0, 1])
    return scene


@pytest.mark.parametrize("make", [four_bar, pytest.param(slider_crank, marks=pytest.mark.slow)])
def test_regular_mechanisms_lose_no_rank(make) -> None:
    """Full turns in coordinates of bodies, where gradients are weakest."""
    scene = make()
    scene.output("energy", "energy.kinetic + energy.potential")
    model = scene.compile(tree=absolute_tree(scene), optimize="-O0")
    for method, rtol in (("dop853", 1e-12), ("dopri5", 1e-10), ("rodas5", 1e-10), ("cvode", 1e-10)):
        result = model.simulate((0, 1), [0.5, 1.0], method, rtol, rtol, throw=True)
        assert abs(result["bA.theta"][-1] - 1.0) > 2 * np.pi
        assert result.message == f"{method} reached t = 1."
        assert np.ptp(result["energy"]) < 1e4 * rtol


@pytest.mark.slow
def test_many_loops_side_by_side_are_no_singular_position() -> None:
    """Ten windows upright have a direction in which gradients are a tenth of their length."""
    scene = windows(10)
    model = scene.compile(tree=absolute_tree(scene), optimize="-O0")
    projection, y = (
        BoundModel(model.kernels, 0.0, model.default_parameters),
        model.start().y,
    )
    assert projection.singular(0.0, y) == ()
