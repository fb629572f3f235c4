"""Random boxes that are thrown into the corner of a room: impacts, sliding and rest at two planes.

Energy never grows, no gap closes further than the tolerance, no contact pulls, and friction stays
within its limits.
"""

from __future__ import annotations

import functools
from itertools import product

import numpy as np
import pytest
from contact_checks import check_contacts, check_sensitivities

import cotree

pytestmark = pytest.mark.compiler

G = 9.81

#: Slips that end ever faster between impacts, and a contact that cannot slip while two others hold.
ONCE_REFUSED = (116, 205, 284, 326, 395)

PLACES = [f"{plane}{i}" for plane in ("floor", "wall") for i in range(1, 5)]


@functools.cache
def model(by=()):
    """Compile a box above a floor and beside a wall."""
    scene = cotree.Scene("cornered", gravity=[0, -G, 0])
    values = {"W": 0.3, "H": 0.2, "m": 1.0, "I": 0.02, "mu": 0.3, "e": 0.2}
    start = {"x": 1.0, "y": 0.8, "theta": 0.3, "x_dot": -1.0, "y_dot": 0.0, "theta_dot": 1.0}
    for name, value in (values | {f"{name}0": value for name, value in start.items()}).items():
        scene.parameter(name, value)
    initial = {name: f"{name}0" for name in start}
    scene.edge("b", "rigid_body", "ground", "P", mass="m", inertia="I", initial=initial)
    own = {"size": ["W", "H", 0], "friction": "mu", "restitution": "e", "rest_speed": 0.02}
    for plane, normal in {"floor": [0, 1, 0], "wall": [1, 0, 0]}.items():
        scene.edge(plane, "rigid_contact", "ground", "P", normal=normal, **own)
        for i in range(1, 5):
            scene.output(f"N_{plane}{i}", f"-{plane}.normal_{i}.f")
            scene.output(f"T_{plane}{i}", f"{plane}.slide1_{i}.f")
            scene.output(f"gap_{plane}{i}", f"{plane}.normal_{i}.s")
    moving = "0.5*m*(b.x_dot**2 + b.y_dot**2) + 0.5*I*b.theta_dot**2"
    scene.output("energy", f"{moving} + {G}*m*b.y")
    return scene.compile(list(by), optimize="-O1")


def thrown(seed):
    """Draw a box and its throw."""
    random = np.random.default_rng(seed)
    width, height = random.uniform(0.1, 0.6, 2)
    mass = random.choice([0.5, 1.0, 2.0])
    values = {"W": width, "H": height, "m": mass, "I": mass * (width**2 + height**2) / 12}
    values |= {"mu": random.choice([0.05, 0.1, 0.3, 0.6, 1.0])}
    values |= {"e": random.choice([0.0, 0.0, 0.2, 0.5])}
    values |= {"x0": random.uniform(0.5, 1.2), "y0": random.uniform(0.5, 1)}
    values |= {"theta0": random.uniform(-1.5, 1.5), "x_dot0": -abs(2 * random.normal())}
    values |= {"y_dot0": random.normal(), "theta_dot0": 4 * random.normal()}
    return {name: float(value) for name, value in values.items()}


def seeds(n):
    """List seeds, of which a campaign has more."""
    return [
        pytest.param(seed, marks=[pytest.mark.campaign] * (seed >= 20 and seed not in ONCE_REFUSED))
        for seed in range(n)
    ]


@pytest.mark.slow
@pytest.mark.parametrize("seed", seeds(500))
def test_boxes_thrown_into_corners(seed):
    values = thrown(seed)
    result = model().simulate((0, 3), rtol=1e-9, atol=1e-11, parameters=values, time_limit=60)
    assert result.success, result.message
    check_contacts(result, PLACES, values["mu"])


@pytest.mark.parametrize("method", ["dop853", "dopri5", "rodas5"])
def test_box_slides_down_a_wall_and_lands_flat(method):
    # Two corners slide down the wall, so that two others hit the floor at once: without
    # restitution the box comes to rest in the corner.
    values = thrown(0)
    result = model().simulate((0, 1), method=method, rtol=1e-9, atol=1e-11, parameters=values)
    assert abs(result["b.x"][-1] - 0.5 * values["H"]) <= 1e-9
    assert abs(result["b.y"][-1] - 0.5 * values["W"]) <= 1e-9
    assert abs(result["b.x_dot"][-1]) <= 1e-9


def impacts(values, before):
    """List all solutions of an impact at the floor and the wall: places with impulses, and speeds.

    Without restitution, a corner has no impulse and separates, sticks, or slides.
    """
    x, y, theta, *speeds = before
    c, s = np.cos(theta), np.sin(theta)
    half = 0.5 * np.array([values["W"], values["H"]])
    arms = np.array([[c, -s], [s, c]]) @ (half * list(product((-1, 1), repeat=2))).T
    weights = np.array([values["m"], values["m"], values["I"]])
    rows = []
    for normal in ([0.0, 1.0], [1.0, 0.0]):
        arm = arms[:, np.argmin(normal @ arms)]
        assert abs(normal @ (arm + np.array([x, y]))) <= 1e-9
        rows.append([[*n, arm[0] * n[1] - arm[1] * n[0]] for n in (normal, normal[::-1])])
    J = np.reshape(rows, (4, 3))  # normal and tangent at the floor, then at the wall
    slopes, start, mu = J @ (J / weights).T, J @ speeds, values["mu"]
    found = []
    for laws in product(("open", "sticks", -1, 1), repeat=2):
        left, right = slopes.copy(), -start
        for k, law in enumerate(laws):
            free = {"open": (0, 1), "sticks": ()}.get(law, (1,))
            for i in free:
                # The impulse is zero, or that of friction; otherwise a speed is zero.
                left[2 * k + i] = np.eye(4)[2 * k + i]
                right[2 * k + i] = 0.0
            if law in {-1, 1}:
                left[2 * k + 1, 2 * k] = law * mu
        if np.linalg.cond(left) > 1e9:
            continue  # impulses that are not unique, where both corners stick
        pulses = np.linalg.solve(left, right)
        after = start + slopes @ pulses
        for k, law in enumerate(laws):
            (push, rub), (rate, slip) = pulses[2 * k : 2 * k + 2], after[2 * k : 2 * k + 2]
            if rate < -1e-12 or push < -1e-12 or abs(rub) > mu * push + 1e-12:
                break
            if law in {-1, 1} and law * slip < -1e-12:
                break
        else:
            found.append((pulses[::2] > 1e-12, speeds + J.T @ pulses / weights))
    return found


@pytest.mark.parametrize(("seed", "end", "number"), [(2, 0.65, 1), (124, 0.42, 2)])
def test_an_impact_with_several_solutions_has_impulses_only_where_a_gap_closes(seed, end, number):
    values = thrown(seed)
    result = model().simulate((0, end), rtol=1e-10, atol=1e-12, parameters=values)
    row = result.events[f"wall.normal_{number} rests"]
    solutions = impacts(values, row.y_before[:6, -1])
    # In the others, the box jams between the floor and the wall.
    jams = [speeds for pushed, speeds in solutions if pushed.all()]
    assert jams
    np.testing.assert_allclose(jams, 0.0, atol=1e-9)
    (speeds,) = [speeds for pushed, speeds in solutions if not pushed[0]]
    assert np.abs(speeds).max() > 0.1
    np.testing.assert_allclose(row.y_after[3:6, -1], speeds, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [pytest.param(k, marks=[pytest.mark.campaign] * (k >= 6)) for k in range(100)]
)
def test_sensitivities_of_boxes_equal_differences(seed):
    values = thrown(seed)
    values["e"] += 0.05  # differences need restitutions on both sides
    compiled = model(("mu", "e", "x_dot0"))
    check_sensitivities(compiled, values, 1.2, ["b.x", "b.y", "b.theta", "b.x_dot"])
