"""A ladder against a wall: two contacts with friction that stick, slide and lift."""

from __future__ import annotations

from math import atan, pi

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import cotree

G, LENGTH, MASS, MU = 9.81, 2.0, 3.0, 0.2
INERTIA = MASS * LENGTH**2 / 12


def ladder():
    """Lean a ladder against a wall, th above the floor."""
    scene = cotree.Scene("ladder", gravity=[0, -G, 0])
    scene.parameter("mu", MU)
    scene.parameter("th", 1.0)
    place = {"theta": "pi - th", "x": f"{LENGTH}/2*cos(th)", "y": f"{LENGTH}/2*sin(th)"}
    scene.edge("b", "rigid_body", "ground", "P", mass=MASS, inertia=INERTIA, initial=place)
    scene.edge("low", "arm", "P", "B", vector=[-LENGTH / 2, 0, 0])
    scene.edge("high", "arm", "P", "T", vector=[LENGTH / 2, 0, 0])
    scene.edge("floor", "rigid_contact", "ground", "B", normal=[0, 1, 0], friction="mu")
    scene.edge("wall", "rigid_contact", "ground", "T", normal=[1, 0, 0], friction="mu")
    return scene


def sliding(angle, rate, mu):
    """Return the acceleration of the angle and the force of the wall while both ends slide."""
    c, s, half = np.cos(angle), np.sin(angle), LENGTH / 2
    matrix = [
        [-MASS * half * s, mu, -1.0],
        [MASS * half * c, -1.0, -mu],
        [-INERTIA, half * (s * mu - c), half * (c * mu + s)],
    ]
    turn = MASS * half * rate**2
    found = np.linalg.solve(matrix, [turn * c, turn * s - MASS * G, 0.0])
    return found[0], found[2]


def falling(angle, rate, mu):
    """Return the accelerations of the angle and of the centre after the wall is left."""
    c, s, half = np.cos(angle), np.sin(angle), LENGTH / 2
    matrix = [[MASS * half * c, -1.0], [INERTIA, half * (c - s * mu)]]
    turn, force = np.linalg.solve(matrix, [MASS * half * s * rate**2 - MASS * G, 0.0])
    return turn, -mu * force / MASS


def motion(mu, th, end):
    """Return angle and place of the ladder at the end, and the time at which it leaves the wall."""

    def leaves(_, z):
        return sliding(z[0], z[1], mu)[1].real

    leaves.terminal = True
    tight = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14}

    def slides(_, z):
        return [z[1], sliding(z[0], z[1], mu)[0]]

    run = solve_ivp(slides, (0, end), [th + 0j, 0j], events=leaves, **tight)
    angle, rate = run.y[:, -1]
    t, half = run.t[-1], LENGTH / 2
    start = [angle, rate, half * np.cos(angle), -half * np.sin(angle) * rate]
    if t < end:

        def rates(_, z):
            turn, shift = falling(z[0], z[1], mu)
            return [z[1], turn, z[3], shift]

        start = solve_ivp(rates, (t, end), start, **tight).y[:, -1]
    return np.array([pi - start[0], start[2]]), t


def test_it_stands_where_friction_bears_it_at_every_angle():
    """Gaps of the start are zero up to rounding, on either side of it."""
    model = ladder().compile()
    limit = atan((1 - MU**2) / (2 * MU))
    for th in np.linspace(0.9, 1.3, 41):
        result = model.simulate((0, 0.3), parameters={"th": float(th)})
        assert result.success, (th, result.message)
        assert (abs(result["b.theta"][-1] - (pi - th)) < 1e-12) == (th > limit), th


@pytest.mark.parametrize("method", ["dop853", "dopri5", "rodas4", "rodas5", "cvode", "ida"])
@pytest.mark.parametrize("end", [0.4, 0.85])
def test_it_slides_down_and_leaves_the_wall(end, method):
    model = ladder().compile(["mu", "th"])
    result = model.simulate((0, end), method=method, rtol=1e-11, atol=1e-13)
    place, lifted = motion(MU, 1.0, end)
    # Global errors of cvode and ida, with slopes of up to some hundred after the wall is left.
    close = 1e-7 if method in ("cvode", "ida") else 1e-9
    found = [result["b.theta"][-1], result["b.x"][-1]]
    np.testing.assert_allclose(found, place.real, rtol=close, atol=close)
    assert {name for name, row in result.events.items() if row.t.size} == (
        {"wall.normal lifts"} if lifted < end else set()
    )
    for name, (mu, th) in {"mu": (1e-30j, 0.0), "th": (0.0, 1e-30j)}.items():
        slope = motion(MU + mu, 1.0 + th, end)[0].imag / 1e-30
        found = [result.sensitivity(state, name)[-1] for state in ("b.theta", "b.x")]
        np.testing.assert_allclose(found, slope, rtol=close, atol=close)


@pytest.mark.parametrize("rtol", [1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize("method", ["dopri5", "rodas5", "cvode"])
def test_errors_of_speeds_cause_no_impacts(method, rtol):
    """A contact that was held has no speed at which it could be hit as another one lifts."""
    result = ladder().compile(["mu"]).simulate((0, 0.77), method=method, rtol=rtol, atol=rtol / 100)
    assert result.success, result.message
    assert {name for name, row in result.events.items() if row.t.size} == {"wall.normal lifts"}
