"""Boxes, discs and cylinders on balls: faces, edges, corners and rims, against own equations."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import cotree

G = 9.81
R, MASS, INERTIA = 0.5, 1.5, np.array([0.020, 0.028, 0.036])
#: Mass and moment of inertia of a moving ball.
BALL, MOMENT = 4.0, 0.4
ROLLS = 10.0  # a coefficient of friction at which these bodies do not slip


def cross(a, b):
    """Return the cross products of columns; NumPy's takes five times as long for so few."""
    return a[[1, 2, 0]] * b[[2, 0, 1]] - a[[2, 0, 1]] * b[[1, 2, 0]]


def dot(a, b):
    """Return the scalar products of columns, without conjugates."""
    return (a * b).sum(axis=0)


def nearest(shape, c, c_rate, region):
    """Return the points of a body nearest to the ball's centres c, and their rates."""
    if "size" in shape:
        half, is_out = 0.5 * np.array(shape["size"])[:, None], np.array(region)[:, None]
        return np.where(is_out, half * np.sign(c.real), c), np.where(is_out, 0.0, c_rate)
    flat, up = np.array([[1.0], [1.0], [0.0]]), np.array([[0.0], [0.0], [1.0]])
    out, out_rate = c * flat, c_rate * flat
    if region[0]:
        rho = np.sqrt(dot(out, out))
        out_rate = shape["radius"] * (out_rate / rho - out * dot(out, out_rate) / rho**3)
        out = shape["radius"] * out / rho
    length = shape.get("length", 0.0)
    if length and region[1]:
        out = out + up * 0.5 * length * np.sign(c.real)
    elif length:
        out, out_rate = out + c * up, out_rate + c_rate * up
    return out, out_rate


def beyond(shape, c):
    """Return the functions whose signs determine the region."""
    if "size" in shape:
        return c**2 - 0.25 * np.array(shape["size"])[:, None] ** 2
    ends = [c[2] ** 2 - 0.25 * shape["length"] ** 2] if "length" in shape else []
    return np.array([c[0] ** 2 + c[1] ** 2 - shape["radius"] ** 2, *ends])


def rates(shape, region, mu, big, moves, z):
    """Return the rates of bodies on balls, in axes of the bodies; if mu is ROLLS, none slips.

    ``z`` has a column for each body: its spin and velocity, the centre of the ball, the downward
    direction, the velocity and spin of the ball.
    """
    w, u, c, down, ball_u, ball_w = z.reshape(6, 3, -1)
    c_rate = ball_u - u - cross(w, c)
    p, p_rate = nearest(shape, c, c_rate, region)
    arm, arm_rate = p - c, p_rate - c_rate
    v = u + cross(w, p) - ball_u - cross(ball_w, arm)
    inertia = INERTIA[:, None]

    def motion(force):
        """Return the accelerations, and the rate of v in these axes."""
        turn = (cross(p, force) - cross(w, inertia * w)) / inertia
        rate = force / MASS + G * down - cross(w, u)
        # A force holds up the moving ball and the body together.
        ball = (G * down - force / BALL - (MASS + BALL) / BALL * G * down) * moves
        ball_turn = -cross(arm, force) / MOMENT * moves
        ball, ball_turn = ball - cross(w, ball_u), ball_turn - cross(w, ball_w)
        slip = rate + cross(turn, p) + cross(w, p_rate) - ball
        slip = slip - cross(ball_turn, arm) - cross(ball_w, arm_rate)
        return (turn, rate, c_rate, -cross(w, down), ball, ball_turn), slip

    free = motion(np.zeros_like(c))[1]
    if mu is ROLLS:
        by_force = [motion(np.tile(e[:, None], c.shape[1]))[1] - free for e in np.eye(3)]
        # Axes: body, component of the rate of v, component of the force.
        force = np.linalg.solve(np.transpose(by_force, (2, 1, 0)), -free.T[:, :, None])[:, :, 0].T
    else:
        n = arm / big
        across = v - dot(n, v) * n
        way = n - mu * across / np.sqrt(dot(across, across)) if np.any(mu) else n
        # The rate of n.v vanishes.
        force = -(dot(n, free) + dot(arm_rate, v) / big) / dot(n, motion(way)[1] - free) * way
    return np.concatenate(motion(force)[0])


def reference(shape, mu, big, moves, z, end):
    """Integrate columns from region to region; times of the borders have their complex steps.

    All columns have the same real part, so that they cross the borders together.
    """
    t, passed = np.zeros(z.shape[1], complex), []
    region = [x[0].real >= 0 for x in beyond(shape, z[6:9])]
    while True:
        passed.append(tuple(map(int, region)))
        share = (end - t) / (end - t).real

        def along(_, z, share=share):
            columns = z.reshape(18, -1)
            return (share * rates(shape, region, mu, big, moves, columns)).ravel()

        borders = []
        for i, is_out in enumerate(region):
            borders.append(lambda _, z, i=i: beyond(shape, z.reshape(18, -1)[6:9, :1])[i, 0].real)
            borders[i].terminal, borders[i].direction = True, -1 if is_out else 1
        settings = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14, "events": borders}
        run = solve_ivp(along, (0, (end - t[0]).real), z.ravel(), **settings)
        z, t = run.y[:, -1].reshape(18, -1), t + share * run.t[-1]
        if run.status == 0:
            return z, passed
        i = next(i for i, hits in enumerate(run.t_events) if len(hits))
        slope, h = rates(shape, region, mu, big, moves, z), 1e-30
        crossing = beyond(shape, z[6:9].real + 1j * h * slope[6:9].real)[i].imag / h
        late = -1j * beyond(shape, z[6:9])[i].imag / crossing
        z, t = z + late * slope, t + late
        region[i] = not region[i]


def turned(angles):
    """Return the matrix of roll, pitch and yaw."""
    (a, b, c), (x, y, z) = np.cos(angles), np.sin(angles)
    about_x = np.array([[1, 0, 0], [0, a, -x], [0, x, a]])
    about_y = np.array([[b, 0, y], [0, 1, 0], [-y, 0, b]])
    return np.array([[c, -z, 0], [z, c, 0], [0, 0, 1]]) @ about_y @ about_x


def linear(offset, slopes):
    """Return an expression of parameters."""
    return " + ".join([f"({offset!r})", *(f"({s!r})*{name}" for name, s in slopes.items())])


class Case:
    """A body that touches a ball with a given point ``at``; ``out`` points to the ball's centre."""

    def __init__(self, shape, mu, angles, at, out, spin, slide, end, moves=False):
        self.shape, self.mu, self.angles, self.end, self.moves = shape, mu, angles, end, moves
        self.turn, self.at = turned(angles), np.array(at, dtype=float)
        self.out = np.array(out) / np.sqrt(np.array(out) @ out)
        self.slide = np.array(slide) - (np.array(slide) @ self.out) * self.out
        self.values = {"R": R, "wx": spin[0], "wy": spin[1], "wz": spin[2]}
        if mu not in (0, ROLLS):
            self.values["mu"] = mu

    def scene(self):
        scene = cotree.Scene("on-a-ball", gravity=[0, 0, -G])
        for name, value in self.values.items():
            scene.parameter(name, value)
        place, along = -self.turn @ self.at, -self.turn @ self.out
        spins = [self.turn @ -np.cross(e, self.at) for e in np.eye(3)]
        fast = self.turn @ self.slide
        first = {"rotation": list(self.angles), "w1": "wx", "w2": "wy", "w3": "wz"}
        for i, x in enumerate("xyz"):
            first[x] = linear(float(place[i]), {"R": float(along[i])})
            own = {f"w{e}": float(s[i]) for e, s in zip("xyz", spins, strict=True)}
            first[f"v{x}"] = linear(float(fast[i]), own)
        body = {"mass": MASS, "inertia": INERTIA.tolist(), "initial": first}
        scene.edge("b", "rigid_body", "ground", "P", **body)
        node = "ground"
        if self.moves:
            scene.edge("B", "rigid_body", "ground", "Q", mass=BALL, inertia=[MOMENT] * 3)
            scene.edge("up", "force", "ground", "Q", force=[0, 0, (MASS + BALL) * G])
            node = "Q"
        own = dict(self.shape)
        if "radius" in own:
            own["axis"] = [0, 0, 1]
        if self.mu:
            own["friction"] = "mu" if "mu" in self.values else self.mu
        scene.edge("c", "rigid_contact", node, "P", ball="R", **own)
        scene.output("energy", "energy.kinetic + energy.potential")
        scene.output("gap", "c.normal.s")
        scene.output("force", "c.force")
        for i in "123":
            scene.output(f"down{i}", f"-P.r3{i}")
        return scene

    def exact(self):
        """Return spin and downward direction at the end, their slopes, and the regions passed.

        There is a column for each parameter, with a complex step of that parameter.
        """
        step = 1e-30
        columns = np.array(list(self.values.values()))[:, None] + 1j * step * np.eye(
            len(self.values)
        )
        values = dict(zip(self.values, columns, strict=True))
        big, spin, out = values["R"], np.array([values[f"w{i}"] for i in "xyz"]), self.out[:, None]
        at = np.tile(self.at[:, None], len(columns))
        first = [spin, self.slide[:, None] - cross(spin, at), at + big * out]
        first += [np.tile(self.turn.T[:, 2:] * -1.0, len(columns)), np.zeros((6, len(columns)))]
        mu = values.get("mu", self.mu)
        z, passed = reference(self.shape, mu, big, self.moves, np.concatenate(first), self.end)
        found = np.concatenate([z[:3], z[9:12]])
        slopes = dict(zip(self.values, found.imag.T / step, strict=True))
        return found[:, 0].real, slopes, passed


DISC, CYLINDER = {"radius": 0.2}, {"radius": 0.2, "length": 0.3}
BOX, PLATE, ROD = ({"size": list(row)} for row in ((0.4, 0.3, 0.2), (0.4, 0.3, 0), (0.4, 0, 0)))
LYING, UPRIGHT, TILTED = (0.05, 0.03, 0.2), (1.5, 0.03, 0.2), (0.6, 0.6, 0.2)
DOWN, REST = (0, 0, -1), (0, 0, 0)
#: A coin that slides on its rim; a box that rolls over an edge, on a fixed and a moving ball; a
#: cylinder that rolls over its rim.
CASES = {
    "coin": Case(DISC, 0.2, UPRIGHT, (0, -0.2, 0), (0, -1, -0.2), (0.5, 1, 6), (0.5, 0, 0.3), 0.3),
    "box": Case(BOX, ROLLS, LYING, (0.12, 0.03, -0.1), DOWN, (1.5, -2.8, 1), REST, 0.5),
    "cylinder": Case(CYLINDER, ROLLS, UPRIGHT, (0, -0.2, 0.1), (0, -1, 0), (1.5, 1, 1), REST, 0.5),
    "box on a moving ball": Case(
        BOX, ROLLS, LYING, (0.12, 0.03, -0.1), DOWN, (2.5, -4, 1), REST, 0.4, moves=True
    ),
}
MORE = {
    "rolling coin": Case(DISC, ROLLS, UPRIGHT, (0, -0.2, 0), (0, -1, -0.2), (0.5, 1, 6), REST, 0.4),
    "lying coin": Case(DISC, ROLLS, LYING, (0.15, 0.03, 0), DOWN, (0.5, -3.5, 1), REST, 0.4),
    "slick box": Case(
        BOX, 0, LYING, (0.12, 0.03, -0.1), DOWN, (1.5, -1.8, 1), (-0.3, 0.2, 0), 0.42
    ),
    "corner": Case(
        BOX, ROLLS, TILTED, (0.2, -0.15, -0.1), (0.5, -0.5, -0.7), (0.5, -0.8, 3), REST, 0.25
    ),
    "plate": Case(PLATE, ROLLS, LYING, (0.12, 0.03, 0), DOWN, (1.5, -3.5, 1), REST, 0.4),
    "rod": Case(ROD, ROLLS, LYING, (0.12, 0, 0), DOWN, (1.5, -3.5, 1), REST, 0.4),
    "standing cylinder": Case(
        CYLINDER, ROLLS, LYING, (0.15, 0, -0.15), DOWN, (1.5, -2.8, 1), REST, 0.4
    ),
    "cylinder on a moving ball": Case(
        CYLINDER,
        0,
        UPRIGHT,
        (0, -0.2, 0.1),
        (0, -1, 0),
        (1.5, 1, 1),
        (0.3, 0, 0.4),
        0.5,
        moves=True,
    ),
    "coin on a moving ball": Case(
        DISC, 0.2, UPRIGHT, (0, -0.2, 0), (0, -1, -0.2), (0.5, 1, 6), (0.5, 0, 0.3), 0.3, moves=True
    ),
}
NAMES = [*CASES, *(pytest.param(name, marks=pytest.mark.slow) for name in MORE)]


@pytest.mark.parametrize("name", NAMES)
def test_bodies_on_balls_move_by_their_equations(name):
    case = {**CASES, **MORE}[name]
    model = case.scene().compile(list(case.values), optimize="-O0")
    exact, slopes, passed = case.exact()
    states = ["b.w1", "b.w2", "b.w3", "down1", "down2", "down3"]
    for method in ("dopri5", "rodas5"):
        result = model.simulate((0, case.end), method=method, rtol=1e-11, atol=1e-13)
        assert result["force"].min() > 0
        crossed = [n for n, row in result.events.items() if "beyond" in n for _ in row.t]
        assert len(crossed) == len(passed) - 1
        found = [result[state][-1] for state in states]
        np.testing.assert_allclose(found, exact, rtol=0, atol=1e-9)
        for parameter, slope in slopes.items():
            found = [result.sensitivity(state, parameter)[-1] for state in states]
            # Relative to slopes of up to a hundred.
            np.testing.assert_allclose(found, slope, rtol=1e-9, atol=1e-9)
    result = model.simulate((0, case.end), rtol=1e-10)
    if case.mu in (0, ROLLS) and not case.moves:
        np.testing.assert_allclose(result["energy"], result["energy"][0], rtol=1e-9)
    assert np.abs(result["gap"]).max() <= 1e-10


#: A block of the height H and the length L on a fixed cylinder of the radius R.
BLOCK = {"R": 0.2, "H": 0.6, "L": 0.16, "m": 2.0, "a": 0.1, "w": 0.5}


def block(**values):
    """Build a block that has rolled on a cylinder by the angle a, at the rate w."""
    scene = cotree.Scene("block", gravity=[0, -G, 0])
    for name, value in {**BLOCK, **values}.items():
        scene.parameter(name, value)
    first = {
        "x": "(R + H/2)*sin(a) - R*a*cos(a)",
        "y": "(R + H/2)*cos(a) + R*a*sin(a)",
        "theta": "-a",
        "x_dot": "w*(H/2*cos(a) + R*a*sin(a))",
        "y_dot": "w*(R*a*cos(a) - H/2*sin(a))",
        "theta_dot": "-w",
    }
    inertia = "m*(L**2 + H**2)/12"
    scene.edge("b", "rigid_body", "ground", "P", mass="m", inertia=inertia, initial=first)
    scene.edge("c", "rigid_contact", "ground", "P", ball="R", size=["L", "H", 0], friction=5.0)
    return scene


def time_of_fall(R, H, L, m, a, w, end):
    """Return the time at which the block has turned by ``end``.

    It rolls, with T = (J + m (h^2 + R^2 q^2)) q'^2/2 and h = H/2, until its edge touches at R q =
    L/2, and then turns about that edge, which sticks.
    """
    h, inertia, g = H / 2, m * (L**2 + H**2) / 12, mp.mpf(G)

    def rolling(q):
        return inertia + m * (h**2 + (R * q) ** 2), (R + h) * mp.cos(q) + R * q * mp.sin(q)

    def turning(q):
        height = R * mp.cos(L / 2 / R) + h * mp.cos(q) + L / 2 * mp.sin(q)
        return inertia + m * (h**2 + L**2 / 4), height

    own, height = rolling(a)
    energy = own * w**2 / 2 + m * g * height

    def slowness(part, q):
        own, height = part(q)
        return mp.sqrt(own / 2 / (energy - m * g * height))

    edge = L / 2 / R
    return mp.quad(lambda q: slowness(rolling, q), [a, edge]) + mp.quad(
        lambda q: slowness(turning, q), [edge, end]
    )


@pytest.mark.parametrize("method", ["dopri5", "rodas5"])
def test_a_block_rolls_on_a_cylinder_to_its_edge_and_turns_about_it(method):
    scene = block()
    scene.event("turned", "b.theta + 1", direction=-1)
    names = list(BLOCK)
    result = scene.compile(names).simulate((0, 0.69), method=method, rtol=1e-11, atol=1e-13)
    with mp.workdps(25):
        given = {name: mp.mpf(value) for name, value in BLOCK.items()}
        assert abs(result.events["turned"].t[0] - float(time_of_fall(**given, end=1))) <= 1e-10
        for name, value in given.items():
            slope = mp.diff(lambda v, n=name: time_of_fall(**{**given, n: v}, end=1), value, h=1e-9)
            assert abs(result.event_sensitivity("turned", name)[0] - float(slope)) <= 1e-9


def test_a_block_rocks_on_a_cylinder_whose_radius_exceeds_half_its_height():
    """Small oscillations have the period 2 pi sqrt((J + m h^2)/(m g (R - h))) for h < R."""
    inertia = 2.0 * (0.6**2 + 0.2**2) / 12
    for R, is_stable in ((0.11, True), (0.09, False)):
        scene = block(R=R, H=0.2, L=0.6, a=1e-4, w=0.0)
        scene.output("energy", "energy.kinetic + energy.potential")
        scene.event("through", "b.theta", direction=1)
        result = scene.compile().simulate((0, 10), method="dop853", rtol=1e-10, atol=1e-13)
        np.testing.assert_allclose(result["energy"], result["energy"][0], rtol=1e-9)
        assert bool(np.abs(result["b.theta"]).max() <= 1.0001e-4) is is_stable
        if is_stable:
            period = 2 * np.pi * np.sqrt((inertia + 2.0 * 0.1**2) / (2.0 * G * (R - 0.1)))
            # The period depends on the amplitude by its square.
            assert np.diff(result.events["through"].t)[0] == pytest.approx(period, rel=1e-5)


def test_a_ball_rolls_over_the_edge_of_a_fixed_box():
    """The second node may be fixed; the box is that of the equations for display, too."""
    scene = cotree.Scene("box", gravity=[0, -G, 0])
    first = {"x": 0.15, "y": 0.6, "x_dot": 0.5, "theta_dot": -1.0}
    scene.edge("b", "rigid_body", "ground", "P", mass=2.0, inertia=0.2, initial=first)
    shapes = {"ball": R, "size": [0.4, 0.2, 0]}
    scene.edge("c", "rigid_contact", "P", "ground", **shapes, friction=ROLLS)
    scene.output("energy", "energy.kinetic + energy.potential")
    assert "Piecewise" in str(scene.equations())
    result = scene.compile().simulate((0, 0.4), rtol=1e-10)
    assert result.events["c.beyond_x >= 0 up"].t == pytest.approx([0.1], abs=1e-10)
    # It turns about the edge, with (2/5 + 1) m r^2 w'^2/2 - m g r cos(q).
    np.testing.assert_allclose(result["energy"], result["energy"][0], rtol=1e-9)
    angle, rate = np.arcsin((result["b.x"][-1] - 0.2) / R), -result["b.theta_dot"][-1]
    assert rate**2 == pytest.approx(1 + 2 * G / R * (1 - np.cos(angle)) / 1.4, abs=1e-9)
