"""A rattleback, against equations of motion of its own that are written down here."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import cotree

# T. R. Kane, D. A. Levinson, Int. J. Non-Linear Mechanics 17 (1982) 175: semiaxes, height of the
# ellipsoid's centre above that of mass, mass, inertia.
SEMIAXES, HEIGHT, MASS, G = np.array([0.2, 0.03, 0.02]), 0.01, 1.0, 9.81
INERTIA = np.array([[2e-4, -2e-5, 0.0], [-2e-5, 1.6e-3, 0.0], [0.0, 0.0, 1.7e-3]])
LEAN, SPIN = np.deg2rad(0.5), -5.0


def contact_point(up):
    """Return the point of contact from the centre of mass, in the body's axes."""
    squares = SEMIAXES**2
    return np.array([0.0, 0.0, HEIGHT]) - squares * up / np.sqrt(squares @ up**2)


def rates(_, state):
    """Return the rates of angular velocity and upward direction, in the body's axes.

    Rolling means v = r x w; balance of momentum and of angular momentum about the centre of mass.
    """
    w, up = state[:3], state[3:]
    up_rate = np.cross(up, w)
    squares = SEMIAXES**2
    depth = np.sqrt(squares @ up**2)
    r = contact_point(up)
    r_rate = -squares * up_rate / depth + squares * up * (squares @ (up * up_rate)) / depth**3
    cross = np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])
    force = np.cross(r_rate, w) + np.cross(w, np.cross(r, w)) + G * up
    moment = -np.cross(w, INERTIA @ w) + MASS * np.cross(r, force)
    return np.concatenate([np.linalg.solve(INERTIA - MASS * cross @ cross, moment), up_rate])


def reference(times, spin=SPIN):
    up, w = np.array([0.0, np.sin(LEAN), np.cos(LEAN)]), np.array([0.0, 0.0, spin])
    settings = {"rtol": 1e-13, "atol": 1e-14, "method": "DOP853", "t_eval": times}
    start = np.concatenate([w, up])
    return solve_ivp(rates, (0, times[-1]), start, **settings).y[:3]


def rattleback(sensitivities=(), **edge):
    up, w = np.array([0.0, np.sin(LEAN), np.cos(LEAN)]), np.array([0.0, 0.0, SPIN])
    r = contact_point(up)
    turn = np.array([[1, 0, 0], [0, np.cos(LEAN), -np.sin(LEAN)], [0, np.sin(LEAN), np.cos(LEAN)]])
    velocity = turn @ np.cross(r, w) / SPIN
    initial = {"z": -(turn @ r)[2], "rotation": [LEAN, 0, 0], "w3": "spin"}
    for name, share in zip(("vx", "vy", "vz"), velocity.tolist(), strict=True):
        initial[name] = f"{share!r}*spin"
    scene = cotree.Scene("rattleback", gravity=(0, 0, -G))
    scene.parameter("spin", SPIN)
    body = {"mass": MASS, "inertia": INERTIA.tolist(), "initial": initial}
    scene.edge("body", "rigid_body", "ground", "M", **body)
    scene.edge("up", "arm", "M", "E", vector=[0, 0, HEIGHT])
    is_rolling = edge["type"] == "rolling_ellipsoid"
    shape = {"normal": [0, 0, 1], "semiaxes": SEMIAXES.tolist()}
    scene.edge("roll", edge.pop("type"), "ground", "E", **shape, **edge)
    scene.output("energy", "energy.kinetic + energy.potential")
    if not is_rolling:
        scene.output("gap", "roll.normal.s")
    return scene.compile(sensitivities, optimize="-O0")


def test_a_rolling_rattleback_moves_by_its_equations_and_turns_back():
    times = np.linspace(0, 6, 61)
    result = rattleback(type="rolling_ellipsoid").simulate((0, 6), times, rtol=1e-11)
    own = np.array([result[f"body.w{i}"] for i in (1, 2, 3)])
    # Errors at rtol 1e-11 grow with the unstable rocking, by some e^10 in this time.
    np.testing.assert_allclose(own[:, :31], reference(times[:31]), atol=1e-6)
    # It spins in the direction that it does not like, and ends up in the other.
    assert own[2, 0] == SPIN
    assert own[2].max() > 0.5
    np.testing.assert_allclose(result["energy"], result["energy"][0], rtol=1e-8)


@pytest.mark.parametrize("method", ["dopri5", "rodas5"])
def test_a_rattleback_that_sticks_to_a_rigid_contact_rolls(method):
    model = rattleback(["spin"], type="rigid_contact", friction=1.0)
    result = model.simulate((0, 1), [0.0, 1.0], method=method, rtol=1e-11, atol=1e-13)
    assert not any(row.t.size for row in result.events.values())
    exact = reference([1.0], SPIN + 1e-30j)[:, -1]
    own = [f"body.w{i}" for i in (1, 2, 3)]
    np.testing.assert_allclose([result[name][-1] for name in own], exact.real, atol=1e-9)
    slopes = [result.sensitivity(name, "spin")[-1] for name in own]
    np.testing.assert_allclose(slopes, exact.imag / 1e-30, atol=1e-9)
    np.testing.assert_allclose(result["energy"], result["energy"][0], rtol=1e-9)


@pytest.mark.slow
def test_a_rattleback_on_an_elastic_contact_turns_back_too():
    contact = {"stiffness": 1e7, "dissipation": 0.3, "friction": 1.0, "transition": 1e-5}
    model = rattleback(type="contact", **contact)
    result = model.simulate((0, 8), rtol=1e-7)
    assert result.success
    assert result["body.w3"].max() > 0.2
    # Friction and impacts take energy, and nothing gives any; the contact stores 2/5 k d^2.5.
    stored = 0.4 * 1e7 * np.maximum(-result["gap"], 0.0) ** 2.5
    energy = result["energy"] + stored
    # Errors of some ten thousand steps at rtol 1e-7.
    assert np.max(np.diff(energy)) < 1e-5 * energy[0]
