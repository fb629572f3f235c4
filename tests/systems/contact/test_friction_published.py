"""Clutches, brakes, gears and play of the Modelica Standard Library, against its reference results.

Texts and trajectories are those of the Modelica Association (library 4.1.0), made with Dymola at a
tolerance of 1e-6; they are read where they lie and not part of cotree.
"""

import csv
from math import pi

import numpy as np
from published import shared_folder

import cotree

FOLDER = shared_folder("msl")

#: What states may differ by, as a share of a variable's range, and transitions, [s].
CLOSE = 1e-4


def reference(name):
    """Read a trajectory; of two rows at one time the first is left of an event."""
    with (FOLDER / f"Modelica.Mechanics.{name}" / "reference.csv").open() as file:
        names, *rows = csv.reader(file)
    return dict(zip(names, np.array(rows, dtype=float).T, strict=True))


def changes(t, modes):
    """List what a mode becomes, each with its time, from its value behind the start on."""
    found = []
    for time, mode in zip(t, np.rint(modes).astype(int).tolist(), strict=True):
        # At the start the reference lists values before and after its initial events.
        if found and time <= t[0] + 1e-6:
            found[-1] = (time, mode)
        elif not found or found[-1][1] != mode:
            found.append((time, mode))
    return found


def compare(scene, name, states, modes=(), rtol=1e-9):
    """Compare states by their range, and modes by their order and their times.

    ``states`` maps names of the scene to those of the reference; ``modes`` does so for modes.
    """
    there = reference(name)
    t = there["time"]
    model = scene.compile()
    at_rows = model.simulate((0, t[-1]), np.unique(t), method="dop853", rtol=rtol)
    assert at_rows.success
    place = np.searchsorted(at_rows.t, t)
    for own, other in states.items():
        worst = np.max(np.abs(at_rows[own][place] - there[other])) / np.ptp(there[other])
        assert worst <= CLOSE, (other, worst)
    # Steps end where modes change, so that times of changes are among those of a plain run.
    result = model.simulate((0, t[-1]), method="dop853", rtol=rtol)
    for own, other in dict(modes).items():
        found, expected = changes(result.t, result[own]), changes(t, there[other])
        assert [mode for _, mode in found] == [mode for _, mode in expected], other
        times = np.array([[a[0], b[0]] for a, b in zip(found, expected, strict=True)])
        assert np.max(np.abs(times[:, 0] - times[:, 1])) <= CLOSE, other
    return result


def test_coupled_clutches():
    scene = cotree.Scene("coupled-clutches")
    for i in range(1, 5):
        initial = {"w": 10.0 if i == 1 else 0.0}
        inertia = {"inertia": 1.0, "initial": initial}
        scene.edge(f"J{i}", "rotational_inertia", "ground", f"n{i}", **inertia)
    scene.edge("T", "torque_source", "ground", "n1", torque="10*sin(10*pi*t)")
    forces = ("20*sin(0.4*pi*t + pi/2)", "where(t < 0.4, 0, 20)", "where(t < 0.9, 0, 20)")
    states = {"J1.w": "J1.w"}
    for i, force in enumerate(forces, start=1):
        faces = {"normal_force": force, "friction": 0.5, "radius": 1.0, "peak": 1.1}
        scene.edge(f"clutch{i}", "clutch", f"n{i}", f"n{i + 1}", **faces)
        scene.output(f"phi{i}", f"clutch{i}.theta")
        scene.output(f"slip{i}", f"clutch{i}.w")
        states |= {f"phi{i}": f"clutch{i}.phi_rel", f"slip{i}": f"clutch{i}.w_rel"}
    modes = {f"clutch{i}.mode": f"clutch{i}.mode" for i in (1, 2, 3)}
    compare(scene, "Rotational.Examples.CoupledClutches", states, modes)


def test_a_clutch_and_a_brake():
    scene = cotree.Scene("clutch-and-brake")
    for name, node, inertia, w in (("i3", "a", 1.0, 100.0), ("i2", "b", 0.05, 90.0)):
        initial = {"w": w}
        scene.edge(name, "rotational_inertia", "ground", node, inertia=inertia, initial=initial)
    scene.edge("i1", "rotational_inertia", "ground", "c", inertia=1.0, initial={"w": 90.0})
    scene.edge("spring", "shaft", "b", "c", stiffness=160.0, damping=1.0, initial={"theta": 0.0})
    scene.edge("clutch", "clutch", "a", "b", normal_force=160.0, friction=0.5, radius=1.0)
    pressed = {"normal_force": "where(t < 0.5, 0, 1600)", "friction": 0.5, "radius": 1.0}
    scene.edge("brake", "brake", "ground", "c", **pressed)
    scene.edge("T", "torque_source", "ground", "a", torque="where(t < 0.5, 200*sin(100*t), 0)")
    for name, value in (("phi", "clutch.theta"), ("slip", "clutch.w"), ("twist_w", "spring.w")):
        scene.output(name, value)
    states = {
        "phi": "clutch.phi_rel",
        "slip": "clutch.w_rel",
        "i3.w": "inertia3.w",
        "spring.theta": "spring.phi_rel",
        "twist_w": "spring.w_rel",
    }
    modes = {"brake.mode": "brake.mode", "clutch.mode": "clutch.mode"}
    compare(scene, "Rotational.Examples.Friction", states, modes)


def lossy_gear():
    scene = cotree.Scene("lossy-gear")
    scene.edge("I1", "rotational_inertia", "ground", "a", inertia=1.0)
    scene.edge("I2", "rotational_inertia", "ground", "b", inertia=1.5, initial={"w": 0.0})
    scene.edge("G", "lossy_gear", "a", "b", ratio=2.0, efficiency=0.5)
    scene.edge("T1", "torque_source", "ground", "a", torque="10*sin(2*pi*t)")
    scene.edge("T2", "torque_source", "ground", "b", torque="2.5*t - 10")
    scene.output("phi", "I2.theta")
    return scene


def test_a_gear_that_locks():
    states = {"phi": "Inertia2.phi", "I2.w": "Inertia2.w"}
    modes = {"G.mode": "gear.mode"}
    compare(lossy_gear(), "Rotational.Examples.LossyGearDemo1", states, modes)


def test_a_gear_and_a_bearing_that_hold_one_shaft():
    """The motion is that of the reference; which of two that hold slips first is not unique.

    The reference says so itself. There the gear is the first to slip at 0.2304 s and 0.4562 s; here
    both share the torque, and the bearing reaches its limit first.
    """
    scene = lossy_gear()
    scene.edge("B", "rotational_dry_friction", "ground", "a", torque=0.5, damping=0.5)
    name = "Rotational.Examples.LossyGearDemo2"
    result = compare(scene, name, {"phi": "Inertia2.phi", "I2.w": "Inertia2.w"})
    there = reference(name)
    # It is held while either sticks; both slide while it moves.
    held = (there["gear.mode"] == 0.0) | (there["bearingFriction.mode"] == 0.0)
    own = (np.abs(result["G.mode"]) < 0.5) | (np.abs(result["B.mode"]) < 0.5)
    expected, found = changes(there["time"], held), changes(result.t, own)
    assert [state for _, state in found] == [state for _, state in expected] == [0, 1, 0, 1, 0]
    for (a, _), (b, _) in zip(found, expected, strict=True):
        assert abs(a - b) <= CLOSE


def test_a_one_way_clutch():
    scene = cotree.Scene("one-way")
    scene.edge("i", "rotational_inertia", "ground", "a", inertia=1.0, initial={"w": -0.5})
    scene.edge("o", "rotational_inertia", "ground", "b", inertia=1.0)
    scene.edge("T", "torque_source", "ground", "a", torque="10*sin(6*pi*t)")
    scene.output("pressed", "where(t < 0.3, 0, where(mod(t - 0.3, 1.3) < 0.65, 3, 0))")
    faces = {"normal_force": "pressed", "friction": 0.5, "radius": 1.0, "peak": 25}
    scene.edge("C", "one_way_clutch", "a", "b", **faces)
    scene.output("phi", "C.theta")
    scene.output("slip", "C.w")
    states = {
        "i.w": "inertiaIn.w",
        "phi": "oneWayClutch.phi_rel",
        "slip": "oneWayClutch.w_rel",
    }
    # The reference has no modes of this one.
    compare(scene, "Rotational.Examples.OneWayClutch", states)


def test_a_brake_along_a_line():
    scene = cotree.Scene("brake")
    scene.edge("M", "translational_mass", "ground", "a", mass=1.0, initial={"v": 1.0})
    pressed = {"normal_force": "where(t < 0.1, 0, 2)", "friction": 0.5}
    scene.edge("B", "translational_brake", "ground", "a", **pressed)
    scene.output("s", "B.s")
    states = {"s": "mass1.s", "M.v": "mass1.v"}
    compare(scene, "Translational.Examples.Brake", states, {"B.mode": "brake.mode"})


def test_backlash():
    scene = cotree.Scene("backlash")
    initial, half = {"theta": pi / 2}, pi / 8
    scene.edge("i1", "rotational_inertia", "ground", "a", inertia=5.0)
    scene.edge("k", "rotational_spring", "ground", "a", stiffness=20e3, initial=initial)
    scene.edge("d", "rotational_damper", "ground", "a", damping=50.0)
    scene.edge("i2", "rotational_inertia", "ground", "b", inertia=5.0)
    play = {"lower": -half, "upper": half, "stiffness": 20e3, "damping": 50.0}
    scene.edge("play", "rotational_backlash", "ground", "b", initial=initial, **play)
    states = {
        "i1.w": "springDamper.w_rel",
        "k.theta": "springDamper.phi_rel",
        "i2.w": "elastoBacklash.w_rel",
        "play.theta": "elastoBacklash.phi_rel",
    }
    compare(scene, "Rotational.Examples.Backlash", states)


def test_elastic_gaps():
    scene = cotree.Scene("gaps")
    # The masses begin at 2 m; the walls are at -2 m and 2 m, which shortens what reaches them.
    gap = {"stiffness": 10.0, "damping": 1.5, "lower": 1.5 - 2.0}
    for node in "ab":
        initial = {"s": 2.0}
        scene.edge(f"m_{node}", "translational_mass", "ground", node, mass=1.0, initial=initial)
    for i, ends in enumerate((("ground", "a"), ("a", "ground")), start=1):
        spring = {"stiffness": 10.0, "free_length": 1.0 - 2.0}
        scene.edge(f"k{i}", "translational_spring", *ends, **spring)
        scene.edge(f"d{i}", "translational_damper", *ends, damping=1.5)
        ends = tuple("b" if end == "a" else end for end in ends)
        scene.edge(f"gap{i}", "translational_backlash", *ends, **gap)
    scene.output("s_a", "k2.s + 2")
    scene.output("s_b", "gap2.s + 2")
    states = {
        "m_a.v": "springDamper1.v_rel",
        "s_a": "springDamper2.s_rel",
        "m_b.v": "elastoGap1.v_rel",
        "s_b": "elastoGap2.s_rel",
    }
    compare(scene, "Translational.Examples.ElastoGap", states)
