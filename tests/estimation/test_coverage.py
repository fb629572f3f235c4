"""Coverage of confidence intervals in fits of simulated experiments with many seeds."""

from __future__ import annotations

import pytest
from simulated_fits import CASES, covered

# With a coverage probability of 95 %, fewer than 88 of 100 intervals contain the true value in at
# most one of 200 such experiments (binomial distribution).
SEEDS, LEAST = 100, 88

# The linkage takes most of a minute, so only benchmarks/interval_coverage.py includes it.
QUICK = [name for name in CASES if not name.startswith("motor-linkage")]


@pytest.mark.slow
@pytest.mark.parametrize("name", QUICK)
def test_intervals_have_their_nominal_coverage(name):
    counts = covered(name, range(SEEDS))
    assert min(counts.values()) >= LEAST, counts
