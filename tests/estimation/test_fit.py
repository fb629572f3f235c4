"""Fits against closed forms, linear regression and SciPy's ``curve_fit``."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import curve_fit, minimize

import cotree

T = np.linspace(0.0, 5.0, 21)
NOISE = np.random.default_rng(5).standard_normal((3, 21))

# Relative tolerance of the runs 1e-10; the optimiser stops within 1e-6 standard errors.
FINE = {"rtol": 1e-10, "atol": 1e-12, "starts": 3}


def discharge(name="discharge"):
    scene = cotree.Scene(name)
    scene.parameter("R", 2.0, unit="ohm")
    scene.parameter("unused", 1.0)
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0, initial={"v": 4.0})
    scene.edge("R", "resistor", "a", "ground", resistance="R")
    return scene


@pytest.fixture(scope="module")
def scene():
    return discharge()


def decay(t, R, v):
    return v * np.exp(-t / R)


def charging():
    """Return a capacitor charged through a resistor by an input voltage."""
    scene = cotree.Scene("charging")
    scene.parameter("R", 2.0)
    scene.input("u", 0.0, unit="V")
    scene.edge("V", "voltage_source", "p", "ground", voltage="u")
    scene.edge("R", "resistor", "p", "a", resistance="R")
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0, initial={"v": 0.0})
    return scene


@pytest.mark.parametrize("noise", [0.1, None])
def test_estimates_of_an_exponential_agree_with_curve_fit(scene, noise):
    y = decay(T, 3.0, 5.0) + 0.1 * NOISE[0]
    run = cotree.Experiment({"t": T, "C.v": y}, noise=noise)
    result = cotree.fit(scene, run, {"R": (0.1, 100, "log"), "C.v": (0, 10)}, **FINE)
    wanted, _ = curve_fit(decay, T, y, [2.0, 4.0], ftol=1e-14, xtol=1e-14)
    found = result.parameters
    assert [found["R"], found["C.v"]] == pytest.approx(wanted, rel=1e-6)
    assert result.starts[0].is_converged


def test_true_values_are_recovered_from_exact_data_with_missing_values(scene):
    v = decay(T, 3.0, 5.0)
    data = {"t": T, "v": v.copy(), "power": v**2 / 3.0}
    data["v"][::2] = np.nan
    data["power"][5:9] = np.nan
    run = cotree.Experiment(data, observables={"v": "C.v", "power": "C.v**2/R"}, noise=0.01)
    result = cotree.fit(scene, run, {"R": (0.1, 100, "log"), "C.v": (0, 10)}, **FINE)
    assert len(result.problem.measured) == 10 + 17
    assert list(result.parameters.values()) == pytest.approx([3.0, 5.0], rel=1e-7)


def test_the_estimated_noise_of_exact_data_vanishes(scene):
    run = cotree.Experiment({"t": T, "C.v": decay(T, 3.0, 5.0)})
    result = cotree.fit(scene, run, {"R": (0.1, 100, "log"), "C.v": (0, 10)}, **FINE)
    assert result.parameters["R"] == pytest.approx(3.0, rel=1e-6)
    assert result.parameters["noise[C.v]"] < 1e-6


def test_shared_parameters_and_parameters_per_experiment(scene):
    runs = [
        cotree.Experiment({"t": T, "C.v": decay(T, R, v)}, initial={"C.v": "v0"}, noise=0.1, name=n)
        for R, v, n in ((3.0, 5.0, "warm"), (4.0, 5.0, None))
    ]
    ranges = {"R": (0.1, 100, "log"), "v0": (0, 10)}
    for options in ({"per_experiment": ["R"]}, {"shared": ["v0"]}):
        result = cotree.fit(scene, runs, ranges, **options, **FINE)
        wanted = {"R[warm]": 3.0, "v0": 5.0, "R[2]": 4.0}
        assert result.parameters == pytest.approx(wanted, rel=1e-7)
        assert list(result.parameters) == ["R[warm]", "R[2]", "v0"]


def test_an_experiment_may_fix_a_parameter_that_others_estimate(scene):
    runs = [
        cotree.Experiment(
            {"t": T, "C.v": decay(T, R, 5.0)}, noise=0.1, parameters=given, initial={"C.v": 5.0}
        )
        for R, given in ((3.0, {}), (7.0, {"R": 7.0}))
    ]
    result = cotree.fit(scene, runs, {"R": (0.1, 100, "log")}, **FINE)
    assert result.parameters == pytest.approx({"R": 3.0}, rel=1e-7)


def test_parameters_of_inputs_are_estimated_next_to_tables_and_numbers():
    """v' = (u - v)/R, with u = U (1 - exp(-t)): v = U (1 - (R exp(-t/R) - exp(-t))/(R - 1))."""
    R, U = 2.5, 3.0
    rising = U * (1.0 - (R * np.exp(-T / R) - np.exp(-T)) / (R - 1.0))
    # Closed forms for a ramp of slope one, given as a table, and for a constant input.
    ramp = T - R * (1.0 - np.exp(-T / R))
    constant = 2.0 * (1.0 - np.exp(-T / R))
    runs = [
        cotree.Experiment({"t": T, "C.v": rising}, inputs={"u": "U*(1 - exp(-t))"}, noise=0.1),
        cotree.Experiment({"t": T, "C.v": ramp}, inputs={"u": ([0, 9], [0, 9])}, noise=0.1),
        cotree.Experiment({"t": T, "C.v": ramp, "u": T}, noise=0.1),
        cotree.Experiment({"t": T, "C.v": constant}, inputs={"u": 2.0}, noise=0.1),
    ]
    ranges = {"R": (0.1, 100, "log"), "U": (0.1, 10)}
    result = cotree.fit(charging(), runs, ranges, **FINE)
    assert result.parameters == pytest.approx({"R": R, "U": U}, rel=1e-7)


def test_units_of_columns_are_converted(scene):
    v = decay(T, 3.0, 5.0)
    plain = cotree.Experiment({"t": T, "C.v": v}, noise=0.1)
    named = cotree.Experiment(
        {"time [ms]": 1e3 * T, "C.v [mV]": 1e3 * v, "s": 0 * T + 100.0}, noise={"C.v": "s"}
    )
    given = cotree.Experiment({"t": T, "C.v": 1e3 * v}, units={"C.v": "mV"}, noise=100.0)
    problems = [cotree.estimation_problem(scene, run, ["R"]) for run in (plain, named, given)]
    for problem in problems[1:]:
        assert problem.measured.value == pytest.approx(problems[0].measured.value, rel=1e-15)
        assert list(problem.measured.noise) == pytest.approx([0.1] * 21, rel=1e-15)
    wrong = cotree.Experiment({"t": T, "C.v [A]": v}, noise=0.1)
    with pytest.raises(
        cotree.ModelError, match=r"'C.v' of the data is given in 'A', but is in 'V'"
    ):
        cotree.estimation_problem(scene, wrong, ["R"])


def test_noise_may_be_an_expression_or_a_parameter(scene):
    v = decay(T, 3.0, 5.0)
    run = cotree.Experiment({"t": T, "C.v": v * (1 + 0.1 * NOISE[0])}, noise="s*C.v")
    ranges = {"R": (0.1, 100, "log"), "C.v": (0, 10), "s": (1e-3, 10, "log")}
    result = cotree.fit(scene, run, ranges, **FINE)
    fitted = result.problem.predicted(result.theta)
    relative = np.sqrt(np.mean((fitted.values / result.problem.measured.value - 1) ** 2))
    # These residuals are relative to measured values, those of the fit to predicted values.
    assert result.parameters["s"] == pytest.approx(relative, rel=0.2)
    assert np.abs(result.problem.objective(result.theta)[1]).max() < 1e-4
    named = cotree.Experiment({"t": T, "C.v": v + 0.1 * NOISE[0]}, noise="s")
    plain = cotree.Experiment({"t": T, "C.v": v + 0.1 * NOISE[0]})
    a = cotree.fit(scene, named, ranges, **FINE).parameters
    b = cotree.fit(scene, plain, {k: ranges[k] for k in ("R", "C.v")}, **FINE).parameters
    assert a["s"] == pytest.approx(b["noise[C.v]"], rel=1e-5)
    assert a["R"] == pytest.approx(b["R"], rel=1e-6)


def test_a_fit_of_logarithms_agrees_with_linear_regression(scene):
    y = decay(T, 3.0, 5.0) * np.exp(0.1 * NOISE[1])
    run = cotree.Experiment({"t": T, "C.v": y}, transform="log")
    result = cotree.fit(scene, run, {"R": (0.1, 100, "log"), "C.v": (0.1, 10, "log")}, **FINE)
    slope, intercept = np.polyfit(T, np.log(y), 1)
    assert result.parameters["R"] == pytest.approx(-1.0 / slope, rel=1e-6)
    assert result.parameters["C.v"] == pytest.approx(math.exp(intercept), rel=1e-6)


def test_the_restitution_coefficient_is_estimated_across_bounces():
    scene = cotree.Scene("ball", gravity=[0, 0, -9.81])
    scene.parameter("e", 0.7)
    scene.edge("j", "prismatic", "ground", "B", axis=[0, 0, 1], initial={"s": 2.0})
    scene.edge("body", "rigid_body", "ground", "B", mass=1.0)
    scene.event("hit", "j.s", direction=-1, set={"j.s_dot": "-e*j.s_dot"})
    t = np.linspace(0.0, 2.4, 49)
    # Free fall until t1, then two parabolas after the bounces at t1 and t1 + 2 e t1.
    t1, e, g = math.sqrt(4 / 9.81), 0.8, 9.81
    heights = 2.0 - g * t**2 / 2
    for n in (1, 2):
        begin = t1 * (1 + sum(2 * e**i for i in range(1, n)))
        since, speed = t - begin, e**n * g * t1
        heights = np.where(since > 0, speed * since - g * since**2 / 2, heights)
    run = cotree.Experiment({"t": t, "j.s": heights}, noise=0.01)
    result = cotree.fit(scene, run, {"e": (0.5, 0.95), "j.s": (1.5, 2.5)}, starts=6)
    assert result.parameters == pytest.approx({"e": 0.8, "j.s": 2.0}, rel=1e-6)


def test_observables_may_depend_on_algebraic_unknowns():
    """The data are a simulation with a known resistance, which the fit must recover."""
    scene = cotree.Scene("rectifier")
    scene.parameter("R", 1000.0)
    scene.input("u", 0.0)
    scene.edge("V", "voltage_source", "p", "ground", voltage="u")
    scene.edge("D", "diode", "p", "a", saturation_current=1e-12)
    scene.edge("R", "resistor", "a", "ground", resistance="R")
    scene.edge("C", "capacitor", "a", "ground", capacitance=1e-6)
    t = np.linspace(0, 2e-3, 21)
    wave = {"u": "5*sin(3000*t)"}
    truth = scene.compile().simulate(
        (0, 2e-3), t, inputs=wave, parameters={"R": 700.0}, rtol=1e-10, atol=1e-12
    )
    # The current of the resistor is not a state, but an observable may refer to it.
    data = {"t": t, "i": truth["C.v"] / 700.0, "v": truth["C.v"]}
    run = cotree.Experiment(data, observables={"i": "R.i", "v": "C.v"}, inputs=wave, noise=0.01)
    result = cotree.fit(scene, run, {"R": (100, 1e4, "log")}, starts=4)
    assert result.parameters["R"] == pytest.approx(700.0, rel=1e-6)


def test_a_compiled_model_is_reused_if_it_has_all_that_is_needed(scene):
    run = cotree.Experiment({"t": T, "C.v": decay(T, 3.0, 4.0)}, noise=0.1)
    model = scene.compile(["R"])
    problem = cotree.estimation_problem(model, run, ["R"])
    assert problem.conditions[0].model is model
    other = cotree.estimation_problem(model, run, ["R", "C.v"])
    assert other.conditions[0].model.sensitivities == ("R", "C.v")
    best = minimize(problem.objective, problem.theta(), jac=True, bounds=problem.bounds)
    assert problem.values(best.x)["R"] == pytest.approx(3.0, rel=1e-5)


def test_equal_seeds_give_equal_results(scene):
    run = cotree.Experiment({"t": T, "C.v": decay(T, 3.0, 4.0) + NOISE[0]}, noise=0.1)
    a, b = (cotree.fit(scene, run, ["R"], starts=4, seed=7) for _ in range(2))
    assert a.parameters == b.parameters
    assert [row.began.tolist() for row in a.starts] == [row.began.tolist() for row in b.starts]


RUN = {"t": T, "C.v": decay(T, 3.0, 4.0)}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"parameters": {"Q": (1, 2)}}, "'Q' is to be estimated, but the scene 'discharge' has no"),
        ({"parameters": {"R": (2, 1)}}, "'R' has the bounds 2 and 1"),
        ({"parameters": {"R": 3}}, "'R' has the range 3: give (lower, upper)"),
        ({"parameters": {"R": (1, 2, "ln")}}, "the scale of 'R' is 'ln'"),
        ({"parameters": {}}, "nothing is estimated"),
        ({"parameters": {"C.w": (0, 1)}}, "'C.w' is neither a parameter nor a state"),
        ({"parameters": {"unused": (0, 1)}}, "no measured value depends on 'unused'"),
        (
            {"experiments": cotree.Experiment(RUN, parameters={"R": 2.0})},
            "'R' is to be estimated, but every experiment gives its value",
        ),
        ({"start": {"R": 200.0}}, "'R' starts at 200, outside its bounds"),
        ({"start": {"S": 200.0}}, "start names 'S', which is not estimated"),
        ({"per_experiment": ["S"]}, "per_experiment names 'S', which is not estimated"),
        ({"shared": ["R"], "per_experiment": ["R"]}, "'R' is in shared and in per_experiment"),
        ({"noise": "no"}, "noise is 'no': give 'given' or 'estimated'"),
        ({"loss": "l2"}, "loss is 'l2': give 'linear', 'soft_l1'"),
        ({"noise": "estimated", "loss": "huber"}, "loss='huber' needs known noise"),
        ({"starts": 0}, "starts is 0: give a whole number of at least 1"),
        ({"seed": -1}, "seed is -1: give a whole number of at least 0"),
        ({"seed": "a"}, "seed is 'a': give a whole number"),
        ({"start": 3}, "start is 3: give a mapping of names to values"),
        ({"shared": 3}, "shared is 3: give a list of names"),
        ({"max_evaluations": 0}, "max_evaluations is 0: give a whole number of at least 1"),
        ({"loss": "huber", "f_scale": 0}, "f_scale is 0: give a positive number"),
        ({"loss": "huber", "f_scale": math.nan}, "f_scale is nan"),
        (
            {"parameters": {"R": (None, None)}, "optimiser": "lm", "loss": "huber"},
            "optimiser='lm' does not support loss 'huber'",
        ),
        (
            {
                "parameters": {"R": (None, None), "C.v": (None, None)},
                "experiments": cotree.Experiment({"t": [1.0], "C.v": [1.0]}, noise=0.1),
                "optimiser": "lm",
            },
            "optimiser='lm' needs at least as many measured values",
        ),
        ({"optimiser": "lm"}, "optimiser='lm' does not support bounds, but 'R' has some"),
        ({"experiments": []}, "there are no experiments"),
        ({"experiments": [3]}, "experiments holds 3: give cotree.Experiment(data, ...)"),
        ({"experiments": cotree.Experiment(RUN), "noise": "given"}, "noise is 'given', but column"),
        (
            {"experiments": cotree.Experiment({"t": T, "C.u": T})},
            "the data: no column is a state or an output of the model; did you mean 'C.v'?",
        ),
        (
            {"experiments": cotree.Experiment({"t": T, "C.v": T * np.nan})},
            "the data: 'C.v' holds missing values only",
        ),
        (
            {"experiments": cotree.Experiment(RUN, observables={"C.v": "C.v*gain"})},
            "column 'C.v' of the data uses the unknown name 'gain'",
        ),
        (
            {"experiments": cotree.Experiment(RUN, initial={"C.v": "v0"})},
            "the data names 'v0', which is not estimated",
        ),
        (
            {"experiments": cotree.Experiment(RUN, inputs={"u": 1.0})},
            "inputs of the data: the scene has no input 'u'",
        ),
        (
            {"experiments": cotree.Experiment(RUN, noise=-0.1)},
            "the noise of column 'C.v' of the data is -0.1: give a positive number",
        ),
        (
            {"experiments": cotree.Experiment({**RUN, "s": 0 * T}, noise="s")},
            "the data, row 0, noise 's' is 0: give a positive number",
        ),
    ],
)
def test_invalid_arguments_are_refused(scene, options, message):
    given = {
        "experiments": cotree.Experiment(RUN, noise=0.1),
        "parameters": {"R": (0.1, 100, "log")},
        "starts": 2,
    } | options
    with pytest.raises(cotree.ModelError) as caught:
        cotree.fit(scene, **given)
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize("is_compiled", [False, True])
def test_a_column_and_the_state_it_measures_are_the_same_quantity(scene, is_compiled):
    """Its noise is found by either name, whether the model is compiled beforehand or not."""
    run = cotree.Experiment({"t": T, "u C": decay(T, 3, 5)}, observables={"u C": "C.v"}, noise=0.1)
    model = scene.compile() if is_compiled else scene
    result = cotree.fit(model, run, {"R": (0.1, 100, "log"), "C.v": (0, 10)}, **FINE)
    by_state, by_column = (result.bands(name, T, noise=True) for name in ("C.v", "u C"))
    assert by_column.upper == pytest.approx(by_state.upper, rel=1e-12)
    assert (by_column.name, by_state.name, by_column.unit) == ("u C", "C.v", "V")
    plans = [result.next_measurements({name: T}, 2) for name in ("C.v", "u C")]
    assert plans[0][-1].errors == pytest.approx(plans[1][-1].errors, rel=1e-12)
    with pytest.raises(cotree.ParameterError, match=r"no state or output 'C.w'; did you mean"):
        result.bands("C.w")


def test_minpack_rejects_steps_to_points_where_runs_fail():
    scene = discharge("root")
    scene.parameter("q", 1.0)
    scene.output("y", "C.v*sqrt(q)")
    run = cotree.Experiment({"t": T, "y": decay(T, 3.0, 4.0)}, noise=0.01)
    unbounded = {"R": (None, None), "q": (None, None)}
    # From here the first Gauss-Newton step leads to a negative q, whose square root is undefined.
    result = cotree.fit(scene, run, unbounded, start={"q": 9.0, "R": 0.1}, optimiser="lm", starts=1)
    assert result.is_converged
    assert result.parameters == pytest.approx({"R": 3.0, "q": 1.0}, rel=1e-6)


def test_exact_data_with_estimated_noise_are_reported(scene):
    run = cotree.Experiment({"t": T, "C.v": decay(T, 3.0, 4.0)})
    result = cotree.fit(scene, run, {"R": (0.1, 100, "log")}, starts=2)
    (finding,) = result.findings
    assert finding.startswith("'noise[C.v]' is at its lower bound")
    assert "reproduces the data almost exactly" in finding
    assert math.isfinite(result.standard_errors["noise[C.v]"])


def test_outliers_are_not_reported_with_a_robust_loss(scene):
    y = decay(T, 3.0, 4.0) + 0.01 * NOISE[0]
    y[5] += 2.0
    run = cotree.Experiment({"t": T, "C.v": y}, noise=0.01)
    plain, robust = (
        cotree.fit(scene, run, {"R": (0.1, 100, "log")}, starts=1, loss=loss)
        for loss in ("linear", "cauchy")
    )
    assert "residuals are larger" in plain.findings[0]
    assert robust.findings == ()
    # The true value lies within four standard errors with a probability of 1 - 6e-5.
    assert abs(robust.parameters["R"] - 3.0) < 4.0 * robust.standard_errors["R"]
    assert abs(plain.parameters["R"] - 3.0) > 4.0 * plain.standard_errors["R"]


def test_ignored_columns_cause_a_warning(scene):
    run = cotree.Experiment({**RUN, "C.w": T}, noise=0.1)
    with pytest.warns(RuntimeWarning, match=r"is called 'C.w', which is ignored"):
        cotree.fit(scene, run, ["R"], starts=1)


def test_a_fit_whose_starts_all_fail_gives_the_reason(scene):
    run = cotree.Experiment(RUN, observables={"C.v": "C.v*sqrt(R - 10)"}, noise=0.1)
    with pytest.raises(cotree.SolveError, match="all 2 starts failed: predictions are not finite"):
        cotree.fit(scene, run, {"R": (0.1, 1.0)}, starts=2)
