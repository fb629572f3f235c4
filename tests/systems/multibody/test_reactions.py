"""Reactions, consistent starts and linearisation: closed forms, and every set of coordinates."""

from __future__ import annotations

import bare_models
import numpy as np
import pytest
from random_scenes import random_scene

import cotree
from cotree import Scene
from cotree.errors import ParameterError

# Each value is a few dozen products of order one to a hundred, each rounded to 1e-16.
ROUNDING = 1e-12

each_coordinates = pytest.mark.parametrize("coordinates", ["joint", "absolute"])


def tree_of(scene, coordinates):
    kinds = ("rigid_body", "arm") if coordinates == "absolute" else ("revolute", "prismatic", "arm")
    return [n for n, e in scene.edges.items() if e.component.name in kinds and n != "D"]


def evaluated(scene, coordinates="joint", wanted=()):
    trees = tree_of(scene, coordinates) if coordinates in ("joint", "absolute") else coordinates
    return bare_models.evaluated(scene, trees, wanted)


def at(model, t=0.0):
    """Outputs by name at the consistent start, and their sensitivities by name and parameter."""
    start = model.start(t)
    found = dict(zip(model.outputs, model.output_values(t, start.y), strict=True))
    if model.sensitivities:
        slopes = model.output_sensitivity(t, start.y, start.s)
        for name, row in zip(model.outputs, slopes, strict=True):
            for parameter, slope in zip(model.sensitivities, row, strict=True):
                found[name, parameter] = slope
    return found


def new_scene(name, **parameters):
    scene = Scene(name, gravity=[0, "-g", 0])
    for key, value in {"g": 9.81, **parameters}.items():
        scene.parameter(key, value)
    return scene


# ---- closed forms


@each_coordinates
def test_the_pin_of_a_pendulum_carries_its_weight_and_its_swing(coordinates):
    m, L, J, g, angle, rate = 1.3, 0.8, 0.2, 9.81, 0.7, 2.1
    scene = new_scene("pendulum", m=m, L=L, J=J)
    start = {"theta": angle, "theta_dot": rate}
    scene.edge("pin", "revolute", "ground", "B", axis=[0, 0, 1], initial=start)
    scene.edge("rod", "arm", "B", "C", vector=[0, "-L", 0])
    scene.edge("bob", "rigid_body", "ground", "C", mass="m", inertia="J")
    for key in ("fx", "fy", "tz"):
        scene.output(key, f"pin.{key}")
    found = at(evaluated(scene, coordinates, ["L"]))
    whole = J + m * L**2
    bend = -m * g * L * np.sin(angle) / whole
    along, inward = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    force = m * L * (bend * along + rate**2 * inward) + [0, m * g]
    assert np.allclose([found["fx"], found["fy"]], force, rtol=0, atol=ROUNDING)
    assert abs(found["tz"]) < ROUNDING
    # The angle and its rate stay as given while L changes.
    slope = -m * g * np.sin(angle) * (J - m * L**2) / whole**2
    slopes = m * ((bend + L * slope) * along + rate**2 * inward)
    own = [found["fx", "L"], found["fy", "L"]]
    assert np.allclose(own, slopes, rtol=0, atol=10 * ROUNDING)


@each_coordinates
def test_a_guide_carries_what_leads_beside_it(coordinates):
    m, g, slope, push, drag, rate, c, d = 1.3, 9.81, 0.4, 3.0, 0.6, 1.7, 0.3, 0.2
    scene = new_scene("guide", m=m)
    axis = np.array([np.cos(slope), np.sin(slope)])
    fields = {"axis": [*axis.tolist(), 0], "force": push, "damping": drag}
    start = {"s": 0.5, "s_dot": rate}
    scene.edge("guide", "prismatic", "ground", "A", initial=start, **fields)
    scene.edge("beside", "arm", "A", "C", vector=[c, d, 0])
    scene.edge("body", "rigid_body", "ground", "C", mass="m", inertia=0.1)
    for key in ("fx", "fy", "tz"):
        scene.output(key, f"guide.{key}")
    found = at(evaluated(scene, coordinates))
    bend = (push - drag * rate) / m - g * axis[1]
    force = m * bend * axis + [0, m * g]
    assert np.allclose([found["fx"], found["fy"]], force, rtol=0, atol=ROUNDING)
    # No moment is left about the centre of mass.
    assert found["tz"] == pytest.approx(c * force[1] - d * force[0], abs=ROUNDING)


@each_coordinates
def test_the_torque_of_a_prescribed_turn(coordinates):
    m, L, J, c, g, t = 1.3, 0.8, 0.2, 0.4, 9.81, 0.6
    scene = new_scene("driven", m=m, L=L, J=J)
    fields = {"axis": [0, 0, 1], "motion": "0.9*sin(2*t)", "damping": c}
    scene.edge("motor", "revolute", "ground", "B", **fields)
    scene.edge("rod", "arm", "B", "C", vector=["L", 0, 0])
    scene.edge("bob", "rigid_body", "ground", "C", mass="m", inertia="J")
    for key in ("drive", "tz", "fx"):
        scene.output(key, f"motor.{key}")
    found = at(evaluated(scene, coordinates), t)
    angle, rate, bend = 0.9 * np.sin(2 * t), 1.8 * np.cos(2 * t), -3.6 * np.sin(2 * t)
    torque = (J + m * L**2) * bend + m * g * L * np.cos(angle)
    assert found["tz"] == pytest.approx(torque, abs=ROUNDING)
    assert found["drive"] == pytest.approx(torque + c * rate, abs=ROUNDING)
    pull = -m * L * (bend * np.sin(angle) + rate**2 * np.cos(angle))
    assert found["fx"] == pytest.approx(pull, abs=ROUNDING)


@each_coordinates
def test_the_force_of_a_prescribed_lift(coordinates):
    m, g, t = 2.0, 9.81, 0.7
    scene = new_scene("lift", m=m)
    scene.edge("winch", "prismatic", "ground", "A", axis=[0, 1, 0], motion="0.3*t**3")
    scene.edge("cabin", "rigid_body", "ground", "A", mass="m")
    scene.output("drive", "winch.drive")
    found = at(evaluated(scene, coordinates), t)
    assert found["drive"] == pytest.approx(m * (g + 1.8 * t), abs=ROUNDING)


TURNED = {"A": -0.8, "B": -2.3}


def four_bar(**starts):
    """A crank, a coupler and a rocker; the loop is closed by D. Starts are by joint.

    Turned ends let angles of zero be near the one assembly, of two, that every tree then finds.
    """
    scene = new_scene("four-bar", a=0.3, b=0.7, c=0.5, d=0.6, m=2.0)
    end = "ground"
    for name, length in zip("ABC", "abc", strict=True):
        start = starts.get(name, {})
        extra = {"motion": start.pop("motion")} if "motion" in start else {}
        extra |= {"damping": 0.3} if name == "B" else {}
        scene.edge(name, "revolute", end, f"{name}1", axis=[0, 0, 1], initial=start, **extra)
        scene.edge(f"c{name}", "arm", f"{name}1", f"{name}c", vector=[f"{length}/2", 0.02, 0])
        turned = {"rotation": [0, 0, TURNED[name]]} if name in TURNED else {}
        scene.edge(f"e{name}", "arm", f"{name}1", f"{name}2", vector=[length, 0, 0], **turned)
        body = {"mass": "m", "inertia": f"m*{length}**2/12"}
        scene.edge(f"b{name}", "rigid_body", "ground", f"{name}c", **body)
        end = f"{name}2"
    scene.edge("base", "arm", "ground", "D1", vector=["d", 0, 0])
    scene.edge("D", "revolute", "D1", end, axis=[0, 0, 1])
    for key in ("A.fx", "A.fy", "D.fx", "D.fy", "B.tz", "B.theta_dot", "A.theta_dot", "Cc.ax"):
        scene.output(key.replace(".", "_"), key)
    scene.output("energy", "energy.kinetic + energy.potential")
    return scene


@pytest.mark.sampled(3)
@each_coordinates
@pytest.mark.parametrize("t", [0.0, 0.4])
def test_the_crank_of_a_four_bar_gives_what_the_bodies_take(coordinates, t):
    scene = four_bar(A={"motion": "1.1 + 3*t + t**2"})
    scene.output("drive", "A.drive")
    model = evaluated(scene, coordinates)
    start, found = model.start(t).y, at(model, t)
    rates, step = model.rhs(t, start), 1e-4
    energy = model.outputs.index("energy")
    ahead = [model.output_values(t, start + k * step * rates)[energy] for k in (-2, -1, 1, 2)]
    stored = np.dot([1, -8, 8, -1], ahead) / (12 * step)
    lost = 0.3 * found["B_theta_dot"] ** 2
    assert found["A_theta_dot"] == pytest.approx(3 + 2 * t, abs=1e-12)
    # Differences divide the energy's rounding of 1e-15 by the step, and err by 1e-16 times
    # fifth derivatives.
    power = found["drive"] * found["A_theta_dot"]
    assert power == pytest.approx(stored + lost, abs=1e-9 * max(1.0, abs(stored)))
    assert abs(power) > 1.0


# ---- whatever the tree


# Other seeds have springs about joints whose angle a chord does not know.
@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(i, marks=pytest.mark.slow) for i in (1, 3, 4, 8, 9))]
)
def test_accelerations_and_reactions_are_those_of_every_tree(seed):
    scene = random_scene(seed, 2)
    scene.outputs.clear()
    for i in range(2):
        for k in "xyz":
            for key in (f"C{i}.a{k}", f"C{i}.alpha{k}", f"j{i}.f{k}", f"j{i}.t{k}"):
                scene.output(key.replace(".", "_"), key)
    kinds = ("rigid_body", "spring", "damper", "force", "torque")
    joints = [n for n, e in scene.edges.items() if e.component.name not in kinds]
    bodies = tree_of(scene, "absolute")
    check_same(*(at(evaluated(scene, tree, ["a", "b", "g"]), 0.3) for tree in (joints, bodies)))


def test_reactions_of_a_loop_are_those_of_every_tree():
    scene = four_bar(A={"theta": 1.1, "theta_dot": 2.0})
    wanted = ["a", "d", "g", "m"]
    found = [at(evaluated(scene, tree, wanted)) for tree in ("joint", "absolute")]
    without_b = [n for n in [*tree_of(scene, "joint"), "D"] if n != "B"]
    check_same(*found, at(evaluated(scene, without_b, wanted)))


def check_same(expected, *others):
    for other in others:
        assert other.keys() == expected.keys()
        for key, value in expected.items():
            # Roundings of order 1e-15 times the condition of bordered matrices, some decades.
            assert other[key] == pytest.approx(value, rel=1e-9, abs=1e-10), key


# ---- consistent starts

CRANK = {"theta": 1.1, "theta_dot": 2.0}


def test_what_is_given_stays_and_the_rest_of_a_loop_follows():
    model = evaluated(four_bar(A=CRANK))
    y = model.start().y
    by_name = dict(zip(model.states, y, strict=True))
    assert (by_name["A.theta"], by_name["A.theta_dot"]) == (1.1, 2.0)
    a, b, c, d = 0.3, 0.7, 0.5, 0.6
    turns = [
        by_name["A.theta"],
        *(by_name[f"{j}.theta"] + v for j, v in zip("BC", TURNED.values(), strict=True)),
    ]
    one, two, three = np.cumsum(turns)
    closed = a * np.exp(1j * one) + b * np.exp(1j * two) + c * np.exp(1j * three)
    assert abs(closed - d) < 1e-13  # Newton's steps end at the rounding of sums of order one
    assert np.abs(model.kernels.constraint_values(0.0, y)).max() < 1e-13


def test_sensitivities_of_a_start_keep_the_loop_closed():
    wanted = ["a", "c", "d", "A.theta"]
    model = evaluated(four_bar(A=CRANK), wanted=wanted)
    start, p = model.start(), model.default_parameters
    kernel = model.kernels.bound("constraint_sensitivity", p)
    rows = kernel(0.0, start.y, np.ascontiguousarray(start.s.T).ravel(), None)
    assert rows.size
    assert np.abs(rows).max() < 1e-12
    step = 1e-4
    for j, name in enumerate(wanted):
        found = []
        for k in (-2, -1, 1, 2):
            if name == "A.theta":
                found.append(model.start(initial={name: 1.1 + k * step}).y)
            else:
                value = p[model.parameters.index(name)] + k * step
                found.append(model.start(p=model.kernels.parameter_array({name: value})).y)
        slope = np.dot([1, -8, 8, -1], found) / (12 * step)
        # Starts are found to 1e-14, divided by the step; fourth order errs by some 1e-12.
        assert np.allclose(start.s[:, j], slope, rtol=0, atol=1e-8), name


def given_start(digits, **changes):
    """Return every joint of the tree, rounded, with changes."""
    model = evaluated(four_bar(A=CRANK))
    known = dict(zip(model.states, model.start().y, strict=True))
    rounded = {name: float(f"{value:.{digits}g}") for name, value in known.items()}
    rounded |= {name.replace("__", "."): value for name, value in changes.items()}
    starts = {j: {c: rounded[f"{j}.{c}"] for c in ("theta", "theta_dot")} for j in "ABC"}
    return evaluated(four_bar(**starts)), known


def test_values_that_cannot_fit_are_refused_by_residual():
    model, _ = given_start(17, B__theta=1.0)
    with pytest.raises(ParameterError, match=r"initial positions violate.*D\.[xy] = "):
        model.start()
    model, _ = given_start(17, C__theta_dot=5.0)
    with pytest.raises(ParameterError, match=r"initial velocities violate.*D\.[xy]_dot = "):
        model.start()


def test_values_of_six_digits_are_mended():
    model, known = given_start(6)
    y = model.start().y
    assert np.abs(model.kernels.constraint_values(0.0, y)).max() < 1e-13
    # The smallest move is of the size of the roundings, 5e-6 of values up to ten.
    moved = np.abs(y - [known[name] for name in model.states])
    assert 0.0 < moved.max() < 1e-4


# ---- Baumgarte


@pytest.mark.compiler
def test_baumgarte_bounds_the_drift_that_grows_without():
    scene = new_scene("pendulum", m=1.0)
    scene.edge("pin", "revolute", "ground", "B", axis=[0, 0, 1], initial={"theta": 1.0})
    scene.edge("rod", "arm", "B", "C", vector=[0, -1.0, 0])
    scene.edge("bob", "rigid_body", "ground", "C", mass="m", inertia=0.1)
    times = np.array([5.0, 20.0])
    drift = {}
    for rate in (0.0, 20.0):
        model = scene.compile(tree=["bob", "rod"], optimize="-O0", baumgarte=rate)
        settings = {"method": "dop853", "rtol": 1e-7, "atol": 1e-7, "throw": True}
        result = model.simulate((0.0, 20.0), times, project=False, **settings)
        values = [
            model.kernels.constraint_values(t, y) for t, y in zip(times, result.y.T, strict=True)
        ]
        drift[rate] = np.abs(values).max(axis=1)
        held = model.simulate((0.0, 20.0), times, **settings)
        assert held.drift is not None
        assert held.drift.worst < 1e-14
    # Left alone, errors of velocity add up to errors of position that grow with the time squared;
    # a decay of 20 /s leaves those of the last fraction of a second.
    assert drift[0.0][1] > 3.0 * drift[0.0][0] > 0.0
    assert drift[20.0][1] < 3.0 * drift[20.0][0]
    assert drift[20.0][1] < 1e-2 * drift[0.0][1]


# ---- linearisation


@pytest.mark.compiler
@pytest.mark.parametrize("tree", [None, ["m5", "m6", "r3", "r4"]], ids=["joint", "absolute"])
def test_linearisation_is_the_slope_of_rates_and_outputs(tree):
    scene = cotree.load("slider-pendulum")
    scene.input("F", 0.0)
    scene.edge("push", "force", "ground", "A", force=["F + 0.1*F*h2.theta", 0, 0])
    for name, text in {"a": "A.ax", "reaction": "h2.fy", "mixed": "F*2 + h2.theta"}.items():
        scene.output(name, text)
    model = scene.compile(tree=tree, optimize="-O0")
    linear = model.linearize(0.2)
    n, here = len(model.states), np.append(model.start().y, 0.0)

    def both(z):
        return np.concatenate(
            [f(0.2, z[:n], None, z[n:]) for f in (model.rhs, model.output_values)]
        )

    found = np.block([[linear.A, linear.B], [linear.C, linear.D]])
    # Differences of fourth order: 1e-12 of fifth derivatives, and roundings of 1e-16 of terms of
    # some hundred over the step.
    step, weights = 1e-3, {-2: 1, -1: -8, 1: 8, 2: -1}
    columns = [
        sum(w * both(here + k * step * e) for k, w in weights.items()) for e in np.eye(n + 1)
    ]
    expected = np.array(columns).T / (12 * step)
    assert np.allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    assert np.allclose(linear.A, model.jacobian(0.2, here[:n]), rtol=0, atol=1e-11)
