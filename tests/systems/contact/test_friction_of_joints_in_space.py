"""Friction of spherical, universal and cylindrical joints with their reactions."""

from __future__ import annotations

from math import cos, sin

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import cotree

G = 9.81
TIGHT = {"method": "dop853", "rtol": 1e-11, "atol": 1e-13}
CLOSE = 1e-9
LOAD = "sqrt(h.fx**2 + h.fy**2 + h.fz**2)"


def slopes(function, given):
    """Return the derivatives of a function by each argument, by complex steps."""
    return {name: function(**{**given, name: v + 1e-30j}).imag / 1e-30 for name, v in given.items()}


def norm(a):
    """Return the length of a vector whose entries may be complex."""
    return np.sqrt(np.sum(a * a))


def implicit(function, start):
    """Return the fixed point of a contraction."""
    for _ in range(60):
        before, start = start, function(start)
        if start == before:
            break
    return start


def test_smooth_friction_of_a_ball_joint_is_against_the_spin():
    """A sphere about its centre: sinh(w/d) decays at the rate M/(J d), in a fixed direction."""
    given = {"mu": 0.2, "R": 0.05, "m": 2.0, "J": 0.01, "d": 0.5, "a": 3.0, "b": -1.0}
    scene = cotree.Scene("sphere", gravity=[0, 0, -G])
    for name, value in given.items():
        scene.parameter(name, value)
    spin = {"w1": "a", "w2": "b", "w3": 0.7, "rotation": [0.3, -0.4, 1.0]}
    scene.edge("h", "spherical", "ground", "A", initial=spin)
    scene.edge("b", "rigid_body", "ground", "A", mass="m", inertia=["J"] * 3)
    scene.edge("F", "rotational_friction", joint="h", torque=f"mu*R*{LOAD}", transition="d")
    result = scene.compile(list(given)).simulate((0, 2.0), **TIGHT)

    def speed(mu, R, m, J, d, a, b):
        start = np.sqrt(a**2 + b**2 + 0.7**2)
        now = d * np.arcsinh(np.sinh(start / d) * np.exp(-mu * R * m * G * 2.0 / (J * d)))
        return now * np.array([a, b, 0.7]) / start

    names = ["h.w1", "h.w2", "h.w3"]
    np.testing.assert_allclose([result[q][-1] for q in names], speed(**given), atol=CLOSE)
    for name in given:
        found = [result.sensitivity(q, name)[-1] for q in names]
        np.testing.assert_allclose(found, slopes(speed, given)[name], atol=CLOSE)


def ball_pendulum(mu, length, d, w):
    """Return the angular velocity of a bob on a rod, whose joint has smooth friction, after 1 s."""
    m, own, g = 2.0, np.array([0.1, 0.1, 0.05]), np.array([0, 0, -G])
    arm = np.array([0, 0, -1.0]) * length
    inertia = own + m * length**2 * np.array([1, 1, 0])
    tilt = np.array([[1, 0, 0], [0, cos(1.0), -sin(1.0)], [0, sin(1.0), cos(1.0)]])

    def rates(t, z):
        turn, spin = z[:9].reshape(3, 3), z[9:]
        weight = turn.T @ g

        def change(load):
            speed = norm(spin)
            drag = mu * load * np.tanh(speed / d) * spin / speed
            moment = m * np.cross(arm, weight) - drag - np.cross(spin, inertia * spin)
            return moment / inertia

        def load(guess):
            lift = np.cross(change(guess), arm) + np.cross(spin, np.cross(spin, arm)) - weight
            return m * norm(lift)

        cross = np.array([[0, -spin[2], spin[1]], [spin[2], 0, -spin[0]], [-spin[1], spin[0], 0]])
        return np.concatenate([(turn @ cross).ravel(), change(implicit(load, m * G + 0j))])

    start = np.concatenate([tilt.ravel(), [0.3, w, 2.0]]).astype(complex)
    run = solve_ivp(rates, (0, 1.0), start, method="DOP853", rtol=1e-12, atol=1e-14)
    return run.y[9:, -1]


def test_smooth_friction_of_a_ball_joint_follows_its_reaction():
    given = {"mu": 0.05, "length": 1.3, "d": 0.3, "w": 1.5}
    scene = cotree.Scene("pendulum", gravity=[0, 0, -G])
    for name, value in given.items():
        scene.parameter(name, value)
    start = {"rotation": [1.0, 0, 0], "w1": 0.3, "w2": "w", "w3": 2.0}
    scene.edge("h", "spherical", "ground", "A", initial=start)
    scene.edge("rod", "arm", "A", "B", vector=[0, 0, "-length"])
    scene.edge("b", "rigid_body", "ground", "B", mass=2.0, inertia=[0.1, 0.1, 0.05])
    scene.edge("F", "rotational_friction", joint="h", torque=f"mu*{LOAD}", transition="d")
    result = scene.compile(list(given)).simulate((0, 1.0), **TIGHT)
    names = ["h.w1", "h.w2", "h.w3"]
    exact = ball_pendulum(**given).real
    np.testing.assert_allclose([result[q][-1] for q in names], exact, atol=CLOSE)
    for name, slope in slopes(ball_pendulum, given).items():
        found = [result.sensitivity(q, name)[-1] for q in names]
        np.testing.assert_allclose(found, slope, atol=CLOSE)


def cross_pendulum(mu, length, p, q, end):
    """Return angles and rates of a mass whose two pins slide; place l (-sin q, sin p cos q, ...).

    Each pin bears the reaction of the joint, with the moment mu |F|.
    """
    m = 2.0

    def rates(t, z):
        p, q, u, v = z
        sp, cp, sq, cq = np.sin(p), np.cos(p), np.sin(q), np.cos(q)

        def change(load):
            first = -m * G * length * sp * cq - mu * load * np.sign(u.real)
            first += 2 * m * length**2 * cq * sq * u * v
            second = -m * G * length * cp * sq - mu * load * np.sign(v.real)
            second -= m * length**2 * cq * sq * u * u
            return first / (m * length**2 * cq**2), second / (m * length**2)

        def load(guess):
            a, b = change(guess)
            lift = [
                -b * cq + v * v * sq,
                a * cp * cq - sp * cq * (u * u + v * v) - 2 * u * v * cp * sq - b * sp * sq,
                a * sp * cq + cp * cq * (u * u + v * v) - 2 * u * v * sp * sq + b * cp * sq,
            ]
            return m * norm(length * np.array(lift) + np.array([0, 0, G]))

        return [u, v, *change(implicit(load, m * G + 0j))]

    start = np.array([p, q, 1.0, -0.8], dtype=complex)
    return solve_ivp(rates, (0, end), start, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]


def test_both_pins_of_a_universal_joint_rub_with_its_reaction():
    given = {"mu": 0.08, "length": 1.3, "p": -0.6, "q": 0.5}
    scene = cotree.Scene("cross", gravity=[0, 0, -G])
    for name, value in given.items():
        scene.parameter(name, value)
    start = {"theta1": "p", "theta2": "q", "theta1_dot": 1.0, "theta2_dot": -0.8}
    axes = {"axis": [1, 0, 0], "axis2": [0, 1, 0]}
    scene.edge("h", "universal", "ground", "A", initial=start, **axes)
    scene.edge("rod", "arm", "A", "B", vector=[0, 0, "-length"])
    scene.edge("b", "rigid_body", "ground", "B", mass=2.0)
    for pin in ("theta1", "theta2"):
        scene.edge(pin, "rotational_dry_friction", joint=f"h.{pin}", torque=f"mu*{LOAD}")
    end = 0.4
    model = scene.compile(list(given))
    result = model.simulate((0, end), **TIGHT)
    names = ["h.theta1", "h.theta2", "h.theta1_dot", "h.theta2_dot"]
    exact = cross_pendulum(**given, end=end).real
    np.testing.assert_allclose([result[n][-1] for n in names], exact, atol=CLOSE)
    for name, value in given.items():
        slope = cross_pendulum(**{**given, name: value + 1e-30j}, end=end).imag / 1e-30
        found = [result.sensitivity(n, name)[-1] for n in names]
        np.testing.assert_allclose(found, slope, atol=CLOSE)
    # At rest each pin holds up to mu m g.
    rest = model.simulate((0, 20), **TIGHT)
    assert rest["theta1.mode"][-1] == rest["theta2.mode"][-1] == 0.0
    held = np.array([sin(rest["h.theta1"][-1]) * cos(rest["h.theta2"][-1]),
                     cos(rest["h.theta1"][-1]) * sin(rest["h.theta2"][-1])])  # fmt: skip
    assert np.max(np.abs(held)) * 1.3 <= 0.08 + CLOSE


@pytest.mark.parametrize("tilt", [0.2, 0.6])
def test_a_rod_in_a_sleeve_slides_and_turns_with_friction_by_the_normal_force(tilt):
    given = {"mu": 0.3, "R": 0.04, "m": 1.5, "J": 0.02, "v": 2.0, "w": 6.0}
    scene = cotree.Scene("sleeve", gravity=[0, 0, -G])
    for name, value in given.items():
        scene.parameter(name, value)
    axis, across = [cos(tilt), 0, sin(tilt)], [-sin(tilt), 0, cos(tilt)]
    start = {"s_dot": "v", "theta_dot": "w"}
    scene.edge("h", "cylindrical", "ground", "A", axis=axis, initial=start)
    scene.edge("b", "rigid_body", "ground", "A", mass="m", inertia=["J"] * 3)
    normal = f"sqrt((h.fx*{across[0]!r} + h.fz*{across[2]!r})**2 + h.fy**2)"
    scene.edge("S", "translational_dry_friction", joint="h.s", force=f"mu*{normal}")
    scene.edge("T", "rotational_dry_friction", joint="h.theta", torque=f"mu*R*{normal}")
    result = scene.compile(list(given)).simulate((0, 1.0), **TIGHT)

    def stops(mu, R, m, J, v, w):
        return v / (G * (np.sin(tilt) + mu * np.cos(tilt)))

    def turned(mu, R, m, J, v, w):
        return w**2 * J / (2 * mu * R * m * G * np.cos(tilt))

    def slid(mu, R, m, J, v, w):
        up = stops(mu, R, m, J, v, w)
        down = G * max(0.0, sin(tilt) - 0.3 * cos(tilt)) and G * (sin(tilt) - mu * cos(tilt))
        return v * up / 2 - down * (1.0 - up) ** 2 / 2

    assert abs(result.events["S stops"].t[0] - stops(**given)) <= CLOSE
    for name, slope in slopes(stops, given).items():
        assert abs(result.event_sensitivity("S stops", name)[0] - slope) <= CLOSE
    for q, exact in {"h.s": slid, "h.theta": turned}.items():
        assert abs(result[q][-1] - exact(**given)) <= CLOSE
        for name, slope in slopes(exact, given).items():
            # Relative to slopes of up to some hundreds.
            assert abs(result.sensitivity(q, name)[-1] - slope) <= CLOSE * max(1, abs(slope))
