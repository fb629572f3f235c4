"""Events against closed forms: states, times and sensitivities, with every kind of method.

Sensitivities of closed forms are their derivatives by complex steps of 1e-30, exact to rounding, or
by mpmath. Runs at rtol = 1e-12 are to agree to 1e-9: the multistep methods' global error is a
few hundred times their tolerance over tens of restarts.
"""

import mpmath
import numpy as np
import pytest

import cotree

METHODS = [
    *("cvode", "ida", "dop853", "dopri5", "rodas4", "rodas5"),
    pytest.param("rkf45", marks=pytest.mark.slow),
]
TIGHT = {"rtol": 1e-12, "atol": 1e-13}
CLOSE = 1e-9


@pytest.fixture(params=METHODS)
def method(request):
    if request.param in ("cvode", "ida"):
        pytest.importorskip("sksundae")
    return request.param


def derivatives(function, values):
    """Differentiate a function of a mapping, (n_values, n_parameters), by complex steps."""
    columns = []
    for name in values:
        shifted = {key: complex(value) for key, value in values.items()}
        shifted[name] += 1e-30j
        columns.append(np.array(function(**shifted)).imag / 1e-30)
    return np.array(columns).T


def check(result, events, wanted, names, closed, values):
    """Compare final states and event times, and the sensitivities of both, with a closed form.

    ``closed`` gives the states first, then the times of all events in order.
    """
    assert result.success, result.message
    times = np.concatenate([result.events[event].t for event in events])
    order = np.argsort(times)
    found = [*(result[name][-1] for name in wanted), *times[order]]
    exact = np.array(closed(**{k: complex(v) for k, v in values.items()})).real
    np.testing.assert_allclose(found, exact, rtol=0, atol=CLOSE)
    slopes = derivatives(closed, values)
    for k, name in enumerate(names):
        of_times = np.concatenate([result.event_sensitivity(event, name) for event in events])
        of_states = [result.sensitivity(state, name)[-1] for state in wanted]
        found = [*of_states, *of_times[order]]
        np.testing.assert_allclose(found, slopes[:, k], rtol=CLOSE, atol=CLOSE, err_msg=name)


def on_a_rail(name, gravity=0.0, force=0.0, **initial):
    scene = cotree.Scene(name, gravity=[0, 0, gravity])
    scene.edge(
        "j", "prismatic", "ground", "B", axis=[0, 0, 1], force=force, initial=initial or {"s": 0.0}
    )
    scene.edge("b", "rigid_body", "ground", "B", mass=1.0)
    return scene


def ball(values, initial="h"):
    scene = on_a_rail("ball", "-g", s=initial)
    for name, value in values.items():
        scene.parameter(name, value)
    scene.event("hit", "j.s", direction=-1, set={"j.s_dot": "-e*j.s_dot"})
    return scene


BALL = {"g": 9.81, "e": 0.8, "h": 2.0}


def test_bouncing_ball(method):
    def closed(g, e, h, end=2.5, n=2):
        speed = (2 * g * h) ** 0.5
        times = [(2 * h / g) ** 0.5]
        for k in range(1, n + 1):
            times.append(times[-1] + 2 * speed * e**k / g)
        left, up = end - times[-1], speed * e ** (n + 1)
        return [up * left - g * left**2 / 2, up - g * left, *times]

    model = ball(BALL).compile(list(BALL))
    result = model.simulate((0, 2.5), method=method, **TIGHT)
    check(result, ["hit"], ["j.s", "j.s_dot"], list(BALL), closed, BALL)
    row = result.events["hit"]
    np.testing.assert_allclose(row.y_after[1], -0.8 * row.y_before[1], rtol=1e-15)
    np.testing.assert_allclose(row.y_before[0], 0.0, atol=1e-13)


def test_relay_oscillator(method):
    values = {"a": 2.0, "v": 1.0, "x": 0.5}

    def closed(a, v, x, end=7.3):
        speed = (v * v + 2 * a * x) ** 0.5
        times, sign = [(v + speed) / a], -1
        while (times[-1] + 2 * speed / a).real < end:
            times.append(times[-1] + 2 * speed / a)
            sign = -sign
        left = end - times[-1]
        return [sign * (speed * left - a * left**2 / 2), sign * (speed - a * left), *times]

    scene = on_a_rail("relay", force="-u", s="x", s_dot="v")
    for name, value in values.items():
        scene.parameter(name, value)
    scene.mode("u", "a")
    scene.event("down", "j.s", direction=-1, set={"u": "-a"})
    scene.event("up", "j.s", direction=1, set={"u": "a"})
    result = scene.compile(list(values)).simulate((0, 7.3), method=method, **TIGHT)
    check(result, ["down", "up"], ["j.s", "j.s_dot"], list(values), closed, values)
    assert set(result["u"]) == {-2.0, 2.0}


def test_thermostat(method):
    values = {"C": 10.0, "G": 2.0, "q": 100.0, "Ta": 10.0, "lo": 19.0, "hi": 21.0}

    def closed(C, G, q, Ta, lo, hi, end=5.0):
        t, now, on, times = 0.0, 15.0, 1, []
        while True:
            rest, goal = Ta + on * q / G, hi if on else lo
            length = C / G * np.log((now - rest) / (goal - rest))
            if (t + length).real > end:
                return [rest + (now - rest) * np.exp((t - end) * G / C), *times]
            t, now, on = t + length, goal, 1 - on
            times.append(t)

    scene = cotree.Scene("thermostat")
    for name, value in values.items():
        scene.parameter(name, value)
    scene.mode("on", 1)
    scene.edge("room", "heat_capacitor", "R", "ground", capacity="C", initial={"T": 15.0})
    scene.edge("air", "temperature_source", "A", "ground", temperature="Ta")
    scene.edge("wall", "thermal_resistor", "R", "A", resistance="1/G")
    scene.edge("heater", "heat_source", "ground", "R", heat_flow="q*on")
    scene.output("T", "R.T")
    scene.event("warm", "room.T - hi", direction=1, set={"on": 0})
    scene.event("cold", "T - lo", direction=-1, set={"on": 1})  # an event may name an output
    result = scene.compile(list(values)).simulate((0, 5), method=method, **TIGHT)
    check(result, ["warm", "cold"], ["T"], list(values), closed, values)


def pendulum_closed(g, L, e, a, start=0.9):
    """Return the times of two impacts of a pendulum that falls from rest onto a stop at a < 0."""
    root = mpmath.sqrt(L / g)

    def fall(top):  # from rest at the angle top, through the bottom, as far as the stop
        k = mpmath.sin(top / 2)
        phi = mpmath.asin(mpmath.sin(-a / 2) / k)
        return root * (mpmath.ellipk(k**2) + mpmath.ellipf(phi, k**2))

    first = fall(mpmath.mpf(start))
    # What energy is left lifts it to the angle top on the other side.
    top = mpmath.acos(mpmath.cos(a) - e**2 * (mpmath.cos(a) - mpmath.cos(start)))
    return [first, first + 2 * fall(top)]


PENDULUM = {"g": 9.81, "L": 1.3, "e": 0.7, "a": -0.4}


def check_pendulum(result):
    np.testing.assert_allclose(
        result.events["stop"].t, [float(t) for t in pendulum_closed(**PENDULUM)], atol=CLOSE
    )
    for name, value in PENDULUM.items():
        exact = [
            float(
                mpmath.diff(lambda x, n=name, i=i: pendulum_closed(**{**PENDULUM, n: x})[i], value)
            )
            for i in range(2)
        ]
        found = result.event_sensitivity("stop", name)
        np.testing.assert_allclose(found, exact, rtol=CLOSE, atol=CLOSE, err_msg=name)


def pendulum(**event):
    scene = cotree.Scene("pendulum", gravity=[0, "-g", 0])
    for name, value in PENDULUM.items():
        scene.parameter(name, value)
    scene.edge("h", "revolute", "ground", "A", axis=[0, 0, 1], initial={"theta": 0.9})
    scene.edge("r", "arm", "A", "B", vector=[0, "-L", 0])
    scene.edge("b", "rigid_body", "ground", "B", mass=2.0)
    scene.event("stop", direction=-1, **event)
    return scene


@pytest.mark.sampled(2)
def test_pendulum_against_a_stop(method):
    scene = pendulum(when="h.theta - a", set={"h.theta_dot": "-e*h.theta_dot"})
    check_pendulum(scene.compile(list(PENDULUM)).simulate((0, 4), method=method, **TIGHT))


@pytest.mark.sampled(2)
@pytest.mark.parametrize("when", ["h.theta - a", "B.x - L*sin(a)"])
@pytest.mark.parametrize("loop", ["dop853", "rodas5", "cvode", "ida"])
def test_an_impact_of_one_coordinate_reverses_its_rate(when, loop):
    scene = pendulum(when=when, impact={"restitution": "e"})
    check_pendulum(scene.compile(list(PENDULUM)).simulate((0, 4), method=loop, **TIGHT))


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "event", [{"set": {"x.s_dot": "-e*x.s_dot"}}, {"impact": {"restitution": "e"}}]
)
def test_a_constrained_pendulum_against_a_stop(method, event):
    """The same pendulum in Cartesian coordinates: the other speed follows from the constraint."""
    scene = cotree.Scene("cartesian", gravity=[0, "-g", 0])
    for name, value in PENDULUM.items():
        scene.parameter(name, value)
    start = {"x": "L*sin(0.9)", "y": "-L*cos(0.9)"}
    scene.edge("x", "prismatic", "ground", "X", axis=[1, 0, 0], initial={"s": start["x"]})
    scene.edge("y", "prismatic", "X", "B", axis=[0, 1, 0], initial={"s": start["y"]})
    scene.edge("b", "rigid_body", "ground", "B", mass=2.0)
    scene.edge("rod", "distance", "ground", "B", length="L")
    scene.event("stop", "x.s - L*sin(a)", direction=-1, **event)
    model = scene.compile(list(PENDULUM))
    result = model.simulate((0, 4), method=method, **TIGHT)
    assert result.drift.worst < 1e-14  # of lengths and speeds of order one
    check_pendulum(result)
    for row in (result.events["stop"].y_before, result.events["stop"].y_after):
        for j, t in enumerate(result.events["stop"].t):
            np.testing.assert_allclose(
                model.kernels.constraint_values(t, row[:, j]), 0.0, atol=1e-13
            )


def test_a_relaxation_oscillator_with_an_algebraic_unknown(method):
    """C v' = -i, v = k r i^2: sqrt(v) falls evenly. The event looks at i; k switches."""
    values = {"C": 2.0, "r": 1.5, "v0": 4.0, "i0": 0.5}

    def closed(C, r, v0, i0, end=15.0):
        t, k, v, times = 0.0, 1, v0, []
        while True:
            root = (k * r) ** 0.5
            length = 2 * C * root * (v**0.5 - i0 * root)
            if (t + length).real > end:
                left = v**0.5 - (end - t) / (2 * C * root)
                return [left**2, left / root, *times]
            t, v, k = t + length, k * v0, 3 - k
            times.append(t)

    scene = cotree.Scene("relaxation")
    for name, value in values.items():
        scene.parameter(name, value)
    scene.mode("k", 1)
    scene.edge("c", "capacitor", "a", "ground", capacitance="C", initial={"v": "v0"})
    scene.edge("R", "resistor", "a", "ground", resistance="k*r*abs(R.i)")
    scene.event("low", "R.i - i0", direction=-1, set={"c.v": "v0*k", "k": "3 - k"})
    result = scene.compile(list(values)).simulate((0, 15), method=method, **TIGHT)
    assert len(result.events["low"].t) >= 2
    check(result, ["low"], ["c.v", "R.i"], list(values), closed, values)


def test_an_event_that_falls_on_an_output_time(method):
    scene = on_a_rail("wall", s=1.0, s_dot="-v")
    scene.parameter("v", 1.0)
    scene.event("hit", "j.s", direction=-1, set={"j.s_dot": "-0.5*j.s_dot"})
    result = scene.compile(["v"]).simulate((0, 2), np.linspace(0, 2, 11), method=method, **TIGHT)
    # What holds after the event is stored there: j.s = (v t - 1) / 2.
    exact = np.where(result.t < 0.99, 1.0 - result.t, (result.t - 1.0) / 2.0)
    np.testing.assert_allclose(result["j.s"], exact, atol=CLOSE)
    np.testing.assert_allclose(result["j.s_dot"], np.where(result.t < 0.99, -1.0, 0.5), atol=CLOSE)
    exact = np.where(result.t < 0.99, -result.t, result.t / 2.0)
    np.testing.assert_allclose(result.sensitivity("j.s", "v"), exact, atol=CLOSE)
    np.testing.assert_allclose(result.event_sensitivity("hit", "v"), [-1.0], atol=CLOSE)


def test_two_events_at_once(method):
    """Two equal balls fall side by side: each has its own time, and sensitivity of it."""
    scene = cotree.Scene("two", gravity=[0, 0, -9.81])
    for i, height in (("1", 2.0), ("2", 2.0)):
        scene.parameter(f"h{i}", height)
        scene.edge(f"j{i}", "prismatic", "ground", f"B{i}", axis=[0, 0, 1], initial={"s": f"h{i}"})
        scene.edge(f"b{i}", "rigid_body", "ground", f"B{i}", mass=1.0)
        scene.event(f"hit{i}", f"j{i}.s", direction=-1, set={f"j{i}.s_dot": f"-0.8*j{i}.s_dot"})

    def closed(h, end=1.0):
        speed = (2 * 9.81 * h) ** 0.5
        t = speed / 9.81
        return [0.8 * speed * (end - t) - 9.81 / 2 * (end - t) ** 2, t]

    result = scene.compile(["h1", "h2"]).simulate((0, 1), method=method, **TIGHT)
    position, time = closed(2.0)
    slope = derivatives(closed, {"h": 2.0})[:, 0]
    for i in "12":
        np.testing.assert_allclose(result.events[f"hit{i}"].t, [time], atol=CLOSE)
        np.testing.assert_allclose(result[f"j{i}.s"][-1], position, atol=CLOSE)
        for k in "12":
            own = slope * (i == k)
            found = result.sensitivity(f"j{i}.s", f"h{k}")[-1]
            np.testing.assert_allclose(found, own[0], atol=CLOSE)
            found = result.event_sensitivity(f"hit{i}", f"h{k}")
            np.testing.assert_allclose(found, [own[1]], atol=CLOSE)


@pytest.mark.parametrize(
    ("when", "falling"),
    [
        # The times at which each leaves zero to the other side, as x falls from 1.
        ("floor(5*x.v) - 2", [0.6]),
        ("sign(x.v - 0.6) + sign(x.v - 0.3)", [0.7]),
        ("2 - floor(5*t)", [0.6]),
        ("where(x.v > 0.5, 1, 0)", []),
    ],
)
def test_a_function_that_jumps_to_zero_crosses_it_at_the_next_jump(when, falling):
    scene = cotree.Scene("in-two-jumps")
    scene.mode("n", 0)
    scene.edge("x", "capacitor", "a", "ground", capacitance=1.0, initial={"v": 1.0})
    scene.edge("I", "current_source", "a", "ground", current=1.0)
    for name, direction in (("either", 0), ("down", -1), ("up", 1)):
        scene.event(name, when, direction=direction, set={"n": "n + 1"})
    result = scene.compile(optimize="-O0").simulate((0, 0.95))
    assert result["n"][-1] == 2 * len(falling)
    for name in ("either", "down"):
        assert result.events[name].t == pytest.approx(falling, abs=1e-12)
    assert not len(result.events["up"].t)
