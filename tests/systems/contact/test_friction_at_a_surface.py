"""Dry friction at the surface of a rod in a sleeve, which limits force and torque together.

The slip has the components v and R w. With k = m R^2/J, friction changes them by -a v/|u| and
-k a R w/|u|, so that R w is proportional to v^k, and the time is an integral over v.
"""

from __future__ import annotations

import shlex
import subprocess
from math import cos, sin

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss

import cotree
from cotree.errors import SceneError

G = 9.81
CLOSE = 1e-9
METHODS = ("dopri5", "rodas5")
NODES, WEIGHTS = leggauss(120)


def slopes(function, given):
    """Return the derivatives of a function by each argument, by complex steps."""
    return {name: function(**{**given, name: v + 1e-30j}).imag / 1e-30 for name, v in given.items()}


def rod(given, tilt=0.0, **fields):
    """Return a scene with a rod in a sleeve, with the weight m g sin(tilt) along it."""
    scene = cotree.Scene("rod", gravity=[-G * sin(tilt), 0, -G * cos(tilt)])
    for name, value in given.items():
        scene.parameter(name, value)
    start = {f"{q}_dot": rate for q, rate in {"s": "v", "theta": "w"}.items() if rate in given}
    scene.edge("h", "cylindrical", "ground", "A", axis=[1, 0, 0], initial=start)
    scene.edge("b", "rigid_body", "ground", "A", mass="m", inertia=["J"] * 3)
    normal = "sqrt(h.fy**2 + h.fz**2)"
    own = {"force": f"mu*{normal}", "radius": "R", **fields}
    scene.edge("F", "translational_dry_friction", joint="h", **own)
    scene.output("f", "F.along.f")
    scene.output("tau", "F.around.tau")
    return scene


def stop(mu, R, m, J, v, w):
    """Return time, way and angle until a rod that slides and turns comes to rest."""
    k, a = m * R**2 / J, mu * G
    # The substitution v = v0 x^8 makes the integrand smooth for any k.
    x, share = (NODES + 1) / 2, WEIGHTS / 2
    slip, turn = v * x**8, R * w * x ** (8 * k)
    shares = share * 8 * v * x**7 * np.sqrt(slip**2 + turn**2) / (a * slip)
    return np.array([np.sum(shares), np.sum(shares * slip), np.sum(shares * turn) / R])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("inertia", [0.0024, 0.0012, 0.003], ids=["tube", "solid", "heavy"])
def test_a_rod_that_slides_and_turns_stops_both_at_once(inertia, method):
    given = {"mu": 0.3, "R": 0.04, "m": 1.5, "J": inertia, "v": 1.2, "w": 25.0}
    result = rod(given).compile(list(given)).simulate((0, 1), method=method, rtol=1e-11, atol=1e-13)
    exact = stop(**given)
    found = [*result.events["F stops"].t, result["h.s"][-1], result["h.theta"][-1]]
    np.testing.assert_allclose(found, exact, rtol=0, atol=CLOSE)
    assert result["F.mode"][-1] == 0
    for name, value in given.items():
        slope = stop(**{**given, name: value + 1e-30j}).imag / 1e-30
        own = [result.sensitivity(q, name)[-1] for q in ("h.s", "h.theta")]
        found = [*result.event_sensitivity("F stops", name), *own]
        # Relative to slopes of up to some thousands.
        np.testing.assert_allclose(found, slope, rtol=CLOSE, atol=CLOSE)
    # The force is at its limit while the rod moves.
    moves = result["F.mode"] == 1
    size = np.hypot(result["f"], result["tau"] / 0.04)[moves]
    np.testing.assert_allclose(size, 0.3 * 1.5 * G, rtol=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_force_and_torque_together_break_a_rod_away(method):
    """A tube, J = m R^2, moves in the direction in which it breaks away."""
    given = {"mu": 0.3, "R": 0.04, "m": 1.5, "P": 6.0, "T": 0.3}
    scene = cotree.Scene("tube", gravity=[0, 0, -G])
    for name, value in given.items():
        scene.parameter(name, value)
    scene.edge("h", "cylindrical", "ground", "A", axis=[1, 0, 0])
    scene.edge("b", "rigid_body", "ground", "A", mass="m", inertia=["m*R**2"] * 3)
    own = {"force": "mu*sqrt(h.fy**2 + h.fz**2)", "radius": "R"}
    scene.edge("F", "translational_dry_friction", joint="h", **own)
    scene.edge("P", "force", "ground", "A", force=["P*t", 0, 0])
    scene.edge("T", "torque", "ground", "A", torque=["T*t", 0, 0])
    result = scene.compile(list(given)).simulate((0, 1), method=method, rtol=1e-10, atol=1e-12)

    def slips(mu, R, m, P, T):
        return mu * m * G / np.sqrt(P**2 + (T / R) ** 2)

    def speed(mu, R, m, P, T):
        return P * (1 - slips(mu, R, m, P, T)) ** 2 / (2 * m)

    assert abs(result.events["F slips"].t[0] - slips(**given)) <= CLOSE
    for name, slope in slopes(slips, given).items():
        found = result.event_sensitivity("F slips", name)[0]
        assert abs(found - slope) <= CLOSE * max(1, abs(slope))
    assert abs(result["h.s_dot"][-1] - speed(**given)) <= CLOSE
    for name, slope in slopes(speed, given).items():
        found = result.sensitivity("h.s_dot", name)[-1]
        assert abs(found - slope) <= CLOSE * max(1, abs(slope))


@pytest.mark.parametrize("method", METHODS)
def test_a_rod_that_turns_slides_down_where_one_at_rest_sticks(method):
    """A motor turns a rod, whose axial friction falls as v/sqrt(v^2 + (R w)^2): it creeps down."""
    tilt, given = 0.2, {"mu": 0.3, "R": 0.04, "m": 1.5, "J": 0.0024, "w": 10.0}
    assert np.tan(tilt) < given["mu"]
    scene = rod(given, tilt)
    # The torque of the motor is that of friction, so that the speed of rotation is constant.
    scene.edge("M", "torque_source", joint="h.theta", torque="F.around.tau")
    model = scene.compile(list(given))
    result = model.simulate((0, 12), method=method, rtol=1e-10, atol=1e-12)

    def speed(mu, R, m, J, w):
        return -R * w / np.sqrt((mu / np.tan(tilt)) ** 2 - 1)

    assert abs(result["h.s_dot"][-1] - speed(**given)) <= CLOSE
    for name, slope in slopes(speed, given).items():
        assert abs(result.sensitivity("h.s_dot", name)[-1] - slope) <= CLOSE
    rest = model.simulate((0, 1), method=method, parameters={"w": 0.0})
    assert rest["F.mode"][-1] == 0
    assert abs(rest["f"][-1] + 1.5 * G * sin(tilt)) <= CLOSE


def test_a_c_project_stops_a_rod(tmp_path):
    given = {"mu": 0.3, "R": 0.04, "m": 1.5, "J": 0.0012, "v": 1.2, "w": 25.0}
    project = rod(given).compile().write(tmp_path, "dop853")
    subprocess.run(shlex.split(project.command), cwd=tmp_path, check=True)
    command = [str(tmp_path / "rod"), "--t-end", "1", "--rtol", "1e-11", "--atol", "1e-13"]
    lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    found = dict(line.split("=")[:2] for line in lines if "=" in line)
    values = {name.strip(): float(text.split()[0]) for name, text in found.items()}
    _, way, angle = stop(**given)
    assert values["h.s"] == pytest.approx(way, abs=CLOSE)
    assert values["h.theta"] == pytest.approx(angle, abs=CLOSE)


def test_what_friction_at_a_surface_refuses():
    given = {"mu": 0.3, "R": 0.04, "m": 1.5, "J": 0.0024}
    with pytest.raises(SceneError, match="no backward direction: remove backward"):
        rod(given, backward=2.0).compile()
    with pytest.raises(SceneError, match=r"its force depends on the speed 'F.v'.*stribeck_speed"):
        rod(given, force=[[0, 3], [1, 2]]).compile()
    scene = cotree.Scene("rail")
    scene.edge("h", "prismatic", "ground", "A", axis=[1, 0, 0])
    scene.edge("b", "rigid_body", "ground", "A", mass=1.0)
    scene.edge("F", "translational_dry_friction", joint="h", force=1.0, radius=0.1)
    with pytest.raises(SceneError, match="radius of edge 'F' needs a cylindrical joint"):
        scene.compile()
