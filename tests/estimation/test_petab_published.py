"""Published values of the PEtab test suite and of the PEtab benchmark collection."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from published import shared_folder

import cotree

yaml = pytest.importorskip("yaml")
pandas = pytest.importorskip("pandas")
pytest.importorskip("libsbml")

SHARED = shared_folder("petab")

# Cases of the quick suite: overrides and scales, preequilibration with retained initial values, and
# an estimated initial value.
QUICK = ("0007", "0014", "0017", "0019")
CASES = [
    pytest.param(case, marks=() if case in QUICK else pytest.mark.slow)
    for case in (f"{number:04d}" for number in range(1, 21))
]

# Log-likelihoods from the tests of AMICI, with a relative tolerance of 1e-3; for
# Crauste_CellSystems2017 the common value of two other tools at tighter tolerances.
LIKELIHOODS = {
    "Bachmann_MSB2011": 418.40573341425295,
    "Boehm_JProteomeRes2014": -138.22199693517703,
    "Borghans_BiophysChem1997": 83.3237191357272,
    "Brannmark_JBC2010": -141.889113770537,
    "Bruno_JExpBot2016": 46.688176988431806,
    "Crauste_CellSystems2017": -190.9639776,
    "Elowitz_Nature2000": 63.20279991419332,
    "Fujita_SciSignal2010": 53.08377736998929,
    "Schwen_PONE2014": -943.9992988598723,
}

# Models with differences of second instead of fourth order. For the many parameters of the Bachmann
# model they take half as long, and deviate from gradients by 2 % of the tolerance.
SECOND_ORDER = ("Bachmann_MSB2011",)

# Finite-difference steps on the parameters' scales. Solutions of the Crauste model diverge at a
# distance of 1e-7 from its optimum; with larger steps, spikes of the Borghans model shift by much
# more than their width.
STEPS = {"Crauste_CellSystems2017": 1e-9, "Borghans_BiophysChem1997": 1e-6}


def benchmark(name, **settings):
    return cotree.read_petab(SHARED / "benchmark" / name / f"{name}.yaml", **settings)


@pytest.mark.parametrize("case", CASES)
def test_cases_of_the_suite(case):
    folder = SHARED / "test_suite" / case
    solution = yaml.safe_load((folder / f"_{case}_solution.yaml").read_text())
    problem = cotree.read_petab(folder / f"_{case}.yaml")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = problem.simulate()
    expected = pandas.read_csv(folder / "_simulations.tsv", sep="\t")
    np.testing.assert_allclose(
        found["simulation"], expected["simulation"], rtol=0, atol=solution["tol_simulations"]
    )
    assert problem.chi2() == pytest.approx(solution["chi2"], abs=solution["tol_chi2"])
    assert problem.log_likelihood() == pytest.approx(solution["llh"], abs=solution["tol_llh"])
    theta, h = problem.theta(), 1e-4
    points = np.concatenate([theta + h * np.eye(len(theta)), theta - h * np.eye(len(theta))])
    values = [problem.likelihood.log_likelihood(row) for row in problem.predict(points)]
    slopes = -np.diff(np.reshape(values, (2, -1)), axis=0)[0] / (2 * h)
    np.testing.assert_allclose(problem.gradient(), slopes, rtol=1e-4, atol=1e-5)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.filterwarnings("ignore::FutureWarning")
def test_the_petab_library_computes_the_same_likelihood():
    """It evaluates our simulation table of 286 rows, with noise formulas and overrides."""
    petab = pytest.importorskip("petab.v1")
    folder = SHARED / "benchmark" / "Schwen_PONE2014"
    tables = {
        "measurement": petab.get_measurement_df,
        "observables": petab.get_observable_df,
        "parameters": petab.get_parameter_df,
    }
    files = {
        "measurement": "measurementData",
        "observables": "observables",
        "parameters": "parameters",
    }
    measured, observables, parameters = (
        read(folder / f"{files[kind]}_Schwen_PONE2014.tsv") for kind, read in tables.items()
    )
    problem = benchmark("Schwen_PONE2014")
    simulated = problem.simulate()
    expected = petab.calculate_llh(measured, simulated, observables, parameters)
    assert problem.log_likelihood() == pytest.approx(float(expected), rel=1e-12)


def test_one_published_likelihood():
    problem = benchmark("Crauste_CellSystems2017", method="rodas5")
    assert problem.log_likelihood() == pytest.approx(-190.9639776, rel=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("name", LIKELIHOODS)
def test_likelihoods_and_gradients_of_published_problems(name):
    """Two different integration methods agree to eight digits at tight tolerances."""
    problem = benchmark(name, method="rodas5", rtol=1e-12, atol=1e-15)
    found = problem.log_likelihood()
    limit = 1e-8 if name == "Crauste_CellSystems2017" else 1e-3
    assert found == pytest.approx(LIKELIHOODS[name], rel=limit)
    other = problem.using(method="cvode", rtol=1e-13, atol=1e-18)
    assert other.log_likelihood() == pytest.approx(found, rel=1e-8)

    if name == "Crauste_CellSystems2017":
        problem = problem.using(method="dop853", rtol=1e-13)
    theta, h = problem.theta(), STEPS.get(name, 1e-5)
    # Central differences.
    is_second = name in SECOND_ORDER
    weights = np.array([-6.0, 6.0] if is_second else [1.0, -8.0, 8.0, -1.0]) / 12
    offsets = (-1, 1) if is_second else (-2, -1, 1, 2)
    points = np.concatenate([theta + i * h * np.eye(len(theta)) for i in offsets])
    rows = problem.predict(points, slopes=False)
    values = [problem.likelihood.log_likelihood(row) for row in rows]
    slopes = weights @ np.reshape(values, (len(offsets), -1)) / h
    # Derivatives of some parameters at bounds are smaller than the rounding error of differences.
    size = np.abs(slopes).max()
    np.testing.assert_allclose(problem.gradient(), slopes, rtol=1e-4, atol=1e-4 * size)
