"""Optimal designs against closed forms, and error messages for invalid input."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest

import cotree

pytestmark = pytest.mark.compiler

M, K = 1.5, 60.0


@pytest.fixture(scope="module")
def scene():
    scene = cotree.Scene("damper")
    scene.parameter("c", 3.0, unit="N s/m")
    scene.parameter("k", K, unit="N/m")
    scene.parameter("idle", 1.0)
    joint = {"axis": [1, 0, 0], "stiffness": "k", "damping": "c", "initial": {"s": 1.0}}
    scene.edge("j", "prismatic", "ground", "A", **joint)
    scene.edge("body", "rigid_body", "ground", "A", mass=M)
    return scene


@pytest.mark.parametrize("method", ["slsqp", "trust-constr"])
def test_the_integral_of_the_square_is_minimal_at_half_the_critical_damping(scene, method):
    over = {"c": (1, 50, "log")}
    found = cotree.optimise(scene, "integral(j.s**2)", over, t_span=(0, 40), method=method)
    # The objective is flat at its minimum: a relative error of 2e-5 changes it by only 2e-10.
    assert found["c"] == pytest.approx(math.sqrt(K * M), rel=2e-5)
    assert found.success
    assert found.message.startswith("Converged")
    assert found.result.success
    assert "Objective" in found.summary()


def test_a_constraint_on_a_minimum_over_time_holds_with_equality(scene):
    over = {"c": (0.5, 15)}
    found = cotree.optimise(scene, "c", over, "minimum(j.s) >= -0.1", t_span=(0, 4))
    # A mass released from rest overshoots by exp(-pi zeta / sqrt(1 - zeta^2)).
    ratio = math.log(10) / math.hypot(math.pi, math.log(10))
    assert found["c"] == pytest.approx(2 * ratio * math.sqrt(K * M), rel=1e-5)
    assert "'minimum(j.s) >= -0.1' holds with equality" in found.message


def test_several_parameters_share_a_budget(scene):
    goals = ["c + k <= 60", "0 <= integral(j.s**2) <= 3"]
    over = {"c": (1, 50), "k": (10, 100)}
    found = cotree.optimise(scene.compile(), "integral(j.s**2)", over, goals, t_span=(0, 40))
    # Scan of the closed form (zeta + 1/(4 zeta))/w = (c/k + m/c)/2 along c = 60 - k.
    c = np.linspace(5, 12, 700001)
    best = c[np.argmin(c / (60 - c) + M / c)]
    # Near its minimum the scan is flat too: its position is exact to the root of rounding only.
    assert found["c"] == pytest.approx(best, rel=2e-5)
    assert [row.is_active for row in found.conditions] == [True, False, False]


def test_initial_values_and_values_at_given_times(scene):
    over = {"j.s_dot": (-30, 30), "j.s": (-2, 2)}
    goals = ["start(j.s) == 0.5", "at(0.1, j.s) == 0.7"]
    found = cotree.optimise(scene, "(c - 3)**2 + mean(j.s)**2", over, goals, t_span=(0, 0.1))
    assert found["j.s"] == pytest.approx(0.5, abs=1e-9)
    # x = e^(-a t) (x0 cos w t + (v0 + a x0)/w sin w t).
    a = 3.0 / (2 * M)
    w = math.sqrt(K / M - a * a)
    v = w * (0.7 * math.exp(0.1 * a) - 0.5 * math.cos(0.1 * w)) / math.sin(0.1 * w) - 0.5 * a
    assert found["j.s_dot"] == pytest.approx(v, rel=1e-6)


def test_scenarios_are_averaged_and_constraints_hold_in_each(scene):
    runs = [{"initial": {"j.s": x}} for x in (1.0, 2.0)]
    found = cotree.optimise(
        scene, "c", {"c": (0.5, 15)}, "minimum(j.s) >= -0.1", t_span=(0, 4), runs=runs
    )
    ratio = math.log(20) / math.hypot(math.pi, math.log(20))
    assert found["c"] == pytest.approx(2 * ratio * math.sqrt(K * M), rel=1e-5)
    assert len(found.results) == 2
    assert [row.is_active for row in found.conditions] == [False, True]


def test_times_of_events_are_differentiated():
    scene = cotree.Scene("ball", gravity=[0, -10.0, 0])
    scene.parameter("h", 1.0)
    scene.edge("j", "prismatic", "ground", "A", axis=[0, 1, 0], initial={"s": "h"})
    scene.edge("b", "rigid_body", "ground", "A", mass=1.0)
    scene.event("floor", "j.s", direction=-1, stop=True)
    found = cotree.optimise(scene, "(time(floor) - 0.6)**2", {"h": (0.5, 5)}, t_span=(0, 2))
    assert found["h"] == pytest.approx(1.8, rel=1e-5)
    with pytest.raises(cotree.SolveError, match="an event ends the run"):
        cotree.optimise(scene, "end(j.s_dot)", {"h": (0.5, 5)}, t_span=(0, 2))


def test_trial_points_whose_run_fails_are_rejected(scene):
    # The logarithm is undefined beyond c = 5, where the first steps lead.
    goal = "-c - 0.1*log(5 - c) + 0*end(j.s)"
    found = cotree.optimise(scene, goal, {"c": (1, 100)}, t_span=(0, 1))
    assert found["c"] == pytest.approx(4.9, rel=1e-5)
    assert any(row.reason for row in found.history)
    assert "rejected because their run failed" in found.message


def test_more_starts_find_the_global_minimum(scene):
    goal = "cos(c) + 0.1*c"
    one = cotree.optimise(scene, goal, {"c": (0, 20)}, guess={"c": 16.0})
    several = cotree.optimise(scene, goal, {"c": (0, 20)}, guess={"c": 16.0}, starts=6, seed=1)
    assert several.objective < one.objective - 0.5
    assert several["c"] == pytest.approx(math.pi - math.asin(0.1), rel=1e-4)
    assert len(several.starts) == 6
    # Without an upper bound the starts extend to twice the guess.
    open_above = cotree.optimise(
        scene, goal, {"c": (0, math.inf)}, guess={"c": 16.0}, starts=6, seed=1
    )
    assert len(set(open_above.starts)) > 1
    assert open_above.objective < one.objective - 0.5


def test_infeasible_constraints_are_named(scene):
    found = cotree.optimise(scene, "integral(j.s**2)", {"c": (1, 2)}, ["c >= 3"], t_span=(0, 1))
    assert not found.success
    assert "No feasible point was found" in found.message
    assert "'c >= 3' is violated by 1 at the best point" in found.message


@pytest.mark.parametrize(
    ("minimise", "over", "more", "sentence"),
    [
        ("j.s", {"q": (1, 2)}, {}, "over names 'q', which is not a parameter"),
        ("j.s", {"c": (2, 1)}, {}, "the lower one must be below the upper one"),
        ("j.s", {"c": (1, 1, 1, 1)}, {}, r"give \(lower, upper\)"),
        ("j.s", {"c": (-1, 2, "log")}, {}, "bounds must not be negative"),
        ("j.s", {"idle": (1, 2)}, {}, "nothing depends on 'idle'"),
        ("k", {"c": (1, 2)}, {}, "the objective does not change with 'c'"),
        ("end(j.q)", {"c": (1, 2)}, {}, "'j.q' in a goal: edge 'j' has no variable 'q'"),
        ("sign(j.s)", {"c": (1, 2)}, {}, "use it inside integral"),
        ("end(floor(j.s))", {"c": (1, 2)}, {}, r"floor is discontinuous, so end\(...\) of it"),
        ("endd(j.s)", {"c": (1, 2)}, {}, "did you mean 'end'"),
        ("j.s <= 1", {"c": (1, 2)}, {}, "constraints belong in subject_to"),
        ("c", {"c": (1, 2)}, {"subject_to": ["c"]}, "is not a comparison"),
        ("at(9, j.s)", {"c": (1, 2)}, {}, "is outside the run"),
        ("at(k, j.s)", {"c": (1, 2)}, {}, "must be a number"),
        ("mean(end(j.s))", {"c": (1, 2)}, {}, "is nested inside mean"),
        ("time(bump)", {"c": (1, 2)}, {}, "the scene has no event 'bump'"),
        ("c.__class__", {"c": (1, 2)}, {}, "in a goal"),
        ("__import__('os')", {"c": (1, 2)}, {}, "calls '__import__', which is unknown"),
        ("c", {"c": (1, 2)}, {"guess": {"c": 3.0}}, "outside its bounds"),
        ("c", {"c": (1, 2)}, {"method": "newton"}, "give 'slsqp' or 'trust-constr'"),
        ("c", {"c": (1, 2)}, {"solver": "dop835"}, "^There is no method 'dop835'; did you mean"),
        ("c", {"c": (1, 2)}, {"solver": 3}, "^method is 3: give a name in quotes"),
        ("c", {"c": (1, 2)}, {"rtol": -1}, "^rtol is -1.0; give a positive finite number"),
        ("c", {"c": (1, 2)}, {"max_step": -1}, "^max_step is -1.0; give positive seconds"),
        ("c", {"c": (1, 2)}, {"runs": []}, "runs is empty"),
        ("c", {"c": (1, 2)}, {"runs": 3}, "runs is 3: give a list of mappings"),
        ("c", {"c": (1, 2)}, {"runs": [{"t_span": (1, 0)}]}, "the end must be later"),
        ("c", {"c": (1, 2)}, {"runs": [{"initial": 3}]}, "initial of run 1 is 3"),
        ("c", {"c": (1, 2)}, {"subject_to": 3}, "subject_to is 3: give a list of conditions"),
        ("c", {"c": (1, 2)}, {"guess": 3}, "guess is 3: give a mapping"),
        ("c", {"c": (1, 2)}, {"tolerance": -1}, "tolerance is -1: give a positive number"),
        ("c", {"c": (1, 2)}, {"max_iterations": 0}, "max_iterations is 0: give a whole number"),
        ("c", {"c": (1, 2)}, {"starts": 3, "seed": -1}, "seed is -1: give a whole number"),
        ("integral(j.q**2)", {"c": (1, 2)}, {}, r"'j.q \*\* 2' in a goal uses 'j.q', which is no"),
    ],
)
def test_wrong_input_gets_one_sentence(scene, minimise, over, more, sentence):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(cotree.Error, match=sentence) as caught:
            cotree.optimise(scene, minimise, over, t_span=(0, 1), **more)
    assert "\n" not in str(caught.value)
    assert "goal0" not in str(caught.value)


def bounded_search(n, **more):
    """Search for six forces on a mass that lead it to rest at 1 m, with at most n iterations."""
    described = cotree.Scene("pushed")
    forces = [f"u{i}" for i in range(6)]
    for i, name in enumerate(forces):
        described.parameter(name, 3.0 * math.cos(i))
    described.table("push", np.linspace(0, 2, 6).tolist(), forces)
    described.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], force="push(t)", damping=0.1)
    described.edge("body", "rigid_body", "ground", "A", mass=1.0)
    described.output("force", "push(t)")
    goal = "1000*(j.s - 1)**2 + 1000*j.s_dot**2 + integral(force**2)"
    over = {name: (-25, 25) for name in forces}
    return cotree.optimise(described, goal, over, t_span=(0, 2), max_iterations=n, **more)


@pytest.mark.parametrize("method", ["slsqp", "trust-constr"])
def test_a_search_that_ends_at_its_limit_names_the_limit_and_what_it_missed(method):
    short = bounded_search(3, method=method)
    assert not short.success
    assert "max_iterations = 3" in short.message
    assert f"{short.optimality:.1e}" in short.message
    assert short.optimality > 1e-4
    full = bounded_search(400, method=method)
    assert full.success
    assert full.message.startswith("Converged")
    assert full.objective < short.objective
    assert full.violation == 0.0


def test_constraints_are_met_relative_to_their_size():
    """A bound of nanovolts is violated by half, which is less than 1e-6 in its own unit."""
    scene = cotree.Scene("small")
    scene.parameter("I", 1e-9)
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0)
    scene.edge("S", "current_source", "ground", "a", current="I")
    over = {"I": (2e-9, 4e-9)}
    missed = cotree.optimise(scene, "I*1e9", over, ["C.v <= 1e-9"], t_span=(0, 1))
    assert not missed.success
    # The least voltage within the bounds is 2 nV, to the tolerance of the run.
    assert missed.violation == pytest.approx(1e-9, rel=1e-5)
    met = cotree.optimise(scene, "I*1e9", over, ["C.v >= 3e-9"], t_span=(0, 1))
    assert met.success
    assert met["I"] == pytest.approx(3e-9, rel=1e-5)


def test_the_maximum_of_a_constant_is_that_constant(scene):
    found = cotree.optimise(scene, "maximum(c + 0*j.s) + 1/c", {"c": (0.5, 5)}, t_span=(0, 1))
    assert found["c"] == pytest.approx(1.0, rel=1e-4)
