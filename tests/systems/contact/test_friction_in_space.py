"""Friction on planes in space: closed forms, an independent integration, and transitions."""

from __future__ import annotations

import functools
from math import hypot

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import cotree

G = 9.81
TIGHT = {"rtol": 1e-10, "atol": 1e-12}


def sphere(velocity, spin, height="R", restitution=0.0, friction=0.2):
    """Throw a solid sphere on a horizontal plane."""
    scene = cotree.Scene("sphere", gravity=[0, 0, -G])
    for name, value in {"mu": friction, "m": 2.0, "R": 0.1, "e": restitution}.items():
        scene.parameter(name, value)
    initial = dict(zip(("vx", "vy"), velocity, strict=True)) | {"z": height}
    initial |= dict(zip(("w1", "w2", "w3"), spin, strict=True))
    scene.edge("b", "rigid_body", "ground", "P", mass="m", inertia=["2/5*m*R**2"] * 3,
               initial=initial)  # fmt: skip
    scene.edge("c", "rigid_contact", "ground", "P", normal=[0, 0, 1], radius="R", friction="mu",
               restitution="e")  # fmt: skip
    return scene


def rolling(velocity, spin, end, mu=0.2, radius=0.1):
    """Return place and velocity: slip falls by 7/2 mu g in its own direction, then it rolls."""
    slip = np.array(velocity) + radius * np.array([-spin[1], spin[0]])
    way = slip / np.linalg.norm(slip)
    t = min(end, 2 * np.linalg.norm(slip) / (7 * mu * G))
    speed = velocity - mu * G * t * way
    place = np.array(velocity) * t - mu * G * t * t / 2 * way + speed * (end - t)
    # The time at which it rolls is inversely proportional to mu, the speed then is the same.
    slope = -G * t * t / 2 * way
    return place, speed, slope


@pytest.mark.parametrize("method", ["dop853", "rodas5"])
@pytest.mark.parametrize(
    ("velocity", "spin"),
    [((2.0, 0.0), (0.0, 0.0, 0.0)), ((0.7, -1.1), (12.0, -5.0, 30.0)), ((0.4, 0.3), (0, 25.0, 0))],
)
def test_a_sphere_slides_then_rolls(velocity, spin, method):
    model = sphere(velocity, spin).compile(["mu"])
    result = model.simulate((0, 1.0), method=method, **TIGHT)
    place, speed, slope = rolling(velocity, spin, 1.0)
    # The direction of the slip is exact to the tolerance where it vanishes.
    np.testing.assert_allclose([result["b.x"][-1], result["b.y"][-1]], place, atol=1e-9)
    np.testing.assert_allclose([result["b.vx"][-1], result["b.vy"][-1]], speed, atol=1e-9)
    assert result["c.slide1.mode"][-1] == 0.0
    found = [result.sensitivity(name, "mu")[-1] for name in ("b.x", "b.y")]
    np.testing.assert_allclose(found, slope, atol=1e-9)


def bounces(velocity, spin, end, mu, e, radius=0.1, height=0.6):
    """Return the place of a sphere that bounces, and sticks or slides in each impact."""
    place, v = np.array([0, 0, height], complex), np.array([*velocity, 0.0], complex)
    w, t = np.array(spin, complex), 0j
    while True:
        gap = place[2] - radius if t == 0 else 0j
        step = (v[2] + np.sqrt(v[2] ** 2 + 2 * G * gap)) / G
        is_over = step.real >= end - t.real
        last = end - t if is_over else step
        place = place + v * last - [0, 0, G * last**2 / 2]
        v = v - [0, 0, G * last]
        t += last
        if is_over:
            return place
        place[2] = radius
        slip = v[:2] + radius * np.array([-w[1], w[0]])
        size = np.sqrt(slip @ slip + 1e-60)
        slides = (mu * (1 + e) * -v[2]).real < 2 / 7 * size.real
        pull = -slip / size * (mu * (1 + e) * -v[2] if slides else 2 / 7 * size)
        v = np.array([*(v[:2] + pull), -e * v[2]])
        w = w + np.cross([0, 0, -radius], [*pull, 0]) / (0.4 * radius**2)


@pytest.mark.parametrize("mu", [0.04, 0.3])
def test_impacts_stick_or_slide_in_the_direction_of_the_slip_after_them(mu):
    velocity, spin, e = (1.2, -0.8), (14.0, 9.0, -20.0), 0.8
    model = sphere(velocity, spin, 0.6, e, mu).compile(["mu", "e"])
    result = model.simulate((0, 1.9), **TIGHT)
    names = ["b.x", "b.y", "b.z"]
    place = bounces(velocity, spin, 1.9, mu, e)
    np.testing.assert_allclose([result[name][-1] for name in names], place.real, atol=1e-10)
    for parameter, exact in {
        "mu": bounces(velocity, spin, 1.9, mu + 1e-30j, e),
        "e": bounces(velocity, spin, 1.9, mu, e + 1e-30j),
    }.items():
        found = [result.sensitivity(name, parameter)[-1] for name in names]
        np.testing.assert_allclose(found, exact.imag / 1e-30, atol=1e-9)


#: Time from the beginning of a slip, which grows with its square, to the start of a reference.
TAU = 1e-3

#: Points of a quadrature from 0 to 1, with equal weights.
GAUSS = (0.5 - np.sqrt(1 / 12), 0.5 + np.sqrt(1 / 12))


def slid(pull, slip, mu, first, end):
    """Return the place at the end of a puck that slides, from the state (t, place, velocity).

    At first it is integrated over s with dt = |slip| ds, since the equations over t are stiff. The
    imaginary parts, 1e-30 times a derivative, are integrated with their own errors.
    """

    def rates(z, is_slow):
        own = slip(z[0], z[1:3], z[3:])
        speed = np.sqrt(own @ own)
        rate = np.concatenate([[1], z[3:], pull(z[0]) - mu * G * own / speed])
        return rate * speed if is_slow else rate

    def run(z, span, is_slow):
        def split(_, y):
            rate = rates(y[:5] + 1e-30j * y[5:], is_slow)
            return np.concatenate([rate.real, rate.imag / 1e-30])

        y = np.concatenate([z.real, z.imag / 1e-30])
        y = solve_ivp(split, (0, span), y, "DOP853", rtol=1e-12, atol=1e-15).y[:, -1]
        return y[:5] + 1e-30j * y[5:]

    size = np.linalg.norm(slip(first[0], first[1:3], first[3:]).real)
    # The slip grows as c t^2/2, so that s is 2/c (1/TAU - 1/t).
    z = run(first, 0.98 * TAU / size, is_slow=True)
    z = z - rates(z, is_slow=False) * 1j * z[0].imag
    return run(z, end - z[0].real, is_slow=False)[1:3]


#: Largest errors in integrations at 1e-10; cvode errs by some hundred tolerances.
PUCKS = [("dop853", 1e-9), ("rodas5", 1e-9), ("cvode", 1e-7)]


@pytest.mark.parametrize(("method", "close"), PUCKS)
def test_a_puck_breaks_away_in_the_direction_of_the_force_and_follows_a_curve(method, close):
    mu, mass, rate, turn, end = 0.3, 0.5, 3.0, 3.0, 1.2
    scene = cotree.Scene("puck", gravity=[0, 0, -G])
    scene.parameter("mu", mu)
    scene.edge("b", "rigid_body", "ground", "P", mass=mass, inertia=[0.01, 0.01, 0.01])
    scene.edge("c", "rigid_contact", "ground", "P", normal=[0, 0, 1], friction="mu")
    force = [f"{rate}*t*cos({turn}*t)", f"{rate}*t*sin({turn}*t)", "0"]
    scene.edge("push", "force", "ground", "P", force=force)

    def pull(t):
        return rate * t / mass * np.array([np.cos(turn * t), np.sin(turn * t)])

    def place(mu):
        start = mu * mass * G / rate
        way = pull(start + TAU) * mass / (rate * (start + TAU))
        speed = rate / mass * TAU**2 / 2
        first = np.array([start + TAU, *(speed * TAU / 3 * way), *(speed * way)], complex)
        return slid(pull, lambda t, x, v: v, mu, first, end)

    result = scene.compile(["mu"]).simulate((0, end), method=method, rtol=1e-10, atol=1e-13)
    found = [result["b.x"][-1], result["b.y"][-1]]
    np.testing.assert_allclose(found, place(mu).real, atol=close)
    found = [result.sensitivity(name, "mu")[-1] for name in ("b.x", "b.y")]
    np.testing.assert_allclose(found, place(mu + 1e-30j).imag / 1e-30, atol=close)


@functools.cache
def on_table(mu, rate, end, radius=0.5):
    """Return the place of a puck on a table that turns ever faster: it sticks, then slides."""
    start = np.sqrt(np.sqrt((mu * G / (radius * rate)) ** 2 - 1) / rate)
    t = start + TAU
    turn, speed = rate * t**2 / 2, rate * t
    c, s = np.cos(turn), np.sin(turn)
    pull = radius * np.array([-rate * s - speed**2 * c, rate * c - speed**2 * s])
    size = np.sqrt(pull @ pull)
    # The first slip is against the force that the table would need, and grows by its excess over
    # the friction: by a quadrature of two points, which is exact to order TAU^4.
    need = [radius * np.sqrt(rate**2 + (rate * (start + TAU * x)) ** 4) for x in GAUSS]
    slip = -TAU * (sum(need) / 2 - mu * G) * pull / size
    v = speed * radius * np.array([-s, c]) + slip
    first = np.array([t, *(radius * np.array([c, s]) + slip * TAU / 3), *v], complex)

    def relative(t, x, v):
        return v - rate * t * np.array([-x[1], x[0]])

    return slid(lambda t: np.zeros(2), relative, mu, first, end)


@functools.cache
def turntable(mu, rate):
    """Return the model of a puck on a turning table."""
    scene = cotree.Scene("turntable", gravity=[0, 0, -G])
    scene.parameter("mu", mu)
    scene.parameter("a", rate)
    scene.edge("h", "revolute", "ground", "T", axis=[0, 0, 1], motion="a*t**2/2")
    scene.edge("b", "rigid_body", "ground", "P", mass=0.7, inertia=[0.01, 0.01, 0.01],
               initial={"x": 0.5})  # fmt: skip
    scene.edge("c", "rigid_contact", "T", "P", normal=[0, 0, 1], friction="mu")
    return scene.compile(["mu", "a"])


@pytest.mark.parametrize(("method", "close"), PUCKS)
def test_a_puck_sticks_to_a_turning_table_and_slides_off(method, close):
    mu, rate, end = 0.3, 2.0, 2.0
    result = turntable(mu, rate).simulate((0, end), method=method, rtol=1e-10, atol=1e-13)
    names = ["b.x", "b.y"]
    places = [result[name][-1] for name in names]
    for name, (by_mu, by_rate) in {"mu": (1e-30j, 0.0), "a": (0.0, 1e-30j)}.items():
        exact = on_table(mu + by_mu, rate + by_rate, end)
        np.testing.assert_allclose(places, exact.real, rtol=close, atol=close)
        found = [result.sensitivity(place, name)[-1] for place in names]
        np.testing.assert_allclose(found, exact.imag / 1e-30, rtol=close, atol=close)


COIN = {"m": 0.5, "R": 0.1, "tilt": 0.3}
#: Inertia of a thin disc about its diameters and its axis.
ROUND = COIN["m"] * COIN["R"] ** 2 * np.array([0.25, 0.25, 0.5])


def turned(q):
    """Return the rotation matrix of a unit quaternion."""
    w, v = q[0], np.asarray(q[1:])
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def rim(q, w):
    """Return axes of a disc, the vector from its centre to its lowest point, and its rate."""
    axes = turned(np.asarray(q) / np.sqrt(q @ q))
    n, up = axes[:, 2], np.array([0, 0, 1.0])
    dn = np.cross(w, n)
    u, du = up - n[2] * n, -dn[2] * n - n[2] * dn
    size = np.sqrt(u @ u)
    return axes, -COIN["R"] * u / size, -COIN["R"] * (du / size - u * (u @ du) / size**3)


def coin_rates(_, z):
    """Return the rates of place, quaternion and angular velocity of a disc that rolls."""
    q, w, m = z[3:7], z[7:], COIN["m"]
    axes, r, dr = rim(q, w)
    inertia = axes @ np.diag(ROUND) @ axes.T
    cross = np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])
    # The acceleration of the centre is r x w' - w x r', and the force m (a + g) acts at r.
    force = m * np.cross(r, np.array([0, 0, G]) - np.cross(w, dr))
    dw = np.linalg.solve(inertia - m * cross @ cross, force - np.cross(w, inertia @ w))
    dq = 0.5 * np.array([-w @ q[1:], *(q[0] * w + np.cross(w, q[1:]))])
    return [*-np.cross(w, r), *dq, *dw]


def coin_start(spin):
    """Return place, quaternion, velocity and angular velocity of a tilted disc that rolls."""
    half = (COIN["tilt"] - np.pi / 2) / 2
    q = np.array([np.cos(half), np.sin(half), 0, 0])
    own = np.array([0.2, 1.0, spin])
    w = turned(q) @ own
    r = rim(q, w)[1]
    return -r, q, -np.cross(w, r), w, own


#: Velocity of the contact point of a disc that slides.
SLIDE = np.array([1.5, -1.0, 0.0])


def sliding_rates(mu):
    """Return the rates of place, quaternion, velocity and angular velocity of a disc that slides.

    The contact force is N f with f = n - mu u/|u| and the slip u, where N keeps the speed of the
    contact point along the normal n at zero.
    """
    up = np.array([0, 0, 1.0])

    def rates(_, z):
        q, v, w, m = z[3:7], z[7:10], z[10:], COIN["m"]
        axes, r, dr = rim(q, w)
        inertia = axes @ np.diag(ROUND) @ axes.T
        slip = v + np.cross(w, r)
        f = up - mu * slip / np.sqrt(slip @ slip)
        turn = np.linalg.solve(inertia, np.cross(r, f))
        free = -np.linalg.solve(inertia, np.cross(w, inertia @ w))
        fall = G - (np.cross(free, r) + np.cross(w, dr)) @ up
        force = fall / (f[2] / m + np.cross(turn, r)[2])
        dq = 0.5 * np.array([-w @ q[1:], *(q[0] * w + np.cross(w, q[1:]))])
        return [*v, *dq, *(force / m * f - G * up), *(free + force * turn)]

    return rates


@functools.cache
def coin():
    """Compile a tilted disc on a plane, which rolls at first if slide is 0."""
    scene = cotree.Scene("coin", gravity=[0, 0, -G])
    values = {"spin": 8.0, "mu": 0.9, "slide": 0.0}
    for name, value in values.items():
        scene.parameter(name, value)
    x, q, v, _, own = coin_start(values["spin"])
    slope = coin_start(values["spin"] + 1)[2] - v  # the speed of the centre is linear in the spin
    names = ("x", "y", "z", "q0", "q1", "q2", "q3", "w1", "w2")
    initial = dict(zip(names, map(float, (*x, *q, *own[:2])), strict=True)) | {"w3": "spin"}
    for name, *row in zip(("vx", "vy", "vz"), v, slope, SLIDE, strict=True):
        at, by, more = map(float, row)
        initial[name] = f"{at!r} + ({by!r})*(spin - {values['spin']}) + ({more!r})*slide"
    scene.edge("b", "rigid_body", "ground", "P", mass=COIN["m"], inertia=list(map(float, ROUND)),
               initial=initial)  # fmt: skip
    scene.edge("c", "rigid_contact", "ground", "P", normal=[0, 0, 1], radius=COIN["R"],
               axis=[0, 0, 1], friction="mu")  # fmt: skip
    return scene.compile(list(values))


def rolled(spin, end):
    """Return the place of a disc that rolls."""
    x, q, _, w, _ = coin_start(spin)
    start = np.array([*x, *q, *w], complex)
    return solve_ivp(coin_rates, (0, end), start, "DOP853", rtol=1e-12, atol=1e-14).y[:3, -1]


def slipped(spin, mu, slide, end):
    """Return the place of a disc that slides."""
    x, q, v, w, _ = coin_start(spin)
    start = np.array([*x, *q, *(v + slide * SLIDE), *w], complex)
    run = solve_ivp(sliding_rates(mu), (0, end), start, "DOP853", rtol=1e-12, atol=1e-14)
    return run.y[:3, -1]


@pytest.mark.parametrize("method", ["dop853", "rodas5"])
def test_a_coin_that_rolls_on_its_rim_pivots_without_resistance(method):
    result = coin().simulate((0, 1.5), method=method, **TIGHT)
    assert not any(row.t.size for row in result.events.values())
    places = ("b.x", "b.y", "b.z")
    # Global errors of a run at 1e-10, over some hundred steps.
    found = [result[name][-1] for name in places]
    np.testing.assert_allclose(found, rolled(8.0, 1.5).real, atol=1e-9)
    found = [result.sensitivity(name, "spin")[-1] for name in places]
    np.testing.assert_allclose(found, rolled(8.0 + 1e-30j, 1.5).imag / 1e-30, atol=1e-9)


@pytest.mark.parametrize("method", ["dop853", "rodas5"])
def test_a_coin_slides_on_its_rim_and_pivots(method):
    given = {"spin": 3.0, "mu": 0.1, "slide": 1.0}
    result = coin().simulate((0, 0.3), method=method, parameters=given, **TIGHT)
    assert [result[f"c.{name}.mode"][-1] for name in ("normal", "slide1")] == [-1.0, 1.0]
    places = ("b.x", "b.y", "b.z")
    found = [result[name][-1] for name in places]
    np.testing.assert_allclose(found, slipped(**given, end=0.3).real, atol=1e-9)
    for name, value in given.items():
        slope = slipped(**{**given, name: value + 1e-30j}, end=0.3).imag / 1e-30
        found = [result.sensitivity(place, name)[-1] for place in places]
        np.testing.assert_allclose(found, slope, atol=1e-9)


def tipping(is_flat):
    """Slide a tall box, whose friction tips it over its front edge; in the plane, or in space."""
    a, b, h, mass = 0.2, 0.3, 0.8, 2.0
    up = 1 if is_flat else 2
    down = [0.0] * 3
    down[up] = -h / 2
    normal = [float(i == up) for i in range(3)]
    scene = cotree.Scene("tips", gravity=[-G * n for n in normal])
    scene.parameter("mu", 0.5)
    scene.parameter("v", 1.5)
    inertia = [
        mass / 12 * (b * b + h * h),
        mass / 12 * (a * a + h * h),
        mass / 12 * (a * a + b * b),
    ]
    initial = {"y": h / 2, "x_dot": "v"} if is_flat else {"z": h / 2, "vx": "v"}
    scene.edge("b", "rigid_body", "ground", "P", mass=mass,
               inertia=inertia[1] if is_flat else inertia, initial=initial)  # fmt: skip
    scene.edge("foot", "arm", "P", "B", vector=down)
    own = {"normal": normal, "friction": "mu"}
    if not is_flat:
        scene.edge("c", "rigid_contact", "ground", "B", size=[a, b, 0], **own)
    for side in (-1, 1) if is_flat else ():
        end = "front" if side > 0 else "back"
        scene.edge(f"to_{end}", "arm", "B", end, vector=[side * a / 2, 0, 0])
        scene.edge(f"c_{end}", "rigid_contact", "ground", end, **own)
    model = scene.compile(["mu", "v"])
    result = model.simulate((0, 0.6), rtol=1e-11, atol=1e-13)
    assert result.success, result.message
    names = ["b.x", "b.y" if is_flat else "b.z"]
    slopes = [result.sensitivity(name, by)[-1] for name in names for by in ("mu", "v")]
    return [result[name][-1] for name in names], slopes


@pytest.mark.slow
def test_a_box_slides_tips_and_falls_in_space_as_in_the_plane():
    (place, slopes), (flat, flat_slopes) = tipping(False), tipping(True)
    np.testing.assert_allclose(place, flat, atol=1e-9)
    np.testing.assert_allclose(slopes, flat_slopes, atol=1e-9)


def plate(spin, velocity=(1.0, 0.5), mu=0.3):
    """Lay a plate on a plane, which it touches with its four corners."""
    scene = cotree.Scene("plate", gravity=[0, 0, -G])
    scene.parameter("mu", mu)
    a, b, mass = 0.3, 0.2, 2.0
    inertia = [mass / 12 * b * b, mass / 12 * a * a, mass / 12 * (a * a + b * b)]
    initial = {"vx": velocity[0], "vy": velocity[1], "w3": spin}
    scene.edge("b", "rigid_body", "ground", "P", mass=mass, inertia=inertia, initial=initial)
    scene.edge("c", "rigid_contact", "ground", "P", normal=[0, 0, 1], size=[a, b, 0], friction="mu")
    scene.output("E", f"{mass}*(b.vx**2 + b.vy**2)/2 + {inertia[2]}*b.w3**2/2")
    return scene


@pytest.mark.slow
def test_a_plate_slides_on_four_corners_to_rest():
    result = plate(0.0).compile(["mu"]).simulate((0, 1), rtol=1e-9, atol=1e-11)
    assert result.success, result.message
    speed = hypot(1.0, 0.5)
    way = np.array([1.0, 0.5]) / speed * speed**2 / (2 * 0.3 * G)
    np.testing.assert_allclose([result["b.x"][-1], result["b.y"][-1]], way, rtol=1e-9)
    found = [result.sensitivity(name, "mu")[-1] for name in ("b.x", "b.y")]
    np.testing.assert_allclose(found, -way / 0.3, rtol=1e-8)


@pytest.mark.slow
def test_sliding_and_spinning_of_a_plate_end_together():
    """All slips vanish at one time, also if a body slides and spins at first."""
    result = plate(4.0).compile().simulate((0, 1), rtol=1e-9, atol=1e-11)
    assert result.success, result.message
    assert [result[f"c.slide1_{i}.mode"][-1] for i in (1, 2, 3, 4)] == [0.0] * 4
    assert np.max(np.diff(result["E"])) <= 1e-12
    # At rest, to the tolerance.
    assert result["E"][-1] <= 1e-16
