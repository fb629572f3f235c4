"""Results of fits against linear regression, closed forms and published optimal designs."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from scipy import stats

import cotree
from cotree import Settings
from cotree.estimation.candidates import Candidates
from cotree.estimation.conditions import Condition, Measured
from cotree.estimation.estimated import Estimated
from cotree.estimation.multistart import StartRecord, minimise_from_starts
from cotree.estimation.problem import Problem
from cotree.estimation.result import FitResult

# With tolerances of 1e-10 for runs and objective, parameters have about six correct digits.
CLOSE = 1e-6
FINE = Settings(method="dop853", rtol=1e-10, atol=1e-12)


def fitted(problem, *starts, search=None, **options):
    points = np.array([problem.theta(row) for row in (starts or [None])])
    found = minimise_from_starts(problem, points, search, progress=False, **options)
    return FitResult(problem, found, search, **options)


def at_start(problem):
    """Return a result with the initial guesses as estimates."""
    theta = problem.theta()
    (found,) = problem.predict([theta])
    objective = -problem.likelihood.log_likelihood(found)
    return FitResult(problem, [StartRecord(theta, theta, objective, 1, True, "converged")])


def rows_of(names, t, value, noise):
    n = len(t)
    return Measured(np.zeros(n, int), np.asarray(t, float), names, np.asarray(value), [noise] * n)


@pytest.fixture(scope="module")
def line():
    """A free mass with the motion x = a + b t."""
    scene = cotree.Scene("line", gravity=(0, 0, 0))
    scene.parameter("s", 0.1)
    scene.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], initial={"s": 0.0, "s_dot": 1.0})
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0)
    scene.output("sigma", "s")
    return scene.compile(["j.s", "j.s_dot", "s"])


T = np.linspace(0.0, 2.0, 9)
Y = 1.0 + 0.5 * T + 0.1 * np.random.default_rng(3).standard_normal(9)


def line_problem(line, t=T, y=Y, noise=0.1, more=(), **scales):
    names = [
        Estimated("a", -10.0, 10.0, start=0.5, unit="m"),
        Estimated("b", -10.0, 10.0, start=0.4, unit="m/s"),
        *more,
    ]
    initial = {"j.s": "a", "j.s_dot": "b"}
    parameters = {row.name: row.name for row in more}
    condition = Condition("run", line, parameters, initial)
    return Problem(names, [condition], rows_of(["j.s"] * len(t), t, y, noise), FINE)


def test_intervals_with_given_noise_agree_with_linear_regression(line):
    result = fitted(line_problem(line))
    X = np.column_stack([np.ones(9), T])
    cov = 0.01 * np.linalg.inv(X.T @ X)
    best = np.linalg.lstsq(X, Y)[0]
    assert list(result.parameters.values()) == pytest.approx(best, rel=CLOSE)
    assert result.covariance == pytest.approx(cov, rel=CLOSE)
    reach = stats.norm.ppf(0.975) * np.sqrt(cov[0, 0])
    assert result.intervals()["a"] == pytest.approx((best[0] - reach, best[0] + reach), rel=CLOSE)
    assert result.correlation[0, 1] == pytest.approx(cov[0, 1] / math.sqrt(cov[0, 0] * cov[1, 1]))
    assert result.degrees_of_freedom == 7
    assert result.chi2 == pytest.approx(np.sum((X @ best - Y) ** 2) / 0.01, rel=CLOSE)
    assert result.findings == ()
    relative = np.outer(best, best) * np.linalg.inv(cov)
    assert result.eigenvalues == pytest.approx(np.linalg.eigvalsh(relative), rel=1e-5)


def test_intervals_with_estimated_noise_agree_with_linear_regression(line):
    """With the factor n/(n - p) and Student's t, as in statsmodels and R."""
    sigma = Estimated("s", 1e-4, 10.0, "log", 0.05)
    result = fitted(line_problem(line, noise="sigma", more=[sigma]))
    own = stats.linregress(T, Y)
    assert result.parameters["b"] == pytest.approx(own.slope, rel=CLOSE)
    assert result.standard_errors["b"] == pytest.approx(own.stderr, rel=1e-5)
    assert result.uncertainty.freedom == 7.0
    reach = stats.t(7).ppf(0.975) * own.stderr
    assert np.ptp(result.intervals()["b"]) == pytest.approx(2 * reach, rel=1e-5)
    assert min(result.intervals()["s"]) > 0.0
    assert "Student's t with 7 degrees" in str(result)
    # Profile limits are located to 0.005 in the rise t^2, which is 0.001 standard errors in t.
    assert result.profile("b").interval == pytest.approx(
        result.intervals()["b"], abs=2e-3 * own.stderr
    )


def test_bands_with_estimated_noise_agree_with_linear_regression(line):
    sigma = Estimated("s", 1e-4, 10.0, "log", 0.05)
    result = fitted(line_problem(line, noise="sigma", more=[sigma]))
    t = np.array([0.0, 1.0, 4.0])
    X, Xt = np.column_stack([np.ones(9), T]), np.column_stack([np.ones(3), t])
    residuals = Y - X @ np.linalg.lstsq(X, Y)[0]
    s = math.sqrt(residuals @ residuals / 7)
    leverage = np.einsum("ij,jk,ik->i", Xt, np.linalg.inv(X.T @ X), Xt)
    reach = stats.t(7).ppf(0.975) * s * np.sqrt(1 + leverage)
    band = result.bands("j.s", t, noise=True)
    assert band.upper - band.value == pytest.approx(reach, rel=1e-5)
    drawn = result.bands("j.s", t, noise=True, draws=20000, seed=1)
    # Quantiles of 20000 draws of t with 7 degrees have standard errors of about 0.02 deviations.
    assert drawn.upper - drawn.value == pytest.approx(reach, rel=0.05)


def test_profiles_of_a_linear_model_are_parabolas(line):
    result = fitted(line_problem(line))
    for name, profile in result.profiles().items():
        error = result.standard_errors[name]
        wanted = ((profile.values - profile.estimate) / error) ** 2
        assert profile.rise == pytest.approx(wanted, rel=1e-4, abs=1e-6)
        values, rise = profile.curve(51)
        wanted = ((values - profile.estimate) / error) ** 2
        assert rise == pytest.approx(wanted, rel=1e-3, abs=1e-5)
        # Limits are located to 0.005 in the rise z^2 = 3.84, which is 0.0013 standard errors in z.
        assert profile.interval == pytest.approx(result.intervals()[name], abs=2e-3 * error)
        assert profile.is_closed == (True, True)


def test_the_band_of_a_line_agrees_with_linear_regression(line):
    result = fitted(line_problem(line))
    t = np.array([0.0, 1.0, 4.0])
    X = np.column_stack([np.ones(3), t])
    error = np.sqrt(np.einsum("ij,jk,ik->i", X, result.covariance, X))
    band = result.bands("j.s", t)
    assert band.error == pytest.approx(error, rel=CLOSE)
    assert band.upper - band.value == pytest.approx(stats.norm.ppf(0.975) * error, rel=CLOSE)
    noisy = result.bands("j.s", t, noise=True, level=0.5)
    assert noisy.upper - noisy.value == pytest.approx(
        stats.norm.ppf(0.75) * np.hypot(error, 0.1), rel=CLOSE
    )
    drawn = result.bands("j.s", t, draws=4000, seed=1)
    # Quantiles of 4000 draws have standard errors of about 0.04 deviations.
    assert drawn.upper == pytest.approx(band.upper, abs=0.15 * error.max())


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda r: r.bands("j.q"), "the model has no state or output 'j.q'"),
        (lambda r: r.bands("j.s", [-1.0]), "the time -1 s is before the start of the run"),
        (lambda r: r.bands("j.s", "a"), "the times are 'a': give finite numbers"),
        (lambda r: r.bands("j.s", level="a"), "level is 'a': give a number"),
        (lambda r: r.bands("j.s", draws=-1), "draws is -1"),
        (lambda r: r.bands("j.s", experiment=None), "experiment is None"),
        (lambda r: r.intervals(1.5), "level is 1.5: give a confidence level between 0 and 1"),
        (lambda r: r.profile("c"), "'c' is not estimated"),
        (lambda r: r.next_measurements({"j.s": T}, "a"), "n is 'a': give a whole number"),
        (lambda r: r.next_measurements({"j.s": T}, 30, repeat=False), "30 measurements cannot be"),
        (lambda r: r.next_measurements({"j.s": {"times": T}}, 1), "candidates of 'j.s' have the"),
        (lambda r: r.next_measurements({"j.s": {}}, 1), "candidates of 'j.s' have no times 't'"),
        (
            lambda r: r.next_measurements({"j.s": {"t": T, "inputs": {"u": "2*t"}}}, 1),
            "input 'u' of candidates is an expression",
        ),
        (lambda r: r.problem.predict([0.0, 1.0]), "thetas must be an array of shape"),
    ],
)
def test_invalid_requests_to_a_result_are_refused(line, ask, message):
    with pytest.raises(cotree.ParameterError) as caught:
        ask(at_start(line_problem(line)))
    assert str(caught.value).startswith(message)


def test_the_next_measurements_of_a_line_are_its_ends(line):
    """The D-optimal design for a line measures both ends equally often."""
    result = at_start(line_problem(line, [0.9, 1.1], [1.0, 1.0], noise=100.0))
    chosen = result.next_measurements({"j.s": (np.linspace(0, 2, 21), 0.1)}, 4)
    assert sorted(row.t for row in chosen) == [0.0, 0.0, 2.0, 2.0]
    X = np.column_stack([np.ones(4), [0, 0, 2, 2]])
    errors = np.sqrt(np.diag(0.01 * np.linalg.inv(X.T @ X)))
    assert list(chosen[-1].errors.values()) == pytest.approx(errors, rel=1e-4)
    once = result.next_measurements({"j.s": (np.linspace(0, 2, 21), 0.1)}, 4, repeat=False)
    assert sorted(row.t for row in once) == pytest.approx([0.0, 0.1, 1.9, 2.0])


def test_a_measurement_that_determines_something_comes_first(line):
    """Data at a single time determine only a + b t; any other time makes both identifiable."""
    result = fitted(line_problem(line, [1.0, 1.0], [1.4, 1.6]))
    assert result.undetermined == (
        "Only the sum a + b is determined, not a and b individually: fix one of them to estimate "
        "the rest.",
    )
    assert all(math.isinf(x) for x in result.standard_errors.values())
    assert result.degrees_of_freedom == 1
    band = result.bands("j.s", [0.0, 1.0])
    assert math.isinf(band.error[0])
    assert band.error[1] == pytest.approx(0.1 / math.sqrt(2), rel=1e-5)
    candidates = [Candidates("j.s", [1.0, 3.0]), Candidates("j.s_dot", [0.0], 10.0)]
    first, second = result.next_measurements(candidates, 2)
    assert (first.output, first.t, first.determines) == ("j.s", 3.0, ("a", "b"))
    assert second.determines == ()
    assert "determines a, b" in str(result.next_measurements(candidates, 2))
    # Towards lower values b reaches its bound of 10; towards higher values no limit is reached.
    profile = result.profile("a")
    lower = 1.5 - 10.0 - stats.norm.ppf(0.975) * 0.1 / math.sqrt(2)
    assert profile.interval == pytest.approx((lower, 10.0), abs=1e-3)
    assert profile.sentence == "95 % interval -8.6386 to 10 m; no upper limit within the bounds"


@pytest.fixture(scope="module")
def decay():
    """C v' = -v/R, which depends on the product R C only."""
    scene = cotree.Scene("decay")
    for name, value in (("R", 2.0), ("C", 0.5), ("idle", 1.0)):
        scene.parameter(name, value)
    scene.edge("C", "capacitor", "a", "ground", capacitance="C", initial={"v": 1.0})
    scene.edge("R", "resistor", "a", "ground", resistance="R")
    scene.edge("X", "resistor", "b", "ground", resistance="idle")
    scene.edge("Y", "capacitor", "b", "ground", capacitance=1.0, initial={"v": 1.0})
    return scene.compile(["R", "C", "idle", "C.v"])


def decay_problem(decay, names, t=(0.5, 1.0, 2.0), noise=0.01, initial=None):
    t = np.array(t)
    scales = {"R": "log", "C": "lin", "idle": "log10"}
    begin = {"R": 2.0, "C": 0.5, "idle": 1.0}
    rows = [Estimated(n, 1e-2, 1e2, scales[n], begin[n]) for n in names if n != "v0"]
    rows += [Estimated("v0", 0.0, 10.0, start=1.0)] if "v0" in names else []
    condition = Condition("run", decay, {n: n for n in names if n != "v0"}, initial or {})
    value = np.exp(-t) + noise * np.array([(-1.0) ** i for i in range(len(t))])
    return Problem(rows, [condition], rows_of(["C.v"] * len(t), t, value, noise), FINE)


def test_identifiable_products_and_unused_parameters_are_named(decay):
    result = fitted(decay_problem(decay, ["R", "C", "idle"]))
    idle, product = result.undetermined
    assert idle == "No measured value depends on idle, so it cannot be estimated."
    assert product.startswith("Only R*C is determined, not R and C individually")
    assert result.parameters["R"] * result.parameters["C"] == pytest.approx(1.0, abs=0.05)
    assert "not determined" in str(result)
    json.loads(result.to_json())


def test_identifiable_ratios_are_named():
    scene = cotree.Scene("oscillator", gravity=(0, 0, 0))
    for name, value in (("k", 4.0), ("m", 1.0), ("c", 0.3)):
        scene.parameter(name, value)
    joint = {"axis": [1, 0, 0], "stiffness": "k", "damping": "c", "initial": {"s": 1.0}}
    scene.edge("j", "prismatic", "ground", "A", **joint)
    scene.edge("b", "rigid_body", "ground", "A", mass="m")
    model = scene.compile(["k", "m", "c"])
    t = np.linspace(0.1, 5, 20)
    rows = [Estimated(n, 1e-2, 1e2, "log", v) for n, v in (("k", 4.0), ("m", 1.0), ("c", 0.3))]
    y = model.simulate((0, 5), t)["j.s"]
    for names, fixed, wanted in (
        # Without damping only the ratio of stiffness and mass is identifiable.
        (("k", "m"), {"c": 0.0}, "Only k/m is"),
        (("k", "m", "c"), {}, "Only k/c and m/c are"),
    ):
        condition = Condition("run", model, {**{n: n for n in names}, **fixed})
        own = [row for row in rows if row.name in names]
        result = at_start(Problem(own, [condition], rows_of(["j.s"] * 20, t, y, 0.01), FINE))
        (sentence,) = result.undetermined
        assert sentence.startswith(f"{wanted} determined, not"), sentence


def test_the_optimal_time_for_a_decay_is_that_of_box_and_lucas(decay):
    """For exp(-k t), the time 1/k is the most informative about k (Box and Lucas 1959)."""
    result = at_start(decay_problem(decay, ["R"], noise=10.0))
    (row,) = result.next_measurements({"C.v": (np.linspace(0, 4, 401), 0.1)}, 1)
    assert row.t == pytest.approx(1.0)
    # If the amplitude is estimated as well, the second optimal time is zero.
    two = at_start(decay_problem(decay, ["R", "v0"], noise=10.0, initial={"C.v": "v0"}))
    pair = two.next_measurements({"C.v": (np.linspace(0, 4, 401), 0.1)}, 2)
    assert sorted(r.t for r in pair) == pytest.approx([0.0, 1.0])


def test_profiles_of_a_nonlinear_model_agree_with_the_closed_form(decay):
    """R = -t/log(y) is a monotonic function of y = exp(-t/R), so its interval is that of y."""
    result = fitted(decay_problem(decay, ["R"], t=[1.0, 1.0], noise=0.05))
    mean = float(np.mean(result.problem.measured.value))
    reach = math.sqrt(stats.chi2.ppf(0.95, 1)) * 0.05 / math.sqrt(2)
    wanted = [-1 / math.log(mean + sign * reach) / 0.5 for sign in (-1, 1)]
    profile = result.profile("R")
    assert profile.interval == pytest.approx(wanted, rel=1e-3)
