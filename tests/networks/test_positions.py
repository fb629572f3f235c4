"""Positions in networks are across variables: one for each pair of nodes, along f-circuits."""

from __future__ import annotations

import numpy as np
import pytest

import cotree
from cotree import Scene

TIGHT = {"method": "dop853", "rtol": 1e-12, "atol": 1e-14}
# Runs of some ten periods at that tolerance.
CLOSE = {"rtol": 0.0, "atol": 1e-10}

MOTIONS = {
    "translational": ("s", "translational_mass", "mass", "free_length"),
    "rotational": ("theta", "rotational_inertia", "inertia", "free_angle"),
}


def oscillator(domain: str, of_spring: object = None, *, is_turned: bool = False) -> Scene:
    """Put a spring of 100 N/m beside a mass of 1 kg that is given a position."""
    symbol, store, field, _ = MOTIONS[domain]
    scene = Scene("oscillator")
    scene.parameter("x0", 0.3)
    scene.edge("m", store, "ground", "a", **{field: 1.0}, initial={symbol: "x0"})
    nodes = ("a", "ground") if is_turned else ("ground", "a")
    initial = {} if of_spring is None else {symbol: of_spring}
    scene.edge("k", f"{domain}_spring", *nodes, stiffness=100.0, initial=initial)
    return scene


@pytest.mark.parametrize("is_turned", [False, True])
@pytest.mark.parametrize("domain", MOTIONS)
def test_edges_between_the_same_nodes_have_one_position(domain, is_turned):
    symbol = MOTIONS[domain][0]
    model = oscillator(domain, is_turned=is_turned).compile(["x0"])
    assert set(model.states) == {f"m.{symbol}", f"m.{'v' if symbol == 's' else 'w'}"}
    result = model.simulate((0, 1), **TIGHT)
    own, beside = result[f"m.{symbol}"], result[f"k.{symbol}"]
    np.testing.assert_allclose(own, 0.3 * np.cos(10 * result.t), **CLOSE)
    np.testing.assert_array_equal(beside, -own if is_turned else own)
    slope = result.sensitivity(f"k.{symbol}", "x0") * (-1 if is_turned else 1)
    np.testing.assert_allclose(slope, np.cos(10 * result.t), **CLOSE)
    columns = result.columns()
    np.testing.assert_array_equal(columns[f"k.{symbol}"], beside)
    assert f"d(k.{symbol})/d(x0)" in columns
    assert f"k.{symbol}" in result
    assert result.unit(f"k.{symbol}") == result.unit(f"m.{symbol}")


@pytest.mark.parametrize("domain", MOTIONS)
def test_initial_values_that_contradict_each_other_are_refused_with_the_remedy(domain):
    symbol, *_, free = MOTIONS[domain]
    with pytest.raises(cotree.ParameterError) as caught:
        oscillator(domain, 0.1).compile()
    for part in (f"'k.{symbol}' is given as 0.1", f"0.3 by 'm.{symbol}'", free):
        assert part in str(caught.value)
    # They agree at 0.3 only, so that a sensitivity to it has two values.
    with pytest.raises(cotree.ParameterError, match=rf"d\(k.{symbol}\)/d\(x0\) is 0 .* but 1 by"):
        oscillator(domain, 0.3).compile(["x0"])
    assert oscillator(domain, "x0").compile(["x0"]).start().s.max() == 1.0


def test_a_run_may_not_give_what_follows_along_a_circuit():
    model = oscillator("translational").compile()
    assert model.simulate((0, 0.1), initial={"m.s": 0.5})["k.s"][0] == 0.5
    with pytest.raises(cotree.ParameterError, match=r"position 'k.s': give .* of m.s"):
        model.start(initial={"k.s": 0.5})


def test_members_of_an_ensemble_have_positions_that_follow():
    model = oscillator("translational", is_turned=True).compile(["x0"])
    runs = model.ensemble((0, 1), {"x0": [0.1, 0.2]}, t_eval=[0.0, 1.0])
    np.testing.assert_array_equal(runs["k.s"], -runs["m.s"])
    np.testing.assert_array_equal(runs["d(k.s)"], -runs["d(m.s)"])
    assert runs["k.s"].attrs["units"] == "m"


def two_carts(**initial: dict[str, float]) -> Scene:
    scene = Scene("carts")
    masses = {"m1": "a", "m2": "b"}
    for name, node in masses.items():
        own = {"s": initial[name]} if name in initial else {}
        scene.edge(name, "translational_mass", "ground", node, mass=1.0, initial=own)
    own = {"s": initial["k"]} if "k" in initial else {}
    scene.edge("k", "translational_spring", "a", "b", stiffness=8.0, initial=own)
    scene.output("x1", "m1.s")
    scene.output("x2", "m2.s")
    return scene


@pytest.mark.parametrize(
    ("initial", "starts"),
    [
        ({"m1": 0.1, "m2": 0.4}, (0.1, 0.4)),
        ({"m1": 0.1, "k": 0.3}, (0.1, 0.4)),
        ({"m2": 0.4, "k": 0.3}, (0.1, 0.4)),
        ({"m1": 0.1, "m2": 0.4, "k": 0.3}, (0.1, 0.4)),
        # What is not given is zero, in the order of the scene.
        ({"k": 0.3}, (0.0, 0.3)),
        ({"m2": 0.4}, (0.4, 0.4)),
        ({}, (0.0, 0.0)),
    ],
    ids=str,
)
def test_positions_add_up_along_a_circuit(initial, starts):
    model = two_carts(**initial).compile()
    assert sum(name.endswith(".s") for name in model.states) == 2
    result = model.simulate((0, 2), **TIGHT)
    middle, half = sum(starts) / 2, (starts[1] - starts[0]) / 2
    np.testing.assert_allclose(result["x1"], middle - half * np.cos(4 * result.t), **CLOSE)
    np.testing.assert_allclose(result["x2"], middle + half * np.cos(4 * result.t), **CLOSE)
    np.testing.assert_allclose(result["k.s"], result["x2"] - result["x1"], atol=1e-15)


def test_three_positions_of_one_circuit_may_contradict_each_other():
    with pytest.raises(
        cotree.ParameterError, match=r"'k.s' is given as 0.2 but is 0.3 by 'm1.s', "
    ):
        two_carts(m1=0.1, m2=0.4, k=0.2).compile()


def test_no_output_adds_a_position_that_follows():
    scene = two_carts()
    plain = scene.compile().states
    scene.output("gap", "k.s")
    assert scene.compile().states == plain


def test_springs_in_series_follow_the_position_of_their_end():
    """The middle balances both springs, from the first moment on."""
    scene = Scene("row")
    scene.edge("k1", "translational_spring", "ground", "n", stiffness=30.0, free_length=0.1)
    scene.edge("k2", "translational_spring", "n", "a", stiffness=60.0)
    scene.edge("m", "translational_mass", "ground", "a", mass=2.0, initial={"s": 0.4})
    for name in ("k1.s", "k2.s", "k1.f", "k2.f"):
        scene.output(name.replace(".", "_"), name)
    model = scene.compile()
    assert set(model.states) == {"m.s", "m.v"}
    result = model.simulate((0, 2), **TIGHT)
    # Both springs in a row have 20 N/m; 30 (s1 - 0.1) = 60 (s - s1).
    s = 0.1 + 0.3 * np.cos(np.sqrt(10.0) * result.t)
    np.testing.assert_allclose(result["m.s"], s, **CLOSE)
    np.testing.assert_allclose(result["k1_s"], (3.0 + 60.0 * s) / 90.0, **CLOSE)
    np.testing.assert_allclose(result["k1_s"] + result["k2_s"], result["m.s"], atol=1e-15)
    np.testing.assert_allclose(result["k1_f"], result["k2_f"], atol=1e-12)


def test_bent_springs_in_series_follow_the_position_of_their_end():
    scene = Scene("row")
    scene.edge("k1", "translational_spring", "ground", "n", force="40*k1.s + 20*k1.s**3")
    scene.edge("k2", "translational_spring", "n", "a", force="10*k2.s + 100*k2.s**3")
    scene.edge("m", "translational_mass", "ground", "a", mass=2.0, initial={"s": 0.5})
    own = "20*k1.s**2 + 5*k1.s**4 + 5*k2.s**2 + 25*k2.s**4"
    scene.output("energy", f"m.v**2 + {own}")
    scene.output("gap", "k1.f - k2.f")
    scene.output("sum", "k1.s + k2.s - m.s")
    result = scene.compile().simulate((0, 3), **TIGHT)
    assert result["m.s"][0] == 0.5
    assert np.ptp(result["energy"]) < 1e-9  # of 2 J
    # The balance is solved to 1e-12 of forces of some 15 N, with slopes of 1e2 N/m.
    assert np.max(np.abs(result["gap"])) < 1e-9
    assert np.max(np.abs(result["sum"])) < 1e-14


def test_a_stop_and_events_follow_the_position_of_a_mass_beside_them():
    """A mass that falls from 1.2 m meets a rigid floor that is given no position of its own."""
    scene = Scene("fall")
    scene.parameter("h", 1.2)
    scene.edge("m", "translational_mass", "ground", "a", mass=2.0, initial={"s": "h"})
    scene.edge("F", "force_source", "ground", "a", force=-2.0 * 9.81)
    scene.edge("floor", "translational_rigid_stop", "ground", "a", lower=0.2, restitution=0.5)
    scene.mode("n", 0)
    scene.event("half", "floor.s - 0.7", direction=-1, set={"n": "n + 1"})
    result = scene.compile(["h"]).simulate((0, 0.6), method="dopri5", rtol=1e-11, atol=1e-13)
    fall = np.sqrt(2 * 0.5 / 9.81)
    assert result.events["half"].t[0] == pytest.approx(fall, abs=1e-9)
    # t = sqrt(2 (h - 0.7) / g)
    assert result.event_sensitivity("half", "h")[0] == pytest.approx(1 / (9.81 * fall), abs=1e-7)
    hit = np.sqrt(2 * 1.0 / 9.81)
    after = 0.2 + 0.5 * 9.81 * hit * (0.6 - hit) - 9.81 * (0.6 - hit) ** 2 / 2
    assert result["m.s"][-1] == pytest.approx(after, abs=1e-8)


def test_positions_on_both_sides_of_a_gear_keep_their_offset():
    """Each begins where its own side says; what they move by has the ratio."""
    scene = Scene("gear")
    for name, node, angle in (("J1", "A", 0.3), ("J2", "B", 0.7)):
        initial = {"theta": angle}
        scene.edge(name, "rotational_inertia", "ground", node, inertia=1.0, initial=initial)
    scene.edge("G", "ideal_gear", "A", "B", ratio=3.0)
    scene.edge("k", "rotational_spring", "ground", "B", stiffness=10.0, free_angle=0.2)
    result = scene.compile().simulate((0, 3), **TIGHT)
    assert set(result.states) & {"J1.theta", "J2.theta"} == {"J1.theta", "J2.theta"}
    # The inertia of both sides, seen from B: 1 + 9.
    np.testing.assert_allclose(result["J2.theta"], 0.2 + 0.5 * np.cos(result.t), **CLOSE)
    offset = result["J1.theta"] - 3 * result["J2.theta"]
    np.testing.assert_allclose(offset, 0.3 - 2.1, atol=1e-12)
