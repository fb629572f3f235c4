"""Stiffness that appears on the way: found by explicit methods, left to others by "auto"."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

from cotree import Scene, load
from cotree.codegen.tableaus import TABLEAUS
from cotree.solvers import select

pytestmark = pytest.mark.compiler

END = 14.0


def thickening():
    """A mass in what thickens as exp(t), pushed so that v = a sin(t)."""
    scene = Scene("thickening")
    scene.parameter("a", 1.0)
    scene.edge("m", "translational_mass", "ground", "A", mass=1.0)
    scene.edge("d", "translational_damper", "ground", "A", damping="exp(t)")
    scene.edge("F", "force_source", "ground", "A", force="a*(exp(t)*sin(t) + cos(t))")
    return scene


def van_der_pol(start):
    """x'' + mu (x^2 - 1) x' + x = 0 with mu = 1000."""
    scene = Scene("van-der-pol")
    scene.parameter("mu", 1e3)
    scene.edge("m", "translational_mass", "ground", "A", mass=1.0)
    scene.edge("s", "translational_spring", "ground", "A", stiffness=1.0, initial={"s": start})
    scene.edge("d", "translational_damper", "ground", "A", damping="mu*(s.s**2 - 1)")
    return scene


def chain(n):
    """Rods that hang on each other and swing without friction."""
    scene = Scene("chain", gravity=[0, -9.81, 0])
    for i in range(n):
        scene.edge(f"h{i}", "revolute", f"B{i}" if i else "ground", f"A{i}", axis=[0, 0, 1])
        scene.edge(f"l{i}", "arm", f"A{i}", f"B{i + 1}", vector=[1, 0, 0])
        scene.edge(f"m{i}", "rigid_body", "ground", f"B{i + 1}", mass=1.0, inertia=0.01)
    return scene


def ratio(text):
    """Evaluate a coefficient in C, a number or one by another."""
    return np.divide(*map(float, f"{text}/1".split("/")[:2]))


@pytest.mark.parametrize("method", list(TABLEAUS))
def test_bounds_are_those_of_the_methods(method):
    row = TABLEAUS[method]
    n = len(row.stages) + 1
    a, b = np.zeros((n, n)), np.zeros(n)
    for i, stage in enumerate(row.stages, 1):
        a[i, list(stage)] = [ratio(text) for text in stage.values()]
    b[list(row.solution)] = [ratio(text) for text in row.solution.values()]

    def growth(z):
        return abs(1.0 - z * b @ np.linalg.solve(np.eye(n) + z * a, np.ones(n)))

    bound = float(row.stable)
    # A little below the bound is stable, which it need not be for long above.
    assert all(growth(z) <= 1.0 for z in np.linspace(0.01, bound, 200))
    assert growth(1.06 * bound) > 1.0


@pytest.mark.parametrize("times", [None, np.linspace(0.0, END, 57), np.array([2.0, 11.0])])
def test_auto_hands_over(times):
    model = thickening().compile(["a"])
    result = model.simulate((0.0, END), times, throw=True)
    work = result.statistics
    assert (work.began_with, work.method) == ("dop853", "rodas5")
    assert "rodas5 took over from dop853 at t = " in result.message
    assert "stiff, from t = " in result.message
    # dop853 alone takes 90,000 steps, rodas5 some hundred.
    assert 300 < work.n_steps < 5000
    assert work.nfev > 8 * work.n_steps
    assert work.njev > 0
    if times is None:
        assert np.all(np.diff(result.t) > 0.0)
        assert len(result.t) == work.n_steps + 1
    else:
        np.testing.assert_array_equal(result.t, times)
    # Stiffness brings errors back to the curve; 1e-8 of the tolerance over a hundred steps.
    np.testing.assert_allclose(result["m.v"], np.sin(result.t), atol=1e-6)
    np.testing.assert_allclose(result.sensitivity("m.v", "a"), np.sin(result.t), atol=1e-6)


def test_van_der_pol_from_where_it_is_not_stiff():
    model = van_der_pol(0.1).compile(["mu"])
    settings = {"t_eval": np.linspace(0.0, 2000.0, 9), "rtol": 1e-11, "atol": 1e-13}
    result = model.simulate((0.0, 2000.0), throw=True, **settings)
    assert (result.statistics.began_with, result.statistics.method) == ("dop853", "rodas5")
    other = model.simulate((0.0, 2000.0), method="rodas5", throw=True, **settings)
    # A jump at slopes of 1e3 enlarges errors of its time; points here are on slow parts.
    np.testing.assert_allclose(result["s.s"], other["s.s"], rtol=1e-8)
    slopes = [r.sensitivity("s.s", "mu") for r in (result, other)]
    np.testing.assert_allclose(*slopes, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("method", list(TABLEAUS))
def test_a_method_that_was_asked_for_goes_on(method):
    result = van_der_pol(0.5).compile().simulate((0.0, 20.0), method=method, throw=True)
    assert result.statistics.method == method
    assert result.statistics.began_with == ""
    assert "The problem is stiff from t = 0.0" in result.message
    assert "rodas5 may take far fewer" in result.message


@pytest.mark.sampled(2)
@pytest.mark.parametrize("rtol", [1e-3, 1e-5, 1e-8, 1e-11])
@pytest.mark.parametrize("method", ["auto", *TABLEAUS])
def test_what_is_not_stiff_is_not_called_so(method, rtol):
    slider, rods = load("slider-pendulum").compile(["L"]), chain(5).compile()
    for model, end in ((slider, 10.0), (slider, 60.0), (rods, 10.0)):
        result = model.simulate((0.0, end), method=method, rtol=rtol, atol=rtol / 100, throw=True)
        assert result.statistics.began_with == ""
        assert "problem is stiff" not in result.message
        assert "continued" not in result.message


def test_events_before_and_after():
    scene = thickening()
    scene.mode("n", 0.0)
    scene.event("up", "m.v - 0.5*a", direction=1, set={"n": "n + 1"})
    result = scene.compile(["a"]).simulate((0.0, END), throw=True)
    assert result.statistics.began_with == "dop853"
    # v = a sin(t) reaches a/2 at times that do not depend on a: twice before, once after.
    exact = np.pi / 6 + 2.0 * np.pi * np.arange(3)
    np.testing.assert_allclose(result.events["up"].t, exact, atol=1e-7)
    np.testing.assert_allclose(result.event_sensitivity("up", "a"), 0.0, atol=1e-6)
    assert result["n"][-1] == 3.0


def test_an_event_that_rests_at_zero_forbids_it():
    scene = thickening()
    scene.edge("m2", "translational_mass", "ground", "B", mass=1.0)
    scene.event("moves", "m2.v", direction=1)
    result = scene.compile().simulate((0.0, 11.0), throw=True)
    assert (result.statistics.method, result.statistics.began_with) == ("dop853", "")
    assert "dop853 continued, although the problem is stiff at t = " in result.message
    assert "the function of event 'moves' is zero there" in result.message
    assert result["m.v"][-1] == pytest.approx(np.sin(11.0), abs=1e-6)


def test_constraints_are_left_to_cvode():
    pytest.importorskip("sksundae")
    scene = Scene("pendulum", gravity=[0, -9.81, 0])
    scene.edge("h", "revolute", "ground", "A", axis=[0, 0, 1], damping="0.1 + exp(t - 4)")
    scene.edge("l", "arm", "A", "B", vector=[1, 0, 0])
    scene.edge("m", "rigid_body", "ground", "B", mass=1.0, inertia=0.1)
    times = np.linspace(0.0, END, 15)
    loose = scene.compile(tree=["l", "m"]).simulate((0.0, END), times, throw=True)
    assert loose.statistics.method == "cvode"
    assert loose.statistics.began_with == "dop853"
    assert "cvode took over from dop853" in loose.message
    assert loose.drift is not None
    assert loose.drift.residual.shape[1] == len(times)
    assert loose.drift.worst < 1e-10  # metres, projected to rounding
    tight = scene.compile().simulate((0.0, END), times, "rodas5", 1e-11, 1e-11, throw=True)
    # The tolerance, 1e-8, through some hundred steps.
    np.testing.assert_allclose(loose["m.theta"], tight["h.theta"], atol=1e-6)


def test_algebraic_unknowns():
    scene = Scene("diode")
    scene.edge("V", "voltage_source", "a", "ground", voltage="sin(t)")
    scene.edge("D", "diode", "a", "b", saturation_current=1e-9)
    scene.edge("R", "resistor", "b", "c", resistance="exp(-t)")
    scene.edge("C", "capacitor", "c", "ground", capacitance=1.0)
    scene.edge("L", "resistor", "c", "ground", resistance="exp(-t)")
    model = scene.compile()
    times = np.linspace(0.0, END, 29)
    result = model.simulate((0.0, END), times, throw=True)
    assert (result.statistics.began_with, result.statistics.method) == ("dop853", "rodas5")
    other = model.simulate((0.0, END), times, "rodas5", 1e-10, 1e-12, throw=True)
    np.testing.assert_allclose(result.y, other.y, rtol=1e-6, atol=1e-7)


def test_budgets_are_shared():
    model = thickening().compile()
    whole = model.simulate((0.0, END))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        part = model.simulate((0.0, END), max_steps=whole.statistics.n_steps - 5)
        spent = model.simulate((0.0, END), max_steps=50)
    assert part.status == -2
    assert part.statistics.n_steps == whole.statistics.n_steps - 5
    assert part.statistics.began_with == "dop853"
    assert f"the limit of {whole.statistics.n_steps - 5} steps is reached" in part.message
    assert whole.t[-7] < part.t[-1] < END
    assert spent.statistics.began_with == ""
    assert "the limit of 50 steps is reached" in spent.message


def test_a_successor_that_fails(monkeypatch):
    solve = select._solve

    def failing(problem, method, *others):
        found = solve(problem, method, *others)
        return replace(found, status=-1, message="It broke.") if method == "rodas5" else found

    monkeypatch.setattr(select, "_solve", failing)
    result = thickening().compile().simulate((0.0, 11.0), throw=True)
    assert (result.statistics.method, result.statistics.began_with) == ("dop853", "")
    assert result.message.startswith("dop853 reached t = 11. dop853 continued, although")
    assert "as short as stability requires: It broke." in result.message
    assert result["m.v"][-1] == pytest.approx(np.sin(11.0), abs=1e-6)


@pytest.mark.parametrize("rtol", [1e-4, 1e-6])
def test_growth_from_below_the_tolerance_is_followed(rtol):
    # Near the rest at x = 0 one mode grows as exp(1000 t) from 1e-9, below the tolerance, and
    # Rosenbrock's steps of 40 of its time constants damp it: they came to rest at x = 7e-6.
    model = van_der_pol(1e-6).compile()
    result = model.simulate((0.0, 2000.0), [2000.0], rtol=rtol, atol=1e-2 * rtol, throw=True)
    tight = model.simulate((0.0, 2000.0), [2000.0], "rodas5", rtol=1e-10, atol=1e-13, throw=True)
    assert result.statistics.began_with == "dop853"
    assert "at the start a mode grows e-fold every 0.001 s, which rodas5 would" in result.message
    # Its first step, of 5.5 time constants, errs by per cents: some 1e-5 s of the whole motion.
    # Where both are at the end, x' is 1; some hundred steps err by the tolerance.
    assert abs(result["s.s"][-1] - tight["s.s"][-1]) < 1e-4 + 100.0 * rtol


def test_growth_that_an_explicit_method_cannot_follow_is_said():
    # Beside what grows e-fold in a second something decays in a microsecond.
    scene = Scene("tipping")
    for name, current in (("u", "u.v"), ("w", "-1e6*w.v")):
        scene.edge(name, "capacitor", name, "ground", capacitance=1.0, initial={"v": 1e-6})
        scene.edge(f"I{name}", "current_source", "ground", name, current=current)
    result = scene.compile().simulate((0.0, 30.0), [30.0], throw=True)
    assert result.statistics.method == "rodas5"
    assert "But at the start a mode grows e-fold every 1 s: what is below" in result.message


def test_equal_runs_change_over_at_the_same_step():
    """The first one takes the steps by which its method is chosen; those that follow know it."""
    # On its way from 0.5 to 2, where modes decay, it is stiff before these steps are over.
    model = van_der_pol(0.5).compile()
    run = {"t_span": (0.0, 400.0), "t_eval": [0.01, 400.0], "rtol": 1e-11, "atol": 1e-11}
    first, second = (model.simulate(**run) for _ in range(2))
    assert first.statistics.began_with == "dop853"
    assert first.message == second.message
    assert first.statistics.n_steps == second.statistics.n_steps
    assert first.y.tobytes() == second.y.tobytes()


@pytest.mark.parametrize("rtol", [1e-6, 1e-8, 1e-10])
def test_a_mode_that_is_stiff_for_a_while(rtol):
    """Where both the switch and the diode block, a current decays within 50 ps.

    At tight tolerances the stages of steps at the bound of stability differ by a small share of
    the tolerance only, but by far more than rounding.
    """
    scene = Scene("buck")
    scene.edge("V", "voltage_source", "in", "ground", voltage=24.0)
    closed = "where(mod(t, 1e-5) < 5e-6, 1, 0)"
    resistances = {"on_resistance": 0.05, "off_resistance": 1e6}
    scene.edge("S", "switch", "in", "x", closed=closed, **resistances)
    scene.edge("F", "diode", "ground", "x", saturation_current=1e-9, thermal_voltage=0.03)
    scene.edge("L", "inductor", "x", "out", inductance=47e-6)
    scene.edge("C", "capacitor", "out", "ground", capacitance=1e-4)
    scene.edge("R", "resistor", "out", "ground", resistance=5.0)
    result = scene.compile().simulate((0, 5e-4), rtol=rtol)
    assert result.status == 0
    assert "rodas5 took over from dop853" in result.message
    # dop853 alone takes more than 200,000.
    assert result.statistics.n_steps < 20_000
