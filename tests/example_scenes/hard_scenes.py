"""Scenes that are known to be hard, with what is known of their solutions.

Every function gives a scene, or the values of its outputs in closed form.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import mpmath
import numpy as np
from scipy import special

from cotree import Scene

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = np.ndarray[Any, np.dtype[np.float64]]
Values = dict[str, Array]

GRAVITY = [0, -9.81, 0]


def _with_energy(scene: Scene) -> Scene:
    scene.output("energy", "energy.kinetic + energy.potential")
    return scene


# ---- mechanisms


def double_pendulum(masses: Sequence[float] = (1.0, 1.0), angle: float = 2.0) -> Scene:
    """Two rods without mass with a bob each, released from rest in one line."""
    scene, end = Scene("double-pendulum", gravity=GRAVITY), "ground"
    for i, mass in enumerate(masses):
        initial = {"theta": angle if i == 0 else 0.0}
        scene.edge(f"h{i}", "revolute", end, f"A{i}", axis=[0, 0, 1], initial=initial)
        scene.edge(f"r{i}", "arm", f"A{i}", f"B{i}", vector=[0, -1.0, 0])
        scene.edge(f"m{i}", "rigid_body", "ground", f"B{i}", mass=mass)
        end = f"B{i}"
    return _with_energy(scene)


def long_pendulum_exact(t: Array, length: float = 2.0, angle: float = 0.5) -> Values:
    """Return the angle of a bob on one rod, released from rest, by an elliptic function."""
    modulus = math.sin(angle / 2.0)
    omega = math.sqrt(-GRAVITY[1] / length)
    _, cn, dn, _ = special.ellipj(omega * t, modulus**2)
    return {"h0.theta": 2.0 * np.arcsin(modulus * cn / dn)}


BENNETT = (0.6, 1.1)  # twists, [rad]


def bennett_loop() -> Scene:
    """Bennett's linkage: four hinges in space, in no plane and through no point, that still turn.

    Lengths are in proportion to the sines of the twists. Its loop has six conditions, three of
    them redundant.
    """
    scene, node = Scene("bennett", gravity=[0.5, -9.81, 1.0]), "ground"
    lengths = [math.sin(twist) / math.sin(BENNETT[0]) for twist in BENNETT]
    for i in range(3):
        initial = {"theta": 1.2, "theta_dot": 4.0} if i == 0 else {}
        length, twist = lengths[i % 2], BENNETT[i % 2]
        scene.edge(f"j{i}", "revolute", node, f"L{i}", axis=[0, 0, 1], initial=initial)
        link = {"vector": [length, 0, 0], "rotation": [twist, 0, 0]}
        scene.edge(f"a{i}", "arm", f"L{i}", f"E{i}", **link)
        scene.edge(f"c{i}", "arm", f"L{i}", f"C{i}", vector=[length / 2, 0, 0])
        inertia = [0.1, 0.2, 0.25]
        scene.edge(f"b{i}", "rigid_body", "ground", f"C{i}", mass=1.0 + i, inertia=inertia)
        node = f"E{i}"
    # The fourth link is the ground, seen from its other end.
    base = {"vector": [-lengths[1], 0, 0], "rotation": [-BENNETT[1], 0, 0]}
    scene.edge("base", "arm", "ground", "P", **base)
    scene.edge("j3", "revolute", node, "P", axis=[0, 0, 1])
    return _with_energy(scene)


def bennett_gap(theta0: Array, theta1: Array) -> Array:
    """Return the residual of Bennett's relation, tan(a/2) tan(b/2) = sin(../2) / sin(../2)."""
    sines = [math.sin((BENNETT[1] + sign * BENNETT[0]) / 2.0) for sign in (1.0, -1.0)]
    halves = theta0 / 2.0, theta1 / 2.0
    gap: Array = sines[1] * np.sin(halves[0]) * np.sin(halves[1]) - sines[0] * np.cos(
        halves[0]
    ) * np.cos(halves[1])
    return gap


SPIN, RADIUS, REACH, STIFFNESS = 100.0, 1.0, 0.4, 1e8


def spinning_pair() -> Scene:
    """Two bodies of 1 kg that a stiff spring holds on a circle, its vibration not excited."""
    scene = Scene("spinning-pair")
    length = 2.0 * (RADIUS - REACH) - SPIN**2 * RADIUS / STIFFNESS
    for side, sign in (("a", 1.0), ("b", -1.0)):
        initial = {"x": sign * RADIUS, "y_dot": sign * RADIUS * SPIN, "theta_dot": SPIN}
        joint = {"normal": [0, 0, 1], "initial": initial}
        scene.edge(f"p{side}", "planar", "ground", f"C{side}", **joint)
        scene.edge(f"m{side}", "rigid_body", "ground", f"C{side}", mass=1.0, inertia=0.02)
        scene.edge(f"e{side}", "arm", f"C{side}", f"E{side}", vector=[-sign * REACH, 0, 0])
    scene.edge("spring", "spring", "Ea", "Eb", stiffness=STIFFNESS, free_length=length)
    for name in ("Ca.x", "Ca.y", "Cb.vx"):
        scene.output(name.replace(".", "_"), name)
    return _with_energy(scene)


def spinning_pair_exact(t: Array) -> Values:
    angle = SPIN * t
    return {
        "Ca_x": RADIUS * np.cos(angle),
        "Ca_y": RADIUS * np.sin(angle),
        "Cb_vx": RADIUS * SPIN * np.sin(angle),
    }


# ---- masses and springs along a line


def two_masses(m: Sequence[float], k: Sequence[float], c: Sequence[float]) -> Scene:
    """Two masses in a row on springs with dampers beside them, the outer one displaced."""
    scene, node = Scene("two-masses"), "ground"
    for i in (0, 1):
        end, start = f"N{i}", {"s": float(i)}
        scene.edge(f"m{i}", "translational_mass", "ground", end, mass=m[i])
        scene.edge(f"k{i}", "translational_spring", node, end, stiffness=k[i], initial=start)
        if c[i]:
            scene.edge(f"c{i}", "translational_damper", node, end, damping=c[i])
        node = end
    return scene


def two_masses_exact(
    m: Sequence[float], k: Sequence[float], c: Sequence[float], t: Array
) -> Values:
    """Return the extensions of the springs by the eigenvectors, in 60 digits."""
    with mpmath.workdps(60):
        (m0, m1), (k0, k1), (c0, c1) = ([mpmath.mpf(x) for x in row] for row in (m, k, c))
        # Extensions and velocities: s0' = v0, s1' = v1 - v0, m0 v0' = f1 - f0, m1 v1' = -f1.
        zero, one = mpmath.mpf(0), mpmath.mpf(1)
        matrix = mpmath.matrix(
            [
                [zero, zero, one, zero],
                [zero, zero, -one, one],
                [-k0 / m0, k1 / m0, -(c0 + c1) / m0, c1 / m0],
                [zero, -k1 / m1, c1 / m1, -c1 / m1],
            ]
        )
        values, vectors = mpmath.eig(matrix)
        shares = mpmath.lu_solve(vectors, mpmath.matrix([0, 1, 0, 0]))
        rows: list[list[float]] = [[], []]
        for time in t.tolist():
            grown = [
                share * mpmath.exp(value * time)
                for share, value in zip(shares, values, strict=True)
            ]
            for row, found in zip(rows, (0, 1), strict=True):
                total = mpmath.fsum(vectors[found, j] * grown[j] for j in range(4))
                row.append(float(mpmath.re(total)))
    return {"k0.s": np.array(rows[0]), "k1.s": np.array(rows[1])}


DAMPING = 1e-5  # [1/s], by the mass


def light_oscillator() -> Scene:
    """x'' + 2 d x' + x = 0 from x = 1, which takes a tenth of a million seconds to die out."""
    scene = Scene("light-oscillator")
    scene.edge("m", "translational_mass", "ground", "A", mass=1.0)
    scene.edge("s", "translational_spring", "ground", "A", stiffness=1.0, initial={"s": 1.0})
    scene.edge("d", "translational_damper", "ground", "A", damping=2.0 * DAMPING)
    return scene


def light_oscillator_exact(t: Array) -> Values:
    omega = math.sqrt(1.0 - DAMPING**2)
    decay = np.exp(-DAMPING * t)
    return {"s.s": decay * (np.cos(omega * t) + DAMPING / omega * np.sin(omega * t))}


FRICTION = 0.02  # force over stiffness, [m]


def dry_swing() -> Scene:
    """A mass on a spring of 1 N/m under dry friction, which jumps at each turn."""
    scene = Scene("dry-swing")
    scene.edge("m", "translational_mass", "ground", "A", mass=1.0)
    scene.edge("s", "translational_spring", "ground", "A", stiffness=1.0, initial={"s": 1.0})
    scene.edge("f", "force_source", "ground", "A", force=f"-{FRICTION}*sign(m.v)")
    return scene


def dry_swing_exact(t: Array) -> Values:
    """Half a turn after half a turn about a centre that the friction shifts."""
    n = np.floor(t / np.pi)
    size, sign = 1.0 - (2.0 * n + 1.0) * FRICTION, (-1.0) ** n
    angle = t - n * np.pi
    return {
        "s.s": sign * (size * np.cos(angle) + FRICTION),
        "m.v": -sign * size * np.sin(angle),
    }


def sliding_to_rest(transition: float = 0.0) -> Scene:
    """A mass of 1 kg at 1 m/s under dry friction of 1 N, at rest after a second."""
    scene = Scene("sliding-to-rest")
    scene.edge("m", "translational_mass", "ground", "A", mass=1.0, initial={"v": 1.0})
    if transition:
        law = {"force": 1.0, "transition": transition}
        scene.edge("f", "translational_friction", "ground", "A", **law)
    else:
        scene.edge("f", "force_source", "ground", "A", force="-sign(m.v)")
    return scene


def sliding_to_rest_exact(t: Array, transition: float = 0.0) -> Values:
    """Return v = max(1 - t, 0), or with a smooth law sinh(v/d) = sinh(1/d) exp(-t/d)."""
    if not transition:
        return {"m.v": np.maximum(1.0 - t, 0.0)}
    with mpmath.workdps(40):
        d = mpmath.mpf(transition)
        start = mpmath.sinh(1 / d)
        return {
            "m.v": np.array(
                [float(d * mpmath.asinh(start * mpmath.exp(-x / d))) for x in t.tolist()]
            )
        }


MU = 1e6


def van_der_pol() -> Scene:
    """x'' + mu (x^2 - 1) x' + x = 0 from its slow curve at x = 2."""
    scene = Scene("van-der-pol")
    start = -2.0 / (3.0 * MU)
    scene.edge("m", "translational_mass", "ground", "A", mass=1.0, initial={"v": start})
    scene.edge("s", "translational_spring", "ground", "A", stiffness=1.0, initial={"s": 2.0})
    scene.edge("d", "translational_damper", "ground", "A", damping=f"{MU}*(s.s**2 - 1)")
    return scene


def van_der_pol_exact(t: Array) -> Values:
    """Return x on the slow curve, log x - x^2/2 = t/mu + log 2 - 2, and mirrored after a jump.

    What is left out is 1/mu^2 of x. Half a period is (3/2 - log 2) mu + 3.507.. mu^(-1/3), with
    the first zero of Airy's function, and terms of log(mu)/mu: 1e-5 s, in which x moves by 1e-11.
    """
    half = (1.5 - math.log(2.0)) * MU + 1.5 * 2.338107410459767 * MU ** (-1.0 / 3.0)
    n = np.floor(t / half)
    right = (t - n * half) / MU + math.log(2.0) - 2.0
    x = np.full_like(t, 1.7)
    for _ in range(60):  # Newton's iteration, which does not leave x > 1
        x = np.maximum(x - (np.log(x) - x**2 / 2.0 - right) / (1.0 / x - x), 1.0 + 1e-9)
    return {"s.s": (-1.0) ** n * x}


# ---- networks


def pressure_sensor() -> Scene:
    """A vessel of 10 MPa empties, and a signal of it charges 1 pF through 1 megohm."""
    scene = Scene("pressure-sensor")
    scene.parameter("C", 1e-12)
    scene.edge("V", "accumulator", "a", "ground", capacity=1e-12, initial={"p": 1e7})
    scene.edge("R", "hydraulic_resistor", "a", "ground", resistance=1e12)
    scene.edge("S", "voltage_source", "s", "ground", voltage="1e-6*a.p")
    scene.edge("Re", "resistor", "s", "e", resistance=1e6)
    scene.edge("Ce", "capacitor", "e", "ground", capacitance="C", initial={"v": 0.0})
    return scene


def pressure_sensor_exact(t: Array) -> Values:
    """The vessel empties within 1 s, the charge follows within 1 microsecond."""
    slow, fast = np.exp(-t), np.exp(-1e6 * t)
    return {"V.p": 1e7 * slow, "Ce.v": 10.0 * (slow - fast) * 1e6 / (1e6 - 1.0)}


def parasitic_rectifier(parasitic: float) -> Scene:
    """A diode between a source and a load, with a capacitance across it, or without."""
    scene = Scene("parasitic")
    scene.edge("S", "sine_voltage", "s", "ground", amplitude=5.0, frequency=50.0)
    scene.edge("Rs", "resistor", "s", "a", resistance=10.0)
    scene.edge("D", "diode", "a", "o", saturation_current=1e-12)
    if parasitic:
        scene.edge("Cp", "capacitor", "a", "ground", capacitance=parasitic)
    scene.edge("C", "capacitor", "o", "ground", capacitance=1e-5)
    scene.edge("RL", "resistor", "o", "ground", resistance=1e3)
    scene.output("v_o", "o.v")
    return scene
