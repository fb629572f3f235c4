"""Rigid stops: impacts, rest and lift-off against closed forms, and their sensitivities."""

from math import asin, cos, pi, sin, sqrt

import numpy as np
import pytest
from with_parameters import scene_with

import cotree
from cotree.errors import ExpressionError, FormulationError, ParameterError, SceneError

# What a run at this tolerance leaves of its states is measured as 1e-11 and less.
TIGHT = {"method": "dop853", "rtol": 1e-11, "atol": 1e-13}
CLOSE = 1e-9


def ball(**parameters):
    given = {"m": 2.0, "g": 9.81, "h": 1.0, "e": 0.8, "vr": 0.05} | parameters
    scene = scene_with("stops", **given)
    scene.edge("M", "translational_mass", "ground", "A", mass="m")
    scene.edge("G", "force_source", "ground", "A", force="-m*g")
    limit = {"lower": 0.0, "restitution": "e", "rest_speed": "vr"}
    scene.edge("F", "translational_rigid_stop", "ground", "A", initial={"s": "h"}, **limit)
    scene.output("push", "-F.f")
    return scene


def table():
    """Build a mass on a table that moves by a sin(w t), faster than it falls."""
    scene = scene_with("stops", m=2.0, g=9.81, a=0.05, w=20.0)
    scene.edge("T", "velocity_source", "ground", "T", velocity="a*w*cos(w*t)")
    scene.edge("M", "translational_mass", "ground", "A", mass="m", initial={"v": "a*w"})
    scene.edge("G", "force_source", "ground", "A", force="-m*g")
    limit = {"lower": 0.0, "restitution": 0.3, "rest_speed": 0.01}
    scene.edge("F", "translational_rigid_stop", "T", "A", **limit)
    return scene


def pair():
    """Build two masses, of which one runs into the other."""
    scene = scene_with("stops", m1=2.0, m2=3.0, u=1.5, e=0.6, gap=0.4)
    scene.edge("M1", "translational_mass", "ground", "A", mass="m1", initial={"v": "u"})
    scene.edge("M2", "translational_mass", "ground", "B", mass="m2")
    limit = {"lower": 0.0, "restitution": "e"}
    scene.edge("F", "translational_rigid_stop", "A", "B", initial={"s": "gap"}, **limit)
    return scene


def slot():
    """Build a mass that rubs and bounces between two limits."""
    scene = scene_with("stops", m=1.0, u=1.5, e=0.5, b=0.3, F=0.05)
    scene.edge("M", "translational_mass", "ground", "A", mass="m", initial={"v": "u"})
    scene.edge("R", "translational_dry_friction", "ground", "A", force="F")
    limits = {"lower": "-b", "upper": "b", "restitution": "e"}
    scene.edge("F", "translational_rigid_stop", "ground", "A", **limits)
    return scene


def oscillator(**parameters):
    scene = scene_with("stops", **{"m": 1.0, "k": 40.0, "x0": 0.5, "b": 0.3, "e": 0.8} | parameters)
    scene.edge("M", "translational_mass", "ground", "A", mass="m")
    scene.edge("K", "translational_spring", "ground", "A", stiffness="k", initial={"s": "x0"})
    limit = {"lower": "-b", "restitution": "e"}
    scene.edge("F", "translational_rigid_stop", "ground", "A", initial={"s": "x0"}, **limit)
    return scene


def pressed():
    """Build a mass that rubs, and that a force presses against a wall and pulls off again."""
    scene = scene_with("stops", m=1.0, P=3.0, w=1.0, b=0.2, F=1.0)
    scene.edge("M", "translational_mass", "ground", "A", mass="m")
    scene.edge("P", "force_source", "ground", "A", force="P*sin(w*t)")
    scene.edge("R", "translational_dry_friction", "ground", "A", force="F")
    limit = {"upper": "b", "restitution": 0.4, "rest_speed": 0.05}
    scene.edge("F", "translational_rigid_stop", "ground", "A", **limit)
    return scene


def row_of_masses(n=3, restitution=1.0):
    """Build masses in a row, all but the first of which touch."""
    scene = scene_with("stops", m=1.0, u=1.0)
    for i in range(n):
        initial = {"v": "u"} if i == 0 else {}
        scene.edge(f"M{i}", "translational_mass", "ground", f"N{i}", mass="m", initial=initial)
    for i in range(n - 1):
        limit = {"lower": 0.0, "restitution": restitution, "initial": {"s": 0.0 if i else 0.3}}
        scene.edge(f"F{i}", "translational_rigid_stop", f"N{i}", f"N{i + 1}", **limit)
    return scene


def stack():
    """Build two blocks on each other that fall on the floor."""
    scene = scene_with("stops", m=1.0, g=9.81, h=0.3, e=0.3)
    limit = {"lower": 0.0, "restitution": "e", "rest_speed": 0.02}
    for i, (node, below, mass) in enumerate((("A", "ground", "m"), ("B", "A", "2*m"))):
        scene.edge(f"M{i}", "translational_mass", "ground", node, mass=mass)
        scene.edge(f"G{i}", "force_source", "ground", node, force=f"-{mass}*g")
        initial = {} if i else {"s": "h"}
        scene.edge(f"F{i}", "translational_rigid_stop", below, node, initial=initial, **limit)
    return scene


def cart(with_stop=True):
    """Build a cart with a pendulum that runs into a wall, by a stop or by an event."""
    scene = cotree.Scene("cart", gravity=[0, "-g", 0])
    given = {"g": 9.81, "m": 1.0, "M": 2.0, "L": 0.7, "e": 0.6, "u": 1.0, "b": 0.4}
    for name, value in given.items():
        scene.parameter(name, value)
    scene.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], initial={"s_dot": "u"})
    scene.edge("c", "rigid_body", "ground", "A", mass="M")
    scene.edge("h", "revolute", "A", "B", axis=[0, 0, 1], initial={"theta": 0.4})
    scene.edge("r", "arm", "B", "C", vector=[0, "-L", 0])
    scene.edge("p", "rigid_body", "ground", "C", mass="m")
    if with_stop:
        scene.edge("F", "translational_rigid_stop", joint="j", upper="b", restitution="e")
    else:
        scene.event("F", when="b - j.s", direction=-1, impact={"restitution": "e"})
    return scene


def rope():
    """Build a body that falls until its rope is taut, and swings on it."""
    scene = cotree.Scene("rope", gravity=[0, "-g", 0])
    for name, value in {"g": 9.81, "m": 1.0, "L": 1.0, "x0": 0.5}.items():
        scene.parameter(name, value)
    scene.edge("p", "rigid_body", "ground", "P", mass="m", initial={"x": "x0", "y": -0.1})
    scene.edge("F", "translational_rigid_stop", line=["ground", "P"], upper="L")
    return scene


def linkage():
    """Build a four-bar linkage that falls against a limit of its crank, and rests there."""
    scene = cotree.Scene("linkage", gravity=[0, "-g", 0])
    for name, value in {"g": 9.81, "m": 1.0, "e": 0.5}.items():
        scene.parameter(name, value)
    hinge = {"axis": [0, 0, 1]}
    scene.edge("h1", "revolute", "ground", "A", initial={"theta": 0.6}, **hinge)
    scene.edge("a1", "arm", "A", "B", vector=[0, 1, 0])
    scene.edge("m1", "rigid_body", "ground", "B", mass="m")
    scene.edge("h2", "revolute", "B", "C", **hinge)
    scene.edge("a2", "arm", "C", "D", vector=[1, 0, 0])
    scene.edge("m2", "rigid_body", "ground", "D", mass="m")
    scene.edge("h3", "revolute", "D", "E", **hinge)
    scene.edge("a3", "arm", "E", "P", vector=[0, -1, 0])
    scene.edge("o", "arm", "ground", "O", vector=[1, 0, 0])
    scene.edge("h4", "revolute", "O", "P", **hinge)
    limit = {"upper": 1.1, "restitution": "e", "rest_speed": 0.2}
    scene.edge("F", "rotational_rigid_stop", joint="h1", **limit)
    return scene


def test_a_ball_bounces_until_it_rests():
    m, g, h, e, slow = 2.0, 9.81, 1.0, 0.8, 0.05
    first = sqrt(2 * g * h)
    n = 1
    while first * e**n > slow:
        n += 1
    # It falls for first/g, and each flight takes 2 e^k first/g; the last impact leaves nothing.
    flights = 1 + 2 * np.cumsum([0.0, *(e**k for k in range(1, n))])
    model = ball().compile(["h", "g", "e", "m", "vr"])
    result = model.simulate((0, 5), **TIGHT)
    hits = result.events["F hits"].t
    assert len(hits) == n
    assert np.max(np.abs(hits - first / g * flights)) <= CLOSE
    assert abs(result.events["F rests"].t[0] - hits[-1]) == 0.0
    assert f"Impacts ended in rest, slower than rest_speed: 'F' at t = {hits[-1]:.10g}" in (
        result.message
    )
    # It stays there, and the floor bears its weight.
    final = [result[name][-1] for name in ("F.s", "M.v", "F.mode", "push", "F.impulse")]
    last = m * first * e ** (n - 1)
    assert np.max(np.abs(final - np.array([0.0, 0.0, -1.0, m * g, last]))) <= CLOSE
    slopes = 1 + 2 * np.cumsum([0.0, *(e**k for k in range(1, n))])
    by_e = 2 * np.cumsum([0.0, *(k * e ** (k - 1) for k in range(1, n))])
    exact = {"h": hits / (2 * h), "g": -hits / (2 * g), "e": first / g * by_e, "m": 0 * slopes}
    for name, value in (exact | {"vr": 0 * slopes}).items():
        assert np.max(np.abs(result.event_sensitivity("F hits", name) - value)) <= CLOSE * 30
        for state in ("F.s", "M.v"):
            assert abs(result.sensitivity(state, name)[-1]) <= CLOSE
    assert abs(result.sensitivity("F.impulse", "e")[-1] - (n - 1) * last / e) <= CLOSE


def test_a_table_throws_a_mass_off_where_it_falls_faster():
    g, a, w = 9.81, 0.05, 20.0
    start = asin(g / (a * w**2)) / w
    t = np.linspace(0, 0.25, 51)
    result = table().compile(["a", "g", "w"]).simulate((0, 0.25), t, **TIGHT)
    assert abs(result.events["F lifts"].t[0] - start) <= CLOSE
    # The derivative of a w^2 sin(w t) = g.
    slope = 1 / (a * w**3 * cos(w * start))
    exact = {"g": slope, "a": -(w**2) * sin(w * start) * slope}
    exact["w"] = -(2 * a * w * sin(w * start) + a * w**2 * start * cos(w * start)) * slope
    for name, value in exact.items():
        assert abs(result.event_sensitivity("F lifts", name)[0] - value) <= CLOSE
    flight = np.maximum(t - start, 0)
    thrown = a * sin(w * start) + a * w * cos(w * start) * flight - g * flight**2 / 2
    gap = np.where(t > start, thrown - a * np.sin(w * t), 0.0)
    assert np.max(np.abs(result["F.s"] - gap)) <= CLOSE
    # Points between steps are interpolated, modes among them, to rounding.
    assert np.max(np.abs(result["F.mode"] + (t < start))) <= 1e-12


def test_an_impact_between_two_masses_keeps_their_momentum():
    m1, m2, u, e, gap = 2.0, 3.0, 1.5, 0.6, 0.4
    result = pair().compile(["m1", "m2", "u", "e", "gap"]).simulate((0, 1), **TIGHT)
    impulse = (1 + e) * u * m1 * m2 / (m1 + m2)
    assert abs(result.events["F hits"].t[0] - gap / u) <= CLOSE
    assert abs(result["F.impulse"][-1] - impulse) <= CLOSE
    assert abs(result["M1.v"][-1] - (u - impulse / m1)) <= CLOSE
    assert abs(result["M2.v"][-1] - impulse / m2) <= CLOSE
    exact = {
        "m1": impulse * m2 / (m1 * (m1 + m2)),
        "m2": impulse * m1 / (m2 * (m1 + m2)),
        "u": impulse / u,
        "e": impulse / (1 + e),
        "gap": 0.0,
    }
    for name, value in exact.items():
        assert abs(result.sensitivity("F.impulse", name)[-1] - value) <= CLOSE
    # Behind it the gap is e (u t - gap).
    assert abs(result.sensitivity("F.s", "gap")[-1] + e) <= CLOSE


def test_an_oscillator_hits_its_stop_and_grazing_is_named():
    w, x0, b = sqrt(40.0), 0.5, 0.3

    def hits(b, e):
        times, speed = [np.arccos(-b / x0) / w], e * w * np.sqrt(x0**2 - b**2)
        for _ in range(3):
            # From -b with this speed up, round, and back to -b with the same speed.
            times.append(times[-1] + 2 * (pi - np.arctan(speed / (w * b))) / w)
            speed *= e
        return np.array(times)

    model = oscillator().compile(["b", "e"])
    result = model.simulate((0, 3), **TIGHT)
    assert np.max(np.abs(result.events["F hits"].t - hits(b, 0.8))) <= CLOSE
    for name, by in {"b": (1e-30j, 0.0), "e": (0.0, 1e-30j)}.items():
        slope = hits(b + by[0], 0.8 + by[1]).imag / 1e-30
        assert np.max(np.abs(result.event_sensitivity("F hits", name) - slope)) <= CLOSE
    with pytest.warns(RuntimeWarning, match="event 'F hits' grazes at t = 0.49672"):
        model.simulate((0, 1), parameters={"b": x0}, **TIGHT)
    # Without sensitivities nothing is undefined there.
    assert oscillator(b=x0).compile().simulate((0, 1), **TIGHT).success


def test_what_touches_takes_part_in_an_impact():
    result = row_of_masses().compile().simulate((0, 1), **TIGHT)
    # Newton's law for all at once: the first contact opens at u, the others stay closed, and
    # momentum is kept: v0 = -u/3, v1 = v2 = 2 u/3, with the energy that there was.
    speeds = [result[f"M{i}.v"][-1] for i in range(3)]
    assert np.max(np.abs(np.array(speeds) - [-1 / 3, 2 / 3, 2 / 3])) <= CLOSE
    assert [len(result.events[f"F{i} hits"].t) for i in range(2)] == [1, 0]


def test_gaps_that_close_at_once():
    scene = scene_with("stops", u=1.0)
    for i, sign in enumerate((1, 0, -1)):
        initial = {"v": f"{sign}*u"}
        scene.edge(f"M{i}", "translational_mass", "ground", f"N{i}", mass=1.0, initial=initial)
    for i in range(2):
        limit = {"lower": 0.0, "restitution": 0.5, "initial": {"s": 0.3}}
        scene.edge(f"F{i}", "translational_rigid_stop", f"N{i}", f"N{i + 1}", **limit)
    result = scene.compile().simulate((0, 1), **TIGHT)
    speeds = [result[f"M{i}.v"][-1] for i in range(3)]
    assert np.max(np.abs(np.array(speeds) - [-0.5, 0.0, 0.5])) <= CLOSE
    assert [len(result.events[f"F{i} hits"].t) for i in range(2)] == [1, 1]
    with pytest.warns(RuntimeWarning, match="'F1 hits' at t = 0.3 coincides with another"):
        scene.compile(["u"]).simulate((0, 1), **TIGHT)


def test_a_stop_on_a_joint_is_what_an_event_with_an_impact_is():
    names = ["L", "e", "m", "b"]
    stop = cart().compile(names).simulate((0, 1.5), **TIGHT)
    event = cart(with_stop=False).compile(names).simulate((0, 1.5), **TIGHT)
    for state in ("j.s", "h.theta", "j.s_dot"):
        assert abs(stop[state][-1] - event[state][-1]) <= CLOSE
        for name in names:
            difference = stop.sensitivity(state, name)[-1] - event.sensitivity(state, name)[-1]
            assert abs(difference) <= CLOSE


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "end", "states"),
    [
        (ball, 1.9, ["F.s", "M.v"]),
        (table, 0.4, ["M.v", "F.s"]),
        (pair, 1.0, ["M1.v", "M2.v", "F.s", "F.impulse"]),
        (slot, 3.0, ["M.v", "F.s"]),
        (oscillator, 3.0, ["M.v", "F.s"]),
        (pressed, 9.0, ["M.v", "F.s"]),
        (stack, 0.4, ["M0.v", "M1.v", "F0.s", "F1.s"]),
        (cart, 1.5, ["j.s", "h.theta", "j.s_dot"]),
        (rope, 2.0, ["p.x", "p.y"]),
        (linkage, 0.8, ["h1.theta", "h1.theta_dot"]),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_sensitivities_across_transitions_agree_with_differences(make, end, states):
    scene = make()
    values = {name: row.number for name, row in scene.parameters.items()}
    model = scene.compile(list(values))
    result = model.simulate((0, end), **TIGHT)
    assert result.success, result.message
    for name, value in values.items():
        h = 1e-5 * value
        sides = [model.simulate((0, end), parameters={name: value + d}, **TIGHT) for d in (h, -h)]
        for state in states:
            difference = (sides[0][state][-1] - sides[1][state][-1]) / (2 * h)
            # Second-order errors h^2 and rounding of states over h, both below 1e-7 here.
            size = max(1.0, abs(difference))
            assert abs(result.sensitivity(state, name)[-1] - difference) <= 1e-6 * size


@pytest.mark.slow
@pytest.mark.parametrize("method", ["dopri5", "rodas5", "cvode", "ida"])
def test_every_method_that_takes_events_takes_stops(method):
    tight = pressed().compile(["P"]).simulate((0, 9), **TIGHT)
    result = pressed().compile(["P"]).simulate((0, 9), method=method, rtol=1e-8, atol=1e-10)
    # Errors of some tens of tolerances, those of the multistep methods being the largest.
    assert abs(result["F.s"][-1] - tight["F.s"][-1]) <= 1e-5
    assert abs(result.sensitivity("F.s", "P")[-1] - tight.sensitivity("F.s", "P")[-1]) <= 1e-5


def test_a_start_at_a_limit_rests_there_or_begins_with_an_impact():
    rest = ball(h=0.0).compile(["m"]).simulate((0, 1), [0.0, 1.0], **TIGHT)
    assert np.max(np.abs(rest["F.mode"] + 1)) == 0.0
    assert np.max(np.abs(rest["push"] - 2.0 * 9.81)) <= CLOSE
    scene = scene_with("stops", u=-2.0)
    scene.edge("M", "translational_mass", "ground", "A", mass=1.0, initial={"v": "u"})
    scene.edge("F", "translational_rigid_stop", "ground", "A", lower=0.0, restitution=0.5)
    result = scene.compile(["u"]).simulate((0, 1), **TIGHT)
    assert result.events["F hits"].t.tolist() == [0.0]
    assert abs(result["M.v"][-1] - 1.0) <= CLOSE
    assert abs(result.sensitivity("F.s", "u")[-1] + 0.5) <= CLOSE


def test_an_event_that_drives_what_rests_into_its_stop_is_an_impact():
    scene = scene_with("stops", u=2.0)
    scene.edge("M", "translational_mass", "ground", "A", mass=1.0)
    scene.edge("G", "force_source", "ground", "A", force=-9.81)
    scene.edge("F", "translational_rigid_stop", "ground", "A", lower=0.0, restitution=0.5)
    scene.event("kick", when="t - 1", set={"M.v": "-u"})
    result = scene.compile(["u"]).simulate((0, 1.1), **TIGHT)
    assert [len(result.events[name].t) for name in ("kick", "F hits", "F rests")] == [1, 1, 0]
    # It leaves with u/2, and falls for a tenth of a second.
    assert abs(result["M.v"][-1] - (1.0 - 0.981)) <= CLOSE
    assert abs(result.sensitivity("M.v", "u")[-1] - 0.5) <= CLOSE
    assert abs(result.sensitivity("F.impulse", "u")[-1] - 1.5) <= CLOSE


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({}, "edge 'F' of type 'translational_rigid_stop' needs a lower or an upper limit"),
        ({"lower": 1.0, "upper": 0.5}, "'F' needs an upper limit above the lower one"),
        ({"lower": 0.0, "restitution": 1.1}, "'F' needs a restitution of one at most"),
        ({"lower": 0.0, "restitution": -0.1}, "restitution of edge 'F'"),
        ({"lower": 0.0, "rest_speed": 0.0}, "rest_speed of edge 'F'"),
        ({"lower": "sin(t)"}, "lower of edge 'F'"),
    ],
)
def test_a_stop_that_is_none_is_refused_by_name(fields, why):
    scene = scene_with(
        "stops",
    )
    scene.edge("M", "translational_mass", "ground", "A", mass=1.0)

    def run():
        scene.edge("F", "translational_rigid_stop", "ground", "A", **fields)
        scene.compile().simulate((0, 1))

    with pytest.raises((SceneError, ParameterError, ExpressionError), match=why):
        run()


def test_a_start_beyond_a_limit_ends_the_run_with_its_name():
    with pytest.warns(RuntimeWarning, match="'F' starts at t = 0 beyond its limit: start within"):
        ball(h=-0.1).compile().simulate((0, 1), **TIGHT)


@pytest.mark.parametrize("method", ["dop853", "rodas5"])
@pytest.mark.parametrize("push", [-6.0, -2.0, -1.0])
def test_a_joint_with_friction_and_a_stop_shares_its_load_between_them(push, method):
    scene = cotree.Scene("slide")
    m, c, e, start = 1.5, 2.0, 0.4, 1.0
    for name, value in {"F": push, "c": c}.items():
        scene.parameter(name, value)
    given = {"s": start, "s_dot": -1.0}
    scene.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], initial=given)
    scene.edge("b", "rigid_body", "ground", "A", mass=m)
    scene.edge("push", "force_source", joint="j", force="F")
    scene.edge("R", "translational_dry_friction", joint="j", force="c")
    stop = {"lower": 0.0, "restitution": e, "rest_speed": 1e-3}
    scene.edge("S", "translational_rigid_stop", joint="j", **stop)
    scene.output("R", "R.f")
    scene.output("S", "S.f")
    run = {"method": method, "rtol": 1e-11, "atol": 1e-13}
    result = scene.compile(["F", "c"]).simulate((0, 4), **run)
    assert result.success, result.message
    # Friction carries the push up to its limit, and the stop the rest, if the cart reaches it.
    carried = max(push, -c)
    assert abs(result["R"][-1] - carried) <= CLOSE
    assert abs(result["S"][-1] - (push - carried)) <= CLOSE
    assert abs(result["j.s_dot"][-1]) <= CLOSE
    if push == -1.0:  # stops before the wall, from 1 m/s at (F + c)/m
        place, slope = start - m / (2 * (push + c)), m / (2 * (push + c) ** 2)
    elif push == -2.0:  # reaches the wall at 1 m/s, and rebounds against F - c
        place, slope = m * e**2 / (2 * (c - push)), None
    else:
        place, slope = 0.0, 0.0
    assert abs(result["j.s"][-1] - place) <= CLOSE
    for name in ("F", "c"):
        if slope is not None:
            assert abs(result.sensitivity("j.s", name)[-1] - slope) <= CLOSE


def test_a_stop_between_massless_nodes_is_refused_by_name():
    scene = scene_with(
        "stops",
    )
    scene.edge("D", "translational_damper", "ground", "A", damping=1.0)
    scene.edge("F", "translational_rigid_stop", "ground", "A", lower=0.0)
    with pytest.raises(FormulationError, match=r"'F' of type .* holds at its limits, so "):
        scene.compile()


def test_bounces_that_the_tolerances_do_not_tell_are_named():
    with pytest.warns(RuntimeWarning, match="have become too small for the tolerances; give a lar"):
        ball(vr=1e-7).compile(["e"]).simulate((0, 5), rtol=1e-6, atol=1e-8)


def test_members_of_an_ensemble_bounce_as_single_runs_do():
    model = ball().compile(["e"])
    heights = [0.5, 1.0, 1.5]
    found = model.ensemble((0, 2), {"h": heights}, t_eval=[2.0], progress=False, **TIGHT)
    alone = [model.simulate((0, 2), [2.0], parameters={"h": h}, **TIGHT) for h in heights]
    # Members take the same steps of the same method, so that their bits agree.
    assert np.ravel(found["F.s"]).tolist() == [one["F.s"][0] for one in alone]
