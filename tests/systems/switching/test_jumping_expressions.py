"""Signs, floors, remainders and conditionals of states are located; sensitivities jump there."""

from __future__ import annotations

import math
import warnings

import mpmath
import numpy as np
import pytest

from cotree import Scene
from cotree.errors import FormulationError, SolveError

pytestmark = pytest.mark.compiler

TIGHT = {"rtol": 1e-10, "atol": 1e-12}
METHODS = ["dopri5", "dop853", "rodas5", "rodas4", "cvode", "ida"]


def _charged(voltage: str, capacitance: float | str = 1.0, **values: float) -> Scene:
    """A capacitor behind a resistor and a source."""
    scene = Scene("charged")
    for name, value in values.items():
        scene.parameter(name, value)
    scene.edge("V", "voltage_source", "a", "ground", voltage=voltage)
    scene.edge("R", "resistor", "a", "b", resistance="R")
    scene.edge("C", "capacitor", "b", "ground", capacitance=capacitance)
    return scene


def _slid(force: str, speed: float = 1.0, **values: float) -> Scene:
    """A mass of 1 kg under a force."""
    scene = Scene("slid")
    for name, value in values.items():
        scene.parameter(name, value)
    scene.edge("m", "translational_mass", "ground", "A", mass=1.0, initial={"v": speed})
    scene.edge("f", "force_source", "ground", "A", force=force)
    return scene


def _turned(torque: str, **values: float) -> Scene:
    """An inertia of 1 kg m2 at rest under a torque."""
    scene = Scene("turned")
    for name, value in values.items():
        scene.parameter(name, value)
    scene.edge("J", "rotational_inertia", "ground", "A", inertia=1.0)
    scene.edge("f", "torque_source", "ground", "A", torque=torque)
    return scene


def _along(end, values):
    """Differentiate a closed form by each of its arguments, to twenty digits."""
    with mpmath.workdps(40):
        return {
            name: float(mpmath.diff(lambda x, n=name: end(**{**values, n: x}), values[name]))
            for name in values
        }


def _agrees(scene, end, values, t_end, method, name="C.v"):
    result = scene.compile(list(values)).simulate((0, t_end), method=method, **TIGHT)
    # Methods of variable order err by some hundred tolerances over their first steps.
    assert result[name][-1] == pytest.approx(float(end(**values)), rel=1e-7)
    for parameter, expected in _along(end, values).items():
        found = result.sensitivity(name, parameter)[-1]
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-7), parameter
    return result


@pytest.mark.parametrize("method", METHODS)
def test_a_source_that_its_own_load_switches(method):
    def end(E, K, c, R):
        crossed = R * mpmath.log(E / (E - c))
        return E + K + (c - E - K) * mpmath.exp(-(2 - crossed) / R)

    values = {"E": 2.0, "K": 3.0, "c": 1.0, "R": 1.0}
    scene = _charged("E + K*(1 + sign(C.v - c))/2", **values)
    result = _agrees(scene, end, values, 2.0, method)
    jumps = result.events["sign(C.v - c) up"]
    assert jumps.t == pytest.approx([math.log(2.0)], rel=1e-8)
    assert result["sign(C.v - c)"][[0, -1]] == pytest.approx([-1.0, 1.0])
    # d t/dc of log(E/(E - c))
    assert result.event_sensitivity("sign(C.v - c) up", "c") == pytest.approx([1.0], rel=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_a_capacitance_that_jumps(method):
    def end(E, k, c, R):
        first, second = R * (1.5 - k), R * (1.5 + k)
        return E + (c - E) * mpmath.exp(-(2 - first * mpmath.log(E / (E - c))) / second)

    values = {"E": 2.0, "k": 0.5, "c": 1.0, "R": 1.0}
    _agrees(_charged("E", "1.5 + k*sign(C.v - c)", **values), end, values, 2.0, method)


@pytest.mark.parametrize("text", ["E + K*floor(C.v/c)", "E + K*(C.v - mod(C.v, c))/c"])
def test_steps_of_a_level(text):
    """C.v' = E + K n - C.v between n c and (n + 1) c, passed three times."""

    def end(E, K, c, R):
        t, v, n = mpmath.mpf(0), mpmath.mpf(0), 0
        while True:
            drive = E + K * n
            crossed = t + R * mpmath.log((drive - v) / (drive - (n + 1) * c))
            if crossed > 1:
                return drive + (v - drive) * mpmath.exp(-(1 - t) / R)
            t, v, n = crossed, (n + 1) * c, n + 1

    values = {"E": 2.0, "K": 0.4, "c": 0.43, "R": 1.1}
    result = _agrees(_charged(text, **values), end, values, 1.0, "auto")
    assert len(result.events["floor(C.v / c) up"].t) == 3
    assert not len(result.events["floor(C.v / c) down"].t)


def test_a_level_that_is_passed_down_again():
    """A swing s = 0.9 cos(w t) is counted in whole halves."""
    scene = Scene("count")
    scene.parameter("w", 1.3)
    scene.edge("m", "translational_mass", "ground", "A", mass=1.0)
    spring = {"stiffness": "w**2", "initial": {"s": 0.9}}
    scene.edge("s", "translational_spring", "ground", "A", **spring)
    scene.edge("I", "current_source", "ground", "b", current="floor(2*s.s)")
    scene.edge("C", "capacitor", "b", "ground", capacitance=1.0)
    result = scene.compile(["w"]).simulate((0, 4.0), **TIGHT)

    def end(w):
        # It is 1, 0, -1, -2 between the angles where 1.8 cos is 1, 0, -1, and back.
        turns = [mpmath.acos(level / mpmath.mpf("1.8")) for level in (1, 0, -1)]
        turns += [2 * mpmath.pi - turn for turn in reversed(turns)]
        levels, total, last = [1, 0, -1, -2, -1, 0, 1], mpmath.mpf(0), mpmath.mpf(0)
        for level, angle in zip(levels, [*turns, mpmath.inf], strict=True):
            upto = min(angle / w, mpmath.mpf(4))
            total += level * (upto - last)
            last = upto
        return total

    assert result["C.v"][-1] == pytest.approx(float(end(mpmath.mpf("1.3"))), rel=1e-8)
    expected = _along(end, {"w": mpmath.mpf("1.3")})["w"]
    assert result.sensitivity("C.v", "w")[-1] == pytest.approx(expected, rel=1e-7)


def test_conditions_of_states_and_time():
    """Charged by E within 0.2 < v <= c before t = 0.9, else by K."""

    def end(E, K, c, R):
        v, t = mpmath.mpf(0), mpmath.mpf(0)
        for drive, level in ((K, mpmath.mpf("0.2")), (E, c)):
            t += R * mpmath.log((drive - v) / (drive - level))
            v = level
        return K + (v - K) * mpmath.exp(-(2 - t) / R)

    values = {"E": 2.0, "K": 3.0, "c": 1.0, "R": 1.0}
    scene = _charged("where(0.2 < C.v <= c and t < 0.9, E, K)", **values)
    result = _agrees(scene, end, values, 2.0, "auto")
    assert set(result.events) == {
        f"{name} {way}" for name in ("0.2 < C.v", "C.v <= c") for way in ("up", "down")
    }


@pytest.mark.parametrize("method", ["dop853", "rodas5", "cvode"])
def test_dry_friction_swings_with_exact_sensitivities(method):
    """Half a turn after half a turn about a centre that the friction shifts."""

    def end(k, F):
        w = mpmath.sqrt(k)
        n = int(mpmath.floor(w * 8 / mpmath.pi))
        size = 1 - (2 * n + 1) * F / k
        return (-1) ** n * (size * mpmath.cos(w * 8 - n * mpmath.pi) + F / k)

    values = {"k": 1.7, "F": 0.02}
    scene = Scene("swing")
    for name, value in values.items():
        scene.parameter(name, value)
    scene.edge("m", "translational_mass", "ground", "A", mass=1.0)
    spring = {"stiffness": "k", "initial": {"s": 1.0}}
    scene.edge("s", "translational_spring", "ground", "A", **spring)
    scene.edge("f", "force_source", "ground", "A", force="-F*sign(m.v)")
    _agrees(scene, end, values, 8.0, method, "s.s")


@pytest.mark.parametrize("method", ["dop853", "rodas5", "cvode"])
@pytest.mark.parametrize("sensitivities", [[], ["F"]])
def test_what_sticks_stops_with_the_expression(method, sensitivities):
    model = _slid("-F*sign(m.v)", F=2.0).compile(sensitivities)
    with pytest.warns(RuntimeWarning, match=r"'sign\(m.v\) .*driven back to the jump"):
        result = model.simulate((0, 2.0), method=method, **TIGHT)
    assert result.status < 0
    assert result.t[-1] == pytest.approx(0.5, rel=1e-6)


@pytest.mark.parametrize("method", ["dop853", "rodas5"])
def test_what_rests_at_a_jump_stays_or_stops(method):
    rests = _slid("-F*sign(m.v)", 0.0, F=2.0).compile().simulate((0, 1.0), method=method)
    assert rests.status == 0
    assert not np.any(rests["m.v"])
    for force in ("5*t", "5*max(0, t - 0.4)", "5*t**3"):
        model = _slid(f"{force} - F*sign(m.v)", 0.0, F=2.0).compile()
        with pytest.warns(RuntimeWarning, match=r"'sign\(m.v\) up'.*driven back to the"):
            assert model.simulate((0, 1.0), method=method).status < 0
    # Nothing shows at the start that a force will act; later it is found to have done so.
    model = _slid("5*exp(-1/(1e-9 + t)**2) - F*sign(m.v)", 0.0, F=2.0).compile()
    with pytest.warns(RuntimeWarning, match=r"'sign\(m.v\) .* the jump"):
        assert model.simulate((0, 1.0), method=method).status < 0


@pytest.mark.parametrize("method", ["dop853", "rodas5"])
def test_what_rests_is_pushed_off_at_a_corner_of_a_force(method):
    """v = (5 - F) (t - d)."""
    scene = _slid("where(t >= d, 5, 0) - F*sign(m.v)", 0.0, F=2.0, d=1.0)
    result = scene.compile(["F", "d"]).simulate((0, 2.5), method=method, **TIGHT)
    assert result["m.v"][-1] == pytest.approx(4.5, rel=1e-9)
    assert result.sensitivity("m.v", "F")[-1] == pytest.approx(-1.5, rel=1e-9)
    assert result.sensitivity("m.v", "d")[-1] == pytest.approx(-3.0, rel=1e-9)


@pytest.mark.parametrize("method", ["dop853", "rodas5", "cvode"])
@pytest.mark.parametrize("begins", [0.0, 0.5])
@pytest.mark.parametrize(
    ("law", "push"),
    [
        ("where(J.theta >= 0, a, 2*a)", 0.3),
        ("where(J.theta > 0, a, 2*a)", 0.3),
        ("where(J.theta >= 0, -a, -2*a)", -0.6),
        ("where(J.theta > 0, -a, -2*a)", -0.6),
        # From one side alone: with the other branch it would stay.
        ("where(J.theta + mod(J.theta, 0.5) >= 0, a, 0)", 0.3),
    ],
)
def test_rest_on_a_jump_ends_on_the_side_that_it_is_pushed_to(law, push, begins, method):
    """theta = push (t - begins)^2/2, which is linear in a."""
    scene = _turned(f"where(t >= {begins}, 1, 0)*({law})", a=0.3)
    result = scene.compile(["a"]).simulate((0, 1), [0, 0.5, 1], method=method, **TIGHT)
    expected = 0.5 * push * (1.0 - begins) ** 2
    # Methods of variable order err by some hundred tolerances over their first steps.
    assert result["J.theta"][-1] == pytest.approx(expected, rel=1e-7)
    assert result.sensitivity("J.theta", "a")[-1] == pytest.approx(expected / 0.3, rel=1e-7)


@pytest.mark.parametrize("method", ["dop853", "rodas5"])
@pytest.mark.parametrize("sensitivities", [[], ["a"]])
@pytest.mark.parametrize("begins", [0.0, 0.5])
def test_rest_on_a_jump_that_pushes_back_from_either_side_stops(begins, sensitivities, method):
    scene = _turned(f"where(t >= {begins}, a, 0)*where(J.theta > 0, -1, 2)", a=0.3)
    with pytest.warns(RuntimeWarning, match=r"'J.theta > 0 up'.*driven back"):
        result = scene.compile(sensitivities).simulate((0, 1), method=method)
    assert result.t[-1] == pytest.approx(begins, abs=1e-9)


def test_rest_on_a_jump_that_grows_from_nothing_is_driven_back():
    """Both rates are zero at the start, and differ later: no kink."""
    scene = _charged("C.v + where(C.v > 0, -t, t)", R=1.0)
    with pytest.warns(RuntimeWarning, match=r"'C.v > 0 up'.*driven back"):
        result = scene.compile().simulate((0, 1))
    assert result.t[-1] == 0.0


def test_rest_on_a_jump_has_no_slope_by_where_it_is():
    model = _turned("where(J.theta >= d, 1, 2)", d=0.0).compile(["d"])
    with pytest.raises(SolveError, match=r"'J.theta >= d up' occurs exactly at the start.*'d'"):
        model.simulate((0, 1))


@pytest.mark.parametrize("method", ["dop853", "rodas5", "cvode"])
def test_a_jump_that_takes_the_rate_away_is_passed(method):
    """v = t up to 0.5, where v' jumps to zero and v'' to 1: v = t - 1 + exp(0.5 - t)."""
    scene = _charged("where(C.v < 0.5, 1, 0) + min(1, t)", R=1.0)
    result = scene.compile().simulate((0, 1), method=method, **TIGHT)
    # Methods of variable order err by some hundred tolerances over their first steps.
    assert result["C.v"][-1] == pytest.approx(math.exp(-0.5), rel=1e-7)


def test_jumps_within_jumps_at_the_start_have_slopes_where_nothing_moves_them():
    """None of them has a time that a parameter moves, so that their order does not matter."""
    model = _charged("E*(3 - floor(-2*(C.v + 0.9*sign(C.v)))/2)", E=2.0, R=1.0).compile(["E"])

    def end(voltage: float) -> float:
        return float(model.simulate((0, 1), parameters={"E": voltage}, **TIGHT)["C.v"][-1])

    found = model.simulate((0, 1), **TIGHT).sensitivity("C.v", "E")[-1]
    # Of runs to 1e-10, differences by 1e-4 are right to about 1e-6 and to the square of the step.
    assert found == pytest.approx((end(2.0001) - end(1.9999)) / 2e-4, rel=1e-5)


def test_a_start_on_a_jump_has_sensitivities_along_it_only():
    scene = _charged("E + K*sign(C.v)", E=2.0, K=1.0, R=1.0)
    result = scene.compile(["K", "R"]).simulate((0, 1.0), **TIGHT)
    assert result["C.v"][-1] == pytest.approx(3 * (1 - math.exp(-1)), rel=1e-9)
    assert result.sensitivity("C.v", "K")[-1] == pytest.approx(1 - math.exp(-1), rel=1e-8)
    with pytest.raises(SolveError, match=r"'sign\(C.v\) up' occurs exactly at the start.*'C.v'"):
        scene.compile(["C.v"]).simulate((0, 1.0))
    # A corner has one derivative.
    corner = _charged("E + K*C.v*sign(C.v)", E=2.0, K=0.5, R=1.0)
    result = corner.compile(["C.v"]).simulate((0, 1.0), **TIGHT)
    assert result.sensitivity("C.v", "C.v")[-1] == pytest.approx(math.exp(-0.5), rel=1e-8)


@pytest.mark.parametrize("method", ["auto", "rodas5"])
def test_jumps_at_once_that_come_apart_have_no_derivative(method):
    """At 1.5 both levels are passed: with c a little larger one comes later than the other."""
    scene = _charged("E + K*floor(C.v/c) + K*floor(C.v/0.3)", E=2.0, K=0.3, c=0.25, R=1.0)
    result = scene.compile(["E"]).simulate((0, 1.0), method=method, **TIGHT)
    assert result.status == 0  # they stay at once where E changes
    with pytest.warns(
        RuntimeWarning, match=r"'floor\(C.v / c\) up' and others jump simultaneously"
    ):
        scene.compile(["c"]).simulate((0, 1.0), method=method, **TIGHT)
    assert scene.compile().simulate((0, 1.0), method=method).status == 0


def test_a_jump_of_an_algebraic_unknown():
    """A divider of two diodes-like laws decides what charges C; against differences."""
    scene = Scene("divider")
    for name, value in {"E": 2.0, "c": 0.4, "R": 1.0}.items():
        scene.parameter(name, value)
    scene.edge("V", "voltage_source", "a", "ground", voltage="E*t")
    scene.edge("R1", "resistor", "a", "m", resistance="R")
    scene.edge("R2", "resistor", "m", "ground", resistance="1 + R2.i**2")
    scene.edge("I", "current_source", "ground", "b", current="1 + sign(R2.v - c)/2")
    scene.edge("C", "capacitor", "b", "ground", capacitance=1.0)
    model = scene.compile(["E", "c", "R"])
    result = model.simulate((0, 1.0), **TIGHT)
    for name, value in {"E": 2.0, "c": 0.4, "R": 1.0}.items():
        ends = [
            model.simulate((0, 1.0), parameters={name: value * (1 + h)}, **TIGHT)["C.v"][-1]
            for h in (1e-4, -1e-4)
        ]
        # The next term of a difference over 1e-4 is 1e-8 of the value.
        expected = (ends[0] - ends[1]) / (2e-4 * value)
        assert result.sensitivity("C.v", name)[-1] == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_a_sign_of_an_input():
    """A square wave from a sine: 1 V/s up and down again, with sensitivity to its frequency."""
    scene = Scene("square")
    scene.parameter("w", 4.0)
    scene.input("u", "sin(w*t)")
    scene.edge("I", "current_source", "ground", "b", current="sign(u) + sign(sin(w*t))/2")
    scene.edge("C", "capacitor", "b", "ground", capacitance=1.0)
    result = scene.compile(["w"]).simulate((0, 2.0), **TIGHT)
    # Up to pi/4 and pi/2, from there to 2: v = 1.5 (2 - pi/2) as w t = 8 lies beyond 2 pi.
    assert result["C.v"][-1] == pytest.approx(1.5 * (2 - math.pi / 2), rel=1e-9)
    assert result.sensitivity("C.v", "w")[-1] == pytest.approx(1.5 * math.pi / 8, rel=1e-8)


def test_an_event_that_looks_at_a_jump_happens_with_it():
    values = {"E": 2.0, "c": 1.0, "R": 1.0}
    scene = _charged("E - n", **values)
    scene.mode("n", 0.0)
    scene.event("passed", "sign(C.v - c)", direction=1, set={"n": "n + 5"})
    result = scene.compile(["c"]).simulate((0, 1.0), **TIGHT)
    assert result.events["passed"].t == pytest.approx([math.log(2.0)], rel=1e-9)
    assert result.event_sensitivity("passed", "c") == pytest.approx([1.0], rel=1e-8)


def test_a_mode_that_only_a_sign_looks_at_moves_sensitivities():
    """An expression that uses a mode has another rate after the mode has changed."""
    scene = _charged("E + 3*sign(n - 0.5)", E=2.0, c=0.5, R=1.0)
    scene.mode("n", 0.8)
    scene.event("passed", "C.v - c", direction=1, set={"n": 0})
    result = scene.compile(["c"]).simulate((0, 1.0), **TIGHT)
    # From 0 to c under 5 V, then under -1 V: d v/dc = 6/(5 - c) exp(-(1 - t)).
    crossed = math.log(5 / 4.5)
    expected = 6 / 4.5 * math.exp(-(1 - crossed))
    assert result.sensitivity("C.v", "c")[-1] == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize(
    "text",
    [
        "C.v*sign(C.v)",
        "sign(C.v - c)*sqrt(abs(C.v - c))",
        "where(C.v > c, C.v - c, 0)",
        "where(C.v < 0, 0, C.v*sqrt(C.v)) + where(C.v <= c, 0, (C.v - c)**0.7)",
        "where(C.v < 0, -C.v**2, where(C.v > 0.7, 1.4*C.v - 0.49, C.v**2))",
        "where(C.v < 0, c*C.v, c*(exp(C.v/0.3) - 1)) + abs(c)*where(E*C.v > 2*E, C.v - 2, 0)",
        "where(t < c, E, 0) + sign(t - 3*c) + floor(t/c) + mod(t, c)",
    ],
)
def test_corners_and_known_times_need_no_events(text):
    """Both values are one where such an expression has its corner, or its times are known."""
    model = _charged(f"E + c*({text})/9", E=2.0, c=1.0, R=1.0).compile(["c"])
    assert model.states == ("C.v",)


@pytest.mark.parametrize(
    "text",
    [
        "where(C.v > 0, where(E > 50, 1, C.v), 0)",
        "where(C.v > 0, where(E*C.v + R > 100, 1, 0), 0)",
        "where(C.v > c, 1e-9, 0) + C.v",
        "where(C.v > c, 1, C.v/abs(c))",
    ],
)
def test_branches_that_meet_for_some_values_only_are_events(text):
    model = _charged(f"E + c*({text})/9", E=2.0, c=1.0, R=1.0).compile(["c"])
    assert len(model.states) > 1


@pytest.mark.parametrize(
    "text",
    [
        "where(M.s < 0, k*(-M.s)**1.5, 0)",
        "where(M.s >= 0, 0, k*(-M.s)**1.5)",
        "where(M.s < 0, k*(-M.s)*sqrt(-M.s), 0)",
        "k*max(0, -M.s)**1.5",
    ],
)
def test_a_branch_without_a_value_beyond_its_corner_is_left_to_its_condition(text):
    """A Hertzian contact opens: no step is taken with the power of a negative number."""
    scene = Scene("hertz")
    scene.parameter("k", 1e4)
    scene.edge("M", "translational_mass", "ground", "A", mass=1.0, initial={"s": 0.1})
    scene.edge("W", "force_source", "ground", "A", force=-9.81)
    scene.edge("F", "force_source", "ground", "A", force=text)
    model = scene.compile()
    assert set(model.states) == {"M.s", "M.v"}
    for method in METHODS:
        result = model.simulate((0, 1), method=method, rtol=1e-9)
        # SciPy's DOP853 at 1e-11 and steps of 1 ms; a stiff impact amplifies errors a hundredfold.
        assert result["M.s"][-1] == pytest.approx(0.0537078019, abs=1e-6), method


def test_lost_modes_name_what_cannot_agree_at_a_start():
    scene = Scene("contrary")
    scene.edge("V", "voltage_source", "a", "ground", voltage=1.0)
    scene.edge("R1", "resistor", "a", "m", resistance="1 + R1.i**2")
    scene.edge("R2", "resistor", "m", "ground", resistance="where(m.v > 0.5, 0.1, 10)")
    scene.edge("C", "capacitor", "a", "b", capacitance=1.0)
    scene.edge("R3", "resistor", "b", "ground", resistance=1.0)
    with pytest.raises(
        SolveError, match=r"no values of 'm.v > 0.5'.* are consistent with the states"
    ):
        scene.compile().simulate((0, 1.0))


def test_the_scene_itself_stays_as_it_was_written():
    scene = _charged("E*sign(C.v - 1)", E=2.0, R=1.0)
    scene.compile()
    assert "mode" not in scene.summary()


def test_a_long_expression_has_a_short_name():
    text = " + ".join(["C.v*E"] * 30)
    scene = _charged(f"sign({text} - 1) + sign({text} - 2)", E=2.0, R=1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        names = scene.compile().states[:2]
    assert names[0].endswith("...")
    assert names[1] == f"{names[0]} (2)"
    assert max(map(len, names)) < 70


@pytest.mark.parametrize(
    ("voltage", "refused", "allowed"),
    [
        ("k*max(C2.v, 0)", ["k", "R", "C2.v"], []),
        ("max(k*sin(3*w*t), 0)", ["w", "k"], ["R"]),
    ],
)
def test_corners_whose_rate_is_needed_refuse_sensitivities_that_would_jump(
    voltage, refused, allowed
):
    scene = Scene("tied")
    for name in ("k", "w", "R"):
        scene.parameter(name, 0.8)
    scene.edge("V", "voltage_source", "a", "ground", voltage=voltage)
    scene.edge("C1", "capacitor", "a", "b", capacitance=0.5)
    scene.edge("R1", "resistor", "b", "ground", resistance="R")
    scene.edge("C2", "capacitor", "b", "ground", capacitance=0.5, initial={"v": -0.5})
    for name in refused:
        with pytest.raises(FormulationError, match=f"voltage of edge 'V' has a kink.*'{name}'"):
            scene.compile([name])
    assert scene.compile(allowed).simulate((0, 1.0)).status == 0


@pytest.mark.parametrize("method", ["dop853", "rodas5"])
def test_a_large_count_passes_each_number_once(method):
    """C v' = 2 a floor(v/a): straight between whole numbers, ever steeper down to -1573.

    The difference of v/a and its count has the rounding of these, not of its own size: what falls
    below a number must not seem to come back to it.
    """
    scene = Scene("runaway")
    scene.parameter("a", 0.3)
    scene.edge("C", "capacitor", "n", "ground", capacitance=1.0, initial={"v": -1.6})
    scene.edge("I", "current_source", "ground", "n", current="2*a*floor(C.v/a)")
    result = scene.compile(["a"]).simulate((0, 2.8), method=method, rtol=1e-12, atol=1e-12)
    assert result.success, result.message
    w, t, count = -1.6 / 0.3, 0.0, math.floor(-1.6 / 0.3)
    times = []
    while t + (w - count) / (-2.0 * count) < 2.8:
        t += (w - count) / (-2.0 * count)
        times.append(t)
        w, count = float(count), count - 1
    up, down = (result.events[f"floor(C.v / a) {way}"].t for way in ("up", "down"))
    assert len(up) == 0
    # Roundings of 1568 steps.
    np.testing.assert_allclose(down, times, rtol=0, atol=1e-12)
    end = 0.3 * (w + 2.0 * count * (2.8 - t))
    assert result["C.v"][-1] == pytest.approx(end, rel=1e-12)


def _cell(current: str = "where(load.v > Vmin, I, 0)", **values: float) -> Scene:
    """A cell whose load is cut off by its own voltage, which recovers then: neither holds."""
    scene = Scene("cell")
    for name, value in {"C": 1000.0, "I": 3.0, "Vmin": 3.6, **values}.items():
        scene.parameter(name, value)
    scene.edge("cell", "capacitor", "o", "ground", capacitance="C", initial={"v": 4.0})
    scene.edge("R", "resistor", "o", "p", resistance=0.1)
    scene.edge("load", "current_source", "p", "ground", current=current)
    return scene


def _cut(C, drawn):
    """When 4 - drawn t / C - drawn / 10 is 3.6."""
    return C * (0.4 - 0.1 * drawn) / drawn


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("sensitivities", [[], ["I"]])
def test_what_contradicts_its_own_condition_stops(method, sensitivities):
    model = _cell().compile(sensitivities)
    # Whether the value at the located time is beyond zero is a matter of rounding.
    rng = np.random.default_rng(1)
    for C, drawn in zip(10 ** rng.uniform(1, 4, 40), rng.uniform(0.5, 3.9, 40), strict=True):
        given = {"parameters": {"C": C, "I": drawn}, "method": method}
        with pytest.warns(RuntimeWarning, match=r"'load.v > Vmin up', 'load.v > Vmin down' at"):
            result = model.simulate((0, 2 * _cut(C, drawn)), **given)
        assert result.status == -1
        assert result.t[-1] == pytest.approx(_cut(C, drawn), rel=1e-5)


@pytest.mark.parametrize("method", ["dop853", "rodas5", "cvode"])
@pytest.mark.parametrize("coils", [("r1",), ("r2", "r1")])
def test_a_contradiction_that_changes_no_rate_stops(method, coils):
    """A relay shorts its own coil, or two do by turns, and no rate changes."""
    scene = Scene("relay")
    scene.edge("V", "voltage_source", "a", "ground", voltage="t")
    scene.edge("R", "resistor", "a", "c", resistance=1.0)
    scene.edge("C", "capacitor", "c", "ground", capacitance=1.0)
    # One closes above 1 V of the other, which then falls; of two, the second opens below 1 V.
    for i, coil in enumerate(coils, 1):
        off, on = (10.0, 0.1) if i == 1 else (0.1, 10.0)
        scene.edge(f"s{i}", "resistor", "a", f"n{i}", resistance=1.0)
        law = f"where({coil}.v > 1, {on}, {off})"
        scene.edge(f"r{i}", "resistor", f"n{i}", "ground", resistance=law)
    with pytest.warns(RuntimeWarning, match=r"'r1.v > 1 up'"):
        result = scene.compile().simulate((0, 3), method=method)
    assert result.status == -1
    assert result.t[-1] == pytest.approx(1.1, rel=1e-9)  # 10/11 of the voltage are 1 V


def test_members_of_ensembles_stop_where_a_jump_contradicts_itself():
    rng = np.random.default_rng(2)
    members = {"C": 10 ** rng.uniform(1, 3, 100), "I": rng.uniform(0.5, 3.9, 100)}
    last = _cut(members["C"], members["I"])
    with pytest.warns(RuntimeWarning, match="50 of 100 members failed"):
        data = _cell().compile().ensemble((0, float(np.median(last))), members)
    assert np.array_equal(data.status < 0, last < np.median(last))


@pytest.mark.parametrize("sensitivities", [[], ["I"]])
@pytest.mark.parametrize("method", ["dop853", "rodas5", "cvode"])
def test_a_jump_contradicts_itself_once_something_else_happens(method, sensitivities):
    """At 4.5 A the load is beyond its condition at once: from a time on, or from an event on."""
    timed = _cell("where(load.v > Vmin, I*where(t >= 1, 1.5, 1), 0)")
    staged = _cell("where(load.v > Vmin, I*stage, 0)")
    staged.mode("stage", 1.0)
    staged.event("more", when="cell.v - 3.99", direction=-1, set={"stage": "1.5"})
    for scene, expected in ((timed, 1.0), (staged, 10 / 3)):
        with pytest.warns(RuntimeWarning, match=r": 'load.v > Vmin up', 'load.v > Vmin down' at"):
            result = scene.compile(sensitivities).simulate((0, 20), method=method)
        assert result.t[-1] == pytest.approx(expected, rel=1e-9)


def test_a_jump_that_contradicts_itself_at_the_start_is_refused():
    with pytest.raises(SolveError, match=r"no values of 'load.v > Vmin' are consistent"):
        _cell(I=4.5).compile()


@pytest.mark.parametrize("kind", ["ModelExchange", "CoSimulation"])
def test_fmus_stop_where_a_jump_contradicts_itself(tmp_path, kind):
    fmpy = pytest.importorskip("fmpy")
    model, path = _cell().compile(), tmp_path / "cell.fmu"
    model.export_fmu(path)
    rng = np.random.default_rng(3)
    for C, drawn in zip(10 ** rng.uniform(1, 2, 8), rng.uniform(0.5, 3.9, 8), strict=True):
        with pytest.raises(fmpy.fmi1.FMICallException):
            fmpy.simulate_fmu(
                str(path),
                fmi_type=kind,
                stop_time=2 * _cut(C, drawn),
                start_values={"C": C, "I": drawn},
                logger=lambda *_: None,
            )


@pytest.mark.parametrize("rtol", [1e-8, 1e-10, 1e-11])
def test_a_table_in_a_condition_does_not_hide_when_it_changes(rtol):
    """The time of a jump whose condition has a table of a state moves with a parameter."""
    scene = Scene("switch")
    scene.parameter("d", 0.1)
    scene.table("curve", [-1.0, 0.0, 0.7, 2.0], [0.3, -0.2, 0.5, 0.1])
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0, initial={"v": -0.9})
    scene.edge("I", "current_source", "ground", "a", current="1 + where(curve(C.v) - d > 0, 1, 0)")
    result = scene.compile(["d"]).simulate((0.0, 1.5), rtol=rtol)
    # The table falls through 0.1 at v = -0.6 and rises through it at v = 0.3. Until then v grows by
    # 2 in a second, then by 1, then by 2; the rises are -0.5 and 1 in a unit of v.
    v = 0.3 + 2.0 * (1.5 - 0.15 - 0.9)
    assert result["C.v"][-1] == pytest.approx(v, rel=1e-7)
    # With v1 and v2 there: t1 = (v1 + 0.9)/2, t2 = t1 + v2 - v1, v = v2 + 2 (1.5 - t2).
    v1, v2 = -2.0, 1.0  # slopes by d of where it jumps
    t2 = 0.5 * v1 + v2 - v1
    assert result.sensitivity("C.v", "d")[-1] == pytest.approx(v2 - 2.0 * t2, rel=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_jumps_on_one_surface_have_sensitivities_whatever_their_order(method):
    """v' = -(a + q floor(2 v + 1.5 [v < 0.5])) from 1: -(a + q), from 0.5 on -(a + 2 q)."""
    scene = Scene("nested")
    scene.parameter("a", 0.2)
    scene.parameter("q", 0.3)
    scene.edge("C", "capacitor", "n", "ground", capacitance=1.0, initial={"v": 0.999})
    law = "a + q*floor(2*C.v + 1.5*where(C.v < 0.5, 1, 0))"
    scene.edge("I", "current_source", "n", "ground", current=law)
    result = scene.compile(["q"]).simulate((0, 1.2), method=method, **TIGHT)
    assert result.status == 0, result.message
    t1 = 0.499 / 0.5
    # A hundred tolerances: multistep methods begin anew at the jump.
    assert result["C.v"][-1] == pytest.approx(0.5 - 0.8 * (1.2 - t1), abs=1e-8)
    slope = -2.0 * (1.2 - t1) - 0.8 * 0.499 / 0.25
    assert result.sensitivity("C.v", "q")[-1] == pytest.approx(slope, abs=1e-7)
