"""Linearisation and trim where dry friction has modes: in which, and what contradicts them."""

from __future__ import annotations

import numpy as np
import pytest

import cotree
from cotree.errors import SolveError

K, C, F = 40.0, 0.3, 2.0


def oscillator(s=0.03, v=0.0):
    scene = cotree.Scene("oscillator")
    scene.parameter("k", K)
    scene.input("u", 0.0)
    scene.edge("M", "translational_mass", "ground", "A", mass=1.0, initial={"v": v})
    scene.edge("K", "translational_spring", "ground", "A", stiffness="k", initial={"s": s})
    scene.edge("P", "force_source", "ground", "A", force="u")
    scene.edge("R", "translational_dry_friction", "ground", "A", force=F, damping=C)
    scene.output("force", "R.f")
    return scene.compile()


def belt(v=0.5):
    scene = cotree.Scene("belt")
    scene.edge("M", "translational_mass", "ground", "A", mass=1.0, initial={"v": v})
    scene.edge("K", "translational_spring", "ground", "A", stiffness=10.0)
    scene.edge("B", "velocity_source", "ground", "belt", velocity=0.5)
    scene.edge("R", "translational_dry_friction", "belt", "A", force=1.0, breakaway=1.6)
    return scene.compile()


def test_a_sliding_mass_is_linearised_in_its_mode_which_is_no_state():
    linear = oscillator(v=1.0).linearize(sensitivities=["k"])
    assert linear.states == ("M.v", "K.s")
    assert dict(linear.modes) == {"R.mode": 1.0}
    # v' = -k s - c v - F + u, all of it exact.
    assert linear.A.tolist() == [[-C, -K], [1.0, 0.0]]
    assert linear.B.tolist() == [[1.0], [0.0]]
    assert linear.C.tolist() == [[C, 0.0]]
    assert linear.sensitivity("k").A.tolist() == [[0.0, -1.0], [0.0, 0.0]]
    assert "in the modes R.mode = 1" in linear.summary()
    assert "R.mode = 1" in repr(linear)
    assert "R.mode = 1" in linear._repr_html_()


def test_deviations_of_all_states_have_none_in_modes():
    model = oscillator()
    linear = model.linearize(reduced=True)
    assert model.states == ("R.mode", "M.v", "K.s")
    assert linear.basis.tolist() == [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]


def test_where_it_sticks_nothing_accelerates_it_and_the_force_holds_what_there_is():
    linear = oscillator().linearize()
    assert dict(linear.modes) == {"R.mode": 0.0}
    assert np.abs(linear.A).tolist() == [[0.0, 0.0], [1.0, 0.0]]
    assert np.abs(linear.B).tolist() == [[0.0], [0.0]]
    assert linear.C.tolist() == [[0.0, -K]]
    assert linear.D.tolist() == [[1.0]]


@pytest.mark.parametrize(
    ("point", "why"),
    [
        ([0.0, 0.0, 0.47], "'R' sticks .* exceeds its limit by 16.8"),
        ([0.0, 0.5, 0.03], "'R' sticks .* its speed is 0.5"),
        ([-1.0, 0.5, 0.03], "'R' slides backwards .* its speed is 0.5"),
        ([0.5, 0.5, 0.03], "'R.mode' is 0.5 .* 0 means sticking"),
    ],
)
def test_a_point_that_contradicts_its_mode_is_refused(point, why):
    with pytest.raises(SolveError, match=why):
        oscillator().linearize(y=point)


def test_a_start_that_would_slip_is_refused_and_a_state_of_a_run_is_not():
    model = oscillator(s=0.47)
    with pytest.raises(SolveError, match=r"'R' sticks at this point .* a state of a run"):
        model.linearize()
    result = model.simulate((0, 0.1))
    assert dict(model.linearize(y=result.y[:, -1]).modes) == {"R.mode": -1.0}


def test_a_clutch_that_nothing_presses_together_is_linearised_as_free():
    scene = cotree.Scene("clutch")
    scene.parameter("N", -1.0)
    scene.edge("J", "rotational_inertia", "ground", "a", inertia=1.0, initial={"w": 1.0})
    scene.edge("B", "brake", "ground", "a", normal_force="N", friction=0.5, radius=1.0)
    model = scene.compile()
    assert dict(model.linearize().modes) == {"B.mode": 2.0}
    with pytest.raises(SolveError, match=r"'B' is disengaged .* its grip would be 0.5"):
        model.linearize(y=[2.0, 1.0], p={"N": 1.0})


def test_what_sticks_is_an_equilibrium_anywhere_within_its_limits():
    point = oscillator().trim(guess={"K.s": 0.04})
    assert point["K.s"] == pytest.approx(0.04, rel=1e-12)
    assert point["force"] == pytest.approx(-K * 0.04, rel=1e-12)
    assert not point.is_unique
    assert point["R.mode"] == 0.0
    with pytest.raises(SolveError, match=r"exceeds its limit by 16\.8"):
        oscillator(s=0.47).trim()


def test_a_block_on_a_belt_has_an_equilibrium_where_it_slides():
    # It begins with the speed of the belt, where it sticks; at rest it slides.
    for model in (belt(0.5), belt(0.1)):
        point = model.trim()
        assert point["K.s"] == pytest.approx(0.1, rel=1e-12)  # F/k
        assert point["R.mode"] == -1.0
        assert point.is_unique
        found = point.linearize().eigenvalues
        assert found == pytest.approx([1j * np.sqrt(10.0), -1j * np.sqrt(10.0)], rel=1e-12)
