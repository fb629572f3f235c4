"""One-dimensional mechanics against closed forms: springs in series, gears, positions, stops."""

from __future__ import annotations

import numpy as np
import pytest

from cotree import Scene
from cotree.errors import (
    FormulationError,
    ParameterError,
    SceneError,
    SingularSystemError,
    TopologyError,
)

TIGHT = {"method": "dop853", "rtol": 1e-12, "atol": 1e-14}
# Runs of some ten periods at that tolerance: measured 1e-11 and less.
CLOSE = {"rtol": 0.0, "atol": 1e-10}


def chain(*springs, mass=2.0):
    """Hang a mass on springs in a row, each given by its fields."""
    scene = Scene("chain")
    nodes = ["ground", *(f"n{i}" for i in range(1, len(springs))), "end"]
    for i, fields in enumerate(springs):
        scene.edge(f"k{i}", "translational_spring", nodes[i], nodes[i + 1], **fields)
    scene.edge("m", "translational_mass", "ground", "end", mass=mass)
    return scene


def test_springs_in_series_share_one_state():
    scene = chain(
        {"stiffness": 30.0, "free_length": 0.1, "initial": {"s": 0.4}},
        {"stiffness": 60.0, "free_length": 0.2},
    )
    scene.output("x", "k0.s + k1.s")
    scene.output("f0", "k0.f")
    scene.output("f1", "k1.f")
    scene.output("v", "n1.v")
    model = scene.compile()
    assert model.states == ("k0.s", "m.v")
    result = model.simulate((0, 3), **TIGHT)
    omega = np.sqrt(20.0 / 2.0)  # 1/k = 1/30 + 1/60
    start = 30.0 * (0.4 - 0.1) * (1 / 30 + 1 / 60)
    exact = 0.3 + start * np.cos(omega * result.t)
    np.testing.assert_allclose(result["x"], exact, **CLOSE)
    np.testing.assert_allclose(result["f1"], result["f0"], atol=1e-12)
    # The middle moves by what the first spring takes of the stretch: two thirds.
    np.testing.assert_allclose(
        result["v"], -2 / 3 * start * omega * np.sin(omega * result.t), **CLOSE
    )


def test_sensitivities_of_springs_that_meet_at_a_node_without_mass():
    scene = Scene("star")
    for name, value in {"k": 10.0, "F": 1.0}.items():
        scene.parameter(name, value)
    for i in (1, 2):
        scene.edge(f"k{i}", "translational_spring", "ground", "A", stiffness=f"{i}*k")
    scene.edge("k3", "translational_spring", "A", "B", stiffness="3*k")
    scene.edge("m", "translational_mass", "ground", "B", mass=2.0)
    scene.edge("F", "force_source", "ground", "B", force="F")
    scene.output("y", "m.s")
    model = scene.compile(["k", "F"])
    # One position is free: the first two stretches are one, and balance the third.
    assert model.states == ("k3.s", "m.v")
    result = model.simulate((0, 3), **TIGHT)
    stiffness, t = 1.5 * 10.0, result.t  # (1 + 2) k and 3 k in series
    omega = np.sqrt(stiffness / 2.0)
    exact = (1 - np.cos(omega * t)) / stiffness
    np.testing.assert_allclose(result["y"], exact, **CLOSE)
    np.testing.assert_allclose(result.sensitivity("y", "F"), exact, **CLOSE)
    by_k = 1.5 * (t * np.sin(omega * t) / (2 * omega * 2.0) - exact) / stiffness
    np.testing.assert_allclose(result.sensitivity("y", "k"), by_k, **CLOSE)


def test_a_linear_spring_in_series_with_one_by_an_expression():
    scene = chain(
        {"force": "100*k0.s**3 + 10*k0.s", "initial": {"s": 0.5}},
        {"stiffness": 40.0},
    )
    scene.output("energy", "m.v**2 + 25*k0.s**4 + 5*k0.s**2 + 20*k1.s**2")
    scene.output("gap", "k0.f - k1.f")
    result = scene.compile().simulate((0, 3), **TIGHT)
    assert np.ptp(result["energy"]) < 1e-9  # of 3 J
    assert np.max(np.abs(result["gap"])) < 1e-12


def test_two_springs_by_expressions_in_series():
    """The second stretch balances the forces; both share the motion as their slopes say."""
    scene = chain(
        {"force": "c*k0.s**3 + 10*k0.s", "initial": {"s": 0.5}},
        {"force": "40*k1.s + 20*k1.s**3"},
    )
    scene.parameter("c", 100.0)
    scene.output("energy", "m.v**2 + c*k0.s**4/4 + 5*k0.s**2 + 20*k1.s**2 + 5*k1.s**4")
    scene.output("gap", "k0.f - k1.f")
    scene.output("slopes", "(3*c*k0.s**2 + 10)*k0.v - (40 + 60*k1.s**2)*k1.v")
    scene.output("pull", "k0.f")
    model = scene.compile(["c"])
    assert model.states == ("k0.s", "m.v", "k1.s")
    result = model.simulate((0, 3), **TIGHT)
    assert np.ptp(result["energy"]) < 1e-9  # of 6 J
    # The balance is solved to 1e-12 of forces of some 20 N, with slopes of 1e2 N/m.
    assert np.max(np.abs(result["gap"])) < 1e-9
    assert np.max(np.abs(result["slopes"])) < 1e-9
    # The energy stays what it is at the start for any c, where c s1^3 + 10 s1 = 40 s2 + 20 s2^3.
    s1, s2 = result["k0.s"][0], result["k1.s"][0]
    force = 40 * s2 + 20 * s2**3
    expected = s1**4 / 4 + force * s1**3 / (40 + 60 * s2**2)
    np.testing.assert_allclose(result.sensitivity("energy", "c"), expected, atol=1e-9)


def test_a_spring_by_an_expression_pressed_by_a_given_force():
    scene = Scene("press")
    scene.edge("k", "translational_spring", "ground", "A", force="8*k.s**3 + 2*k.s")
    scene.edge("F", "force_source", "ground", "A", force="10 + sin(t)")
    scene.edge("C", "heat_capacitor", "h", "ground", capacity=1.0)  # something with a state
    scene.output("v", "A.v")
    scene.output("s", "k.s")
    result = scene.compile().simulate((0, 2), **TIGHT)
    s, t = result["s"], result.t
    np.testing.assert_allclose(8 * s**3 + 2 * s, 10 + np.sin(t), **CLOSE)
    np.testing.assert_allclose(result["v"], np.cos(t) / (24 * s**2 + 2), **CLOSE)


def test_a_spring_pressed_by_a_given_force_follows_it():
    scene = Scene("press")
    scene.edge("k", "translational_spring", "ground", "A", stiffness=50.0)
    scene.edge("F", "force_source", "ground", "A", force="3*sin(2*t)")
    scene.edge("C", "heat_capacitor", "h", "ground", capacity=1.0)  # something with a state
    scene.output("s", "k.s")
    scene.output("v", "A.v")
    result = scene.compile().simulate((0, 2))
    np.testing.assert_allclose(result["s"], 3 * np.sin(2 * result.t) / 50, atol=1e-15)
    np.testing.assert_allclose(result["v"], 6 * np.cos(2 * result.t) / 50, atol=1e-15)


def test_shafts_in_a_row_keep_their_own_twist():
    scene = Scene("shafts")
    scene.edge("a", "shaft", "ground", "A", stiffness=10.0, damping=1.0)
    scene.edge("b", "shaft", "A", "B", stiffness=20.0, damping=2.0)  # damped alike
    scene.edge("J", "rotational_inertia", "ground", "B", inertia=1.0, initial={"w": 1.0})
    scene.output("twist", "a.theta + b.theta")
    model = scene.compile()
    assert model.states == ("a.theta", "b.theta", "J.w")
    result = model.simulate((0, 2), **TIGHT)
    k, c = 20.0 / 3.0, 2.0 / 3.0
    delta = c / 2
    omega = np.sqrt(k - delta**2)
    exact = np.exp(-delta * result.t) * np.sin(omega * result.t) / omega
    np.testing.assert_allclose(result["twist"], exact, **CLOSE)


def test_springs_without_a_law_that_can_be_solved_need_a_mass():
    scene = chain({"force": "10*k0.s**3"}, {"force": "10*k1.s**3"})
    with pytest.raises(SingularSystemError, match=r"springs .* zero stiffness"):  # at rest
        scene.compile()
    scene.edge("d", "translational_damper", "ground", "n1", damping=0.1)
    assert set(scene.compile().states) == {"k0.s", "k1.s", "m.v"}
    scene = Scene("stops")
    limits = {"lower": -1.0, "upper": 1.0, "stiffness": 10.0, "damping": 1.0}
    scene.edge("s0", "translational_stop", "ground", "n1", **limits)
    scene.edge("s1", "translational_stop", "n1", "end", **limits)
    scene.edge("m", "translational_mass", "ground", "end", mass=1.0)
    with pytest.raises(TopologyError, match=r"s0, s1 reach the node n1 .* a mass or a damper"):
        scene.compile()


def test_what_a_spring_in_series_cannot_do_is_said():
    scene = chain({"stiffness": "u", "initial": {"s": 0.1}}, {"stiffness": 40.0})
    scene.input("u", 3.0)
    with pytest.raises(FormulationError, match="stiffness of edge 'k0' depends on an input"):
        scene.compile()
    scene = chain(
        {"stiffness": 1.0, "initial": {"s": 0.1}}, {"stiffness": 1.0, "initial": {"s": 0.2}}
    )
    with pytest.raises(ParameterError, match=r"'k0.s' is given as 0.1 but is 0.2 by 'k1.s'"):
        scene.compile()


def test_a_stiffness_that_changes_with_time_in_series():
    """The force at a fixed stretch of both is that of the springs in series at each instant."""
    scene = Scene("tuned")
    total = 0.4  # the second spring is so much shorter than the gap
    scene.edge("k0", "translational_spring", "ground", "A", stiffness="10*(1 + t)")
    scene.edge("k1", "translational_spring", "A", "ground", stiffness=10.0, free_length=-total)
    scene.edge("C", "heat_capacitor", "h", "ground", capacity=1.0)  # something with a state
    scene.output("f", "k0.f")
    scene.output("sum", "k0.s + k1.s")
    result = scene.compile().simulate((0, 2), **TIGHT)
    exact = total / (1 / (10 * (1 + result.t)) + 0.1)
    np.testing.assert_allclose(result["f"], exact, **CLOSE)
    np.testing.assert_allclose(result["sum"], 0.0, **CLOSE)


def test_positions_are_states_only_where_they_are_used():
    def states(*outputs, **mass):
        scene = Scene("mass")
        scene.edge("m", "translational_mass", "ground", "A", mass=1.0, **mass)
        scene.edge("d", "translational_damper", "ground", "A", damping=1.0)
        for i, text in enumerate(outputs):
            scene.output(f"y{i}", text)
        return scene.compile().states

    assert states("A.v") == ("m.v",)
    assert states("m.s") == ("m.v", "m.s")
    assert states("d.s") == ("m.v", "d.s")
    assert states(initial={"s": 0.3}) == ("m.v", "m.s")


def test_a_field_may_use_a_position():
    scene = Scene("soft")
    scene.edge("m", "translational_mass", "ground", "A", mass=1.0, initial={"v": 1.0})
    scene.edge("F", "force_source", "ground", "A", force="-9*m.s")
    scene.output("s", "m.s")
    result = scene.compile().simulate((0, 3), **TIGHT)
    np.testing.assert_allclose(result["s"], np.sin(3 * result.t) / 3, **CLOSE)


def test_inertias_on_a_gear_share_a_state_with_sensitivities():
    scene = Scene("gear")
    for name, value in {"J1": 0.1, "J2": 0.9, "n": 3.0, "T": 2.0}.items():
        scene.parameter(name, value)
    scene.edge("J1", "rotational_inertia", "ground", "A", inertia="J1")
    scene.edge("G", "ideal_gear", "A", "B", ratio="n")
    scene.edge("J2", "rotational_inertia", "ground", "B", inertia="J2")
    scene.edge("T", "torque_source", "ground", "A", torque="T")
    scene.output("w", "A.w")
    scene.output("tooth", "G.output.tau")
    model = scene.compile(["J1", "J2", "n"])
    assert len(model.states) == 1
    result = model.simulate((0, 2), **TIGHT)
    total, t = 0.1 + 0.9 / 9, result.t
    np.testing.assert_allclose(result["w"], 2.0 * t / total, **CLOSE)
    # The gear drives the load, so it takes its torque from the node B.
    np.testing.assert_allclose(result["tooth"], -0.9 * 2.0 / total / 3, rtol=1e-14)
    slope = -2.0 * t / total**2
    for name, by in {"J1": 1.0, "J2": 1 / 9, "n": -2 * 0.9 / 27}.items():
        np.testing.assert_allclose(result.sensitivity("w", name), slope * by, **CLOSE)


def test_a_planetary_gear_shares_torque_among_three_inertias():
    """Two speeds are free; a torque on the sun accelerates them by the inverse of their inertia."""
    inertias, r, torque = {"sun": 0.2, "carrier": 0.5, "ring": 0.7}, 2.5, 3.0
    scene = Scene("planets")
    scene.parameter("r", r)
    for node, inertia in inertias.items():
        scene.edge(f"J_{node}", "rotational_inertia", "ground", node, inertia=inertia)
    scene.edge("G", "planetary_gear", "sun", "carrier", "ring", ratio="r")
    scene.edge("T", "torque_source", "ground", "sun", torque=torque)
    for node in inertias:
        scene.output(node, f"{node}.w")
    result = scene.compile(["r"]).simulate((0, 1), **TIGHT)

    def exact(r):
        # Columns are what the speeds of sun and ring add to those of sun, carrier and ring.
        free = np.array([[1.0, 0.0], [1 / (1 + r), r / (1 + r)], [0.0, 1.0]])
        matrix = free.T @ np.diag(list(inertias.values())) @ free
        return free @ np.linalg.solve(matrix, free.T @ [torque, 0.0, 0.0])

    ends = [result[node][-1] for node in inertias]
    np.testing.assert_allclose(ends, exact(r), rtol=1e-12)
    # A complex step has no error of cancellation.
    slopes = np.imag(exact(r + 1e-30j)) / 1e-30
    ends = [result.sensitivity(node, "r")[-1] for node in inertias]
    np.testing.assert_allclose(ends, slopes, rtol=1e-11)


def test_ports_may_be_named_by_both_nodes_or_by_one_each():
    def final(**nodes):
        scene = Scene("rack")
        scene.edge("m", "translational_mass", "ground", "A", mass=2.0, initial={"v": 1.0})
        scene.edge("J", "rotational_inertia", "ground", "B", inertia=0.5)
        listed = nodes.pop("nodes", ())
        scene.edge("G", "rack_and_pinion", *listed, radius=0.5, **nodes)
        scene.edge("d", "rotational_damper", "ground", "B", damping=0.3)
        scene.output("v", "A.v")
        return scene.compile().simulate((0, 1), **TIGHT)["v"][-1]

    exact = np.exp(-0.3 / 0.25 / (2.0 + 0.5 / 0.25))
    assert final(nodes=("A", "B")) == pytest.approx(exact, rel=1e-11)
    assert final(rack=["ground", "A"], pinion=["ground", "B"]) == pytest.approx(exact, rel=1e-11)
    with pytest.raises(SceneError, match="has the ports rack, pinion: name the two nodes"):
        final(nodes=("A",))


def test_a_backlash_lets_through_nothing_within_its_gap():
    scene = Scene("backlash")
    scene.edge("m", "translational_mass", "ground", "A", mass=1.0, initial={"v": 1.0})
    fields = {"lower": -0.5, "upper": 0.5, "stiffness": 1e4, "damping": 20.0}
    scene.edge("B", "translational_stop", "ground", "A", **fields)
    scene.output("f", "B.f")
    scene.output("s", "B.s")
    result = scene.compile().simulate((0, 2), t_eval=np.linspace(0, 2, 201), **TIGHT)
    within = np.abs(result["s"]) < 0.45
    # Far from a stop, at a distance x, its force is k d**2 / (4 x), d = 1e-6 by default, and its
    # damping c v d**2 / (4 x**2).
    assert np.max(np.abs(result["f"][within])) < 1e4 * 1e-12 / (4 * 0.05) + 20e-12 / (4 * 0.05**2)
    assert np.any(result["f"] > 10.0)
    speeds = np.abs(result.y[0][within])
    assert speeds[-1] < 0.9  # the stop takes energy


def test_inertia_is_against_the_ground():
    with pytest.raises(SceneError, match=r"'m' is connected to 'A'.* name 'ground' first"):
        Scene("s").edge("m", "translational_mass", "A", "ground", mass=1.0)


def test_a_spring_has_a_stiffness_or_a_force():
    with pytest.raises(SceneError, match="needs the field 'stiffness'"):
        Scene("s").edge("k", "translational_spring", "ground", "A")
    with pytest.raises(SceneError, match="give one of them"):
        Scene("s").edge("k", "rotational_spring", "ground", "A", stiffness=1.0, torque="k.theta")
