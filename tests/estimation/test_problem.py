"""Estimation problems against closed forms: discharge of a capacitor, and a steady state."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

import cotree
from cotree import Settings
from cotree.estimation.conditions import Condition, Measured
from cotree.estimation.estimated import Estimated
from cotree.estimation.problem import Problem

# Local errors of about 1e-9 accumulate over some fifty steps; this allows for a factor of 100.
CLOSE = 1e-7


@pytest.fixture(scope="module")
def circuit():
    scene = cotree.Scene("discharge")
    scene.parameter("R", 2.0)
    scene.parameter("s", 0.1)
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.5, initial={"v": 4.0})
    scene.edge("R", "resistor", "a", "ground", resistance="R")
    scene.output("power", "C.v**2/R")
    scene.output("sigma", "s*C.v")
    return scene.compile(["R", "s", "C.v"])


def problem_of(model, **changes):
    """Return a problem with an estimated and a known initial voltage and a common resistance."""
    rows = {
        "condition": np.array([0, 0, 1, 1]),
        "t": np.array([1.0, 2.0, 0.0, 3.0]),
        "observable": ("C.v", "power", "C.v", "C.v"),
        "value": np.array([2.5, 2.0, 3.1, 1.2]),
        "noise": (0.1, 0.2, "sigma", "sigma"),
    }
    return Problem(
        [
            Estimated("resistance", 0.1, 100.0, "log10", 2.0),
            Estimated("v0", 0.0, 10.0, start=4.0),
            Estimated("share", 0.01, 1.0, "log", 0.1),
        ],
        [
            Condition("unknown", model, {"R": "resistance", "s": "share"}, {"C.v": "v0"}),
            Condition("known", model, {"R": "resistance", "s": "share"}, {"C.v": 3.0}),
        ],
        Measured(**{**rows, **changes}),
        Settings(method="dop853", rtol=1e-10, atol=1e-12),
    )


def voltage(t, R, v0):
    return v0 * math.exp(-t / (1.5 * R))


def test_predictions_and_their_derivatives_agree_with_the_closed_form(circuit):
    problem = problem_of(circuit)
    R, v0, share = 3.0, 5.0, 0.2
    (found,) = problem.predict([problem.theta([R, v0, share])])
    a, b, c, d = voltage(1, R, v0), voltage(2, R, v0), 3.0, voltage(3, R, 3.0)
    assert found.message == ""
    assert found.values == pytest.approx([a, b**2 / R, c, d], rel=CLOSE)
    assert found.sigma == pytest.approx([0.1, 0.2, share * c, share * d], rel=CLOSE)
    # dv/dR = v t / (1.5 R^2); the derivative by log10(R) is R ln(10) times that.
    by_R = [a * 1 / (1.5 * R), 2 * b * b * 2 / (1.5 * R) / R - b**2 / R, 0, d * 3 / (1.5 * R)]
    assert found.slopes[:, 0] == pytest.approx(np.array(by_R) * math.log(10), rel=CLOSE, abs=1e-9)
    assert found.slopes[:, 1] == pytest.approx([a / v0, 2 * b * b / R / v0, 0, 0], rel=CLOSE)
    assert found.slopes[:, 2] == pytest.approx([0, 0, 0, 0])
    assert found.sigma_slopes[:, 2] == pytest.approx([0, 0, share * c, share * d], rel=CLOSE)


@pytest.mark.parametrize("transformation", ["lin", "log", "log10"])
@pytest.mark.parametrize("distribution", ["normal", "laplace"])
def test_likelihood_agrees_with_scipy_and_its_gradient_with_differences(
    circuit, transformation, distribution
):
    problem = problem_of(circuit, transformation=transformation, distribution=distribution)
    likelihood, theta = problem.likelihood, problem.theta()
    (found,) = problem.predict([theta])
    T = {"lin": np.asarray, "log": np.log, "log10": np.log10}[transformation]
    law = {"normal": stats.norm, "laplace": stats.laplace}[distribution]
    value = np.asarray(problem.measured.value)
    slope = {"lin": 1 + 0 * value, "log": value, "log10": value * math.log(10)}[transformation]
    wanted = np.sum(law.logpdf(T(value), T(found.values), found.sigma) - np.log(slope))
    assert likelihood.log_likelihood(found) == pytest.approx(wanted, rel=1e-12)
    # Steps of 1e-5 give truncation errors of 1e-10, and errors of 1e-10 / 1e-5 from the runs.
    aside = [theta + sign * 1e-5 * row for row in np.eye(3) for sign in (1, -1)]
    moved = [likelihood.log_likelihood(row) for row in problem.predict(aside)]
    differences = [(a - b) / 2e-5 for a, b in zip(moved[::2], moved[1::2], strict=True)]
    assert likelihood.gradient(found) == pytest.approx(differences, rel=1e-5, abs=1e-5)


def test_predictions_do_not_depend_on_other_members(circuit):
    problem = problem_of(circuit)
    thetas = [problem.theta([R, 4.0, 0.1]) for R in (1.0, 2.0, 5.0)]
    together = problem.predict(thetas)
    for theta, found in zip(thetas, together, strict=True):
        (alone,) = problem.predict([theta])
        assert np.array_equal(found.values, alone.values)
        assert np.array_equal(found.slopes, alone.slopes)


def test_a_failing_run_is_reported_with_its_condition(circuit):
    problem = problem_of(circuit)
    good, bad = problem.predict([problem.theta(), [math.nan, 4.0, 0.0]])
    assert good.message == ""
    assert bad.message.startswith("condition 'unknown': ")
    assert np.isnan(bad.values).any()


def test_a_run_starts_from_a_steady_state_with_its_sensitivities():
    """A <-> B conserves the total: B has the steady state a0 k / (k + r) and then decays."""
    scene = cotree.Scene("exchange")
    for name, value in (("k", 0.8), ("r", 0.4), ("on", 1.0)):
        scene.parameter(name, value)
    scene.edge("A", "species", "A", "ground", volume=1.0, initial={"c": 1.0})
    scene.edge("B", "species", "B", "ground", volume=1.0, initial={"c": 0.0})
    scene.edge("forth", "reaction", reactants=["A"], products=["B"], rate="k*on")
    scene.edge("back", "reaction", reactants=["B"], products=["A"], rate="r")
    model = scene.compile(["k", "r", "A.c"])
    before = Condition("rest", model, {"k": "k", "r": "r", "on": 1.0}, {"A.c": "a0", "B.c": 0.0})
    later = Condition("off", model, {"k": "k", "r": "r", "on": 0.0}, before=before)
    rows = Measured(np.array([0, 0]), np.array([0.0, 2.0]), ["B.c"] * 2, np.ones(2), [1.0, 1.0])
    names = [Estimated(name, 1e-3, 1e3, start=1.0) for name in ("k", "r", "a0")]
    problem = Problem(names, [later], rows, Settings(rtol=1e-9, atol=1e-12))
    k, r, a0 = 0.8, 0.4, 3.0
    (found,) = problem.predict([[k, r, a0]])
    b, decay = a0 * k / (k + r), math.exp(-2 * r)
    slopes = np.array([b * r / (k * (k + r)), -b / (k + r), b / a0])
    assert found.values == pytest.approx([b, b * decay], rel=CLOSE)
    assert found.slopes[0] == pytest.approx(slopes, rel=CLOSE)
    assert found.slopes[1] == pytest.approx(slopes * decay + [0, -2 * b * decay, 0], rel=CLOSE)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"value": np.array([1, math.nan, 1, 1])}, "value 1 of 'power' in condition 'unknown' is"),
        ({"t": np.array([1.0, -2.0, 0.0, 3.0])}, "is at t = -2, but the run begins at t = 0"),
        (
            {"observable": ("C.v", "powr", "C.v", "C.v")},
            "'powr', but the model has no such state or output",
        ),
        ({"noise": (0.1, 0.0, 0.1, 0.1)}, "has the standard deviation 0.0"),
        ({"noise": (0.1, 0.2)}, "there are 4 values, but 'noise' has 2 rows"),
        ({"transformation": "log2"}, "the transformation of a measured value is 'log2'"),
    ],
)
def test_invalid_rows_are_refused(circuit, changes, message):
    with pytest.raises(cotree.ParameterError, match=message):
        problem_of(circuit, **changes)


def test_invalid_bounds_and_scales_are_refused():
    with pytest.raises(cotree.ParameterError, match="the lower one must be below"):
        Estimated("k", 2.0, 1.0)
    with pytest.raises(cotree.ParameterError, match="bounds must not be negative"):
        Estimated("k", -1.0, 1.0, "log")
    with pytest.raises(cotree.ParameterError, match="the scale of 'k'"):
        Estimated("k", 1.0, 2.0, "ln")
