"""Sparse linear systems of Newton's method beside full ones: the same steps, the same verdicts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from cotree.model.linear import linearise, singular_direction, solve_entries


def chain(n: int, *, is_free: bool = False) -> np.ndarray:
    """A matrix with a few entries in each row, of sizes from 1e-9 to 1e3.

    Where ``is_free`` is set, a column is made of those beside it, which leaves a direction free.
    """
    rng = np.random.default_rng(1)
    matrix = np.diag(3.0 + rng.random(n)) + np.diag(rng.random(n - 1), 1)
    matrix += np.diag(rng.random(n - 1), -1)
    if is_free:
        matrix[:, 40] = matrix[:, 39] - 2.0 * matrix[:, 41]
    return matrix * 10.0 ** rng.uniform(-9.0, 3.0, (n, 1))


def test_steps_and_scales_are_those_of_the_full_matrix():
    n, m = 120, 3
    held = np.random.default_rng(2).random((n, m))
    slope, y = np.hstack([held, chain(n)]), np.arange(1.0, n + m + 1.0)
    full, sparse = linearise(slope, y), linearise(csr_matrix(slope), y)
    x = np.sin(np.arange(1.0, 2.0 * n + 1.0)).reshape(n, 2)
    np.testing.assert_allclose(sparse.solve(slope[:, m:] @ x), x, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(sparse.sizes, full.sizes, rtol=1e-14)
    # The largest of 16 sums with random signs: never more than the sum of sizes, never far less.
    share = sparse.scale / full.scale
    assert share.max() <= 1.0 + 1e-12
    assert share.min() > 0.3


@pytest.mark.parametrize("compress", [np.array, csr_matrix])
def test_unknowns_that_are_left_free(compress):
    matrix = chain(90, is_free=True)
    assert singular_direction([compress(matrix)]) == (39, 40, 41)
    assert singular_direction([compress(matrix), compress(chain(90))]) == ()
    assert singular_direction([compress(chain(90))]) == ()


@pytest.mark.parametrize("n", [4, 100])
def test_entries_of_a_singular_system(n):
    places = np.arange(n)
    values = np.where(places == 1, 0.0, 2.0)
    with pytest.raises(np.linalg.LinAlgError):
        solve_entries(places, places, values, np.ones(n))
    values[1] = 0.5
    # Entries of one place add up.
    twice = np.concatenate([values, values]), np.concatenate([places, places])
    assert solve_entries(twice[1], twice[1], twice[0], np.ones(n)) == pytest.approx(0.5 / values)
