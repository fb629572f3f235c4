"""Events beside algebraic unknowns, with sensitivities: several methods side by side.

The closed form is in test_events.py; here are exponentials, against differences of other runs.
"""

import numpy as np
import pytest

import cotree

METHODS = ["dop853", "rodas4", "rodas5", "cvode", "ida"]
CHARGER = {"V": 5.0, "R": 100.0, "C": 1e-4, "G": 2e-3, "hi": 3.0, "lo": 1.5}


@pytest.fixture(params=METHODS)
def method(request):
    if request.param in ("cvode", "ida"):
        pytest.importorskip("sksundae")
    return request.param


def charger():
    """Draw a capacitor that is charged through a diode, and has a load while it is full."""
    scene = cotree.Scene("charger")
    for name, value in CHARGER.items():
        scene.parameter(name, value)
    scene.mode("on", 0)
    scene.mode("n", 0)
    scene.edge("V1", "voltage_source", "a", "ground", voltage="V")
    scene.edge("R1", "resistor", "a", "n", resistance="R")
    scene.edge("D1", "diode", "n", "c", saturation_current=1e-12, thermal_voltage=0.02585)
    scene.edge("C1", "capacitor", "c", "ground", capacitance="C", initial={"v": 0.5})
    scene.edge("R2", "resistor", "c", "ground", resistance="1/(G*(0.01 + 20*on))")
    scene.event("full", "C1.v - hi", direction=1, set={"on": 1})
    scene.event("empty", "C1.v - lo", direction=-1, set={"on": 0})
    # What it looks at is an algebraic unknown's doing.
    scene.event("weak", "R1.i - 0.02", direction=-1, set={"n": "n + 1"})
    return scene


def numbers(result):
    """List the last states that are none of modes, and the times of all events."""
    times = [result.events[name].t for name in ("full", "empty", "weak")]
    assert [len(t) for t in times] == [10, 9, 10]
    return np.concatenate([result.y[2:, -1], *times])


@pytest.fixture(scope="module")
def differences():
    """Return the numbers, and their derivatives by five points 1e-4 of a parameter apart."""
    model = charger().compile()

    def run(**given):
        result = model.simulate((0, 0.1), method="dop853", rtol=1e-13, atol=1e-14, parameters=given)
        return numbers(result)

    found = {}
    for name, value in CHARGER.items():
        step = 1e-4 * value
        shifted = {k: run(**{name: value + k * step}) for k in (-2, -1, 1, 2)}
        found[name] = (8 * (shifted[1] - shifted[-1]) - (shifted[2] - shifted[-2])) / (12 * step)
    return run(), found


@pytest.mark.sampled(2)
def test_a_charger_with_a_diode(method, differences):
    model = charger().compile(list(CHARGER))
    assert model.kernels.layout.n_algebraic == 1
    rtol = 1e-11
    result = model.simulate((0, 0.1), method=method, rtol=rtol, atol=rtol / 10)
    values, slopes = differences
    # Each of 29 events leaves some errors of a thousand steps of the tolerance, formulas of several
    # steps a hundred times as much.
    scale = 1e3 if method in ("cvode", "ida") else 10.0
    np.testing.assert_allclose(numbers(result), values, atol=scale * rtol)
    for name, value in CHARGER.items():
        found = [result.sensitivity(state, name)[-1] for state in model.states[2:]]
        found += [s for e in ("full", "empty", "weak") for s in result.event_sensitivity(e, name)]
        # Differences of numbers good to 1e-12, by steps of 1e-4; truncation is below that.
        np.testing.assert_allclose(
            np.array(found) * value, slopes[name] * value, rtol=3e-7, atol=3e-7, err_msg=name
        )
    assert result.drift.worst < 1e-14
    n = model.states.index("n")
    assert result.y[n, -1] == 10.0


def test_unknowns_that_jump_at_a_breakpoint_make_an_event_happen(method):
    """Two diodes clamp a capacitor; what drives it turns round, and with it the current."""
    scene = cotree.Scene("clamped")
    scene.parameter("R", 100.0)
    scene.mode("n", 0)
    scene.input("u", "2*sign(2e-3 - t)")
    scene.edge("V1", "voltage_source", "s", "ground", voltage="u")
    scene.edge("R1", "resistor", "s", "a", resistance="R")
    for name, ends in {"D1": ("a", "b"), "D2": ("b", "a")}.items():
        scene.edge(name, "diode", *ends, saturation_current=1e-9)
    scene.edge("C1", "capacitor", "b", "ground", capacitance=1e-5)
    scene.event("turn", "R1.i", direction=-1, set={"n": "n + 1", "C1.v": "0.5*C1.v"})
    model = scene.compile(["R"])
    times = [1e-3, 2e-3, 3e-3]
    result = model.simulate((0.0, 3e-3), times, method, 1e-9, 1e-11, throw=True)
    np.testing.assert_allclose(result.events["turn"].t, [2e-3], atol=1e-18)
    np.testing.assert_array_equal(result.event_sensitivity("turn", "R"), [0.0])
    assert result["n"].tolist() == [0.0, 1.0, 1.0]
    expected = model.simulate((0.0, 3e-3), times, "dop853", 1e-12, 1e-14, throw=True)
    # Some hundred steps of the tolerance.
    np.testing.assert_allclose(result.y, expected.y, atol=1e-6)
    np.testing.assert_allclose(result.s * 100.0, expected.s * 100.0, atol=1e-6)
    assert result.drift.worst < 1e-13
