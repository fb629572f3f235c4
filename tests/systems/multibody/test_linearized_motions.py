"""Linearisation about motions: published and closed-form eigenvalues, and the flow itself."""

from __future__ import annotations

import numpy as np
import pytest
from constrained_scenes import disc_in_a_circle
from readme_linkage import four_bar

import cotree
from cotree.model.deviations import reduce

pytestmark = pytest.mark.compiler

G = 9.81


AXES = ["x", "y", "z", "yaw", "lean", "spin"]


def axes(spin=0.0, mass=1.5, radius=0.3, inertia=()):
    """A disc on six axes: three positions, heading, lean, and about its axle."""
    scene = cotree.Scene("axes", gravity=[0, 0, -G])
    fast, turning = {"s_dot": radius * spin}, {"theta": 0.4, "theta_dot": spin}
    scene.edge("x", "prismatic", "ground", "a", axis=[1, 0, 0], initial=fast)
    scene.edge("y", "prismatic", "a", "b", axis=[0, 1, 0])
    scene.edge("z", "prismatic", "b", "c", axis=[0, 0, 1], initial={"s": radius})
    scene.edge("yaw", "revolute", "c", "d", axis=[0, 0, 1])
    scene.edge("lean", "revolute", "d", "e", axis=[1, 0, 0])
    scene.edge("spin", "revolute", "e", "C", axis=[0, 1, 0], initial=turning)
    scene.edge("m", "rigid_body", "ground", "C", mass=mass, inertia=[*inertia])
    scene.edge(
        "road", "rolling_disc", "ground", "C", normal=[0, 0, 1], axis=[0, 1, 0], radius=radius
    )
    return scene


def coin(way, spin, radius=0.3, mass=1.5):
    """A thin disc that rolls straight on: on a free joint, on six axes, or a body in the tree."""
    across = mass * radius**2 / 4
    if way == "axes":
        return axes(spin, mass, radius, [across, 2 * across, across]).compile(tree=AXES)
    scene = cotree.Scene("coin", gravity=[0, 0, -G])
    start = {"z": radius, "vx": radius * spin, "w2": spin}
    if way == "free":
        scene.edge("f", "free", "ground", "C", initial=start)
    own = {"initial": start} if way == "body" else {}
    inertia = [across, 2 * across, across]
    scene.edge("m", "rigid_body", "ground", "C", mass=mass, inertia=inertia, **own)
    scene.edge(
        "road", "rolling_disc", "ground", "C", normal=[0, 0, 1], axis=[0, 1, 0], radius=radius
    )
    return scene.compile(tree=["f" if way == "free" else "m"], optimize="-O0")


@pytest.mark.sampled(1)
@pytest.mark.parametrize("way", ["free", "axes", "body"])
def test_a_rolling_disc_is_stable_above_its_critical_speed(way):
    """lambda^2 = 4 g/(5 r) - 12 w^2/5 of a thin disc: stable if w > sqrt(g/(3 r))."""
    radius, spin = 0.3, 14.85
    model = coin(way, spin, radius)
    for speed in (0.8 * np.sqrt(G / (3 * radius)), spin):
        y = model.start().y
        y = np.where(np.isclose(y, radius * spin), radius * speed, y)
        y = np.where(np.isclose(y, spin), speed, y)
        linear = model.linearize(y=y, reduced=True)
        assert linear.is_steady
        assert "the eigenvalues of A determine stability" in linear.summary()
        # Six freedoms of which one is held, and three speeds of which two slips leave one more.
        assert linear.A.shape == (8, 8)
        found = np.linalg.eigvals(linear.A)
        square = 4 * G / (5 * radius) - 12 / 5 * speed**2
        expected = np.sqrt(complex(square))
        # The other six, of position, heading and speed, are zero: a defective cluster of them
        # keeps half the digits.
        order = np.argsort(-np.abs(found))
        assert found[order[:2]] ** 2 == pytest.approx(square, rel=1e-12)
        assert np.max(np.abs(found[order[2:]])) < 1e-6 * abs(expected)
        assert (found.real.max() > 1.0) == (square > 0)


@pytest.mark.slow
def test_a_leaning_disc_in_a_circle_is_steady_by_its_angles_only():
    """Ground axes turn against a motion in a circle; yaw, lean and spin know nothing of it."""
    case = disc_in_a_circle()
    free = case.scene.compile(tree=case.branches, optimize="-O0")
    seen = free.linearize(y=free.start(initial=case.state).y, reduced=True)
    assert not seen.is_steady
    assert "a motion that is not steady" in seen.summary()

    lean = 2.0 * np.arctan2(case.state["f.q1"], case.state["f.q0"])
    turning = case.state["f.w3"] / np.cos(lean)
    scene = axes(mass=1.5, radius=0.4, inertia=[0.05, 0.09, 0.05])
    model = scene.compile(tree=AXES, optimize="-O0")
    state = {"yaw.theta_dot": turning, "lean.theta": lean, "z.s": case.state["f.z"]}
    state |= {"spin.theta_dot": case.state["f.w2"] - turning * np.sin(lean)}
    found = []
    for heading in (0.0, 1.3):
        fast = case.state["f.vx"] * np.array([np.cos(heading), np.sin(heading)])
        state |= {"yaw.theta": heading, "x.s_dot": fast[0], "y.s_dot": fast[1]}
        linear = model.linearize(y=model.start(initial=state).y, reduced=True)
        assert linear.is_steady
        found.append(np.linalg.eigvals(linear.A))
    # Nothing depends on the heading, nor do the eigenvalues; those of zero keep half the digits.
    assert np.sort(np.abs(found[0])) == pytest.approx(np.sort(np.abs(found[1])), abs=1e-5)


def bicycle():
    """The benchmark of Meijaard, Papadopoulos, Ruina and Schwab, Proc. R. Soc. A 463 (2007) 1955.

    With z downwards and y to the right, as there.
    """
    base, trail, tilt = 1.02, 0.08, np.pi / 10
    scene = cotree.Scene("bicycle", gravity=[0, 0, G])
    scene.parameter("v", 5.0)
    scene.edge("x", "prismatic", "ground", "a", axis=[1, 0, 0], initial={"s_dot": "v"})
    scene.edge("y", "prismatic", "a", "b", axis=[0, 1, 0])
    scene.edge("z", "prismatic", "b", "c", axis=[0, 0, 1], initial={"s": -0.3})
    scene.edge("yaw", "revolute", "c", "d", axis=[0, 0, 1])
    scene.edge("lean", "revolute", "d", "e", axis=[1, 0, 0])
    scene.edge("pitch", "revolute", "e", "R", axis=[0, 1, 0])
    turning = {"theta_dot": "-v/0.3"}
    scene.edge("rear", "revolute", "R", "RW", axis=[0, 1, 0], initial=turning)
    scene.edge("to_steer", "arm", "R", "S", vector=[base + trail, 0, 0.3])
    scene.edge("steer", "revolute", "S", "H", axis=[np.sin(tilt), 0, np.cos(tilt)])
    scene.edge("fork", "arm", "H", "F", vector=[-trail, 0, -0.35])
    turning = {"theta_dot": "-v/0.35"}
    scene.edge("front", "revolute", "F", "FW", axis=[0, 1, 0], initial=turning)
    scene.edge("to_frame", "arm", "R", "B", vector=[0.3, 0, -0.6])
    scene.edge("to_bar", "arm", "H", "HC", vector=[0.9 - base - trail, 0, -0.7])
    wheels = {"rear": ("RW", 2, [0.0603, 0.12, 0.0603], 0.3)}
    wheels["front"] = ("FW", 3, [0.1405, 0.28, 0.1405], 0.35)
    for name, (node, mass, inertia, radius) in wheels.items():
        scene.edge(f"m_{name}", "rigid_body", "ground", node, mass=mass, inertia=inertia)
        places = {"normal": [0, 0, -1], "axis": [0, 1, 0], "radius": radius}
        scene.edge(f"road_{name}", "rolling_disc", "ground", node, **places)
    inertia = [[9.2, 0, 2.4], [0, 11, 0], [2.4, 0, 2.8]]
    scene.edge("m_frame", "rigid_body", "ground", "B", mass=85, inertia=inertia)
    inertia = [[0.05892, 0, -0.00756], [0, 0.06, 0], [-0.00756, 0, 0.00708]]
    scene.edge("m_bar", "rigid_body", "ground", "HC", mass=4, inertia=inertia)
    return scene


def published_bicycle(v):
    """M q'' + v C1 q' + (g K0 + v^2 K2) q = 0 in lean and steer, equations (A 3) there."""
    mass = np.array([[80.81722, 2.31941332208709], [2.31941332208709, 0.29784188199686]])
    k0 = np.array([[-80.95, -2.59951685249872], [-2.59951685249872, -0.80329488458618]])
    k2 = np.array([[0, 76.59734589573222], [0, 2.65431523794604]])
    c1 = np.array([[0, 33.86641391492494], [-0.85035641456978, 1.68540397397560]])
    lower = np.linalg.solve(mass, np.hstack([-(G * k0 + v**2 * k2), -v * c1]))
    return np.linalg.eigvals(np.vstack([np.hstack([np.zeros((2, 2)), np.eye(2)]), lower]))


@pytest.mark.slow
def test_the_benchmark_bicycle_has_its_published_eigenvalues():
    joints = ["x", "y", "z", "yaw", "lean", "pitch", "rear", "steer", "front"]
    arms = ["to_steer", "fork", "to_frame", "to_bar"]
    model = bicycle().compile(tree=[*joints, *arms], optimize="-O0")
    for v in (1.0, 5.0, 10.0):
        linear = model.linearize(p=model.kernels.parameter_array({"v": v}), reduced=True)
        assert linear.is_steady
        found = np.linalg.eigvals(linear.A)
        found = found[np.argsort(-np.abs(found))]
        expected = published_bicycle(v)
        expected = expected[np.argsort(-np.abs(expected))]
        # 14 digits are published, of matrices with a condition number of 350.
        assert np.sort_complex(found[:4]) == pytest.approx(np.sort_complex(expected), rel=1e-11)
        assert np.max(np.abs(found[4:])) < 1e-5
    # The table of the paper, at 5 m/s: weave, caster, capsize.
    table = [-14.07838969279822, -0.77534188219585 - 4.46486771378823j]
    table += [-0.77534188219585 + 4.46486771378823j, -0.32286642900409]
    assert np.sort_complex(published_bicycle(5.0)) == pytest.approx(np.array(table), rel=1e-12)


@pytest.mark.parametrize("tree", [None, ["m"]], ids=["joint", "body"])
def test_a_pendulum_about_its_bottom_and_on_its_way(tree):
    scene = cotree.Scene("pendulum", gravity=[0, -G, 0])
    scene.edge("h", "revolute", "ground", "A", axis=[0, 0, 1], initial={"theta": -np.pi / 2})
    scene.edge("r", "arm", "A", "B", vector=[0.7, 0, 0])
    scene.edge("m", "rigid_body", "ground", "B", mass=1.3, inertia=0.1)
    scene.input("tau", 0.0)
    scene.edge("push", "torque", "ground", "B", torque=[0, 0, "tau"])
    scene.output("angle", "h.theta")
    model = scene.compile(tree=tree and [*tree, "r"], optimize="-O0")
    linear = model.linearize(reduced=True)
    about = 1.3 * 0.7**2 + 0.1
    assert linear.is_steady
    assert linear.A.shape == (2, 2)
    square = 1.3 * G * 0.7 / about
    assert np.linalg.eigvals(linear.A) ** 2 == pytest.approx(-square, rel=1e-12)
    # From the torque to the angle: 1/(J (s^2 + square)).
    s = 0.3 + 2j
    found = linear.C @ np.linalg.solve(s * np.eye(2) - linear.A, linear.B) + linear.D
    assert found[0, 0] == pytest.approx(1 / (about * (s**2 + square)), rel=1e-12)
    moving = "h.theta_dot" if tree is None else "m.theta_dot"
    later = model.start(initial={moving: 1.0}).y
    assert not model.linearize(y=later).is_steady


def test_a_conical_pendulum():
    """W^2 = g/(l cos a); it oscillates about that with W sqrt(1 + 3 cos^2 a)."""
    angle, length = 0.6, 0.8
    turning = np.sqrt(G / (length * np.cos(angle)))
    scene = cotree.Scene("conical", gravity=[0, 0, -G])
    scene.edge("around", "revolute", "ground", "A", axis=[0, 0, 1], initial={"theta_dot": turning})
    scene.edge("up", "revolute", "A", "B", axis=[0, 1, 0], initial={"theta": -angle})
    scene.edge("r", "arm", "B", "C", vector=[0, 0, -length])
    scene.edge("m", "rigid_body", "ground", "C", mass=2.0)
    linear = scene.compile(tree=["around", "up", "r"], optimize="-O0").linearize(reduced=True)
    assert linear.is_steady
    found = np.linalg.eigvals(linear.A)
    expected = turning * np.sqrt(1 + 3 * np.cos(angle) ** 2)
    assert np.sort(found.imag)[[0, -1]] == pytest.approx([-expected, expected], rel=1e-12)
    assert np.max(np.abs(found.real)) < 1e-7  # a double zero keeps half the digits


def test_a_moved_pivot_is_no_steady_motion():
    """It hangs at rest, and what moves its pivot up and down changes its equations."""
    scene = cotree.Scene("kapitza", gravity=[0, -G, 0])
    scene.edge("lift", "prismatic", "ground", "P", axis=[0, 1, 0], motion="0.1*sin(3*t)")
    scene.edge("h", "revolute", "P", "A", axis=[0, 0, 1], initial={"theta": -np.pi / 2})
    scene.edge("r", "arm", "A", "B", vector=[0.7, 0, 0])
    scene.edge("m", "rigid_body", "ground", "B", mass=1.3)
    assert not scene.compile(optimize="-O0").linearize(reduced=True).is_steady


def linkage():
    scene = four_bar(gravity=G)
    bodies = ["base", "crank", "coupler", "rocker", "m_crank", "m_coupler", "m_rocker"]
    model = scene.compile(tree=bodies, optimize="-O0")
    return model, {}


def circling_disc():
    case = disc_in_a_circle()
    return case.scene.compile(tree=case.branches, optimize="-O0"), case.state


@pytest.mark.sampled(1)
@pytest.mark.parametrize("case", [linkage, circling_disc], ids=["four-bar", "disc"])
def test_deviations_follow_the_flow_and_its_constraints(case):
    """About no steady motion: z' = A(t) z along it is what differences of the flow do."""
    model, given = case()
    start = model.start(initial=given).y
    states = dict(zip(model.states, start, strict=True))
    end, n, eps = 0.2, 10, 1e-6
    settings = {"rtol": 1e-13, "atol": 1e-14, "method": "dop853"}
    times = np.linspace(0.0, end, 2 * n + 1)
    way = model.simulate((0.0, end), initial=states, t_eval=times, **settings).y
    assert not model.linearize(0.0, way[:, 0]).is_steady
    here = model.linearize(0.0, way[:, 0], reduced=True)
    points = [
        model._linearizer.at(t, y, model.default_parameters, np.zeros(0))
        for t, y in zip(times, way.T, strict=True)
    ]
    linear = [reduce(point, model.states, here.states) for point in points]
    assert np.array_equal(linear[0].A, here.A)

    # Constraints: G A N + G' N = 0, with G' by differences of fourth order along the motion.
    held = [np.vstack([point.held, point.held_rates]) for point in points[8:13]]
    basis, span = linear[10].basis, times[12] - times[8]
    turned = (held[0] - 8 * held[1] + 8 * held[3] - held[4]) / (3 * span) @ basis
    still = held[2] @ points[10].A @ basis
    assert np.abs(held[2] @ basis).max() < 1e-12 * np.abs(held[2]).max()
    assert np.abs(still).max() > 1.0
    # What these leave: a step of 0.01 s to the fourth, of motions that take 0.1 s.
    assert still + turned == pytest.approx(0.0, abs=1e-3 * np.abs(still).max())

    # The flow: the classical method over matrices at every half step.
    z, step = np.eye(linear[0].A.shape[0]), end / n
    for k in range(n):
        first, middle, last = (row.A for row in linear[2 * k : 2 * k + 3])
        a = first @ z
        b = middle @ (z + step / 2 * a)
        c = middle @ (z + step / 2 * b)
        z = z + step / 6 * (a + 2 * b + 2 * c + last @ (z + step * c))
    found = linear[-1].basis @ z
    rng = np.random.default_rng(2)
    along = rng.normal(size=z.shape[0])
    ends = []
    for sign in (1.0, -1.0):
        moved = start + sign * eps * linear[0].basis @ along
        given = dict(zip(model.states, moved, strict=True))
        ends.append(model.simulate((0.0, end), initial=given, **settings).y[:, -1])
    expected = (ends[0] - ends[1]) / (2 * eps)
    # Differences leave 1e-13/1e-6 of the states, the classical method 1e-5 of a fast motion.
    assert found @ along == pytest.approx(expected, abs=3e-5 * np.abs(expected).max())
