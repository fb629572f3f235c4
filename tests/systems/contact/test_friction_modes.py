"""Modes of dry friction where they are hard to choose: at limits, at zeros, in loops."""

from math import pi

import numpy as np
import pytest

import cotree

TIGHT = {"method": "dop853", "rtol": 1e-11, "atol": 1e-13}
CLOSE = 1e-9


def pushed(push, **friction):
    """Push a mass that rubs on the ground."""
    scene = cotree.Scene("pushed")
    scene.edge("M", "translational_mass", "ground", "A", mass=1.0)
    scene.edge("P", "force_source", "ground", "A", force=push)
    scene.edge("R", "translational_dry_friction", "ground", "A", **friction)
    return scene


def test_friction_that_is_less_at_rest_than_in_sliding_has_no_mode_between_the_two():
    scene = pushed("1.5*t", force=2.0, breakaway=1.0)
    told = "'R' have no consistent modes"
    with pytest.warns(RuntimeWarning, match=told):
        result = scene.compile().simulate((0, 2), **TIGHT)
    assert not result.success
    assert abs(result.t[-1] - 1 / 1.5) <= CLOSE


def test_a_force_that_touches_its_limit_moves_nothing():
    """A spring that swings pulls as much as friction holds, for one instant of each swing."""
    scene = cotree.Scene("touch")
    scene.parameter("x0", 1.0)
    scene.edge("J", "rotational_inertia", "ground", "a", inertia=0.5)
    scene.edge("K", "rotational_spring", "a", "b", stiffness=2.0, initial={"theta": "x0"})
    scene.edge("B", "rotational_inertia", "ground", "b", inertia=1.0)
    scene.edge("R", "rotational_dry_friction", "ground", "b", torque=2.0)
    model = scene.compile()
    result = model.simulate((0, 20), **TIGHT)
    assert result.success
    # It swings by cos(w t) with w = sqrt(k/J) = 2, and nothing of that is lost but errors of steps.
    swing = np.cos(2.0 * result.t)
    assert np.max(np.abs(result["K.theta"] - swing)) <= 1e-7
    # Just above it, the first swing moves the other end.
    assert model.simulate((0, 4), parameters={"x0": 1.001}, **TIGHT).events["R stops"].t.size


@pytest.mark.sampled(1)
@pytest.mark.parametrize("pressing", [0.0, "N", "-1 - t"])
def test_a_one_way_clutch_that_nothing_presses_together_runs_free_and_holds_at_rest(pressing):
    scene = cotree.Scene("freewheel")
    scene.parameter("N", 0.0)
    scene.edge("J", "rotational_inertia", "ground", "a", inertia=2.0)
    scene.edge("T", "torque_source", "ground", "a", torque="sin(t)")
    faces = {"normal_force": pressing, "friction": 0.5, "radius": 1.0}
    scene.edge("C", "one_way_clutch", "ground", "a", **faces)
    scene.output("held", "C.tau")
    result = scene.compile().simulate((0, 10), [1.0, 2 * pi, 8.0], **TIGHT)
    # It turns forwards by (1 - cos t)/2, stops after a turn of the torque, and goes on at once.
    assert np.max(np.abs(result["J.w"] - (1 - np.cos([1.0, 2 * pi, 8.0])) / 2)) <= CLOSE
    assert np.max(np.abs(result["held"])) <= CLOSE
    backwards = scene.compile().simulate((pi, 6), [4.0, 6.0], **TIGHT)
    assert np.max(np.abs(backwards["J.w"])) <= CLOSE
    assert np.max(np.abs(backwards["held"] - np.sin([4.0, 6.0]))) <= CLOSE


def test_elements_without_force_neither_chatter_nor_take_part():
    """Nine of ten have no limit at all, at the very place where the tenth holds."""
    scene = cotree.Scene("zeros")
    for i in range(10):
        scene.parameter(f"F{i}", 0.0 if i else 3.0)
        scene.edge(f"R{i}", "rotational_dry_friction", "ground", "a", torque=f"F{i}")
    faces = {"normal_force": "F1", "friction": 0.5, "radius": 1.0}
    scene.edge("C", "one_way_clutch", "ground", "a", **faces)
    scene.edge("J", "rotational_inertia", "ground", "a", inertia=1.0, initial={"w": 1.0})
    scene.edge("K", "rotational_spring", "ground", "a", stiffness=100.0, initial={"theta": 0.0})
    result = scene.compile().simulate((0, 20), **TIGHT)
    assert result.success
    # Forwards only: half a swing, pi/10 about -F/k, less the way to it and back.
    lead = np.arctan(3.0 / 100.0 * 10.0)
    assert abs(result.events["R0 stops"].t[0] - (pi / 2 - lead) / 10) <= CLOSE
    assert sum(len(row.t) for row in result.events.values()) <= 2
    assert np.max(np.abs(result["J.w"][result.t > 1])) <= CLOSE


def test_a_stored_point_at_a_breakpoint_has_the_modes_behind_it():
    scene = pushed("where(t < 1, 1, 5)", force=2.0)
    scene.output("force", "R.f")
    result = scene.compile().simulate((0, 2), [0.5, 1.0, 2.0], **TIGHT)
    assert np.max(np.abs(result["R.mode"] - [0.0, 1.0, 1.0])) <= 1e-14
    assert np.max(np.abs(result["force"] - [1.0, 2.0, 2.0])) <= CLOSE
    assert abs(result["M.v"][-1] - 3.0) <= CLOSE


def wedge(ratio):
    """Build two shafts with a lossy gear between them, and a clutch in parallel that closes."""
    scene = cotree.Scene("wedge")
    scene.parameter("r", ratio)
    for node, w in (("a", "r*2"), ("b", 2.0)):
        scene.edge(f"J{node}", "rotational_inertia", "ground", node, inertia=1.0, initial={"w": w})
    scene.edge("G", "lossy_gear", "a", "b", ratio="r", efficiency=0.8)
    faces = {"normal_force": "t - 1", "friction": 1.0, "radius": 1.0}
    scene.edge("C", "clutch", "a", "b", **faces)
    scene.output("speed", "a.w")
    return scene


def test_a_clutch_beside_a_gear_brings_both_shafts_to_rest():
    result = wedge(1.5).compile().simulate((0, 8), **TIGHT)
    assert result.success
    assert abs(result["speed"][-1]) <= CLOSE
    assert round(result["C.mode"][-1]) == 0


def test_a_clutch_beside_a_gear_of_ratio_one_is_named_where_losses_depend_on_it():
    with pytest.warns(RuntimeWarning, match="'C' would stick while a gear"):
        result = wedge(1.0).compile().simulate((0, 8), **TIGHT)
    assert abs(result.t[-1] - 1.0) <= CLOSE


def test_friction_around_a_closed_chain_holds_what_it_can():
    """Three shafts, each of which rubs at both others, one of them driven to and fro."""
    scene = cotree.Scene("ring")
    scene.parameter("T", 3.0)
    for node in "abc":
        scene.edge(f"J{node}", "rotational_inertia", "ground", node, inertia=1.0)
    for first, second in ("ab", "bc", "ca"):
        scene.edge(f"R{first}{second}", "rotational_dry_friction", first, second, torque=1.0)
    scene.edge("P", "torque_source", "ground", "a", torque="T*t")
    result = scene.compile(["T"]).simulate((0, 2), [0.9, 2.0], **TIGHT)
    # Shaft a passes on 2/3 of the torque, by way of two contacts that hold 1 each: they slip at
    # T t = 3. From there on both others are driven by 1, and a by the rest.
    assert np.max(np.abs([result[f"J{node}.w"][0] for node in "abc"] - np.full(3, 0.405))) <= CLOSE
    turned = 3.0 / 2 / 3
    assert abs(result["Jb.w"][1] - (turned + 1.0)) <= CLOSE
    assert abs(result["Ja.w"][1] - (turned + 3.0 * (4 - 1) / 2 - 2.0)) <= CLOSE
    # All slides from the same instant on, and b and c stay together.
    assert abs(result["Jb.w"][1] - result["Jc.w"][1]) <= CLOSE


def test_a_motion_far_below_atol_says_which_tolerance_finds_it():
    """A brake of 1e-15 N on a swing of 1e-15 m/s: rounding decides at an atol of 1e-10."""
    scene = cotree.Scene("tiny")
    scene.translational_mass("M", "ground", "x", mass=1.0, initial={"v": 1e-15})
    scene.translational_spring("k", "ground", "x", stiffness=1e4)
    scene.translational_brake("f", "x", "ground", normal_force=1e-15, friction=0.5)
    scene.force_source("e", "ground", "x", force=-1e-15)
    model = scene.compile()
    with pytest.warns(RuntimeWarning, match="never much larger than atol, give a smaller atol"):
        model.simulate((0, 100))
    fine = model.simulate((0, 100), atol=1e-18)
    assert fine.success
    # It comes to rest, to the tolerance.
    assert abs(fine["M.v"][-1]) <= 1e-18
