"""Factors of matrices of nodes against dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest

from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import Dag
from cotree.linear.factors import factorise, factorise_definite, factorise_unsymmetric


def _symmetric(n, seed):
    """A sparse symmetric matrix whose diagonal outweighs its rows."""
    rng = np.random.default_rng(seed)
    values = rng.uniform(-1.0, 1.0, (n, n)) * (rng.random((n, n)) < 0.3)
    values = values + values.T
    return values + np.diag(np.abs(values).sum(axis=1) + 1.0), rng.uniform(-1.0, 1.0, n)


def _symbols(dag, values):
    """Return symbols of the nonzeros, the same across the diagonal, by row, and their values."""
    rows = [{} for _ in values]
    for i, j in zip(*np.nonzero(values), strict=True):
        rows[i][j] = dag.symbol("a", min(i, j) * len(values) + max(i, j))
    known = {s: values[i][j] for i, row in enumerate(rows) for j, s in row.items()}
    return rows, known


@pytest.mark.parametrize("seed", range(5))
def test_definite_matrices(seed):
    dag, n = Dag(), 9
    values, right = _symmetric(n, seed)
    rows, known = _symbols(dag, values)
    b = [dag.symbol("b", i) for i in range(n)]
    known |= dict(zip(b, right, strict=True))
    found = evaluate(factorise_definite(dag, rows).solve(b), known)
    # Diagonally dominant: a condition of some tens.
    np.testing.assert_allclose(found, np.linalg.solve(values, right), rtol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_pivots_that_are_not_safe_are_left_to_the_core(seed):
    """A border of constraints with zeros on its diagonal, and an unknown that may lack inertia."""
    dag, n, m = Dag(), 8, 2
    values, right = _symmetric(n, seed)
    values[n - m :, n - m :] = 0.0
    border = np.eye(n)[1 : 1 + m, : n - m] + 0.5
    values[n - m :, : n - m], values[: n - m, n - m :] = border, border.T
    rows, known = _symbols(dag, values)
    full = [[row.get(j, dag.zero) for j in range(n)] for row in rows]
    is_safe = [i not in (2, *range(n - m, n)) for i in range(n)]
    factors = factorise(dag, full, is_safe, [[dag.one] * (n - m)] * m)
    assert factors.core.places == (2, n - 2, n - 1)
    assert factors.core.n_determined == 1
    b = [dag.symbol("b", i) for i in range(n)]
    known |= dict(zip(b, right, strict=True))
    found = evaluate(factors.solve(b), known)
    np.testing.assert_allclose(found, np.linalg.solve(values, right), rtol=1e-11)


def test_an_arrow_is_eliminated_from_its_tips():
    dag, n = Dag(), 20
    values = np.eye(n)
    values[0, :] = values[:, 0] = 1.0
    rows, _ = _symbols(dag, values)
    own = factorise_definite(dag, rows).factors
    # Its hub first would fill all of it.
    assert own.pivots[-1][0] in (0, 1)
    assert sum(map(len, own.lower)) == n - 1


@pytest.mark.parametrize("seed", range(20))
def test_static_pivots_solve_sparse_equations(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 9))
    values = rng.uniform(-1.0, 1.0, (n, n)) * (rng.random((n, n)) < 0.4)
    # Rows exchanged: the diagonal is no better than other places.
    values = (values + np.diag(3.0 + rng.random(n)))[rng.permutation(n)]
    right = rng.uniform(-1.0, 1.0, n)
    found, doubt = solved(values, right)
    # Pivots that are not the largest lose what the doubt says.
    np.testing.assert_allclose(found, np.linalg.solve(values, right), rtol=1e-12 * max(1.0, doubt))


def solved(values, right):
    dag, n = Dag(), len(right)
    symbols = {(i, j): dag.symbol("a", i * n + j) for i, j in zip(*np.nonzero(values), strict=True)}
    rows = [{j: s for (k, j), s in symbols.items() if k == i} for i in range(n)]
    factors, doubt = factorise_unsymmetric(dag, rows, 1000)
    b = [dag.symbol("b", i) for i in range(n)]
    known = {s: values[place] for place, s in symbols.items()} | dict(zip(b, right, strict=True))
    *found, doubt = evaluate([*factors.solve(b), doubt], known)
    return found, doubt


def test_doubt_tells_of_cancellation():
    values = np.array([[1.0, 1.0], [1.0, 1.0 + 1e-9]])
    assert solved(values, [1.0, 2.0])[1] == pytest.approx(2e9, rel=1e-6)
    # One equation after another: nothing is subtracted from a pivot.
    assert solved(np.array([[1e-9, 0.0], [1.0, 1.0]]), [1.0, 2.0])[1] == 0.0


def test_equations_without_a_solution_have_no_factors():
    dag = Dag()
    a = dag.symbol("a", 0)
    assert factorise_unsymmetric(dag, [{0: a}, {0: a}], 10) is None
    full = [{j: dag.symbol("a", 3 * i + j) for j in range(3)} for i in range(3)]
    assert factorise_unsymmetric(dag, full, 4) is None  # two by two entries, then one, are changed
