"""Events with each engine: the same by two methods, in every respect that a user sees."""

from __future__ import annotations

import warnings

import loop_with_network
import numpy as np
import pytest
from hard_scenes import bennett_loop

from cotree import Scene
from cotree.errors import SolveError
from cotree.methods import METHODS

pytestmark = pytest.mark.compiler

TIGHT = {"rtol": 1e-11, "atol": 1e-12}

IN_C = ["dopri5", "rkf45", "dop853", "rodas4", "rodas5", "cvode", "ida"]


@pytest.fixture(params=IN_C)
def in_c(request):
    if request.param in ("cvode", "ida"):
        pytest.importorskip("sksundae")
    return request.param


def rail(gravity=-9.81, force=0.0, **initial):
    scene = Scene("rail", gravity=[0, 0, gravity])
    scene.edge("j", "prismatic", "ground", "B", axis=[0, 0, 1], force=force, initial=initial)
    scene.edge("b", "rigid_body", "ground", "B", mass=1.0)
    return scene


def ball():
    scene = rail(s=2.0)
    scene.parameter("e", 0.8)
    scene.event("hit", "j.s", direction=-1, set={"j.s_dot": "-e*j.s_dot"})
    return scene


def four_bar(**close):
    """Draw a loop whose crank is turned back at an angle, and whose coupler strikes a wall."""
    scene = loop_with_network.four_bar("c", "m", {"damping": 0.1}, **close)
    for name, value in {"c": 1.2, "m": 1.1, "e": 0.7}.items():
        scene.parameter(name, value)
    return scene


def agree(model, t_end, times=21, most=1e-8, method="dop853", other="", **settings):
    """Run with a method and with one of another kind, and compare everything."""
    other = other or ("rodas5" if method == "dop853" else "dop853")
    times = None if times is None else np.linspace(0, t_end, times)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ours = model.simulate((0, t_end), times, method, **TIGHT, **settings)
        theirs = model.simulate((0, t_end), times, other, **TIGHT, **settings)
    assert "was used instead" not in ours.message + theirs.message
    assert ours.status == theirs.status
    assert ours.message.partition(":")[2] == theirs.message.partition(":")[2]
    for name, row in theirs.events.items():
        found = ours.events[name]
        assert len(found.t) == len(row.t), name
        for key in ("t", "y_before", "y_after", "s"):
            np.testing.assert_allclose(getattr(found, key), getattr(row, key), atol=most, rtol=most)
    if times is not None:
        np.testing.assert_allclose(ours.t, theirs.t, atol=1e-10)
        for key in ("y", "s", "output_values", "output_sensitivities"):
            np.testing.assert_allclose(
                getattr(ours, key), getattr(theirs, key), atol=most, rtol=most
            )
    return ours


# One of each kind that runs in C, with what it is to agree to at a tolerance of 1e-11: formulas of
# several steps gather errors of hundreds of steps.
KINDS = [("dop853", 1e-8), ("rodas5", 1e-8), ("cvode", 1e-6), ("ida", 1e-6)]


@pytest.fixture(params=KINDS, ids=[kind for kind, _ in KINDS])
def kind(request):
    if request.param[0] in ("cvode", "ida"):
        pytest.importorskip("sksundae")
    return dict(zip(("method", "most"), request.param, strict=True))


@pytest.mark.sampled(2)
def test_a_loop_whose_crank_is_turned_back(kind):
    scene = four_bar()
    scene.mode("n", 0)
    back = {"crank.theta_dot": "-e*crank.theta_dot", "n": "n + 1"}
    scene.event("back", "crank.theta - 0.4", direction=-1, set=back)
    result = agree(scene.compile(["a", "m", "e"]), 2.0, **kind)
    assert len(result.events["back"].t) == 1
    assert result.drift.worst < 1e-13


@pytest.mark.sampled(1)
def test_positions_that_are_set_in_a_loop(kind):
    scene = four_bar()
    scene.event("back", "crank.theta - 0.3", direction=-1, set={"crank.theta": "crank.theta + 0.4"})
    result = agree(scene.compile(), 2.0, **kind)
    assert len(result.events["back"].t) == 5
    # The other angles follow: the least step closes the loop.
    assert result.drift.worst < 1e-13
    # With sensitivities the speeds are a choice.
    result = agree(scene.compile(["a"]), 2.0, **kind)
    assert "sets fewer states than the constraints leave free" in result.message


@pytest.mark.sampled(1)
@pytest.mark.parametrize("method", ["dop853", "cvode", "ida"])
def test_a_loop_that_is_redundant(method):
    if method != "dop853":
        pytest.importorskip("sksundae")
    scene = bennett_loop()
    back = {"j0.theta_dot": "-0.8*j0.theta_dot"}
    scene.event("back", "j0.theta - 2", direction=1, set=back)
    # Stages of rodas5 are off constraints that depend on each other.
    result = agree(scene.compile(), 1.0, most=1e-8, method=method, other="dopri5")
    assert len(result.events["back"].t) == 1
    # Rounding, enlarged where the loop lies flat.
    assert result.drift.worst < 1e-12


@pytest.mark.sampled(1)
def test_a_wall_in_the_way_of_a_loop(kind):
    scene = four_bar()
    scene.event("wall", "D.x - 1.1", impact={"restitution": "e"})
    result = agree(scene.compile(["a", "c", "e"]), 2.0, **kind)
    assert len(result.events["wall"].t) == 1


@pytest.mark.sampled(1)
@pytest.mark.parametrize("loop", ["dop853", "rodas5", "cvode", "ida"])
def test_an_initial_rate_of_a_chord_is_not_given_again_by_an_event(loop):
    scene = four_bar(initial={"theta_dot": -1.0})
    scene.mode("n", 0)
    scene.event("tick", "t - 0.5", direction=1, set={"n": "n + 1"})
    model = scene.compile(["m"])
    assert model.kernels.layout.start_rows == ("close.theta_dot",)
    result = model.simulate((0, 1), [0.5, 1.0], loop, **TIGHT)
    row = result.events["tick"]
    speed = model.states.index("crank.theta_dot")
    assert row.y_after[speed, 0] == pytest.approx(row.y_before[speed, 0], abs=1e-12)
    plain = four_bar(initial={"theta_dot": -1.0}).compile(["m"])
    without = plain.simulate((0, 1), [0.5, 1.0], "dop853", **TIGHT)
    # The tolerance, enlarged a hundred times by the motion.
    np.testing.assert_allclose(result["crank.theta"], without["crank.theta"], atol=1e-9)
    found = result.sensitivity("crank.theta", "m")
    np.testing.assert_allclose(found, without.sensitivity("crank.theta", "m"), atol=1e-8)


def test_more_happens_than_there_is_room_for_at_first():
    scene = rail(gravity=0.0, force="-400*j.s", s=1.0)
    scene.mode("n", 0)
    scene.event("zero", "j.s", set={"n": "n + 1"})
    result = scene.compile().simulate((0, 100), [100.0], "dop853", 1e-11, 1e-13)
    exact = np.pi / 20 * (np.arange(637) + 0.5)
    # Phases are off by the tolerance of each of twenty thousand steps.
    np.testing.assert_allclose(result.events["zero"].t, exact, atol=1e-8)
    assert result["n"].tolist() == [637.0]


def relaxation():
    """Draw a capacitor that discharges through k r i, and is charged where the current is low."""
    scene = Scene("relaxation")
    scene.parameter("r", 1.5)
    scene.mode("k", 1)
    scene.edge("c", "capacitor", "a", "ground", capacitance=2.0, initial={"v": 4.0})
    scene.edge("R", "resistor", "a", "ground", resistance="k*r*abs(R.i)")
    scene.event("low", "R.i - 0.5", direction=-1, set={"c.v": "4*k", "k": "3 - k"})
    return scene


@pytest.mark.parametrize("scene", [ball, relaxation])
def test_nothing_stands_in(in_c, scene):
    model = scene().compile(["e" if scene is ball else "r"])
    result = model.simulate((0, 2), [2.0], in_c)
    assert result.statistics.method == in_c
    assert result.message == f"{in_c} reached t = 2."


def test_every_step_and_every_event_is_a_point(in_c):
    result = ball().compile().simulate((0, 2), None, in_c, 1e-8, 1e-10)
    assert np.all(np.diff(result.t) > 0.0)
    for t, after in zip(result.events["hit"].t, result.events["hit"].y_after.T, strict=True):
        place = np.flatnonzero(result.t == t)
        assert place.size == 1
        np.testing.assert_array_equal(result.y[:, place[0]], after)
    assert result.t[-1] == 2.0


@pytest.mark.sampled(2)
@pytest.mark.parametrize("times", [None, [0.0, 0.3, 1.0]])
@pytest.mark.parametrize("loop", ["dop853", "rodas5", "cvode", "ida"])
def test_what_jumps_at_a_breakpoint_is_stored_once(loop, times):
    scene = rail(gravity=0.0, s=0.0, s_dot="v")
    scene.parameter("v", 1.0)
    scene.input("gate", "sign(t - 0.3)")
    scene.event("open", "gate", direction=1, set={"j.s_dot": "2*v"})
    result = scene.compile(["v"]).simulate((0, 1), times, loop, **TIGHT)
    assert np.all(np.diff(result.t) > 0.0)
    assert result["j.s_dot"][result.t == 0.3].tolist() == [2.0]


def test_inputs_that_are_replaced(kind):
    scene = rail(gravity=0.0, force="push", s=0.0)
    scene.input("push", 0.0)
    scene.mode("n", 0)
    scene.event("half", "j.s - 0.5", direction=1, set={"j.s": "0", "n": "n + push"})
    table = ([0.0, 1.0, 2.0], [0.0, 3.0, 1.0])
    result = agree(scene.compile(), 3.0, inputs={"push": table}, **kind)
    assert len(result.events["half"].t) >= 3
    assert result["n"][-1] > 3.0


@pytest.mark.sampled(2)
@pytest.mark.parametrize("scene", [rail, relaxation])
def test_a_stop_at_the_start(in_c, scene):
    drawn = scene()
    drawn.event("now", "t", direction=1, stop=True)
    for times in (None, [0.0, 1.0], [1.0]):
        result = drawn.compile().simulate((0, 1), times, in_c)
        assert result.success
        assert "event 'now' ends the run" in result.message
        assert result.t.tolist() == [0.0]
        assert result.events["now"].t.tolist() == [0.0]


@pytest.mark.sampled(12)
@pytest.mark.parametrize("scene", [rail, relaxation])
def test_an_event_a_few_roundings_before_the_end(in_c, scene):
    drawn = scene()
    drawn.mode("n", 0)
    drawn.event("late", "t - 0.999999999999998", direction=1, set={"n": "n + 1"})
    for times in (None, [1.0]):
        result = drawn.compile().simulate((0.9, 1), times, in_c)
        assert result.success
        np.testing.assert_allclose(result.events["late"].t, [1.0 - 2e-15], atol=3e-16)
        assert result.t[-1] == 1.0
        assert result["n"][-1] == 1.0


@pytest.mark.parametrize("method", ["dopri5", "rodas5"])
def test_budgets_leave_what_happened(method):
    model = ball().compile()
    with pytest.warns(RuntimeWarning, match="the limit of 9 steps is reached"):
        result = model.simulate((0, 2), [2.0], method, max_steps=9)
    assert result.status == -2
    assert len(result.events["hit"].t) >= 1
    assert result.t[-1] >= result.events["hit"].t[-1]


@pytest.mark.parametrize("loop", ["dop853", "rodas5", "cvode", "ida"])
def test_a_budget_of_events(loop):
    model = ball().compile()
    with pytest.warns(RuntimeWarning, match=r"t = 1.66023.*: the limit of 2 events is reached"):
        result = model.simulate((0, 5), [1.0, 5.0], loop, max_events=2)
    assert result.status == -2
    assert len(result.events["hit"].t) == 2
    # What the last event leaves is the last good point.
    assert result.t.tolist() == [1.0, result.events["hit"].t[1]]
    np.testing.assert_array_equal(result.y[:, -1], result.events["hit"].y_after[:, -1])
    assert model.simulate((0, 2), [2.0], loop, max_events=3).success
    with pytest.raises(SolveError, match="max_events is -1; give a positive number"):
        model.simulate((0, 2), [2.0], loop, max_events=-1)


def endless():
    scene = rail(s=1.0)
    scene.mode("on", -1)
    scene.event("low", "j.s - 0.5", direction=-1, set={"on": 1})
    scene.event("flip", "on", direction=1, set={"on": -1})
    scene.event("flop", "on", direction=-1, set={"on": 1})
    return scene


def undefined():
    scene = rail(s=1.0)
    scene.event("root", "sqrt(j.s - 0.5)", direction=-1)
    return scene


def overflow():
    scene = rail(s=1.0)
    scene.event("low", "j.s - 0.5", direction=-1, set={"j.s": "log(0.4 - j.s)"})
    return scene


def chatter():
    scene = rail(gravity=0.0, force="-u", s=0.0, s_dot=1.0)
    scene.mode("u", 2)
    scene.event("back", "j.s_dot", direction=-1, set={"u": -2})
    scene.event("forth", "j.s_dot", direction=1, set={"u": 2})
    return scene


def contradiction():
    scene = four_bar()
    everything = {f"{name}.theta": 0.0 for name in ("crank", "coupler", "rocker")}
    scene.event("low", "crank.theta - 0.4", direction=-1, set=everything)
    return scene


@pytest.mark.sampled(2)
@pytest.mark.parametrize("scene", [endless, undefined, overflow, chatter])
def test_what_ends_a_run_is_said_in_the_same_words(scene, kind):
    # The last good point is where a step ended, which are not the same.
    result = agree(scene().compile(), 20.0, times=None, most=1e-6, method=kind["method"])
    assert result.status == -1


@pytest.mark.parametrize("method", ["dop853", "rodas5"])
def test_bounces_end_at_the_same_one(method):
    # Of formulas of several steps the errors decide which one is the last.
    assert agree(ball().compile(), 20.0, times=None, most=1e-6, method=method).status == -1


@pytest.mark.sampled(2)
def test_what_contradicts_the_constraints_is_named(in_c):
    with pytest.warns(RuntimeWarning, match=r"'low' contradict the constraints, '.*' first"):
        result = contradiction().compile().simulate((0, 2), [2.0], in_c)
    assert result.statistics.method == in_c


@pytest.mark.parametrize("method", ["RK45", "RK23", "DOP853", "Radau", "BDF", "LSODA"])
def test_scipys_methods_name_those_that_take_events(method):
    with pytest.raises(SolveError) as caught:
        ball().compile().simulate((0, 2), method=method)
    said = str(caught.value)
    assert f"'{method}' cannot take events, such as 'hit'" in said
    assert f"use '{METHODS[method].instead}'" in said


def test_a_stop_between_outputs():
    scene = rail(s=1.0)
    scene.event("ground", "j.s", direction=-1, stop=True)
    result = agree(scene.compile(), 5.0, times=51)
    assert result.t[-1] == pytest.approx(np.sqrt(2 / 9.81), abs=1e-11)
    assert result["j.s"][-1] == pytest.approx(0.0, abs=1e-11)


def test_auto_takes_c():
    result = ball().compile(["e"]).simulate((0, 2))
    assert result.statistics.method == "dop853"
    assert "was used instead" not in result.message


@pytest.mark.parametrize("method", ["dopri5", "dop853", "rodas5"])
def test_points_before_a_kink_at_the_end_of_a_step_are_on_its_first_branch(method):
    """Steps of 50 us end at 2 ms, within rounding of the kink, up to which nothing drives."""
    scene = Scene("half_waves")
    scene.edge("V", "voltage_source", "a", "ground", voltage="max(2*sin(1000*pi*t), 0)")
    scene.edge("R", "resistor", "a", "b", resistance=1e3)
    scene.edge("C", "capacitor", "b", "ground", capacitance=1e-6)
    times = np.linspace(1.0, 2.0, 101)  # ms, the time constant
    run = scene.compile().simulate(
        (0, 3e-3), times * 1e-3, method=method, rtol=1e-8, atol=1e-11, max_step=5e-5
    )
    # v' = 2 sin(pi t) - v up to 1 ms, then v' = -v.
    begin = 2.0 * np.pi * (1.0 + np.exp(-1.0)) / (1.0 + np.pi**2)
    # The second branch would change the last points by 0.02.
    np.testing.assert_allclose(run["C.v"], begin * np.exp(1.0 - times), rtol=0, atol=1e-8)
