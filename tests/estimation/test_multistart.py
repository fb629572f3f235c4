"""Multistart least squares against closed forms for the discharge of a capacitor."""

from __future__ import annotations

import math

import numpy as np
import pytest

import cotree
from cotree import Settings
from cotree.estimation.conditions import Condition, Measured
from cotree.estimation.estimated import Estimated, spread_starts
from cotree.estimation.multistart import Search, SquareRows, minimise_from_starts
from cotree.estimation.problem import Problem

T = np.linspace(0.0, 6.0, 13)
NOISE = 0.05 * np.random.default_rng(3).standard_normal(13)


@pytest.fixture(scope="module")
def circuit():
    scene = cotree.Scene("discharge")
    scene.parameter("R", 2.0)
    scene.parameter("s", 0.1)
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.5, initial={"v": 4.0})
    scene.edge("R", "resistor", "a", "ground", resistance="R")
    scene.output("sigma", "s")
    return scene.compile(["R", "s", "C.v"])


def problem_of(model, noise, distribution="normal"):
    names = {"R": "R", "s": "s"} if noise == "sigma" else {"R": "R"}
    rows = [Estimated("R", 0.1, 100.0, "log", 2.0), Estimated("v0", 0.0, 10.0, start=3.0)]
    if noise == "sigma":
        rows.append(Estimated("s", 1e-4, 10.0, "log", 0.5))
    value = 5.0 * np.exp(-T / (1.5 * 3.0)) + NOISE
    measured = Measured(
        np.zeros(13, dtype=int), T, ["C.v"] * 13, value, [noise] * 13, distribution=distribution
    )
    run = Condition("run", model, names, {"C.v": "v0"})
    return Problem(rows, [run], measured, Settings(method="dop853", rtol=1e-10, atol=1e-12))


@pytest.mark.parametrize("distribution", ["normal", "laplace"])
def test_least_squares_rows_have_the_value_and_gradient_of_the_likelihood(circuit, distribution):
    problem = problem_of(circuit, "sigma", distribution)
    rows = SquareRows(problem)
    points = [problem.theta([R, 4.0, s]) for R, s in ((2.0, 0.5), (3.0, 0.05), (20.0, 0.3))]
    found = problem.predict(points)
    at = [rows.at(row) for row in found]
    values = [
        0.5 * np.sum(f**2) + problem.likelihood.log_likelihood(p)
        for (f, _), p in zip(at, found, strict=True)
    ]
    # The difference is a constant, up to rounding of sums whose terms reach thousands.
    assert np.ptp(values) < 1e-9
    for (f, along), p in zip(at, found, strict=True):
        wanted = -problem.likelihood.gradient(p)
        assert along.T @ f == pytest.approx(wanted, rel=1e-9, abs=1e-9)


def test_estimated_noise_is_the_root_mean_square_of_the_residuals(circuit):
    given = problem_of(circuit, 0.05)
    (plain,) = minimise_from_starts(given, [given.theta()])
    problem = problem_of(circuit, "sigma")
    best, *_ = minimise_from_starts(problem, spread_starts(problem.estimated, 3, seed=1))
    (found,) = problem.predict([best.theta])
    rms = np.sqrt(np.mean((found.values - problem.measured.value) ** 2))
    assert best.is_converged
    # By maximum likelihood s is the RMS, and the other estimates do not depend on s. The search
    # stops at relative changes of 1e-12 of an objective of about 300 with a curvature of 26 along
    # log(s), which corresponds to a step of 5e-6.
    assert np.exp(best.theta[2]) == pytest.approx(rms, rel=1e-5)
    assert best.theta[:2] == pytest.approx(plain.theta, rel=1e-7)


def test_the_result_of_a_start_does_not_depend_on_other_starts(circuit):
    problem = problem_of(circuit, 0.05)
    starts = spread_starts(problem.estimated, 5, seed=4)
    together = minimise_from_starts(problem, starts)
    assert [row.objective for row in together] == sorted(row.objective for row in together)
    for row in together:
        (alone,) = minimise_from_starts(problem, [row.began])
        assert np.array_equal(alone.theta, row.theta)
        assert alone.n_evaluations == row.n_evaluations


def test_starts_are_reproducible_and_the_guess_comes_first(circuit):
    problem = problem_of(circuit, 0.05)
    a, b = spread_starts(problem.estimated, 8, seed=4), spread_starts(problem.estimated, 8, seed=4)
    assert np.array_equal(a, b)
    assert a[0] == pytest.approx([math.log(2.0), 3.0])
    assert np.all(a >= problem.scaled.lower)
    assert np.all(a <= problem.scaled.upper)
    # A Latin hypercube of seven points has one in each seventh of the range.
    sevenths = np.floor(a[1:, 1] / 10.0 * 7)
    assert sorted(sevenths) == list(range(7))


def test_many_starts_are_searched_in_blocks(circuit, monkeypatch):
    problem = problem_of(circuit, 0.05)
    points = spread_starts(problem.estimated, 7)
    together = minimise_from_starts(problem, points)
    monkeypatch.setattr("cotree.estimation.multistart._SIDE_BY_SIDE", 3)
    apart = minimise_from_starts(problem, points)
    assert [row.began.tolist() for row in apart] == [row.began.tolist() for row in together]
    assert [row.objective for row in apart] == [row.objective for row in together]


def test_a_failing_start_gives_the_reason_and_others_continue(circuit):
    problem = problem_of(circuit, 0.05)
    predict = problem.predict

    def failing(thetas, **options):
        rows = predict(thetas, **options)
        for theta, row in zip(thetas, rows, strict=True):
            if theta[1] > 9.0:
                row.values[:] = np.nan
                object.__setattr__(row, "message", "condition 'run': it broke")
        return rows

    problem.predict = failing
    good, bad = minimise_from_starts(problem, [[0.0, 9.5], [1.0, 5.0]])
    assert good.is_converged
    assert not bad.is_converged
    assert bad.objective == math.inf
    assert bad.message == "condition 'run': it broke"


def test_further_rows_act_as_priors(circuit):
    problem = problem_of(circuit, 0.05)
    target = np.array([math.log(5.0), 2.0])
    strong = minimise_from_starts(
        problem, [problem.theta()], more_rows=lambda x: ((x - target) * 1e6, np.eye(2) * 1e6)
    )
    assert strong[0].theta == pytest.approx(target, rel=1e-6)


def test_an_outlier_counts_less_with_a_robust_loss(circuit):
    problem = problem_of(circuit, 0.05)
    problem.likelihood._target[6] += 3.0
    (plain,) = minimise_from_starts(problem, [problem.theta()])
    (robust,) = minimise_from_starts(problem, [problem.theta()], Search(loss="soft_l1"))
    truth = np.array([math.log(3.0), 5.0])
    assert np.abs(robust.theta - truth).max() < 0.3 * np.abs(plain.theta - truth).max()


def test_errors_in_predictions_propagate(circuit):
    problem = problem_of(circuit, 0.05)

    def broken(thetas):
        raise cotree.ParameterError("broken")

    problem.predict = broken
    with pytest.raises(cotree.ParameterError, match="broken"):
        minimise_from_starts(problem, [problem.theta(), problem.theta()])
