"""Elastic contact: closed forms of impacts, of sliding, rolling and rest, and sensitivities."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import gamma

import cotree
from cotree import Scene, SceneError

G = 9.81
TIGHT = {"rtol": 1e-11, "atol": 1e-14}


def ball(initial, *, mass=1.3, radius=0.2, gravity=0.0, **contact):
    scene = Scene("ball", gravity=(0, -gravity, 0))
    for name, value in {"m": mass, "R": radius, "k": 2.5e5, "mu": 0.3}.items():
        scene.parameter(name, value)
    inertia = "2/5*m*R**2"
    scene.edge("b", "rigid_body", "ground", "B", mass="m", inertia=inertia, initial=initial)
    fields = {"normal": [0, 1, 0], "radius": "R", "stiffness": "k"} | contact
    scene.edge("c", "contact", "ground", "B", **fields)
    scene.output("gap", "c.normal.s")
    scene.output("force", "c.force")
    return scene


@pytest.mark.parametrize("exponent", [1.5, 1, 2.2])
@pytest.mark.parametrize("method", ["dop853", "rodas5"])
def test_an_impact_has_the_depth_and_the_duration_of_its_closed_form(exponent, method):
    """Energy: m v^2 / 2 = k d^(n + 1) / (n + 1); its quadrature gives the duration (Hertz)."""
    m, v, k, n, away = 1.3, 0.7, 2.5e5, exponent, 0.01
    depth = ((n + 1) * m * v**2 / (2 * k)) ** (1 / (n + 1))
    half = depth / v * np.sqrt(np.pi) * gamma(1 + 1 / (n + 1)) / gamma(0.5 + 1 / (n + 1))
    model = ball({"y": 0.2 + away, "y_dot": -v}, exponent=exponent).compile(optimize="-O0")
    deepest = model.simulate((0, away / v + half), method=method, **TIGHT)
    # The error of a step that meets the surface is that of the tolerance, amplified by the
    # stiffness: 1e-9 for rodas5.
    assert -deepest["gap"][-1] == pytest.approx(depth, rel=1e-8)
    assert deepest["force"][-1] == pytest.approx(k * depth**n, rel=1e-8)
    assert abs(deepest["b.y_dot"][-1]) < 1e-7 * v
    apart = model.simulate((0, 3 * away / v + 2 * half), method=method, **TIGHT)
    assert apart["b.y_dot"][-1] == pytest.approx(v, rel=1e-8)
    assert apart["gap"][-1] == pytest.approx(2 * away, rel=1e-6)


def test_an_impact_loses_what_hunt_and_crossley_say():
    """A slow impact: e = 1 - c v to first order (Hunt and Crossley 1975, Eq. (18))."""
    loss = []
    for c in (0.02, 0.04):
        model = ball({"y": 0.21, "y_dot": -0.7}, dissipation=c).compile(optimize="-O0")
        result = model.simulate((0, 0.06), method="dop853", **TIGHT)
        loss.append((1 - result["b.y_dot"][-1] / 0.7) / (c * 0.7))
    # The next term is of second order: extrapolated to no dissipation it is one.
    assert 2 * loss[0] - loss[1] == pytest.approx(1.0, abs=1e-3)


def test_it_never_pulls():
    """A strong dissipation would pull as the bodies part."""
    model = ball({"y": 0.21, "y_dot": -2.0}, dissipation=20.0).compile(optimize="-O0")
    result = model.simulate((0, 0.2), method="rodas5", rtol=1e-8)
    assert result["force"].min() >= 0.0
    assert result["force"].max() > 0.0


def test_a_sliding_ball_rolls_at_five_sevenths_of_its_speed():
    start = {"y": 0.2, "x_dot": 2.0}
    model = ball(start, gravity=G, dissipation=1.0, friction="mu", transition=1e-5)
    result = model.compile(["mu"], optimize="-O0").simulate((0, 1.5), rtol=1e-9)
    assert result["b.x_dot"][-1] == pytest.approx(10 / 7, rel=1e-9)
    assert -0.2 * result["b.theta_dot"][-1] == pytest.approx(10 / 7, rel=1e-7)
    # Momentum about the line of contact stays, whatever the friction is.
    assert abs(result.sensitivity("b.x_dot", "mu")[-1]) < 1e-6


def test_a_sphere_in_space_is_that_of_the_plane():
    """The same slide, along a slanted line of an inclined plane through a node that is turned."""
    turn = cotree.Scene("slope", gravity=(0, 0, 0))
    normal = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)
    along = np.array([3.0, 0.0, -1.0]) / np.sqrt(10.0)
    turn.gravity = cotree.Scene("g", gravity=tuple(-G * normal)).gravity
    place = 0.2 * normal
    initial = dict(zip(("x", "y", "z"), place, strict=True))
    initial |= dict(zip(("vx", "vy", "vz"), 2.0 * along, strict=True))
    turn.edge("b", "rigid_body", "ground", "B", mass=1.3, inertia=0.4 * 1.3 * 0.04, initial=initial)
    turn.edge("tilt", "arm", "ground", "P", vector=[0, 0, 0], rotation=[0.3, -0.2, 0.7])
    axes = turning(0.3, -0.2, 0.7)
    contact = {"radius": 0.2, "stiffness": 2.5e5, "dissipation": 1.0, "friction": 0.3}
    turn.edge("c", "contact", "P", "B", normal=(axes.T @ normal).tolist(), **contact)
    result = turn.compile(optimize="-O0").simulate((0, 0.4), rtol=1e-9)
    flat = ball({"y": 0.2, "x_dot": 2.0}, gravity=G, dissipation=1.0, friction="mu")
    expected = flat.compile(optimize="-O0").simulate((0, 0.4), rtol=1e-9)
    end = np.array([result[f"b.{c}"][-1] for c in "xyz"])
    velocity = np.array([result[f"b.v{c}"][-1] for c in "xyz"])
    # Two runs at rtol 1e-9.
    assert end @ along == pytest.approx(expected["b.x"][-1], rel=1e-7)
    assert end @ normal == pytest.approx(expected["b.y"][-1], rel=1e-7)
    assert velocity @ along == pytest.approx(expected["b.x_dot"][-1], rel=1e-7)
    assert abs(end @ np.cross(normal, along)) < 1e-9


def turning(roll, pitch, yaw):
    def about(axis, angle):
        c, s = np.cos(angle), np.sin(angle)
        i, j = [(1, 2), (2, 0), (0, 1)][axis]
        matrix = np.eye(3)
        matrix[i, i] = matrix[j, j] = c
        matrix[i, j], matrix[j, i] = -s, s
        return matrix

    return about(2, yaw) @ about(1, pitch) @ about(0, roll)


@pytest.mark.parametrize("friction", [{}, {"friction": 0.2}])
def test_two_spheres_keep_momentum_and_angular_momentum(friction):
    scene = Scene("spheres", gravity=(0, 0, 0))
    starts = {
        "A": {"vx": 1.0, "vy": 0.1, "w3": 5.0},
        "B": {"x": 0.25, "y": 0.05, "z": -0.03, "w1": 2.0},
    }
    masses, inertias = {"A": 1.0, "B": 2.5}, {"A": 0.004, "B": 0.02}
    for n, initial in starts.items():
        body = {"mass": masses[n], "inertia": inertias[n]}
        scene.edge(n.lower(), "rigid_body", "ground", n, **body, initial=initial)
    scene.edge(
        "hit",
        "contact",
        "A",
        "B",
        ball=0.1,
        radius=0.12,
        stiffness=1e6,
        dissipation=0.1,
        **friction,
    )
    scene.output("force", "hit.force")
    result = scene.compile(optimize="-O0").simulate((0, 0.2), rtol=1e-10, atol=1e-13)
    assert result["force"].max() > 0.0 == result["force"][-1]

    def vectors(kind, body):
        names = {"place": "xyz", "v": ("vx", "vy", "vz"), "w": ("w1", "w2", "w3")}[kind]
        return np.array([result[f"{body}.{name}"] for name in names]).T

    momentum, spin, energy = 0.0, 0.0, 0.0
    for n in "AB":
        b, m, j = n.lower(), masses[n], inertias[n]
        momentum = momentum + m * vectors("v", b)
        spin = spin + np.cross(vectors("place", b), m * vectors("v", b)) + in_space(result, b, j)
        energy = energy + m * (vectors("v", b) ** 2).sum(1) + j * (vectors("w", b) ** 2).sum(1)
    # Sums over the run of errors at rtol 1e-10.
    assert np.max(np.abs(momentum - momentum[0])) < 1e-9
    assert np.max(np.abs(spin - spin[0])) < 1e-9
    assert energy[-1] < energy[0]


def in_space(result, body, inertia):
    """Turn an angular momentum from a ball's axes to those of the ground."""
    q0, q = result[f"{body}.q0"], np.array([result[f"{body}.q{i}"] for i in (1, 2, 3)]).T
    w = np.array([result[f"{body}.w{i}"] for i in (1, 2, 3)]).T
    crossed = 2.0 * np.cross(q, w)
    return inertia * (w + q0[:, None] * crossed + np.cross(q, crossed))


def box(**initial):
    scene = Scene("box", gravity=(0, -G, 0))
    scene.parameter("mu", 0.4)
    scene.edge("b", "rigid_body", "ground", "B", mass=1.0, inertia=0.13 / 12, initial=initial)
    fields = {"stiffness": 2e5, "dissipation": 0.5, "friction": "mu", "size": [0.3, 0.2, 0]}
    scene.edge("c", "contact", "ground", "B", normal=[0, 1, 0], **fields)
    scene.output("force", "c.force")
    return scene


def test_a_box_comes_to_rest_on_its_side():
    model = box(y=0.8, x_dot=1.0, theta=0.5, theta_dot=-3.0).compile(optimize="-O0")
    assert len([name for name in model.outputs if name == "force"]) == 1
    result = model.simulate((0, 4), rtol=1e-7)
    # Two corners bear it: depth = (m g / (2 k))^(2/3) on either side, at multiples of a half turn.
    depth = (G / 4e5) ** (2 / 3)
    assert result["force"][-1] == pytest.approx(G, rel=1e-4)
    assert result["b.y"][-1] == pytest.approx(0.1 - depth, abs=1e-6)
    assert np.sin(result["b.theta"][-1]) == pytest.approx(0.0, abs=1e-4)


def test_sensitivities_agree_with_differences():
    scene = ball(
        {"y": 0.6, "x_dot": 2.0}, gravity=G, dissipation=0.3, friction="mu", transition=0.05
    )
    names = ["k", "mu", "R", "m", "b.y"]
    model = scene.compile(names, optimize="-O0")
    # At 1e-12 contacts leave 2e-10 in some runs, which the differences divide by 3e-3.
    settings = {"method": "dop853", "rtol": 1e-13, "atol": 1e-15}
    result = model.simulate((0, 0.5), **settings)
    states = ("b.x", "b.y", "b.theta", "b.y_dot")
    for name in names:
        value = 0.6 if name == "b.y" else {"k": 2.5e5, "mu": 0.3, "R": 0.2, "m": 1.3}[name]
        ends = {}
        for share in (1e-2, 5e-3):
            for sign in (1, -1):
                where = {name: value * (1 + sign * share)}
                given = {"initial": where} if name == "b.y" else {"parameters": where}
                run = model.simulate((0, 0.5), sensitivities=False, **given, **settings)
                ends[sign * share] = np.array([run[state][-1] for state in states])
        coarse, fine = (
            (ends[share] - ends[-share]) / (2 * share * value) for share in (1e-2, 5e-3)
        )
        # Extrapolated, the differences have an error of the step to the fourth power.
        slopes = (4 * fine - coarse) / 3
        found = [result.sensitivity(state, name)[-1] for state in states]
        np.testing.assert_allclose(found, slopes, rtol=1e-6, atol=1e-6 * np.max(np.abs(slopes)))


def test_a_cylinder_lies_on_two_rims():
    scene = Scene("drum", gravity=(0, 0, -G))
    body = {"mass": 2.0, "inertia": [0.03, 0.03, 0.04]}
    scene.edge("b", "rigid_body", "ground", "B", **body, initial={"z": 0.2, "vx": 0.4, "w2": 2.0})
    fields = {"radius": 0.2, "axis": [0, 1, 0], "length": 0.5, "stiffness": 1e5, "dissipation": 1.0}
    scene.edge("c", "contact", "ground", "B", normal=[0, 0, 1], friction=0.5, **fields)
    for i in (1, 2):
        scene.output(f"f{i}", f"-c.normal_{i}.f")
    result = scene.compile(optimize="-O0").simulate((0, 2), rtol=1e-8)
    # It begins to roll without slip, and goes on so.
    assert result["b.vx"][-1] == pytest.approx(0.4, rel=1e-3)
    for i in (1, 2):
        assert result[f"f{i}"][-1] == pytest.approx(G, rel=1e-3)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({}, "needs the normal of a plane or the radius of a ball"),
        ({"normal": [0, 1, 0], "ball": 1}, "needs the normal of a plane or the radius of a ball"),
        ({"ball": 1, "size": [1, 1, 1], "radius": 1}, "size of a box: remove radius, axis"),
        ({"ball": 1, "semiaxes": [1, 1, 1]}, "ellipsoid, which touches a plane: remove"),
        ({"ball": 1, "axis": [0, 0, 1]}, "needs a radius"),
        ({"normal": [0, 1, 0], "axis": [0, 0, 1]}, "needs a radius"),
        ({"normal": [0, 1, 0], "length": 2}, "needs its axis"),
        ({"normal": [0, 1, 0], "exponent": "n"}, "exponent of edge 'c' must be a number"),
        ({"normal": [0, 1, 0], "exponent": 0.5}, "must be a number from 1 to 10"),
        ({"normal": [0, 1, 0], "stiffness": -1}, "stiffness of edge 'c'"),
        ({"normal": [0, 0, 0]}, "normal of edge 'c'"),
        ({"normal": [0, 1, 0], "radius": -1}, "radius of edge 'c'"),
        ({"normal": [0, 1, 0], "joint": "j"}, "joint"),
        ({"normal": [0, 1, 0], "size": [1, -2, 1]}, "entry 2 of size of edge 'c' is -2"),
        ({"normal": [0, 1, 0], "size": [0, 0.0, 0]}, "size of edge 'c' is zero along every axis"),
        ({"normal": [0, 1, 0], "semiaxes": [0, 0, 0]}, "entry 1 of semiaxes of edge 'c' is 0"),
        ({"normal": [0, 1, 0], "semiaxes": [1, -1, 2]}, "entry 2 of semiaxes of edge 'c' is -1"),
    ],
)
def test_wrong_contacts_are_refused_by_name(fields, message):
    with pytest.raises(cotree.Error, match=message):
        compiled_with({"stiffness": 1e5} | fields)


def compiled_with(fields):
    scene = Scene("wrong")
    scene.edge("b", "rigid_body", "ground", "B", mass=1.0, inertia=1.0)
    scene.edge("c", "contact", "ground", "B", **fields)
    return scene.compile(optimize="-O0")


@pytest.mark.parametrize(
    "size",
    [
        ["0", 0.2, 0.4],
        {"value": [0, 20, 40], "unit": "cm"},
        [{"value": 0, "unit": "mm"}, 0.2, 0.4],
    ],
)
def test_a_plate_has_four_corners_however_its_zero_is_written(size):
    scene = compiled_with({"normal": [0, 1, 0], "stiffness": 1e5, "size": [0, 0.2, 0.4]})
    other = compiled_with({"normal": [0, 1, 0], "stiffness": 1e5, "size": size})
    assert other.kernels.source == scene.kernels.source


def test_an_edge_that_a_parameter_makes_zero_has_two_corners_at_one_place():
    """Folded into the code or tunable, the parameter gives the same eight places."""
    forces = []
    for tunable in (False, True):
        scene = Scene("thin", gravity=(0, 0, 0))
        scene.parameter("w", 0.0, tunable=tunable)
        scene.edge("b", "rigid_body", "ground", "B", mass=1.0, inertia=1.0, initial={"y": 0.09})
        fields = {"normal": [0, 1, 0], "stiffness": 1e5, "size": ["w", 0.2, 0.4]}
        scene.edge("c", "contact", "ground", "B", **fields)
        scene.output("force", "c.force")
        model = scene.compile(optimize="-O0")
        forces.append(float(model.output_values(0.0, model.initial_state)[0]))
    # The four lower corners are 0.01 m deep.
    assert forces == pytest.approx([4 * 1e5 * 0.01**1.5] * 2, rel=1e-12)


def test_a_slip_has_no_integral():
    scene = ball({}, friction=0.3)
    scene.output("slid", "c.slide1.s")
    with pytest.raises(cotree.Error, match=r"edge 'c' has no variable 'slide1\.s'"):
        scene.compile()


def test_nodes_are_those_of_bodies():
    scene = Scene("nowhere")
    scene.edge("b", "rigid_body", "ground", "B", mass=1.0, inertia=1.0)
    scene.edge("c", "contact", "ground", "C", normal=[0, 1, 0], stiffness=1e5)
    with pytest.raises(cotree.Error, match="C"):
        scene.compile()
    with pytest.raises(SceneError, match="two nodes"):
        scene.edge("d", "contact", "ground", normal=[0, 1, 0], stiffness=1e5)


@pytest.mark.parametrize("kind", ["contact", "rigid_contact"])
@pytest.mark.parametrize(
    ("normal", "across", "slip"),
    [
        ([0, 1, 0], [0, 0, 1], 0.3),
        ([1, 0, 0], [0, 0, 1], -0.2),
        ([0.6, 0.8, 0], [0, 0, 1], 0.8 * 0.3 - 0.6 * 0.2),
        ([0, 0, 1], [0, 1, 0], -0.3),
        ([1, 0, 0], [0, 1, 0], 0.2),
    ],
)
def test_both_contacts_slide_along_the_normal_crossed_with_that_of_the_motion(
    kind, normal, across, slip
):
    up = np.cross(across, [1, 0, 0]) * (1 if across[2] else -1)
    scene = cotree.Scene("direction", gravity=[float(-9.81 * x) for x in up])
    far = 3.0 * np.array(normal)
    start = {"s": float(far[0]), "s_dot": 0.3}
    scene.edge("x", "prismatic", "ground", "A", axis=[1, 0, 0], initial=start)
    start = {"s": float(far @ up), "s_dot": 0.2}
    scene.edge("y", "prismatic", "A", "B", axis=up.tolist(), initial=start)
    scene.edge("r", "revolute", "B", "P", axis=across)
    scene.edge("b", "rigid_body", "ground", "P", mass=1.0, inertia=[1.0, 1.0, 1.0])
    own = {"stiffness": 1e4} if kind == "contact" else {}
    scene.edge("c", kind, "ground", "P", normal=normal, friction=0.3, **own)
    scene.output("slip", "c.slide1.v")
    result = scene.compile(optimize="-O0").simulate((0, 0.01), [0.0, 0.01])
    assert abs(result["slip"][0] - slip) <= 1e-14
