"""Friction of contacts on balls: a ball that rolls off another one, spins on it, and collides."""

from __future__ import annotations

from math import cos, sin

import mpmath as mp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import cotree

G = 9.81
TIGHT = {"method": "dop853", "rtol": 1e-11, "atol": 1e-13}
START = 0.1  # angle of the line of centres to the vertical, at the start


def on_a_ball(mu, plane):
    """Build a ball that begins to roll on a fixed one; ``plane`` is the azimuth, None if planar."""
    scene = cotree.Scene("ball", gravity=[0, -G, 0] if plane is None else [0, 0, -G])
    for name, value in {"mu": mu, "R": 1.0, "r": 0.25, "w": 0.1}.items():
        scene.parameter(name, value)
    out, up = f"(R + r)*{sin(START)!r}", f"(R + r)*{cos(START)!r}"
    if plane is None:
        initial = {"x": out, "y": up, "x_dot": f"w*{up}", "y_dot": f"-w*{out}"}
        initial["theta_dot"] = "-(R + r)*w/r"
        inertia = "2/5*m*r**2"
    else:
        c, s = f"{cos(plane)!r}", f"{sin(plane)!r}"
        initial = {"x": f"{out}*{c}", "y": f"{out}*{s}", "z": up}
        initial |= {"vx": f"w*{up}*{c}", "vy": f"w*{up}*{s}", "vz": f"-w*{out}"}
        initial |= {"w1": f"-(R + r)*w/r*{s}", "w2": f"(R + r)*w/r*{c}"}
        inertia = ["2/5*m*r**2"] * 3
    scene.parameter("m", 2.0)
    scene.edge("b", "rigid_body", "ground", "P", mass="m", inertia=inertia, initial=initial)
    scene.edge("c", "rigid_contact", "ground", "P", ball="R", radius="r", friction="mu")
    return scene


def leaves(mu, R, r, w):
    """Return the times at which the ball slips and lifts.

    With the square u of the rate of the angle a, rolling obeys 7/5 (R + r) u' = 2 g sin(a), and
    sliding (R + r) u' = 2 (g sin(a) - mu n), where the normal force n = g cos(a) - (R + r) u.
    """
    length, g = R + r, mp.mpf(G)

    def rolling(a):
        return w**2 + 10 * g / length / 7 * (mp.cos(START) - mp.cos(a))

    def excess(a):
        return 2 * g * mp.sin(a) / 7 - mu * (g * mp.cos(a) - length * rolling(a))

    slip = mp.findroot(excess, (START, mp.acos(mp.mpf(10) / 17)), solver="anderson")
    k = 2 * mu
    b = (k * mu - 1) * 2 * g / length / (1 + k * k)
    a = k * b - 2 * g * mu / length

    def sliding(x):
        first = rolling(slip) - a * mp.sin(slip) - b * mp.cos(slip)
        return a * mp.sin(x) + b * mp.cos(x) + first * mp.exp(k * (x - slip))

    off = mp.findroot(lambda x: g * mp.cos(x) - length * sliding(x), slip + 0.05)
    until = mp.quad(lambda x: 1 / mp.sqrt(rolling(x)), mp.linspace(START, slip, 6))
    return until, until + mp.quad(lambda x: 1 / mp.sqrt(sliding(x)), [slip, off]), off


@pytest.mark.parametrize("mu", [0.5, 10.0])
@pytest.mark.parametrize("plane", [None, 0.7])
def test_a_ball_rolls_slips_and_leaves_another(mu, plane):
    names = ["mu", "R", "r", "w"]
    result = on_a_ball(mu, plane).compile(names).simulate((0, 1.2), **TIGHT)
    slips = "c.slide1 slips" + (" forwards" if plane is None else "")
    with mp.workdps(30):
        given = {name: mp.mpf(v) for name, v in zip(names, (mu, 1.0, 0.25, 0.1), strict=True)}
        exact = leaves(**given)
        for i, event in enumerate((slips, "c.normal lifts")):
            assert abs(result.events[event].t[0] - float(exact[i])) <= 1e-11
            for name, value in given.items():
                slope = mp.diff(lambda v, n=name, i=i: leaves(**{**given, n: v})[i], value, h=1e-9)
                assert abs(result.event_sensitivity(event, name)[0] - float(slope)) <= 1e-9


def test_a_ball_that_cannot_slip_leaves_at_ten_seventeenths():
    """Rolling from rest on the top it leaves at cos(a) = 10/17, without friction at 2/3."""
    top, rate = cos(START), 0.1**2 * 1.25 / G
    for mu, share in ((1e5, 10 / 17), (1e-9, 2 / 3)):
        result = on_a_ball(mu, None).compile().simulate((0, 1.2), **TIGHT)
        gone = result.events["c.normal lifts"].t[0]
        run = on_a_ball(mu, None).compile().simulate((0, gone), **TIGHT)
        # Energy at the start adds a share of that angle; forces change by mu or 1/mu.
        exact = share * top + share * rate * (0.7 if mu > 1 else 0.5)
        assert abs(run["b.y"][-1] / 1.25 - exact) <= 1e-5


def spinning(x, end):
    """Return place and spin of a ball that rolls on a fixed ball and spins about the normal.

    With v = r w x n the moments about the contact are (I + m r^2) w' = m r n x g - m r^2 n x (w x
    n'). ``x``: inclination at the start, rate, spin and the radius R.
    """
    tilt, rate, turn, big = x
    r = 0.25
    n = np.array([np.sin(tilt), 0.0, np.cos(tilt)], dtype=complex)
    across = np.array([np.cos(tilt), 0.0, -np.sin(tilt)], dtype=complex)
    v = (big + r) * rate * across + 0 * n

    def rates(t, z):
        n, w = z[:3], z[3:]
        turned = np.cross(w, n) * r / (big + r)
        moment = r * np.cross(n, [0, 0, -G]) - r**2 * np.cross(n, np.cross(w, turned))
        return np.concatenate([turned, moment / (1.4 * r**2)])

    start = np.concatenate([n, np.cross(n, v) / r + turn * n])
    z = solve_ivp(rates, (0, end), start, method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]
    return np.concatenate([(big + r) * z[:3], z[3:]])


def test_a_spinning_ball_rolls_on_another_along_a_curve():
    start = {"tilt": 0.2, "rate": 0.15, "turn": 40.0, "R": 1.0}
    end = 0.6
    scene = cotree.Scene("spinning", gravity=[0, 0, -G])
    for name, value in start.items():
        scene.parameter(name, value)
    out, up, v = "(R + 0.25)*sin(tilt)", "(R + 0.25)*cos(tilt)", "(R + 0.25)*rate"
    initial = {"x": out, "z": up, "vx": f"{v}*cos(tilt)", "vz": f"-{v}*sin(tilt)"}
    initial |= {"w1": "turn*sin(tilt)", "w2": f"{v}/0.25", "w3": "turn*cos(tilt)"}
    scene.edge("b", "rigid_body", "ground", "P", mass=2.0, inertia=[0.05] * 3, initial=initial)
    scene.edge("c", "rigid_contact", "ground", "P", ball="R", radius=0.25, friction=2.0)
    result = scene.compile(list(start)).simulate((0, end), **TIGHT)
    assert not len(result.events["c.slide1 slips"].t)
    names = ["b.x", "b.y", "b.z"]
    exact = spinning(np.array(list(start.values()), dtype=complex), end)
    np.testing.assert_allclose([result[name][-1] for name in names], exact[:3].real, atol=1e-9)
    for i, parameter in enumerate(start):
        changed = np.array(list(start.values()), dtype=complex)
        changed[i] += 1e-30j
        slope = spinning(changed, end)[:3].imag / 1e-30
        found = [result.sensitivity(name, parameter)[-1] for name in names]
        np.testing.assert_allclose(found, slope, atol=1e-9)


@pytest.mark.parametrize("mu", [0.05, 0.9])
def test_two_balls_collide_obliquely_and_slide_or_stick(mu):
    """Impulses follow from the masses at the contact: n = (1 + e) v / (1/m + 1/M)."""
    scene = cotree.Scene("collision")
    values = {"mu": mu, "e": 0.6, "m": 1.0, "M": 3.0, "v": 2.0, "spin": 9.0}
    for name, value in values.items():
        scene.parameter(name, value)
    c, s = 0.8, 0.6  # the line of centres at the impact, which is 0.1 s after the start
    first = {"x": f"0.3*{c} + 0.1*v", "y": 0.3 * s, "x_dot": "-v", "theta_dot": "spin"}
    scene.edge("b", "rigid_body", "ground", "P", mass="m", inertia="0.4*m*0.1**2", initial=first)
    scene.edge("B", "rigid_body", "ground", "Q", mass="M", inertia="0.4*M*0.2**2")
    scene.edge("c", "rigid_contact", "Q", "P", ball=0.2, radius=0.1, friction="mu", restitution="e")
    names = list(values)
    result = scene.compile(names).simulate((0, 0.3), **TIGHT)

    def after(mu, e, m, M, v, spin):
        n = (1 + e) * v * c / (1 / m + 1 / M)
        # The slip along normal x z; each ball's 1/m + r^2/I is 3.5/m.
        slip = -v * s + 0.1 * spin
        t = -slip / (3.5 / m + 3.5 / M)
        if abs(t) > abs(mu * n):
            t = -mu * n * np.sign(slip.real)
        return np.array(
            [-v + (n * c + t * s) / m, (n * s - t * c) / m, spin + t / (0.4 * m * 0.1),
             (-n * c - t * s) / M, (-n * s + t * c) / M, t / (0.4 * M * 0.2)]
        )  # fmt: skip

    speeds = [f"{body}.{q}_dot" for body in "bB" for q in ("x", "y", "theta")]
    np.testing.assert_allclose([result[q][-1] for q in speeds], after(**values).real, atol=1e-10)
    for name, value in values.items():
        found = [result.sensitivity(q, name)[-1] for q in speeds]
        exact = after(**{**values, name: value + 1e-30j})
        np.testing.assert_allclose(found, exact.imag / 1e-30, atol=1e-9)
