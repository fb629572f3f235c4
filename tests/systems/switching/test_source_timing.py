"""Sensitivities to when sources begin, rise, fall and repeat: those of states jump at corners.

Closed forms, and extrapolated central differences, whose error is that of their runs over the step:
with runs at 1e-11 and a step of 1e-4 some 1e-7.
"""

from __future__ import annotations

import numpy as np
import pytest
from readme_linkage import four_bar

import cotree
from cotree.errors import SolveError

pytestmark = pytest.mark.compiler

OWN = ("dopri5", "rkf45", "dop853", "rodas4", "rodas5")
OTHERS = ("cvode", "ida")
TIGHT = {"rtol": 1e-10, "atol": 1e-12}

#: Milliseconds, kiloohms and microfarads: units that belong together.
TIMING = {"delay": 1.0, "rise": 0.4, "width": 0.5, "fall": 0.3, "period": 1.7}


def _loop(**fields):
    """A source and two capacitors, a loop without resistance; a resistor beside one of them."""
    scene = cotree.Scene("loop")
    for name, value in TIMING.items():
        scene.parameter(name, value)
    pulse = {name: name for name in TIMING} | fields
    scene.edge("V", "pulse_voltage", "a", "ground", high=5.0, **pulse)
    scene.edge("C1", "capacitor", "a", "b", capacitance=0.5)
    scene.edge("C2", "capacitor", "b", "ground", capacitance=0.25)
    scene.edge("R", "resistor", "b", "ground", resistance=1.0)
    return scene


def _loop_voltage(t, delay, rise, width, fall, period):
    """C1's voltage: the source's, less what each change of its slope leaves on C2."""
    found = 0.0
    for k in range(5):
        begin = delay + k * period
        up, down = 5.0 / rise, -5.0 / fall
        corners = [
            (begin, up),
            (begin + rise, -up),
            (begin + rise + width, down),
            (begin + rise + width + fall, -down),
        ]
        for at, change in corners:
            if np.real(at) < t:
                left = 0.5 * (1.0 - np.exp((at - t) / 0.75))
                found += change * ((t - at) - left)
    return found


def _exact(name, t):
    """The derivative of the same, by a complex step: exact to rounding."""
    values = dict(TIMING)
    values[name] = values[name] + 1e-30j
    return np.imag(_loop_voltage(t, **values)) / 1e-30


@pytest.fixture(scope="module")
def loop():
    return _loop().compile(list(TIMING))


@pytest.mark.parametrize("method", OWN + OTHERS)
def test_a_loop_of_capacitors_with_a_pulse(loop, method):
    t = np.linspace(0.0, 5.0, 21)[1:] + 0.013  # between corners
    result = loop.simulate((0, 6), t_eval=t, method=method, **TIGHT)
    assert result.status == 0
    assert "was used instead" not in result.message
    # Multistep methods begin anew at every corner: some hundred local errors of 1e-10 add up.
    scale = 1e-7 if method in OTHERS else 2e-9
    expected = [_loop_voltage(at, **TIMING) for at in t]
    assert result["C1.v"] == pytest.approx(expected, abs=scale)
    for name in TIMING:
        exact = [_exact(name, at) for at in t]
        assert result.sensitivity("C1.v", name) == pytest.approx(exact, abs=50 * scale), name


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", ["RK45", "RK23", "DOP853", "Radau", "BDF", "LSODA"])
def test_scipys_methods_name_others(loop, method):
    with pytest.raises(SolveError, match=rf"'{method}' cannot take sensitivities.*in C"):
        loop.simulate((0, 6), method=method)


def test_what_is_kept_at_a_corner_is_what_holds_behind_it(loop):
    for method in ("dop853", "rodas5", "cvode"):
        steps = loop.simulate((0, 1.2), method=method, **TIGHT)
        i = int(np.flatnonzero(steps.t == 1.0)[0])
        # The source's slope of 12.5 V/ms begins there; two thirds of it charge C2.
        behind = -12.5 + 12.5 * 0.5 / 0.75
        assert steps.sensitivity("C1.v", "delay")[i] == pytest.approx(behind, rel=1e-9)


def test_backwards_in_time(loop):
    there = loop.simulate((0, 2.1), method="dop853", **TIGHT)
    start = {"C1.v": there["C1.v"][-1]}
    back = loop.simulate((2.1, 0.5), initial=start, method="dop853", **TIGHT)
    # Held at 2.1 ms, the voltage before the pulse is off by what the delay changes there, which
    # then grows backwards as it decays forwards.
    expected = -_exact("delay", 2.1) * np.exp((2.1 - 0.5) / 0.75)
    assert back.sensitivity("C1.v", "delay")[-1] == pytest.approx(expected, rel=1e-7)


def _difference(scene_of, values, name, what, t, h=1e-4):
    """Extrapolate central differences of two steps: what is left is of fourth order in them."""
    model = scene_of().compile([])

    def end(value):
        settings = {"method": "dop853", "rtol": 1e-11, "atol": 1e-13}
        return model.simulate((0, t), parameters={name: value}, **settings)[what][-1]

    near, far = (
        (end(values[name] + step) - end(values[name] - step)) / (2.0 * step)
        for step in (h, 2.0 * h)
    )
    return (4.0 * near - far) / 3.0


#: Waveforms of t, d and P, some of which jump.
WAVEFORMS = [
    "5*(1 + sign(t - d))/2",
    "floor(t/P - 0.3*d)",
    "mod(t - 0.5*d, P)",
    "abs(t - d)",
    "min(t, d) - max(0, t - 2*P)",
    "max(0, 1 - abs(t - d)/P)",
    "sign(t - d)*sign(t - P)",
    {"of": "t - d", "x": [-0.5, 0, 0.5, 0.7], "y": [0, 1, -1, 2]},
]


@pytest.mark.sampled(3)
@pytest.mark.parametrize("waveform", WAVEFORMS, ids=str)
@pytest.mark.parametrize("method", ["dopri5", "rodas5", "ida"])
def test_waveforms_with_corners_and_jumps(waveform, method):
    values = {"d": 1.0, "P": 0.7}

    def scene_of():
        scene = cotree.Scene("filter")
        for name, value in values.items():
            scene.parameter(name, value)
        scene.edge("V", "voltage_source", "a", "ground", voltage=waveform)
        scene.edge("R", "resistor", "a", "b", resistance=1.0)
        scene.edge("C", "capacitor", "b", "ground", capacitance=0.8)
        return scene

    asked = ["d", "P"] if "P" in str(waveform) else ["d"]
    result = scene_of().compile(asked).simulate((0, 1.777), method=method, **TIGHT)
    for name in asked:
        by_difference = _difference(scene_of, values, name, "C.v", 1.777)
        found = result.sensitivity("C.v", name)[-1]
        assert found == pytest.approx(by_difference, abs=1e-6), name


def _delayed_sine():
    scene = cotree.Scene("delayed")
    scene.parameter("d", 0.6)
    scene.edge(
        "V", "sine_voltage", "a", "ground", amplitude=2.0, frequency=0.4, phase=0.5, delay="d"
    )
    scene.edge("C1", "capacitor", "a", "b", capacitance=0.5)
    scene.edge("C2", "capacitor", "b", "ground", capacitance=0.25)
    scene.edge("R", "resistor", "b", "ground", resistance=1.0)
    return scene


def _inductors():
    scene = cotree.Scene("cutset")
    scene.parameter("d", 0.6)
    scene.edge("I", "pulse_current", "ground", "a", high=2.0, delay="d", rise=0.3, width=0.4)
    scene.edge("L1", "inductor", "a", "b", inductance=0.5)
    scene.edge("R1", "resistor", "a", "ground", resistance=2.0)
    scene.edge("L2", "inductor", "b", "ground", inductance=0.25)
    scene.edge("R2", "resistor", "b", "ground", resistance=1.0)
    scene.edge("J", "pulse_current", "ground", "b", high=1.0, delay="d/2", rise=0.3, width=0.4)
    return scene


def _cutset():
    """Two inductors in series with a source of current: one of them has no state."""
    scene = cotree.Scene("series")
    scene.parameter("d", 0.6)
    scene.edge("I", "pulse_current", "ground", "a", high=2.0, delay="d", rise=0.3, width=0.4)
    scene.edge("L1", "inductor", "a", "ground", inductance=0.5)
    scene.edge("L2", "inductor", "a", "b", inductance=0.25)
    scene.edge("R2", "resistor", "b", "ground", resistance=1.0)
    return scene


def _with_a_diode():
    """Algebraic unknowns beside the loop."""
    scene = _delayed_sine()
    scene.edge("D", "diode", "b", "c", saturation_current=1e-6, thermal_voltage=0.1)
    scene.edge("R3", "resistor", "c", "ground", resistance=0.5)
    return scene


def _lifted():
    """A pendulum on a support that is moved: its acceleration has corners."""
    scene = cotree.Scene("lifted", gravity=[0, -9.81, 0])
    scene.parameter("d", 0.6)
    scene.edge("lift", "prismatic", "ground", "A", axis=[1, 0, 0], motion="max(0, t - d)**2")
    scene.edge("h", "revolute", "A", "B", axis=[0, 0, 1], initial={"theta": 0.3})
    scene.edge("rod", "arm", "B", "C", vector=[0, -0.7, 0])
    scene.edge("bob", "rigid_body", "ground", "C", mass=0.6, inertia=0.01)
    return scene


def _driven():
    """A loop that is held by multipliers, with a torque that jumps."""
    torque = "4*(1 + sign(t - d))"
    scene = four_bar("driven", initial={"theta": 1.5}, torque=torque)
    scene.parameter("d", 0.6)
    return scene


SYSTEMS = {
    "sine": (_delayed_sine, "C1.v"),
    "inductors": (_inductors, "L1.i"),
    "cutset": (_cutset, "L2.i"),
    "diode": (_with_a_diode, "C1.v"),
    "lifted": (_lifted, "h.theta"),
    "driven": (_driven, "a.theta"),
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("system", SYSTEMS)
def test_systems_with_a_delay(system):
    scene_of, what = SYSTEMS[system]
    model = scene_of().compile(["d"])
    what = what if what in model.states else model.states[0]
    by_difference = _difference(scene_of, {"d": 0.6}, "d", what, 1.35)
    for method in ("dop853", "rodas5", "cvode"):
        result = model.simulate((0, 1.35), method=method, **TIGHT)
        found = result.sensitivity(what, "d")[-1]
        # BDF's local errors of 1e-10 add up over a few thousand steps.
        assert found == pytest.approx(by_difference, rel=1e-6, abs=1e-6), method


@pytest.mark.parametrize("method", ["dopri5", "rodas5", "cvode", "ida"])
def test_an_event_at_a_corner_moves_with_it(method):
    """An event that a jump of a source triggers happens at its time: a mode that starts a clock."""

    def scene_of():
        scene = cotree.Scene("clock")
        scene.parameter("d", 0.6)
        scene.parameter("w", 0.5)
        scene.mode("on", 0)
        scene.edge("V", "voltage_source", "a", "ground", voltage="sign(t - d) + sign(t - d - w)")
        scene.edge("R", "resistor", "a", "b", resistance=1.0)
        scene.edge("C", "capacitor", "b", "ground", capacitance=1.0, initial={"v": 0.5})
        scene.edge("I", "current_source", "ground", "c", current="3*on")
        scene.edge("C2", "capacitor", "c", "ground", capacitance=2.0)
        scene.output("u", "V.v")
        scene.event("begins", "u - 0.5", direction=1, set={"on": "1"})
        return scene

    result = scene_of().compile(["d", "w"]).simulate((0, 1.7), method=method, **TIGHT)
    assert result.events["begins"].t == pytest.approx([1.1], abs=1e-12)
    assert result.event_sensitivity("begins", "d") == pytest.approx([1.0])
    assert result.event_sensitivity("begins", "w") == pytest.approx([1.0])
    # From then on C2 takes 3 A / 2 F.
    assert result.sensitivity("C2.v", "d")[-1] == pytest.approx(-1.5, abs=1e-8)
    # The filter: -2, then 0, then 2 V.
    t = 1.7
    by_d = -2.0 * np.exp(0.6 - t) - 2.0 * np.exp(1.1 - t)
    assert result.sensitivity("C.v", "d")[-1] == pytest.approx(by_d, abs=1e-7)


def test_corners_that_meet_and_differ_are_refused_by_name():
    scene = _loop(width="0.5 - width")
    model = scene.compile(["width", "delay"])
    parameters = {"width": 0.5}
    assert model.simulate((0, 1.3), parameters=parameters).status == 0
    for method in ("dop853", "rodas5", "cvode"):
        with pytest.raises(SolveError, match=r"sensitivity of 'C1.v' to 'width' does not exist"):
            model.simulate((0, 3), parameters=parameters, method=method, throw=True)
    # Where nothing jumps, what meets does not matter: a pulse into a resistor and a capacitor.
    filtered = cotree.Scene("filter")
    filtered.parameter("width", 0.0)
    filtered.edge(
        "V", "pulse_voltage", "a", "ground", high=1, delay=1, rise=0.5, fall=0.5, width="width"
    )
    filtered.edge("R", "resistor", "a", "b", resistance=1.0)
    filtered.edge("C", "capacitor", "b", "ground", capacitance=1.0)
    result = filtered.compile(["width"]).simulate((0, 3), throw=True)
    # From the top on it lasts longer: exp(-1.5) - (its slope -2 V/s acts from 1.5 s to 2 s).
    expected = 2.0 * (np.exp(-1.0) - np.exp(-1.5))
    assert result.sensitivity("C.v", "width")[-1] == pytest.approx(expected, abs=1e-7)


def test_a_corner_at_the_start_is_refused_by_name(loop):
    parameters = {"delay": 0.0}
    for method in ("dop853", "rodas5", "cvode"):
        with pytest.raises(SolveError, match=r"to 'delay' does not exist: a source has a kink"):
            loop.simulate((0, 1), parameters=parameters, method=method, throw=True)
    # From before it there is one.
    result = loop.simulate((-0.5, 0.3), parameters=parameters, throw=True, **TIGHT)
    expected = -12.5 + 12.5 * 2.0 / 3.0 * np.exp(-0.3 / 0.75)
    assert result.sensitivity("C1.v", "delay")[-1] == pytest.approx(expected, rel=1e-8)


def test_a_parameter_that_only_times_a_jump_reaches_states():
    scene = cotree.Scene("switched")
    scene.parameter("d", 1.0)
    scene.edge("V", "voltage_source", "a", "ground", voltage="sign(t - d)")
    scene.edge("R", "resistor", "a", "b", resistance=1.0)
    scene.edge("C", "capacitor", "b", "ground", capacitance=1.0)
    scene.edge("C9", "capacitor", "c", "ground", capacitance=1.0, initial={"v": 1.0})
    scene.edge("R9", "resistor", "c", "ground", resistance=1.0)
    model = scene.compile(["d"])
    reached = dict(
        zip(model.states, model.kernels.structure.sensitivity_pattern[:, 0], strict=True)
    )
    assert reached == {"C.v": True, "C9.v": False}


#: Sources that do not jump.
TIED = [
    "max(sin(t), 0)",
    "min(t, 1.5)",
    "abs(mod(t, 2) - 1)",
    "sign(t**2 - 1)*(t**2 - 1)",
    "exp(-max(0, t - 0.3))",
]


@pytest.mark.parametrize("waveform", TIED)
def test_a_source_with_corners_may_have_capacitors_tied_to_it(waveform):
    scene = cotree.Scene("tied")
    scene.edge("V", "voltage_source", "a", "ground", voltage=waveform)
    scene.edge("C1", "capacitor", "a", "b", capacitance=0.5)
    scene.edge("C2", "capacitor", "b", "ground", capacitance=0.25)
    scene.edge("R", "resistor", "b", "ground", resistance=1.0)
    scene.output("u", "V.v")
    scene.output("v", "C2.v")
    result = scene.compile().simulate((0, 2), np.linspace(0, 2, 4001), rtol=1e-10, atol=1e-12)
    # v' = (V'/2 - v)/0.75: integrated by parts, V is needed but not its rate.
    t, u = result.t, result["u"]
    kernel = np.exp((t - t[-1]) / 0.75)
    integrand = u * kernel / 0.75
    smooth = np.sum(0.5 * (integrand[1:] + integrand[:-1]) * np.diff(t))
    start = (result["v"][0] - 2.0 / 3.0 * u[0]) * kernel[0]
    expected = start + 2.0 / 3.0 * (u[-1] - smooth)
    # The trapezoidal rule errs by h**2/12 u''/0.75 T, and at kinks by h**2 times the kink.
    assert result["v"][-1] == pytest.approx(expected, abs=1e-6)


def test_parameters_that_make_a_tied_source_jump_are_refused():
    scene = cotree.Scene("tied")
    scene.parameter("P", 2.0)
    pulse = {"delay": 1.0, "rise": 0.1, "width": 0.5, "fall": 0.1}
    scene.edge("V", "pulse_voltage", "a", "ground", high=5.0, period="P", **pulse)
    scene.edge("C1", "capacitor", "a", "ground", capacitance=0.5)
    scene.output("i", "C1.i")
    model = scene.compile()
    # A period that cuts the pulse off makes the source fall at once.
    with pytest.raises(cotree.errors.ParameterError, match=r"'V' jumps.*'P'"):
        model.simulate((0, 3), parameters={"P": 0.6})


@pytest.mark.parametrize("method", ["rodas5", "rodas4"])
def test_an_end_at_a_corner(method):
    """Corners at 5, 10, 15 and 20 s of a stiff filter, whose rates change within rounding of t."""
    scene = cotree.Scene("stiff")
    timing = {"delay": 5.0, "rise": 5.0, "width": 5.0, "fall": 5.0, "period": 20.0}
    for name, value in timing.items():
        scene.parameter(name, value)
    pulse = {name: name for name in timing}
    scene.edge("V", "pulse_voltage", "a", "ground", high=1.0, **pulse)
    scene.edge("R", "resistor", "a", "b", resistance=1e-4)
    scene.edge("C", "capacitor", "b", "ground", capacitance=1.0)
    model = scene.compile(list(timing))
    for t_end in (60.0, np.nextafter(60.0, 0.0), np.nextafter(60.0, 99.0), 57.0):
        result = model.simulate((0, t_end), method=method, rtol=1e-10)
        assert result.status == 0
    # On its way down: v' = -1/5 since 55 s, which all but the period move to later.
    moved = {"delay": 0.2, "rise": 0.2, "width": 0.2, "fall": 2.0 / 25.0, "period": 0.4}
    for name, expected in moved.items():
        # 1e-4 s behind the source, and two fifths down.
        found = result.sensitivity("C.v", name)[-1]
        assert found == pytest.approx(expected, abs=1e-4), name


@pytest.mark.parametrize("motion", ["max(0, t - d)", "sign(t - d)", "abs(sin(3*t))", "mod(t, d)"])
def test_a_prescribed_motion_whose_speed_jumps_is_refused(motion):
    """It would take an impulse, which no step of an integration passes on."""
    scene = cotree.Scene("lifted")
    scene.parameter("d", 0.6)
    scene.edge("lift", "prismatic", "ground", "A", axis=[1, 0, 0], motion=motion)
    scene.edge("body", "rigid_body", "ground", "A", mass=0.6)
    with pytest.raises(cotree.errors.Error, match="motion of edge 'lift' jumps, or its rate does"):
        scene.compile()


@pytest.mark.parametrize("method", ["dop853", "rodas5", "ida"])
def test_a_corner_whose_time_is_a_small_difference(method):
    """At 0.864 - 0.860 s, a time whose rounding is that of larger ones, a ramp falls back."""
    values = {"d": 0.864, "P": 0.86}

    def scene_of():
        scene = cotree.Scene("small")
        for name, value in values.items():
            scene.parameter(name, value)
        scene.edge("I", "current_source", "ground", "a", current="2.47*mod(t - d, P)")
        scene.edge("C", "capacitor", "a", "ground", capacitance=0.8)
        scene.edge("R", "resistor", "a", "ground", resistance=1.1)
        return scene

    result = scene_of().compile(["d", "P"]).simulate((0, 1.86), method=method, **TIGHT)
    for name in values:
        by_difference = _difference(scene_of, values, name, "C.v", 1.86)
        assert result.sensitivity("C.v", name)[-1] == pytest.approx(by_difference, abs=2e-6), name
