"""Dry friction in joints of closed chains: parallelogram and slider-crank, against closed forms."""

from __future__ import annotations

from functools import cache
from itertools import combinations, pairwise

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from scipy.optimize import brentq

from cotree import Scene

pytestmark = pytest.mark.compiler

TIGHT = {"method": "dop853", "rtol": 1e-11, "atol": 1e-13}
# Errors of both runs are some hundred tolerances of 1e-11.
CLOSE = 1e-9
Z = [0, 0, 1]
#: The largest torque of friction in each hinge of the parallelogram.
TORQUES = {1: 0.2, 2: 0.13, 3: 0.17, 4: 0.11}
G = 9.81


#: Parameters of all motions: constant, growing and alternating torque, angle at the start, gravity.
TORQUE = "T0 + T1*t + T2*cos(3*t)"
RESTING = {"T0": 0.0, "T1": 0.0, "T2": 0.0, "start": 1.1, "g": 0.0}


def _parallelogram(hinges):
    """Draw two cranks of length 0.5 and a coupler of length 0.8, which moves without turning."""
    scene = Scene("parallelogram", gravity=[0, "-g", 0])
    for name, value in RESTING.items():
        scene.parameter(name, value)
    initial = {"theta": "start"}
    scene.edge("h1", "revolute", "ground", "A", axis=Z, torque=TORQUE, initial=initial)
    scene.edge("crank1", "rigid_body", "ground", "A", mass=0.0, inertia=0.05)
    scene.edge("arm1", "arm", "A", "B", vector=[0.5, 0, 0])
    scene.edge("h2", "revolute", "B", "C", axis=Z, initial={"theta": "-start"})
    scene.edge("half", "arm", "C", "M", vector=[0.4, 0, 0])
    scene.edge("coupler", "rigid_body", "ground", "M", mass=1.3, inertia=0.1)
    scene.edge("whole", "arm", "C", "E", vector=[0.8, 0, 0])
    scene.edge("base", "arm", "ground", "Q", vector=[0.8, 0, 0])
    scene.edge("h4", "revolute", "Q", "R", axis=Z, initial={"theta": "start"})
    scene.edge("crank2", "rigid_body", "ground", "R", mass=0.0, inertia=0.05)
    scene.edge("arm2", "arm", "R", "S", vector=[0.5, 0, 0])
    scene.edge("h3", "revolute", "E", "S", axis=Z)
    for k in hinges:
        scene.parameter(f"F{k}", TORQUES[k])
        scene.edge(f"f{k}", "rotational_dry_friction", joint=f"h{k}", torque=f"F{k}")
        scene.output(f"held{k}", f"f{k}.tau")
    return scene


def _one_freedom():
    """Draw the shaft that the parallelogram amounts to, whose closed forms are tested elsewhere."""
    scene = Scene("one")
    scene.parameter("F", 1.0)
    for name, value in RESTING.items():
        scene.parameter(name, value)
    initial = {"theta": "start"}
    whole = 2 * 0.05 + 1.3 * 0.5**2
    scene.edge("J", "rotational_inertia", "ground", "a", inertia=whole, initial=initial)
    weight = "1.3*g*0.5*cos(J.theta)"
    scene.edge("T", "torque_source", "ground", "a", torque=f"{TORQUE} - {weight}")
    scene.edge("f", "rotational_dry_friction", "ground", "a", torque="F")
    scene.output("held", "f.tau")
    return scene


def _subsets(joints):
    return [own for n in range(1, 5) for own in combinations(joints, n)]


@cache
def _compiled(draw, joints, sensitivities=()):
    return draw(joints).compile(list(sensitivities))


def _with_friction(draw, limits, joints, *, has_sensitivities=False):
    """Return a model with friction in some joints, and values of its parameters.

    One subset of each size has a model of its own. The others share the model with friction in all
    joints, and set the other limits to zero.
    """
    every = tuple(limits)
    modelled = joints if joints in _subsets(every)[::5] else every
    names = [f"F{joint}" for joint in modelled] if has_sensitivities else []
    others = {f"F{joint}": 0.0 for joint in modelled if joint not in joints}
    return _compiled(draw, modelled, tuple(names)), others


#: Parameters and speed at the start.
MOTIONS = {
    "at rest": ({"T0": 0.1}, 0.0),
    "breaking away": ({"T1": 0.38}, 0.0),
    # Within 2.2 s no motion reaches the position in one line, where it could go on in two ways.
    "stopping": ({"T0": 0.05}, 0.5),
    "to and fro": ({"T2": 1.0}, 0.0),
    "under its weight": ({"start": -0.9, "g": G}, 0.0),
}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("hinges", _subsets(TORQUES), ids=str)
def test_a_parallelogram_whose_hinges_rub_moves_as_one_shaft_does(hinges):
    times = np.linspace(0, 2.2, 23)
    alone = _one_freedom().compile(["F"])
    model, others = _with_friction(_parallelogram, TORQUES, hinges, has_sensitivities=True)
    whole = {"F": sum(TORQUES[k] for k in hinges)}
    for own, speed in MOTIONS.values():
        exact = alone.simulate(
            (0, 2.2), times, **TIGHT, parameters=own | whole, initial={"J.w": speed}
        )
        found = model.simulate(
            (0, 2.2), times, **TIGHT, parameters=own | others, initial={"h1.theta_dot": speed}
        )
        assert found.status == 0, found.message
        assert found["h1.theta"] == pytest.approx(exact["J.theta"], abs=CLOSE)
        slope = exact.sensitivity("J.theta", "F")
        for k in hinges:
            assert found.sensitivity("h1.theta", f"F{k}") == pytest.approx(slope, abs=CLOSE)
        # Only the second hinge turns backwards as the first one turns forwards.
        total = sum(found[f"held{k}"] * (-1 if k == 2 else 1) for k in hinges)
        assert total == pytest.approx(exact["held"], abs=1e-8)
        for k in hinges:
            assert np.max(np.abs(found[f"held{k}"])) <= TORQUES[k] + CLOSE


R, L, WHEEL, ROD, TURN, SLIDER = 0.2, 0.5, 0.3, 0.4, 0.02, 0.7
START, SPEED = 0.5, 6.0
#: The joints of the slider-crank, with the largest force or torque of friction in each.
JOINTS = {"h1": 0.03, "h2": 0.05, "pin": 0.04, "rail": 0.5}


def _slider_crank(joints, at=START, **of_crank):
    scene = Scene("slider-crank")
    scene.edge("h1", "revolute", "ground", "A", axis=Z, **of_crank)
    scene.edge("wheel", "rigid_body", "ground", "A", mass=0.0, inertia=WHEEL)
    scene.edge("crank", "arm", "A", "B", vector=[R, 0, 0])
    tilt = np.arcsin(R * np.sin(at) / L)
    scene.edge("h2", "revolute", "B", "C", axis=Z, initial={"theta": -at - tilt})
    scene.edge("half", "arm", "C", "M", vector=[L / 2, 0, 0])
    scene.edge("rod", "rigid_body", "ground", "M", mass=ROD, inertia=TURN)
    scene.edge("whole", "arm", "C", "D", vector=[L, 0, 0])
    along = {"s": R * np.cos(at) + L * np.cos(tilt)}
    scene.edge("rail", "prismatic", "ground", "E", axis=[1, 0, 0], initial=along)
    scene.edge("slider", "rigid_body", "ground", "E", mass=SLIDER)
    scene.edge("pin", "revolute", "E", "D", axis=Z)
    for joint in joints:
        scene.parameter(f"F{joint}", JOINTS[joint])
        kind, field = ("translational", "force") if joint == "rail" else ("rotational", "torque")
        law = {field: f"F{joint}"}
        scene.edge(f"f_{joint}", f"{kind}_dry_friction", joint=joint, **law)
        scene.output(f"o_{joint}", f"f_{joint}.{'f' if joint == 'rail' else 'tau'}")
    return scene


def _ratios(q):
    """Return the speed of each joint for a unit of the crank's."""
    tilt = np.arcsin(R * np.sin(q) / L)
    turn = R * np.cos(q) / L / np.cos(tilt)
    slide = -R * np.sin(q) - L * np.sin(tilt) * turn
    return {"h1": np.ones_like(q), "h2": -1 - turn, "pin": -turn, "rail": slide}


def _inertia(q):
    """Return the inertia that the crank feels at an angle."""
    tilt = np.arcsin(R * np.sin(q) / L)
    own = _ratios(q)
    x = -R * np.sin(q) + L / 2 * np.sin(tilt) * own["pin"]
    y = R * np.cos(q) + L / 2 * np.cos(tilt) * own["pin"]
    return WHEEL + SLIDER * own["rail"] ** 2 + TURN * own["pin"] ** 2 + ROD * (x**2 + y**2)


NODES, WEIGHTS = leggauss(12)


def _angle(joints, t_end):
    """Return the angle of the crank at a time, and its derivatives by the forces of friction.

    Work gives the speed at each angle, and its reciprocal the time.
    """
    energy = 0.5 * _inertia(np.array(START)) * SPEED**2

    def advance(a, b, before):
        """Return time, its derivatives and the work of unit forces from angle a to b."""
        angles, weights = a + (NODES + 1) / 2 * (b - a), WEIGHTS * (b - a) / 2
        inner = a + np.outer((angles - a) / 2, NODES + 1)
        shares = np.outer((angles - a) / 2, WEIGHTS)
        work = {j: before[j] + np.sum(shares * abs(_ratios(inner)[j]), axis=1) for j in joints}
        inertia = _inertia(angles)
        speed = np.sqrt(2 * (energy - sum(JOINTS[j] * work[j] for j in joints)) / inertia)
        slopes = {j: np.sum(weights * work[j] / (inertia * speed**3)) for j in joints}
        end = {j: before[j] + np.sum(weights * abs(_ratios(angles)[j])) for j in joints}
        return np.sum(weights / speed), slopes, end

    # The ratios change sign at multiples of a quarter of a turn, where cells end.
    cell = np.pi / 64
    q, t = START, 0.0
    work, slopes = dict.fromkeys(joints, 0.0), dict.fromkeys(joints, 0.0)
    while True:
        ahead = (np.floor(q / cell + 1e-9) + 1) * cell
        time, own, end = advance(q, ahead, work)
        if t + time > t_end:
            break
        q, t, work = ahead, t + time, end
        slopes = {j: slopes[j] + own[j] for j in joints}
    angle = brentq(lambda x: t + advance(q, x, work)[0] - t_end, q, ahead, xtol=1e-15)
    _, own, end = advance(q, angle, work)
    left = energy - sum(JOINTS[j] * end[j] for j in joints)
    speed = np.sqrt(2 * left / _inertia(np.array(angle)))
    return angle, {j: -speed * (slopes[j] + own[j]) for j in joints}


def _turning(joints):
    return _slider_crank(joints, initial={"theta": START, "theta_dot": SPEED})


def _driven(joints):
    return _slider_crank(joints, motion=f"{SPEED}*t + {START}")


def _pushed(joints):
    return _slider_crank(joints, at=0.0, torque=0.3)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("joints", _subsets(JOINTS), ids=str)
def test_a_slider_crank_with_friction_passes_its_dead_centres(joints):
    angle, slopes = _angle(joints, 2.0)
    assert angle > START + 3 * np.pi  # three dead centres at least
    model, others = _with_friction(_turning, JOINTS, joints, has_sensitivities=True)
    result = model.simulate((0, 2), **TIGHT, parameters=others)
    assert result.status == 0, result.message
    assert result["h1.theta"][-1] == pytest.approx(angle, abs=CLOSE)
    for j in joints:
        assert result.sensitivity("h1.theta", f"F{j}")[-1] == pytest.approx(slopes[j], abs=CLOSE)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("joints", _subsets(JOINTS), ids=str)
def test_joints_of_a_driven_slider_crank_rub_against_their_speeds(joints):
    model, others = _with_friction(_driven, JOINTS, joints, has_sensitivities=True)
    result = model.simulate((0, 2), rtol=1e-9, parameters=others)
    assert result.status == 0, result.message
    for joint, ratio in _ratios(SPEED * result.t + START).items():
        moves = np.abs(ratio) > 1e-3
        for by in joints if joint in joints else ():
            side = np.sign(ratio[moves])
            assert result[f"o_{joint}"][moves] == pytest.approx(JOINTS[joint] * side, abs=1e-12)
            found = result.sensitivity(f"o_{joint}", f"F{by}")[moves]
            assert found == pytest.approx(side * (by == joint), abs=1e-12)


def _time_from_dead_centre(joints, torque, angle):
    """Return the time after which a torque has turned the crank by an angle, from rest."""
    # In the root of the angle the speed is nearly linear.
    ends = np.linspace(0, np.sqrt(angle), 9)
    total = 0.0
    for a, b in pairwise(ends):
        roots, weights = a + (NODES + 1) / 2 * (b - a), WEIGHTS * (b - a) / 2
        angles = roots**2
        inner, shares = np.outer(angles / 2, NODES + 1), np.outer(angles / 2, WEIGHTS)
        work = sum(JOINTS[j] * np.sum(shares * abs(_ratios(inner)[j]), axis=1) for j in joints)
        speed = np.sqrt(2 * (torque * angles - work) / _inertia(angles))
        total += np.sum(weights * 2 * roots / speed)
    return total


@pytest.mark.sampled(2)
@pytest.mark.parametrize("joints", _subsets(JOINTS), ids=str)
def test_a_slider_crank_starts_from_its_dead_centre(joints):
    model, others = _with_friction(_pushed, JOINTS, joints)
    result = model.simulate((0, 1), **TIGHT, parameters=others)
    assert result.status == 0, result.message
    exact = brentq(lambda x: _time_from_dead_centre(joints, 0.3, x) - 1.0, 0.1, 0.9, xtol=1e-14)
    # The slider sticks until its force moves something: for 1e-6 of the angle.
    assert result["h1.theta"][-1] == pytest.approx(exact, abs=1e-7)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("hinges", _subsets(TORQUES), ids=str)
def test_hinges_that_hold_one_motion_share_the_torque_in_one_direction(hinges):
    model, others = _with_friction(_parallelogram, TORQUES, hinges)
    for torque in (0.0, 0.09):
        result = model.simulate((0, 1), parameters={"T0": torque, **others}, **TIGHT)
        shares = [result[f"held{k}"][-1] * (-1 if k == 2 else 1) for k in hinges]
        assert sum(shares) == pytest.approx(torque, abs=1e-12)
        # Least norm: no hinge holds against another one.
        assert min(shares) >= -1e-12
