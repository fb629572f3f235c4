"""The planned elimination against dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest

from cotree.linear.elimination import Elimination, plan_elimination

Pattern = tuple[list[int], list[int]]


def compress(matrix: np.ndarray) -> tuple[Pattern, np.ndarray]:
    """Return the pattern of a matrix by columns, and its entries."""
    starts, rows, values = [0], [], []
    for column in matrix.T:
        (places,) = np.nonzero(column)
        rows += places.tolist()
        values += column[places].tolist()
        starts.append(len(rows))
    return (starts, rows), np.array(values)


def solve(plan: Elimination, values: np.ndarray, shift: float, b: np.ndarray) -> np.ndarray:
    """Take the steps of a plan."""
    f: list[float] = []
    for entry in plan.factors:
        value = shift if entry.has_shift else 0.0
        value -= values[entry.value] if entry.value >= 0 else 0.0
        value -= sum(f[i] * f[j] for i, j in entry.products)
        value *= f[entry.pivot] if entry.pivot >= 0 else 1.0
        f.append(1.0 / value if entry.is_pivot else value)
    y = [0.0] * len(b)
    for k, row in enumerate(plan.rows):
        y[k] = b[row] - sum(f[i] * y[m] for m, i in plan.lower[k])
    x = np.zeros(len(b))
    for k in reversed(range(len(b))):
        y[k] = (y[k] - sum(f[i] * y[j] for j, i in plan.upper[k])) * f[plan.pivots[k]]
        x[plan.columns[k]] = y[k]
    return x


@pytest.mark.parametrize("n_algebraic", [0, 3])
@pytest.mark.parametrize("seed", range(10))
def test_random_matrices(seed: int, n_algebraic: int) -> None:
    rng = np.random.default_rng(seed)
    n, shift = 12, 40.0
    matrix = rng.normal(size=(n, n)) * (rng.random((n, n)) < 0.25)
    # Algebraic unknowns that only others' rows hold: pivots beside the diagonal.
    for i in range(n - n_algebraic, n):
        matrix[i, i] = 0.0
        matrix[i, n - n_algebraic + (i + 1) % max(n_algebraic, 1)] = 5.0
    (starts, rows), values = compress(matrix)
    plan = plan_elimination(n, starts, rows, n_algebraic)
    assert plan is not None
    mass = np.diag([1.0] * (n - n_algebraic) + [0.0] * n_algebraic)
    whole, b = shift * mass - matrix, rng.normal(size=n)
    # Rounding, enlarged by the condition, which pivots that are not the largest add to.
    tolerance = 1e-12 * np.linalg.cond(whole)
    exact = np.linalg.solve(whole, b)
    np.testing.assert_allclose(solve(plan, values, shift, b), exact, rtol=0, atol=tolerance)


def test_a_ladder_is_not_filled_in() -> None:
    n = 400
    matrix = np.diag(np.ones(n)) + np.diag(np.ones(n - 1), 1) + np.diag(np.ones(n - 1), -1)
    (starts, rows), _ = compress(matrix)
    plan = plan_elimination(n, starts, rows, 0)
    assert plan is not None
    assert len(plan.factors) == len(rows)


def test_an_arrow_is_eliminated_from_its_tips() -> None:
    n = 50
    matrix = np.diag(np.ones(n))
    matrix[0, :] = matrix[:, 0] = 1.0
    (starts, rows), _ = compress(matrix)
    plan = plan_elimination(n, starts, rows, 0)
    assert plan is not None
    assert len(plan.factors) == len(rows)  # its hub first would fill all of it


def test_a_pattern_that_is_always_singular() -> None:
    # Two algebraic unknowns that only one equation holds.
    assert plan_elimination(3, [0, 1, 2, 3], [0, 1, 1], 2) is None
