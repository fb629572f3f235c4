"""Priors against densities from SciPy, and least-squares rows against these densities."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from cotree.errors import ParameterError
from cotree.estimation.estimated import Estimated
from cotree.estimation.petab.problem import Prior, Priors, sample_starts
from cotree.estimation.petab.tsv_tables import PriorRow

SCALES = {"lin": lambda x: x, "log": math.log, "log10": math.log10}

# The density of each type at a value x, whose value on the scale is z.
DENSITIES = {
    "parameterScaleNormal": lambda x, z: stats.norm.logpdf(z, 0.4, 0.3),
    "parameterScaleLaplace": lambda x, z: stats.laplace.logpdf(z, 0.4, 0.3),
    "parameterScaleUniform": lambda x, z: stats.uniform.logpdf(z, -3.0, 6.0),
    "normal": lambda x, z: stats.norm.logpdf(x, 0.4, 0.3),
    "laplace": lambda x, z: stats.laplace.logpdf(x, 0.4, 0.3),
    "uniform": lambda x, z: stats.uniform.logpdf(x, -3.0, 6.0),
    "logNormal": lambda x, z: stats.lognorm.logpdf(x, 0.3, scale=math.exp(0.4)),
    "logLaplace": lambda x, z: stats.laplace.logpdf(math.log(x), 0.4, 0.3) - math.log(x),
}


def row_of(kind):
    return PriorRow(kind, -3.0, 3.0) if kind.lower().endswith("form") else PriorRow(kind, 0.4, 0.3)


def theta_of(estimated, x):
    return np.array([SCALES[estimated.scale](x)])


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("kind", DENSITIES)
def test_densities_gradients_and_rows(kind, scale):
    """Central differences with steps of 1e-6 are exact to 1e-9 of values of ten."""
    estimated = Estimated("p", 0.05, 20.0, scale)
    priors = Priors([estimated], [row_of(kind)])
    start = None
    for x in (0.3, 0.9, 1.7):
        theta, h = theta_of(estimated, x), 1e-6
        value = priors.log_density(theta)
        assert value == pytest.approx(DENSITIES[kind](x, theta[0]), rel=1e-12)
        slope = (priors.log_density(theta + h) - priors.log_density(theta - h)) / (2 * h)
        assert priors.gradient(theta)[0] == pytest.approx(slope, rel=1e-7, abs=1e-7)
        rows, along = priors.rows(theta)
        assert rows @ along == pytest.approx(-priors.gradient(theta), abs=1e-12)
        shift = value + 0.5 * rows @ rows
        start = shift if start is None else start
        assert shift == pytest.approx(start, abs=1e-9)


def test_samples_are_truncated_at_bounds():
    estimated = Estimated("p", 0.5, 2.0, "log10")
    random = np.random.default_rng(1)
    drawn = Prior(PriorRow("parameterScaleNormal", 0.0, 0.2), estimated).sample(2000, random)
    assert np.abs(drawn).max() <= math.log10(2.0)
    # Truncation at 1.505 standard deviations reduces the standard deviation to 0.7485 of it.
    assert np.std(drawn) == pytest.approx(0.2 * stats.truncnorm.std(-1.505, 1.505), rel=0.06)
    starts = sample_starts([estimated], [None], 2000, seed=2)
    assert np.mean(starts) == pytest.approx(0.0, abs=0.02)
    assert np.array_equal(starts, sample_starts([estimated], [None], 2000, seed=2))


def test_priors_with_negligible_mass_between_the_bounds_are_refused():
    estimated = Estimated("p", 0.5, 2.0, "lin")
    with pytest.raises(ParameterError, match="almost no probability within its bounds"):
        sample_starts([estimated], [PriorRow("normal", 50.0, 0.1)], 3, seed=0)
    with pytest.raises(ParameterError, match="cannot be drawn between 0 and inf"):
        sample_starts([Estimated("p", 0.0)], [None], 3, seed=0)
