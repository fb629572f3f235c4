"""Contacts whose normal has any direction: the motion is that with a vertical normal, rotated."""

from __future__ import annotations

import numpy as np
import pytest

import cotree

#: Weight, start and spin in the axes of the plane, whose third one is the normal.
FRAME = {"g": [1.0, 0.5, -9.0], "x": [0.1, 0.2, 0.3], "v": [1.0, -0.4, 0.0], "w": [3.0, 8.0, -2.0]}
#: Direction opposite to that from which the frames of contacts on balls are rotated.
LACKING = -np.sqrt(np.array([2, 3, 7]) / 12)


def normals():
    """Return the six axes, one with rational components, and fifty random ones."""
    axes = np.concatenate([np.eye(3), -np.eye(3), [np.array([-2, -3, -6]) / 7]])
    spread = np.random.default_rng(36).normal(size=(50, 3))
    return [*axes, *(spread / np.linalg.norm(spread, axis=1)[:, None])]


def turned_to(normal, angle):
    """Return a rotation from the axes of the plane to those of space."""
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    c, s = np.cos(angle), np.sin(angle)
    return np.column_stack([c * first + s * second, c * second - s * first, normal])


def sphere_on_a_plane(normal, gravity):
    """Return a sphere that slides on a plane, stops, and rolls."""
    scene = cotree.Scene("sphere", gravity=gravity)
    for names in ("abc", "pqr"):
        for name in names:
            scene.parameter(name, 1.0)
    scene.edge("b", "rigid_body", "ground", "P", mass=2.0, inertia=[0.05] * 3)
    scene.edge("c", "rigid_contact", "ground", "P", normal=normal, radius=0.3, friction=0.3)
    return scene.compile()


def moved(model, rotation, method):
    """Return the end of a run in the axes of the plane, and the times at which slip ends."""
    seen = {name: rotation @ value for name, value in FRAME.items()}
    start = {f"b.{axis}": seen["x"][i] for i, axis in enumerate("xyz")}
    start |= {f"b.v{axis}": seen["v"][i] for i, axis in enumerate("xyz")}
    start |= {f"b.w{i + 1}": seen["w"][i] for i in range(3)}
    given = dict(zip("abcpqr", [*rotation[:, 2], *seen["g"]], strict=True))
    result = model.simulate(
        (0, 1.0), parameters=given, initial=start, method=method, rtol=1e-10, atol=1e-12
    )
    assert result.status == 0, result.message
    ends = np.array([result[f"b.{axis}"][-1] for axis in "xyz"])
    return np.array([*(rotation.T @ ends), *result.events["c.slide1 stops"].t])


@pytest.mark.parametrize("method", ["dop853", "rodas5"])
def test_a_plane_may_have_any_normal(method):
    model = sphere_on_a_plane(["a", "b", "c"], ["p", "q", "r"])
    level = moved(model, turned_to(np.array([0, 0, 1.0]), 0.0), method)
    for i, normal in enumerate(normals()):
        found = moved(model, turned_to(normal, 0.7 * i), method)
        np.testing.assert_allclose(found, level, atol=1e-9)


def test_a_normal_in_numbers_is_as_one_in_parameters():
    normal = np.array([-2, -3, -6]) / 7
    rotation = turned_to(normal, 0.4)
    models = [
        sphere_on_a_plane(given, ["p", "q", "r"]) for given in (["a", "b", "c"], normal.tolist())
    ]
    first, second = (moved(model, rotation, "dop853") for model in models)
    np.testing.assert_allclose(first, second, atol=1e-11)


def sphere_on_a_ball(gravity):
    """Return a sphere that slides on a ball, and then rolls."""
    scene = cotree.Scene("spheres", gravity=gravity)
    for name in "pqr":
        scene.parameter(name, -1.0)
    own = {"mass": 2.0, "inertia": [0.05] * 3, "initial": {"z": 0.8}}
    scene.edge("b", "rigid_body", "ground", "P", **own)
    scene.edge("c", "rigid_contact", "ground", "P", ball=0.5, radius=0.3, friction=0.3)
    return scene.compile(["p", "q", "r"])


def moved_on_a_ball(model, rotation, method):
    """Return the end, its derivatives by the weight, and the times at which slip ends."""
    place, speed, spin = (rotation @ v for v in ([0, 0, 0.8], [0.5, -0.2, 0.0], [3.0, 2.0, -2.0]))
    start = {f"b.{axis}": place[i] for i, axis in enumerate("xyz")}
    start |= {f"b.v{axis}": speed[i] for i, axis in enumerate("xyz")}
    start |= {f"b.w{i + 1}": spin[i] for i in range(3)}
    given = dict(zip("pqr", rotation @ [0.3, 0.1, -9.0], strict=True))
    result = model.simulate(
        (0, 0.3), parameters=given, initial=start, method=method, rtol=1e-11, atol=1e-13
    )
    assert result.status == 0, result.message
    ends = np.array([result[f"b.{axis}"][-1] for axis in "xyz"])
    slopes = np.array([[result.sensitivity(f"b.{a}", g)[-1] for g in "pqr"] for a in "xyz"])
    turned = rotation.T @ slopes @ rotation
    return np.concatenate([rotation.T @ ends, turned.ravel(), result.events["c.slide1 stops"].t])


@pytest.mark.parametrize("method", ["dop853", "rodas5"])
def test_a_normal_on_a_ball_may_have_any_direction(method):
    model = sphere_on_a_ball(["p", "q", "r"])
    level = moved_on_a_ball(model, np.eye(3), method)
    assert level.size == 13
    near = LACKING + 1e-5 * np.array([1, -2, 0.5])
    for normal in (np.array([-2, -3, -6]) / 7, near / np.linalg.norm(near), *np.eye(3)[:2]):
        found = moved_on_a_ball(model, turned_to(normal, 0.7), method)
        np.testing.assert_allclose(found, level, atol=1e-9)
