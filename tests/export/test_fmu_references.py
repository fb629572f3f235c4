"""Models of the Modelica Association's Reference-FMUs, as scenes.

The trajectories that are published with these FMUs come from Euler's method with a fixed step; a
few of their points stand here. They differ from exact solutions by the error of that method.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from fmu_importer import Unit

from cotree import Scene


def _dahlquist():
    scene = Scene("dahlquist")
    scene.parameter("k", 1.0)
    scene.edge("x", "heat_capacitor", "a", "ground", capacity=1.0, initial={"T": 1.0})
    scene.edge("loss", "thermal_resistor", "a", "ground", resistance="1/k")
    scene.output("level", "a.T")
    return scene


def _van_der_pol():
    scene = Scene("van-der-pol")
    scene.parameter("mu", 1.0)
    force = "mu*(1 - x.s**2)*x.s_dot - x.s"
    start = {"s": 2.0, "s_dot": 0.0}
    axis = [1, 0, 0]
    scene.edge("x", "prismatic", "ground", "A", axis=axis, force=force, initial=start)
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0)
    scene.output("x0", "x.s")
    scene.output("x1", "x.s_dot")
    return scene


def _state_space():
    scene = Scene("state-space")
    for i in (1, 2, 3):
        scene.input(f"u{i}", float(i))
        scene.edge(f"x{i}", "heat_capacitor", f"a{i}", "ground", capacity=1.0, initial={"T": 0.0})
        scene.edge(f"f{i}", "heat_source", "ground", f"a{i}", heat_flow=f"a{i}.T + u{i}")
        scene.output(f"y{i}", f"a{i}.T + u{i}")
    return scene


def _bouncing_ball():
    scene = Scene("ball", gravity=(0.0, 0.0, -9.81))
    scene.parameter("e", 0.7)
    scene.mode("free", 1.0)
    axis = [0, 0, 1]
    scene.edge(
        "j", "prismatic", "ground", "B", axis=axis, force="(1 - free)*9.81", initial={"s": 1.0}
    )
    scene.edge("ball", "rigid_body", "ground", "B", mass=1.0)
    scene.output("h", "j.s")
    leaves = "(1 + sign(-e*j.s_dot - 0.1))/2"
    new = {"j.s_dot": f"-e*j.s_dot*{leaves}", "free": leaves}
    scene.event("hit", "j.s", direction=-1, set=new)
    return scene


def _values(scene, path, times, names, kind):
    """Simulate an FMU at tight tolerances."""
    scene.compile().export_fmu(path)
    found = []
    with Unit(path, kind) as unit:
        unit.initialize(1e-12)
        t = 0.0
        for end in times:
            if end > t:
                unit.step(t, end - t)
            t = end
            found.append(unit.get(*names))
    return np.array(found)


def test_dahlquist(tmp_path):
    times = [0.0, 0.1, 1.0, 10.0]
    found = _values(_dahlquist(), tmp_path / "x.fmu", times, ["level"], "CoSimulation")[:, 0]
    np.testing.assert_allclose(found, np.exp(-np.array(times)), atol=1e-9)
    # Euler's method with steps of 0.1 has factors of 0.9, and errs by at most h/2 max|x''| t.
    published = [1.0, 0.9, 0.9**10, 0.00002656139888758746]
    assert np.all(np.abs(found - published) <= 0.05 * np.array(times) + 1e-12)


def test_state_space(tmp_path):
    names = ["y1", "y2", "y3"]
    times = [0.0, 1.0, 10.0]
    found = _values(_state_space(), tmp_path / "x.fmu", times, names, "CoSimulation")
    exact = np.outer(np.exp(times), [1.0, 2.0, 3.0])
    np.testing.assert_allclose(found, exact, rtol=1e-9)
    # The published values are those of (1 + h)^n for steps of h = 1e-3.
    published = [2.7169239322358925, 21916.681339078466]
    for row, value, n in zip(found[1:], published, (1000, 10000), strict=True):
        assert value == pytest.approx(1.001**n, rel=1e-9)
        assert abs(row[0] - value) <= 0.5e-3 * (n / 1000) * math.exp(n / 1000)


def _euler(h, t_end):
    x = np.array([2.0, 0.0])
    for _ in range(round(t_end / h)):
        x = x + h * np.array([x[1], (1.0 - x[0] ** 2) * x[1] - x[0]])
    return x


def test_van_der_pol(tmp_path):
    path = tmp_path / "x.fmu"
    found = _values(_van_der_pol(), path, [20.0], ["x0", "x1"], "CoSimulation")[0]
    published = np.array([2.0148418861546133, 0.24419470751904407])
    np.testing.assert_allclose(_euler(1e-2, 20.0), published, rtol=1e-9)
    # The error of a method of first order is about twice what halving its step changes.
    error = 2.0 * np.abs(published - _euler(5e-3, 20.0))
    # In the largest component: where a component turns round, its own error is of second order.
    assert np.max(np.abs(found - published)) <= 1.5 * np.max(error)
    # d(der x1)/d mu is (1 - x0^2) x1: -3 where x0 = 2 and x1 = 1, in every mode.
    with Unit(path) as unit:
        unit.initialize()
        unit.update()
        unit.fmu.enterContinuousTimeMode()
        unit.go(0.0, np.array([2.0, 1.0]))
        assert unit.slopes(["der(x.s_dot)"], ["mu"]).tolist() == [[-3.0]]
        assert unit.adjoints(["der(x.s_dot)"], ["mu"]).tolist() == [[-3.0]]


def _exact_height(t):
    """The height of a ball that loses 0.3 of its speed in each bounce and rests below 0.1 m/s."""
    g, v = 9.81, math.sqrt(2 * 9.81)
    at = v / g
    if t < at:
        return 1.0 - 0.5 * g * t * t
    while True:
        v *= 0.7
        if v < 0.1:
            return 0.0
        if t < at + 2 * v / g:
            return v * (t - at) - 0.5 * g * (t - at) ** 2
        at += 2 * v / g


def test_bouncing_ball(tmp_path):
    times = np.arange(0.0, 3.001, 0.1)
    found = _values(_bouncing_ball(), tmp_path / "x.fmu", times, ["h"], "CoSimulation")[:, 0]
    np.testing.assert_allclose(found, [_exact_height(t) for t in times], atol=1e-9)
    # The published row at 0.01 s: steps of 1e-3 s, each of which errs by g h^2 / 2.
    assert abs(_exact_height(0.01) - 0.99955855) <= 10 * 9.81 * 0.5e-6 * 1.001
    assert abs(found[-1]) <= 1e-9  # at rest, as in the last published row


@pytest.mark.parametrize("n_steps", [1, 3])
@pytest.mark.parametrize("n_teeth", [5, 60])
def test_co_simulation_misses_no_crossing(tmp_path, n_teeth, n_steps):
    """Under a square wave of its angle an inertia keeps its energy, less the work."""
    scene = Scene("motor")
    scene.mode("count", 0.0)
    scene.edge(
        "J", "rotational_inertia", "ground", "A", inertia=0.1, initial={"w": 10.0, "theta": 0.1}
    )
    scene.edge("M", "torque_source", "ground", "A", torque=f"2*sign(sin({n_teeth}*J.theta))")
    scene.event("tooth", f"cos({n_teeth}*J.theta)", set={"count": "count + 1"})
    path = tmp_path / "motor.fmu"
    scene.compile().export_fmu(path, kinds=["CoSimulation"])
    with Unit(path, "CoSimulation") as unit:
        unit.initialize(1e-9)
        for k in range(n_steps):
            unit.step(2.0 * k / n_steps, 2.0 / n_steps)
        q, w, count = unit.get("J.theta", "J.w", "count")
    start, end = (math.acos(math.cos(n_teeth * x)) / n_teeth for x in (0.1, q))
    # A jump that is missed changes the energy by a share; tolerances by 1e-9 at each of them.
    assert w * w == pytest.approx(100.0 + 40.0 * (end - start), rel=1e-6)
    passed = [math.floor(n_teeth * x / math.pi + 0.5) for x in (0.1, q)]
    assert count == passed[1] - passed[0]
