"""Stick and slip against closed forms in all parameters: states, times of events, sensitivities.

Each closed form is one expression of the parameters, and its derivatives are taken by SymPy.
"""

import sympy as sp

import cotree

# What a run at this tolerance leaves is measured as 1e-11 and less; derivatives of times are larger
# than one and lose a digit.
TIGHT = {"method": "dop853", "rtol": 1e-12, "atol": 1e-14}
CLOSE = 1e-9


def symbols(values):
    return {name: sp.Symbol(name, positive=True) for name in values}


def check(found, sensitivity, expression, values):
    """Compare a number and its derivatives by all parameters with an expression of them."""
    own = symbols(values)
    numbers = {own[name]: sp.Float(value, 30) for name, value in values.items()}
    exact = float(expression.subs(numbers))
    assert abs(found - exact) <= CLOSE * max(1.0, abs(exact))
    for name in values:
        slope = float(sp.diff(expression, own[name]).subs(numbers))
        assert abs(sensitivity(name) - slope) <= CLOSE * max(1.0, abs(slope)), name


def check_time(result, event, number, expression, values):
    check(
        result.events[event].t[number],
        lambda name: result.event_sensitivity(event, name)[number],
        expression,
        values,
    )


def check_state(result, state, place, expression, values):
    check(
        result[state][place],
        lambda name: result.sensitivity(state, name)[place],
        expression,
        values,
    )


def test_a_block_under_a_ramp_starts_slides_and_stops_for_good():
    values = {"m": 2.0, "a": 1.5, "T": 3.0, "F": 2.0, "B": 3.0}
    scene = cotree.Scene("ramp")
    for name, value in values.items():
        scene.parameter(name, value)
    scene.edge("M", "translational_mass", "ground", "A", mass="m")
    scene.edge("P", "force_source", "ground", "A", force="where(t < T, a*t, a*(2*T - t))")
    scene.edge("R", "translational_dry_friction", "ground", "A", force="F", breakaway="B")
    scene.output("s", "M.s")
    result = scene.compile(list(values)).simulate((0, 7.5), [2.5, 4.0, 7.5], **TIGHT)
    own = symbols(values)
    m, a, end, sliding, most = (own[name] for name in ("m", "a", "T", "F", "B"))
    t = sp.Symbol("t")
    start = most / a
    rising = (a * (t**2 - start**2) / 2 - sliding * (t - start)) / m
    fastest = rising.subs(t, end)
    falling = fastest + (a * end**2 / 2 - a * (2 * end - t) ** 2 / 2 - sliding * (t - end)) / m
    # The later root of falling = 0, in x = 2 T - t: a x^2/2 - F x = m v(T) + a T^2/2 - F T.
    level = m * fastest + a * end**2 / 2 - sliding * end
    stop = 2 * end - (sliding - sp.sqrt(sliding**2 + 2 * a * level)) / a
    stop = sp.simplify(stop)
    numbers = {own[name]: value for name, value in values.items()}
    assert abs(float(falling.subs(t, stop).subs(numbers))) < 1e-12
    check_time(result, "R slips forwards", 0, start, values)
    check_state(result, "M.v", 0, rising.subs(t, sp.Rational(5, 2)), values)
    check_state(result, "M.v", 1, falling.subs(t, 4), values)
    check_time(result, "R stops", 0, stop, values)
    # From there on it is held, and nothing changes where it stands.
    way = sp.integrate(rising, (t, start, end)) + sp.integrate(falling, (t, end, stop))
    check_state(result, "s", 2, way, values)
    assert len(result.events["R slips backwards"].t) == 0
    # Points between steps are interpolated, modes among them, to rounding.
    assert [round(mode) for mode in result["R.mode"]] == [1, 1, 0]


def test_a_limit_cycle_on_a_belt_depends_on_all_parameters_as_its_closed_form_does():
    values = {"m": 1.0, "k": 10.0, "F": 1.0, "B": 1.6, "v": 0.5}
    scene = cotree.Scene("belt")
    for name, value in values.items():
        scene.parameter(name, value)
    scene.edge("M", "translational_mass", "ground", "A", mass="m", initial={"v": "v"})
    scene.edge("K", "translational_spring", "ground", "A", stiffness="k")
    scene.edge("V", "velocity_source", "ground", "belt", velocity="v")
    scene.edge("R", "translational_dry_friction", "belt", "A", force="F", breakaway="B")
    result = scene.compile(list(values)).simulate((0, 7.3), [6.2, 7.3], **TIGHT)
    own = symbols(values)
    m, k, sliding, most, v = (own[name] for name in ("m", "k", "F", "B", "v"))
    w, lead = sp.sqrt(k / m), (most - sliding) / k
    slipping = 2 * (sp.pi - sp.atan(lead * w / v)) / w
    period = slipping + 2 * lead / v
    for n in range(4):
        check_time(result, "R slips backwards", n, most / (k * v) + n * period, values)
    for n in range(3):
        check_time(result, "R stops", n, most / (k * v) + n * period + slipping, values)
    # It sticks at 6.2 s and goes with the belt; at 7.3 s it slides about F/k.
    stuck = sliding / k - lead + v * (sp.Rational(31, 5) - most / (k * v) - 2 * period - slipping)
    late = sp.Rational(73, 10) - most / (k * v) - 3 * period
    assert [round(mode) for mode in result["R.mode"]] == [0, -1]
    check_state(result, "K.s", 0, stuck, values)
    angle = w * late
    check_state(
        result, "K.s", 1, sliding / k + lead * sp.cos(angle) + v / w * sp.sin(angle), values
    )


def test_two_coaxial_clutches_lock_at_once_and_slip_again_as_their_closed_form_does():
    values = {"J1": 1.0, "J2": 2.0, "T": 0.8, "F1": 2.0, "F2": 3.0, "w0": 10.0}
    scene = cotree.Scene("coaxial")
    for name, value in values.items():
        scene.parameter(name, value)
    scene.edge("J1", "rotational_inertia", "ground", "a", inertia="J1", initial={"w": "w0"})
    scene.edge("J2", "rotational_inertia", "ground", "b", inertia="J2")
    scene.edge("C1", "rotational_dry_friction", "a", "b", torque="F1")
    scene.edge("C2", "rotational_dry_friction", "a", "b", torque="F2")
    scene.edge("T", "torque_source", "ground", "a", torque="T*t")
    result = scene.compile(list(values)).simulate((0, 14), [5.0, 14.0], **TIGHT)
    own = symbols(values)
    j1, j2, rate, f1, f2, w0 = (own[name] for name in ("J1", "J2", "T", "F1", "F2", "w0"))
    t = sp.Symbol("t")
    # w1 - w2 = w0 - b t + T t^2/(2 J1), to its first zero.
    b = (f1 + f2) * (1 / j1 + 1 / j2)
    lock = (b - sp.sqrt(b**2 - 2 * rate * w0 / j1)) / (rate / j1)
    check_time(result, "C1 stops", 0, lock, values)
    slip = (f1 + f2) * (j1 + j2) / (j2 * rate)
    check_time(result, "C2 slips backwards", 0, slip, values)
    # All angular momentum is that of the torque; locked, both turn alike, whatever the clutches.
    common = (j1 * w0 + rate * t**2 / 2) / (j1 + j2)
    check_state(result, "J1.w", 0, common.subs(t, 5), values)
    second = common.subs(t, slip) + (f1 + f2) / j2 * (t - slip)
    check_state(result, "J2.w", 1, second.subs(t, 14), values)
