"""Dry friction in joints of mechanisms: of a constant torque, and with the load of the joint."""

from itertools import pairwise
from math import atan, cos, exp, radians, sin, sqrt, tan

import numpy as np
import pytest
from scipy.optimize import brentq

import cotree
from cotree.errors import ExpressionError, SolveError

TIGHT = {"method": "dop853", "rtol": 1e-11, "atol": 1e-13}
CLOSE = 1e-9
G = 9.81


def pendulum(torque, **values):
    """Build a mass on a rod without mass, hinged to the ground with friction."""
    scene = cotree.Scene("pendulum", gravity=[0, -G, 0])
    for name, value in {"m": 2.0, "l": 1.3, "th": 1.2, **values}.items():
        scene.parameter(name, value)
    scene.edge("h", "revolute", "ground", "A", axis=[0, 0, 1], initial={"theta": "th"})
    scene.edge("rod", "arm", "A", "B", vector=[0, "-l", 0])
    scene.edge("b", "rigid_body", "ground", "B", mass="m")
    scene.output("load", "sqrt(h.fx**2 + h.fy**2)")
    scene.edge("R", "rotational_dry_friction", joint="h", torque=torque)
    scene.output("held", "R.tau")
    return scene


def test_a_pendulum_loses_what_its_pivot_takes_in_each_swing():
    m, length, torque, start = 2.0, 1.3, 1.7, 1.2
    swings = [start]
    # m g l (cos a1 - cos a0) = tau (a0 + a1), until friction holds the weight.
    while m * G * length * sin(swings[-1]) > torque:
        a = swings[-1]

        def left(b, a=a):
            return m * G * length * (cos(b) - cos(a)) - torque * (a + b)

        # The other root, b = -a, is where it begins.
        swings.append(brentq(left, 1e-3 - a, a, xtol=1e-15))
    assert len(swings) > 3
    names = ["T", "th", "m", "l"]
    result = pendulum("T", T=torque).compile(names).simulate((0, 20), **TIGHT)
    stops = result.events["R stops"]
    found = [float(np.interp(t, result.t, result["h.theta"])) for t in stops.t]
    signs = [(-1) ** n for n in range(1, len(swings))]
    assert np.max(np.abs(np.array(found) - np.array(signs) * swings[1:])) <= CLOSE
    # Held there, by what the weight asks for.
    rest = result["h.theta"][-1]
    assert result["R.mode"][-1] == 0.0
    assert abs(result["held"][-1] + m * G * length * sin(rest)) <= 1e-8
    # The derivative of each amplitude follows from its relation, and from that of the one before.
    slopes = {"T": 0.0, "th": 1.0, "m": 0.0, "l": 0.0}
    weight = m * G * length
    for a, b in pairwise(swings):
        own = {"T": a + b, "th": 0.0}
        own |= {"m": -G * length * (cos(b) - cos(a)), "l": -G * m * (cos(b) - cos(a))}
        for name in names:
            along = own[name] - (weight * sin(a) - torque) * slopes[name]
            slopes[name] = along / (-weight * sin(b) - torque)
    for name in names:
        assert abs(result.sensitivity("h.theta", name)[-1] - signs[-1] * slopes[name]) <= 1e-8


def test_a_pivot_whose_friction_follows_its_reaction_takes_what_its_closed_form_says():
    """Friction c N at a mass on a rod: N^2 is (m (l w^2 + g cos th))^2 + (c N / l)^2."""
    m, length, c, start = 2.0, 1.3, 0.1, 1.2
    k = c / length / sqrt(1 - (c / length) ** 2)
    result = pendulum("c*load", c=c).compile().simulate((0, 15), **TIGHT)
    radial = m * (length * result["h.theta_dot"] ** 2 + G * np.cos(result["h.theta"]))
    slides = np.abs(np.rint(result["R.mode"])) == 1
    exact = k * length * radial * np.sign(result["R.mode"])
    assert np.max(np.abs(result["held"] - exact)[slides]) <= CLOSE
    # With u = w^2 over the angle the motion of each swing is linear: u' = 2 k u + ...
    a = 6 * k * G / length / (1 + 4 * k**2)
    b = (2 - 4 * k**2) * G / length / (1 + 4 * k**2)

    def square(th, first):
        known = -(a * sin(first) + b * cos(first)) * exp(2 * k * (th - first))
        return known + a * sin(th) + b * cos(th)

    swings = [start]
    while tan(swings[-1]) > k:  # on the way to rest w = 0: c N holds m g l sin(th)
        first = swings[-1]
        # u is zero at the start of the swing, and again behind the lowest point.
        swings.append(-brentq(square, -first, first - 1e-3, args=(first,), xtol=1e-15))
    found = [float(np.interp(t, result.t, result["h.theta"])) for t in result.events["R stops"].t]
    assert len(found) == len(swings) - 1 > 3
    signs = [(-1) ** n for n in range(1, len(swings))]
    assert np.max(np.abs(np.array(found) - np.array(signs) * swings[1:])) <= CLOSE
    # At rest the hinge bears the weight, m g, and holds it at its angle.
    assert abs(result["load"][-1] - m * G) <= 1e-8
    assert abs(result["held"][-1] + m * G * length * sin(result["h.theta"][-1])) <= 1e-8


@pytest.mark.slow
def test_sensitivities_of_friction_that_follows_a_reaction_agree_with_differences():
    names = ["c", "th", "l", "m"]
    model = pendulum("c*load", c=0.1).compile(names)
    _agree_with_differences(model, 3.0, names, ["h.theta", "held", "load"])
    _agree_with_differences(model, 15.0, names, ["h.theta", "held"])


def _agree_with_differences(model, end, names, variables):
    given = dict(zip(model.parameters, model.default_parameters, strict=True))
    result = model.simulate((0, end), **TIGHT)
    for name in names:
        h = 1e-5 * given[name]
        sides = [
            model.simulate((0, end), parameters={name: given[name] + d}, **TIGHT) for d in (h, -h)
        ]
        for variable in variables:
            difference = (sides[0][variable][-1] - sides[1][variable][-1]) / (2 * h)
            # Second-order errors h^2 and rounding over h, both below 1e-7 of derivatives of size 1.
            size = max(1.0, abs(difference))
            assert abs(result.sensitivity(variable, name)[-1] - difference) <= 1e-6 * size


@pytest.mark.sampled(1)
@pytest.mark.parametrize("tilt", [10.0, 25.0])
def test_a_block_in_a_guide_rubs_with_what_the_guide_bears(tilt):
    """It slides up a slope, stops, and stays there or comes back."""
    mu, rest, v0, slope = 0.3, 0.4, 3.0, radians(tilt)
    scene = cotree.Scene("slope", gravity=[0, -G, 0])
    scene.parameter("mu", mu)
    way = [cos(slope), sin(slope), 0]
    scene.edge("j", "prismatic", "ground", "A", axis=way, initial={"s_dot": v0})
    scene.edge("b", "rigid_body", "ground", "A", mass=1.7)
    scene.output("N", f"-j.fx*{sin(slope)!r} + j.fy*{cos(slope)!r}")
    scene.edge("R", "translational_dry_friction", joint="j", force="mu*N", breakaway=f"{rest}*N")
    result = scene.compile(["mu"]).simulate((0, 3), **TIGHT)
    up = G * (sin(slope) + mu * cos(slope))
    assert abs(result.events["R stops"].t[0] - v0 / up) <= CLOSE
    by_mu = -v0 / up**2 * G * cos(slope)
    assert abs(result.event_sensitivity("R stops", "mu")[0] - by_mu) <= CLOSE
    back = G * (sin(slope) - mu * cos(slope)) if tan(slope) > rest else 0.0
    assert abs(result["j.s_dot"][-1] + back * (3.0 - v0 / up)) <= CLOSE
    assert (slope > atan(rest)) == (back > 0)


def linkage():
    """Build a crank with a coupler and a slider, whose loop the slider's hinge closes."""
    scene = cotree.Scene("slider-crank", gravity=[0, -G, 0])
    for name, value in {"c": 0.02, "w": 3.0, "m": 1.0}.items():
        scene.parameter(name, value)
    axis = [0, 0, 1]
    start = {"theta": 1.0, "theta_dot": "w"}
    scene.edge("h1", "revolute", "ground", "A", axis=axis, initial=start)
    scene.edge("crank", "arm", "A", "B", vector=[0.5, 0, 0])
    scene.edge("m1", "rigid_body", "ground", "B", mass="m", inertia=0.1)
    tilt = "asin(0.5*sin(1)/1.2)"
    scene.edge("h2", "revolute", "B", "C", axis=axis, initial={"theta": f"-1 - {tilt}"})
    scene.edge("coupler", "arm", "C", "D", vector=[1.2, 0, 0])
    scene.edge("m2", "rigid_body", "ground", "D", mass="m", inertia=0.1)
    along = {"s": f"0.5*cos(1) + 1.2*cos({tilt})"}
    scene.edge("rail", "prismatic", "ground", "E", axis=[1, 0, 0], initial=along)
    scene.edge("m3", "rigid_body", "ground", "E", mass="m")
    scene.edge("pin", "revolute", "E", "D", axis=axis)
    scene.edge("R", "rotational_dry_friction", joint="h1", torque="c*sqrt(h1.fx**2 + h1.fy**2)")
    scene.output("energy", "energy.kinetic + energy.potential")
    scene.output("held", "R.tau")
    return scene


@pytest.mark.slow
def test_a_closed_chain_whose_crank_rubs_with_its_load():
    model = linkage().compile(["c", "w", "m"])
    result = model.simulate((0, 4), method="dop853", rtol=1e-10)
    assert result.success
    # Each step adds its error, a tolerance of 1e-10 of some joules.
    assert np.max(np.diff(result["energy"])) <= 1e-7
    assert result["energy"][-1] < result["energy"][0] - 1.0
    _agree_with_differences(model, 0.8, ["c", "w", "m"], ["h1.theta", "held"])


def test_reactions_in_other_fields_are_refused_with_where_they_may_be():
    scene = pendulum("c*load", c=0.1)
    scene.edge("T", "torque_source", joint="h", torque="0.1*load")
    with pytest.raises(
        ExpressionError, match=r"'h.fx'.*in fields of friction and dampers on joints only"
    ):
        scene.compile()
    scene = pendulum("c*h.fq", c=0.1)
    with pytest.raises(ExpressionError, match="edge 'h' has no variable 'fq'"):
        scene.compile()


def test_an_equilibrium_of_a_pendulum_is_where_its_pivot_holds_it():
    model = pendulum("c*load", c=0.1).compile()
    point = model.trim(guess={"h.theta": 0.05})
    assert abs(point["h.theta"] - 0.05) <= 1e-12
    assert abs(point["held"] + 2.0 * G * 1.3 * sin(0.05)) <= 1e-9
    # At rest the hinge bears m g, so that c m g is all that it holds.
    most = 2.0 * G * 1.3 * sin(0.5) - 0.1 * 2.0 * G
    with pytest.raises(SolveError, match=rf"'R' sticks .* exceeds its limit by {most:.4f}"):
        model.trim(guess={"h.theta": 0.5})


@pytest.mark.sampled(1)
@pytest.mark.parametrize("method", ["dopri5", "rodas5", "cvode", "ida"])
def test_every_method_that_takes_events_finds_friction_with_its_reaction(method):
    model = pendulum("c*load", c=0.1).compile(["c"])
    exact = model.simulate((0, 4), **TIGHT)
    result = model.simulate((0, 4), method=method, rtol=1e-8)
    # Errors of some tens of tolerances, those of the multistep methods being the largest.
    assert abs(result["h.theta"][-1] - exact["h.theta"][-1]) <= 1e-6
    assert (
        abs(result.sensitivity("h.theta", "c")[-1] - exact.sensitivity("h.theta", "c")[-1]) <= 2e-6
    )


def test_methods_of_scipy_refuse_friction_by_name():
    with pytest.raises(SolveError, match="'Radau' cannot take events, such as 'R stops'"):
        pendulum("T", T=1.0).compile().simulate((0, 1), method="Radau")


@pytest.mark.parametrize("mu", [0.0, 0.9])
def test_joint_friction_has_no_impulse_when_another_joint_hits_its_stop(mu):
    scene = cotree.Scene("double", gravity=[0, -G, 0])
    scene.parameter("mu", mu)
    e, m1, m2, l1, l2, i1, i2 = 0.5, 1.0, 0.7, 1.0, 0.8, 0.1, 0.05
    given = {"theta": 0.3, "theta_dot": -2.0}
    scene.edge("h1", "revolute", "ground", "A", axis=[0, 0, 1], initial=given)
    scene.edge("a1", "arm", "A", "B", vector=[0, -l1, 0])
    scene.edge("b1", "rigid_body", "ground", "B", mass=m1, inertia=i1)
    given = {"theta": 0.4, "theta_dot": -1.0}
    scene.edge("h2", "revolute", "B", "C", axis=[0, 0, 1], initial=given)
    scene.edge("a2", "arm", "C", "D", vector=[0, -l2, 0])
    scene.edge("b2", "rigid_body", "ground", "D", mass=m2, inertia=i2)
    torque = "0.05*mu*sqrt(h1.fx**2 + h1.fy**2)"
    scene.edge("R", "rotational_dry_friction", joint="h1", torque=torque)
    scene.edge("stop", "rotational_rigid_stop", joint="h2", lower=0.1, restitution=e)
    result = scene.compile().simulate((0, 0.5), **TIGHT)
    hits = result.events["stop hits"]
    before, after = (
        dict(zip(result.states, y[:, 0], strict=True)) for y in (hits.y_before, hits.y_after)
    )
    # The impulse acts on the second hinge only, and the mass matrix transmits it.
    a, c = before["h1.theta"], before["h1.theta"] + before["h2.theta"]
    first = l1 * np.array([[cos(a), 0], [sin(a), 0]])
    second = l2 * np.array([[cos(c), cos(c)], [sin(c), sin(c)]]) + first
    turns = np.array([[1, 0]]), np.array([[1, 1]])
    mass = m1 * first.T @ first + m2 * second.T @ second
    mass += i1 * turns[0].T @ turns[0] + i2 * turns[1].T @ turns[1]
    change = np.linalg.solve(mass, [0, 1])
    change *= -(1 + e) * before["h2.theta_dot"] / change[1]
    for name, own in zip(("h1.theta_dot", "h2.theta_dot"), change, strict=True):
        assert abs(after[name] - before[name] - own) <= 1e-13
