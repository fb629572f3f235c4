"""Rigid contact of bodies: impacts, rest, rolling, sliding and rocking, against closed forms."""

from math import atan, cos, sin, sqrt

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from scipy.integrate import quad

import cotree

# What a run at this tolerance leaves of its states is measured as 1e-11 and less.
TIGHT = {"method": "dop853", "rtol": 1e-11, "atol": 1e-13}
CLOSE = 1e-9
G = 9.81


def plane_scene(name, **parameters):
    scene = cotree.Scene(name, gravity=[0, "-g", 0])
    scene.parameter("g", G)
    for key, value in parameters.items():
        scene.parameter(key, value)
    return scene


def disc(**parameters):
    """Build a disc that is thrown on a floor: it bounces, slides, and rolls."""
    given = {"m": 2.0, "R": 0.1, "mu": 0.3, "u": 2.0, "e": 0.5, "h": 0.0, "w": 0.0}
    scene = plane_scene("disc", **given | parameters)
    inertia = ["m*R**2/4", "m*R**2/4", "m*R**2/2"]
    initial = {"y": "h + R", "x_dot": "u", "theta_dot": "w"}
    scene.edge("b", "rigid_body", "ground", "P", mass="m", inertia=inertia, initial=initial)
    own = {"friction": "mu", "restitution": "e", "rest_speed": 0.05}
    scene.edge("c", "rigid_contact", "ground", "P", normal=[0, 1, 0], radius="R", **own)
    return scene


def incline():
    """Build a block on a plane that tilts: the weight turns instead."""
    scene = cotree.Scene("incline")
    given = {"g": G, "m": 2.0, "mu": 0.3, "L": 0.4, "H": 0.2, "r": 0.1}
    for key, value in given.items():
        scene.parameter(key, value)
    inertia = ["m*H**2/12", "m*L**2/12", "m*(L**2 + H**2)/12"]
    initial = {"y": "H/2"}
    scene.edge("b", "rigid_body", "ground", "P", mass="m", inertia=inertia, initial=initial)
    scene.edge(
        "c", "rigid_contact", "ground", "P", normal=[0, 1, 0], size=["L", "H", 0], friction="mu"
    )
    weight = ["m*g*sin(r*t)", "-m*g*cos(r*t)", 0]
    scene.edge("G", "force", "ground", "P", force=weight)
    return scene


def rocking(th=0.1):
    """Build a block that stands on one of its corners, and falls back."""
    scene = plane_scene("rocking", m=5.0, B=0.3, H=1.0, th=th)
    initial = {
        "theta": "-th",
        "x": "-(B/2)*cos(th) + (H/2)*sin(th)",
        "y": "(B/2)*sin(th) + (H/2)*cos(th)",
    }
    inertia = ["m", "m", "m*(B**2 + H**2)/12"]
    scene.edge("b", "rigid_body", "ground", "P", mass="m", inertia=inertia, initial=initial)
    own = {"size": ["B", "H", 0], "friction": 3.0, "rest_speed": 1e-4}
    scene.edge("c", "rigid_contact", "ground", "P", normal=[0, 1, 0], **own)
    return scene


def rod(u, mu, w=0.0, th=1.1):
    """Build a rod that slides with its lower end on a rough floor (P. Painleve, 1895)."""
    scene = plane_scene("rod", m=1.0, L=1.0, mu=mu, th=th, u=u, w=w)
    initial = {
        "theta": "th",
        "x": "L/2*cos(th)",
        "y": "L/2*sin(th)",
        "theta_dot": "w",
        "x_dot": "u - w*L/2*sin(th)",
        "y_dot": "w*L/2*cos(th)",
    }
    inertia = ["m", "m", "m*L**2/12"]
    scene.edge("b", "rigid_body", "ground", "P", mass="m", inertia=inertia, initial=initial)
    scene.edge("tip", "arm", "P", "T", vector=["-L/2", 0, 0])
    scene.edge("c", "rigid_contact", "ground", "T", normal=[0, 1, 0], friction="mu")
    return scene


def woodpecker():
    """Build the woodpecker toy of R. Leine, Ch. Glocker, D. van Campen (ASME DETC2001/VIB-21608).

    Its dimensions are theirs; angles are not linearised.
    """
    scene = cotree.Scene("woodpecker", gravity=[0, -G, 0])
    given = {"mM": 0.0003, "JM": 5e-9, "mS": 0.0045, "JS": 7e-7, "c": 0.0056, "r0": 0.0025}
    given |= {"rM": 0.0031, "hM": 0.0058, "lM": 0.010, "lG": 0.015, "hS": 0.02, "lS": 0.0201}
    for name, value in given.items():
        scene.parameter(name, value)
    turn = {"axis": [0, 0, 1]}
    scene.edge("pole", "arm", "ground", "R", vector=["r0", 0, 0])
    scene.edge("y", "prismatic", "ground", "A", axis=[0, 1, 0], initial={"s_dot": -0.3411})
    scene.edge("phi", "revolute", "A", "B", initial={"theta": -0.1}, **turn)
    scene.edge("sleeve", "rigid_body", "ground", "B", mass="mM", inertia=["JM", "JM", "JM"])
    scene.edge("mount", "arm", "B", "C", vector=["lM", 0, 0])
    start = {"theta": -0.1788, "theta_dot": -7.4583}
    scene.edge("bend", "revolute", "C", "D", initial=start, **turn)
    scene.edge("spring", "rotational_spring", joint="bend", stiffness="c")
    scene.edge("body", "arm", "D", "S", vector=["lG", 0, 0])
    scene.edge("bird", "rigid_body", "ground", "S", mass="mS", inertia=["JS", "JS", "JS"])
    scene.edge("head", "arm", "D", "beak", vector=["lG - lS", "hS", 0])
    scene.edge("below", "arm", "B", "low", vector=["rM", "-hM", 0])
    scene.edge("above", "arm", "B", "top", vector=["rM", "hM", 0])
    own = {"normal": [1, 0, 0], "friction": 0.3}
    scene.edge("peck", "rigid_contact", "R", "beak", restitution=0.5, **own)
    scene.edge("jam", "rigid_contact", "R", "low", **own)
    scene.edge("catch", "rigid_contact", "R", "top", **own)
    return scene


def test_a_disc_slides_until_it_rolls():
    u, mu = 2.0, 0.3
    result = disc().compile(["mu", "u"]).simulate((0, 2), **TIGHT)
    # Friction takes mu g of the speed, and gives 2 mu g/R of the spin, until both agree.
    roll = u / (3 * mu * G)
    assert abs(result.events["c.slide1 stops"].t[0] - roll) <= CLOSE
    assert abs(result["b.x_dot"][-1] - 2 / 3 * u) <= CLOSE
    assert abs(result["b.theta_dot"][-1] + 2 / 3 * u / 0.1) <= CLOSE * 10
    assert abs(result["b.x"][-1] - (2 / 3 * u * 2 + u**2 / (18 * mu * G))) <= CLOSE
    assert abs(result.sensitivity("b.x", "mu")[-1] + u**2 / (18 * mu**2 * G)) <= CLOSE
    assert abs(result.sensitivity("b.x", "u")[-1] - (4 / 3 + u / (9 * mu * G))) <= CLOSE


@pytest.mark.parametrize(("mu", "w"), [(0.1, 3.0), (0.9, -12.0)])
def test_an_impact_with_friction_slides_or_sticks(mu, w):
    u, e, h, radius = 3.0, 0.5, 0.5, 0.1
    result = disc(mu=mu, w=w, u=u, h=h).compile(["mu", "e"]).simulate((0, 0.6), **TIGHT)
    normal = (1 + e) * sqrt(2 * G * h)
    # To stick takes a third of the slip of the rim, of a disc whose inertia is m R^2/2.
    slip = u + w * radius
    sticks = abs(slip) / 3 <= mu * normal
    change = slip / 3 if sticks else np.sign(slip) * mu * normal
    assert abs(result["b.x_dot"][-1] - (u - change)) <= CLOSE
    assert abs(result["b.theta_dot"][-1] - (w - 2 * change / radius)) <= CLOSE * 10
    by_mu = 0.0 if sticks else -np.sign(slip) * normal
    assert abs(result.sensitivity("b.x_dot", "mu")[-1] - by_mu) <= CLOSE


def test_a_disc_bounces_to_rest_and_rolls_on():
    h, e, slow = 0.5, 0.5, 0.05
    result = disc(h=h, w=30.0).compile(["e"]).simulate((0, 3), **TIGHT)
    first = sqrt(2 * G * h)
    n = 1
    while first * e**n > slow:
        n += 1
    flights = 1 + 2 * np.cumsum([0.0, *(e**k for k in range(1, n))])
    assert np.max(np.abs(result.events["c.normal hits"].t - first / G * flights)) <= CLOSE
    assert "Impacts ended in rest, slower than rest_speed: 'c.normal'" in result.message
    # Angular momentum about the floor stays, whatever friction does: x' = (2 u - R w)/3.
    assert abs(result["b.x_dot"][-1] - (2 * 2.0 - 0.1 * 30.0) / 3) <= CLOSE
    assert result["c.normal.mode"][-1] == -1.0


def test_a_block_on_an_incline_slips_where_that_is_steep_enough():
    mu, r = 0.3, 0.1
    result = incline().compile(["mu"]).simulate((0, 4), **TIGHT)
    start = atan(mu) / r
    # One corner reaches its limit first; the other one holds on until both have.
    slips = [t for i in range(1, 5) for t in result.events[f"c.slide1_{i} slips forwards"].t]
    assert abs(max(slips) - start) <= CLOSE
    name = next(
        f"c.slide1_{i} slips forwards"
        for i in range(1, 5)
        if max(result.events[f"c.slide1_{i} slips forwards"].t, default=0) == max(slips)
    )
    assert abs(result.event_sensitivity(name, "mu")[-1] - 1 / ((1 + mu**2) * r)) <= CLOSE

    def speed(t):
        return G / r * (cos(r * start) - cos(r * t) - mu * (sin(r * t) - sin(r * start)))

    assert abs(result["b.x_dot"][-1] - speed(4.0)) <= CLOSE
    assert abs(result["b.x"][-1] - quad(speed, start, 4.0, epsabs=1e-13)[0]) <= CLOSE


def falls(th, B, H):
    """Return the time in which a block that stands on a corner falls flat.

    Energy about the corner: th'^2 = 2 p^2 (cos(alpha - th) - cos(alpha - th0)). In x with
    th0 - th = th0 x^2 the integrand has no pole.
    """
    alpha, p2 = np.arctan(B / H), 3 * G / (2 * np.sqrt(B**2 + H**2))
    nodes, weights = leggauss(40)
    x = (nodes + 1) / 2
    # cos(alpha - th0) - cos(alpha - th) without the difference of nearly equal numbers
    drop = 2 * np.sin(alpha - th + th * x**2 / 2) * np.sin(th * x**2 / 2)
    return np.sum(weights * th * x / np.sqrt(2 * p2 * drop))


def test_a_block_rocks_as_housner_says():
    given = {"th": 0.1, "B": 0.3, "H": 1.0}
    alpha = atan(given["B"] / given["H"])
    result = rocking().compile(list(given)).simulate((0, 1.2), **TIGHT)
    hits = sorted((t, n) for n, row in result.events.items() if "hits" in n for t in row.t)
    assert abs(hits[0][0] - falls(**given)) <= CLOSE
    for name, value in given.items():
        slope = falls(**{**given, name: value + 1e-30j}).imag / 1e-30
        assert abs(result.event_sensitivity(hits[0][1], name)[0] - slope) <= CLOSE
    place = result.states.index("b.theta_dot")
    for _, name in hits:
        row = result.events[name]
        # From the angular momentum about the corner that comes down (G. W. Housner, Bull. Seism.
        # Soc. Am. 53 (1963) 403).
        ratio = row.y_after[place, 0] / row.y_before[place, 0]
        assert abs(ratio - (1 - 1.5 * sin(alpha) ** 2)) <= CLOSE


def test_painleves_rod_is_named_where_nothing_or_more_than_one_motion_agrees():
    # Steep enough and rough enough: mu > 4/3.
    with pytest.warns(RuntimeWarning, match=r"'c.normal' have no consistent modes"):
        rod(-1.0, 2.0).compile().simulate((0, 0.3), **TIGHT)
    with pytest.warns(
        RuntimeWarning, match=r"the contact 'c.normal' may stay closed or open: with such"
    ):
        rod(-1.0, 2.0, w=5.0).compile().simulate((0, 0.3), **TIGHT)
    # Sliding fast, it turns until the force that presses it down has no bound.
    with pytest.warns(RuntimeWarning, match=r"Sliding at 'c.normal' jams: with such strong"):
        rod(-20.0, 3.0, w=3.0, th=0.3).compile().simulate((0, 0.3), **TIGHT)
    assert rod(-1.0, 0.3).compile().simulate((0, 0.3), **TIGHT).success
    assert rod(1.0, 2.0).compile().simulate((0, 0.3), **TIGHT).success


def test_a_woodpecker_comes_down_its_pole_in_a_limit_cycle():
    result = woodpecker().compile().simulate((0, 1.6), method="dop853", rtol=1e-9, atol=1e-12)
    assert result.success
    row = result.events["peck.normal hits"]
    periods = np.diff(row.t)[-3:]
    drops = np.diff(row.y_before[result.states.index("y.s")])[-3:]
    # The cycle repeats: the tolerance is that of the run.
    assert np.ptp(periods) <= 1e-7
    assert np.ptp(drops) <= 1e-7
    # Moreau's time-stepping, written for itself with steps of 20 and 10 us, gives 0.13084 s and
    # 0.13079 s, 14.546 mm and 14.518 mm; its errors are of first order.
    assert abs(periods[-1] - 0.13074) <= 3e-5
    assert abs(drops[-1] + 0.01449) <= 3e-5


def test_sensitivities_of_a_woodpecker_equal_differences_over_its_cycle():
    """Over one cycle the sleeve jams, sticks, slides and lets go, and the beak hits the pole."""
    scene = woodpecker()
    values = {name: row.number for name, row in scene.parameters.items()}
    model = scene.compile(list(values))
    states = ["y.s", "phi.theta", "bend.theta", "y.s_dot", "bend.theta_dot"]

    def run(**parameters):
        own = {"method": "dop853", "rtol": 1e-12, "atol": 1e-15, "parameters": parameters}
        result = model.simulate((0, 0.13), **own)
        times = [(t, name) for name, row in result.events.items() for t in row.t]
        return result, [name for _, name in sorted(times)]

    result, sequence = run()
    for name in ("jam.slide1 stops", "jam.slide1 slips forwards", "jam.normal lifts"):
        assert name in sequence
    assert "peck.normal hits" in sequence
    for name, value in values.items():
        slopes = []
        for h in (1e-4, 5e-5):
            sides = [run(**{name: value * (1 + d)}) for d in (h, -h)]
            assert [side[1] for side in sides] == [sequence] * 2
            ends = [np.array([side[state][-1] for state in states]) for side, _ in sides]
            slopes.append((ends[0] - ends[1]) / (2 * h))
        # Fourth order; what is left is the error of the runs, 1e-11 of a speed, over the step.
        slope = slopes[1] + (slopes[1] - slopes[0]) / 3
        found = [value * result.sensitivity(state, name)[-1] for state in states]
        bound = 3e-6 * np.abs(slope).max()
        np.testing.assert_allclose(found, slope, rtol=0, atol=bound, err_msg=name)


def test_a_sphere_slides_down_a_plane_without_friction_in_space():
    scene = cotree.Scene("sphere", gravity=[0, 0, "-g"])
    for name, value in {"g": G, "R": 0.2, "a": 0.3}.items():
        scene.parameter(name, value)
    initial = {"x": "R*sin(a)", "z": "R*cos(a)", "vy": 0.5}
    scene.edge("b", "rigid_body", "ground", "P", mass=1.5, initial=initial)
    scene.edge("c", "rigid_contact", "ground", "P", normal=["sin(a)", 0, "cos(a)"], radius="R")
    scene.output("push", "c.force")
    result = scene.compile(["a"]).simulate((0, 1), **TIGHT)
    gone = G * sin(0.3) / 2
    assert abs(result["b.x"][-1] - (0.2 * sin(0.3) + gone * cos(0.3))) <= CLOSE
    assert abs(result["b.y"][-1] - 0.5) <= CLOSE
    assert abs(result["push"][-1] - 1.5 * G * cos(0.3)) <= CLOSE


def test_a_point_that_touches_is_marked_in_animations():
    drawing = rod(1.0, 0.3).compile(optimize="-O0").simulate((0, 0.1)).animate().drawing
    tip = [solid for solid in drawing.solids if solid.name == "c"]
    assert min(np.ptp(solid.mesh.points, axis=0).max() for solid in tip) <= 0.1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "own", "end", "states"),
    [
        (disc, {}, 2.0, ["b.x", "b.theta"]),
        (disc, {"h": 0.5, "w": 30.0}, 3.0, ["b.x", "b.theta"]),
        (disc, {"h": 0.5, "w": 3.0, "u": 3.0, "mu": 0.1}, 1.2, ["b.x", "b.theta", "b.x_dot"]),
        (incline, {}, 4.0, ["b.x", "b.x_dot"]),
        (rocking, {}, 1.2, ["b.theta", "b.theta_dot"]),
        (rod, {"u": 1.0, "mu": 2.0}, 0.3, ["b.theta", "b.x"]),
        (rod, {"u": -1.0, "mu": 0.3}, 0.3, ["b.theta", "b.x"]),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_sensitivities_across_transitions_agree_with_differences(make, own, end, states):
    scene = make(**own)
    values = {name: row.number for name, row in scene.parameters.items() if row.number}
    model = scene.compile(list(values))
    result = model.simulate((0, end), **TIGHT)
    assert result.success, result.message
    for name, value in values.items():
        h = 1e-5 * abs(value)
        sides = [model.simulate((0, end), parameters={name: value + d}, **TIGHT) for d in (h, -h)]
        for state in states:
            difference = (sides[0][state][-1] - sides[1][state][-1]) / (2 * h)
            # Second-order errors h^2 and rounding of states over h, both below 1e-7 here.
            size = max(1.0, abs(difference))
            assert abs(result.sensitivity(state, name)[-1] - difference) <= 1e-6 * size


def boxes(seed):
    """Build a box that is thrown on a floor."""
    rng = np.random.default_rng(seed)
    width, height = (float(x) for x in rng.uniform(0.1, 0.6, 2))
    mass = float(rng.choice([0.5, 1.0, 2.0]))
    inertia = mass * (width**2 + height**2) / 12
    scene = cotree.Scene("box", gravity=[0, -G, 0])
    initial = {"y": float(rng.uniform(0.5, 1)), "theta": float(rng.uniform(-1.5, 1.5))}
    initial |= {"x_dot": float(rng.normal()), "theta_dot": float(3 * rng.normal())}
    own = {"mass": mass, "inertia": [inertia] * 3, "initial": initial}
    scene.edge("b", "rigid_body", "ground", "P", **own)
    mu = float(rng.choice([0.1, 0.3, 0.6, 1.0]))
    surface = {"friction": mu, "restitution": float(rng.choice([0.0, 0.2])), "rest_speed": 0.02}
    scene.edge(
        "c", "rigid_contact", "ground", "P", normal=[0, 1, 0], size=[width, height, 0], **surface
    )
    for i in range(1, 5):
        scene.output(f"N{i}", f"-c.normal_{i}.f")
        scene.output(f"T{i}", f"c.slide1_{i}.f")
        scene.output(f"g{i}", f"c.normal_{i}.s")
    moving = f"0.5*{mass}*(b.x_dot**2 + b.y_dot**2) + 0.5*{inertia}*b.theta_dot**2"
    scene.output("energy", f"{moving} + {mass * G}*b.y")
    return scene, mu


@pytest.mark.slow
@pytest.mark.parametrize("first", [0, 10, 20])
def test_random_boxes_come_to_rest_as_contact_allows(first):
    for seed in range(first, first + 10):
        scene, mu = boxes(seed)
        result = scene.compile(optimize="-O0").simulate((0, 3), rtol=1e-9, atol=1e-11)
        # Newton's law of impact with friction may gain energy, and is refused then.
        assert result.success or "would leave more energy" in result.message, (seed, result.message)
        energy = result["energy"]
        # Errors of the steps, some hundred of them, each a tolerance of 1e-9.
        assert np.max(np.diff(energy), initial=0.0) <= 1e-6 * (1 + abs(energy[0])), seed
        for i in range(1, 5):
            normal, along = result[f"N{i}"], result[f"T{i}"]
            # A corner that holds is left by what the tolerance allows.
            assert np.min(result[f"g{i}"]) >= -1e-6, (seed, i)
            assert np.min(normal) >= -1e-6, (seed, i)
            assert np.max(np.abs(along) - mu * normal) <= 1e-6, (seed, i)


@pytest.mark.parametrize("seed", [7, 9])
def test_boxes_that_rock_to_rest_stay_on_the_floor(seed):
    # The last flights of the corners are lower than rounding: gaps that are left below zero by that
    # must neither let the box through nor add up.
    scene, _ = boxes(seed)
    result = scene.compile(optimize="-O0").simulate((0, 3), rtol=1e-9, atol=1e-11)
    assert result.success, result.message
    for i in range(1, 5):
        # What rests is left by what the tolerance allows.
        assert np.min(result[f"g{i}"]) >= -1e-8
    # At rest the floor carries the weight; all energy is that of height, to the tolerance.
    weight = result["energy"][-1] / result["b.y"][-1]
    assert sum(result[f"N{i}"][-1] for i in range(1, 5)) == pytest.approx(weight, rel=1e-6)
