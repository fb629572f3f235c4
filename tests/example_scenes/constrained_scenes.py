"""Small constrained systems whose accelerations are known in closed form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cotree import Scene

if TYPE_CHECKING:
    from collections.abc import Callable

G = 9.81


@dataclass(frozen=True)
class Constrained:
    """A scene with a closed state and its accelerations there.

    Attributes
    ----------
    scene : Scene
        The system.
    branches : list of str
        Its tree.
    t : float
        The time.
    state : dict of str to float
        The state at that time; what is absent is zero.
    accelerations : dict of str to float
        Rates of some speeds.
    """

    scene: Scene
    branches: list[str]
    t: float
    state: dict[str, float]
    accelerations: dict[str, float]


def bead_on_a_turning_rod() -> Constrained:
    """The rod's angle is prescribed: s'' = angle'^2 s."""
    scene = Scene("bead")
    scene.edge("turn", "revolute", "ground", "A", axis=[0, 0, 1], motion="0.5*t + 0.3*t**2")
    scene.edge("slide", "prismatic", "A", "B", axis=[1, 0, 0])
    scene.edge("bead", "rigid_body", "ground", "B", mass=1.3, inertia=0.2)
    t, s, rate = 0.7, 0.8, 0.5 + 0.6 * 0.7
    state = {"turn.theta": 0.5 * t + 0.3 * t**2, "turn.theta_dot": rate, "slide.s": s}
    found = {"turn.theta_dot": 0.6, "slide.s_dot": rate**2 * s}
    return Constrained(scene, ["turn", "slide"], t, state | {"slide.s_dot": -0.4}, found)


def winch() -> Constrained:
    """A pendulum whose rod shortens: angle'' = -(2 L' angle' + g sin(angle)) / L."""
    scene = Scene("winch", gravity=[0, -G, 0])
    scene.edge("p", "planar", "ground", "B", normal=[0, 0, 1], initial={"y": -2.0})
    scene.edge("rod", "distance", "ground", "B", length="2 - 0.3*t")
    scene.edge("bob", "rigid_body", "ground", "B", mass=1.3, inertia=0.2)
    t, angle, rate, shortening = 0.5, 0.6, 1.1, -0.3
    length = 2 - 0.3 * t
    bend = -(2 * shortening * rate + G * np.sin(angle)) / length
    out, round_ = (
        np.array([np.sin(angle), -np.cos(angle)]),
        np.array([np.cos(angle), np.sin(angle)]),
    )
    place, speed = length * out, shortening * out + length * rate * round_
    pull = (2 * shortening * rate + length * bend) * round_ - length * rate**2 * out
    state = {"p.x": place[0], "p.y": place[1], "p.x_dot": speed[0], "p.y_dot": speed[1]}
    return Constrained(scene, ["p"], t, state, {"p.x_dot": pull[0], "p.y_dot": pull[1]})


def sleigh() -> Constrained:
    """Chaplygin's: v' = a w^2 and w' = -m a v w / (J + m a^2), v along the blade.

    The centre of mass is a distance a before the blade.
    """
    mass, inertia, a = 1.3, 0.4, 0.25
    scene = Scene("sleigh")
    scene.edge("p", "planar", "ground", "K", normal=[0, 0, 1])
    scene.edge("blade", "knife_edge", "ground", "K", axis=[0, 1, 0])
    scene.edge("frame", "arm", "K", "C", vector=[a, 0, 0])
    scene.edge("m", "rigid_body", "ground", "C", mass=mass, inertia=inertia)
    angle, v, w = 0.7, 1.4, -0.9
    along, across = (
        np.array([np.cos(angle), np.sin(angle)]),
        np.array([-np.sin(angle), np.cos(angle)]),
    )
    state = {"p.x": 0.3, "p.theta": angle, "p.theta_dot": w}
    state |= {"p.x_dot": v * along[0], "p.y_dot": v * along[1]}
    pull = a * w**2 * along + v * w * across
    found = {"p.x_dot": pull[0], "p.y_dot": pull[1]}
    found["p.theta_dot"] = -mass * a * v * w / (inertia + mass * a**2)
    return Constrained(scene, ["p", "frame"], 0.0, state, found)


def disc_on_a_slope() -> Constrained:
    """A disc rolls straight down: x'' = g sin(slope) / (1 + J / (m r^2))."""
    slope, radius, mass, about = 0.3, 0.4, 1.5, 0.09
    scene = Scene("disc", gravity=[G * np.sin(slope), 0, -G * np.cos(slope)])
    scene.edge("f", "free", "ground", "C")
    scene.edge(
        "road", "rolling_disc", "ground", "C", normal=[0, 0, 1], axis=[0, 1, 0], radius=radius
    )
    scene.edge("m", "rigid_body", "ground", "C", mass=mass, inertia=[0.05, about, 0.05])
    state = {"f.z": radius, "f.q0": 1.0, "f.vx": 0.8, "f.w2": 0.8 / radius}
    pull = G * np.sin(slope) / (1 + about / (mass * radius**2))
    found = {
        "f.vx": pull,
        "f.vy": 0.0,
        "f.vz": 0.0,
        "f.w1": 0.0,
        "f.w2": pull / radius,
        "f.w3": 0.0,
    }
    return Constrained(scene, ["f"], 0.0, state, found)


def disc_in_a_circle() -> Constrained:
    """A leaning disc rolls in a circle.

    With d the axle, u up within the disc and z the vertical, the disc turns by W z + s d, its
    spin is w = s + W z.d, and the centre goes at r w along d x u. The contact force m (a + g z),
    a = W z x v, acts at -r u; along d x u its moment is W z x (J3 w d + J1 W (z.u) u), so that

    w = (J1 W^2 (z.u) - m g r) (z.d) / (W (z.u) (J3 + m r^2)).
    """
    lean, turning, radius, mass, across, about = 0.35, 1.9, 0.4, 1.5, 0.05, 0.09
    scene = Scene("coin", gravity=[0, 0, -G])
    scene.edge("f", "free", "ground", "C")
    scene.edge(
        "road", "rolling_disc", "ground", "C", normal=[0, 0, 1], axis=[0, 1, 0], radius=radius
    )
    scene.edge("m", "rigid_body", "ground", "C", mass=mass, inertia=[across, about, across])
    down, up = np.sin(lean), np.cos(lean)  # z.d and z.u
    spin = (across * turning**2 * up - mass * G * radius) * down
    spin /= turning * up * (about + mass * radius**2)
    state = {"f.z": radius * up, "f.q0": np.cos(lean / 2), "f.q1": np.sin(lean / 2)}
    state |= {"f.vx": radius * spin, "f.w2": spin, "f.w3": turning * up}
    found = {"f.vx": 0.0, "f.vy": turning * spin * radius, "f.vz": 0.0}
    found |= {"f.w1": -turning * (spin - turning * down) * up, "f.w2": 0.0, "f.w3": 0.0}
    return Constrained(scene, ["f"], 0.0, state, found)


def geared_wheels() -> Constrained:
    """angle1 = ratio angle2 + phase: angle2'' = ratio torque / (J2 + ratio^2 J1)."""
    one, two, ratio, torque = 0.3, 0.8, -2.5, 1.7
    scene = Scene("gears")
    scene.edge("j1", "revolute", "ground", "A", axis=[0, 0, 1], torque=torque)
    scene.edge("j2", "revolute", "ground", "B", axis=[0, 0, 1])
    scene.edge(
        "mesh",
        "gear",
        "A",
        "B",
        coordinate1="j1.theta",
        coordinate2="j2.theta",
        ratio=ratio,
        phase=0.2,
    )
    scene.edge("m1", "rigid_body", "ground", "A", mass=1.0, inertia=one)
    scene.edge("m2", "rigid_body", "ground", "B", mass=1.0, inertia=two)
    bend = ratio * torque / (two + ratio**2 * one)
    state = {"j2.theta": 0.4, "j1.theta": ratio * 0.4 + 0.2}
    state |= {"j2.theta_dot": 0.7, "j1.theta_dot": ratio * 0.7}
    found = {"j1.theta_dot": ratio * bend, "j2.theta_dot": bend}
    return Constrained(scene, ["j1", "j2"], 0.0, state, found)


def bead_on_a_parabola() -> Constrained:
    """On y = x^2: (1 + 4 x^2) x'' + 4 x x'^2 + 2 g x = 0."""
    scene = Scene("parabola", gravity=[0, -G, 0])
    scene.edge("sx", "prismatic", "ground", "A", axis=[1, 0, 0])
    scene.edge("sy", "prismatic", "A", "B", axis=[0, 1, 0])
    scene.edge("wire", "constraint", "ground", "B", expression="B.y - sx.s**2")
    scene.edge("m", "rigid_body", "ground", "B", mass=1.2)
    x, rate = 0.6, 1.3
    bend = -(4 * x * rate**2 + 2 * G * x) / (1 + 4 * x**2)
    state = {"sx.s": x, "sy.s": x**2, "sx.s_dot": rate, "sy.s_dot": 2 * x * rate}
    found = {"sx.s_dot": bend, "sy.s_dot": 2 * x * bend + 2 * rate**2}
    return Constrained(scene, ["sx", "sy"], 0.0, state, found)


CONSTRAINED: dict[str, Callable[[], Constrained]] = {
    row.__name__: row
    for row in (
        bead_on_a_turning_rod,
        winch,
        sleigh,
        disc_on_a_slope,
        disc_in_a_circle,
        geared_wheels,
        bead_on_a_parabola,
    )
}
