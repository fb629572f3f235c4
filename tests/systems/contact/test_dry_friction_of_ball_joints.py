"""Dry friction of spherical joints and screws: sticking, breaking away, sliding, stopping."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import cotree
from cotree.errors import SceneError

G = 9.81
METHODS = ("dopri5", "dop853", "rodas5")
CLOSE = 1e-9
LOAD = "sqrt(h.fx**2 + h.fy**2 + h.fz**2)"


def slopes(function, given):
    """Return the derivatives of a function by each argument, by complex steps."""
    return {name: function(**{**given, name: v + 1e-30j}).imag / 1e-30 for name, v in given.items()}


def ball_joint(given, torque=f"mu*R*{LOAD}", base="ground", initial=None, **fields):
    """Return a scene with a spherical joint 'h' from ``base`` to 'A', with dry friction 'F'."""
    scene = cotree.Scene("ball", gravity=[0, 0, -G])
    for name, value in given.items():
        scene.parameter(name, value)
    scene.edge("h", "spherical", base, "A", initial=initial or {})
    scene.edge("F", "rotational_dry_friction", joint="h", torque=torque, **fields)
    return scene


def simulate(model, method, end):
    """Return a run; rodas5 needs many steps at smaller tolerances."""
    return model.simulate((0, end), method=method, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_a_hanging_rod_that_spins_stops_and_sticks(method):
    given = {"mu": 0.2, "R": 0.05, "m": 2.0, "J": 0.01, "w": 3.0}
    scene = ball_joint(given, initial={"w3": "w"})
    scene.edge("rod", "arm", "A", "B", vector=[0, 0, -0.7])
    scene.edge("b", "rigid_body", "ground", "B", mass="m", inertia=[0.02, 0.02, "J"])
    result = simulate(scene.compile(list(given)), method, 1.0)

    def stops(mu, R, m, J, w):
        return w * J / (mu * R * m * G)

    def turned(mu, R, m, J, w):
        return np.sin(w * stops(mu, R, m, J, w) / 4)  # half of the angle w t/2, as a quaternion

    (stop,) = result.events["F stops"].t
    assert abs(stop - stops(**given)) <= CLOSE
    assert abs(result["h.q3"][-1] - turned(**given)) <= CLOSE
    assert result["F.mode"][-1] == 0
    for name in given:
        slope = slopes(stops, given)[name]
        assert abs(result.event_sensitivity("F stops", name)[0] - slope) <= CLOSE
        slope = slopes(turned, given)[name]
        assert abs(result.sensitivity("h.q3", name)[-1] - slope) <= CLOSE * max(1, abs(slope))


@pytest.mark.parametrize("method", METHODS)
def test_a_growing_torque_breaks_a_ball_joint_away(method):
    """The torque k t acts on a sphere at its centre; after t_b the speed is k (t - t_b)^2/(2 J)."""
    given = {"mu": 0.2, "R": 0.05, "m": 2.0, "J": 0.01, "k": 0.1}
    scene = ball_joint(given)
    scene.edge("b", "rigid_body", "ground", "A", mass="m", inertia=["J"] * 3)
    scene.edge("T", "torque", "ground", "A", torque=["k*t/3", "2*k*t/3", "2*k*t/3"])
    result = simulate(scene.compile(list(given)), method, 3.0)

    def speed(mu, R, m, J, k):
        return k * (3.0 - mu * R * m * G / k) ** 2 / (2 * J) * np.array([1, 2, 2]) / 3

    names = ["h.w1", "h.w2", "h.w3"]
    np.testing.assert_allclose([result[n][-1] for n in names], speed(**given), atol=CLOSE)
    for name, slope in slopes(speed, given).items():
        found = [result.sensitivity(n, name)[-1] for n in names]
        np.testing.assert_allclose(found, slope, rtol=CLOSE, atol=CLOSE)


ON_A_CART = {"mu": 0.2, "R": 0.3, "m": 2.0, "L": 0.8, "j": 1.0}


@functools.cache
def pendulum_on_a_cart():
    """Return the model of a pendulum on a cart whose acceleration grows with time."""
    scene = ball_joint(ON_A_CART, base="C")
    scene.edge("cart", "prismatic", "ground", "C", axis=[0.6, 0.8, 0], motion="j*t**3/6")
    scene.edge("rod", "arm", "A", "B", vector=[0, 0, "-L"])
    scene.edge("b", "rigid_body", "ground", "B", mass="m", inertia=[0.02, 0.03, 0.01])
    return scene.compile(list(ON_A_CART))


@pytest.mark.parametrize("method", METHODS)
def test_a_pendulum_breaks_away_when_its_reaction_has_turned_far_enough(method):
    """On a cart with the acceleration a, the joint slips at a L = mu R sqrt(a^2 + g^2)."""
    given = ON_A_CART
    result = simulate(pendulum_on_a_cart(), method, 1.0)

    def slips(mu, R, m, L, j):
        return mu * R * G / np.sqrt(L**2 - (mu * R) ** 2) / j

    (slip,) = result.events["F slips"].t
    assert abs(slip - slips(**given)) <= CLOSE
    for name, slope in slopes(slips, given).items():
        assert abs(result.event_sensitivity("F slips", name)[0] - slope) <= CLOSE


SWINGING = {"mu": 0.1, "R": 0.3, "L": 0.8, "q": 1.0}


@functools.cache
def swinging(joint):
    """Return the model of a pendulum in a plane, which a ball joint or a hinge holds."""
    scene = cotree.Scene(joint, gravity=[0, 0, -G])
    for name, value in SWINGING.items():
        scene.parameter(name, value)
    start = {"rotation": ["q", 0, 0]} if joint == "spherical" else {"theta": "q"}
    axis = {} if joint == "spherical" else {"axis": [1, 0, 0]}
    scene.edge("h", joint, "ground", "A", initial=start, **axis)
    scene.edge("rod", "arm", "A", "B", vector=[0, 0, "-L"])
    scene.edge("b", "rigid_body", "ground", "B", mass=2.0, inertia=[0.03, 0.03, 0.01])
    scene.edge("F", "rotational_dry_friction", joint="h", torque=f"mu*R*{LOAD}")
    scene.output("depth", "B.z")
    return scene.compile(list(SWINGING))


@pytest.mark.parametrize("method", METHODS)
def test_in_one_plane_a_ball_joint_is_a_hinge(method):
    """Ten swings, with a stop at the end of each, and rest."""
    found = {}
    for joint in ("spherical", "revolute"):
        result = simulate(swinging(joint), method, 12.0)
        assert result["F.mode"][-1] == 0
        slopes_of_depth = [result.sensitivity("depth", name)[-1] for name in SWINGING]
        found[joint] = [result["depth"][-1], *slopes_of_depth, *result.events["F stops"].t]
    # Integration errors of eleven swings.
    np.testing.assert_allclose(found["spherical"], found["revolute"], atol=1e-8)


def come_to_rest(mu, L, w):
    """Return the time at which a swinging bob rests, and its vertical in its own axes.

    The independent variable s with dt = |w| ds makes the slip decay exponentially before rest, so
    that its direction is resolved up to the end.
    """
    m, g, arm = 2.0, np.array([0, 0, -G]), np.array([0, 0, -1.0]) * L
    inertia = np.array([0.1, 0.1, 0.05]) + m * L**2 * np.array([1, 1, 0])
    tilt = np.array([[1, 0, 0], [0, np.cos(1.0), -np.sin(1.0)], [0, np.sin(1.0), np.cos(1.0)]])

    def cross(a):
        return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])

    def speed(z):
        return np.sqrt(z[9:12] @ z[9:12])

    def change(z):
        turn, spin = z[:9].reshape(3, 3), z[9:12]
        weight = turn.T @ g
        free = (m * np.cross(arm, weight) - np.cross(spin, inertia * spin)) / inertia
        drag = -mu * spin / speed(z) / inertia
        # The load is |a + load b|.
        a = m * (np.cross(free, arm) + np.cross(spin, np.cross(spin, arm)) - weight)
        b = m * np.cross(drag, arm)
        p, q, r = b @ b - 1, a @ b, a @ a
        return free + (-q - np.sqrt(q * q - p * r)) / p * drag

    def rates(s, z):
        turning = z[:9].reshape(3, 3) @ cross(z[9:12])
        return speed(z) * np.concatenate([turning.ravel(), change(z), [1.0]])

    def rests(s, z):
        return speed(z).real - 1e-13

    rests.terminal = True
    start = np.concatenate([tilt.ravel(), [0.3, w, 2.0], [0]]).astype(complex)
    run = solve_ivp(rates, (0, 600), start, method="DOP853", rtol=1e-12, atol=1e-15, events=rests)
    z = run.y[:, -1]
    left = -(speed(z) ** 2) / (z[9:12] @ change(z))
    return np.array([z[12] + left, *z[6:9]])


VERTICAL = {
    "x": "2*(h.q1*h.q3 - h.q0*h.q2)",
    "y": "2*(h.q2*h.q3 + h.q0*h.q1)",
    "z": "1 - 2*(h.q1**2 + h.q2**2)",
}


def swinging_bob(given):
    """Return the model of :func:`come_to_rest`."""
    start = {"rotation": [1.0, 0, 0], "w1": 0.3, "w2": "w", "w3": 2.0}
    scene = ball_joint(given, torque=f"mu*{LOAD}", initial=start)
    scene.edge("rod", "arm", "A", "B", vector=[0, 0, "-L"])
    scene.edge("b", "rigid_body", "ground", "B", mass=2.0, inertia=[0.1, 0.1, 0.05])
    for name, value in VERTICAL.items():
        scene.output(name, value)
    return scene


BOB = {"mu": 0.3, "L": 1.3, "w": 1.5}


def test_a_bob_that_swings_in_space_comes_to_rest():
    exact, exact_slopes = come_to_rest(**BOB).real, slopes(come_to_rest, BOB)
    model = swinging_bob(BOB).compile(list(BOB))
    for method in METHODS:
        result = simulate(model, method, 4.0)
        (stop,) = result.events["F stops"].t
        found = [stop, *(result[name][-1] for name in VERTICAL)]
        np.testing.assert_allclose(found, exact, atol=CLOSE)
        for name in BOB:
            found = [result.sensitivity(key, name)[-1] for key in VERTICAL]
            np.testing.assert_allclose(found, exact_slopes[name][1:], atol=CLOSE)
            slope = result.event_sensitivity("F stops", name)[0]
            assert abs(slope - exact_slopes[name][0]) <= CLOSE


@pytest.mark.parametrize("method", [*METHODS, "rodas4", "cvode", "ida"])
def test_rest_is_found_at_loose_tolerances(method):
    """The direction of a slip below the tolerance is noise; the joint then sticks."""
    result = swinging_bob(BOB).compile().simulate((0, 4), method=method, rtol=1e-6, atol=1e-6)
    assert result.status == 0
    assert result["F.mode"][-1] == 0
    (stop,) = result.events["F stops"].t
    assert abs(stop - 2.343736) <= 1e-4  # ten to a hundred tolerances


def test_what_a_ball_joint_refuses():
    with pytest.raises(SceneError, match="no backward direction: remove backward"):
        ball_joint({}, torque=0.3, backward=0.2).compile()
    with pytest.raises(SceneError, match=r"several components: use stribeck_speed"):
        ball_joint({}, torque=[[0, 0.3], [1, 0.2]]).compile()


def test_edges_with_friction_on_one_ball_joint_add_their_torques():
    def stops(torques):
        scene = cotree.Scene("top", gravity=[0, 0, -G])
        scene.edge("h", "spherical", "ground", "A", initial={"w3": 4.0})
        scene.edge("rod", "arm", "A", "B", vector=[0, 0, -1.0])
        scene.edge("b", "rigid_body", "ground", "B", mass=2.0, inertia=[0.3, 0.3, 0.1])
        for i, torque in enumerate(torques):
            scene.edge(f"R{i}", "rotational_dry_friction", joint="h", torque=torque)
        result = scene.compile().simulate((0, 3), rtol=1e-10, atol=1e-12)
        assert result.success, result.message
        return result.events["R0 stops"].t

    # The body spins about its axis: J w = T t.
    for torques in ([0.25], [0.1, 0.15]):
        assert np.max(np.abs(stops(torques) - 0.1 * 4.0 / 0.25)) <= 1e-9


@pytest.mark.parametrize("mu", [0.05, 0.2])
@pytest.mark.parametrize("method", METHODS)
def test_a_nut_on_a_thread_rises_and_sticks_or_falls_back(method, mu):
    """A nut on a thread with the slope k, which is an inclined plane: it holds if mu >= k.

    With the normal force N and c = 1/sqrt(1 + k^2), the axial force is N c (1 -+ mu k) and the
    torque -N c r (k +- mu), with the upper signs while it rises.
    """
    k, given = 0.1, {"mu": mu, "r": 0.02, "m": 1.5, "J": 5e-4, "w": 30.0}
    scene = cotree.Scene("nut", gravity=[0, 0, -G])
    for name, value in given.items():
        scene.parameter(name, value)
    start = {"theta_dot": "w"}
    scene.edge("h", "screw", "ground", "A", axis=[0, 0, 1], pitch=f"{k}*r", initial=start)
    scene.edge("b", "rigid_body", "ground", "A", mass="m", inertia=["J"] * 3)
    law = "mu*r*abs(h.fz)*(1 + {k}**2)/(1 {sign} mu*{k})".format
    rising, falling = law(k=k, sign="-"), law(k=k, sign="+")
    scene.edge("F", "rotational_dry_friction", joint="h", torque=rising, backward=falling)
    end = 1.0
    result = simulate(scene.compile(list(given)), method, end)

    def acceleration(mu, r, m, J, way):
        share = r * (k + way * mu) / (1 - way * mu * k)  # torque per axial force m (g + k r a)
        return -share * m * G / (J + share * m * k * r)

    def stops(mu, r, m, J, w):
        return -w / acceleration(mu, r, m, J, 1)

    def angle(mu, r, m, J, w):
        up = stops(mu, r, m, J, w)
        falls = acceleration(mu, r, m, J, -1) if given["mu"] < k else 0.0
        return w * up / 2 + falls * (end - up) ** 2 / 2

    assert abs(result.events["F stops"].t[0] - stops(**given)) <= CLOSE
    assert abs(result["h.theta"][-1] - angle(**given)) <= CLOSE
    assert result["F.mode"][-1] == (-1 if mu < k else 0)
    for name, slope in slopes(angle, given).items():
        found = result.sensitivity("h.theta", name)[-1]
        assert abs(found - slope) <= CLOSE * max(1, abs(slope))
