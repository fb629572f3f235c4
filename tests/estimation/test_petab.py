"""PEtab problems against closed forms: a species that decays, c = c0 exp(-k t)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from petab_texts import (
    CONDITIONS,
    MEASUREMENTS,
    MODEL,
    OBSERVABLES,
    PARAMETERS,
    YAML,
    write_problem,
)
from scipy import stats

import cotree
from cotree.estimation.multistart import Search

pytest.importorskip("yaml")
pytest.importorskip("libsbml")

# Tolerance of the runs 1e-10; residuals amplify errors by the ratio of value to noise, about ten.
CLOSE = 1e-7

MEASURED = np.array([1.7, 1.2, 0.7, 7.1, 2.6])
NOMINAL = {"k": 0.5, "gain": 3.0, "sigma": 0.2}


def predicted(k, gain):
    return [
        gain * math.exp(-k),
        gain * math.exp(-2 * k),
        gain * math.exp(-4 * k),
        4 * gain * math.exp(-k),
        4 * 2.5 * math.exp(-3 * k),
    ]


def exact(k, gain, sigma):
    values = stats.norm.logpdf(MEASURED, predicted(k, gain), [sigma] * 3 + [0.5] * 2)
    return float(np.sum(values))


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    file = write_problem(tmp_path_factory.mktemp("decay"))
    return cotree.read_petab(file, rtol=1e-10, atol=1e-12)


def test_the_likelihood_agrees_with_the_closed_form(problem):
    assert problem.log_likelihood() == pytest.approx(exact(**NOMINAL), rel=CLOSE)
    other = {"k": 0.7, "gain": 2.0, "sigma": 0.4}
    assert problem.log_likelihood(other) == pytest.approx(exact(**other), rel=CLOSE)
    assert problem.log_likelihood([0.7, 2.0, 0.4]) == problem.log_likelihood(other)
    assert problem.log_likelihood({"k": 0.7}) == pytest.approx(
        exact(**{**NOMINAL, "k": 0.7}), rel=CLOSE
    )


def test_chi2_is_the_sum_of_squared_residuals(problem):
    r = (MEASURED - predicted(0.5, 3.0)) / [0.2, 0.2, 0.2, 0.5, 0.5]
    assert problem.chi2() == pytest.approx(float(r @ r), rel=CLOSE)


def test_the_gradient_is_with_respect_to_parameters_on_their_scales(problem):
    """Central differences of the closed form: steps of 1e-5 leave errors of about 1e-9."""

    def on_scales(theta):
        return exact(10.0 ** theta[0], theta[1], math.exp(theta[2]))

    theta, h = problem.theta(), 1e-5
    steps = h * np.eye(3)
    expected = [(on_scales(theta + d) - on_scales(theta - d)) / (2 * h) for d in steps]
    np.testing.assert_allclose(problem.gradient(), expected, rtol=1e-6, atol=1e-6)
    value, gradient = problem.objective(theta)
    assert value == pytest.approx(-problem.log_likelihood(), rel=CLOSE)
    np.testing.assert_allclose(gradient, -problem.gradient(), rtol=1e-12)


def test_the_simulation_table_has_the_rows_of_the_measurements(problem):
    table = problem.simulate()
    np.testing.assert_allclose(table["simulation"], predicted(0.5, 3.0), rtol=CLOSE)
    assert list(table["observableId"]) == ["seen"] * 5
    assert "measurement" not in table


def test_a_fit_finds_the_maximum(problem):
    """At the maximum the gradient vanishes, and its value is no less than at the nominal point."""
    result = problem.fit(starts=3, seed=1, progress=False)
    assert -result.starts[0].objective >= problem.log_likelihood()
    np.testing.assert_allclose(problem.gradient(result.parameters), 0.0, atol=1e-3)


def test_a_fit_with_steps_compared_by_bounds_finds_the_same_maximum(problem):
    search = Search(optimiser="dogbox", scale="bounds")
    found = [problem.fit(starts=1, search=s, progress=False).starts[0] for s in (None, search)]
    assert found[1].objective == pytest.approx(found[0].objective, rel=1e-9)
    with pytest.raises(cotree.ParameterError, match="give 'jacobian' or 'bounds'"):
        Search(scale="widths")


def test_the_integration_method_can_be_changed(problem):
    other = problem.using(method="rodas5")
    assert other.log_likelihood() == pytest.approx(problem.log_likelihood(), rel=CLOSE)
    assert other.model is problem.model


def test_priors_are_part_of_the_objective(tmp_path):
    parameters = PARAMETERS.replace(
        "estimate", "estimate objectivePriorType objectivePriorParameters"
    )
    parameters = parameters.replace("0.5 1", "0.5 1 parameterScaleNormal 0.1;0.3")
    parameters = parameters.replace(" 3 1", " 3 1 laplace 2;0.5").replace("0.2 1", "0.2 1 _ _")
    problem = cotree.read_petab(write_problem(tmp_path, parameters=parameters))
    expected = stats.norm.logpdf(math.log10(0.5), 0.1, 0.3) + stats.laplace.logpdf(3.0, 2.0, 0.5)
    assert problem.log_prior() == pytest.approx(expected)
    value, _ = problem.objective(problem.theta())
    assert value == pytest.approx(-problem.log_likelihood() - expected)
    found = problem.fit(starts=1, progress=False)
    assert found.starts[0].objective < value
    best, gradient = problem.objective(found.theta)
    assert best == pytest.approx(found.starts[0].objective)
    # The prior of the gain has a kink at 2, where its derivative jumps by 4.
    np.testing.assert_allclose(gradient[[0, 2]], 0.0, atol=1e-3)


def test_intervals_include_normal_priors(tmp_path):
    """The information is the sum of that of the data and the inverse variance of the prior."""
    parameters = PARAMETERS.replace(
        "estimate", "estimate objectivePriorType objectivePriorParameters"
    )
    parameters = parameters.replace("0.5 1", "0.5 1 parameterScaleNormal 0.1;0.01")
    problem = cotree.read_petab(write_problem(tmp_path, parameters=parameters))
    found = problem.fit(starts=1, progress=False)
    data = problem.likelihood.fisher(problem.predict([found.theta])[0])
    assert found.fisher == pytest.approx(data + np.diag([1e4, 0.0, 0.0]), rel=1e-9, abs=1e-9)


def test_noise_may_depend_on_the_observable_and_be_laplacian(tmp_path):
    observables = (
        "observableId observableFormula noiseFormula observableTransformation noiseDistribution\n"
        "seen observableParameter1_seen*A noiseParameter1_seen+0.1*seen log laplace\n"
    )
    problem = cotree.read_petab(write_problem(tmp_path, observables=observables))
    y = np.array(predicted(0.5, 3.0))
    scale = np.array([0.2, 0.2, 0.2, 0.5, 0.5]) + 0.1 * y
    densities = stats.laplace.logpdf(np.log(MEASURED), np.log(y), scale) - np.log(MEASURED)
    expected = np.sum(densities)
    assert problem.log_likelihood() == pytest.approx(float(expected), rel=1e-6)


def test_a_time_of_inf_is_the_steady_state(tmp_path):
    """With a way back A rests where k A = back B, and A + B is the 1 or 4 of the start."""
    model = MODEL.replace('id="back" value="0"', 'id="back" value="0.25"')
    measurements = MEASUREMENTS.replace("few 2", "few inf")
    problem = cotree.read_petab(write_problem(tmp_path, model=model, measurements=measurements))
    assert problem.simulate()["simulation"][1] == pytest.approx(3.0 * 0.25 / 0.75, rel=1e-6)


def test_a_time_of_inf_may_follow_on_a_preequilibration(tmp_path):
    """A and B rest at k A = back B; the second run begins there, with A set anew or not.

    First A + B = 2, so that B rests at 2 k/(k + back) with the estimated k. The condition then sets
    back to 1.5, and A to 4 or not at all: A rests at (A + B) back/(k + back).
    """
    model = MODEL.replace('id="back" value="0"', 'id="back" value="0.25"')
    conditions = "conditionId A back\nfirst 2 0.25\nfew 4 1.5\nmany _ 1.5\n"
    measurements = MEASUREMENTS.replace("Id time", "Id preequilibrationConditionId time")
    for name in ("few", "many"):
        measurements = measurements.replace(f"{name} ", f"{name} first ")
    measurements = measurements.replace("first 2", "first inf").replace("first 3", "first inf")
    changed = {"model": model, "conditions": conditions, "measurements": measurements}
    problem = cotree.read_petab(write_problem(tmp_path, **changed))

    def at_rest(k, gain):
        b = 2.0 * k / (k + 0.25)
        few, many = ((a + b) * 1.5 / (k + 1.5) for a in (4.0, 2.0 - b))
        return gain * few, 2.5 * many

    # Steady states are held to ten times the tolerance of 1e-8.
    few, many = at_rest(0.5, 3.0)
    assert problem.simulate()["simulation"][1] == pytest.approx(few, rel=1e-6)
    assert problem.simulate()["simulation"][4] == pytest.approx(many, rel=1e-6)
    theta, h = problem.theta(), 1e-4
    steps = h * np.eye(3)
    # Differences of log-likelihoods of some tens, held to 1e-7, over 2e-4: good to 1e-4 or so.
    ahead, behind = ([problem.objective(theta + s * d)[0] for d in steps] for s in (1, -1))
    slopes = (np.array(ahead) - behind) / (2 * h)
    np.testing.assert_allclose(problem.objective(theta)[1], slopes, rtol=1e-3, atol=1e-3)


def wrong(**changed):
    return lambda folder: write_problem(folder, **changed)


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (wrong(yaml="a: [1"), r"problem.yaml:\d: not valid YAML"),
        (wrong(yaml="a: 1"), "no 'format_version'"),
        (wrong(yaml="format_version: 2.0.0"), "only version 1 of PEtab is supported"),
        (wrong(yaml="format_version: 1\nproblems: []"), "must list one problem"),
        (
            wrong(parameters=PARAMETERS.replace("0.5 1", "half 1")),
            "parameters.tsv:2: 'nominalValue' is",
        ),
        (
            wrong(parameters=PARAMETERS.replace("0.01 100", "100 0.01")),
            "parameters.tsv:2: the lower bound",
        ),
        (
            wrong(parameters=PARAMETERS.replace("lin", "ln")),
            "parameters.tsv:3: 'parameterScale' is 'ln'",
        ),
        (
            wrong(parameters=PARAMETERS + "k lin 0 1 1 1\n"),
            "parameters.tsv:5: parameter 'k' is defined twice",
        ),
        (
            wrong(parameters=PARAMETERS.replace("upperBound ", "")),
            "parameters.tsv:2: the row has more cells",
        ),
        (
            wrong(parameters=PARAMETERS.replace("parameterScale", "scale")),
            "parameters.tsv:1: no column",
        ),
        (wrong(parameters=PARAMETERS.replace(" 1\n", " 0\n")), "no parameter is estimated"),
        (wrong(conditions=CONDITIONS.replace(" A", " C")), "conditions.tsv:2: the column 'C'"),
        (
            wrong(conditions=CONDITIONS.replace("few 1", "few a0")),
            "conditions.tsv:2: 'A' of condition",
        ),
        (
            wrong(observables=OBSERVABLES.replace("*A", "*C")),
            "observables.tsv:2: 'C' in the formula",
        ),
        (
            wrong(observables=OBSERVABLES.replace("*A", "**")),
            "observables.tsv:2: observableFormula",
        ),
        (
            wrong(observables=OBSERVABLES.replace("*A", "*f(A)")),
            "observables.tsv:2: .*calls 'f', which",
        ),
        (
            wrong(measurements=MEASUREMENTS.replace("many 3", "more 3")),
            "measurements.tsv:6: unknown simul",
        ),
        (
            wrong(measurements=MEASUREMENTS.replace("1.7", "x")),
            "measurements.tsv:2: 'measurement' is 'x'",
        ),
        (
            wrong(measurements=MEASUREMENTS.replace("few 2", "few -2")),
            "measurements.tsv:3: the time is -2",
        ),
        (
            wrong(measurements=MEASUREMENTS.replace("7.1 gain", "7.1 grain")),
            "tsv:5: 'grain' in 'obs",
        ),
        (
            wrong(measurements=MEASUREMENTS.replace("7.1 gain", "7.1 gain;1")),
            "tsv:5: 'observablePara",
        ),
        (
            wrong(measurements=MEASUREMENTS.replace("7.1 gain", "7.1 _")),
            "tsv:5: 'seen' needs a value for",
        ),
        (
            wrong(measurements=MEASUREMENTS.replace("2.5 0.5", "2.5 0")),
            "tsv:6: the noise of 'seen' is 0",
        ),
        (
            wrong(parameters=PARAMETERS.replace("0.5 1", "0 1")),
            "tsv:2: 'k' is on scale log10: its nominalValue 0 must be positive",
        ),
        (
            wrong(parameters=PARAMETERS.replace(" 3 1", " inf 1")),
            "tsv:3: 'nominalValue' is inf: give a finite number",
        ),
        (wrong(conditions=CONDITIONS.replace("few 1", "few inf")), "tsv:2: 'A' is inf: give a fin"),
        (
            wrong(measurements=MEASUREMENTS.replace("7.1 gain", "7.1 inf")),
            "tsv:5: 'observableParameters' is inf",
        ),
        # Beyond doubles it must not become the steady state, which inf means.
        (
            wrong(measurements=MEASUREMENTS.replace("few 2", "few 1e999")),
            "tsv:3: 'time' is '1e999', which is not a number",
        ),
        (wrong(yaml=YAML + "\0"), "not valid YAML: special characters"),
        (wrong(measurements=MEASUREMENTS.splitlines()[0]), "the measurement table has no rows"),
        (wrong(yaml=YAML.replace("model.xml", "m" * 5000)), "the file 'mmm.*does not exist"),
    ],
)
def test_errors_are_reported_in_one_sentence_with_file_and_line(tmp_path, write, message):
    with pytest.raises(cotree.SceneError, match=message) as caught:
        cotree.read_petab(write(tmp_path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ((b"\tnominalValue", b"\tlowerBound\tnominalValue"), "1: two columns are named 'lower"),
        # The csv module of Python accepts no NUL in some versions, and no lone CR in others.
        ((b"0.5", b"0.5\r\r\rx"), "parameters.tsv:"),
        ((b"\t0.5", b'\t"0.5'), "parameters.tsv:"),
        ((b"0.2\t1\n", b'0.2\t"1\n'), "not a table with tab-separated columns"),
        ((b"\t", b" "), "1: no column 'parameterId': separate columns by tabs"),
    ],
)
def test_malformed_tables_are_refused(tmp_path, change, message):
    file, table = write_problem(tmp_path), tmp_path / "parameters.tsv"
    n_changes = -1 if change[0] == b"\t" else 1
    table.write_bytes(table.read_bytes().replace(*change, n_changes))
    with pytest.raises(cotree.SceneError, match=message) as caught:
        cotree.read_petab(file)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    file = write_problem(tmp_path)
    (tmp_path / "conditions.tsv").unlink()
    with pytest.raises(cotree.SceneError, match=r"the file 'conditions.tsv' does not"):
        cotree.read_petab(file)
    with pytest.raises(cotree.SceneError, match="is not a file"):
        cotree.read_petab(tmp_path / "none.yaml")


def test_invalid_numbers_of_starts_and_seeds_are_refused(problem):
    with pytest.raises(cotree.ParameterError, match="starts is 0: give a whole number of at least"):
        problem.fit(starts=0)
    with pytest.raises(cotree.ParameterError, match="seed is -1: give a whole number"):
        problem.fit(starts=1, seed=-1)
    with pytest.raises(cotree.ParameterError, match=r"n is 2\.5: give a whole number"):
        problem.starts(2.5)
    with pytest.raises(cotree.ParameterError, match="seed is 'a': give a whole number"):
        problem.starts(2, "a")


def test_unknown_parameters_of_a_call_are_refused(problem):
    with pytest.raises(cotree.ParameterError, match="'speed' is not estimated"):
        problem.log_likelihood({"speed": 1.0})
    with pytest.raises(cotree.ParameterError, match="finite logarithm"):
        problem.gradient({"k": 0.0})


def test_a_cell_may_name_a_constant_of_the_model(tmp_path):
    """The constant 'start' of the model is not in the parameter table: its value is the model's."""
    model = MODEL.replace("<listOfParameters>", '<listOfParameters>\n<parameter id="start" '
                          'value="1.5" constant="true"/>\n<parameter id="other" value="9" '
                          'constant="true"/>')  # fmt: skip
    conditions = CONDITIONS.replace("few 1", "few start")
    problem = cotree.read_petab(write_problem(tmp_path, model=model, conditions=conditions))
    expected = np.array(predicted(0.5, 3.0)) * [1.5, 1.5, 1.5, 1.0, 1.0]
    # Runs hold 1e-8 of each step.
    np.testing.assert_allclose(problem.simulate()["simulation"], expected, rtol=1e-6)
    # A column for 'start' itself takes precedence over the model, through another column, too.
    for columns, few in (("A start", "start 2"), ("A start other", "start other 2")):
        n = few.count(" ")
        conditions = f"conditionId {columns}\nfew {few}\nmany 4{' _' * n}\n"
        problem = cotree.read_petab(write_problem(tmp_path, model=model, conditions=conditions))
        expected = np.array(predicted(0.5, 3.0)) * [2.0, 2.0, 2.0, 1.0, 1.0]
        np.testing.assert_allclose(problem.simulate()["simulation"], expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("conditions", "message"),
    [
        ("conditionId A back\nfew back back\nmany 4 0\n", r"tsv:2: 'back' .* depends on itself"),
        ("conditionId A\nfew B\nmany 4\n", r"tsv:2: 'A' of condition 'few' is 'B', which is neith"),
        ("conditionId A\nfew backk\nmany 4\n", r"did you mean 'back'"),
    ],
)
def test_cells_that_name_no_constant(tmp_path, conditions, message):
    with pytest.raises(cotree.SceneError, match=message):
        cotree.read_petab(write_problem(tmp_path, conditions=conditions))


def test_a_quantity_without_a_value_in_one_condition_is_refused(tmp_path):
    model = MODEL.replace(' initialConcentration="2"', "")
    conditions = CONDITIONS.replace("many 4", "many _")
    with pytest.raises(cotree.SceneError, match="tsv:3: 'A' has no value in condition 'many'"):
        cotree.read_petab(write_problem(tmp_path, model=model, conditions=conditions))
