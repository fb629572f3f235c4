"""Redundant constraints: the same motion as without what is too much, whatever the axes."""

from __future__ import annotations

import numpy as np
import pytest
from fast_and_slow import cases

from cotree import Scene

# A rounding of the axes enters through lever arms and a few hundred operations.
SAME = {"rtol": 1e-9, "atol": 1e-9}


def door(n_hinges: int, axis: list[float], rotation: list[float] | None = None) -> Scene:
    """A door on one hinge, or on two along the same line."""
    scene, base = Scene("door", gravity=[1.0, -9.81, 2.0]), "ground"
    if rotation is not None:
        scene.edge("frame", "weld", "ground", "W", rotation=rotation)
        base = "W"
    scene.edge("h1", "revolute", base, "A", axis=axis, initial={"theta": 0.4})
    if n_hinges == 2:
        scene.edge("ga", "arm", base, "G", vector=axis)
        scene.edge("ab", "arm", "A", "B", vector=axis)
        scene.edge("h2", "revolute", "G", "B", axis=axis)
    scene.edge("ac", "arm", "A", "C", vector=[0.7, 0.2, 0.9])
    scene.edge("M", "rigid_body", "ground", "C", mass=3, inertia=[0.1, 0.2, 0.25])
    for name in ("C.x", "C.ay", "energy.kinetic"):
        scene.output(name.replace(".", "_"), name)
    return scene


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("axis", "rotation"),
    [
        ([0, 0, 1], None),
        ([1, 2, 3], None),
        ([0, 0, 1], [0.3, 0.1, 0.2]),
        pytest.param([1, 1, 0], None, marks=pytest.mark.slow),
        pytest.param([0.3, -0.2, 1], None, marks=pytest.mark.slow),
    ],
    ids=str,
)
@pytest.mark.parametrize("is_absolute", [False, True], ids=["joints", "bodies"])
def test_a_second_hinge_changes_nothing(axis, rotation, is_absolute):
    times = np.linspace(0, 1, 11)
    found = []
    for n_hinges in (1, 2):
        scene = door(n_hinges, axis, rotation)
        types = ("rigid_body", "arm", "weld")
        bodies = [name for name, e in scene.edges.items() if e.component.name in types]
        model = scene.compile(tree=bodies if is_absolute else None, optimize="-O0")
        found.append(model.simulate((0, 1), times, "dop853", 1e-11, 1e-11))
    one, two = found
    for name in one.outputs:
        assert np.allclose(two[name], one[name], **SAME), name
    if is_absolute or axis == [1, 2, 3]:  # along an axis, what is too much is never written
        assert two.redundant >= 5  # a hinge holds five directions


def linkage(axis: list[float], closing: str) -> Scene:
    """A planar four-bar of parallel hinges, closed by a hinge (redundant) or by a slot."""
    n = np.array(axis, dtype=float) / np.linalg.norm(axis)
    u = np.cross(n, [0.0, 0.0, 1.0]) if abs(n[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    u /= np.linalg.norm(u)
    v = np.cross(n, u)
    scene = Scene("linkage", gravity=[0.3, -9.81, 1.0])
    node = "ground"
    for name, along in (("a", (0.3, 1.0)), ("b", (1.5, 0.2)), ("c", (0.2, -1.2))):
        end = f"{name}2"
        vector = [float(x) for x in along[0] * u + along[1] * v]
        scene.edge(name, "revolute", node, f"{name}1", axis=axis)
        scene.edge(f"l{name}", "arm", f"{name}1", end, vector=vector)
        scene.edge(f"m{name}", "rigid_body", "ground", end, mass=1, inertia=[0.1, 0.1, 0.1])
        node = end
    scene.edge("g", "arm", "ground", "G", vector=[float(x) for x in 2.0 * u])
    scene.edge("d", closing, "G", node, axis=axis)
    return scene


@pytest.mark.slow
@pytest.mark.parametrize("axis", cases([[1, 2, 3]], [[0, 0, 1]]), ids=str)
def test_a_planar_loop_of_hinges_in_space(axis):
    ends = []
    for closing in ("slot", "revolute"):
        model = linkage(axis, closing).compile(optimize="-O0")
        result = model.simulate((0, 1), [1.0], "dop853", 1e-11, 1e-11)
        ends.append(result["a.theta"][-1])
    assert ends[1] == pytest.approx(ends[0], rel=1e-8)


def bench(n_legs: int) -> Scene:
    """A beam that swings on equal legs: with three of them one constraint is too much."""
    scene = Scene("bench", gravity=[0, -9.81, 0])
    scene.parameter("l", 0.5)
    z = [0, 0, 1]
    for i in range(n_legs):
        scene.edge(f"g{i}", "arm", "ground", f"G{i}", vector=[float(i), 0, 0])
        scene.edge(f"p{i}", "revolute", f"G{i}", f"L{i}", axis=z, initial={"theta": 0.3})
        scene.edge(f"l{i}", "arm", f"L{i}", f"T{i}", vector=[0, "-l", 0])
    scene.edge("q0", "revolute", "T0", "B0", axis=z)
    for i in range(1, n_legs):
        scene.edge(f"b{i}", "arm", "B0", f"B{i}", vector=[float(i), 0, 0])
        scene.edge(f"q{i}", "revolute", f"T{i}", f"B{i}", axis=z)
    scene.edge("M", "rigid_body", "ground", "B1", mass=4.0, inertia=0.3)
    for i in range(n_legs):
        scene.output(f"fy{i}", f"q{i}.fy")
    scene.output("ay", "B1.ay")
    return scene


def test_equal_legs_share_the_load_and_its_sensitivities_are_left_out():
    model = bench(3).compile(["l"])
    with pytest.warns(RuntimeWarning, match="reactions are not unique"):
        result = model.simulate((0, 1), np.linspace(0, 1, 5), "dop853", 1e-11, 1e-11)
    assert result.redundant == 1
    assert "Redundant constraints: 1" in result.summary()
    total = result["fy0"] + result["fy1"] + result["fy2"]
    assert np.allclose(total, 4.0 * (result["ay"] + 9.81), **SAME)
    assert np.allclose(result["fy0"], result["fy2"], **SAME)
    assert np.all(np.isnan(result.sensitivity("fy0", "l")))
    # The beam swings like a point on one leg: theta'' = -(g/l) sin(theta).
    pendulum = Scene("pendulum", gravity=[0, -9.81, 0])
    pendulum.parameter("l", 0.5)
    pendulum.edge("h", "revolute", "ground", "A", axis=[0, 0, 1], initial={"theta": 0.3})
    pendulum.edge("r", "arm", "A", "B", vector=[0, "-l", 0])
    pendulum.edge("m", "rigid_body", "ground", "B", mass=4.0)
    alone = pendulum.compile(["l"]).simulate((0, 1), np.linspace(0, 1, 5), "dop853", 1e-11, 1e-11)
    assert np.allclose(result["p0.theta"], alone["h.theta"], **SAME)
    found, expected = (r.sensitivity(n, "l") for r, n in ((result, "p0.theta"), (alone, "h.theta")))
    assert np.allclose(found, expected, rtol=1e-7, atol=1e-8)
