"""Orientations at a pitch of a right angle, and bushings that turn through it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cotree import Scene

LOCKED = (np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9, -np.pi / 2 + 1e-7, np.pi / 2 - 1e-4, 0.4)
TURNS = ((0.0, -np.pi / 4), (0.3, -0.7), (-2.0, 2.5), (0.0, 0.0), (np.pi, 1.0))
ENTRIES = [f"r{i}{j}" for i in "123" for j in "123"]
ANGLES = ["roll", "pitch", "yaw"]


def turned(roll, pitch, yaw):
    """Turn about fixed x, y and z axes, in this order."""
    (a, b, c), (p, q, r) = (f([roll, pitch, yaw]) for f in (np.cos, np.sin))
    about_x = np.array([[1, 0, 0], [0, a, -p], [0, p, a]])
    about_y = np.array([[b, 0, q], [0, 1, 0], [-q, 0, b]])
    return np.array([[c, -r, 0], [r, c, 0], [0, 0, 1]]) @ about_y @ about_x


def body(rotation, **initial) -> Scene:
    scene = Scene("pose")
    start = {"x": 0, "y": 0, "z": 0, "rotation": rotation, **initial}
    scene.edge("b", "rigid_body", "ground", "P", mass=1.0, inertia=[0.3, 0.4, 0.5], initial=start)
    for name in (*ENTRIES, *ANGLES):
        scene.output(name, f"P.{name}")
    return scene


def test_angles_are_those_of_the_orientation_at_any_pitch():
    scene = body(["r", "p", "y"])
    for name in "rpy":
        scene.parameter(name, 0.0)
    model = scene.compile()
    for pitch in LOCKED:
        for roll, yaw in TURNS:
            start = model.start(p={"r": roll, "p": pitch, "y": yaw})
            found = model.output_values(0.0, start.y)
            axes, angles = found[:9].reshape(3, 3), found[9:]
            # Rounding of entries of one.
            np.testing.assert_allclose(axes, turned(roll, pitch, yaw), rtol=0, atol=1e-15)
            np.testing.assert_allclose(turned(*angles), axes, rtol=0, atol=1e-14)
            if abs(pitch) < 1.5:
                np.testing.assert_allclose(angles, [roll, pitch, yaw], atol=1e-14)


def test_angles_have_their_own_derivatives_away_from_the_lock():
    scene = body(["r", "p", "y"])
    for name, value in {"r": 0.3, "p": 1.4, "y": -0.7}.items():
        scene.parameter(name, value)
    result = scene.compile(["r", "p", "y"]).simulate((0, 0.1), [0.0, 0.1], method="dopri5")
    slopes = [[result.sensitivity(angle, name)[0] for name in "rpy"] for angle in ANGLES]
    # Levers of 1 / cos 1.4.
    np.testing.assert_allclose(slopes, np.eye(3), atol=1e-13)


@pytest.mark.compiler
def test_lanes_of_vectors_agree_at_the_lock():
    scene = body(["r", "p", "y"], w1=0.3)
    for name in "rpy":
        scene.parameter(name, 0.1)
    n = 8
    rng = np.random.default_rng(0)
    starts = {
        "r": rng.uniform(-3, 3, n),
        "p": np.resize(LOCKED, n),
        "y": rng.uniform(-3, 3, n),
    }
    runs = scene.compile().ensemble(
        (0, 0.5), starts, t_eval=[0.0, 0.5], method="dopri5", rtol=1e-10
    )
    found = {name: np.asarray(runs[name]) for name in (*ENTRIES, *ANGLES)}
    for i in range(n):
        for k in range(2):
            axes = np.array([found[name][i, k] for name in ENTRIES]).reshape(3, 3)
            back = turned(*(found[name][i, k] for name in ANGLES))
            np.testing.assert_allclose(back, axes, rtol=0, atol=1e-14)


def mount(rotation, stiffness, damping=(0.0, 0.0, 0.0), **initial) -> Scene:
    scene = body(rotation, **initial)
    rubber = {"stiffness": [50.0] * 3, "rotation_stiffness": stiffness}
    scene.edge("m", "bushing", "ground", "P", **rubber, rotation_damping=list(damping))
    scene.output("potential", "energy.potential")
    scene.output("kinetic", "energy.kinetic")
    return scene


@pytest.mark.parametrize(("start", "speed"), [(-np.pi / 2, 0.0), (1.2, 7.0), (-np.pi / 2, -3.0)])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_bushing_turns_back_by_the_sine_of_its_turn(axis, start, speed):
    inertia, k, c = [0.3, 0.4, 0.5][axis], 9.0, 0.1
    stiffness = [0.0, 4.0, 5.0]
    stiffness[axis] = k  # the others are not strained
    turn, damping = [0.0] * 3, [0.2] * 3
    turn[axis], damping[axis] = start, c
    scene = mount(turn, stiffness, damping, **{f"w{axis + 1}": speed})
    result = scene.compile().simulate((0, 2), method="dopri5", rtol=1e-10, atol=1e-12)
    q = solve_ivp(
        lambda t, y: [y[1], -(k * np.sin(y[0]) + c * y[1]) / inertia],
        (0, 2),
        [start, speed],
        "DOP853",
        rtol=1e-12,
        atol=1e-13,
    ).y[0, -1]
    i, j = (axis + 1) % 3, (axis + 2) % 3
    found = [result[ENTRIES[3 * j + i]][-1], result[ENTRIES[3 * i + i]][-1]]
    # A hundred steps of 1e-10.
    np.testing.assert_allclose(found, [np.sin(q), np.cos(q)], atol=1e-8)


def test_a_bushing_stores_what_its_torque_takes_at_any_turn():
    """Unequal springs, and a body that tumbles through every orientation."""
    stiffness = np.array([9.0, 3.0, 5.0])
    scene = mount([0.4, 1.2, -0.9], stiffness.tolist(), w1=6.0, w2=-4.0, w3=5.0)
    result = scene.compile().simulate((0, 3), method="dopri5", rtol=1e-11, atol=1e-13)
    axes = np.array([result[name] for name in ENTRIES]).reshape(3, 3, -1)
    diagonal = axes[[0, 1, 2], [0, 1, 2]]
    assert diagonal.min() < -0.9  # it turns over
    # Of the quaternion, 4 q_i^2 = 1 + 2 r_ii - tr.
    stored = 0.5 * stiffness @ (1 + 2 * diagonal - diagonal.sum(axis=0))
    np.testing.assert_allclose(result["potential"], stored, atol=1e-12)
    energy = result["potential"] + result["kinetic"]
    assert np.ptp(energy) < 1e-8 * energy[0]  # a thousand steps of 1e-11


def test_a_bushing_has_sensitivities_through_the_lock():
    def build() -> Scene:
        scene = Scene("mount")
        scene.parameter("k", 9.0)
        start = {"x": 0, "y": 0, "z": 0, "rotation": [0.1, 1.3, 0.2], "w1": 0.4, "w2": 5.0}
        inertia = [0.3, 0.4, 0.5]
        scene.edge("b", "rigid_body", "ground", "P", mass=1.0, inertia=inertia, initial=start)
        scene.edge("m", "bushing", "ground", "P", rotation_stiffness=["k", "k/2", "2*k"])
        scene.output("s", "P.r31")
        return scene

    model = build().compile(["k"])
    settings = {"method": "dopri5", "rtol": 1e-11, "atol": 1e-13}
    found = model.simulate((0, 1), [1.0], **settings).sensitivity("s", "k")[0]
    h = 1e-4
    ends = [
        model.simulate((0, 1), [1.0], **settings, parameters={"k": 9.0 + d})["s"][0]
        for d in (h, -h)
    ]
    # Rounding and steps over h, and h^2.
    assert found == pytest.approx((ends[0] - ends[1]) / (2 * h), abs=1e-6)


def test_a_bushing_in_a_plane():
    scene = Scene("plane")
    scene.edge("h", "revolute", "ground", "P", axis=[0, 0, 1], initial={"theta": 2.0})
    scene.edge("b", "rigid_body", "ground", "P", mass=1.0, inertia=0.5)
    scene.edge("m", "bushing", "ground", "P", rotation_stiffness=[1, 1, 3.0])
    assert scene.compile().rhs(0.0, [2.0, 0.0])[1] == pytest.approx(-3.0 * np.sin(2.0) / 0.5)
