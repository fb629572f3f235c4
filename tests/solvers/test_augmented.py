from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from ivp_cases import oscillator, robertson, robertson_rhs

from cotree.solvers.guarded_calls import (
    assemble_dense,
    assemble_sparse,
    augmented_tolerances,
    difference_columns,
)


@pytest.mark.parametrize("n_parameters", [0, 1, 4])
def test_dense_and_sparse_are_the_same(n_parameters):
    rng = np.random.default_rng(1)
    n_states = 3
    first = rng.standard_normal((n_states * (1 + n_parameters), n_states))
    dense = assemble_dense(first, n_states)
    assert np.array_equal(assemble_sparse(first, n_states).toarray(), dense)
    for k in range(0, len(dense), n_states):
        assert np.array_equal(dense[k : k + n_states, k : k + n_states], first[:n_states])
    assert np.array_equal(dense[:, :n_states], first)
    assert np.count_nonzero(dense) == first.size + 9 * n_parameters


def test_differences_of_a_quadratic():
    z = np.array([0.7, 1e-5, 0.3, -4.0, 5e-5, 4.0])
    columns = difference_columns(robertson(40.0), lambda point: robertson_rhs(0.0, point), z)
    step = 1e-20
    for j in range(3):
        shifted = z.astype(complex)
        shifted[j] += 1j * step
        a, b, c = shifted[:3]
        slow, fast = 0.04 * a - 1e4 * b * c, 3e7 * b * b
        exact = np.array([-slow, slow - fast, fast]).imag / step
        # The increments follow rtol = 1e-6, and the rates are quadratic.
        np.testing.assert_allclose(columns[:3, j], exact, rtol=1e-5, atol=1e-5)
    # d(J s)/db of the last rate is d(6e7 b s_b)/db.
    np.testing.assert_allclose(columns[5, 1], 6e7 * 5e-5, rtol=1e-5)


def test_tolerances_of_sensitivities():
    problem = oscillator(rtol=1e-6, atol=1e-8, sizes=np.array([1.0, 0.1]))
    rtol, atol = augmented_tolerances(problem)
    assert rtol == 1e-6
    np.testing.assert_allclose(atol, [1e-8, 1e-9] * 3, rtol=1e-15)  # a product rounds


def test_tolerances_without_sensitivities_in_the_error_test():
    problem = oscillator(rtol=1e-6, atol=1e-8, error_test_sensitivities=False)
    rtol, atol = augmented_tolerances(problem)
    # The mean square over three blocks, two of them without weight, equals that of the states.
    assert rtol == pytest.approx(1e-6 / np.sqrt(3))
    np.testing.assert_allclose(atol[:2], 1e-8 / np.sqrt(3))
    assert np.all(atol[2:] > 1e50)


def test_import_is_cheap():
    code = (
        "import sys, cotree.solvers; "
        "print([m for m in ('scipy', 'sksundae', 'pandas', 'matplotlib') if m in sys.modules])"
    )
    answer = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert answer.stdout.strip() == "[]"
