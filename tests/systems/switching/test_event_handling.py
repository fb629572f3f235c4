"""Events where something is in the way: grazing, accumulation, chains, impulses, wrong scenes."""

import itertools
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import cotree
from cotree.errors import (
    ExpressionError,
    ModelError,
    ParameterError,
    SceneError,
    SolveError,
)

TIGHT = {"rtol": 1e-11, "atol": 1e-13}
METHODS = [
    *("cvode", "ida", "dop853", "dopri5", "rodas4", "rodas5"),
    pytest.param("rkf45", marks=pytest.mark.slow),
]


@pytest.fixture(params=METHODS)
def method(request):
    if request.param in ("cvode", "ida"):
        pytest.importorskip("sksundae")
    return request.param


@pytest.fixture(params=["dop853", "rodas5", "cvode", "ida"])
def loop(request):
    """The loop with every kind of engine."""
    if request.param in ("cvode", "ida"):
        pytest.importorskip("sksundae")
    return request.param


def rail(name="rail", gravity=-9.81, force=0.0, **initial):
    scene = cotree.Scene(name, gravity=[0, 0, gravity])
    scene.edge("j", "prismatic", "ground", "B", axis=[0, 0, 1], force=force, initial=initial)
    scene.edge("b", "rigid_body", "ground", "B", mass=1.0)
    return scene


def ball(**initial):
    scene = rail("ball", **initial)
    scene.parameter("e", 0.8)
    scene.event("hit", "j.s", direction=-1, set={"j.s_dot": "-e*j.s_dot"})
    return scene


@pytest.fixture(scope="module")
def ball_model():
    return ball(s=2.0).compile()


@pytest.mark.parametrize(("rtol", "e"), list(itertools.product([1e-5, 1e-8, 1e-11], [0.3, 0.8])))
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_bounces_without_end_stop_with_a_message(ball_model, method, rtol, e):
    result = ball_model.simulate(
        (0, 100), method=method, rtol=rtol, atol=rtol / 100, parameters={"e": e}
    )
    assert result.status == -1
    assert "'hit'" in result.message
    speed = np.sqrt(2 * 9.81 * 2.0)
    end = speed / 9.81 + 2 * speed * e / 9.81 / (1 - e)
    # Bounces whose height is below the tolerance are found at random; (100 rtol)^(1/2) is about
    # how long one of that height takes.
    assert abs(result.t[-1] - end) < 3 * np.sqrt(100 * rtol)
    assert np.min(result["j.s"]) > -1e-6


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_accumulation_is_foretold(ball_model, loop):
    message = ball_model.simulate((0, 100), method=loop, **TIGHT).message
    speed = np.sqrt(2 * 9.81 * 2.0)
    end = speed / 9.81 + 2 * speed * 0.8 / 9.81 / 0.2
    foretold = float(re.search(r"accumulates at t = (\S+):", message)[1])
    # Formulas of several steps gather an error of some thousand tolerances over forty restarts.
    assert foretold == pytest.approx(end, abs=2e-7 if loop in ("cvode", "ida") else 1e-8)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_start_on_the_ground(ball_model, method):
    def run(speed):
        initial = {"j.s": 0.0, "j.s_dot": speed}
        return ball_model.simulate((0, 0.5), [0.0, 0.5], method=method, initial=initial, **TIGHT)

    up, down, rest = run(3.0), run(-3.0), run(0.0)
    assert up.events["hit"].t.size == 0
    np.testing.assert_array_equal(down.events["hit"].t[:1], [0.0])
    assert down["j.s_dot"][0] == pytest.approx(2.4, abs=1e-15)
    np.testing.assert_allclose(down.events["hit"].t[1], 2 * 2.4 / 9.81, atol=1e-9)
    assert rest.status == -1
    assert "leaves no speed away from zero" in rest.message


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_grazing_contact_is_refused_where_there_are_sensitivities(method):
    scene = rail(s=0.0, s_dot="v")
    scene.parameter("v", np.sqrt(2 * 9.81))
    scene.event("ceiling", "1 - j.s", direction=-1, set={"j.s_dot": "-j.s_dot"})
    result = scene.compile(["v"]).simulate((0, 0.8), method=method)
    assert result.status == -1
    assert "event 'ceiling' grazes at t = 0.45152" in result.message
    assert scene.compile().simulate((0, 0.8), method=method).success


def test_two_crossings_within_a_step_are_not_lost(method):
    """A parabola 1e-4 deep below zero: steps of these methods are thousands of times as long."""
    scene = rail(gravity=-1.0, s=0.0, s_dot=1.0)
    scene.event("up", "j.s - 0.4999", direction=1)
    scene.event("down", "j.s - 0.4999", direction=-1)
    result = scene.compile().simulate((0, 3), method=method, **TIGHT)
    half = np.sqrt(2 * 1e-4)
    np.testing.assert_allclose(result.events["up"].t, [1 - half], atol=1e-9)
    np.testing.assert_allclose(result.events["down"].t, [1 + half], atol=1e-9)


def test_a_count_counts_each_crossing_once(method):
    scene = rail(gravity=0.0, force="-j.s", s=1.0)
    scene.mode("n", 0)
    scene.event("zero", "j.s", set={"n": "n + 1"})
    result = scene.compile().simulate((0, 20), method=method, **TIGHT)
    exact = np.pi * (np.arange(6) + 0.5)
    np.testing.assert_allclose(result.events["zero"].t, exact, atol=2e-9)
    assert result["n"][-1] == 6.0


def test_a_stop_ends_the_run(method):
    scene = rail(s=1.0)
    scene.event("ground", "j.s", direction=-1, stop=True)
    result = scene.compile().simulate((0, 5), [0.0, 0.2, 1.0], method=method, **TIGHT)
    assert result.success
    assert "event 'ground' ends the run" in result.message
    np.testing.assert_allclose(result.t, [0.0, 0.2, np.sqrt(2 / 9.81)], atol=1e-9)
    assert "Event 'ground' occurred 1 time, last at t = 0.4515236" in result.summary()


def test_one_event_makes_another_happen(loop):
    scene = rail(s=1.0)
    scene.mode("on", 0)
    scene.mode("n", 0)
    scene.parameter("g0", 0.0)
    scene.event("switched", "on - 0.5", direction=1, set={"n": "n + 1", "j.s_dot": "j.s_dot - g0"})
    scene.event("low", "j.s - 0.5", direction=-1, set={"on": 1})
    result = scene.compile(["g0"]).simulate((0, 0.4), method=loop, **TIGHT)
    time = np.sqrt(1 / 9.81)
    for event in ("low", "switched"):
        np.testing.assert_allclose(result.events[event].t, [time], atol=1e-12)
    assert result["n"][-1] == 1.0
    np.testing.assert_allclose(result.sensitivity("j.s", "g0")[-1], time - 0.4, atol=1e-12)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_events_that_make_each_other_happen_without_end_stop(loop):
    scene = rail(s=1.0)
    scene.mode("on", -1)
    scene.event("low", "j.s - 0.5", direction=-1, set={"on": 1})
    scene.event("flip", "on", direction=1, set={"on": -1})
    scene.event("flop", "on", direction=-1, set={"on": 1})
    result = scene.compile().simulate((0, 1), method=loop)
    assert "'flip', 'flop' trigger each other without end" in result.message


def test_what_lies_at_zero_has_passed_it(loop):
    """A ball that bounces comes up from below zero, if by nothing."""
    scene = ball(s=2.0)
    scene.mode("n", 0)
    scene.event("up", "j.s", direction=1, set={"n": "n + 1"})
    result = scene.compile(["e"]).simulate((0, 2), method=loop, **TIGHT)
    np.testing.assert_array_equal(result.events["up"].t, result.events["hit"].t)
    assert result["n"][-1] == 2.0
    np.testing.assert_array_equal(
        result.event_sensitivity("up", "e"), result.event_sensitivity("hit", "e")
    )


def test_the_first_of_two_that_turns_the_motion_round_is_enough(loop):
    scene = ball(s=2.0)
    scene.event("again", "2*j.s", direction=-1, set={"j.s_dot": "-e*j.s_dot"})
    result = scene.compile(["e"]).simulate((0, 1), method=loop, **TIGHT)
    assert [len(result.events[name].t) for name in ("hit", "again")] == [1, 0]
    assert result["j.s"][-1] > 0.0


def test_an_input_that_jumps_through_zero_makes_an_event_happen(method):
    scene = rail(gravity=0.0, s=0.0, s_dot="v")
    scene.parameter("v", 1.0)
    scene.input("gate", "sign(t - 0.3)")
    scene.event("open", "gate", direction=1, set={"j.s_dot": "2*v"})
    result = scene.compile(["v"]).simulate((0, 1), [0.0, 0.3, 1.0], method=method, **TIGHT)
    np.testing.assert_allclose(result.events["open"].t, [0.3], atol=1e-15)
    np.testing.assert_allclose(result["j.s_dot"], [1.0, 2.0, 2.0], atol=1e-12)
    np.testing.assert_allclose(result.sensitivity("j.s", "v")[-1], 1.7, atol=1e-9)
    np.testing.assert_array_equal(result.event_sensitivity("open", "v"), [0.0])


def test_a_moving_floor(loop):
    """A floor that rises evenly: seen from it the ball falls as onto one at rest, but faster."""
    scene = rail(s=1.0)
    scene.parameter("w", 0.5)
    scene.parameter("e", 0.8)
    scene.event("hit", "j.s - w*t", direction=-1, impact={"restitution": "e"})
    result = scene.compile(["w", "e"]).simulate((0, 0.6), method=loop, **TIGHT)

    def closed(w, e, end=0.6, g=9.81):
        t = (-w + (w * w + 2 * g) ** 0.5) / g
        speed = w + e * (g * t + w)  # the floor's, and e times that of the approach
        return w * t + speed * (end - t) - g / 2 * (end - t) ** 2, t

    position, time = closed(0.5, 0.8)
    np.testing.assert_allclose(result.events["hit"].t, [time], atol=1e-10)
    assert result["j.s"][-1] == pytest.approx(position, abs=1e-10)
    for name, shifted in (("w", (0.5 + 1e-30j, 0.8)), ("e", (0.5, 0.8 + 1e-30j))):
        slopes = np.imag(closed(*shifted)) / 1e-30
        assert result.sensitivity("j.s", name)[-1] == pytest.approx(slopes[0], abs=1e-10)
        assert result.event_sensitivity("hit", name)[0] == pytest.approx(slopes[1], abs=1e-10)


def chain(n, **event):
    """Return a chain of n links that falls from one side, as a separate model or with an event."""
    scene = cotree.Scene("chain", gravity=[0, "-g", 0])
    scene.parameter("g", 9.81)
    scene.parameter("e", 0.6)
    scene.parameter("L", 0.5)
    node = "ground"
    for i in range(n):
        start = {"theta": 0.8 * (i == 0)}
        scene.edge(f"h{i}", "revolute", node, f"A{i}", axis=[0, 0, 1], initial=start)
        scene.edge(f"r{i}", "arm", f"A{i}", f"B{i}", vector=[0, "-L", 0])
        scene.edge(f"b{i}", "rigid_body", "ground", f"B{i}", mass=1.0 + 0.2 * i, inertia=0.01)
        node = f"B{i}"
    scene.output("energy", "energy.kinetic")
    scene.event(
        "wall",
        f"B{n - 1}.x - 0.6*{n}*L*sin(0.8)",
        direction=-1,
        impact={"restitution": "e"},
        **event,
    )
    return scene


def five_points(run, value):
    """Differentiate by five points, whose error is about 1e-11 of the size of fifth derivatives."""
    step = 1e-3 * max(abs(value), 0.1)
    shifted = {k: run(value + k * step) for k in (-2, -1, 1, 2)}
    return (8 * (shifted[1] - shifted[-1]) - (shifted[2] - shifted[-2])) / (12 * step)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("n", [2, 3, 9])
def test_an_impulse_on_a_chain(n, loop):
    """The impulse acts along the gradient, through the mass matrix; of nine links, by the tree."""
    model = chain(n).compile()
    elastic = model.simulate((0, 0.8), method=loop, parameters={"e": 1.0}, **TIGHT)
    row = elastic.events["wall"]
    assert row.t.size
    t, before, after = row.t[0], row.y_before[:, 0], row.y_after[:, 0]
    energy = [model.output_values(t, y)[0] for y in (before, after)]
    assert energy[1] == pytest.approx(energy[0], rel=1e-11)  # elastic
    np.testing.assert_array_equal(before[:n], after[:n])
    # B.x = L (sin(h0) + sin(h0 + h1) + ...): its gradient by hand.
    angles = np.cumsum(before[:n])
    gradient = np.array([0.5 * np.sum(np.cos(angles[i:])) for i in range(n)])
    assert gradient @ after[n:] == pytest.approx(-(gradient @ before[n:]), rel=1e-10)
    # What M is, half the second derivatives of the energy say: M dv is along the gradient.
    units = np.eye(n)

    def kinetic(v):
        return model.output_values(t, np.concatenate([before[:n], v]))[0]

    mass = np.array([[kinetic(a + b) - kinetic(a) - kinetic(b) for a in units] for b in units])
    momentum = mass @ (after[n:] - before[n:])
    np.testing.assert_allclose(
        momentum, gradient * (momentum @ gradient) / (gradient @ gradient), atol=1e-10
    )


@pytest.mark.sampled(2)
@pytest.mark.parametrize("n", [2, 9])
def test_sensitivities_across_an_impulse_on_a_chain(n, loop):
    wanted = ["e", "g", "L", "h1.theta"]
    model = chain(n).compile(wanted)
    result = model.simulate((0, 0.8), method=loop, **TIGHT)
    plain = chain(n).compile()
    for name in wanted:

        def run(value, name=name):
            kind = "initial" if name in plain.states else "parameters"
            one = plain.simulate((0, 0.8), method=loop, **{kind: {name: value}}, **TIGHT)
            return np.concatenate([one.y[:, -1], one.events["wall"].t])

        if name in plain.states:
            value = plain.initial_state[plain.states.index(name)]
        else:
            value = plain.default_parameters[plain.parameters.index(name)]
        found = np.concatenate(
            [
                [result.sensitivity(s, name)[-1] for s in model.states],
                result.event_sensitivity("wall", name),
            ]
        )
        # Truncated at 1e-12 of derivatives that grow by the fourth power of some tens.
        np.testing.assert_allclose(found, five_points(run, value), rtol=3e-6, atol=3e-6)


class TestRandom:
    """Two masses, an input, a mode that holds a speed, a switch, an impact, of any sizes."""

    @staticmethod
    def scene(values):
        scene = cotree.Scene("hybrid", gravity=[0, 0, "-g"])
        for name, value in values.items():
            scene.parameter(name, value)
        scene.mode("held", 0)
        scene.mode("on", 1)
        scene.input("push", "a*sin(w*t)")
        force = "push - k*(j.s - 1) - c*on*j.s_dot + 0.2*held"
        start = {"s": "h", "s_dot": "v"}
        scene.edge("j", "prismatic", "ground", "B", axis=[0, 0, 1], force=force, initial=start)
        scene.edge("b", "rigid_body", "ground", "B", mass="m")
        scene.edge("h", "revolute", "B", "C", axis=[0, 1, 0], initial={"theta": 0.4})
        scene.edge("r", "arm", "C", "D", vector=[0, 0, "-l"])
        scene.edge("p", "rigid_body", "ground", "D", mass=0.3)
        scene.event("floor", "j.s", direction=-1, impact={"restitution": "e"})
        scene.event(
            "swing",
            "h.theta + 0.1*push + 0.05*j.s_dot",
            set={"held": "j.s_dot + w", "h.theta_dot": "0.9*h.theta_dot", "on": "1 - on"},
        )
        return scene

    @pytest.mark.sampled(1)
    @pytest.mark.filterwarnings("ignore::RuntimeWarning")
    @pytest.mark.parametrize("loop", ["dop853", "rodas5", "cvode", "ida"])
    @settings(max_examples=5)
    @given(st.integers(0, 10_000))
    def test_sensitivities_are_differences(self, loop, seed):
        rng = np.random.default_rng(seed)
        names = ["g", "a", "w", "k", "c", "h", "v", "m", "l", "e"]
        values = dict(zip(names, rng.uniform(0.5, 1.5, len(names)).tolist(), strict=True))
        values |= {"g": 9.81, "e": 0.3 + 0.5 * rng.random(), "k": 2.0}
        model = self.scene(values).compile(names)
        plain = model_without(self.scene)

        def run(used, method="dop853", **changed):
            given = {**values, **changed}
            return used.simulate((0, 1.5), method=method, parameters=given, **TIGHT)

        result = run(model, loop)
        if not result.success:  # an accumulation, or a crossing that may not take place
            return
        count = {name: len(row.t) for name, row in result.events.items()}
        for k, name in enumerate(names):
            step = 1e-5 * values[name]
            ends = [run(plain, **{name: values[name] + sign * step}) for sign in (1, -1)]
            if any({n: len(r.t) for n, r in end.events.items()} != count for end in ends):
                continue  # an event comes or goes
            slope = (ends[0].y[:, -1] - ends[1].y[:, -1]) / (2 * step)
            # Differences have an error of 1e-8 or so: that of the runs, below 1e-12 by dop853
            # (1e-10 by the methods of SUNDIALS), over the step of 1e-5, enlarged by slow
            # crossings; and the step squared times the third derivatives.
            scale = 1.0 + np.abs(slope).max()
            np.testing.assert_allclose(result.s[:, k, -1], slope, atol=1e-6 * scale, err_msg=name)
            for event, row in result.events.items():
                times = (ends[0].events[event].t - ends[1].events[event].t) / (2 * step)
                np.testing.assert_allclose(
                    row.s[k], times, atol=1e-6 * (1.0 + np.abs(times).max(initial=0.0))
                )


_PLAIN = {}


def model_without(scene):
    """Compile the random scene once without sensitivities; runs give its parameters."""
    if "plain" not in _PLAIN:
        names = ["g", "a", "w", "k", "c", "h", "v", "m", "l", "e"]
        _PLAIN["plain"] = scene(dict.fromkeys(names, 1.0)).compile()
    return _PLAIN["plain"]


WRONG = {
    "direction": ({"when": "j.s", "direction": 2}, "direction of event 'x' is 2: give -1"),
    "bool": ({"when": "j.s", "direction": True}, "direction of event 'x'"),
    "when": ({"when": "j.q"}, "edge 'j' has no variable 'q'"),
    "no expression": ({"when": "j.s +"}, "when of event 'x'"),
    "target": (
        {"when": "j.s", "set": {"j.v": 1}},
        "event 'x' sets 'j.v', which is neither a state nor",
    ),
    "parameter": (
        {"when": "j.s", "set": {"e": 1}},
        "event 'x' sets 'e', which is neither a state nor",
    ),
    "set": ({"when": "j.s", "set": [1]}, "set of event 'x' must be a table"),
    "value": ({"when": "j.s", "set": {"on": "q"}}, "'on' in set of event 'x': uses the unknown"),
    "stop": ({"when": "j.s", "stop": 1}, "stop of event 'x' must be true or false"),
    "impact": ({"when": "j.s", "impact": 0.5}, "impact of event 'x' must be a table"),
    "field": ({"when": "j.s", "impact": {"e": 1}}, "impact of event 'x' has no field 'e'"),
    "empty": ({"when": "j.s", "impact": {}}, "needs the field 'restitution'"),
    "speed": (
        {"when": "j.s_dot", "impact": {"restitution": 1}},
        "when of event 'x' depends on 'j.s_dot', but an impact needs an expression of positions",
    ),
    "force": ({"when": "j.fz", "impact": {"restitution": 1}}, "accelerations or reactions"),
    "time": ({"when": "t - 1", "impact": {"restitution": 1}}, "does not depend on any joint"),
    "both": (
        {"when": "j.s", "impact": {"restitution": 1}, "set": {"j.s_dot": 0}},
        "event 'x' sets 'j.s_dot', a speed, but its impact changes all speeds",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_events_are_refused_by_name(case):
    fields, message = WRONG[case]
    scene = ball(s=1.0)
    scene.mode("on", 1)

    def compile_it():
        scene.event("x", **fields)
        scene.compile()

    with pytest.raises(ModelError) as caught:
        compile_it()
    assert message in str(caught.value)


def test_an_algebraic_unknown_cannot_be_set():
    scene = cotree.Scene("relaxation")
    scene.edge("c", "capacitor", "a", "ground", capacitance=1.0, initial={"v": 1.0})
    scene.edge("R", "resistor", "a", "ground", resistance="1 + abs(R.i)")
    scene.event("x", "c.v - 0.5", set={"R.i": 0})
    with pytest.raises(SceneError, match=r"event 'x' sets 'R\.i', an algebraic unknown"):
        scene.compile()


def test_what_modes_may_not_be_used_in():
    scene = rail()
    scene.mode("on", 1)
    scene.input("u", "2*on")
    told = "uses 'on', but may depend on parameters and t only: let an output depend on modes"
    with pytest.raises(ExpressionError, match=told):
        scene.compile()
    scene = rail()
    scene.input("u", 1.0)
    scene.event("switch", "j.s", set={"u": "0"})
    with pytest.raises(SceneError, match=r"event 'switch' sets 'u', an input, .*: set a mode"):
        scene.compile()
    scene = rail()
    scene.mode("on", 1)
    for add in (scene.parameter, scene.input, scene.output, scene.mode):
        with pytest.raises(SceneError, match=r"the name of .* 'on' is taken"):
            add("on", 1.0)
    with pytest.raises(SceneError, match="already means something"):
        scene.mode("t", 1.0)


def test_what_runs_with_events_cannot_do(ball_model):
    with pytest.raises(SolveError, match="runs forwards only"):
        ball_model.simulate((1, 0))
    scene = rail(gravity=0.0, s=0.0, s_dot=1.0)
    scene.parameter("e", 1.0)
    scene.input("level", "t")
    scene.event("hit", "j.s - level - 1", set={"j.s_dot": "e"})
    with pytest.raises(ParameterError, match="input 'level' affects when an event occurs"):
        scene.compile(["e"]).simulate((0, 1), inputs={"level": 1.0})
    with pytest.raises(KeyError, match="There is no event 'hip'; did you mean 'hit'"):
        scene.compile(["e"]).simulate((0, 1)).event_sensitivity("hip", "e")


@pytest.mark.sampled(1)
def test_a_set_that_leaves_a_choice_has_no_sensitivities(loop):
    """Two bodies tied by a rod have three freedoms; one speed set leaves the others open."""
    scene = cotree.Scene("tied", gravity=[0, -9.81, 0])
    for i, place in (("1", 0.0), ("2", 1.0)):
        scene.edge(f"x{i}", "prismatic", "ground", f"X{i}", axis=[1, 0, 0], initial={"s": place})
        scene.edge(f"y{i}", "prismatic", f"X{i}", f"B{i}", axis=[0, 1, 0], initial={"s": 1.0})
        scene.edge(f"b{i}", "rigid_body", "ground", f"B{i}", mass=1.0)
    scene.edge("rod", "distance", "B1", "B2", length=1.0)
    scene.parameter("v", 1.0)
    scene.event("hit", "x1.s + y1.s - 0.5", direction=-1, set={"x1.s_dot": "v"})
    with pytest.warns(RuntimeWarning, match="sets fewer states than the constraints leave free"):
        result = scene.compile(["v"]).simulate((0, 1), method=loop)
    assert result.status == -1
    assert scene.compile().simulate((0, 0.5), method=loop).success


def test_scene_files_say_the_same(tmp_path):
    text = """
name = "ball"
gravity = [0, 0, -9.81]
[parameters]
e = 0.8
[modes]
n = { value = 0, doc = "bounces" }
[edges.j]
type = "prismatic"
nodes = ["ground", "B"]
axis = [0, 0, 1]
initial = { s = 2.0 }
[edges.b]
type = "rigid_body"
nodes = ["ground", "B"]
mass = 1.0
[events.hit]
when = "j.s"
direction = -1
set = { "j.s_dot" = "-e*j.s_dot", n = "n + 1" }
stop = false
"""
    path = tmp_path / "ball.toml"
    path.write_text(text)
    result = cotree.load(path).compile(["e"]).simulate((0, 2), method="dop853", **TIGHT)
    scene = ball(s=2.0)
    scene.mode("n", 0)
    again = scene.compile(["e"]).simulate((0, 2), method="dop853", **TIGHT)
    np.testing.assert_allclose(result["j.s"][-1], again["j.s"][-1], atol=1e-14)
    assert result["n"][-1] == len(result.events["hit"].t) == 2
    for wrong, message in (
        ("[events.x]\nwhere = 1", "event 'x' has no field 'where'; did you mean 'when'"),
        ("[events.x]\nstop = true", "event 'x' needs the field 'when'"),
        ("[modes.m]\nunit = 1", "mode 'm' has no field 'unit'"),
    ):
        path.write_text(f"{text}\n{wrong}\n")
        with pytest.raises(SceneError, match=message):
            cotree.load(path)


def test_the_shipped_ball_comes_to_rest(method):
    model = cotree.load("bouncing-ball").compile(["e", "h"])
    result = model.simulate(method=method, rtol=1e-10, atol=1e-12)
    speed, e = np.sqrt(2 * 9.81 * 2.0), 0.8
    n = int(np.ceil(np.log(0.5 / speed) / np.log(e)))  # the first that leaves less than 0.5 m/s
    end = (speed + 2 * speed * sum(e**k for k in range(1, n))) / 9.81
    assert result.success
    assert result["bounces"][-1] == n == len(result.events["hit"].t)
    np.testing.assert_allclose(result.events["hit"].t[-1], end, atol=1e-7)
    np.testing.assert_allclose(result.y[:2, -1], 0.0, atol=1e-9)
    slope = end / (2 * 2.0)  # times grow with the square root of the height
    np.testing.assert_allclose(result.event_sensitivity("hit", "h")[-1], slope, atol=1e-7)
    # Where it lies, nothing depends on how it came there.
    np.testing.assert_allclose(result.s[:2, :, -1], 0.0, atol=1e-7)


def test_crossings_that_only_time_decides_are_not_stepped_over(method):
    """Nothing else moves, so that only the sine's period, and the jumps of mod, bound the steps."""
    scene = rail(gravity=0.0, s=0.0)
    scene.mode("n", 0)
    scene.mode("k", 0)
    scene.input("wave", "sin(2*pi*3*t + 0.1)")
    scene.event("wave_up", "wave", direction=1, set={"n": "n + 1"})
    scene.event("tick", "mod(t, 0.25) - 0.2", direction=1, set={"k": "k + 1"})
    result = scene.compile().simulate((0, 10), method=method, **TIGHT)
    exact = np.arange(1, 31) / 3 - 0.1 / (6 * np.pi)
    np.testing.assert_allclose(result.events["wave_up"].t, exact, atol=1e-12)
    np.testing.assert_allclose(result.events["tick"].t, 0.25 * np.arange(40) + 0.2, atol=1e-12)
    assert (result["n"][-1], result["k"][-1]) == (30.0, 40.0)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_relay_that_chatters_stops_with_a_message(loop):
    """With friction against the motion, switched by its own speed, v = 0 is held by chatter."""
    scene = rail(gravity=0.0, force="-u", s=0.0, s_dot=1.0)
    scene.mode("u", 2)
    scene.event("back", "j.s_dot", direction=-1, set={"u": -2})
    scene.event("forth", "j.s_dot", direction=1, set={"u": 2})
    result = scene.compile().simulate((0, 1), method=loop)
    assert result.status == -1
    message = "events 'back', 'forth' trigger each other without end at t = 0.5: hold the"
    assert message in result.message
