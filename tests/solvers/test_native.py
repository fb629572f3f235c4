"""cotree's own integrators, run by C on compiled models."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
from hand_made import Made
from hard_scenes import bennett_loop

from cotree import Scene, load
from cotree.codegen.c_files import INTEGRATORS
from cotree.solvers import native
from cotree.solvers.engine import load_engine

pytestmark = pytest.mark.compiler

NATIVE = list(INTEGRATORS)


@pytest.fixture(scope="module")
def slider():
    return load("slider-pendulum").compile(["L", "k"])


@pytest.fixture(scope="module")
def forced():
    """A mass, driven by a force that is an input: m x'' = u."""
    scene = Scene("forced")
    scene.input("u", 0.0)
    scene.edge("m", "translational_mass", "ground", "a", mass=2.0)
    scene.edge("f", "force_source", "ground", "a", force="u")
    scene.output("v", "m.v")
    return scene.compile()


@pytest.mark.filterwarnings("ignore:no state was ever larger")  # so that all steps pass
@pytest.mark.parametrize(
    ("method", "order"), [("rkf45", 5), ("dopri5", 5), ("dop853", 8), ("rodas4", 4)]
)
def test_orders_of_states_and_sensitivities(method, order):
    # One linear oscillator, steps held at h and h/2 by the longest step: x = cos(w t).
    scene = Scene("oscillator")
    scene.parameter("c", 1.0)
    scene.edge("L1", "inductor", "a", "ground", inductance=1.0, initial={"i": 0.0})
    scene.edge("C1", "capacitor", "a", "ground", capacitance="c", initial={"v": 1.0})
    model = scene.compile(["c"])
    end, errors = 2.0, []
    steps = (8, 16) if method == "dop853" else (32, 64)
    for n in steps:
        result = model.simulate((0.0, end), [end], method, 1e-2, 1e3, max_step=end / n, throw=True)
        # v = cos(t / sqrt(c)), dv/dc = t sin(t) / 2 at c = 1
        exact = math.cos(end), 0.5 * end * math.sin(end)
        found = result["C1.v"][-1], result.sensitivity("C1.v", "c")[-1]
        errors.append(np.abs(np.subtract(found, exact)))
        assert result.statistics.n_steps <= n + 4  # a short one at the start
    rates = np.log2(errors[0] / errors[1])
    # The first step, chosen by itself, is shorter; rounding is far below.
    assert np.all(np.abs(rates - order) < 0.5), rates


@pytest.mark.parametrize("method", NATIVE)
def test_agrees_with_a_tight_solution_of_another_method(slider, method):
    times = np.linspace(0.0, 10.0, 101)
    reference = slider.simulate((0.0, 10.0), times, "dop853", 1e-12, 1e-13)
    result = slider.simulate((0.0, 10.0), times, method, 1e-9, 1e-9, throw=True)
    assert result.message == f"{method} reached t = 10."
    # The tolerance, through tens to thousands of steps of a motion that stretches errors.
    assert np.abs(result.y - reference.y).max() < 1e-7
    assert np.abs(result.s - reference.s).max() < 2e-6
    assert np.array_equal(result.t, times)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("method", NATIVE)
def test_points_between_steps_are_as_accurate_as_steps(slider, method):
    times = np.linspace(0.0, 3.0, 2001)
    reference = slider.simulate((0.0, 3.0), times, "dop853", 1e-12, 1e-13).y
    found = slider.simulate((0.0, 3.0), times, method, 1e-6, 1e-6).y
    steps = slider.simulate((0.0, 3.0), None, method, 1e-6, 1e-6)
    own = slider.simulate((0.0, 3.0), steps.t, "dop853", 1e-12, 1e-13).y
    at_steps = np.abs(steps.y - own).max()
    # Interpolation is held to a share of the tolerance.
    assert np.abs(found - reference).max() < 2.0 * at_steps + 1e-6


def test_backwards_and_forwards_again(slider):
    there = slider.simulate((0.0, 0.3), [0.3], "dop853", 1e-11, 1e-12)
    initial = dict(zip(slider.states, there.y[:, -1], strict=True))
    back = slider.simulate((0.3, 0.0), [0.1, 0.0], "dop853", 1e-11, 1e-12, initial=initial)
    # The tolerance, stretched by friction that grows backwards.
    np.testing.assert_allclose(back.y[:, -1], slider.initial_state, atol=1e-7)


@pytest.mark.parametrize("method", NATIVE)
def test_tables_and_numbers_in_place_of_inputs(forced, method):
    pulse = ([0.0, 1.0, 1.001, 1.002, 1.003], [0.0, 0.0, 2000.0, 2000.0, 0.0])
    result = forced.simulate((0.0, 5.0), [0.5, 5.0], method, 1e-9, 1e-12, inputs={"u": pulse})
    # The pulse's area is 4 N s: 2 m/s for 2 kg, whatever the steps. Rounding of the times.
    np.testing.assert_allclose(result["v"], [0.0, 2.0], rtol=1e-9, atol=1e-12)
    assert "was used instead" not in result.message
    steady = forced.simulate((0.0, 5.0), [5.0], method, inputs={"u": 3.0})
    assert steady["v"][-1] == pytest.approx(7.5, rel=1e-12)
    assert steady.inputs == ("u",)


def test_budgets(slider):
    with pytest.warns(RuntimeWarning, match="the limit of 7 steps is reached"):
        result = slider.simulate((0.0, 10.0), None, "dop853", max_steps=7)
    assert result.status == -2
    assert result.statistics.n_steps == 7
    assert len(result.t) == 8
    with pytest.warns(RuntimeWarning, match="time limit of 0.05 s is spent"):
        result = slider.simulate((0.0, 1e9), [1e9], "rkf45", time_limit=0.05)
    assert result.status == -2
    assert 0.0 < result.t[-1] < 1e9


@pytest.mark.parametrize("first", [5, 20])
def test_a_second_attempt_takes_what_is_left_of_the_budget(monkeypatch, first):
    steps, jobs = native.Attempt._steps, []

    def failing(attempt, begin, progress, until):
        jobs.append(attempt.job)
        if len(jobs) > 1:
            return steps(attempt, begin, progress, until)
        attempt.job.run(first)
        return native.FAILED, "made up", False

    monkeypatch.setattr(native.Attempt, "_steps", failing)
    model = load("bridge-rectifier").compile()
    with pytest.warns(RuntimeWarning, match="the limit of 20 steps is reached"):
        result = model.simulate((0.0, 0.1), None, "dop853", max_steps=20)
    assert len(jobs) == 2  # unknowns are integrated, then solved for
    assert result.statistics.n_steps == 20 - first
    assert len(result.t) == 1 + 20 - first


@pytest.mark.parametrize("method", NATIVE)
def test_the_last_good_point_of_a_spent_budget(slider, method):
    with pytest.warns(RuntimeWarning, match="the limit of 40 steps"):
        at_steps = slider.simulate((0.0, 10.0), None, method, max_steps=40)
    with pytest.warns(RuntimeWarning, match="the limit of 40 steps"):
        wanted = slider.simulate((0.0, 10.0), [10.0], method, max_steps=40)
    assert wanted.t.tolist() == [at_steps.t[-1]]
    np.testing.assert_array_equal(wanted.y[:, -1], at_steps.y[:, -1])


def test_every_step_is_kept_however_many_there_are(slider):
    result = slider.simulate((0.0, 10.0), None, "rkf45", max_step=1e-3)
    assert result.statistics.n_steps >= 10_000
    assert len(result.t) == result.statistics.n_steps + 1
    assert np.diff(result.t).max() <= 1e-3 * (1 + 1e-9)


@pytest.mark.parametrize("method", NATIVE)
def test_an_explosion_is_reported_where_it_happens(method):
    # v' = v^2 with v(0) = 1: v = 1/(1 - t).
    scene = Scene("explosion")
    scene.edge("C1", "capacitor", "a", "ground", capacitance=1.0, initial={"v": 1.0})
    scene.edge("I1", "current_source", "ground", "a", current="C1.v**2")
    model = scene.compile()
    with pytest.warns(RuntimeWarning, match=f"{method} stopped at t = "):
        result = model.simulate((0.0, 2.0), [0.5, 1.5], method, 1e-6, 1e-8)
    assert result.status == -1
    # At rtol = 1e-6 the pole is placed within 1e-4.
    assert result.t.tolist() == [0.5, pytest.approx(1.0, abs=1e-4)]
    assert result["C1.v"][0] == pytest.approx(2.0, rel=1e-4)
    assert np.all(np.isfinite(result.y))


def _stiff():
    """Two capacitors of very different size behind each other, driven by a sine."""
    scene = Scene("stiff")
    scene.parameter("R", 1.0)
    scene.edge("V", "sine_voltage", "a", "ground", amplitude=1.0, frequency=1.0)
    scene.edge("R1", "resistor", "a", "b", resistance="R")
    scene.edge("C1", "capacitor", "b", "ground", capacitance=1e-6)
    scene.edge("R2", "resistor", "b", "c", resistance=1.0)
    scene.edge("C2", "capacitor", "c", "ground", capacitance=1.0)
    return scene.compile(["R"])


@pytest.mark.sampled(1)
@pytest.mark.parametrize("rtol", [1e-5, 1e-8])
@pytest.mark.parametrize("method", ["rodas4", "rodas5"])
def test_a_stiff_system_takes_few_steps(method, rtol):
    model, times = _stiff(), np.linspace(0.0, 2.0, 41)
    result = model.simulate((0.0, 2.0), times, method, rtol, rtol, throw=True)
    reference = model.simulate((0.0, 2.0), times, "Radau", 1e-11, 1e-13)
    # An explicit method takes a step for each time constant of 0.5e-6 s: millions.
    assert result.statistics.n_steps < 2000
    assert result.statistics.nlu >= result.statistics.n_steps
    # The tolerance, through a hundred steps of a decaying error.
    assert np.abs(result.y - reference.y).max() < 20 * rtol
    # Sensitivities are smaller than their tolerance allows; see the error test.
    assert np.abs(result.s - reference.s).max() < 20 * rtol


@pytest.mark.parametrize("method", ["rodas4", "rodas5"])
def test_algebraic_unknowns_by_a_stiff_method(method):
    model = load("bridge-rectifier").compile(["RL"])
    times = np.linspace(0.0, 0.04, 21)
    result = model.simulate((0.0, 0.04), times, method, 1e-7, 1e-9, throw=True)
    reference = model.simulate((0.0, 0.04), times, "dop853", 1e-10, 1e-12, throw=True)
    # The tolerance, through a thousand steps.
    assert np.abs(result["voltage"] - reference["voltage"]).max() < 1e-5
    found, exact = (r.sensitivity("voltage", "RL") for r in (result, reference))
    assert np.abs(found - exact).max() < 1e-5
    assert result.drift.worst < 1e-9  # currents of amperes, solved to rounding


def _decay(kind):
    """x' = -a x^2, itself, with a time that drives it, or through a root of an equation."""

    def rates(v):
        t, a, x = v["t"], v["a"], v["x"]
        if kind == "algebraic":  # z = x is the one root
            z = v["z"]
            return [-a * x * z, z + z**3 - x - x**3]
        added = t * (x * (1.0 + a * t) - 1.0) if kind == "driven" else 0.0  # zero on the solution
        return [-a * x * x + added]

    unknowns = {"z": 0.9} if kind == "algebraic" else {}
    return Made(f"decay_{kind}", {"x": 1.0}, unknowns, {"a": 1.0}, rates).model(["a"])


@pytest.mark.filterwarnings("ignore:no state was ever larger")  # so that all steps pass
@pytest.mark.parametrize(("method", "order"), [("rodas4", 4), ("rodas5", 5)])
@pytest.mark.parametrize("kind", ["plain", "driven", "algebraic"])
def test_orders_of_stiff_methods(kind, method, order):
    model, end, errors = _decay(kind), 2.0, []
    for n in (32, 64):
        result = model.simulate((0.0, end), [end], method, 1e-2, 1e3, max_step=end / n, throw=True)
        # x = 1 / (1 + a t), dx/da = -t / (1 + a t)^2; an unknown is the same.
        exact = np.array([[1.0, -end / (1.0 + end)]]) / (1.0 + end)
        found = np.hstack([result.y[:, -1:], result.s[:, 0, -1:]])
        errors.append(np.abs(found - exact))
    rates = np.log2(errors[0] / errors[1])
    # Next terms of the error are a few percent of it, those of other sign more.
    assert np.all(np.abs(rates - order) < 0.5), (rates, errors)


@pytest.mark.parametrize("method", ["rodas4", "rodas5"])
def test_a_stiff_method_holds_constraints(method):
    model = load("slider-pendulum").compile(["L"], tree=["m5", "m6", "r3", "r4"])
    times = np.linspace(0.0, 2.0, 21)
    result = model.simulate((0.0, 2.0), times, method, 1e-8, 1e-8, throw=True)
    assert result.statistics.method == method
    reference = model.simulate((0.0, 2.0), times, "dop853", 1e-11, 1e-11)
    # The tolerance, through a few hundred steps of a motion that does not forget.
    assert np.abs(result.y - reference.y).max() < 1e-6
    assert np.abs(result.s - reference.s).max() < 1e-5
    assert result.drift.worst < 1e-11  # metres and radians, projected to rounding


@pytest.mark.slow
def test_a_stiff_method_leaves_dependent_constraints_to_another():
    # Three of Bennett's six conditions are redundant.
    result = bennett_loop().compile().simulate((0.0, 0.01), [0.01], "rodas5", 1e-6, 1e-8)
    assert "cvode was used instead of rodas5: constraints of 'j2' are dependent" in result.message


@pytest.mark.parametrize("method", ["rodas5", "dop853"])
def test_planned_pivots_that_are_zero_are_exchanged(method):
    # The diagonal that the pattern offers holds a parameter, which is zero.
    model = Made(
        "exchanged",
        {"x": 1.0},
        {"y": 0.0, "z": 0.0},
        {"e": 0.0},
        lambda v: [
            -v["y"],
            v["e"] * v["y"] + v["z"] - v["x"],
            v["y"] + v["e"] * v["z"] - 2.0 * v["x"],
        ],
    ).model(["e"])
    result = model.simulate((0.0, 1.0), [1.0], method, 1e-8, 1e-10, throw=True)
    assert result.statistics.method == method
    # At e = 0: y = 2 x, z = x; dy/de = -z, so x' = -2 x and s' = -2 s + x.
    x = math.exp(-2.0)
    found = [result[name][-1] for name in ("x", "y", "z")]
    # The tolerance, through some tens of steps.
    np.testing.assert_allclose(found, [x, 2.0 * x, x], rtol=1e-7)
    # s = t exp(-2 t); y + e z = 2 x and e y + z = x by e: y_e = 2 s - z, z_e = s - y.
    slopes = [result.sensitivity(name, "e")[-1] for name in ("x", "y", "z")]
    np.testing.assert_allclose(slopes, [x, x, -x], rtol=1e-7)


@pytest.mark.parametrize("method", ["rodas4", "rodas5"])
@pytest.mark.parametrize("rtol", [1e-3, 1e-4, 1e-6, 1e-8])
def test_diodes_may_turn_within_a_step(method, rtol):
    """Its end left unknowns hundreds of tolerances off, until an exponential overflowed."""
    model = load("bridge-rectifier").compile()
    times = np.linspace(0.0, 0.04, 81)
    exact = model.simulate((0.0, 0.04), times, "ida", 1e-11, 1e-13, throw=True)
    result = model.simulate((0.0, 0.04), times, method, rtol, rtol / 100, throw=True)
    # Diodes turn eight times, by one to five tolerances of ten volts.
    np.testing.assert_allclose(result.y, exact.y, atol=5 * rtol * 10.0)
    # With what rounds to zero in the error test, it was 2500 of rodas5 and 3200 of rodas4 at 1e-8.
    assert result.statistics.n_steps < 1000
    assert result.drift.worst < 1e-12


def test_a_long_ladder_by_a_stiff_method():
    # More products than are printed as straight lines: the elimination walks through tables.
    scene, n = Scene("ladder"), 700
    for i in range(n):
        scene.edge(f"R{i}", "resistor", f"n{i}" if i else "ground", f"n{i + 1}", resistance=1.0)
        scene.edge(
            f"C{i}", "capacitor", f"n{i + 1}", "ground", capacitance=1e-3, initial={"v": 1.0}
        )
    model = scene.compile()
    result = model.simulate((0.0, 5.0), [5.0], "rodas5", 1e-7, 1e-9, throw=True)
    assert result.statistics.method == "rodas5"
    # v' = A v, from 1 everywhere: by the eigenvectors of the second difference.
    matrix = np.diag(np.full(n - 1, 1.0), 1) + np.diag(np.full(n - 1, 1.0), -1)
    matrix -= np.diag(np.full(n, 2.0))
    matrix[-1, -1] = -1.0
    values, vectors = np.linalg.eigh(1e3 * matrix)
    exact = vectors @ (np.exp(5.0 * values) * (vectors.T @ np.ones(n)))
    found = [result[f"C{i}.v"][-1] for i in range(n)]
    # The tolerance, through some tens of steps.
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-6)


def test_a_wide_system():
    scene = Scene("wide")
    for i in range(300):
        scene.edge(
            f"C{i}", "capacitor", f"n{i}", "ground", capacitance=1.0, initial={"v": float(i)}
        )
        scene.edge(f"R{i}", "resistor", f"n{i}", "ground", resistance=1.0 + i)
    model = scene.compile()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = model.simulate((0.0, 1.0), [1.0], "dopri5", 1e-9, 1e-9)
    exact = np.arange(300) * np.exp(-1.0 / (1.0 + np.arange(300)))
    found = [result[f"C{i}.v"][-1] for i in range(300)]
    np.testing.assert_allclose(found, exact, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("method", NATIVE)
def test_a_spent_budget_leaves_the_last_good_point(slider, method):
    with pytest.warns(RuntimeWarning, match="the limit of 7 steps is reached"):
        result = slider.simulate((0.0, 10.0), [5.0, 10.0], method, 1e-9, 1e-9, max_steps=7)
    reference = slider.simulate((0.0, 10.0), result.t, "dop853", 1e-12, 1e-13)
    assert 0.0 < result.t[-1] < 5.0
    # The tolerance, through seven steps.
    np.testing.assert_allclose(result.y[:, -1], reference.y[:, -1], atol=1e-7)


@pytest.mark.parametrize("method", ["auto", *NATIVE, "cvode", "ida"])
def test_the_engine_without_events_takes_the_same_steps(slider, monkeypatch, method):
    """Models without events run in a shorter engine; both give the same bits."""
    short = slider.simulate((0.0, 3.0), 20, method)
    monkeypatch.setattr(native, "load_engine", lambda stepper, has_events: load_engine(stepper))
    whole = load("slider-pendulum").compile(["L", "k"]).simulate((0.0, 3.0), 20, method)
    assert np.array_equal(short.y, whole.y)
    assert short.statistics.n_steps == whole.statistics.n_steps
