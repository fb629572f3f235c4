"""Dry friction that sticks and slides, against closed forms, and its sensitivities."""

from math import atan, cos, pi, sin, sqrt

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from with_parameters import scene_with

import cotree
from cotree.errors import FormulationError, SceneError

# What a run at this tolerance leaves of its states is measured as 1e-11 and less.
TIGHT = {"method": "dop853", "rtol": 1e-11, "atol": 1e-13}
CLOSE = 1e-9


def oscillator(**parameters):
    scene = scene_with("rubbing", **{"m": 1.0, "k": 40.0, "F": 2.0, "x0": 0.47} | parameters)
    scene.edge("M", "translational_mass", "ground", "A", mass="m")
    scene.edge("K", "translational_spring", "ground", "A", stiffness="k", initial={"s": "x0"})
    scene.edge("R", "translational_dry_friction", "ground", "A", force="F")
    scene.output("force", "R.f")
    return scene


def belt():
    scene = scene_with("rubbing", m=1.0, k=10.0, F=1.0, Fs=1.6, v=0.5)
    scene.edge("M", "translational_mass", "ground", "A", mass="m", initial={"v": "v"})
    scene.edge("K", "translational_spring", "ground", "A", stiffness="k")
    scene.edge("B", "velocity_source", "ground", "belt", velocity="v")
    scene.edge("R", "translational_dry_friction", "belt", "A", force="F", breakaway="Fs")
    return scene


def pendulum():
    """Build a double pendulum with friction in both hinges."""
    scene = cotree.Scene("pendulum", gravity=[0, "-g", 0])
    for name, value in {"g": 9.81, "T1": 2.0, "T2": 0.7, "m": 1.0, "th": 1.0}.items():
        scene.parameter(name, value)
    hinge = {"axis": [0, 0, 1]}
    scene.edge("h1", "revolute", "ground", "A", initial={"theta": "th"}, **hinge)
    scene.edge("a1", "arm", "A", "B", vector=[0, -1, 0])
    scene.edge("b1", "rigid_body", "ground", "B", mass="m")
    scene.edge("h2", "revolute", "B", "C", initial={"theta": 0.5}, **hinge)
    scene.edge("a2", "arm", "C", "D", vector=[0, -1, 0])
    scene.edge("b2", "rigid_body", "ground", "D", mass="m")
    scene.edge("R1", "rotational_dry_friction", joint="h1", torque="T1")
    scene.edge("R2", "rotational_dry_friction", joint="h2", torque="T2", breakaway="1.3*T2")
    return scene


def incline():
    """Build a block on an incline that tilts to and fro, by the angle sin(w t)."""
    scene = scene_with("rubbing", m=2.0, g=9.81, mu=0.3, mus=0.4, w=1.0)
    scene.output("N", "m*g*cos(sin(w*t))")
    scene.edge("M", "translational_mass", "ground", "A", mass="m")
    scene.edge("G", "force_source", "ground", "A", force="m*g*sin(sin(w*t))")
    scene.edge("R", "translational_dry_friction", "ground", "A", force="mu*N", breakaway="mus*N")
    return scene


def coaxial():
    """Build two shafts with two clutches between them, which lock at once, and slip again."""
    scene = scene_with("rubbing", J1=1.0, J2=2.0, T=0.8, F1=2.0, F2=3.0, w0=10.0)
    scene.edge("J1", "rotational_inertia", "ground", "a", inertia="J1", initial={"w": "w0"})
    scene.edge("J2", "rotational_inertia", "ground", "b", inertia="J2")
    scene.edge("C1", "rotational_dry_friction", "a", "b", torque="F1")
    scene.edge("C2", "rotational_dry_friction", "a", "b", torque="F2")
    scene.edge("T", "torque_source", "ground", "a", torque="T*t")
    scene.output("slip", "a.w - b.w")
    scene.output("passed", "C1.tau + C2.tau")
    return scene


def chain():
    """Build three masses in a row, each of which rubs at its neighbours."""
    scene = scene_with("rubbing", m=1.0, F1=1.0, F2=1.5, F3=0.7, a=4.0, w=2.0)
    for node in "ABC":
        scene.edge(f"M{node}", "translational_mass", "ground", node, mass="m")
    for name, first, second in (("F1", "ground", "A"), ("F2", "A", "B"), ("F3", "B", "C")):
        scene.edge(f"R{name}", "translational_dry_friction", first, second, force=name)
    scene.edge("P", "force_source", "ground", "C", force="a*sin(w*t)")
    scene.edge("Q", "force_source", "ground", "A", force="a*cos(1.3*w*t)")
    return scene


def test_an_oscillator_comes_to_rest_and_stays_there():
    m, k, friction, x = 1.0, 40.0, 2.0, 0.47
    w, left, parts = sqrt(k / m), friction / k, []
    while abs(x) > left:
        # Half a period about the point where spring and friction balance.
        centre = left * np.sign(x)
        parts.append((centre, x - centre))
        x = 2 * centre - x
    t = np.linspace(0, 4, 401)
    n = np.minimum((t * w / pi).astype(int), len(parts))
    exact = [
        parts[i][0] + parts[i][1] * cos(w * s - i * pi) if i < len(parts) else x
        for i, s in zip(n, t, strict=True)
    ]
    model = oscillator().compile(["F", "x0", "k", "m"])
    result = model.simulate((0, 4), t, **TIGHT)
    assert np.max(np.abs(result["K.s"] - exact)) <= CLOSE
    stops = result.events["R stops"].t
    assert np.max(np.abs(stops - np.arange(1, len(parts) + 1) * pi / w)) <= CLOSE
    is_over = t > stops[-1]
    assert np.max(np.abs(result["R.mode"][is_over])) <= 1e-14
    assert np.max(np.abs(result["M.v"][is_over])) <= CLOSE
    assert np.max(np.abs(result["force"][is_over] + k * x)) <= CLOSE * k
    # Each half-period takes 2 F/k from the amplitude, and the last one has a sign.
    sign = (-1) ** len(parts)
    exact = {"F": -sign * 2 * len(parts) / k, "x0": sign, "m": 0.0}
    for name, value in {**exact, "k": sign * 2 * len(parts) * friction / k**2}.items():
        assert abs(result.sensitivity("K.s", name)[-1] - value) <= CLOSE
    # t_n = n pi sqrt(m/k): half of it over m, minus half over k, nothing by the others.
    for name, value in {"m": 0.5, "k": -0.5 / k, "F": 0.0, "x0": 0.0}.items():
        assert np.max(np.abs(result.event_sensitivity("R stops", name) - value * stops)) <= CLOSE


def test_a_block_on_a_belt_runs_into_a_limit_cycle():
    m, k, friction, static, v = 1.0, 10.0, 1.0, 1.6, 0.5
    w, lead = sqrt(k / m), (static - friction) / k
    # It slides about F/k until it is as fast as the belt, as far beyond that point as before it.
    sliding = 2 * (pi - atan(lead * w / v)) / w
    period = sliding + 2 * lead / v
    model = belt().compile(["F", "Fs", "v", "k"])
    result = model.simulate((0, 9), **TIGHT)
    slips = result.events["R slips backwards"].t
    stops = result.events["R stops"].t
    assert len(slips) == 5
    assert np.max(np.abs(slips - static / (k * v) - period * np.arange(5))) <= CLOSE
    assert np.max(np.abs(stops - slips[: len(stops)] - sliding)) <= CLOSE
    # t1 = Fs/(k v).
    assert abs(result.event_sensitivity("R slips backwards", "Fs")[0] - 1 / (k * v)) <= CLOSE
    assert abs(result.event_sensitivity("R slips backwards", "v")[0] + slips[0] / v) <= CLOSE


def test_a_block_on_a_tilting_incline_starts_slides_and_stops():
    g, mu, mus = 9.81, 0.3, 0.4

    def acceleration(t, way):
        return g * sin(sin(t)) - way * mu * g * cos(sin(t))

    def speed(t, start, way):
        return quad(acceleration, start, t, args=(way,), epsabs=1e-12, epsrel=1e-12)[0]

    start = brentq(lambda t: sin(sin(t)) - mus * cos(sin(t)), 0, 1, xtol=1e-14)
    stop = brentq(lambda t: speed(t, start, 1), 3, 5, xtol=1e-14)
    # Where it stops, the incline is steep enough the other way that it goes on at once.
    assert sin(sin(stop)) < -mus * cos(sin(stop))
    result = incline().compile(["mus"]).simulate((0, 6), [0.2, 2.0, 5.5], **TIGHT)
    assert abs(result.events["R slips forwards"].t[0] - start) <= CLOSE
    assert abs(result.events["R stops"].t[0] - stop) <= CLOSE
    exact = [0.0, speed(2.0, start, 1), speed(5.5, stop, -1)]
    assert np.max(np.abs(result["M.v"] - exact)) <= CLOSE


def test_two_clutches_lock_at_one_event_and_share_what_they_pass():
    j1, j2, torque, f1, f2, w0 = 1.0, 2.0, 0.8, 2.0, 3.0, 10.0
    model = coaxial().compile()
    t = np.linspace(0, 14, 281)
    result = model.simulate((0, 14), t, **TIGHT)
    # w1 - w2 = w0 - (F1 + F2) (1/J1 + 1/J2) t + T t^2/(2 J1), to its first zero.
    b = (f1 + f2) * (1 / j1 + 1 / j2)
    lock = (b - sqrt(b**2 - 2 * torque * w0 / j1)) / (torque / j1)
    assert [len(result.events[f"C{i} stops"].t) for i in (1, 2)] == [1, 0]
    assert abs(result.events["C1 stops"].t[0] - lock) <= CLOSE
    # Locked, they pass J2/(J1 + J2) of the torque; together they slip at F1 + F2.
    slip = (f1 + f2) * (j1 + j2) / (j2 * torque)
    assert abs(result.events["C2 slips backwards"].t[-1] - slip) <= CLOSE
    is_locked = (t > lock) & (t < slip)
    passed = -torque * t * j2 / (j1 + j2)
    assert np.max(np.abs(result["passed"] - passed)[is_locked]) <= CLOSE
    assert np.max(np.abs(result["slip"][is_locked])) <= CLOSE
    assert np.round([result[f"C{i}.mode"][-1] for i in (1, 2)]).tolist() == [-1.0, -1.0]


@pytest.mark.parametrize("method", ["dopri5", "rodas5", "cvode", "ida"])
def test_every_method_that_takes_events_takes_friction(method):
    result = oscillator().compile(["F"]).simulate((0, 4), method=method, rtol=1e-8)
    # Errors of some tens of tolerances, those of the multistep methods being the largest.
    assert abs(result["K.s"][-1] - 0.03) <= 1e-6
    assert abs(result.sensitivity("K.s", "F")[-1] - 0.25) <= 1e-6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "end", "states"),
    [
        (oscillator, 2.3, ["K.s", "M.v"]),
        (belt, 7.3, ["K.s", "M.v"]),
        (incline, 5.5, ["M.v"]),
        (coaxial, 14.0, ["J1.w", "J2.w"]),
        (chain, 10.0, ["MA.v", "MB.v", "MC.v"]),
        (pendulum, 5.0, ["h1.theta", "h2.theta"]),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_sensitivities_across_transitions_agree_with_differences(make, end, states):
    scene = make()
    values = {name: row.number for name, row in scene.parameters.items()}
    model = scene.compile(list(values))
    result = model.simulate((0, end), **TIGHT)
    for name, value in values.items():
        h = 1e-5 * value
        sides = [model.simulate((0, end), parameters={name: value + d}, **TIGHT) for d in (h, -h)]
        for state in states:
            difference = (sides[0][state][-1] - sides[1][state][-1]) / (2 * h)
            # Second-order errors h^2 and rounding of states over h, both below 1e-7 here.
            size = max(1.0, abs(difference))
            assert abs(result.sensitivity(state, name)[-1] - difference) <= 1e-6 * size


def test_a_start_at_rest_slips_at_once_under_a_force_beyond_the_limit():
    scene = scene_with("rubbing", P=3.0)
    scene.edge("M", "translational_mass", "ground", "A", mass=1.0)
    scene.edge("P", "force_source", "ground", "A", force="P")
    scene.edge("R", "translational_dry_friction", "ground", "A", force=2.0)
    result = scene.compile(["P"]).simulate((0, 2), **TIGHT)
    assert result["R.mode"][0] == 1.0
    assert abs(result["M.v"][-1] - 2.0) <= CLOSE
    assert abs(result.sensitivity("M.v", "P")[-1] - 2.0) <= CLOSE


def test_a_clutch_without_normal_force_is_free_and_engages():
    scene = scene_with("rubbing", mu=0.5)
    scene.edge("J", "rotational_inertia", "ground", "a", inertia=1.0, initial={"w": 2.0})
    # The normal force is negative at first, zero at t = 1.
    scene.edge("B", "brake", "ground", "a", normal_force="t - 1", friction="mu", radius=1.0)
    result = scene.compile(["mu"]).simulate((0, 5), [0.5, 2.0, 5.0], **TIGHT)
    # Points between steps are interpolated, modes among them, to rounding.
    assert np.max(np.abs(result["B.mode"] - [2.0, 1.0, 0.0])) <= 1e-14
    assert np.max(np.abs(result["J.w"] - [2.0, 1.75, 0.0])) <= CLOSE
    assert abs(result.events["B engages"].t[0] - 1.0) <= CLOSE
    # w = 2 - mu (t - 1)^2/2 is zero at 1 + 2/sqrt(mu).
    assert abs(result.events["B stops"].t[0] - (1 + 2 / sqrt(0.5))) <= CLOSE


def test_a_table_of_speeds_is_linear_between_them_and_constant_beyond():
    scene = scene_with("rubbing", most=3.0)
    scene.edge("M", "translational_mass", "ground", "A", mass=1.0, initial={"v": 2.0})
    scene.edge(
        "R", "translational_dry_friction", "ground", "A", force=[[0, "most"], [1, 2.0], [1.5, 2.0]]
    )
    result = scene.compile(["most"]).simulate((0, 2), **TIGHT)
    # 2 m/s to 1 m/s in half a second, then v' = -(3 - v).
    stop = 0.5 + np.log(3.0 / 2.0)
    assert abs(result.events["R stops"].t[0] - stop) <= CLOSE
    # From 1 m/s on, by v' = -(F - (F - 2) v), it takes log(F/2)/(F - 2), F being 3 N.
    by_most = 1 / 3 - np.log(1.5)
    assert abs(result.event_sensitivity("R stops", "most")[0] - by_most) <= 1e-8


@pytest.mark.parametrize(
    ("table", "why"),
    [
        ([[0, 1], [0, 2]], "must begin with 0 and ascend"),
        ([[1, 1]], "must begin with 0 and ascend"),
        ([[0, 1, 2]], "list of pairs"),
        ([["x", 1]], "must be numbers"),
    ],
)
def test_a_table_that_is_none_is_refused(table, why):
    scene = scene_with(
        "rubbing",
    )
    with pytest.raises(SceneError, match=f"force of edge 'R'.* {why}|speeds in force .*{why}"):
        scene.edge("R", "translational_dry_friction", "ground", "A", force=table)


@pytest.mark.parametrize("force", [0, "Z"])
def test_friction_without_force_does_nothing(force):
    scene = scene_with("rubbing", Z=0.0)
    scene.edge("M", "translational_mass", "ground", "A", mass=1.0, initial={"v": 1.0})
    scene.edge("K", "translational_spring", "ground", "A", stiffness=4.0)
    scene.edge("R", "translational_dry_friction", "ground", "A", force=force)
    result = scene.compile().simulate((0, 3), **TIGHT)
    assert abs(result["M.v"][-1] - cos(6.0)) <= CLOSE


def test_friction_in_joints_brings_a_pendulum_to_rest():
    scene = pendulum()
    for i in (1, 2):
        scene.output(f"held{i}", f"R{i}.tau")
    result = scene.compile().simulate((0, 12), method="dop853", rtol=1e-9)
    assert [result[f"R{i}.mode"][-1] for i in (1, 2)] == [0.0, 0.0]
    speeds = [result[f"h{i}.theta_dot"][-1] for i in (1, 2)]
    assert np.max(np.abs(speeds)) <= CLOSE
    # At rest each hinge holds the moments of the weights beyond it.
    first, second = (result[f"h{i}.theta"][-1] for i in (1, 2))
    lower = 9.81 * sin(first + second)
    upper = 9.81 * 2 * sin(first) + lower
    assert abs(result["held2"][-1] + lower) <= 1e-7
    assert abs(result["held1"][-1] + upper) <= 1e-7


def test_edges_with_friction_on_one_joint_act_as_one_with_the_sum_of_their_limits():
    def final(torques):
        scene = cotree.Scene("sum", gravity=[0, -9.81, 0])
        given = {"theta": 1.2}
        scene.edge("h", "revolute", "ground", "A", axis=[0, 0, 1], initial=given)
        scene.edge("rod", "arm", "A", "B", vector=[0, -1.3, 0])
        scene.edge("b", "rigid_body", "ground", "B", mass=2.0)
        for i, torque in enumerate(torques):
            scene.parameter(f"T{i}", torque)
            scene.edge(f"R{i}", "rotational_dry_friction", joint="h", torque=f"T{i}")
            scene.output(f"tau{i}", f"R{i}.tau")
        result = scene.compile(["T0"]).simulate((0, 20), **TIGHT)
        shares = [result[f"tau{i}"][-1] for i in range(len(torques))]
        return result["h.theta"][-1], result.sensitivity("h.theta", "T0")[-1], shares

    angle, slope, (whole,) = final([1.7])
    other_angle, other_slope, shares = final([0.5, 0.2, 1.0])
    assert abs(other_angle - angle) <= CLOSE
    assert abs(other_slope - slope) <= CLOSE
    # They share the load by least squares within their limits.
    assert abs(shares[1] + 0.2) <= CLOSE
    assert np.max(np.abs(np.array(shares)[[0, 2]] - (whole + 0.2) / 2)) <= CLOSE


def test_friction_between_massless_nodes_is_refused_by_name():
    scene = scene_with("rubbing", k=3.0)
    scene.edge("M", "translational_mass", "ground", "A", mass=1.0)
    scene.edge("R", "translational_dry_friction", "A", "B", force=1.0)
    scene.edge("K", "translational_spring", "B", "ground", stiffness="k")
    with pytest.raises(FormulationError, match=r"'R' .* 'K', which has none"):
        scene.compile()


def test_friction_between_given_speeds_is_refused_by_name():
    scene = scene_with("rubbing", v=1.0)
    scene.edge("V", "velocity_source", "ground", "A", velocity="v")
    scene.edge("R", "translational_dry_friction", "A", "ground", force=1.0)
    with pytest.raises(FormulationError, match=r"'R' .* between prescribed speeds"):
        scene.compile()


def test_modes_cannot_be_given():
    scene = scene_with(
        "rubbing",
    )
    with pytest.raises(SceneError, match="no field 'mode'"):
        scene.edge("R", "translational_dry_friction", "ground", "A", force=1.0, mode=1)


def test_a_one_way_clutch_that_turns_the_wrong_way_ends_the_run_with_its_name():
    scene = scene_with(
        "rubbing",
    )
    scene.edge("a", "rotational_inertia", "ground", "A", inertia=1.0, initial={"w": 1.0})
    scene.edge("b", "rotational_inertia", "ground", "B", inertia=1.0)
    scene.edge("C", "one_way_clutch", "A", "B", normal_force=0, friction=0.1, radius=1.0)
    with pytest.warns(RuntimeWarning, match="'C' turns at t = 0 in its locked direction"):
        result = scene.compile().simulate((0, 1))
    assert not result.success


def test_parallel_brakes_hold_as_much_as_both_together():
    """On one shaft, by way of a gear, what reaches its limit first goes on with that."""
    scene = scene_with("rubbing", r=2.0)
    scene.edge("a", "rotational_inertia", "ground", "A", inertia=1.0)
    scene.edge("b", "rotational_inertia", "ground", "B", inertia=1.0)
    scene.edge("G", "ideal_gear", "A", "B", ratio="r")
    scene.edge("Ra", "rotational_dry_friction", "ground", "A", torque=1.0)
    scene.edge("Rb", "rotational_dry_friction", "ground", "B", torque=3.0)
    scene.edge("T", "torque_source", "ground", "A", torque="t")
    scene.output("speed", "A.w")
    result = scene.compile().simulate((0, 4), **TIGHT)
    # Counted at A the brake at B holds 3/r.
    moves = 1.0 + 3.0 / 2.0
    t = result.t
    # w' = (t - moves)/(1 + 1/r^2)
    exact = np.where(t > moves, (t - moves) ** 2 / 2 / 1.25, 0.0)
    assert np.max(np.abs(result["speed"] - exact)) <= CLOSE


def test_members_of_an_ensemble_rub_as_single_runs_do():
    model = oscillator().compile()
    forces = [1.0, 2.0, 3.0]
    settings = {"method": "dop853", "rtol": 1e-10}
    found = model.ensemble((0, 4), {"F": forces}, t_eval=[4.0], progress=False, **settings)
    alone = [model.simulate((0, 4), [4.0], parameters={"F": f}, **settings) for f in forces]
    # Members take the same steps of the same method, so that their bits agree.
    assert np.ravel(found["K.s"]).tolist() == [one["K.s"][0] for one in alone]
